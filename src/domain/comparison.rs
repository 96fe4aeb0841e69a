//! Result of comparing groups of shapes: permutation tests of mean shapes, of the effect along the shape, and of sizes.

use serde::{Deserialize, Serialize};

use crate::analysis::alignment::Alignment;
use crate::analysis::correspondence::Mirror;
use crate::analysis::dictionary::content::MeanRecord;
use crate::analysis::rows::Row;
use crate::analysis::transformation::Transformation;
use crate::geometry::size::SizeMeasure;

/// Comparison of groups of shapes of a cohort.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Comparison {
    /// Id of the cohort.
    pub cohort: String,
    /// Revision of the cohort that was analysed.
    pub cohort_revision: u64,
    /// Unit of the sizes.
    pub length_unit: Option<String>,
    /// Transformation class that was removed.
    pub transformation: Transformation,
    /// Alignment method: projection onto the class, or Procrustes.
    pub alignment: Alignment,
    /// Whether shapes were matched to mirror images.
    pub mirror: Mirror,
    /// Seed of the random relabellings.
    pub seed: u64,
    /// Attributes within whose values labels were exchanged.
    pub strata: Vec<String>,
    /// Number of shapes in all groups.
    pub shapes: usize,
    /// Number of shapes without a value of the attribute that defines the groups.
    pub left_out: usize,
    /// Number of shapes whose stratum contains several groups; relabelling does not affect the others.
    pub exchangeable: usize,
    /// Mean of all shapes, computed without knowledge of the groups; everything is aligned to it.
    pub pooled: MeanRecord,
    /// Groups, in the order of the request, or of their values.
    pub groups: Vec<GroupRecord>,
    /// Comparison of every two groups.
    pub pairs: Vec<PairRecord>,
    /// Comparison of all groups at once; null for two groups, which form one pair.
    pub overall: Option<OverallRecord>,
    /// Warnings about the result.
    pub warnings: Vec<String>,
}

/// One of the groups.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct GroupRecord {
    /// Name of the group, or the value of the attribute.
    pub name: String,
    /// Number of shapes in the group.
    pub shapes: usize,
    /// Sum of the weights of its shapes.
    pub weight: f64,
    /// Member of the group's mean space that is nearest to the pooled mean, with the certificate of the space. For Procrustes
    /// alignment it equals `average`.
    pub mean: MeanRecord,
    /// Weighted arithmetic mean of the aligned shapes, which the tests compare.
    pub average: Vec<Row>,
    /// Root of the weighted mean squared distance of the aligned shapes from `average`.
    pub spread: f64,
    /// Sizes before the class was removed, as far as the representation has them.
    pub sizes: Vec<SizeSummary>,
}

/// Size of the shapes of a group.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct SizeSummary {
    /// Measure of size.
    pub measure: SizeMeasure,
    /// Weighted mean.
    pub mean: f64,
    /// Standard deviation, `√(n/(n−1) · Σw(x − x̄)²/Σw)`.
    pub deviation: f64,
}

/// Permutation test of a statistic.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct TestRecord {
    /// p value `(1 + exceeding)/(1 + permutations)`; null without permutations.
    pub p: Option<f64>,
    /// p value corrected by Holm for the number of pairs; null if `p` is, and if there is only one test.
    pub p_holm: Option<f64>,
    /// Number of relabellings, without the observed labelling, whose statistic reaches the observed one.
    pub exceeding: usize,
    /// Number of relabellings, without the observed labelling.
    pub permutations: usize,
    /// Whether all possible relabellings were used, which makes the p value exact.
    pub exact: bool,
}

/// A statistic with its test.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct StatisticRecord {
    /// Value of the statistic; null if infinite.
    pub value: Option<f64>,
    /// Permutation test of the statistic.
    pub test: TestRecord,
}

/// Comparison of two groups; differences are the second minus the first.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct PairRecord {
    /// Name of the first group.
    pub first: String,
    /// Name of the second group.
    pub second: String,
    /// Number of shapes of the two groups whose labels can be exchanged.
    pub exchangeable: usize,
    /// Chordal distance between the mean spaces, `√(1 − tr(P₁P₂)/I)`, 0 to 1; null for Procrustes alignment.
    pub chordal_distance: Option<f64>,
    /// `L₂` distance between the averages.
    pub distance: StatisticRecord,
    /// Pseudo-F of the squared distances.
    pub pseudo_f: StatisticRecord,
    /// Fraction of the squared distances explained by the two groups.
    pub r_squared: f64,
    /// Hotelling's `T²` of the leading principal coordinates.
    pub hotelling: StatisticRecord,
    /// Number of these coordinates.
    pub components: usize,
    /// Difference along the shape.
    pub effect: Vec<EffectPoint>,
    /// Differences in size.
    pub sizes: Vec<SizeDifference>,
}

/// Difference between two groups at a point along the shape.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct EffectPoint {
    /// Parameter `u` on curves; index of a landmark; on surfaces the index `k n_v + l` on the grid of knots.
    pub parameter: f64,
    /// Parameters `u` and `v` on surfaces.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub surface_parameters: Option<[f64; 2]>,
    /// Point on the average of the first group.
    pub point: Vec<f64>,
    /// Average of the second group minus that point.
    pub difference: Vec<f64>,
    /// Length of the difference.
    pub length: f64,
    /// Hotelling's `T²` at the point; null if infinite.
    pub t_squared: Option<f64>,
    /// p value of the largest `T²` over all points: corrected for their number.
    pub p: Option<f64>,
}

/// Difference in size between two groups.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct SizeDifference {
    /// Measure of size.
    pub measure: SizeMeasure,
    /// Mean of the second group minus mean of the first.
    pub difference: f64,
    /// Test of its magnitude, using the relabellings of the shapes.
    pub test: TestRecord,
}

/// Comparison of all groups at once.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct OverallRecord {
    /// Pseudo-F: between-group over within-group sum of squares, each divided by its degrees of freedom.
    pub pseudo_f: StatisticRecord,
    /// Fraction of the squared distances explained by the groups.
    pub r_squared: f64,
}
