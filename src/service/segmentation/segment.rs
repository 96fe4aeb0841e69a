//! Segmentation of objects in an image, from an initial shape each.

use std::collections::BTreeMap;

use rayon::prelude::*;
use serde::Serialize;

use super::image::{Coordinates, ImageOutput, described, file_limits, plane_frame, refused, volume_frame};
use super::request::{BoxInput, EnergyInput, Minimiser, StageInput};
use crate::formats::fault::Fault;
use crate::formats::image::{Description, Grid as FileGrid, read, read_labels};
use crate::formats::shape::{Points, ShapeInput};
use crate::geometry::raster::{Grid, Mask, Overlap, overlap_unless_stopped};
use crate::numeric::dense::Matrix;
use crate::segmentation::SegmentationError;
use crate::segmentation::energy::{Prior, TermValue};
use crate::segmentation::field::Image;
use crate::segmentation::frame::Frame;
use crate::segmentation::run::scene::Scene;
use crate::segmentation::run::{Outcome, Segmentation, Settings, StageReport, evaluate, segment};
use crate::segmentation::snake::Model;
use crate::segmentation::snake::kind::SpaceModel;
use crate::service::app::memory::{Held, Purpose};
use crate::service::app::{App, ServiceError, Work};
use crate::service::shapes::read::read_shape;
use crate::service::statistics::{CheckedSettings, Setup};

/// Predicted bytes per cell beside the file: the image, and fields while they are prepared.
const CELL_BYTES: usize = 36;
/// Bytes per cell of the prepared field of a term at one blur.
const FIELD_BYTES: usize = 8;
/// Predicted seconds per cell to prepare a term at one blur, beside the kernels.
const CELL: f64 = 4e-8;
/// Predicted seconds per cell and number of a kernel.
const TAP: f64 = 1.5e-9;
/// Predicted seconds per sample of a boundary and term, for one evaluation.
const SAMPLE: f64 = 1.2e-7;
/// Least number of samples for each control point.
const SAMPLES_PER_POINT: f64 = 16.0;
/// Evaluations of the energy in an iteration of methods that move all points at once.
const EVALUATIONS: f64 = 1.3;
/// Evaluations for each point in a sweep from point to point.
const EVALUATIONS_PER_POINT: f64 = 3.5;

/// What is wanted of an image.
#[derive(Debug)]
pub struct Wanted {
    /// Representation of the shapes, and the class of the prior.
    pub settings: CheckedSettings,
    /// Where objects begin.
    pub starts: Starts,
    /// Energy and stages.
    pub energy: EnergyInput,
    /// Shape whose class attracts, with its weight.
    pub prior: Option<(Reference, f64)>,
    /// Coordinates of shapes, blurs and the answer.
    pub coordinates: Coordinates,
    /// Labels of the truth, one for each object; all but 0 without.
    pub truth_labels: Option<Vec<u32>>,
    /// What is answered besides.
    pub answered: Answered,
}

/// Shape whose class attracts.
#[derive(Debug)]
pub enum Reference {
    /// A posted shape.
    Posted(ShapeInput),
    /// A mean of the representation, coordinate-major.
    Stored(Vec<f64>),
}

/// Optional parts of the answer.
#[derive(Debug, Clone, Copy, Default)]
pub struct Answered {
    /// The energy after every iteration.
    pub history: bool,
    /// The gradient of the energy at the result.
    pub gradient: bool,
}

/// Initial shapes.
#[derive(Debug)]
pub enum Starts {
    /// Posted shapes.
    Shapes(Vec<ShapeInput>),
    /// Boxes that the initial shapes fill.
    Boxes(Vec<BoxInput>),
}

impl Starts {
    fn count(&self) -> usize {
        match self {
            Self::Shapes(shapes) => shapes.len(),
            Self::Boxes(boxes) => boxes.len(),
        }
    }
}

/// Value of a term of the energy.
#[derive(Debug, Clone, Copy, Serialize, utoipa::ToSchema)]
pub struct TermOutput {
    /// Without its weight.
    value: f64,
    /// Times the weight.
    weighted: f64,
}

/// One run of a stage; a stage whose result is faulty runs again with more spacing and shorter steps.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub struct StageOutput {
    /// Position of the stage.
    stage: usize,
    /// Number of iterations.
    iterations: usize,
    /// Number of evaluations of the energy and its gradient.
    evaluations: usize,
    /// Weight of the spacing term.
    spacing: f64,
    /// What was wrong with the result: `folded`, `left_image` or `collapsed`.
    fault: Option<&'static str>,
    /// Energy at the start and after every iteration, where asked for.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    history: Vec<f64>,
}

/// Overlap with the truth, counted in the cells of the image.
#[derive(Debug, Clone, Copy, Serialize, utoipa::ToSchema)]
pub struct TruthOutput {
    /// `|A ∩ B|/|A ∪ B|`; 1 for two empty bodies.
    jaccard: f64,
    /// `2|A ∩ B|/(|A| + |B|)`; 1 for two empty bodies.
    dice: f64,
    /// Largest distance from the surface of one to that of the other, in the unit of the coordinates; null if one is empty.
    hausdorff: Option<f64>,
    /// 95th percentile of these distances from one to the other, the larger one of both directions.
    hausdorff_95: Option<f64>,
    /// Mean of these distances.
    mean_surface_distance: Option<f64>,
    /// Number of cells inside the shape and the truth.
    cells: [usize; 2],
}

/// A segmented object.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub struct SegmentedOutput {
    /// Position of its initial shape.
    index: usize,
    /// The shape, in the coordinates of the request.
    control_points: Points,
    /// Whether the last stage converged.
    converged: bool,
    /// Why the segmentation ended: `converged`, `limit`, `line_search` (no step decreases the energy: usual at the level of the
    /// noise), `folded`, `left_image` or `collapsed`. After the last three the shape is that of the stage before.
    stop: &'static str,
    /// Number of iterations of all stages.
    iterations: usize,
    /// The terms of the energy at the result.
    energies: BTreeMap<&'static str, TermOutput>,
    /// Runs of the stages.
    stages: Vec<StageOutput>,
    /// Gradient of the energy with respect to the free points, where asked for: all control points, without those of a cylinder
    /// beyond its ends.
    #[serde(skip_serializing_if = "Option::is_none")]
    gradient: Option<Points>,
    /// Overlap with the truth, where it was posted.
    #[serde(skip_serializing_if = "Option::is_none")]
    overlap: Option<TruthOutput>,
    /// Limitations of the result.
    warnings: Vec<String>,
}

/// Segmented objects of an image.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub struct SegmentAnswer {
    /// The image.
    image: ImageOutput,
    /// Coordinates of the shapes.
    coordinates: Coordinates,
    /// One entry for each initial shape, in order.
    results: Vec<SegmentedOutput>,
}

/// An image of which the header was read, and what is wanted of it.
#[derive(Debug)]
pub struct Planned {
    wanted: Wanted,
    stages: Vec<StageInput>,
    description: Description,
    _room: Held,
}

/// The files of a request.
#[derive(Debug, Clone, Copy)]
pub struct Files<'a> {
    /// The image.
    pub image: &'a [u8],
    /// Labels of the truth.
    pub truth: Option<&'a [u8]>,
}

impl Planned {
    /// Reads the headers of the files, checks what is wanted and reserves memory.
    ///
    /// # Errors
    /// Faults at `/image`, `/truth` and of the fields; [`ServiceError::Overloaded`] if memory is short.
    pub fn new(app: &App, files: Files<'_>, wanted: Wanted) -> Result<Self, ServiceError> {
        let description = described(files.image, "image", &app.limits)?;
        let grid = description.grid;
        let truth = files.truth.map(|truth| described(truth, "truth", &app.limits)).transpose()?;
        let mut faults = wanted.faults(&grid, app);
        if let Some(truth) = truth
            && truth.grid.size() != grid.size()
        {
            let detail =
                format!("expected {}, the size of the image, got {}", size(&grid), size(&truth.grid));
            faults.push(Fault::new("/truth", detail));
        }
        ServiceError::unless_empty(faults)?;
        let stages = wanted.stages(&grid);
        let fields = wanted.energy.image_terms().len() * stages.len();
        let cells = grid.cells().saturating_mul(CELL_BYTES + FIELD_BYTES * fields);
        let read = |found: &Description| usize::try_from(found.memory_bytes).unwrap_or(usize::MAX);
        let files = read(&description).saturating_add(truth.as_ref().map_or(0, read));
        let room = app.memory.hold(Purpose::Bodies, cells.saturating_add(files))?;
        Ok(Self { wanted, stages, description, _room: room })
    }

    /// Predicted work: the fields of all terms and blurs, then the iterations, for shapes half as large as the image.
    pub fn work(&self) -> Work {
        let grid = &self.description.grid;
        let [x, y, z] = grid.size().map(|count| count as f64);
        let (planar, cell) = (grid.is_planar(), self.wanted.cell(grid));
        let terms = self.wanted.energy.terms.len() as f64;
        let axes = if planar { 2.0 } else { 3.0 };
        let field = |stage: &StageInput| CELL + axes * TAP * (1.0 + 8.0 * stage.sigma / cell);
        let fields: f64 = self.stages.iter().map(field).sum();
        let representation = &self.wanted.settings.representation;
        let (points, vertices) = (representation.size() as f64, representation.refined_vertices() as f64);
        let samples = |stage: &StageInput| {
            let blur = (stage.sigma / cell).max(1.0);
            let boundary = if planar { x + y } else { (x * y + y * z + z * x) / (blur * blur) };
            boundary.max(SAMPLES_PER_POINT * points).max(vertices)
        };
        let (evaluations, factorisation) = match self.wanted.energy.method {
            Minimiser::Lbfgs => (EVALUATIONS, 0.0),
            Minimiser::Newton => (EVALUATIONS, (2.0 * points).powi(3) / 3.0),
            Minimiser::Coordinates => (1.0 + EVALUATIONS_PER_POINT * points, 0.0),
        };
        let iterations: f64 = self.stages.iter().map(|stage| stage.iterations as f64).sum();
        let runs =
            self.stages.iter().map(|stage| (1.0 + evaluations * stage.iterations as f64) * samples(stage));
        let objects = self.wanted.starts.count() as f64;
        Work::from_seconds(
            grid.cells() as f64 * terms * fields + runs.sum::<f64>() * objects * terms * SAMPLE,
        ) + Work::from_multiply_adds(objects * iterations * factorisation)
    }

    /// Segments the objects.
    ///
    /// # Errors
    /// Files that are broken; initial shapes that are faulty or enclose nothing; an image without contrast;
    /// [`ServiceError::Cancelled`].
    pub fn segment(self, app: &App, files: Files<'_>) -> Result<SegmentAnswer, ServiceError> {
        let Self { wanted, stages, .. } = self;
        let setup = Setup::new(app, wanted.settings.clone())?;
        let model = SpaceModel::new(&setup.space)
            .map_err(|fault| ServiceError::below(vec![Fault::from(fault)], "/representation"))?;
        let file = read(files.image, &file_limits(&app.limits)).map_err(|error| refused(&error, "image"))?;
        let labels =
            |truth| read_labels(truth, &file_limits(&app.limits)).map_err(|error| refused(&error, "truth"));
        let truth = files.truth.map(labels).transpose()?.map(|file| file.values);
        let grid = file.grid;
        let image = Image::new(grid.size(), file.values).map_err(faulty)?;
        let task = Task { app, wanted: &wanted, stages: &stages, setup: &setup, truth };
        let results = match &model {
            SpaceModel::Plane(model) => {
                let frame = plane_frame(&grid, wanted.coordinates)?;
                task.run(&image, frame, &**model)?
            }
            SpaceModel::Space(model) => {
                let frame = volume_frame(&grid, wanted.coordinates).map_err(faulty)?;
                task.run(&image, frame, &**model)?
            }
        };
        Ok(SegmentAnswer { image: ImageOutput::new(&grid), coordinates: wanted.coordinates, results })
    }
}

impl Wanted {
    fn faults(&self, grid: &FileGrid, app: &App) -> Vec<Fault> {
        let dimension = self.settings.representation.dimension();
        let mut faults = self.energy.faults(self.cell(grid));
        let axes = if grid.is_planar() { 2 } else { 3 };
        if axes != dimension {
            let detail = format!("expected an image of {dimension} dimensions, as the shapes, got {axes}");
            faults.push(Fault::new("/image", detail));
        }
        let (list, count, most) = match &self.starts {
            Starts::Shapes(shapes) => ("shapes", shapes.len(), app.limits.shapes),
            Starts::Boxes(boxes) => ("boxes", boxes.len(), app.limits.shapes),
        };
        if !(1..=most).contains(&count) {
            let detail = format!("expected between 1 and {most} entries, got {count}");
            faults.push(Fault::new(format!("/{list}"), detail));
        }
        if let Starts::Boxes(boxes) = &self.starts {
            for (index, posted) in boxes.iter().enumerate() {
                let at = format!("/boxes/{index}");
                faults.extend(
                    posted.faults(dimension).into_iter().map(|fault| fault.below(&at).at_shape(index)),
                );
            }
        }
        if let Some(labels) = &self.truth_labels
            && labels.len() != count
        {
            let detail = format!("expected a label for each of {count} shapes, got {}", labels.len());
            faults.push(Fault::new("/truth_labels", detail));
        }
        if let Some((_, weight)) = self.prior
            && !(0.0..=1e9).contains(&weight)
        {
            faults.push(Fault::new(
                "/prior/weight",
                format!("expected a number between 0 and 1e9, got {weight}"),
            ));
        }
        faults
    }

    /// The side of a cell in the unit of the coordinates.
    fn cell(&self, grid: &FileGrid) -> f64 {
        match self.coordinates {
            Coordinates::Index => 1.0,
            Coordinates::World if grid.is_planar() => (grid.spacing()[0] * grid.spacing()[1]).sqrt(),
            Coordinates::World => grid.determinant().abs().cbrt(),
        }
    }

    fn stages(&self, grid: &FileGrid) -> Vec<StageInput> {
        if self.energy.stages.is_empty() {
            StageInput::usual(self.cell(grid))
        } else {
            self.energy.stages.clone()
        }
    }
}

/// A segmentation whose files were read.
struct Task<'a> {
    app: &'a App,
    wanted: &'a Wanted,
    stages: &'a [StageInput],
    setup: &'a Setup,
    /// Labels of the truth, x fastest.
    truth: Option<Vec<u32>>,
}

impl Task<'_> {
    fn run<const D: usize>(
        &self,
        image: &Image<f32>,
        frame: Frame<D>,
        model: &dyn Model<D>,
    ) -> Result<Vec<SegmentedOutput>, ServiceError> {
        let starts = self.starts::<D>()?;
        let mut settings = self.wanted.energy.settings::<D>(self.stages);
        settings.prior = self.prior(frame, model)?;
        let sigmas: Vec<f64> = self.stages.iter().map(|stage| stage.sigma).collect();
        let scene = Scene::new(image, frame, &self.wanted.energy.image_terms(), &sigmas);
        let object =
            |(index, start): (usize, &Vec<[f64; D]>)| self.object(index, start, &scene, model, &settings);
        starts.par_iter().enumerate().map(object).collect()
    }

    /// Control points of the initial shapes, in the coordinates of the request.
    fn starts<const D: usize>(&self) -> Result<Vec<Vec<[f64; D]>>, ServiceError> {
        let (reading, mut faults) = (self.setup.reading(&self.app.limits), Vec::new());
        let mut shapes = Vec::new();
        match &self.wanted.starts {
            Starts::Shapes(posted) => {
                for (index, shape) in posted.iter().enumerate() {
                    let below = |fault: Fault| fault.below(&format!("/shapes/{index}")).at_shape(index);
                    match read_shape(&reading, shape.clone()) {
                        Ok(shape) => shapes.push(rows(&shape.control_points)),
                        Err(found) => faults.extend(found.into_iter().map(below)),
                    }
                }
            }
            Starts::Boxes(boxes) => {
                for (index, posted) in boxes.iter().enumerate() {
                    match self.setup.space.fill_box(&posted.lower, &posted.upper) {
                        Ok(shape) => shapes.push(rows(shape.as_slice())),
                        Err(fault) => {
                            faults.push(Fault::from(fault).below("/representation").at_shape(index))
                        }
                    }
                }
            }
        }
        ServiceError::unless_empty(faults)?;
        Ok(shapes)
    }

    fn prior<const D: usize>(
        &self,
        frame: Frame<D>,
        model: &dyn Model<D>,
    ) -> Result<Option<(Prior<D>, f64)>, ServiceError> {
        let Some((reference, weight)) = &self.wanted.prior else { return Ok(None) };
        let at = "/prior/reference";
        let reference: Vec<[f64; D]> = match reference {
            Reference::Posted(shape) => {
                let read = read_shape(&self.setup.reading(&self.app.limits), shape.clone());
                rows(&read.map_err(|faults| ServiceError::below(faults, at))?.control_points)
            }
            Reference::Stored(control_points) => rows(control_points),
        };
        let (metric, method) = (self.setup.metric.clone(), self.setup.method.clone());
        let prior = Prior::new(metric, method, &reference, model.lift(), frame);
        let prior = prior.map_err(|error| ServiceError::invalid(at, error.to_string()))?;
        Ok(Some((prior, *weight)))
    }

    fn object<const D: usize>(
        &self,
        index: usize,
        start: &[[f64; D]],
        scene: &Scene<D>,
        model: &dyn Model<D>,
        settings: &Settings<D>,
    ) -> Result<SegmentedOutput, ServiceError> {
        let context = self.app.pool.context();
        let stop = || context.is_cancelled();
        let frame = scene.frame();
        let in_cells: Vec<[f64; D]> = start.iter().map(|point| frame.to_index(*point)).collect();
        let first = model.free_points(&in_cells);
        let at_start = |error| faulty_start(error, &self.wanted.starts, index);
        let begun = evaluate(scene, model, &first, settings).map_err(at_start)?;
        let found = segment(scene, model, &first, settings, &stop).map_err(at_start)?;
        if found.outcome == Outcome::Stopped || stop() {
            return Err(ServiceError::Cancelled);
        }
        let gradient = match self.wanted.answered.gradient {
            true => Some(evaluate(scene, model, &found.rows, settings).map_err(at_start)?.gradient),
            false => None,
        };
        let world = |rows: Vec<[f64; D]>| {
            points(&rows.into_iter().map(|row| frame.to_world(row)).collect::<Vec<_>>())
        };
        let mut warnings = warnings(&found, &begun.terms);
        if D == 3 && self.wanted.prior.is_some() && model.lift().is_some() {
            warnings.push("the prior compares control points beyond the ends as they are extended".into());
        }
        Ok(SegmentedOutput {
            index,
            control_points: world(model.control_points(&found.rows)),
            converged: found.outcome == Outcome::Converged,
            stop: found.outcome.name(),
            iterations: found.iterations(),
            energies: found.terms.iter().map(|term| (term.name, TermOutput::from(*term))).collect(),
            stages: found.stages.iter().map(|stage| self.stage(stage)).collect(),
            gradient: gradient.map(|rows| {
                points(&rows.into_iter().map(|row| frame.gradient_to_world(row)).collect::<Vec<_>>())
            }),
            overlap: self.overlap(index, scene, model, &found.rows, &stop)?,
            warnings,
        })
    }

    fn stage(&self, report: &StageReport) -> StageOutput {
        StageOutput {
            stage: report.stage,
            iterations: report.iterations,
            evaluations: report.evaluations,
            spacing: report.spacing,
            fault: report.fault.map(|fault| Outcome::from(fault).name()),
            history: if self.wanted.answered.history { report.history.clone() } else { Vec::new() },
        }
    }

    /// Overlap of a shape with its label of the truth.
    fn overlap<const D: usize>(
        &self,
        index: usize,
        scene: &Scene<D>,
        model: &dyn Model<D>,
        rows: &[[f64; D]],
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Result<Option<TruthOutput>, ServiceError> {
        let Some(truth) = &self.truth else { return Ok(None) };
        let label = self.wanted.truth_labels.as_ref().and_then(|labels| labels.get(index));
        let is_truth = |value: &u32| label.map_or(*value > 0, |label| value == label);
        let mut spacing = [1.0; 3];
        spacing[..D].copy_from_slice(&scene.frame().spacing());
        let in_cells = Grid { first: [0.0; 3], spacing: [1.0; 3], size: scene.size() };
        let grid = Grid { spacing, ..in_cells };
        let found = Mask { grid, ..model.outline(rows).cells(&in_cells) };
        let inside: Vec<bool> = truth.iter().map(is_truth).collect();
        let truth = Mask::from_x_fastest(grid, &inside)
            .ok_or_else(|| ServiceError::Internal("a truth of another size".into()))?;
        let overlap = overlap_unless_stopped(&found, &truth, stop).ok_or(ServiceError::Cancelled)?;
        Ok(Some(TruthOutput::from(overlap)))
    }
}

/// Coordinate-major control points as rows.
fn rows<const D: usize>(control_points: &[f64]) -> Vec<[f64; D]> {
    let count = control_points.len() / D;
    (0..count).map(|k| std::array::from_fn(|c| control_points[c * count + k])).collect()
}

fn points<const D: usize>(rows: &[[f64; D]]) -> Points {
    let matrix = Matrix::from_fn(rows.len(), D, |k, c| rows[k][c]);
    Points::from_columns(matrix.as_slice().to_vec(), D)
}

/// Limitations of a result; `begun` are the terms at the initial shape.
fn warnings<const D: usize>(found: &Segmentation<D>, begun: &[TermValue]) -> Vec<String> {
    let mut warnings = Vec::new();
    let fault = match found.outcome {
        Outcome::Folded => Some("folded"),
        Outcome::LeftImage => Some("left the image"),
        Outcome::Collapsed => Some("collapsed"),
        _ => None,
    };
    if let (Some(fault), Some(last)) = (fault, found.stages.last()) {
        let stage = last.stage;
        warnings.push(format!("the shape {fault} in stage {stage}: the shape before that stage is answered"));
    }
    for term in
        begun.iter().filter(|term| matches!(term.name, "contour" | "local_contrast") && term.value > 0.0)
    {
        warnings.push(format!(
            "the term {} is positive at the initial shape ({:.2e}), as for an object of the other polarity",
            term.name, term.value
        ));
    }
    warnings
}

/// Refusal of an image or a setting.
fn faulty(error: SegmentationError) -> ServiceError {
    ServiceError::invalid("/image", error.to_string())
}

/// Refusal of an initial shape, or of an image without contrast in it.
fn faulty_start(error: SegmentationError, starts: &Starts, index: usize) -> ServiceError {
    let list = match starts {
        Starts::Shapes(_) => "shapes",
        Starts::Boxes(_) => "boxes",
    };
    match error {
        SegmentationError::NoVolume { .. } | SegmentationError::Flat => {
            let fault = Fault::new(format!("/{list}/{index}"), error.to_string()).at_shape(index);
            ServiceError::Invalid(vec![fault].into())
        }
        SegmentationError::Scale { .. } => ServiceError::invalid("/terms", error.to_string()),
        SegmentationError::Method => ServiceError::invalid("/method", error.to_string()),
        SegmentationError::Stages { .. } => ServiceError::invalid("/stages", error.to_string()),
        _ => faulty(error),
    }
}

fn size(grid: &FileGrid) -> String {
    grid.size().map(|count| count.to_string()).join(" × ")
}

impl From<TermValue> for TermOutput {
    fn from(TermValue { value, weighted, .. }: TermValue) -> Self {
        Self { value, weighted }
    }
}

impl From<Overlap> for TruthOutput {
    fn from(overlap: Overlap) -> Self {
        let Overlap { jaccard, dice, hausdorff, hausdorff_95, mean_surface_distance, cells, .. } = overlap;
        Self { jaccard, dice, hausdorff, hausdorff_95, mean_surface_distance, cells }
    }
}
