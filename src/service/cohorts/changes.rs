//! Feed of changes. A client continues from the number of the last change it has examined; old changes are not kept.

use serde::Serialize;

use crate::domain::change::{Change, ChangeKind};
use crate::service::app::{App, ServiceError};
use crate::wire::time::rfc3339;

/// Entry of the change feed, which the event stream and hooks send too.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub struct ChangeOutput {
    /// Number of the change, from 1; changes of a tenant are numbered in order.
    sequence: u64,
    /// Time of the change, RFC 3339 in UTC.
    at: String,
    /// Kind of change.
    kind: ChangeKind,
    /// Id of the changed object.
    object: String,
    /// Id of the cohort that the object belongs to.
    cohort: Option<String>,
    /// Revision of the cohort after the change.
    revision: Option<u64>,
    /// Number of shapes added, deleted or erased.
    #[serde(rename = "shape_count")]
    shapes: Option<u64>,
    /// Ids of the shapes that were erased, at most 200: more are in further changes. Absent for other kinds.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(required = false, max_items = 200)]
    shape_ids: Option<Vec<String>>,
}

impl From<Change> for ChangeOutput {
    fn from(change: Change) -> Self {
        let Change { sequence, at_ms, kind, object, cohort, revision, shapes, shape_ids } = change;
        Self { sequence, at: rfc3339(at_ms), kind, object, cohort, revision, shapes, shape_ids }
    }
}

/// A page of changes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Changes {
    /// The changes, in order.
    pub changes: Vec<Change>,
    /// Number of the last change examined, from which to continue.
    pub last: u64,
    /// Whether no later change exists.
    pub done: bool,
}

/// At most `limit` changes after number `since`.
///
/// # Errors
/// [`ServiceError::ChangesGone`].
pub async fn list(app: &App, since: u64, limit: usize) -> Result<Changes, ServiceError> {
    // Read before the list: changes added in between are seen by the next call.
    let newest = app.store.last_change().await?;
    let mut changes = app.store.list_changes(since, limit + 1).await?;
    let done = changes.len() <= limit;
    changes.truncate(limit);
    let seen = changes.last().map_or(since, |change| change.sequence);
    // At the end of the feed, changes that the caller may not see need not be examined again.
    let last = if done { seen.max(newest) } else { seen };
    Ok(Changes { changes, last, done })
}
