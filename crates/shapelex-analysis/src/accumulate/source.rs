//! Sources of prepared shapes.

use shapelex_numeric::parallel;

use super::mark::Mark;
use crate::AnalysisError;
use crate::metric::{Metric, norm};
use crate::pass::{CodeGroup, Pass};
use crate::placement::Placement;
use crate::subspace::{check_extent, flatten};
use crate::watch::Watch;

/// Shapes per partial sum. Part of the definition of every result: changing it changes last bits.
pub const BLOCK: usize = 128;

/// Shapes per part: their blocks merge before they are added to the sum of its group. A part is the unit of work of a distributed
/// sum. Part of the definition of every result over more shapes than that, as [`BLOCK`] is.
pub const PART: usize = 64 * BLOCK;

/// Shapes per task of a map. Results do not depend on it.
const MAP_BLOCK: usize = 16;

/// A batch of consecutive prepared shapes: whitened, centred when the class translates, `d·N` numbers each.
#[derive(Debug, Clone, Copy)]
pub struct Shapes<'a> {
    /// Position of the first shape in the whole set.
    pub first: usize,
    /// The shapes, one after the other.
    pub whitened: &'a [f64],
    /// One positive weight per shape.
    pub weights: &'a [f64],
}

impl<'a> Shapes<'a> {
    /// `(position, whitened shape, weight)` of every shape.
    pub fn iter(&self) -> impl Iterator<Item = (usize, &'a [f64], f64)> + use<'a> {
        let length = self.whitened.len() / self.weights.len().max(1);
        let rows = self.whitened.chunks_exact(length.max(1)).zip(self.weights);
        let first = self.first;
        rows.enumerate().map(move |(i, (x, &weight))| (first + i, x, weight))
    }

    /// Splits off the first `shapes` shapes.
    pub(crate) fn split_at(self, shapes: usize) -> (Self, Self) {
        let length = self.whitened.len() / self.weights.len().max(1);
        let (left, right) = self.whitened.split_at(shapes * length);
        let (first_weights, other_weights) = self.weights.split_at(shapes);
        let rest = Shapes { first: self.first + shapes, whitened: right, weights: other_weights };
        (Shapes { first: self.first, whitened: left, weights: first_weights }, rest)
    }

    /// Block `k` of consecutive blocks of `size` shapes; the last one may be shorter.
    pub(crate) fn block(self, k: usize, size: usize) -> Self {
        let (_, rest) = self.split_at(k * size);
        rest.split_at(size.min(rest.weights.len())).0
    }
}

/// Receives consecutive shapes and their marks.
pub type VisitMarked<'a> = dyn FnMut(Shapes<'_>, &[Mark]) -> Result<(), AnalysisError> + 'a;

/// A set of shapes that can be read several times, always in the same order.
///
/// Statistics take it as `&dyn ShapeSource`, so that they are compiled once: a call for each batch costs nothing. A failure of the
/// origin of the shapes passes through them as [`AnalysisError::Source`].
pub trait ShapeSource: Sync {
    /// Number of shapes.
    fn count(&self) -> usize;

    /// Calls `visit` with consecutive batches; every batch but the last has a multiple of [`BLOCK`] shapes.
    ///
    /// # Errors
    /// The first error of the storage or of `visit`.
    fn for_each_batch(
        &self,
        visit: &mut dyn FnMut(Shapes<'_>) -> Result<(), AnalysisError>,
    ) -> Result<(), AnalysisError>;

    /// Calls `visit` with consecutive batches of any length and the [mark](Mark) of each shape. Default: marks of the prepared shapes,
    /// for a source whose shapes were never given in another form; one that changes or selects shapes of another source passes
    /// their marks on.
    ///
    /// # Errors
    /// As [`for_each_batch`](Self::for_each_batch).
    fn for_each_marked(&self, visit: &mut VisitMarked<'_>) -> Result<(), AnalysisError> {
        self.for_each_batch(&mut |batch| visit(batch, &Mark::of_all(batch.whitened, batch.weights)))
    }

    /// Fails once reading should end. Called between the steps of computations on shapes read before.
    ///
    /// # Errors
    /// The reason to end.
    fn check(&self) -> Result<(), AnalysisError> {
        Ok(())
    }

    /// Counts shapes that a pass has worked through. Reading counts by itself; passes over kept data of the shapes call it.
    fn worked(&self, shapes: usize) {
        let _ = shapes;
    }

    /// Reserves memory to keep all shapes in, until the value returned is dropped; `None` if that is too much. Default: at most
    /// [`KEPT_BYTES`].
    fn reserve(&self, bytes: usize) -> Option<Reservation<'_>> {
        (bytes <= KEPT_BYTES).then(|| Box::new(()) as Reservation<'_>)
    }

    /// Placements from which a search for start points, directions and mirror images begins, if an earlier search has found
    /// some: of all shapes, where one that it did not see stands as given, or of the
    /// [leading](crate::alignment::MeanShape::leading) ones.
    ///
    /// # Errors
    /// A failure of the storage.
    fn known_placements(&self) -> Result<Option<Vec<Placement>>, AnalysisError> {
        Ok(None)
    }

    /// The error with the name of the shape that caused it, as far as the source knows it.
    fn located(&self, error: AnalysisError) -> AnalysisError {
        error
    }

    /// Computes the sums of the parts elsewhere and passes them to `merge` in order, as
    /// [`Accumulator::to_bytes`](super::Accumulator::to_bytes) wrote them; or the one sum over all parts, merged in groups of
    /// [`FAN_IN`](super::FAN_IN). Returns `false`, doing nothing, if the sum should be computed locally.
    ///
    /// # Errors
    /// The first error of the storage or of `merge`.
    fn spread(&self, pass: &Pass, merge: &mut MergePart<'_>) -> Result<bool, AnalysisError> {
        let _ = (pass, merge);
        Ok(false)
    }

    /// Codes groups of shapes in other processes while a dictionary is learnt; `None` if shapes are to be coded here.
    fn coders(&self) -> Option<CodeGroup<'_>> {
        None
    }
}

/// Memory reserved until it is dropped.
pub type Reservation<'a> = Box<dyn Reserved + 'a>;

/// A value that holds a reservation.
pub trait Reserved {}

impl<T> Reserved for T {}

/// Maximum size of shapes kept in memory, in bytes; larger sets are read from their source in every pass.
pub const KEPT_BYTES: usize = 1 << 30;

/// Receives the serialised sum of a part.
pub type MergePart<'a> = dyn FnMut(&[u8]) -> Result<(), AnalysisError> + 'a;

/// Shapes in memory, prepared once.
#[derive(Debug, Clone)]
pub struct ShapesInMemory {
    whitened: Vec<f64>,
    weights: Vec<f64>,
    /// Marks of the shapes as given; `None` for shapes that were prepared elsewhere.
    marks: Option<Vec<Mark>>,
}

impl ShapesInMemory {
    /// Prepares `control_points`, `d·N` coordinate-major numbers per shape, one shape after the other.
    ///
    /// # Errors
    /// [`AnalysisError::NoExtent`] for the first shape without an extent.
    pub fn new(
        metric: &Metric,
        centred: bool,
        mut control_points: Vec<f64>,
        weights: Vec<f64>,
    ) -> Result<Self, AnalysisError> {
        prepare(metric, centred, 0, &mut control_points)?;
        Ok(Self::prepared(control_points, weights))
    }

    /// As [`new`](Self::new), with the marks of the shapes, so that samples of them are those of the same shapes in a store.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn marked(
        metric: &Metric,
        centred: bool,
        control_points: Vec<f64>,
        weights: Vec<f64>,
    ) -> Result<Self, AnalysisError> {
        let marks = Some(Mark::of_all(&control_points, &weights));
        Ok(Self { marks, ..Self::new(metric, centred, control_points, weights)? })
    }

    /// Wraps shapes that are already prepared.
    pub fn prepared(whitened: Vec<f64>, weights: Vec<f64>) -> Self {
        Self { whitened, weights, marks: None }
    }

    /// All shapes of a source.
    ///
    /// # Errors
    /// Errors of the source.
    pub fn of(source: &dyn ShapeSource) -> Result<Self, AnalysisError> {
        let (mut whitened, mut weights) = (Vec::new(), Vec::with_capacity(source.count()));
        source.for_each_batch(&mut |batch: Shapes<'_>| {
            if weights.is_empty() {
                let length = batch.whitened.len() / batch.weights.len().max(1);
                whitened.reserve_exact(source.count() * length);
            }
            whitened.extend_from_slice(batch.whitened);
            weights.extend_from_slice(batch.weights);
            Ok(())
        })?;
        Ok(Self::prepared(whitened, weights))
    }

    /// `count` shapes that `read` passes on, with their marks.
    ///
    /// # Errors
    /// Errors of `read`.
    pub fn read_marked(
        count: usize,
        read: &mut dyn FnMut(&mut VisitMarked<'_>) -> Result<(), AnalysisError>,
    ) -> Result<Self, AnalysisError> {
        let (mut whitened, mut weights) = (Vec::new(), Vec::with_capacity(count));
        let mut kept = Vec::with_capacity(count);
        read(&mut |batch, marks| {
            if weights.is_empty() {
                whitened.reserve_exact(count * (batch.whitened.len() / batch.weights.len().max(1)));
            }
            whitened.extend_from_slice(batch.whitened);
            weights.extend_from_slice(batch.weights);
            kept.extend_from_slice(marks);
            Ok(())
        })?;
        Ok(Self { whitened, weights, marks: Some(kept) })
    }

    /// The numbers of all prepared shapes, one shape after the other.
    pub(crate) fn into_whitened(self) -> Vec<f64> {
        self.whitened
    }

    /// The prepared shapes.
    pub fn all(&self) -> Shapes<'_> {
        Shapes { first: 0, whitened: &self.whitened, weights: &self.weights }
    }

    fn range(&self, k: usize) -> std::ops::Range<usize> {
        let length = self.whitened.len() / self.weights.len().max(1);
        k * length..(k + 1) * length
    }

    /// Numbers of shape `k`.
    pub(crate) fn shape(&self, k: usize) -> &[f64] {
        &self.whitened[self.range(k)]
    }

    /// Replaces shape `k` by `whitened`, which has as many numbers.
    pub(crate) fn replace(&mut self, k: usize, whitened: &[f64]) {
        let range = self.range(k);
        self.whitened[range].copy_from_slice(whitened);
    }
}

impl ShapeSource for ShapesInMemory {
    fn count(&self) -> usize {
        self.weights.len()
    }

    fn for_each_batch(
        &self,
        visit: &mut dyn FnMut(Shapes<'_>) -> Result<(), AnalysisError>,
    ) -> Result<(), AnalysisError> {
        visit(self.all())
    }

    fn for_each_marked(&self, visit: &mut VisitMarked<'_>) -> Result<(), AnalysisError> {
        match &self.marks {
            Some(marks) => visit(self.all(), marks),
            None => visit(self.all(), &Mark::of_all(&self.whitened, &self.weights)),
        }
    }
}

/// The first shapes of a source.
pub(crate) struct Leading<'a> {
    pub(crate) source: &'a dyn ShapeSource,
    /// At most those of the source; a multiple of [`BLOCK`], or all.
    pub(crate) count: usize,
}

impl ShapeSource for Leading<'_> {
    fn count(&self) -> usize {
        self.count
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
        let mut left = self.count;
        let read = self.source.for_each_batch(&mut |batch| {
            let (wanted, _) = batch.split_at(batch.weights.len().min(left));
            visit(wanted)?;
            left -= wanted.weights.len();
            // An error is the only way to end the reading.
            if left == 0 && self.count < self.source.count() {
                Err(AnalysisError::Interrupted)
            } else {
                Ok(())
            }
        });
        if left == 0 { Ok(()) } else { read }
    }

    fn located(&self, error: AnalysisError) -> AnalysisError {
        self.source.located(error)
    }

    fn spread(&self, pass: &Pass, merge: &mut MergePart<'_>) -> Result<bool, AnalysisError> {
        Ok(self.count == self.source.count() && self.source.spread(pass, merge)?)
    }
}

/// A source whose `watch` is asked before every [`PART`] of shapes, so that an iteration over it can be cancelled, and counts
/// the shapes that are read.
pub struct Watched<'a> {
    source: &'a dyn ShapeSource,
    watch: &'a dyn Watch,
}

impl<'a> Watched<'a> {
    /// Wraps `source`; reading ends with [`AnalysisError::Interrupted`] once the watch stops.
    pub fn new(source: &'a dyn ShapeSource, watch: &'a dyn Watch) -> Self {
        Self { source, watch }
    }
}

impl ShapeSource for Watched<'_> {
    fn count(&self) -> usize {
        self.source.count()
    }

    fn check(&self) -> Result<(), AnalysisError> {
        self.watch.check()?;
        self.source.check()
    }

    fn worked(&self, shapes: usize) {
        self.watch.worked(shapes);
    }

    fn reserve(&self, bytes: usize) -> Option<Reservation<'_>> {
        self.source.reserve(bytes)
    }

    fn known_placements(&self) -> Result<Option<Vec<Placement>>, AnalysisError> {
        self.source.known_placements()
    }

    fn for_each_batch(
        &self,
        visit: &mut dyn FnMut(Shapes<'_>) -> Result<(), AnalysisError>,
    ) -> Result<(), AnalysisError> {
        self.source.for_each_batch(&mut |mut rest| {
            loop {
                self.check()?;
                let count = rest.weights.len().min(PART);
                let (part, others) = rest.split_at(count);
                visit(part)?;
                self.worked(count);
                if others.weights.is_empty() {
                    return Ok(());
                }
                rest = others;
            }
        })
    }

    fn for_each_marked(&self, visit: &mut VisitMarked<'_>) -> Result<(), AnalysisError> {
        self.source.for_each_marked(&mut |batch, marks| {
            self.check()?;
            visit(batch, marks)?;
            self.worked(marks.len());
            Ok(())
        })
    }

    fn located(&self, error: AnalysisError) -> AnalysisError {
        self.source.located(error)
    }

    fn spread(&self, pass: &Pass, merge: &mut MergePart<'_>) -> Result<bool, AnalysisError> {
        self.source.spread(pass, merge)
    }
}

/// Turns control points into prepared shapes, in place: centred when `centred`, then whitened.
///
/// # Errors
/// [`AnalysisError::NoExtent`] with the position (`first` + offset) of the first shape without an extent.
pub fn prepare(
    metric: &Metric,
    centred: bool,
    first: usize,
    shapes: &mut [f64],
) -> Result<(), AnalysisError> {
    let length = metric.len();
    parallel::try_for_each_chunk(shapes, BLOCK * length, &|block, rows| {
        for (i, shape) in rows.chunks_exact_mut(length).enumerate() {
            let size = norm(shape);
            if centred {
                metric.centre(shape);
            }
            check_extent(norm(shape), size).map_err(|error| error.at(first + block * BLOCK + i))?;
            if centred {
                flatten(shape, metric.dimension(), size);
            }
        }
        metric.whiten(rows);
        Ok(())
    })
}

/// Calls `visit` with every batch of `source`, its shapes changed in place by `change`, which also receives them as they
/// were.
///
/// # Errors
/// Errors of the source, of `change` and of `visit`.
pub(crate) fn for_each_changed(
    source: &dyn ShapeSource,
    change: impl Fn(Shapes<'_>, &mut [f64]) -> Result<(), AnalysisError>,
    visit: &mut dyn FnMut(Shapes<'_>) -> Result<(), AnalysisError>,
) -> Result<(), AnalysisError> {
    let mut whitened = Vec::new();
    source.for_each_batch(&mut |mut rest| {
        // Parts, so that a source in memory is not copied as a whole.
        while !rest.weights.is_empty() {
            let (part, others) = rest.split_at(rest.weights.len().min(PART));
            whitened.clear();
            whitened.extend_from_slice(part.whitened);
            change(part, &mut whitened)?;
            visit(Shapes { whitened: &whitened, ..part })?;
            rest = others;
        }
        Ok(())
    })
}

/// One value for every shape, in order, computed in parallel.
///
/// # Errors
/// The first error of the source or of `f`.
pub fn map_shapes<T: Send>(
    source: &dyn ShapeSource,
    f: impl Fn(usize, &[f64], f64) -> Result<T, AnalysisError> + Sync,
) -> Result<Vec<T>, AnalysisError> {
    map_by(source, MAP_BLOCK, &|block| block.iter().map(|(i, x, w)| f(i, x, w)).collect())
}

/// The same by blocks of at most [`BLOCK`] shapes.
///
/// # Errors
/// The first error of the source or of `f`.
pub(crate) fn map_blocks<T: Send>(
    source: &dyn ShapeSource,
    f: impl Fn(Shapes<'_>) -> Result<Vec<T>, AnalysisError> + Sync,
) -> Result<Vec<T>, AnalysisError> {
    map_by(source, BLOCK, &f)
}

fn map_by<T: Send>(
    source: &dyn ShapeSource,
    size: usize,
    f: &(dyn Fn(Shapes<'_>) -> Result<Vec<T>, AnalysisError> + Sync),
) -> Result<Vec<T>, AnalysisError> {
    let mut values = Vec::with_capacity(source.count());
    source.for_each_batch(&mut |batch| {
        let count = batch.weights.len().div_ceil(size);
        values.extend(parallel::try_map(count, &|k| f(batch.block(k, size)))?.into_iter().flatten());
        Ok(())
    })?;
    Ok(values)
}

/// The eligible shape with the lexicographically smallest coordinates, with its position: a choice that does not depend on
/// the order of the shapes.
///
/// # Errors
/// [`AnalysisError::TooFewShapes`] when no position is eligible; errors of the source.
pub fn smallest_eligible(
    source: &dyn ShapeSource,
    eligible: impl Fn(usize) -> bool,
) -> Result<(usize, Vec<f64>), AnalysisError> {
    let mut chosen: Option<(usize, Vec<f64>)> = None;
    source.for_each_batch(&mut |batch| {
        for (position, x, _) in batch.iter().filter(|(k, ..)| eligible(*k)) {
            if chosen.as_ref().is_none_or(|(_, c)| x.partial_cmp(c) == Some(std::cmp::Ordering::Less)) {
                chosen = Some((position, x.to_vec()));
            }
        }
        Ok(())
    })?;
    chosen.ok_or(AnalysisError::TooFewShapes { found: 0, needed: 1 })
}

/// The whitened shapes at the positions `chosen`, in their order.
pub fn subset(shapes: &ShapesInMemory, chosen: &[usize]) -> ShapesInMemory {
    let all = shapes.all();
    let length = all.whitened.len() / all.weights.len().max(1);
    let whitened = chosen.iter().flat_map(|&k| &all.whitened[k * length..(k + 1) * length]).copied();
    ShapesInMemory::prepared(whitened.collect(), chosen.iter().map(|&k| all.weights[k]).collect())
}
