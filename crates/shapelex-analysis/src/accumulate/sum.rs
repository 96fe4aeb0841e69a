//! Sums over the shapes of a source.

use rayon::prelude::*;

use super::source::{BLOCK, PART, ShapeSource, Shapes};
use crate::AnalysisError;
use crate::pass::{Pass, Sum};

/// Approximate limit on the memory of all partial sums in flight, in bytes.
const PARTIAL_BYTES: usize = 256 << 20;

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
