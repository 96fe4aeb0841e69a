//! Mean and covariance of the scores of weighted shapes.

use shapelex_numeric::dense::Matrix;

/// Weighted mean and covariance of `q` scores.
pub(super) struct Moments {
    pub(super) weight: f64,
    pub(super) mean: Vec<f64>,
    /// `q × q`, both triangles, divided by the weight.
    pub(super) covariance: Matrix,
}

impl Moments {
    /// Of `q` scores for each weight, one shape after the other. Not finite if the weights are all zero.
    pub(super) fn of(scores: &[f64], q: usize, weights: &[f64]) -> Self {
        let rows = || scores.chunks_exact(q).zip(weights).filter(|(_, weight)| **weight > 0.0);
        let weight: f64 = weights.iter().sum();
        let mut mean = vec![0.0; q];
        for (t, w) in rows() {
            mean.iter_mut().zip(t).for_each(|(sum, t)| *sum += w * t / weight);
        }
        let mut covariance = Matrix::zeros(q, q);
        let mut away = vec![0.0; q];
        for (t, w) in rows() {
            away.iter_mut().zip(t.iter().zip(&mean)).for_each(|(a, (t, mean))| *a = t - mean);
            for j in 0..q {
                let scaled = w / weight * away[j];
                (j..q).for_each(|i| covariance[(i, j)] += scaled * away[i]);
            }
        }
        covariance.fill_upper_triangle_with_lower_triangle();
        Self { weight, mean, covariance }
    }

    /// Covariance within two groups, `(W₁C₁ + W₂C₂)/(W₁ + W₂) + least·I`.
    pub(super) fn within(&self, other: &Self, least: f64) -> Matrix {
        let sum = &self.covariance * self.weight + &other.covariance * other.weight;
        let mut within = sum / (self.weight + other.weight);
        (0..within.nrows()).for_each(|i| within[(i, i)] += least);
        within
    }

    /// Difference of the means, `other − self`.
    pub(super) fn towards(&self, other: &Self) -> Matrix {
        Matrix::from_fn(self.mean.len(), 1, |i, _| other.mean[i] - self.mean[i])
    }
}

/// `(t − m)ᵀ C⁻¹ (t − m)` for `C = L Lᵀ`: `root` is `L`, `mean` is `m`, `away` a buffer of their size.
pub(super) fn square(root: &Matrix, mean: &[f64], t: &[f64], away: &mut [f64]) -> f64 {
    for i in 0..away.len() {
        let known: f64 = (0..i).map(|j| root[(i, j)] * away[j]).sum();
        away[i] = (t[i] - mean[i] - known) / root[(i, i)];
    }
    away.iter().map(|value| value * value).sum()
}
