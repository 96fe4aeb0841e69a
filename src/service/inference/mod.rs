//! Studies of the shapes of a cohort: permutation tests, at once or as jobs.
//!
//! * [`study`] — request, plan and run of any study; [`sample`] — its shapes, with strata and control points;
//! * [`comparisons`] — differences between groups; [`regressions`] — dependence on a numeric attribute;
//! * [`models`] — linear models by formulas; [`repeatability`] — shapes that were taken several times of each subject;
//! * [`blocks`] — blocks that vary together; [`modularity`] — modules; [`symmetry`] — symmetry and asymmetry.

pub mod blocks;
pub mod comparisons;
pub mod models;
pub mod modularity;
pub mod parts;
pub mod regressions;
pub mod repeatability;
pub mod sample;
pub mod study;
pub mod symmetry;
