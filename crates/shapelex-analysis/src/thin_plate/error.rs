//! Errors of thin-plate splines.

use shapelex_numeric::NumericError;

/// Distance of two landmarks, as a part of the size, from which they differ: its square is that of a unit's last digit.
pub const COINCIDENT: f64 = 1e-8;
/// Smallest extent of landmarks in any direction, as a part of the largest.
pub const FLAT: f64 = 1e-10;

/// Reason why landmarks have no thin-plate spline.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ThinPlateError {
    /// Fewer landmarks than an affine map needs.
    #[error("expected at least {needed} landmarks, got {found}")]
    TooFew {
        /// Number of landmarks.
        found: usize,
        /// Number needed.
        needed: usize,
    },
    /// Two landmarks at one place.
    #[error("expected landmarks at different places, got {first} and {second} at one")]
    Coincident {
        /// Position of the first landmark.
        first: usize,
        /// Position of the second one.
        second: usize,
    },
    /// Landmarks on one line or plane.
    #[error(
        "expected landmarks that are not on one {}, got an extent of {extent:.1e} of the largest in one direction",
        if *dimension == 2 { "line" } else { "plane" }
    )]
    Flat {
        /// `d`.
        dimension: usize,
        /// Smallest extent, divided by the largest.
        extent: f64,
    },
    /// Landmarks so near each other that rounding hides their bending.
    #[error("expected landmarks farther apart: their bending is lost in rounding")]
    Numeric(#[from] NumericError),
}
