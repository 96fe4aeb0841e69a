//! Parts of shapes: their control points, as aligned with the whole shape or on their own.

use super::error::BlocksError;
use crate::correspondence::{Correspondence, Direction, Mirror};
use crate::inference::aligned::{AlignedShapes, StudySpace};
use crate::matching::Matching;
use crate::metric::Metric;
use crate::watch::Watch;
use shapelex_geometry::representation::ShapeSpace;
use shapelex_numeric::dense::Matrix;
use shapelex_numeric::parallel;

/// Control points `points` of shapes, coordinate-major, one shape a column: aligned with the whole shape, or `apart` on their own, in the
/// discrete metric, from the start points of the whole shape.
///
/// # Errors
/// Parts without an extent; those of the alignment.
pub fn part_of(
    shapes: &AlignedShapes<'_>,
    points: &[usize],
    apart: bool,
    watch: &dyn Watch,
) -> Result<Matrix, BlocksError> {
    if !apart {
        return Ok(control_points(shapes, &shapes.aligned, points));
    }
    let dimension = shapes.space.metric.dimension();
    let own = control_points(shapes, &shapes.placed, points);
    let space = ShapeSpace::of_points(dimension, points.len())?;
    let metric = Metric::of(&space);
    let matching = Matching::new(&space, Correspondence::Landmarks, Direction::Given, Mirror::Forbid);
    let study = StudySpace { space: &space, metric: &metric, matching: &matching, ..shapes.space };
    let aligned = AlignedShapes::new(study, own.as_slice().to_vec(), shapes.weights.clone(), watch)?;
    let all: Vec<usize> = (0..points.len()).collect();
    Ok(control_points(&aligned, &aligned.aligned, &all))
}

/// Control points of whitened shapes.
fn control_points(shapes: &AlignedShapes<'_>, whitened: &Matrix, points: &[usize]) -> Matrix {
    let metric = shapes.space.metric;
    let (size, dimension) = (metric.size(), metric.dimension());
    let mut found = Matrix::zeros(dimension * points.len(), whitened.ncols());
    parallel::for_each_chunk(found.as_mut_slice(), dimension * points.len(), &|k, column| {
        let mut shape = whitened.column(k).as_slice().to_vec();
        metric.unwhiten(&mut shape);
        for (own, c) in column.chunks_exact_mut(points.len()).zip(0..) {
            own.iter_mut().zip(points).for_each(|(value, &k)| *value = shape[c * size + k]);
        }
    });
    found
}
