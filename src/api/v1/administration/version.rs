//! Version of the program and its database.

use std::sync::Arc;

use axum::Extension;
use axum::extract::State;
use axum::http::StatusCode;
use axum::response::Response;
use serde::Serialize;

use crate::api::extract::NoQuery;
use crate::api::problem::Problem;
use crate::api::respond::json;
use crate::domain::access::{Principal, Role};
use crate::service::app::{App, ServiceError, build};

/// Versions of the program and its database.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct VersionOutput {
    /// Version of the program.
    #[schema(example = "0.1.0")]
    version: &'static str,
    /// Commit it was built from; null if unknown at build time.
    commit: Option<&'static str>,
    /// Compiler version.
    rustc: &'static str,
    /// Optional features compiled in.
    features: &'static [&'static str],
    /// Database behind the program.
    database: DatabaseOutput,
    /// Who asks.
    caller: CallerOutput,
}

/// Caller with its rights.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct CallerOutput {
    /// Role of the caller.
    role: Role,
    /// Its tenant.
    tenant: String,
    /// Subject of its token, or id of its key; null on an open service.
    name: Option<String>,
    /// Whether everyone on this machine is let in as an administrator.
    open: bool,
}

impl CallerOutput {
    fn new(principal: &Principal) -> Self {
        let open = principal.is_local();
        let name = principal.subject.as_ref().unwrap_or(&principal.key);
        let name = (!open).then(|| name.clone());
        Self { role: principal.role, tenant: principal.tenant.clone(), name, open }
    }
}

/// Database behind the program.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct DatabaseOutput {
    /// Database engine: `sqlite` or `postgres`.
    #[schema(example = "sqlite")]
    engine: &'static str,
    /// Version of the schema: number of its last migration.
    schema_version: i64,
}

/// Returns the versions of the program and its database, and who asks.
#[utoipa::path(get, path = "/v1/version", tag = "operation", responses(
    (status = 200, description = "Versions of the program and the database", body = VersionOutput),
    (status = 400, description = "An unknown parameter"),
    (status = 503, description = "The store cannot be read")
))]
pub(in crate::api::v1) async fn find_version(
    State(app): State<App>,
    Extension(principal): Extension<Arc<Principal>>,
    _: NoQuery,
) -> Result<Response, Problem> {
    let schema_version = app.store.schema_version().await.map_err(ServiceError::from)?;
    let version = VersionOutput {
        version: build::VERSION,
        commit: build::COMMIT,
        rustc: build::RUSTC,
        features: build::FEATURES,
        database: DatabaseOutput { engine: app.store.engine(), schema_version },
        caller: CallerOutput::new(&principal),
    };
    Ok(json(StatusCode::OK, &version)?)
}
