//! Exact control points of idealised shapes. The function is synchronous and runs on the pool.

use super::request::Posted;
use crate::geometry::capability::idealise::{IdealFault, Placed, PlacedSurface};
use crate::numeric::dense::Matrix;
use crate::service::app::{App, ServiceError};
use crate::wire::fault::Fault;
use crate::wire::shape::MAX_COORDINATE;

/// Exact control points of idealised curves or surfaces.
///
/// # Errors
/// Shapes that the generators do not reproduce; for curves, with the missing poles.
pub fn idealise(app: &App, posted: &Posted, wanted: &[Placed]) -> Result<Vec<Matrix>, ServiceError> {
    let (list, name) =
        if posted.space.domain().is_sheet() { ("surfaces", "surface") } else { ("curves", "curve") };
    let refused = |detail: String| Err(ServiceError::invalid(format!("/{list}"), detail));
    if wanted.is_empty() {
        return refused("expected at least 1 entry, got none".into());
    }
    if wanted.len().saturating_mul(posted.metric.size()) > app.limits.samples {
        return refused(format!("expected at most {} control points over all entries", app.limits.samples));
    }
    let (mut shapes, mut faults) = (Vec::with_capacity(wanted.len()), Vec::new());
    for (index, placed) in wanted.iter().enumerate() {
        match idealise_one(posted, placed, name) {
            Ok(shape) => shapes.push(shape),
            Err(fault) => faults.push(fault.below(&format!("/{list}/{index}")).at_shape(index)),
        }
    }
    ServiceError::unless_empty(faults)?;
    Ok(shapes)
}

fn idealise_one(posted: &Posted, placed: &Placed, name: &str) -> Result<Matrix, Fault> {
    let shape = posted.space.idealise(placed);
    let shape = shape.map_err(|fault| Fault::new(format!("/{name}"), detail(&fault, placed)))?;
    let inside = shape.iter().all(|value| value.abs() <= MAX_COORDINATE);
    let outside = || Fault::new("", format!("expected coordinates within ±{MAX_COORDINATE:e}"));
    inside.then_some(shape).ok_or_else(outside)
}

/// The fault in words; generators that would contain a surface are named as in a request.
fn detail(fault: &IdealFault, placed: &Placed) -> String {
    match (fault, placed) {
        (IdealFault::NotContained { .. }, Placed::Surface(PlacedSurface { surface, .. })) => {
            let kinds = serde_json::to_string(&surface.generators()).unwrap_or_default();
            let [least_u, least_v] = surface.fewest_intervals();
            format!("{fault}: use {kinds} with at least {least_u} × {least_v} control points")
        }
        _ => fault.to_string(),
    }
}
