//! Continuous shapes: generators, curves, the Gram operators of their bases, measures and sampling.
//!
//! * [`generator`] — compactly supported functions whose integer shifts span a shape space;
//! * [`representation`] — what a shape is made of, and the prepared [`ShapeSpace`](representation::ShapeSpace) it lives in;
//! * [`curve`] — a closed spline curve as polynomials per half-segment: values, derivatives;
//! * [`measures`] — area, centroid, perimeter, bounding box, orientation;
//! * [`intersection`] — the self-intersection test;
//! * [`resample`] — arc-length sampling of polygons and the canonical start point of a contour.

pub mod curve;
pub mod generator;
pub mod intersection;
pub mod measures;
pub mod representation;
pub mod resample;

use crate::numeric::NumericError;

/// What the geometry can refuse.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum GeometryError {
    /// The poles of a generator leave the admissible domain.
    #[error("generator pole {re} ± {im}i is outside the admissible domain |Re| ≤ 10, |Im| < π")]
    Pole {
        /// Real part.
        re: f64,
        /// Imaginary part.
        im: f64,
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
    /// A numerical failure.
    #[error(transparent)]
    Numeric(#[from] NumericError),
}
