//! Sizes of shapes: volume, area, length.

use crate::curve::Curve;
use crate::measures::area_and_length;
use crate::representation::ShapeSpace;
use crate::subdivision::measures::measure;
use crate::surface::measures::SurfaceMeasures;
use shapelex_numeric::bounded::Stop;
use shapelex_numeric::dense::Matrix;

/// Measure of size.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
pub enum SizeMeasure {
    /// Volume that a surface encloses, unsigned.
    Volume,
    /// Enclosed area of closed planar curves, unsigned; area of surfaces.
    Area,
    /// Length of curves: the perimeter of closed ones.
    Length,
    /// Centroid size: of landmarks the root of the sum of squared distances from their mean, of curves and surfaces the root of the
    /// integral.
    CentroidSize,
}

impl SizeMeasure {
    /// The measures that shapes of `space` have, from the volume on.
    pub fn of(space: &ShapeSpace) -> Vec<Self> {
        let representation = space.representation();
        let curves = space.generator().is_some();
        let encloses_area = curves && representation.is_closed() && representation.dimension() == 2;
        let zero = Matrix::zeros(representation.size(), representation.dimension());
        let surface = space.surface().map(|basis| basis.surface(&zero));
        let mesh = space.subdivision().is_some();
        let encloses_volume = surface.as_ref().is_some_and(|surface| surface.encloses()) || mesh;
        let measures = [
            (Self::Volume, encloses_volume),
            (Self::Area, encloses_area || surface.is_some() || mesh),
            (Self::Length, curves),
            (Self::CentroidSize, true),
        ];
        measures.into_iter().filter_map(|(measure, exists)| exists.then_some(measure)).collect()
    }
}

/// Volume, area and length of one shape, as far as shapes of its space have them.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Sizes {
    /// Enclosed volume, unsigned.
    pub volume: Option<f64>,
    /// Area of a surface; enclosed area of a closed planar curve, unsigned, 0 for other curves.
    pub area: Option<f64>,
    /// Length of a curve.
    pub length: Option<f64>,
}

impl Sizes {
    /// Sizes of the shape with these control points (`N × d`); `stop` ends the quadrature of a curve early.
    pub fn of(space: &ShapeSpace, control_points: &Matrix, stop: Stop<'_>) -> Self {
        if let Some(curve) = Curve::of(space, control_points) {
            return Self::of_curve(&curve, stop);
        }
        let measures = match (space.surface(), space.subdivision()) {
            (Some(basis), _) => SurfaceMeasures::of(&basis.surface(control_points)),
            (_, Some(basis)) => measure(&basis.mesh(control_points), basis.level() > 0),
            _ => return Self::default(),
        };
        let volume = measures.enclosed.map(|enclosed| enclosed.signed_volume.abs());
        Self { volume, area: Some(measures.area), length: None }
    }

    /// Sizes of a curve; `stop` ends its quadrature early.
    pub fn of_curve(curve: &Curve, stop: Stop<'_>) -> Self {
        let (area, length) = area_and_length(curve, stop);
        Self { volume: None, area: Some(area), length: Some(length) }
    }

    /// The size by `measure`; `None` if the shape does not have it here, as for the centroid size, which needs a metric.
    pub fn get(&self, measure: SizeMeasure) -> Option<f64> {
        match measure {
            SizeMeasure::Volume => self.volume,
            SizeMeasure::Area => self.area,
            SizeMeasure::Length => self.length,
            SizeMeasure::CentroidSize => None,
        }
    }
}
