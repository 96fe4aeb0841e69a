//! What happens to the objects of a tenant, as a stream: changes in the order of their numbers, and the progress of running
//! jobs.
//!
//! A stream reads the change feed, which all replicas write, every `LOOK`. It continues from the number of any change, so a
//! client that reconnects misses nothing that the feed still has. Progress is not stored: it has no number, and is not
//! repeated.
//!
//! * [`place`] — how many streams a caller has, and how long they last, also those of single jobs.

pub mod place;

use std::collections::VecDeque;
use std::time::Duration;

use tokio::time::Instant;

use crate::domain::change::{Change, ChangeFilter};
use crate::domain::job::{Job, JobFilter, JobStatus};
use crate::service::app::{App, ServiceError};
use crate::service::cohorts::changes;
use crate::service::jobs;

/// Interval between two looks at the feed.
const LOOK: Duration = Duration::from_millis(400);
/// Interval between two reports of a running job, a little less than a second.
const PROGRESS: Duration = Duration::from_millis(800);
/// Changes per look.
const PAGE: usize = 100;
/// Running jobs whose progress is reported.
const MAX_JOBS: usize = 100;

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

/// What a stream reports.
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
    /// Time of the next report of progress.
    report: Instant,
}

impl Events {
    /// Opens a stream of what happens after the change with number `after`; by default, of what happens from now on.
    ///
    /// # Errors
    /// [`ServiceError::ChangesGone`].
    pub async fn open(app: &App, wanted: Wanted, after: Option<u64>) -> Result<Self, ServiceError> {
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
            report: Instant::now(),
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
                    () = tokio::time::sleep(LOOK) => {}
                    () = self.app.stopping() => return Ok(None),
                }
            }
            self.look().await?;
        }
    }

    async fn look(&mut self) -> Result<(), ServiceError> {
        let found = changes::list(&self.app, self.last, PAGE).await?;
        let wanted = found.changes.into_iter().filter(|change| self.wanted.changes.admits(change));
        self.ready.extend(wanted.map(Event::Change));
        if self.ready.is_empty() && found.last > self.last {
            self.ready.push_back(Event::Examined(found.last));
        }
        (self.last, self.behind) = (found.last, !found.done);
        if self.wanted.progress && Instant::now() >= self.report {
            self.report = Instant::now() + PROGRESS;
            self.ready.extend(self.running().await?.into_iter().map(|job| Event::Progress(Box::new(job))));
        }
        Ok(())
    }

    /// The running jobs, the oldest first.
    async fn running(&self) -> Result<Vec<Job>, ServiceError> {
        let filter = JobFilter {
            status: Some(JobStatus::Running),
            cohort: self.wanted.changes.cohort.clone(),
            ..JobFilter::default()
        };
        let (mut running, _) = jobs::list(&self.app, &filter, None, MAX_JOBS).await?;
        running.reverse();
        Ok(running)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::domain::change::ChangeKind;
    use crate::domain::job::JobKind;
    use crate::service::app::Limits;
    use crate::store::Store;

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
}
