//! Errors of blocks and modules.

use crate::AnalysisError;
use crate::inference::error::StudyError;
use shapelex_geometry::GeometryError;

/// Reason why there is no result.
#[derive(Debug, PartialEq, thiserror::Error)]
pub enum BlocksError {
    /// Too few subjects for a correlation that is not one by necessity.
    #[error("expected at least {needed} shapes, got {found}")]
    FewSubjects {
        /// Number of shapes.
        found: usize,
        /// Number needed.
        needed: usize,
    },
    /// A block without variation.
    #[error("expected numbers that vary in '{name}', got the same for all shapes")]
    Constant {
        /// Position of the block.
        block: usize,
        /// Its name, or that of the label.
        name: String,
    },
    /// Modules that cannot be exchanged.
    #[error("{0}")]
    Exchange(&'static str),
    /// A part of too few points.
    #[error(transparent)]
    Geometry(#[from] GeometryError),
    /// A failure of the alignment of a part.
    #[error(transparent)]
    Study(#[from] StudyError),
    /// A failure of an eigenproblem, or the end of the time.
    #[error(transparent)]
    Analysis(#[from] AnalysisError),
}
