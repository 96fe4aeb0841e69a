//! Numerical tools without knowledge of shapes: structured operators, dense kernels, quadrature.
//!
//! * [`operator`] — symmetric positive definite operators and their square roots (what a Gram matrix is to its users);
//! * [`cholesky`] — the factor of a matrix that grows and shrinks by rows;
//! * [`circulant`] — the operator of a periodic shift-invariant basis, diagonal under the real FFT;
//! * [`bounded`] — what makes searches end: shares of steps and callers who want to stop;
//! * [`banded`] — symmetric positive definite band matrices and their Cholesky factor;
//! * [`kronecker`] — tensor products of operators;
//! * [`sparse`] — sparse matrices by rows;
//! * [`kernels`] — loops over short slices;
//! * [`dense`] — the only module that knows the dense linear algebra library: rank-k updates and eigenproblems;
//! * [`fingerprint`] — whether two processes compute alike;
//! * [`quadrature`] — Gauss–Legendre rules and an adaptive integral;
//! * [`real`] — double and double-double numbers under one name, small systems over them.

pub mod banded;
pub mod bounded;
pub mod cholesky;
pub mod circulant;
pub mod dense;
pub mod fingerprint;
pub mod kernels;
pub mod kronecker;
pub mod operator;
pub mod quadrature;
pub mod real;
pub mod sparse;

/// What the numerical layer can refuse.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum NumericError {
    /// An operator that must be positive definite is not.
    #[error("the operator of size {size} is not positive definite: smallest eigenvalue {smallest:.3e}")]
    NotPositiveDefinite {
        /// Number of rows.
        size: usize,
        /// Its smallest eigenvalue.
        smallest: f64,
    },
    /// An eigenvalue iteration did not finish.
    #[error("no convergence of the eigenproblem of size {size}")]
    NoConvergence {
        /// Number of rows.
        size: usize,
    },
}
