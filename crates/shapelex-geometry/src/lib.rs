//! Continuous shapes: generators, curves, the Gram operators of their bases, measures and sampling.
//!
//! * [`generator`] — compactly supported functions whose integer shifts span a shape space;
//! * [`mod@line`] — their shifts along one direction, closed or open: inner products, interpolation;
//! * [`representation`] — what a shape is made of, and the prepared [`ShapeSpace`](representation::ShapeSpace) it lives in;
//! * [`curve`] — a spline curve, closed or open, as polynomials per half-segment: values, derivatives;
//! * [`open`] — the basis of open curves: points beyond the ends, banded inner products;
//! * [`measures`] — area, moments, length, curvature, energies, bounding box, orientation;
//! * [`distance`] — distances of two curves, as functions and as sets;
//! * [`frame`] — tangent, normal and curvature at a parameter;
//! * [`intersection`] — the self-intersection test;
//! * [`resample`] — arc-length sampling of polygons and the canonical start point of a contour;
//! * [`sampling`] — places along shapes, where they are compared;
//! * [`turning`] — how much a curve turns;
//! * [`fit`] — least-squares fits of raw contours;
//! * [`refine`] — the same curve on a finer grid;
//! * [`deformation`] — control points moved, handles met;
//! * [`surface`] — tensor-product surfaces;
//! * [`subdivision`] — subdivision surfaces;
//! * [`mesh`] — triangle meshes; [`quality`] — what may be wrong with them; [`nearest`] — the nearest point on one; [`vector`] — vectors of space;
//! * [`raster`] — which cells of a grid are inside of a shape, and how two such sets overlap;
//! * [`ideal`] — idealised curves, reproduced exactly where the poles allow.
//!
//! What ends each loop stands in one table for all layers of arithmetic, `docs/limits.md`.

pub mod curve;
pub mod deformation;
pub mod distance;
pub mod fit;
pub mod frame;
pub mod generator;
pub mod ideal;
pub mod intersection;
pub mod line;
pub mod measures;
pub mod mesh;
pub mod nearest;
pub mod open;
pub mod quality;
pub mod raster;
pub mod refine;
pub mod representation;
pub mod resample;
pub mod sampling;
pub mod subdivision;
pub mod surface;
pub mod turning;
pub mod vector;

use shapelex_numeric::NumericError;

/// What the geometry can refuse.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum GeometryError {
    /// The poles of a generator leave the admissible domain.
    #[error("the pair of poles ±({}) is outside the admissible domain |Re| ≤ 10, |Im| < π, where the shifts are a Riesz basis and interpolators exist", complex((*re, *im)))]
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
        /// What is missing.
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
    /// A parameter is out of range, or not larger than the one before.
    #[error("is {value}: parameters must increase strictly within [0, 1], without 1 on closed curves")]
    Parameter {
        /// Position.
        index: usize,
        /// The parameter.
        value: f64,
    },
    /// The points leave gaps in which nothing determines the curve.
    #[error(
        "{points} points do not determine {needed} control points: they leave gaps longer than the distance of the knots; take fewer control points, or more points"
    )]
    Undetermined {
        /// Points given.
        points: usize,
        /// Control points.
        needed: usize,
    },
    /// No number of control points reaches the tolerance.
    #[error(
        "no fit reaches the tolerance {}: the best residual is {residual:.3e} with {count} of at most {most} control points or intervals",
        number(*tolerance)
    )]
    Tolerance {
        /// Wanted.
        tolerance: f64,
        /// Best residual.
        residual: f64,
        /// Where it was reached.
        count: usize,
        /// Largest number tried.
        most: usize,
    },
    /// Landmarks have no curve.
    #[error("landmarks are points without a curve")]
    NotACurve,
    /// The shifts of a generator are dependent to working precision.
    #[error(
        "the {size} shifts of the generator are dependent to working precision (smallest eigenvalue or pivot {smallest:.1e}): take fewer poles, or poles nearer to 0"
    )]
    Dependent {
        /// Number of shifts.
        size: usize,
        /// What should be positive.
        smallest: f64,
    },
    /// Too few points for the operation.
    #[error("{found} points, at least {needed} are needed")]
    TooFewPoints {
        /// Points given.
        found: usize,
        /// Points needed.
        needed: usize,
    },
    /// The contour has no extent.
    #[error("all {points} points coincide (extent {extent:.1e}): the contour has no length")]
    NoLength {
        /// Points given.
        points: usize,
        /// Largest coordinate range.
        extent: f64,
    },
    /// Two consecutive points are equal.
    #[error("points {first} and {second} are equal: arc length does not tell them apart")]
    RepeatedPoint {
        /// Position of the first.
        first: usize,
        /// Position of the second.
        second: usize,
    },
    /// The parts of a surface do not fit together.
    #[error("{field} {detail}")]
    Surface {
        /// Which part.
        field: &'static str,
        /// Why.
        detail: String,
    },
    /// Handles contradict one another.
    #[error(
        "the {count} handles do not determine a deformation: two of them are at one place, or there are more than control points near them"
    )]
    Handles {
        /// How many there are.
        count: usize,
    },
    /// A mesh is no closed surface.
    #[error(transparent)]
    Mesh(#[from] mesh::MeshError),
    /// A mesh has handles.
    #[error("the mesh has {genus} handles: longitude and colatitude need a surface like a sphere")]
    NotASphere {
        /// Their number.
        genus: usize,
    },
    /// Two vertices cannot be poles.
    #[error("the poles are vertices {} and {} of {count}: they must be different and not neighbours", poles[0], poles[1])]
    Poles {
        /// What was asked for.
        poles: [u32; 2],
        /// Vertices that there are.
        count: usize,
    },
    /// A scheme has no rules for a vertex.
    #[error(
        "vertex {vertex} has {valence} neighbours: BLOB has rules for four and six; split the mesh so, or use the scheme loop"
    )]
    Valence {
        /// The vertex.
        vertex: u32,
        /// Its neighbours.
        valence: usize,
    },
    /// A scheme that is no linear map.
    #[error(
        "the scheme normal_based is not linear: shapes made of its points and normals have no mean, no inner product and no \
         components. Take blob, loop or butterfly for statistics; the shapes can be evaluated, drawn and morphed"
    )]
    NotLinear,
    /// Positions at control vertices that do not determine these.
    #[error(
        "the positions of the {size} control vertices at this level do not determine them: give control_points instead"
    )]
    NoInterpolation {
        /// Control vertices.
        size: usize,
    },
    /// An edge that the normal-based scheme cannot split.
    #[error("the edge from vertex {} to vertex {} of level {level} has no point between: {fault}", edge[0], edge[1])]
    Edge {
        /// The level.
        level: usize,
        /// Its ends.
        edge: [u32; 2],
        /// Why.
        fault: subdivision::normal_based::EdgeFault,
    },
    /// A mesh with more vertices than are accepted.
    #[error("level {level} has {} vertices, at most {most} are accepted", count(*vertices))]
    TooFine {
        /// The level.
        level: usize,
        /// Vertices there.
        vertices: usize,
        /// The limit.
        most: usize,
    },
    /// No level within the limits is near enough to its limit.
    #[error("no level with at most {most} vertices reaches the tolerance {}: level {level} still moves by {change:.3e}", number(*tolerance))]
    Coarse {
        /// Wanted.
        tolerance: f64,
        /// The last level.
        level: usize,
        /// How far its vertices are from the edges of the level before.
        change: f64,
        /// The limit.
        most: usize,
    },
    /// An iteration did not end.
    #[error("no convergence after {iterations} iterations: relative residual {residual:.1e}")]
    NoConvergence {
        /// Iterations done.
        iterations: usize,
        /// Relative residual.
        residual: f64,
    },
    /// A numerical failure.
    #[error(transparent)]
    Numeric(#[from] NumericError),
}

/// `a + bi`, without a part that is zero.
fn complex((re, im): (f64, f64)) -> String {
    match (re, im) {
        (re, 0.0) => number(re),
        (0.0, im) => format!("{}i", number(im)),
        (re, im) => format!("{}{}{}i", number(re), if im < 0.0 { "" } else { "+" }, number(im)),
    }
}

/// A number of things; what nobody counts any more with one digit behind the point.
fn count(value: usize) -> String {
    if value < 1_000_000_000 { value.to_string() } else { format!("{:.1e}", value as f64) }
}

/// The shorter of `1000` and `1e3`, plain ones first.
fn number(value: f64) -> String {
    let (plain, scientific) = (format!("{value}"), format!("{value:e}"));
    if plain.len() > scientific.len() + 5 { scientific } else { plain }
}
