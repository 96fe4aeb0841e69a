//! Errors of models.

use super::design::{MAX_COLUMNS, MAX_LEVELS};
use super::formula::FormulaError;
use crate::AnalysisError;

/// Reason why there is no model.
#[derive(Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ModelError {
    /// The text is no formula.
    #[error(transparent)]
    Formula(#[from] FormulaError),
    /// A formula has nothing to test.
    #[error("expected a formula with at least one term, got none")]
    NoTerms,
    /// A variable that the shapes have not.
    #[error("expected attributes of the shapes in the formula, got '{name}'")]
    UnknownVariable {
        /// Name of the attribute.
        name: String,
    },
    /// Attributes of different numbers of shapes.
    #[error("expected {expected} values of '{name}', one for each shape, got {found}")]
    Lengths {
        /// Name of the attribute.
        name: String,
        /// Number of its values.
        found: usize,
        /// Number of shapes.
        expected: usize,
    },
    /// A function of texts.
    #[error("expected numbers for '{name}', got texts")]
    NotNumeric {
        /// The variable.
        name: String,
    },
    /// A value without a value of the function.
    #[error("expected {expected} for '{name}', got {value:e} at shape {shape}")]
    Domain {
        /// The variable.
        name: String,
        /// Values that it may have.
        expected: &'static str,
        /// The value.
        value: f64,
        /// Position of the shape.
        shape: usize,
    },
    /// A factor of one level.
    #[error("expected a factor of at least two levels, got one for '{name}': {level}")]
    OneLevel {
        /// The variable.
        name: String,
        /// Its level.
        level: String,
    },
    /// A number that does not vary.
    #[error("expected numbers that vary for '{name}', got {value} for all shapes")]
    Constant {
        /// The variable.
        name: String,
        /// Its value.
        value: f64,
    },
    /// A level that the given list has not.
    #[error("expected the given levels for '{name}', got '{level}' at shape {shape}")]
    UnknownLevel {
        /// The variable.
        name: String,
        /// The level.
        level: String,
        /// Position of the shape.
        shape: usize,
    },
    /// A factor of too many levels.
    #[error("expected at most {MAX_LEVELS} levels, got {found} for '{name}'")]
    ManyLevels {
        /// The variable.
        name: String,
        /// Number of its levels.
        found: usize,
    },
    /// A polynomial of a degree that the values do not determine.
    #[error("expected more than {degree} different values for '{name}', got {found}")]
    FewValues {
        /// The variable.
        name: String,
        /// Degree of the polynomial.
        degree: u32,
        /// Number of different values.
        found: usize,
    },
    /// Too many columns.
    #[error("expected at most {MAX_COLUMNS} columns of the design, got {found}")]
    ManyColumns {
        /// Number of columns.
        found: usize,
    },
    /// No degree of freedom is left.
    #[error(
        "expected at least {needed} shapes for a design of rank {rank}, got {found}: no degree of freedom is left"
    )]
    FewShapes {
        /// Number of shapes.
        found: usize,
        /// Number needed.
        needed: usize,
        /// Rank of the design.
        rank: usize,
    },
    /// Sums of squares of type III of a design with dropped columns.
    #[error(
        "expected shapes in every combination of levels for type III, got none for {columns}: ask for type II"
    )]
    EmptyCells {
        /// Names of the columns.
        columns: String,
    },
    /// Collinear columns that are not to be dropped.
    #[error("expected columns that are linearly independent, got {columns} as combinations of others")]
    Collinear {
        /// Names of the columns.
        columns: String,
    },
    /// Blocks that cannot be exchanged.
    #[error("expected blocks of equal size to exchange, got sizes that all differ: {sizes}")]
    UnequalBlocks {
        /// The sizes.
        sizes: String,
    },
    /// An error term that the model has not, or that does not contain its term.
    #[error("expected a term of the model that contains '{term}' as its error term, got '{error}'")]
    NoErrorTerm {
        /// The tested term.
        term: String,
        /// The error term.
        error: String,
    },
    /// A place of a prediction that the model has not.
    #[error("expected {detail}, got another value of '{name}'")]
    UnknownPlace {
        /// Position of the prediction.
        place: usize,
        /// Name of the attribute.
        name: String,
        /// The expected values.
        detail: String,
    },
    /// Values of a prediction that the shapes do not determine.
    #[error(
        "expected values that the shapes determine, got others, for which {column} cannot be told from other columns"
    )]
    Undetermined {
        /// Position of the prediction.
        place: usize,
        /// Column of the design that the shapes do not tell apart from others, though these values do.
        column: String,
    },
    /// Type III of an interaction with a number that is never near zero.
    #[error(
        "expected values on both sides of zero for '{name}', got {least} to {most}: type III tests the other variables of its          interactions where it is zero; subtract a value, or ask for type II"
    )]
    FarFromZero {
        /// The variable.
        name: String,
        /// Its least value.
        least: f64,
        /// Its largest value.
        most: f64,
    },
    /// Strata that differ between shapes whose average is tested.
    #[error(
        "expected strata that are equal within the groups of {group}, whose averages are exchanged, got several in one"
    )]
    StrataInside {
        /// The error term.
        group: String,
    },
    /// More principal scores than the shapes have.
    #[error("expected at most {most} scores, got {found}")]
    FewScores {
        /// Last score.
        found: usize,
        /// Number of scores.
        most: usize,
    },
    /// Random effects that the shapes do not determine.
    #[error("{detail}")]
    Unidentified {
        /// What was expected, and what was found.
        detail: String,
    },
    /// A covariance of shapes that there is none of.
    #[error("{detail}")]
    Covariance {
        /// What was expected, and what was found.
        detail: String,
    },
    /// A model without multivariate statistics.
    #[error("{detail}")]
    Multivariate {
        /// What was expected, and what was found.
        detail: String,
    },
    /// A setting of pairs, disparity, trajectories, bands or a comparison that does not fit.
    #[error("{detail}")]
    Setting {
        /// Place in the request, such as `pairs/groups`.
        field: &'static str,
        /// What was expected, and found.
        detail: String,
    },
    /// A failure of an eigenproblem, or the end of the time.
    #[error(transparent)]
    Analysis(#[from] AnalysisError),
}
