//! Metrics and request log: each request gets a log line with id, method, route template, status, duration and key. Path,
//! query and body are never logged.

use std::net::{IpAddr, SocketAddr};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use axum::body::Body;
use axum::extract::{ConnectInfo, MatchedPath, Request};
use axum::http::{HeaderValue, Method, StatusCode};
use axum::middleware::Next;
use axum::response::Response;
use metrics::{Counter, Label, counter, gauge, histogram};
use tracing::{Instrument, Span};

use super::inspected_body::{Inspect, InspectedBody, Passing};
use super::operation;
use crate::domain::access::{self, Principal};
use crate::service::app::metrics::{
    HTTP_BYTES_IN, HTTP_BYTES_OUT, HTTP_DURATION, HTTP_IN_FLIGHT, HTTP_REQUESTS,
};
use crate::service::app::shares::Share;
use crate::service::app::touched::Touched;

/// Header with the request id.
pub const REQUEST_ID: &str = "x-request-id";
/// Maximum length of a request id set by the client.
const MAX_REQUEST_ID: usize = 64;
/// Route label for requests without a matching route.
const UNMATCHED: &str = "unmatched";
/// Routes polled by monitoring, which are logged at level debug.
const PROBES: [&str; 3] = ["/livez", "/readyz", "/metrics"];

/// Whether the route template is polled by monitoring.
pub fn is_probe(route: &str) -> bool {
    PROBES.contains(&route)
}

/// Request-scoped record in which inner layers leave the caller and the objects for the outer ones.
#[derive(Debug, Clone, Default)]
pub struct Asker {
    principal: Arc<OnceLock<Arc<Principal>>>,
    touched: Touched,
    /// Place among the requests of the caller, until the response is sent.
    share: Arc<OnceLock<Share>>,
    /// Whether the request is logged only at level debug.
    hushed: Arc<AtomicBool>,
}

impl Asker {
    /// Records the caller, even if the request is then refused.
    pub fn is(&self, principal: &Arc<Principal>) {
        // Ignored if already set: a request is admitted once.
        let _ = self.principal.set(Arc::clone(principal));
    }

    /// Keeps the place of the request until its response is sent.
    pub fn hold(&self, share: Share) {
        // Ignored if already set: a request is admitted once.
        let _ = self.share.set(share);
    }

    /// Objects that the request touches.
    pub fn touched(&self) -> &Touched {
        &self.touched
    }

    /// Logs the request only at level debug, as one of many without a known caller.
    pub fn hush(&self) {
        self.hushed.store(true, Ordering::Relaxed);
    }

    fn is_hushed(&self) -> bool {
        self.hushed.load(Ordering::Relaxed)
    }

    /// Caller, once known.
    pub fn principal(&self) -> Option<&Arc<Principal>> {
        self.principal.get()
    }
}

/// Removes a request id that is too long or has characters other than `A-Z a-z 0-9 . _ : -`; a new one is generated.
pub fn plain_request_id(mut request: Request) -> Request {
    let is_plain = |id: &HeaderValue| {
        let is_plain = |c: &u8| c.is_ascii_alphanumeric() || b"._:-".contains(c);
        (1..=MAX_REQUEST_ID).contains(&id.len()) && id.as_bytes().iter().all(is_plain)
    };
    if !request.headers().get(REQUEST_ID).is_none_or(is_plain) {
        request.headers_mut().remove(REQUEST_ID);
    }
    request
}

/// Request id.
pub fn request_id(request: &Request) -> &str {
    request.headers().get(REQUEST_ID).and_then(|id| id.to_str().ok()).unwrap_or_default()
}

/// Network of the client, for counting.
pub fn network(request: &Request) -> Option<IpAddr> {
    let peer = request.extensions().get::<ConnectInfo<SocketAddr>>();
    peer.map(|ConnectInfo(peer)| access::network(peer.ip()))
}

/// Path template of the matched route.
pub fn route(request: &Request) -> Option<&str> {
    request.extensions().get::<MatchedPath>().map(|path| operation::route_of(path.as_str()))
}

/// Middleware that counts and logs the request.
pub async fn observe(mut request: Request, next: Next) -> Response {
    let asker = Asker::default();
    request.extensions_mut().insert(asker.clone());
    let route = route(&request).unwrap_or(UNMATCHED).to_owned();
    let method = method_label(request.method());
    let span = tracing::info_span!("request", id = request_id(&request), method, route);
    let mut exchange = Exchange::begin(method, route, asker, span.clone());
    let bytes = counter!(HTTP_BYTES_IN, exchange.labels());
    let counting = Counting { bytes, _held: None };
    let request = request.map(|body| Body::new(InspectedBody::new(body, counting)));
    let response = next.run(request).instrument(span).await;
    exchange.answered(response.status());
    let bytes = counter!(HTTP_BYTES_OUT, exchange.labels());
    let counting = Counting { bytes, _held: Some(exchange) };
    response.map(|body| Body::new(InspectedBody::new(body, counting)))
}

/// Label of the method: clients may invent others.
fn method_label(method: &Method) -> &'static str {
    const KNOWN: [Method; 7] = [
        Method::GET,
        Method::HEAD,
        Method::POST,
        Method::PUT,
        Method::PATCH,
        Method::DELETE,
        Method::OPTIONS,
    ];
    const NAMES: [&str; 7] = ["GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"];
    KNOWN.iter().position(|known| known == method).map_or("other", |place| NAMES[place])
}

fn status_class(status: StatusCode) -> &'static str {
    match status.as_u16() {
        100..200 => "1xx",
        200..300 => "2xx",
        300..400 => "3xx",
        400..500 => "4xx",
        _ => "5xx",
    }
}

/// A request until its response is sent, or until the client disconnects.
struct Exchange {
    begun: Instant,
    method: &'static str,
    route: String,
    asker: Asker,
    span: Span,
    answered: bool,
}

impl Exchange {
    fn begin(method: &'static str, route: String, asker: Asker, span: Span) -> Self {
        gauge!(HTTP_IN_FLIGHT).increment(1);
        Self { begun: Instant::now(), method, route, asker, span, answered: false }
    }

    fn labels(&self) -> Vec<Label> {
        vec![Label::new("method", self.method), Label::new("route", self.route.clone())]
    }

    fn answered(&mut self, status: StatusCode) {
        self.answered = true;
        self.count(status_class(status));
        self.write_line(Some(status.as_u16()));
    }

    fn count(&self, status: &'static str) {
        let mut labels = self.labels();
        labels.push(Label::new("status", status));
        histogram!(HTTP_DURATION, labels.clone()).record(self.begun.elapsed());
        counter!(HTTP_REQUESTS, labels).increment(1);
    }

    fn write_line(&self, status: Option<u16>) {
        let duration_ms = milliseconds(self.begun.elapsed());
        let key = self.asker.principal().map(|principal| principal.key.as_str());
        let what = if status.is_some() { "answered" } else { "the client went away" };
        if is_probe(&self.route) || self.asker.is_hushed() {
            tracing::debug!(parent: &self.span, status, duration_ms, key, "{what}");
        } else {
            tracing::info!(parent: &self.span, status, duration_ms, key, "{what}");
        }
    }
}

impl Drop for Exchange {
    fn drop(&mut self) {
        gauge!(HTTP_IN_FLIGHT).decrement(1);
        if !self.answered {
            self.count("gone");
            self.write_line(None);
        }
    }
}

fn milliseconds(time: Duration) -> f64 {
    (time.as_secs_f64() * 1e6).round() / 1e3
}

/// Counts the bytes of a body; that of a response also holds its exchange until it is sent.
struct Counting {
    bytes: Counter,
    _held: Option<Exchange>,
}

impl Inspect for Counting {
    fn inspect(&mut self, passing: Passing<'_>) {
        if let Passing::Frame(frame) = passing
            && let Some(data) = frame.data_ref()
        {
            self.bytes.increment(data.len() as u64);
        }
    }
}
