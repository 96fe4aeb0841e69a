//! The distribution of corresponding shapes, and the cost of a shape under it.
//!
//! ```text
//! log det(S/n + δI) ≤ log det M + tr(M⁻¹(S/n + δI)) − p,   M = S₀/n + δI       (the logarithm is concave)
//! ```
//!
//! With `M` of the current shapes, each shape therefore lowers the bound on its own by its Mahalanobis distance.

use shapelex_numeric::dense::{Matrix, leading_eigenpairs, multiply, transpose_multiply};

use super::super::AnalysisError;

/// Mean and covariance in `p = 3 B` coefficients.
#[derive(Debug, Clone)]
pub(super) struct Model {
    /// Mean, `p`.
    pub mean: Vec<f64>,
    /// Directions of variance, `p × r`.
    vectors: Matrix,
    /// `λ/(λ + δ)` of every direction.
    shares: Vec<f64>,
}

impl Model {
    /// The model under which every direction counts alike.
    pub(super) fn isotropic(mean: Vec<f64>) -> Self {
        let vectors = Matrix::zeros(mean.len(), 0);
        Self { mean, vectors, shares: Vec::new() }
    }

    /// A model of these directions and variances.
    pub(super) fn of(mean: Vec<f64>, vectors: Matrix, variances: &[f64], delta: f64) -> Self {
        let shares = variances.iter().map(|variance| variance / (variance + delta)).collect();
        Self { mean, vectors, shares }
    }

    /// `δ M⁻¹ x` for columns `x`.
    pub(super) fn weigh(&self, columns: &Matrix) -> Matrix {
        if self.shares.is_empty() {
            return columns.clone();
        }
        let mut along = transpose_multiply(&self.vectors, columns);
        for mut column in along.column_iter_mut() {
            column.iter_mut().zip(&self.shares).for_each(|(part, share)| *part *= share);
        }
        columns - multiply(&self.vectors, &along)
    }

    /// `x − μ`.
    pub(super) fn apart(&self, x: &[f64]) -> Vec<f64> {
        x.iter().zip(&self.mean).map(|(x, mean)| x - mean).collect()
    }

    /// `δ (x − μ)ᵀ M⁻¹ (x − μ)`.
    pub(super) fn cost(&self, x: &[f64]) -> f64 {
        let apart = Matrix::from_vec(x.len(), 1, self.apart(x));
        self.weigh(&apart).dot(&apart).max(0.0)
    }
}

/// Mean, directions and variances of shapes.
#[derive(Debug, Clone)]
pub(super) struct Spread {
    pub mean: Vec<f64>,
    vectors: Matrix,
    variances: Vec<f64>,
}

/// Variances below this fraction of the largest are rounding.
const NO_VARIANCE: f64 = 1e-12;

impl Spread {
    /// Of the rows of coefficients of all shapes, in order. Cost: `p²` per shape, and one eigendecomposition of size `p`.
    ///
    /// # Errors
    /// Coefficients that are not finite.
    pub(super) fn of(shapes: &[&[f64]]) -> Result<Self, AnalysisError> {
        let (count, size) = (shapes.len() as f64, shapes.first().map_or(0, |shape| shape.len()));
        let mut mean = vec![0.0; size];
        for shape in shapes {
            mean.iter_mut().zip(*shape).for_each(|(sum, x)| *sum += x / count);
        }
        let mut centred = Matrix::zeros(shapes.len(), size);
        for (k, shape) in shapes.iter().enumerate() {
            (0..size).for_each(|i| centred[(k, i)] = shape[i] - mean[i]);
        }
        let scatter = transpose_multiply(&centred, &centred) / count;
        let pairs = leading_eigenpairs(&scatter, size)?;
        let least = NO_VARIANCE * pairs.values.first().copied().unwrap_or(0.0).max(0.0);
        let rank = pairs.values.iter().take_while(|value| **value > least).count();
        let variances = pairs.values[..rank].to_vec();
        Ok(Self { mean, vectors: pairs.vectors.columns(0, rank).into_owned(), variances })
    }

    /// Total variance.
    pub(super) fn total(&self) -> f64 {
        self.variances.iter().sum()
    }

    /// `Σ log(1 + λ/δ)`: the excess of `log det(S/n + δI)` over that of no variance.
    pub(super) fn entropy(&self, delta: f64) -> f64 {
        self.variances.iter().map(|variance| (variance / delta).ln_1p()).sum()
    }

    /// Scores of centred shapes along the first `most` directions, as orthonormal columns, and `λ/(λ + δ)` of each.
    pub(super) fn patterns(&self, apart: &[Vec<f64>], delta: f64, most: usize) -> (Matrix, Vec<f64>) {
        let count = self.variances.len().min(most);
        let norm = |i: usize| (apart.len() as f64 * self.variances[i]).sqrt();
        let score = |k: usize, i: usize| {
            apart[k].iter().zip(self.vectors.column(i).iter()).map(|(x, v)| x * v).sum::<f64>() / norm(i)
        };
        let shares = self.variances[..count].iter().map(|variance| variance / (variance + delta)).collect();
        (Matrix::from_fn(apart.len(), count, score), shares)
    }

    /// The model with noise `delta`.
    pub(super) fn model(&self, delta: f64) -> Model {
        Model::of(self.mean.clone(), self.vectors.clone(), &self.variances, delta)
    }
}
