//! Sums over the shapes of a source.

use shapelex_numeric::parallel;

use super::source::{PART, ShapeSource, Shapes};
use crate::AnalysisError;
use crate::pass::{Pass, Sum};

/// A sum over shapes that merges by addition: across threads, chunks of a job and machines.
pub trait Accumulator: Sized + Send {
    /// Number of shapes that are summed before sums merge: a divisor of [`PART`] and a multiple of
    /// [`BLOCK`](super::BLOCK). Part of the definition of a sum, as its last bits depend on it.
    fn unit(&self) -> usize;

    /// Adds the shapes. Several calls give the bits of one if all but the last add multiples of [`BLOCK`](super::BLOCK) shapes.
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

/// Maximum number of units that are summed before they merge.
const TOGETHER: usize = 64;

/// Sums that merge to one of the next level: parts to groups of 64 parts, groups to groups of groups. Part of the definition of
/// every result over more than `64·PART` = 524 288 shapes.
pub const FAN_IN: usize = 64;

/// The sum over parts as a tree of fan-in [`FAN_IN`], which depends on their numbers alone: engines on many machines merge
/// groups where they are, and pass on one sum for each.
#[derive(Debug)]
pub(crate) struct PartTree<A, E, M> {
    /// The open group of every level, and how many sums it holds.
    levels: Vec<(A, usize)>,
    empty: E,
    merge: M,
}

impl<A, E: Fn() -> A, M: Fn(&mut A, A)> PartTree<A, E, M> {
    /// No parts. `empty` makes a sum of nothing, `merge` adds the second sum to the first.
    pub(crate) fn new(empty: E, merge: M) -> Self {
        Self { levels: Vec::new(), empty, merge }
    }

    /// Adds the sum of the next part.
    pub(crate) fn push(&mut self, mut sum: A) {
        for level in 0.. {
            if level == self.levels.len() {
                self.levels.push(((self.empty)(), 0));
            }
            let (group, held) = &mut self.levels[level];
            (self.merge)(group, sum);
            *held += 1;
            if *held < FAN_IN {
                return;
            }
            *held = 0;
            sum = std::mem::replace(group, (self.empty)());
        }
    }

    /// The sum over all parts: the open group of a level is the last of the next one. No parts are left.
    pub(crate) fn finish(&mut self) -> A {
        let mut below = None;
        for (mut group, held) in self.levels.drain(..) {
            let any = held > 0 || below.is_some();
            below.into_iter().for_each(|sum| (self.merge)(&mut group, sum));
            below = any.then_some(group);
        }
        below.unwrap_or_else(&self.empty)
    }
}

/// Sum over all shapes of `source`, its units in parallel. `empty` creates an accumulator.
///
/// # Errors
/// The first error of the source or of an update.
pub fn accumulate<A: Accumulator>(
    source: &dyn ShapeSource,
    empty: impl Fn() -> A,
) -> Result<A, AnalysisError> {
    accumulate_all(source, &empty)
}

fn accumulate_all<A: Accumulator>(
    source: &dyn ShapeSource,
    empty: &dyn Fn() -> A,
) -> Result<A, AnalysisError> {
    let (mut parts, mut part, mut open) = (PartTree::new(empty, A::merge), None::<A>, None);
    let unit = empty().unit();
    source.for_each_batch(&mut |batch| {
        for pieces in pieces(batch, unit).chunks(TOGETHER) {
            // The first piece may continue a unit.
            let mut sums: Vec<(Shapes<'_>, A)> =
                pieces.iter().map(|piece| (*piece, open.take().unwrap_or_else(empty))).collect();
            let updated = parallel::map_each(&mut sums, &|(piece, sum)| sum.update(*piece));
            for ((piece, sum), updated) in sums.into_iter().zip(updated) {
                if piece.first.is_multiple_of(PART) {
                    part.take().into_iter().for_each(|part| parts.push(part));
                }
                updated?;
                let end = piece.first + piece.weights.len();
                if end.is_multiple_of(unit) {
                    part.get_or_insert_with(empty).merge(sum);
                } else {
                    open = Some(sum);
                }
            }
        }
        Ok(())
    })?;
    open.into_iter().for_each(|sum| part.get_or_insert_with(empty).merge(sum));
    part.into_iter().for_each(|part| parts.push(part));
    Ok(parts.finish())
}

/// The shapes, cut where units end.
fn pieces(mut shapes: Shapes<'_>, unit: usize) -> Vec<Shapes<'_>> {
    let mut pieces = Vec::with_capacity(shapes.weights.len() / unit + 2);
    while !shapes.weights.is_empty() {
        let (piece, rest) = shapes.split_at((unit - shapes.first % unit).min(shapes.weights.len()));
        pieces.push(piece);
        shapes = rest;
    }
    pieces
}

/// Serialised sums, merged in their order, serialised. Merging an empty sum with one that was serialised changes no bit of it, so
/// the sums of a group may arrive in any number of calls, each of which begins with the result of the one before.
///
/// # Errors
/// [`AnalysisError::NotAnAccumulator`].
pub(crate) fn merge_serialised<A: Accumulator>(
    sums: &[&[u8]],
    empty: impl Fn() -> A,
) -> Result<Vec<u8>, AnalysisError> {
    let mut group = empty();
    for bytes in sums {
        let mut sum = empty();
        sum.restore(bytes)?;
        group.merge(sum);
    }
    Ok(group.to_bytes())
}

/// Sum over all shapes of `source`: merged from distributed parts if the source distributes them, else made by `here`.
///
/// # Errors
/// Those of the source and of `here`.
pub(crate) fn accumulate_spread<A: Accumulator>(
    source: &dyn ShapeSource,
    sum: Sum,
    empty: impl Fn() -> A,
    here: impl FnOnce() -> Result<A, AnalysisError>,
) -> Result<A, AnalysisError> {
    let mut parts = PartTree::new(&empty, A::merge);
    let spread = source.spread(&Pass { aligned: None, sum }, &mut |bytes| {
        let mut part = empty();
        part.restore(bytes)?;
        parts.push(part);
        Ok(())
    })?;
    if spread { Ok(parts.finish()) } else { here() }
}

/// Writes a length and the numbers.
pub(crate) fn write_numbers(bytes: &mut Vec<u8>, numbers: &[f64]) {
    bytes.extend_from_slice(&(numbers.len() as u64).to_le_bytes());
    numbers.iter().for_each(|value| bytes.extend_from_slice(&value.to_le_bytes()));
}

/// Reads the output of [`write_numbers`] and advances past it.
pub(crate) fn read_numbers(bytes: &mut &[u8]) -> Result<Vec<f64>, AnalysisError> {
    let (head, rest) = bytes.split_first_chunk::<8>().ok_or(AnalysisError::NotAnAccumulator)?;
    let length = usize::try_from(u64::from_le_bytes(*head)).map_err(|_| AnalysisError::NotAnAccumulator)?;
    let end =
        length.checked_mul(8).filter(|&end| end <= rest.len()).ok_or(AnalysisError::NotAnAccumulator)?;
    let numbers = rest[..end].as_chunks::<8>().0.iter().map(|chunk| f64::from_le_bytes(*chunk)).collect();
    *bytes = &rest[end..];
    Ok(numbers)
}
