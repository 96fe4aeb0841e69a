//! Tests of groups, regressions and linear models.

pub(in crate::api) mod comparisons;
pub(in crate::api) mod models;
pub(in crate::api) mod regressions;
