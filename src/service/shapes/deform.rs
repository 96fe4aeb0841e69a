//! Deformation of one posted shape. The function is synchronous and runs on the pool.

use super::read_oriented::OrientedReader;
use super::request::Posted;
use crate::geometry::capability::deform::MovedOriented;
use crate::geometry::deformation::{ControlPointMove, Deformation, Edit, Handle};
use crate::geometry::representation::Representation;
use crate::geometry::resolution::{Block, Resolutions};
use crate::service::app::faults::Faults;
use crate::service::app::{App, ServiceError};
use crate::wire::fault::Fault;
use crate::wire::shape::ShapeInput;

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
    let mut faults = Faults::default();
    let before = faults.keep_below("/shape", posted.detailed(app, shape));
    let uniform;
    let grids = match posted.grids() {
        Some(grids) => grids,
        None => {
            uniform = Resolutions::uniform(&posted.space);
            &uniform
        }
    };
    let blocks = before.as_ref().map_or(&[][..], |before| &before.blocks);
    // Faults of the blocks come first: moves name their indices.
    let edit = match &before {
        None if posted.grids().is_some() => None,
        _ => faults.keep_below("", edit(grids, blocks, moves, handles)),
    };
    let (Some(before), Some(edit)) = (&before, edit) else { return Err(ServiceError::Invalid(faults)) };
    let context = app.pool.context();
    context.check()?;
    let after = edit.apply(before)?;
    context.check()?;
    Ok(edit.described(before, after))
}

/// Moves points and normals of a shape of the normal-based scheme.
///
/// # Errors
/// Faults of the shape at `/shape…`, of the moves and handles; edges that cannot be split.
pub fn deform_oriented(
    app: &App,
    representation: &Representation,
    shape: ShapeInput,
    moves: &[ControlPointMove],
    handles: &[Handle],
) -> Result<MovedOriented, ServiceError> {
    let reader = OrientedReader::new(representation)?
        .ok_or_else(|| ServiceError::Internal("only the normal-based scheme has normals".into()))?;
    check_count(moves, handles).map_err(|faults| ServiceError::below(faults, ""))?;
    let before = reader.read(shape).map_err(|errors| ServiceError::below(errors, "/shape"))?;
    app.pool.context().check()?;
    let moved = reader.meshes.moved(representation, &before, moves, handles);
    moved.map_err(|faults| ServiceError::below(faults.into_iter().map(Fault::from).collect(), ""))
}

/// Checks the numbers of moves and handles.
fn check_count(moves: &[ControlPointMove], handles: &[Handle]) -> Result<(), Vec<Fault>> {
    if moves.len() <= MOST && handles.len() <= MOST {
        return Ok(());
    }
    let detail = format!(
        "expected at most {MOST} moves and as many handles, got {} moves and {} handles",
        moves.len(),
        handles.len()
    );
    Err(vec![Fault::new("", detail)])
}

fn edit<'a>(
    grids: &'a Resolutions,
    blocks: &[Block],
    moves: &'a [ControlPointMove],
    handles: &'a [Handle],
) -> Result<Edit<'a>, Vec<Fault>> {
    check_count(moves, handles)?;
    let edit = Edit::new(grids, blocks, moves, handles);
    edit.map_err(|faults| faults.into_iter().map(Fault::from).collect())
}
