//! Answers in memory: those that are written as a whole are held against an account until they are sent, or the connection is
//! gone.

use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};

use axum::body::{Body, Bytes, HttpBody};
use axum::extract::{Request, State};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use http_body::{Frame, SizeHint};

use super::problem::Problem;
use crate::service::memory::{Held, Memory, Purpose};

/// Shorter answers are not counted: connections bound how many there are.
const SMALL: u64 = 4 << 10;

/// Holds the memory of an answer; refuses it when too many others have not been read.
pub async fn hold(State(memory): State<Memory>, request: Request, next: Next) -> Response {
    let response = next.run(request).await;
    let Some(bytes) = response.body().size_hint().exact().filter(|bytes| *bytes > SMALL) else {
        return response;
    };
    match memory.hold(Purpose::Answers, usize::try_from(bytes).unwrap_or(usize::MAX)) {
        Ok(held) => response.map(|body| Body::new(Answer { body, held: Arc::new(held) })),
        Err(error) => Problem::from(error).into_response(),
    }
}

/// An answer whose bytes hold their memory wherever they are: the connection keeps them until they are written.
struct Answer {
    body: Body,
    held: Arc<Held>,
}

/// Bytes of an answer.
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
        let polled = Pin::new(&mut self.body).poll_frame(context);
        let held = &self.held;
        polled.map_ok(|frame| {
            frame.map_data(|bytes| Bytes::from_owner(Piece { bytes, _held: Arc::clone(held) }))
        })
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

#[cfg(test)]
mod tests {
    use axum::Router;
    use axum::middleware::from_fn_with_state;
    use axum::routing::get;
    use http_body_util::BodyExt;
    use tower::ServiceExt;

    use super::*;
    use crate::service::memory::Quota;

    const BYTES: usize = 100 << 10;

    fn service(answers: usize) -> (Memory, Router) {
        let memory = Memory::new(Quota { process: usize::MAX, bodies: 0, answers });
        let hold = from_fn_with_state(memory.clone(), hold);
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
        let part = bytes.slice(10..20);
        drop((answer, bytes));
        assert_eq!(memory.held(Purpose::Answers), BYTES, "a connection may still have to write it");
        assert_eq!(ask(&router).await.status(), 503);
        drop(part);
        assert_eq!(memory.held(Purpose::Answers), 0);
        assert_eq!(ask(&router).await.status(), 200);
    }

    #[tokio::test]
    async fn an_answer_that_never_fits_is_refused_for_good() {
        let (memory, router) = service(BYTES - 1);
        assert_eq!(ask(&router).await.status(), 422);
        assert_eq!(memory.held(Purpose::Answers), 0);
    }
}
