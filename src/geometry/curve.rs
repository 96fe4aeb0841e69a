//! A closed spline curve as one polynomial per coordinate and half-segment.
//!
//! ```text
//! r(u) = Σ_m p_h[m] s^m,   h = ⌊2Nu⌋,   s = 4(Nu − ⌊Nu⌋) − 2(h mod 2) − 1 ∈ [−1, 1]
//! ```
//!
//! Control point `k` contributes piece `p = S + 2(i − k) + q` of the generator to half `q` of segment
//! `i` (`S` the support): sums of Taylor vectors, so bounds, roots and integrals of the curve are those
//! of short polynomials.

use super::generator::Generator;
use super::representation::ShapeSpace;
use crate::numeric::dense::Matrix;

/// Highest derivative that [`ClosedCurve::evaluate`] offers to users: the third jumps at every knot.
pub const MAX_DERIVATIVE: usize = 2;

/// A closed curve in `R^d`.
#[derive(Debug, Clone)]
pub struct ClosedCurve {
    segments: usize,
    dimension: usize,
    terms: usize,
    /// `[half-segment][coordinate][term]`.
    coefficients: Vec<f64>,
}

impl ClosedCurve {
    /// The curve with `control_points` (`N × d`). Cost `O(N d S n)` with `S` the support and `n` the
    /// terms of a piece.
    pub fn new(generator: &Generator, control_points: &Matrix) -> Self {
        let (segments, dimension) = control_points.shape();
        let (terms, support) = (generator.terms(), generator.support() as isize);
        let mut coefficients = vec![0.0; 2 * segments * dimension * terms];
        for half in 0..2 * segments {
            let (i, q) = ((half / 2) as isize, (half % 2) as isize);
            // 0 ≤ S + 2(i − k) + q < 2S
            let first = i - (support - 1 - q).div_euclid(2);
            let last = i + (support + q).div_euclid(2);
            for k in first..=last {
                let piece = generator.piece((support + 2 * (i - k) + q) as usize);
                let row = k.rem_euclid(segments as isize) as usize;
                for c in 0..dimension {
                    let weight = control_points[(row, c)];
                    let target = (half * dimension + c) * terms;
                    for (sum, value) in coefficients[target..target + terms].iter_mut().zip(piece) {
                        *sum += weight * value;
                    }
                }
            }
        }
        Self { segments, dimension, terms, coefficients }
    }

    /// The curve of a shape of `space`, when its shapes are curves.
    pub fn of(space: &ShapeSpace, control_points: &Matrix) -> Option<Self> {
        space.generator().map(|generator| Self::new(generator, control_points))
    }

    /// `d`.
    pub fn dimension(&self) -> usize {
        self.dimension
    }

    /// Number of half-segments, `2N`.
    pub fn halves(&self) -> usize {
        2 * self.segments
    }

    /// Polynomial of one coordinate on one half-segment, in `s ∈ [−1, 1]`.
    pub fn polynomial(&self, half: usize, coordinate: usize) -> &[f64] {
        let start = (half * self.dimension + coordinate) * self.terms;
        &self.coefficients[start..start + self.terms]
    }

    /// `d^j r/du^j` at `u`, taken modulo 1; the right limit where it jumps.
    pub fn evaluate(&self, u: f64, derivative: usize) -> Vec<f64> {
        let position = 2.0 * self.segments as f64 * (u - u.floor());
        let half = (position.floor() as usize).min(self.halves() - 1);
        let scale = (self.segments as f64).powi(derivative as i32);
        (0..self.dimension)
            .map(|c| scale * self.derivative_at(half, c, 2.0 * (position - half as f64) - 1.0, derivative))
            .collect()
    }

    /// Derivative with respect to the cardinal parameter `t = Nu` at `s` of one half-segment.
    pub fn derivative_at(&self, half: usize, coordinate: usize, s: f64, derivative: usize) -> f64 {
        super::generator::evaluate_taylor(self.polynomial(half, coordinate), s, derivative)
    }

    /// Parameter `u` at `s` of a half-segment.
    pub fn parameter(&self, half: usize, s: f64) -> f64 {
        (half as f64 + 0.5 * (s + 1.0)) / self.halves() as f64
    }

    /// `count` points equally spaced in the parameter, starting at `u = 0`, row by row.
    pub fn sample(&self, count: usize) -> Vec<Vec<f64>> {
        (0..count).map(|i| self.evaluate(i as f64 / count as f64, 0)).collect()
    }
}
