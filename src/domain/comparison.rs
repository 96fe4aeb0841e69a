//! What the comparison of groups of shapes has found.

use serde::{Deserialize, Serialize};

use super::dictionary::{MeanRecord, Row};
use crate::analysis::alignment::Alignment;
use crate::analysis::correspondence::Mirror;
use crate::analysis::transformation::Transformation;

/// The comparison of groups of shapes of a cohort.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Comparison {
    /// Id of the cohort.
    pub cohort: String,
    /// The revision that was looked at.
    pub cohort_revision: u64,
    /// Unit of the sizes.
    pub length_unit: Option<String>,
    /// The class that was removed.
    pub transformation: Transformation,
    /// Projection on the class, or Procrustes fits.
    pub alignment: Alignment,
    /// Whether mirror images were matched.
    pub mirror: Mirror,
    /// Seed of the relabellings that were drawn.
    pub seed: u64,
    /// Attributes within whose values labels were exchanged.
    pub strata: Vec<String>,
    /// Shapes of all groups.
    pub shapes: usize,
    /// Shapes that have no value of the attribute that makes the groups.
    pub left_out: usize,
    /// Shapes whose stratum has shapes of several groups: no relabelling changes the others.
    pub exchangeable: usize,
    /// The mean of all shapes, which knows nothing of the groups: everything is aligned to it.
    pub pooled: MeanRecord,
    /// The groups, in the order of the request, or of their values.
    pub groups: Vec<GroupRecord>,
    /// Every two groups.
    pub pairs: Vec<PairRecord>,
    /// All groups at once; null for two, which are one pair.
    pub overall: Option<OverallRecord>,
    /// What a reader of the result should know.
    pub warnings: Vec<String>,
}

/// One group.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct GroupRecord {
    /// Its name, or the value of the attribute.
    pub name: String,
    /// Its shapes.
    pub shapes: usize,
    /// Sum of their weights.
    pub weight: f64,
    /// The member of the mean space of the group that is nearest to the pooled mean, with the certificate of the space.
    /// For Procrustes fits the same as `average`.
    pub mean: MeanRecord,
    /// Weighted arithmetic mean of the aligned shapes: what the tests compare.
    pub average: Vec<Row>,
    /// Root of the weighted mean squared distance of the aligned shapes from `average`.
    pub spread: f64,
    /// Sizes before the class was removed; those that the representation has.
    pub sizes: Vec<SizeSummary>,
}

/// A measure of size.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum SizeMeasure {
    /// Volume that a surface encloses, without its sign.
    Volume,
    /// Enclosed area of closed planar curves, without its sign; area of surfaces.
    Area,
    /// Length of curves: the perimeter of closed ones.
    Length,
    /// `L₂` norm about the mean position: root of the mean squared distance from it.
    CentroidSize,
}

/// A size of the shapes of a group.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct SizeSummary {
    /// What is measured.
    pub measure: SizeMeasure,
    /// Weighted mean.
    pub mean: f64,
    /// Standard deviation, `√(n/(n−1) · Σw(x − x̄)²/Σw)`.
    pub deviation: f64,
}

/// How often the relabellings reach an observed statistic.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct TestRecord {
    /// `(1 + exceeding)/(1 + permutations)`; null when nothing was permuted.
    pub p: Option<f64>,
    /// Corrected by Holm for the number of pairs; null where `p` is, and where there is one test.
    pub p_holm: Option<f64>,
    /// Relabellings, without the observed labelling, whose statistic reaches the observed one.
    pub exceeding: usize,
    /// Relabellings without the observed labelling.
    pub permutations: usize,
    /// Whether these are all there are: then the p value is exact.
    pub exact: bool,
}

/// A statistic with its test.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct StatisticRecord {
    /// Its value; null where it is infinite.
    pub value: Option<f64>,
    /// Its test.
    pub test: TestRecord,
}

/// Two groups, the second less the first.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct PairRecord {
    /// Name of the first group.
    pub first: String,
    /// Name of the second group.
    pub second: String,
    /// Shapes of the two whose labels can be exchanged.
    pub exchangeable: usize,
    /// Chordal distance of the mean spaces, `√(1 − tr(P₁P₂)/I)`, 0 to 1; null for Procrustes fits.
    pub chordal_distance: Option<f64>,
    /// `L₂` distance of the averages.
    pub distance: StatisticRecord,
    /// Pseudo-F of the squared distances.
    pub pseudo_f: StatisticRecord,
    /// Part of the squared distances that the two groups explain.
    pub r_squared: f64,
    /// Hotelling's `T²` of the leading principal coordinates.
    pub hotelling: StatisticRecord,
    /// How many coordinates these are.
    pub components: usize,
    /// The difference along the shape.
    pub effect: Vec<EffectPoint>,
    /// Differences of the sizes.
    pub sizes: Vec<SizeDifference>,
}

/// The difference of two groups at a point along the shape.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct EffectPoint {
    /// Parameter `u` on curves; the index of a landmark, or of a place `k n_v + l` on the grid of the knots of a surface.
    pub parameter: f64,
    /// `u` and `v` on surfaces.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub surface_parameters: Option<[f64; 2]>,
    /// The point on the average of the first group.
    pub point: Vec<f64>,
    /// The average of the second group less that.
    pub difference: Vec<f64>,
    /// Its length.
    pub length: f64,
    /// Hotelling's `T²` of the point; null where it is infinite.
    pub t_squared: Option<f64>,
    /// p value of the largest `T²` over all points: corrected for their number.
    pub p: Option<f64>,
}

/// The difference of a size between two groups.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct SizeDifference {
    /// What is measured.
    pub measure: SizeMeasure,
    /// Mean of the second group less that of the first.
    pub difference: f64,
    /// The test of its magnitude, by the relabellings of the shapes.
    pub test: TestRecord,
}

/// All groups at once.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct OverallRecord {
    /// Pseudo-F: between over within sum of squares, each over its degrees of freedom.
    pub pseudo_f: StatisticRecord,
    /// Part of the squared distances that the groups explain.
    pub r_squared: f64,
}
