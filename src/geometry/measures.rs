//! Measures of closed curves: exact where the integrand is polynomial, adaptive for the perimeter.
//!
//! ```text
//! area = ½ ∮ x dy − y dx     centroid = (∮ x²/2 dy, −∮ y²/2 dx) / area     perimeter = ∮ |r'| du
//! ```

use serde::Serialize;

use super::curve::ClosedCurve;
use super::generator::HALF_PIECE;
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

/// Measures of one closed curve, in the unit of its control points.
#[derive(Debug, Clone, PartialEq)]
pub struct CurveMeasures {
    /// Signed enclosed area, counter-clockwise positive; planar curves only.
    pub signed_area: Option<f64>,
    /// Centroid of the enclosed area; planar curves with an orientation only.
    pub centroid: Option<Vec<f64>>,
    /// Mean position along the parameter, `∫ r du`.
    pub mean_position: Vec<f64>,
    /// Length of the curve, to `10⁻¹⁰` relative.
    pub perimeter: f64,
    /// Smallest and largest coordinates.
    pub bounding_box: (Vec<f64>, Vec<f64>),
    /// Sign of the area; planar curves only.
    pub orientation: Option<Orientation>,
}

/// Relative to the squared perimeter: a circle has `1/(4π) ≈ 0.08`; below this the sign is rounding.
const NO_AREA: f64 = 1e-12;

/// Gauss nodes per half-segment: exact to `2·10⁻¹⁵` for products of three generators.
const NODES: usize = 12;

impl CurveMeasures {
    /// Measures `curve`. Cost `O(N)` quadratures; the perimeter adds panels near cusps.
    pub fn of(curve: &ClosedCurve) -> Self {
        let rule = GaussLegendre::new(NODES);
        let perimeter = perimeter(curve, &rule);
        let signed_area = (curve.dimension() == 2).then(|| signed_area(curve, &rule));
        let orientation = signed_area.map(|area| orientation(area, perimeter));
        let centroid = signed_area
            .filter(|_| orientation != Some(Orientation::None))
            .map(|area| centroid(curve, &rule, area));
        Self {
            signed_area,
            centroid,
            mean_position: (0..curve.dimension())
                .map(|c| {
                    integrate(curve, &rule, |half, s| curve.derivative_at(half, c, s, 0)) / segments(curve)
                })
                .collect(),
            perimeter,
            bounding_box: bounding_box(curve),
            orientation,
        }
    }
}

fn segments(curve: &ClosedCurve) -> f64 {
    curve.halves() as f64 / 2.0
}

/// `∫₀^N f dt` over the cardinal parameter.
fn integrate(curve: &ClosedCurve, rule: &GaussLegendre, f: impl Fn(usize, f64) -> f64) -> f64 {
    let panels = (0..curve.halves()).map(|half| rule.integrate(-1.0, 1.0, |s| f(half, s)));
    HALF_PIECE * panels.sum::<f64>()
}

/// `½ ∮ x dy − y dx`, about the first point of the curve so that a shape far from the origin keeps
/// its digits.
pub fn signed_area(curve: &ClosedCurve, rule: &GaussLegendre) -> f64 {
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

/// About the first point of the curve, as the area.
fn centroid(curve: &ClosedCurve, rule: &GaussLegendre, area: f64) -> Vec<f64> {
    let origin = curve.evaluate(0.0, 0);
    let x = |half, s| curve.derivative_at(half, 0, s, 0) - origin[0];
    let y = |half, s| curve.derivative_at(half, 1, s, 0) - origin[1];
    let mx = integrate(curve, rule, |half, s| 0.5 * x(half, s).powi(2) * curve.derivative_at(half, 1, s, 1));
    let my = integrate(curve, rule, |half, s| -0.5 * y(half, s).powi(2) * curve.derivative_at(half, 0, s, 1));
    vec![origin[0] + mx / area, origin[1] + my / area]
}

fn perimeter(curve: &ClosedCurve, rule: &GaussLegendre) -> f64 {
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
pub fn bounding_box(curve: &ClosedCurve) -> (Vec<f64>, Vec<f64>) {
    let upper = |sign: f64| (0..curve.dimension()).map(move |c| sign * maximum(curve, c, sign)).collect();
    (upper(-1.0), upper(1.0))
}

/// `max_t sign·r_c(t)` by branch and bound: on `|s − m| ≤ h`, `f ≤ f(m) + |f'(m)| h + ½ B h²` with
/// `B = Σ m(m−1)|c_m| ≥ |f''|`.
fn maximum(curve: &ClosedCurve, coordinate: usize, sign: f64) -> f64 {
    let value = |half, s| sign * curve.derivative_at(half, coordinate, s, 0);
    let mut best = (0..curve.halves()).map(|half| value(half, -1.0)).fold(f64::MIN, f64::max);
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
