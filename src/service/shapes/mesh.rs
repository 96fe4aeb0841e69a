//! Triangle meshes of shapes. The functions are synchronous and run on the pool.

use super::outcome::Outcomes;
use super::read::check_correspondence;
use super::read_oriented::OrientedReader;
use super::request::Posted;
use crate::analysis::correspondence::Correspondence;
use crate::geometry::GeometryError;
use crate::geometry::capability::domain::{Admitted, Domain};
use crate::geometry::capability::tessellate::Detail;
use crate::geometry::drawing::layer::MAX_FACES;
use crate::geometry::mesh::TriangleMesh;
use crate::geometry::representation::ShapeSpace;
use crate::geometry::texture::TexturedMesh;
use crate::numeric::dense::Matrix;
use crate::service::app::{App, ServiceError};
use crate::wire::fault::Fault;
use crate::wire::shape::ShapeInput;

/// Maximum number of vertices of a mesh over a grid: a tenth of a second.
const MAX_VERTICES: usize = 250_000;

/// Triangle mesh of a shape, with texture coordinates if it has two parameters, at `grid` places along `u` and `v`. Default:
/// two for every interval between knots, within bounds. A subdivision surface has the mesh of its level.
///
/// # Errors
/// [`ServiceError::Parameters`] for shapes that are not surfaces and for invalid grids.
pub fn mesh_of(
    space: &ShapeSpace,
    control_points: &[f64],
    grid: Option<[usize; 2]>,
) -> Result<TexturedMesh, ServiceError> {
    let refused = |name: &str, detail: String| Err(ServiceError::parameter(name, detail));
    let grid = match space.domain() {
        Domain::Vertices if grid.is_some() => {
            let detail =
                "expected none: a grid belongs to tensor-product surfaces, a subdivision surface has a level";
            return refused("grid", detail.into());
        }
        Domain::Vertices => None,
        Domain::Sheet { extent, seam } => {
            let grid = grid.unwrap_or_else(|| extent.usual_grid());
            if let Some(detail) = extent.grid_fault(seam, grid, MAX_VERTICES) {
                return refused("grid", detail);
            }
            Some(grid)
        }
        Domain::Points | Domain::Line { .. } => {
            return refused(
                "format",
                "expected 'json', 'svg' or 'png': only surfaces are written as meshes".into(),
            );
        }
    };
    let rows = Matrix::from_column_slice(space.gram().size(), 3, control_points);
    let mesh = space.tessellate(&rows, grid).ok_or_else(not_a_mesh)?;
    Ok(TexturedMesh { mesh, texture: space.texture(grid) })
}

fn not_a_mesh() -> ServiceError {
    ServiceError::Internal("only surfaces have meshes".into())
}

/// Checks the number of vertices of `shapes` refined meshes.
///
/// # Errors
/// Too many vertices in total.
pub(crate) fn check_vertices(
    app: &App,
    representation: &Admitted,
    shapes: usize,
) -> Result<(), ServiceError> {
    let vertices = representation.refined_vertices().saturating_mul(shapes);
    if vertices > app.limits.samples {
        let detail =
            format!("expected at most {} vertices over all shapes, got {vertices}", app.limits.samples);
        return Err(ServiceError::invalid("/shapes", detail));
    }
    Ok(())
}

/// Refined meshes of posted shapes, in order; those of the normal-based scheme have normals.
///
/// # Errors
/// Faults of the shapes; too many vertices in total.
pub fn refined(
    app: &App,
    representation: &Admitted,
    correspondence: Correspondence,
    shapes: Vec<ShapeInput>,
    detail: Detail,
) -> Result<Vec<TriangleMesh>, ServiceError> {
    refined_each(app, representation, correspondence, shapes, detail)?.all()
}

/// As [`refined`], with the faults of the shapes among the outcomes.
///
/// # Errors
/// Too many vertices in total; no shapes.
pub(crate) fn refined_each(
    app: &App,
    representation: &Admitted,
    correspondence: Correspondence,
    shapes: Vec<ShapeInput>,
    detail: Detail,
) -> Result<Outcomes<TriangleMesh>, ServiceError> {
    check_vertices(app, representation, shapes.len())?;
    if let Some(reader) = OrientedReader::new(representation)? {
        check_correspondence(representation, correspondence)?;
        return refined_oriented(app, &reader, shapes, detail);
    }
    let posted = Posted::new(app, representation, correspondence)?;
    let shapes = posted.read_each(app, shapes)?;
    shapes
        .each(&app.pool.context(), |_, rows| posted.space.refined_mesh(&rows, detail).ok_or_else(not_a_mesh))
}

fn refined_oriented(
    app: &App,
    reader: &OrientedReader<'_>,
    shapes: Vec<ShapeInput>,
    detail: Detail,
) -> Result<Outcomes<TriangleMesh>, ServiceError> {
    let context = app.pool.context();
    let most = (detail == Detail::Drawn).then_some(MAX_FACES);
    reader.read_each(&context, shapes)?.each(&context, |index, shape| {
        let refused = |error: GeometryError| vec![Fault::new("", error.to_string())];
        let mesh = reader.meshes.refine(&shape, most).map_err(refused);
        mesh.map_err(|faults| ServiceError::of_entry("shapes", index, faults))
    })
}
