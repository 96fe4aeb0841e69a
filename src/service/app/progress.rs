//! Progress and cancellation of one computation, shared by the thread that runs it and its watchers.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use tokio::sync::watch;

use super::error::ServiceError;
use crate::analysis::watch::Watch;
use crate::domain::job::{Job, Progress};

/// Channel between the attempt that runs a job and its watchers.
#[derive(Debug, Default)]
pub(in crate::service) struct Channel {
    /// Signals that the stored row has changed.
    pub(in crate::service) states: watch::Sender<()>,
    pub(in crate::service) progress: watch::Sender<Progress>,
    /// Tells the current attempt to stop.
    pub(in crate::service) interrupted: Mutex<Arc<AtomicBool>>,
    /// The job as its watchers have read it last, and when.
    pub(in crate::service) read: tokio::sync::Mutex<Option<(Instant, Job)>>,
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
    /// `fraction` is clamped to 0 to 1 and never falls; an objective that is not finite is dropped.
    pub fn report(&self, phase: &'static str, fraction: f64, objective: Option<f64>) {
        let fraction = if fraction.is_nan() { 0.0 } else { fraction.clamp(0.0, 1.0) };
        let objective = objective.filter(|objective| objective.is_finite());
        // An attempt that has lost its claim must not report for the one that holds it.
        if !self.is_cancelled() {
            self.channel.progress.send_modify(|progress| {
                let fraction = fraction.max(progress.fraction);
                *progress = Progress { fraction, phase: Some(phase), objective };
            });
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

/// A part of a job: its predicted work, in the unit of all parts, and how much of it is usually counted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Part {
    /// Predicted work.
    pub work: f64,
    /// Count that is expected by its end.
    pub count: f64,
}

/// Progress of a job in parts: the fraction of the predicted work, from the work that is counted.
#[derive(Debug)]
pub struct Meter {
    context: JobContext,
    parts: Vec<Part>,
    /// Predicted work of all parts, and of the work after them.
    whole: f64,
    place: Mutex<Place>,
}

/// Where a job is.
#[derive(Debug, Default)]
struct Place {
    part: usize,
    name: &'static str,
    counted: f64,
    /// Fraction of the part that is known to be done.
    reached: f64,
    objective: Option<f64>,
}

/// Fraction of a part up to which its progress is proportional to the count. From there on it goes ever slower, because an
/// iteration may take longer than usual: with `left` the rest of the part, `1 − left² / (left + excess)`, so that a part that takes
/// ten times its usual count is still told from one that is done.
const PROPORTIONAL: f64 = 0.8;

impl Meter {
    /// Progress of `parts`, after which `rest` is left to do.
    pub fn new(context: &JobContext, parts: Vec<Part>, rest: f64) -> Self {
        let whole = rest + parts.iter().map(|part| part.work).sum::<f64>();
        Self { context: context.clone(), parts, whole, place: Mutex::default() }
    }

    /// Enters a phase of a part. Entering another phase of the same part loses nothing.
    pub fn enter(&self, part: usize, name: &'static str) {
        self.report(|place| {
            if part != place.part {
                *place = Place { part, ..Place::default() };
            }
            place.name = name;
        });
    }

    /// Counts work of the current part.
    pub fn worked(&self, count: usize) {
        self.report(|place| place.counted += count as f64);
    }

    /// Part of the current part that is known to be done.
    pub fn reached(&self, fraction: f64) {
        self.report(|place| place.reached = place.reached.max(fraction));
    }

    /// Current value of the objective.
    pub fn objective(&self, value: f64) {
        self.report(|place| place.objective = Some(value));
    }

    fn report(&self, change: impl FnOnce(&mut Place)) {
        let mut place = self.place.lock().unwrap_or_else(PoisonError::into_inner);
        change(&mut place);
        let Part { work, count } = self.parts[place.part];
        let before: f64 = self.parts[..place.part].iter().map(|part| part.work).sum();
        let part = done(place.counted / count.max(1.0)).max(place.reached.min(1.0));
        self.context.report(place.name, (before + part * work) / self.whole.max(1.0), place.objective);
    }
}

/// Fraction of a part for this multiple of its usual count.
fn done(count: f64) -> f64 {
    if count <= PROPORTIONAL {
        return count;
    }
    let left = 1.0 - PROPORTIONAL;
    1.0 - left * left / (left + count - PROPORTIONAL)
}

/// Counts the work of a computation, and stops it with its job.
impl Watch for Meter {
    fn stop(&self) -> bool {
        self.context.is_cancelled()
    }

    fn worked(&self, count: usize) {
        self.worked(count);
    }

    fn progress(&self, fraction: f64) {
        self.reached(fraction);
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
        for (fraction, expected) in [(-1.0, 0.0), (0.25, 0.25), (0.1, 0.25), (f64::NAN, 0.25), (7.0, 1.0)] {
            context.report("learning", fraction, Some(f64::INFINITY));
            let wanted = Progress { fraction: expected, phase: Some("learning"), objective: None };
            assert_eq!(context.progress(), wanted, "{fraction}");
        }
        context.report("learning", 0.5, Some(2.5));
        assert_eq!(context.progress().objective, Some(2.5));
    }

    #[test]
    fn parts_are_measured_by_what_they_count() {
        let context = JobContext::default();
        let parts = vec![Part { work: 60.0, count: 1000.0 }, Part { work: 20.0, count: 10.0 }];
        let meter = Meter::new(&context, parts, 20.0);
        let fraction = || context.progress().fraction;
        meter.enter(0, "mean");
        assert_eq!(fraction(), 0.0);
        meter.worked(500);
        assert!((fraction() - 0.3).abs() < 1e-12, "{}", fraction());
        // An iteration that takes longer than usual still moves, and never reaches the end.
        let mut before = fraction();
        for _ in 0..20 {
            meter.worked(100);
            assert!(fraction() > before && fraction() < 0.6, "{}", fraction());
            before = fraction();
        }
        meter.enter(1, "learn");
        assert!((fraction() - 0.6).abs() < 1e-12);
        meter.reached(0.5);
        meter.objective(3.0);
        meter.worked(1);
        meter.enter(1, "refine");
        let progress = context.progress();
        assert_eq!((progress.phase, progress.objective), (Some("refine"), Some(3.0)));
        assert!((progress.fraction - 0.7).abs() < 1e-12, "{progress:?}");
    }
}
