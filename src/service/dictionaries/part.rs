//! Posted shapes of which a part may be missing, as `assess` takes them.

use super::coding::Given;
use crate::analysis::dictionary::posterior::missing::PartialShape;
use crate::geometry::capability::domain::Domain;
use crate::service::shapes::read::{self, Reading};
use crate::service::shapes::read_points::given;
use crate::wire::checked::take_given;
use crate::wire::fault::Fault;
use crate::wire::observed::Observed;
use crate::wire::partial::PartialInput;
use crate::wire::shape::{PointList, ShapeInput};

/// Control points, `None` where one is missing.
type Rows = Vec<Option<Vec<f64>>>;

/// A posted shape: all of it, or the part that is seen. A shape of which nothing turns out to be missing is a whole one.
///
/// # Errors
/// All faults of the shape, with pointers relative to it.
pub(super) fn read_given(reading: &Reading<'_>, mut shape: ShapeInput) -> Result<Given, Vec<Fault>> {
    if !shape.has_missing_parts() {
        return read::read_shape(reading, shape).map(|shape| Given::Whole(shape.control_points));
    }
    let mut faults = Vec::new();
    let observed = shape.observed.take().map(|observed| *observed);
    let observed: Option<Observed> = take_given(observed, "/observed", &mut faults).flatten();
    let (rows, list) = match rows(reading, shape) {
        Ok(found) if faults.is_empty() => found,
        found => {
            faults.extend(found.err().unwrap_or_default());
            return Err(faults);
        }
    };
    let part =
        PartialInput::of(rows, observed).checked(reading.conversion.space, reading.limits.control_points);
    let named = |fault: Fault| match fault.pointer.strip_prefix("/control_points") {
        Some(rest) => Fault { pointer: format!("{list}{rest}"), ..fault },
        None => fault,
    };
    let part = part.map_err(|faults| faults.into_iter().map(named).collect::<Vec<Fault>>())?;
    let (n, d) = (
        reading.conversion.space.representation().size(),
        reading.conversion.space.representation().dimension(),
    );
    Ok(match part.arcs.is_none() && part.control_points.len() == n {
        true => Given::Whole(columns(&part, d)),
        false => Given::Part(Box::new(part)),
    })
}

/// Control points of a shape, and the pointer of the list that they were given by. Points of curves and surfaces, which determine control
/// points together, must all be there.
fn rows(reading: &Reading<'_>, mut shape: ShapeInput) -> Result<(Rows, &'static str), Vec<Fault>> {
    let d = reading.conversion.space.representation().dimension();
    let is_landmarks = matches!(reading.conversion.space.domain(), Domain::Points);
    let (points, controls) = (given(&shape.points), given(&shape.control_points));
    let (list, pointer) = match (points, controls) {
        (None, Some(list)) => (list, "/control_points"),
        (Some(list), None) if is_landmarks => (list, "/points"),
        (Some(list), None) if list.has_gaps() => {
            let detail = "expected all points of a curve or surface, got null: give control_points with null where one is missing, or points with observed";
            return Err(vec![Fault::new("/points", detail)]);
        }
        _ => {
            let whole = read::read_shape(reading, shape)?.control_points;
            let n = whole.len() / d;
            let row = |i: usize| Some((0..d).map(|c| whole[c * n + i]).collect());
            return Ok(((0..n).map(row).collect(), "/points"));
        }
    };
    let rows = rows_of(list, d)
        .map_err(|faults| faults.into_iter().map(|fault| fault.below(pointer)).collect::<Vec<Fault>>());
    let unsuitable = reading.unsuitable(&shape);
    (shape.points, shape.control_points) = (None, None);
    match (rows, unsuitable, read::attributes(shape)) {
        (Ok(rows), None, Ok(_)) => Ok((rows, pointer)),
        (rows, unsuitable, attributes) => Err(rows
            .err()
            .into_iter()
            .flatten()
            .chain(unsuitable)
            .chain(attributes.err().into_iter().flatten())
            .collect()),
    }
}

/// The points of a list, `None` where one is null.
fn rows_of(list: &PointList, dimension: usize) -> Result<Rows, Vec<Fault>> {
    if list.grid().is_some() {
        return Err(vec![Fault::new("", "expected a list of points, got a grid")]);
    }
    list.with_gaps(dimension)
}

/// Control points of a shape of which nothing is missing, coordinate-major.
fn columns(shape: &PartialShape, dimension: usize) -> Vec<f64> {
    let column = |c: usize| shape.control_points.iter().map(move |(_, point)| point[c]);
    (0..dimension).flat_map(column).collect()
}
