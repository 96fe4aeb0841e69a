//! Hypothesis tests on the shapes of a cohort, by permutation.
//!
//! * [`comparisons`] — differences between groups; [`regressions`] — dependence on a number;
//! * [`test_sample`] — the shapes of a test, aligned to one mean.

pub mod comparisons;
pub mod regressions;
pub mod test_sample;
