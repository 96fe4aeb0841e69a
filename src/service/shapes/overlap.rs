//! Overlap of two posted bodies: Jaccard and Dice coefficients of their interior cells, and distances of their surfaces.
//!
//! The functions are synchronous and run on the pool.

use super::read_mesh::face_pointer;
use super::read_points::take_points;
use crate::geometry::field_fault::FieldFault;
use crate::geometry::mesh::TriangleMesh;
use crate::geometry::overlap::{Bodies, Body, GridInput, MaskInput};
use crate::service::app::{App, Limits, ServiceError};
use crate::wire::checked::{Checked, LARGE, document, take_given};
use crate::wire::fault::Fault;
use crate::wire::shape::PointList;

document! {
    /// A body, given by exactly one of `contour`, `vertices` with `faces`, and `mask`.
    pub struct BodyInput {
        /// Points of a closed contour in the plane.
        #[schema(value_type = Option<Vec<[f64; 2]>>)]
        contour: PointList;
        /// Vertices of a closed triangle mesh.
        #[schema(value_type = Option<Vec<[f64; 3]>>)]
        vertices: PointList;
        /// Triangles of the mesh, as indices of their vertices.
        #[schema(value_type = Option<Vec<[u32; 3]>>)]
        faces: Checked<Vec<[u32; 3]>, LARGE>;
        /// Mask on a regular grid.
        #[schema(value_type = Option<MaskInput>)]
        mask: Checked<MaskInput, LARGE>;
    }
}

/// Maximum number of cells of a grid: some seconds of work.
const MAX_CELLS: usize = 1 << 24;

fn read_body(input: BodyInput, limits: &Limits) -> Result<Body, Vec<Fault>> {
    let mut errors = input.faults;
    let contour = take_points::<2>(&input.contour, "/contour", &mut errors);
    let vertices = take_points::<3>(&input.vertices, "/vertices", &mut errors);
    let faces = take_given(input.faces, "/faces", &mut errors);
    let mask = take_given(input.mask, "/mask", &mut errors);
    if !errors.is_empty() {
        return Err(errors);
    }
    let one = |pointer: &str, detail: String| vec![Fault::new(pointer, detail)];
    match (contour, vertices, faces, mask) {
        (Some(points), None, None, None) => match points.len() {
            3.. if points.len() <= limits.points => {
                Body::from_contour(points).map_err(|detail| one("/contour", detail))
            }
            found => {
                let detail = format!("expected between 3 and {} points, got {found}", limits.points);
                Err(one("/contour", detail))
            }
        },
        (None, Some(vertices), Some(faces), None) => {
            if vertices.len() > limits.vertices || faces.len() > 2 * limits.vertices {
                let detail = format!(
                    "expected at most {1} vertices (and twice as many faces), got {0}",
                    vertices.len(),
                    limits.vertices
                );
                return Err(one("/vertices", detail));
            }
            let mesh = TriangleMesh { vertices, normals: None, faces };
            Body::from_mesh(mesh)
                .map_err(|fault| one(&format!("/faces{}", face_pointer(&fault)), fault.to_string()))
        }
        (None, None, None, Some(mask)) => {
            let below = |fault: FieldFault| Fault::from(fault).below("/mask");
            let mask = mask.mask(MAX_CELLS);
            mask.map(Body::from_mask).map_err(|faults| faults.into_iter().map(below).collect())
        }
        _ => Err(one("", "expected one of a contour, vertices and faces, or a mask".into())),
    }
}

/// Cells on which two bodies are counted.
#[derive(Debug, Clone)]
pub enum Cells {
    /// Those of a grid around both, of this side if one is given.
    Spacing(Option<f64>),
    /// Those of a given grid.
    Grid(GridInput),
}

/// Reads two bodies and chooses their grid: see [`Bodies::new`] and [`Bodies::on_grid`].
///
/// # Errors
/// Faults of the bodies at `/first…` and `/second…`, and of the grid at `/grid…`; bodies and cells that do not fit together; too
/// many cells.
pub fn read(app: &App, [first, second]: [BodyInput; 2], cells: Cells) -> Result<Bodies, ServiceError> {
    let mut faults = Vec::new();
    let mut read = |body, pointer: &str| match read_body(body, &app.limits) {
        Ok(body) => Some(body),
        Err(errors) => {
            faults.extend(errors.into_iter().map(|error| error.below(pointer)));
            None
        }
    };
    let bodies = (read(first, "/first"), read(second, "/second"));
    ServiceError::unless_empty(faults)?;
    let (Some(first), Some(second)) = bodies else {
        return Err(ServiceError::Internal("a body that is neither read nor refused".into()));
    };
    match cells {
        Cells::Spacing(spacing) => {
            Bodies::new([first, second], spacing, MAX_CELLS).map_err(ServiceError::from)
        }
        Cells::Grid(given) => {
            let grid = given.grid(MAX_CELLS).map_err(|faults| below(faults, "/grid"))?;
            Bodies::on_grid([first, second], grid, given.size.len()).map_err(|faults| below(faults, ""))
        }
    }
}

fn below(faults: Vec<FieldFault>, pointer: &str) -> ServiceError {
    ServiceError::below(faults.into_iter().map(Fault::from).collect(), pointer)
}
