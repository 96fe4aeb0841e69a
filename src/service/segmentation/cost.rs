//! Predicted work and memory of segmentations. The constants are fitted to the rows of `benches/load/costs.py`.
//!
//! ```text
//! seconds = cells · (READ + Σ fields) + Σ objects, stages: evaluations · samples · terms · SAMPLE
//! ```

use std::f64::consts::PI;

use serde::Serialize;

use super::request::{Minimiser, SigmaInput, StageInput, TermInput};
use super::sheets;
use super::wanted::Wanted;
use crate::geometry::capability::domain::Admitted;
use crate::service::app::Work;
use crate::service::app::progress::Part;
use crate::wire::image::Grid;

/// Predicted bytes per cell beside the file: the image, and fields while they are prepared.
const CELL_BYTES: usize = 52;
/// Bytes per cell of the prepared field of a term at one blur.
const FIELD_BYTES: usize = 8;

/// Bytes of the runs of the cells of a result, for each cell of the length of its boundary, or of the area.
const RUN_BYTES: f64 = 16.0;
/// Bytes per cell of the first result that covers it, where there are several.
const OWNER_BYTES: usize = 4;
/// Bytes of an outline for each cell of the length of a curve, or of the area of a surface.
const OUTLINE_BYTES: [f64; 2] = [32.0, 200.0];

/// Predicted seconds per cell to read an image.
const READ: f64 = 1.2e-8;
/// Predicted seconds per cell and axis to prepare the contour term at a blur, and per cell of the blur.
const CONTOUR: [f64; 2] = [3e-8, 6e-9];
/// The same of a term that integrates the blurred image.
const REGION: [f64; 2] = [9e-9, 1.5e-9];
/// Predicted seconds per cell to integrate the image up to a level that comes with the initial shape.
const LEVEL: f64 = 1e-8;

/// Predicted seconds per sample of a curve and term for one evaluation; of a spline surface; of a mesh, by its vertices.
const SAMPLE: [f64; 3] = [1e-7, 2.8e-7, 1.5e-7];
/// Samples per cell of the length of a curve, and least number for each control point.
const PER_CELL: f64 = 1.6;
const PER_POINT: f64 = 8.0;
/// Least number of samples of a surface for each control point.
const PER_POINT_IN_SPACE: f64 = 25.0;
/// Samples for each control point where integrals are to be exact: of a curve, and of a surface.
const FINE: [f64; 2] = [64.0, 600.0];
/// Factor by which boundaries grow from their boxes: initial shapes are smaller than objects.
const GROWTH: f64 = 1.3;

/// Usual evaluations of a stage until it ends, with a region term; with the contour term of a curve, of which each point needs some
/// more, and of a surface.
const REGION_EVALUATIONS: f64 = 28.0;
const CONTOUR_EVALUATIONS: [f64; 2] = [45.0, 95.0];
const EVALUATIONS_OF_POINT: f64 = 0.4;
/// Evaluations of the energy in an iteration of methods that move all points at once.
const EVALUATIONS: f64 = 1.1;
/// Evaluations for each point in a sweep from point to point.
const EVALUATIONS_PER_POINT: f64 = 1.4;

/// Most splits of a control mesh, more than any limit of vertices admits.
const MAX_LEVEL: usize = 15;

/// Predicted cost of a segmentation.
#[derive(Debug, Clone, Copy, Serialize, utoipa::ToSchema)]
pub struct SegmentEstimate {
    /// Number of objects.
    pub(super) objects: usize,
    /// Peak memory in bytes, beside the request and the answer.
    pub(super) memory_bytes: usize,
    /// Seconds of processor time, to a factor of two for usual images on the machine where the constants were measured. Objects
    /// are segmented in parallel.
    pub(super) seconds: f64,
}

impl SegmentEstimate {
    /// Peak memory in bytes.
    pub fn memory_bytes(&self) -> usize {
        self.memory_bytes
    }
}

/// Predicted bytes of an image of which the `files` take so many when they are read, and of its fields.
pub(super) fn memory(wanted: &Wanted, grid: &Grid, stages: &[StageInput], files: usize) -> usize {
    let fields = wanted.energy.image_terms().len() * blurs(stages).len();
    let outlines = if wanted.answered.outlines { Cost::new(wanted, grid).outlines() } else { 0 };
    let several = if wanted.starts.count() > 1 {
        Cost::new(wanted, grid).runs().saturating_add(OWNER_BYTES.saturating_mul(grid.cells()))
    } else {
        0
    };
    let detected = wanted.different_detectors().len();
    let detector = if detected > 0 { sheets::CELL_BYTES } else { 0 };
    let cells = grid.cells().saturating_mul(CELL_BYTES + detector + FIELD_BYTES * (fields + detected));
    cells.saturating_add(files).saturating_add(outlines).saturating_add(several)
}

/// Predicted work.
pub(super) fn work(wanted: &Wanted, grid: &Grid, stages: &[StageInput]) -> Work {
    let [fields, runs] = parts(wanted, grid, stages).map(|part| Work::from_seconds(part.work));
    fields + runs
}

/// Predicted seconds to read an image and to prepare its fields; and of all minimisations, with the usual number of evaluations in
/// them.
pub(super) fn parts(wanted: &Wanted, grid: &Grid, stages: &[StageInput]) -> [Part; 2] {
    let (cost, terms) = (Cost::new(wanted, grid), wanted.energy.terms.len() as f64);
    let objects = wanted.starts.count();
    let detected: f64 = wanted.different_detectors().iter().map(|detector| detector.seconds(grid)).sum();
    let fields = grid.cells() as f64 * (READ + cost.fields(stages)) + detected;
    let levels = grid.cells() as f64 * cost.levels(stages) * objects as f64;
    let (mut runs, mut products, mut evaluations) = (0.0, 0.0, 0.0);
    for index in 0..objects {
        products += cost.factorisations(index, stages) + cost.spans(index, stages);
        for stage in staged(stages) {
            let passes = 1.0 + cost.evaluations(index, &stage);
            evaluations += passes;
            runs += passes * cost.samples(index, &stage) * terms;
        }
    }
    let products = Work::from_multiply_adds(products);
    [Part { work: fields, count: 1.0 }, Part { work: runs + levels + products.seconds(), count: evaluations }]
}

/// Predicted work to sample the boundaries of shapes once, as finely as integrals over them need.
pub fn boundaries(representation: &Admitted, shapes: usize) -> Work {
    let (points, vertices) = (representation.size() as f64, representation.refined_vertices() as f64);
    let one = match representation.dimension() {
        2 => SAMPLE[0] * FINE[0] * points,
        _ if vertices > 0.0 => SAMPLE[2] * vertices,
        _ => SAMPLE[1] * FINE[1] * points,
    };
    Work::from_seconds(shapes as f64 * one)
}

/// A stage with the number of splits before it.
#[derive(Clone, Copy)]
struct Staged<'a> {
    stage: &'a StageInput,
    splits: i32,
}

/// Stages with the splits before them, of which more than [`MAX_LEVEL`] are refused elsewhere.
fn staged(stages: &[StageInput]) -> impl Iterator<Item = Staged<'_>> {
    stages.iter().scan(0, |splits: &mut i32, stage| {
        *splits += stage.splits.min(MAX_LEVEL) as i32;
        Some(Staged { stage, splits: *splits })
    })
}

/// The different blurs of stages.
fn blurs(stages: &[StageInput]) -> Vec<SigmaInput> {
    let mut blurs = Vec::new();
    for stage in stages {
        if !blurs.contains(&stage.sigma) {
            blurs.push(stage.sigma);
        }
    }
    blurs
}

struct Cost<'a> {
    wanted: &'a Wanted,
    grid: &'a Grid,
    /// Side of a cell.
    cell: f64,
    axes: usize,
}

impl<'a> Cost<'a> {
    fn new(wanted: &'a Wanted, grid: &'a Grid) -> Self {
        Self { wanted, grid, cell: wanted.cell(grid), axes: if grid.is_planar() { 2 } else { 3 } }
    }

    /// Bytes of the outlines of all initial shapes and results.
    fn outlines(&self) -> usize {
        let boundaries: f64 = (0..self.wanted.starts.count()).map(|index| self.boundary(index)).sum();
        (2.0 * OUTLINE_BYTES[self.axes - 2] * boundaries) as usize
    }

    /// Bytes of the cells of all results.
    fn runs(&self) -> usize {
        let boundaries: f64 = (0..self.wanted.starts.count()).map(|index| self.boundary(index)).sum();
        (RUN_BYTES * boundaries) as usize
    }

    /// Length in cells of the boundary of an object, or its area.
    fn boundary(&self, index: usize) -> f64 {
        let [x, y, z] = self.extent(index);
        match self.axes {
            2 => PI * GROWTH * 0.5 * (x + y),
            _ => PI * GROWTH * GROWTH * (x * y + y * z + z * x) / 3.0,
        }
    }

    /// Control points of an object in a stage: a split makes less than four of one.
    fn points(&self, index: usize, stage: &Staged) -> f64 {
        self.wanted.kinds.of(index).representation.size() as f64 * 4.0_f64.powi(stage.splits)
    }

    fn is_by_contours(&self) -> bool {
        self.wanted.energy.terms.iter().any(|term| matches!(term, TermInput::Contour { .. }))
    }

    /// Seconds per cell for the fields of all terms and blurs.
    fn fields(&self, stages: &[StageInput]) -> f64 {
        let sides = self.wanted.sides(self.grid);
        let of_term = |term: &TermInput, blur: SigmaInput| -> f64 {
            let [fixed, per_cell] = match term {
                TermInput::Contour { .. } => CONTOUR,
                TermInput::Boundary { .. } | TermInput::Start { .. } | TermInput::Spacing { .. } => [0.0; 2],
                _ => REGION,
            };
            blur.in_cells(&sides).map(|cells| fixed + per_cell * cells).sum()
        };
        let terms = &self.wanted.energy.terms;
        blurs(stages).iter().map(|blur| terms.iter().map(|term| of_term(term, *blur)).sum::<f64>()).sum()
    }

    /// Seconds per cell and object for levels that come with the initial shape: in every stage, at its start and its end.
    fn levels(&self, stages: &[StageInput]) -> f64 {
        let is_open = |term: &TermInput| matches!(term, TermInput::Threshold { level: None, .. });
        let terms = self.wanted.energy.terms.iter().filter(|term| is_open(term)).count();
        LEVEL * (terms * (stages.len() + 2)) as f64
    }

    /// Seconds to sample the boundary of an object once for a term.
    fn samples(&self, index: usize, stage: &Staged) -> f64 {
        let vertices = self.wanted.kinds.of(index).representation.refined_vertices() as f64;
        let (boundary, points) = (self.boundary(index), self.points(index, stage));
        match self.axes {
            2 => SAMPLE[0] * (PER_CELL * boundary).max(PER_POINT * points),
            _ if vertices > 0.0 => SAMPLE[2] * vertices,
            _ => {
                let sides = self.wanted.sides(self.grid);
                let blur = stage.stage.sigma.in_cells(&sides).fold(f64::INFINITY, f64::min).max(1.0);
                SAMPLE[1] * (boundary / (blur * blur)).max(PER_POINT_IN_SPACE * points)
            }
        }
    }

    /// Cells of the sides of the box around an initial shape, at most those of the image.
    fn extent(&self, index: usize) -> [f64; 3] {
        let usual = super::starts::usual_radius(self.grid, self.wanted.coordinates, self.cell);
        let sides = self.wanted.starts.extent(index, usual);
        let size = self.grid.size();
        std::array::from_fn(|axis| {
            let side = sides.get(axis).copied().unwrap_or(0.0) / self.cell;
            side.clamp(0.0, size[axis] as f64)
        })
    }

    /// Iterations of a stage until it ends, as far as they are allowed.
    fn iterations(&self, index: usize, stage: &Staged) -> f64 {
        let usual = match (self.is_by_contours(), self.axes) {
            (false, _) => REGION_EVALUATIONS,
            (true, 2) => CONTOUR_EVALUATIONS[0] + EVALUATIONS_OF_POINT * self.points(index, stage),
            (true, _) => CONTOUR_EVALUATIONS[1],
        };
        (usual / EVALUATIONS).min(stage.stage.iterations as f64)
    }

    fn evaluations(&self, index: usize, stage: &Staged) -> f64 {
        let iterations = self.iterations(index, stage);
        match self.wanted.energy.method {
            Minimiser::Lbfgs => EVALUATIONS * iterations,
            // In noise Newton's steps do not become small: the limit ends them.
            Minimiser::Newton => EVALUATIONS * stage.stage.iterations as f64,
            Minimiser::Coordinates => (1.0 + EVALUATIONS_PER_POINT * self.points(index, stage)) * iterations,
        }
    }

    /// Multiply-adds for an object to project onto the span of several shapes.
    fn spans(&self, index: usize, stages: &[StageInput]) -> f64 {
        let Some((reference, _)) = &self.wanted.prior else { return 0.0 };
        let length = (self.wanted.kinds.of(index).representation.size() * self.axes) as f64;
        // A class has at most as many matrices as a matrix has entries.
        let basis = |shapes: &[Vec<f64>]| ((shapes.len() * self.axes * self.axes) as f64).min(length);
        let evaluations: f64 = staged(stages).map(|stage| 1.0 + self.evaluations(index, &stage)).sum();
        2.0 * evaluations * length * reference.spans().map(basis).sum::<f64>()
    }

    /// Multiply-adds of Newton's method for an object.
    fn factorisations(&self, index: usize, stages: &[StageInput]) -> f64 {
        match self.wanted.energy.method {
            Minimiser::Lbfgs | Minimiser::Coordinates => 0.0,
            Minimiser::Newton => {
                let points = self.wanted.kinds.of(index).representation.size() as f64;
                let iterations: f64 = stages.iter().map(|stage| stage.iterations as f64).sum();
                iterations * (2.0 * points).powi(3) / 3.0
            }
        }
    }
}
