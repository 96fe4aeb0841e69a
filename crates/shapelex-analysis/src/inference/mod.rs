//! Permutation tests for group differences and regressions of aligned shapes.
//!
//! Shapes aligned to one mean, which does not depend on groups or covariates, are vectors of one space. For any statistic,
//! the distribution under the null hypothesis (the labels are exchangeable) is the one over the relabellings:
//!
//! ```text
//! p = (1 + #{relabellings with a statistic ≥ the observed one}) / (1 + relabellings)
//! ```
//!
//! Whole studies, from control points to records:
//!
//! * [`aligned`] — shapes of a study, aligned to one mean;
//! * [`compare`] — comparison of groups; [`groups`] — their shapes, strata and subjects;
//! * [`regress`] — regression on an attribute; [`variables`] — attribute, covariates and their design;
//! * [`records`] — results; [`error`] — reasons why there is none; [`limits`].
//!
//! Their parts:
//!
//! * [`permutation`] — relabellings within strata, enumerated or drawn; p values; Holm's correction;
//! * [`histogram`] — histograms of a statistic over the relabellings;
//! * [`span`] — coordinates in the span of the shapes, the fewest possible;
//! * [`comparison`] — groups: distance of the means, pseudo-F, Hotelling's statistic, the effect along the shape; [`studentised`] — the
//!   distance of groups that scatter unequally;
//! * [`regression`] — linear regression of shapes on an attribute, adjusted for covariates; [`regression_sums`] — the same of
//!   more shapes than fit into memory.
//!
//! Sources: Anderson 2001 (pseudo-F), Freedman and Lane 1983 (residuals are permuted), Holm 1979, Phipson and Smyth
//! 2010 (the observed labelling counts as one).

pub mod aligned;
pub mod compare;
pub mod comparison;
pub mod error;
pub mod groups;
pub mod histogram;
pub mod limits;
pub mod permutation;
pub mod records;
pub mod regress;
pub mod regression;
pub mod regression_sums;
pub mod span;
pub mod studentised;
pub mod variables;

/// Relative difference below which two statistics are equal: they are sums of the same numbers in different order.
const TIE: f64 = 1e-9;

/// Whether the statistic of a relabelling reaches the observed one (both are non-negative).
pub(crate) fn reaches(statistic: f64, observed: f64) -> bool {
    statistic >= observed * (1.0 - TIE)
}
