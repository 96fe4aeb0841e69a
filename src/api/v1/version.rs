//! What runs here.

use axum::extract::State;
use axum::http::StatusCode;
use axum::response::Response;
use serde::Serialize;

use crate::api::extract::NoQuery;
use crate::api::problem::{Problem, ProblemDocument};
use crate::api::respond::json;
use crate::service::app::{App, ServiceError, build};

/// Program and database.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct VersionOutput {
    /// Version of the program.
    #[schema(example = "0.1.0")]
    version: &'static str,
    /// The commit it was built from; null when the build did not know.
    commit: Option<&'static str>,
    /// The compiler.
    rustc: &'static str,
    /// Optional parts that were built in.
    features: &'static [&'static str],
    /// The database.
    database: DatabaseOutput,
}

/// The database behind the program.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct DatabaseOutput {
    /// `sqlite` or `postgres`.
    #[schema(example = "sqlite")]
    engine: &'static str,
    /// Number of the last step of its schema.
    schema_version: i64,
}

/// Says which program and database answer.
#[utoipa::path(get, path = "/version", tag = "operation", responses(
    (status = 200, description = "Program and database", body = VersionOutput),
    (status = 400, description = "An unknown parameter", body = ProblemDocument, content_type = "application/problem+json"),
    (status = 503, description = "The store cannot be read", body = ProblemDocument, content_type = "application/problem+json")
))]
pub(super) async fn find_version(State(app): State<App>, _: NoQuery) -> Result<Response, Problem> {
    let schema_version = app.store.schema_version().await.map_err(ServiceError::from)?;
    let version = VersionOutput {
        version: build::VERSION,
        commit: build::COMMIT,
        rustc: build::RUSTC,
        features: build::FEATURES,
        database: DatabaseOutput { engine: app.store.engine(), schema_version },
    };
    Ok(json(StatusCode::OK, &version)?)
}
