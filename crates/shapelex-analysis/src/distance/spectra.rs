//! Products at all start points, by the Fourier transform.

use rayon::prelude::*;
use realfft::num_complex::Complex64;

use super::products::{Score, rotation_scores};
use super::{DistanceSpace, TILE, chunk};
use shapelex_numeric::fft::{ComplexFft, FftScratch, RealFft};
use shapelex_numeric::kernels::{add_squared_norms, multiply_conjugates, multiply_mirrored, squared_norms};

/// `2^{−1/4}`: with this factor on both shapes, sums of squares are halved.
pub(super) const HALF_ROOT: f64 = 0.840_896_415_253_714_5;

/// The inverse transforms that give the products of a pair at all start points.
#[derive(Debug, Clone)]
pub(super) enum Transform {
    /// One real inverse transform for each product.
    Real(RealFft),
    /// One complex inverse transform for `z₁* z₂`, whose parts are the two products.
    Complex(ComplexFft),
    /// Two complex inverse transforms, for `z₁* z₂` and `z₁ᵀ z₂`: their parts are sums and differences of the products of both
    /// columns with both.
    ComplexPair(ComplexFft),
}

impl Transform {
    /// Length of the spectra of a shape of so many columns.
    pub(super) fn spectrum_len(&self, columns: usize) -> usize {
        match self {
            Self::Real(fft) => columns * fft.spectrum_len(),
            Self::Complex(fft) | Self::ComplexPair(fft) => fft.len(),
        }
    }

    /// Multiply-adds of the transforms of `products` products of a pair, from `terms` products of spectra.
    pub(super) fn operations(&self, terms: f64, products: f64) -> f64 {
        /// Cost of the complex transform, in real ones.
        const COMPLEX: f64 = 1.4;
        let operations = |n: usize, terms: f64, transforms: f64| {
            let n = n as f64;
            2.0 * n * (terms + transforms * (2.0 + n.log2()))
        };
        match self {
            Self::Real(fft) => operations(fft.len(), terms, products),
            Self::Complex(fft) => operations(fft.len(), 2.0, COMPLEX),
            Self::ComplexPair(fft) => operations(fft.len(), 4.0, 2.0 * COMPLEX),
        }
    }
}

/// Scratch memory for the products of one pair.
pub(super) struct Work {
    pub(super) scratch: Scratch,
    pub(super) spectrum: Vec<Complex64>,
    pub(super) correlation: Vec<f64>,
    pub(super) scores: Vec<f64>,
    /// All products of all start points, for [`Score::Rotation`].
    pub(super) products: Vec<f64>,
}

pub(super) enum Scratch {
    None,
    Real(FftScratch),
    Complex(Vec<Complex64>),
}

impl DistanceSpace {
    /// `p(s) = F⁻¹ Σ ± conj(x̂) ŷ`: the products for every start point `s` of the second shape.
    pub(super) fn scores_of_spectra(
        &self,
        fft: &RealFft,
        first: &[Complex64],
        second: &[Complex64],
        work: &mut Work,
    ) {
        let (n, length) = (fft.len(), fft.spectrum_len());
        let Work { scratch, spectrum, correlation, scores, products } = work;
        let Scratch::Real(scratch) = scratch else { unreachable!("all work of a space is of one kind") };
        for (k, terms) in self.products.iter().enumerate() {
            for (position, term) in terms.iter().enumerate() {
                let (left, right) = (chunk(first, term.left, length), chunk(second, term.right, length));
                // The first term of a product is not negative.
                if position == 0 {
                    multiply_conjugates(spectrum, left, right);
                    continue;
                }
                let add = |(sum, (x, y)): (&mut Complex64, (&Complex64, &Complex64))| {
                    *sum += term.sign * (x.conj() * y);
                };
                spectrum.iter_mut().zip(left.iter().zip(right)).for_each(add);
            }
            fft.inverse(spectrum, correlation, scratch);
            match self.score {
                Score::Squares if k == 0 => {
                    scores.iter_mut().zip(&*correlation).for_each(|(score, p)| *score = p * p);
                }
                Score::Squares => {
                    scores.iter_mut().zip(&*correlation).for_each(|(score, p)| *score += p * p);
                }
                Score::Single => scores.copy_from_slice(correlation),
                Score::Rotation => products[k * n..(k + 1) * n].copy_from_slice(correlation),
            }
        }
        if self.score == Score::Rotation {
            rotation_scores(products, scores);
        }
    }

    pub(super) fn work(&self) -> Work {
        let (n, all) = match (&self.transform, self.score) {
            (None, _) => (1, 0),
            (Some(_), Score::Rotation) => (self.size, self.products.len()),
            (Some(_), _) => (self.size, 0),
        };
        let (scratch, spectrum) = match &self.transform {
            None => (Scratch::None, 0),
            Some(Transform::Real(fft)) => (Scratch::Real(fft.scratch()), fft.spectrum_len()),
            Some(Transform::Complex(fft)) => (Scratch::Complex(fft.scratch()), n),
            Some(Transform::ComplexPair(fft)) => (Scratch::Complex(fft.scratch()), 2 * n),
        };
        Work {
            scratch,
            spectrum: vec![Complex64::ZERO; spectrum],
            correlation: vec![0.0; n],
            scores: vec![0.0; n],
            products: vec![0.0; all * n],
        }
    }
}

/// `|p(s)|²` with `p(s) = F⁻¹ conj(ẑ₁) ẑ₂`, for every start point `s` of the second shape.
pub(super) fn scores_of_complex_spectra(
    fft: &ComplexFft,
    first: &[Complex64],
    second: &[Complex64],
    work: &mut Work,
) {
    let Scratch::Complex(scratch) = &mut work.scratch else {
        unreachable!("all work of a space is of one kind")
    };
    multiply_conjugates(&mut work.spectrum, first, second);
    fft.inverse(&mut work.spectrum, scratch);
    squared_norms(&mut work.scores, &work.spectrum);
}

/// `|p(s)|² + |q(s)|²` with `p(s)` as above and `q(s)` the same of `z₁*` instead of `z₁`, for every start point `s`.
pub(super) fn scores_of_complex_pair(
    fft: &ComplexFft,
    first: &[Complex64],
    second: &[Complex64],
    work: &mut Work,
) {
    let Scratch::Complex(scratch) = &mut work.scratch else {
        unreachable!("all work of a space is of one kind")
    };
    let (conjugated, plain) = work.spectrum.split_at_mut(fft.len());
    multiply_conjugates(conjugated, first, second);
    multiply_mirrored(plain, first, second);
    fft.inverse(&mut work.spectrum, scratch);
    let (conjugated, plain) = work.spectrum.split_at(fft.len());
    squared_norms(&mut work.scores, conjugated);
    add_squared_norms(&mut work.scores, plain);
}

pub(super) fn spectra(fft: &RealFft, signals: &[f64]) -> Vec<Complex64> {
    let (n, length) = (fft.len(), fft.spectrum_len());
    let mut spectra = vec![Complex64::ZERO; signals.len() / n * length];
    let pairs = signals.par_chunks_exact(n).zip(spectra.par_chunks_exact_mut(length));
    pairs.with_min_len(TILE).for_each_init(
        || fft.scratch(),
        |scratch, (signal, spectrum)| fft.forward(signal, spectrum, scratch),
    );
    spectra
}

/// `n^{−1/2} F z` of every two columns `x` and `y`, with `z = scale (x + iy)`.
pub(super) fn complex_spectra(fft: &ComplexFft, scale: f64, signals: &[f64]) -> Vec<Complex64> {
    let (n, factor) = (fft.len(), scale / (fft.len() as f64).sqrt());
    let mut spectra = vec![Complex64::ZERO; signals.len() / 2];
    let pairs = signals.par_chunks_exact(2 * n).zip(spectra.par_chunks_exact_mut(n));
    pairs.with_min_len(TILE).for_each_init(
        || fft.scratch(),
        |scratch, (signal, spectrum)| {
            let (x, y) = signal.split_at(n);
            let both = x.iter().zip(y);
            spectrum.iter_mut().zip(both).for_each(|(z, (x, y))| *z = factor * Complex64::new(*x, *y));
            fft.forward(spectrum, scratch);
        },
    );
    spectra
}
