//! Numerical tools that are independent of shapes: structured operators, dense kernels, quadrature.
//!
//! * [`operator`] — symmetric positive definite operators and their square roots: the interface of a Gram matrix;
//! * [`cholesky`] — Cholesky factor of a submatrix whose index set grows and shrinks;
//! * [`circulant`] — the operator of a periodic shift-invariant basis, diagonal under the real FFT;
//! * [`bounded`] — termination of searches: budgets of steps, and cancellation by the caller;
//! * [`banded`] — symmetric positive definite band matrices and their Cholesky factor;
//! * [`kronecker`] — tensor products of operators;
//! * [`sparse`] — sparse matrices by rows;
//! * [`kernels`] — loops over short slices;
//! * [`descent`] — minimisation with bounded steps: [`lbfgs`], damped [`newton`], and one point after the other
//!   ([`coordinates`]);
//! * [`lanes`] — long columns in pieces of a few vectors, and stacks of such columns;
//! * [`dense`] — dense kernels and eigenproblems; the only module that depends on the linear algebra library;
//! * [`lanczos`] — the leading eigenvector of an operator;
//! * [`parallel`] — loops over all threads;
//! * [`quadrature`] — Gauss–Legendre rules and an adaptive integral;
//! * [`double_double`] — double and double-double arithmetic under one trait, and small systems over it.
//!
//! # Example
//!
//! The leading eigenpair of a symmetric matrix:
//!
//! ```
//! use shapelex_numeric::dense::{Matrix, leading_eigenpairs};
//!
//! let matrix = Matrix::from_row_slice(2, 2, &[2.0, 1.0, 1.0, 2.0]);
//! let pairs = leading_eigenpairs(&matrix, 1)?;
//! assert!((pairs.values[0] - 3.0).abs() < 1e-14);
//! # Ok::<(), shapelex_numeric::NumericError>(())
//! ```

pub mod banded;
pub mod bounded;
pub mod cholesky;
pub mod circulant;
pub mod coordinates;
pub mod dense;
pub mod descent;
pub mod double_double;
pub mod fft;
pub mod kernels;
pub mod kronecker;
pub mod lanczos;
pub mod lanes;
pub mod lbfgs;
pub mod newton;
pub mod operator;
pub mod parallel;
pub mod quadrature;
pub mod sparse;

/// Largest magnitude of a number from outside, chosen so that squares, areas and their sums stay finite.
pub const MAX_NUMBER: f64 = 1e100;

/// Errors of the numerical layer.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum NumericError {
    /// An operator that must be positive definite is not.
    #[error("the operator of size {size} is not positive definite: smallest eigenvalue {smallest:.3e}")]
    NotPositiveDefinite {
        /// Number of rows.
        size: usize,
        /// Its smallest eigenvalue.
        smallest: f64,
    },
    /// An eigenvalue iteration did not converge.
    #[error("no convergence of the eigenproblem of size {size}")]
    NoConvergence {
        /// Number of rows.
        size: usize,
    },
}

/// The examples of the README are tests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
