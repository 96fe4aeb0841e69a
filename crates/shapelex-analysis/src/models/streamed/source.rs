//! Shapes of a stream on their way into sums: weighed in the first pass, aligned to the mean in the last.

use std::sync::{Mutex, PoisonError};

use crate::AnalysisError;
use crate::accumulate::{Reservation, ShapeSource, Shapes, VisitMarked, for_each_changed};
use crate::inference::aligned::StudySpace;
use crate::placement::Placement;
use crate::tangent::to_tangent;
use shapelex_numeric::parallel;

/// Shapes of a task. Results do not depend on it.
const TASK: usize = 16;

/// A source that keeps the weights of its shapes as they are read first.
pub(super) struct Weighed<'a> {
    source: &'a dyn ShapeSource,
    weights: Mutex<Vec<f64>>,
}

impl<'a> Weighed<'a> {
    pub(super) fn new(source: &'a dyn ShapeSource) -> Self {
        Self { source, weights: Mutex::new(Vec::with_capacity(source.count())) }
    }

    /// The weights of all shapes; a pass over the shapes unless they were read.
    ///
    /// # Errors
    /// Errors of the source.
    pub(super) fn into_weights(self) -> Result<Vec<f64>, AnalysisError> {
        let is_read = self.weights.lock().unwrap_or_else(PoisonError::into_inner).len() == self.count();
        if !is_read {
            self.for_each_batch(&mut |_| Ok(()))?;
        }
        Ok(self.weights.into_inner().unwrap_or_else(PoisonError::into_inner))
    }

    fn keep(&self, batch: Shapes<'_>) {
        let mut weights = self.weights.lock().unwrap_or_else(PoisonError::into_inner);
        let known = weights.len().saturating_sub(batch.first).min(batch.weights.len());
        // Later passes, and those over the first shapes, bring nothing new.
        if batch.first <= weights.len() {
            weights.extend_from_slice(&batch.weights[known..]);
        }
    }
}

impl ShapeSource for Weighed<'_> {
    fn count(&self) -> usize {
        self.source.count()
    }

    fn check(&self) -> Result<(), AnalysisError> {
        self.source.check()
    }

    fn worked(&self, shapes: usize) {
        self.source.worked(shapes);
    }

    fn reserve(&self, bytes: usize) -> Option<Reservation<'_>> {
        self.source.reserve(bytes)
    }

    fn known_placements(&self) -> Result<Option<Vec<Placement>>, AnalysisError> {
        self.source.known_placements()
    }

    fn located(&self, error: AnalysisError) -> AnalysisError {
        self.source.located(error)
    }

    fn for_each_batch(
        &self,
        visit: &mut dyn FnMut(Shapes<'_>) -> Result<(), AnalysisError>,
    ) -> Result<(), AnalysisError> {
        self.source.for_each_batch(&mut |batch| {
            self.keep(batch);
            visit(batch)
        })
    }

    fn for_each_marked(&self, visit: &mut VisitMarked<'_>) -> Result<(), AnalysisError> {
        self.source.for_each_marked(&mut |batch, marks| {
            self.keep(batch);
            visit(batch, marks)
        })
    }
}

/// A source whose shapes, in their placements, are aligned to a mean.
pub(super) struct Brought<'a> {
    pub(super) source: &'a dyn ShapeSource,
    pub(super) space: StudySpace<'a>,
    /// Whitened.
    pub(super) mean: &'a [f64],
}

impl ShapeSource for Brought<'_> {
    fn count(&self) -> usize {
        self.source.count()
    }

    fn check(&self) -> Result<(), AnalysisError> {
        self.source.check()
    }

    fn worked(&self, shapes: usize) {
        self.source.worked(shapes);
    }

    fn for_each_batch(
        &self,
        visit: &mut dyn FnMut(Shapes<'_>) -> Result<(), AnalysisError>,
    ) -> Result<(), AnalysisError> {
        let StudySpace { metric, method, tangent, .. } = self.space;
        let bring = |x: &mut [f64]| {
            method.bring_in_place(x, self.mean)?;
            if tangent { to_tangent(self.mean, x) } else { Ok(()) }
        };
        let change = |batch: Shapes<'_>, whitened: &mut [f64]| {
            parallel::try_for_each_chunk(whitened, TASK * metric.len(), &|task, shapes| {
                let mut shapes = (batch.first + task * TASK..).zip(shapes.chunks_exact_mut(metric.len()));
                shapes.try_for_each(|(k, x)| bring(x).map_err(|error| error.at(k)))
            })
        };
        for_each_changed(self.source, change, visit)
    }
}
