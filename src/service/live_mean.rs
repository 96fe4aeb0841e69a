//! The mean of a stored cohort: shapes stream from the store in bounded batches, at one revision.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex};

use tokio::runtime::Handle;

use super::compute::{MAX_DRAWN, Settings, Setup};
use super::error::Fault;
use super::{App, ServiceError};
use crate::analysis::AnalysisError;
use crate::analysis::accumulate::{BLOCK, ShapeSource, Shapes, prepare};
use crate::analysis::alignment::{AlignedShape, Alignment, MeanShape, align, mean_shape};
use crate::analysis::frame::Frame;
use crate::analysis::metric::Metric;
use crate::analysis::transformation::{ClassName, Transformation};
use crate::domain::cohort::Cohort;
use crate::domain::shape::ShapeFilter;
use crate::store::{Ids, Store};

/// Shapes of one batch: enough for all threads, little enough for memory.
const BATCH_SHAPES: usize = 16 * BLOCK;

/// What mean of a cohort is asked for.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct MeanQuery {
    /// The class.
    pub transformation: ClassName,
    /// Projection or Procrustes.
    pub alignment: Alignment,
    /// Which member of the mean space.
    pub frame: Frame,
    /// Which shapes.
    pub filter: ShapeFilter,
}

/// The mean of a cohort at a revision.
#[derive(Debug)]
pub struct LiveMean {
    /// The cohort as it was.
    pub cohort: Cohort,
    /// What it was computed with.
    pub setup: Setup,
    /// The mean; its placements are dropped.
    pub mean: MeanShape,
    /// Some aligned shapes, for the drawing.
    pub drawn: Vec<AlignedShape>,
}

/// Means that were asked for lately.
#[derive(Debug, Default)]
pub struct MeanCache {
    entries: Mutex<VecDeque<(CacheKey, Arc<LiveMean>)>>,
}

type CacheKey = (String, u64, MeanQuery);

/// Means kept: a dashboard asks for a handful again and again.
const KEPT: usize = 64;

impl MeanCache {
    fn find(&self, key: &CacheKey) -> Option<Arc<LiveMean>> {
        let entries = self.entries.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        entries.iter().find(|(known, _)| known == key).map(|(_, mean)| mean.clone())
    }

    fn keep(&self, key: CacheKey, mean: Arc<LiveMean>) {
        let mut entries = self.entries.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        entries.retain(|(known, _)| known.0 != key.0 || known.1 == key.1);
        if entries.len() >= KEPT {
            entries.pop_front();
        }
        entries.push_back((key, mean));
    }
}

/// The mean of the shapes of a cohort that match the filter, at its present revision.
///
/// # Errors
/// [`ServiceError::NotFound`]; too few or degenerate shapes.
pub async fn mean(app: &App, cohort: Cohort, query: MeanQuery) -> Result<Arc<LiveMean>, ServiceError> {
    let key = (cohort.id.clone(), cohort.revision, query.clone());
    if let Some(known) = app.means.find(&key) {
        return Ok(known);
    }
    let settings = Settings {
        representation: cohort.representation.clone(),
        correspondence: cohort.correspondence,
        direction: cohort.direction,
        mirror: cohort.mirror,
        transformation: Transformation::Named(query.transformation),
        alignment: query.alignment,
        frame: query.frame,
    };
    let count = app.store.count(&cohort.id, cohort.revision, &query.filter).await?;
    let (task_app, handle, filter) = (app.clone(), Handle::current(), query.filter);
    let computed =
        app.pool.run(move || compute(&task_app, &handle, cohort, &settings, filter, count)).await?;
    let mean = Arc::new(computed);
    app.means.keep(key, mean.clone());
    Ok(mean)
}

fn compute(
    app: &App,
    handle: &Handle,
    cohort: Cohort,
    settings: &Settings,
    filter: ShapeFilter,
    count: u64,
) -> Result<LiveMean, ServiceError> {
    let setup = Setup::new(app, settings)?;
    let count = usize::try_from(count)
        .map_err(|_| ServiceError::Internal("too many shapes for this machine".into()))?;
    let source = StoredShapes {
        store: &app.store,
        handle,
        cohort: &cohort,
        filter: &filter,
        metric: &setup.metric,
        centred: setup.method.translates(),
        count,
    };
    let Setup { metric, method, frame, matching, .. } = &setup;
    let mut mean = mean_shape(&source, metric, method, *frame, matching)?;
    let mut drawn = Vec::new();
    let first = source.first(MAX_DRAWN)?;
    for (k, shape) in first.chunks_exact(metric.len()).enumerate() {
        let (mut x, centroid) = (shape.to_vec(), metric.centroid(shape));
        prepare(metric, method.translates(), k, &mut x)?;
        drawn.push(align(method, matching, &mean.whitened, &x, &centroid, mean.placements[k])?);
    }
    mean.placements = Vec::new();
    Ok(LiveMean { setup, mean, drawn, cohort })
}

/// Takes control points and weights of a stored chunk; false ends the scan.
type VisitChunk<'a> = dyn FnMut(&[f64], &[f64]) -> Result<bool, ServiceError> + 'a;

/// The shapes of a cohort at a revision, read again in every pass.
struct StoredShapes<'a> {
    store: &'a Store,
    handle: &'a Handle,
    cohort: &'a Cohort,
    filter: &'a ShapeFilter,
    metric: &'a Metric,
    centred: bool,
    count: usize,
}

impl StoredShapes<'_> {
    /// Control points of the first `most` shapes.
    fn first(&self, most: usize) -> Result<Vec<f64>, ServiceError> {
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
    fn scan(&self, visit: &mut VisitChunk<'_>) -> Result<(), ServiceError> {
        let mut position = None;
        loop {
            let read =
                self.store.scan(&self.cohort.id, self.cohort.revision, self.filter, position, Ids::Skip);
            let Some(batch) = self.handle.block_on(read)? else { return Ok(()) };
            position = Some(batch.position);
            if !visit(&batch.control_points, &batch.weights)? {
                return Ok(());
            }
        }
    }

    /// Errors name the shape: its id is what the client knows.
    fn named(&self, error: AnalysisError) -> ServiceError {
        let (AnalysisError::Degenerate { index, .. } | AnalysisError::NoExtent { index, .. }) = error else {
            return error.into();
        };
        let id = self.id_at(index).ok().flatten().unwrap_or_default();
        let detail = format!("{error} (shape '{id}' of the cohort '{}')", self.cohort.name);
        ServiceError::DegenerateShape(vec![Fault { index: Some(index), ..Fault::new("", detail) }])
    }

    fn id_at(&self, index: usize) -> Result<Option<String>, ServiceError> {
        let (mut position, mut left) = (None, index);
        loop {
            let read =
                self.store.scan(&self.cohort.id, self.cohort.revision, self.filter, position, Ids::Include);
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
                    .map_err(|e| self.named(e))?;
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
