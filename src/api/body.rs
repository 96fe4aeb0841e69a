//! Request bodies in memory: each is bounded before and after decompression, and all are bounded together.

use axum::body::{Body, Bytes};
use axum::extract::Request;
use axum::http::{HeaderMap, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use futures_util::{Stream, TryStreamExt};
use http_body_util::{BodyExt, LengthLimitError, Limited};

use super::coding::Expands;
use super::media_type::{is_form, media_type};
use super::overload::Edge;
use super::problem::{Problem, ProblemKind};
use crate::service::app::memory::{Held, Purpose};
use crate::service::app::{App, Limits, ServiceError};
use crate::service::files::FileFormat;
use crate::wire::bounds::Census;
use crate::wire::fault::Fault;

/// Whether a body is a stream of lines, which is never held in memory as a whole.
pub fn is_stream(media_type: &str) -> bool {
    matches!(
        media_type,
        "application/x-ndjson" | "application/ndjson" | "application/jsonl" | "application/x-jsonlines"
    )
}

/// Whether a body is a file of another program, which is read as it arrives and bounded by its reader.
pub fn is_file(media_type: &str) -> bool {
    media_type == "application/octet-stream"
        || FileFormat::all().any(|format| format.media_types().contains(&media_type))
}

/// Refuses bodies whose declared length is too long before reading them, and cuts off longer ones while they arrive. Runs
/// outside of decompression.
pub async fn bound(request: Request, next: Next) -> Response {
    let Some(edge) = Edge::of(&request) else { return next.run(request).await };
    let found = media_type(request.headers());
    if is_stream(&found) || is_file(&found) {
        return next.run(request).await;
    }
    let limit = if is_form(&found) { edge.form_bytes } else { edge.body_bytes };
    if length(request.headers()).is_some_and(|length| length > limit as u64) {
        return too_long(limit).into_response();
    }
    next.run(request.map(|body| Body::new(Limited::new(body, limit)))).await
}

fn length(headers: &HeaderMap) -> Option<u64> {
    headers.get(header::CONTENT_LENGTH)?.to_str().ok()?.parse().ok()
}

fn too_long(limit: usize) -> Problem {
    let detail = format!("the body is longer than {limit} bytes, the limit before and after decompression");
    Problem::new(ProblemKind::PayloadTooLarge, detail)
}

/// Bytes with the memory reserved for them, which is released when they are dropped.
pub(super) struct HeldBody {
    bytes: Vec<u8>,
    _room: Held,
}

impl HeldBody {
    /// The bytes with the memory reserved for them.
    pub(super) fn of(bytes: Vec<u8>, room: Held) -> Bytes {
        Bytes::from_owner(Self { bytes, _room: room })
    }
}

impl AsRef<[u8]> for HeldBody {
    fn as_ref(&self) -> &[u8] {
        &self.bytes
    }
}

/// Length beyond which a body is read on separate threads: about 0.1 ms of decompression.
pub(super) const LONG: usize = 64 << 10;

/// Reads a JSON body to its end. The memory reserved for it and for the values parsed from it is released when the bytes are
/// dropped.
///
/// # Errors
/// A body that is too long, has too many values, is broken or cut off; [`ProblemKind::Overloaded`] if memory is short.
pub async fn read(app: &App, body: Body) -> Result<Bytes, Problem> {
    let room = app.memory.hold(Purpose::Bodies, 0)?;
    let limits = app.limits;
    let mut reading = Reading { body, limits, bytes: Vec::new(), census: Census::default(), room };
    if !reading.has_ended_within(LONG).await? {
        let rest = async move { reading.has_ended_within(usize::MAX).await.map(|_| reading) };
        reading = app.pool.read_body(rest).await??;
    }
    Ok(HeldBody::of(reading.bytes, reading.room))
}

/// A body of which a part has been read.
struct Reading {
    body: Body,
    limits: Limits,
    bytes: Vec<u8>,
    census: Census,
    room: Held,
}

impl Reading {
    /// Reads until `most` bytes are there; whether that was all.
    async fn has_ended_within(&mut self, most: usize) -> Result<bool, Problem> {
        let limits = &self.limits;
        while self.bytes.len() < most {
            let Some(frame) = self.body.frame().await else { return Ok(true) };
            let frame = frame.map_err(|error| unreadable(error, limits.body_bytes))?;
            let Ok(piece) = frame.into_data() else { continue };
            if self.bytes.len() + piece.len() > limits.body_bytes {
                return Err(too_long(limits.body_bytes));
            }
            self.census = self.census.and(Census::of(&piece));
            if self.census.values > limits.json_values {
                return Err(too_many_values(limits.json_values));
            }
            self.room.resize(self.census.memory(limits.shapes))?;
            self.bytes.extend_from_slice(&piece);
        }
        Ok(false)
    }
}

pub(super) fn too_many_values(most: usize) -> Problem {
    let detail = format!("the body has more than {most} values (commas and brackets are counted)");
    Problem::new(ProblemKind::PayloadTooLarge, detail)
}

/// A body as a stream of chunks.
pub fn pieces(body: Body) -> impl Stream<Item = Result<Bytes, ServiceError>> {
    TryStreamExt::map_err(body.into_data_stream(), |error| {
        let detail = match cause::<Expands>(&error) {
            Some(expands) => return ServiceError::TooLarge(Fault::new("", expands.to_string()).into()),
            None => format!("the stream ended early or its encoding is invalid: {error}"),
        };
        ServiceError::Malformed(vec![Fault::new("", detail)])
    })
}

/// First error of this type in the chain of causes.
fn cause<'a, E: std::error::Error + 'static>(error: &'a (dyn std::error::Error + 'static)) -> Option<&'a E> {
    std::iter::successors(Some(error), |error| error.source()).find_map(|error| error.downcast_ref())
}

/// Problem that describes why a body could not be read.
pub(super) fn unreadable(error: axum::Error, limit: usize) -> Problem {
    if cause::<LengthLimitError>(&error).is_some() {
        return too_long(limit);
    }
    if let Some(expands) = cause::<Expands>(&error) {
        return Problem::new(ProblemKind::PayloadTooLarge, expands.to_string());
    }
    let detail = format!("the body ended early or its encoding is invalid: {}", error.into_inner());
    Problem::new(ProblemKind::MalformedBody, detail)
}
