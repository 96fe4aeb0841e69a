//! Comparisons of two nested linear models of the shapes of a cohort.

use std::collections::BTreeMap;

use axum::response::Response;

use crate::analysis::models::anova::{ExchangeRule, Statistic};
use crate::analysis::models::effect_size::Transform;
use crate::analysis::models::formula::TermOrder;
use crate::analysis::models::subspaces::SumType;
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
use crate::service::inference::models::further::FurtherOptions;
use crate::service::inference::models::{Collinear, ModelledShapes, Options};
use crate::service::inference::regressions::Missing;
use crate::service::inference::study::StudyRequest;
use crate::wire::checked::{Checked, take_given, take_or_default};

study_request! {
    /// Two nested linear models of shapes.
    #[schema(example = json!({
        "cohort": "example-cells", "reduced": "~ log_centroid_size", "full": "~ log_centroid_size * cell_line", "permutations": 200
    }))]
    CompareModelsRequest {
        /// Filter that selects shapes of the cohort. Default: all shapes.
        #[schema(value_type = Option<ShapeFilter>)]
        filter: Checked<ShapeFilter>;
        /// Formula of the reduced model, all of whose fits are fits of the full one.
        #[schema(value_type = String, required = true)]
        reduced: Checked<String>, required;
        /// Formula of the full model, as of `POST /v1/models`.
        #[schema(value_type = String, required = true)]
        full: Checked<String>, required;
        /// Levels of factors in their order, the first of which is the reference. Default: those that occur, sorted.
        #[schema(value_type = Option<BTreeMap<String, Vec<String>>>)]
        levels: Checked<BTreeMap<String, Vec<String>>>;
        /// Response of the model: `shape`, `log_centroid_size`, or a numeric attribute. Default: `shape`.
        #[schema(value_type = Option<String>)]
        response: Checked<String>;
        /// Handling of shapes without a value. Default: `refuse`.
        #[schema(value_type = Option<Missing>)]
        missing: Checked<Missing>;
        /// Attributes whose equal values are blocks of shapes that belong together, such as `subject`.
        #[schema(value_type = Option<Vec<String>>)]
        blocks: Checked<Names>;
        /// Units of exchange with blocks. Default: `auto`: within blocks if all terms that the reduced model has not
        /// vary inside, whole blocks if none does.
        #[schema(value_type = Option<ExchangeRule>)]
        exchange: Checked<ExchangeRule>;
        /// The statistic of p and Z. Default: `f`.
        #[schema(value_type = Option<Statistic>)]
        statistic: Checked<Statistic>;
        /// Transformation of the statistic before it is standardised. Default: `box_cox`.
        #[schema(value_type = Option<Transform>)]
        z: Checked<Transform>;
    } {
        /// Number of permutations, 0 to 100000. Default: 1000.
        permutations
        /// Seed of the permutations. Default: 0.
        seed
        /// Attributes within whose values residuals are exchanged: `subject`, `label`, `labels.<attribute>`, or a list.
        strata
    } {}
}

/// Compares two nested linear models of the shapes of a cohort.
///
/// The residuals of the reduced model are exchanged; the only row of the table is the addition of the full model, named
/// by its further terms. The answer is otherwise that of `POST /v1/models` for the full model, and becomes a job in the
/// same way.
#[utoipa::path(post, path = "/v1/models/compare", tag = "inference", request_body = CompareModelsRequest,
    params(
        ("format" = Option<String>, Query, description = "`json`, `svg` or `png`"), DrawingQuery,
        ("prefer" = Option<String>, Header, description = "`wait=10`: wait up to ten seconds for the job"), RetryHeader
    ),
    responses(
        (status = 200, description = "The full model beside the reduced one", content((ShapeModel = "application/json"), (String = "image/svg+xml"))),
        (status = 202, description = "The job that fits the models", body = JobOutput, headers(("Location" = String))),
        (status = 404, description = "No such cohort"),
        (status = "4XX", description = "The input was refused, or the job failed within the wait"),
        (status = 503, description = "Too many jobs are waiting")
    ))]
pub(in crate::api::v1) async fn compare_models(
    Caller(app): Caller,
    OnlyFormat(format): OnlyFormat,
    prefer: Prefer,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    answer_study::<CompareModelsRequest>(app, format, prefer, body).await
}

impl StudyBody for CompareModelsRequest {
    type Kind = ModelledShapes;

    fn take_priority(&mut self) -> Option<Checked<Priority>> {
        self.priority.take()
    }

    fn request(mut self) -> Result<StudyRequest<Options>, ServiceError> {
        let mut errors = std::mem::take(&mut self.faults);
        let cohort = take_given(self.cohort.take(), "/cohort", &mut errors);
        let filter = take_filter(self.filter.take(), "/filter", &mut errors);
        let reduced = take_given(self.reduced.take(), "/reduced", &mut errors);
        let full = take_given(self.full.take(), "/full", &mut errors);
        let levels = take_or_default(self.levels.take(), "/levels", &mut errors);
        let response = take_given(self.response.take(), "/response", &mut errors);
        let missing = take_or_default(self.missing.take(), "/missing", &mut errors);
        let blocks = take_or_default(self.blocks.take(), "/blocks", &mut errors);
        let exchange = take_or_default(self.exchange.take(), "/exchange", &mut errors);
        let statistic = take_or_default(self.statistic.take(), "/statistic", &mut errors);
        let z = take_or_default(self.z.take(), "/z", &mut errors);
        let common = self.take_common(&mut errors);
        let options = (|| {
            Some(Options {
                filter: filter?,
                formula: full?,
                order: TermOrder::default(),
                kind: SumType::I,
                contrasts: None,
                levels: levels?,
                response: response.unwrap_or_else(|| "shape".into()),
                missing: missing?,
                collinear: Collinear::default(),
                blocks: blocks?.0,
                exchange: exchange?,
                error_terms: BTreeMap::new(),
                statistic: statistic?,
                z: z?,
                at: None,
                further: FurtherOptions { reduced: Some(reduced?), ..FurtherOptions::default() },
                random: None,
                manova: None,
                covariance: None,
                compatibility: None,
            })
        })();
        common.request(cohort, options, errors)
    }
}
