//! Feed of changes. A client continues from the number of the last change it has examined; old changes are not kept.

use crate::domain::change::Change;
use crate::service::app::{App, ServiceError};

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
