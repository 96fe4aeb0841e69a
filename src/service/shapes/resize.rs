//! Surfaces with other numbers of control points.
//!
//! The function is synchronous and runs on the pool.

use super::each::each;
use super::refine::Refined;
use super::request::Posted;
use crate::formats::fault::Fault;
use crate::geometry::capability::refine::Resizing;
use crate::numeric::dense::Matrix;
use crate::service::app::{App, ServiceError};

/// Interpolates `shapes` at the knots of another grid, keeping their tangents at the poles.
///
/// # Errors
/// Sizes that do not fit, at `pointer`; too many control points.
pub fn resize(
    app: &App,
    posted: &Posted,
    control_points: [usize; 2],
    pointer: &str,
    shapes: &[Matrix],
) -> Result<Refined, ServiceError> {
    let representation = posted.space.representation().with_intervals(control_points);
    let space = app.space_of(&representation).map_err(|error| match error {
        ServiceError::Invalid(faults) => {
            ServiceError::Invalid(faults.map(|fault| Fault { pointer: pointer.into(), ..fault }))
        }
        other => other,
    })?;
    if representation.size().saturating_mul(shapes.len()) > app.limits.samples {
        let detail = format!("expected at most {} control points over all shapes", app.limits.samples);
        return Err(ServiceError::invalid(pointer, detail));
    }
    let resizing = Resizing::new(&posted.space, &space)
        .ok_or_else(|| ServiceError::Internal("only surfaces have two numbers of control points".into()))?;
    let resized = each(&app.pool.context(), shapes, |shape| resizing.apply(shape))?;
    Ok(Refined {
        exact: resized.iter().all(|resized| resized.exact),
        parameter_shift: 0.0,
        shapes: resized.into_iter().map(|found| (found.control_points, Some(found.change))).collect(),
        representation,
    })
}
