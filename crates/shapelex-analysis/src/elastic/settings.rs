//! Settings of elastic distances.

use crate::AnalysisError;

/// Thoroughness of the search: more starts and wider bands find smaller distances, and take longer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
pub enum Effort {
    /// A third of the time; distances are larger by 3 % in the mean.
    Fast,
    /// The usual search.
    #[default]
    Normal,
    /// Twice the time and more: twice as many starts, and both curves in either role.
    Thorough,
}

/// What is compared, and how thoroughly.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ElasticSettings {
    /// `ε`, the weight of bending against stretching, in (0, 1].
    pub elasticity: f64,
    /// `M`, the number of segments of a curve.
    pub points: usize,
    /// Whether rotations are removed.
    pub rotation: bool,
    /// Thoroughness of the search.
    pub effort: Effort,
}

/// Fewest and most segments of a curve.
pub const POINTS: [usize; 2] = [16, 1000];

impl Default for ElasticSettings {
    fn default() -> Self {
        Self { elasticity: 1.0, points: 100, rotation: true, effort: Effort::Normal }
    }
}

impl ElasticSettings {
    /// The settings, if they are in range.
    ///
    /// # Errors
    /// [`AnalysisError::Parameter`] of `elasticity` or `points`.
    pub fn checked(self) -> Result<Self, AnalysisError> {
        let refused = |field, detail| Err(AnalysisError::Parameter { field, detail });
        if !(self.elasticity > 0.0 && self.elasticity <= 1.0) {
            let detail = format!("expected a number above 0 and up to 1, got {}", self.elasticity);
            return refused("elasticity", detail);
        }
        let [fewest, most] = POINTS;
        if !(fewest..=most).contains(&self.points) {
            let detail = format!("expected a number between {fewest} and {most}, got {}", self.points);
            return refused("points", detail);
        }
        Ok(self)
    }

    /// Predicted seconds of one pair on one thread, for `variants` ways to lay one curve: with or without mirror images, in one
    /// direction or two.
    pub fn seconds(&self, variants: usize) -> f64 {
        /// Per way and a hundred segments.
        const WAY: [f64; 3] = [5e-5, 1.5e-4, 6.5e-4];
        WAY[self.effort as usize] * variants as f64 * self.points as f64 / 100.0
    }
}
