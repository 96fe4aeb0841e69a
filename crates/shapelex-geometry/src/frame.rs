//! Tangent, normal and curvature of a curve at a parameter.
//!
//! ```text
//! T = r'/|r'|     plane: N = T rotated by +90°, κ = r' × r''/|r'|³ (positive where the curve turns left)
//!                 space: N = (r'' − (r''·T) T)/|…|, κ = |r' × r''|/|r'|³ ≥ 0
//! ```

use super::curve::Curve;

/// Frame of a curve at one point.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Frame {
    /// Unit tangent; `None` where the speed vanishes.
    pub tangent: Option<Vec<f64>>,
    /// Unit normal; `None` where it is undefined: without a tangent, and in space where the curve is straight.
    pub normal: Option<Vec<f64>>,
    /// Curvature in 1/length, signed in the plane; `None` without a tangent.
    pub curvature: Option<f64>,
}

/// Speed or bend, relative to the size of the control polygon per knot, that counts as zero.
const NOTHING: f64 = 1e-12;

/// Relative rounding error of a position; a speed below it counts as zero as well: the control points coincide.
pub(super) const ROUNDING: f64 = 64.0 * f64::EPSILON;

/// `v × a`: signed in the plane; in space, the length of the vector product.
pub fn cross(v: &[f64], a: &[f64]) -> f64 {
    let minor = |i: usize, j: usize| v[i] * a[j] - v[j] * a[i];
    match v.len() {
        2 => minor(0, 1),
        _ => f64::hypot(f64::hypot(minor(1, 2), minor(2, 0)), minor(0, 1)),
    }
}

impl Frame {
    /// The frame of `curve` at `u`; right limits where derivatives jump.
    pub fn at(curve: &Curve, u: f64) -> Self {
        let (half, s) = curve.locate(u);
        let derivative = |order: usize| -> Vec<f64> {
            (0..curve.dimension()).map(|c| curve.derivative_at(half, c, s, order)).collect()
        };
        // The coefficients of the piece set the scale of rounding.
        let size: f64 = (0..curve.dimension())
            .flat_map(|c| curve.polynomial(half, c).iter().skip(1))
            .fold(0.0, |size, value| size.max(value.abs()));
        let (v, a) = (derivative(1), derivative(2));
        let speed = norm(&v);
        let away = (0..curve.dimension()).fold(0.0, |m: f64, c| m.max(curve.polynomial(half, c)[0].abs()));
        if !(speed > (NOTHING * size).max(ROUNDING * away)) {
            return Self::default();
        }
        let tangent: Vec<f64> = v.iter().map(|x| x / speed).collect();
        // dT/dℓ without the powers of M, which cancel up to the unit of length, and without third powers, which could overflow.
        let turn: Vec<f64> = a.iter().map(|x| x / speed).collect();
        let curvature = cross(&tangent, &turn) / speed;
        let normal = match tangent.as_slice() {
            [x, y] => Some(vec![-y, *x]),
            _ => {
                let along: f64 = a.iter().zip(&tangent).map(|(a, t)| a * t).sum();
                let across: Vec<f64> = a.iter().zip(&tangent).map(|(a, t)| a - along * t).collect();
                let bend = norm(&across);
                (bend > NOTHING * size).then(|| across.iter().map(|x| x / bend).collect())
            }
        };
        Self { tangent: Some(tangent), normal, curvature: Some(curvature) }
    }
}

fn norm(v: &[f64]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}
