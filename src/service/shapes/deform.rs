//! Deformation of one shape by displaced control points and by handles, points through which it must pass.
//!
//! The function is synchronous and runs on the pool.

use super::request::Posted;
use crate::formats::fault::Fault;
use crate::formats::shape::{MAX_COORDINATE, ShapeInput};
use crate::geometry::deformation::{self, Handle};
use crate::numeric::dense::Matrix;
use crate::service::app::faults::Faults;
use crate::service::app::{App, ServiceError};

/// Displacement of a control point.
#[derive(Debug, Clone, PartialEq, serde::Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ControlPointMove {
    /// Index of the control point, from 0, in the order of responses.
    pub control_point: usize,
    /// Displacement vector, in the unit of the points.
    pub by: Vec<f64>,
}

/// Result of a deformation.
#[derive(Debug)]
pub struct Deformation {
    /// Control points of the deformed shape.
    pub control_points: Matrix,
    /// Support of each moved control point.
    pub supports: Vec<Support>,
    /// `L₂` norm of the change.
    pub l2_change: f64,
    /// Largest change at the knots.
    pub largest_change: f64,
}

/// Part of a shape that a control point affects.
#[derive(Debug, Clone, PartialEq, serde::Serialize, utoipa::ToSchema)]
pub struct Support {
    /// Index of the control point, from 0.
    pub control_point: usize,
    /// Interval `[from, to]` for every direction; `to` exceeds 1 where it extends past the end of a closed direction.
    /// Empty for subdivision surfaces, which have no parameters.
    pub parameters: Vec<[f64; 2]>,
}

/// Maximum number of handles, and of displacements.
const MOST: usize = 500;

/// Moves control points of a shape, then applies the smallest change in `L₂` with which it meets `handles`.
///
/// # Errors
/// Faults of the shape at `/shape…`, of the moves and handles; handles that contradict one another.
pub fn deform(
    app: &App,
    posted: &Posted,
    shape: ShapeInput,
    moves: &[ControlPointMove],
    handles: &[Handle],
) -> Result<Deformation, ServiceError> {
    let mut all = Faults::default();
    let before = all.keep(posted.read_one(app, shape, "/shape"))?;
    all.extend(faults(posted, moves, handles));
    let Some(before) = before.filter(|_| all.count() == 0) else { return Err(ServiceError::Invalid(all)) };
    let mut after = before.clone();
    for ControlPointMove { control_point, by } in moves {
        by.iter().enumerate().for_each(|(c, by)| after[(*control_point, c)] += by);
    }
    let context = app.pool.context();
    context.check()?;
    if !handles.is_empty() {
        after += deformation::meet(&posted.space, &after, handles)
            .map_err(|error| ServiceError::invalid("/handles", error.to_string()))?;
    }
    if !after.iter().all(|value| value.abs() <= MAX_COORDINATE) {
        return Err(ServiceError::invalid(
            "/handles",
            format!("expected positions that keep the shape within ±{MAX_COORDINATE:e}"),
        ));
    }
    context.check()?;
    let change = &after - &before;
    let support = |moved: &ControlPointMove| Support {
        control_point: moved.control_point,
        parameters: deformation::support(&posted.space, moved.control_point),
    };
    Ok(Deformation {
        supports: moves.iter().map(support).collect(),
        l2_change: posted.space.norm(&change),
        largest_change: posted.space.largest_change(&change),
        control_points: after,
    })
}

fn faults(posted: &Posted, moves: &[ControlPointMove], handles: &[Handle]) -> Vec<Fault> {
    let representation = posted.space.representation();
    let (size, dimension) = (representation.size(), representation.dimension());
    let mut faults = Vec::new();
    if moves.is_empty() && handles.is_empty() {
        faults.push(Fault::new("", "expected moves or handles, got neither"));
    }
    if moves.len() > MOST || handles.len() > MOST {
        let detail = format!(
            "expected at most {MOST} moves and as many handles, got {} moves and {} handles",
            moves.len(),
            handles.len()
        );
        return vec![Fault::new("", detail)];
    }
    let position = |values: &[f64], pointer: String| {
        let wrong = values.len() != dimension || !values.iter().all(|value| value.abs() <= MAX_COORDINATE);
        let detail = format!("expected {dimension} coordinates within ±{MAX_COORDINATE:e}");
        wrong.then(|| Fault::new(pointer, detail))
    };
    for (i, ControlPointMove { control_point, by }) in moves.iter().enumerate() {
        faults.extend(position(by, format!("/moves/{i}/by")));
        if *control_point >= size {
            let detail = format!("expected a control point from 0 and below {size}, got {control_point}");
            faults.push(Fault::new(format!("/moves/{i}/control_point"), detail));
        }
    }
    for (i, Handle { parameters, position: to }) in handles.iter().enumerate() {
        faults.extend(position(to, format!("/handles/{i}/position")));
        let pointer = format!("/handles/{i}/parameters");
        let found = representation.handle_faults(parameters).into_iter();
        faults.extend(found.map(|fault| Fault::from(fault).below(&pointer)));
    }
    faults
}
