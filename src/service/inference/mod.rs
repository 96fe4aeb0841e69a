//! Studies of the shapes of a cohort: permutation tests, at once or as jobs.
//!
//! * [`study`] — request, plan and run of any study; [`sample`] — its shapes, with strata and control points;
//! * [`comparisons`] — differences between groups; [`regressions`] — dependence on a numeric attribute;
//! * [`models`] — linear models by formulas.

pub mod comparisons;
pub mod models;
pub mod regressions;
pub mod sample;
pub mod study;
