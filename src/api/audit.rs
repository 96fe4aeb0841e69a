//! Every request under `/v1` is entered in the audit trail, also one that reads and one that is refused.
//!
//! This stands outside of access control: who was refused is recorded, too. What may change something is answered when its
//! entry is on disk.

use std::collections::{BTreeMap, HashMap};
use std::net::SocketAddr;
use std::sync::Arc;

use axum::extract::{ConnectInfo, FromRequestParts, RawPathParams, Request, State};
use axum::http::request::Parts;
use axum::http::{Method, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use utoipa::openapi::OpenApi;

use super::access::{self, Needs};
use super::observe::{self, Asker};
use super::problem::Problem;
use crate::domain::access::Role;
use crate::domain::audit::Entry;
use crate::service::audit::Trail;
use crate::service::now_ms;

/// What is recorded.
const RECORDED: &str = "/v1/";
/// Longest name of an object that is kept.
const MAX_OBJECT_CHARS: usize = 256;
/// Longest method that is kept: clients may invent some.
const MAX_METHOD_CHARS: usize = 32;
/// What stands in place of a path parameter for the id of what a request has created.
const CREATED: &str = "created";
/// What the middleware needs.
#[derive(Debug, Clone)]
pub struct Recorder {
    trail: Arc<Trail>,
    /// Ids of the operations by route template and method.
    operations: Arc<HashMap<(String, Method), String>>,
}

impl Recorder {
    /// Records the operations of `document` in `trail`.
    pub fn new(trail: Arc<Trail>, document: &OpenApi) -> Self {
        let mut operations = HashMap::new();
        for (path, item) in &document.paths.paths {
            let methods = [
                (Method::GET, &item.get),
                (Method::PUT, &item.put),
                (Method::POST, &item.post),
                (Method::PATCH, &item.patch),
                (Method::DELETE, &item.delete),
            ];
            for (method, operation) in methods {
                let id = operation.as_ref().and_then(|operation| operation.operation_id.clone());
                operations.extend(id.map(|id| ((path.clone(), method), id)));
            }
        }
        Self { trail, operations: Arc::new(operations) }
    }

    fn operation(&self, method: &Method, route: Option<&str>) -> Option<String> {
        // A HEAD is answered by the handler of the GET.
        let method = if method == Method::HEAD { &Method::GET } else { method };
        self.operations.get(&(route?.to_owned(), method.clone())).cloned()
    }
}

/// Records the request.
pub async fn record(State(recorder): State<Recorder>, request: Request, next: Next) -> Response {
    if !request.uri().path().starts_with(RECORDED) {
        return next.run(request).await;
    }
    let asker = request.extensions().get::<Asker>().cloned().unwrap_or_default();
    let (mut parts, body) = request.into_parts();
    let objects = objects(&mut parts).await;
    let request = Request::from_parts(parts, body);
    let mut open = Open { entry: Some(recorder.entry(&request, objects)), asker, trail: &recorder.trail };
    let response = next.run(request).await;
    let Some(entry) = open.close(&response) else { return response };
    let surely = may_have_changed_something(&entry);
    let recorded =
        if surely { recorder.trail.record_surely(entry).await } else { recorder.trail.record(entry).await };
    match recorded {
        Ok(()) => response,
        Err(error) => Problem::from(error).into_response(),
    }
}

impl Recorder {
    fn entry(&self, request: &Request, objects: BTreeMap<String, String>) -> Entry {
        let route = observe::route(request);
        let remote = request.extensions().get::<ConnectInfo<SocketAddr>>();
        Entry {
            operation: self.operation(request.method(), route),
            method: request.method().as_str().chars().take(MAX_METHOD_CHARS).collect(),
            route: route.map(str::to_owned),
            objects,
            request_id: observe::request_id(request).to_owned(),
            remote: remote.map(|ConnectInfo(address)| address.ip().to_string()),
            ..Entry::default()
        }
    }
}

/// The objects that the path names.
async fn objects(parts: &mut Parts) -> BTreeMap<String, String> {
    // A name that is not UTF-8 names nothing; the handler refuses it.
    let Ok(path) = RawPathParams::from_request_parts(parts, &()).await else { return BTreeMap::new() };
    path.iter()
        .map(|(name, value)| (name.to_owned(), value.chars().take(MAX_OBJECT_CHARS).collect()))
        .collect()
}

/// An entry whose request is not answered yet. When the client goes away before it is, that is recorded.
struct Open<'a> {
    entry: Option<Entry>,
    asker: Asker,
    trail: &'a Arc<Trail>,
}

impl Open<'_> {
    /// The entry of the answered request.
    fn close(&mut self, response: &Response) -> Option<Entry> {
        let mut entry = self.take()?;
        entry.status = Some(response.status().as_u16());
        let created = response.headers().get(header::LOCATION).and_then(|place| place.to_str().ok());
        if let Some((_, id)) =
            created.filter(|_| response.status().is_success()).and_then(|p| p.rsplit_once('/'))
        {
            entry.objects.insert(CREATED.to_owned(), id.to_owned());
        }
        Some(entry)
    }

    fn take(&mut self) -> Option<Entry> {
        let mut entry = self.entry.take()?;
        entry.at_ms = now_ms();
        match self.asker.principal() {
            Some(principal) => {
                entry.tenant.clone_from(&principal.tenant);
                entry.key = Some(principal.key.clone());
                entry.subject.clone_from(&principal.subject);
                entry.objects.extend(self.asker.touched().ids());
            }
            // Whose objects they would be is not known, and nobody else shall read their names.
            None => entry.objects.clear(),
        }
        Some(entry)
    }
}

impl Drop for Open<'_> {
    fn drop(&mut self) {
        if let Some(entry) = self.take() {
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

/// Whether the answer has to wait for the entry: what only computes, and what was refused, has changed nothing.
fn may_have_changed_something(entry: &Entry) -> bool {
    let refused = entry.status.is_some_and(|status| (400..500).contains(&status));
    let reads = matches!(entry.method.as_str(), "GET" | "HEAD" | "OPTIONS");
    let needs = entry.route.as_deref().and_then(|route| access::listed(&entry.method, route));
    // What a reader may ask stores nothing.
    let computes = needs == Some(Needs::Role(Role::Reader));
    !(refused || reads || computes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn operations_are_known_by_method_and_route() {
        let recorder = Recorder::new(Arc::default(), &crate::api::openapi());
        let operation = |method, route| recorder.operation(&method, Some(route));
        assert_eq!(operation(Method::GET, "/v1/cohorts/{cohort}").as_deref(), Some("find_cohort"));
        assert_eq!(operation(Method::HEAD, "/v1/cohorts/{cohort}").as_deref(), Some("find_cohort"));
        assert_eq!(operation(Method::DELETE, "/v1/cohorts/{cohort}").as_deref(), Some("delete_cohort"));
        assert_eq!(operation(Method::PUT, "/v1/cohorts/{cohort}"), None);
        assert_eq!(recorder.operation(&Method::GET, None), None);
    }

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
