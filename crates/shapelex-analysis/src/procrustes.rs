//! Generalised Procrustes analysis, for comparison with projection; also gives the mean under pure translation.
//!
//! ```text
//! min_{μ, A_k} Σ_k w_k ‖A_k x_k − μ‖²,   A_k = s_k R_k,  R_kᵀR_k = I, det R_k = 1
//! ```
//!
//! With scaling, `‖μ‖ = 1` and `s_k = ⟨R_k x_k, μ⟩/‖x_k‖²` (the full Procrustes fit, so that in the plane and in the
//! discrete metric the mean is Kent's). With partial scaling, `s_k = 1/‖x_k‖`, without scaling, `s_k = 1`; then `μ` is the mean
//! of the fitted shapes.
//! Rotations come from the singular value decomposition of `H = Σ_n μ[n] x[n]ᵀ`, without reflection.

use super::AnalysisError;
use super::accumulate::{
    Accumulator, BLOCK, ShapeSource, Shapes, accumulate, accumulate_spread, map_shapes, read_numbers,
    smallest_eligible, write_numbers,
};
use super::fit::{Fit, Scaling, cross_product, nearest_rotation, transform};
use super::frame::{Frame, largest};
use super::metric::{Metric, norm};
use super::pass::Sum;
use shapelex_numeric::dense::{Matrix, symmetric_eigen};

/// The iteration stops when the mean moves by less than this part of its norm.
const CONVERGED: f64 = 1e-10;

/// Maximum number of iterations.
const MAX_ITERATIONS: usize = 1000;

/// `Σ w A_k x_k` and `Σ w`.
#[derive(Debug, Clone)]
pub(super) struct FittedSum<'a> {
    mean: &'a [f64],
    fit: Fit,
    sum: Vec<f64>,
    weight: f64,
}

impl<'a> FittedSum<'a> {
    /// The empty sum of shapes fitted to `mean`.
    pub(super) fn new(fit: Fit, mean: &'a [f64]) -> Self {
        Self { mean, fit, sum: vec![0.0; mean.len()], weight: 0.0 }
    }
}

impl Accumulator for FittedSum<'_> {
    fn unit(&self) -> usize {
        BLOCK
    }

    fn update(&mut self, shapes: Shapes<'_>) -> Result<(), AnalysisError> {
        for (_, x, weight) in shapes.iter() {
            let fitted = transform(&self.fit.matrix(x, self.mean), x);
            self.sum.iter_mut().zip(fitted).for_each(|(sum, value)| *sum += weight * value);
            self.weight += weight;
        }
        Ok(())
    }

    fn merge(&mut self, other: Self) {
        self.sum.iter_mut().zip(&other.sum).for_each(|(a, b)| *a += b);
        self.weight += other.weight;
    }

    fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        write_numbers(&mut bytes, &[self.weight]);
        write_numbers(&mut bytes, &self.sum);
        bytes
    }

    fn restore(&mut self, mut bytes: &[u8]) -> Result<(), AnalysisError> {
        let (weight, sum) = (read_numbers(&mut bytes)?, read_numbers(&mut bytes)?);
        if weight.len() != 1 || sum.len() != self.sum.len() {
            return Err(AnalysisError::NotAnAccumulator);
        }
        (self.weight, self.sum) = (weight[0], sum);
        Ok(())
    }
}

/// The sum of the shapes fitted to `mean`.
pub(super) fn fitted_sum<'a>(
    source: &dyn ShapeSource,
    fit: Fit,
    mean: &'a [f64],
) -> Result<FittedSum<'a>, AnalysisError> {
    let empty = || FittedSum::new(fit, mean);
    let here = || accumulate(source, empty);
    accumulate_spread(source, Sum::Fits { fit, mean: mean.to_vec() }, empty, here)
}

/// Mean shape of a Procrustes iteration.
#[derive(Debug, Clone)]
pub struct ProcrustesMean {
    /// Whitened mean shape.
    pub mean: Vec<f64>,
    /// Number of iterations.
    pub iterations: usize,
    /// Whether the last iteration moved the mean by less than `10⁻¹⁰` of its norm.
    pub converged: bool,
}

/// The generalised Procrustes mean, iterated from `start` (whitened).
///
/// Cost per iteration: one `d × d` singular value decomposition per shape.
///
/// # Errors
/// Errors of the source.
pub fn iterate(source: &dyn ShapeSource, fit: Fit, start: Vec<f64>) -> Result<ProcrustesMean, AnalysisError> {
    let mut mean = start;
    for iterations in 1..=MAX_ITERATIONS {
        let next = step(source, fit, &mean)?;
        let moved = next.iter().zip(&mean).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
        let converged = moved <= CONVERGED * norm(&next);
        mean = next;
        if converged || (!fit.rotates && fit.scaling == Scaling::None) {
            return Ok(ProcrustesMean { mean, iterations, converged: true });
        }
    }
    Ok(ProcrustesMean { mean, iterations: MAX_ITERATIONS, converged: false })
}

/// The mean of the shapes fitted to `mean`: one iteration.
pub(super) fn step(source: &dyn ShapeSource, fit: Fit, mean: &[f64]) -> Result<Vec<f64>, AnalysisError> {
    let total = fitted_sum(source, fit, mean)?;
    let divisor = if fit.scaling == Scaling::Full { norm(&total.sum) } else { total.weight };
    Ok(total.sum.iter().map(|value| value / divisor).collect())
}

/// A start shape that does not depend on the order, position, orientation or size of the shapes: the shape whose
/// profile `|x[n]|/‖x‖` is nearest to the mean profile. In a tie, the shape with the smaller coordinates.
///
/// # Errors
/// Errors of the source.
pub fn start(source: &dyn ShapeSource, fit: Fit) -> Result<Vec<f64>, AnalysisError> {
    let profiles = map_shapes(source, |_, x, weight| Ok((profile(x, fit.dimension), weight)))?;
    let n = profiles.first().map_or(0, |(p, _)| p.len());
    let mut mean = vec![0.0; n];
    let total: f64 = profiles.iter().map(|(_, weight)| weight).sum();
    for (profile, weight) in &profiles {
        mean.iter_mut().zip(profile).for_each(|(sum, value)| *sum += weight * value / total);
    }
    let distance = |p: &[f64]| p.iter().zip(&mean).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
    let distances: Vec<f64> = profiles.iter().map(|(p, _)| distance(p)).collect();
    let smallest = distances.iter().copied().fold(f64::MAX, f64::min);
    let (_, chosen) = smallest_eligible(source, |k| distances[k] <= smallest * (1.0 + 1e-12))?;
    let scale = if fit.scaling == Scaling::None { 1.0 } else { norm(&chosen).recip() };
    Ok(chosen.iter().map(|value| scale * value).collect())
}

fn profile(x: &[f64], d: usize) -> Vec<f64> {
    let n = x.len() / d;
    let size = norm(x);
    (0..n).map(|k| (0..d).map(|c| x[c * n + k].powi(2)).sum::<f64>().sqrt() / size).collect()
}

/// Rotates the mean into `frame`.
///
/// Training: the rotation that brings the mean closest to the shapes as posed. Canonical: principal axes of inertia on
/// the coordinate axes, longest first, with a positive largest control coordinate on every axis but the last, and
/// without reflection.
///
/// # Errors
/// Errors of the source.
pub fn turn(
    mean: Vec<f64>,
    fit: Fit,
    frame: Frame,
    metric: &Metric,
    source: &dyn ShapeSource,
) -> Result<Vec<f64>, AnalysisError> {
    if !fit.rotates {
        return Ok(mean);
    }
    match frame {
        Frame::Canonical => Ok(principal_frame(&mean, fit.dimension, metric)),
        Frame::Training => {
            let posed = Fit { rotates: false, scaling: Scaling::None, ..fit };
            let total = fitted_sum(source, posed, &mean)?;
            Ok(transform(&nearest_rotation(&cross_product(&total.sum, &mean, fit.dimension)), &mean))
        }
    }
}

fn principal_frame(mean: &[f64], d: usize, metric: &Metric) -> Vec<f64> {
    let inertia = symmetric_eigen(&cross_product(mean, mean, d));
    let mut order: Vec<usize> = (0..d).collect();
    order.sort_by(|&i, &j| inertia.eigenvalues[j].total_cmp(&inertia.eigenvalues[i]));
    let mut axes = Matrix::from_fn(d, d, |i, j| inertia.eigenvectors[(j, order[i])]);
    let mut control_points = transform(&axes, mean);
    metric.unwhiten(&mut control_points);
    for (c, coordinate) in control_points.chunks_exact(metric.size()).enumerate().take(d - 1) {
        if largest(coordinate) < 0.0 {
            axes.row_mut(c).neg_mut();
        }
    }
    if axes.determinant() < 0.0 {
        axes.row_mut(d - 1).neg_mut();
    }
    transform(&axes, mean)
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;
    use crate::accumulate::{ShapesInMemory, Watched};
    use crate::watch::{StopWhen, Unwatched};

    #[test]
    fn an_abandoned_iteration_ends_with_its_walk_over_the_shapes() {
        // Points that no rotation brings together need many iterations.
        let shape = |k: usize| (0..60).map(move |i| ((7 * k * k + 3 * i * i + i * k) as f64).sin());
        let whitened: Vec<f64> = (0..40).flat_map(shape).collect();
        let source = ShapesInMemory::prepared(whitened.clone(), vec![1.0; 40]);
        let fit = Fit { dimension: 3, rotates: true, scaling: Scaling::Full };
        let whole = iterate(&source, fit, whitened[..60].to_vec()).unwrap();
        assert!(whole.iterations > 5, "{}", whole.iterations);
        let walks = AtomicUsize::new(0);
        let stop = || walks.fetch_add(1, Ordering::Relaxed) >= 3;
        let ended = iterate(&Watched::new(&source, &StopWhen(&stop)), fit, whitened[..60].to_vec());
        assert!(matches!(ended, Err(AnalysisError::Interrupted)), "{ended:?}");
        assert_eq!(walks.load(Ordering::Relaxed), 4, "three walks, and the one that was not begun");
        let watched = iterate(&Watched::new(&source, &Unwatched), fit, whitened[..60].to_vec()).unwrap();
        assert_eq!((watched.mean, watched.iterations), (whole.mean, whole.iterations));
    }
}
