//! Progress and cancellation of one computation, shared by the thread that runs it and its watchers.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Instant;

use tokio::sync::watch;

use super::error::ServiceError;
use crate::analysis::watch::Watch;
use crate::domain::job::Progress;

/// Channel between the attempt that runs a job and its watchers.
#[derive(Debug, Default)]
pub(in crate::service) struct Channel {
    /// Signals that the stored row has changed.
    pub(in crate::service) states: watch::Sender<()>,
    pub(in crate::service) progress: watch::Sender<Progress>,
    /// Tells the current attempt to stop.
    pub(in crate::service) interrupted: Mutex<Arc<AtomicBool>>,
}

impl Channel {
    /// Subscribes to changes of the stored row.
    pub(in crate::service) fn states(&self) -> watch::Receiver<()> {
        self.states.subscribe()
    }

    /// Subscribes to progress.
    pub(in crate::service) fn progress(&self) -> watch::Receiver<Progress> {
        self.progress.subscribe()
    }
}

/// Reports progress of an attempt and receives its cancellation. The default belongs to no job and has no watchers.
#[derive(Debug, Clone, Default)]
pub struct JobContext {
    pub(in crate::service) interrupted: Arc<AtomicBool>,
    /// Deadline of the work.
    pub(in crate::service) deadline: Option<Instant>,
    pub(in crate::service) channel: Arc<Channel>,
}

impl JobContext {
    /// Fails if the work must stop; cheap enough for inner loops.
    ///
    /// # Errors
    /// [`ServiceError::Cancelled`].
    pub fn check(&self) -> Result<(), ServiceError> {
        if self.is_cancelled() { Err(ServiceError::Cancelled) } else { Ok(()) }
    }

    /// The same work with a `deadline`.
    pub(crate) fn until(&self, deadline: Instant) -> Self {
        Self { deadline: Some(deadline), ..self.clone() }
    }

    /// Whether the work must stop: the job was cancelled, the client has disconnected, the service is stopping, another
    /// attempt has taken over, or the deadline has passed.
    pub fn is_cancelled(&self) -> bool {
        self.interrupted.load(Ordering::Relaxed)
            || self.deadline.is_some_and(|deadline| Instant::now() >= deadline)
    }

    /// Reports progress; cheap, nothing is stored here.
    ///
    /// `fraction` is clamped to 0 to 1; an objective that is not finite is dropped.
    pub fn report(&self, phase: &'static str, fraction: f64, objective: Option<f64>) {
        let fraction = if fraction.is_nan() { 0.0 } else { fraction.clamp(0.0, 1.0) };
        let objective = objective.filter(|objective| objective.is_finite());
        // An attempt that has lost its claim must not report for the one that holds it.
        if !self.is_cancelled() {
            self.channel.progress.send_replace(Progress { fraction, phase: Some(phase), objective });
        }
    }

    /// Asks the work to stop.
    pub fn interrupt(&self) {
        self.interrupted.store(true, Ordering::Relaxed);
    }

    /// Last reported progress.
    pub fn progress(&self) -> Progress {
        *self.channel.progress.borrow()
    }
}

/// Stops a computation; its phases are not reported.
impl Watch for JobContext {
    fn stop(&self) -> bool {
        self.is_cancelled()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reports_are_held_within_bounds() {
        let context = JobContext::default();
        for (fraction, expected) in [(0.25, 0.25), (-1.0, 0.0), (7.0, 1.0), (f64::NAN, 0.0)] {
            context.report("learning", fraction, Some(f64::INFINITY));
            let wanted = Progress { fraction: expected, phase: Some("learning"), objective: None };
            assert_eq!(context.progress(), wanted, "{fraction}");
        }
        context.report("learning", 0.5, Some(2.5));
        assert_eq!(context.progress().objective, Some(2.5));
    }
}
