//! Refinement of curves to a grid with several times as many knots, exactly where the generator allows it.
//!
//! The function is synchronous and runs on the pool.

use super::each::each;
use super::request::Posted;
use crate::geometry::refine::Refinement;
use crate::geometry::representation::Representation;
use crate::numeric::dense::Matrix;
use crate::service::app::{App, ServiceError};

/// Maximum factor of a refinement.
const MAX_FACTOR: usize = 1024;

/// Shapes on another grid of knots.
#[derive(Debug)]
pub struct Refined {
    /// Representation of the new shapes.
    pub representation: Representation,
    /// Whether the new shapes are the same functions, at most up to rounding.
    pub exact: bool,
    /// The shifts `δ` with `r(u) = r_new(u + δ)`, one per parameter.
    pub parameter_shifts: Vec<f64>,
    /// Control points and, unless the two are the same by construction, the `L₂` distance to the original shape.
    pub shapes: Vec<(Matrix, Option<f64>)>,
}

/// Refines curves to `factor` times as many knots.
///
/// # Errors
/// A factor that does not fit; too many control points.
pub fn refine(app: &App, curves: &Posted, factor: usize, shapes: &[Matrix]) -> Result<Refined, ServiceError> {
    check_factor(app, curves.space.representation(), factor, shapes.len())?;
    let refinement = Refinement::new(&curves.space, factor)
        .map_err(|error| ServiceError::invalid("/representation/generator", error.to_string()))?;
    let shapes = each(&app.pool.context(), shapes, |shape| refinement.apply_measured(&curves.space, shape))?;
    Ok(Refined {
        representation: refinement.representation().clone(),
        exact: refinement.is_exact(),
        parameter_shifts: vec![refinement.parameter_shift()],
        shapes,
    })
}

fn check_factor(
    app: &App,
    representation: &Representation,
    factor: usize,
    shapes: usize,
) -> Result<(), ServiceError> {
    let refused = |detail: String| Err(ServiceError::invalid("/factor", detail));
    if !(2..=MAX_FACTOR).contains(&factor) {
        return refused(format!("expected a number between 2 and {MAX_FACTOR}, got {factor}"));
    }
    if representation.needs_even_factors() && factor % 2 == 1 {
        return refused(format!(
            "expected an even number, got {factor}: half-integer shifts fall between the knots of an odd split"
        ));
    }
    let (count, most) = (representation.count().saturating_mul(factor), app.limits.control_points);
    if count > most {
        let field = representation.knots()[0].field;
        return refused(format!("expected at most {most} {field} after refinement, got {count}"));
    }
    if count.saturating_mul(shapes) > app.limits.samples {
        return refused(format!("expected at most {} control points over all shapes", app.limits.samples));
    }
    Ok(())
}
