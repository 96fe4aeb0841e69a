//! The feed of a tenant as its streams in this process share it. One task looks every [`LOOK`] while there are streams, so that their
//! number costs the store nothing; each stream takes the changes that its caller may see.

use std::collections::{HashMap, VecDeque};
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::time::Duration;

use tokio::sync::watch;
use tokio::time::Instant;

use crate::domain::access::Principal;
use crate::domain::change::Change;
use crate::domain::job::{Job, JobFilter, JobStatus};
use crate::service::app::{App, ServiceError};
use crate::service::cohorts::changes::Changes;
use crate::service::jobs;

/// Interval between two looks at the feed.
const LOOK: Duration = Duration::from_millis(400);
/// Interval between two reports of a running job, a little less than a second.
const PROGRESS: Duration = Duration::from_millis(800);
/// Changes that are kept; a stream that is further behind reads the store.
const KEPT: usize = 256;
/// Running jobs whose progress is reported.
const MAX_JOBS: usize = 100;

/// Feeds of the tenants that have streams.
#[derive(Debug, Default)]
struct Feeds(Mutex<HashMap<String, Weak<Feed>>>);

/// The feed of a tenant.
#[derive(Debug, Default)]
pub(super) struct Feed(watch::Sender<Recent>);

/// Recent events.
#[derive(Debug, Default)]
pub(super) struct Recent {
    /// The numbers after which and up to which all changes are here; `None` before the first look.
    range: Option<(u64, u64)>,
    changes: VecDeque<Change>,
    /// The running jobs, the oldest first.
    pub(super) running: Arc<Vec<Job>>,
    /// Number of reports of running jobs so far.
    pub(super) reports: u64,
}

impl Recent {
    /// The changes after number `since`; `None` if they are not all here.
    pub(super) fn after(&self, since: u64) -> Option<Changes> {
        let (first, last) = self.range.filter(|(first, _)| *first <= since)?;
        debug_assert!(first <= last);
        let changes = self.changes.iter().filter(|change| change.sequence > since);
        Some(Changes { changes: changes.cloned().collect(), last: last.max(since), done: true })
    }

    fn begin(&mut self, number: u64) {
        self.range = Some((number, number));
        self.changes.clear();
    }

    fn add(&mut self, found: Vec<Change>) {
        let (Some((first, last)), Some(newest)) = (&mut self.range, found.last()) else { return };
        *last = newest.sequence;
        self.changes.extend(found);
        while self.changes.len() > KEPT {
            *first = self.changes.pop_front().map_or(*first, |gone| gone.sequence);
        }
    }
}

impl Feed {
    /// The feed of the caller's tenant, which is read while anything holds it.
    pub(super) fn of(app: &App) -> Arc<Self> {
        let (feeds, tenant) = (app.state::<Feeds>(), &app.principal.tenant);
        let mut feeds = feeds.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(feed) = feeds.get(tenant).and_then(Weak::upgrade) {
            return feed;
        }
        feeds.retain(|_, feed| feed.strong_count() > 0);
        let feed = Arc::new(Self::default());
        feeds.insert(tenant.clone(), Arc::downgrade(&feed));
        tokio::spawn(read(app.of(Arc::new(Principal::system(tenant))), Arc::downgrade(&feed)));
        feed
    }

    /// Events from now on.
    pub(super) fn subscribe(&self) -> watch::Receiver<Recent> {
        self.0.subscribe()
    }

    /// Reads new changes from the store.
    async fn look(&self, app: &App) -> Result<(), ServiceError> {
        loop {
            let newest = app.store.last_change().await?;
            let range = self.0.borrow().range;
            let Some((_, last)) = range else {
                self.0.send_modify(|recent| recent.begin(newest));
                return Ok(());
            };
            if newest <= last {
                return Ok(());
            }
            match app.store.list_changes(last, KEPT).await.map_err(ServiceError::from) {
                Ok(found) => self.0.send_modify(|recent| recent.add(found)),
                // Streams that need them find out by themselves.
                Err(ServiceError::ChangesGone { .. }) => self.0.send_modify(|recent| recent.begin(newest)),
                Err(error) => return Err(error),
            }
        }
    }

    /// Reports the running jobs, if there are any.
    async fn report(&self, app: &App) -> Result<(), ServiceError> {
        let filter = JobFilter { status: Some(JobStatus::Running), ..JobFilter::default() };
        let (mut running, _) = jobs::list(app, &filter, None, MAX_JOBS).await?;
        running.reverse();
        self.0.send_if_modified(|recent| {
            let any = !running.is_empty();
            recent.running = Arc::new(running);
            recent.reports += u64::from(any);
            any
        });
        Ok(())
    }
}

/// Reads the feed while anything holds it.
async fn read(app: App, feed: Weak<Feed>) {
    let (mut report, mut fails) = (Instant::now(), false);
    while let Some(feed) = feed.upgrade() {
        let mut found = feed.look(&app).await;
        if found.is_ok() && Instant::now() >= report {
            report = Instant::now() + PROGRESS;
            found = feed.report(&app).await;
        }
        drop(feed);
        if let Err(error) = &found
            && !fails
        {
            tracing::warn!(
                error = error.cause(),
                "the feed of changes cannot be read: streams of events stand still"
            );
        }
        fails = found.is_err();
        tokio::time::sleep(LOOK).await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::domain::change::ChangeKind;

    fn change(sequence: u64) -> Change {
        Change {
            sequence,
            at_ms: 0,
            kind: ChangeKind::JobQueued,
            object: "job_1".into(),
            cohort: None,
            revision: None,
            shapes: None,
            shape_ids: None,
        }
    }

    #[test]
    fn recent_changes_are_given_only_without_a_gap() {
        let mut recent = Recent::default();
        let found = |changes: Vec<Change>, last| Some(Changes { changes, last, done: true });
        assert_eq!(recent.after(5), None, "nothing was read");
        recent.begin(5);
        assert_eq!((recent.after(4), recent.after(5)), (None, found(Vec::new(), 5)));
        recent.add((6..=8).map(change).collect());
        assert_eq!(recent.after(6), found(vec![change(7), change(8)], 8));
        assert_eq!(recent.after(9), found(Vec::new(), 9), "a number that is yet to come");
        recent.add((9..9 + KEPT as u64).map(change).collect());
        let last = 8 + KEPT as u64;
        assert_eq!((recent.after(7), recent.after(last)), (None, found(Vec::new(), last)));
        assert_eq!(recent.after(8).unwrap().changes.len(), KEPT);
    }
}
