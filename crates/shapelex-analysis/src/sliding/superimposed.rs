//! Generalised Procrustes superimposition of shapes of unit size.

use crate::fit::{Fit, Scaling, transform};
use crate::metric::norm;
use crate::unit_size::unit;
use shapelex_numeric::dense::{Matrix, svd};
use shapelex_numeric::parallel;

/// The rotation of `shape` onto `onto`.
pub(super) fn rotation(shape: &[f64], onto: &[f64], dimension: usize) -> Matrix {
    Fit { dimension, rotates: true, scaling: Scaling::None }.matrix(shape, onto)
}

/// Sum of shapes in their order.
pub(super) fn sum(shapes: &[Vec<f64>]) -> Vec<f64> {
    let mut total = vec![0.0; shapes.first().map_or(0, Vec::len)];
    for shape in shapes {
        total.iter_mut().zip(shape).for_each(|(total, x)| *total += x);
    }
    total
}

/// Shapes rotated onto `onto`, and the rotations.
pub(super) fn rotated(shapes: &[Vec<f64>], onto: &[f64], dimension: usize) -> (Vec<Vec<f64>>, Vec<Matrix>) {
    parallel::map(shapes.len(), &|k| {
        let turn = rotation(&shapes[k], onto, dimension);
        (transform(&turn, &shapes[k]), turn)
    })
    .into_iter()
    .unzip()
}

/// Most rounds of a superimposition; it needs five to ten.
const ROUNDS: usize = 100;
/// Move of the consensus at which it ends.
const STILL: f64 = 1e-14;

/// Shapes of unit size rotated onto their common consensus, which has unit size.
#[derive(Debug)]
pub(super) struct Superimposed {
    pub(super) aligned: Vec<Vec<f64>>,
    pub(super) rotations: Vec<Matrix>,
    pub(super) consensus: Vec<f64>,
}

/// Superimposes shapes of unit size, beginning with `consensus`.
pub(super) fn superimpose(shapes: &[Vec<f64>], consensus: &[f64], dimension: usize) -> Superimposed {
    let mut consensus = consensus.to_vec();
    let (mut aligned, mut rotations) = rotated(shapes, &consensus, dimension);
    for _ in 0..ROUNDS {
        let mut next = sum(&aligned);
        let size = norm(&next);
        if size > 0.0 {
            next.iter_mut().for_each(|x| *x /= size);
        }
        let moved = distance(&next, &consensus);
        consensus = next;
        if moved < STILL {
            break;
        }
        (aligned, rotations) = rotated(shapes, &consensus, dimension);
    }
    Superimposed { aligned, rotations, consensus }
}

pub(super) fn distance(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

/// The rotation that turns principal axes of a shape to those of coordinates, the longest first, each by less than a right angle where that
/// is no reflection.
pub(super) fn principal_axes(shape: &[f64], dimension: usize) -> Matrix {
    let (centred, _) = unit(shape, dimension);
    let rows = Matrix::from_column_slice(shape.len() / dimension, dimension, &centred);
    let Some(mut axes) = svd(rows, false, true).and_then(|found| found.v_t) else {
        return Matrix::identity(dimension, dimension);
    };
    for k in 0..dimension {
        if axes[(k, k)] < 0.0 {
            axes.row_mut(k).neg_mut();
        }
    }
    if axes.determinant() < 0.0 {
        axes.row_mut(dimension - 1).neg_mut();
    }
    axes
}
