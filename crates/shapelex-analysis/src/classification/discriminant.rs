//! Regularised discriminants: from linear (one covariance) to quadratic (one covariance per class).
//!
//! ```text
//! δ_c(z) = −½ (z − μ_c)ᵀ Σ_c⁻¹ (z − μ_c) − ½ ln det Σ_c + ln(n_c/n)
//! Σ_c = (1 − γ) S_c + γ (tr S_c/p) I,    S_c = ((1 − α) W_c + α W)/((1 − α)(n_c − 1) + α (n − C))
//! ```
//!
//! `z` are features divided by their pooled standard deviation within classes, `W_c` is the scatter of a class about its
//! mean, and `W = Σ W_c`; `α` is the pooling, `γ` the shrinkage. Default `γ`: the Ledoit–Wolf estimate for the pooled
//! covariance, which minimises the expected squared error.
//!
//! Sources: Friedman 1989, *Regularized discriminant analysis*; Ledoit and Wolf 2004.

use nalgebra::Cholesky;

use super::observations::{Evidence, Labelled};
use crate::AnalysisError;
use crate::dictionary::model::squared_distance;
use shapelex_numeric::dense::{Matrix, multiply};

/// Regularisation of the covariance estimates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Regularisation {
    /// Number of leading features of the code to use. Default: all.
    pub components: Option<usize>,
    /// `α`: 1 for linear discriminants, 0 for quadratic ones.
    pub pooling: f64,
    /// `γ`. Default: estimated.
    pub shrinkage: Option<f64>,
}

/// A trained discriminant.
#[derive(Debug, Clone, PartialEq)]
pub struct Discriminant {
    /// Indices of the features in use, from 0.
    pub features: Vec<usize>,
    /// Pooled standard deviations of these features within classes.
    pub scales: Vec<f64>,
    /// Mean features of every class, divided by the scales.
    pub means: Vec<Vec<f64>>,
    /// `L` with `Σ_c = L Lᵀ`: one for all classes, or one per class.
    pub factors: Vec<Matrix>,
    /// Logarithms of the prior probabilities, `ln(n_c/n)`.
    pub log_priors: Vec<f64>,
    /// The shrinkage `γ` in use.
    pub shrinkage: f64,
}

/// Relative standard deviation, as a fraction of the largest, below which a feature is constant up to rounding.
const CONSTANT: f64 = 1e-12;

impl Discriminant {
    /// Trains on features, one shape per column. Cost `O(n p² + C p³)`.
    ///
    /// # Errors
    /// [`AnalysisError::SingularCovariance`] if the covariance of a class is rank-deficient.
    pub(super) fn train(
        features: &Matrix,
        size: bool,
        sample: Labelled<'_>,
        regularisation: Regularisation,
    ) -> Result<Self, AnalysisError> {
        let all = features.nrows();
        let codes = all - usize::from(size);
        let kept = regularisation.components.unwrap_or(codes).min(codes);
        let chosen: Vec<usize> = (0..kept).chain(codes..all).collect();
        let sizes = sample.sizes();
        let (z, means) = about_means(features.select_rows(&chosen), sample, &sizes);
        let (n, count) = (z.ncols(), sample.count);
        let freedom = n.saturating_sub(count).max(1) as f64;
        let deviations: Vec<f64> = z.row_iter().map(|row| (row.norm_squared() / freedom).sqrt()).collect();
        let largest = deviations.iter().copied().fold(0.0, f64::max);
        if !(largest > 0.0) {
            return Err(AnalysisError::SingularCovariance { class: 0 });
        }
        let varies = |i: &usize| deviations[*i] > CONSTANT * largest;
        let rows: Vec<usize> = (0..chosen.len()).filter(varies).collect();
        let scales: Vec<f64> = rows.iter().map(|&i| deviations[i]).collect();
        let (mut z, mut means) = (z.select_rows(&rows), means.select_rows(&rows));
        for (i, &scale) in scales.iter().enumerate() {
            z.row_mut(i).unscale_mut(scale);
            means.row_mut(i).unscale_mut(scale);
        }
        let shrinkage = regularisation.shrinkage.unwrap_or_else(|| ledoit_wolf(&z));
        let scatter = multiply(&z, &z.transpose());
        let alpha = regularisation.pooling;
        let covariance = |own: Option<(Matrix, usize)>| {
            let (own, members) = own.unwrap_or_else(|| (scatter.clone(), n - count + 1));
            let degrees = (1.0 - alpha) * members.saturating_sub(1) as f64 + alpha * freedom;
            let mut s = (own * (1.0 - alpha) + &scatter * alpha) / degrees.max(1.0);
            let target = s.trace() / s.nrows() as f64;
            s *= 1.0 - shrinkage;
            (0..s.nrows()).for_each(|i| s[(i, i)] += shrinkage * target);
            s
        };
        let factors: Result<Vec<Matrix>, AnalysisError> = if alpha == 1.0 {
            Ok(vec![factor(0, covariance(None))?])
        } else {
            let own = |class: usize| {
                let members: Vec<usize> = (0..n).filter(|&k| sample.classes[k] == class).collect();
                let z = z.select_columns(&members);
                factor(class, covariance(Some((multiply(&z, &z.transpose()), members.len()))))
            };
            (0..count).map(own).collect()
        };
        Ok(Self {
            features: rows.iter().map(|&i| chosen[i]).collect(),
            scales,
            means: means.column_iter().map(|column| column.iter().copied().collect()).collect(),
            factors: factors?,
            log_priors: sizes.iter().map(|&size| (size as f64 / n as f64).ln()).collect(),
            shrinkage,
        })
    }

    /// Evidence from features, one shape per column; distances are Mahalanobis distances. Cost `O(K C p²)`.
    pub(super) fn evidence(&self, features: &Matrix) -> Vec<Evidence> {
        let mut z = features.select_rows(&self.features);
        for (i, &scale) in self.scales.iter().enumerate() {
            z.row_mut(i).unscale_mut(scale);
        }
        let count = self.means.len();
        let empty = Evidence { distances: vec![0.0; count], scores: vec![0.0; count] };
        let mut evidence = vec![empty; z.ncols()];
        // ‖L⁻¹(z − μ)‖ = ‖L⁻¹z − L⁻¹μ‖: with a single covariance, the shapes are transformed once for all classes.
        let white: Vec<Matrix> = self.factors.iter().map(|factor| solved(factor, &z)).collect();
        for (c, mean) in self.means.iter().enumerate() {
            let own = c.min(self.factors.len() - 1);
            let log_determinant: f64 = self.factors[own].diagonal().iter().map(|pivot| pivot.ln()).sum();
            let mean = solved(&self.factors[own], &Matrix::from_column_slice(mean.len(), 1, mean));
            for (evidence, z) in evidence.iter_mut().zip(white[own].column_iter()) {
                let squared = squared_distance(z.as_slice(), mean.as_slice());
                evidence.distances[c] = squared.sqrt();
                evidence.scores[c] = -0.5 * squared - log_determinant + self.log_priors[c];
            }
        }
        evidence
    }
}

/// Features about the means of their classes, and these means, one class per column.
fn about_means(mut z: Matrix, sample: Labelled<'_>, sizes: &[usize]) -> (Matrix, Matrix) {
    let mut means = Matrix::zeros(z.nrows(), sample.count);
    for (column, &c) in z.column_iter().zip(sample.classes) {
        means.column_mut(c).axpy(1.0 / sizes[c] as f64, &column, 1.0);
    }
    for (mut column, &c) in z.column_iter_mut().zip(sample.classes) {
        column -= means.column(c);
    }
    (z, means)
}

/// Cholesky factor of the covariance of a class.
fn factor(class: usize, covariance: Matrix) -> Result<Matrix, AnalysisError> {
    let error = || AnalysisError::SingularCovariance { class };
    let factor = Cholesky::new(covariance).ok_or_else(error)?.unpack();
    let pivots = factor.diagonal();
    // The squared ratio is a lower bound on the condition number.
    if pivots.min() > WELL_CONDITIONED * pivots.max() { Ok(factor) } else { Err(error()) }
}

/// `L⁻¹ z`.
fn solved(factor: &Matrix, z: &Matrix) -> Matrix {
    let mut solved = z.clone();
    // Fails only for zero pivots, which training and import reject.
    let positive = factor.solve_lower_triangular_mut(&mut solved);
    debug_assert!(positive, "pivots are positive");
    solved
}

/// Minimum ratio of smallest to largest pivot for which a covariance can be inverted with half of the digits.
const WELL_CONDITIONED: f64 = 1e-7;

/// `γ = min(b²/d², 1)`: `d² = ‖S − μI‖²`, `b² = (Σ_k ‖z_k z_kᵀ − S‖²)/n²`, for `S = (Σ z zᵀ)/n` and `μ = tr S/p`.
fn ledoit_wolf(z: &Matrix) -> f64 {
    let (p, n) = (z.nrows() as f64, z.ncols() as f64);
    let s = multiply(z, &z.transpose()) / n;
    let (mu, squared) = (s.trace() / p, s.norm_squared());
    let spread = squared - p * mu * mu;
    let fourth: f64 = z.column_iter().map(|column| column.norm_squared().powi(2)).sum();
    let error = (fourth / n - squared) / n;
    if spread > 0.0 { (error / spread).clamp(0.0, 1.0) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::classification::Observations;

    const NOTHING: Observations<'_> = Observations { shapes: &[], prepared: &[], codes: &[] };

    fn train(
        features: &Matrix,
        classes: &[usize],
        regularisation: Regularisation,
    ) -> Result<Discriminant, AnalysisError> {
        let count = 1 + classes.iter().max().unwrap();
        let sample = Labelled { observations: NOTHING, weights: &[], classes, count };
        Discriminant::train(features, false, sample, regularisation)
    }

    #[test]
    fn one_feature_is_the_textbook() {
        // Means 1 and 6, pooled variance (2 + 8)/4 = 5/2, equal priors.
        let features = Matrix::from_row_slice(1, 6, &[0.0, 1.0, 2.0, 4.0, 6.0, 8.0]);
        let classes = [0, 0, 0, 1, 1, 1];
        let linear = Regularisation { components: None, pooling: 1.0, shrinkage: Some(0.0) };
        let discriminant = train(&features, &classes, linear).unwrap();
        let found = discriminant.evidence(&Matrix::from_row_slice(1, 2, &[3.0, 3.5]));
        let (near, far) = (2.0 / 2.5_f64.sqrt(), 3.0 / 2.5_f64.sqrt());
        assert!((found[0].distances[0] - near).abs() < 1e-14 && (found[0].distances[1] - far).abs() < 1e-14);
        let advantage = found[0].scores[0] - found[0].scores[1];
        assert!((advantage - 0.5 * (9.0 - 4.0) / 2.5).abs() < 1e-14, "{advantage}");
        assert!((found[1].scores[0] - found[1].scores[1]).abs() < 1e-14, "half-way between the means");
        // Separate variances 1 and 4: the δ differ by ln 2 where the distances agree.
        let quadratic = Regularisation { pooling: 0.0, ..linear };
        let found = train(&features, &classes, quadratic).unwrap();
        let found = found.evidence(&Matrix::from_row_slice(1, 1, &[8.0 / 3.0]));
        assert!((found[0].distances[0] - 5.0 / 3.0).abs() < 1e-14);
        assert!((found[0].distances[1] - 5.0 / 3.0).abs() < 1e-14);
        assert!((found[0].scores[0] - found[0].scores[1] - 2.0_f64.ln()).abs() < 1e-14);
    }

    #[test]
    fn covariances_without_full_rank_are_refused() {
        let features = Matrix::from_row_slice(2, 4, &[0.0, 1.0, 4.0, 6.0, 0.0, 1.0, 4.5, 5.5]);
        let own = Regularisation { components: None, pooling: 0.0, shrinkage: Some(0.0) };
        let refused = train(&features, &[0, 0, 1, 1], own);
        assert_eq!(refused, Err(AnalysisError::SingularCovariance { class: 0 }));
        let shrunk = Regularisation { shrinkage: Some(0.1), ..own };
        assert!(train(&features, &[0, 0, 1, 1], shrunk).is_ok());
        let constant = Matrix::from_row_slice(1, 4, &[0.0, 0.0, 1.0, 1.0]);
        let refused = train(&constant, &[0, 0, 1, 1], shrunk);
        assert_eq!(refused, Err(AnalysisError::SingularCovariance { class: 0 }));
    }

    /// By hand: z = ±1 on each axis of the plane gives S = I/2, which leaves nothing to shrink.
    #[test]
    fn estimated_shrinkage_is_within_its_bounds() {
        let isotropic = Matrix::from_row_slice(2, 4, &[1.0, -1.0, 0.0, 0.0, 0.0, 0.0, 1.0, -1.0]);
        assert_eq!(ledoit_wolf(&isotropic), 0.0);
        // One direction only, eight equal steps: ‖S‖² = 1, spread 1/2, error (1 − 1)/8.
        let line =
            Matrix::from_fn(2, 8, |i, k| if i == 0 { if k % 2 == 0 { 1.0 } else { -1.0 } } else { 0.0 });
        assert_eq!(ledoit_wolf(&line), 0.0);
        // Unequal steps 0 and ±2: S = diag(2, 0), fourth moment 8, error (8 − 4)/8 = 1/2, spread 4 − 2 = 2.
        let unequal = Matrix::from_fn(2, 8, |i, k| match (i, k % 4) {
            (0, 0) => 2.0,
            (0, 1) => -2.0,
            _ => 0.0,
        });
        assert!((ledoit_wolf(&unequal) - 0.25).abs() < 1e-15);
    }
}
