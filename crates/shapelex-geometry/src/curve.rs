//! A spline curve, closed or open, as one polynomial per coordinate and half-segment.
//!
//! ```text
//! r(u) = Σ_m p_h[m] s^m,   h = ⌊2Mu⌋,   s = 4(Mu − ⌊Mu⌋) − 2(h mod 2) − 1 ∈ [−1, 1]
//! ```
//!
//! Control point `k` contributes piece `p = N + 2(i − k) + q` of the generator to half `q` of segment `i` (`N` is the
//! support). The polynomials are sums of Taylor vectors, so bounds, roots and integrals of the curve are those of short
//! polynomials.

use super::generator::{Generator, evaluate_taylor};
use super::knot_line::locate;
use super::open::covering;
use super::representation::ShapeSpace;
use shapelex_numeric::dense::Matrix;

/// Highest derivative that clients can request; the third one jumps at every knot.
pub const MAX_DERIVATIVE: usize = 2;

/// Maximum rounding error of an evaluation, relative to the largest coordinate.
const ROUNDING: f64 = 64.0 * f64::EPSILON;

/// Exponent up to which a power of two has a finite normal reciprocal.
const MAX_BINARY: f64 = 1000.0;

/// A curve `r: [0, 1] → R^d`, with `r(0) = r(1)` when closed.
#[derive(Debug, Clone)]
pub struct Curve {
    segments: usize,
    closed: bool,
    dimension: usize,
    smoothness: usize,
    terms: usize,
    /// `[half-segment][coordinate][term]`.
    coefficients: Vec<f64>,
}

impl Curve {
    /// The closed curve with `control_points` (`M × d`). Cost `O(M d N n)`, where `N` is the support and `n` the number of
    /// terms per piece.
    pub fn closed(generator: &Generator, control_points: &Matrix) -> Self {
        let segments = control_points.nrows();
        let row = |k: isize| k.rem_euclid(segments as isize) as usize;
        Self::new(generator, control_points, segments, true, row)
    }

    /// The open curve with `control_points` (`(M + 1 + 2K) × d`, phantoms included, `K = ⌈N/2⌉ − 1`; one less if shifted).
    pub fn open(generator: &Generator, control_points: &Matrix) -> Self {
        let [before, after] = generator.beyond();
        let segments = control_points.nrows() - 1 - before - after;
        Self::new(generator, control_points, segments, false, |k| (k + before as isize) as usize)
    }

    fn new(
        generator: &Generator,
        control_points: &Matrix,
        segments: usize,
        closed: bool,
        row: impl Fn(isize) -> usize,
    ) -> Self {
        let (terms, dimension) = (generator.terms(), control_points.ncols());
        let mut coefficients = vec![0.0; 2 * segments * dimension * terms];
        for half in 0..2 * segments {
            for (k, p) in covering(generator, half) {
                let (piece, row) = (generator.piece(p), row(k));
                for c in 0..dimension {
                    let weight = control_points[(row, c)];
                    let target = (half * dimension + c) * terms;
                    for (sum, value) in coefficients[target..target + terms].iter_mut().zip(piece) {
                        *sum += weight * value;
                    }
                }
            }
        }
        let smoothness = generator.smoothness();
        Self { segments, closed, dimension, smoothness, terms, coefficients }
    }

    /// Minimum and maximum that a coordinate may have on a half-segment: one side of a bounding box.
    pub fn half_box(&self, half: usize, coordinate: usize) -> [f64; 2] {
        let piece = self.polynomial(half, coordinate);
        let reach: f64 = piece.iter().skip(1).map(|value| value.abs()).sum();
        [piece[0] - reach, piece[0] + reach]
    }

    /// A power of two near the extent of all `curves` together, but not below the rounding error of their largest coordinate;
    /// 1 if both vanish. Scaled by its reciprocal, the curves have coordinates near 1 with the same digits.
    pub fn unit(curves: &[&Self]) -> f64 {
        let (mut extent, mut largest) = (0.0_f64, 0.0_f64);
        for c in 0..curves.iter().map(|curve| curve.dimension).max().unwrap_or(0) {
            let boxes =
                curves.iter().flat_map(|curve| (0..curve.halves()).map(move |h| curve.half_box(h, c)));
            let [low, high] =
                boxes.fold([f64::MAX, f64::MIN], |[l, h], [low, high]| [l.min(low), h.max(high)]);
            extent = extent.max(high - low);
            largest = largest.max(high.abs()).max(low.abs());
        }
        power_of_two(extent, largest)
    }

    /// The same curve scaled by `factor`.
    pub fn scaled(&self, factor: f64) -> Self {
        Self { coefficients: self.coefficients.iter().map(|value| value * factor).collect(), ..*self }
    }

    /// The curve of a shape of `space`; `None` if its shapes are not curves.
    pub fn of(space: &ShapeSpace, control_points: &Matrix) -> Option<Self> {
        let generator = space.generator()?;
        Some(if space.representation().is_closed() {
            Self::closed(generator, control_points)
        } else {
            Self::open(generator, control_points)
        })
    }

    /// Dimension of the points, `d`.
    pub fn dimension(&self) -> usize {
        self.dimension
    }

    /// Whether the curve is closed.
    pub fn is_closed(&self) -> bool {
        self.closed
    }

    /// Number of continuous derivatives.
    pub fn smoothness(&self) -> usize {
        self.smoothness
    }

    /// Number of segments, `M`.
    pub fn segments(&self) -> usize {
        self.segments
    }

    /// Number of half-segments, `2M`.
    pub fn halves(&self) -> usize {
        2 * self.segments
    }

    /// Polynomial of one coordinate on one half-segment, in `s ∈ [−1, 1]`.
    pub fn polynomial(&self, half: usize, coordinate: usize) -> &[f64] {
        let start = (half * self.dimension + coordinate) * self.terms;
        &self.coefficients[start..start + self.terms]
    }

    /// Half-segment and local coordinate `s` of a parameter, which is reduced modulo 1 on closed curves and clamped to `[0, 1]`
    /// on open ones.
    pub fn locate(&self, u: f64) -> (usize, f64) {
        locate(u, self.segments, self.closed)
    }

    /// `d^j r/du^j` at `u`: the right limit where it jumps, the left limit at the end of an open curve.
    pub fn evaluate(&self, u: f64, derivative: usize) -> Vec<f64> {
        let mut value = vec![0.0; self.dimension];
        self.evaluate_into(u, derivative, &mut value);
        value
    }

    /// As [`Self::evaluate`], written to `value` (`d` numbers).
    pub fn evaluate_into(&self, u: f64, derivative: usize, value: &mut [f64]) {
        let (half, s) = self.locate(u);
        let scale = (self.segments as f64).powi(derivative as i32);
        for (c, value) in value.iter_mut().enumerate() {
            *value = match derivative {
                0 => horner(self.polynomial(half, c), s),
                _ => scale * self.derivative_at(half, c, s, derivative),
            };
        }
    }

    /// [`Self::evaluate`] at many parameters, coordinate-major.
    pub fn evaluate_all(&self, parameters: &[f64], derivative: usize) -> Vec<f64> {
        let count = parameters.len();
        let mut values = vec![0.0; count * self.dimension];
        let scale = (self.segments as f64).powi(derivative as i32);
        for (i, &u) in parameters.iter().enumerate() {
            let (half, s) = self.locate(u);
            for c in 0..self.dimension {
                values[c * count + i] = match derivative {
                    0 => horner(self.polynomial(half, c), s),
                    _ => scale * self.derivative_at(half, c, s, derivative),
                };
            }
        }
        values
    }

    /// Derivative with respect to the cardinal parameter `t = Mu`, at `s` of one half-segment.
    pub fn derivative_at(&self, half: usize, coordinate: usize, s: f64, derivative: usize) -> f64 {
        evaluate_taylor(self.polynomial(half, coordinate), s, derivative)
    }

    /// Parameter `u` at local coordinate `s` of a half-segment.
    pub fn parameter(&self, half: usize, s: f64) -> f64 {
        (half as f64 + 0.5 * (s + 1.0)) / self.halves() as f64
    }

    /// `count` equally spaced parameters from `u = 0`: `u = i/count` on closed curves, `u = i/(count − 1)` on open ones, which
    /// include their end point.
    pub fn parameters(&self, count: usize) -> Vec<f64> {
        let steps = if self.closed { count } else { count.saturating_sub(1).max(1) };
        (0..count).map(|i| i as f64 / steps as f64).collect()
    }

    /// The points at [`Self::parameters`], row by row.
    pub fn sample(&self, count: usize) -> Vec<Vec<f64>> {
        self.parameters(count).into_iter().map(|u| self.evaluate(u, 0)).collect()
    }
}

/// [`Curve::unit`] of the coordinates of points instead of those of curves.
pub(crate) fn unit_of<'a>(coordinates: impl Iterator<Item = &'a [f64]>) -> f64 {
    let (mut extent, mut largest) = (0.0_f64, 0.0_f64);
    for coordinate in coordinates {
        let range = |[low, high]: [f64; 2], value: &f64| [low.min(*value), high.max(*value)];
        let [low, high] = coordinate.iter().fold([f64::MAX, f64::MIN], range);
        extent = extent.max(high - low);
        largest = largest.max(high.abs()).max(low.abs());
    }
    power_of_two(extent, largest)
}

fn power_of_two(extent: f64, largest: f64) -> f64 {
    let size = extent.max(ROUNDING * largest);
    if size > 0.0 && size.is_finite() {
        size.log2().round().clamp(-MAX_BINARY, MAX_BINARY).exp2()
    } else {
        1.0
    }
}

/// `Σ c[m] s^m`.
fn horner(c: &[f64], s: f64) -> f64 {
    c.iter().rev().fold(0.0, |sum, &value| sum * s + value)
}
