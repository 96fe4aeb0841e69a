//! Symmetric positive definite band matrices.
//!
//! ```text
//! Φ_ij = 0 for |i − j| > b,   Φ = RᵀR,  R upper triangular with the same band
//! ```
//!
//! The Gram operator of an open spline basis. Factorisation costs `O(n b²)`, everything else `O(n b)` per column.

use super::NumericError;
use super::operator::SymmetricOperator;

/// A symmetric positive definite band matrix with its Cholesky factor.
#[derive(Debug, Clone)]
pub struct Banded {
    matrix: Band,
    factor: Band,
}

/// The upper part of a band matrix, row by row: entry `(i, i + k)` at index `i·(b + 1) + k`.
#[derive(Debug, Clone, PartialEq)]
pub struct Band {
    size: usize,
    width: usize,
    entries: Vec<f64>,
}

impl Band {
    /// The zero matrix of `size` rows with `width` superdiagonals (fewer if the matrix is small).
    pub fn zeros(size: usize, width: usize) -> Self {
        let width = width.min(size.saturating_sub(1));
        Self { size, width, entries: vec![0.0; size * (width + 1)] }
    }

    /// Entry `(i, j)` of the symmetric matrix.
    pub fn get(&self, i: usize, j: usize) -> f64 {
        let (i, k) = (i.min(j), i.abs_diff(j));
        if k > self.width { 0.0 } else { self.entries[i * (self.width + 1) + k] }
    }

    /// Adds to entry `(i, j)`, `i ≤ j ≤ i + width`, and thereby to `(j, i)`.
    pub fn add(&mut self, i: usize, j: usize, value: f64) {
        self.entries[i * (self.width + 1) + (j - i)] += value;
    }

    /// Row `i` from the diagonal on, up to the end of the matrix.
    fn row(&self, i: usize) -> &[f64] {
        let start = i * (self.width + 1);
        &self.entries[start..start + (self.width + 1).min(self.size - i)]
    }
}

/// Ratio of a pivot to its diagonal entry below which the basis is linearly dependent to working precision.
const INDEPENDENT: f64 = 1e-13;

impl Banded {
    /// Factors `matrix`.
    ///
    /// # Errors
    /// [`NumericError::NotPositiveDefinite`] if a pivot vanishes relative to its diagonal entry.
    pub fn new(matrix: Band) -> Result<Self, NumericError> {
        let Band { size, width, .. } = matrix;
        let mut factor = matrix.clone();
        let stride = width + 1;
        for i in 0..size {
            let pivot = factor.entries[i * stride];
            if !(pivot > INDEPENDENT * matrix.entries[i * stride]) {
                return Err(NumericError::NotPositiveDefinite { size, smallest: pivot });
            }
            let root = pivot.sqrt();
            let reach = (width).min(size - 1 - i);
            for k in 0..=reach {
                factor.entries[i * stride + k] /= root;
            }
            for k in 1..=reach {
                let head = factor.entries[i * stride + k];
                for l in k..=reach {
                    factor.entries[(i + k) * stride + l - k] -= head * factor.entries[i * stride + l];
                }
            }
        }
        Ok(Self { matrix, factor })
    }

    /// Smallest ratio of a pivot to its diagonal entry: the squared sine of the angle between a basis function and the span of
    /// those before it. If it is small, something is hardly determined.
    pub fn independence(&self) -> f64 {
        let stride = self.matrix.width + 1;
        let pairs =
            self.factor.entries.iter().step_by(stride).zip(self.matrix.entries.iter().step_by(stride));
        pairs.map(|(root, diagonal)| root * root / diagonal).fold(1.0, f64::min)
    }

    fn columns<'a>(&self, data: &'a mut [f64]) -> impl Iterator<Item = &'a mut [f64]> {
        assert_eq!(data.len() % self.matrix.size, 0, "columns of length {}", self.matrix.size);
        data.chunks_exact_mut(self.matrix.size)
    }

    /// `x ← R⁻ᵀ x`, by forward substitution.
    fn solve_transposed(&self, x: &mut [f64]) {
        for i in 0..x.len() {
            let row = self.factor.row(i);
            x[i] /= row[0];
            let head = x[i];
            for (k, value) in row.iter().enumerate().skip(1) {
                x[i + k] -= head * value;
            }
        }
    }

    /// `x ← R⁻¹ x`, by back substitution.
    fn solve_factor(&self, x: &mut [f64]) {
        for i in (0..x.len()).rev() {
            let row = self.factor.row(i);
            let known: f64 = row[1..].iter().zip(&x[i + 1..]).map(|(r, v)| r * v).sum();
            x[i] = (x[i] - known) / row[0];
        }
    }
}

impl SymmetricOperator for Banded {
    fn size(&self) -> usize {
        self.matrix.size
    }

    fn apply(&self, data: &mut [f64]) {
        for x in self.columns(data) {
            let mut product = vec![0.0; x.len()];
            for i in 0..x.len() {
                let row = self.matrix.row(i);
                product[i] += row[0] * x[i];
                for (k, value) in row.iter().enumerate().skip(1) {
                    product[i] += value * x[i + k];
                    product[i + k] += value * x[i];
                }
            }
            x.copy_from_slice(&product);
        }
    }

    fn solve(&self, data: &mut [f64]) {
        for x in self.columns(data) {
            self.solve_transposed(x);
            self.solve_factor(x);
        }
    }

    fn whiten(&self, data: &mut [f64]) {
        for x in self.columns(data) {
            for i in 0..x.len() {
                x[i] = self.factor.row(i).iter().zip(&x[i..]).map(|(r, v)| r * v).sum();
            }
        }
    }

    fn unwhiten(&self, data: &mut [f64]) {
        for x in self.columns(data) {
            self.solve_factor(x);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::operator::assert_operator_of;

    fn example(size: usize, width: usize) -> Band {
        let mut band = Band::zeros(size, width);
        for i in 0..size {
            for k in 0..=width.min(size - 1 - i) {
                band.add(i, i + k, if k == 0 { 4.0 + i as f64 } else { 1.0 / (k + i + 1) as f64 });
            }
        }
        band
    }

    #[test]
    fn operations_agree_with_the_matrix() {
        for (size, width) in [(1, 0), (2, 3), (7, 2), (9, 8)] {
            let band = example(size, width);
            let operator = Banded::new(band.clone()).unwrap();
            assert_operator_of(&operator, |i, j| band.get(i, j), 1e-13);
        }
    }

    #[test]
    fn dependent_bases_are_refused() {
        let mut band = Band::zeros(3, 1);
        for (i, j, value) in [(0, 0, 1.0), (0, 1, 1.0), (1, 1, 1.0), (2, 2, 1.0)] {
            band.add(i, j, value);
        }
        assert!(matches!(Banded::new(band), Err(NumericError::NotPositiveDefinite { size: 3, .. })));
    }
}
