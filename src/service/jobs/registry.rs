//! Volatile state of jobs, beyond their rows: current progress, cancellation requests and watchers.

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

use tokio::sync::Notify;

use crate::domain::job::{Job, JobStatus, Progress};
use crate::service::app::App;
use crate::service::app::progress::{Channel, JobContext};

/// Channels of all jobs that are running or watched.
#[derive(Debug, Default)]
pub struct Registry {
    channels: Mutex<HashMap<String, Weak<Channel>>>,
    submitted: Notify,
    submitted_to_short: Notify,
}

impl App {
    /// Channels of the jobs in this process.
    pub(super) fn registry(&self) -> Arc<Registry> {
        self.state()
    }
}

impl Registry {
    /// Channel of a job; it lives as long as a holder exists.
    pub(super) fn channel(&self, id: &str) -> Arc<Channel> {
        let mut channels = locked(&self.channels);
        if let Some(channel) = channels.get(id).and_then(Weak::upgrade) {
            return channel;
        }
        channels.retain(|_, channel| channel.strong_count() > 0);
        let channel = Arc::default();
        channels.insert(id.into(), Arc::downgrade(&channel));
        channel
    }

    fn existing(&self, id: &str) -> Option<Arc<Channel>> {
        locked(&self.channels).get(id).and_then(Weak::upgrade)
    }

    /// Context of a new attempt. An older attempt at the same job has lost its claim and is stopped.
    pub(super) fn begin(&self, id: &str) -> JobContext {
        let channel = self.channel(id);
        let interrupted: Arc<AtomicBool> = Arc::default();
        let older = std::mem::replace(&mut *locked(&channel.interrupted), Arc::clone(&interrupted));
        older.store(true, Ordering::Relaxed);
        channel.progress.send_replace(Progress::default());
        JobContext { interrupted, deadline: None, channel }
    }

    /// Asks the running attempt, if any, to stop.
    pub(super) fn interrupt(&self, id: &str) {
        if let Some(channel) = self.existing(id) {
            locked(&channel.interrupted).store(true, Ordering::Relaxed);
        }
    }

    /// Notifies the watchers of the job that its row has changed.
    pub(super) fn announce(&self, id: &str) {
        if let Some(channel) = self.existing(id) {
            channel.states.send_replace(());
        }
    }

    /// The job with its current progress; the stored progress may be up to a second old.
    pub(super) fn up_to_date(&self, job: Job) -> Job {
        match self.existing(&job.id) {
            Some(channel) if job.status == JobStatus::Running => {
                job.with_progress(&channel.progress.borrow())
            }
            _ => job,
        }
    }

    /// Wakes a slot of each kind to look into the queue.
    pub(super) fn wake(&self) {
        self.submitted.notify_one();
        self.submitted_to_short.notify_one();
    }

    /// Waits for [`Registry::wake`]; an earlier call counts.
    pub(super) async fn woken(&self, short: bool) {
        if short { self.submitted_to_short.notified().await } else { self.submitted.notified().await }
    }
}

/// Locks a mutex, ignoring poison: no critical section leaves a partial change.
fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::domain::job::JobKind;
    use crate::service::app::ServiceError;

    #[test]
    fn a_new_attempt_stops_the_older_one_and_starts_from_nothing() {
        let registry = Registry::default();
        let older = registry.begin("job_1");
        older.report("half way", 0.5, None);
        let newer = registry.begin("job_1");
        assert!(matches!(older.check(), Err(ServiceError::Cancelled)));
        assert!(newer.check().is_ok());
        assert_eq!(newer.progress(), Progress::default());
        older.report("late", 0.9, None);
        assert_eq!(newer.progress(), Progress::default());
        registry.interrupt("job_2");
        assert!(!newer.is_cancelled());
        registry.interrupt("job_1");
        assert!(newer.is_cancelled());
    }

    #[test]
    fn only_running_jobs_have_progress_of_this_moment() {
        let registry = Registry::default();
        let mut job = Job::new(JobKind::LearnDictionary, serde_json::Value::Null, 1);
        let context = registry.begin(&job.id);
        context.report("learning", 0.5, Some(3.0));
        assert_eq!(registry.up_to_date(job.clone()), job);
        job.status = JobStatus::Running;
        let seen = registry.up_to_date(job);
        assert_eq!(
            (seen.progress, seen.phase.as_deref(), seen.objective),
            (0.5, Some("learning"), Some(3.0))
        );
    }

    #[test]
    fn channels_nobody_holds_are_forgotten() {
        let registry = Registry::default();
        for k in 0..100 {
            drop(registry.channel(&format!("job_{k}")));
        }
        let _held = registry.channel("held");
        assert_eq!(locked(&registry.channels).len(), 1);
        assert!(registry.existing("held").is_some());
    }
}
