//! The trash: what was deleted, until its term ends.

use crate::domain::trash::{Trashed, TrashedKind};
use crate::service::app::{App, Page, ServiceError, now_ms};

/// Things in the trash in the order of their ids, after `cursor` (the id of the last one seen).
///
/// # Errors
/// Those of the store.
pub async fn list(app: &App, cursor: Option<&str>, limit: usize) -> Result<Page<Trashed>, ServiceError> {
    let mut items = app.store.list_trash(cursor, limit + 1).await?;
    let next = (items.len() > limit).then(|| items[limit - 1].id.clone());
    items.truncate(limit);
    Ok((items, next))
}

/// Takes the thing with this id out of the trash.
///
/// # Errors
/// [`ServiceError::NotFound`]; [`ServiceError::NameTaken`] when another cohort has taken the name meanwhile.
pub async fn restore(app: &App, id: &str) -> Result<TrashedKind, ServiceError> {
    app.store.restore(id, now_ms()).await?.ok_or_else(|| not_found(id))
}

/// Removes the thing with this id from the trash for good.
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
    ServiceError::NotFound { kind: "thing in the trash", key: id.into() }
}

/// Removes for good what lies in the trash longer than `days`, and forgets receipts past their time.
///
/// # Errors
/// Those of the store.
pub async fn tidy(app: &App, days: u32) -> Result<(), ServiceError> {
    const DAY_MS: i64 = 24 * 3_600_000;
    let now = now_ms();
    let removed = app.store.purge_trash(now - i64::from(days) * DAY_MS).await?;
    if removed > 0 {
        tracing::info!(removed, "removed for good what lay in the trash past its term");
    }
    app.store.prune_receipts(now).await?;
    Ok(())
}
