//! Security and caching headers, which tell browsers that responses are data, same-origin only, and not to be stored.

use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::middleware::Next;
use axum::response::Response;

use super::caching::{IMMUTABLE, NO_STORE};
use super::dashboard;
use crate::service::app::App;

/// Path prefix of responses with shapes and ids.
const API: &str = "/v1/";
/// Media type of drawings.
const SVG: &str = "image/svg+xml";

/// Policy for data: a browser that opens it runs, loads and frames nothing.
const DATA_POLICY: &str = "default-src 'none'; frame-ancestors 'none'";
/// Policy for drawings, which contain a style sheet.
const SVG_POLICY: &str = "default-src 'none'; style-src 'unsafe-inline'; frame-ancestors 'none'";

/// Policies for the pages: their own scripts and style sheets, and pictures that they make of answers. They call this service only;
/// the dashboard also the identity provider through which people log in on it, if there is one.
#[derive(Debug, Clone)]
pub(super) struct PagePolicy {
    dashboard: HeaderValue,
    reference: HeaderValue,
}

impl PagePolicy {
    pub(super) fn new(app: &App) -> Self {
        let provider = app.login().map_or_else(String::new, |login| format!(" {}", login.origin()));
        Self { dashboard: Self::calling(&provider), reference: Self::calling("") }
    }

    fn calling(provider: &str) -> HeaderValue {
        let policy = format!(
            "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; connect-src \
             'self'{provider}; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
        );
        // An origin is made of characters that headers may have.
        HeaderValue::try_from(policy).unwrap_or(HeaderValue::from_static(DATA_POLICY))
    }
}

/// Request headers on which answers depend.
const VARY: [&str; 3] = ["accept", "accept-encoding", "authorization"];

const ALWAYS: [(HeaderName, HeaderValue); 3] = [
    (header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff")),
    (header::REFERRER_POLICY, HeaderValue::from_static("no-referrer")),
    (HeaderName::from_static("cross-origin-resource-policy"), HeaderValue::from_static("same-origin")),
];

/// Adds the headers to every response.
pub(super) async fn secure(State(own): State<PagePolicy>, request: Request, next: Next) -> Response {
    let (is_api, page) = {
        let path = request.uri().path();
        (path.starts_with(API), page_policy(path, own))
    };
    let mut response = next.run(request).await;
    let is_known = is_api && response.status() == StatusCode::NOT_MODIFIED;
    let headers = response.headers_mut();
    for (name, value) in ALWAYS {
        headers.insert(name, value);
    }
    // A browser that is told that it has an answer already takes the policy of this response. It says nothing of the media type.
    let policy = page.or_else(|| (!is_known).then(|| HeaderValue::from_static(data_policy(headers))));
    if let Some(policy) = policy {
        headers.insert(header::CONTENT_SECURITY_POLICY, policy);
    }
    if is_api {
        add_variations(headers);
        headers.insert(header::CACHE_CONTROL, HeaderValue::from_static(caching(headers)));
    }
    response
}

/// Adds the request headers on which every answer depends to those that inner layers have named.
fn add_variations(headers: &mut HeaderMap) {
    let named = headers.get_all(header::VARY).iter().filter_map(|value| value.to_str().ok());
    let mut names: Vec<String> =
        named.flat_map(|value| value.split(',')).map(|name| name.trim().to_ascii_lowercase()).collect();
    names.extend(VARY.map(str::to_owned));
    names.sort();
    names.dedup();
    if let Ok(value) = HeaderValue::from_str(&names.join(", ")) {
        headers.insert(header::VARY, value);
    }
}

/// The policy of the address of a page, which does not depend on the response.
fn page_policy(path: &str, policies: PagePolicy) -> Option<HeaderValue> {
    match path {
        path if dashboard::is_view(path) => Some(policies.dashboard),
        path if dashboard::is_reference(path) => Some(policies.reference),
        _ => None,
    }
}

fn data_policy(headers: &HeaderMap) -> &'static str {
    let media_type =
        headers.get(header::CONTENT_TYPE).and_then(|value| value.to_str().ok()).unwrap_or_default();
    if media_type.starts_with(SVG) { SVG_POLICY } else { DATA_POLICY }
}

/// Responses with an entity tag may be cached privately. They must be revalidated, unless a handler says that they never change,
/// or forbids to store them; others must not be stored.
fn caching(headers: &HeaderMap) -> &'static str {
    let said = headers.get(header::CACHE_CONTROL).map(HeaderValue::as_bytes);
    match said {
        _ if !headers.contains_key(header::ETAG) => NO_STORE,
        Some(said) if said == NO_STORE.as_bytes() => NO_STORE,
        Some(said) if said == IMMUTABLE.as_bytes() => IMMUTABLE,
        _ => "private, no-cache",
    }
}
