//! Assessment of a shape of which a part is seen, from the posterior of the part.
//!
//! ```text
//! T² = |ẑ|²,   e = J − tr C_z                                     e: expectation of T² given a part of this extent
//! Q  = ⟨1, 1⟩ Σ_i |q_i − ŷ_i|²/M                                  squared prediction error, as of the whole shape
//! t  = T²/e,   s = Σ_i |q_i − ŷ_i|²/v_i / (d M − I − e)           compared with parts of held-out shapes
//! ```
//!
//! `C_z` is the covariance of the scores, `M` the number of seen points and `I` that of the unknowns of the pose. Both measures are about
//! one for shapes of the model, whatever part is seen; a whole shape has the `T²` and `Q` of its code.

use super::conditioning::{Posterior, Seen};
use super::missing::PartialShape;
use super::model::PosteriorModel;
use crate::AnalysisError;
use crate::dictionary::in_use::Dictionary;
use crate::dictionary::score::Known;
use crate::metric::norm;
use shapelex_geometry::representation::ShapeSpace;

/// Least number of residual numbers for each of which the misfit is counted: below it hardly anything is left to misfit.
const LEAST_FREE: f64 = 0.5;

/// Least expectation of `T²`: below it only the pose is seen, and scores are rounding errors.
const LEAST_KNOWN: f64 = 1e-6;

/// How unlike the model the seen part of a shape is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PartMeasures {
    /// `t`: squared Mahalanobis distance of the scores over its expectation.
    pub distance: f64,
    /// `s`: squared residual in units of its variance, for each number that scores and pose leave.
    pub residual: f64,
}

/// How the seen part of a shape compares with parts of held-out shapes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PartScore {
    /// Whether the larger of the two measures exceeds their common limit.
    pub is_outlier: bool,
    /// Fraction of the parts whose scores are as near to the mean, or nearer.
    pub distance_rank: f64,
    /// Fraction of the parts that the model fits as well, or better.
    pub residual_rank: f64,
}

impl Dictionary {
    /// Compares the seen part of a shape with whole held-out shapes, as if the rest of it were as unlike the model: without parts of
    /// held-out shapes, for want of a better comparison.
    pub fn score_part(&self, measures: PartMeasures, components: usize, quantile: f64) -> PartScore {
        let residuals = Known::of(&self.content.statistics).residuals;
        let usual = residuals.iter().sum::<f64>() / residuals.len().max(1) as f64;
        let (t_squared, residual) = (measures.distance * components as f64, measures.residual * usual);
        let score = self.compared(Some(t_squared), None, residual, quantile);
        PartScore {
            is_outlier: score.outlier,
            distance_rank: score.t_squared_rank.unwrap_or_default(),
            residual_rank: score.residual_rank,
        }
    }
}

impl Posterior {
    /// How unlike the model the seen part is.
    pub fn measures(&self) -> PartMeasures {
        let j = self.scores.len();
        let known = (j as f64 - (0..j).map(|i| self.covariance[(i, i)]).sum::<f64>()).max(LEAST_KNOWN);
        let free = (self.freedom as f64 - known).max(LEAST_FREE);
        PartMeasures { distance: self.distance().powi(2) / known, residual: self.misfit / free }
    }
}

/// A shape of which a part is seen, beside its most likely shape.
#[derive(Debug, Clone)]
pub struct PartAssessment {
    /// Scores and pose.
    pub posterior: Posterior,
    /// Scores of the dictionary.
    pub scores: Vec<f64>,
    /// Their standard deviations.
    pub deviations: Vec<f64>,
    /// Positions of the seen part: control points, or with arcs those of as many places along the curve.
    pub seen: Vec<usize>,
    /// Distances of the seen part from the most likely shape, in the unit of the shape.
    pub residual: Vec<f64>,
    /// The most likely shape, `d·N` coordinate-major numbers, in the pose in which the part is seen.
    pub completed: Vec<f64>,
    /// The same with the seen control points in their places.
    pub filled: Vec<f64>,
    /// `T²`.
    pub t_squared: f64,
    /// `Q`.
    pub squared_error: f64,
    /// `√(Σ|q − ŷ|²/Σ|q|²)` over the seen part, in the pose of the dictionary.
    pub relative_residual: f64,
    /// `Σ|q − ŷ|²/√(Σ|q|² Σ|ŷ|²)` over the seen part, in the pose of the dictionary.
    pub relative_error: f64,
}

impl PosteriorModel {
    /// Assesses a shape of which control points or arcs are seen.
    ///
    /// Cost: that of its [`Posterior`].
    ///
    /// # Errors
    /// As [`Posterior::new`], for parts that leave the pose open; [`AnalysisError::Parameter`] at `observed` for parts that determine the
    /// pose alone, which say nothing of the shape.
    pub fn assess(&self, space: &ShapeSpace, shape: &PartialShape) -> Result<PartAssessment, AnalysisError> {
        let (d, n) = (self.dimension(), self.size());
        let known = self.seen(space, shape)?;
        let posterior = Posterior::new(&known, self.freedom())?;
        let Seen { at, points, .. } = &known;
        if posterior.freedom == 0 {
            let detail =
                format!("expected more seen numbers than the pose has unknowns, got {}", d * at.count());
            return Err(AnalysisError::Parameter { field: "observed", detail });
        }
        let (q, y) = (posterior.pose.apply(points), at.points(&posterior.scores));
        let back = posterior.back.apply(&y);
        let count = at.count();
        let away = |i: usize| {
            norm(&(0..d).map(|c| points[c * count + i] - back[c * count + i]).collect::<Vec<f64>>())
        };
        let apart = norm(&q.iter().zip(&y).map(|(q, y)| q - y).collect::<Vec<f64>>());
        let completed = posterior.back.apply(&self.controls().points(&posterior.scores));
        let mut filled = completed.clone();
        shape.fill(space, &mut filled);
        let mut ones = vec![0.0; d * n];
        ones[..n].fill(1.0);
        let squared_error = self.metric.inner(&ones, &ones) * apart.powi(2) / count as f64;
        Ok(PartAssessment {
            scores: self.scores(&posterior.scores),
            deviations: self.score_deviations(&posterior.covariance),
            residual: (0..count).map(away).collect(),
            t_squared: posterior.distance().powi(2),
            relative_residual: apart / norm(&q),
            relative_error: apart.powi(2) / (norm(&q) * norm(&y)),
            squared_error,
            seen: shape.seen(space),
            completed,
            filled,
            posterior,
        })
    }
}
