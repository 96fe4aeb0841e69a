//! Planes of symmetry of a closed curve without markings. The function is synchronous and runs on the pool.

use super::read_points::{below_points, contour, raw_points};
use crate::analysis::drawing::symmetry::draw_planes;
use crate::analysis::symmetry::plane::planes_of_curve;
use crate::analysis::symmetry::records::CurvePlaneRecord;
use crate::geometry::drawing::scene::Drawing;
use crate::numeric::dense::Matrix;
use crate::service::app::{App, ServiceError};
use crate::wire::fault::Fault;
use crate::wire::shape::ShapeInput;

/// Fewest points along a curve.
pub const MIN_POINTS: usize = 8;

/// A closed curve with its planes of symmetry.
#[derive(Debug, Clone)]
pub struct CurvePlanes {
    /// Points spaced by arc length, `N × d`.
    pub points: Matrix,
    /// Mean of the points, through which the planes pass.
    pub centre: Vec<f64>,
    /// Length of the posted polygon.
    pub length: f64,
    /// The planes, the best one first.
    pub planes: Vec<CurvePlaneRecord>,
}

impl CurvePlanes {
    /// Planes of a closed contour at `count` points spaced by arc length; default: as many as were posted.
    ///
    /// # Errors
    /// Faults of the input, at `/shape` and `/count`.
    pub fn of(app: &App, shape: ShapeInput, count: Option<usize>) -> Result<Self, ServiceError> {
        let refused = |faults: Vec<Fault>| ServiceError::below(faults, "/shape");
        let points = raw_points(shape, None, true, &app.limits).map_err(refused)?;
        let count = count.unwrap_or(points.nrows().max(MIN_POINTS));
        if !(MIN_POINTS..=app.limits.points).contains(&count) {
            let detail =
                format!("expected a number between {MIN_POINTS} and {}, got {count}", app.limits.points);
            return Err(ServiceError::invalid("/count", detail));
        }
        let contour = contour(points, true).map_err(|faults| refused(below_points(faults)))?;
        let points = contour.sample(count, 0.0);
        let centre: Vec<f64> = points.column_iter().map(|column| column.mean()).collect();
        let mut centred = points.clone();
        for (mut column, mean) in centred.column_iter_mut().zip(&centre) {
            column.add_scalar_mut(-mean);
        }
        // At unit size: no square leaves the range of numbers.
        let largest = centred.amax();
        centred.unscale_mut(if largest > 0.0 { largest } else { 1.0 });
        let planes = planes_of_curve(centred.as_slice(), points.ncols())
            .map_err(|error| ServiceError::invalid("/shape", error.to_string()))?;
        Ok(Self { length: contour.length(), centre, points, planes })
    }

    /// The curve with its planes.
    pub fn drawing(&self) -> Drawing {
        draw_planes(self.points.as_slice(), self.points.ncols(), &self.planes)
    }
}
