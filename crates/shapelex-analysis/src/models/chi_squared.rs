//! The distribution of a weighted sum of χ² variables, of which sums of squares of exchanged residuals become one as shapes become many.
//!
//! ```text
//! P(Σ_k λ_k χ²_f > x) = [s_0 < 0] + 1/(2πi) ∫_C e^{K(s) − s x} ds/s,      K(s) = −f/2 Σ_k log(1 − 2 λ_k s)
//! ```
//!
//! `C` passes the real axis at the saddle point `K'(s_0) = x`, left of the branch point `1/(2 λ_1)`, and opens to the right, where the
//! integrand falls exponentially: `s = s_0 + κ (cosh t − 1) + i c κ sinh t`. The trapezoidal rule then converges geometrically, to a small
//! relative error far out as well.
//!
//! Sources: Imhof 1961 (the integral along the imaginary axis); Daniels 1987 (saddle points); Talbot 1979 (contours that open).

use std::f64::consts::PI;

use num_complex::Complex64;

/// Step of the rule.
const STEP: f64 = 0.02;
/// Slope of the contour at infinity.
const SLOPE: f64 = 2.0;
/// Most points of the rule: cosh of the last one is beyond the range of exponents.
const MOST: usize = 1000;
/// Bisections for the saddle point.
const HALVINGS: usize = 200;

/// Probability that `Σ λ_k χ²_f`, with positive `weights` `λ` and `f` degrees of freedom each, is at least `x`. `None` without a positive
/// weight. Cost: some hundred logarithms for each weight.
pub fn tail(weights: &[f64], degrees: usize, x: f64) -> Option<f64> {
    let largest = weights.iter().copied().fold(0.0, f64::max);
    if !(largest > 0.0 && largest.is_finite() && x.is_finite()) || degrees == 0 {
        return None;
    }
    if x <= 0.0 {
        return Some(1.0);
    }
    // In units of the largest weight; what is a rounding error of it has no effect.
    let weights: Vec<f64> = weights.iter().map(|w| w / largest).filter(|w| *w > 1e-15).collect();
    let (x, f) = (x / largest, degrees as f64);
    let saddle = saddle(&weights, f, x);
    // Away from the pole at zero, by less than the width of the integrand.
    let deviation = (2.0 * f * weights.iter().map(|w| w * w).sum::<f64>()).sqrt();
    let least = (0.5 / deviation).min(0.25);
    let start = if saddle.abs() < least { least } else { saddle };
    let kappa = 0.5 * start.abs().min(0.5 - start);
    let value = |s: Complex64| {
        let logarithms: Complex64 = weights.iter().map(|w| (1.0 - 2.0 * w * s).ln()).sum();
        (-0.5 * f * logarithms - s * x).exp() / s
    };
    let (mut sum, mut most) = (0.0, 0.0_f64);
    for k in 0..MOST {
        let t = STEP * k as f64;
        let s = Complex64::new(start + kappa * (t.cosh() - 1.0), SLOPE * kappa * t.sinh());
        let slope = Complex64::new(kappa * t.sinh(), SLOPE * kappa * t.cosh());
        let term = value(s) * slope;
        let size = term.norm();
        most = most.max(size);
        sum += if k == 0 { 0.5 * term.im } else { term.im };
        if !(size > 1e-18 * most) {
            break;
        }
    }
    let integral = sum * STEP / PI + if start < 0.0 { 1.0 } else { 0.0 };
    integral.is_finite().then(|| integral.clamp(0.0, 1.0))
}

/// `s < ½` with `Σ f λ/(1 − 2 λ s) = x`, by bisection: the left side grows from 0 to infinity.
fn saddle(weights: &[f64], f: f64, x: f64) -> f64 {
    let slope = |s: f64| weights.iter().map(|w| f * w / (1.0 - 2.0 * w * s)).sum::<f64>();
    // Each weight contributes less than `f/(2 |s|)`.
    let (mut low, mut high) = (-0.5 * f * weights.len() as f64 / x, 0.5 * (1.0 - f64::EPSILON));
    for _ in 0..HALVINGS {
        let middle = 0.5 * (low + high);
        if slope(middle) < x { low = middle } else { high = middle }
    }
    low
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `P(χ²_{2m} > x) = e^{−x/2} Σ_{j<m} (x/2)^j/j!`.
    fn of_even_degrees(m: usize, x: f64) -> f64 {
        let mut term = (-0.5 * x).exp();
        (1..m).fold(term, |sum, j| {
            term *= 0.5 * x / j as f64;
            sum + term
        })
    }

    #[test]
    fn equal_weights_give_the_distribution_of_even_degrees() {
        for (m, x) in
            [(1, 0.01), (1, 1.0), (1, 50.0), (1, 700.0), (5, 3.0), (5, 40.0), (100, 150.0), (100, 200.0)]
                .into_iter()
                .chain([(100, 300.0), (300, 600.0), (300, 560.0), (300, 900.0)])
        {
            let expected = of_even_degrees(m, x);
            for (weights, degrees) in [(vec![0.3; 2 * m], 1), (vec![0.3; m], 2)] {
                let found = tail(&weights, degrees, 0.3 * x).unwrap();
                assert!((found / expected - 1.0).abs() < 1e-9, "{m}, {x}: {found:e} for {expected:e}");
            }
        }
    }

    #[test]
    fn tails_without_a_distribution_are_none() {
        assert_eq!(tail(&[], 1, 1.0), None);
        assert_eq!(tail(&[0.0, -1.0], 1, 1.0), None);
        assert_eq!(tail(&[f64::NAN], 1, 1.0), None);
        assert_eq!(tail(&[1.0], 1, f64::NAN), None);
        assert_eq!(tail(&[1.0], 1, 0.0), Some(1.0));
        assert!(tail(&[1.0, 1e-3], 1, 1e9).unwrap() < 1e-300);
    }
}
