//! Points of a posterior with their covariances.
//!
//! ```text
//! r_i = M (m_i + D_i ẑ) + t,   C_i = M (G_i H⁻¹ G_iᵀ + v_i I) Mᵀ       a region: (x − r_i)ᵀ C_i⁻¹ (x − r_i) ≤ f²
//! ```

use super::conditioning::{Posterior, fill};
use super::places::AtPlaces;
use crate::AnalysisError;
use shapelex_numeric::dense::{Definite, Matrix, multiply, symmetric_eigen};

/// Points with covariances, in the pose in which the shape is seen.
#[derive(Debug, Clone)]
pub struct Predicted {
    /// `r_i`, `d·M` coordinate-major numbers.
    pub points: Vec<f64>,
    /// `C_i`, `d × d`.
    pub covariances: Vec<Matrix>,
}

impl Posterior {
    /// Points of the shape at some places. Cost `O(d M (J + I)²)`.
    pub fn at(&self, at: &AtPlaces) -> Predicted {
        let d = at.dimension;
        let (count, unknowns) = (at.count(), self.covariance.nrows());
        let y = at.points(&self.scores);
        let mut rows = Matrix::zeros(unknowns, d * count);
        for i in 0..count {
            let point = |e: usize| y[e * count + i];
            for c in 0..d {
                let row = &mut rows.as_mut_slice()[(i * d + c) * unknowns..][..unknowns];
                fill(row, at.row(i, c), &self.directions, self.translates, (c, point));
            }
        }
        let spread = multiply(&self.covariance, &rows);
        let covariance = |i: usize| {
            let rows = rows.columns(i * d, d);
            let noise = Matrix::identity(d, d) * at.noise[i];
            let inner = rows.transpose() * spread.columns(i * d, d) + noise;
            &self.back.matrix * (0.5 * (&inner + inner.transpose())) * self.back.matrix.transpose()
        };
        Predicted { points: self.back.apply(&y), covariances: (0..count).map(covariance).collect() }
    }
}

impl Predicted {
    /// Mahalanobis distance of each of other points from these.
    ///
    /// # Errors
    /// A covariance without full rank.
    pub fn distances(&self, others: &[f64]) -> Result<Vec<f64>, AnalysisError> {
        let (count, d) = (self.covariances.len(), self.points.len() / self.covariances.len().max(1));
        let distance = |(i, covariance): (usize, &Matrix)| {
            let away = Matrix::from_fn(d, 1, |c, _| others[c * count + i] - self.points[c * count + i]);
            let solved = Definite::new(covariance)?.solve(&away);
            Ok(away.dot(&solved).max(0.0).sqrt())
        };
        self.covariances.iter().enumerate().map(distance).collect()
    }

    /// Largest standard deviation of each point in any direction.
    pub fn deviations(&self) -> Vec<f64> {
        let largest = |covariance: &Matrix| symmetric_eigen(covariance).eigenvalues.max().max(0.0).sqrt();
        self.covariances.iter().map(largest).collect()
    }
}
