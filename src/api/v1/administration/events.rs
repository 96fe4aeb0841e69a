//! Events of a tenant: changes and the progress of jobs, as server-sent events.

use std::convert::Infallible;
use std::time::Duration;

use axum::http::HeaderMap;
use axum::response::sse::{Event as Sent, KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use futures_util::stream::{self, Stream, StreamExt};
use serde::{Deserialize, Serialize};

use crate::api::extract::{Caller, Query};
use crate::api::problem::Problem;
use crate::api::v1::administration::jobs::JobEntry;
use crate::domain::change::{ChangeFilter, ChangeKind};
use crate::service::app::{App, ServiceError};
use crate::service::cohorts::catalogue;
use crate::service::cohorts::changes::ChangeOutput;
use crate::service::events::place::Place;
use crate::service::events::{Event, Events, Wanted};

/// Longest silence on an event stream: proxies close connections that look dead.
const KEEP_ALIVE: Duration = Duration::from_secs(15);
/// Name of the events that report a running job.
const PROGRESS: &str = "job_progress";

/// Filter and position of the events.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(in crate::api::v1) struct EventsQuery {
    /// Kinds of events, separated by commas: kinds of changes, and `job_progress`. Default: all.
    #[param(example = "shapes_added,job_succeeded,job_failed")]
    kind: Option<String>,
    /// Events of the cohort with this id or name only, of its shapes, dictionaries and jobs.
    cohort: Option<String>,
    /// Number of the last change already seen, for clients that cannot set `Last-Event-ID`, which takes precedence.
    since: Option<u64>,
}

/// A server-sent event, as the fields on the stream.
#[derive(Debug, utoipa::ToSchema)]
pub(in crate::api::v1) struct TenantEvent {
    /// Event name: the kind of change, or `job_progress`.
    #[schema(example = "shapes_added")]
    event: &'static str,
    /// Number of the change; `job_progress` has none.
    id: Option<String>,
    /// The change as in the change feed, or the job as in the list of jobs, as JSON.
    #[schema(content_media_type = "application/json")]
    data: String,
}

/// An event as it is sent: changes and progress as a [`TenantEvent`], a position without data, which is not an event for clients.
fn to_send(event: Event) -> Result<Sent, ServiceError> {
    let event = match event {
        Event::Change(change) => TenantEvent {
            event: change.kind.as_str(),
            id: Some(change.sequence.to_string()),
            data: text(&ChangeOutput::from(change))?,
        },
        Event::Progress(job) => TenantEvent { event: PROGRESS, id: None, data: text(&JobEntry::from(*job))? },
        Event::Examined(number) => return Ok(position(number)),
    };
    Ok(event.into())
}

/// Tells the client where to continue.
fn position(number: u64) -> Sent {
    Sent::default().id(number.to_string()).comment("position")
}

fn text(value: &impl Serialize) -> Result<String, ServiceError> {
    serde_json::to_string(value).map_err(|error| ServiceError::Internal(error.to_string()))
}

impl From<TenantEvent> for Sent {
    fn from(TenantEvent { event, id, data }: TenantEvent) -> Self {
        let sent = Self::default().event(event).data(data);
        match id {
            Some(id) => sent.id(id),
            None => sent,
        }
    }
}

/// Follows the events of the tenant by server-sent events.
///
/// Each change is sent as an event whose name is its kind and whose id is its number; `Last-Event-ID` continues after that
/// number, and nothing in between is lost. Without it the stream begins with changes from now on. Running jobs are
/// reported once a second by events named `job_progress`, which have no id. Only changes and jobs that the caller may
/// see are sent. The stream ends after 15 minutes, when the service stops, and when the key is revoked; clients should
/// reconnect. At most 16 streams per caller, together with those of jobs.
#[utoipa::path(get, path = "/v1/events", tag = "changes",
    params(EventsQuery, ("Last-Event-ID" = Option<u64>, Header, description = "Number of the last change received")),
    responses(
        (status = 200, description = "The events", body = TenantEvent, content_type = "text/event-stream"),
        (status = 404, description = "No such cohort"),
        (status = 410, description = "Changes that old are no longer available"),
        (status = "4XX", description = "The query was refused")
    ))]
pub(in crate::api::v1) async fn list_events(
    Caller(app): Caller,
    Query(query): Query<EventsQuery>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let after = last_event(&headers)?.or(query.since);
    let place = Place::take(&app)?;
    let events = Events::open(&app, wanted(&app, query).await?, after).await?;
    // The position is known before the first event: a client that reconnects at once misses nothing.
    let opening = position(events.first());
    let events = stream::once(async { Ok(opening) }).chain(sent(events)).take_until(place.is_over());
    Ok(Sse::new(events).keep_alive(KeepAlive::new().interval(KEEP_ALIVE)).into_response())
}

/// Number of the last change that the client has received.
fn last_event(headers: &HeaderMap) -> Result<Option<u64>, Problem> {
    let Some(value) = headers.get("last-event-id") else { return Ok(None) };
    let number = value.to_str().ok().and_then(|text| text.parse().ok());
    let refused =
        || ServiceError::Query("expected the number of a change in Last-Event-ID, got another text".into());
    number.map(Some).ok_or_else(|| refused().into())
}

async fn wanted(app: &App, query: EventsQuery) -> Result<Wanted, Problem> {
    let words: Option<Vec<&str>> = query.kind.as_deref().map(|text| text.split(',').map(str::trim).collect());
    let progress = words.as_ref().is_none_or(|words| words.contains(&PROGRESS));
    let kinds: Option<Result<Vec<_>, _>> =
        words.map(|words| words.into_iter().filter(|word| *word != PROGRESS).map(kind).collect());
    let cohort = match &query.cohort {
        Some(key) => Some(catalogue::find(app, key).await?.id),
        None => None,
    };
    Ok(Wanted { changes: ChangeFilter { kinds: kinds.transpose()?, cohort }, progress })
}

fn kind(word: &str) -> Result<ChangeKind, Problem> {
    ChangeKind::from_word(word).ok_or_else(|| {
        let names: Vec<&str> =
            ChangeKind::ALL.into_iter().map(ChangeKind::as_str).chain([PROGRESS]).collect();
        let detail = format!("expected kinds of events among {}, got '{word}'", names.join(", "));
        Problem::of_parameter("kind", detail)
    })
}

fn sent(events: Events) -> impl Stream<Item = Result<Sent, Infallible>> {
    stream::unfold(events, |mut events| async move {
        let event = match events.next().await {
            Ok(event) => to_send(event?),
            Err(error) => Err(error),
        };
        match event {
            Ok(event) => Some((Ok(event), events)),
            Err(error) => {
                // The response head is already sent: the client reconnects, and then gets the error.
                tracing::warn!(error = error.cause(), "a stream of events breaks off");
                None
            }
        }
    })
    .fuse()
}
