//! Resampling of polygons to points of equal arc length. The function is synchronous and runs on the pool.

use super::each::each_shape;
use super::read_points::{below_points, contour, raw_points};
use crate::service::app::{App, ServiceError};
use crate::wire::fault::Fault;
use crate::wire::shape::ShapeInput;

/// Start of resampling.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Start {
    /// The first point.
    #[default]
    First,
    /// The canonical start point of the contour.
    Canonical,
}

/// A resampled contour.
#[derive(Debug, Clone)]
pub struct Resampled {
    /// Dimension `d`.
    pub dimension: usize,
    /// Points, coordinate-major.
    pub points: Vec<f64>,
    /// Length of the polygon.
    pub length: f64,
}

/// Resamples polygons to `count` points of equal arc length.
///
/// # Errors
/// Faults of the input.
pub fn resample(
    app: &App,
    count: usize,
    start: Start,
    closed: bool,
    shapes: Vec<ShapeInput>,
) -> Result<Vec<Resampled>, ServiceError> {
    let mut faults = Vec::new();
    let fewest = if closed { 3 } else { 2 };
    if !(fewest..=app.limits.points).contains(&count) {
        let detail = format!("expected a number between {fewest} and {}, got {count}", app.limits.points);
        faults.push(Fault::new("/count", detail));
    }
    if !closed && start == Start::Canonical {
        faults.push(Fault::new("/start", "expected \"first\": an open contour starts at its first point"));
    }
    if shapes.is_empty() {
        return Err(ServiceError::TooFewShapes { found: 0, needed: 1 });
    }
    if count.saturating_mul(shapes.len()) > app.limits.samples {
        let detail = format!("expected at most {} points over all shapes", app.limits.samples);
        faults.push(Fault::new("/count", detail));
    }
    ServiceError::unless_empty(faults)?;
    each_shape(&app.pool.context(), shapes, |_, shape| {
        let points = raw_points(shape, None, closed, &app.limits)?;
        let dimension = points.ncols();
        let contour = contour(points, closed).map_err(below_points)?;
        let from = if start == Start::Canonical { contour.canonical_start() } else { 0.0 };
        let points = contour.sample(count, from).as_slice().to_vec();
        Ok(Resampled { dimension, points, length: contour.length() })
    })
}
