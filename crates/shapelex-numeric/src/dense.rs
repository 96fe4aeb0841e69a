//! Dense kernels: symmetric rank-k update, matrix products, symmetric eigenproblems.
//!
//! This is the only module that depends on the linear algebra library. Kernels run on one thread. Callers run chunks in
//! parallel instead, which stays fast on a busy machine and makes results independent of the number of threads.

use faer::linalg::matmul::triangular::{self, BlockStructure};
use faer::linalg::solvers::{Llt, PartialPivLu};
use faer::linalg::triangular_solve::solve_upper_triangular_in_place;
use faer::prelude::{ReborrowMut, Solve};
use faer::{Accum, MatMut, MatRef, Par, Side};
use nalgebra::{DMatrix, DVector, Dyn, SVD, SymmetricEigen};

use super::NumericError;
use super::operator::SymmetricOperator;

/// Column-major dense matrix.
pub type Matrix = DMatrix<f64>;
/// Dense vector.
pub type Vector = DVector<f64>;

fn view(m: &Matrix) -> MatRef<'_, f64> {
    MatRef::from_column_major_slice(m.as_slice(), m.nrows(), m.ncols())
}

fn view_mut(m: &mut Matrix) -> MatMut<'_, f64> {
    let (rows, columns) = m.shape();
    MatMut::from_column_major_slice_mut(m.as_mut_slice(), rows, columns)
}

/// Columns of `X` in one product of [`add_outer_products`]. Changing it changes last bits.
pub const PANEL: usize = 128;

/// Number of strips of large matrices, and minimum width of a strip.
const STRIPS: (usize, usize) = (8, 32);

/// Neighbouring columns of a square matrix.
#[derive(Debug)]
pub struct Strip<'a> {
    /// Rows of the matrix.
    n: usize,
    /// Position of the first column.
    first: usize,
    columns: &'a mut [f64],
}

/// Splits a square matrix into at most 8 strips of equal width; the last one may be narrower.
pub fn strips(s: &mut Matrix) -> impl DoubleEndedIterator<Item = Strip<'_>> + ExactSizeIterator {
    let n = s.nrows();
    let width = n.div_ceil(STRIPS.0).next_multiple_of(8).max(STRIPS.1);
    let columns = s.as_mut_slice().chunks_mut((n * width).max(1));
    columns.enumerate().map(move |(i, columns)| Strip { n, first: i * width, columns })
}

impl Strip<'_> {
    /// Lower triangle of `S ← S + factor X Xᵀ` within this strip of `S`, as by [`add_outer_products`].
    pub fn add_outer_products(&mut self, columns: &[f64], factor: f64) {
        let (n, width) = (self.n, self.columns.len() / self.n);
        let rows = n - self.first;
        let mut strip =
            MatMut::from_column_major_slice_mut(self.columns, n, width).subrows_mut(self.first, rows);
        for panel in columns.chunks(n * PANEL) {
            let x = MatRef::from_column_major_slice(panel, n, panel.len() / n).subrows(self.first, rows);
            faer::linalg::matmul::matmul(
                strip.rb_mut(),
                Accum::Add,
                x,
                x.subrows(0, width).transpose(),
                factor,
                Par::Seq,
            );
        }
    }
}

/// Lower triangle of `s ← s + factor X Xᵀ`; `columns` holds `X` (`n × k`, column-major), `s` is `n × n`.
///
/// The columns of `X` are multiplied in panels of [`PANEL`], in order: several calls give the bits of one if all but the last
/// add whole panels. Cost: `n² k / 2` multiply-adds. The upper triangle of `s` is left with
/// values without meaning.
pub fn add_outer_products(s: &mut Matrix, columns: &[f64], factor: f64) {
    strips(s).for_each(|mut strip| strip.add_outer_products(columns, factor));
}

/// `XᵀX` of the `n × k` matrix stored in `columns`, with both triangles filled.
pub fn gram(columns: &[f64], n: usize) -> Matrix {
    let k = columns.len() / n.max(1);
    let x = MatRef::from_column_major_slice(columns, n, k);
    let mut g = Matrix::zeros(k, k);
    triangular::matmul(
        view_mut(&mut g),
        BlockStructure::TriangularLower,
        Accum::Replace,
        x.transpose(),
        BlockStructure::Rectangular,
        x,
        BlockStructure::Rectangular,
        1.0,
        Par::Seq,
    );
    fill_upper(&mut g);
    g
}

/// Copies the strict lower triangle to the upper one.
pub fn fill_upper(s: &mut Matrix) {
    for column in 1..s.ncols() {
        for row in 0..column {
            s[(row, column)] = s[(column, row)];
        }
    }
}

/// `A B`.
pub fn multiply(a: &Matrix, b: &Matrix) -> Matrix {
    let mut c = Matrix::zeros(a.nrows(), b.ncols());
    faer::linalg::matmul::matmul(view_mut(&mut c), Accum::Replace, view(a), view(b), 1.0, Par::Seq);
    c
}

/// `C ← C + X B`; `columns` holds `X` (column-major).
pub fn add_product(c: &mut Matrix, columns: &[f64], b: &Matrix) {
    let x = MatRef::from_column_major_slice(columns, c.nrows(), b.nrows());
    faer::linalg::matmul::matmul(view_mut(c), Accum::Add, x, view(b), 1.0, Par::Seq);
}

/// `AᵀB`.
pub fn transpose_multiply(a: &Matrix, b: &Matrix) -> Matrix {
    transpose_multiply_view(a, view(b))
}

/// `AᵀX`; `columns` holds `X` (`n × k`, column-major, `n > 0`).
pub fn transpose_multiply_columns(a: &Matrix, columns: &[f64]) -> Matrix {
    let n = a.nrows();
    transpose_multiply_view(a, MatRef::from_column_major_slice(columns, n, columns.len() / n.max(1)))
}

fn transpose_multiply_view(a: &Matrix, x: MatRef<'_, f64>) -> Matrix {
    let mut c = Matrix::zeros(a.ncols(), x.ncols());
    let at = view(a).transpose();
    faer::linalg::matmul::matmul(view_mut(&mut c), Accum::Replace, at, x, 1.0, Par::Seq);
    c
}

/// The Cholesky factor of a symmetric positive definite matrix.
#[derive(Debug)]
pub struct Definite {
    factor: Llt<f64>,
    independence: f64,
}

impl Definite {
    /// Factors the matrix in the lower triangle of `s`. Cost `n³/3`.
    ///
    /// # Errors
    /// [`NumericError::NotPositiveDefinite`] if the factorisation fails.
    pub fn new(s: &Matrix) -> Result<Self, NumericError> {
        let failure = |smallest| NumericError::NotPositiveDefinite { size: s.nrows(), smallest };
        let factor = view(s).llt(Side::Lower).map_err(|_| failure(0.0))?;
        let pivot = |i: usize| factor.L()[(i, i)].powi(2) / s[(i, i)];
        let independence = (0..s.nrows()).map(pivot).fold(1.0, f64::min);
        // A pivot that is not a number counts as a failure.
        if independence > 0.0 { Ok(Self { factor, independence }) } else { Err(failure(independence)) }
    }

    /// Smallest ratio of a pivot to its diagonal entry, as in [`super::banded::Banded::independence`].
    pub fn independence(&self) -> f64 {
        self.independence
    }

    /// `S⁻¹ right`.
    pub fn solve(&self, right: &Matrix) -> Matrix {
        let solution = self.factor.solve(view(right));
        Matrix::from_fn(right.nrows(), right.ncols(), |i, j| solution[(i, j)])
    }
}

/// A dense symmetric positive definite operator, with its Cholesky factor: `R = Lᵀ`.
#[derive(Debug)]
pub struct DenseOperator {
    matrix: Matrix,
    factor: Llt<f64>,
}

impl DenseOperator {
    /// Factors `matrix`. Cost `n³/3`.
    ///
    /// # Errors
    /// [`NumericError::NotPositiveDefinite`] if the factorisation fails.
    pub fn new(matrix: Matrix) -> Result<Self, NumericError> {
        let Definite { factor, .. } = Definite::new(&matrix)?;
        Ok(Self { matrix, factor })
    }

    /// The matrix.
    pub fn matrix(&self) -> &Matrix {
        &self.matrix
    }

    fn columns<'a>(&self, data: &'a mut [f64]) -> MatMut<'a, f64> {
        let n = self.matrix.nrows();
        let count = data.len() / n.max(1);
        MatMut::from_column_major_slice_mut(data, n, count)
    }
}

impl SymmetricOperator for DenseOperator {
    fn size(&self) -> usize {
        self.matrix.nrows()
    }

    fn apply(&self, data: &mut [f64]) {
        let before = data.to_vec();
        let x = MatRef::from_column_major_slice(&before, self.size(), before.len() / self.size().max(1));
        let out = self.columns(data);
        faer::linalg::matmul::matmul(out, Accum::Replace, view(&self.matrix), x, 1.0, Par::Seq);
    }

    fn solve(&self, data: &mut [f64]) {
        self.factor.solve_in_place(self.columns(data));
    }

    fn whiten(&self, data: &mut [f64]) {
        let before = data.to_vec();
        let x = MatRef::from_column_major_slice(&before, self.size(), before.len() / self.size().max(1));
        triangular::matmul(
            self.columns(data),
            BlockStructure::Rectangular,
            Accum::Replace,
            self.factor.L().transpose(),
            BlockStructure::TriangularUpper,
            x,
            BlockStructure::Rectangular,
            1.0,
            Par::Seq,
        );
    }

    fn unwhiten(&self, data: &mut [f64]) {
        solve_upper_triangular_in_place(self.factor.L().transpose(), self.columns(data), Par::Seq);
    }
}

/// LU factors of a square matrix that need not be symmetric.
#[derive(Debug)]
pub struct Square {
    factors: PartialPivLu<f64>,
}

/// Ratio of a pivot to the largest one below which the matrix is singular.
const SINGULAR: f64 = 1e-12;

impl Square {
    /// Factors the matrix; `None` if it is singular to working precision. Cost `2n³/3`.
    pub fn new(matrix: &Matrix) -> Option<Self> {
        let factors = view(matrix).partial_piv_lu();
        let pivots: Vec<f64> = (0..matrix.nrows()).map(|i| factors.U()[(i, i)].abs()).collect();
        let largest = pivots.iter().copied().fold(0.0, f64::max);
        pivots.iter().all(|pivot| *pivot > SINGULAR * largest).then_some(Self { factors })
    }

    /// `A⁻¹ right`.
    pub fn solve(&self, right: &Matrix) -> Matrix {
        let solution = self.factors.solve(view(right));
        Matrix::from_fn(right.nrows(), right.ncols(), |i, j| solution[(i, j)])
    }
}

/// Eigenpairs of a symmetric matrix: eigenvalues in descending order, orthonormal eigenvectors.
#[derive(Debug, Clone)]
pub struct Eigenpairs {
    /// Eigenvalues, `λ_1 ≥ λ_2 ≥ …`.
    pub values: Vec<f64>,
    /// One eigenvector per column, in the order of `values`.
    pub vectors: Matrix,
}

/// Maximum number of steps of [`iterate_subspace`]: enough for eigenvalues that fall by
/// a quarter behind the subspace, 0.75¹⁰⁰ < 10⁻¹¹.
const SUBSPACE_STEPS: usize = 100;

/// Relative residual at which a subspace counts as invariant. It guides a search; the mean itself is computed anew.
pub(crate) const SUBSPACE_RESIDUAL: f64 = 1e-11;

/// Orthonormal basis of the leading invariant subspace of a symmetric positive semi-definite operator, by subspace
/// iteration from the columns of `near`. For repeated problems that change little, this takes a few products.
/// `None` if the residual stays above `10⁻¹¹`.
pub fn iterate_subspace(apply: impl Fn(&Matrix) -> Matrix, near: &Matrix) -> Option<Matrix> {
    let mut basis = near.clone();
    for _ in 0..SUBSPACE_STEPS {
        let image = apply(&basis);
        let small = transpose_multiply(&basis, &image);
        let residual = (&image - multiply(&basis, &small)).norm();
        if !residual.is_finite() {
            return None;
        }
        if residual <= SUBSPACE_RESIDUAL * small.norm() {
            return Some(basis);
        }
        basis = image.qr().q();
    }
    None
}

/// Size up to which the full solver is faster than, or close to, the partial one.
pub const FULL_SOLVER_SIZE: usize = 96;

/// The `count` leading eigenpairs of the symmetric matrix in the lower triangle of `s`.
///
/// Small matrices, and requests for more than a quarter of the spectrum, use the full solver (`~10 n³`). Large ones use
/// a block Krylov iteration from a fixed start (`~n²` for each dimension of the space, at most `n/2` of them), with the full
/// solver as the fallback if it does not converge.
///
/// # Errors
/// [`NumericError::NoConvergence`] if the full solver fails (entries that are not finite).
pub fn leading_eigenpairs(s: &Matrix, count: usize) -> Result<Eigenpairs, NumericError> {
    let n = s.nrows();
    let count = count.min(n);
    if n > FULL_SOLVER_SIZE
        && count * 4 <= n
        && let Some(pairs) = krylov_eigenpairs(s, count)
    {
        return Ok(pairs);
    }
    full_eigenpairs(s, count)
}

pub(crate) fn full_eigenpairs(s: &Matrix, count: usize) -> Result<Eigenpairs, NumericError> {
    let n = s.nrows();
    // The library cannot decompose a matrix without entries.
    if count == 0 {
        return Ok(Eigenpairs { values: Vec::new(), vectors: Matrix::zeros(n, 0) });
    }
    let failure = NumericError::NoConvergence { size: n };
    if s.iter().any(|value| !value.is_finite()) {
        return Err(failure);
    }
    let eigen = view(s).self_adjoint_eigen(Side::Lower).map_err(|_| failure)?;
    let (ascending, u) = (eigen.S().column_vector(), eigen.U());
    let values = (0..count).map(|i| ascending[n - 1 - i]).collect();
    let vectors = Matrix::from_fn(n, count, |row, i| u[(row, n - 1 - i)]);
    Ok(Eigenpairs { values, vectors })
}

/// Most steps of the QR iterations of [`symmetric_eigen`] and [`svd`] for each row and column of the matrix. Two are usual.
const MAX_QR_STEPS: usize = 64;

/// All eigenpairs of a small symmetric matrix, in no order, by the QR iteration.
///
/// Blocks so much smaller than the matrix that their squares underflow can keep that iteration going, or end it with NaN. After
/// 64 steps for each row, or with a value that is not finite, the solver of [`leading_eigenpairs`] takes over. If an entry is not
/// finite, all values and vectors are NaN.
pub fn symmetric_eigen(s: &Matrix) -> SymmetricEigen<f64, Dyn> {
    let n = s.nrows();
    let finite = s.iter().all(|entry| entry.is_finite());
    let solved = finite.then(|| SymmetricEigen::try_new(s.clone(), f64::EPSILON, MAX_QR_STEPS * n));
    let solved = solved.flatten().filter(|eigen| eigen.eigenvalues.iter().all(|value| value.is_finite()));
    solved.unwrap_or_else(|| match full_eigenpairs(s, n) {
        Ok(Eigenpairs { values, vectors }) => {
            SymmetricEigen { eigenvalues: Vector::from_vec(values), eigenvectors: vectors }
        }
        Err(_) => SymmetricEigen {
            eigenvalues: Vector::from_element(n, f64::NAN),
            eigenvectors: Matrix::from_element(n, n, f64::NAN),
        },
    })
}

/// Singular values in descending order, with `U` and `Vᵀ` on request. `None` after 64 steps for each row and column, and if an
/// entry or a value is not finite.
pub fn svd(matrix: Matrix, u: bool, v: bool) -> Option<SVD<f64, Dyn, Dyn>> {
    let steps = MAX_QR_STEPS * (matrix.nrows() + matrix.ncols());
    let finite = matrix.iter().all(|entry| entry.is_finite());
    // The tolerance is the default of the library.
    let solved = finite.then(|| SVD::try_new(matrix, u, v, 5.0 * f64::EPSILON, steps)).flatten();
    solved.filter(|svd| svd.singular_values.iter().all(|value| value.is_finite()))
}

/// Columns of a block of [`krylov_eigenpairs`]: eigenvalues of up to this multiplicity are found without help from rounding.
const BLOCK: usize = 4;

/// Relative residual at which an eigenpair has converged.
const RITZ_RESIDUAL: f64 = 32.0 * f64::EPSILON;

/// Growth of the Krylov space between two small eigenproblems.
const RITZ_GROWTH: f64 = 1.3;

/// Block Lanczos iteration with full orthogonalisation and without restarts: `SQ = QT + Q'B` with the block tridiagonal `T`,
/// whose eigenpairs `(θ, y)` are those of `S` up to `‖By‖`. `None` if the `count` leading ones have not converged when the
/// space holds half of the dimensions.
///
/// Noise of the size of the rounding is added to each new block, so that it has full rank also where `SQ` is within `Q`.
///
/// Source: Golub and Van Loan, *Matrix Computations*, 4th edition, section 10.3.6.
fn krylov_eigenpairs(s: &Matrix, count: usize) -> Option<Eigenpairs> {
    // A power of two changes no digit, and keeps residuals far from underflow.
    let unit = power_of_two(largest_below(s))?;
    let mut full = s * (1.0 / unit);
    fill_upper(&mut full);
    krylov_eigenpairs_of(s.nrows(), unit, |x| multiply(&full, x), count)
}

/// The `count` leading eigenpairs of a symmetric positive semi-definite operator of size `n`, by the block Krylov iteration of
/// [`leading_eigenpairs`]; `size` is about its largest eigenvalue. The operator is applied to four columns at a time. `None` if the
/// iteration does not converge.
pub fn leading_eigenpairs_of(
    n: usize,
    size: f64,
    apply: impl Fn(&Matrix) -> Matrix,
    count: usize,
) -> Option<Eigenpairs> {
    let unit = power_of_two(size)?;
    krylov_eigenpairs_of(n, unit, |x| apply(x) / unit, count)
}

/// Eigenpairs of `unit · A`, for the operator `A` that `apply` applies.
fn krylov_eigenpairs_of(
    n: usize,
    unit: f64,
    apply: impl Fn(&Matrix) -> Matrix,
    count: usize,
) -> Option<Eigenpairs> {
    let mut noise = noise(n);
    let mut krylov = Krylov::new(noise());
    let mut next_solution = count + BLOCK;
    for _ in 0..n / 2 / BLOCK {
        let image = apply(&krylov.next);
        krylov.extend(image, noise());
        if krylov.size() < next_solution {
            continue;
        }
        next_solution = (krylov.size() as f64 * RITZ_GROWTH) as usize;
        if let Some(Eigenpairs { values, vectors }) = krylov.eigenpairs(count) {
            return Some(Eigenpairs { values: values.iter().map(|value| unit * value).collect(), vectors });
        }
    }
    None
}

/// A Krylov space of a symmetric matrix.
struct Krylov {
    /// Columns of `Q`, and the block that comes next.
    basis: Vec<f64>,
    next: Matrix,
    /// Diagonal blocks of `T`, and the blocks below them: the last one leads out of the space.
    diagonal: Vec<Matrix>,
    below: Vec<Matrix>,
}

impl Krylov {
    fn new(start: Matrix) -> Self {
        Self { basis: vec![], next: start.qr().q(), diagonal: vec![], below: vec![] }
    }

    fn size(&self) -> usize {
        self.diagonal.len() * BLOCK
    }

    /// Takes the next block, whose image under the matrix is `image`, into the space, and finds the one behind it.
    fn extend(&mut self, mut image: Matrix, noise: Matrix) {
        self.diagonal.push(transpose_multiply(&self.next, &image));
        self.basis.extend_from_slice(self.next.as_slice());
        image += noise * (f64::EPSILON * image.norm());
        // The second time takes out parts of the basis left by cancellation.
        let (once, first) = self.orthogonalise(image).qr().unpack();
        let (twice, second) = self.orthogonalise(once).qr().unpack();
        self.next = twice;
        self.below.push(second * first);
    }

    /// `X − QQᵀX`.
    fn orthogonalise(&self, mut x: Matrix) -> Matrix {
        let inside = transpose_multiply_columns(&x, &self.basis).transpose();
        add_product(&mut x, &self.basis, &-inside);
        x
    }

    /// The leading eigenpairs, if all have converged.
    fn eigenpairs(&self, count: usize) -> Option<Eigenpairs> {
        let m = self.size();
        let mut t = Matrix::zeros(m, m);
        for (i, (diagonal, below)) in self.diagonal.iter().zip(&self.below).enumerate() {
            let at = i * BLOCK;
            t.view_mut((at, at), (BLOCK, BLOCK)).copy_from(diagonal);
            if at + BLOCK < m {
                t.view_mut((at + BLOCK, at), (BLOCK, BLOCK)).copy_from(below);
            }
        }
        let Eigenpairs { values, vectors: y } = full_eigenpairs(&t, count).ok()?;
        let residuals = self.below.last()? * y.rows(m - BLOCK, BLOCK);
        let largest = residuals.column_iter().map(|residual| residual.norm()).fold(0.0, f64::max);
        (largest <= RITZ_RESIDUAL * values[0]).then(|| {
            let mut vectors = Matrix::zeros(self.basis.len() / m, count);
            add_product(&mut vectors, &self.basis, &y);
            Eigenpairs { values, vectors }
        })
    }
}

/// Largest magnitude of the lower triangle: not finite if an entry is not. The magnitudes of doubles are ordered as their bits.
fn largest_below(s: &Matrix) -> f64 {
    let (n, entries) = (s.nrows(), s.as_slice());
    // One loop for each column: the compiler does not vectorise a flattened one.
    let largest = |column: &[f64]| column.iter().fold(0, |most: u64, entry| most.max(entry.abs().to_bits()));
    f64::from_bits((0..n).map(|j| largest(&entries[j * n + j..(j + 1) * n])).max().unwrap_or(0))
}

/// The largest power of two up to `value`; `None` for zero, subnormal and infinite numbers, and NaN.
fn power_of_two(value: f64) -> Option<f64> {
    value.is_normal().then(|| f64::from_bits(value.abs().to_bits() & (0x7ff << 52)))
}

/// Fixed, structureless blocks, with columns of norms near 1. Results must not depend on ambient randomness, and a constant vector
/// would be an eigenvector of every circulant matrix.
fn noise(n: usize) -> impl FnMut() -> Matrix {
    let mut state = 0x9e37_79b9_7f4a_7c15_u64;
    let scale = (12.0 / n as f64).sqrt();
    move || {
        Matrix::from_fn(n, BLOCK, |_, _| {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            ((state >> 11) as f64 / (1u64 << 53) as f64 - 0.5) * scale
        })
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::operator::assert_operator_of;

    #[test]
    fn eigenvalues_of_blocks_that_underflow_beside_the_matrix_are_found() {
        for tiny in [1e-320, 1e-200, 1e-160, 1e-30] {
            let entry = |i: usize, j: usize| match (i, j) {
                (0, 0) => 1.0,
                (0, _) | (_, 0) => 0.0,
                _ if i.abs_diff(j) == 1 => tiny,
                _ => 0.0,
            };
            let s = Matrix::from_fn(7, 7, entry);
            let eigen = symmetric_eigen(&s);
            let back = &eigen.eigenvectors
                * Matrix::from_diagonal(&eigen.eigenvalues)
                * eigen.eigenvectors.transpose();
            assert!((back - &s).amax() < 1e-14, "{tiny}: {}", eigen.eigenvalues);
            let singular = svd(s, true, true);
            assert!(singular.is_none_or(|found| (found.singular_values[0] - 1.0).abs() < 1e-14), "{tiny}");
        }
    }

    #[test]
    fn a_matrix_that_is_not_finite_has_no_decomposition() {
        for wrong in [f64::NAN, f64::INFINITY] {
            let s = Matrix::from_fn(4, 4, |i, j| if i + j == 2 { wrong } else { 1.0 });
            assert!(symmetric_eigen(&s).eigenvalues.iter().all(|value| value.is_nan()));
            assert!(svd(s, true, true).is_none());
        }
    }

    pub(crate) fn covariance(n: usize, spectrum: impl Fn(usize) -> f64) -> Matrix {
        let raw = Matrix::from_fn(n, n, |i, j| ((i * 37 + j * 101 + i * j) as f64 * 0.7).sin());
        let q = raw.qr().q();
        let scaled = Matrix::from_fn(n, n, |i, j| q[(i, j)] * spectrum(j));
        multiply(&scaled, &q.transpose())
    }

    #[test]
    fn krylov_equals_full_also_for_multiple_eigenvalues() {
        for (n, spectrum) in [
            (150, (|i| 1.0 / (1.0 + i as f64).powi(2)) as fn(usize) -> f64),
            (200, |i| 1.0 / (1.0 + (i / 2) as f64)),
            (130, |i| if i < 8 { 10.0 - i as f64 } else { 0.0 }),
            (200, |i| 4.0 - (i / 3) as f64 / 100.0),
        ] {
            let s = covariance(n, spectrum);
            let full = full_eigenpairs(&s, 6).unwrap();
            let partial = leading_eigenpairs(&s, 6).unwrap();
            for i in 0..6 {
                assert!((full.values[i] - partial.values[i]).abs() < 1e-12, "{n}: {i}");
            }
            let p = multiply(&partial.vectors, &partial.vectors.transpose());
            let f = multiply(&full.vectors, &full.vectors.transpose());
            assert!((p - f).norm() < 1e-8, "n = {n}");
        }
    }

    /// Sums of random shapes and of their quarter turns: all eigenvalues are double and near to each other.
    #[test]
    fn no_copy_of_an_eigenvalue_of_a_flat_spectrum_is_missed() {
        let n = 512;
        let mut random = noise(n);
        let mut s = Matrix::zeros(n, n);
        for _ in 0..n / BLOCK {
            let x = random();
            let turned =
                Matrix::from_fn(
                    n,
                    BLOCK,
                    |i, j| if i < n / 2 { -x[(i + n / 2, j)] } else { x[(i - n / 2, j)] },
                );
            add_outer_products(&mut s, x.as_slice(), 1.0);
            add_outer_products(&mut s, turned.as_slice(), 1.0);
        }
        let full = full_eigenpairs(&s, 10).unwrap();
        let partial = krylov_eigenpairs(&s, 10).unwrap();
        for i in 0..10 {
            assert!((full.values[i] - partial.values[i]).abs() < 1e-13 * full.values[0], "{i}");
        }
    }

    /// Matrices on which Krylov iterations break down; the result is compared where there is one.
    #[test]
    fn the_iteration_ends_on_every_matrix() {
        let n = 130;
        let first = |i: usize, j: usize| f64::from(u8::from(i == 0 && j == 0));
        let same = |i: usize, j: usize| f64::from(u8::from(i == j));
        let wave = |i: usize| (0.3 * i as f64).sin();
        type Entry = Box<dyn Fn(usize, usize) -> f64>;
        let cases: Vec<(&str, Entry)> = vec![
            ("zero", Box::new(|_, _| 0.0)),
            ("identity", Box::new(same)),
            ("multiple", Box::new(move |i, j| 0.3 * same(i, j))),
            ("one entry", Box::new(first)),
            ("ones", Box::new(|_, _| 1.0)),
            ("projector", Box::new(move |i, j| if i < n / 2 { same(i, j) } else { 0.0 })),
            ("near identity", Box::new(move |i, j| same(i, j) + 1e-17 * wave(i) * wave(j))),
            ("small block", Box::new(move |i, j| if i.max(j) < 5 { 1.0 / (1 + i + j) as f64 } else { 0.0 })),
            (
                "small block apart",
                Box::new(move |i, j| if i.min(j) > 126 { 1.0 / (1 + i + j) as f64 } else { 0.0 }),
            ),
            ("two values", Box::new(move |i, j| same(i, j) * if i < 3 { 1.0 } else { 0.5 })),
            ("spike", Box::new(move |i, j| if i == j && i % 40 == 7 { 1e-9 } else { 0.0 })),
            ("rank one", Box::new(move |i, j| wave(i) * wave(j))),
            ("tiny", Box::new(move |i, j| 1e-300 * wave(i) * wave(j))),
            ("subnormal", Box::new(move |i, j| 1e-310 * wave(i) * wave(j))),
            ("huge", Box::new(move |i, j| 1e300 * wave(i) * wave(j))),
            ("wide", Box::new(move |i, j| 1e-150_f64.powi((i + j) as i32 / 130) * wave(i) * wave(j))),
            ("not a number", Box::new(move |i, j| if i + j == 9 { f64::NAN } else { same(i, j) })),
            ("infinite", Box::new(move |i, j| if i + j == 8 { f64::INFINITY } else { same(i, j) })),
        ];
        for (name, entry) in cases {
            let s = Matrix::from_fn(n, n, entry);
            let (send, receive) = std::sync::mpsc::channel();
            let (largest, full) = (s.amax(), full_eigenpairs(&s, 3).ok());
            let finite = s.iter().all(|entry| entry.is_finite());
            std::thread::spawn(move || send.send(leading_eigenpairs(&s, 3).ok()));
            let found = receive.recv_timeout(std::time::Duration::from_secs(60));
            let found = found.unwrap_or_else(|_| panic!("{name}: no end"));
            // The full solver fails where squares underflow.
            assert!(found.is_some() || full.is_none(), "{name}");
            assert!(found.is_none() || finite, "{name}");
            if let (Some(found), Some(full)) = (found, full) {
                let far = found.values.iter().zip(&full.values).map(|(a, b)| (a - b).abs());
                assert!(far.fold(0.0, f64::max) <= 1e-11 * n as f64 * largest, "{name}");
            }
        }
    }

    #[test]
    fn outer_products_fill_the_lower_triangle() {
        let x = Matrix::from_fn(5, 7, |i, j| (i as f64 + 1.3) * (j as f64 - 2.0).cos());
        let mut s = Matrix::zeros(5, 5);
        add_outer_products(&mut s, x.as_slice(), 1.0);
        fill_upper(&mut s);
        assert!((s - &x * x.transpose()).norm() < 1e-13);
        assert!((gram(x.as_slice(), 5) - x.transpose() * &x).norm() < 1e-13);
        assert!((transpose_multiply(&x, &x) - x.transpose() * &x).norm() < 1e-13);
    }

    #[test]
    fn products_of_nothing_keep_their_shape() {
        let (none, columns) = (Matrix::zeros(0, 3), Matrix::zeros(0, 5));
        assert_eq!(transpose_multiply(&none, &columns), Matrix::zeros(3, 5));
        assert_eq!(multiply(&none.transpose(), &columns), Matrix::zeros(3, 5));
    }

    #[test]
    fn entries_that_are_not_finite_are_an_error() {
        let s = Matrix::from_element(3, 3, f64::NAN);
        assert!(leading_eigenpairs(&s, 1).is_err());
    }

    #[test]
    fn outer_products_are_summed_in_strips_and_panels() {
        for n in [1, 7, 33, 64, 300] {
            for k in [0, 1, PANEL, 3 * PANEL + 5] {
                let x = Matrix::from_fn(n, k, |i, j| ((i * 31 + j * 17) % 23) as f64 - 11.0);
                let mut s = Matrix::from_element(n, n, 0.5);
                add_outer_products(&mut s, x.as_slice(), 2.0);
                // Whole numbers, so there is no rounding.
                let wanted = &x * x.transpose() * 2.0;
                for j in 0..n {
                    assert!((j..n).all(|i| s[(i, j)] == wanted[(i, j)] + 0.5), "{n} x {k}, column {j}");
                }
                let mut parts = Matrix::from_element(n, n, 0.5);
                x.as_slice().chunks(n * 2 * PANEL).for_each(|part| add_outer_products(&mut parts, part, 2.0));
                assert!((0..n).all(|j| (j..n).all(|i| parts[(i, j)] == s[(i, j)])));
            }
        }
    }

    #[test]
    fn dense_operators_have_the_root_of_their_factor() {
        let matrix = covariance(7, |i| 1.0 + i as f64);
        let operator = DenseOperator::new(matrix.clone()).unwrap();
        assert_operator_of(&operator, |i, j| matrix[(i, j)], 1e-12);
    }

    #[test]
    fn square_matrices_are_solved_unless_they_are_singular() {
        let matrix =
            Matrix::from_fn(5, 5, |i, j| ((3 * i + j * j) as f64).sin() + if i == j { 2.0 } else { 0.0 });
        let wanted = Matrix::from_fn(5, 2, |i, j| (i + 2 * j) as f64);
        let found = Square::new(&matrix).unwrap().solve(&(&matrix * &wanted));
        assert!((found - wanted).amax() < 1e-13);
        assert!(Square::new(&Matrix::from_fn(3, 3, |i, j| (i * j) as f64)).is_none());
    }
}
