//! Overload protection: time limits of requests, rate limits of callers, and their shares of the connections.

use std::collections::HashMap;
use std::net::IpAddr;
use std::num::NonZeroU32;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use axum::extract::Request;
use axum::http::{HeaderValue, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use super::observe::{self, Asker};
use super::problem::{Problem, ProblemKind};
use crate::domain::access::{self, Principal};
use crate::service::app::shares::Shares;
use crate::service::app::{App, Limits, ServiceError};

/// Number of requests after which inactive callers are removed.
const SWEEP: u32 = 1024;

/// Maximum number of files of a form.
const MOST_FORM_FILES: usize = 3;
/// Bytes of boundaries and headers of a form, all together.
const FORM_HEADERS: usize = 64 << 10;

/// Limits enforced by middleware, attached to every request.
#[derive(Debug)]
pub struct Edge {
    /// Maximum number of body bytes on the wire, except for streams of lines.
    pub body_bytes: usize,
    /// Maximum number of body bytes of a form, on the wire.
    pub form_bytes: usize,
    /// Maximum ratio of decompressed to compressed size.
    pub compression_ratio: u64,
    light: Duration,
    compute: Duration,
    rates: Option<Rates>,
    refusals: Option<Rates>,
    /// Requests of a caller that are being answered, and their maximum number.
    answering: Arc<Shares>,
    caller_requests: usize,
}

/// Maximum number of bytes of a form.
pub(super) fn most_form_bytes(limits: &Limits) -> usize {
    limits
        .body_bytes
        .saturating_add(MOST_FORM_FILES.saturating_mul(limits.image_bytes))
        .saturating_add(FORM_HEADERS)
}

impl Edge {
    /// Limits of the service.
    pub fn new(limits: &Limits) -> Arc<Self> {
        Arc::new(Self {
            body_bytes: limits.body_bytes,
            form_bytes: most_form_bytes(limits),
            compression_ratio: limits.compression_ratio as u64,
            light: limits.light_time,
            compute: limits.compute_time,
            rates: Rates::new(limits.rate_per_second, limits.rate_burst),
            refusals: Rates::from_refusals(limits.refusals_per_minute),
            answering: Arc::default(),
            caller_requests: limits.caller_requests,
        })
    }

    /// Counts a request refused by access control; returns a 429 response if it is over the limit.
    fn refuse_unknown(&self, caller: &Caller) -> Option<Response> {
        [&self.rates, &self.refusals].into_iter().flatten().find_map(|rates| rates.refuse(caller))
    }

    /// Limits attached to the request.
    pub fn of(request: &Request) -> Option<Arc<Self>> {
        request.extensions().get::<Arc<Self>>().cloned()
    }
}

/// Applies the time limit of light requests.
pub async fn light(request: Request, next: Next) -> Response {
    let Some(time) = Edge::of(&request).map(|edge| edge.light) else { return next.run(request).await };
    tokio::time::timeout(time, next.run(request)).await.unwrap_or_else(|_| took_too_long(time))
}

/// Refusal of a new request while the service is stopping; probes are still answered.
pub(super) fn refuse_while_stopping(request: &Request) -> Option<Response> {
    let is_stopping = request.extensions().get::<App>().is_some_and(App::is_stopping);
    let refused =
        || Problem::new(ProblemKind::Unavailable, "the service is stopping: send the request again");
    is_stopping.then(|| refused().into_response())
}

/// Deadline of a computing request, which its work also observes.
#[derive(Debug, Clone, Copy)]
pub struct Deadline(pub Instant);

/// Applies the time limit of computing requests.
pub async fn computing(mut request: Request, next: Next) -> Response {
    let Some(time) = Edge::of(&request).map(|edge| edge.compute) else { return next.run(request).await };
    let end = Instant::now() + time;
    request.extensions_mut().insert(Deadline(end));
    match tokio::time::timeout_at(end.into(), next.run(request)).await {
        // The work observes the deadline too: it may be cancelled, and say so, before this timer is polled.
        Ok(response) if end <= Instant::now() && is_unavailable(&response) => took_too_long(time),
        Ok(response) => response,
        Err(_) => took_too_long(time),
    }
}

fn is_unavailable(response: &Response) -> bool {
    let problem = response.extensions().get::<Problem>();
    problem.is_some_and(|problem| problem.kind() == ProblemKind::Unavailable)
}

fn took_too_long(limit: Duration) -> Response {
    let seconds = limit.as_secs();
    let detail = format!("the request was stopped after {seconds} s, the time limit: ask for less at a time");
    Problem::new(ProblemKind::TookTooLong, detail).into_response()
}

/// Callers whose requests are counted together.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
enum Caller {
    /// A caller with a credential.
    Known(access::Caller),
    /// Address of an unauthenticated client.
    Address(IpAddr),
}

impl Caller {
    fn of(request: &Request) -> Option<Self> {
        match request.extensions().get::<Arc<Principal>>() {
            Some(principal) => Some(Self::Known(principal.caller())),
            None => Self::at(request),
        }
    }

    fn at(request: &Request) -> Option<Self> {
        observe::network(request).map(Self::Address)
    }
}

/// Rate limiter of callers: the generic cell rate algorithm (ITU-T I.371), a token bucket with one time for each caller.
///
/// A request moves the caller's time, never earlier than now, on by `interval = 1 / rate`; it is refused while that time is
/// more than `(burst − 1) · interval` ahead of now. A time in the past is that of a full bucket and is forgotten.
#[derive(Debug)]
struct Rates {
    interval: Duration,
    /// `(burst − 1) · interval`.
    tolerance: Duration,
    /// Description of the rate for the client.
    rate: String,
    callers: Mutex<Callers>,
}

/// Times of the callers, and the number of requests checked.
#[derive(Debug, Default)]
struct Callers {
    times: HashMap<Caller, Instant>,
    checks: u32,
}

impl Rates {
    /// `None` if `per_second` is 0; a `burst` of 0 means twice `per_second`.
    fn new(per_second: u32, burst: u32) -> Option<Self> {
        let rate = NonZeroU32::new(per_second)?;
        let burst = NonZeroU32::new(burst).unwrap_or(rate.saturating_add(per_second));
        let interval = Duration::from_secs(1) / rate.get();
        Some(Self::from_interval(interval, burst, format!("{per_second} requests per second")))
    }

    /// Limiter for requests refused by access control; `None` if `per_minute` is 0.
    fn from_refusals(per_minute: u32) -> Option<Self> {
        let burst = NonZeroU32::new(per_minute)?;
        let rate = format!("{per_minute} requests per minute without a valid key from this address");
        Some(Self::from_interval(Duration::from_secs(60) / per_minute, burst, rate))
    }

    fn from_interval(interval: Duration, burst: NonZeroU32, rate: String) -> Self {
        let tolerance = interval * (burst.get() - 1);
        Self { interval, tolerance, rate, callers: Mutex::default() }
    }

    /// Counts a request; returns a 429 response if it is over the limit.
    fn refuse(&self, caller: &Caller) -> Option<Response> {
        self.refuse_at(caller, Instant::now())
    }

    fn refuse_at(&self, caller: &Caller, now: Instant) -> Option<Response> {
        let wait = self.wait(caller, now)?;
        Some(refusal(&self.rate, wait.as_secs() + 1))
    }

    /// Counts a request, or returns the time until one is admitted.
    fn wait(&self, caller: &Caller, now: Instant) -> Option<Duration> {
        let mut callers = self.callers.lock().unwrap_or_else(PoisonError::into_inner);
        callers.checks = callers.checks.wrapping_add(1);
        if callers.checks.is_multiple_of(SWEEP) {
            callers.times.retain(|_, time| *time > now);
            callers.times.shrink_to_fit();
        }
        let time = callers.times.get(caller).map_or(now, |time| now.max(*time));
        let ahead = time - now;
        if ahead > self.tolerance {
            return Some(ahead - self.tolerance);
        }
        match callers.times.get_mut(caller) {
            Some(known) => *known = time + self.interval,
            None => drop(callers.times.insert(caller.clone(), time + self.interval)),
        }
        None
    }
}

fn refusal(rate: &str, seconds: u64) -> Response {
    let detail = format!("more than {rate}: send the next request in {seconds} s");
    let mut response = Problem::new(ProblemKind::TooManyRequests, detail).into_response();
    response.headers_mut().insert(header::RETRY_AFTER, HeaderValue::from(seconds));
    response
}

/// Refusal of a request of a known caller beyond its rate limit.
pub(super) fn refuse_frequent(request: &Request) -> Option<Response> {
    let edge = request.extensions().get::<Arc<Edge>>()?;
    edge.rates.as_ref()?.refuse(&Caller::of(request)?)
}

/// Refusal of a request of a caller of whom many are being answered. Those that wait for a job, and those whose answers are streams, keep
/// their connections, which no other caller could then have. Nobody needs protection from the users of an open service.
pub(super) fn refuse_crowding(request: &Request) -> Option<Response> {
    let edge = request.extensions().get::<Arc<Edge>>()?;
    let (asker, principal) =
        (request.extensions().get::<Asker>()?, request.extensions().get::<Arc<Principal>>()?);
    if principal.is_local() {
        return None;
    }
    let most = edge.caller_requests;
    match edge.answering.take(principal.caller(), most) {
        Some(share) => {
            asker.hold(share);
            None
        }
        None => {
            let detail =
                format!("expected at most {most} requests of a caller at the same time, got one more");
            Some(Problem::from(ServiceError::Overloaded(detail)).into_response())
        }
    }
}

/// Counts a request that access control refuses, so that keys cannot be tried at will: its refusal, or that of the rate limit
/// of its address. A valid key is never refused because of other requests from its address.
pub(super) fn count_refused(request: &Request, refusal: Response) -> Response {
    if refusal.status() != StatusCode::UNAUTHORIZED {
        return refusal;
    }
    let counted = Edge::of(request).zip(Caller::at(request));
    counted.and_then(|(edge, caller)| edge.refuse_unknown(&caller)).unwrap_or(refusal)
}

#[cfg(test)]
mod tests {
    use std::net::SocketAddr;

    use axum::body::Body;
    use axum::extract::ConnectInfo;
    use axum::middleware::from_fn;
    use axum::routing::get;
    use axum::{Extension, Router};
    use tower::ServiceExt as _;

    use super::*;
    use crate::service::app::error::ServiceError;

    #[tokio::test]
    async fn work_that_sees_the_deadline_before_the_timer_took_too_long() {
        let (late, early) = (ProblemKind::TookTooLong, ProblemKind::Unavailable);
        for (limit, pause, kind) in [(20, 40, late), (3_600_000, 0, early)] {
            let limits = Limits { compute_time: Duration::from_millis(limit), ..Limits::default() };
            let work = move || async move {
                // A blocked thread polls no timer.
                std::thread::sleep(Duration::from_millis(pause));
                Problem::from(ServiceError::Cancelled)
            };
            let router = Router::new()
                .route("/", get(work))
                .layer(from_fn(computing))
                .layer(Extension(Edge::new(&limits)));
            let response = router.oneshot(Request::new(Body::empty())).await.unwrap();
            assert_eq!(response.extensions().get::<Problem>().unwrap().kind(), kind, "{limit} ms");
        }
    }

    #[test]
    fn callers_have_their_own_counts_which_are_forgotten() {
        let rates = Rates::new(1000, 3).unwrap();
        let caller = |i: u32| Caller::Address(IpAddr::from(std::net::Ipv4Addr::from_bits(i)));
        let now = Instant::now();
        for _ in 0..3 {
            assert!(rates.refuse_at(&caller(0), now).is_none());
        }
        let refusal = rates.refuse_at(&caller(0), now).unwrap();
        assert_eq!(
            (refusal.status().as_u16(), &refusal.headers()["retry-after"]),
            (429, &HeaderValue::from(1))
        );
        assert!(rates.refuse_at(&caller(1), now).is_none());
        for i in 2..SWEEP {
            assert!(rates.refuse_at(&caller(i), now).is_none());
        }
        let later = now + Duration::from_millis(20);
        for _ in 0..2 * SWEEP {
            let _ = rates.refuse_at(&caller(0), later);
        }
        assert_eq!(rates.callers.lock().unwrap().times.len(), 1);
        assert!(Rates::new(0, 5).is_none());
    }

    #[test]
    fn a_burst_is_followed_by_the_rate() {
        let (rates, now) = (Rates::from_refusals(30).unwrap(), Instant::now());
        let caller = Caller::Known(Principal::local().caller());
        let wait = |after_ms: u64| rates.wait(&caller, now + Duration::from_millis(after_ms));
        assert!((0..30).all(|_| wait(0).is_none()));
        assert_eq!([wait(0), wait(1500)], [2000, 500].map(|ms| Some(Duration::from_millis(ms))));
        assert_eq!([wait(2000), wait(2000)], [None, Some(Duration::from_secs(2))]);
        assert!((0..30).all(|_| wait(62_000).is_none()));
        assert_eq!(wait(62_000), Some(Duration::from_secs(2)));
        // More requests per second than a clock tells apart are not limited.
        let fast = Rates::new(u32::MAX, u32::MAX).unwrap();
        assert!((0..100).all(|_| fast.wait(&caller, now).is_none()));
    }

    #[test]
    fn addresses_of_one_network_are_one_caller() {
        let from = |address: &str| {
            let mut request = Request::new(Body::empty());
            let address = SocketAddr::new(address.parse().unwrap(), 1);
            request.extensions_mut().insert(ConnectInfo(address));
            Caller::of(&request)
        };
        assert_eq!(from("2001:db8::1"), from("2001:db8::ffff:1"));
        assert_ne!(from("2001:db8::1"), from("2001:db8:0:1::1"));
        assert_ne!(from("127.0.0.1"), from("127.0.0.2"));
        let mut request = Request::new(Body::empty());
        request.extensions_mut().insert(Arc::new(Principal::local()));
        assert_eq!(Caller::of(&request), Some(Caller::Known(Principal::local().caller())));
    }
}
