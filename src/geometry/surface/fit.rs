//! Least-squares fits of surfaces to points with parameters.
//!
//! ```text
//! min_c Σ_i w_i |σ_c(u_i, v_i) − p_i|²,   Σ w_i = 1
//! ```
//!
//! The normal equations of all rows at once. Points of a surface of the space, at their parameters, give back its rows.

use std::f64::consts::{PI, TAU};

use super::basis::SurfaceBasis;
use super::norm;
use crate::geometry::GeometryError;
use crate::numeric::dense::{Definite, Matrix};

/// A fitted surface.
#[derive(Debug, Clone)]
pub struct SurfaceFit {
    /// Its rows, `N × 3`.
    pub rows: Matrix,
    /// `√(Σ w_i |σ(u_i, v_i) − p_i|²)`.
    pub residual: f64,
    /// `max_i |σ(u_i, v_i) − p_i|`.
    pub largest: f64,
}

/// A point of a cloud with its parameters and its weight, not negative.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfaceSample {
    /// `u` and `v`.
    pub parameters: [f64; 2],
    /// Where the surface shall pass.
    pub point: [f64; 3],
    /// Its share of the sum.
    pub weight: f64,
}

/// A row that moves the points by less than this (squared, against its own size) is not determined by them.
const DETERMINED: f64 = 1e-9;

/// Fits a surface of `basis`. Cost `N³/3` for the equations and 256 products a point.
///
/// # Errors
/// [`GeometryError::Undetermined`] for points that are too few or leave gaps.
pub fn fit(basis: &SurfaceBasis, samples: &[SurfaceSample]) -> Result<SurfaceFit, GeometryError> {
    let size = basis.gram().size();
    let undetermined = GeometryError::Undetermined { points: samples.len(), needed: size };
    let total: f64 = samples.iter().map(|sample| sample.weight).sum();
    if samples.len() < size || !(total > 0.0) {
        return Err(undetermined);
    }
    let (mut normal, mut right) = (Matrix::zeros(size, size), Matrix::zeros(size, 3));
    let places: Vec<Vec<(usize, f64)>> = samples
        .iter()
        .map(|sample| merged(basis.weights(sample.parameters[0], sample.parameters[1])))
        .collect();
    for (sample, place) in samples.iter().zip(&places) {
        let share = sample.weight / total;
        for (position, &(i, a)) in place.iter().enumerate() {
            (0..3).for_each(|c| right[(i, c)] += share * a * sample.point[c]);
            // Rows ascend: this is the lower triangle.
            for &(j, b) in &place[position..] {
                normal[(j, i)] += share * a * b;
            }
        }
    }
    let factored = Definite::new(&normal).ok().filter(|normal| normal.independence() > DETERMINED);
    let rows = factored.ok_or(undetermined)?.solve(&right);
    let (mut squares, mut largest) = (0.0, 0.0_f64);
    for (sample, place) in samples.iter().zip(&places) {
        let apart = [0, 1, 2].map(|c| {
            let value: f64 = place.iter().map(|(i, a)| a * rows[(*i, c)]).sum();
            value - sample.point[c]
        });
        squares += sample.weight / total * norm(apart).powi(2);
        largest = largest.max(norm(apart));
    }
    Ok(SurfaceFit { rows, residual: squares.sqrt(), largest })
}

/// Every row once, ascending.
fn merged(mut weights: Vec<(usize, f64)>) -> Vec<(usize, f64)> {
    weights.sort_unstable_by_key(|(row, _)| *row);
    weights.dedup_by(|next, kept| {
        let same = next.0 == kept.0;
        if same {
            kept.1 += next.1;
        }
        same
    });
    weights
}

/// Parameters on a sphere in the direction of `point` from its centre: longitude `u ∈ [0, 1)` from the x axis towards y, and
/// colatitude `v ∈ [0, 1]` from the z axis.
pub fn spherical_parameters([x, y, z]: [f64; 3]) -> [f64; 2] {
    let u = y.atan2(x) / TAU;
    // What rounds up to a whole turn begins anew.
    let u = if u < 0.0 { (u + 1.0) % 1.0 } else { u };
    [u, x.hypot(y).atan2(z) / PI]
}
