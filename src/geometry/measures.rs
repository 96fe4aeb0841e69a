//! Measures of curves: exact where the integrand is polynomial, adaptive for the length.
//!
//! ```text
//! area = ½ ∮ x dy − y dx     centroid = (∮ x²/2 dy, −∮ y²/2 dx) / area     length = ∫ |r'| du
//! ∬ x² = ∮ x³/3 dy,  ∬ xy = ∮ x²y/2 dy,  ∬ y² = −∮ y³/3 dx                 second moments of the enclosed area
//! energies ∫ |r'|² du, ∫ |r''|² du     total curvature ∫ |κ| dℓ, turning ∫ κ dℓ,  κ = r' × r''/|r'|³
//! ```

use serde::Serialize;

use super::curve::Curve;
use super::generator::{HALF_PIECE, differentiate, integrate_product};
use super::turning::Turning;
use crate::numeric::quadrature::GaussLegendre;

/// Direction in which a planar curve encloses its area.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Orientation {
    /// Positive area (y axis up).
    CounterClockwise,
    /// Negative area.
    Clockwise,
    /// The signed area vanishes against the squared perimeter.
    None,
}

/// Measures of one curve, in the unit of its control points.
#[derive(Debug, Clone, PartialEq)]
pub struct CurveMeasures {
    /// Whether the end is the start.
    pub closed: bool,
    /// What a closed planar curve encloses.
    pub enclosed: Option<Enclosed>,
    /// Mean position along the parameter, `∫ r du`.
    pub mean_position: Vec<f64>,
    /// Length of the curve, to `10⁻¹⁰` relative.
    pub length: f64,
    /// Smallest and largest coordinates.
    pub bounding_box: (Vec<f64>, Vec<f64>),
    /// `∫ |r'|² du`.
    pub stretching_energy: f64,
    /// `∫ |r''|² du`; none for curves with corners, where it is infinite.
    pub bending_energy: Option<f64>,
    /// `∫ |κ| dℓ` in radians; none for curves with corners or cusps.
    pub total_curvature: Option<f64>,
    /// `∫ κ dℓ` in radians, counter-clockwise positive: `2π` times the turning number of a closed curve. Planar curves
    /// only.
    pub turning: Option<f64>,
}

/// What a closed planar curve encloses.
#[derive(Debug, Clone, PartialEq)]
pub struct Enclosed {
    /// Signed area, counter-clockwise positive.
    pub signed_area: f64,
    /// Sign of the area.
    pub orientation: Orientation,
    /// Centroid, when there is an orientation.
    pub centroid: Option<[f64; 2]>,
    /// `∬ (x − x̄)(x − x̄)ᵀ dA` about the centroid, positive for either orientation of a simple curve (parts that the
    /// curve encloses the other way count negative, as in the area); when there is one.
    pub second_moments: Option<[[f64; 2]; 2]>,
}

/// Relative to the squared perimeter: a circle has `1/(4π) ≈ 0.08`; below this the sign is rounding.
const NO_AREA: f64 = 1e-12;

/// Gauss nodes per half-segment: exact to `2·10⁻¹⁵` for products of three generators.
const NODES: usize = 12;

impl CurveMeasures {
    /// Measures `curve`. Cost `O(M)` quadratures; length and curvature add panels near cusps.
    pub fn of(curve: &Curve) -> Self {
        let rule = GaussLegendre::new(NODES);
        let length = length(curve, &rule);
        let planar = curve.dimension() == 2;
        let turning = Turning::of(curve);
        Self {
            closed: curve.is_closed(),
            enclosed: (planar && curve.is_closed()).then(|| Enclosed::of(curve, &rule, length)),
            mean_position: (0..curve.dimension())
                .map(|c| {
                    integrate(curve, &rule, |half, s| curve.derivative_at(half, c, s, 0)) / segments(curve)
                })
                .collect(),
            length,
            bounding_box: bounding_box(curve),
            stretching_energy: energy(curve, 1),
            bending_energy: (curve.smoothness() >= 1).then(|| energy(curve, 2)),
            total_curvature: turning.map(|turning| turning.total),
            turning: turning.filter(|_| planar).map(|turning| turning.signed),
        }
    }
}

impl Enclosed {
    fn of(curve: &Curve, rule: &GaussLegendre, length: f64) -> Self {
        // About the first point of the curve, so that a shape far from the origin keeps its digits.
        let origin = curve.evaluate(0.0, 0);
        let signed_area = signed_area(curve, rule);
        let orientation = orientation(signed_area, length);
        let from = |about: [f64; 2]| move |half, s, c: usize| curve.derivative_at(half, c, s, 0) - about[c];
        let slope = |half, s, c| curve.derivative_at(half, c, s, 1);
        let centroid = (orientation != Orientation::None).then(|| {
            let r = from([origin[0], origin[1]]);
            let mx = integrate(curve, rule, |h, s| 0.5 * r(h, s, 0).powi(2) * slope(h, s, 1));
            let my = integrate(curve, rule, |h, s| -0.5 * r(h, s, 1).powi(2) * slope(h, s, 0));
            [origin[0] + mx / signed_area, origin[1] + my / signed_area]
        });
        let second_moments = centroid.map(|about| {
            let r = from(about);
            let sign = signed_area.signum();
            let xx = integrate(curve, rule, |h, s| r(h, s, 0).powi(3) / 3.0 * slope(h, s, 1));
            let xy = integrate(curve, rule, |h, s| 0.5 * r(h, s, 0).powi(2) * r(h, s, 1) * slope(h, s, 1));
            let yy = integrate(curve, rule, |h, s| -r(h, s, 1).powi(3) / 3.0 * slope(h, s, 0));
            [[sign * xx, sign * xy], [sign * xy, sign * yy]]
        });
        // Fourth powers leave the range of numbers first.
        let second_moments =
            second_moments.filter(|m| m.as_flattened().iter().all(|value| value.is_finite()));
        Self { signed_area, orientation, centroid, second_moments }
    }
}

/// `∫₀¹ |d^j r/du^j|² du`, by products of the polynomials.
fn energy(curve: &Curve, derivative: usize) -> f64 {
    let square = |half: usize, c: usize| {
        let p = differentiate(curve.polynomial(half, c), derivative);
        integrate_product(&p, &p)
    };
    let sum: f64 = (0..curve.halves())
        .flat_map(|half| (0..curve.dimension()).map(move |c| (half, c)))
        .map(|(h, c)| square(h, c))
        .sum();
    HALF_PIECE * sum * segments(curve).powi(2 * derivative as i32 - 1)
}

/// `v × a`: signed in the plane, the length of the product in space.
pub fn cross(v: &[f64], a: &[f64]) -> f64 {
    let minor = |i: usize, j: usize| v[i] * a[j] - v[j] * a[i];
    match v.len() {
        2 => minor(0, 1),
        _ => f64::hypot(f64::hypot(minor(1, 2), minor(2, 0)), minor(0, 1)),
    }
}

fn segments(curve: &Curve) -> f64 {
    curve.halves() as f64 / 2.0
}

/// `∫₀^N f dt` over the cardinal parameter.
fn integrate(curve: &Curve, rule: &GaussLegendre, f: impl Fn(usize, f64) -> f64) -> f64 {
    let panels = (0..curve.halves()).map(|half| rule.integrate(-1.0, 1.0, |s| f(half, s)));
    HALF_PIECE * panels.sum::<f64>()
}

/// `½ ∮ x dy − y dx`, about the first point of the curve so that a shape far from the origin keeps
/// its digits.
pub fn signed_area(curve: &Curve, rule: &GaussLegendre) -> f64 {
    let origin = curve.evaluate(0.0, 0);
    let arm = |half, s, c| curve.derivative_at(half, c, s, 0) - origin[c];
    let slope = |half, s, c| curve.derivative_at(half, c, s, 1);
    0.5 * integrate(curve, rule, |half, s| {
        arm(half, s, 0) * slope(half, s, 1) - arm(half, s, 1) * slope(half, s, 0)
    })
}

fn orientation(area: f64, perimeter: f64) -> Orientation {
    if area.abs() <= NO_AREA * perimeter * perimeter {
        Orientation::None
    } else if area > 0.0 {
        Orientation::CounterClockwise
    } else {
        Orientation::Clockwise
    }
}

/// Length of a curve, to `10⁻¹⁰` relative.
pub fn length(curve: &Curve, rule: &GaussLegendre) -> f64 {
    let speed = |half: usize, s: f64| {
        (0..curve.dimension()).map(|c| curve.derivative_at(half, c, s, 1).powi(2)).sum::<f64>().sqrt()
    };
    let rough = integrate(curve, rule, speed);
    let tolerance = 1e-11 * rough / (HALF_PIECE * curve.halves() as f64);
    let panels =
        (0..curve.halves()).map(|half| rule.integrate_adaptive(-1.0, 1.0, tolerance, &|s| speed(half, s)));
    HALF_PIECE * panels.sum::<f64>()
}

/// Smallest and largest coordinates, to `10⁻¹³` of the coordinate's range.
pub fn bounding_box(curve: &Curve) -> (Vec<f64>, Vec<f64>) {
    let upper = |sign: f64| (0..curve.dimension()).map(move |c| sign * maximum(curve, c, sign)).collect();
    (upper(-1.0), upper(1.0))
}

/// `max_t sign·r_c(t)` by branch and bound: on `|s − m| ≤ h`, `f ≤ f(m) + |f'(m)| h + ½ B h²` with
/// `B = Σ m(m−1)|c_m| ≥ |f''|`.
fn maximum(curve: &Curve, coordinate: usize, sign: f64) -> f64 {
    let value = |half, s| sign * curve.derivative_at(half, coordinate, s, 0);
    let end = value(curve.halves() - 1, 1.0);
    let mut best = (0..curve.halves()).map(|half| value(half, -1.0)).fold(end, f64::max);
    let worst = (0..curve.halves()).map(|half| value(half, -1.0)).fold(f64::MAX, f64::min);
    let tolerance = 1e-13 * (best - worst).max(f64::EPSILON * best.abs());
    for half in 0..curve.halves() {
        let curvature: f64 = curve
            .polynomial(half, coordinate)
            .iter()
            .enumerate()
            .map(|(m, c)| (m * m.saturating_sub(1)) as f64 * c.abs())
            .sum();
        let mut pending = vec![(0.0, 1.0)];
        while let Some((middle, radius)) = pending.pop() {
            let here = value(half, middle);
            best = best.max(here);
            let slope = curve.derivative_at(half, coordinate, middle, 1).abs() * HALF_PIECE;
            let bound = here + slope * radius + 0.5 * curvature * radius * radius;
            if bound > best + tolerance && radius > 1e-9 {
                let quarter = 0.5 * radius;
                pending.push((middle - quarter, quarter));
                pending.push((middle + quarter, quarter));
            }
        }
    }
    best
}
