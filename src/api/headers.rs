//! What every answer tells browsers: that it is data, for its own page, and not to be kept.

use axum::extract::Request;
use axum::http::{HeaderMap, HeaderName, HeaderValue, header};
use axum::middleware::Next;
use axum::response::Response;

/// Where the answers are that carry shapes and ids.
const API: &str = "/v1/";
/// Where the reference page is.
const DOCS: &str = "/docs";
/// The media type of drawings.
const SVG: &str = "image/svg+xml";

/// Data: a browser that is led to it runs, loads and frames nothing.
const DATA_POLICY: &str = "default-src 'none'; frame-ancestors 'none'";
/// Drawings bring a style sheet of their own.
const SVG_POLICY: &str = "default-src 'none'; style-src 'unsafe-inline'; frame-ancestors 'none'";
/// The reference page: its own scripts; style attributes and pictures in the page are made by these scripts.
const DOCS_POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; \
     img-src 'self' data:; connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

const ALWAYS: [(HeaderName, HeaderValue); 3] = [
    (header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff")),
    (header::REFERRER_POLICY, HeaderValue::from_static("no-referrer")),
    (HeaderName::from_static("cross-origin-resource-policy"), HeaderValue::from_static("same-origin")),
];

/// Writes the headers of every answer.
pub async fn secure(request: Request, next: Next) -> Response {
    let (is_api, is_docs) = {
        let path = request.uri().path();
        (path.starts_with(API), path.starts_with(DOCS))
    };
    let mut response = next.run(request).await;
    let headers = response.headers_mut();
    for (name, value) in ALWAYS {
        headers.insert(name, value);
    }
    headers.insert(header::CONTENT_SECURITY_POLICY, HeaderValue::from_static(policy(headers, is_docs)));
    if is_api {
        headers.insert(header::CACHE_CONTROL, HeaderValue::from_static(caching(headers)));
    }
    response
}

fn policy(headers: &HeaderMap, is_docs: bool) -> &'static str {
    let media_type =
        headers.get(header::CONTENT_TYPE).and_then(|value| value.to_str().ok()).unwrap_or_default();
    match media_type {
        _ if is_docs => DOCS_POLICY,
        text if text.starts_with(SVG) => SVG_POLICY,
        _ => DATA_POLICY,
    }
}

/// What has a tag may stay in the cache of its reader, who asks each time whether it still holds; all else is not kept.
fn caching(headers: &HeaderMap) -> &'static str {
    if headers.contains_key(header::ETAG) { "private, no-cache" } else { "no-store" }
}
