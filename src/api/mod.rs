//! The HTTP door: translates requests to use cases and their outcome to answers.
//!
//! * [`v1`] — the resources;
//! * [`problem`] — every refusal as a problem document (RFC 9457);
//! * [`drain`] — refused bodies are read to their end;
//! * [`extract`] — bodies, queries, the wanted format; rejections are problem documents too;
//! * [`respond`] — answers computed and written on the pool;
//! * [`health`] — liveness and readiness.

pub mod drain;
pub mod extract;
pub mod health;
pub mod problem;
pub mod respond;
pub mod v1;

use std::time::Duration;

use axum::Router;
use axum::http::{HeaderName, StatusCode};
use axum::routing::get;
use tower::ServiceBuilder;
use tower_http::catch_panic::CatchPanicLayer;
use tower_http::compression::CompressionLayer;
use tower_http::decompression::RequestDecompressionLayer;
use tower_http::request_id::{MakeRequestUuid, PropagateRequestIdLayer, SetRequestIdLayer};
use tower_http::timeout::TimeoutLayer;
use tower_http::trace::TraceLayer;
use utoipa::OpenApi;
use utoipa_axum::router::OpenApiRouter;

use crate::service::App;
use problem::{Problem, ProblemKind};

/// Longest time for a request that is answered from memory.
const REQUEST_TIMEOUT: Duration = Duration::from_secs(120);

#[derive(OpenApi)]
#[openapi(
    info(
        title = "Shapelex",
        description = "Shape statistics as a service: post contours, get template-free alignment, mean shapes and \
                       functional PCA. Errors are problem documents (RFC 9457) with a stable `code`, the JSON pointer of \
                       every bad field and the index of the bad shape.",
        license(name = "Apache-2.0 OR MIT")
    ),
    tags(
        (name = "catalogue", description = "Generators and transformation classes"),
        (name = "statistics", description = "Stateless: everything in the request, nothing stored"),
        (name = "curves", description = "Evaluation, measures and resampling of curves"),
        (name = "cohorts", description = "Named sets of shapes, their shapes and their mean"),
        (name = "retrieval", description = "Nearest shapes, and distances of all pairs"),
        (name = "jobs", description = "Long work: progress, events, cancellation"),
        (name = "dictionaries", description = "What is learnt from cohorts: components and sparse atoms, and their use"),
        (name = "tests", description = "Comparison of groups and regression, by permutation"),
        (name = "health", description = "Probes")
    )
)]
struct Document;

fn routes() -> (Router<App>, utoipa::openapi::OpenApi) {
    let timed = OpenApiRouter::with_openapi(Document::openapi())
        .merge(health::routes())
        .nest("/v1", v1::routes())
        .layer(TimeoutLayer::with_status_code(StatusCode::SERVICE_UNAVAILABLE, REQUEST_TIMEOUT));
    // An upload lasts as long as its stream flows, and watches its own pauses; events last as long as their job.
    let streamed = OpenApiRouter::new().nest("/v1", v1::streamed_routes());
    timed.merge(streamed).split_for_parts()
}

/// The OpenAPI document of the service.
pub fn openapi() -> utoipa::openapi::OpenApi {
    routes().1
}

/// The whole service.
pub fn router(app: App) -> Router {
    let (router, document) = routes();
    let request_id = HeaderName::from_static("x-request-id");
    let middleware = ServiceBuilder::new()
        .layer(SetRequestIdLayer::new(request_id.clone(), MakeRequestUuid))
        .layer(TraceLayer::new_for_http().make_span_with(respond::request_span))
        .layer(PropagateRequestIdLayer::new(request_id))
        .layer(axum::middleware::from_fn(drain::drain))
        .layer(CompressionLayer::new().gzip(true))
        .layer(axum::middleware::from_fn(problem::render))
        .layer(CatchPanicLayer::custom(problem::of_panic))
        .layer(RequestDecompressionLayer::new().gzip(true).pass_through_unaccepted(false));
    router
        .route("/", get(v1::index))
        .merge(utoipa_swagger_ui::SwaggerUi::new("/docs").url("/openapi.json", document))
        .fallback(|uri: axum::http::Uri| async move {
            Problem::new(ProblemKind::RouteNotFound, format!("there is nothing at {}", uri.path()))
        })
        .method_not_allowed_fallback(|method: axum::http::Method| async move {
            Problem::new(
                ProblemKind::MethodNotAllowed,
                format!("{method} is not offered here; see the Allow header"),
            )
        })
        .layer(middleware)
        .with_state(app)
}
