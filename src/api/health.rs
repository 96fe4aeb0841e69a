//! Health probes, open without authentication.

use axum::extract::State;
use axum::http::StatusCode;

use super::problem::Problem;
use crate::service::app::App;

/// Liveness: the process responds.
#[utoipa::path(get, path = "/livez", tag = "health", responses((status = 204, description = "Alive")))]
pub(super) async fn live() -> StatusCode {
    StatusCode::NO_CONTENT
}

/// Readiness: the service is not stopping, its compute threads make progress, and the store and the audit trail accept a write.
#[utoipa::path(get, path = "/readyz", tag = "health", responses(
    (status = 204, description = "Ready"),
    (status = 503, description = "Not ready")
))]
pub(super) async fn ready(State(app): State<App>) -> Result<StatusCode, Problem> {
    app.ready().await?;
    app.trail().check()?;
    Ok(StatusCode::NO_CONTENT)
}
