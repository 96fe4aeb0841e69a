//! Linear models of the shapes of a cohort, with permutation tests of their terms.

use std::collections::BTreeMap;

use axum::response::Response;

use crate::analysis::models::anova::{ExchangeRule, Statistic};
use crate::analysis::models::design::Contrasts;
use crate::analysis::models::disparity::DisparityOptions;
use crate::analysis::models::effect_size::Transform;
use crate::analysis::models::formula::TermOrder;
use crate::analysis::models::pairs::PairsOptions;
use crate::analysis::models::records::At;
use crate::analysis::models::subspaces::SumType;
use crate::analysis::models::trajectories::TrajectoryOptions;
use crate::api::extract::{Caller, JsonBody, OnlyFormat, Prefer};
use crate::api::problem::Problem;
#[cfg(feature = "schema")]
use crate::api::v1::requests::described::*;
use crate::api::v1::requests::planned::{Names, StudyBody, answer_study, study_request};
use crate::api::v1::requests::shape_query::take_filter;
use crate::domain::filter::ShapeFilter;
use crate::domain::job::Priority;
#[cfg(feature = "schema")]
use crate::domain::study::ShapeModel;
use crate::service::app::ServiceError;
use crate::service::inference::models::extras::{
    Compatibility, CovarianceOptions, ManovaOptions, RandomOptions,
};
use crate::service::inference::models::further::FurtherOptions;
use crate::service::inference::models::{Collinear, ModelledShapes, Options};
use crate::service::inference::regressions::Missing;
use crate::service::inference::study::StudyRequest;
use crate::wire::checked::{Checked, LARGE, take_given, take_or_default};

study_request! {
    /// A linear model of shapes.
    #[schema(example = json!({
        "cohort": "example-cells", "formula": "~ log_centroid_size * cell_line", "permutations": 200
    }))]
    ModelRequest {
        /// Filter that selects shapes of the cohort. Default: all shapes.
        #[schema(value_type = Option<ShapeFilter>)]
        filter: Checked<ShapeFilter>;
        /// Formula in the notation of Wilkinson and Rogers, as R reads it: `~ treatment * log(age) + sex + (1 | subject)`. Names are
        /// `subject`, `label`, `labels.<attribute>` or the attribute alone, `measures.<measure>` and `log_centroid_size`.
        #[schema(value_type = String, required = true)]
        formula: Checked<String>, required;
        /// Order of the terms, which matters for type I. Default: `by_degree`.
        #[schema(value_type = Option<TermOrder>)]
        order: Checked<TermOrder>;
        /// Type of the sums of squares: `I` sequential, `II` hierarchical, `III` marginal. Default: `II`.
        #[schema(value_type = Option<SumType>)]
        r#type: Checked<SumType>;
        /// Coding of factors: changes coefficients and type III. Default: `treatment`, and `sum` for type III.
        #[schema(value_type = Option<Contrasts>)]
        contrasts: Checked<Contrasts>;
        /// Levels of factors in their order, the first of which is the reference. Default: those that occur, sorted.
        #[schema(value_type = Option<BTreeMap<String, Vec<String>>>)]
        levels: Checked<BTreeMap<String, Vec<String>>>;
        /// Response of the model: `shape`, `score 1..3` (shapes within the space of these principal components of all),
        /// `log_centroid_size`, or a numeric attribute. Default: `shape`.
        #[schema(value_type = Option<String>)]
        response: Checked<String>;
        /// Handling of shapes without a value. Default: `refuse`.
        #[schema(value_type = Option<Missing>)]
        missing: Checked<Missing>;
        /// Handling of columns of the design that depend on others. Default: `drop`.
        #[schema(value_type = Option<Collinear>)]
        collinear: Checked<Collinear>;
        /// Attributes whose equal values are blocks of shapes that belong together, such as `subject`.
        #[schema(value_type = Option<Vec<String>>)]
        blocks: Checked<Names>;
        /// Units of exchange with blocks. Default: `auto`: within blocks for terms that vary inside, whole blocks for
        /// others.
        #[schema(value_type = Option<ExchangeRule>)]
        exchange: Checked<ExchangeRule>;
        /// Terms that are tested against another term of the model that contains them, on the averages of its groups:
        /// `{"site": "site:year"}`. Terms that are constant in the groups of `(1 | group)` are tested against these.
        #[schema(value_type = Option<BTreeMap<String, String>>)]
        error_terms: Checked<BTreeMap<String, String>>;
        /// The statistic of p and Z. Default: `f`.
        #[schema(value_type = Option<Statistic>)]
        statistic: Checked<Statistic>;
        /// Transformation of the statistic before it is standardised. Default: `box_cox`.
        #[schema(value_type = Option<Transform>)]
        z: Checked<Transform>;
        /// Values of attributes at which shapes are predicted, at most 100. Default: the levels of the first variable, or its quantiles
        /// 5, 50 and 95 %.
        #[schema(value_type = Option<Vec<BTreeMap<String, At>>>, max_items = 100)]
        at: Checked<Vec<BTreeMap<String, At>>>;
        /// Groups beside each other: least-squares means, or slopes on a covariate.
        #[schema(value_type = Option<PairsOptions>)]
        pairs: Checked<PairsOptions>;
        /// Scatter of groups, and whether it differs.
        #[schema(value_type = Option<DisparityOptions>)]
        disparity: Checked<DisparityOptions>;
        /// Trajectories of groups through the means at the levels of a factor.
        #[schema(value_type = Option<TrajectoryOptions>)]
        trajectories: Checked<TrajectoryOptions>;
        /// Level of the bands of predictions, such as 0.95. Default: no bands.
        #[schema(value_type = Option<f64>, exclusive_minimum = 0.0, exclusive_maximum = 1.0)]
        bands: Checked<f64>;
        /// Number of places along curves at which bands are given. Default: the number of control points.
        #[schema(value_type = Option<usize>, minimum = 1)]
        samples: Checked<usize>;
        /// Whether the model is kept, so that it predicts at any values later: the request then becomes a job, however small it is, and its
        /// result tells in `kept_at` where the predictions are. Default: false.
        #[schema(value_type = Option<bool>)]
        keep: Checked<bool>;
        /// Estimates of the random part `(1 | g)` or `(x | g)` of the formula. Default: the usual ones, if the shapes determine them.
        #[schema(value_type = Option<RandomOptions>)]
        random: Checked<RandomOptions>;
        /// Multivariate statistics of the terms in the first principal coordinates. Default: none.
        #[schema(value_type = Option<ManovaOptions>)]
        manova: Checked<ManovaOptions>;
        /// Known covariance of the shapes, as rows or as a tree, for generalised least squares. Default: shapes are independent.
        #[schema(value_type = Option<CovarianceOptions>)]
        covariance: Checked<CovarianceOptions, LARGE>;
        /// `rrpp` adds p and Z of the ratio of permuted mean squares to terms with an error term of the model. Default: none.
        #[schema(value_type = Option<Compatibility>)]
        compatibility: Checked<Compatibility>;
    } {
        /// Number of permutations, 0 to 100000. Default: 1000.
        permutations
        /// Seed of the permutations. Default: 0.
        seed
        /// Attributes within whose values residuals are exchanged: `subject`, `label`, `labels.<attribute>`, or a list.
        strata
    } {}
}

/// Fits a linear model to the shapes of a cohort.
///
/// All shapes are aligned to their mean; each term of the formula is tested by permutations of the residuals of the model without it.
/// The answer is the table of an analysis of variance with F, Z and p, coefficients as displacements of the shape, and predicted
/// shapes, on request with bands; pairs, disparity and trajectories of groups are tested besides. Small tests are answered at once; others become a job (202) with this result. With `Prefer: wait=N` the response is the result
/// if the job ends within `N` seconds, at most 60. As SVG: the predicted shapes over the table.
#[utoipa::path(post, path = "/v1/models", tag = "inference", request_body = ModelRequest,
    params(
        ("format" = Option<String>, Query, description = "`json`, `svg` or `png`"), DrawingQuery,
        ("prefer" = Option<String>, Header, description = "`wait=10`: wait up to ten seconds for the job"), RetryHeader
    ),
    responses(
        (status = 200, description = "The model", content((ShapeModel = "application/json"), (String = "image/svg+xml"))),
        (status = 202, description = "The job that fits the model", body = JobOutput, headers(("Location" = String))),
        (status = 404, description = "No such cohort"),
        (status = "4XX", description = "The input was refused, or the job failed within the wait"),
        (status = 503, description = "Too many jobs are waiting")
    ))]
pub(in crate::api::v1) async fn model(
    Caller(app): Caller,
    OnlyFormat(format): OnlyFormat,
    prefer: Prefer,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    answer_study::<ModelRequest>(app, format, prefer, body).await
}

impl StudyBody for ModelRequest {
    type Kind = ModelledShapes;

    fn take_priority(&mut self) -> Option<Checked<Priority>> {
        self.priority.take()
    }

    fn request(mut self) -> Result<StudyRequest<Options>, ServiceError> {
        let mut errors = std::mem::take(&mut self.faults);
        let cohort = take_given(self.cohort.take(), "/cohort", &mut errors);
        let filter = take_filter(self.filter.take(), "/filter", &mut errors);
        let formula = take_given(self.formula.take(), "/formula", &mut errors);
        let order = take_or_default(self.order.take(), "/order", &mut errors);
        let kind = take_or_default(self.r#type.take(), "/type", &mut errors);
        let contrasts = take_given(self.contrasts.take(), "/contrasts", &mut errors);
        let levels = take_or_default(self.levels.take(), "/levels", &mut errors);
        let response = take_given(self.response.take(), "/response", &mut errors);
        let missing = take_or_default(self.missing.take(), "/missing", &mut errors);
        let collinear = take_or_default(self.collinear.take(), "/collinear", &mut errors);
        let blocks = take_or_default(self.blocks.take(), "/blocks", &mut errors);
        let exchange = take_or_default(self.exchange.take(), "/exchange", &mut errors);
        let error_terms = take_or_default(self.error_terms.take(), "/error_terms", &mut errors);
        let statistic = take_or_default(self.statistic.take(), "/statistic", &mut errors);
        let z = take_or_default(self.z.take(), "/z", &mut errors);
        let at = take_given(self.at.take(), "/at", &mut errors);
        let further = FurtherOptions {
            reduced: None,
            pairs: take_given(self.pairs.take(), "/pairs", &mut errors),
            disparity: take_given(self.disparity.take(), "/disparity", &mut errors),
            trajectories: take_given(self.trajectories.take(), "/trajectories", &mut errors),
            bands: take_given(self.bands.take(), "/bands", &mut errors),
            samples: take_given(self.samples.take(), "/samples", &mut errors),
            keep: take_or_default(self.keep.take(), "/keep", &mut errors).unwrap_or_default(),
        };
        let random = take_given(self.random.take(), "/random", &mut errors);
        let manova = take_given(self.manova.take(), "/manova", &mut errors);
        let covariance = take_given(self.covariance.take(), "/covariance", &mut errors);
        let compatibility = take_given(self.compatibility.take(), "/compatibility", &mut errors);
        let common = self.take_common(&mut errors);
        let options = (|| {
            Some(Options {
                filter: filter?,
                formula: formula?,
                order: order?,
                kind: kind?,
                contrasts,
                levels: levels?,
                response: response.unwrap_or_else(|| "shape".into()),
                missing: missing?,
                collinear: collinear?,
                blocks: blocks?.0,
                exchange: exchange?,
                error_terms: error_terms?,
                statistic: statistic?,
                z: z?,
                at,
                further,
                random,
                manova,
                covariance,
                compatibility,
            })
        })();
        common.request(cohort, options, errors)
    }
}
