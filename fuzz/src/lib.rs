//! What the fuzz targets share: a representation that shapes are read for, and the whole service on a store of its own.

use std::sync::LazyLock;
use std::time::Duration;

use axum::Router;
use axum::body::Body;
use axum::http::{HeaderMap, HeaderValue, Request, StatusCode};
use bytes::Bytes;
use http_body_util::BodyExt;
use shapelex::api;
use shapelex::service::{App, Limits};
use shapelex::store::Store;
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
