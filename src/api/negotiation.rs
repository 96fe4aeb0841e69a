//! Media types of answers: refuses a request whose `Accept` header excludes the media type of its operation, before any work
//! is done. Operations with several media types choose one themselves; tables of answers are chosen in `tabular`.

use std::collections::HashMap;
use std::sync::LazyLock;

use axum::extract::Request;
use axum::http::Method;
use axum::response::{IntoResponse, Response};
use utoipa::openapi::path::Operation;
use utoipa::openapi::{OpenApi, RefOr};

use super::extract::{ANYTHING, accepted, preferred};
use super::problem::{Problem, ProblemKind};
use super::{document, observe, tabular};

/// Media types by route template and method.
type Offers = HashMap<(String, Method), String>;

static OFFERS: LazyLock<Offers> = LazyLock::new(|| offers(&super::openapi()));

/// Media types of the successful answers of every operation that has a single one.
fn offers(document: &OpenApi) -> Offers {
    let single = document::operations(document).filter_map(|(path, method, operation)| {
        let only = only_media_type(operation, |kind| !tabular::is_table(&method, path, kind))?;
        Some(((path.to_owned(), method), only))
    });
    single.collect()
}

/// Media type of the successful answers of an operation, if there is exactly one among those that count.
pub(super) fn only_media_type(operation: &Operation, counts: impl Fn(&str) -> bool) -> Option<String> {
    let responses = operation.responses.responses.iter().filter(|(status, _)| status.starts_with('2'));
    let contents = responses.filter_map(|(_, response)| match response {
        RefOr::T(response) => Some(response.content.keys().cloned()),
        RefOr::Ref(_) => None,
    });
    let mut found: Vec<String> = contents.flatten().filter(|kind| counts(kind)).collect();
    found.dedup();
    found.pop().filter(|_| found.is_empty())
}

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
    let method = if request.method() == Method::HEAD { &Method::GET } else { request.method() };
    let offered = OFFERS.get(&(route.to_owned(), method.clone()))?;
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
    fn operations_offer_the_media_type_of_their_answers() {
        let offered = |method: Method, path: &str| OFFERS.get(&(path.to_owned(), method)).map(String::as_str);
        assert_eq!(offered(Method::GET, "/v1/cohorts"), Some("application/json"));
        assert_eq!(offered(Method::GET, "/v1/cohorts/{cohort}/shapes"), None, "several");
        assert_eq!(offered(Method::GET, "/metrics"), Some("text/plain; version=0.0.4"));
        assert_eq!(offered(Method::DELETE, "/v1/cohorts/{cohort}"), None, "no answer");
        assert_eq!(offered(Method::GET, "/v1/cohorts/{cohort}/mean"), None, "several");
    }

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
