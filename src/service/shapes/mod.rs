//! Use cases that treat each shape of a request by itself.
//!
//! * [`read`] — control points of posted shapes; [`request`] — shapes of a request in their space; [`spaces`] —
//!   prepared spaces;
//! * [`curves`], [`surfaces`], [`subdivisions`] — evaluate, measure, refine;
//! * [`fitting`], [`surface_fitting`], [`subdivision_fitting`] — fit;
//! * [`morph`], [`deform`] — paths between two shapes; deformation by handles; [`overlap`] — overlap of two bodies;
//! * [`generators`] — properties of a generator.

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
