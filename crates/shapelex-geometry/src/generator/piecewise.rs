//! The piecewise Taylor form of a generator.

use shapelex_numeric::double_double::Real;

/// Half the length of a piece; pieces are half-integer intervals.
pub const HALF_PIECE: f64 = 0.25;

/// Difference of two pieces, relative to the largest coefficient, below which they are one function: more than their rounding where
/// one is continued over the other.
const SAME_FUNCTION: f64 = 1e-6;

/// Number of phantom control points beyond each end, `K`, for a support of `support`.
pub fn phantoms(support: usize) -> usize {
    support.saturating_sub(1) / 2
}

/// Contribution to the second derivative, relative to the function, below which powers are not stored.
const NEGLIGIBLE: f64 = 1e-19;

/// The Taylor vectors of a centred function in the precision `T`.
#[derive(Debug, Clone)]
pub(super) struct Pieces<T> {
    /// `N`: the function is zero outside `[−N/2, N/2]`.
    pub(super) support: usize,
    /// Length of the Taylor vectors.
    pub(super) terms: usize,
    /// Number of continuous derivatives.
    pub(super) smoothness: usize,
    /// `C[p][m]` at `p·terms + m`, `0 ≤ p < 2N`.
    pub(super) coefficients: Vec<T>,
}

impl<T: Real> Pieces<T> {
    /// `Σ_i w_i φ_i(t − h_i/2)` with `(w_i, h_i, φ_i)` from `parts`, on a support of length `support`.
    pub(super) fn combine(support: usize, parts: &[(T, isize, &Self)]) -> Self {
        let terms = parts.iter().map(|(_, _, part)| part.terms).max().unwrap_or(1);
        let smoothness = parts.iter().map(|(_, _, part)| part.smoothness).min().unwrap_or(0);
        let mut coefficients = vec![T::from(0.0); 2 * support * terms];
        for &(weight, halves, part) in parts {
            let first = halves + support as isize - part.support as isize;
            for p in 0..2 * part.support {
                let target = (first + p as isize) as usize * terms;
                for (m, &c) in part.piece(p).iter().enumerate() {
                    coefficients[target + m] = coefficients[target + m] + weight * c;
                }
            }
        }
        Self { support, terms, smoothness, coefficients }
    }

    fn piece(&self, p: usize) -> &[T] {
        &self.coefficients[p * self.terms..(p + 1) * self.terms]
    }

    /// `∫_{t−1/2}^{t+1/2} φ` for an even `φ`: convolution with a box, which adds a pole at 0.
    ///
    /// The antiderivative of piece `q` minus that of piece `q − 2`, in the local variable; the second half is the mirror
    /// image.
    pub(super) fn smoothed(&self) -> Self {
        let (support, terms) = (self.support + 1, self.terms + 1);
        let zero = T::from(0.0);
        // Antiderivatives F_q of the first pieces, with F = 0 at the left end of the support.
        let mut antiderivatives = vec![zero; support * terms];
        let mut left = zero;
        for q in 0..support.min(2 * self.support) {
            let f = &mut antiderivatives[q * terms..(q + 1) * terms];
            let mut at_left = zero;
            let mut at_right = zero;
            for (m, &c) in self.piece(q).iter().enumerate() {
                f[m + 1] = c * T::from(HALF_PIECE) / T::from((m + 1) as f64);
                at_right = at_right + f[m + 1];
                at_left = if m % 2 == 0 { at_left - f[m + 1] } else { at_left + f[m + 1] };
            }
            f[0] = left - at_left;
            left = f[0] + at_right;
        }
        let mut coefficients = vec![zero; 2 * support * terms];
        for q in 0..support {
            for m in 0..terms {
                let before = if q >= 2 { antiderivatives[(q - 2) * terms + m] } else { zero };
                let value = antiderivatives[q * terms + m] - before;
                coefficients[q * terms + m] = value;
                let mirrored = 2 * support - 1 - q;
                coefficients[mirrored * terms + m] = if m % 2 == 0 { value } else { -value };
            }
        }
        Self { support, terms, smoothness: self.smoothness + 1, coefficients }
    }

    /// `φ(h/2)`, the right limit: the value at the left end `s = −1` of a piece.
    pub(super) fn at_half(&self, h: isize) -> T {
        let p = h + self.support as isize;
        if !(0..2 * self.support as isize).contains(&p) {
            return T::from(0.0);
        }
        let c = self.piece(p as usize);
        c.iter().rev().fold(T::from(0.0), |sum, &value| value - sum)
    }
}

impl<T: Real> From<Pieces<T>> for Generator {
    fn from(pieces: Pieces<T>) -> Self {
        let Pieces { support, terms, smoothness, coefficients } = pieces;
        let rounded: Vec<f64> = coefficients.into_iter().map(Into::into).collect();
        // Drop the powers that only the higher precision needed.
        let largest = |m: usize| rounded.iter().skip(m).step_by(terms).fold(0.0, |x: f64, c| x.max(c.abs()));
        let scale = (0..terms).map(largest).fold(0.0, f64::max);
        let matters = |m: &usize| largest(*m) * (m * m) as f64 > NEGLIGIBLE * scale;
        let kept = (0..terms).rev().find(matters).map_or(1, |m| m + 1);
        Self {
            support,
            terms: kept,
            smoothness,
            shifted: false,
            coefficients: rounded.chunks_exact(terms).flat_map(|c| &c[..kept]).copied().collect(),
        }
    }
}

/// A centred generator with support `[−N/2, N/2]`, as `2N` Taylor vectors of equal length. A shifted one, `φ(t − ½)`, has the support
/// `[1 − N/2, N/2]`: its first two vectors are zero.
#[derive(Debug, Clone, PartialEq)]
pub struct Generator {
    support: usize,
    terms: usize,
    smoothness: usize,
    shifted: bool,
    /// `C[p][m]` at `p·terms + m`.
    coefficients: Vec<f64>,
}

impl Generator {
    /// `φ(t − ½)`, for a centred generator of an odd support: its knots are the integers.
    pub(super) fn shifted(self) -> Self {
        let mut coefficients = vec![0.0; 2 * self.terms];
        coefficients.extend(self.coefficients);
        Self { support: self.support + 1, shifted: true, coefficients, ..self }
    }

    /// Whether it is `φ(t − ½)` of a centred `φ`.
    pub fn is_shifted(&self) -> bool {
        self.shifted
    }

    /// Number of pieces before the support: they are zero.
    pub fn pieces_before(&self) -> usize {
        if self.shifted { 2 } else { 0 }
    }

    /// Numbers of control points beyond the ends of an open line that have an influence on it: before its first knot, and after its
    /// last one.
    pub fn beyond(&self) -> [usize; 2] {
        let before = phantoms(self.support);
        [before, before - usize::from(self.shifted)]
    }

    /// `factor · φ`.
    pub(super) fn scaled(mut self, factor: f64) -> Self {
        self.coefficients.iter_mut().for_each(|c| *c *= factor);
        self
    }

    /// Length of the support, `N`: the generator vanishes outside `[−N/2, N/2]`.
    pub fn support(&self) -> usize {
        self.support
    }

    /// Number of continuous derivatives.
    pub fn smoothness(&self) -> usize {
        self.smoothness
    }

    /// Length of the Taylor vectors.
    pub fn terms(&self) -> usize {
        self.terms
    }

    /// Whether the function is one analytic function on every interval between knots, so that all breaks are knots.
    pub fn breaks_at_knots_only(&self) -> bool {
        let scale = self.scale();
        let continues = |p: usize| {
            let (one, next) = (self.piece(p), self.piece(p + 1));
            (0..=self.terms).all(|k| {
                let s = 2.0 * k as f64 / self.terms as f64 - 1.0;
                let difference = evaluate_taylor(one, s + 2.0, 0) - evaluate_taylor(next, s, 0);
                difference.abs() <= SAME_FUNCTION * scale
            })
        };
        // Of an odd support, the ends are not knots.
        self.support.is_multiple_of(2) && (0..2 * self.support).step_by(2).all(continues)
    }

    /// Largest coefficient of each power in a Taylor vector, relative to the largest of all: of pieces, or of the intervals between
    /// knots if `by_intervals`, where [breaks](Self::breaks_at_knots_only) are knots.
    pub fn majorant(&self, by_intervals: bool) -> Vec<f64> {
        let mut majorant = vec![0.0_f64; self.terms];
        let mut join = |c: &[f64]| majorant.iter_mut().zip(c).for_each(|(most, c)| *most = most.max(c.abs()));
        for p in 0..2 * self.support {
            match by_intervals {
                true if p % 2 == 0 => join(&recentre(self.piece(p), 1.0, 2.0)),
                true => (),
                false => join(self.piece(p)),
            }
        }
        let largest = majorant.iter().fold(f64::MIN_POSITIVE, |most, c| most.max(*c));
        majorant.iter().map(|c| c / largest).collect()
    }

    /// Largest coefficient.
    fn scale(&self) -> f64 {
        self.coefficients.iter().fold(f64::MIN_POSITIVE, |most, c| most.max(c.abs()))
    }

    /// Taylor vector of piece `p`, `0 ≤ p < 2N`.
    pub fn piece(&self, p: usize) -> &[f64] {
        &self.coefficients[p * self.terms..(p + 1) * self.terms]
    }

    /// `φ^(derivative)(t)`: the right limit where the derivative jumps, zero outside the support.
    pub fn evaluate(&self, t: f64, derivative: usize) -> f64 {
        let position = 2.0 * t + self.support as f64;
        if !(0.0..2.0 * self.support as f64).contains(&position) {
            return 0.0;
        }
        let p = position.floor();
        evaluate_taylor(self.piece(p as usize), 2.0 * (position - p) - 1.0, derivative)
    }

    /// `a_{d₁d₂}[m] = ∫ φ^(d₁)(t) φ^(d₂)(t − m) dt`, exact up to rounding; zero for `|m| ≥ N`.
    ///
    /// Products of the Taylor vectors are integrated term by term: `∫_{−1}^{1} s^k ds = 2/(k+1)` for even `k`.
    pub fn correlation(&self, d1: usize, d2: usize, m: isize) -> f64 {
        let pieces = 2 * self.support as isize;
        let overlap = (2 * m).max(0)..pieces.min(pieces + 2 * m);
        overlap.map(|p| self.piece_product(d1, p as usize, d2, (p - 2 * m) as usize)).sum()
    }

    /// `(A², B²)`, the extremes of `Σ_m a_00[m] cos mθ = Σ_k |φ̂(θ + 2πk)|²`, on a grid of 4001 angles.
    pub fn riesz_bounds_squared(&self) -> (f64, f64) {
        const STEPS: usize = 4000;
        let a: Vec<f64> = (0..self.support as isize).map(|m| self.correlation(0, 0, m)).collect();
        let at = |theta: f64| {
            a[0] + 2.0 * a.iter().enumerate().skip(1).map(|(m, a)| a * (m as f64 * theta).cos()).sum::<f64>()
        };
        let values = (0..=STEPS).map(|i| at(std::f64::consts::PI * i as f64 / STEPS as f64));
        values.fold((f64::MAX, f64::MIN), |(low, high), value| (low.min(value), high.max(value)))
    }

    /// `∫ φ^(d₁) φ^(d₂)` over one half-integer interval, with piece `p` of the first factor and piece `q` of the second.
    pub fn piece_product(&self, d1: usize, p: usize, d2: usize, q: usize) -> f64 {
        let (a, b) = (differentiate(self.piece(p), d1), differentiate(self.piece(q), d2));
        HALF_PIECE * integrate_product(&a, &b)
    }
}

/// Value at `s` of the `derivative`-th derivative (in `t`) of `Σ c[m] s^m`, with `dt = H ds`.
pub fn evaluate_taylor(c: &[f64], s: f64, derivative: usize) -> f64 {
    let mut value = 0.0;
    for m in (derivative..c.len()).rev() {
        let factor: f64 = (0..derivative).map(|i| (m - i) as f64).product();
        value = value * s + factor * c[m];
    }
    value / HALF_PIECE.powi(derivative as i32)
}

/// Taylor vector of the `order`-th derivative in `t`.
pub fn differentiate(c: &[f64], order: usize) -> Vec<f64> {
    let mut c = c.to_vec();
    for _ in 0..order {
        c = (1..c.len()).map(|m| m as f64 * c[m] / HALF_PIECE).collect();
    }
    c
}

/// `∫_{−1}^{1} a(s) b(s) ds`.
pub fn integrate_product(a: &[f64], b: &[f64]) -> f64 {
    let mut sum = 0.0;
    for (i, &x) in a.iter().enumerate() {
        for j in (i % 2..b.len()).step_by(2) {
            sum += x * b[j] * 2.0 / (i + j + 1) as f64;
        }
    }
    sum
}

/// Coefficients of `p(middle + radius s)`.
pub fn recentre(p: &[f64], middle: f64, radius: f64) -> Vec<f64> {
    let mut c = p.to_vec();
    let n = c.len();
    for start in 0..n {
        for i in (start..n - 1).rev() {
            c[i] += middle * c[i + 1];
        }
    }
    let mut power = 1.0;
    for value in &mut c {
        *value *= power;
        power *= radius;
    }
    c
}
