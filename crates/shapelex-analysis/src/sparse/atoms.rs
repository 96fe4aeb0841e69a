//! Atoms of a dictionary with their Gram matrix.

use shapelex_numeric::dense::{Matrix, transpose_multiply_columns};
use shapelex_numeric::kernels::{add_columns, column, dot};
use shapelex_numeric::parallel;

/// Columns of the Gram matrix that are formed in one product: some for every thread, in the same way for any number of
/// threads.
const STRIP: usize = 128;

/// Atoms, each a block `U_j` of `b` columns with `n` whitened numbers, with their Gram matrix.
///
/// The columns of a block are orthonormal up to a common factor, `U_jᵀU_j = s_j I` with `0 ≤ s_j ≤ 1`: dictionary atoms
/// lie in the unit ball, and an atom with `s_j = 0` is dead. A single column (`b = 1`) is always such a block.
#[derive(Debug, Clone)]
pub struct Atoms {
    matrix: Matrix,
    gram: Matrix,
    block: usize,
    /// `s_j`.
    energies: Vec<f64>,
}

impl Atoms {
    /// Wraps whitened atoms of one column each (`n × J`). Cost `O(nJ²)`.
    pub fn new(matrix: Matrix) -> Self {
        Self::blocks(matrix, 1)
    }

    /// Wraps whitened atoms of `block ≥ 1` consecutive columns each (`n × Jb`), orthonormal up to a factor within each block.
    /// Cost `O(nJ²b²)`.
    ///
    /// Certificates hold for any columns. Convergence of the codes, and the choices of a pursuit, rely on the orthogonality.
    ///
    /// # Panics
    /// If the number of columns is not a multiple of `block`.
    pub fn blocks(matrix: Matrix, block: usize) -> Self {
        assert!(block > 0 && matrix.ncols().is_multiple_of(block), "columns of whole blocks");
        let gram = gram(&matrix);
        let energy =
            |j: usize| (j * block..(j + 1) * block).map(|i| gram[(i, i)]).sum::<f64>() / block as f64;
        let energies: Vec<f64> = (0..matrix.ncols() / block).map(energy).collect();
        Self { matrix, gram, block, energies }
    }

    /// The atoms as a matrix, `n × Jb`.
    pub fn matrix(&self) -> &Matrix {
        &self.matrix
    }

    /// The Gram matrix `DᵀD`.
    pub fn gram(&self) -> &Matrix {
        &self.gram
    }

    /// Number of atoms, `J`.
    pub fn len(&self) -> usize {
        self.energies.len()
    }

    /// Number of columns of an atom, `b`.
    pub fn block(&self) -> usize {
        self.block
    }

    /// Whether there are no atoms.
    pub fn is_empty(&self) -> bool {
        self.energies.is_empty()
    }

    /// `max_j ‖U_jᵀx‖`: for penalties from this value on, the group lasso code of `x` is zero, and so is the lasso code.
    pub fn lambda_max(&self, x: &[f64]) -> f64 {
        let correlation = |i: usize| dot(column(&self.matrix, i), x);
        let squared = |j: usize| (j * self.block..(j + 1) * self.block).map(|i| correlation(i).powi(2)).sum();
        (0..self.len()).map(squared).fold(0.0, f64::max).sqrt()
    }

    /// `J·b`.
    pub(super) fn columns(&self) -> usize {
        self.matrix.ncols()
    }

    /// `s_j`, the squared norm of the columns of block `j`.
    pub(super) fn energies(&self) -> &[f64] {
        &self.energies
    }

    /// `residual ← Dᵀx − DᵀD code`, where `code` has one number per column.
    pub(super) fn residual(&self, correlations: &[f64], code: &[f64], residual: &mut Vec<f64>) {
        residual.clear();
        residual.extend_from_slice(correlations);
        let mut used = code.iter().enumerate().filter(|(_, value)| **value != 0.0);
        loop {
            // Four columns at a time: the number that one pass over the residual handles.
            let (mut columns, mut factors, mut count) = ([0; 4], [0.0; 4], 0);
            for (j, value) in used.by_ref().take(4) {
                (columns[count], factors[count]) = (j, -value);
                count += 1;
            }
            add_columns(residual, self.gram.as_slice(), &columns[..count], &factors[..count]);
            if count < 4 {
                return;
            }
        }
    }
}

/// `DᵀD`.
fn gram(matrix: &Matrix) -> Matrix {
    let (n, columns) = matrix.shape();
    let strips: Vec<&[f64]> = matrix.as_slice().chunks((n * STRIP).max(1)).collect();
    let strips = parallel::map(strips.len(), &|k| transpose_multiply_columns(matrix, strips[k]));
    let mut entries = Vec::with_capacity(columns * columns);
    strips.iter().for_each(|strip| entries.extend_from_slice(strip.as_slice()));
    entries.resize(columns * columns, 0.0);
    Matrix::from_vec(columns, columns, entries)
}
