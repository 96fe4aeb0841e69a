//! Gauss–Legendre rules and an adaptive integral on a finite interval.

use super::bounded::{Allowance, Stop};

/// Nodes and weights of the `n`-point Gauss–Legendre rule on `[−1, 1]`, exact for degree `2n − 1`.
///
/// Computed by Newton's iteration on the Legendre polynomial from the usual cosine guess; accurate to a few ulp for the
/// `n` used here (`n ≤ 64`).
#[derive(Debug, Clone)]
pub struct GaussLegendre {
    nodes: Vec<f64>,
    weights: Vec<f64>,
}

impl GaussLegendre {
    /// Builds the rule; `n ≥ 1`.
    pub fn new(n: usize) -> Self {
        let (mut nodes, mut weights) = (vec![0.0; n], vec![0.0; n]);
        for i in 0..n {
            let mut x = (std::f64::consts::PI * (i as f64 + 0.75) / (n as f64 + 0.5)).cos();
            let mut slope = 1.0;
            for _ in 0..100 {
                let (value, derivative) = legendre(n, x);
                slope = derivative;
                let step = value / derivative;
                x -= step;
                if step.abs() < 1e-16 {
                    break;
                }
            }
            nodes[i] = x;
            weights[i] = 2.0 / ((1.0 - x * x) * slope * slope);
        }
        Self { nodes, weights }
    }

    /// `(node, weight)` pairs on `[−1, 1]`.
    pub fn points(&self) -> impl Iterator<Item = (f64, f64)> + '_ {
        self.nodes.iter().copied().zip(self.weights.iter().copied())
    }

    /// `∫_a^b f` by the rule.
    pub fn integrate(&self, a: f64, b: f64, f: impl Fn(f64) -> f64) -> f64 {
        let (centre, half) = (0.5 * (a + b), 0.5 * (b - a));
        half * self.points().map(|(node, weight)| weight * f(centre + half * node)).sum::<f64>()
    }

    /// `∫_a^b f` by bisection until two levels agree to `tolerance` (absolute) or to rounding, or until 40 levels or the
    /// budget of panels are spent.
    ///
    /// For integrands that are analytic except for isolated kinks, such as the speed `|r'|` of a curve near a cusp, where a
    /// fixed rule converges slowly.
    pub fn integrate_adaptive(
        &self,
        (a, b): (f64, f64),
        tolerance: f64,
        f: &impl Fn(f64) -> f64,
        panels: &mut Panels<'_>,
    ) -> f64 {
        let whole = self.integrate(a, b, f);
        self.refine((a, b), whole, tolerance, f, MAX_LEVELS, panels)
    }

    fn refine(
        &self,
        (a, b): (f64, f64),
        whole: f64,
        tolerance: f64,
        f: &impl Fn(f64) -> f64,
        depth: u32,
        panels: &mut Panels<'_>,
    ) -> f64 {
        let middle = 0.5 * (a + b);
        let (left, right) = (self.integrate(a, middle, f), self.integrate(middle, b, f));
        let difference = (left + right - whole).abs();
        // Two rules cannot agree better than the rounding of their sums.
        let met = !(difference > tolerance.max(ROUNDING * (left.abs() + right.abs())));
        if met || depth == 0 || !panels.allowance.take() {
            panels.missed += if met { 0.0 } else { difference };
            return left + right;
        }
        let half = 0.5 * tolerance;
        self.refine((a, middle), left, half, f, depth - 1, panels)
            + self.refine((middle, b), right, half, f, depth - 1, panels)
    }
}

/// Maximum number of bisections of a panel: its length is then a rounding error of the first.
const MAX_LEVELS: u32 = 40;

/// Relative rounding error of a sum of some twenty terms of one sign.
const ROUNDING: f64 = 4.0 * f64::EPSILON;

/// Budget of panels that all adaptive integrals of one shape may bisect together.
pub struct Panels<'a> {
    allowance: Allowance<'a>,
    missed: f64,
}

impl<'a> Panels<'a> {
    /// A budget of `most` panels.
    pub fn new(most: usize, stop: Stop<'a>) -> Self {
        Self { allowance: Allowance::new(most, stop), missed: 0.0 }
    }

    /// Number of panels that were bisected.
    pub fn halved(&self) -> usize {
        self.allowance.taken()
    }

    /// Sum of the differences of the last two levels over panels that missed their tolerance: an estimate of the error.
    pub fn missed(&self) -> f64 {
        self.missed
    }
}

/// `(P_n(x), P_n'(x))` by the three-term recurrence.
fn legendre(n: usize, x: f64) -> (f64, f64) {
    let (mut previous, mut current) = (1.0, x);
    for k in 2..=n {
        let k = k as f64;
        (previous, current) = (current, ((2.0 * k - 1.0) * x * current - (k - 1.0) * previous) / k);
    }
    (current, n as f64 * (x * current - previous) / (x * x - 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bounded::never;

    #[test]
    fn exact_for_its_degree() {
        for n in [2, 5, 12, 20] {
            let rule = GaussLegendre::new(n);
            for degree in 0..2 * n {
                let exact = if degree % 2 == 0 { 2.0 / (degree as f64 + 1.0) } else { 0.0 };
                let value = rule.integrate(-1.0, 1.0, |x| x.powi(degree as i32));
                assert!((value - exact).abs() < 4e-15, "n = {n}, degree {degree}: {value} for {exact}");
            }
        }
    }

    #[test]
    fn adaptive_resolves_a_kink() {
        let rule = GaussLegendre::new(10);
        let mut panels = Panels::new(1000, &never);
        let kink = |x: f64| (x - 0.3).abs().sqrt();
        let value = rule.integrate_adaptive((0.0, 1.0), 1e-13, &kink, &mut panels);
        let exact = 2.0 / 3.0 * (0.3f64.powf(1.5) + 0.7f64.powf(1.5));
        assert!((value - exact).abs() < 1e-11, "{value} for {exact}");
    }

    /// Noise has no limit on which two levels could agree: the budget ends the integral, and the error is reported.
    #[test]
    fn noise_ends_within_the_allowance() {
        let rule = GaussLegendre::new(10);
        let evaluations = std::cell::Cell::new(0_usize);
        let noise = |x: f64| {
            evaluations.set(evaluations.get() + 1);
            (x * 1e9).sin()
        };
        for most in [0, 10, 1000] {
            evaluations.set(0);
            let mut panels = Panels::new(most, &never);
            let value = rule.integrate_adaptive((0.0, 1.0), 1e-13, &noise, &mut panels);
            assert!(value.abs() <= 1.0 && panels.missed() > 1e-13, "{value} {}", panels.missed());
            assert_eq!(evaluations.get(), 10 * (3 + 4 * most), "{most}");
        }
    }

    #[test]
    fn values_that_are_no_numbers_end_at_once() {
        let mut panels = Panels::new(1000, &never);
        let value = GaussLegendre::new(10).integrate_adaptive((0.0, 1.0), 0.0, &|_| f64::NAN, &mut panels);
        assert!(value.is_nan() && panels.allowance.take());
    }
}
