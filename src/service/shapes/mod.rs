//! Use cases that treat each shape of a request by itself, a file per verb. Kinds of shapes are told apart in the geometry
//! crate only.
//!
//! * [`read`] — control points of posted shapes; [`read_points`], [`read_mesh`], [`read_oriented`] — points, meshes, and
//!   points with normals as posted; [`request`] — shapes of a request in their space; [`blocks`] — those of several resolutions;
//!   [`spaces`] — prepared spaces;
//!   [`each`] — parallel work on a list; [`names`], [`outcome`] — names of the
//!   shapes of a request, and values for them or their errors; `directions` — which way closed curves run;
//! * [`evaluate`], [`measure`], [`mesh`], [`draw`] — values, measures, triangle meshes, drawings;
//! * [`fit`], [`resample`], [`idealise`] — shapes from points, meshes and formulas;
//! * [`refine`], [`resize`], [`subdivide`] — other grids of knots; refined meshes and polylines;
//! * [`morph`], [`deform`] — paths between two shapes; deformation by handles; [`overlap`] — overlap of two bodies;
//! * [`warp`] — thin-plate splines between landmarks; [`symmetry`] — planes of a curve;
//! * [`generators`] — generators asked for in a query.

pub mod blocks;
pub mod deform;
pub(crate) mod directions;
pub mod draw;
pub mod each;
pub mod evaluate;
pub mod fit;
pub mod generators;
pub mod idealise;
pub mod measure;
pub mod mesh;
pub mod morph;
pub mod names;
pub mod outcome;
pub mod overlap;
pub mod read;
pub mod read_mesh;
pub mod read_oriented;
pub mod read_points;
pub mod refine;
pub mod request;
pub mod resample;
pub mod resize;
pub mod spaces;
pub mod subdivide;
pub mod symmetry;
pub mod warp;
