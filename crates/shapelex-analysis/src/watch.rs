//! Progress and cancellation of long computations.

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

    /// Receives the completed fraction of a computation whose length is known, 0 to 1.
    fn progress(&self, _fraction: f64) {}

    /// Called after every pass with the number of passes so far and the objective.
    fn epoch(&self, _epochs: usize, _objective: f64) {}

    /// Called when a phase begins, with 0, and with the completed fraction of the last two phases.
    fn phase(&self, _phase: Phase, _fraction: f64) {}

    /// Called with the reason if a dictionary could be learnt, but not without a part of its shapes: it then has no
    /// statistics of held-out shapes.
    fn not_held_out(&self, _error: &AnalysisError) {}

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

/// A watch that stops with another one, but reports nothing: for parts that are no progress of their own.
#[derive(Clone, Copy)]
pub(crate) struct Quiet<'a>(pub(crate) &'a dyn Watch);

impl Watch for Quiet<'_> {
    fn stop(&self) -> bool {
        self.0.stop()
    }
}
