//! Results of random parts as records.

use super::super::records::CoefficientRecord;
use super::{Criterion, Structure};

/// Random effects of the groups of a model.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct RandomRecord {
    /// The random part, as `(1 | subject)`.
    pub part: String,
    /// Names of the effects of a group.
    pub effects: Vec<String>,
    /// Structure of the covariances.
    pub structure: Structure,
    /// Criterion that was maximised.
    pub method: Criterion,
    /// Number of groups.
    pub groups: usize,
    /// Variances, summed over the coordinates of the shapes.
    pub variance: VarianceRecord,
    /// Part of the groups in the variance; null for several effects, whose variance depends on the values.
    pub icc: Option<f64>,
    /// Whether a covariance of the effects is singular: the shapes then show no scatter of the groups in a direction.
    pub boundary: bool,
    /// Whether the iteration came to rest.
    pub converged: bool,
    /// Logarithm of the maximised likelihood. That of `scalar` treats coordinates as uncorrelated, and compares no models.
    pub log_likelihood: f64,
    /// Number of principal scores; null if all coordinates are used.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub components: Option<usize>,
    /// Part of the scatter of the shapes in these scores.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub explained: Option<f64>,
    /// Variances of each score, for `by_score`.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Vec::is_empty"))]
    pub scores: Vec<ScoreRecord>,
    /// Covariance of the scores of the groups, for `full`.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub between: Option<Vec<Vec<f64>>>,
    /// Covariance of the scores of the residuals, for `full`.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub within: Option<Vec<Vec<f64>>>,
    /// Coefficients of the fixed part by generalised least squares.
    pub coefficients: Vec<CoefficientRecord>,
    /// Shapes of the groups, on request.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Vec::is_empty"))]
    pub subjects: Vec<ConditionalRecord>,
}

/// Variances of groups and residuals, summed over the coordinates of the shapes.
#[derive(Debug, Clone, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct VarianceRecord {
    /// Covariance of the effects of a group.
    pub between: Vec<Vec<f64>>,
    /// Variance of a residual.
    pub within: f64,
}

/// Variances of a principal score.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct ScoreRecord {
    /// Covariance of the effects of a group.
    pub between: Vec<Vec<f64>>,
    /// Variance of a residual.
    pub within: f64,
    /// Whether the covariance is singular.
    pub boundary: bool,
    /// Logarithm of the maximised likelihood.
    pub log_likelihood: f64,
}

/// Shape of a group, given all shapes: the fixed part with the expected effects of the group.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct ConditionalRecord {
    /// Value of the group.
    pub group: String,
    /// Number of its shapes.
    pub shapes: usize,
    /// The number at the mean of its values.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub value: Option<f64>,
    /// Control points at the mean of its values, in the frame of the mean.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub shape: Option<Vec<Vec<f64>>>,
    /// Expected effects, as coefficients.
    pub effects: Vec<CoefficientRecord>,
    /// Posterior covariance of the effects, summed over the coordinates of the shapes.
    pub covariance: Vec<Vec<f64>>,
}

impl RandomRecord {
    pub(super) fn new(
        part: &str,
        effects: &[String],
        structure: Structure,
        method: Criterion,
        groups: usize,
    ) -> Self {
        Self {
            part: part.into(),
            effects: effects.to_vec(),
            structure,
            method,
            groups,
            variance: VarianceRecord::default(),
            icc: None,
            boundary: false,
            converged: true,
            log_likelihood: 0.0,
            components: None,
            explained: None,
            scores: Vec::new(),
            between: None,
            within: None,
            coefficients: Vec::new(),
            subjects: Vec::new(),
        }
    }
}
