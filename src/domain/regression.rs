//! Result of regressing shapes on an attribute: change of the shape, explained variation, and a permutation test.

use serde::{Deserialize, Serialize};

use super::comparison::TestRecord;
use crate::analysis::alignment::Alignment;
use crate::analysis::correspondence::Mirror;
use crate::analysis::dictionary::content::MeanRecord;
use crate::analysis::rows::Row;
use crate::analysis::transformation::Transformation;

/// Regression of the shapes of a cohort on an attribute.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct ShapeRegression {
    /// Id of the cohort.
    pub cohort: String,
    /// Revision of the cohort that was analysed.
    pub cohort_revision: u64,
    /// Transformation class that was removed.
    pub transformation: Transformation,
    /// Alignment method: projection onto the class, or Procrustes.
    pub alignment: Alignment,
    /// Whether shapes were matched to mirror images.
    pub mirror: Mirror,
    /// Seed of the permutations.
    pub seed: u64,
    /// Attributes within whose values residuals were exchanged.
    pub strata: Vec<String>,
    /// Number of shapes used.
    pub shapes: usize,
    /// Number of shapes left out because a value is missing or not a number.
    pub left_out: usize,
    /// Mean of all shapes; everything is aligned to it.
    pub pooled: MeanRecord,
    /// Values of the attribute.
    pub attribute: AttributeSummary,
    /// Covariates, as used in the regression.
    pub covariates: Vec<CovariateRecord>,
    /// Degrees of freedom of the residuals.
    pub degrees: usize,
    /// Fraction of the squared distances from the average explained by the attribute after the covariates (type III).
    pub r_squared: f64,
    /// Fraction of what the covariates leave unexplained that the attribute explains.
    pub partial_r_squared: f64,
    /// Fraction explained by attribute and covariates together.
    pub model_r_squared: f64,
    /// Pseudo-F of the attribute after the covariates; null if infinite.
    pub pseudo_f: Option<f64>,
    /// Permutation test of the pseudo-F; with covariates, by permutation of residuals (Freedman and Lane).
    pub test: TestRecord,
    /// Weighted arithmetic mean of the aligned shapes: the prediction at the mean of attribute and covariates.
    pub average: Vec<Row>,
    /// Change of the shape per unit of the attribute.
    pub change_per_unit: Vec<Row>,
    /// Change of the shape per standard deviation of the attribute.
    pub change_per_deviation: Vec<Row>,
    /// Shapes predicted at quantiles of the attribute, with the covariates at their mean.
    pub predictions: Vec<Prediction>,
    /// Regression scores, one entry per shape, in the order of the cohort.
    pub scores: Vec<RegressionScore>,
    /// Warnings about the result.
    pub warnings: Vec<String>,
}

/// Summary of the values of an attribute.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct AttributeSummary {
    /// Name of the attribute.
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

/// Covariate of a regression.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct CovariateRecord {
    /// Name of the covariate.
    pub name: String,
    /// Values of a categorical covariate, in order; the first is the reference, each other one takes a column. Null for
    /// numbers.
    pub levels: Option<Vec<String>>,
}

/// Shape predicted at a value of the attribute.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Prediction {
    /// Quantile of the attribute.
    pub quantile: f64,
    /// Value of the attribute.
    pub attribute: f64,
    /// Control points of the predicted shape.
    pub control_points: Vec<Row>,
}

/// Position of a shape along the regression.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct RegressionScore {
    /// Id of the shape.
    pub id: String,
    /// Identifier assigned by the client.
    pub external_id: Option<String>,
    /// Value of the attribute.
    pub attribute: f64,
    /// `⟨y − ȳ, b⟩/‖b‖`: distance that the shape has moved in the direction of the change.
    pub score: f64,
}
