//! Tests of groups and regressions.

pub(in crate::api) mod comparisons;
pub(in crate::api) mod regressions;
