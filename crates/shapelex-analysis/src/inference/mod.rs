//! Tests of differences and dependencies of aligned shapes, by permutation.
//!
//! Shapes that are aligned to one mean, which knows nothing of groups or covariates, are vectors of one space. Whatever
//! statistic is taken of them, its distribution under "the labels mean nothing" is that over the relabellings:
//!
//! ```text
//! p = (1 + #{relabellings with a statistic ≥ the observed one}) / (1 + relabellings)
//! ```
//!
//! * [`permutation`] — relabellings within strata, all of them or drawn; p values, Holm's correction;
//! * [`span`] — the same shapes in as few coordinates as they span;
//! * [`comparison`] — groups: distance of the averages, pseudo-F, Hotelling's statistic, the effect along the shape;
//! * [`regression`] — the linear dependence of shapes on an attribute, after covariates.
//!
//! Sources: Anderson 2001 (pseudo-F), Freedman and Lane 1983 (residuals are permuted), Holm 1979, Phipson and Smyth
//! 2010 (the observed labelling counts as one).

pub mod comparison;
pub mod permutation;
pub mod regression;
pub mod span;

/// Statistics that differ by less than this part are equal: sums of the same numbers in another order.
const TIE: f64 = 1e-9;

/// Whether a relabelling reaches the observed statistic (neither is negative).
fn reaches(statistic: f64, observed: f64) -> bool {
    statistic >= observed * (1.0 - TIE)
}
