//! Access control: identifies the caller once per request, before its handler, and checks the caller's role.
//!
//! Every operation needs a role, listed in [`operation::OPERATIONS`]. Operations not in the table need an administrator.

use std::sync::Arc;

use axum::extract::Request;
use axum::http::HeaderMap;
use axum::http::header::{AUTHORIZATION, HOST};
use axum::http::uri::Authority;
use axum::response::{IntoResponse, Response};

use super::observe::{self, Asker};
use super::operation::{self, Needs};
use super::origin;
use super::problem::{Problem, ProblemKind};
use crate::domain::access::{Principal, Role, is_loopback};
use crate::service::access::{Shown, identify};
use crate::service::app::App;

/// Access required by `method` on the route template; an operation that is not listed needs an administrator.
pub(super) fn needed(method: &str, route: &str) -> Needs {
    operation::find(method, route).map_or(Needs::Role(Role::Admin), |operation| operation.needs)
}

/// Identifies the caller and leaves it in the request extensions; the refusal of a request that is not authorised.
pub(super) async fn refuse(request: &mut Request) -> Option<Response> {
    let Some(app) = request.extensions().get::<App>().cloned() else {
        return Some(Problem::new(ProblemKind::Internal, "a request without the context").into_response());
    };
    let route = observe::route(request).unwrap_or_default();
    let needs = match needed(request.method().as_str(), route) {
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

#[cfg(test)]
mod tests {
    use axum::body::Body;

    use super::*;

    #[test]
    fn nothing_is_open_but_what_is_listed() {
        assert_eq!(needed("HEAD", "/v1/cohorts"), Needs::Role(Role::Reader));
        assert_eq!(needed("GET", "/v1/unknown"), Needs::Role(Role::Admin));
        assert_eq!(needed("PATCH", "/v1/cohorts"), Needs::Role(Role::Admin));
        assert_eq!(needed("GET", ""), Needs::Role(Role::Admin));
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
