//! Functional principal component analysis of aligned shapes.
//!
//! ```text
//! S = Σ_k w_k y_k y_kᵀ,   S ξ_i = λ_i ξ_i,   ⟨ξ_i, ξ_j⟩ = δ_ij,   score_ik = ⟨ξ_i, y_k⟩
//! ```
//!
//! with `y_k = r̃_k` (uncentred, as in the thesis: the first eigenshape then carries most of the energy) or
//! `y_k = r̃_k − r̄` (centred on the arithmetic mean, the usual PCA). Eigenvalues are sums over the shapes, not
//! divided by their number. Dual and primal route as in [`OuterProductSum`].
//!
//! [`OuterProductSum`]: super::accumulate::OuterProductSum

use super::AnalysisError;
use super::accumulate::{ScatterSum, ShapeSource, accumulate, accumulate_spread, map_blocks};
use super::frame::largest;
use super::metric::{Metric, dot, norm};
use super::pass::Sum;
use shapelex_numeric::dense::{Matrix, transpose_multiply_columns};
use shapelex_numeric::kernels::add_scaled;

/// Components with an eigenvalue below this fraction of the first are rounding error and are dropped.
pub(super) const SMALLEST_COMPONENT: f64 = 1e-12;

/// Warning about components that are not centred.
pub const UNCENTRED: &str = "the components are not centred: the first one is the mean, and fractions of variation count it; \
                             \"centre\": true subtracts it";

/// Functional principal components.
#[derive(Debug, Clone)]
pub struct FunctionalPca {
    /// Arithmetic mean of the aligned shapes, whitened.
    pub mean: Vec<f64>,
    /// Eigenvalues `λ_i`, descending.
    pub eigenvalues: Vec<f64>,
    /// Explained fractions, `λ_i / Σ λ`.
    pub explained: Vec<f64>,
    /// Eigenshapes `ξ_i`, whitened, one per column; the control coordinate of largest magnitude is positive.
    pub eigenshapes: Matrix,
    /// Whether the mean was subtracted.
    pub centred: bool,
}

impl FunctionalPca {
    /// The leading `components` components of the whitened shapes of `source`; fewer if the rank is smaller.
    ///
    /// `reference` is a whitened shape near all of them. It is subtracted before sums are formed, so that centring
    /// loses no digits. Cost: the smaller of `K (dN)²` and `K² dN`, and a partial eigenproblem.
    ///
    /// # Errors
    /// Errors of the source; a failure of the eigenproblem.
    pub fn new(
        source: &dyn ShapeSource,
        metric: &Metric,
        reference: &[f64],
        centred: bool,
        components: usize,
    ) -> Result<Self, AnalysisError> {
        let origin = Self::origin(reference, centred);
        Self::from_sum(Self::scatter(source, &origin)?, metric, &origin, centred, components)
    }

    /// Shape to subtract from every shape before sums are formed: `reference` if centred, else zero.
    pub fn origin(reference: &[f64], centred: bool) -> Vec<f64> {
        if centred { reference.to_vec() } else { vec![0.0; reference.len()] }
    }

    /// Scatter of the whitened shapes of `source` about `origin`.
    ///
    /// # Errors
    /// Errors of the source.
    pub fn scatter(source: &dyn ShapeSource, origin: &[f64]) -> Result<ScatterSum, AnalysisError> {
        let empty = || ScatterSum::about(origin.to_vec());
        let here = || accumulate(source, empty);
        accumulate_spread(source, Sum::Scatter { origin: origin.to_vec() }, empty, here)
    }

    /// Components from a scatter about `origin`, for sums that were merged.
    ///
    /// # Errors
    /// A failure of the eigenproblem.
    pub fn from_sum(
        sum: ScatterSum,
        metric: &Metric,
        origin: &[f64],
        centred: bool,
        components: usize,
    ) -> Result<Self, AnalysisError> {
        let mean: Vec<f64> = sum.mean().iter().zip(origin).map(|(m, o)| m + o).collect();
        // Eigenvalues have the unit of the weights, and so has the rounding of shapes that are equal.
        let spread = if centred { sum.weight() * norm(origin).powi(2) * f64::EPSILON } else { 0.0 };
        let (total, pairs) = sum.leading(centred, components)?;
        let first = pairs.values.first().copied().unwrap_or(0.0);
        let kept = pairs.values.iter().take_while(|&&v| v > SMALLEST_COMPONENT * first && v > spread).count();
        let eigenvalues = pairs.values[..kept].to_vec();
        let explained = eigenvalues.iter().map(|value| value / total).collect();
        let mut eigenshapes = pairs.vectors.columns(0, kept).into_owned();
        for mut column in eigenshapes.column_iter_mut() {
            let mut control_points = column.iter().copied().collect::<Vec<_>>();
            metric.unwhiten(&mut control_points);
            if largest(&control_points) < 0.0 {
                column.neg_mut();
            }
        }
        Ok(Self { mean, eigenvalues, explained, eigenshapes, centred })
    }

    /// Scores of one whitened aligned shape.
    pub fn scores(&self, x: &[f64]) -> Vec<f64> {
        let centred: Vec<f64> =
            if self.centred { x.iter().zip(&self.mean).map(|(x, m)| x - m).collect() } else { x.to_vec() };
        self.eigenshapes.column_iter().map(|xi| dot(xi.as_slice(), &centred)).collect()
    }

    /// The whitened shape with the given scores: `Σ score_i ξ_i`, plus the mean when centred.
    pub fn reconstruct(&self, scores: &[f64]) -> Vec<f64> {
        let mut x = if self.centred { self.mean.clone() } else { vec![0.0; self.mean.len()] };
        for (score, xi) in scores.iter().zip(self.eigenshapes.column_iter()) {
            add_scaled(&mut x, *score, xi.as_slice());
        }
        x
    }

    /// Scores of whitened shapes given one after the other: one column per shape.
    fn block_scores(&self, whitened: &[f64]) -> Matrix {
        if !self.centred {
            return transpose_multiply_columns(&self.eigenshapes, whitened);
        }
        let shapes = whitened.chunks_exact(self.mean.len());
        let centred: Vec<f64> =
            shapes.flat_map(|x| x.iter().zip(&self.mean).map(|(x, mean)| x - mean)).collect();
        transpose_multiply_columns(&self.eigenshapes, &centred)
    }

    /// Scores of all shapes, in order.
    ///
    /// # Errors
    /// Errors of the source.
    pub fn all_scores(&self, source: &dyn ShapeSource) -> Result<Vec<Vec<f64>>, AnalysisError> {
        map_blocks(source, |block| Ok(columns(&self.block_scores(block.whitened))))
    }
}

fn columns(matrix: &Matrix) -> Vec<Vec<f64>> {
    matrix.column_iter().map(|column| column.as_slice().to_vec()).collect()
}

/// Principal components with the scores of the shapes they come from.
#[derive(Debug)]
pub struct Components {
    /// The components.
    pub pca: FunctionalPca,
    /// Scores, one list per shape.
    pub scores: Vec<Vec<f64>>,
    /// Reconstruction error of each shape from its scores.
    pub errors: Vec<f64>,
    /// Factors of the weights of the shapes, if they are those of a robust mean.
    pub factors: Option<Vec<f64>>,
}

impl Components {
    /// Components as by [`FunctionalPca::new`], and one more pass over the shapes for their scores.
    ///
    /// # Errors
    /// Errors of the source; a failure of the eigenproblem.
    pub fn new(
        source: &dyn ShapeSource,
        metric: &Metric,
        reference: &[f64],
        centred: bool,
        components: usize,
    ) -> Result<Self, AnalysisError> {
        let pca = FunctionalPca::new(source, metric, reference, centred, components)?;
        let described = map_blocks(source, |block| {
            let scores = pca.block_scores(block.whitened);
            let shapes = columns(&scores).into_iter().zip(block.iter());
            let described = shapes.map(|(scores, (_, x, _))| {
                let error = reconstruction_error(x, &pca.reconstruct(&scores));
                (scores, error)
            });
            Ok(described.collect())
        })?;
        let (scores, errors) = described.into_iter().unzip();
        Ok(Self { pca, scores, errors, factors: None })
    }

    /// Whitened shapes `mean − sigma·s ξ`, `mean` and `mean + sigma·s ξ` of the component at `position`, with the standard
    /// deviation `s` of its scores. Uncentred eigenvalues measure energy, not variation, so they do not serve here.
    pub fn mode(&self, position: usize, sigma: f64) -> [Vec<f64>; 3] {
        let of = |scores: &Vec<f64>| scores[position];
        let factor = |k: usize| self.factors.as_ref().map_or(1.0, |factors| factors[k]);
        let counted = || self.scores.iter().enumerate().map(|(k, scores)| (factor(k), of(scores)));
        let shapes: f64 = counted().map(|(factor, _)| factor).sum();
        let mean = counted().map(|(factor, score)| factor * score).sum::<f64>() / shapes;
        let variance =
            counted().map(|(factor, score)| factor * (score - mean).powi(2)).sum::<f64>() / (shapes - 1.0);
        [-1.0, 0.0, 1.0].map(|sign: f64| {
            let step = sign * sigma * variance.sqrt();
            let xi = self.pca.eigenshapes.column(position);
            self.pca.mean.iter().zip(xi.iter()).map(|(m, xi)| m + step * xi).collect()
        })
    }
}

/// `‖r − r̂‖² / (‖r‖ ‖r̂‖)` of two whitened shapes: the reconstruction error of Tables 4.2 and 4.4.
pub fn reconstruction_error(x: &[f64], reconstructed: &[f64]) -> f64 {
    let difference: f64 = x.iter().zip(reconstructed).map(|(a, b)| (a - b).powi(2)).sum();
    difference / (norm(x) * norm(reconstructed))
}
