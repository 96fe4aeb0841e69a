//! Directions in which points slide, and the displacements that a criterion asks for.

use super::error::SlidingError;
use super::table::Sliders;
use crate::thin_plate::ThinPlate;
use crate::thin_plate::error::COINCIDENT;
use shapelex_numeric::dense::{Definite, Matrix, multiply, svd};

/// Criterion that sliding minimises.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
pub enum SlidingCriterion {
    /// Bending energy of the thin-plate spline from the consensus.
    #[default]
    BendingEnergy,
    /// Squared distance from the consensus.
    Procrustes,
}

/// A direction in which one point slides.
#[derive(Debug, Clone, Copy)]
pub(super) struct Direction {
    pub(super) point: usize,
    /// Unit vector; zero beyond the dimension.
    pub(super) along: [f64; 3],
}

/// Points whose four nearest, with themselves, give the tangent plane of a surface.
const NEAREST: usize = 5;
/// Smallest pivot of the system of displacements, as a part of its diagonal, at which they are determined.
const DETERMINED: f64 = 1e-11;

/// Point `k` of a coordinate-major shape.
pub(super) fn point(shape: &[f64], dimension: usize, k: usize) -> [f64; 3] {
    let size = shape.len() / dimension;
    let mut found = [0.0; 3];
    (0..dimension).for_each(|c| found[c] = shape[c * size + k]);
    found
}

pub(super) fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub(super) fn difference(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|c| a[c] - b[c])
}

/// Directions of the curve sliders of a shape: from the point before to the point after.
pub(super) fn of_curves(shape: &[f64], dimension: usize, sliders: &Sliders) -> Result<Vec<Direction>, usize> {
    let direction = |&[before, slide, after]: &[usize; 3]| {
        let along = difference(point(shape, dimension, after), point(shape, dimension, before));
        let length = dot(along, along).sqrt();
        if length > 0.0 {
            Ok(Direction { point: slide, along: along.map(|x| x / length) })
        } else {
            Err(slide)
        }
    };
    sliders.curves.iter().map(direction).collect()
}

/// Both directions of a surface slider: the first two principal axes of the point and its four nearest among all points.
pub(super) fn of_surface(shape: &[f64], slider: usize) -> Result<[[f64; 3]; 2], usize> {
    let size = shape.len() / 3;
    let own = point(shape, 3, slider);
    let mut near: Vec<(f64, usize)> = (0..size)
        .map(|k| {
            let apart = difference(point(shape, 3, k), own);
            (dot(apart, apart), k)
        })
        .collect();
    near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    near.truncate(NEAREST);
    let mut rows = Matrix::from_fn(near.len(), 3, |i, c| point(shape, 3, near[i].1)[c]);
    for mut column in rows.column_iter_mut() {
        let mean = column.mean();
        column.add_scalar_mut(-mean);
    }
    let found = svd(rows, false, true).ok_or(slider)?;
    let axes = found.v_t.ok_or(slider)?;
    // Points on one line have no plane.
    if axes.nrows() < 2 || !(found.singular_values[1] > COINCIDENT * found.singular_values[0]) {
        return Err(slider);
    }
    Ok([0, 1].map(|k| [axes[(k, 0)], axes[(k, 1)], axes[(k, 2)]]))
}

/// Bending energy matrix of points some of which may be at one place: those share it.
///
/// # Errors
/// Two sliders at one place; flat points.
pub(super) fn bending(
    consensus: &[f64],
    dimension: usize,
    sliders: &Sliders,
) -> Result<Matrix, SlidingError> {
    let size = consensus.len() / dimension;
    let points = Matrix::from_column_slice(size, dimension, consensus);
    let squares = |i: usize, j: usize| (points.row(i) - points.row(j)).norm_squared();
    let mut kept: Vec<usize> = Vec::new();
    let mut twin_of = vec![0; size];
    for (k, twin) in twin_of.iter_mut().enumerate() {
        // The consensus has unit size.
        *twin = kept.iter().position(|&one| squares(one, k) < COINCIDENT * COINCIDENT).unwrap_or_else(|| {
            kept.push(k);
            kept.len() - 1
        });
    }
    let mut slides = vec![None; kept.len()];
    for slider in sliders.curves.iter().map(|row| row[1]).chain(sliders.surface.iter().copied()) {
        if let Some(first) = slides[twin_of[slider]].replace(slider) {
            return Err(SlidingError::OnePlace { first, second: slider });
        }
    }
    let plate = ThinPlate::new(&points.select_rows(&kept), 0.0).map_err(SlidingError::Consensus)?;
    let matrix = plate.bending_matrix();
    let mut count = vec![0.0; kept.len()];
    twin_of.iter().for_each(|&twin| count[twin] += 1.0);
    Ok(Matrix::from_fn(size, size, |i, j| {
        let (i, j) = (twin_of[i], twin_of[j]);
        matrix[(i, j)] / (count[i] * count[j])
    }))
}

/// Displacements that the criterion asks for, one per direction: the shape moves by minus these.
///
/// ```text
/// t = (UᵀBU)⁻¹ UᵀB y   with the bending energy matrix B;   t = Uᵀ(y − target)   for distances
/// ```
///
/// Cost: `m³/3` for `m` directions, and `p²`. `None` if the system does not determine them.
pub(super) fn displacements(
    shape: &[f64],
    target: &[f64],
    directions: &[Direction],
    (dimension, bending): (usize, Option<&Matrix>),
) -> Option<Vec<f64>> {
    let along =
        |of: &[f64], direction: &Direction| dot(point(of, dimension, direction.point), direction.along);
    let Some(bending) = bending else {
        return Some(directions.iter().map(|one| along(shape, one) - along(target, one)).collect());
    };
    let size = shape.len() / dimension;
    let bent = multiply(bending, &Matrix::from_column_slice(size, dimension, shape));
    let right: Vec<f64> = directions.iter().map(|one| along(bent.as_slice(), one)).collect();
    let system = Matrix::from_fn(directions.len(), directions.len(), |i, j| {
        let (a, b) = (&directions[i], &directions[j]);
        bending[(a.point, b.point)] * dot(a.along, b.along)
    });
    let factor = Definite::new(&system).ok().filter(|factor| factor.independence() > DETERMINED)?;
    Some(factor.solve(&Matrix::from_vec(directions.len(), 1, right)).as_slice().to_vec())
}

/// `y − U t`.
pub(super) fn displaced(shape: &[f64], directions: &[Direction], by: &[f64], dimension: usize) -> Vec<f64> {
    let size = shape.len() / dimension;
    let mut moved = shape.to_vec();
    for (direction, by) in directions.iter().zip(by) {
        (0..dimension).for_each(|c| moved[c * size + direction.point] -= by * direction.along[c]);
    }
    moved
}
