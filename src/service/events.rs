//! What happens to the objects of a tenant, as a stream: changes in the order of their numbers, and the progress of running
//! jobs.
//!
//! A stream reads the change feed, which all replicas write, every `LOOK`. It continues from the number of any change, so a
//! client that reconnects misses nothing that the feed still has. Progress is not stored: it has no number, and is not
//! repeated.

use std::collections::{HashMap, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio::time::Instant;

use crate::domain::change::{Change, ChangeFilter};
use crate::domain::job::{Job, JobFilter, JobStatus};
use crate::service::access;
use crate::service::app::{App, ServiceError};
use crate::service::cohorts::changes;
use crate::service::jobs;

/// Interval between two looks at the feed.
const LOOK: Duration = Duration::from_millis(400);
/// Interval between two reports of a running job, a little less than a second.
const PROGRESS: Duration = Duration::from_millis(800);
/// Interval between two checks that the caller is still let in.
const CHECK: Duration = Duration::from_secs(3);
/// Longest duration of a stream. The client reconnects with its credential, which is then checked in full.
const LONGEST: Duration = Duration::from_secs(900);
/// Changes per look.
const PAGE: usize = 100;
/// Running jobs whose progress is reported.
const MAX_JOBS: usize = 100;
/// Concurrent streams of a caller.
pub const MAX_STREAMS: usize = 16;

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

/// Open streams by tenant and caller.
#[derive(Debug, Default)]
struct Open(Mutex<HashMap<(String, String), usize>>);

impl Open {
    fn locked(&self) -> MutexGuard<'_, HashMap<(String, String), usize>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Place of a stream among those of its caller, free again when it is dropped.
#[derive(Debug)]
struct Slot {
    open: Arc<Open>,
    caller: (String, String),
}

impl Slot {
    fn take(app: &App) -> Result<Self, ServiceError> {
        let principal = &app.principal;
        let caller = principal.subject.as_ref().unwrap_or(&principal.key);
        let (open, caller): (Arc<Open>, _) = (app.state(), (principal.tenant.clone(), caller.clone()));
        let mut streams = open.locked();
        let count = streams.entry(caller.clone()).or_default();
        if *count >= MAX_STREAMS {
            let detail =
                format!("expected at most {MAX_STREAMS} open event streams of a caller, got one more");
            return Err(ServiceError::Overloaded(detail));
        }
        *count += 1;
        drop(streams);
        Ok(Self { open, caller })
    }
}

impl Drop for Slot {
    fn drop(&mut self) {
        let mut streams = self.open.locked();
        if let Some(count) = streams.get_mut(&self.caller) {
            *count -= 1;
            if *count == 0 {
                streams.remove(&self.caller);
            }
        }
    }
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
    end: Instant,
    /// Time of the next check of the caller, and of the next report of progress.
    check: Instant,
    report: Instant,
    _slot: Slot,
}

impl Events {
    /// Opens a stream of what happens after the change with number `after`; by default, of what happens from now on.
    ///
    /// # Errors
    /// [`ServiceError::ChangesGone`]; [`ServiceError::Overloaded`] if the caller has too many streams.
    pub async fn open(app: &App, wanted: Wanted, after: Option<u64>) -> Result<Self, ServiceError> {
        let slot = Slot::take(app)?;
        let last = match after {
            Some(after) => after,
            None => app.store.last_change().await?,
        };
        let now = Instant::now();
        let mut events = Self {
            app: app.clone(),
            wanted,
            first: last,
            last,
            ready: VecDeque::new(),
            behind: false,
            end: now + LONGEST,
            check: now + CHECK,
            report: now,
            _slot: slot,
        };
        // Faults of the position are answered before the stream begins.
        events.look().await?;
        Ok(events)
    }

    /// Number of the change after which the stream begins.
    pub fn first(&self) -> u64 {
        self.first
    }

    /// The next event; `None` at the end: the service is stopping, the caller is no longer let in, or the stream has lasted
    /// long enough.
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
            if Instant::now() >= self.end || !self.is_admitted().await? {
                return Ok(None);
            }
            self.look().await?;
        }
    }

    async fn is_admitted(&mut self) -> Result<bool, ServiceError> {
        if Instant::now() < self.check {
            return Ok(true);
        }
        self.check = Instant::now() + CHECK;
        access::still_admits(&self.app).await
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
    async fn a_stream_begins_now_or_at_a_number_and_streams_are_counted() {
        let folder = tempfile::tempdir().unwrap();
        let app = App::new(Store::open(folder.path()).await.unwrap(), Limits::default(), 1);
        let submit =
            async || jobs::submit(&app, JobKind::Distances, serde_json::json!({}), 1.0).await.unwrap();
        let first = submit().await;
        let wanted = Wanted { progress: true, ..Wanted::default() };
        let mut from_now = Events::open(&app, wanted.clone(), None).await.unwrap();
        let mut all = Events::open(&app, wanted.clone(), Some(0)).await.unwrap();
        let second = submit().await;
        let object = async |events: &mut Events| match events.next().await.unwrap().unwrap() {
            Event::Change(change) => (change.kind, change.object),
            other => panic!("nothing is running, and all is wanted: {other:?}"),
        };
        let queued = |job: &Job| (ChangeKind::JobQueued, job.id.clone());
        assert_eq!(object(&mut from_now).await, queued(&second));
        assert_eq!([object(&mut all).await, object(&mut all).await], [queued(&first), queued(&second)]);
        assert_eq!((from_now.first(), all.first()), (1, 0));

        let mut open = Vec::new();
        for _ in 2..MAX_STREAMS {
            open.push(Events::open(&app, wanted.clone(), None).await.unwrap());
        }
        let refused = Events::open(&app, wanted.clone(), None).await;
        assert!(matches!(refused, Err(ServiceError::Overloaded(_))), "{refused:?}");
        drop(all);
        Events::open(&app, wanted, None).await.unwrap();
        app.drain();
        assert_eq!(from_now.next().await.unwrap(), None);
    }
}
