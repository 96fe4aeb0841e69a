//! Audit middleware: records every request under `/v1`, including reads and refused requests.
//!
//! It wraps access control, so that refused callers are recorded too. Responses to requests that may change something are
//! sent once their entry is on disk, and such requests are not started while entries cannot be written. Requests without a
//! known caller are counted per address and minute; the first of them gets an entry.

use std::collections::BTreeMap;
use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;

use axum::extract::{ConnectInfo, FromRequestParts, RawPathParams, Request, State};
use axum::http::request::Parts;
use axum::http::{HeaderName, HeaderValue, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use super::observe::{self, Asker};
use super::operation::{self, Needs};
use super::problem::Problem;
use crate::domain::access::Role;
use crate::domain::audit::Entry;
use crate::service::app::now_ms;
use crate::service::audit::trail::{Recording, Trail};

/// Path prefix of the recorded requests.
const RECORDED: &str = "/v1/";
/// Object names are truncated to this length.
const MAX_OBJECT_CHARS: usize = 256;
/// Methods are truncated to this length: clients may invent some.
const MAX_METHOD_CHARS: usize = 32;
/// Name under which an entry lists the id of a created object, in place of a path parameter.
const CREATED: &str = "created";
/// Header of a response that is not in the trail, and its value.
const AUDIT: HeaderName = HeaderName::from_static("shapelex-audit");
const UNRECORDED: HeaderValue = HeaderValue::from_static("unrecorded");
/// Header of an answer to a request that was executed before, and its value.
const REPLAYED: HeaderName = HeaderName::from_static("idempotency-replayed");
const TRUE: HeaderValue = HeaderValue::from_static("true");
/// Parameters of a path that are not recorded: the trail must not keep the identifier of a subject that is erased.
const PRIVATE: [&str; 1] = ["subject"];
/// State of the middleware.
#[derive(Debug, Clone)]
pub struct Recorder {
    trail: Arc<Trail>,
}

impl Recorder {
    /// Records requests in `trail`.
    pub fn new(trail: Arc<Trail>) -> Self {
        Self { trail }
    }
}

/// Middleware that records the request.
pub async fn record(State(recorder): State<Recorder>, request: Request, next: Next) -> Response {
    let asker = request.extensions().get::<Asker>().cloned().unwrap_or_default();
    let is_probe = observe::route(&request).is_some_and(observe::is_probe);
    if !request.uri().path().starts_with(RECORDED) {
        let (network, id) = (observe::network(&request), observe::request_id(&request).to_owned());
        let response = next.run(request).await;
        if response.status().is_client_error() && asker.principal().is_none() && !is_probe {
            count(&recorder.trail, &asker, network, reason(&response), &id, false);
        }
        return response;
    }
    let (mut parts, body) = request.into_parts();
    let objects = objects(&mut parts).await;
    let request = Request::from_parts(parts, body);
    let entry = recorder.entry(&request, objects);
    if may_change_something(&entry)
        && let Err(error) = recorder.trail.check()
    {
        return Problem::from(error).into_response();
    }
    let network = observe::network(&request);
    let touched = asker.touched().clone();
    let mut open = Open { entry: Some(entry), asker, network, trail: &recorder.trail };
    let mut response = next.run(request).await;
    if touched.is_repeat() {
        response.headers_mut().insert(REPLAYED, TRUE);
    }
    match open.close(&response) {
        Some(entry) => recorder.answer(entry, response).await,
        None => response,
    }
}

/// Counts a request without a known caller; returns whether it is the first of its address in this minute.
fn count(
    trail: &Trail,
    asker: &Asker,
    network: Option<IpAddr>,
    reason: &'static str,
    id: &str,
    has_entry: bool,
) -> bool {
    if trail.refusals().is_loud(network) {
        asker.hush();
    }
    trail.refusals().count(network, reason, id, has_entry, now_ms())
}

/// Problem code of a refused request.
fn reason(response: &Response) -> &'static str {
    match response.extensions().get::<Problem>() {
        Some(problem) => problem.kind().code(),
        None if response.status().is_success() => "answered",
        None => "refused",
    }
}

impl Recorder {
    /// Records the entry as durably as required, then returns the response.
    async fn answer(&self, entry: Entry, mut response: Response) -> Response {
        let recorded = if may_have_changed_something(&entry) {
            self.trail.record_surely(entry).await.map(|()| Recording::Kept)
        } else {
            self.trail.record(entry).await
        };
        match recorded {
            Ok(Recording::Kept) => response,
            Ok(Recording::Counted) => {
                response.headers_mut().insert(AUDIT, UNRECORDED);
                response
            }
            Err(error) => Problem::from(error).into_response(),
        }
    }
}

impl Recorder {
    fn entry(&self, request: &Request, objects: BTreeMap<String, String>) -> Entry {
        let route = observe::route(request);
        let operation = route.and_then(|route| operation::find(request.method().as_str(), route));
        let remote = request.extensions().get::<ConnectInfo<SocketAddr>>();
        Entry {
            operation: operation.map(|operation| operation.id.to_owned()),
            method: request.method().as_str().chars().take(MAX_METHOD_CHARS).collect(),
            route: route.map(str::to_owned),
            objects,
            request_id: observe::request_id(request).to_owned(),
            remote: remote.map(|ConnectInfo(address)| address.ip().to_string()),
            ..Entry::default()
        }
    }
}

/// Objects named in the path.
async fn objects(parts: &mut Parts) -> BTreeMap<String, String> {
    // A name that is not UTF-8 identifies nothing; the handler refuses it.
    let Ok(path) = RawPathParams::from_request_parts(parts, &()).await else { return BTreeMap::new() };
    path.iter()
        .filter(|(name, _)| !PRIVATE.contains(name))
        .map(|(name, value)| (name.to_owned(), value.chars().take(MAX_OBJECT_CHARS).collect()))
        .collect()
}

/// Entry of an unanswered request. If the client disconnects first, dropping it records that.
struct Open<'a> {
    entry: Option<Entry>,
    asker: Asker,
    network: Option<IpAddr>,
    trail: &'a Arc<Trail>,
}

impl Open<'_> {
    /// Entry of the answered request; `None` if the request was only counted.
    fn close(&mut self, response: &Response) -> Option<Entry> {
        let mut entry = self.take(reason(response))?;
        entry.status = Some(response.status().as_u16());
        let created = response.headers().get(header::LOCATION).and_then(|place| place.to_str().ok());
        if let Some((_, id)) =
            created.filter(|_| response.status().is_success()).and_then(|p| p.rsplit_once('/'))
        {
            entry.objects.insert(CREATED.to_owned(), id.to_owned());
        }
        Some(entry)
    }

    /// Entry of a request with a known caller. Other requests are counted by their `reason`, and the first of an address gets
    /// an entry without objects: their tenant is unknown, and no tenant may read the names of another.
    fn take(&mut self, reason: &'static str) -> Option<Entry> {
        let mut entry = self.entry.take()?;
        entry.at_ms = now_ms();
        let Some(principal) = self.asker.principal() else {
            let is_first = count(self.trail, &self.asker, self.network, reason, &entry.request_id, true);
            entry.objects.clear();
            return is_first.then_some(entry);
        };
        entry.tenant.clone_from(&principal.tenant);
        entry.key = Some(principal.key.clone());
        entry.subject.clone_from(&principal.subject);
        entry.objects.extend(self.asker.touched().ids());
        // The id tells which shape it was, and an external id may tell whose: the trail outlives an erasure.
        if entry.objects.contains_key("shape_id") {
            entry.objects.remove("shape");
        }
        Some(entry)
    }
}

impl Drop for Open<'_> {
    fn drop(&mut self) {
        if let Some(entry) = self.take("gone") {
            let trail = Arc::clone(self.trail);
            tokio::spawn(async move {
                if let Err(error) = trail.record(entry).await {
                    tracing::error!(
                        error = error.cause(),
                        "a request whose client went away is not in the audit trail"
                    );
                }
            });
        }
    }
}

/// Whether the response must wait for the entry; computations and refused requests have changed nothing.
fn may_have_changed_something(entry: &Entry) -> bool {
    let refused = entry.status.is_some_and(|status| (400..500).contains(&status));
    !refused && may_change_something(entry)
}

/// Whether a request of this kind may change something.
fn may_change_something(entry: &Entry) -> bool {
    let reads = matches!(entry.method.as_str(), "GET" | "HEAD" | "OPTIONS");
    let operation = entry.route.as_deref().and_then(|route| operation::find(&entry.method, route));
    // Operations open to readers store nothing.
    let computes = operation.is_some_and(|operation| operation.needs == Needs::Role(Role::Reader));
    !(reads || computes || entry.route.is_none())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_may_have_changed_something_waits_for_its_entry() {
        let waits = |method: &str, route: &str, status| {
            may_have_changed_something(&Entry {
                method: method.into(),
                route: Some(route.into()),
                status,
                ..Entry::default()
            })
        };
        assert!(waits("POST", "/v1/cohorts", Some(201)));
        assert!(waits("DELETE", "/v1/cohorts/{cohort}", Some(500)));
        assert!(waits("POST", "/v1/cohorts", None));
        assert!(!waits("POST", "/v1/cohorts", Some(409)));
        assert!(!waits("GET", "/v1/cohorts/{cohort}", Some(200)));
        assert!(!waits("POST", "/v1/mean", Some(200)));
    }
}
