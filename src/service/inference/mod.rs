//! Permutation tests on the shapes of a cohort.
//!
//! * [`comparisons`] — differences between groups; [`regressions`] — dependence on a numeric attribute;
//! * [`test_sample`] — shapes of a test, aligned to one mean.

pub mod comparisons;
pub mod regressions;
pub mod test_sample;
