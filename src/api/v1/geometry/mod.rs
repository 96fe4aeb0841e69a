//! Geometry of the shapes of one request: curves, fits, refinement, morphs, warps.

pub(in crate::api) mod catalogue;
pub(in crate::api) mod curves;
pub(in crate::api) mod deform;
pub(in crate::api) mod fitting;
pub(in crate::api) mod morph;
pub(in crate::api) mod overlap;
pub(in crate::api) mod refine;
pub(in crate::api) mod subdivision;
pub(in crate::api) mod warp;
