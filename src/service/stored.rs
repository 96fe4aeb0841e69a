//! The shapes of a stored cohort as a source of statistics: they stream in bounded batches, at one revision.

use tokio::runtime::Handle;

use super::compute::Setup;
use super::error::Fault;
use super::{App, ServiceError};
use crate::analysis::accumulate::{BLOCK, ShapeSource, Shapes, prepare};
use crate::analysis::metric::Metric;
use crate::domain::cohort::Cohort;
use crate::domain::shape::ShapeFilter;
use crate::store::{Ids, Revisions, Store};

/// Shapes of one batch: enough for all threads, little enough for memory.
const BATCH_SHAPES: usize = 16 * BLOCK;

/// Takes control points and weights of a stored chunk; false ends the scan.
type VisitChunk<'a> = dyn FnMut(&[f64], &[f64]) -> Result<bool, ServiceError> + 'a;

/// The shapes of a cohort at its revision, read again in every pass.
pub(super) struct StoredShapes<'a> {
    store: &'a Store,
    /// Of the runtime that reads: passes are made on compute threads.
    handle: &'a Handle,
    cohort: &'a Cohort,
    filter: &'a ShapeFilter,
    revisions: Revisions,
    metric: &'a Metric,
    centred: bool,
    /// Number of the shapes.
    count: usize,
    /// Whether to stop: asked before every batch.
    stop: &'a (dyn Fn() -> bool + Sync),
}

impl<'a> StoredShapes<'a> {
    /// The shapes of `cohort` that came after the revision `since`, up to its own.
    pub(super) fn new(
        app: &'a App,
        handle: &'a Handle,
        cohort: &'a Cohort,
        filter: &'a ShapeFilter,
        since: u64,
        setup: &'a Setup,
        stop: &'a (dyn Fn() -> bool + Sync),
    ) -> Result<Self, ServiceError> {
        let revisions = Revisions { after: since, until: cohort.revision };
        let count = handle.block_on(app.store.count(&cohort.id, revisions, filter))?;
        let count = usize::try_from(count)
            .map_err(|_| ServiceError::Internal("too many shapes for this machine".into()))?;
        let (metric, centred) = (&setup.metric, setup.method.translates());
        Ok(Self { store: &app.store, handle, cohort, filter, revisions, metric, centred, count, stop })
    }

    /// Control points of the first `most` shapes.
    pub(super) fn first(&self, most: usize) -> Result<Vec<f64>, ServiceError> {
        let mut control_points = Vec::new();
        let wanted = most.min(self.count) * self.metric.len();
        self.scan(&mut |batch, _| {
            control_points.extend_from_slice(batch);
            Ok(control_points.len() < wanted)
        })?;
        control_points.truncate(wanted);
        Ok(control_points)
    }

    /// Calls `visit` with control points and weights of every stored chunk until it says false.
    pub(super) fn scan(&self, visit: &mut VisitChunk<'_>) -> Result<(), ServiceError> {
        let mut position = None;
        loop {
            if (self.stop)() {
                return Err(ServiceError::Cancelled);
            }
            let read = self.store.scan(&self.cohort.id, self.revisions, self.filter, position, Ids::Skip);
            let Some(batch) = self.handle.block_on(read)? else { return Ok(()) };
            position = Some(batch.position);
            if !visit(&batch.control_points, &batch.weights)? {
                return Ok(());
            }
        }
    }

    /// Errors of statistics name the shape: its id is what the client knows.
    pub(super) fn named(&self, error: impl Into<ServiceError>) -> ServiceError {
        match error.into() {
            ServiceError::DegenerateShape(faults) => ServiceError::DegenerateShape(
                faults.into_iter().map(|fault| self.named_fault(fault)).collect(),
            ),
            error => error,
        }
    }

    fn named_fault(&self, fault: Fault) -> Fault {
        // What has no pointer is named already.
        let Some(index) = fault.index.filter(|_| !fault.pointer.is_empty()) else { return fault };
        let id = self.id_at(index).ok().flatten().unwrap_or_default();
        let detail = format!("{} (shape '{id}' of the cohort '{}')", fault.detail, self.cohort.name);
        Fault { index: Some(index), ..Fault::new("", detail) }
    }

    fn id_at(&self, index: usize) -> Result<Option<String>, ServiceError> {
        let (mut position, mut left) = (None, index);
        loop {
            let read = self.store.scan(&self.cohort.id, self.revisions, self.filter, position, Ids::Include);
            let Some(mut batch) = self.handle.block_on(read)? else { return Ok(None) };
            if left < batch.ids.len() {
                return Ok(Some(batch.ids.swap_remove(left)));
            }
            left -= batch.ids.len();
            position = Some(batch.position);
        }
    }
}

impl ShapeSource for StoredShapes<'_> {
    type Error = ServiceError;

    fn count(&self) -> usize {
        self.count
    }

    fn for_each_batch(
        &self,
        visit: &mut dyn FnMut(Shapes<'_>) -> Result<(), ServiceError>,
    ) -> Result<(), ServiceError> {
        let length = self.metric.len();
        let (mut rows, mut weights): (Vec<f64>, Vec<f64>) = (Vec::new(), Vec::new());
        let mut first = 0;
        // Stored chunks have any length; batches are whole blocks, so that the result does not depend on how
        // the cohort was uploaded.
        let mut emit =
            |rows: &mut Vec<f64>, weights: &mut Vec<f64>, count: usize| -> Result<(), ServiceError> {
                prepare(self.metric, self.centred, first, &mut rows[..count * length])
                    .map_err(|error| self.named(error))?;
                visit(Shapes { first, whitened: &rows[..count * length], weights: &weights[..count] })?;
                rows.drain(..count * length);
                weights.drain(..count);
                first += count;
                Ok(())
            };
        self.scan(&mut |control_points, chunk_weights| {
            rows.extend_from_slice(control_points);
            weights.extend_from_slice(chunk_weights);
            let whole = weights.len() / BLOCK * BLOCK;
            if whole >= BATCH_SHAPES {
                emit(&mut rows, &mut weights, whole)?;
            }
            Ok(true)
        })?;
        let rest = weights.len();
        if rest > 0 { emit(&mut rows, &mut weights, rest) } else { Ok(()) }
    }
}
