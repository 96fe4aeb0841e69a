//! Tensor products of symmetric operators, which are never formed.
//!
//! ```text
//! (Φ_u ⊗ Φ_v) x,   x[k·n_v + l] at (k, l):   X ← Φ_u X Φ_v for the n_u × n_v matrix X
//! ```
//!
//! The Gram operator of tensor-product surfaces. Its square root is the product of the roots of the factors. Every operation
//! costs those of the factors, on `n_u` columns and on `n_v` columns.

use std::sync::Arc;

use super::operator::SymmetricOperator;

/// `Φ_u ⊗ Φ_v`, with the second index fastest.
#[derive(Debug, Clone)]
pub struct Kronecker {
    outer: Arc<dyn SymmetricOperator>,
    inner: Arc<dyn SymmetricOperator>,
}

impl Kronecker {
    /// The product of `outer` (on the slow index) and `inner` (on the fast one).
    pub fn new(outer: Arc<dyn SymmetricOperator>, inner: Arc<dyn SymmetricOperator>) -> Self {
        Self { outer, inner }
    }

    fn both(&self, data: &mut [f64], operation: impl Fn(&dyn SymmetricOperator, &mut [f64])) {
        let (rows, columns) = (self.outer.size(), self.inner.size());
        assert_eq!(data.len() % (rows * columns), 0, "columns of length {}", rows * columns);
        operation(&*self.inner, data);
        let mut turned = vec![0.0; rows * columns];
        for x in data.chunks_exact_mut(rows * columns) {
            transpose(x, columns, &mut turned);
            operation(&*self.outer, &mut turned);
            transpose(&turned, rows, x);
        }
    }
}

/// Transposes a matrix stored by rows: `to[j·rows + i] ← from[i·columns + j]`.
pub fn transpose(from: &[f64], columns: usize, to: &mut [f64]) {
    let rows = from.len() / columns;
    for (i, row) in from.chunks_exact(columns).enumerate() {
        for (j, value) in row.iter().enumerate() {
            to[j * rows + i] = *value;
        }
    }
}

impl SymmetricOperator for Kronecker {
    fn size(&self) -> usize {
        self.outer.size() * self.inner.size()
    }

    fn apply(&self, data: &mut [f64]) {
        self.both(data, |factor, data| factor.apply(data));
    }

    fn solve(&self, data: &mut [f64]) {
        self.both(data, |factor, data| factor.solve(data));
    }

    fn whiten(&self, data: &mut [f64]) {
        self.both(data, |factor, data| factor.whiten(data));
    }

    fn unwhiten(&self, data: &mut [f64]) {
        self.both(data, |factor, data| factor.unwhiten(data));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::circulant::Circulant;
    use crate::operator::{ScaledIdentity, assert_operator_of};

    #[test]
    fn operations_agree_with_the_matrix() {
        let row = [0.8, 0.15, -0.05, -0.05, 0.15];
        let outer = Arc::new(Circulant::new(&row).unwrap());
        let product = Kronecker::new(outer, Arc::new(ScaledIdentity::new(3, 0.25)));
        let entry = |i: usize, j: usize| {
            let (k, l, m, n) = (i / 3, i % 3, j / 3, j % 3);
            if l == n { 0.25 * row[(m + 5 - k) % 5] } else { 0.0 }
        };
        assert_operator_of(&product, entry, 1e-14);
    }
}
