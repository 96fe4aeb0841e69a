//! Metrics endpoint for Prometheus.

use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};

use crate::service::app::{App, scrape};

/// Returns metrics in the Prometheus text format.
///
/// Names and labels are listed in `docs/observability.md`.
#[utoipa::path(get, path = "/metrics", tag = "operation",
    responses((status = 200, description = "The metrics", body = String, content_type = "text/plain; version=0.0.4")))]
pub(super) async fn read_metrics(State(app): State<App>) -> Response {
    ([(header::CONTENT_TYPE, "text/plain; version=0.0.4")], scrape::scrape(&app).await).into_response()
}
