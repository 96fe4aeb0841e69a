//! Batches of codes, one shape after the other with memory that is used again.

use super::atoms::Atoms;
use super::code::{Signal, SparseCode};
use crate::AnalysisError;
use shapelex_numeric::dense::transpose_multiply_columns;
use shapelex_numeric::kernels::{column, dot};
use shapelex_numeric::parallel;

/// Shapes whose correlations are formed in one product: few enough that small sets use all threads. Part of the
/// definition of a code: changing it changes last bits.
const BATCH: usize = 64;

/// A coder of whitened shapes, given one after the other with `n` numbers each.
///
/// Codes come in the order of the shapes, and their bits do not depend on the number of threads.
pub trait Encode {
    /// The codes of `shapes`, from the `previous` ones (by position) where there are any.
    ///
    /// # Errors
    /// [`AnalysisError::NoConvergence`] with the position of the first shape whose code does not reach its tolerance, and
    /// the gap that was reached.
    fn encode(
        &self,
        atoms: &Atoms,
        shapes: &[f64],
        previous: Option<&[SparseCode]>,
    ) -> Result<Vec<SparseCode>, AnalysisError>;

    /// The codes of `shapes`.
    ///
    /// # Errors
    /// As for [`Self::encode`].
    fn codes(&self, atoms: &Atoms, shapes: &[f64]) -> Result<Vec<SparseCode>, AnalysisError> {
        self.encode(atoms, shapes, None)
    }

    /// As [`Self::codes`], for codes near the `previous` ones, as between epochs of learning. A penalised code starts from
    /// the previous one, with the same certificate; a pursuit starts afresh.
    ///
    /// # Errors
    /// As for [`Self::encode`].
    fn codes_from(
        &self,
        atoms: &Atoms,
        shapes: &[f64],
        previous: &[SparseCode],
    ) -> Result<Vec<SparseCode>, AnalysisError> {
        self.encode(atoms, shapes, Some(previous))
    }
}

impl<Single: EncodeOne> Encode for Single {
    fn encode(
        &self,
        atoms: &Atoms,
        shapes: &[f64],
        previous: Option<&[SparseCode]>,
    ) -> Result<Vec<SparseCode>, AnalysisError> {
        self.encode_all(atoms, shapes, previous)
    }
}

/// Codes one shape after the other with memory that is used again.
pub(super) trait EncodeOne: Sync {
    /// Buffers kept from shape to shape; no result depends on their content.
    type Work: Default;

    /// The code of one shape, from its `previous` one where there is one.
    fn code(
        &self,
        atoms: &Atoms,
        signal: &Signal<'_>,
        previous: Option<&SparseCode>,
        work: &mut Self::Work,
    ) -> Result<SparseCode, AnalysisError>;

    /// Codes of whitened `shapes` in order.
    ///
    /// # Errors
    /// Of the first shape that has one, with its position.
    fn encode_all(
        &self,
        atoms: &Atoms,
        shapes: &[f64],
        previous: Option<&[SparseCode]>,
    ) -> Result<Vec<SparseCode>, AnalysisError> {
        let length = atoms.matrix().nrows() * BATCH;
        let batches: Vec<&[f64]> = shapes.chunks(length.max(1)).collect();
        let batches =
            parallel::map(batches.len(), &|i| self.encode_batch(atoms, batches[i], i * BATCH, previous));
        concatenated(batches, atoms, shapes)
    }

    /// The codes of a batch whose first shape is at position `first`.
    fn encode_batch(
        &self,
        atoms: &Atoms,
        batch: &[f64],
        first: usize,
        previous: Option<&[SparseCode]>,
    ) -> Result<Vec<SparseCode>, AnalysisError> {
        let correlations = transpose_multiply_columns(atoms.matrix(), batch);
        let mut work = Self::Work::default();
        let code = |(k, x): (usize, &[f64])| {
            let signal = Signal { correlations: column(&correlations, k), energy: dot(x, x) };
            let previous = previous.and_then(|codes| codes.get(first + k));
            self.code(atoms, &signal, previous, &mut work).map_err(|error| error.at(first + k))
        };
        batch.chunks_exact(atoms.matrix().nrows()).enumerate().map(code).collect()
    }
}

fn concatenated(
    batches: impl IntoIterator<Item = Result<Vec<SparseCode>, AnalysisError>>,
    atoms: &Atoms,
    shapes: &[f64],
) -> Result<Vec<SparseCode>, AnalysisError> {
    let mut codes = Vec::with_capacity(shapes.len() / atoms.matrix().nrows().max(1));
    for batch in batches {
        codes.extend(batch?);
    }
    Ok(codes)
}
