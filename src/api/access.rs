//! Access control: identifies the caller once per request, before its handler, and checks the caller's role.
//!
//! Every operation needs a role, listed in `OPERATIONS`. Operations not in the table need an administrator.

use std::collections::HashMap;
use std::sync::{Arc, LazyLock};

use axum::extract::{MatchedPath, Request};
use axum::http::header::{AUTHORIZATION, HOST};
use axum::http::uri::Authority;
use axum::http::{HeaderMap, Method};
use axum::response::{IntoResponse, Response};
use utoipa::openapi::OpenApi;
use utoipa::openapi::extensions::Extensions;
use utoipa::openapi::header::Header;
use utoipa::openapi::path::{Operation, PathItem};
use utoipa::openapi::security::{HttpAuthScheme, HttpBuilder, SecurityRequirement, SecurityScheme};

use super::document::refusal;
use super::observe::{self, Asker};
use super::origin;
use super::problem::{Problem, ProblemKind};
use crate::domain::access::{Principal, Role, is_loopback};
use crate::service::access::{Shown, identify};
use crate::service::app::App;

/// Access that an operation requires.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Needs {
    /// None: open to everyone.
    Nothing,
    /// At least this role.
    Role(Role),
}

impl Needs {
    /// Word used in the OpenAPI document.
    fn as_str(self) -> &'static str {
        match self {
            Self::Nothing => "none",
            Self::Role(role) => role.as_str(),
        }
    }
}

/// Access that every operation requires: a reader for reading or computing without storing, a writer for storing or
/// submitting jobs, an administrator for managing keys and hooks, and for what cannot be undone.
const OPERATIONS: &[(Needs, &[&str])] = &[
    (Needs::Nothing, &["GET /livez", "GET /readyz"]),
    (
        Needs::Role(Role::Reader),
        &[
            "GET /metrics",
            "GET /v1/changes",
            "GET /v1/cohorts",
            "GET /v1/cohorts/{cohort}",
            "GET /v1/cohorts/{cohort}/assessments",
            "GET /v1/cohorts/{cohort}/attributes",
            "GET /v1/cohorts/{cohort}/export",
            "GET /v1/cohorts/{cohort}/mean",
            "GET /v1/cohorts/{cohort}/shapes",
            "GET /v1/cohorts/{cohort}/shapes/{shape}",
            "GET /v1/cohorts/{cohort}/table",
            "POST /v1/cohorts/{cohort}/table",
            "GET /v1/cohorts/{cohort}/sheet",
            "GET /v1/dictionaries",
            "GET /v1/dictionaries/{dictionary}",
            "GET /v1/dictionaries/{dictionary}/aliases",
            "GET /v1/dictionaries/{dictionary}/aliases/{alias}",
            "GET /v1/dictionaries/{dictionary}/atoms",
            "GET /v1/dictionaries/{dictionary}/drift",
            "GET /v1/dictionaries/{dictionary}/export",
            "GET /v1/dictionaries/{dictionary}/modes",
            "GET /v1/events",
            "GET /v1/formats",
            "GET /v1/generators",
            "GET /v1/generators/{name}",
            "GET /v1/idealised",
            "GET /v1/jobs",
            "GET /v1/jobs/{job}",
            "GET /v1/jobs/{job}/events",
            "GET /v1/jobs/{job}/output",
            "GET /v1/transformations",
            "GET /v1/trash",
            "GET /v1/version",
            "POST /v1/align",
            "POST /v1/cohorts/{cohort}/search",
            "POST /v1/contours",
            "POST /v1/convert",
            "POST /v1/deform",
            "POST /v1/dictionaries/{dictionary}/assess",
            "POST /v1/dictionaries/{dictionary}/classify",
            "POST /v1/dictionaries/{dictionary}/complete",
            "POST /v1/dictionaries/{dictionary}/correspond",
            "POST /v1/dictionaries/{dictionary}/encode",
            "POST /v1/dictionaries/{dictionary}/prior",
            "POST /v1/dictionaries/{dictionary}/reconstruct",
            "POST /v1/dictionaries/{dictionary}/sample",
            "POST /v1/dictionaries/{dictionary}/score",
            "POST /v1/evaluate",
            "POST /v1/fit",
            "POST /v1/idealised",
            "POST /v1/inspect",
            "POST /v1/mean",
            "POST /v1/measure",
            "POST /v1/morph",
            "POST /v1/overlap",
            "POST /v1/pca",
            "POST /v1/pca/incomplete",
            "POST /v1/prior",
            "POST /v1/project",
            "POST /v1/refine",
            "POST /v1/resample",
            "POST /v1/segment",
            "POST /v1/sheets",
            "POST /v1/subdivide",
        ],
    ),
    (
        Needs::Role(Role::Writer),
        &[
            "DELETE /v1/cohorts/{cohort}",
            "DELETE /v1/cohorts/{cohort}/shapes",
            "DELETE /v1/cohorts/{cohort}/shapes/{shape}",
            "DELETE /v1/dictionaries/{dictionary}",
            "DELETE /v1/dictionaries/{dictionary}/aliases/{alias}",
            "PATCH /v1/cohorts/{cohort}",
            "PATCH /v1/cohorts/{cohort}/shapes/{shape}",
            "POST /v1/cohorts",
            "POST /v1/cohorts/{cohort}/correspond",
            "POST /v1/cohorts/{cohort}/segment",
            "POST /v1/cohorts/{cohort}/shapes",
            "POST /v1/comparisons",
            "POST /v1/dictionaries",
            "POST /v1/dictionaries/import",
            "POST /v1/dictionaries/{dictionary}/assessments",
            "POST /v1/dictionaries/{dictionary}/report",
            "POST /v1/distances",
            "POST /v1/jobs/{job}/cancel",
            "POST /v1/regressions",
            "POST /v1/trash/{id}/restore",
            "PUT /v1/dictionaries/{dictionary}/aliases/{alias}",
        ],
    ),
    (
        Needs::Role(Role::Admin),
        &[
            "DELETE /v1/audit",
            "DELETE /v1/hooks/{hook}",
            "DELETE /v1/keys/{key}",
            "DELETE /v1/subjects/{subject}",
            "DELETE /v1/trash/{id}",
            "GET /v1/audit",
            "GET /v1/hooks",
            "GET /v1/hooks/{hook}",
            "GET /v1/hooks/{hook}/failures",
            "GET /v1/keys",
            "GET /v1/keys/{key}",
            "GET /v1/settings",
            "POST /v1/hooks",
            "POST /v1/hooks/{hook}/pause",
            "POST /v1/hooks/{hook}/redeliver",
            "POST /v1/hooks/{hook}/resume",
            "POST /v1/keys",
        ],
    ),
];

static TABLE: LazyLock<HashMap<(&str, &str), Needs>> = LazyLock::new(|| {
    let rows = OPERATIONS.iter().flat_map(|(needs, names)| names.iter().map(move |name| (name, *needs)));
    rows.filter_map(|(name, needs)| Some((name.split_once(' ')?, needs))).collect()
});

/// Access required by `method` on the route template, if it is in the table.
pub fn listed(method: &str, route: &str) -> Option<Needs> {
    TABLE.get(&(method, route)).copied()
}

/// Access required by `method` on the route template.
fn needed(method: &Method, route: &str) -> Needs {
    let method = if method == Method::HEAD { &Method::GET } else { method };
    listed(method.as_str(), route).unwrap_or(Needs::Role(Role::Admin))
}

/// Identifies the caller and leaves it in the request extensions; the refusal of a request that is not authorised.
pub(super) async fn refuse(request: &mut Request) -> Option<Response> {
    let Some(app) = request.extensions().get::<App>().cloned() else {
        return Some(Problem::new(ProblemKind::Internal, "a request without the context").into_response());
    };
    let route = request.extensions().get::<MatchedPath>().map_or("", MatchedPath::as_str);
    let needs = match needed(request.method(), route) {
        Needs::Role(_) if route == "/metrics" && app.metrics_are_open() => Needs::Nothing,
        needs => needs,
    };
    let Needs::Role(role) = needs else { return None };
    let quiet = app.trail().refusals().is_loud(observe::network(request));
    match identify(&app, shown(request.headers()), quiet).await {
        Ok(principal) => {
            let (allowed, principal) = (check(&app, &principal, role, request), Arc::new(principal));
            if let Some(asker) = request.extensions().get::<Asker>() {
                asker.is(&principal);
            }
            request.extensions_mut().insert(principal);
            allowed.err().map(IntoResponse::into_response)
        }
        Err(error) => Some(Problem::from(error).into_response()),
    }
}

/// Credentials that a request presents.
fn shown(headers: &HeaderMap) -> Shown<'_> {
    let mut values = headers.get_all(AUTHORIZATION).iter();
    let Some(value) = values.next() else { return Shown::Nothing };
    let token = value.to_str().ok().and_then(|text| text.split_once(' '));
    match token {
        Some((scheme, token)) if scheme.eq_ignore_ascii_case("bearer") && values.next().is_none() => {
            Shown::Bearer(token.trim())
        }
        _ => Shown::Unreadable,
    }
}

/// Checks that a caller may use an operation that needs `role`.
fn check(app: &App, principal: &Principal, role: Role, request: &Request) -> Result<(), Problem> {
    let refuse = |detail: String| Err(Problem::new(ProblemKind::Forbidden, detail));
    if principal.is_local() && !names_this_machine(request) {
        return refuse(
            "expected a loopback name or address in the Host header, because the service has no keys".into(),
        );
    }
    if principal.is_local()
        && let Some(header) = origin::foreign(request.uri(), request.headers())
        && !origin::only(request.headers()).is_some_and(|origin| app.allows_origin(origin))
    {
        return refuse(format!(
            "expected the service's own origin in {header}, because the service has no keys: create a key to \
             answer pages of other sites or ports, or list their origin in allow_origin"
        ));
    }
    if principal.role < role {
        let (key, found, needed) = (&principal.key, principal.role.as_str(), role.as_str());
        tracing::info!(key, role = found, needed, "a request needs a higher role");
        return refuse(format!("expected the role {needed}, the caller has the role {found}"));
    }
    Ok(())
}

/// Whether the request names this machine as its host. A page of another site can make its own host name resolve to a
/// loopback address; accepting it would give the page access reserved for users of this machine.
fn names_this_machine(request: &Request) -> bool {
    let header = || {
        let mut values = request.headers().get_all(HOST).iter();
        let value = values.next().filter(|_| values.next().is_none())?;
        value.to_str().ok()?.parse::<Authority>().ok()
    };
    let authority = request.uri().authority().cloned().or_else(header);
    authority.is_some_and(|authority| is_loopback(authority.host()))
}

/// Name of the security scheme in the OpenAPI document.
const SCHEME: &str = "bearer";

/// Adds access control to the OpenAPI document: the scheme, the role of every operation (`x-role`), and the responses to
/// unauthorised requests.
pub fn describe(document: &mut OpenApi) {
    let scheme = HttpBuilder::new().scheme(HttpAuthScheme::Bearer).description(Some(
        "A key (`shk_…`) or a token of the identity provider. Not required on a loopback address without keys \
         and identity provider.",
    ));
    let components = document.components.get_or_insert_default();
    components.security_schemes.insert(SCHEME.into(), SecurityScheme::Http(scheme.build()).into());
    for (path, item) in &mut document.paths.paths {
        for (method, operation) in operations(item) {
            describe_operation(operation, needed(&method, path));
        }
    }
}

fn operations(item: &mut PathItem) -> impl Iterator<Item = (Method, &mut Operation)> {
    let methods = [
        (Method::GET, item.get.as_mut()),
        (Method::POST, item.post.as_mut()),
        (Method::PUT, item.put.as_mut()),
        (Method::PATCH, item.patch.as_mut()),
        (Method::DELETE, item.delete.as_mut()),
    ];
    methods.into_iter().filter_map(|(method, operation)| Some((method, operation?)))
}

fn describe_operation(operation: &mut Operation, needs: Needs) {
    let role = Extensions::from_iter([("x-role", needs.as_str())]);
    operation.extensions.get_or_insert_default().merge(role);
    let Needs::Role(role) = needs else {
        operation.security = Some(Vec::new());
        return;
    };
    operation.security = Some(vec![SecurityRequirement::new::<_, [&str; 0], _>(SCHEME, [])]);
    let unknown = refusal("No valid key or token");
    let unknown = unknown.header("WWW-Authenticate", Header::default());
    let forbidden =
        refusal(format!("The caller lacks the role {}, or its key does not cover this", role.as_str()));
    let responses = &mut operation.responses.responses;
    responses.entry("401".into()).or_insert_with(|| unknown.build().into());
    responses.entry("403".into()).or_insert_with(|| forbidden.build().into());
}

#[cfg(test)]
mod tests {
    use axum::body::Body;

    use super::*;

    #[test]
    fn the_table_has_every_operation_once_and_nothing_else_is_open() {
        let rows: usize = OPERATIONS.iter().map(|(_, names)| names.len()).sum();
        assert_eq!(TABLE.len(), rows, "an operation is listed twice, or without its method");
        assert_eq!(needed(&Method::HEAD, "/v1/cohorts"), Needs::Role(Role::Reader));
        assert_eq!(needed(&Method::GET, "/v1/unknown"), Needs::Role(Role::Admin));
        assert_eq!(needed(&Method::PATCH, "/v1/cohorts"), Needs::Role(Role::Admin));
        assert_eq!(needed(&Method::GET, ""), Needs::Role(Role::Admin));
    }

    #[test]
    fn one_bearer_token_is_read() {
        let shown_by = |values: &[&'static str]| {
            let mut headers = HeaderMap::new();
            for value in values {
                headers.append(AUTHORIZATION, value.parse().unwrap());
            }
            match shown(&headers) {
                Shown::Bearer(token) => token.to_owned(),
                other => format!("{other:?}"),
            }
        };
        assert_eq!(shown_by(&[]), "Nothing");
        assert_eq!(shown_by(&["Bearer abc"]), "abc");
        assert_eq!(shown_by(&["bearer  abc "]), "abc");
        for wrong in [&["Basic YTpi"][..], &["Bearer"], &["abc"], &["Bearer a", "Bearer b"], &[""]] {
            assert_eq!(shown_by(wrong), "Unreadable", "{wrong:?}");
        }
    }

    #[test]
    fn the_host_must_be_this_machine() {
        let request = |uri: &str, host: &[&str]| {
            let mut request = Request::builder().uri(uri);
            for host in host {
                request = request.header(HOST, *host);
            }
            names_this_machine(&request.body(Body::empty()).unwrap())
        };
        assert!(
            request("/", &["127.0.0.1:8080"]) && request("/", &["localhost"]) && request("/", &["[::1]:80"])
        );
        assert!(request("http://localhost:1/", &[]));
        assert!(
            !request("/", &[])
                && !request("/", &["evil.example"])
                && !request("/", &["localhost", "localhost"])
        );
        assert!(!request("http://evil.example/", &["localhost"]));
    }
}
