//! Assessments of all shapes of a cohort with a dictionary, as lines: at once, or as the output of a job; and those that are
//! stored beside the shapes.

use axum::body::Bytes;
use axum::http::{HeaderName, StatusCode, header};
use axum::response::{IntoResponse, Response};
use futures_util::stream;

use crate::analysis::defaults::OUTLIER_QUANTILE;
use crate::api::extract::{Caller, JsonBody, NoQuery, Path, Prefer, PrefersLines, Query};
use crate::api::problem::Problem;
use crate::api::respond::{json, streamed};
#[cfg(feature = "schema")]
use crate::api::v1::requests::described::*;
use crate::api::v1::requests::entity_tags::not_stored;
use crate::api::v1::requests::planned::{Waited, waited};
use crate::api::v1::requests::request_macros::{PageQuery, page, priority_of};
use crate::api::v1::requests::shape_query::{Parameters, take_filter};
use crate::domain::filter::ShapeFilter;
use crate::domain::job::{OutputParts, Priority};
use crate::service::app::{App, ServiceError};
use crate::service::dictionaries::assessments::{self, AssessCohort};
use crate::service::dictionaries::stored_assessments::{self, StoredAssessmentOutput, StoredListing};
use crate::service::jobs;
use crate::wire::checked::{Checked, document, take_given, take_or_default};

/// Revision of the cohort that lines were made from.
const REVISION: HeaderName = HeaderName::from_static("shapelex-revision");

document! {
    /// Shapes of a cohort to assess.
    #[schema(example = json!({"cohort": "example-cells", "filter": {"labels": {"treatment": "control"}}}))]
    pub(in crate::api::v1) struct AssessCohortRequest {
        /// Id or name of a cohort in the dictionary's representation.
        #[schema(value_type = String, required = true)]
        cohort: Checked<String>, required;
        /// Filter that selects shapes of the cohort. Default: all shapes.
        #[schema(value_type = Option<ShapeFilter>)]
        filter: Checked<ShapeFilter>;
        /// Training quantile, from 0.5, beyond which a shape is an outlier or of none of the classes. Default: 0.99.
        #[schema(value_type = Option<f64>, minimum = 0.5, exclusive_maximum = 1)]
        quantile: Checked<f64>;
        /// Number of parameters at which the residual is returned. Default: 0.
        #[schema(value_type = Option<usize>)]
        samples: Checked<usize>;
        /// Whether the assessments are stored beside the shapes, each in place of an earlier one by the same version. Default:
        /// false.
        #[schema(value_type = Option<bool>)]
        store: Checked<bool>;
        /// Priority among the tenant's queued jobs if the request becomes a job. Default: `normal`.
        #[schema(value_type = Option<Priority>)]
        priority: Checked<Priority>;
    }
}

/// Assesses the shapes of a cohort: one line per shape, in the order of the cohort at its present revision.
///
/// A line is an entry of `POST …/assess` with the dictionary beside it; a shape without an assessment has an `error`. Few shapes
/// are answered at once (200). More become a job (202), whose output are the lines; with `Prefer: wait=N` they are answered if they
/// are ready within `N` seconds, at most 60. `Prefer: respond-async` asks for a job in any case.
#[utoipa::path(post, path = "/v1/dictionaries/{dictionary}/assessments", tag = "dictionaries", request_body = AssessCohortRequest,
    params(
        ("dictionary" = String, Path, description = "Id, `name@version`, `name@alias` or name"),
        ("prefer" = Option<String>, Header, description = "`wait=10`: wait up to ten seconds for the job; `respond-async`: make a job in any case"),
        RetryHeader
    ),
    responses(
        (status = 200, description = "One line per shape, each a `CohortAssessment`", content((String = "application/x-ndjson"))),
        (status = 202, description = "The job that assesses the shapes", body = JobOutput, headers(("Location" = String))),
        (status = 404, description = "No such dictionary or cohort"),
        (status = "4XX", description = "The input was refused, or the job failed within the wait"),
        (status = 503, description = "Too many jobs are waiting")
    ))]
pub(in crate::api::v1) async fn assess_cohort(
    Caller(app): Caller,
    _: NoQuery,
    _: PrefersLines,
    prefer: Prefer,
    Path(key): Path<String>,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    let app = app.with_body(&body);
    let mut request: AssessCohortRequest = app.parse(&body)?;
    let app = app.with_priority(priority_of(request.priority.take())?);
    let planned = assessments::plan(&app, &key, asked_of(request)?).await?;
    if planned.is_quick() && !prefer.respond_async {
        let lines = planned.lines(&app).await?;
        let revision = [(REVISION, lines.revision.to_string())];
        return Ok((revision, [(header::CONTENT_TYPE, NDJSON)], lines.text).into_response());
    }
    match waited(&app, planned.submit(&app).await?, prefer).await? {
        Waited::Succeeded(job) => Ok(lines_of(app, job.id).await?),
        Waited::Else(response) => Ok(response),
    }
}

/// Lines of a job that has succeeded.
async fn lines_of(app: App, job: String) -> Result<Response, ServiceError> {
    let missing = || ServiceError::Internal("a job of lines without lines".into());
    let (output, _room) = jobs::output(&app, &job).await?;
    let parts = output.parts().ok_or_else(missing)?;
    Ok(stored_lines(app, job, parts))
}

const NDJSON: &str = "application/x-ndjson";

fn asked_of(request: AssessCohortRequest) -> Result<AssessCohort, ServiceError> {
    let mut errors = request.faults;
    let cohort = take_given(request.cohort, "/cohort", &mut errors);
    let filter = take_filter(request.filter, "/filter", &mut errors);
    let quantile =
        request.quantile.map_or(Some(OUTLIER_QUANTILE), |field| field.take("/quantile", &mut errors));
    let samples = take_or_default(request.samples, "/samples", &mut errors);
    let store = take_or_default(request.store, "/store", &mut errors);
    ServiceError::unless_empty(errors)?;
    match (cohort, filter, quantile, samples, store) {
        (Some(cohort), Some(filter), Some(quantile), Some(samples), Some(store)) => {
            Ok(AssessCohort { cohort, filter, quantile, samples, store })
        }
        _ => Err(ServiceError::invalid("", "the request is incomplete")),
    }
}

/// Lines that a job has stored, sent as they are read: one part after the other.
pub(in crate::api::v1) fn stored_lines(app: App, job: String, parts: OutputParts) -> Response {
    let lines = stream::try_unfold((app, job, 0), move |(app, job, part)| async move {
        if part == parts.count {
            return Ok::<_, ServiceError>(None);
        }
        let lines = jobs::output_part(&app, &job, parts, part).await?;
        Ok(Some((Bytes::from(lines), (app, job, part + 1))))
    });
    ([(header::CONTENT_TYPE, NDJSON)], streamed(lines)).into_response()
}

/// Selects stored assessments, beside the filter of their shapes.
#[derive(utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code, reason = "only for the document; `Parameters` reads them")]
pub(in crate::api::v1) struct AssessmentsQuery {
    /// Only assessments by this version: id, `name@version`, `name@alias` or name. Default: all versions.
    dictionary: Option<String>,
    /// Only shapes that were assigned to this class, and belong to it.
    class: Option<String>,
    /// Only shapes that are outliers, or only those that are not.
    is_outlier: Option<bool>,
}

page! {
    /// One page of the assessments stored beside the shapes of a cohort.
    PageOfAssessments of StoredAssessmentOutput
}

/// Lists the assessments that are stored beside the shapes of a cohort.
///
/// `POST /v1/dictionaries/{dictionary}/assessments` stores them with `"store": true`: for each shape and version of a dictionary
/// the latest one. Shapes that were deleted are left out. A page is shorter than `limit` if its assessments take more than 8 MiB.
#[utoipa::path(get, path = "/v1/cohorts/{cohort}/assessments", tag = "cohorts",
    params(("cohort" = String, Path, description = "Id or name"), AssessmentsQuery, FilterQuery, PageQuery),
    responses(
        (status = 200, description = "A page of assessments, in the order of the ids of dictionaries and shapes", body = PageOfAssessments),
        (status = 404, description = "No such cohort or dictionary"),
        (status = "4XX", description = "The query was refused")
    ))]
pub(in crate::api::v1) async fn list_assessments(
    Caller(app): Caller,
    Path(key): Path<String>,
    Query(pairs): Query<Vec<(String, String)>>,
) -> Result<Response, Problem> {
    let mut parameters = Parameters::read(pairs)?;
    let page = PageQuery { cursor: parameters.take("cursor"), limit: parameters.take_count("limit")? };
    let listing = StoredListing {
        filter: parameters.take_filter(),
        dictionary: parameters.take("dictionary"),
        class: parameters.take("class"),
        is_outlier: parameters.take_choice("is_outlier")?,
        limit: page.limit()?,
        cursor: page.cursor,
    };
    parameters.refuse_rest()?;
    let (items, next) = stored_assessments::list(&app, &key, &listing).await?;
    Ok(not_stored(json(StatusCode::OK, &PageOfAssessments { items, next })?))
}
