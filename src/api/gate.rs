//! Checks of a request before its handler, in one order: whether the service is stopping, who the caller is, which role it has,
//! whether it accepts the media type of the answer, how many requests it sends, in time and at once, and whether its address is text.
//!
//! They are one layer: each separate layer costs an allocation and a copy of all layers inside of it per request.

use axum::extract::Request;
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use super::problem::{Problem, ProblemKind};
use super::{access, negotiation, overload};

/// Passes the request to its handler unless a check refuses it.
pub(super) async fn pass(mut request: Request, next: Next) -> Response {
    match refusal(&mut request).await {
        Some(refusal) => refusal,
        None => next.run(request).await,
    }
}

async fn refusal(request: &mut Request) -> Option<Response> {
    if let Some(refusal) = overload::refuse_while_stopping(request) {
        return Some(refusal);
    }
    if let Some(refusal) = access::refuse(request).await {
        return Some(overload::count_refused(request, refusal));
    }
    negotiation::refuse(request)
        .or_else(|| overload::refuse_frequent(request))
        .or_else(|| overload::refuse_crowding(request))
        .or_else(|| refuse_zeros(request).map(Problem::into_response))
}

/// U+0000 ends a text in one database and is not a text in the other.
fn refuse_zeros(request: &Request) -> Option<Problem> {
    let address = request.uri().path_and_query()?.as_str();
    let detail = "expected text without the character U+0000 in the path and the query";
    address.contains("%00").then(|| Problem::new(ProblemKind::InvalidQuery, detail))
}
