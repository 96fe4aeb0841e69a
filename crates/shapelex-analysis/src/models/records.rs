//! Results of models as records.

use std::collections::BTreeMap;

use super::design::Contrasts;
use super::exchange::ExchangeKind;
use super::study::At;
use crate::inference::histogram::ExplainedHistogram;
use crate::mean_record::MeanRecord;

/// A linear model of shapes.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct ModelRecord {
    /// The table.
    #[cfg_attr(feature = "serde", serde(flatten))]
    pub anova: AnovaRecord,
    /// Mean of all shapes, computed without knowledge of the model, to which they are aligned; null if numbers are modelled.
    pub pooled: Option<MeanRecord>,
    /// Coefficients of the columns of the design.
    pub coefficients: Vec<CoefficientRecord>,
    /// Predicted shapes, or numbers.
    pub predictions: Vec<PredictionRecord>,
}

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

/// What a model predicts at values of its attributes.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct PredictionRecord {
    /// The values. Numbers that are not given are at their mean, and shapes are averaged over other factors as they occur.
    pub at: BTreeMap<String, At>,
    /// Predicted number.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub value: Option<f64>,
    /// Predicted control points, in the frame of the mean.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub shape: Option<Vec<Vec<f64>>>,
    /// Leverage: variance of the prediction, over that of a residual.
    pub leverage: f64,
    /// Whether a number lies outside of the values of the shapes.
    pub extrapolated: bool,
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
    /// Number of exchanges, without the observed one, whose statistic reaches the observed one.
    pub exceeding: usize,
    /// Number of exchanges, without the observed one.
    pub permutations: usize,
    /// Whether all distinct exchanges were made, so that p is exact.
    pub exact: bool,
    /// What was exchanged: all residuals, those within blocks, or whole blocks.
    pub exchange: ExchangeKind,
    /// Number of distinct exchanges; null beyond the range of numbers.
    pub distinct: Option<f64>,
    /// Term whose groups are the error of this one; null for the residuals.
    pub error_term: Option<String>,
    /// Whether the test is one of the averages of the groups of the error term.
    pub collapsed: bool,
    /// Columns that the term is a combination of, if it adds no dimension.
    pub aliased_with: Vec<String>,
    /// `partial_eta_squared` of the exchanges: the distribution that the observed value is compared with; null without permutations.
    pub histogram: Option<ExplainedHistogram>,
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
