//! Events on the objects of a tenant, as a stream: changes in the order of their numbers, and the progress of running
//! jobs.
//!
//! A stream continues from the number of any change, so a client that reconnects misses nothing that the change feed, which all
//! replicas write, still has. Progress is not stored: it has no number, and is not repeated.
//!
//! * `feed` — reads the change feed once for all streams of a tenant;
//! * [`place`] — how many streams a caller has, and how long they last, also those of single jobs.

mod feed;
pub mod place;

use std::collections::VecDeque;
use std::sync::Arc;

use tokio::sync::watch;

use self::feed::{Feed, Recent};
use crate::domain::change::{Change, ChangeFilter};
use crate::domain::job::Job;
use crate::service::app::{App, ServiceError};
use crate::service::cohorts::changes::{self, Changes};

/// Changes that a stream which is behind reads at once.
const PAGE: usize = 100;

/// Something that happened.
#[derive(Debug, Clone, PartialEq)]
pub enum Event {
    /// A change, with a number from which a stream can continue.
    Change(Change),
    /// Current state of a running job.
    Progress(Box<Job>),
    /// Changes up to this number were examined, and the last of them were not wanted: a stream can continue from here.
    Examined(u64),
}

/// Selection of events that a stream reports.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Wanted {
    /// Changes.
    pub changes: ChangeFilter,
    /// Whether the progress of running jobs is reported.
    pub progress: bool,
}

/// A stream of events.
#[derive(Debug)]
pub struct Events {
    app: App,
    wanted: Wanted,
    /// Number of the change after which the stream begins.
    first: u64,
    /// Number of the last change examined.
    last: u64,
    ready: VecDeque<Event>,
    /// Whether there are more changes than the last look has read.
    behind: bool,
    news: watch::Receiver<Recent>,
    /// Number of the last report of running jobs.
    reported: u64,
    /// Is read while it is held.
    _feed: Arc<Feed>,
}

impl Events {
    /// Opens a stream of events after the change with number `after`; by default, of events from now on.
    ///
    /// # Errors
    /// [`ServiceError::ChangesGone`].
    pub async fn open(app: &App, wanted: Wanted, after: Option<u64>) -> Result<Self, ServiceError> {
        // Subscribed before the store is read: changes in between are news.
        let feed = Feed::of(app);
        let news = feed.subscribe();
        let reported = news.borrow().reports;
        let last = match after {
            Some(after) => after,
            None => app.store.last_change().await?,
        };
        let mut events = Self {
            app: app.clone(),
            wanted,
            first: last,
            last,
            ready: VecDeque::new(),
            behind: false,
            reported,
            news,
            _feed: feed,
        };
        // Faults of the position are answered before the stream begins.
        events.look().await?;
        Ok(events)
    }

    /// Number of the change after which the stream begins.
    pub fn first(&self) -> u64 {
        self.first
    }

    /// The next event; `None` when the service is stopping.
    ///
    /// # Errors
    /// Failures of the store; [`ServiceError::ChangesGone`] if the client reads more slowly than the feed is removed.
    pub async fn next(&mut self) -> Result<Option<Event>, ServiceError> {
        loop {
            if let Some(event) = self.ready.pop_front() {
                return Ok(Some(event));
            }
            if !self.behind {
                tokio::select! {
                    // Cannot fail: the feed held here owns the sender.
                    _ = self.news.changed() => {}
                    () = self.app.stopping() => return Ok(None),
                }
            }
            self.look().await?;
        }
    }

    async fn look(&mut self) -> Result<(), ServiceError> {
        let (recent, running) = self.recent();
        let found = match recent {
            Some(found) => found,
            None => changes::list(&self.app, self.last, PAGE).await?,
        };
        let admits =
            |change: &Change| self.wanted.changes.admits(change) && self.sees(change.cohort.as_deref());
        let wanted: Vec<Change> = found.changes.into_iter().filter(admits).collect();
        self.ready.extend(wanted.into_iter().map(Event::Change));
        if self.ready.is_empty() && found.last > self.last {
            self.ready.push_back(Event::Examined(found.last));
        }
        (self.last, self.behind) = (found.last, !found.done);
        let cohort = self.wanted.changes.cohort.as_deref();
        let admits =
            |job: &&Job| self.sees(job.cohort()) && cohort.is_none_or(|cohort| job.cohort() == Some(cohort));
        let progress: Vec<Event> =
            running.iter().filter(admits).map(|job| Event::Progress(Box::new(job.clone()))).collect();
        self.ready.extend(progress);
        Ok(())
    }

    /// The changes that the feed has for this stream, and the running jobs that it has not reported yet.
    fn recent(&mut self) -> (Option<Changes>, Arc<Vec<Job>>) {
        let recent = self.news.borrow_and_update();
        let is_new = self.wanted.progress && recent.reports > self.reported;
        self.reported = recent.reports;
        (recent.after(self.last), if is_new { Arc::clone(&recent.running) } else { Arc::default() })
    }

    /// Whether the caller may see objects of this cohort, or of none.
    fn sees(&self, cohort: Option<&str>) -> bool {
        match cohort {
            Some(cohort) => self.app.principal.may_use(cohort),
            None => self.app.principal.cohorts.is_none(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::domain::change::ChangeKind;
    use crate::domain::job::JobKind;
    use crate::service::app::Limits;
    use crate::service::jobs;
    use crate::store::Store;
    use std::time::Duration;

    #[tokio::test]
    async fn a_stream_begins_now_or_at_a_number_and_ends_with_the_service() {
        let folder = tempfile::tempdir().unwrap();
        let app = App::new(Store::open(folder.path()).await.unwrap(), Limits::default(), 1);
        let submit =
            async || jobs::submit(&app, JobKind::Distances, serde_json::json!({}), 1.0).await.unwrap();
        let first = submit().await;
        let wanted = Wanted { progress: true, ..Wanted::default() };
        let mut from_now = Events::open(&app, wanted.clone(), None).await.unwrap();
        let mut all = Events::open(&app, wanted, Some(0)).await.unwrap();
        let second = submit().await;
        let object = async |events: &mut Events| match events.next().await.unwrap().unwrap() {
            Event::Change(change) => (change.kind, change.object),
            other => panic!("nothing is running, and all is wanted: {other:?}"),
        };
        let queued = |job: &Job| (ChangeKind::JobQueued, job.id.clone());
        assert_eq!(object(&mut from_now).await, queued(&second));
        assert_eq!([object(&mut all).await, object(&mut all).await], [queued(&first), queued(&second)]);
        assert_eq!((from_now.first(), all.first()), (1, 0));
        app.drain();
        assert_eq!(from_now.next().await.unwrap(), None);
    }

    #[tokio::test]
    async fn streams_of_a_tenant_share_one_reader_and_ask_the_store_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let app = App::new(Store::open(folder.path()).await.unwrap(), Limits::default(), 1);
        let mut first = Events::open(&app, Wanted::default(), None).await.unwrap();
        let second = Events::open(&app, Wanted::default(), None).await.unwrap();
        assert!(Arc::ptr_eq(&first._feed, &second._feed));
        let other = app.of(Arc::new(crate::domain::access::Principal::system("b")));
        assert!(!Arc::ptr_eq(
            &Events::open(&other, Wanted::default(), None).await.unwrap()._feed,
            &first._feed
        ));
        app.store.close().await;
        let waits = tokio::time::timeout(Duration::from_millis(1200), first.next()).await;
        assert!(waits.is_err(), "a stream that asks the closed store would fail: {waits:?}");
        let feed = Arc::downgrade(&first._feed);
        drop((first, second));
        let unread = async {
            while feed.strong_count() > 0 {
                tokio::time::sleep(Duration::from_millis(20)).await;
            }
        };
        tokio::time::timeout(Duration::from_secs(20), unread).await.expect("without streams nothing is read");
    }
}
