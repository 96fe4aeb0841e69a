//! Predicted work and memory of segmentations.

use super::request::{Minimiser, StageInput};
use super::wanted::Wanted;
use crate::formats::image::Grid;
use crate::service::app::Work;

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

/// Predicted bytes of an image of which the `files` take so many when they are read, and of its fields.
pub(super) fn memory(grid: &Grid, files: usize, terms: usize, stages: usize) -> usize {
    grid.cells().saturating_mul(CELL_BYTES + FIELD_BYTES * terms * stages).saturating_add(files)
}

/// Predicted work: the fields of all terms and blurs, then the iterations, for shapes half as large as the image.
pub(super) fn work(wanted: &Wanted, grid: &Grid, stages: &[StageInput]) -> Work {
    let [x, y, z] = grid.size().map(|count| count as f64);
    let (planar, cell) = (grid.is_planar(), wanted.cell(grid));
    let terms = wanted.energy.terms.len() as f64;
    let axes = if planar { 2.0 } else { 3.0 };
    let field = |stage: &StageInput| CELL + axes * TAP * (1.0 + 8.0 * stage.sigma / cell);
    let fields: f64 = stages.iter().map(field).sum();
    let representation = &wanted.settings.representation;
    let (points, vertices) = (representation.size() as f64, representation.refined_vertices() as f64);
    let samples = |stage: &StageInput| {
        let blur = (stage.sigma / cell).max(1.0);
        let boundary = if planar { x + y } else { (x * y + y * z + z * x) / (blur * blur) };
        boundary.max(SAMPLES_PER_POINT * points).max(vertices)
    };
    let (evaluations, factorisation) = match wanted.energy.method {
        Minimiser::Lbfgs => (EVALUATIONS, 0.0),
        Minimiser::Newton => (EVALUATIONS, (2.0 * points).powi(3) / 3.0),
        Minimiser::Coordinates => (1.0 + EVALUATIONS_PER_POINT * points, 0.0),
    };
    let iterations: f64 = stages.iter().map(|stage| stage.iterations as f64).sum();
    let runs = stages.iter().map(|stage| (1.0 + evaluations * stage.iterations as f64) * samples(stage));
    let objects = wanted.starts.count() as f64;
    Work::from_seconds(grid.cells() as f64 * terms * fields + runs.sum::<f64>() * objects * terms * SAMPLE)
        + Work::from_multiply_adds(objects * iterations * factorisation)
}
