//! Refinement of curves to a grid with several times as many knots, exactly where the generator allows it; and of curves and surfaces in
//! a part of their domain, by blocks of a finer grid.
//!
//! The function is synchronous and runs on the pool.

use super::blocks::Layers;
use super::each::each;
use super::request::Posted;
use crate::geometry::refine::Refinement;
use crate::geometry::representation::Representation;
use crate::geometry::resolution::{Block, Detailed, ParameterRegion};
use crate::numeric::dense::Matrix;
use crate::service::app::{App, ServiceError};
use crate::wire::fault::Fault;
use crate::wire::shape::ShapeInput;

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

/// A block of a shape, with the places of its control points.
#[derive(Debug)]
pub struct Placed {
    /// The block.
    pub block: Block,
    /// Its control points, on their grid.
    pub control_points: Matrix,
}

/// A shape with its blocks, in their order.
#[derive(Debug)]
pub struct Layered {
    /// Control points of the representation of the request.
    pub control_points: Matrix,
    /// Blocks of finer grids.
    pub blocks: Vec<Placed>,
}

impl Layered {
    /// A shape with the places of the control points of its blocks, on the grids of `posted`.
    ///
    /// # Errors
    /// Grids without a relation, which those that were prepared have.
    pub fn new(posted: &Posted, shape: Detailed) -> Result<Self, ServiceError> {
        let Some(grids) = posted.grids() else {
            return Ok(Self { control_points: shape.control_points, blocks: Vec::new() });
        };
        let places =
            shape.blocks.iter().map(|block| grids.places(&shape, block)).collect::<Result<Vec<_>, _>>();
        let places = places.map_err(|error| ServiceError::Internal(error.to_string()))?;
        let placed = shape.blocks.into_iter().zip(places);
        let blocks = placed.map(|(block, control_points)| Placed { block, control_points }).collect();
        Ok(Self { control_points: shape.control_points, blocks })
    }
}

/// Adds a block of the control points of a finer grid that move shapes within `region` only: the same shapes, whose offsets are 0.
///
/// # Errors
/// Faults of the shapes and of the region; too many control points.
pub fn refine_region(
    app: &App,
    posted: &Posted,
    factors: &[usize],
    region: &ParameterRegion,
    shapes: Vec<ShapeInput>,
) -> Result<Vec<Layered>, ServiceError> {
    let grid = posted.grids().and_then(|grids| grids.grid(factors));
    let grid = grid.ok_or_else(|| ServiceError::Internal("the grid of a region is prepared".into()))?;
    let indices = region
        .control_points(grid)
        .map_err(|fault| ServiceError::below(vec![Fault::from(fault)], "/region"))?;
    if indices.len().saturating_mul(shapes.len()) > app.limits.samples {
        let detail =
            format!("expected at most {} control points over the blocks of all shapes", app.limits.samples);
        return Err(ServiceError::invalid("/region", detail));
    }
    let dimension = posted.metric.dimension();
    let block = || {
        let offsets = Matrix::zeros(indices.len(), dimension);
        Block { factors: factors.to_vec(), indices: indices.clone(), offsets }
    };
    let shapes = posted.read_detailed(app, shapes)?;
    let refined = each(&app.pool.context(), &shapes, |shape| {
        let mut shape = shape.clone();
        shape.blocks.push(block());
        Layered::new(posted, shape)
    })?;
    refined.into_iter().collect()
}

/// Shapes with blocks by control points of one grid that refines those of all blocks.
///
/// # Errors
/// Faults of the shapes; too many control points.
pub fn flatten(
    app: &App,
    layers: &Layers,
    posted: &Posted,
    shapes: Vec<ShapeInput>,
) -> Result<Refined, ServiceError> {
    let shapes = posted.read(app, shapes)?;
    if posted.metric.size().saturating_mul(shapes.len()) > app.limits.samples {
        let detail = format!("expected at most {} control points over all shapes", app.limits.samples);
        return Err(ServiceError::invalid("/shapes", detail));
    }
    Ok(Refined {
        representation: posted.space.representation().clone(),
        exact: true,
        parameter_shifts: posted.shifts()[..layers.factors().len()].to_vec(),
        shapes: shapes.into_iter().map(|shape| (shape, None)).collect(),
    })
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
