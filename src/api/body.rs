//! Bodies in memory: bounded each, before and after decompression, and bounded together.

use axum::body::{Body, Bytes};
use axum::extract::Request;
use axum::http::{HeaderMap, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use http_body_util::{BodyExt, LengthLimitError, Limited};
use tokio::sync::OwnedSemaphorePermit;

use super::extract::media_type;
use super::overload::Edge;
use super::problem::{Problem, ProblemKind};
use crate::service::App;

/// Whether a body is a stream of lines, which is never in memory as a whole.
pub fn is_stream(media_type: &str) -> bool {
    matches!(
        media_type,
        "application/x-ndjson" | "application/ndjson" | "application/jsonl" | "application/x-jsonlines"
    )
}

/// Refuses bodies that say they are too long before a byte of them is read, and ends those that are on their way.
pub async fn bound(request: Request, next: Next) -> Response {
    let Some(edge) = Edge::of(&request) else { return next.run(request).await };
    if is_stream(&media_type(request.headers())) {
        return next.run(request).await;
    }
    let limit = edge.body_bytes;
    if length(request.headers()).is_some_and(|length| length > limit as u64) {
        return too_long(limit).into_response();
    }
    next.run(request.map(|body| Body::new(Limited::new(body, limit)))).await
}

fn length(headers: &HeaderMap) -> Option<u64> {
    headers.get(header::CONTENT_LENGTH)?.to_str().ok()?.parse().ok()
}

fn too_long(limit: usize) -> Problem {
    let detail = format!("the body is longer than {limit} bytes, which holds before and after decompression");
    Problem::new(ProblemKind::PayloadTooLarge, detail)
}

/// A body with the room that it takes.
struct Held {
    bytes: Vec<u8>,
    _room: Option<OwnedSemaphorePermit>,
}

impl AsRef<[u8]> for Held {
    fn as_ref(&self) -> &[u8] {
        &self.bytes
    }
}

/// Reads a body to its end; its room is free again when the bytes are dropped.
///
/// # Errors
/// A body that is too long, broken or cut off; [`ProblemKind::Overloaded`] when there is no room for it.
pub async fn read(app: &App, mut body: Body) -> Result<Bytes, Problem> {
    let limit = app.limits.body_bytes;
    let mut held = Held { bytes: Vec::new(), _room: None };
    while let Some(frame) = body.frame().await {
        let frame = frame.map_err(|error| unreadable(error, limit))?;
        let Ok(piece) = frame.into_data() else { continue };
        if held.bytes.len() + piece.len() > limit {
            return Err(too_long(limit));
        }
        let more = app.room(piece.len())?;
        match &mut held._room {
            Some(room) => room.merge(more),
            none => *none = Some(more),
        }
        held.bytes.extend_from_slice(&piece);
    }
    Ok(Bytes::from_owner(held))
}

/// Why a body could not be read.
fn unreadable(error: axum::Error, limit: usize) -> Problem {
    let mut cause: Option<&(dyn std::error::Error + 'static)> = Some(&error);
    while let Some(error) = cause {
        if error.is::<LengthLimitError>() {
            return too_long(limit);
        }
        cause = error.source();
    }
    let detail = format!("the body ended early or its encoding is broken: {}", error.into_inner());
    Problem::new(ProblemKind::MalformedBody, detail)
}
