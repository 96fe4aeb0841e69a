//! What has changed, and what was deleted and can come back.

use axum::http::StatusCode;
use axum::response::Response;
use serde::{Deserialize, Serialize};

use super::settings::{Page, PageQuery, time};
use crate::api::extract::{Caller, NoQuery, Path, Query};
use crate::api::problem::{Problem, ProblemDocument};
use crate::api::respond::json;
use crate::domain::change::{Change, ChangeKind};
use crate::domain::trash::{Trashed, TrashedKind};
use crate::service::cohorts::{changes, trash};

/// Where to go on.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct ChangesQuery {
    /// Number of the last change that was seen; 0 unless given.
    #[serde(default)]
    since: u64,
    /// Changes per answer, 1 to 1000; 100 unless given.
    limit: Option<usize>,
}

/// A change.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct ChangeOutput {
    /// Its number, from 1; changes of a tenant are numbered in their order.
    sequence: u64,
    /// RFC 3339 UTC.
    at: String,
    /// What happened.
    kind: ChangeKind,
    /// Id of what it happened to.
    object: String,
    /// Id of its cohort.
    cohort: Option<String>,
    /// Revision of the cohort that it brought about.
    revision: Option<u64>,
    /// Shapes that were added.
    shapes: Option<u64>,
}

impl From<Change> for ChangeOutput {
    fn from(change: Change) -> Self {
        let Change { sequence, at_ms, kind, object, cohort, revision, shapes } = change;
        Self { sequence, at: time(at_ms), kind, object, cohort, revision, shapes }
    }
}

/// Some changes.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct ChangesAnswer {
    /// In their order.
    changes: Vec<ChangeOutput>,
    /// `since` of the next question.
    last: u64,
    /// Whether there was no later change.
    done: bool,
}

/// Lists what has changed, in the order of the changes, so that a pipeline can go on where it stopped.
///
/// Whoever has seen a number has seen all before it. The newest million changes are kept.
#[utoipa::path(get, path = "/changes", tag = "changes", params(ChangesQuery),
    responses(
        (status = 200, description = "The changes after `since`", body = ChangesAnswer),
        (status = 410, description = "Changes that old are not kept any more", body = ProblemDocument, content_type = "application/problem+json"),
        (status = "4XX", description = "The query was refused", body = ProblemDocument, content_type = "application/problem+json")
    ))]
pub(super) async fn list_changes(
    Caller(app): Caller,
    Query(query): Query<ChangesQuery>,
) -> Result<Response, Problem> {
    let page = PageQuery { cursor: None, limit: query.limit };
    let found = changes::list(&app, query.since, page.limit()?).await?;
    let changes = found.changes.into_iter().map(Into::into).collect();
    Ok(json(StatusCode::OK, &ChangesAnswer { changes, last: found.last, done: found.done })?)
}

/// A thing in the trash.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct TrashedOutput {
    /// What it is.
    kind: TrashedKind,
    /// Its id.
    id: String,
    /// Its name, which may belong to another one by now.
    name: String,
    /// Version of a dictionary.
    version: Option<u64>,
    /// RFC 3339 UTC.
    deleted_at: String,
}

impl From<Trashed> for TrashedOutput {
    fn from(trashed: Trashed) -> Self {
        let Trashed { kind, id, name, version, deleted_at_ms } = trashed;
        Self { kind, id, name, version, deleted_at: time(deleted_at_ms) }
    }
}

/// Lists what was deleted and can come back.
#[utoipa::path(get, path = "/trash", tag = "changes", params(PageQuery),
    responses(
        (status = 200, description = "A page of the trash", body = Page<TrashedOutput>),
        (status = "4XX", description = "The query was refused", body = ProblemDocument, content_type = "application/problem+json")
    ))]
pub(super) async fn list_trash(
    Caller(app): Caller,
    Query(page): Query<PageQuery>,
) -> Result<Response, Problem> {
    let (items, next) = trash::list(&app, page.cursor.as_deref(), page.limit()?).await?;
    let items: Vec<TrashedOutput> = items.into_iter().map(Into::into).collect();
    Ok(json(StatusCode::OK, &Page { items, next })?)
}

/// Takes a cohort or a version of a dictionary out of the trash.
#[utoipa::path(post, path = "/trash/{id}/restore", tag = "changes",
    params(("id" = String, Path, description = "Id of the cohort or of the version")),
    responses(
        (status = 204, description = "It is back"),
        (status = 404, description = "It is not in the trash", body = ProblemDocument, content_type = "application/problem+json"),
        (status = 409, description = "Its name is taken by now", body = ProblemDocument, content_type = "application/problem+json"),
        (status = "4XX", description = "The request was refused", body = ProblemDocument, content_type = "application/problem+json")
    ))]
pub(super) async fn restore_trashed(
    Caller(app): Caller,
    _: NoQuery,
    Path(id): Path<String>,
) -> Result<StatusCode, Problem> {
    trash::restore(&app, &id).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// Removes a thing from the trash for good.
#[utoipa::path(delete, path = "/trash/{id}", tag = "changes",
    params(("id" = String, Path, description = "Id of the cohort or of the version")),
    responses(
        (status = 204, description = "Gone"),
        (status = 404, description = "It is not in the trash", body = ProblemDocument, content_type = "application/problem+json"),
        (status = "4XX", description = "The request was refused", body = ProblemDocument, content_type = "application/problem+json")
    ))]
pub(super) async fn remove_trashed(
    Caller(app): Caller,
    _: NoQuery,
    Path(id): Path<String>,
) -> Result<StatusCode, Problem> {
    trash::remove(&app, &id).await?;
    Ok(StatusCode::NO_CONTENT)
}
