//! Sizes of shapes: volume, area, length.

use crate::arc_length::ArcLength;
use crate::area::signed_area;
use crate::columns::Columns;
use crate::intersection::crosses_itself;
use crate::representation::ShapeSpace;
use crate::subdivision::measures::measure;
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
        let closed_mesh = space.subdivision().is_some_and(|basis| basis.control().is_closed());
        let encloses_volume = surface.as_ref().is_some_and(|surface| surface.encloses()) || closed_mesh;
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
    /// Sizes of the shape of `space` with these control points (`d·N` coordinate-major numbers); `stop` ends the quadrature of a
    /// curve early. Cost: one quadrature.
    pub fn of(space: &ShapeSpace, control_points: &[f64], stop: Stop<'_>) -> Self {
        match PlacedCurve::of(space, control_points) {
            Some(curve) => curve.sizes(stop),
            None => Self::of_sheet(space, control_points),
        }
    }

    /// As [`Self::of`], and whether the shape is a planar curve that crosses or touches itself, if it is a planar curve: see
    /// [`self_intersects`](crate::intersection::self_intersects).
    pub fn with_crossings(
        space: &ShapeSpace,
        control_points: &[f64],
        stop: Stop<'_>,
    ) -> (Self, Option<bool>) {
        match PlacedCurve::of(space, control_points) {
            Some(curve) => {
                let planar = curve.near_one.dimension() == 2;
                (curve.sizes(stop), planar.then(|| crosses_itself(&curve.near_one)))
            }
            None => (Self::of_sheet(space, control_points), None),
        }
    }

    /// Sizes of a surface or mesh; none of landmarks.
    fn of_sheet(space: &ShapeSpace, control_points: &[f64]) -> Self {
        let representation = space.representation();
        let matrix =
            || Matrix::from_column_slice(representation.size(), representation.dimension(), control_points);
        let (signed_volume, area) = match (space.surface(), space.subdivision()) {
            (Some(basis), _) => {
                let sizes = basis.sizes(&matrix());
                (sizes.signed_volume, sizes.area)
            }
            (_, Some(basis)) => {
                let measures = measure(&basis.mesh(&matrix()), basis.level() > 0);
                (measures.enclosed.map(|enclosed| enclosed.signed_volume), measures.area)
            }
            _ => return Self::default(),
        };
        Self { volume: signed_volume.map(f64::abs), area: Some(area), length: None }
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

/// Part of the squared extent of a curve below which its area has no sign.
///
/// An area is a sum of terms as large as the squared extent, with a rounding error of some 1e-15 of it; contours of
/// use enclose more than a thousandth. A figure of eight or a line that is traced back has an area of rounding.
const NO_AREA: f64 = 1e-9;

/// Whether the closed planar curve of `space` with these control points (`2·N` coordinate-major numbers) runs clockwise; `None` for
/// shapes of other kinds. A curve without an area to speak of does not. Exact up to rounding. Cost `O(M n²)` for `M` segments of
/// degree `n − 1`.
pub fn runs_clockwise(space: &ShapeSpace, control_points: &[f64]) -> Option<bool> {
    let PlacedCurve { near_one, unit } = PlacedCurve::of(space, control_points)?;
    if !near_one.is_closed() || near_one.dimension() != 2 {
        return None;
    }
    let range =
        |c: &[f64]| c.iter().copied().fold(f64::MIN, f64::max) - c.iter().copied().fold(f64::MAX, f64::min);
    let extent = control_points.chunks_exact(space.representation().size()).map(range).fold(0.0, f64::max);
    let relative = extent / unit;
    Some(signed_area(&near_one) < -NO_AREA * relative * relative)
}

/// A curve with coordinates near 1, and the power of two by which they were divided: squares of coordinates overflow long before
/// sizes do.
struct PlacedCurve {
    near_one: Columns,
    unit: f64,
}

impl PlacedCurve {
    /// `None` if shapes of `space` are not curves.
    fn of(space: &ShapeSpace, control_points: &[f64]) -> Option<Self> {
        let (generator, representation) = (space.generator()?, space.representation());
        let (closed, dimension) = (representation.is_closed(), representation.dimension());
        let (near_one, unit) = Columns::near_one(generator, closed, dimension, control_points);
        Some(Self { near_one, unit })
    }

    fn sizes(&self, stop: Stop<'_>) -> Sizes {
        let Self { near_one, unit } = self;
        let encloses = near_one.is_closed() && near_one.dimension() == 2;
        let area = if encloses { signed_area(near_one).abs() } else { 0.0 };
        let length = ArcLength::of(near_one, stop).length;
        Sizes { volume: None, area: Some(area * unit * unit), length: Some(length * unit) }
    }
}
