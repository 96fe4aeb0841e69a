//! Surfaces with other numbers of control points.
//!
//! The function is synchronous and runs on the pool.

use super::each::each;
use super::refine::Refined;
use super::request::Posted;
use crate::geometry::capability::refine::Resizing;
use crate::numeric::dense::Matrix;
use crate::service::app::{App, ServiceError};
use crate::wire::fault::Fault;

/// Refines `shapes` exactly where their generators allow it, else interpolates them at the knots of another grid, keeping their tangents
/// at the poles.
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
    let no_surface = || ServiceError::Internal("only surfaces have two numbers of control points".into());
    let at_pointer = |error| match error {
        ServiceError::Invalid(faults) => {
            ServiceError::Invalid(faults.map(|fault| Fault { pointer: pointer.into(), ..fault }))
        }
        other => other,
    };
    // Sizes first: filters and factors are as large.
    app.admit(posted.space.representation().with_intervals(control_points)).map_err(at_pointer)?;
    let representation = posted.space.resized(control_points).ok_or_else(no_surface)?;
    let space = app.space_of(&representation).map_err(at_pointer)?;
    if representation.size().saturating_mul(shapes.len()) > app.limits.samples {
        let detail = format!("expected at most {} control points over all shapes", app.limits.samples);
        return Err(ServiceError::invalid(pointer, detail));
    }
    let resizing = Resizing::new(&posted.space, &space).ok_or_else(no_surface)?;
    let resized = each(&app.pool.context(), shapes, |shape| resizing.apply(shape))?;
    Ok(Refined {
        exact: resized.iter().all(|resized| resized.exact),
        parameter_shifts: resizing.shifts().to_vec(),
        shapes: resized.into_iter().map(|found| (found.control_points, found.change)).collect(),
        representation,
    })
}
