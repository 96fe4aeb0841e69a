//! Progress and cancellation of long computations.

use std::sync::atomic::{AtomicUsize, Ordering};

use crate::AnalysisError;

/// Phase of learning a dictionary, in order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Phase {
    /// Computation of the mean shape, including the search of start points.
    Mean,
    /// Alignment of the shapes.
    Align,
    /// Learning of atoms or components.
    Learn,
    /// Encoding of all shapes in the learnt dictionary.
    Certify,
    /// Holding out shapes, to calibrate the detection of new ones.
    HoldOut,
    /// Validation and training of the classifier.
    Validate,
}

impl Phase {
    /// Name of the phase in lower case, such as `hold_out`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Mean => "mean",
            Self::Align => "align",
            Self::Learn => "learn",
            Self::Certify => "certify",
            Self::HoldOut => "hold_out",
            Self::Validate => "validate",
        }
    }
}

/// Progress reports and cancellation for long computations.
pub trait Watch: Sync {
    /// Whether to stop; called every few shapes.
    fn stop(&self) -> bool {
        false
    }

    /// Counts shapes that a pass has worked through, or permutations of a test; cheap enough for inner loops.
    fn worked(&self, _count: usize) {}

    /// Receives the completed fraction of a computation whose length is known, 0 to 1.
    fn progress(&self, _fraction: f64) {}

    /// Called after every pass with the number of passes so far and the objective.
    fn epoch(&self, _epochs: usize, _objective: f64) {}

    /// Called when a phase begins, with 0, and with the completed fraction of the last two phases.
    fn phase(&self, _phase: Phase, _fraction: f64) {}

    /// Called with the reason if a dictionary could be learnt, but not without a part of its shapes: it then has no
    /// statistics of held-out shapes.
    fn not_held_out(&self, _error: AnalysisError) {}

    /// Fails if the computation must stop.
    ///
    /// # Errors
    /// [`AnalysisError::Interrupted`].
    fn check(&self) -> Result<(), AnalysisError> {
        if self.stop() { Err(AnalysisError::Interrupted) } else { Ok(()) }
    }
}

/// A watch that ignores progress and never stops.
#[derive(Debug, Clone, Copy)]
pub struct Unwatched;

impl Watch for Unwatched {}

/// A watch that stops when the function returns true, and ignores progress.
#[derive(Clone, Copy)]
pub struct StopWhen<'a>(pub &'a (dyn Fn() -> bool + Sync));

impl Watch for StopWhen<'_> {
    fn stop(&self) -> bool {
        (self.0)()
    }
}

/// A watch that turns counted work into the completed fraction of a known total.
pub(crate) struct Counted<'a> {
    watch: &'a dyn Watch,
    total: usize,
    done: AtomicUsize,
}

impl<'a> Counted<'a> {
    pub(crate) fn new(watch: &'a dyn Watch, total: usize) -> Self {
        Self { watch, total, done: AtomicUsize::new(0) }
    }
}

impl Watch for Counted<'_> {
    fn stop(&self) -> bool {
        self.watch.stop()
    }

    fn worked(&self, count: usize) {
        let done = count + self.done.fetch_add(count, Ordering::Relaxed);
        self.watch.progress(done.min(self.total) as f64 / self.total.max(1) as f64);
    }
}

/// A watch that stops with another one and counts work for it, but reports no phases: for parts of a phase.
#[derive(Clone, Copy)]
pub(crate) struct Quiet<'a>(pub(crate) &'a dyn Watch);

impl Watch for Quiet<'_> {
    fn stop(&self) -> bool {
        self.0.stop()
    }

    fn worked(&self, count: usize) {
        self.0.worked(count);
    }
}
