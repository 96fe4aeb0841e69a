//! Curves with the parameters of a template: the curves of a space nearest to `r(γ(s))`.

use shapelex_geometry::arc_parameter::ArcParameter;
use shapelex_geometry::curve::Curve;
use shapelex_geometry::reparametrisation::LineRefit;
use shapelex_geometry::representation::ShapeSpace;
use shapelex_numeric::dense::Matrix;

use super::space::{ElasticMatch, ElasticSpace};
use crate::AnalysisError;

/// Share of equal steps that is mixed into a map: a curve that stands still over an interval has no tangent there.
const RAISED: f64 = 0.02;

/// A curve that follows a template.
#[derive(Debug, Clone)]
pub struct ElasticRefit {
    /// Control points and certificate, in the pose in which the curve is given.
    pub curve: LineRefit,
    /// Smallest and largest slope of the fraction of the length by the parameter of the template.
    pub slopes: [f64; 2],
}

impl ElasticSpace {
    /// The curve of `space` nearest to a curve of this one, of these control points (coordinate-major), at the parameters of the template to
    /// which it is matched. Slopes are at least a fiftieth.
    ///
    /// Cost: six points between two places of the map or knots.
    ///
    /// # Errors
    /// [`AnalysisError::Parameter`] of polygons, and of a `space` whose curves the points do not determine.
    pub fn refit(
        &self,
        control_points: &[f64],
        found: &ElasticMatch,
        space: &ShapeSpace,
    ) -> Result<ElasticRefit, AnalysisError> {
        let refused = |detail: String| AnalysisError::Parameter { field: "representation", detail };
        let (own, d) = (self.space(), self.dimension());
        let matrix = Matrix::from_column_slice(control_points.len() / d, d, control_points);
        let curve = own.and_then(|own| Curve::of(own, &matrix));
        let curve = curve.ok_or_else(|| refused("expected curves, got polygons".to_owned()))?;
        let arc = ArcParameter::of(&curve);
        let map = raised(&found.places);
        let last = map.len() - 1;
        let closed = self.is_closed();
        let at = |s: f64| {
            let place = s * last as f64;
            let k = (place as usize).min(last - 1);
            let t = map[k] + (place - k as f64) * (map[k + 1] - map[k]);
            arc.at(if closed { t.rem_euclid(1.0) } else { t.clamp(0.0, 1.0) })
        };
        let corners: Vec<f64> = (1..last).map(|i| i as f64 / last as f64).collect();
        let refit = LineRefit::new(&curve, space, &corners, &at);
        let refit = refit.map_err(|error| refused(error.to_string()))?;
        let slopes = map.windows(2).map(|ends| (ends[1] - ends[0]).abs() * last as f64);
        let slopes = slopes.fold([f64::INFINITY, 0.0_f64], |[least, most], x| [least.min(x), most.max(x)]);
        Ok(ElasticRefit { curve: refit, slopes })
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
