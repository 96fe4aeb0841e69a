//! Curves with the parameters of a template: the curves of a space nearest to `r(γ(s))`.

use shapelex_geometry::curve::Curve;
use shapelex_geometry::reparametrisation::LineRefit;
use shapelex_geometry::representation::ShapeSpace;
use shapelex_numeric::dense::Matrix;

use super::space::{ElasticMatch, ElasticSpace};
use crate::AnalysisError;

impl ElasticSpace {
    /// The curve of `space` nearest to a curve of this one, of these control points (coordinate-major), at the parameters of the template to
    /// which it is matched, in the pose in which it is given; with the smallest and largest slope of the fraction of its length.
    ///
    /// # Errors
    /// [`AnalysisError::Parameter`] of polygons, and of a `space` whose curves the points do not determine.
    pub fn refit(
        &self,
        control_points: &[f64],
        found: &ElasticMatch,
        space: &ShapeSpace,
    ) -> Result<(LineRefit, [f64; 2]), AnalysisError> {
        let refused = |detail: String| AnalysisError::Parameter { field: "representation", detail };
        let d = self.dimension();
        let matrix = Matrix::from_column_slice(control_points.len() / d, d, control_points);
        let curve = self.space().and_then(|own| Curve::of(own, &matrix));
        let curve = curve.ok_or_else(|| refused("expected curves, got polygons".to_owned()))?;
        LineRefit::along(&curve, &found.places, space).map_err(|error| refused(error.to_string()))
    }
}
