//! Segmentation of objects in an image, from an initial shape each.

use std::ops::Range;
use std::sync::Arc;

use super::answer::{
    CellsOutput, SegmentAnswer, SegmentedOutput, StageOutput, TermOutput, TruthOutput, finite, warnings,
};
use super::cost::{self, SegmentEstimate};
use super::image::{Coordinates, ImageOutput, Part, plane_frame, unit_of, volume_frame};
use super::kinds::Kind;
use super::place;
use super::prior::{begun, with_target};
use super::reference::Structure;
use super::request::{FieldInput, StageInput};
use super::shown::Segmented;
use super::starts::{Starts, usual_radius};
use super::wanted::{Reference, Wanted, size};
use crate::geometry::raster::{Grid, Mask, overlap_unless_stopped};
use crate::numeric::bounded::Stop;
use crate::numeric::dense::Matrix;
use crate::segmentation::SegmentationError;
use crate::segmentation::blur::Blur;
use crate::segmentation::energy::Prior;
use crate::segmentation::field::Image;
use crate::segmentation::frame::Frame;
use crate::segmentation::run::scene::{FieldTerm, Scene};
use crate::segmentation::run::{Level, Outcome, Settings, StageReport, evaluate, segment_nested};
use crate::segmentation::snake::{Model, Outline};
use crate::service::app::parallel;
use crate::service::app::progress::{JobContext, Meter, Part as ProgressPart};
use crate::service::app::{App, ServiceError, Work};
use crate::service::shapes::read::read_shape;
use crate::service::statistics::Setup;
use crate::wire::fault::Fault;
use crate::wire::image::{Description, Grid as FileGrid};
use crate::wire::shape::{Points, ShapeInput};
use crate::wire::unit::Unit;

/// Unit of the work of which progress is counted.
const MICROSECONDS: f64 = 1e6;
/// How often a minimisation looks for cancellation in an evaluation: at its beginning, and between the steps.
const LOOKS_PER_EVALUATION: f64 = 2.0;
/// Longest side of an initial shape relative to that of the image. Of a larger one less than half is in the image.
const MOST_OF_IMAGE: f64 = 2.0;

/// An image whose header was read, and its settings.
#[derive(Debug)]
pub struct Planned {
    wanted: Wanted,
    stages: Vec<StageInput>,
    description: Description,
    /// Predicted memory.
    bytes: usize,
}

/// The files of a request.
#[derive(Debug, Clone, Copy)]
pub struct Files<'a> {
    /// The image.
    pub image: Part<'a>,
    /// Labels of the truth.
    pub truth: Option<Part<'a>>,
}

impl Planned {
    /// Reads the headers of the files, checks the settings and predicts the cost.
    ///
    /// # Errors
    /// Faults at `/image`, `/truth` and of the fields.
    pub fn new(app: &App, files: Files<'_>, mut wanted: Wanted) -> Result<Self, ServiceError> {
        let description = files.image.describe(&app.limits)?;
        let grid = description.grid;
        let truth = files.truth.map(|truth| truth.describe(&app.limits)).transpose()?;
        let mut faults = wanted.faults(&grid, app);
        if let Some(truth) = truth
            && truth.grid.size() != grid.size()
        {
            let detail =
                format!("expected {}, the size of the image, got {}", size(&grid), size(&truth.grid));
            faults.push(Fault::new("/truth", detail));
        }
        ServiceError::unless_empty(faults)?;
        wanted.convert_prior(wanted.unit.or_else(|| unit_of(&grid, wanted.coordinates)))?;
        let stages = wanted.stages(&grid);
        let read = |found: &Description| usize::try_from(found.memory_bytes).unwrap_or(usize::MAX);
        let files = read(&description).saturating_add(truth.as_ref().map_or(0, read));
        let bytes = cost::memory(&wanted, &grid, &stages, files);
        Ok(Self { wanted, stages, description, bytes })
    }

    /// Unit of the coordinates of the objects, where the request or the image gives one.
    pub fn unit(&self) -> Option<Unit> {
        self.wanted.unit.or_else(|| unit_of(&self.description.grid, self.wanted.coordinates))
    }

    /// Predicted work.
    pub fn work(&self) -> Work {
        cost::work(&self.wanted, &self.description.grid, &self.stages)
    }

    /// Predicted cost.
    pub fn estimate(&self) -> SegmentEstimate {
        let (objects, seconds) = (self.wanted.starts.count(), self.work().seconds());
        SegmentEstimate { objects, memory_bytes: self.bytes, seconds }
    }

    /// Segments the objects; the memory is that of [`Self::estimate`].
    ///
    /// # Errors
    /// Files that are broken; initial shapes that are faulty or enclose nothing; an image without contrast;
    /// [`ServiceError::Cancelled`].
    pub fn segment(self, app: &App, files: Files<'_>) -> Result<Segmented, ServiceError> {
        let context = app.pool.context();
        let meter = self.meter(&context);
        meter.enter(0, "read");
        let Self { wanted, stages, .. } = self;
        let kinds = wanted.kinds.prepared(app, &stages)?;
        let file = files.image.image(&app.limits)?;
        let truth = files.truth.map(|truth| truth.labels(&app.limits)).transpose()?.map(|file| file.values);
        let grid = file.grid;
        let image = Image::new(grid.size(), file.values).map_err(faulty)?;
        meter.enter(0, "fields");
        let terms = terms(&wanted, &image, &grid, &|| context.is_cancelled())?;
        let (wanted, stages, kinds) = (&wanted, &stages[..], &kinds[..]);
        let task =
            Task { app, wanted, stages, kinds, grid: &grid, truth, terms, context: &context, meter: &meter };
        // All kinds are of the dimension of the image.
        let in_plane: Option<Vec<_>> = kinds.iter().map(|kind| kind.nested.in_plane(stages.len())).collect();
        let splits = || stages.iter().map(|stage| stage.splits);
        let in_space: Option<Vec<_>> = kinds.iter().map(|kind| kind.nested.in_space(splits())).collect();
        let found = match (in_plane, in_space) {
            (Some(levels), _) => task.run(plane_frame(&grid, wanted.coordinates)?, &levels)?,
            (None, Some(levels)) => {
                task.run(volume_frame(&grid, wanted.coordinates).map_err(faulty)?, &levels)?
            }
            (None, None) => return Err(ServiceError::Internal("shapes of several dimensions".into())),
        };
        let (answer, outlines) = gathered(found, &grid, wanted.coordinates);
        Ok(Segmented { answer, outlines, image, grid })
    }

    /// Progress by the predicted work.
    fn meter(&self, context: &JobContext) -> Meter {
        let parts = cost::parts(&self.wanted, &self.description.grid, &self.stages);
        let part = |part: ProgressPart| ProgressPart {
            work: MICROSECONDS * part.work,
            count: LOOKS_PER_EVALUATION * part.count,
        };
        Meter::new(context, parts.map(part).into(), 0.0)
    }
}

/// Image terms with the fields that they integrate. Equal fields are detected once.
fn terms(
    wanted: &Wanted,
    image: &Image<f32>,
    grid: &FileGrid,
    stop: Stop<'_>,
) -> Result<Vec<FieldTerm>, ServiceError> {
    let mut known: Vec<(FieldInput, Arc<Image>)> = Vec::new();
    let mut terms = Vec::new();
    let energy = &wanted.energy;
    let wanted_terms = energy.fields().zip(energy.image_terms()).zip(energy.by_contrast());
    for (((index, input), (term, weight)), by_contrast) in wanted_terms {
        let found = known.iter().find(|(known, _)| *known == input).map(|(_, field)| field.clone());
        let field = match (found, input.detector(wanted.coordinates)) {
            (Some(field), _) => field,
            (None, None) => Arc::new(image.map(|value| value)),
            (None, Some(detector)) => {
                let field = detector.detected(image, grid, stop);
                Arc::new(field.map_err(|error| of_field(error, index))?)
            }
        };
        known.push((input, field.clone()));
        terms.push(FieldTerm { field, term, weight, by_contrast });
    }
    Ok(terms)
}

/// The refusal of a field at its place: the detector names its own settings, and the image.
fn of_field(error: ServiceError, index: usize) -> ServiceError {
    let ServiceError::Invalid(faults) = error else { return error };
    let below = |fault: Fault| fault.below(&format!("/terms/{index}/field"));
    ServiceError::Invalid(faults.map(|fault| if fault.pointer == "/image" { fault } else { below(fault) }))
}

/// A segmented object.
struct Found {
    object: SegmentedOutput,
    /// The outlines of its initial shape and of its result, where they are asked for.
    outlines: Option<[Outline; 2]>,
    /// The cells of its result, where there are others.
    cells: Vec<Range<usize>>,
}

/// The answer of all objects, each with the others that cover some of the same cells.
fn gathered(
    found: Vec<Found>,
    grid: &FileGrid,
    coordinates: Coordinates,
) -> (SegmentAnswer, Vec<[Outline; 2]>) {
    let (mut results, mut outlines, mut cells) = (Vec::new(), Vec::new(), Vec::new());
    for one in found {
        results.push(one.object);
        outlines.extend(one.outlines);
        cells.push(one.cells);
    }
    let shared = place::overlaps(&cells, grid.cells());
    for (result, shared) in results.iter_mut().zip(shared) {
        result.warnings.extend(place::warnings(&shared));
        result.shared = shared;
    }
    (SegmentAnswer { image: ImageOutput::new(grid), coordinates, results }, outlines)
}

/// A segmentation whose files were read.
struct Task<'a> {
    app: &'a App,
    wanted: &'a Wanted,
    stages: &'a [StageInput],
    /// Those of the prior are the first.
    kinds: &'a [Kind],
    grid: &'a FileGrid,
    /// Labels of the truth, x fastest.
    truth: Option<Vec<u32>>,
    /// Image terms with their fields.
    terms: Vec<FieldTerm>,
    context: &'a JobContext,
    meter: &'a Meter,
}

impl Task<'_> {
    /// `levels` are those of each kind.
    fn run<const D: usize>(
        &self,
        frame: Frame<D>,
        levels: &[Vec<Level<'_, D>>],
    ) -> Result<Vec<Found>, ServiceError> {
        let starts: Vec<Vec<[f64; D]>> = self.starts()?.iter().map(|start| rows(start)).collect();
        let wall = self.wanted.keeping.box_factor(&self.wanted.starts);
        let mut settings = self.wanted.energy.settings::<D>(self.stages, wall);
        settings.prior = self.prior(frame, levels[0][0].model)?;
        let sigmas: Vec<Blur> = self.stages.iter().map(|stage| stage.sigma.into()).collect();
        let stop = || self.context.is_cancelled();
        let scene = Scene::of_fields(self.grid.size(), frame, &self.terms, &sigmas, &stop);
        let scene = scene.ok_or(ServiceError::Cancelled)?;
        self.meter.enter(1, "segment");
        let object = |index, start: &Vec<[f64; D]>| {
            self.object(index, start, &scene, &levels[self.wanted.kinds.position(index)], &settings)
        };
        parallel::map_ref(&starts, object).into_iter().collect()
    }

    /// Control points of the initial shapes, in the coordinates of the request. Where start points are searched, they begin where they
    /// fit the reference of the prior best.
    fn starts(&self) -> Result<Vec<Vec<f64>>, ServiceError> {
        let (wanted, grid) = (self.wanted, self.grid);
        let radius = usual_radius(grid, wanted.coordinates, wanted.cell(grid));
        let kind = |index| &self.kinds[wanted.kinds.position(index)];
        let starts = wanted.starts.control_points(kind, &self.app.limits, radius)?;
        let reference = match &wanted.prior {
            Some((Reference::Posted(shape), _)) => Some(self.posted(shape)?),
            Some((stored, _)) => stored.stored_shape(),
            None => None,
        };
        let Some(reference) = reference else { return Ok(starts) };
        let setup = self.setup();
        if !setup.matching.searches() {
            return Ok(starts);
        }
        with_target(setup, &reference, "/prior/reference", |target| {
            parallel::map(starts, |_, start| begun(setup, target, start)).into_iter().collect()
        })
    }

    /// The space of the prior.
    fn setup(&self) -> &Setup {
        &self.kinds[0].setup
    }

    fn prior<const D: usize>(
        &self,
        frame: Frame<D>,
        model: &dyn Model<D>,
    ) -> Result<Option<(Prior<D>, f64)>, ServiceError> {
        let Some((reference, weight)) = &self.wanted.prior else { return Ok(None) };
        let structures = match reference {
            Reference::Posted(shape) => vec![self.attracted(&[self.posted(shape)?], false, frame, model)?],
            Reference::Stored(structures) => {
                let of = |one: &Structure| self.attracted(&one.shapes, one.is_span, frame, model);
                structures.iter().map(of).collect::<Result<Vec<_>, _>>()?
            }
        };
        Ok(structures.into_iter().reduce(Prior::or).map(|prior| (prior, *weight)))
    }

    /// The attraction to the span of shapes, or to the class of one.
    fn attracted<const D: usize>(
        &self,
        shapes: &[Vec<f64>],
        is_span: bool,
        frame: Frame<D>,
        model: &dyn Model<D>,
    ) -> Result<Prior<D>, ServiceError> {
        let (metric, lift) = (self.setup().metric.clone(), model.lift());
        if is_span {
            let class = self.wanted.kinds.usual().linear_class();
            let class = class.ok_or_else(|| ServiceError::Internal("a span of no class".into()))?;
            return Ok(Prior::spanned(metric, class, shapes, lift, frame));
        }
        let prior = Prior::new(metric, self.setup().method.clone(), &rows(&shapes.concat()), lift, frame);
        prior.map_err(|error| ServiceError::invalid("/prior/reference", error.to_string()))
    }

    /// The dictionary that attracts a result, where there are several to choose from.
    fn chosen<const D: usize>(&self, settings: &Settings<D>, result: &[[f64; D]]) -> Option<String> {
        let ((prior, _), (reference, _)) = (settings.prior.as_ref()?, self.wanted.prior.as_ref()?);
        reference.choice(prior.chosen(result)?).map(str::to_owned)
    }

    /// Control points of a posted reference.
    fn posted(&self, shape: &ShapeInput) -> Result<Vec<f64>, ServiceError> {
        let read = read_shape(&self.setup().reading(&self.app.limits), shape.clone());
        let shape = read.map_err(|faults| ServiceError::below(faults, "/prior/reference"))?;
        Ok(shape.control_points)
    }

    fn object<const D: usize>(
        &self,
        index: usize,
        start: &[[f64; D]],
        scene: &Scene<D>,
        levels: &[Level<'_, D>],
        settings: &Settings<D>,
    ) -> Result<Found, ServiceError> {
        let stop = || {
            self.meter.worked(1);
            self.context.is_cancelled()
        };
        let (coarse, model) = (levels[0].model, levels[levels.len() - 1].model);
        let frame = scene.frame();
        let first = self.first(index, start, scene, coarse)?;
        let at_start = |error| faulty_start(error, &self.wanted.starts, index);
        let size_factor = self.wanted.keeping.size_factor(&self.wanted.starts, index, D);
        let settings = &Settings { size_factor: Some(size_factor), ..settings.clone() };
        let begun = evaluate(scene, coarse, &first, settings).map_err(at_start)?;
        let found = segment_nested(scene, levels, &first, settings, &stop).map_err(at_start)?;
        if found.outcome == Outcome::Stopped || stop() {
            return Err(ServiceError::Cancelled);
        }
        let slopes = || evaluate(scene, model, &found.rows, settings).map(|ended| ended.gradient);
        let gradient = self.wanted.answered.gradient.then(slopes).transpose().map_err(at_start)?;
        let world = |rows: Vec<[f64; D]>| {
            points(&rows.into_iter().map(|row| frame.to_world(row)).collect::<Vec<_>>())
        };
        let mut warnings = warnings(&found, &begun.terms, size_factor);
        warnings.extend(self.more_warnings(index, D == 3 && model.lift().is_some()));
        let outlines = [coarse.outline(&first), model.outline(&found.rows)];
        let cells = self.covered(&outlines[1], scene.size());
        let control_points = model.control_points(&found.rows);
        let gradient_rows = gradient.as_ref().map(|_| free_rows(model, control_points.len()));
        let chosen_dictionary = self.chosen(settings, &found.rows);
        let object = SegmentedOutput {
            index,
            moved: found.moved.into(),
            shared: Vec::new(),
            control_points: world(control_points),
            representation: self.kinds[self.wanted.kinds.position(index)].nested.finest().cloned(),
            converged: found.outcome == Outcome::Converged,
            stop: found.outcome.name(),
            iterations: found.iterations(),
            energies: found.terms.iter().map(|term| (term.name, TermOutput::from(*term))).collect(),
            stages: found.stages.iter().map(|stage| self.stage(stage)).collect(),
            gradient: gradient.map(|rows| {
                points(&rows.into_iter().map(|row| frame.gradient_to_world(row)).collect::<Vec<_>>())
            }),
            gradient_rows,
            overlap: self.overlap(index, scene, &outlines[1], &stop)?,
            mask: self.wanted.answered.mask.then(|| self.mask(scene, &outlines[1])),
            component: self.wanted.starts.component(index),
            chosen_dictionary,
            warnings,
        };
        let outlines = self.wanted.answered.outlines.then_some(outlines);
        Ok(Found { object, outlines, cells })
    }

    /// The free points of an initial shape.
    fn first<const D: usize>(
        &self,
        index: usize,
        start: &[[f64; D]],
        scene: &Scene<D>,
        model: &dyn Model<D>,
    ) -> Result<Vec<[f64; D]>, ServiceError> {
        let in_cells: Vec<[f64; D]> = start.iter().map(|point| scene.frame().to_index(*point)).collect();
        self.check_extent(index, &in_cells, scene.size())?;
        Ok(model.free_points(&in_cells))
    }

    /// The cells of a result, where there are others that may cover them too.
    fn covered(&self, outline: &Outline, size: [usize; 3]) -> Vec<Range<usize>> {
        if self.wanted.starts.count() > 1 { place::runs(outline, size) } else { Vec::new() }
    }

    /// Warnings of the start, and of a prior on a shape whose control points beyond the ends are `extended`.
    fn more_warnings(&self, index: usize, extended: bool) -> impl Iterator<Item = String> {
        let of_prior = (extended && self.wanted.prior.is_some())
            .then(|| "the prior compares control points beyond the ends as they are extended".into());
        self.wanted.starts.warning(index).into_iter().chain(of_prior)
    }

    /// Refuses an initial shape that is much larger than the image: its boundary would have as many more samples.
    fn check_extent<const D: usize>(
        &self,
        index: usize,
        in_cells: &[[f64; D]],
        size: [usize; 3],
    ) -> Result<(), ServiceError> {
        let most = MOST_OF_IMAGE * size.into_iter().max().unwrap_or(0) as f64;
        let along = |c: usize| in_cells.iter().map(move |point| point[c]);
        let side = |c: usize| along(c).fold(f64::MIN, f64::max) - along(c).fold(f64::MAX, f64::min);
        let longest = (0..D).map(side).fold(0.0, f64::max);
        if longest <= most {
            return Ok(());
        }
        let detail = format!(
            "expected an initial shape of at most {most} cells along every axis, {MOST_OF_IMAGE} times the longest side of \
             the image, got {longest:.3e}"
        );
        Err(ServiceError::Invalid(vec![self.wanted.starts.fault(index, "", detail)].into()))
    }

    /// The cells of a result.
    fn mask<const D: usize>(&self, scene: &Scene<D>, result: &Outline) -> CellsOutput {
        let grid = Grid { first: [0.0; 3], spacing: [1.0; 3], size: scene.size() };
        CellsOutput::new(&result.cells(&grid), self.grid.spacing(), D)
    }

    fn stage(&self, report: &StageReport) -> StageOutput {
        StageOutput {
            stage: report.stage,
            iterations: report.iterations,
            evaluations: report.evaluations,
            spacing: report.spacing,
            fault: report.fault.map(|fault| Outcome::from(fault).name()),
            history: match self.wanted.answered.history {
                true => report.history.iter().copied().filter_map(finite).collect(),
                false => Vec::new(),
            },
        }
    }

    /// Overlap of a shape with its label of the truth.
    fn overlap<const D: usize>(
        &self,
        index: usize,
        scene: &Scene<D>,
        result: &Outline,
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Result<Option<TruthOutput>, ServiceError> {
        let Some(truth) = &self.truth else { return Ok(None) };
        let label = self.wanted.truth_labels.as_ref().and_then(|labels| labels.get(index));
        let is_truth = |value: &u32| label.map_or(*value > 0, |label| value == label);
        let mut spacing = [1.0; 3];
        spacing[..D].copy_from_slice(&scene.frame().spacing());
        let in_cells = Grid { first: [0.0; 3], spacing: [1.0; 3], size: scene.size() };
        let grid = Grid { spacing, ..in_cells };
        let found = Mask { grid, ..result.cells(&in_cells) };
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

/// Refusal of an image or a setting.
fn faulty(error: SegmentationError) -> ServiceError {
    ServiceError::invalid("/image", error.to_string())
}

/// Refusal of an initial shape, or of an image without contrast in it.
fn faulty_start(error: SegmentationError, starts: &Starts, index: usize) -> ServiceError {
    match error {
        SegmentationError::NoVolume { .. } | SegmentationError::Flat => {
            ServiceError::Invalid(vec![starts.fault(index, "", error.to_string())].into())
        }
        SegmentationError::Scale { .. } => ServiceError::invalid("/terms", error.to_string()),
        SegmentationError::Method => ServiceError::invalid("/method", error.to_string()),
        SegmentationError::Stages { .. } => ServiceError::invalid("/stages", error.to_string()),
        _ => faulty(error),
    }
}

fn points<const D: usize>(rows: &[[f64; D]]) -> Points {
    let matrix = Matrix::from_fn(rows.len(), D, |k, c| rows[k][c]);
    Points::from_columns(matrix.as_slice().to_vec(), D)
}

/// Positions of the free points of a model among its `count` control points.
fn free_rows<const D: usize>(model: &dyn Model<D>, count: usize) -> Vec<usize> {
    let places: Vec<[f64; D]> = (0..count).map(|row| [row as f64; D]).collect();
    model.free_points(&places).into_iter().map(|place| place[0] as usize).collect()
}
