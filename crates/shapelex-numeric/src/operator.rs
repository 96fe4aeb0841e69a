//! Symmetric positive definite operators on `R^n`, applied in place to columns.

use std::fmt::Debug;

/// A symmetric positive definite `n × n` operator `Φ` with a square root `R`, `RᵀR = Φ`.
///
/// Every method works in place on `data`, which holds any number of columns of length `n`, one after the other.
/// `data.len()` must be a multiple of `n`.
pub trait SymmetricOperator: Debug + Send + Sync {
    /// Number of rows, `n`.
    fn size(&self) -> usize;

    /// `x ← Φ x` for every column.
    fn apply(&self, data: &mut [f64]);

    /// `x ← Φ⁻¹ x` for every column.
    fn solve(&self, data: &mut [f64]);

    /// `x ← R x` for every column. Plain dot products of the results are `Φ`-products.
    fn whiten(&self, data: &mut [f64]);

    /// `x ← R⁻¹ x` for every column.
    fn unwhiten(&self, data: &mut [f64]);
}

/// `Φ = a I`, the discrete metric of landmarks (`a = 1/n`).
#[derive(Debug, Clone)]
pub struct ScaledIdentity {
    size: usize,
    scale: f64,
}

impl ScaledIdentity {
    /// `scale · I` with `size` rows; `scale` must be positive.
    pub fn new(size: usize, scale: f64) -> Self {
        Self { size, scale }
    }
}

fn scale_all(data: &mut [f64], factor: f64) {
    data.iter_mut().for_each(|value| *value *= factor);
}

impl SymmetricOperator for ScaledIdentity {
    fn size(&self) -> usize {
        self.size
    }

    fn apply(&self, data: &mut [f64]) {
        scale_all(data, self.scale);
    }

    fn solve(&self, data: &mut [f64]) {
        scale_all(data, self.scale.recip());
    }

    fn whiten(&self, data: &mut [f64]) {
        scale_all(data, self.scale.sqrt());
    }

    fn unwhiten(&self, data: &mut [f64]) {
        scale_all(data, self.scale.sqrt().recip());
    }
}

/// Checks the laws of an operator: it agrees with the matrix of `entry`, and its root, its inverse and the inverse of its
/// root are consistent with it.
#[cfg(test)]
pub(crate) fn assert_operator_of(
    operator: &dyn SymmetricOperator,
    entry: impl Fn(usize, usize) -> f64,
    tolerance: f64,
) {
    let size = operator.size();
    let data: Vec<f64> = (0..2 * size).map(|i| (i as f64 * 0.7 + 0.3).sin()).collect();
    let after = |operation: &dyn Fn(&mut [f64])| {
        let mut data = data.clone();
        operation(&mut data);
        data
    };
    let near = |found: f64, wanted: f64| {
        assert!((found - wanted).abs() <= tolerance * wanted.abs().max(1.0), "{found} {wanted}, size {size}");
    };
    let applied = after(&|data| operator.apply(data));
    let whitened = after(&|data| operator.whiten(data));
    for (k, x) in data.chunks(size).enumerate() {
        let column = k * size..(k + 1) * size;
        for (i, found) in applied[column.clone()].iter().enumerate() {
            near(*found, (0..size).map(|j| entry(i, j) * x[j]).sum());
        }
        let form: f64 = applied[column.clone()].iter().zip(x).map(|(a, b)| a * b).sum();
        near(whitened[column].iter().map(|value| value * value).sum(), form);
    }
    let solved = after(&|data| {
        operator.apply(data);
        operator.solve(data);
    });
    let back = after(&|data| {
        operator.whiten(data);
        operator.unwhiten(data);
    });
    for (i, x) in data.iter().enumerate() {
        near(solved[i], *x);
        near(back[i], *x);
    }
}
