//! The piecewise Taylor form of a generator.

/// Half of the length of a piece: pieces are half-integer intervals.
pub const HALF_PIECE: f64 = 0.25;

/// A centred generator with support `[−N/2, N/2]`, as `2N` Taylor vectors of equal length.
#[derive(Debug, Clone, PartialEq)]
pub struct Generator {
    support: usize,
    terms: usize,
    /// `C[p][m]` at `p·terms + m`.
    coefficients: Vec<f64>,
}

impl Generator {
    /// From Taylor vectors: `coefficients` holds `2·support` rows of `terms` numbers.
    pub(super) fn from_pieces(support: usize, terms: usize, coefficients: Vec<f64>) -> Self {
        debug_assert_eq!(coefficients.len(), 2 * support * terms);
        Self { support, terms, coefficients }
    }

    /// `Σ_i w_i φ_i(t − h_i/2)`, with `(w_i, h_i, φ_i)` in `parts`, on a support of `support`.
    pub(super) fn combine(support: usize, parts: &[(f64, isize, &Generator)]) -> Self {
        let terms = parts.iter().map(|(_, _, part)| part.terms).max().unwrap_or(1);
        let mut coefficients = vec![0.0; 2 * support * terms];
        for &(weight, halves, part) in parts {
            let first = halves + support as isize - part.support as isize;
            for p in 0..2 * part.support {
                let target = (first + p as isize) as usize * terms;
                for (m, &c) in part.piece(p).iter().enumerate() {
                    coefficients[target + m] += weight * c;
                }
            }
        }
        Self { support, terms, coefficients }
    }

    /// `factor · φ`.
    pub(super) fn scaled(mut self, factor: f64) -> Self {
        self.coefficients.iter_mut().for_each(|c| *c *= factor);
        self
    }

    /// `N`: the generator vanishes outside `[−N/2, N/2]`.
    pub fn support(&self) -> usize {
        self.support
    }

    /// Length of the Taylor vectors.
    pub fn terms(&self) -> usize {
        self.terms
    }

    /// Taylor vector of piece `p`, `0 ≤ p < 2N`.
    pub fn piece(&self, p: usize) -> &[f64] {
        &self.coefficients[p * self.terms..(p + 1) * self.terms]
    }

    /// `φ^(derivative)(t)`; the right limit where the derivative jumps, zero outside the support.
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
    /// Products of the Taylor vectors are integrated term by term: `∫_{−1}^{1} s^k ds = 2/(k+1)` for
    /// even `k`.
    pub fn correlation(&self, d1: usize, d2: usize, m: isize) -> f64 {
        let pieces = 2 * self.support as isize;
        let overlap = (2 * m).max(0)..pieces.min(pieces + 2 * m);
        let sum: f64 = overlap
            .map(|p| {
                let a = differentiate(self.piece(p as usize), d1);
                let b = differentiate(self.piece((p - 2 * m) as usize), d2);
                integrate_product(&a, &b)
            })
            .sum();
        HALF_PIECE * sum
    }
}

/// Value of the `derivative`-th derivative (in `t`) of `Σ c[m] s^m` at `s`, `dt = H ds`.
pub fn evaluate_taylor(c: &[f64], s: f64, derivative: usize) -> f64 {
    let mut value = 0.0;
    for m in (derivative..c.len()).rev() {
        let factor: f64 = (0..derivative).map(|i| (m - i) as f64).product();
        value = value * s + factor * c[m];
    }
    value / HALF_PIECE.powi(derivative as i32)
}

fn differentiate(c: &[f64], order: usize) -> Vec<f64> {
    let mut c = c.to_vec();
    for _ in 0..order {
        c = (1..c.len()).map(|m| m as f64 * c[m] / HALF_PIECE).collect();
    }
    c
}

fn integrate_product(a: &[f64], b: &[f64]) -> f64 {
    let mut sum = 0.0;
    for (i, &x) in a.iter().enumerate() {
        for j in (i % 2..b.len()).step_by(2) {
            sum += x * b[j] * 2.0 / (i + j + 1) as f64;
        }
    }
    sum
}
