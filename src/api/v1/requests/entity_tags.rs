//! Entity tags: a client that has an answer already is told so, without the answer.

use std::convert::Infallible;
use std::fmt::Debug;
use std::future::Future;

use axum::extract::{FromRequestParts, OriginalUri};
use axum::http::request::Parts;
use axum::http::{HeaderMap, HeaderValue, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};

use crate::api::caching::{IMMUTABLE, NO_STORE};
use crate::api::problem::Problem;
use crate::domain::dictionary::Listed;

/// Address of a request, and the answers that the client has: `If-None-Match`.
#[derive(Debug)]
pub(in crate::api::v1) struct Asked {
    uri: Uri,
    headers: HeaderMap,
}

impl<S: Send + Sync> FromRequestParts<S> for Asked {
    type Rejection = Infallible;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Self::Rejection> {
        let OriginalUri(uri) = OriginalUri::from_request_parts(parts, state).await?;
        Ok(Self { uri, headers: parts.headers.clone() })
    }
}

impl Asked {
    /// The answer that follows from `state` (an id of a version, a cohort at a revision) in a format, or 304.
    ///
    /// # Errors
    /// Those of `answer`.
    pub(in crate::api::v1) async fn unless_known(
        &self,
        state: &str,
        format: impl Debug,
        answer: impl Future<Output = Result<Response, Problem>>,
    ) -> Result<Response, Problem> {
        let tag = tag_of(&format!("{state} {} {format:?}", self.uri));
        unless_known(&self.headers, &tag, answer).await
    }

    /// A page with the address of the next one, in the header `Link` (RFC 8288).
    pub(in crate::api::v1) fn linked(&self, mut page: Response, next: Option<String>) -> Response {
        let Some(cursor) = next else { return page };
        let others = self.uri.query().unwrap_or_default().split('&');
        let others = others.filter(|parameter| !parameter.is_empty() && !parameter.starts_with("cursor="));
        let cursor = format!("cursor={cursor}");
        let query: Vec<&str> = others.chain([cursor.as_str()]).collect();
        let link = format!("<{}?{}>; rel=\"next\"", self.uri.path(), query.join("&"));
        if let Ok(link) = HeaderValue::from_str(&link) {
            page.headers_mut().insert(header::LINK, link);
        }
        page
    }
}

/// The answer with its entity tag, or 304 if the client has it.
///
/// # Errors
/// Those of `answer`.
pub(in crate::api::v1) async fn unless_known(
    headers: &HeaderMap,
    tag: &str,
    answer: impl Future<Output = Result<Response, Problem>>,
) -> Result<Response, Problem> {
    let response =
        if is_known(headers, tag) { StatusCode::NOT_MODIFIED.into_response() } else { answer.await? };
    Ok(tagged(response, tag))
}

/// Entity tag of the object that a text describes.
pub(in crate::api::v1) fn tag_of(what: &str) -> String {
    format!("\"{}\"", &blake3::hash(what.as_bytes()).to_hex()[..32])
}

/// Adds the entity tag to a response.
pub(in crate::api::v1) fn tagged(mut response: Response, tag: &str) -> Response {
    if let Ok(value) = HeaderValue::from_str(tag) {
        response.headers_mut().insert(header::ETAG, value);
    }
    response
}

/// A response with shapes of persons, which caches must not store. Programs may keep it, and ask again by its entity tag.
pub(in crate::api::v1) fn not_stored(mut response: Response) -> Response {
    response.headers_mut().insert(header::CACHE_CONTROL, HeaderValue::from_static(NO_STORE));
    response
}

/// An answer that follows from a version of a dictionary alone: where `key` names this version for good, by its id or as
/// `name@version`, caches need not ask again. A name or an alias may mean another version tomorrow.
pub(in crate::api::v1) fn kept_by_version(mut response: Response, key: &str, listed: &Listed) -> Response {
    if key == listed.id || key == format!("{}@{}", listed.name, listed.version) {
        response.headers_mut().insert(header::CACHE_CONTROL, HeaderValue::from_static(IMMUTABLE));
    }
    response
}

/// Whether the client already has this version (`If-None-Match`).
fn is_known(headers: &HeaderMap, tag: &str) -> bool {
    let values = headers.get_all(header::IF_NONE_MATCH).iter().filter_map(|value| value.to_str().ok());
    values
        .flat_map(|value| value.split(','))
        .any(|value| matches!(value.trim(), "*") || value.trim().trim_start_matches("W/") == tag)
}
