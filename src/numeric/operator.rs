//! Symmetric positive definite operators on `R^n`, applied in place to columns.

use std::fmt::Debug;

/// A symmetric positive definite `n × n` operator `Φ` with a square root `R`, `RᵀR = Φ`.
///
/// Every method works in place on `data`, which holds any number of columns of length `n` one after
/// the other; `data.len()` must be a multiple of `n`.
pub trait SymmetricOperator: Debug + Send + Sync {
    /// `n`.
    fn size(&self) -> usize;

    /// `x ← Φ x` for every column.
    fn apply(&self, data: &mut [f64]);

    /// `x ← Φ⁻¹ x` for every column.
    fn solve(&self, data: &mut [f64]);

    /// `x ← R x` for every column: afterwards plain dot products are `Φ`-products.
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
    /// `scale · I` of `size` rows; `scale` must be positive.
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
