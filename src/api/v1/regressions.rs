//! Multivariate linear regression of the shapes of a cohort on an attribute, with a permutation test.

use axum::response::Response;

use super::comparisons::Names;
use super::jobs::JobOutput;
use super::planned::answered;
use super::request_macros::{RetryHeader, priority_of};
use crate::analysis::alignment::Alignment;
use crate::analysis::correspondence::Mirror;
use crate::analysis::transformation::{ClassName, Transformation};
use crate::api::extract::{Caller, JsonBody, OnlyFormat, Prefer};
use crate::api::problem::Problem;
use crate::domain::job::Priority;
use crate::domain::regression::ShapeRegression;
use crate::domain::shape::ShapeFilter;
use crate::formats::checked::{Checked, document, take_given, take_or_default};
use crate::service::app::ServiceError;
use crate::service::inference::regressions::{self, Missing, Regress};
use crate::service::inference::test_sample::DEFAULT_PERMUTATIONS;

document! {
    /// Shapes to regress on an attribute.
    #[schema(example = json!({
        "cohort": "example-cells", "attribute": "log_centroid_size", "covariates": ["labels.cell_line"], "permutations": 200
    }))]
    pub(super) struct RegressRequest {
        /// Id or name of the cohort.
        #[schema(value_type = String, required = true)]
        cohort: Checked<String>, required;
        /// Filter that selects shapes of the cohort. Default: all shapes.
        #[schema(value_type = Option<ShapeFilter>)]
        filter: Checked<ShapeFilter>;
        /// Attribute to regress on: `labels.<attribute>` with numeric values, or `log_centroid_size`.
        #[schema(value_type = String, required = true)]
        attribute: Checked<String>, required;
        /// Covariates, removed first: `subject`, `label`, `labels.<attribute>` or `log_centroid_size`, at most 20. A number
        /// takes one column, a category one column for every value but the first.
        #[schema(value_type = Option<Vec<String>>)]
        covariates: Checked<Vec<String>>;
        /// Handling of shapes without a value. Default: `refuse`.
        #[schema(value_type = Option<Missing>)]
        missing: Checked<Missing>;
        /// Transformation class to remove. Default: `similarity`.
        #[schema(value_type = Option<Transformation>)]
        transformation: Checked<Transformation>;
        /// Alignment method: projection onto the class, or Procrustes. Default: `projection`.
        #[schema(value_type = Option<Alignment>)]
        alignment: Checked<Alignment>;
        /// Whether shapes may be matched to mirror images. Default: the cohort's setting.
        #[schema(value_type = Option<Mirror>)]
        mirror: Checked<Mirror>;
        /// Number of permutations, 0 to 100000. Default: 1000.
        #[schema(value_type = Option<usize>, maximum = 100000)]
        permutations: Checked<usize>;
        /// Seed of the permutations. Default: 0.
        #[schema(value_type = Option<u64>)]
        seed: Checked<u64>;
        /// Attributes within whose values residuals are exchanged: `subject`, `label`, `labels.<attribute>`, or a list.
        #[schema(value_type = Option<Vec<String>>)]
        strata: Checked<Names>;
        /// Priority among the tenant's queued jobs if the request becomes a job. Default: `normal`.
        #[schema(value_type = Option<Priority>)]
        priority: Checked<Priority>;
    }
}

/// Regresses the shapes of a cohort on an attribute.
///
/// All shapes are aligned to their mean, followed by multivariate linear regression on the attribute after the covariates,
/// with the p value of a permutation test (with covariates, that of Freedman and Lane). Small tests are answered at once;
/// others become a job (202) with this result. With `Prefer: wait=N` the response is the result if the job ends within `N`
/// seconds, at most 60. As SVG: the predicted shapes from low to high values.
#[utoipa::path(post, path = "/regressions", tag = "tests", request_body = RegressRequest,
    params(
        ("format" = Option<String>, Query, description = "`json` or `svg`"),
        ("prefer" = Option<String>, Header, description = "`wait=10`: wait up to ten seconds for the job"), RetryHeader
    ),
    responses(
        (status = 200, description = "The regression", content((ShapeRegression = "application/json"), (String = "image/svg+xml"))),
        (status = 202, description = "The job that computes the regression", body = JobOutput, headers(("Location" = String))),
        (status = 404, description = "No such cohort"),
        (status = "4XX", description = "The input was refused, or the job failed within the wait"),
        (status = 503, description = "Too many jobs are waiting")
    ))]
pub(super) async fn regress(
    Caller(app): Caller,
    OnlyFormat(format): OnlyFormat,
    prefer: Prefer,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    let app = app.with_body(&body);
    let mut request: RegressRequest = app.parse(&body)?;
    let app = app.with_priority(priority_of(request.priority.take())?);
    let prepared = regressions::prepare(&app, regress_of(request)?).await?;
    answered(app, prepared, format, prefer).await
}

fn regress_of(request: RegressRequest) -> Result<Regress, ServiceError> {
    let mut errors = request.faults;
    let cohort = take_given(request.cohort, "/cohort", &mut errors);
    let filter = take_or_default(request.filter, "/filter", &mut errors);
    let attribute = take_given(request.attribute, "/attribute", &mut errors);
    let covariates = take_or_default(request.covariates, "/covariates", &mut errors);
    let missing = take_or_default(request.missing, "/missing", &mut errors);
    let transformation = take_given(request.transformation, "/transformation", &mut errors);
    let alignment = take_or_default(request.alignment, "/alignment", &mut errors);
    let mirror = take_given(request.mirror, "/mirror", &mut errors);
    let permutations = take_given(request.permutations, "/permutations", &mut errors);
    let seed = take_or_default(request.seed, "/seed", &mut errors);
    let strata = take_or_default(request.strata, "/strata", &mut errors);
    ServiceError::unless_empty(errors)?;
    let incomplete = || ServiceError::invalid("", "the request is incomplete");
    Ok(Regress {
        cohort: cohort.ok_or_else(incomplete)?,
        filter: filter.ok_or_else(incomplete)?,
        attribute: attribute.ok_or_else(incomplete)?,
        covariates: covariates.ok_or_else(incomplete)?,
        missing: missing.ok_or_else(incomplete)?,
        transformation: transformation.unwrap_or(Transformation::Named(ClassName::Similarity)),
        alignment: alignment.ok_or_else(incomplete)?,
        mirror,
        permutations: permutations.unwrap_or(DEFAULT_PERMUTATIONS),
        seed: seed.ok_or_else(incomplete)?,
        strata: strata.ok_or_else(incomplete)?.0,
    })
}
