//! Measures of curves: exact for polynomial integrands, adaptive for the length.
//!
//! ```text
//! area = ½ ∮ x dy − y dx     centroid = (∮ x²/2 dy, −∮ y²/2 dx) / area     length = ∫ |r'| du
//! ∬ x² = ∮ x³/3 dy,  ∬ xy = ∮ x²y/2 dy,  ∬ y² = −∮ y³/3 dx                 second moments of the enclosed area
//! energies ∫ |r'|² du, ∫ |r''|² du     total curvature ∫ |κ| dℓ, turning ∫ κ dℓ,  κ = r' × r''/|r'|³
//! ```

use std::sync::LazyLock;

use super::arc_length::ArcLength;
use super::area;
use super::columns::Columns;
use super::curve::Curve;
use super::generator::{HALF_PIECE, differentiate, integrate_product};
use super::total_curvature::Turning;
use shapelex_numeric::bounded::{Patience, Stop, never};
use shapelex_numeric::quadrature::GaussLegendre;

/// Orientation of a closed planar curve (y axis up), the sign of its area; `none` if the area vanishes relative to the squared
/// perimeter.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
pub enum Orientation {
    /// Counter-clockwise: the signed area is positive (y axis up).
    CounterClockwise,
    /// Clockwise: the signed area is negative.
    Clockwise,
    /// None: the signed area vanishes relative to the squared perimeter.
    None,
}

/// Measures of one curve, in the unit of its control points.
#[derive(Debug, Clone, PartialEq)]
pub struct CurveMeasures {
    /// Whether the curve is closed.
    pub closed: bool,
    /// Measures of the enclosed area, for closed planar curves.
    pub enclosed: Option<Enclosed>,
    /// Mean position along the parameter, `∫ r du`.
    pub mean_position: Vec<f64>,
    /// Length of the curve, to a relative accuracy of `10⁻¹⁰`.
    pub length: f64,
    /// Additional error bound of the length if its integration was cut short; else 0.
    pub length_error: f64,
    /// Minimum and maximum coordinates.
    pub bounding_box: (Vec<f64>, Vec<f64>),
    /// Stretching energy, `∫ |r'|² du`.
    pub stretching_energy: f64,
    /// Bending energy, `∫ |r''|² du`; `None` for curves with corners, where it is infinite.
    pub bending_energy: Option<f64>,
    /// Total curvature, `∫ |κ| dℓ` in radians; `None` for curves with corners or cusps.
    pub total_curvature: Option<f64>,
    /// `∫ κ dℓ` in radians, counter-clockwise positive: `2π` times the turning number of a closed curve. For planar curves
    /// only.
    pub turning: Option<f64>,
    /// Number of panels and stretches examined: the cost beyond `O(M)`.
    pub steps: usize,
}

/// Measures of the area that a closed planar curve encloses.
#[derive(Debug, Clone, PartialEq)]
pub struct Enclosed {
    /// Signed area, counter-clockwise positive.
    pub signed_area: f64,
    /// Orientation, the sign of the area.
    pub orientation: Orientation,
    /// Centroid, if the curve has an orientation.
    pub centroid: Option<[f64; 2]>,
    /// `∬ (x − x̄)(x − x̄)ᵀ dA` about the centroid, if the curve has one. Positive for a simple curve of either orientation;
    /// parts that the curve encloses in the other direction count as negative, as in the area.
    pub second_moments: Option<[[f64; 2]; 2]>,
}

/// Ratio of area to squared perimeter below which the sign is rounding. A circle has `1/(4π) ≈ 0.08`.
const NO_AREA: f64 = 1e-12;

/// Gauss nodes per half-segment: exact to `2·10⁻¹⁵` for products of three generators.
const NODES: usize = 12;
static RULE: LazyLock<GaussLegendre> = LazyLock::new(|| GaussLegendre::new(NODES));

impl CurveMeasures {
    /// Measures `curve`. Cost: `O(M)` quadratures; length and curvature add a bounded number of panels near cusps.
    pub fn of(curve: &Curve) -> Self {
        Self::in_range(curve, &never)
    }

    /// As [`Self::of`], with cancellation; `None` if `stop` returns true.
    pub fn unless_stopped(curve: &Curve, stop: Stop<'_>) -> Option<Self> {
        let measures = Self::in_range(curve, stop);
        (!stop()).then_some(measures)
    }

    /// Measures the curve scaled to numbers near 1: squares and fourth powers of coordinates overflow long before the measures.
    fn in_range(curve: &Curve, stop: Stop<'_>) -> Self {
        let unit = Curve::unit(&[curve]);
        Self::near_one(&curve.scaled(unit.recip()), stop).scaled(unit)
    }

    fn scaled(self, unit: f64) -> Self {
        let vector = |values: Vec<f64>| values.into_iter().map(|value| value * unit).collect();
        let (low, high) = self.bounding_box;
        Self {
            enclosed: self.enclosed.map(|enclosed| enclosed.scaled(unit)),
            mean_position: vector(self.mean_position),
            length: self.length * unit,
            length_error: self.length_error * unit,
            bounding_box: (vector(low), vector(high)),
            stretching_energy: self.stretching_energy * unit * unit,
            bending_energy: self.bending_energy.map(|energy| energy * unit * unit),
            ..self
        }
    }

    fn near_one(curve: &Curve, stop: Stop<'_>) -> Self {
        let rule = &*RULE;
        let columns = Columns::of(curve);
        let ArcLength { length, missed, halved } = ArcLength::of(&columns, stop);
        let planar = curve.dimension() == 2;
        let (turning, stretches) = Turning::counted(curve, stop);
        let (bounding_box, searched) = bounding_box(curve, stop);
        Self {
            closed: curve.is_closed(),
            enclosed: (planar && curve.is_closed())
                .then(|| Enclosed::of(curve, area::signed_area(&columns), length)),
            mean_position: (0..curve.dimension())
                .map(|c| {
                    integrate(curve, rule, |half, s| curve.derivative_at(half, c, s, 0)) / segments(curve)
                })
                .collect(),
            length,
            length_error: missed,
            bounding_box,
            stretching_energy: energy(curve, 1),
            bending_energy: (curve.smoothness() >= 1).then(|| energy(curve, 2)),
            total_curvature: turning.map(|turning| turning.total),
            turning: turning.filter(|_| planar).map(|turning| turning.signed),
            steps: halved + stretches + searched,
        }
    }
}

impl Enclosed {
    fn of(curve: &Curve, signed_area: f64, length: f64) -> Self {
        let rule = &*RULE;
        // Relative to the first point of the curve, so that a shape far from the origin keeps its digits.
        let origin = curve.evaluate(0.0, 0);
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
        Self { signed_area, orientation, centroid, second_moments }
    }

    fn scaled(self, unit: f64) -> Self {
        let power = |value: f64, power: usize| (0..power).fold(value, |value, _| value * unit);
        // Fourth powers overflow first.
        let moments = self.second_moments.map(|m| m.map(|row| row.map(|value| power(value, 4))));
        Self {
            signed_area: power(self.signed_area, 2),
            centroid: self.centroid.map(|point| point.map(|value| value * unit)),
            second_moments: moments.filter(|m| m.as_flattened().iter().all(|value| value.is_finite())),
            ..self
        }
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

fn segments(curve: &Curve) -> f64 {
    curve.halves() as f64 / 2.0
}

/// `∫₀^N f dt` over the cardinal parameter.
fn integrate(curve: &Curve, rule: &GaussLegendre, f: impl Fn(usize, f64) -> f64) -> f64 {
    let panels = (0..curve.halves()).map(|half| rule.integrate(-1.0, 1.0, |s| f(half, s)));
    HALF_PIECE * panels.sum::<f64>()
}

/// Signed area of a closed planar curve, counter-clockwise positive.
pub fn signed_area(curve: &Curve) -> f64 {
    area::signed_area(&Columns::of(curve))
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

/// Minimum and maximum coordinates, to `10⁻¹³` of the range of the coordinate or to rounding, and the number of stretches
/// examined.
fn bounding_box(curve: &Curve, stop: Stop<'_>) -> ((Vec<f64>, Vec<f64>), usize) {
    let mut steps = 0;
    let mut upper = |sign: f64| -> Vec<f64> {
        let extremes = (0..curve.dimension()).map(|c| maximum(curve, c, sign, stop));
        extremes.map(|(value, looked_at)| (steps += looked_at, sign * value).1).collect()
    };
    let corners = (upper(-1.0), upper(1.0));
    (corners, steps)
}

/// Maximum number of stretches in the search of a half-segment for its largest coordinate before the accuracy is reduced.
/// One smooth maximum takes some 60.
const STRETCHES: usize = 20_000;

/// `max_t sign·r_c(t)` by branch and bound: on `|s − m| ≤ h`, `f ≤ f(m) + |f'(m)| h + ½ B h²` with
/// `B = Σ m(m−1)|c_m| ≥ |f''|`.
fn maximum(curve: &Curve, coordinate: usize, sign: f64, stop: Stop<'_>) -> (f64, usize) {
    let value = |half, s| sign * curve.derivative_at(half, coordinate, s, 0);
    let end = value(curve.halves() - 1, 1.0);
    let mut best = (0..curve.halves()).map(|half| value(half, -1.0)).fold(end, f64::max);
    let worst = (0..curve.halves()).map(|half| value(half, -1.0)).fold(f64::MAX, f64::min);
    let mut steps = 0;
    let tolerance = (1e-13 * (best - worst)).max(f64::EPSILON * best.abs()).max(f64::MIN_POSITIVE);
    for half in 0..curve.halves() {
        let curvature: f64 = curve
            .polynomial(half, coordinate)
            .iter()
            .enumerate()
            .map(|(m, c)| (m * m.saturating_sub(1)) as f64 * c.abs())
            .sum();
        let (mut pending, mut patience) = (vec![(0.0, 1.0)], Patience::new(STRETCHES, stop));
        while let Some((middle, radius)) = pending.pop() {
            patience.step();
            let here = value(half, middle);
            best = best.max(here);
            let slope = curve.derivative_at(half, coordinate, middle, 1).abs() * HALF_PIECE;
            let bound = here + slope * radius + 0.5 * curvature * radius * radius;
            if bound > best + tolerance * patience.factor() && radius > 1e-9 {
                let quarter = 0.5 * radius;
                pending.push((middle - quarter, quarter));
                pending.push((middle + quarter, quarter));
            }
        }
        steps += patience.steps();
    }
    (best, steps)
}
