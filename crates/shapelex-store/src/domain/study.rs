//! Results of studies of the shapes of a cohort: comparisons of groups, regressions on an attribute, linear models, blocks, modules
//! and symmetry.

use serde::{Deserialize, Serialize};
use shapelex_analysis::alignment::Alignment;
use shapelex_analysis::blocks::records::{BlocksRecord, ModularityRecord};
use shapelex_analysis::correspondence::Mirror;
use shapelex_analysis::inference::records::{GroupComparison, RegressionRecord};
use shapelex_analysis::models::outcome::ModelRecord;
use shapelex_analysis::models::repeatability::records::RepeatabilityRecord;
use shapelex_analysis::models::subspaces::SumType;
use shapelex_analysis::symmetry::records::{SymmetryKind, SymmetryRecord};
use shapelex_analysis::transformation::Transformation;

/// Settings of a study.
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
    /// Settings of the study.
    #[serde(flatten)]
    pub header: StudyHeader,
    /// Results.
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
    /// Settings of the study.
    #[serde(flatten)]
    pub header: StudyHeader,
    /// Results.
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
    /// Settings of the study.
    #[serde(flatten)]
    pub header: StudyHeader,
    /// Type of the sums of squares.
    #[serde(rename = "type")]
    pub kind: SumType,
    /// Response of the model: `shape`, or an attribute.
    pub response: String,
    /// Attributes whose values are exchanged as blocks, or within which residuals are exchanged.
    pub blocks: Vec<String>,
    /// Results.
    #[serde(flatten)]
    pub found: ModelRecord,
    /// Whether the shapes were read as a stream, because they are too many for the memory of a test: exchanges are then keyed
    /// bijections, and other ones than those of fewer shapes.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub streamed: bool,
    /// The table as text, as statistical programs print it.
    #[serde(default)]
    pub text: String,
    /// Address of the predictions of the model, if it is kept for them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub kept_at: Option<String>,
}

/// Repeatability of the shapes of a cohort.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct ShapeRepeatability {
    /// Id of the cohort.
    pub cohort: String,
    /// Revision of the cohort that was analysed.
    pub cohort_revision: u64,
    /// Settings of the study.
    #[serde(flatten)]
    pub header: StudyHeader,
    /// Attribute whose values are the subjects.
    pub subject: String,
    /// Attribute whose values are the replicates.
    pub replicate: Option<String>,
    /// Attribute whose values are groups of subjects.
    pub groups: Option<String>,
    /// Results.
    #[serde(flatten)]
    pub found: RepeatabilityRecord,
}

/// How blocks of the same shapes or subjects vary together.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct ShapeBlocks {
    /// Id of the cohort.
    pub cohort: String,
    /// Revision of the cohort that was analysed.
    pub cohort_revision: u64,
    /// Settings of the study.
    #[serde(flatten)]
    pub header: StudyHeader,
    /// Whether parts were aligned on their own: parts of one aligned shape share its alignment.
    pub separate: bool,
    /// Results.
    #[serde(flatten)]
    pub found: BlocksRecord,
    /// Scores along the first pair of singular shapes of the first two blocks, one entry per shape, in the order of the cohort.
    pub scores: Vec<BlockScore>,
}

/// Scores of a shape in two blocks.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct BlockScore {
    /// Id of the shape.
    pub id: String,
    /// Identifier assigned by the client.
    pub external_id: Option<String>,
    /// Score in the first block.
    pub first: f64,
    /// Score in the second block.
    pub second: f64,
}

/// Whether parts of the shapes of a cohort are modules.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct ShapeModularity {
    /// Id of the cohort.
    pub cohort: String,
    /// Revision of the cohort that was analysed.
    pub cohort_revision: u64,
    /// Settings of the study.
    #[serde(flatten)]
    pub header: StudyHeader,
    /// Results.
    #[serde(flatten)]
    pub found: ModularityRecord,
}

/// Symmetry of the shapes of a cohort.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct ShapeSymmetry {
    /// Id of the cohort.
    pub cohort: String,
    /// Revision of the cohort that was analysed.
    pub cohort_revision: u64,
    /// Settings of the study.
    #[serde(flatten)]
    pub header: StudyHeader,
    /// Kind of symmetry.
    pub kind: SymmetryKind,
    /// Values of the sides, left and right; null for object symmetry.
    pub sides: Option<[String; 2]>,
    /// Results.
    #[serde(flatten)]
    pub found: SymmetryRecord,
}
