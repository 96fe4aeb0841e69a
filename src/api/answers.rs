//! Response memory: responses written as a whole are charged to a quota until they are sent or the connection is closed.

use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};

use axum::body::{Body, Bytes, HttpBody};
use axum::response::{IntoResponse, Response};
use http_body::{Frame, SizeHint};

use super::problem::Problem;
use crate::service::app::memory::{Held, Memory, Purpose};

/// Shorter responses are not counted; the limit on connections bounds their number.
const SMALL: u64 = 4 << 10;

/// Reserves memory for a response; refuses it if too many responses are still unread.
pub fn hold(memory: &Memory, response: Response) -> Response {
    let Some(bytes) = response.body().size_hint().exact().filter(|bytes| *bytes > SMALL) else {
        return response;
    };
    match memory.hold(Purpose::Answers, usize::try_from(bytes).unwrap_or(usize::MAX)) {
        Ok(held) => response.map(|body| Body::new(Answer { body, rest: Bytes::new(), held: Arc::new(held) })),
        Err(error) => Problem::from(error).into_response(),
    }
}

/// Response body that holds its memory for as long as any of its bytes exist. It is sent in pieces: the connection keeps or
/// copies some until they are written, and asks for more as its client reads.
struct Answer {
    body: Body,
    /// Unsent rest of the current frame.
    rest: Bytes,
    held: Arc<Held>,
}

/// Number of bytes passed on at a time.
const PIECE: usize = 64 << 10;

impl Answer {
    /// Next piece of the rest.
    fn piece(&mut self) -> Frame<Bytes> {
        let bytes = self.rest.split_to(self.rest.len().min(PIECE));
        Frame::data(Bytes::from_owner(Piece { bytes, _held: Arc::clone(&self.held) }))
    }
}

/// Bytes of a response that hold its memory.
struct Piece {
    bytes: Bytes,
    _held: Arc<Held>,
}

impl AsRef<[u8]> for Piece {
    fn as_ref(&self) -> &[u8] {
        &self.bytes
    }
}

impl HttpBody for Answer {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        if self.rest.is_empty() {
            match ready!(Pin::new(&mut self.body).poll_frame(context)) {
                Some(Ok(frame)) => match frame.into_data() {
                    Ok(bytes) => self.rest = bytes,
                    Err(trailers) => return Poll::Ready(Some(Ok(trailers))),
                },
                end => return Poll::Ready(end),
            }
        }
        Poll::Ready(Some(Ok(self.piece())))
    }

    fn is_end_stream(&self) -> bool {
        self.rest.is_empty() && self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        let (body, rest) = (self.body.size_hint(), self.rest.len() as u64);
        body.exact().map_or_else(SizeHint::default, |left| SizeHint::with_exact(left + rest))
    }
}

#[cfg(test)]
mod tests {
    use std::future::ready;

    use axum::Router;
    use axum::extract::Request;
    use axum::middleware::map_response;
    use axum::routing::get;
    use http_body_util::BodyExt;
    use tower::ServiceExt;

    use super::*;
    use crate::service::app::memory::Quota;

    const BYTES: usize = 100 << 10;

    fn service(answers: usize) -> (Memory, Router) {
        let memory = Memory::new(Quota { process: usize::MAX, bodies: 0, answers });
        let account = memory.clone();
        let hold = map_response(move |response: Response| ready(hold(&account, response)));
        (memory, Router::new().route("/", get(|| async { "x".repeat(BYTES) })).layer(hold))
    }

    async fn ask(router: &Router) -> Response {
        router.clone().oneshot(Request::new(Body::empty())).await.unwrap()
    }

    #[tokio::test]
    async fn an_answer_is_held_until_its_last_byte_is_dropped() {
        let (memory, router) = service(BYTES);
        let mut answer = ask(&router).await;
        assert_eq!(memory.held(Purpose::Answers), BYTES);
        let bytes = answer.body_mut().frame().await.unwrap().unwrap().into_data().unwrap();
        assert_eq!((bytes.len(), answer.body().size_hint().exact()), (PIECE, Some((BYTES - PIECE) as u64)));
        let part = bytes.slice(10..20);
        drop((answer, bytes));
        assert_eq!(memory.held(Purpose::Answers), BYTES, "a connection may still have to write it");
        assert_eq!(ask(&router).await.status(), 503);
        drop(part);
        assert_eq!(memory.held(Purpose::Answers), 0);
        let answer = ask(&router).await;
        assert_eq!(answer.status(), 200);
        assert_eq!(answer.into_body().collect().await.unwrap().to_bytes().len(), BYTES);
    }

    #[tokio::test]
    async fn an_answer_that_never_fits_is_refused_for_good() {
        let (memory, router) = service(BYTES - 1);
        assert_eq!(ask(&router).await.status(), 422);
        assert_eq!(memory.held(Purpose::Answers), 0);
    }
}
