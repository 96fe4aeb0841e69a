//! Components of posted shapes that miss control points. The functions are synchronous and run on the pool.

use crate::analysis::incomplete::{IncompletePca, IncompleteShapes, MAX_LENGTH, incomplete_work};
use crate::service::app::{App, ServiceError, Work};
use crate::service::shapes::outcome::Outcomes;
use crate::service::statistics::Setup;
use crate::wire::fault::Fault;
use crate::wire::partial::PartialInput;

/// Result of the estimation.
#[derive(Debug)]
pub struct Found {
    /// Mean and components.
    pub pca: IncompletePca,
    /// Number of missing control points of each shape.
    pub missing: Vec<usize>,
}

/// Predicted work.
pub fn work(length: usize, shapes: usize, components: usize) -> Work {
    Work::from_multiply_adds(incomplete_work(length.min(MAX_LENGTH), shapes, components))
}

/// Mean and components of incomplete shapes.
///
/// # Errors
/// All faults of the shapes; too many components, too few shapes with a control point, too large shapes; [`ServiceError::Cancelled`].
pub fn pca(
    app: &App,
    setup: &Setup,
    shapes: Vec<PartialInput>,
    components: usize,
) -> Result<Found, ServiceError> {
    let (n, length) = (setup.metric.size(), setup.metric.len());
    if length > MAX_LENGTH {
        let detail = format!(
            "expected shapes of at most {MAX_LENGTH} numbers, got {length}: the scatter has the square of that"
        );
        return Err(ServiceError::invalid("/representation", detail));
    }
    if shapes.len() < 3 || shapes.len() > app.limits.shapes {
        let detail = format!("expected between 3 and {} shapes, got {}", app.limits.shapes, shapes.len());
        return Err(ServiceError::invalid("/shapes", detail));
    }
    let read = |shape: PartialInput| {
        let shape = shape.checked(&setup.space, app.limits.control_points)?;
        let only = shape.arcs.is_none()
            && shape.points.is_empty()
            && shape.conditions.is_empty()
            && shape.deviation == 0.0;
        if !only {
            return Err(vec![Fault::new(
                "",
                "expected control points alone, with nulls or with true and false in observed",
            )]);
        }
        if shape.control_points.is_empty() {
            return Err(vec![Fault::new(
                "/control_points",
                format!("expected some of {n} control points, got none"),
            )]);
        }
        Ok(shape.control_points)
    };
    let read = Outcomes::all_of_list("shapes", shapes.into_iter().map(read))?;
    let mut control_points = vec![0.0; read.len() * length];
    for (shape, given) in control_points.chunks_exact_mut(length).zip(&read) {
        for (i, point) in given {
            point.iter().enumerate().for_each(|(c, x)| shape[c * n + i] = *x);
        }
    }
    let seen: Vec<Vec<usize>> = read.iter().map(|given| given.iter().map(|(i, _)| *i).collect()).collect();
    let missing = seen.iter().map(|seen| n - seen.len()).collect();
    let shapes = IncompleteShapes { control_points, seen };
    let pca = shapes.pca(setup.measured(), setup.frame, components, &app.pool.context())?;
    Ok(Found { pca, missing })
}
