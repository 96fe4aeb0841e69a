//! Fast Fourier transforms of one length, planned once.
//!
//! ```text
//! ẑ[f] = Σ_k z[k] e^{−2πi fk/n}
//! ```

use std::sync::Arc;

use realfft::num_complex::Complex64;
use realfft::{ComplexToReal, RealFftPlanner, RealToComplex};
use rustfft::{Fft, FftPlanner};

/// The forward and inverse real transforms of one length. The inverse includes the factor `1/n`.
#[derive(Clone)]
pub struct RealFft {
    forward: Arc<dyn RealToComplex<f64>>,
    inverse: Arc<dyn ComplexToReal<f64>>,
}

/// Scratch memory for repeated transforms.
pub struct FftScratch {
    signal: Vec<f64>,
    pub(crate) spectrum: Vec<Complex64>,
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

/// The forward and inverse complex transforms of one length, both without a factor.
#[derive(Clone)]
pub struct ComplexFft {
    forward: Arc<dyn Fft<f64>>,
    inverse: Arc<dyn Fft<f64>>,
}

impl std::fmt::Debug for ComplexFft {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "ComplexFft({})", self.forward.len())
    }
}

impl ComplexFft {
    /// Plans both transforms of length `n ≥ 1`.
    pub fn new(n: usize) -> Self {
        let mut planner = FftPlanner::new();
        Self { forward: planner.plan_fft_forward(n), inverse: planner.plan_fft_inverse(n) }
    }

    /// Length of the signals.
    pub fn len(&self) -> usize {
        self.forward.len()
    }

    /// Whether the length is zero (always false).
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Scratch memory for [`Self::forward`] and [`Self::inverse`].
    pub fn scratch(&self) -> Vec<Complex64> {
        let length = self.forward.get_inplace_scratch_len().max(self.inverse.get_inplace_scratch_len());
        vec![Complex64::ZERO; length]
    }

    /// `signal ← F signal` for every `n` numbers of `signals`.
    pub fn forward(&self, signals: &mut [Complex64], scratch: &mut [Complex64]) {
        self.forward.process_with_scratch(signals, scratch);
    }

    /// `spectrum ← n F⁻¹ spectrum` for every `n` numbers of `spectra`.
    pub fn inverse(&self, spectra: &mut [Complex64], scratch: &mut [Complex64]) {
        self.inverse.process_with_scratch(spectra, scratch);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn complex_transforms_are_their_sums_and_invert_each_other() {
        for n in [1, 2, 5, 12, 33] {
            let signal: Vec<Complex64> =
                (0..2 * n).map(|k| Complex64::new((k as f64).sin(), (3.0 * k as f64).cos())).collect();
            let (fft, mut found) = (ComplexFft::new(n), signal.clone());
            let mut scratch = fft.scratch();
            fft.forward(&mut found, &mut scratch);
            for (part, signal) in signal.chunks_exact(n).enumerate() {
                for f in 0..n {
                    let turn =
                        |k: usize| Complex64::cis(-std::f64::consts::TAU * (f * k % n) as f64 / n as f64);
                    let sum: Complex64 = signal.iter().enumerate().map(|(k, z)| z * turn(k)).sum();
                    assert!((found[part * n + f] - sum).norm() < 1e-12 * n as f64, "{n} {f}");
                }
            }
            fft.inverse(&mut found, &mut scratch);
            assert!(found.iter().zip(&signal).all(|(a, b)| (a / n as f64 - b).norm() < 1e-13), "{n}");
        }
    }
}
