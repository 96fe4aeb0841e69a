//! Bounds on products over all start points, from the magnitudes of spectra.
//!
//! ```text
//! |Σ_k conj(z₁[k]) z₂[k+s]| ≤ 1/n Σ_f |ẑ₁[f]| |ẑ₂[f]|     for every start point s
//! ```
//!
//! Magnitudes do not depend on the start point. A search for the nearest shapes therefore needs no correlation of a pair
//! whose bound is already beyond the nearest found.
//!
//! Source: the triangle inequality of the inverse transform; lower bounds in a search, Faloutsos, Ranganathan and
//! Manolopoulos 1994.
//!
//! Numbers of single precision suffice: their rounding is added to the bound.

use realfft::num_complex::Complex64;

use shapelex_numeric::kernels::{SINGLE_LANES, dot_single};

/// Signals whose products are bounded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Signals {
    /// One complex signal.
    Complex,
    /// Real columns, whose products are added.
    Real,
}

/// Magnitudes of the spectra of shapes, those of a shape of unit norm divided by `√n`: a product is at most 1.
#[derive(Debug, Clone)]
pub(crate) struct Magnitudes {
    /// Numbers of one shape.
    length: usize,
    values: Vec<f32>,
}

impl Magnitudes {
    /// Magnitudes of shapes of unit norm and `n` rows from their spectra. Spectra of complex signals are divided by `√n`; those of
    /// real signals are the half spectra of `columns` columns, one after the other.
    pub(crate) fn new(signals: Signals, n: usize, columns: usize, spectra: &[Complex64]) -> Self {
        let half = n / 2 + 1;
        let length = match signals {
            Signals::Complex => n,
            Signals::Real => columns * half,
        };
        let mut values = Vec::with_capacity(spectra.len());
        for shape in spectra.chunks_exact(length) {
            match signals {
                Signals::Complex => values.extend(shape.iter().map(|value| value.norm() as f32)),
                Signals::Real => values.extend(shape.chunks_exact(half).flat_map(|column| {
                    column.iter().enumerate().map(|(f, value)| {
                        // All frequencies but 0 and n/2 occur twice.
                        let twice = if f == 0 || 2 * f == n { 1.0 } else { 2.0_f64.sqrt() };
                        (twice * value.norm() / (n as f64).sqrt()) as f32
                    })
                })),
            }
        }
        Self { length, values }
    }

    /// Magnitudes of shape `k`.
    fn of(&self, k: usize) -> &[f32] {
        &self.values[k * self.length..(k + 1) * self.length]
    }

    /// Reserves memory for further shapes.
    pub(crate) fn reserve(&mut self, shapes: usize) {
        self.values.reserve_exact(self.length * shapes);
    }

    /// Appends those of further shapes.
    pub(crate) fn append(&mut self, more: Self) {
        self.values.extend(more.values);
    }

    /// Memory of one shape in bytes.
    pub(crate) fn bytes(signals: Signals, n: usize, columns: usize) -> usize {
        match signals {
            Signals::Complex => 4 * n,
            Signals::Real => 4 * columns * (n / 2 + 1),
        }
    }

    /// Upper bound of the products of shape `k` with shape `j` of `others` for unit norms.
    pub(crate) fn product(&self, k: usize, others: &Self, j: usize) -> f64 {
        // Rounding of the magnitudes, and of a sum of positive numbers in lanes.
        let rounding = f64::from(f32::EPSILON) * (8 + self.length / SINGLE_LANES) as f64;
        f64::from(dot_single(self.of(k), others.of(j))) + rounding
    }
}
