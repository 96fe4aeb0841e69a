//! Capabilities: questions that every kind of shape can be asked.
//!
//! Layers above ask [`Representation`](crate::representation::Representation) and
//! [`ShapeSpace`](crate::representation::ShapeSpace); only this crate tells kinds apart.
//!
//! * [`domain`] — names of places on a shape; limits of a representation; its faults;
//! * [`place`] — places of curves, surfaces and landmarks, and the points there;
//! * [`sample`] — values, derivatives and frames at places;
//! * [`tessellate`] — triangle meshes;
//! * [`measure`] — lengths, areas, volumes, distances to a reference;
//! * [`fit`] — least-squares fits to points and meshes;
//! * [`refine`] — the same shape on a finer or another grid of knots;
//! * [`deform`] — places of handles, the change of a deformation, moved points and normals;
//! * [`idealise`] — control points of idealised shapes; [`interpolate`] — grids of points that determine a surface;
//! * [`fourier`] — curves given by Fourier coefficients; [`enclose`] — boundaries of regions, and those that fill a box;
//! * [`generator`] — properties of a generator, and its graph.

pub mod deform;
pub mod domain;
pub mod enclose;
pub mod fit;
pub mod fourier;
pub mod generator;
pub mod idealise;
pub mod interpolate;
pub mod measure;
pub mod place;
pub mod refine;
pub mod sample;
pub mod tessellate;
