//! Lists of points as posted, without a space.

use std::borrow::Borrow;

use super::read;
use crate::geometry::capability::fit;
use crate::geometry::resample::{Contour, RepeatedPoints};
use crate::numeric::dense::Matrix;
use crate::service::app::Limits;
use crate::wire::fault::Fault;
use crate::wire::shape::{PointList, ShapeInput};

/// The list, if present; `null` counts as absent.
pub(crate) fn given<L: Borrow<PointList>>(list: &Option<L>) -> Option<&PointList> {
    let list: &PointList = list.as_ref()?.borrow();
    (!list.is_null()).then_some(list)
}

/// Contour through a list of points, without repeated ones.
///
/// # Errors
/// The fault of the list, with a pointer relative to it.
pub(crate) fn contour(points: Matrix, closed: bool) -> Result<Contour, Vec<Fault>> {
    fit::contour(points, closed, RepeatedPoints::Drop).map_err(|fault| vec![fault.into()])
}

/// Reads a list of points with `D` coordinates each.
pub(crate) fn take_points<const D: usize>(
    list: &Option<impl Borrow<PointList>>,
    pointer: &str,
    errors: &mut Vec<Fault>,
) -> Option<Vec<[f64; D]>> {
    let list = given(list)?;
    match list.checked(D) {
        Ok(coordinates) if list.grid().is_none() => Some(coordinates.as_chunks().0.to_vec()),
        Ok(_) => {
            errors.push(Fault::new(pointer, "expected a list of points, got a grid"));
            None
        }
        Err(found) => {
            errors.extend(found.into_iter().map(|error| error.below(pointer)));
            None
        }
    }
}

/// List of points of a shape as posted.
///
/// # Errors
/// Faults of the attributes; a shape without points.
pub(crate) fn posted_list(mut shape: ShapeInput) -> Result<PointList, Vec<Fault>> {
    let points = shape.points.take().filter(|points| !points.is_null());
    read::attributes(shape)?;
    points.map(|points| *points).ok_or_else(|| vec![Fault::new("", "expected points, got none")])
}

pub(crate) fn below_points(errors: Vec<Fault>) -> Vec<Fault> {
    errors.into_iter().map(|error| error.below("/points")).collect()
}

/// Points of a shape as posted, of `dimension` coordinates or, without one, 2 or 3.
pub(crate) fn raw_points(
    shape: ShapeInput,
    dimension: Option<usize>,
    closed: bool,
    limits: &Limits,
) -> Result<Matrix, Vec<Fault>> {
    let stated = shape.closed.as_ref().and_then(|field| field.get().copied().flatten());
    let points = posted_list(shape)?;
    if stated.is_some_and(|stated| stated != closed) {
        let detail = format!(
            "expected the value of this request, whose contours are {1}, got {0}",
            !closed,
            if closed { "closed" } else { "open" }
        );
        return Err(vec![Fault::new("/closed", detail)]);
    }
    if points.len() > limits.points {
        let detail = format!("expected at most {1} points, got {0}", points.len(), limits.points);
        return Err(vec![Fault::new("/points", detail)]);
    }
    let dimension = dimension.unwrap_or_else(|| points.width().clamp(2, 3));
    let coordinates = points.checked(dimension).map_err(below_points)?;
    Ok(Matrix::from_row_slice(points.len(), dimension, coordinates))
}
