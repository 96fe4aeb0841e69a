//! Sums over the shapes of a source.

use rayon::prelude::*;

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

/// Sum over all shapes of `source`, its units in parallel. `empty` creates an accumulator.
///
/// # Errors
/// The first error of the source or of an update.
pub fn accumulate<S: ShapeSource, A: Accumulator>(source: &S, empty: impl Fn() -> A) -> Result<A, S::Error> {
    let (mut total, mut part, mut open) = (empty(), empty(), None);
    let unit = total.unit();
    source.for_each_batch(&mut |batch| {
        for pieces in pieces(batch, unit).chunks(TOGETHER) {
            // The first piece may continue a unit.
            let begin = |&piece| (piece, open.take().unwrap_or_else(&empty));
            let begun: Vec<(Shapes<'_>, A)> = pieces.iter().map(begin).collect();
            let update = |(piece, mut sum): (Shapes<'_>, A)| sum.update(piece).map(|()| sum);
            let sums: Vec<Result<A, AnalysisError>> = begun.into_par_iter().map(update).collect();
            for (piece, sum) in pieces.iter().zip(sums) {
                if piece.first.is_multiple_of(PART) {
                    total.merge(std::mem::replace(&mut part, empty()));
                }
                let end = piece.first + piece.weights.len();
                if end.is_multiple_of(unit) { part.merge(sum?) } else { open = Some(sum?) }
            }
        }
        Ok(())
    })?;
    open.into_iter().for_each(|sum| part.merge(sum));
    total.merge(part);
    Ok(total)
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

/// Sum over all shapes of `source`: merged from distributed parts if the source distributes them, else made by `here`.
///
/// # Errors
/// Those of the source and of `here`.
pub(crate) fn accumulate_spread<S: ShapeSource, A: Accumulator>(
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
