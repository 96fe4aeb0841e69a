//! Distances of close pairs, from the remainder of one shape after the other.
//!
//! ```text
//! projection                 d² = ‖Q₂ − Q₁Q₁ᵀQ₂‖²/I                  for 1 − tr(P₁P₂)/I
//! Procrustes, similarity     d² = ‖ŷ − ρ R x̂‖²                       for 1 − ρ²
//! with sizes a and b         d² = (a − b)² + a b ‖ŷ − R x̂‖²          for (a − b)² + 2 a b (1 − ρ);  partial: a = b = 1
//! ```
//!
//! `x̂` and `ŷ` have unit norm. A difference of two numbers near 1 knows squares of distances to some `10⁻¹⁶`, so distances to
//! `10⁻⁸`; a difference of two shapes knows distances themselves to some `10⁻¹⁶`. Shapes with the same numbers have the distance
//! zero.

use super::best::Best;
use super::prepared::{Columns, PreparedShapes};
use super::spectra::{HALF_ROOT, Scratch, Transform, Work};
use super::{DistanceSpace, Match, Scale, chunk};
use crate::alignment::Method;
use crate::fit::transform;
use crate::matching::Placement;
use crate::subspace::quarter_turn;
use crate::transformation::Structure;
use realfft::num_complex::Complex64;
use shapelex_numeric::dense::Matrix;

/// Distance, relative to the sizes, below which a pair is close: above it, the products know distances to `10⁻¹¹`.
const CLOSE: f64 = 1e-4;

/// Distance, relative to the sizes, below which a pair is equal: the rounding that transforms, bases and rotations leave.
const ROUNDING: f64 = 32.0 * f64::EPSILON;

/// Relative difference of scores below which either may be the larger one: their rounding. Less than the difference within
/// which the first placement counts as the best.
const SAME_SCORE: f64 = 64.0 * f64::EPSILON;

/// Maximum number of placements of equal scores that are compared: distances at more of them differ by `10⁻⁷` at most.
const TIED: usize = 8;

impl DistanceSpace {
    /// Whether a distance of shapes of the sizes `first` and `second` is to be computed by [`Self::closer`].
    pub(super) fn is_close(&self, distance: f64, first: f64, second: f64) -> bool {
        distance < CLOSE * first.max(second)
    }

    /// The distance of a close pair, with the placement that attains it; of equal ones, the first. Cost: the products of all
    /// placements, and the bases or points of [`TIED`] of them.
    pub(super) fn closer(
        &self,
        shapes: &PreparedShapes,
        i: usize,
        others: &PreparedShapes,
        j: usize,
        work: &mut Work,
    ) -> Match {
        if self.is_same(&shapes.laid[0], i, &others.laid[0], j) {
            return Match { distance: 0.0, placement: Placement::default() };
        }
        let (a, b) = (shapes.sizes[i], others.sizes[j]);
        let rounding = ROUNDING * a.max(b);
        let x = self.signals(&shapes.laid[0], i, 0, work);
        let mut closest = Match { distance: f64::INFINITY, placement: Placement::default() };
        for (laid, placement) in self.tied(shapes, i, others, j, work) {
            let y = self.signals(&others.laid[laid], j, placement.shift as usize, work);
            let distance = self.left_over(&x, &y, a, b);
            if distance <= rounding {
                return Match { distance: 0.0, placement };
            }
            if distance < closest.distance - rounding {
                closest = Match { distance, placement };
            }
        }
        closest
    }

    /// Whether two shapes have the same numbers as given.
    fn is_same(&self, first: &Columns, i: usize, second: &Columns, j: usize) -> bool {
        match (first, second, &self.transform) {
            (Columns::Spectra(first), Columns::Spectra(second), Some(transform)) => {
                let length = transform.spectrum_len(self.columns);
                chunk(first, i, length) == chunk(second, j, length)
            }
            (Columns::Signals(first), Columns::Signals(second), _) => {
                let length = self.size * self.columns;
                chunk(first, i, length) == chunk(second, j, length)
            }
            _ => unreachable!("all shapes of a space are prepared alike"),
        }
    }

    /// Placements whose scores equal the best one, with the positions of their candidates: the one of [`Self::best`], then the
    /// largest scores.
    fn tied(
        &self,
        shapes: &PreparedShapes,
        i: usize,
        others: &PreparedShapes,
        j: usize,
        work: &mut Work,
    ) -> impl Iterator<Item = (usize, Placement)> + use<> {
        let (mut best, mut all) = (Best::NONE, Vec::new());
        self.each_score(shapes, i, others, j, work, |k, score, placement| {
            best.offer(score, placement);
            all.push((score, k, placement));
        });
        let least = best.score - SAME_SCORE * best.score.abs();
        all.retain(|(score, _, placement)| *score >= least || *placement == best.placement);
        // Stable: of equal scores, the first comes first.
        all.sort_by(|a, b| (b.2 == best.placement).cmp(&(a.2 == best.placement)).then(b.0.total_cmp(&a.0)));
        all.into_iter().take(TIED).map(|(_, laid, placement)| (laid, placement))
    }

    /// The columns of shape `k` that begin `shift` rows later.
    fn signals(&self, laid: &Columns, k: usize, shift: usize, work: &mut Work) -> Vec<f64> {
        let mut signals = match (laid, &self.transform) {
            (Columns::Spectra(all), Some(transform)) => {
                let spectrum = chunk(all, k, transform.spectrum_len(self.columns));
                signals_of_spectrum(transform, spectrum, &mut work.scratch)
            }
            (Columns::Signals(all), _) => chunk(all, k, self.size * self.columns).to_vec(),
            _ => unreachable!("only spaces with a transform have spectra"),
        };
        signals.chunks_exact_mut(self.size).for_each(|column| column.rotate_left(shift));
        signals
    }

    /// Distance of two shapes of the sizes `a` and `b`, from their columns at one placement.
    fn left_over(&self, x: &[f64], y: &[f64], a: f64, b: f64) -> f64 {
        let squared = match &self.method {
            Method::Projection(class) => {
                let d = class.dimension();
                match class.structure {
                    Structure::PerCoordinate => left_of_bases(x, y, d) / d as f64,
                    Structure::PerAxis => {
                        let axes = x.chunks_exact(self.size).zip(y.chunks_exact(self.size));
                        axes.map(|(x, y)| left_of_bases(x, y, 1)).sum::<f64>() / d as f64
                    }
                    Structure::Complex => left_of_bases(&[x, &quarter_turn(x, 1.0)].concat(), y, 2),
                    Structure::General => {
                        let rank = class.matrices().len();
                        left_of_bases(x, y, rank) / rank as f64
                    }
                }
            }
            Method::Procrustes(fit) => {
                let fitted = transform(&fit.matrix(x, y), x);
                y.iter().zip(fitted).map(|(y, fitted)| (y - fitted).powi(2)).sum()
            }
        };
        match self.scale {
            Scale::Unit(_) => squared.sqrt(),
            Scale::Sizes => f64::hypot(a - b, (a * b * squared).sqrt()),
        }
    }
}

/// `‖Y − X XᵀY‖²`, where `X` has `columns` orthonormal columns, and `Y` columns of the same length.
fn left_of_bases(x: &[f64], y: &[f64], columns: usize) -> f64 {
    let rows = x.len() / columns;
    let x = Matrix::from_column_slice(rows, columns, x);
    let y = Matrix::from_column_slice(rows, y.len() / rows, y);
    (&y - &x * x.tr_mul(&y)).norm_squared()
}

/// The real columns of a spectrum.
fn signals_of_spectrum(transform: &Transform, spectrum: &[Complex64], scratch: &mut Scratch) -> Vec<f64> {
    let mut spectrum = spectrum.to_vec();
    match (transform, scratch) {
        (Transform::Real(fft), Scratch::Real(scratch)) => {
            let mut signals = vec![0.0; spectrum.len() / fft.spectrum_len() * fft.len()];
            let columns =
                spectrum.chunks_exact_mut(fft.spectrum_len()).zip(signals.chunks_exact_mut(fft.len()));
            columns.for_each(|(spectrum, signal)| fft.inverse(spectrum, signal, scratch));
            signals
        }
        (Transform::Complex(fft) | Transform::ComplexPair(fft), Scratch::Complex(scratch)) => {
            let scale = if matches!(transform, Transform::ComplexPair(_)) { HALF_ROOT } else { 1.0 };
            fft.inverse(&mut spectrum, scratch);
            let factor = 1.0 / (scale * (fft.len() as f64).sqrt());
            let real = spectrum.iter().map(|z| factor * z.re);
            real.chain(spectrum.iter().map(|z| factor * z.im)).collect()
        }
        _ => unreachable!("all work of a space is of one kind"),
    }
}
