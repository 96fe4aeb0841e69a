//! Errors of sliding.

use crate::thin_plate::error::ThinPlateError;

/// Reason why nothing slides.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SlidingError {
    /// No point slides.
    #[error("expected at least one point that slides, got none")]
    NoSliders,
    /// A row of the table that does not fit.
    #[error("{detail}")]
    Row {
        /// Position of the row.
        position: usize,
        /// The expectation, and the value found.
        detail: String,
    },
    /// A surface point that does not fit.
    #[error("{detail}")]
    Surface {
        /// Position in the list.
        position: usize,
        /// The expectation, and the value found.
        detail: String,
    },
    /// A shape without extent.
    #[error("expected a shape of some extent, got one point")]
    NoExtent {
        /// Position of the shape.
        shape: usize,
    },
    /// A slider without a direction.
    #[error("expected neighbours of the sliding point {point} at different places, got them at one")]
    NoDirection {
        /// Position of the shape.
        shape: usize,
        /// The point.
        point: usize,
    },
    /// Two sliders that are at one place in every shape.
    #[error(
        "expected sliding points at different places, got {first} and {second} at one place in every shape"
    )]
    OnePlace {
        /// The first point.
        first: usize,
        /// The second one.
        second: usize,
    },
    /// Displacements that the criterion does not determine.
    #[error("expected more fixed points: all sliding points can move together without bending")]
    Free {
        /// Position of the shape.
        shape: usize,
    },
    /// The consensus has no bending energy.
    #[error("the consensus: {0}")]
    Consensus(ThinPlateError),
    /// The end of the time.
    #[error("the work was cancelled before it finished")]
    Cancelled,
}

impl SlidingError {
    /// The same error of shapes that were worked through in another order: shape `k` is the one at `order[k]`.
    pub(super) fn numbered(self, order: &[usize]) -> Self {
        match self {
            Self::NoExtent { shape } => Self::NoExtent { shape: order[shape] },
            Self::NoDirection { shape, point } => Self::NoDirection { shape: order[shape], point },
            Self::Free { shape } => Self::Free { shape: order[shape] },
            other => other,
        }
    }
}
