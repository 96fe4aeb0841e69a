//! Media types of answers: refuses a request whose `Accept` header excludes the media type of its operation, before any work
//! is done. Operations with several media types choose one themselves; tables of answers are chosen in `tabular`.

use axum::extract::Request;
use axum::response::{IntoResponse, Response};

use super::extract::{ANYTHING, accepted, preferred};
use super::operation::{self, Operation};
use super::problem::{Problem, ProblemKind};
use super::{observe, tabular};

/// Refusal of a request that does not accept the media type of the answer. A `format` in the query takes precedence over the
/// header.
pub(super) fn refuse(request: &Request) -> Option<Response> {
    let names_format = request
        .uri()
        .query()
        .is_some_and(|query| query.split('&').any(|parameter| parameter.split('=').next() == Some("format")));
    let accept = accepted(request.headers());
    if names_format || accept == ANYTHING {
        return None;
    }
    if tabular::Wanted::of(request).is_some() {
        return None;
    }
    let route = observe::route(request).unwrap_or_default();
    let offered = operation::find(request.method().as_str(), route).and_then(Operation::only_answer)?;
    if preferred(&accept, |range| covers(range, offered).then_some(())).is_some() {
        return None;
    }
    let detail = format!("expected {offered} to be accepted, got '{accept}'");
    Some(Problem::new(ProblemKind::NotAcceptable, detail).into_response())
}

/// Whether a media range such as `image/*` includes a media type.
pub(super) fn covers(range: &str, media_type: &str) -> bool {
    let media_type = media_type.split(';').next().unwrap_or_default().trim();
    match range.strip_suffix("/*") {
        _ if range.is_empty() => true,
        Some("*") => true,
        Some(kind) => media_type.split('/').next() == Some(kind),
        None => range == media_type,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_include_media_types() {
        for (range, media_type, expected) in [
            ("*/*", "text/csv", true),
            ("text/*", "text/csv", true),
            ("text/*", "image/svg+xml", false),
            ("text/csv", "text/csv; charset=utf-8", true),
            ("text/c", "text/csv", false),
        ] {
            assert_eq!(covers(range, media_type), expected, "{range} {media_type}");
        }
    }
}
