//! Images to shapes.

pub(in crate::api) mod contours;
pub(in crate::api) mod prior;
pub(in crate::api) mod segment;
pub(in crate::api) mod sheets;
