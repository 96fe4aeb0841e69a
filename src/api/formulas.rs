//! `?formulas=escape`: CSV in which no text is a formula to a spreadsheet, of every operation that answers CSV.

use axum::body::{Body, Bytes};
use axum::extract::Request;
use axum::http::{HeaderMap, Uri, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use futures_util::{StreamExt, stream};

use super::extract::TWICE;
use super::problem::Problem;
use super::{observe, operation};
use crate::wire::formulas::Escaping;

/// The parameter.
pub(super) const FORMULAS: &str = "formulas";
/// Its values.
pub(super) const VALUES: [&str; 2] = ["keep", "escape"];
/// Bytes that are looked at in one step, so that a long file does not hold a thread up.
const STEP: usize = 64 << 10;

/// Middleware that reads the parameter and makes the texts.
pub(super) async fn answer(mut request: Request, next: Next) -> Response {
    let asked = match take(&mut request) {
        Ok(asked) => asked,
        Err(problem) => return problem.into_response(),
    };
    let response = next.run(request).await;
    if asked && is_csv(response.headers()) { escaped(response) } else { response }
}

/// Takes the parameter from a request whose operation has it; returns whether formulas become texts.
fn take(request: &mut Request) -> Result<bool, Problem> {
    let parts = || request.uri().query().unwrap_or_default().split('&');
    let is_ours = |part: &&str| part.split('=').next() == Some(FORMULAS);
    if !parts().any(|part| is_ours(&part)) {
        return Ok(false);
    }
    let route = observe::route(request).unwrap_or_default();
    if !operation::find(request.method().as_str(), route).is_some_and(operation::Operation::may_be_csv) {
        return Ok(false);
    }
    let values: Vec<&str> = parts().filter(is_ours).map(|part| &part[FORMULAS.len()..]).collect();
    let [value] = values.as_slice() else { return Err(Problem::of_parameter(FORMULAS, TWICE)) };
    let value = value.trim_start_matches('=');
    if !VALUES.contains(&value) {
        let [keep, escape] = VALUES;
        return Err(Problem::of_parameter(
            FORMULAS,
            format!("expected '{keep}' or '{escape}', got '{value}'"),
        ));
    }
    let (asked, rest) = (value == VALUES[1], parts().filter(|part| !is_ours(part)).collect::<Vec<_>>());
    let uri = with_query(request.uri(), &rest.join("&"));
    *request.uri_mut() = uri;
    Ok(asked)
}

/// The address with another query.
pub(super) fn with_query(uri: &Uri, query: &str) -> Uri {
    let path = uri.path();
    let target = if query.is_empty() { path.to_owned() } else { format!("{path}?{query}") };
    let mut parts = uri.clone().into_parts();
    // Parts of a valid target are one.
    parts.path_and_query = target.parse().ok();
    Uri::from_parts(parts).unwrap_or_else(|_| uri.clone())
}

fn is_csv(headers: &HeaderMap) -> bool {
    let kind = headers.get(header::CONTENT_TYPE).and_then(|kind| kind.to_str().ok());
    kind.is_some_and(|kind| kind.split(';').next() == Some("text/csv"))
}

/// The response with its formulas as texts.
fn escaped(response: Response) -> Response {
    let (mut parts, body) = response.into_parts();
    parts.headers.remove(header::CONTENT_LENGTH);
    let steps = |piece: Bytes| {
        (0..piece.len()).step_by(STEP).map(move |start| piece.slice(start..piece.len().min(start + STEP)))
    };
    let pieces = body.into_data_stream().flat_map(move |piece| match piece {
        Ok(piece) => stream::iter(steps(piece).map(Ok).collect::<Vec<_>>()),
        Err(error) => stream::iter(vec![Err(error)]),
    });
    let pieces = pieces.map(Some).chain(stream::iter([None]));
    let texts = pieces.scan(Escaping::default(), |escaping, piece| {
        let text = match piece {
            Some(Ok(piece)) => Ok(escaping.piece(&piece)),
            Some(Err(error)) => Err(error),
            None => Ok(escaping.rest()),
        };
        std::future::ready(Some(text))
    });
    Response::from_parts(parts, Body::from_stream(texts))
}
