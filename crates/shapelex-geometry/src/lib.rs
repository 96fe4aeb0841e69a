//! Shape geometry: generators, spline curves, surfaces and meshes, with their inner products, measures and sampling.
//!
//! * [`generator`] — compactly supported functions whose integer shifts span a shape space;
//! * [`knot_line`] — these shifts along one direction, closed or open: inner products, interpolation;
//! * [`representation`] — the kind and size of a shape, and the prepared [`ShapeSpace`](representation::ShapeSpace);
//! * [`capability`] — questions to any shape: values, measures, meshes, fits, refinements;
//! * [`curve`] — a spline curve, closed or open, as polynomials per half-segment: values, derivatives;
//! * [`open`] — the basis of open curves: phantom control points beyond the ends, banded inner products;
//! * [`measures`] — area, moments, length, curvature, energies, bounding box, orientation;
//! * [`arc_parameter`] — the parameter of a curve at a fraction of its length;
//! * [`distance`] — distances of two curves, as functions and as sets;
//! * [`frame`] — tangent, normal and curvature at a parameter;
//! * [`intersection`] — the self-intersection test;
//! * [`resample`] — arc-length sampling of polygons and the canonical start point of a contour;
//! * [`sampling`] — points along shapes for comparisons;
//! * [`total_curvature`] — total curvature of a curve;
//! * [`fit`] — least-squares fits of raw contours;
//! * [`refine`] — the same curve on a finer grid; [`resolution`] — shapes with blocks of finer control points;
//! * [`deformation`] — edits by moved control points or handles; [`influence`] — where a control point moves a shape;
//! * [`surface`] — tensor-product surfaces;
//! * [`subdivision`] — subdivision surfaces;
//! * [`mesh`] — triangle meshes; [`quality`] — defects of meshes; [`mesh_tree`] — nearest points on a mesh;
//!   [`vector`] — vectors in space;
//! * [`raster`] — the cells of a grid inside a shape, and the overlap of two such sets; [`overlap`] — that of two bodies;
//! * [`size`] — volume, area, length of any shape; [`drawing`] — drawings as SVG;
//! * [`ideal`] — idealised curves, reproduced exactly where the poles allow.
//!
//! The termination bound of every loop is listed in `docs/limits.md`, in one table for all numerical layers.
//!
//! # Example
//!
//! The curve through eight points of a circle is the circle, as the trigonometric generator reproduces it:
//!
//! ```
//! use std::f64::consts::TAU;
//!
//! use shapelex_geometry::curve::Curve;
//! use shapelex_geometry::generator::GeneratorKind;
//! use shapelex_geometry::measures::CurveMeasures;
//! use shapelex_geometry::representation::{Representation, ShapeSpace};
//! use shapelex_numeric::dense::Matrix;
//!
//! let generator = GeneratorKind::Trigonometric {};
//! let space = ShapeSpace::new(&Representation::ClosedCurve { dimension: 2, control_points: 8, generator })?;
//! let points = Matrix::from_fn(8, 2, |k, c| (TAU * (k as f64 / 8.0 - c as f64 / 4.0)).cos());
//! let curve = Curve::of(&space, &space.interpolate(points)?).expect("the space is one of curves");
//! assert!((CurveMeasures::of(&curve).length - TAU).abs() < 1e-12);
//! # Ok::<(), shapelex_geometry::GeometryError>(())
//! ```

mod arc_length;
pub mod arc_parameter;
mod area;
pub mod capability;
mod columns;
mod cone;
pub mod curve;
pub mod deformation;
pub mod distance;
pub mod drawing;
pub mod edge_fault;
pub mod field_fault;
pub mod fit;
pub mod frame;
pub mod generator;
pub mod ideal;
pub mod influence;
pub mod intersection;
pub mod knot_line;
pub mod measures;
pub mod mesh;
pub mod mesh_tree;
pub mod open;
pub mod overlap;
pub mod quality;
pub mod raster;
pub mod refine;
pub mod reparametrisation;
pub mod representation;
pub mod resample;
pub mod resolution;
pub mod rotation;
pub mod sampling;
pub mod size;
mod stretches;
pub mod subdivision;
pub mod surface;
pub mod texture;
pub mod total_curvature;
pub mod vector;

use shapelex_numeric::NumericError;

/// Errors of the geometry layer.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum GeometryError {
    /// The poles of a generator leave the admissible domain.
    #[error("the poles ±({}) are outside the admissible domain |Re| ≤ 10, |Im| < π, where the shifts are a Riesz \
             basis and interpolators exist", complex((*re, *im)))]
    Pole {
        /// Real part.
        re: f64,
        /// Imaginary part.
        im: f64,
    },
    /// A pole lacks its conjugate or its negative.
    #[error("the pole {} lacks its partner {}: lists must be symmetric and closed under conjugation", complex(*pole), complex(*missing))]
    Unpaired {
        /// Position in the list.
        index: usize,
        /// The pole.
        pole: (f64, f64),
        /// The missing partner.
        missing: (f64, f64),
    },
    /// The interpolation conditions have no stable solution.
    #[error(
        "the interpolation conditions have no stable solution in double-double arithmetic: too many poles, a support too long, weights too large, or the poles ±({}) too near |Im| = π or |Re| = 10",
        complex((*re, *im))
    )]
    Unsolvable {
        /// Real part of the pole nearest to the border.
        re: f64,
        /// Imaginary part.
        im: f64,
    },
    /// A parameter is out of range, or not larger than the previous one.
    #[error(
        "expected parameters that increase strictly within [0, 1], without 1 on closed curves, got {value}"
    )]
    Parameter {
        /// Position.
        index: usize,
        /// The parameter.
        value: f64,
    },
    /// The points leave gaps in which the curve is not determined.
    #[error(
        "{points} points do not determine {needed} control points, because gaps between them are longer than the \
         distance of the knots: use fewer control points, or more points"
    )]
    Undetermined {
        /// Number of points given.
        points: usize,
        /// Number of control points.
        needed: usize,
    },
    /// No number of control points reaches the tolerance.
    #[error(
        "no fit reaches the tolerance {}: the best residual is {residual:.3e} with {count} of at most {most} control points or intervals",
        number(*tolerance)
    )]
    Tolerance {
        /// Requested tolerance.
        tolerance: f64,
        /// Best residual.
        residual: f64,
        /// Number of control points or intervals that reached it.
        count: usize,
        /// Largest number tried.
        most: usize,
    },
    /// The operation needs a curve, and landmarks have none.
    #[error("landmarks are points without a curve")]
    NotACurve,
    /// The shifts of a generator are dependent to working precision.
    #[error(
        "the {size} shifts of the generator are dependent to working precision (smallest eigenvalue or pivot \
         {smallest:.1e}): use fewer poles, or poles nearer to 0"
    )]
    Dependent {
        /// Number of shifts.
        size: usize,
        /// The smallest eigenvalue or pivot, which should be positive.
        smallest: f64,
    },
    /// Too few points for the operation.
    #[error("too few points: expected at least {needed}, got {found}")]
    TooFewPoints {
        /// Number of points given.
        found: usize,
        /// Number of points needed.
        needed: usize,
    },
    /// Too few points remain without those that are equal to their predecessor.
    #[error(
        "too few points: expected at least {needed} that differ from their predecessor, got {found} and {repeated} \
         repeated"
    )]
    TooFewDistinctPoints {
        /// Number of points that remain.
        found: usize,
        /// Number of points needed.
        needed: usize,
        /// Number of repeated points.
        repeated: usize,
    },
    /// The contour has no extent.
    #[error("all points coincide (extent {extent:.1e}): the contour has no length")]
    NoLength {
        /// Largest coordinate range.
        extent: f64,
    },
    /// All points of a shape coincide.
    #[error("all {points} points coincide: extent {extent:.1e} at coordinates up to {largest:.1e}")]
    NoExtent {
        /// Number of points.
        points: usize,
        /// Largest coordinate range.
        extent: f64,
        /// Largest magnitude of a coordinate.
        largest: f64,
    },
    /// Two consecutive points are equal.
    #[error("points {first} and {second} are equal: arc length cannot tell them apart")]
    RepeatedPoint {
        /// Position of the first.
        first: usize,
        /// Position of the second.
        second: usize,
    },
    /// The parts of a surface are inconsistent.
    #[error("{field}: {detail}")]
    Surface {
        /// The part.
        field: &'static str,
        /// The reason.
        detail: String,
    },
    /// A generator has no two-scale relation to the finer grid.
    #[error(
        "expected generators that are refined exactly: bspline, exponential, and half_integer_shifts by even factors, got {generator} by {factor}"
    )]
    NotRefined {
        /// Name of the generator.
        generator: &'static str,
        /// Factor along its direction.
        factor: usize,
    },
    /// A surface is another one on the finer grid, although its generators have two-scale relations.
    #[error("{expected}, got the factors {factors:?}")]
    NoRelation {
        /// Requirement of the relation.
        expected: &'static str,
        /// Factors, one per direction.
        factors: Vec<usize>,
    },
    /// The handles contradict each other.
    #[error(
        "the {count} handles do not determine a deformation: two of them are at the same place, or there are \
         more handles than control points near them"
    )]
    Handles {
        /// Number of handles.
        count: usize,
    },
    /// A mesh is not a closed surface.
    #[error(transparent)]
    Mesh(#[from] mesh::MeshError),
    /// A mesh has a positive genus.
    #[error(
        "expected a mesh with the topology of a sphere, for longitude and colatitude, got one with {genus} \
         handles: of label volumes, the option fill fills them"
    )]
    NotASphere {
        /// Number of handles.
        genus: usize,
    },
    /// Two vertices cannot serve as poles.
    #[error("expected poles at two different vertices that are not neighbours, got {} and {} of {count}", poles[0], poles[1])]
    Poles {
        /// The requested poles.
        poles: [u32; 2],
        /// Number of vertices.
        count: usize,
    },
    /// A subdivision scheme has no rule for a vertex.
    #[error(
        "vertex {vertex} has {valence} neighbours: BLOB has rules for four and six only. Split the mesh \
         accordingly, or use the scheme loop"
    )]
    Valence {
        /// The vertex.
        vertex: u32,
        /// Number of its neighbours.
        valence: usize,
    },
    /// A subdivision scheme is not linear.
    #[error(
        "the scheme normal_based is not linear: shapes made of its points and normals have no mean, no inner \
         product and no components. Use blob, loop or butterfly for statistics. Shapes of normal_based can be \
         evaluated, drawn, morphed and deformed"
    )]
    NotLinear,
    /// Positions at the control vertices do not determine the control points.
    #[error(
        "the positions of the {size} control vertices at this level do not determine the control points: give \
         control_points instead"
    )]
    NoInterpolation {
        /// Number of control vertices.
        size: usize,
    },
    /// The normal-based scheme cannot split an edge.
    #[error("the edge from vertex {} to vertex {} of level {level} cannot be split: {fault}", edge[0], edge[1])]
    Edge {
        /// The level.
        level: usize,
        /// The ends of the edge.
        edge: [u32; 2],
        /// The reason.
        fault: edge_fault::EdgeFault,
    },
    /// A refined mesh has more vertices than the limit.
    #[error("level {level} has {} vertices, expected at most {most}", count(*vertices))]
    TooFine {
        /// The level.
        level: usize,
        /// Number of vertices at that level.
        vertices: usize,
        /// The limit.
        most: usize,
    },
    /// No level within the limit on vertices is close enough to the limit surface.
    #[error("no level with at most {most} vertices reaches the tolerance {}: level {level} still changes by \
             {change:.3e}", number(*tolerance))]
    Coarse {
        /// Requested tolerance.
        tolerance: f64,
        /// The last level.
        level: usize,
        /// Largest distance of its vertices from the edges of the previous level.
        change: f64,
        /// Maximum number of vertices.
        most: usize,
    },
    /// An iteration did not converge.
    #[error("no convergence after {iterations} iterations: relative residual {residual:.1e}")]
    NoConvergence {
        /// Number of iterations.
        iterations: usize,
        /// Relative residual.
        residual: f64,
    },
    /// An error of the numerical layer.
    #[error(transparent)]
    Numeric(#[from] NumericError),
}

/// `a + bi`, without zero parts.
fn complex((re, im): (f64, f64)) -> String {
    match (re, im) {
        (re, 0.0) => number(re),
        (0.0, im) => format!("{}i", number(im)),
        (re, im) => format!("{}{}{}i", number(re), if im < 0.0 { "" } else { "+" }, number(im)),
    }
}

/// A number of things, with two significant digits from 10⁹ on.
fn count(value: usize) -> String {
    if value < 1_000_000_000 { value.to_string() } else { format!("{:.1e}", value as f64) }
}

/// The shorter of the plain and the scientific form; plain in doubt.
fn number(value: f64) -> String {
    let (plain, scientific) = (format!("{value}"), format!("{value:e}"));
    if plain.len() > scientific.len() + 5 { scientific } else { plain }
}

/// The examples of the README are tests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
