//! Total curvature and turning of a curve.
//!
//! ```text
//! turning ∫ κ dℓ = ∫ dθ        total curvature ∫ |κ| dℓ = ∫ |dθ|        θ direction of the tangent
//! ```
//!
//! Half-segments are split until the tangents of a stretch lie in a narrow cone. In the plane, the angle between the
//! tangents at the ends of a stretch is then the integral itself, provided that it bends to one side only; in space, a
//! Gauss rule gives the integral. At a cusp, the tangents lie in no cone, however short the stretch: the curve has no total
//! curvature.

use super::curve::Curve;
use super::frame::{ROUNDING, cross};
use super::generator::recentre;
use shapelex_numeric::bounded::{Allowance, Stop};
use shapelex_numeric::quadrature::{GaussLegendre, Panels};

/// Total curvature and turning of a curve, in radians.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Turning {
    /// Total curvature, `∫ |κ| dℓ`.
    pub total: f64,
    /// Turning, `∫ κ dℓ`, counter-clockwise positive; zero in space, where curvature has no sign.
    pub signed: f64,
}

/// Sine of the largest angle to the middle tangent for which tangents lie in a cone.
const CONE: f64 = 0.25;

/// Length, as a fraction of a half-segment (`2⁻⁴⁰`), at which a stretch without a cone contains a cusp.
const CUSP: f64 = 1e-12;

/// Length of a stretch around an inflection below which its two sides may cancel in the angle: an error of `10⁻¹²` of the bend.
const INFLECTION: f64 = 1e-6;

/// Tolerance for a cone in space: where a curve is nearly straight, `|r' × r''|` has a kink that a fixed rule misses.
const SPACE: f64 = 1e-12;

/// Gauss nodes per cone in space.
const NODES: usize = 12;

/// Maximum number of stretches and panels of a curve, besides those per half-segment. A cusp takes 40, an inflection 20.
const STRETCHES: usize = 4096;
/// Stretches and panels per half-segment.
const STRETCHES_PER_HALF: usize = 256;

impl Turning {
    /// Turning of a curve with continuous tangents; `None` for a curve with corners or a cusp, or if `stop` returns true. Cost
    /// `O(M n²)`, more near inflections and sharp bends: at most some thousand stretches besides 512 per half-segment.
    pub fn of(curve: &Curve, stop: Stop<'_>) -> Option<Self> {
        Self::counted(curve, stop).0
    }

    /// As [`Self::of`], with the number of stretches that were split and panels that were bisected.
    pub fn counted(curve: &Curve, stop: Stop<'_>) -> (Option<Self>, usize) {
        if curve.smoothness() < 1 {
            return (None, 0);
        }
        let rule = GaussLegendre::new(NODES);
        let most = STRETCHES + STRETCHES_PER_HALF * curve.halves();
        let (mut stretches, mut panels) = (Allowance::new(most, stop), Panels::new(most, stop));
        let mut sum = Self { total: 0.0, signed: 0.0 };
        for half in 0..curve.halves() {
            let pieces: Vec<&[f64]> = (0..curve.dimension()).map(|c| curve.polynomial(half, c)).collect();
            let mut pending = vec![(0.0, 1.0)];
            while let Some((middle, radius)) = pending.pop() {
                let stretch = Stretch::new(&pieces, middle, radius);
                let is_cone = stretch.is_cone();
                let is_split = !is_cone || (stretch.has_inflection() && radius > INFLECTION);
                if is_split && radius >= CUSP && stretches.take() {
                    let quarter = 0.5 * radius;
                    pending.extend([(middle - quarter, quarter), (middle + quarter, quarter)]);
                    continue;
                }
                if !is_cone {
                    return (None, stretches.taken() + panels.halved());
                }
                let (total, signed) = stretch.turn(&rule, &mut panels);
                sum.total += total;
                sum.signed += signed;
            }
        }
        (Some(sum), stretches.taken() + panels.halved())
    }
}

/// Part of a half-segment, by its Taylor vectors about the middle, on `[−1, 1]`.
struct Stretch {
    local: Vec<Vec<f64>>,
    radius: f64,
}

impl Stretch {
    fn new(pieces: &[&[f64]], middle: f64, radius: f64) -> Self {
        Self { local: pieces.iter().map(|piece| recentre(piece, middle, radius)).collect(), radius }
    }

    /// Whether all tangents are close to the middle one.
    fn is_cone(&self) -> bool {
        let slope = norm(self.local.iter().map(|c| c.get(1).copied().unwrap_or(0.0)));
        let bend = norm(
            self.local.iter().map(|c| c.iter().enumerate().skip(2).map(|(m, v)| m as f64 * v.abs()).sum()),
        );
        // A slope that the rounding of the position can explain counts as zero.
        let away = self.local.iter().fold(0.0, |m: f64, c| m.max(c[0].abs()));
        bend <= CONE * slope && slope > ROUNDING * away * self.radius
    }

    /// Whether `r' × r''` may change its sign; never in space, where curvature has no sign.
    fn has_inflection(&self) -> bool {
        let [x, y] = self.local.as_slice() else { return false };
        let derivative = |c: &[f64]| -> Vec<f64> { (1..c.len()).map(|m| m as f64 * c[m]).collect() };
        let (vx, vy) = (derivative(x), derivative(y));
        let (ax, ay) = (derivative(&vx), derivative(&vy));
        let mut product = vec![0.0; vx.len() + ax.len()];
        for (i, (vx, vy)) in vx.iter().zip(&vy).enumerate() {
            for (j, (ax, ay)) in ax.iter().zip(&ay).enumerate() {
                product[i + j] += vx * ay - vy * ax;
            }
        }
        let rest: f64 = product.iter().skip(1).map(|c| c.abs()).sum();
        product.first().is_some_and(|c| c.abs() < rest)
    }

    fn derivative(&self, order: usize, s: f64) -> Vec<f64> {
        let factor = |m: usize| (0..order).map(|i| (m - i) as f64).product::<f64>();
        let at = |c: &Vec<f64>| (order..c.len()).rev().fold(0.0, |sum, m| sum * s + factor(m) * c[m]);
        self.local.iter().map(at).collect()
    }

    fn turn(&self, rule: &GaussLegendre, panels: &mut Panels<'_>) -> (f64, f64) {
        let (first, last) = (self.derivative(1, -1.0), self.derivative(1, 1.0));
        if self.local.len() == 2 {
            let dot = first[0] * last[0] + first[1] * last[1];
            let angle = cross(&first, &last).atan2(dot);
            return (angle.abs(), angle);
        }
        let rate = |s: f64| {
            let (v, a) = (self.derivative(1, s), self.derivative(2, s));
            cross(&v, &a) / v.iter().map(|x| x * x).sum::<f64>()
        };
        (rule.integrate_adaptive((-1.0, 1.0), SPACE, &rate, panels), 0.0)
    }
}

fn norm(values: impl Iterator<Item = f64>) -> f64 {
    values.map(|v| v * v).sum::<f64>().sqrt()
}
