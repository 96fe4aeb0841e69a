//! Progress and cancellation of one computation, shared by the thread that runs it and those that watch it.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Instant;

use tokio::sync::watch;

use super::error::ServiceError;
use crate::domain::job::Progress;

/// The channel of a job, between who runs it and who watches it.
#[derive(Debug, Default)]
pub(in crate::service) struct Channel {
    /// Says that the row has changed.
    pub(in crate::service) states: watch::Sender<()>,
    pub(in crate::service) progress: watch::Sender<Progress>,
    /// Says the present attempt that it shall stop.
    pub(in crate::service) interrupted: Mutex<Arc<AtomicBool>>,
}

impl Channel {
    /// Changes of the row from now on.
    pub(in crate::service) fn states(&self) -> watch::Receiver<()> {
        self.states.subscribe()
    }

    /// Progress from now on.
    pub(in crate::service) fn progress(&self) -> watch::Receiver<Progress> {
        self.progress.subscribe()
    }
}

/// What an attempt says and hears while it runs. The default belongs to no job: nobody listens.
#[derive(Debug, Clone, Default)]
pub struct JobContext {
    pub(in crate::service) interrupted: Arc<AtomicBool>,
    /// When its time is over.
    pub(in crate::service) deadline: Option<Instant>,
    pub(in crate::service) channel: Arc<Channel>,
}

impl JobContext {
    /// Nothing, or that the work shall stop; cheap enough for inner loops.
    ///
    /// # Errors
    /// [`ServiceError::Cancelled`].
    pub fn check(&self) -> Result<(), ServiceError> {
        if self.is_cancelled() { Err(ServiceError::Cancelled) } else { Ok(()) }
    }

    /// The same work without a voice: parts of it are done that do not count as its progress.
    pub(crate) fn silent(&self) -> Self {
        Self { channel: Arc::default(), ..self.clone() }
    }

    /// The same work, whose time is over at `deadline`.
    pub(crate) fn until(&self, deadline: Instant) -> Self {
        Self { deadline: Some(deadline), ..self.clone() }
    }

    /// Whether the work shall stop: the job was cancelled, the client has gone, the service stops, another attempt has taken
    /// over, or the time is over.
    pub fn is_cancelled(&self) -> bool {
        self.interrupted.load(Ordering::Relaxed)
            || self.deadline.is_some_and(|deadline| Instant::now() >= deadline)
    }

    /// Says how far the work is; cheap, nothing is written here.
    ///
    /// `fraction` is held within 0 to 1; an objective that is not finite is none.
    pub fn report(&self, phase: &'static str, fraction: f64, objective: Option<f64>) {
        let fraction = if fraction.is_nan() { 0.0 } else { fraction.clamp(0.0, 1.0) };
        let objective = objective.filter(|objective| objective.is_finite());
        // An attempt that has lost its claim must not speak for the one that has it.
        if !self.is_cancelled() {
            self.channel.progress.send_replace(Progress { fraction, phase: Some(phase), objective });
        }
    }

    /// Asks the work to stop.
    pub fn interrupt(&self) {
        self.interrupted.store(true, Ordering::Relaxed);
    }

    /// What was reported last.
    pub fn progress(&self) -> Progress {
        *self.channel.progress.borrow()
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
