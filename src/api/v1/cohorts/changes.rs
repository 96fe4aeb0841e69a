//! Change feed, and the trash of deleted objects that can be restored.

use axum::http::StatusCode;
use axum::response::Response;
use serde::{Deserialize, Serialize};

use crate::api::extract::{Caller, NoQuery, Path, Query};
use crate::api::problem::Problem;
use crate::api::respond::json;
use crate::api::v1::requests::request_macros::{PageQuery, page};
use crate::domain::trash::{Trashed, TrashedKind};
use crate::service::cohorts::changes::{self, ChangeOutput};
use crate::service::cohorts::trash;
use crate::wire::time::rfc3339;

/// Position in the change feed.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(in crate::api::v1) struct ChangesQuery {
    /// Number of the last change already seen. Default: 0.
    #[serde(default)]
    since: u64,
    /// Changes per response, 1 to 1000. Default: 100.
    #[param(minimum = 1, maximum = 1000)]
    limit: Option<usize>,
}

/// One page of the change feed.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct ChangesAnswer {
    /// Changes, in order.
    items: Vec<ChangeOutput>,
    /// Value of `since` for the next request, also if there is nothing new yet.
    next: u64,
    /// Whether there were no later changes.
    done: bool,
}

/// Lists changes in order, so that a pipeline can resume where it stopped.
///
/// A client that has seen a number has seen all changes before it. The newest million changes are kept.
#[utoipa::path(get, path = "/v1/changes", tag = "changes", params(ChangesQuery),
    responses(
        (status = 200, description = "Changes after `since`", body = ChangesAnswer),
        (status = 410, description = "Changes that old are no longer available"),
        (status = "4XX", description = "The query was refused")
    ))]
pub(in crate::api::v1) async fn list_changes(
    Caller(app): Caller,
    Query(query): Query<ChangesQuery>,
) -> Result<Response, Problem> {
    let page = PageQuery { cursor: None, limit: query.limit };
    let found = changes::list(&app, query.since, page.limit()?).await?;
    let items = found.changes.into_iter().map(Into::into).collect();
    Ok(json(StatusCode::OK, &ChangesAnswer { items, next: found.last, done: found.done })?)
}

/// Object in the trash.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct TrashedOutput {
    /// Kind of object.
    kind: TrashedKind,
    /// Id of the object.
    id: String,
    /// Name of the object, which another object may be using by now.
    name: String,
    /// Version, for a dictionary.
    version: Option<u64>,
    /// Time of deletion, RFC 3339 in UTC.
    deleted_at: String,
}

page! {
    /// One page of the trash.
    PageOfTrash of TrashedOutput
}

impl From<Trashed> for TrashedOutput {
    fn from(trashed: Trashed) -> Self {
        let Trashed { kind, id, name, version, deleted_at_ms } = trashed;
        Self { kind, id, name, version, deleted_at: rfc3339(deleted_at_ms) }
    }
}

/// Lists deleted objects that can be restored.
#[utoipa::path(get, path = "/v1/trash", tag = "changes", params(PageQuery),
    responses(
        (status = 200, description = "A page of the trash", body = PageOfTrash),
        (status = "4XX", description = "The query was refused")
    ))]
pub(in crate::api::v1) async fn list_trash(
    Caller(app): Caller,
    Query(page): Query<PageQuery>,
) -> Result<Response, Problem> {
    let (items, next) = trash::list(&app, page.cursor.as_deref(), page.limit()?).await?;
    let items: Vec<TrashedOutput> = items.into_iter().map(Into::into).collect();
    Ok(json(StatusCode::OK, &PageOfTrash { items, next })?)
}

/// Restores a cohort or a dictionary version from the trash.
#[utoipa::path(post, path = "/v1/trash/{id}/restore", tag = "changes",
    params(("id" = String, Path, description = "Id of the cohort or of the dictionary version")),
    responses(
        (status = 204, description = "Restored"),
        (status = 404, description = "Not in the trash"),
        (status = 409, description = "The name is now used by another")
    ))]
pub(in crate::api::v1) async fn restore_trashed(
    Caller(app): Caller,
    _: NoQuery,
    Path(id): Path<String>,
) -> Result<StatusCode, Problem> {
    trash::restore(&app, &id).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// Permanently deletes an object in the trash.
#[utoipa::path(delete, path = "/v1/trash/{id}", tag = "changes",
    params(("id" = String, Path, description = "Id of the cohort or of the dictionary version")),
    responses(
        (status = 204, description = "Permanently deleted"),
        (status = 404, description = "Not in the trash")
    ))]
pub(in crate::api::v1) async fn remove_trashed(
    Caller(app): Caller,
    _: NoQuery,
    Path(id): Path<String>,
) -> Result<StatusCode, Problem> {
    trash::remove(&app, &id).await?;
    Ok(StatusCode::NO_CONTENT)
}
