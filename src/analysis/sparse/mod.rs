//! Sparse codes of shapes in the atoms of a dictionary.
//!
//! ```text
//! lasso                          min_α ½‖x − Dα‖² + λ‖α‖₁     (and α ≥ 0, when wanted)
//! orthogonal matching pursuit    min_α ½‖x − Dα‖²  over supports that grow by the best correlated atom
//! ```
//!
//! in whitened coordinates (`n = d·N` rows), where norms are `L₂` norms of shapes. Everything after the correlations
//! `Dᵀx` happens in the Gram matrix `DᵀD`: a batch of shapes costs one product with the atoms.
//!
//! * [`Atoms`] — the atoms with their Gram matrix;
//! * [`Lasso`] — codes to a duality gap, and the whole regularisation path;
//! * [`Pursuit`] — codes with a given number of atoms.
//!
//! Source: Schmitter 2017, (4.27) with the square that Theorem 3 misses.

mod lasso;
mod pursuit;

pub use lasso::{Knot, Lasso};
pub use pursuit::Pursuit;

use rayon::prelude::*;

use super::AnalysisError;
use super::metric::dot;
use crate::numeric::dense::{Matrix, transpose_multiply};

/// Atoms, one a column of `n` whitened numbers, with their Gram matrix.
#[derive(Debug, Clone)]
pub struct Atoms {
    matrix: Matrix,
    gram: Matrix,
}

/// Shapes whose correlations are formed in one product.
const BATCH: usize = 512;

impl Atoms {
    /// From whitened atoms (`n × J`). Cost `O(nJ²)`.
    pub fn new(matrix: Matrix) -> Self {
        let gram = transpose_multiply(&matrix, &matrix);
        Self { matrix, gram }
    }

    /// `n × J`.
    pub fn matrix(&self) -> &Matrix {
        &self.matrix
    }

    /// `DᵀD`.
    pub fn gram(&self) -> &Matrix {
        &self.gram
    }

    /// `J`.
    pub fn len(&self) -> usize {
        self.matrix.ncols()
    }

    /// Whether there are no atoms.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// `‖Dᵀx‖_∞`: from this penalty on the lasso code of `x` is zero.
    pub fn lambda_max(&self, x: &[f64]) -> f64 {
        self.matrix.column_iter().map(|atom| dot(atom.as_slice(), x).abs()).fold(0.0, f64::max)
    }

    /// Codes of whitened `shapes` (`n` numbers each), in order, with the same bits on any number of threads.
    ///
    /// # Errors
    /// Of the first shape that has one.
    fn each(
        &self,
        shapes: &[f64],
        code: impl Fn(&Signal<'_>) -> Result<SparseCode, AnalysisError> + Sync,
    ) -> Result<Vec<SparseCode>, AnalysisError> {
        let n = self.matrix.nrows();
        let batch = |batch: &[f64]| -> Result<Vec<SparseCode>, AnalysisError> {
            let columns = Matrix::from_column_slice(n, batch.len() / n, batch);
            let correlations = transpose_multiply(&self.matrix, &columns);
            let signals = batch.chunks_exact(n).zip(correlations.column_iter());
            signals
                .map(|(x, correlations)| {
                    code(&Signal { correlations: correlations.as_slice(), energy: dot(x, x) })
                })
                .collect()
        };
        let batches: Result<Vec<Vec<SparseCode>>, AnalysisError> =
            shapes.par_chunks(n * BATCH).map(batch).collect();
        Ok(batches?.into_iter().flatten().collect())
    }

    /// The code with its reconstruction error, from `Σ_j α_j d_j` of the atoms at `indices`.
    fn measured(
        &self,
        signal: &Signal<'_>,
        indices: Vec<usize>,
        values: Vec<f64>,
        lambda: f64,
    ) -> SparseCode {
        // ‖x − Dα‖² = ‖x‖² − αᵀ(Dᵀx + Dᵀr)
        let residual = self.residual_correlations(signal, &indices, &values);
        let explained: f64 = indices
            .iter()
            .zip(&values)
            .map(|(&j, value)| value * (signal.correlations[j] + residual[j]))
            .sum();
        let error = (signal.energy - explained).max(0.0);
        let penalty = lambda * values.iter().map(|value| value.abs()).sum::<f64>();
        SparseCode {
            indices,
            values,
            objective: 0.5 * error + penalty,
            duality_gap: None,
            relative_error: if signal.energy > 0.0 { (error / signal.energy).sqrt() } else { 0.0 },
        }
    }

    /// `Dᵀ(x − Dα)`.
    fn residual_correlations(&self, signal: &Signal<'_>, indices: &[usize], values: &[f64]) -> Vec<f64> {
        let mut residual = signal.correlations.to_vec();
        for (&j, &value) in indices.iter().zip(values) {
            let column = self.gram.column(j);
            residual.iter_mut().zip(column.iter()).for_each(|(r, g)| *r -= value * g);
        }
        residual
    }
}

/// What a code depends on.
#[derive(Debug, Clone, Copy)]
struct Signal<'a> {
    /// `Dᵀx`.
    correlations: &'a [f64],
    /// `‖x‖²`.
    energy: f64,
}

/// A sparse code with its certificate.
#[derive(Debug, Clone, PartialEq)]
pub struct SparseCode {
    /// Atoms that are used, ascending.
    pub indices: Vec<usize>,
    /// Their coefficients.
    pub values: Vec<f64>,
    /// `½‖x − Dα‖² + λ‖α‖₁`, without the penalty for a pursuit.
    pub objective: f64,
    /// Primal minus dual value of the lasso: the objective is at most this far above the minimum.
    pub duality_gap: Option<f64>,
    /// `‖x − Dα‖/‖x‖`.
    pub relative_error: f64,
}

impl SparseCode {
    /// The coefficients of all `atoms` atoms.
    pub fn dense(&self, atoms: usize) -> Vec<f64> {
        let mut dense = vec![0.0; atoms];
        self.indices.iter().zip(&self.values).for_each(|(&j, &value)| dense[j] = value);
        dense
    }
}

/// Indices in ascending order with their values, without zeros.
fn ascending(indices: &[usize], values: &[f64]) -> (Vec<usize>, Vec<f64>) {
    let mut pairs: Vec<(usize, f64)> =
        indices.iter().copied().zip(values.iter().copied()).filter(|(_, value)| *value != 0.0).collect();
    pairs.sort_by_key(|(index, _)| *index);
    pairs.into_iter().unzip()
}
