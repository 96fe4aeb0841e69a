//! What the regression of shapes on an attribute has found.

use serde::{Deserialize, Serialize};

use super::comparison::TestRecord;
use super::dictionary::{MeanRecord, Row};
use crate::analysis::alignment::Alignment;
use crate::analysis::correspondence::Mirror;
use crate::analysis::transformation::Transformation;

/// The regression of the shapes of a cohort on an attribute.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct ShapeRegression {
    /// Id of the cohort.
    pub cohort: String,
    /// The revision that was looked at.
    pub cohort_revision: u64,
    /// The class that was removed.
    pub transformation: Transformation,
    /// Projection on the class, or Procrustes fits.
    pub alignment: Alignment,
    /// Whether mirror images were matched.
    pub mirror: Mirror,
    /// Seed of the permutations.
    pub seed: u64,
    /// Attributes within whose values residuals were exchanged.
    pub strata: Vec<String>,
    /// Shapes that were used.
    pub shapes: usize,
    /// Shapes that were left out because a value is missing or no number.
    pub left_out: usize,
    /// The mean of all shapes: everything is aligned to it.
    pub pooled: MeanRecord,
    /// The attribute.
    pub attribute: AttributeSummary,
    /// The covariates, as they came into the regression.
    pub covariates: Vec<CovariateRecord>,
    /// Degrees of freedom that are left to the residuals.
    pub degrees: usize,
    /// Part of the squared distances from the average that the attribute explains after the covariates (type III).
    pub r_squared: f64,
    /// The same part of what the covariates leave.
    pub partial_r_squared: f64,
    /// Part that attribute and covariates explain together.
    pub model_r_squared: f64,
    /// Pseudo-F of the attribute after the covariates; null where it is infinite.
    pub pseudo_f: Option<f64>,
    /// Its test; with covariates by the permutation of residuals (Freedman and Lane).
    pub test: TestRecord,
    /// Weighted arithmetic mean of the aligned shapes: the prediction at the mean of attribute and covariates.
    pub average: Vec<Row>,
    /// Change of the shape for one unit of the attribute.
    pub change_per_unit: Vec<Row>,
    /// Change of the shape for one standard deviation of the attribute.
    pub change_per_deviation: Vec<Row>,
    /// Shapes predicted at quantiles of the attribute, the covariates at their mean.
    pub predictions: Vec<Prediction>,
    /// One a shape, in the order of the cohort.
    pub scores: Vec<RegressionScore>,
    /// What a reader of the result should know.
    pub warnings: Vec<String>,
}

/// The values of an attribute.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct AttributeSummary {
    /// Its name.
    pub name: String,
    /// Weighted mean.
    pub mean: f64,
    /// Standard deviation, `√(n/(n−1) · Σw(a − ā)²/Σw)`.
    pub deviation: f64,
    /// Smallest value.
    pub smallest: f64,
    /// Largest value.
    pub largest: f64,
}

/// A covariate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct CovariateRecord {
    /// Its name.
    pub name: String,
    /// The values of a categorical one, in their order; the first is the reference, every other one a column. Null for
    /// numbers.
    pub levels: Option<Vec<String>>,
}

/// A predicted shape.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Prediction {
    /// Which quantile of the attribute.
    pub quantile: f64,
    /// Its value.
    pub attribute: f64,
    /// The shape.
    pub control_points: Vec<Row>,
}

/// The place of a shape along the dependence.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct RegressionScore {
    /// Id of the shape.
    pub id: String,
    /// The client's own id.
    pub external_id: Option<String>,
    /// The attribute.
    pub attribute: f64,
    /// `⟨y − ȳ, b⟩/‖b‖`: how far the shape has gone in the direction of the change.
    pub score: f64,
}
