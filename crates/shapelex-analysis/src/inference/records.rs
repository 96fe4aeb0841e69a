//! Results of studies as records: groups, pairs, tests, regressions.

use super::comparison::Tested;
use super::histogram::ExplainedHistogram;
use super::permutation::Tally;
use crate::mean_record::MeanRecord;
use shapelex_geometry::size::SizeMeasure;

/// Comparison of groups of shapes: means, tests, effects along the shape, sizes.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct GroupComparison {
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
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct GroupRecord {
    /// Name of the group, or the value of the attribute.
    pub name: String,
    /// Number of shapes in the group.
    #[cfg_attr(feature = "serde", serde(rename = "shape_count", alias = "shapes"))]
    pub shapes: usize,
    /// Sum of the weights of its shapes.
    pub weight: f64,
    /// Member of the group's mean space that is nearest to the pooled mean, with the certificate of the space. For Procrustes
    /// alignment it equals `average`.
    pub mean: MeanRecord,
    /// Weighted arithmetic mean of the aligned shapes, which the tests compare.
    pub average: Vec<Vec<f64>>,
    /// Root of the weighted mean squared distance of the aligned shapes from `average`.
    pub spread: f64,
    /// Sizes before the class was removed, as far as the representation has them.
    pub sizes: Vec<SizeSummary>,
}

/// Size of the shapes of a group.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct SizeSummary {
    /// Measure of size.
    pub measure: SizeMeasure,
    /// Weighted mean.
    pub mean: f64,
    /// Standard deviation, `√(n/(n−1) · Σw(x − x̄)²/Σw)`.
    pub deviation: f64,
}

/// Permutation test of a statistic.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
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
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct StatisticRecord {
    /// Value of the statistic; null if infinite.
    pub value: Option<f64>,
    /// Permutation test of the statistic.
    pub test: TestRecord,
}

/// Comparison of two groups; differences are the second minus the first.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
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
    /// `r_squared` of the relabellings: the distribution that the observed value is compared with; null without permutations.
    #[cfg_attr(feature = "serde", serde(default))]
    pub histogram: Option<ExplainedHistogram>,
    /// Hotelling's `T²` of the leading principal coordinates. It assumes that the covariances of the groups are equal: where they are
    /// not, its test finds differences too often.
    pub hotelling: StatisticRecord,
    /// Number of these coordinates.
    pub components: usize,
    /// Studentised distance `‖Δ‖²/(V₁ + V₂)`, `V` the estimated variance of an average, with a test by random signs in place of labels:
    /// valid, nearly, for groups that scatter unequally, whatever their sizes. Null with strata, if no group scatters, and in results
    /// of earlier versions.
    #[cfg_attr(feature = "serde", serde(default))]
    pub studentised: Option<StatisticRecord>,
    /// Difference along the shape.
    pub effect: Vec<EffectPoint>,
    /// Differences in size.
    pub sizes: Vec<SizeDifference>,
}

/// Difference between two groups at a point along the shape.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct EffectPoint {
    /// Parameter `u` on curves; index of a landmark; on surfaces the index `k n_v + l` on the grid of knots.
    pub parameter: f64,
    /// Parameters `u` and `v` on surfaces.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
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
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct SizeDifference {
    /// Measure of size.
    pub measure: SizeMeasure,
    /// Mean of the second group minus mean of the first.
    pub difference: f64,
    /// Test of its magnitude, using the relabellings of the shapes.
    pub test: TestRecord,
}

/// Comparison of all groups at once.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct OverallRecord {
    /// Pseudo-F: between-group over within-group sum of squares, each divided by its degrees of freedom.
    pub pseudo_f: StatisticRecord,
    /// Fraction of the squared distances explained by the groups.
    pub r_squared: f64,
    /// `r_squared` of the relabellings: the distribution that the observed value is compared with; null without permutations.
    #[cfg_attr(feature = "serde", serde(default))]
    pub histogram: Option<ExplainedHistogram>,
}

/// Regression of shapes on an attribute: change of the shape, explained variation, and a permutation test.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct RegressionRecord {
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
    /// Fraction of the variation left unexplained by the covariates that the attribute explains.
    pub partial_r_squared: f64,
    /// Fraction explained by attribute and covariates together.
    pub model_r_squared: f64,
    /// Pseudo-F of the attribute after the covariates; null if infinite.
    pub pseudo_f: Option<f64>,
    /// Permutation test of the pseudo-F; with covariates, by permutation of residuals (Freedman and Lane).
    pub test: TestRecord,
    /// Weighted arithmetic mean of the aligned shapes: the prediction at the mean of attribute and covariates.
    pub average: Vec<Vec<f64>>,
    /// Change of the shape per unit of the attribute.
    pub change_per_unit: Vec<Vec<f64>>,
    /// Change of the shape per standard deviation of the attribute.
    pub change_per_deviation: Vec<Vec<f64>>,
    /// Shapes predicted at quantiles of the attribute, with the covariates at their mean.
    pub predictions: Vec<Prediction>,
}

/// Summary of the values of an attribute.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
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
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct CovariateRecord {
    /// Name of the covariate.
    pub name: String,
    /// Values of a categorical covariate, in order; the first is the reference, each other one takes a column. Null for
    /// numbers.
    pub levels: Option<Vec<String>>,
}

/// Shape predicted at a value of the attribute.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Prediction {
    /// Quantile of the attribute.
    pub quantile: f64,
    /// Value of the attribute.
    pub attribute: f64,
    /// Control points of the predicted shape.
    pub control_points: Vec<Vec<f64>>,
}

impl From<Tally> for TestRecord {
    fn from(tally: Tally) -> Self {
        let Tally { exceeding, permutations, exact } = tally;
        Self { p: tally.p(), p_holm: None, exceeding, permutations, exact }
    }
}

impl From<Tested> for StatisticRecord {
    fn from(Tested { value, tally }: Tested) -> Self {
        Self { value, test: tally.into() }
    }
}
