//! Extractors whose rejections are problem documents.

use axum::body::{Bytes, to_bytes};
use axum::extract::{FromRequest, FromRequestParts, Request};
use axum::http::request::Parts;
use axum::http::{HeaderMap, header};
use serde::de::DeserializeOwned;

use super::problem::{Problem, ProblemKind};
use crate::service::App;
pub use crate::service::input::parse;

/// A JSON body within the limit.
#[derive(Debug)]
pub struct JsonBody(pub Bytes);

/// The media type of a body, without parameters, lower case.
pub fn media_type(headers: &HeaderMap) -> String {
    let value = headers.get(header::CONTENT_TYPE).and_then(|value| value.to_str().ok()).unwrap_or_default();
    value.split(';').next().unwrap_or_default().trim().to_ascii_lowercase()
}

/// Whether `media_type` is JSON.
pub fn is_json(media_type: &str) -> bool {
    media_type == "application/json"
        || (media_type.starts_with("application/") && media_type.ends_with("+json"))
}

impl FromRequest<App> for JsonBody {
    type Rejection = Problem;

    async fn from_request(request: Request, app: &App) -> Result<Self, Problem> {
        let found = media_type(request.headers());
        if !is_json(&found) {
            let detail = format!("the body is '{found}', application/json is read here");
            return Err(Problem::new(ProblemKind::UnsupportedMediaType, detail));
        }
        let limit = app.limits.body_bytes;
        to_bytes(request.into_body(), limit).await.map(Self).map_err(|error| body_problem(error, limit))
    }
}

/// Why a body could not be read.
pub fn body_problem(error: axum::Error, limit: usize) -> Problem {
    let source = error.into_inner();
    if source.is::<http_body_util::LengthLimitError>() {
        let detail = format!("the body is longer than {limit} bytes after decompression");
        return Problem::new(ProblemKind::PayloadTooLarge, detail);
    }
    Problem::new(
        ProblemKind::MalformedBody,
        format!("the body ended early or its encoding is broken: {source}"),
    )
}

/// A query string as `T`.
#[derive(Debug)]
pub struct Query<T>(pub T);

impl<T: DeserializeOwned, S: Send + Sync> FromRequestParts<S> for Query<T> {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Problem> {
        axum::extract::Query::<T>::try_from_uri(&parts.uri)
            .map(|query| Self(query.0))
            .map_err(|rejection| Problem::new(ProblemKind::InvalidQuery, rejection.body_text()))
    }
}

/// A route without query parameters: a misspelt one must not be passed over.
#[derive(Debug)]
pub struct NoQuery;

impl<S: Send + Sync> FromRequestParts<S> for NoQuery {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Problem> {
        only(parts, &[]).map(|()| Self)
    }
}

/// Refuses query parameters that are not in `known`.
fn only(parts: &Parts, known: &[&str]) -> Result<(), Problem> {
    let query = axum::extract::Query::<Vec<(String, String)>>::try_from_uri(&parts.uri)
        .map_err(|rejection| Problem::new(ProblemKind::InvalidQuery, rejection.body_text()))?;
    match query.0.iter().find(|(key, _)| !known.contains(&key.as_str())) {
        None => Ok(()),
        Some((key, _)) => {
            Err(Problem::new(ProblemKind::InvalidQuery, format!("'{key}' is not a parameter of this route")))
        }
    }
}

/// The format of the answer, on a route without other query parameters.
#[derive(Debug)]
pub struct OnlyFormat(pub Format);

impl<S: Send + Sync> FromRequestParts<S> for OnlyFormat {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        only(parts, &["format"])?;
        Format::from_request_parts(parts, state).await.map(Self)
    }
}

/// Path segments as `T`.
#[derive(Debug)]
pub struct Path<T>(pub T);

impl<T: DeserializeOwned + Send, S: Send + Sync> FromRequestParts<S> for Path<T> {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        axum::extract::Path::<T>::from_request_parts(parts, state)
            .await
            .map(|path| Self(path.0))
            .map_err(|rejection| Problem::new(ProblemKind::InvalidQuery, rejection.body_text()))
    }
}

/// The format of the answer: `?format=json|svg`, else the `Accept` header, else JSON.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// Numbers.
    Json,
    /// A drawing.
    Svg,
}

#[derive(serde::Deserialize)]
struct FormatQuery {
    format: Option<String>,
}

impl<S: Send + Sync> FromRequestParts<S> for Format {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Problem> {
        let query = axum::extract::Query::<FormatQuery>::try_from_uri(&parts.uri).ok();
        if let Some(format) = query.and_then(|query| query.0.format) {
            return match format.as_str() {
                "json" => Ok(Self::Json),
                "svg" => Ok(Self::Svg),
                other => {
                    let detail = format!("format is '{other}', must be 'json' or 'svg'");
                    Err(Problem::new(ProblemKind::InvalidQuery, detail))
                }
            };
        }
        let accept = parts.headers.get(header::ACCEPT).and_then(|value| value.to_str().ok()).unwrap_or("*/*");
        preferred(accept).ok_or_else(|| {
            let detail = format!("'{accept}' is wanted, application/json and image/svg+xml are offered");
            Problem::new(ProblemKind::NotAcceptable, detail)
        })
    }
}

/// The offered format with the highest quality; of equal ones the first in the header.
fn preferred(accept: &str) -> Option<Format> {
    let mut best: Option<(f64, Format)> = None;
    for range in accept.split(',') {
        let mut parts = range.split(';').map(str::trim);
        let format = match parts.next().unwrap_or_default().to_ascii_lowercase().as_str() {
            "application/json" | "application/*" | "*/*" | "" => Format::Json,
            "image/svg+xml" | "image/*" => Format::Svg,
            _ => continue,
        };
        let quality = parts.find_map(|p| p.strip_prefix("q=")).and_then(|q| q.parse().ok()).unwrap_or(1.0);
        if quality > 0.0 && best.is_none_or(|(highest, _)| quality > highest) {
            best = Some((quality, format));
        }
    }
    best.map(|(_, format)| format)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn formats_are_negotiated() {
        assert_eq!(preferred("*/*"), Some(Format::Json));
        assert_eq!(preferred("image/svg+xml"), Some(Format::Svg));
        assert_eq!(preferred("text/html, image/svg+xml;q=0.9, */*;q=0.8"), Some(Format::Svg));
        assert_eq!(preferred("application/json;q=0.5, image/*"), Some(Format::Svg));
        assert_eq!(preferred("text/csv"), None);
    }
}
