//! Shapes of a request, each by itself.
//!
//! * [`read`] — posted shapes become control points; [`request`] — the shapes of a request in their space; [`spaces`] — prepared spaces;
//! * [`curves`], [`surfaces`], [`subdivisions`] — evaluate, measure, refine;
//! * [`fitting`], [`surface_fitting`], [`subdivision_fitting`] — fit;
//! * [`morph`], [`deform`] — paths between two shapes; handles that pull at one; [`overlap`] — overlap of two bodies;
//! * [`generators`] — one generator with its properties.

pub mod curves;
pub mod deform;
pub mod fitting;
pub mod generators;
pub mod morph;
pub mod overlap;
pub mod read;
pub mod request;
pub mod spaces;
pub mod subdivision_fitting;
pub mod subdivisions;
pub mod surface_fitting;
pub mod surfaces;
