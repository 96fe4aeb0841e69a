//! Shapes of a stored cohort as a source for statistics: they are streamed in bounded batches, at one revision.

use crate::wire::fault::Fault;
use std::cell::RefCell;
use std::collections::HashSet;
use std::sync::Arc;

use tokio::runtime::Handle;
use tokio_util::task::AbortOnDropHandle;

use crate::analysis::AnalysisError;
use crate::analysis::accumulate::{
    BLOCK, Mark, MergePart, Reservation, ShapeSource, Shapes, ShapesInMemory, VisitMarked, prepare,
};
use crate::analysis::dictionary::content::Content;
use crate::analysis::matching::Placement;
use crate::analysis::pass::{CodeGroup, Pass};
use crate::analysis::robust::LessCounted;
use crate::analysis::watch::Watch;
use crate::domain::cohort::Cohort;
use crate::domain::dictionary::LessCountedShape;
use crate::domain::filter::ShapeFilter;
use crate::domain::shape::Shape;
use crate::service::app::cache::{Cache, Cached, Reserved};
use crate::service::app::{App, ServiceError};
use crate::service::cohorts::placements::{KnownPlacements, Which};
use crate::service::shapes::outcome::Outcomes;
use crate::service::statistics::Setup;
use crate::store::{Cursor, Ids, Places, Revisions, ScanBatch, Store, StoreError};

/// Number of shapes per batch: enough for all threads, small enough for memory.
const BATCH_SHAPES: usize = 16 * BLOCK;

/// Receives control points and weights of a stored chunk; returns `false` to end the scan.
type VisitChunk<'a> = dyn FnMut(&[f64], &[f64]) -> Result<bool, ServiceError> + 'a;

/// Receives the ids and prepared shapes of a stored batch.
type VisitStored<'a> = dyn FnMut(&ScanBatch) -> Result<(), AnalysisError> + 'a;

/// Computation over shapes.
#[derive(Debug)]
pub(crate) enum Work {
    /// Sum them.
    Sum(Pass),
    /// Encode them in a dictionary.
    Codes(Box<Content>),
}

/// Computes passes outside of this process.
pub(crate) trait Distribute: Sync {
    /// Computes a pass over `shapes`; `work` describes the computation, and `merge` receives the results in the order of the parts.
    /// Returns `false`, doing nothing, if this process is to compute the pass.
    ///
    /// # Errors
    /// The error of the first part that fails; [`ServiceError::Cancelled`].
    fn run(
        &self,
        shapes: &StoredShapes<'_>,
        work: &dyn Fn() -> Work,
        merge: &mut MergePart<'_>,
    ) -> Result<bool, ServiceError>;

    /// Codes groups of `shapes` while a dictionary is learnt; `None` if this process is to code them.
    fn coders<'a>(&'a self, shapes: &'a StoredShapes<'_>) -> Option<CodeGroup<'a>>;
}

/// Shapes of a cohort with these ids or external ids, in the given order.
///
/// # Errors
/// All unknown ids, at `/ids/{index}`.
pub(crate) async fn find_all(
    app: &App,
    cohort: &Cohort,
    keys: &[String],
) -> Result<Vec<Shape>, ServiceError> {
    find_each(app, cohort, keys).await?.all()
}

/// Shapes with these ids or external ids; a missing one has a fault at `/ids/{index}`.
///
/// # Errors
/// Errors of the store.
pub(crate) async fn find_each(
    app: &App,
    cohort: &Cohort,
    keys: &[String],
) -> Result<Outcomes<Shape>, ServiceError> {
    let found = app.store.find_shapes(&cohort.id, keys).await?;
    let missing = |key: &String| {
        vec![Fault::new("", format!("shape '{key}' not found in the cohort '{}'", cohort.spec.name))]
    };
    let found = found.into_iter().zip(keys).map(|(shape, key)| shape.ok_or_else(|| missing(key)));
    Ok(Outcomes::of_list("ids", found.collect()))
}

/// Refuses duplicate ids.
///
/// # Errors
/// All repetitions, at `/ids/{index}`.
pub(crate) fn refuse_repeated(keys: &[String]) -> Result<(), ServiceError> {
    let mut seen = HashSet::new();
    let repeated = keys.iter().enumerate().filter(|(_, key)| !seen.insert(key.as_str()));
    let fault = |(index, key): (usize, &String)| {
        let detail = format!("'{key}' is given twice");
        Fault::new(format!("/ids/{index}"), detail).at_shape(index)
    };
    ServiceError::unless_empty(repeated.map(fault).collect())
}

/// Marks of a batch of shapes, of their control points as stored and their weights.
type MarksOf<'a> = &'a dyn Fn(&[f64], &[f64]) -> Vec<Mark>;

/// Places of the shapes of a cohort that pass a filter, found once for all passes over them.
struct FilteredPlaces(Places);

impl Cached for FilteredPlaces {
    const NAME: &'static str = "places";

    fn bytes(&self) -> usize {
        self.0.bytes()
    }
}

/// Shapes of a cohort at its revision, read again in every pass.
#[derive(Clone)]
pub(crate) struct StoredShapes<'a> {
    store: &'a Store,
    /// Reserves memory for shapes that are kept.
    cache: &'a Cache,
    /// Runtime for reading: passes run on compute threads.
    handle: &'a Handle,
    cohort: &'a Cohort,
    filter: &'a ShapeFilter,
    revisions: Revisions,
    setup: &'a Setup,
    /// Places of the shapes that pass a filter; `None` for all shapes, and where there is no room for them.
    places: Option<Arc<FilteredPlaces>>,
    /// Number of shapes that pass the filter.
    count: usize,
    /// Whether to stop; queried before every batch.
    stop: &'a (dyn Fn() -> bool + Sync),
    /// Where passes may be computed besides this process.
    distribute: Option<&'a dyn Distribute>,
    /// Placements with which a search begins.
    known: Option<(&'a KnownPlacements, Which)>,
    /// Counts the shapes that passes have worked through.
    counter: Option<&'a dyn Watch>,
}

impl<'a> StoredShapes<'a> {
    /// Shapes of `cohort` added after the revision `since`, up to its own revision.
    pub(crate) fn new(
        app: &'a App,
        handle: &'a Handle,
        cohort: &'a Cohort,
        filter: &'a ShapeFilter,
        since: u64,
        setup: &'a Setup,
        stop: &'a (dyn Fn() -> bool + Sync),
    ) -> Result<Self, ServiceError> {
        let revisions = Revisions { after: since, until: cohort.revision };
        let places = places_of(app, handle, cohort, filter, revisions)?;
        let count = match &places {
            Some(places) => places.0.count(),
            None => usize::try_from(handle.block_on(app.store.count(&cohort.id, revisions, filter))?)
                .map_err(|_| ServiceError::Internal("too many shapes for this machine".into()))?,
        };
        let (store, cache) = (&app.store, &*app.cache);
        Ok(Self {
            store,
            cache,
            handle,
            cohort,
            filter,
            revisions,
            setup,
            places,
            count,
            stop,
            distribute: None,
            known: None,
            counter: None,
        })
    }

    /// The same shapes, whose passes `counter` counts.
    pub(crate) fn counted_by(self, counter: &'a dyn Watch) -> Self {
        Self { counter: Some(counter), ..self }
    }

    /// The same shapes; their passes do not count as progress of the job.
    pub(crate) fn uncounted(self) -> Self {
        Self { counter: None, ..self }
    }

    /// The same shapes, whose search begins with `known` placements.
    pub(crate) fn starting_from(self, known: Option<(&'a KnownPlacements, Which)>) -> Self {
        Self { known, ..self }
    }

    /// The same shapes in memory, read once, if there is room for them, and for a search of them if one is meant; else `None`. Their
    /// numbers as stored are added to `digest`.
    pub(crate) fn kept(
        &self,
        searches: bool,
        digest: Option<&mut ShapesDigest>,
    ) -> Result<Option<KeptShapes<'a>>, ServiceError> {
        /// Memory of a search of start points, in that of the shapes: spectra in all directions and mirror images, and placed ones.
        const SEARCH: usize = 5;
        let bytes = self.count.saturating_mul(8 * (self.width() + 1) + size_of::<Mark>());
        if searches && self.cache.reserve(bytes.saturating_mul(1 + SEARCH)).is_none() {
            return Ok(None);
        }
        let Some(memory) = self.cache.reserve(bytes) else { return Ok(None) };
        let digest = RefCell::new(digest);
        let marks_of = |numbers: &[f64], weights: &[f64]| {
            if let Some(digest) = digest.borrow_mut().as_mut() {
                digest.add(numbers, weights);
            }
            Mark::of_all(numbers, weights)
        };
        let unread = self.clone().uncounted();
        let shapes =
            ShapesInMemory::read_marked(self.count, &mut |visit| unread.for_each_prepared(&marks_of, visit))?;
        Ok(Some(KeptShapes { shapes, stored: self.clone(), _memory: memory }))
    }

    /// Places of the shapes in storage.
    pub(crate) fn places(&self) -> Result<Places, ServiceError> {
        if let Some(places) = &self.places {
            return Ok(places.0.clone());
        }
        let read = self.store.places(&self.cohort.id, self.revisions, self.filter);
        Ok(self.handle.block_on(read)?)
    }

    /// The same shapes, whose passes may be computed elsewhere.
    pub(crate) fn distributed_by(self, distribute: &'a dyn Distribute) -> Self {
        Self { distribute: Some(distribute), ..self }
    }

    /// Runs a pass elsewhere, if that pays: see [`Distribute::run`].
    pub(crate) fn spread_work(
        &self,
        work: &dyn Fn() -> Work,
        merge: &mut MergePart<'_>,
    ) -> Result<bool, ServiceError> {
        let Some(others) = self.distribute else { return Ok(false) };
        others.run(self, work, merge)
    }

    /// Fails if the work must stop.
    pub(crate) fn check(&self) -> Result<(), ServiceError> {
        if (self.stop)() { Err(ServiceError::Cancelled) } else { Ok(()) }
    }

    /// Range of revisions in which the shapes were added.
    pub(crate) fn revisions(&self) -> Revisions {
        self.revisions
    }

    /// Number of coordinates of a shape.
    pub(crate) fn width(&self) -> usize {
        self.setup.metric.len()
    }

    /// Control points of the first `most` shapes.
    pub(crate) fn first(&self, most: usize) -> Result<Vec<f64>, ServiceError> {
        let mut control_points = Vec::new();
        let wanted = most.min(self.count) * self.width();
        self.scan(&mut |batch, _| {
            control_points.extend_from_slice(batch);
            Ok(control_points.len() < wanted)
        })?;
        control_points.truncate(wanted);
        Ok(control_points)
    }

    /// Calls `visit` with control points and weights of every stored chunk until it returns `false`.
    pub(crate) fn scan(&self, visit: &mut VisitChunk<'_>) -> Result<(), ServiceError> {
        let (mut left, width) = (self.count, self.width());
        let mut batches = Batches::new(self, Ids::Skip);
        while left > 0 {
            let Some(batch) = batches.next(left)? else { return Ok(()) };
            let count = batch.weights.len().min(left);
            left -= count;
            if count > 0 && !visit(&batch.control_points[..count * width], &batch.weights[..count])? {
                return Ok(());
            }
        }
        Ok(())
    }

    /// Number of shapes.
    pub(crate) fn len(&self) -> usize {
        self.count
    }

    /// Whether there are no shapes.
    pub(crate) fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Calls `visit` with consecutive batches of prepared shapes and the marks that `marks_of` gives them as they are stored.
    fn for_each_prepared(
        &self,
        marks_of: MarksOf<'_>,
        visit: &mut VisitMarked<'_>,
    ) -> Result<(), AnalysisError> {
        let (metric, centred) = (&self.setup.metric, self.setup.method.translates());
        let length = metric.len();
        let (mut rows, mut weights): (Vec<f64>, Vec<f64>) = (Vec::new(), Vec::new());
        let mut first = 0;
        // Stored chunks have any length; batches are whole blocks, so that the result does not depend on how the cohort
        // was uploaded.
        let mut emit =
            |rows: &mut Vec<f64>, weights: &mut Vec<f64>, count: usize| -> Result<(), ServiceError> {
                let marks = marks_of(&rows[..count * length], &weights[..count]);
                prepare(metric, centred, first, &mut rows[..count * length])
                    .map_err(|error| self.named(error))?;
                let batch = Shapes { first, whitened: &rows[..count * length], weights: &weights[..count] };
                visit(batch, &marks)?;
                self.worked(count);
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
        if rest > 0 {
            emit(&mut rows, &mut weights, rest)?;
        }
        if first != self.count {
            // Only an erasure changes a revision.
            self.cache.forget(&self.cohort.id);
            return Err(ServiceError::Unavailable(
                "shapes were erased while they were read: try again".into(),
            )
            .into());
        }
        Ok(())
    }

    /// Calls `visit` with every stored batch, its shapes prepared; errors name the affected shapes.
    pub(crate) fn for_each_stored(&self, ids: Ids, visit: &mut VisitStored<'_>) -> Result<(), ServiceError> {
        let (mut batches, mut first) = (Batches::new(self, ids), 0);
        loop {
            let Some(mut batch) = batches.next(usize::MAX)? else { return Ok(()) };
            let centred = self.setup.method.translates();
            let prepared = prepare(&self.setup.metric, centred, 0, &mut batch.control_points);
            let visited = prepared.and_then(|()| visit(&batch));
            visited.map_err(|error| self.named(error.after(first)))?;
            first += batch.weights.len();
        }
    }

    /// The shapes that count less in a robust estimate, with their ids; without those that were erased meanwhile. The first ones keep
    /// weights of control points, at most `numbers` of them.
    pub(crate) fn less_counted(
        &self,
        shapes: Vec<LessCounted>,
        numbers: usize,
    ) -> Result<Vec<LessCountedShape>, ServiceError> {
        if shapes.is_empty() {
            return Ok(Vec::new());
        }
        let with_points = numbers / self.setup.metric.size().max(1);
        let places = self.places()?;
        let at: Vec<Cursor> = shapes.iter().filter_map(|shape| places.get(shape.position)).collect();
        let names = self.handle.block_on(self.store.shapes_at(&self.cohort.id, &at))?;
        let named = shapes.into_iter().zip(names).enumerate().filter_map(|(i, (shape, name))| {
            let LessCounted { factor, point_weights, .. } = shape;
            let rounded = || point_weights.iter().map(|weight| (weight * 1e4).round() / 1e4).collect();
            Some(LessCountedShape {
                id: name?.id,
                weight: factor,
                point_weights: (i < with_points).then(rounded),
            })
        });
        Ok(named.collect())
    }

    /// Calls `visit` with every stored batch as it is, with the ids of its shapes.
    pub(crate) fn for_each_named(
        &self,
        visit: &mut dyn FnMut(&ScanBatch) -> Result<(), ServiceError>,
    ) -> Result<(), ServiceError> {
        let mut batches = Batches::new(self, Ids::Include);
        while let Some(batch) = batches.next(usize::MAX)? {
            visit(&batch)?;
        }
        Ok(())
    }

    /// Starts to read the batch that follows `after`.
    fn read(&self, after: After, ids: Ids) -> Reading {
        let (store, cohort, filter) = (self.store.clone(), self.cohort.id.clone(), self.filter.clone());
        let (revisions, places) = (self.revisions, self.places.clone().filter(|_| ids == Ids::Skip));
        Reading::new(self.handle.spawn(async move {
            if let Some(FilteredPlaces(places)) = places.as_deref() {
                let read = store.scan_places(&cohort, revisions.until, places, after.count).await?;
                return Ok(read.map(|(batch, count)| (batch, After { cursor: None, count })));
            }
            let batch = store.scan(&cohort, revisions, &filter, after.cursor, ids).await?;
            Ok(batch.map(|batch| {
                let after = After { cursor: Some(batch.position), count: 0 };
                (batch, after)
            }))
        }))
    }

    /// Names the shape with this id in a fault, without pointer because the shape is not part of a request.
    fn with_name(&self, fault: Fault, id: &str) -> Fault {
        let detail = format!("{} (shape '{id}' of the cohort '{}')", fault.detail, self.cohort.spec.name);
        Fault { index: fault.index, ..Fault::new("", detail) }
    }

    /// Replaces positions in errors of statistics by shape ids, which clients know.
    pub(crate) fn named(&self, error: impl Into<ServiceError>) -> ServiceError {
        match error.into() {
            ServiceError::DegenerateShape(faults) => ServiceError::DegenerateShape(
                faults.into_iter().map(|fault| self.named_fault(fault)).collect(),
            ),
            error => error,
        }
    }

    fn named_fault(&self, fault: Fault) -> Fault {
        // Faults without pointer already name their shape.
        let Some(index) = fault.index.filter(|_| !fault.pointer.is_empty()) else { return fault };
        let id = self.id_at(index).ok().flatten().unwrap_or_default();
        self.with_name(fault, &id)
    }

    fn id_at(&self, index: usize) -> Result<Option<String>, ServiceError> {
        let (mut batches, mut left) = (Batches::new(self, Ids::Include), index);
        loop {
            let Some(mut batch) = batches.next(left + 1)? else { return Ok(None) };
            if left < batch.ids.len() {
                return Ok(Some(batch.ids.swap_remove(left)));
            }
            left -= batch.ids.len();
        }
    }
}

/// Batches of a cohort in storage order. The next one is read while one is processed.
struct Batches<'a> {
    shapes: &'a StoredShapes<'a>,
    ids: Ids,
    next: Reading,
}

/// Where a batch begins: behind a place, or at the position of a shape among places.
#[derive(Clone, Copy, Default)]
struct After {
    cursor: Option<Cursor>,
    count: usize,
}

/// A batch that a task of the runtime reads, and where the next one begins. Dropping it cancels the read.
type Reading = AbortOnDropHandle<Result<Option<(ScanBatch, After)>, StoreError>>;

/// Places of the shapes that pass a filter, found once while the revision is used; `None` for all shapes, and without room for them.
fn places_of(
    app: &App,
    handle: &Handle,
    cohort: &Cohort,
    filter: &ShapeFilter,
    revisions: Revisions,
) -> Result<Option<Arc<FilteredPlaces>>, ServiceError> {
    if filter.is_everything() {
        return Ok(None);
    }
    let settings = (filter, revisions.after, revisions.until);
    if let Some(places) = app.cache.find::<FilteredPlaces>(&cohort.id, &settings) {
        return Ok(Some(places));
    }
    let shapes = usize::try_from(cohort.shapes).unwrap_or(usize::MAX);
    let Some(_room) = app.cache.reserve(shapes.saturating_mul(Places::MOST_BYTES)) else { return Ok(None) };
    let places = handle.block_on(app.store.places(&cohort.id, revisions, filter))?;
    let places = Arc::new(FilteredPlaces(places));
    app.cache.keep(&cohort.id, &settings, &places);
    Ok(Some(places))
}

impl<'a> Batches<'a> {
    fn new(shapes: &'a StoredShapes<'a>, ids: Ids) -> Self {
        Self { shapes, ids, next: shapes.read(After::default(), ids) }
    }

    /// The next batch; no further one is read if it has as many shapes as are `wanted`.
    fn next(&mut self, wanted: usize) -> Result<Option<ScanBatch>, ServiceError> {
        self.shapes.check()?;
        let read = match self.shapes.handle.block_on(&mut self.next) {
            Ok(read) => read?,
            Err(error) => match error.try_into_panic() {
                Ok(panic) => std::panic::resume_unwind(panic),
                Err(_) => return Err(ServiceError::Cancelled),
            },
        };
        let Some((batch, after)) = read else { return Ok(None) };
        if batch.weights.len() < wanted {
            self.next = self.shapes.read(after, self.ids);
        }
        Ok(Some(batch))
    }
}

/// BLAKE3 digest of shapes as they are stored: control points and weight of each, as little-endian numbers.
#[derive(Default)]
pub(crate) struct ShapesDigest {
    hasher: blake3::Hasher,
    bytes: Vec<u8>,
}

impl ShapesDigest {
    /// Adds shapes with one weight each.
    pub(crate) fn add(&mut self, control_points: &[f64], weights: &[f64]) {
        let length = control_points.len() / weights.len().max(1);
        self.bytes.clear();
        for (shape, weight) in control_points.chunks_exact(length.max(1)).zip(weights) {
            self.bytes.extend(shape.iter().chain([weight]).flat_map(|number| number.to_le_bytes()));
        }
        self.hasher.update(&self.bytes);
    }

    /// The digest as text.
    pub(crate) fn finish(&self) -> String {
        self.hasher.finalize().to_hex().to_string()
    }
}

/// Shapes of a cohort that were read once. Their sums have the bits of those that are read in every pass.
pub(crate) struct KeptShapes<'a> {
    stored: StoredShapes<'a>,
    shapes: ShapesInMemory,
    _memory: Reserved<'a>,
}

impl ShapeSource for KeptShapes<'_> {
    fn count(&self) -> usize {
        self.shapes.count()
    }

    fn for_each_batch(
        &self,
        visit: &mut dyn FnMut(Shapes<'_>) -> Result<(), AnalysisError>,
    ) -> Result<(), AnalysisError> {
        let all = self.shapes.all();
        let length = all.whitened.len() / all.weights.len().max(1);
        let batches =
            all.whitened.chunks((BATCH_SHAPES * length).max(1)).zip(all.weights.chunks(BATCH_SHAPES));
        for (k, (whitened, weights)) in batches.enumerate() {
            self.check()?;
            visit(Shapes { first: k * BATCH_SHAPES, whitened, weights })?;
            self.worked(weights.len());
        }
        Ok(())
    }

    fn for_each_marked(&self, visit: &mut VisitMarked<'_>) -> Result<(), AnalysisError> {
        self.check()?;
        self.shapes.for_each_marked(visit)?;
        self.worked(self.count());
        Ok(())
    }

    fn check(&self) -> Result<(), AnalysisError> {
        ShapeSource::check(&self.stored)
    }

    fn worked(&self, shapes: usize) {
        self.stored.worked(shapes);
    }

    fn reserve(&self, bytes: usize) -> Option<Reservation<'_>> {
        ShapeSource::reserve(&self.stored, bytes)
    }

    fn known_placements(&self) -> Result<Option<Vec<Placement>>, AnalysisError> {
        self.stored.known_placements()
    }

    fn located(&self, error: AnalysisError) -> AnalysisError {
        self.stored.located(error)
    }
}

impl ShapeSource for StoredShapes<'_> {
    fn count(&self) -> usize {
        self.count
    }

    fn for_each_batch(
        &self,
        visit: &mut dyn FnMut(Shapes<'_>) -> Result<(), AnalysisError>,
    ) -> Result<(), AnalysisError> {
        self.for_each_prepared(&|_, _| Vec::new(), &mut |batch, _| visit(batch))
    }

    fn for_each_marked(&self, visit: &mut VisitMarked<'_>) -> Result<(), AnalysisError> {
        self.for_each_prepared(&Mark::of_all, visit)
    }

    fn check(&self) -> Result<(), AnalysisError> {
        Ok(Self::check(self)?)
    }

    fn worked(&self, shapes: usize) {
        self.counter.inspect(|counter| counter.worked(shapes));
    }

    fn reserve(&self, bytes: usize) -> Option<Reservation<'_>> {
        self.cache.reserve(bytes).map(|reserved| Box::new(reserved) as Reservation<'_>)
    }

    fn known_placements(&self) -> Result<Option<Vec<Placement>>, AnalysisError> {
        let Some((known, which)) = self.known else { return Ok(None) };
        Ok(known.start(which, &self.places()?))
    }

    fn located(&self, error: AnalysisError) -> AnalysisError {
        self.named(error).into()
    }

    fn spread(&self, pass: &Pass, merge: &mut MergePart<'_>) -> Result<bool, AnalysisError> {
        Ok(self.spread_work(&|| Work::Sum(pass.clone()), merge)?)
    }

    fn coders(&self) -> Option<CodeGroup<'_>> {
        self.distribute?.coders(self)
    }
}
