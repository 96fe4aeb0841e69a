//! Health probes, open without authentication.

use axum::extract::State;
use axum::http::StatusCode;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use super::problem::Problem;
use crate::service::app::App;

/// Paths of the probes, which have no rate limit.
pub(super) const PATHS: [&str; 2] = ["/livez", "/readyz"];

/// Routes of the probes.
pub fn routes() -> OpenApiRouter<App> {
    OpenApiRouter::new().routes(routes!(live)).routes(routes!(ready))
}

/// Liveness: the process responds.
#[utoipa::path(get, path = "/livez", tag = "health", responses((status = 204, description = "Alive")))]
async fn live() -> StatusCode {
    StatusCode::NO_CONTENT
}

/// Readiness: the service is not stopping, its compute threads make progress, and the store accepts a write.
#[utoipa::path(get, path = "/readyz", tag = "health", responses(
    (status = 204, description = "Ready"),
    (status = 503, description = "Not ready")
))]
async fn ready(State(app): State<App>) -> Result<StatusCode, Problem> {
    app.ready().await?;
    Ok(StatusCode::NO_CONTENT)
}
