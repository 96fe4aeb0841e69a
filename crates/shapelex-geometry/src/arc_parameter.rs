//! The parameter of a curve as a function of the fraction of its length.
//!
//! ```text
//! ℓ(u) = ∫₀ᵘ |r'|,   u(t) = ℓ⁻¹(t ℓ(1))
//! ```
//!
//! A Gauss rule on every half-segment, and monotone Newton steps within one. Its error is that of the rule: below rounding where the
//! tangent turns slowly, some thousandths of a half-segment at a cusp.

use std::sync::LazyLock;

use super::curve::Curve;
use shapelex_numeric::quadrature::GaussLegendre;

/// Nodes of the rule.
const NODES: usize = 12;
/// Newton steps or bisections within a half-segment: bisections alone end at rounding.
const MAX_STEPS: usize = 50;
/// Change of the local coordinate, which is in [−1, 1], that ends the steps.
const ROUNDING: f64 = 1e-14;

static RULE: LazyLock<GaussLegendre> = LazyLock::new(|| GaussLegendre::new(NODES));

/// Lengths along a curve.
#[derive(Debug)]
pub struct ArcParameter<'a> {
    curve: &'a Curve,
    /// Length up to each end of a half-segment, from 0.
    ends: Vec<f64>,
}

impl<'a> ArcParameter<'a> {
    /// Lengths along `curve`. Cost: 12 speeds per half-segment.
    pub fn of(curve: &'a Curve) -> Self {
        let mut ends = vec![0.0; curve.halves() + 1];
        for half in 0..curve.halves() {
            ends[half + 1] = ends[half] + length_until(curve, half, 1.0);
        }
        Self { curve, ends }
    }

    /// Length of the curve.
    pub fn length(&self) -> f64 {
        self.ends[self.ends.len() - 1]
    }

    /// Length of the shortest half-segment.
    pub fn shortest(&self) -> f64 {
        self.ends.windows(2).map(|ends| ends[1] - ends[0]).fold(f64::INFINITY, f64::min)
    }

    /// The fraction of the length up to `u`, 0 to 1. The length must be positive.
    pub fn fraction(&self, u: f64) -> f64 {
        let (half, s) = self.curve.locate(u);
        (self.ends[half] + length_until(self.curve, half, s)) / self.length()
    }

    /// `u` at the fraction `t` of the length, 0 to 1. The length must be positive. Cost: some 40 speeds.
    pub fn at(&self, t: f64) -> f64 {
        let target = t * self.length();
        let half = self.ends.partition_point(|&end| end <= target).clamp(1, self.ends.len() - 1) - 1;
        let (from, whole) = (self.ends[half], self.ends[half + 1] - self.ends[half]);
        let wanted = (target - from).clamp(0.0, whole);
        let (mut low, mut high) = (-1.0, 1.0);
        let mut s = if whole > 0.0 { 2.0 * wanted / whole - 1.0 } else { -1.0 };
        for _ in 0..MAX_STEPS {
            let excess = length_until(self.curve, half, s) - wanted;
            if excess > 0.0 {
                high = s
            } else {
                low = s
            }
            let newton = s - excess / (0.25 * speed(self.curve, half, s));
            // Also where the speed vanishes: the quotient is then not finite.
            let next = if newton >= low && newton <= high { newton } else { 0.5 * (low + high) };
            let moved = (next - s).abs();
            s = next;
            if moved <= ROUNDING {
                break;
            }
        }
        self.curve.parameter(half, s)
    }
}

/// Length of a half-segment up to the local coordinate `s`.
fn length_until(curve: &Curve, half: usize, s: f64) -> f64 {
    0.25 * RULE.integrate(-1.0, s, |s| speed(curve, half, s))
}

/// Speed with respect to the cardinal parameter, of which a half-segment takes ½.
fn speed(curve: &Curve, half: usize, s: f64) -> f64 {
    (0..curve.dimension()).map(|c| curve.derivative_at(half, c, s, 1).powi(2)).sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generator::GeneratorKind;
    use crate::representation::{Representation, ShapeSpace};
    use shapelex_numeric::dense::Matrix;

    fn curve(generator: GeneratorKind, points: &[[f64; 2]]) -> Curve {
        let representation =
            Representation::ClosedCurve { dimension: 2, control_points: points.len(), generator };
        let space = ShapeSpace::new(&representation).unwrap();
        Curve::of(&space, &Matrix::from_fn(points.len(), 2, |k, c| points[k][c])).unwrap()
    }

    #[test]
    fn a_polygon_is_divided_by_its_edges() {
        let square = curve(GeneratorKind::Bspline { degree: 1 }, &[[0., 0.], [3., 0.], [3., 1.], [0., 1.]]);
        let arc = ArcParameter::of(&square);
        assert!((arc.length() - 8.0).abs() < 1e-14 && (arc.shortest() - 0.5).abs() < 1e-14);
        for (t, u) in [(0.0, 0.0), (0.1875, 0.125), (0.375, 0.25), (0.4375, 0.375), (0.875, 0.75), (1.0, 1.0)]
        {
            assert!((arc.at(t) - u).abs() < 1e-14, "{t}: {}", arc.at(t));
        }
    }

    #[test]
    fn lengths_up_to_the_parameter_are_the_fraction() {
        let points: Vec<[f64; 2]> = (0..12)
            .map(|k| {
                let t = std::f64::consts::TAU * f64::from(k) / 12.0;
                [3.0 * t.cos() + 0.4 * (3.0 * t).sin(), t.sin()]
            })
            .collect();
        let smooth = curve(GeneratorKind::Bspline { degree: 3 }, &points);
        let arc = ArcParameter::of(&smooth);
        for k in 0..=40 {
            let t = f64::from(k) / 40.0;
            // At its end a closed curve begins anew.
            let found = if k == 40 { arc.fraction(arc.at(t)).max(1.0) } else { arc.fraction(arc.at(t)) };
            assert!((found - t).abs() < 1e-13, "{t}: {found}");
        }
    }
}
