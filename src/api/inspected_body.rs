//! Bodies that report their traffic.

use std::pin::Pin;
use std::task::{Context, Poll};

use axum::body::{Bytes, HttpBody};
use http_body::{Frame, SizeHint};

/// Events of a body.
pub enum Passing<'a> {
    /// The next frame is asked for.
    Asked,
    /// It is not there yet.
    Pending,
    /// A frame passes.
    Frame(&'a Frame<Bytes>),
    /// The body has ended, or failed.
    Ended,
}

/// Observer of a body.
pub trait Inspect: Unpin {
    /// Called for every request for a frame, and for its outcome.
    fn inspect(&mut self, passing: Passing<'_>);
}

/// A body with its observer.
pub struct InspectedBody<B, I> {
    body: B,
    observer: I,
}

impl<B, I> InspectedBody<B, I> {
    /// A body that reports to `observer`.
    pub fn new(body: B, observer: I) -> Self {
        Self { body, observer }
    }
}

impl<B: HttpBody<Data = Bytes> + Unpin, I: Inspect> HttpBody for InspectedBody<B, I> {
    type Data = Bytes;
    type Error = B::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, B::Error>>> {
        self.observer.inspect(Passing::Asked);
        let polled = Pin::new(&mut self.body).poll_frame(context);
        self.observer.inspect(match &polled {
            Poll::Pending => Passing::Pending,
            Poll::Ready(Some(Ok(frame))) => Passing::Frame(frame),
            Poll::Ready(_) => Passing::Ended,
        });
        polled
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}
