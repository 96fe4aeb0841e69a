//! The curves of a space nearest to reparametrised ones.
//!
//! ```text
//! T_γ c = argmin_c' ∫₀¹ |r(γ(s)) − r_c'(s)|² ds
//! ```
//!
//! A Gauss rule between the knots of the new curve and the places where `γ` has corners. Where `γ` crosses a knot of the given curve, its
//! third derivative jumps, which the rule does not follow: an error of a hundred-thousandth of a coarse curve, less of others.

use crate::GeometryError;
use crate::arc_parameter::ArcParameter;
use crate::curve::Curve;
use crate::fit::Samples;
use crate::representation::ShapeSpace;
use shapelex_numeric::dense::Matrix;
use shapelex_numeric::quadrature::GaussLegendre;

/// Nodes between two places: maps are no polynomials there.
const NODES: usize = 6;
/// Distance of two places below which nothing lies between.
const NOTHING: f64 = 1e-13;

/// Share of equal steps that is mixed into a map: a curve that stands still over an interval has no tangent there.
const RAISED: f64 = 0.02;

/// The curve nearest to a reparametrised one, with its certificate.
#[derive(Debug, Clone)]
pub struct LineRefit {
    /// Control points, `N × d`.
    pub control_points: Matrix,
    /// Root mean square distance `‖r∘γ − r'‖` over the parameter, in the unit of the curve.
    pub residual: f64,
    /// The same divided by the root mean square distance of the given curve from its mean position.
    pub relative_residual: f64,
    /// Largest distance at the nodes.
    pub largest: f64,
}

impl LineRefit {
    /// The curve of `space` nearest to `curve` at the parameters `map(s)`; `corners` are the places between 0 and 1 where `map` is not
    /// smooth, in any order.
    ///
    /// Cost: six values of `map` and of the curve between two places, and one banded solve.
    ///
    /// # Errors
    /// [`GeometryError::NotACurve`]; those of [`Samples::fit`].
    pub fn new(
        curve: &Curve,
        space: &ShapeSpace,
        corners: &[f64],
        map: &(dyn Fn(f64) -> f64 + Sync),
    ) -> Result<Self, GeometryError> {
        let intervals = space.line().ok_or(GeometryError::NotACurve)?.intervals();
        let mut places: Vec<f64> = (0..=intervals).map(|k| k as f64 / intervals as f64).collect();
        places.extend(corners.iter().filter(|s| (0.0..1.0).contains(*s)));
        places.sort_by(f64::total_cmp);
        let rule: Vec<(f64, f64)> = GaussLegendre::new(NODES).points().collect();
        let nodes = places.windows(2).filter(|ends| ends[1] - ends[0] > NOTHING).flat_map(|ends| {
            let half = 0.5 * (ends[1] - ends[0]);
            rule.iter().map(move |(x, w)| (ends[0] + half * (x + 1.0), half * w))
        });
        let (parameters, weights): (Vec<f64>, Vec<f64>) = nodes.unzip();
        let images: Vec<f64> = parameters.iter().map(|&s| map(s)).collect();
        let points = Matrix::from_vec(parameters.len(), curve.dimension(), curve.evaluate_all(&images, 0));
        let extent = extent(curve, &rule);
        let fit = Samples::weighted(points, parameters, weights).fit(space)?;
        Ok(Self {
            control_points: fit.control_points,
            residual: fit.residual,
            relative_residual: if extent > 0.0 { fit.residual / extent } else { 0.0 },
            largest: fit.largest,
        })
    }

    /// The curve of `space` that follows `places` of a curve: those of the parameters `i/M`, `i = 0 … M`, as fractions of its length; of closed
    /// curves they go on beyond 0 and 1, and they may decrease. Steps are raised to a fiftieth of equal ones. With it the smallest and
    /// largest slope of the places.
    ///
    /// Cost: six points between two places or knots.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn along(
        curve: &Curve,
        places: &[f64],
        space: &ShapeSpace,
    ) -> Result<(Self, [f64; 2]), GeometryError> {
        let arc = ArcParameter::of(curve);
        let map = raised(places);
        let last = map.len() - 1;
        let closed = curve.is_closed();
        let at = |s: f64| {
            let place = s * last as f64;
            let k = (place as usize).min(last - 1);
            let t = map[k] + (place - k as f64) * (map[k + 1] - map[k]);
            arc.at(if closed { t.rem_euclid(1.0) } else { t.clamp(0.0, 1.0) })
        };
        let corners: Vec<f64> = (1..last).map(|i| i as f64 / last as f64).collect();
        let refit = Self::new(curve, space, &corners, &at)?;
        let slopes = map.windows(2).map(|ends| (ends[1] - ends[0]).abs() * last as f64);
        let slopes = slopes.fold([f64::INFINITY, 0.0_f64], |[least, most], x| [least.min(x), most.max(x)]);
        Ok((refit, slopes))
    }
}

/// A map whose steps are at least a fiftieth of equal ones.
fn raised(places: &[f64]) -> Vec<f64> {
    let last = places.len() - 1;
    let whole = places[last] - places[0];
    let raised =
        |(i, t): (usize, &f64)| (1.0 - RAISED) * t + RAISED * (places[0] + whole * i as f64 / last as f64);
    places.iter().enumerate().map(raised).collect()
}

/// Root mean square distance of a curve from its mean position.
fn extent(curve: &Curve, rule: &[(f64, f64)]) -> f64 {
    let halves = curve.halves();
    let nodes =
        (0..halves).flat_map(|half| rule.iter().map(move |(s, w)| (half, *s, 0.5 * w / halves as f64)));
    let mut square = 0.0;
    for c in 0..curve.dimension() {
        let values: Vec<(f64, f64)> =
            nodes.clone().map(|(half, s, w)| (curve.derivative_at(half, c, s, 0), w)).collect();
        let mean: f64 = values.iter().map(|(x, w)| w * x).sum();
        square += values.iter().map(|(x, w)| w * (x - mean).powi(2)).sum::<f64>();
    }
    square.sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generator::GeneratorKind;
    use crate::representation::Representation;

    fn space(closed: bool, count: usize) -> ShapeSpace {
        let generator = GeneratorKind::Bspline { degree: 3 };
        let representation = if closed {
            Representation::ClosedCurve { dimension: 2, control_points: count, generator }
        } else {
            Representation::OpenCurve { dimension: 2, intervals: count, generator }
        };
        ShapeSpace::new(&representation).unwrap()
    }

    #[test]
    fn the_identity_and_turns_by_knots_keep_control_points() {
        for closed in [true, false] {
            let space = space(closed, 12);
            let size = space.representation().size();
            let points = Matrix::from_fn(size, 2, |k, c| {
                let t = std::f64::consts::TAU * k as f64 / 12.0;
                if c == 0 { 3.0 * t.cos() } else { t.sin() + 0.3 * (2.0 * t).cos() }
            });
            let curve = Curve::of(&space, &points).unwrap();
            let same = LineRefit::new(&curve, &space, &[0.123], &|s| s).unwrap();
            assert!((&same.control_points - &points).amax() < 1e-12 && same.residual < 1e-12);
            if closed {
                let turned = LineRefit::new(&curve, &space, &[], &|s| (s + 0.25) % 1.0).unwrap();
                let apart = (0..12).map(|k| (turned.control_points.row(k) - points.row((k + 3) % 12)).amax());
                assert!(apart.fold(0.0, f64::max) < 1e-12);
            }
            let back = LineRefit::new(&curve, &space, &[], &|s| 1.0 - s).unwrap();
            let last = if closed { 12 } else { size - 1 };
            let apart =
                (0..size).map(|k| (back.control_points.row(k) - points.row((last - k) % size)).amax());
            assert!(apart.fold(0.0, f64::max) < 1e-12);
        }
    }
}
