//! Symmetric circulant operators.
//!
//! ```text
//! Φ_kl = f[(l − k) mod n],  f even     Φ = F* diag(f̂) F,   f̂[q] = f[0] + Σ_m f[m] cos(2πqm/n)
//! ```
//!
//! The real FFT diagonalises `Φ`. Its symmetric square root is circulant too, so it commutes with cyclic shifts and with
//! reversal. Cost of every operation: one FFT pair per column, `O(n log n)`.

use std::sync::Arc;

use realfft::num_complex::Complex64;
use realfft::{ComplexToReal, RealFftPlanner, RealToComplex};

use super::NumericError;
use super::operator::SymmetricOperator;

/// The forward and inverse real transforms of one length. The inverse includes the factor `1/n`.
#[derive(Clone)]
pub struct RealFft {
    forward: Arc<dyn RealToComplex<f64>>,
    inverse: Arc<dyn ComplexToReal<f64>>,
}

/// Scratch memory for repeated transforms.
pub struct FftScratch {
    signal: Vec<f64>,
    spectrum: Vec<Complex64>,
    work: Vec<Complex64>,
}

impl std::fmt::Debug for RealFft {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "RealFft({})", self.len())
    }
}

impl RealFft {
    /// Plans both transforms of length `n ≥ 1`.
    pub fn new(n: usize) -> Self {
        let mut planner = RealFftPlanner::<f64>::new();
        Self { forward: planner.plan_fft_forward(n), inverse: planner.plan_fft_inverse(n) }
    }

    /// Length of the real signal.
    pub fn len(&self) -> usize {
        self.forward.len()
    }

    /// Whether the length is zero (always false).
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Number of complex coefficients, `n/2 + 1`.
    pub fn spectrum_len(&self) -> usize {
        self.len() / 2 + 1
    }

    /// Scratch memory for [`Self::forward`] and [`Self::inverse`].
    pub fn scratch(&self) -> FftScratch {
        let work = self.forward.get_scratch_len().max(self.inverse.get_scratch_len());
        FftScratch {
            signal: vec![0.0; self.len()],
            spectrum: vec![Complex64::ZERO; self.spectrum_len()],
            work: vec![Complex64::ZERO; work],
        }
    }

    /// Forward transform, `spectrum ← F signal`.
    pub fn forward(&self, signal: &[f64], spectrum: &mut [Complex64], scratch: &mut FftScratch) {
        scratch.signal.copy_from_slice(signal);
        self.forward
            .process_with_scratch(&mut scratch.signal, spectrum, &mut scratch.work)
            .expect("lengths are those of the plan");
    }

    /// Inverse transform, `signal ← F⁻¹ spectrum`; overwrites `spectrum`.
    pub fn inverse(&self, spectrum: &mut [Complex64], signal: &mut [f64], scratch: &mut FftScratch) {
        let n = self.len();
        spectrum[0].im = 0.0;
        if n.is_multiple_of(2) {
            spectrum[n / 2].im = 0.0;
        }
        self.inverse
            .process_with_scratch(spectrum, signal, &mut scratch.work)
            .expect("lengths are those of the plan");
        let factor = 1.0 / n as f64;
        signal.iter_mut().for_each(|value| *value *= factor);
    }
}

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
