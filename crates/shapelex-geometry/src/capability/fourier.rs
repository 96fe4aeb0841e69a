//! Curves given by Fourier coefficients: their points, their control points where a space contains them, and the coefficients of the
//! closed curves of a space.

use std::f64::consts::TAU;

use realfft::num_complex::Complex64;

use crate::curve::Curve;
use crate::generator::{Generator, HALF_PIECE, evaluate_taylor};
use crate::representation::ShapeSpace;
use shapelex_numeric::dense::Matrix;
use shapelex_numeric::fft::RealFft;
use shapelex_numeric::quadrature::GaussLegendre;

/// Maximum distance between a curve of a space and the given one, relative to the extent of the given one: rounding of
/// interpolation, far below the effect of a missing harmonic of any weight in a drawing.
const SAME: f64 = 1e-9;
/// Number of places between two control points at which curves are compared.
const PLACES: usize = 4;

/// Nodes of a rule beside those for the degree of a piece and for the turns of the cosine in it.
const SPARE_NODES: usize = 16;
/// Share of the squared size of a generator below which the rest of its harmonics is rounding.
const ROUNDING: f64 = 64.0 * f64::EPSILON;

/// A closed curve `r(t) = c + Σ_{k=1…n} a_k cos 2πkt + b_k sin 2πkt`, `0 ≤ t < 1`.
#[derive(Debug, Clone, Copy)]
pub struct FourierCurve<'a> {
    /// `c`, one number a dimension.
    pub constant: &'a [f64],
    /// `a_k`, n × d, row-major.
    pub cosine: &'a [f64],
    /// `b_k`, n × d, row-major.
    pub sine: &'a [f64],
}

impl FourierCurve<'_> {
    /// Number of harmonics.
    pub fn harmonics(&self) -> usize {
        self.cosine.len().checked_div(self.constant.len()).unwrap_or(0)
    }

    /// Points at `count` equally spaced `t`, one a row. Cost: `count · n` sines and cosines.
    pub fn points(&self, count: usize) -> Matrix {
        let (d, n) = (self.constant.len(), self.harmonics());
        let mut points = Matrix::from_fn(count, d, |_, c| self.constant[c]);
        for j in 0..count {
            for k in 1..=n {
                // The angle is reduced in whole numbers: it is as exact for the last harmonic as for the first.
                let turns = (j as u128 * k as u128 % count as u128) as f64 / count as f64;
                let (sine, cosine) = (TAU * turns).sin_cos();
                for c in 0..d {
                    let at = (k - 1) * d + c;
                    points[(j, c)] += self.cosine[at] * cosine + self.sine[at] * sine;
                }
            }
        }
        points
    }
}

impl ShapeSpace {
    /// Control points of a Fourier curve, if the space contains it: the same curve with the same parameter.
    ///
    /// The curve of the space through the points at its knots is compared with the given one between them. Cost: sines of
    /// [`FourierCurve::points`] at four places a control point.
    pub fn fourier_control_points(&self, fourier: &FourierCurve<'_>) -> Option<Matrix> {
        let representation = self.representation();
        let (n, d) = (representation.size(), fourier.constant.len());
        // Points at knots tell no more harmonics than this apart.
        if !representation.is_closed() || representation.dimension() != d || 2 * fourier.harmonics() >= n {
            return None;
        }
        let control_points = self.interpolate(fourier.points(n)).ok()?;
        let count = PLACES * n;
        let (wanted, curve) = (fourier.points(count), Curve::of(self, &control_points)?);
        let places: Vec<f64> = (0..count).map(|j| j as f64 / count as f64).collect();
        let found = curve.evaluate_all(&places, 0);
        let extent = wanted.column_iter().map(|column| column.max() - column.min()).fold(0.0, f64::max);
        let agrees = wanted.iter().zip(&found).all(|(wanted, found)| (wanted - found).abs() <= SAME * extent);
        agrees.then_some(control_points)
    }
}

/// The Fourier series of the closed curves `r(t) = Σ_m c[m] φ(Mt − m)` of a space, prepared for a number of harmonics.
///
/// ```text
/// ∫_0^1 r(t) e^{−2πjkt} dt = φ̂(2πk/M) C[k] / M,   φ̂(ω) = ∫ φ(t) cos ωt dt,   C[k] = Σ_m c[m] e^{−2πjkm/M}
/// ```
///
/// `C` has the period `M`; the harmonics that share it hold `Σ_j φ̂(θ + 2πj)² = Σ_m a_00[m] cos mθ`, with the correlation
/// [`Generator::correlation`] of the generator (Poisson's and Parseval's formulas). So the harmonic power of a curve that is left is exact
/// as well. Coefficients as Kuhl and Giardina (1982) define them, of a spline in place of a polygon.
#[derive(Debug, Clone)]
pub struct FourierSeries {
    /// `φ̂(2πk/M)/M` for `0 ≤ k ≤ n`.
    weights: Vec<f64>,
    /// Share of all harmonics but the constant in `|C[k]|²`, `0 ≤ k ≤ M/2`.
    all: Vec<f64>,
    /// Share of the remaining harmonics in `|C[k]|²`.
    left: Vec<f64>,
    fft: RealFft,
}

/// Fourier coefficients of a curve of a space.
#[derive(Debug, Clone, PartialEq)]
pub struct FourierExpansion {
    /// `c`, one number a dimension.
    pub constant: Vec<f64>,
    /// `a_k`, n × d, row-major.
    pub cosine: Vec<f64>,
    /// `b_k`, n × d, row-major.
    pub sine: Vec<f64>,
    /// Share of the harmonic power `∫ |r − c|² = ½ Σ_k |a_k|² + |b_k|²` in harmonics beyond the last one, in [0, 1], without unit.
    /// 0 of a curve without extent.
    pub residual_power: f64,
}

impl FourierSeries {
    /// Prepares the first `harmonics` of the curves of a space; `None` if they are not closed curves.
    ///
    /// Cost: `n · N · (n/M + 16 + terms)` cosines, where `N` is the support of the generator.
    pub fn new(space: &ShapeSpace, harmonics: usize) -> Option<Self> {
        let generator = space.generator().filter(|_| space.representation().is_closed())?;
        let intervals = space.representation().size();
        let turn = TAU / intervals as f64;
        let rule = rule(generator, harmonics as f64 * turn);
        let transforms: Vec<f64> =
            (0..=harmonics).map(|k| transform(generator, &rule, k as f64 * turn)).collect();
        let correlation: Vec<f64> =
            (0..generator.support() as isize).map(|m| generator.correlation(0, 0, m)).collect();
        let (mut all, mut left) = (Vec::new(), Vec::new());
        for k in 0..=intervals / 2 {
            let cosine = |m: usize| (TAU * (m * k % intervals) as f64 / intervals as f64).cos();
            let pairs: f64 = correlation.iter().enumerate().skip(1).map(|(m, a)| a * cosine(m)).sum();
            let whole = correlation[0] + 2.0 * pairs;
            // C[−k] is the conjugate of C[k].
            let twice = if k == 0 || 2 * k == intervals { 1.0 } else { 2.0 };
            let is_shared =
                |h: usize, sign: isize| (sign * h as isize - k as isize).rem_euclid(intervals as isize) == 0;
            let share = |h: usize| {
                let signs = [1, -1].into_iter().filter(|sign| is_shared(h, *sign)).count();
                signs as f64 * transforms[h] * transforms[h]
            };
            let constant = if k == 0 { transforms[0] * transforms[0] } else { 0.0 };
            let rest = |held: f64| if whole - held > ROUNDING * whole { twice * (whole - held) } else { 0.0 };
            all.push(rest(constant));
            left.push(rest(constant + (1..=harmonics).map(share).sum::<f64>()));
        }
        let weights = transforms.iter().map(|value| value / intervals as f64).collect();
        Some(Self { weights, all, left, fft: RealFft::new(intervals) })
    }

    /// Coefficients of the curve with control points `M × d`, in their unit, exact up to rounding: the same parameter, no points
    /// between.
    ///
    /// Cost: `d` transforms of length `M`, and `n · d`.
    pub fn of(&self, control_points: &Matrix) -> FourierExpansion {
        let (intervals, d, harmonics) = (self.fft.len(), control_points.ncols(), self.weights.len() - 1);
        let mut expansion = FourierExpansion {
            constant: vec![0.0; d],
            cosine: vec![0.0; harmonics * d],
            sine: vec![0.0; harmonics * d],
            residual_power: 0.0,
        };
        let (mut all, mut left) = (0.0, 0.0);
        let mut scratch = self.fft.scratch();
        let mut spectrum = vec![Complex64::ZERO; self.fft.spectrum_len()];
        let unit = control_points.amax();
        for c in 0..d {
            // The position of the curve takes no digits of its shape, and its unit none of the squares.
            let mean = control_points.column(c).sum() / intervals as f64;
            let signal: Vec<f64> = control_points.column(c).iter().map(|x| x - mean).collect();
            self.fft.forward(&signal, &mut spectrum, &mut scratch);
            let at = |k: usize| match k % intervals {
                k if k < spectrum.len() => spectrum[k],
                k => spectrum[intervals - k].conj(),
            };
            expansion.constant[c] = self.weights[0] * (intervals as f64 * mean + spectrum[0].re);
            for k in 1..=harmonics {
                let value = 2.0 * self.weights[k] * at(k);
                expansion.cosine[(k - 1) * d + c] = value.re;
                expansion.sine[(k - 1) * d + c] = -value.im;
            }
            spectrum[0].re += intervals as f64 * mean;
            for ((value, all_of), left_of) in spectrum.iter().zip(&self.all).zip(&self.left) {
                let square = (value / unit).norm_sqr();
                all += all_of * square;
                left += left_of * square;
            }
        }
        expansion.residual_power = if all > 0.0 { (left / all).min(1.0) } else { 0.0 };
        expansion
    }
}

/// A rule that integrates pieces of a generator times cosines up to the frequency `omega`.
fn rule(generator: &Generator, omega: f64) -> GaussLegendre {
    let turns = (omega * HALF_PIECE).ceil() as usize;
    GaussLegendre::new(generator.terms() / 2 + turns + SPARE_NODES)
}

/// `∫ φ(t) cos ωt dt` of an even generator: twice its right half.
fn transform(generator: &Generator, rule: &GaussLegendre, omega: f64) -> f64 {
    let support = generator.support();
    let piece = |p: usize| {
        let middle = 0.5 * (p as f64 - support as f64) + HALF_PIECE;
        let value =
            |s: f64| evaluate_taylor(generator.piece(p), s, 0) * (omega * (middle + HALF_PIECE * s)).cos();
        HALF_PIECE * rule.integrate(-1.0, 1.0, value)
    };
    2.0 * (support..2 * support).map(piece).sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generator::GeneratorKind;
    use crate::representation::Representation;

    fn space(control_points: usize, generator: GeneratorKind) -> ShapeSpace {
        ShapeSpace::new(&Representation::ClosedCurve { dimension: 2, control_points, generator }).unwrap()
    }

    const ELLIPSE: FourierCurve<'static> =
        FourierCurve { constant: &[3.0, -1.0], cosine: &[2.0, 0.5], sine: &[-0.25, 1.0] };
    const BEAN: FourierCurve<'static> = FourierCurve {
        constant: &[3.0, -1.0],
        cosine: &[2.0, 0.5, 0.25, 0.0],
        sine: &[-0.25, 1.0, 0.0, 0.125],
    };

    #[test]
    fn points_are_those_of_the_formula() {
        let points = ELLIPSE.points(4);
        let rows = [[5.0, -0.5], [2.75, 0.0], [1.0, -1.5], [3.25, -2.0]];
        for (j, row) in rows.iter().enumerate() {
            for c in 0..2 {
                assert!((points[(j, c)] - row[c]).abs() < 1e-15, "{j} {c} {}", points[(j, c)]);
            }
        }
    }

    #[test]
    fn a_space_that_contains_a_curve_gives_it_back() {
        let trigonometric = space(7, GeneratorKind::Trigonometric {});
        let control_points = trigonometric.fourier_control_points(&ELLIPSE).unwrap();
        let curve = Curve::of(&trigonometric, &control_points).unwrap();
        let (found, wanted) = (curve.evaluate_all(&[0.3], 0), ELLIPSE.points(10));
        assert!((found[0] - wanted[(3, 0)]).abs() < 1e-14 && (found[1] - wanted[(3, 1)]).abs() < 1e-14);
        // The generator has the pole of the first harmonic only.
        assert!(trigonometric.fourier_control_points(&BEAN).is_none());
        let splines = space(7, GeneratorKind::Bspline { degree: 3 });
        assert!(splines.fourier_control_points(&ELLIPSE).is_none());
        // Three points do not tell a second harmonic from the first.
        assert!(space(3, GeneratorKind::Trigonometric {}).fourier_control_points(&BEAN).is_none());
    }

    /// Coefficients by the trapezoidal rule on many points: exact up to aliases of harmonics far beyond.
    fn sampled(space: &ShapeSpace, control_points: &Matrix, harmonics: usize, count: usize) -> [Vec<f64>; 3] {
        let curve = Curve::of(space, control_points).unwrap();
        let places: Vec<f64> = (0..count).map(|j| j as f64 / count as f64).collect();
        let values = curve.evaluate_all(&places, 0);
        let d = control_points.ncols();
        let mean = |k: usize, c: usize, wave: fn(f64) -> f64| {
            let term = |j: usize| values[c * count + j] * wave(TAU * (j * k % count) as f64 / count as f64);
            (0..count).map(term).sum::<f64>() / count as f64
        };
        let all = |wave: fn(f64) -> f64| {
            (1..=harmonics).flat_map(|k| (0..d).map(move |c| 2.0 * mean(k, c, wave))).collect()
        };
        [(0..d).map(|c| mean(0, c, f64::cos)).collect(), all(f64::cos), all(f64::sin)]
    }

    #[test]
    fn coefficients_of_a_curve_are_those_of_its_points() {
        let bumps = |n: usize| Matrix::from_fn(n, 2, |k, c| ((3 * k * k + 7 * c + k) % 11) as f64 - 4.0);
        let generators = [
            GeneratorKind::Trigonometric {},
            GeneratorKind::Bspline { degree: 3 },
            GeneratorKind::Bspline { degree: 5 },
        ];
        for (generator, n, harmonics) in generators
            .iter()
            .flat_map(|g| [(g, 9, 4), (g, 16, 20), (g, 7, 0)])
            .map(|(g, n, h)| (g.clone(), n, h))
        {
            let space = space(n, generator);
            let control_points = bumps(n);
            let found = FourierSeries::new(&space, harmonics).unwrap().of(&control_points);
            let wanted = sampled(&space, &control_points, harmonics, 1 << 14);
            let found = [&found.constant, &found.cosine, &found.sine];
            for (found, wanted) in found.into_iter().zip(&wanted) {
                assert_eq!(found.len(), wanted.len());
                // The aliases of a generator with one continuous derivative fall with the third power of the number of points.
                for (found, wanted) in found.iter().zip(wanted) {
                    assert!((found - wanted).abs() < 1e-10, "{found} {wanted} of {n}");
                }
            }
        }
    }

    #[test]
    fn an_ellipse_comes_back_and_nothing_is_left() {
        let trigonometric = space(7, GeneratorKind::Trigonometric {});
        let far = FourierCurve { constant: &[3.0e6, -1.0e6], ..ELLIPSE };
        for (curve, rounding) in [(ELLIPSE, 1e-15), (far, 1e-9)] {
            let control_points = trigonometric.fourier_control_points(&curve).unwrap();
            let found = FourierSeries::new(&trigonometric, 3).unwrap().of(&control_points);
            let wanted = [curve.constant, &[2.0, 0.5, 0.0, 0.0, 0.0, 0.0], &[-0.25, 1.0, 0.0, 0.0, 0.0, 0.0]];
            for (found, wanted) in [&found.constant, &found.cosine, &found.sine].into_iter().zip(wanted) {
                for (found, wanted) in found.iter().zip(wanted) {
                    assert!(
                        (found - wanted).abs() <= 4.0 * rounding * (1.0 + wanted.abs()),
                        "{found} {wanted}"
                    );
                }
            }
            assert!(found.residual_power < rounding, "{}", found.residual_power);
        }
    }

    #[test]
    fn the_share_that_is_left_is_exact() {
        let splines = space(8, GeneratorKind::Bspline { degree: 3 });
        let control_points = Matrix::from_fn(8, 2, |k, c| f64::from((5 * k * k + 3 * c) as u8 % 7));
        let energy = |expansion: &FourierExpansion| {
            expansion.cosine.iter().chain(&expansion.sine).map(|x| 0.5 * x * x).sum::<f64>()
        };
        // Harmonics fall with the fourth power: the rest of 400 is below rounding.
        let whole = energy(&FourierSeries::new(&splines, 400).unwrap().of(&control_points));
        for harmonics in [0, 1, 3, 4, 8, 9, 20] {
            let expansion = FourierSeries::new(&splines, harmonics).unwrap().of(&control_points);
            let wanted = 1.0 - energy(&expansion) / whole;
            assert!(
                (expansion.residual_power - wanted).abs() < 1e-13,
                "{harmonics}: {} {wanted}",
                expansion.residual_power
            );
        }
        let point = Matrix::from_element(8, 2, 5.0);
        assert_eq!(FourierSeries::new(&splines, 3).unwrap().of(&point).residual_power, 0.0);
        let open = Representation::OpenCurve {
            dimension: 2,
            intervals: 8,
            generator: GeneratorKind::Bspline { degree: 3 },
        };
        assert!(FourierSeries::new(&ShapeSpace::new(&open).unwrap(), 3).is_none());
    }
}
