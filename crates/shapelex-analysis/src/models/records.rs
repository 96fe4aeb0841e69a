//! Results of models as records.

use std::collections::BTreeMap;

use super::design::Contrasts;
use super::exchange::ExchangeKind;
use crate::inference::histogram::ExplainedHistogram;

/// Coefficient of a column of a design.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct CoefficientRecord {
    /// Name of the column.
    pub column: String,
    /// Length of the coefficient in the norm of the shapes; null if the column is left out.
    pub norm: Option<f64>,
    /// Change of the modelled number for one unit of the column.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub value: Option<f64>,
    /// Displacements of the control points for one unit of the column, in the frame of the mean.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub shape: Option<Vec<Vec<f64>>>,
}

/// A value of an attribute at which a shape is predicted.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(untagged))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub enum At {
    /// A number.
    Number(f64),
    /// A level.
    Level(String),
}

/// Analysis of variance of shapes.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct AnovaRecord {
    /// The formula, normalised.
    pub formula: String,
    /// The terms, in the order of the model.
    pub terms: Vec<TermRecord>,
    /// Residuals of the whole model.
    pub residual: ResidualRecord,
    /// Squared distances of the shapes from their mean.
    pub total: TotalRecord,
    /// The design.
    pub design: DesignRecord,
    /// Warnings about the result.
    pub warnings: Vec<String>,
}

/// A term of a model.
#[derive(Debug, Clone, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct TermRecord {
    /// Name of the term.
    pub term: String,
    /// Degrees of freedom: dimensions that it adds to the model that it is compared with.
    #[cfg_attr(feature = "serde", serde(rename = "df"))]
    pub degrees: usize,
    /// Sum of squares.
    pub sum_of_squares: f64,
    /// Sum of squares over the degrees of freedom; null without any.
    pub mean_square: Option<f64>,
    /// Sum of squares over the total.
    pub r_squared: f64,
    /// Sum of squares over itself and the residuals.
    pub partial_eta_squared: f64,
    /// Mean square over that of the error term: a ratio of traces, which has no F distribution. Null without degrees of freedom, and if
    /// nothing is left for the error.
    pub f: Option<f64>,
    /// Effect size: the statistic in standard deviations of its permutations, after a transformation to a normal distribution. It is at
    /// most the root of the number of permutations, and null without them.
    pub z: Option<f64>,
    /// p value `(1 + exceeding)/(1 + permutations)`; null without permutations, and with fewer than 20 distinct exchanges.
    pub p: Option<f64>,
    /// p value of the sum of squares as shapes become many, from the scatter of the residuals alone: of models whose shapes are read as a
    /// stream, without strata. Beside `p`, it tells probabilities that no number of exchanges reaches.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub p_asymptotic: Option<f64>,
    /// Number of exchanges, without the observed one, whose statistic reaches the observed one.
    pub exceeding: usize,
    /// Number of exchanges, without the observed one.
    pub permutations: usize,
    /// Whether all distinct exchanges were made, so that p is exact.
    pub exact: bool,
    /// Units of exchange: all residuals, those within blocks, or whole blocks.
    pub exchange: ExchangeKind,
    /// Number of distinct exchanges; null beyond the range of numbers.
    pub distinct: Option<f64>,
    /// Term whose groups are the error of this one; null for the residuals.
    pub error_term: Option<String>,
    /// Whether the test is one of the averages of the groups of the error term.
    pub collapsed: bool,
    /// p and Z of the ratio of two mean squares whose permutations are drawn apart, as RRPP has them; on request, for terms with an error
    /// term of the model. The ratio has no level.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub rrpp: Option<RatioRecord>,
    /// Columns that the term is a combination of, if it adds no dimension.
    pub aliased_with: Vec<String>,
    /// `partial_eta_squared` of the exchanges: the distribution that the observed value is compared with; null without permutations.
    pub histogram: Option<ExplainedHistogram>,
}

/// A sum of squares over another one; 0 of shapes that do not vary.
pub(crate) fn share(part: f64, whole: f64) -> f64 {
    if whole > 0.0 { (part / whole).clamp(0.0, 1.0) } else { 0.0 }
}

/// The test of a ratio of permuted mean squares.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct RatioRecord {
    /// Effect size.
    pub z: Option<f64>,
    /// p value.
    pub p: f64,
}

/// Residuals of a model.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct ResidualRecord {
    /// Degrees of freedom.
    #[cfg_attr(feature = "serde", serde(rename = "df"))]
    pub degrees: usize,
    /// Sum of squares.
    pub sum_of_squares: f64,
    /// Sum of squares over the degrees of freedom.
    pub mean_square: f64,
    /// Sum of squares over the total.
    pub r_squared: f64,
}

/// Squared distances of shapes from their mean.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct TotalRecord {
    /// Degrees of freedom.
    #[cfg_attr(feature = "serde", serde(rename = "df"))]
    pub degrees: usize,
    /// Sum of squares.
    pub sum_of_squares: f64,
}

/// Design of a model.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct DesignRecord {
    /// Names of all columns.
    pub columns: Vec<String>,
    /// Columns that depend on those before them, and are left out.
    pub dropped: Vec<String>,
    /// Number of the others.
    pub rank: usize,
    /// Coding of factors.
    pub contrasts: Contrasts,
    /// Levels of factors, the first of which is the reference.
    pub levels: BTreeMap<String, Vec<String>>,
}
