//! The feed of changes.

use crate::domain::change::Change;
use crate::service::app::{App, ServiceError};

/// Some changes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Changes {
    /// In their order.
    pub changes: Vec<Change>,
    /// Where to go on: the number of the last change that was looked at.
    pub last: u64,
    /// Whether there was no later one.
    pub done: bool,
}

/// At most `limit` changes after the one with the number `since`.
///
/// # Errors
/// [`ServiceError::ChangesGone`].
pub async fn list(app: &App, since: u64, limit: usize) -> Result<Changes, ServiceError> {
    // Before the list: what is added between the two is seen the next time.
    let newest = app.store.last_change().await?;
    let mut changes = app.store.list_changes(since, limit + 1).await?;
    let done = changes.len() <= limit;
    changes.truncate(limit);
    let seen = changes.last().map_or(since, |change| change.sequence);
    // With nothing more to see, changes that are not open to the caller need not be looked at again.
    let last = if done { seen.max(newest) } else { seen };
    Ok(Changes { changes, last, done })
}
