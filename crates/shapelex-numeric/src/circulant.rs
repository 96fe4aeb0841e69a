//! Symmetric circulant operators.
//!
//! ```text
//! Φ_kl = f[(l − k) mod n],  f even     Φ = F* diag(f̂) F,   f̂[q] = f[0] + Σ_m f[m] cos(2πqm/n)
//! ```
//!
//! The real FFT diagonalises `Φ`. Its symmetric square root is circulant too, so it commutes with cyclic shifts and with
//! reversal. Cost of every operation: one FFT pair per column, `O(n log n)`.

use realfft::num_complex::Complex64;

use super::NumericError;
use super::fft::RealFft;
use super::operator::SymmetricOperator;

/// A symmetric positive definite circulant operator.
#[derive(Debug, Clone)]
pub struct Circulant {
    fft: RealFft,
    eigenvalues: Vec<f64>,
    roots: Vec<f64>,
}

impl Circulant {
    /// The operator with first row `f[0], f[1], …, f[n−1]`, where `f[n−m] = f[m]`.
    ///
    /// # Errors
    /// [`NumericError::NotPositiveDefinite`] if an eigenvalue is below `1e-14` of the largest: the basis is then not a
    /// Riesz basis to working precision.
    pub fn new(first_row: &[f64]) -> Result<Self, NumericError> {
        let fft = RealFft::new(first_row.len());
        let mut spectrum = vec![Complex64::ZERO; fft.spectrum_len()];
        fft.forward(first_row, &mut spectrum, &mut fft.scratch());
        let eigenvalues: Vec<f64> = spectrum.iter().map(|value| value.re).collect();
        let largest = eigenvalues.iter().cloned().fold(f64::MIN, f64::max);
        let smallest = eigenvalues.iter().cloned().fold(f64::MAX, f64::min);
        if !(smallest > 1e-14 * largest.abs()) {
            return Err(NumericError::NotPositiveDefinite { size: first_row.len(), smallest });
        }
        let roots = eigenvalues.iter().map(|value| value.sqrt()).collect();
        Ok(Self { fft, eigenvalues, roots })
    }

    /// The distinct eigenvalues `f̂[q]`, `q = 0..=n/2`.
    pub fn eigenvalues(&self) -> &[f64] {
        &self.eigenvalues
    }

    fn filter(&self, data: &mut [f64], gain: impl Fn(usize) -> f64) {
        let n = self.fft.len();
        assert_eq!(data.len() % n, 0, "columns of length {n}");
        let mut scratch = self.fft.scratch();
        let mut spectrum = std::mem::take(&mut scratch.spectrum);
        for column in data.chunks_exact_mut(n) {
            self.fft.forward(column, &mut spectrum, &mut scratch);
            spectrum.iter_mut().enumerate().for_each(|(q, value)| *value *= gain(q));
            self.fft.inverse(&mut spectrum, column, &mut scratch);
        }
    }
}

impl SymmetricOperator for Circulant {
    fn size(&self) -> usize {
        self.fft.len()
    }

    fn apply(&self, data: &mut [f64]) {
        self.filter(data, |q| self.eigenvalues[q]);
    }

    fn solve(&self, data: &mut [f64]) {
        self.filter(data, |q| self.eigenvalues[q].recip());
    }

    fn whiten(&self, data: &mut [f64]) {
        self.filter(data, |q| self.roots[q]);
    }

    fn unwhiten(&self, data: &mut [f64]) {
        self.filter(data, |q| self.roots[q].recip());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::operator::assert_operator_of;

    #[test]
    fn square_root_and_inverse_agree_with_the_matrix() {
        let row = [0.8, 0.15, -0.05, -0.05, 0.15];
        let operator = Circulant::new(&row).unwrap();
        assert_operator_of(&operator, |k, l| row[(l + 5 - k) % 5], 1e-14);
        let mut twice = [1.0, -2.0, 0.5, 3.0, 0.25];
        let mut applied = twice;
        operator.apply(&mut applied);
        operator.whiten(&mut twice);
        operator.whiten(&mut twice);
        for k in 0..5 {
            assert!((twice[k] - applied[k]).abs() < 1e-15);
        }
    }

    #[test]
    fn a_singular_row_is_refused() {
        assert!(matches!(
            Circulant::new(&[1.0, 0.5, 0.0, 0.5]),
            Err(NumericError::NotPositiveDefinite { .. })
        ));
    }
}
