//! Periodic clean-up: expired objects in the trash, expired receipts, remains of erased shapes, and old entries of the audit trail.

use std::time::Duration;

use crate::service::app::{App, ServiceError, clock};
use crate::service::audit::trail;
use crate::service::cohorts::{corrections, trash};

/// Interval between clean-ups.
const EVERY: Duration = Duration::from_secs(600);

/// Retention periods.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Terms {
    /// Days for which deleted objects can be restored.
    pub trash_days: u32,
    /// Days for which entries of the audit trail are kept.
    pub audit_days: u32,
}

/// Removes expired data periodically until the service stops.
pub async fn keep_tidy(app: App, terms: Terms) {
    if let Err(error) = corrections::finish(&app).await {
        tracing::warn!(error = error.cause(), "an interrupted erasure could not be completed");
    }
    let mut ticks = tokio::time::interval(EVERY);
    loop {
        tokio::select! {
            _ = ticks.tick() => {}
            () = app.stopping() => return,
        }
        // After erasures that were interrupted, or found no room for it.
        drop(app.store.begin_rewriting());
        if let Err(error) = tidy(&app, terms).await {
            tracing::warn!(error = error.cause(), "expired data could not be removed");
        }
    }
}

/// Removes expired data, unless the clock is implausible.
///
/// # Errors
/// Store errors.
pub async fn tidy(app: &App, terms: Terms) -> Result<(), ServiceError> {
    if !clock::look(app).await? {
        return Ok(());
    }
    trash::tidy(app, terms.trash_days).await?;
    trail::prune(app, terms.audit_days).await
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::domain::audit::{AuditFilter, Entry};
    use crate::service::app::{Limits, now_ms};
    use crate::store::{ClockNotes, Store};

    const TERMS: Terms = Terms { trash_days: 30, audit_days: 30 };

    #[tokio::test]
    async fn nothing_is_removed_while_the_clock_is_not_believed() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).await.unwrap();
        let app = App::new(store, Limits::default(), 1);
        let days = |count: i64| now_ms() - count * 86_400_000;
        let count = async || app.store.list_audit("a", &AuditFilter::default(), 0, 9).await.unwrap().len();
        // A store last used 400 days ago.
        let old = Entry { at_ms: days(400), tenant: "a".into(), ..Entry::default() };
        app.store.append_audit(&[old]).await.unwrap();
        tidy(&app, TERMS).await.unwrap();
        tidy(&app, TERMS).await.unwrap();
        assert_eq!(count().await, 1);
        let notes = app.store.clock_notes().await.unwrap();
        assert!(notes.believed_ms.unwrap() < days(399) && notes.candidate_ms.is_some(), "{notes:?}");
        clock::confirm(&app.store).await.unwrap();
        tidy(&app, TERMS).await.unwrap();
        assert_eq!(count().await, 0);
        // A running service whose clock jumps.
        app.store
            .append_audit(&[Entry { at_ms: days(40), tenant: "a".into(), ..Entry::default() }])
            .await
            .unwrap();
        app.store.note_clock(ClockNotes::believing(days(40))).await.unwrap();
        tidy(&app, TERMS).await.unwrap();
        assert_eq!(count().await, 1);
    }
}
