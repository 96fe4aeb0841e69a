//! Sums over many shapes that stream, split and merge.
//!
//! A set of shapes is processed in blocks of [`BLOCK`] shapes, each with its own partial sum. The blocks of a part
//! ([`PART`] shapes) merge in order, and so do the parts. The result therefore has the same bits for any number of
//! threads, any division of the shapes into batches, and any process that computed the sum of a part.

use rayon::prelude::*;

use super::AnalysisError;
use super::metric::{Metric, dot, norm};
use super::pass::{Pass, Sum};
use super::subspace::{check_extent, flatten, quarter_turn};
use shapelex_numeric::dense::{self, Eigenpairs, Matrix};

/// Shapes per partial sum. Part of the definition of every result: changing it changes last bits.
pub const BLOCK: usize = 128;

/// Shapes per part: their blocks merge before they are added to the total. A part is the unit of work of a distributed
/// sum. Part of the definition of every result over more shapes than that, as [`BLOCK`] is.
pub const PART: usize = 64 * BLOCK;

/// Shapes per task of a map. Results do not depend on it.
const MAP_BLOCK: usize = 16;

/// Approximate limit on the memory of all partial sums in flight, in bytes.
const PARTIAL_BYTES: usize = 256 << 20;

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
    pub fn iter(&self) -> impl Iterator<Item = (usize, &'a [f64], f64)> {
        let length = self.whitened.len() / self.weights.len().max(1);
        let rows = self.whitened.chunks_exact(length.max(1)).zip(self.weights);
        let first = self.first;
        rows.enumerate().map(move |(i, (x, &weight))| (first + i, x, weight))
    }

    /// Splits off the first `shapes` shapes.
    pub(super) fn split_at(self, shapes: usize) -> (Self, Self) {
        let length = self.whitened.len() / self.weights.len().max(1);
        let (left, right) = self.whitened.split_at(shapes * length);
        let (first_weights, other_weights) = self.weights.split_at(shapes);
        let rest = Shapes { first: self.first + shapes, whitened: right, weights: other_weights };
        (Shapes { first: self.first, whitened: left, weights: first_weights }, rest)
    }

    /// Consecutive blocks of `size` shapes; the last one may be shorter.
    pub(super) fn blocks(self, size: usize) -> impl IndexedParallelIterator<Item = Shapes<'a>> {
        let length = self.whitened.len() / self.weights.len().max(1);
        let rows = self.whitened.par_chunks(size * length.max(1));
        rows.zip(self.weights.par_chunks(size)).enumerate().map(move |(i, (whitened, weights))| Shapes {
            first: self.first + i * size,
            whitened,
            weights,
        })
    }
}

/// A set of shapes that can be read several times, always in the same order.
pub trait ShapeSource: Sync {
    /// Error of a read: a bad shape, or a failure of the storage that the shapes come from.
    type Error: From<AnalysisError> + Send;

    /// Number of shapes.
    fn count(&self) -> usize;

    /// Calls `visit` with consecutive batches; every batch but the last has a multiple of [`BLOCK`] shapes.
    ///
    /// # Errors
    /// The first error of the storage or of `visit`.
    fn for_each_batch(
        &self,
        visit: &mut dyn FnMut(Shapes<'_>) -> Result<(), Self::Error>,
    ) -> Result<(), Self::Error>;

    /// The error with the name of the shape that caused it, as far as the source knows it.
    fn located(&self, error: Self::Error) -> Self::Error {
        error
    }

    /// Distributes the parts to idle workers and passes their sums to `merge` in order, as
    /// [`Accumulator::to_bytes`] wrote them. Returns `false`, doing nothing, if the sum should be computed locally.
    ///
    /// # Errors
    /// The first error of the storage or of `merge`.
    fn spread(&self, pass: &Pass, merge: &mut MergePart<'_>) -> Result<bool, Self::Error> {
        let _ = (pass, merge);
        Ok(false)
    }
}

/// Receives the serialised sum of a part.
pub type MergePart<'a> = dyn FnMut(&[u8]) -> Result<(), AnalysisError> + 'a;

/// Shapes in memory, prepared once.
#[derive(Debug, Clone)]
pub struct ShapesInMemory {
    whitened: Vec<f64>,
    weights: Vec<f64>,
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
        Ok(Self { whitened: control_points, weights })
    }

    /// Wraps shapes that are already prepared.
    pub fn prepared(whitened: Vec<f64>, weights: Vec<f64>) -> Self {
        Self { whitened, weights }
    }

    /// All shapes of a source.
    ///
    /// # Errors
    /// Errors of the source.
    pub fn of<S: ShapeSource>(source: &S) -> Result<Self, S::Error> {
        let (mut whitened, mut weights) = (Vec::new(), Vec::new());
        source.for_each_batch(&mut |batch: Shapes<'_>| {
            whitened.extend_from_slice(batch.whitened);
            weights.extend_from_slice(batch.weights);
            Ok(())
        })?;
        Ok(Self::prepared(whitened, weights))
    }

    /// At most `most` shapes of a source, evenly spread over it.
    ///
    /// # Errors
    /// Errors of the source.
    pub fn spread_out<S: ShapeSource>(source: &S, most: usize) -> Result<Self, S::Error> {
        let (count, held) = (source.count(), source.count().min(most));
        let (mut whitened, mut weights) = (Vec::new(), Vec::new());
        let mut wanted = (0..held).map(|i| i * count / held).peekable();
        source.for_each_batch(&mut |batch| {
            for (_, x, weight) in batch.iter().filter(|(k, ..)| wanted.next_if_eq(k).is_some()) {
                whitened.extend_from_slice(x);
                weights.push(weight);
            }
            Ok(())
        })?;
        Ok(Self::prepared(whitened, weights))
    }

    /// The prepared shapes.
    pub fn all(&self) -> Shapes<'_> {
        Shapes { first: 0, whitened: &self.whitened, weights: &self.weights }
    }
}

impl ShapeSource for ShapesInMemory {
    type Error = AnalysisError;

    fn count(&self) -> usize {
        self.weights.len()
    }

    fn for_each_batch(
        &self,
        visit: &mut dyn FnMut(Shapes<'_>) -> Result<(), AnalysisError>,
    ) -> Result<(), AnalysisError> {
        visit(self.all())
    }
}

/// A source that checks `stop` before every [`PART`] of shapes, so that an iteration over it can be cancelled.
pub struct Watched<'a, S> {
    source: &'a S,
    stop: &'a (dyn Fn() -> bool + Sync),
}

impl<'a, S> Watched<'a, S> {
    /// Wraps `source`; reading ends with [`AnalysisError::Interrupted`] once `stop` returns true.
    pub fn new(source: &'a S, stop: &'a (dyn Fn() -> bool + Sync)) -> Self {
        Self { source, stop }
    }
}

impl<S: ShapeSource> ShapeSource for Watched<'_, S> {
    type Error = S::Error;

    fn count(&self) -> usize {
        self.source.count()
    }

    fn for_each_batch(
        &self,
        visit: &mut dyn FnMut(Shapes<'_>) -> Result<(), S::Error>,
    ) -> Result<(), S::Error> {
        self.source.for_each_batch(&mut |mut rest| {
            loop {
                if (self.stop)() {
                    return Err(AnalysisError::Interrupted.into());
                }
                let count = rest.weights.len().min(PART);
                let (part, others) = rest.split_at(count);
                visit(part)?;
                if others.weights.is_empty() {
                    return Ok(());
                }
                rest = others;
            }
        })
    }

    fn located(&self, error: S::Error) -> S::Error {
        self.source.located(error)
    }

    fn spread(&self, pass: &Pass, merge: &mut MergePart<'_>) -> Result<bool, S::Error> {
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
    shapes.par_chunks_mut(BLOCK * length).enumerate().try_for_each(|(block, rows)| {
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

impl AnalysisError {
    /// The same error for the shape at `position`.
    pub fn at(self, position: usize) -> Self {
        match self {
            Self::Degenerate { class, sigma, .. } => Self::Degenerate { index: position, class, sigma },
            Self::NoExtent { norm, size, .. } => Self::NoExtent { index: position, norm, size },
            Self::NoConvergence { iterations, gap, tolerance, .. } => {
                Self::NoConvergence { index: position, iterations, gap, tolerance }
            }
            other => other,
        }
    }
}

impl AnalysisError {
    /// The same error with its position increased by `first`.
    pub fn after(self, first: usize) -> Self {
        match self.position() {
            Some(position) => self.at(first + position),
            None => self,
        }
    }

    /// Position of the shape that caused the error.
    pub fn position(&self) -> Option<usize> {
        match self {
            Self::Degenerate { index, .. }
            | Self::NoExtent { index, .. }
            | Self::NoConvergence { index, .. } => Some(*index),
            _ => None,
        }
    }
}

/// A sum over shapes that merges by addition: across threads, chunks of a job and machines.
pub trait Accumulator: Sized + Send {
    /// Adds the shapes.
    ///
    /// # Errors
    /// The first error of a shape, with its position.
    fn update(&mut self, shapes: Shapes<'_>) -> Result<(), AnalysisError>;

    /// Adds another sum of the same kind. The order of merges affects the last bits.
    fn merge(&mut self, other: Self);

    /// Serialises the sum: little-endian, self-delimiting, equal bytes for equal sums.
    fn to_bytes(&self) -> Vec<u8>;

    /// Replaces this sum by a serialised one of the same kind and size.
    ///
    /// # Errors
    /// [`AnalysisError::NotAnAccumulator`] for any other bytes.
    fn restore(&mut self, bytes: &[u8]) -> Result<(), AnalysisError>;
}

/// Sum over all shapes of `source`. `empty` creates an accumulator; `partial_bytes` is the size of one.
///
/// # Errors
/// The first error of the source or of an update.
pub fn accumulate<S: ShapeSource, A: Accumulator>(
    source: &S,
    partial_bytes: usize,
    empty: impl Fn() -> A + Sync,
) -> Result<A, S::Error> {
    let together = (PARTIAL_BYTES / partial_bytes.max(1)).clamp(1, 64);
    let (mut total, mut part) = (empty(), empty());
    source.for_each_batch(&mut |batch| {
        let blocks: Vec<Shapes<'_>> = batch.blocks(BLOCK).collect();
        for group in blocks.chunks(together) {
            let partial = |shapes: &Shapes<'_>| {
                let mut sum = empty();
                sum.update(*shapes).map(|()| sum)
            };
            let partials: Vec<Result<A, AnalysisError>> = group.par_iter().map(partial).collect();
            for (block, partial) in group.iter().zip(partials) {
                if block.first.is_multiple_of(PART) {
                    total.merge(std::mem::replace(&mut part, empty()));
                }
                part.merge(partial?);
            }
        }
        Ok(())
    })?;
    total.merge(part);
    Ok(total)
}

/// Sum over all shapes of `source`: merged from distributed parts if the source distributes them, else made by `here`.
///
/// # Errors
/// Those of the source and of `here`.
pub(super) fn accumulate_spread<S: ShapeSource, A: Accumulator>(
    source: &S,
    sum: Sum,
    empty: impl Fn() -> A,
    here: impl FnOnce() -> Result<A, S::Error>,
) -> Result<A, S::Error> {
    let mut total = empty();
    let spread = source.spread(&Pass { aligned: None, sum }, &mut |bytes| {
        let mut part = empty();
        part.restore(bytes)?;
        total.merge(part);
        Ok(())
    })?;
    if spread { Ok(total) } else { here() }
}

/// One value for every shape, in order, computed in parallel.
///
/// # Errors
/// The first error of the source or of `f`.
pub fn map_shapes<S: ShapeSource, T: Send>(
    source: &S,
    f: impl Fn(usize, &[f64], f64) -> Result<T, AnalysisError> + Sync,
) -> Result<Vec<T>, S::Error> {
    let mut values = Vec::with_capacity(source.count());
    source.for_each_batch(&mut |batch| {
        let blocks: Vec<Result<Vec<T>, AnalysisError>> =
            batch.blocks(MAP_BLOCK).map(|block| block.iter().map(|(i, x, w)| f(i, x, w)).collect()).collect();
        for block in blocks {
            values.extend(block?);
        }
        Ok(())
    })?;
    Ok(values)
}

/// The eligible shape with the lexicographically smallest coordinates: a choice that does not depend on the
/// order of the shapes.
///
/// # Errors
/// [`AnalysisError::TooFewShapes`] when no position is eligible; errors of the source.
pub fn smallest_eligible<S: ShapeSource>(
    source: &S,
    eligible: impl Fn(usize) -> bool,
) -> Result<Vec<f64>, S::Error> {
    let mut chosen: Option<Vec<f64>> = None;
    source.for_each_batch(&mut |batch| {
        for (_, x, _) in batch.iter().filter(|(k, ..)| eligible(*k)) {
            if chosen.as_deref().is_none_or(|c| x.partial_cmp(c) == Some(std::cmp::Ordering::Less)) {
                chosen = Some(x.to_vec());
            }
        }
        Ok(())
    })?;
    Ok(chosen.ok_or(AnalysisError::TooFewShapes { found: 0, needed: 1 })?)
}

/// `S = Σ x xᵀ` of vectors `x ∈ R^n`, with its leading eigenpairs by the smaller of two routes.
///
/// Up to about `n/2` vectors are kept as they are (dual route, Theorem 2: the symmetric matrix `XᵀX`); beyond that,
/// they are folded into the `n × n` matrix (primal route). The choice depends on the number of vectors alone.
#[derive(Debug, Clone, PartialEq)]
pub struct OuterProductSum {
    n: usize,
    columns: Vec<f64>,
    /// Lower triangle.
    matrix: Option<Matrix>,
}

/// Minimum number of vectors per fold into the matrix: products of thinner matrices use the kernel badly.
const FOLD: usize = 64;

impl OuterProductSum {
    /// The empty sum in `R^n`.
    pub fn new(n: usize) -> Self {
        Self { n, columns: Vec::new(), matrix: None }
    }

    /// Adds the vectors stored one after the other.
    pub fn add(&mut self, columns: &[f64]) {
        self.columns.extend_from_slice(columns);
        if self.columns.len() >= self.n * (self.n / 2).max(FOLD) {
            self.fold();
        }
    }

    fn fold(&mut self) {
        let matrix = self.matrix.get_or_insert_with(|| Matrix::zeros(self.n, self.n));
        dense::add_outer_products(matrix, &self.columns, 1.0);
        self.columns.clear();
    }

    /// Adds another sum.
    pub fn merge(&mut self, other: Self) {
        if let Some(matrix) = other.matrix {
            match &mut self.matrix {
                Some(own) => *own += matrix,
                None => self.matrix = Some(matrix),
            }
        }
        self.add(&other.columns);
    }

    /// Subtracts the vectors `leaving` and adds `arriving`. Returns `false`, doing nothing, while vectors are kept.
    pub(super) fn exchange(&mut self, leaving: &[f64], arriving: &[f64]) -> bool {
        let Some(matrix) = &mut self.matrix else { return false };
        dense::add_outer_products(matrix, leaving, -1.0);
        dense::add_outer_products(matrix, arriving, 1.0);
        true
    }

    /// Extends the sum over `x` to a sum over `x` and `J x`, where `J` is the quarter turn of planar shapes:
    /// `S + J S Jᵀ = [[A + C, ·], [B − Bᵀ, A + C]]` for `S = [[A, ·], [B, C]]`.
    pub(super) fn close_under_quarter_turn(&mut self) {
        let turned: Vec<f64> = self.columns.chunks_exact(self.n).flat_map(|x| quarter_turn(x, 1.0)).collect();
        self.columns.extend(turned);
        if let Some(s) = &mut self.matrix {
            let half = self.n / 2;
            dense::fill_upper(s);
            let sum = s.view((0, 0), (half, half)) + s.view((half, half), (half, half));
            let cross = s.view((half, 0), (half, half)).into_owned();
            s.view_mut((0, 0), (half, half)).copy_from(&sum);
            s.view_mut((half, half), (half, half)).copy_from(&sum);
            s.view_mut((half, 0), (half, half)).copy_from(&(&cross - cross.transpose()));
        }
    }

    /// Orthonormal basis of the leading invariant subspace, iterated from the columns of `near`. `None` if the
    /// iteration does not converge quickly.
    pub(super) fn leading_subspace(&mut self, near: &Matrix) -> Option<Matrix> {
        if self.matrix.is_none() && self.columns.len() < self.n * self.n {
            let x = Matrix::from_column_slice(self.n, self.columns.len() / self.n, &self.columns);
            return dense::iterate_subspace(|v| dense::multiply(&x, &dense::transpose_multiply(&x, v)), near);
        }
        self.fold();
        let s = self.matrix.as_mut().expect("folded");
        dense::fill_upper(s);
        dense::iterate_subspace(|v| dense::multiply(s, v), near)
    }

    /// Trace of the sum, `tr S`.
    pub fn trace(&self) -> f64 {
        dot(&self.columns, &self.columns) + self.matrix.as_ref().map_or(0.0, Matrix::trace)
    }

    /// The `count` leading eigenpairs of `S`; fewer if its rank is smaller (dual route).
    ///
    /// # Errors
    /// [`NumericError::NoConvergence`](shapelex_numeric::NumericError::NoConvergence) if the eigenproblem fails.
    pub fn leading(mut self, count: usize) -> Result<Eigenpairs, AnalysisError> {
        if self.matrix.is_none() && self.columns.len() < self.n * self.n {
            return dual_eigenpairs(&self.columns, self.n, count);
        }
        self.fold();
        let matrix = self.matrix.expect("folded");
        Ok(dense::leading_eigenpairs(&matrix, count)?)
    }

    pub(super) fn write(&self, bytes: &mut Vec<u8>) {
        write_numbers(bytes, &self.columns);
        write_numbers(bytes, self.matrix.as_ref().map_or(&[], |m| m.as_slice()));
    }

    pub(super) fn read(&mut self, bytes: &mut &[u8]) -> Result<(), AnalysisError> {
        let columns = read_numbers(bytes)?;
        let matrix = read_numbers(bytes)?;
        if columns.len() % self.n != 0 || !(matrix.is_empty() || matrix.len() == self.n * self.n) {
            return Err(AnalysisError::NotAnAccumulator);
        }
        self.columns = columns;
        self.matrix = (!matrix.is_empty()).then(|| Matrix::from_vec(self.n, self.n, matrix));
        Ok(())
    }
}

/// Relative eigenvalue of `XᵀX` below which a direction is rounding error.
const RANK: f64 = 1e-14;

/// Eigenpairs of `X Xᵀ` from those of `XᵀX`: `f_i = X v_i / √λ_i`.
///
/// Division by a small `√λ` costs orthogonality, so the vectors are orthonormalised again in the order of their
/// eigenvalues.
fn dual_eigenpairs(columns: &[f64], n: usize, count: usize) -> Result<Eigenpairs, AnalysisError> {
    let x = Matrix::from_column_slice(n, columns.len() / n, columns);
    let pairs = dense::leading_eigenpairs(&dense::gram(columns, n), count)?;
    let largest = pairs.values.first().copied().unwrap_or(0.0);
    let rank = pairs.values.iter().take_while(|&&value| value > RANK * largest).count();
    let mut vectors = dense::multiply(&x, &pairs.vectors.columns(0, rank).into_owned());
    for j in 0..rank {
        for i in 0..j {
            let product = vectors.column(i).dot(&vectors.column(j));
            let earlier = vectors.column(i).into_owned();
            vectors.column_mut(j).axpy(-product, &earlier, 1.0);
        }
        let length = vectors.column(j).norm();
        vectors.column_mut(j).scale_mut(1.0 / length);
    }
    Ok(Eigenpairs { values: pairs.values[..rank].to_vec(), vectors })
}

/// A weighted sum of outer products: scatter matrix, sum of vectors and of weights.
#[derive(Debug, Clone, PartialEq)]
pub struct ScatterSum {
    outer: OuterProductSum,
    sum: Vec<f64>,
    weight: f64,
}

impl ScatterSum {
    /// The empty sum in `R^n`.
    pub fn new(n: usize) -> Self {
        Self { outer: OuterProductSum::new(n), sum: vec![0.0; n], weight: 0.0 }
    }

    /// Total weight, `Σ w`.
    pub fn weight(&self) -> f64 {
        self.weight
    }

    /// Weighted mean, `Σ w x / Σ w`.
    pub fn mean(&self) -> Vec<f64> {
        self.sum.iter().map(|value| value / self.weight).collect()
    }

    /// `tr S` and the leading eigenpairs of `S = Σ w x xᵀ`, or of `Σ w (x − x̄)(x − x̄)ᵀ`.
    ///
    /// Centring happens at the end. To avoid cancellation, subtract a fixed reference from every vector beforehand.
    ///
    /// # Errors
    /// As [`OuterProductSum::leading`].
    pub fn leading(mut self, centre: bool, count: usize) -> Result<(f64, Eigenpairs), AnalysisError> {
        if centre {
            self.outer.fold();
            let mean = self.mean();
            let matrix = self.outer.matrix.as_mut().expect("folded");
            for j in 0..mean.len() {
                for i in j..mean.len() {
                    matrix[(i, j)] -= self.weight * mean[i] * mean[j];
                }
            }
        }
        Ok((self.outer.trace(), self.outer.leading(count)?))
    }
}

impl Accumulator for ScatterSum {
    fn update(&mut self, shapes: Shapes<'_>) -> Result<(), AnalysisError> {
        let mut columns = shapes.whitened.to_vec();
        let n = self.sum.len();
        for (column, &weight) in columns.chunks_exact_mut(n).zip(shapes.weights) {
            self.sum.iter_mut().zip(column.iter()).for_each(|(sum, x)| *sum += weight * x);
            if weight != 1.0 {
                let root = weight.sqrt();
                column.iter_mut().for_each(|x| *x *= root);
            }
            self.weight += weight;
        }
        self.outer.add(&columns);
        Ok(())
    }

    fn merge(&mut self, other: Self) {
        self.outer.merge(other.outer);
        self.sum.iter_mut().zip(&other.sum).for_each(|(a, b)| *a += b);
        self.weight += other.weight;
    }

    fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        write_numbers(&mut bytes, &[self.weight]);
        write_numbers(&mut bytes, &self.sum);
        self.outer.write(&mut bytes);
        bytes
    }

    fn restore(&mut self, mut bytes: &[u8]) -> Result<(), AnalysisError> {
        let weight = read_numbers(&mut bytes)?;
        let sum = read_numbers(&mut bytes)?;
        if weight.len() != 1 || sum.len() != self.sum.len() {
            return Err(AnalysisError::NotAnAccumulator);
        }
        (self.weight, self.sum) = (weight[0], sum);
        self.outer.read(&mut bytes)
    }
}

/// Writes a length and the numbers.
pub(super) fn write_numbers(bytes: &mut Vec<u8>, numbers: &[f64]) {
    bytes.extend_from_slice(&(numbers.len() as u64).to_le_bytes());
    numbers.iter().for_each(|value| bytes.extend_from_slice(&value.to_le_bytes()));
}

/// Reads the output of [`write_numbers`] and advances past it.
pub(super) fn read_numbers(bytes: &mut &[u8]) -> Result<Vec<f64>, AnalysisError> {
    let (head, rest) = bytes.split_first_chunk::<8>().ok_or(AnalysisError::NotAnAccumulator)?;
    let length = usize::try_from(u64::from_le_bytes(*head)).map_err(|_| AnalysisError::NotAnAccumulator)?;
    let end =
        length.checked_mul(8).filter(|&end| end <= rest.len()).ok_or(AnalysisError::NotAnAccumulator)?;
    let numbers = rest[..end].as_chunks::<8>().0.iter().map(|chunk| f64::from_le_bytes(*chunk)).collect();
    *bytes = &rest[end..];
    Ok(numbers)
}
