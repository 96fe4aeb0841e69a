//! Jobs: list, read, cancel, and follow their events.

use std::convert::Infallible;
use std::time::Duration;

use axum::http::{HeaderMap, StatusCode, header};
use axum::response::sse::{Event, KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use futures_util::stream::{self, Stream, StreamExt};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::api::extract::{Caller, NoQuery, Path, Query};
use crate::api::problem::{Problem, ProblemDocument};
use crate::api::respond::json;
use crate::api::v1::requests::request_macros::{PageQuery, milliseconds, page};
use crate::domain::job::{Job, JobFilter, JobKind, JobStatus};
use crate::domain::study::{
    Comparison, ShapeBlocks, ShapeModel, ShapeModularity, ShapeRegression, ShapeRepeatability, ShapeSymmetry,
};
use crate::service::app::{ServiceError, now_ms};
use crate::service::cohorts::catalogue;
use crate::service::correspondence::CohortCorrespondence;
use crate::service::dictionaries::assessments::AssessedCohort;
use crate::service::dictionaries::learning::LearntDictionary;
use crate::service::dictionaries::report::DictionaryReport;
use crate::service::events::place::Place;
use crate::service::jobs;
use crate::service::jobs::watch::Watch;
use crate::service::search::distances::StoredMatrix;
use crate::service::segmentation::answer::SegmentAnswer;
use crate::service::segmentation::membership::MembersAnswer;
use crate::wire::time::rfc3339;

/// Longest silence on an event stream: proxies close connections that look dead.
const KEEP_ALIVE: Duration = Duration::from_secs(15);

/// Hexadecimal digits of the id of an event.
const ID_DIGITS: usize = 16;

/// A long-running computation, without its result.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct JobEntry {
    /// Identifier.
    #[schema(example = "job_0198c0ffee00700080000000000000aa")]
    id: String,
    /// Kind of work.
    kind: JobKind,
    /// Current status.
    status: JobStatus,
    /// Fraction completed, 0 to 1.
    #[schema(minimum = 0, maximum = 1)]
    progress: f64,
    /// Estimated seconds until a running job ends, from its rate so far; null unless it is running.
    #[schema(minimum = 0)]
    seconds_left: Option<f64>,
    /// Current phase of the work.
    phase: Option<String>,
    /// Current value of the quantity that is minimised or maximised.
    objective: Option<f64>,
    /// Number of attempts so far: a job interrupted by the end of its process is attempted again, five times in total.
    attempt: u32,
    /// Time of creation, RFC 3339 in UTC.
    created_at: String,
    /// Time at which the current or last attempt began, RFC 3339 in UTC.
    started_at: Option<String>,
    /// Time at which the job finished, RFC 3339 in UTC.
    finished_at: Option<String>,
    /// Problem document of the failure; null unless it failed.
    problem: Option<ProblemDocument>,
}

/// A long-running computation.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub struct JobOutput {
    #[serde(flatten)]
    entry: JobEntry,
    /// Result of the job; null unless it succeeded.
    #[schema(value_type = Option<JobResult>)]
    result: Option<Value>,
}

/// Result of a job, by its kind.
#[derive(utoipa::ToSchema)]
#[serde(untagged)]
#[allow(dead_code, reason = "only for the document: results are stored as JSON")]
enum JobResult {
    /// Of `learn_dictionary`.
    Dictionary(LearntDictionary),
    /// Of `distances`.
    Distances(StoredMatrix),
    /// Of `compare`.
    Comparison(Comparison),
    /// Of `regress`.
    Regression(ShapeRegression),
    /// Of `model`.
    Model(Box<ShapeModel>),
    /// Of `repeatability`.
    Repeatability(ShapeRepeatability),
    /// Of `two_blocks`.
    Blocks(ShapeBlocks),
    /// Of `modularity`.
    Modularity(ShapeModularity),
    /// Of `symmetry`.
    Symmetry(ShapeSymmetry),
    /// Of `assess`.
    Assessments(AssessedCohort),
    /// Of `segment`.
    Segmented(SegmentAnswer),
    /// Of `segment`, into a cohort.
    Members(MembersAnswer),
    /// Of `report`.
    Report(DictionaryReport),
    /// Of `correspond`.
    Correspondence(CohortCorrespondence),
}

page! {
    /// One page of jobs.
    PageOfJobs of JobEntry
}

impl From<Job> for JobOutput {
    fn from(mut job: Job) -> Self {
        let result = job.result.take();
        Self { entry: job.into(), result }
    }
}

impl From<Job> for JobEntry {
    fn from(job: Job) -> Self {
        let problem = ProblemDocument::from_failed(&job);
        // Tenths: more digits would promise more than an estimate knows.
        let seconds_left = job.seconds_left(now_ms()).map(|seconds| (10.0 * seconds).round() / 10.0);
        Self {
            id: job.id,
            kind: job.kind,
            status: job.status,
            progress: job.progress,
            seconds_left,
            phase: job.phase,
            objective: job.objective,
            attempt: job.attempt,
            created_at: rfc3339(job.created_at_ms),
            started_at: job.started_at_ms.map(rfc3339),
            finished_at: job.finished_at_ms.map(rfc3339),
            problem,
        }
    }
}

/// Response to a request that has become a job: the location of the job, and its current state.
///
/// # Errors
/// [`ServiceError::Internal`] if the job cannot be serialised (a bug).
pub fn accepted(job: Job) -> Result<Response, ServiceError> {
    let location = format!("/v1/jobs/{}", job.id);
    let response = json(StatusCode::ACCEPTED, &JobOutput::from(job))?;
    Ok(([(header::LOCATION, location)], response).into_response())
}

/// Filter and page of the list of jobs.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(in crate::api::v1) struct JobsQuery {
    /// Jobs with this status only.
    status: Option<JobStatus>,
    /// Jobs of this kind only.
    kind: Option<JobKind>,
    /// Jobs on the cohort with this id or name only.
    cohort: Option<String>,
    /// Jobs created at this time or later only, such as `2026-01-31T12:00:00Z`.
    since: Option<String>,
    /// Cursor from the previous page.
    cursor: Option<String>,
    /// Entries per page, 1 to 1000. Default: 100.
    #[param(minimum = 1, maximum = 1000)]
    limit: Option<usize>,
}

/// Lists jobs, the newest first, without their results.
///
/// Includes all queued and running jobs, and the last 1000 finished ones.
#[utoipa::path(get, path = "/v1/jobs", tag = "jobs", params(JobsQuery),
    responses(
        (status = 200, description = "A page of jobs", body = PageOfJobs),
        (status = 400, description = "The query was refused"),
        (status = 404, description = "No such cohort")
    ))]
pub(in crate::api::v1) async fn list_jobs(
    Caller(app): Caller,
    Query(query): Query<JobsQuery>,
) -> Result<Response, Problem> {
    let page = PageQuery { cursor: query.cursor, limit: query.limit };
    let cohort = match query.cohort {
        Some(key) => Some(catalogue::find(&app, &key).await?.id),
        None => None,
    };
    let since_ms = query.since.as_deref().map(|text| milliseconds("since", text)).transpose()?;
    let filter = JobFilter { status: query.status, kind: query.kind, cohort, since_ms };
    let (items, next) = jobs::list(&app, &filter, page.cursor.as_deref(), page.limit()?).await?;
    let items: Vec<JobEntry> = items.into_iter().map(Into::into).collect();
    Ok(json(StatusCode::OK, &PageOfJobs { items, next })?)
}

/// Returns a job.
#[utoipa::path(get, path = "/v1/jobs/{job}", tag = "jobs", params(("job" = String, Path, description = "Id")),
    responses(
        (status = 200, description = "The job", body = JobOutput),
        (status = 404, description = "No such job")
    ))]
pub(in crate::api::v1) async fn find_job(
    Caller(app): Caller,
    _: NoQuery,
    Path(id): Path<String>,
) -> Result<Response, Problem> {
    Ok(json(StatusCode::OK, &JobOutput::from(jobs::find(&app, &id).await?))?)
}

/// Cancels a job.
///
/// The job is cancelled by the time the response is sent. Cancelling a cancelled job returns it unchanged. A reader cancels only jobs
/// that it has submitted.
#[utoipa::path(post, path = "/v1/jobs/{job}/cancel", tag = "jobs", params(("job" = String, Path, description = "Id")),
    responses(
        (status = 200, description = "The cancelled job", body = JobOutput),
        (status = 403, description = "The job of somebody else, for a reader"),
        (status = 404, description = "No such job"),
        (status = 409, description = "The job has already succeeded or failed")
    ))]
pub(in crate::api::v1) async fn cancel_job(
    Caller(app): Caller,
    _: NoQuery,
    Path(id): Path<String>,
) -> Result<Response, Problem> {
    Ok(json(StatusCode::OK, &JobOutput::from(jobs::cancel(&app, &id).await?))?)
}

/// A server-sent event, as the fields on the stream.
#[derive(Debug, utoipa::ToSchema)]
pub(in crate::api::v1) struct JobEvent {
    /// Event name: `progress`, or the final status.
    #[schema(example = "progress")]
    event: &'static str,
    /// Event id, which identifies the state that the event reports.
    id: String,
    /// The job, as JSON.
    #[schema(content_media_type = "application/json")]
    data: String,
}

impl JobEvent {
    fn new(job: &Job) -> Result<Self, ServiceError> {
        let event = if job.status.is_finished() { job.status.as_str() } else { "progress" };
        let mut output = JobOutput::from(job.clone());
        let text = |output: &JobOutput| {
            serde_json::to_string(output).map_err(|error| ServiceError::Internal(error.to_string()))
        };
        let data = text(&output)?;
        // The estimate changes with every look at the same state.
        output.entry.seconds_left = None;
        let id = blake3::hash(text(&output)?.as_bytes()).to_hex()[..ID_DIGITS].to_owned();
        Ok(Self { event, id, data })
    }
}

impl From<JobEvent> for Event {
    fn from(event: JobEvent) -> Self {
        Self::default().event(event.event).id(event.id).data(event.data)
    }
}

/// Follows a job by server-sent events.
///
/// Each event carries the job as data. Events named `progress` report changes, about five per second at most, and at least one
/// per second while the job is running. The last event is named `succeeded`, `failed` or `cancelled`, and ends the stream. The
/// stream also ends after 15 minutes, when the service stops, and when the key is revoked; clients should reconnect. The event id
/// identifies the state it reports: the state named by `Last-Event-ID` is not sent again, and if it is the final one the response
/// is 204, which stops an `EventSource`. At most 16 streams per caller, together with those of `GET /v1/events`.
#[utoipa::path(get, path = "/v1/jobs/{job}/events", tag = "jobs",
    params(
        ("job" = String, Path, description = "Id"),
        ("Last-Event-ID" = Option<String>, Header, description = "Id of the last event that was received", pattern = "^[0-9a-f]{16}$")
    ),
    responses(
        (status = 200, description = "The events", body = JobEvent, content_type = "text/event-stream"),
        (status = 204, description = "Last-Event-ID names the final state: no further events"),
        (status = 400, description = "Last-Event-ID is not the id of an event"),
        (status = 404, description = "No such job")
    ))]
pub(in crate::api::v1) async fn job_events(
    Caller(app): Caller,
    _: NoQuery,
    Path(id): Path<String>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let last = last_event(&headers)?;
    let job = jobs::find(&app, &id).await?;
    let known = last == Some(JobEvent::new(&job)?.id.as_str());
    if known && job.status.is_finished() {
        return Ok(StatusCode::NO_CONTENT.into_response());
    }
    let place = Place::take(&app)?;
    let events = events(Watch::new(&app, &id, known.then_some(job))).take_until(place.is_over());
    Ok(Sse::new(events).keep_alive(KeepAlive::new().interval(KEEP_ALIVE)).into_response())
}

/// Id of the last event that the client has received.
fn last_event(headers: &HeaderMap) -> Result<Option<&str>, Problem> {
    let Some(value) = headers.get("last-event-id") else { return Ok(None) };
    let is_id = |text: &&str| {
        text.len() == ID_DIGITS && text.bytes().all(|byte| matches!(byte, b'0'..=b'9' | b'a'..=b'f'))
    };
    let id = value.to_str().ok().filter(is_id);
    let detail = "expected the id of an event of a job in Last-Event-ID, got another text";
    id.map(Some).ok_or_else(|| ServiceError::Query(detail.into()).into())
}

/// Events of a job from its current state to the final one.
fn events(watch: Watch) -> impl Stream<Item = Result<Event, Infallible>> {
    stream::unfold(watch, |mut watch| async move {
        let event = match watch.next().await {
            Ok(job) => JobEvent::new(&job?),
            Err(error) => Err(error),
        };
        match event {
            Ok(event) => Some((Ok(event.into()), watch)),
            Err(error) => {
                // The response head is already sent: the client reconnects, and then gets the error.
                tracing::warn!(error = error.cause(), "the events of a job break off");
                None
            }
        }
    })
    .fuse()
}
