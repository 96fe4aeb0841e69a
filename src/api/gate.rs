//! Checks of a request before its handler, in one order: whether the service is stopping, who the caller is, which role it has,
//! whether it accepts the media type of the answer, and how many requests it sends, in time and at once.
//!
//! They are one layer: each layer of its own costs an allocation and a copy of all layers inside of it per request.

use axum::extract::Request;
use axum::middleware::Next;
use axum::response::Response;

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
}
