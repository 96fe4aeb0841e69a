//! Tests of groups, regressions, linear models, repeatability, blocks, modules and symmetry.

pub(in crate::api) mod blocks;
pub(in crate::api) mod comparisons;
pub(in crate::api) mod model_comparisons;
pub(in crate::api) mod models;
pub(in crate::api) mod predictions;
pub(in crate::api) mod regressions;
pub(in crate::api) mod repeatability;
pub(in crate::api) mod symmetry;
