//! Errors of studies of symmetry.

use crate::AnalysisError;
use crate::models::error::ModelError;

/// Fewest individuals: with fewer, nothing is left for the error of the sides.
pub const MIN_INDIVIDUALS: usize = 3;

/// Reason why there is no result.
#[derive(Debug, PartialEq, thiserror::Error)]
pub enum SymmetryError {
    /// Pairs with shapes whose parameter is reversed.
    #[error("expected no pairs with shapes whose parameter is reversed, got {found}")]
    PairsOfCurve {
        /// Number of pairs.
        found: usize,
    },
    /// No pairs of points without a direction.
    #[error("expected at least one pair of points that change places, got none")]
    NoPairs,
    /// A point that is not there, or that has two partners.
    #[error("expected different points below {size}, got [{first}, {second}]", first = pair[0], second = pair[1])]
    Pair {
        /// Position of the pair.
        position: usize,
        /// The pair.
        pair: [usize; 2],
        /// Number of points.
        size: usize,
    },
    /// A relabelling that changes distances.
    #[error(
        "expected points that change places without a change of the metric, got a shape that is not its own image"
    )]
    NotAnIsometry,
    /// An individual of which one side is missing.
    #[error("expected both sides of every individual, got one of '{name}'")]
    OneSided {
        /// Name of the individual.
        name: String,
    },
    /// Too few individuals.
    #[error("expected at least {MIN_INDIVIDUALS} individuals, got {found}")]
    FewIndividuals {
        /// Number of individuals.
        found: usize,
    },
    /// A shape without extent.
    #[error("expected a shape of some extent, got one point")]
    NoExtent,
    /// A failure of the table.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// A failure of an eigenproblem, or the end of the time.
    #[error(transparent)]
    Analysis(#[from] AnalysisError),
}
