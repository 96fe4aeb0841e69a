//! Errors of studies.

use super::limits::{MAX_LEVELS, MAX_VALUE, MAX_WEIGHT_RATIO, MIN_DEVIATION, MIN_MEMBERS};
use crate::AnalysisError;

/// Reason why a study has no result.
#[derive(Debug, PartialEq, thiserror::Error)]
pub enum StudyError {
    /// A single shape dominates the others.
    #[error(
        "expected weights that differ by a factor of at most {MAX_WEIGHT_RATIO:.0e}, got {smallest:.1e} to \
         {largest:.1e}"
    )]
    Weights {
        /// Smallest weight.
        smallest: f64,
        /// Largest weight.
        largest: f64,
    },
    /// A group has too few shapes.
    #[error("expected at least {MIN_MEMBERS} shapes in every group, got {found} in '{group}'")]
    FewMembers {
        /// Name of the group.
        group: String,
        /// Number of its shapes.
        found: usize,
    },
    /// A variable has values whose squares leave the range of numbers.
    #[error("expected values within ±{MAX_VALUE:.0e}")]
    LargeValues,
    /// A categorical variable has too many values.
    #[error("expected at most {MAX_LEVELS} values of a category, got {found}")]
    ManyLevels {
        /// Number of different values.
        found: usize,
    },
    /// There are no more shapes than coefficients.
    #[error(
        "expected at least {needed} shapes that have all values, got {found}: no degree of freedom is left"
    )]
    FewShapes {
        /// Number of shapes given.
        found: usize,
        /// Number of shapes needed.
        needed: usize,
    },
    /// The attribute has no separate effect.
    #[error(
        "the attribute is constant, or a linear combination of the covariates: there is no regression on it"
    )]
    CollinearAttribute,
    /// A covariate has no separate effect.
    #[error("the covariate is constant, or a linear combination of the covariates before it: leave it out")]
    CollinearCovariate {
        /// Position of the covariate.
        covariate: usize,
    },
    /// The attribute varies too little for a change per unit.
    #[error("expected a standard deviation of at least {MIN_DEVIATION:.0e}: use a smaller unit")]
    SmallDeviation,
    /// A variable is the size of shapes that have none.
    #[error("there are shapes too large to be measured")]
    Unmeasured,
    /// An error of the alignment or of a test.
    #[error(transparent)]
    Analysis(#[from] AnalysisError),
}
