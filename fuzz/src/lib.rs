//! What the fuzz targets share: a representation that shapes are read for, and the whole service on a store of its own.

use std::sync::LazyLock;
use std::time::Duration;

use axum::Router;
use axum::body::Body;
use axum::http::{HeaderMap, HeaderValue, Request, StatusCode};
use bytes::Bytes;
use http_body_util::BodyExt;
use shapelex_server::api;
use shapelex_server::service::app::{App, Limits};
use shapelex_server::store::Store;
use tempfile::TempDir;
use tokio::runtime::Runtime;
use tower::ServiceExt;

/// Limits under which no input keeps a target busy for long, and none is refused because the machine is.
pub static LIMITS: LazyLock<Limits> = LazyLock::new(|| Limits {
    control_points: 48,
    points: 200,
    shapes: 12,
    samples: 2000,
    body_bytes: 1 << 16,
    line_bytes: 1 << 12,
    atoms: 8,
    job_bytes: 1 << 24,
    matrix_bytes: 1 << 16,
    matrix_operations: 1_000_000,
    search_operations: 10_000_000,
    light_time: PATIENCE,
    compute_time: PATIENCE,
    ..Limits::default()
});

/// Time of a request; libFuzzer itself ends what lasts too long.
const PATIENCE: Duration = Duration::from_secs(3600);

/// The service on an empty store that lasts as long as the process.
pub struct Service {
    runtime: Runtime,
    app: App,
    router: Router,
    _folder: TempDir,
}

static SERVICE: LazyLock<Service> = LazyLock::new(Service::start);

impl Service {
    /// The one of this process.
    pub fn get() -> &'static Self {
        &SERVICE
    }

    fn start() -> Self {
        let runtime = Runtime::new().expect("a runtime");
        let folder = TempDir::new().expect("a folder");
        let store = runtime.block_on(Store::open(folder.path())).expect("an empty store opens");
        let app = App::new(store, *LIMITS, 1);
        Self { runtime, router: api::router(app.clone()), app, _folder: folder }
    }

    /// What the use cases take.
    pub fn app(&self) -> &App {
        &self.app
    }

    /// Runs `work` to its end.
    pub fn run<T>(&self, work: impl Future<Output = T>) -> T {
        self.runtime.block_on(work)
    }

    /// Sends a request to this machine through all layers; a stream of events is left unread.
    pub fn send(&self, mut request: Request<Body>) -> (StatusCode, HeaderMap, Bytes) {
        request.headers_mut().entry("host").or_insert(HeaderValue::from_static("localhost"));
        self.run(async {
            let response = self.router.clone().oneshot(request).await.expect("the router does not fail");
            let (parts, body) = response.into_parts();
            let endless = content_type(&parts.headers).starts_with("text/event-stream");
            let body = if endless { Bytes::new() } else { body.collect().await.expect("a body").to_bytes() };
            (parts.status, parts.headers, body)
        })
    }
}

/// The media type of an answer, empty when there is none.
pub fn content_type(headers: &HeaderMap) -> &str {
    headers.get("content-type").map_or("", |value| value.to_str().expect("a media type is ASCII"))
}

/// Bytes of an input as the choices of a body: what there is no byte for is 0.
pub struct Draws<'a>(pub &'a [u8]);

/// Lengths that decide: ordinary ones, those whose squares or cubes leave the range of numbers, and those beside which others
/// are rounded away.
const LENGTHS: [f64; 8] = [1.0, 0.25, 1000.0, 1e-158, 1e99, 1e15, 1e-9, 0.0];

impl Draws<'_> {
    /// The next byte.
    pub fn byte(&mut self) -> u8 {
        let Some((first, rest)) = self.0.split_first() else { return 0 };
        self.0 = rest;
        *first
    }

    /// A number from `low` to `high`.
    pub fn between(&mut self, low: usize, high: usize) -> usize {
        low + usize::from(self.byte()) % (high - low + 1)
    }

    /// One of a list.
    pub fn one<'t, T>(&mut self, list: &'t [T]) -> &'t T {
        &list[usize::from(self.byte()) % list.len()]
    }

    /// A length out of a short list.
    pub fn length(&mut self) -> f64 {
        *self.one(&LENGTHS)
    }

    /// A coordinate near 1: a multiple of 1/16 from −8 to 8.
    pub fn coordinate(&mut self) -> f64 {
        (f64::from(self.byte()) - 128.0) / 16.0
    }

    /// Moves points far off, makes them tiny or huge, lays some on others: what one byte decides for all of them.
    pub fn disturb(&mut self, points: &mut [[f64; 3]]) {
        let (unit, offset) = (self.length(), self.length());
        for point in points.iter_mut() {
            *point = point.map(|x| unit * x + offset);
        }
        for _ in 0..self.between(0, 3) {
            let (from, to) = (usize::from(self.byte()), usize::from(self.byte()));
            if !points.is_empty() {
                points[to % points.len()] = points[from % points.len()];
            }
        }
    }
}

/// Posts a body: no answer is a failure on our side, and each is JSON.
pub fn post(target: &str, body: &serde_json::Value) {
    let request = Request::post(target).header("content-type", "application/json");
    let request = request.body(Body::from(body.to_string())).expect("a request");
    let (status, headers, answer) = Service::get().send(request);
    assert!(status < StatusCode::INTERNAL_SERVER_ERROR, "{target}: {status} {answer:?} for {body}");
    let media_type = content_type(&headers);
    assert_eq!(status.is_client_error(), media_type == "application/problem+json", "{target}: {status}");
    if media_type.ends_with("json") {
        serde_json::from_slice::<serde::de::IgnoredAny>(&answer).expect("the answer is JSON");
    }
}
