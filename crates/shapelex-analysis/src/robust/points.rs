//! Where along a shape it is wrong: a weight for each of its control points.
//!
//! ```text
//! c_k ≈ c̄ + Σ_i t_i ξ_i + Σ_j b_j B_j c̄ + e       minimise Σ_n v_n |r_n|² + 10 s² Σ_i t_i²/λ_i
//! r_n  what is left at control point n,   s_n  its median over the shapes,   v_n = 1/(1 + (r_n/(3 s_n))⁴)
//! r_n² is averaged over the neighbours on a curve:  Σ_j (h + 1 − |j|) r_{n+j}² / Σ_j (h + 1 − |j|),   |j| ≤ h,   h = N/32, rounded, or 1
//! ```
//!
//! Damage is a stretch, so that neighbours on a curve tell of each other; what is left by chance is not. Landmarks and
//! surfaces have no neighbours here.
//!
//! The components `ξ_i` and their variances `λ_i` are those of the robust estimate. Members of the class may move as well, since
//! damage in one place turns and shifts the alignment of the whole shape. Residuals and weights alternate, so that a damaged stretch
//! does not pull the fit of the rest.

use rayon::prelude::*;

use super::rejection::{effective, median};
use crate::AnalysisError;
use crate::accumulate::ShapesInMemory;
use crate::alignment::{Method, unwhitened};
use crate::metric::{Metric, dot};
use crate::partial_sums::Measured;
use crate::pca::FunctionalPca;
use shapelex_numeric::dense::Matrix;

/// Maximum number of components of the model.
const COMPONENTS: usize = 12;

/// Number of shapes for each component.
const SHAPES_PER_COMPONENT: f64 = 8.0;

/// Fraction of the variance that the model explains.
const SHARE: f64 = 0.98;

/// Alternations of residuals and weights; the weights of later ones hardly change.
const ROUNDS: usize = 5;

/// Multiple of the median residual at which a weight is one half.
const HALF: f64 = 3.0;

/// Least scale of a point, as a fraction of the median over all points, and as one of the size of the mean (rounding).
const LEAST_SCALE: f64 = 0.25;
const ROUNDING: f64 = 1e-10;

/// Residuals of about so many neighbouring points go together, and count as one against the variances of the components.
const TOGETHER: f64 = 10.0;

/// Number of control points for each neighbour that a point is averaged with on one side.
const POINTS_PER_REACH: usize = 32;

/// Ridge of the directions of the class, as a fraction of the mean diagonal: they may depend on each other.
const RIDGE: f64 = 1e-9;

/// Weights of the control points of aligned shapes, `N` numbers between zero and one for each. `aligned`: whitened, one after the
/// other; `weights`: the weights `w_k f_k` of the shapes in the robust estimate.
///
/// Cost per shape: five least-squares problems of `dN` equations with up to `12 + d² + d` unknowns.
///
/// # Errors
/// A failure of the eigenproblem.
pub fn point_weights(
    measured: Measured<'_>,
    aligned: &[f64],
    weights: &[f64],
) -> Result<Vec<Vec<f64>>, AnalysisError> {
    let Measured { metric, method, matching } = measured;
    let length = metric.len();
    let source = ShapesInMemory::prepared(aligned.to_vec(), weights.to_vec());
    let Some(first) = aligned.chunks_exact(length).zip(weights).find(|(_, w)| **w > 0.0) else {
        return Ok(Vec::new());
    };
    let model = Model::new(&source, metric, method, first.0, weights)?;
    let mut control_points = aligned.to_vec();
    metric.unwhiten(&mut control_points);
    control_points
        .par_chunks_exact_mut(length)
        .for_each(|shape| shape.iter_mut().zip(&model.mean).for_each(|(c, m)| *c -= m));
    let n = metric.size();
    let mut points: Vec<Vec<f64>> = vec![vec![1.0; n]; weights.len()];
    let mut noise = 0.0;
    for _ in 0..ROUNDS {
        let shapes = control_points.par_chunks_exact(length).zip(&points);
        let residuals = shapes.map(|(away, v)| {
            let residuals = model.residuals(away, v, noise);
            matching.curve().map_or_else(|| residuals.clone(), |closed| averaged(&residuals, closed))
        });
        let residuals: Vec<Vec<f64>> = residuals.collect();
        let scales = scales(&residuals, weights, n, model.size);
        noise = TOGETHER * scales.iter().map(|s| s * s).sum::<f64>() / n as f64;
        points.par_iter_mut().zip(&residuals).for_each(|(points, residuals)| {
            for ((v, r), s) in points.iter_mut().zip(residuals).zip(&scales) {
                *v = 1.0 / (1.0 + (r / (HALF * s)).powi(4));
            }
        });
    }
    Ok(points)
}

/// The residuals of neighbours on a curve together: roots of the weighted means of their squares, at the ends of an open one of
/// those that are there.
fn averaged(residuals: &[f64], closed: bool) -> Vec<f64> {
    let n = residuals.len();
    let reach = ((n + POINTS_PER_REACH / 2) / POINTS_PER_REACH).max(1) as isize;
    let square = |at: usize| {
        let neighbours = (-reach..=reach).filter_map(|j| {
            let there = at as isize + j;
            let inside = (0..n as isize).contains(&there);
            let there = there.rem_euclid(n as isize) as usize;
            (closed || inside).then(|| (residuals[there], (reach + 1 - j.abs()) as f64))
        });
        let (sum, weight) = neighbours.fold((0.0, 0.0), |(sum, total), (r, w)| (sum + w * r * r, total + w));
        sum / weight
    };
    (0..n).map(|at| square(at).sqrt()).collect()
}

/// `s_n`: weighted median over the shapes of the residuals at every point.
fn scales(residuals: &[Vec<f64>], weights: &[f64], n: usize, size: f64) -> Vec<f64> {
    let at = |point: usize| {
        let values: Vec<f64> = residuals.iter().map(|r| r[point]).collect();
        median(&values, weights)
    };
    let scales: Vec<f64> = (0..n).into_par_iter().map(at).collect();
    let least = (LEAST_SCALE * median(&scales, &vec![1.0; n])).max(ROUNDING * size);
    scales.into_iter().map(|scale| scale.max(least)).collect()
}

/// Mean and directions of the robust estimate, as control points.
struct Model {
    mean: Vec<f64>,
    /// `dN × p`: components, then the directions of the class.
    directions: Matrix,
    /// `1/λ_i` of the components; empty beyond.
    precisions: Vec<f64>,
    /// Largest coordinate of the mean.
    size: f64,
}

impl Model {
    fn new(
        source: &ShapesInMemory,
        metric: &Metric,
        method: &Method,
        reference: &[f64],
        weights: &[f64],
    ) -> Result<Self, AnalysisError> {
        let worth = effective(weights);
        let most = ((worth - 1.0) / SHAPES_PER_COMPONENT).max(0.0) as usize;
        let pca = FunctionalPca::new(source, metric, reference, true, COMPONENTS)?;
        let mut explained = 0.0;
        let explaining = pca.explained.iter().take_while(|part| {
            let further = explained < SHARE;
            explained += *part;
            further
        });
        let count = explaining.count().min(most);
        let total: f64 = weights.iter().sum();
        let precisions = pca.eigenvalues[..count].iter().map(|value| total / value).collect();
        let mean = unwhitened(metric, &pca.mean);
        let mut columns: Vec<Vec<f64>> =
            (0..count).map(|i| unwhitened(metric, pca.eigenshapes.column(i).as_slice())).collect();
        columns.extend(moves(&mean, method, metric));
        let directions = Matrix::from_vec(metric.len(), columns.len(), columns.concat());
        let size = mean.iter().fold(0.0, |most: f64, value| most.max(value.abs()));
        Ok(Self { mean, directions, precisions, size })
    }

    /// Distances between the control points of a shape, given without the mean, and its fit under the weights `v`.
    fn residuals(&self, away: &[f64], v: &[f64], noise: f64) -> Vec<f64> {
        let (n, p) = (v.len(), self.directions.ncols());
        let mut left = away.to_vec();
        if p > 0 {
            let mut weighted = self.directions.clone();
            for mut column in weighted.column_iter_mut() {
                column.iter_mut().enumerate().for_each(|(row, value)| *value *= v[row % n]);
            }
            let mut normal = weighted.tr_mul(&self.directions);
            let ridge = RIDGE * normal.trace() / p as f64;
            for i in 0..p {
                normal[(i, i)] += ridge + self.precisions.get(i).map_or(0.0, |precision| noise * precision);
            }
            let right = Matrix::from_fn(p, 1, |i, _| dot(weighted.column(i).as_slice(), away));
            if let Some(root) = normal.cholesky() {
                let found = &self.directions * root.solve(&right);
                left.iter_mut().zip(found.iter()).for_each(|(e, f)| *e -= f);
            }
        }
        (0..n).map(|i| left.iter().skip(i).step_by(n).map(|e| e * e).sum::<f64>().sqrt()).collect()
    }
}

/// `E c̄` for the unit matrices `E` of a linear class or the rotations and scales of a fit, and shifts if the class translates.
fn moves(mean: &[f64], method: &Method, metric: &Metric) -> Vec<Vec<f64>> {
    let (n, d) = (metric.size(), metric.dimension());
    let act = |matrix: &Matrix| crate::fit::transform(matrix, mean);
    let mut moves: Vec<Vec<f64>> = match method {
        Method::Projection(class) => class.matrices().iter().map(act).collect(),
        Method::Procrustes(fit) => {
            let turns = (0..d).flat_map(|c| (0..c).map(move |e| (c, e))).filter(|_| fit.rotates);
            let turn = |(c, e): (usize, usize)| {
                let mut matrix = Matrix::zeros(d, d);
                (matrix[(c, e)], matrix[(e, c)]) = (1.0, -1.0);
                act(&matrix)
            };
            turns.map(turn).chain([mean.to_vec()].into_iter().filter(|_| !method.keeps_sizes())).collect()
        }
    };
    if method.translates() {
        moves.extend((0..d).map(|c| (0..d * n).map(|row| f64::from(row / n == c)).collect()));
    }
    moves
}
