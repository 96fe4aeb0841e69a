//! Connections: accepts them while slots are free, with or without TLS, and closes those that idle too long.

use std::convert::Infallible;
use std::io;
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::{Duration, Instant};

use axum::Router;
use axum::body::{Body, Bytes, HttpBody};
use axum::extract::ConnectInfo;
use axum::http::{Request, Response};
use axum_server::accept::Accept;
use axum_server::tls_rustls::{RustlsAcceptor, RustlsConfig};
use futures_util::future::BoxFuture;
use hyper_util::rt::{TokioExecutor, TokioIo, TokioTimer};
use hyper_util::server::conn::auto::Builder;
use hyper_util::service::TowerToHyperService;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpStream};
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;
use tower::Service;

use super::connection_slots::{CloseReason, Part, Request as Guard, Slot, Slots, Timeouts};
use crate::api::inspected_body::{Inspect, InspectedBody, Passing};
use crate::config::ConnectionLimits;

/// Interval of HTTP/2 keep-alive pings, and timeout of their answers.
const PING: Duration = Duration::from_secs(20);
/// Maximum number of response bytes buffered per HTTP/2 stream.
const SEND_BUFFER: usize = 128 << 10;
/// Longest time that a graceful close may take.
const GOODBYE: Duration = Duration::from_secs(1);
/// Pause after a connection could not be accepted, for instance for lack of file descriptors.
const PAUSE: Duration = Duration::from_millis(20);
/// Minimum time between log lines about rejected connections.
const QUIET: Duration = Duration::from_secs(10);

/// Serves connections until it is stopped.
#[derive(Clone)]
pub(super) struct Connections {
    router: Router,
    tls: Option<RustlsConfig>,
    http: Builder<TokioExecutor>,
    patience: Timeouts,
    slots: Arc<Slots>,
    stop: CancellationToken,
}

impl Connections {
    pub(super) fn new(
        router: Router,
        tls: Option<RustlsConfig>,
        limits: &ConnectionLimits,
        stop: CancellationToken,
    ) -> Self {
        let ConnectionLimits { first_request: first, idle, reader, .. } = *limits;
        let patience = Timeouts { first, idle, reader };
        let slots = Slots::new(limits.connections);
        Self { router, tls, http: http(limits), patience, slots, stop }
    }

    /// Accepts connections. After the stop it continues until the earlier ones have ended, so that probes are still answered.
    pub(super) async fn serve(self, listener: TcpListener) {
        let (tasks, late) = (TaskTracker::new(), TaskTracker::new());
        let mut complaint = Complaint(None);
        loop {
            let accepted = tokio::select! {
                biased;
                () = self.stop.cancelled(), if !tasks.is_closed() => {
                    tasks.close();
                    continue;
                }
                () = tasks.wait() => break,
                accepted = listener.accept() => accepted,
            };
            match accepted {
                Ok((stream, peer)) => match self.slots.enter() {
                    Some(slot) => {
                        let tasks = if tasks.is_closed() { &late } else { &tasks };
                        tasks.spawn(self.clone().answer(stream, peer, slot));
                    }
                    None => complaint.say("all connections are being served: new ones are closed"),
                },
                Err(error) => {
                    complaint.say(&format!("a connection could not be accepted: {error}"));
                    self.slots.close_one();
                    tokio::time::sleep(PAUSE).await;
                }
            }
        }
    }

    async fn answer(self, stream: TcpStream, peer: SocketAddr, slot: Arc<Slot>) {
        // Small responses must not be delayed; without the option they are merely slower.
        let _ = stream.set_nodelay(true);
        let late = self.stop.is_cancelled();
        let Some(tls) = &self.tls else { return self.speak(stream, peer, &slot).await };
        let handshake = RustlsAcceptor::new(tls.clone()).handshake_timeout(self.patience.first);
        tokio::select! {
            accepted = handshake.accept(stream, ()) => match accepted {
                Ok((stream, ())) => self.speak(stream, peer, &slot).await,
                Err(error) => tracing::debug!(%error, "a TLS handshake failed"),
            },
            _ = slot.end(&self.patience) => {}
            () = self.stop.cancelled(), if !late => {}
        }
    }

    /// Serves HTTP on a connection until it ends.
    async fn speak<S>(&self, stream: S, peer: SocketAddr, slot: &Arc<Slot>)
    where
        S: AsyncRead + AsyncWrite + Unpin + Send + 'static,
    {
        let service = Watched { router: self.router.clone(), slot: Arc::clone(slot), peer };
        let stream = TokioIo::new(Watching { stream, slot: Arc::clone(slot) });
        let connection = self.http.serve_connection(stream, TowerToHyperService::new(service));
        let mut connection = std::pin::pin!(connection);
        // A connection accepted after the stop gets one response, which announces the close.
        let mut stopping = self.stop.is_cancelled();
        loop {
            tokio::select! {
                // A broken connection is the client's concern.
                _ = connection.as_mut() => return,
                end = slot.end(&self.patience) => {
                    if end == CloseReason::Idle {
                        connection.as_mut().graceful_shutdown();
                        let _ = tokio::time::timeout(GOODBYE, connection).await;
                    }
                    return;
                }
                () = self.stop.cancelled(), if !stopping => {
                    stopping = true;
                    connection.as_mut().graceful_shutdown();
                }
            }
        }
    }
}

/// HTTP settings. Timeouts of request heads are enforced by the connection slots, which also bound the phase before a head.
fn http(limits: &ConnectionLimits) -> Builder<TokioExecutor> {
    let mut builder = Builder::new(TokioExecutor::new());
    builder.http1().timer(TokioTimer::new()).header_read_timeout(None).max_buf_size(limits.head_bytes);
    builder
        .http2()
        .timer(TokioTimer::new())
        .max_concurrent_streams(limits.streams)
        .max_header_list_size(u32::try_from(limits.head_bytes).unwrap_or(u32::MAX))
        .max_send_buf_size(SEND_BUFFER)
        .keep_alive_interval(PING)
        .keep_alive_timeout(PING);
    builder
}

/// Warnings limited in frequency, so that they do not flood the log.
struct Complaint(Option<Instant>);

impl Complaint {
    fn say(&mut self, what: &str) {
        if self.0.is_none_or(|last| last.elapsed() > QUIET) {
            self.0 = Some(Instant::now());
            tracing::warn!("{what}");
        }
    }
}

/// Service of one connection, which reports every request to the connection's slot.
#[derive(Clone)]
struct Watched {
    router: Router,
    slot: Arc<Slot>,
    peer: SocketAddr,
}

impl<B> Service<Request<B>> for Watched
where
    B: HttpBody<Data = Bytes> + Send + 'static,
    B::Error: Into<axum::BoxError>,
{
    type Response = Response<InspectedBody<Body, Leaving>>;
    type Error = Infallible;
    type Future = BoxFuture<'static, Result<Self::Response, Infallible>>;

    fn poll_ready(&mut self, _: &mut Context<'_>) -> Poll<Result<(), Infallible>> {
        Poll::Ready(Ok(()))
    }

    fn call(&mut self, mut request: Request<B>) -> Self::Future {
        let guard = self.slot.begin();
        request.extensions_mut().insert(ConnectInfo(self.peer));
        let part = guard.part(false);
        let answer = self.router.call(request.map(|body| InspectedBody::new(Box::pin(body), Arriving(part))));
        Box::pin(async move {
            let answer = answer.await?;
            let leaving = Leaving { part: guard.part(true), _guard: guard };
            Ok(answer.map(|body| InspectedBody::new(body, leaving)))
        })
    }
}

/// Observer of a request body. While no data is available, the client is not sending; the route bounds how long that may
/// last. A client that sends is not one that has stopped reading: many read only when they have sent their whole request.
struct Arriving(Part);

impl Inspect for Arriving {
    fn inspect(&mut self, passing: Passing<'_>) {
        match passing {
            Passing::Asked => {}
            Passing::Pending => self.0.waits(true),
            Passing::Frame(frame) => {
                self.0.waits(false);
                self.0.took(frame.data_ref().map_or(0, Bytes::len));
            }
            Passing::Ended => self.0.waits(false),
        }
    }
}

/// Observer of a response body. While a chunk is ready and the next one is not requested, the client is not reading.
struct Leaving {
    part: Part,
    _guard: Arc<Guard>,
}

impl Inspect for Leaving {
    fn inspect(&mut self, passing: Passing<'_>) {
        match passing {
            Passing::Asked => self.part.waits(false),
            Passing::Frame(_) => self.part.waits(true),
            Passing::Pending | Passing::Ended => {}
        }
    }
}

/// Stream that reports to the slot when written bytes are not accepted.
struct Watching<S> {
    stream: S,
    slot: Arc<Slot>,
}

impl<S> Watching<S> {
    fn told(&self, polled: Poll<io::Result<usize>>) -> Poll<io::Result<usize>> {
        match &polled {
            Poll::Pending => self.slot.waits(true),
            Poll::Ready(Ok(bytes)) => self.slot.wrote(*bytes),
            Poll::Ready(Err(_)) => {}
        }
        polled
    }
}

impl<S: AsyncRead + Unpin> AsyncRead for Watching<S> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_read(context, buffer)
    }
}

impl<S: AsyncWrite + Unpin> AsyncWrite for Watching<S> {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        let polled = Pin::new(&mut self.stream).poll_write(context, bytes);
        self.told(polled)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        slices: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let polled = Pin::new(&mut self.stream).poll_write_vectored(context, slices);
        self.told(polled)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        // The flush is ready only once all written bytes have left.
        let polled = Pin::new(&mut self.stream).poll_flush(context);
        self.slot.waits(polled.is_pending());
        polled
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(context)
    }
}
