//! Multivariate linear regression of the shapes of a cohort on an attribute, with a permutation test.

use axum::response::Response;

use crate::api::extract::{Caller, JsonBody, OnlyFormat, Prefer};
use crate::api::problem::Problem;
#[cfg(feature = "schema")]
use crate::api::v1::requests::described::*;
use crate::api::v1::requests::planned::{StudyBody, answer_study, study_request};
use crate::api::v1::requests::shape_query::take_filter;
use crate::domain::filter::ShapeFilter;
use crate::domain::job::Priority;
#[cfg(feature = "schema")]
use crate::domain::study::ShapeRegression;
use crate::service::app::ServiceError;
use crate::service::inference::regressions::{Missing, Options, RegressedShapes};
use crate::service::inference::study::StudyRequest;
use crate::wire::checked::{Checked, take_given, take_or_default};

study_request! {
    /// Shapes to regress on an attribute.
    #[schema(example = json!({
        "cohort": "example-cells", "attribute": "log_centroid_size", "covariates": ["labels.cell_line"], "permutations": 200
    }))]
    RegressRequest {
        /// Filter that selects shapes of the cohort. Default: all shapes.
        #[schema(value_type = Option<ShapeFilter>)]
        filter: Checked<ShapeFilter>;
        /// Attribute to regress on: `labels.<attribute>` with numeric values, or `log_centroid_size`.
        #[schema(value_type = String, required = true)]
        attribute: Checked<String>, required;
        /// Covariates, removed first: `subject`, `label`, `labels.<attribute>` or `log_centroid_size`, at most 20. A number
        /// takes one column, a category one column for every value but the first.
        #[schema(value_type = Option<Vec<String>>, max_items = 20)]
        covariates: Checked<Vec<String>>;
        /// Handling of shapes without a value. Default: `refuse`.
        #[schema(value_type = Option<Missing>)]
        missing: Checked<Missing>;
    } {
        /// Number of permutations, 0 to 100000. Default: 1000.
        permutations
        /// Seed of the permutations. Default: 0.
        seed
        /// Attributes within whose values residuals are exchanged: `subject`, `label`, `labels.<attribute>`, or a list.
        strata
    } {}
}

/// Regresses the shapes of a cohort on an attribute.
///
/// All shapes are aligned to their mean, followed by multivariate linear regression on the attribute after the covariates,
/// with the p value of a permutation test (with covariates, that of Freedman and Lane). Small tests are answered at once;
/// others become a job (202) with this result. With `Prefer: wait=N` the response is the result if the job ends within `N`
/// seconds, at most 60. As SVG: the predicted shapes from low to high values.
#[utoipa::path(post, path = "/v1/regressions", tag = "inference", request_body = RegressRequest,
    params(
        ("format" = Option<String>, Query, description = "`json`, `svg` or `png`"), DrawingQuery,
        ("prefer" = Option<String>, Header, description = "`wait=10`: wait up to ten seconds for the job"), RetryHeader
    ),
    responses(
        (status = 200, description = "The regression", content((ShapeRegression = "application/json"), (String = "image/svg+xml"))),
        (status = 202, description = "The job that computes the regression", body = JobOutput, headers(("Location" = String))),
        (status = 404, description = "No such cohort"),
        (status = "4XX", description = "The input was refused, or the job failed within the wait"),
        (status = 503, description = "Too many jobs are waiting")
    ))]
pub(in crate::api::v1) async fn regress(
    Caller(app): Caller,
    OnlyFormat(format): OnlyFormat,
    prefer: Prefer,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    answer_study::<RegressRequest>(app, format, prefer, body).await
}

impl StudyBody for RegressRequest {
    type Kind = RegressedShapes;

    fn take_priority(&mut self) -> Option<Checked<Priority>> {
        self.priority.take()
    }

    fn request(mut self) -> Result<StudyRequest<Options>, ServiceError> {
        let mut errors = std::mem::take(&mut self.faults);
        let cohort = take_given(self.cohort.take(), "/cohort", &mut errors);
        let filter = take_filter(self.filter.take(), "/filter", &mut errors);
        let attribute = take_given(self.attribute.take(), "/attribute", &mut errors);
        let covariates = take_or_default(self.covariates.take(), "/covariates", &mut errors);
        let missing = take_or_default(self.missing.take(), "/missing", &mut errors);
        let common = self.take_common(&mut errors);
        let options = (|| {
            Some(Options {
                filter: filter?,
                attribute: attribute?,
                covariates: covariates?,
                missing: missing?,
            })
        })();
        common.request(cohort, options, errors)
    }
}
