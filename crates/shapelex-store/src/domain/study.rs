//! Results of studies of the shapes of a cohort: comparisons of groups, regressions on an attribute, and linear models.

use serde::{Deserialize, Serialize};
use shapelex_analysis::alignment::Alignment;
use shapelex_analysis::correspondence::Mirror;
use shapelex_analysis::inference::records::{GroupComparison, RegressionRecord};
use shapelex_analysis::models::records::ModelRecord;
use shapelex_analysis::models::subspaces::SumType;
use shapelex_analysis::transformation::Transformation;

/// What was studied, and how.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct StudyHeader {
    /// Transformation class that was removed.
    pub transformation: Transformation,
    /// Alignment method: projection onto the class, or Procrustes.
    pub alignment: Alignment,
    /// Whether aligned shapes were moved, at unit size, into the tangent space at their mean; absent in results of earlier versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tangent: Option<bool>,
    /// Whether shapes were matched to mirror images.
    pub mirror: Mirror,
    /// Seed of the random permutations.
    pub seed: u64,
    /// Attributes within whose values labels or residuals were exchanged.
    pub strata: Vec<String>,
    /// Number of shapes used.
    #[serde(rename = "shape_count", alias = "shapes")]
    pub shapes: usize,
    /// Number of shapes left out because a value is missing or not a number.
    pub left_out: usize,
}

/// Comparison of groups of shapes of a cohort.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Comparison {
    /// Id of the cohort.
    pub cohort: String,
    /// Revision of the cohort that was analysed.
    pub cohort_revision: u64,
    /// Unit of the sizes.
    pub length_unit: Option<String>,
    /// What was studied.
    #[serde(flatten)]
    pub header: StudyHeader,
    /// What was found.
    #[serde(flatten)]
    pub found: GroupComparison,
}

/// Regression of the shapes of a cohort on an attribute.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct ShapeRegression {
    /// Id of the cohort.
    pub cohort: String,
    /// Revision of the cohort that was analysed.
    pub cohort_revision: u64,
    /// What was studied.
    #[serde(flatten)]
    pub header: StudyHeader,
    /// What was found.
    #[serde(flatten)]
    pub found: RegressionRecord,
    /// Regression scores, one entry per shape, in the order of the cohort.
    pub scores: Vec<RegressionScore>,
    /// Warnings about the result.
    pub warnings: Vec<String>,
}

/// Position of a shape along the regression.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
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

/// Linear model of the shapes of a cohort.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct ShapeModel {
    /// Id of the cohort.
    pub cohort: String,
    /// Revision of the cohort that was analysed.
    pub cohort_revision: u64,
    /// What was studied.
    #[serde(flatten)]
    pub header: StudyHeader,
    /// Type of the sums of squares.
    #[serde(rename = "type")]
    pub kind: SumType,
    /// What was modelled: `shape`, or an attribute.
    pub response: String,
    /// Attributes whose values are exchanged as blocks, or within which residuals are exchanged.
    pub blocks: Vec<String>,
    /// What was found.
    #[serde(flatten)]
    pub found: ModelRecord,
}
