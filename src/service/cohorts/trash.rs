//! Trash: deleted objects, until their retention period ends.

use crate::domain::trash::{Trashed, TrashedKind};
use crate::service::app::{App, Page, ServiceError, now_ms};

/// Objects in the trash in id order, after `cursor` (the id of the last object of the previous page).
///
/// # Errors
/// Those of the store.
pub async fn list(app: &App, cursor: Option<&str>, limit: usize) -> Result<Page<Trashed>, ServiceError> {
    let mut items = app.store.list_trash(cursor, limit + 1).await?;
    let next = (items.len() > limit).then(|| items[limit - 1].id.clone());
    items.truncate(limit);
    Ok((items, next))
}

/// Restores the object with this id from the trash.
///
/// # Errors
/// [`ServiceError::NotFound`]; [`ServiceError::NameTaken`] if another cohort has taken the name in the meantime.
pub async fn restore(app: &App, id: &str) -> Result<TrashedKind, ServiceError> {
    app.store.restore(id, now_ms()).await?.ok_or_else(|| not_found(id))
}

/// Permanently removes the object with this id from the trash.
///
/// # Errors
/// [`ServiceError::NotFound`].
pub async fn remove(app: &App, id: &str) -> Result<(), ServiceError> {
    if app.store.remove_trashed(id).await? {
        return Ok(());
    }
    Err(not_found(id))
}

fn not_found(id: &str) -> ServiceError {
    ServiceError::NotFound { kind: "trash entry", key: id.into() }
}

/// Permanently removes objects that have been in the trash for more than `days`, and expired receipts.
///
/// # Errors
/// Those of the store.
pub async fn tidy(app: &App, days: u32) -> Result<(), ServiceError> {
    const DAY_MS: i64 = 24 * 3_600_000;
    let now = now_ms();
    let removed = app.store.purge_trash(now - i64::from(days) * DAY_MS).await?;
    if removed > 0 {
        tracing::info!(removed, "removed expired entries of the trash");
    }
    app.store.prune_receipts(now).await?;
    Ok(())
}
