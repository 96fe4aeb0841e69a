//! Triangle meshes of shapes: for files, for drawings, and as values of shapes without parameters.

use crate::drawing::layer::MAX_FACES;
use crate::mesh::TriangleMesh;
use crate::representation::{Representation, ShapeSpace};
use crate::subdivision::basis::SubdivisionBasis;
use crate::subdivision::measures::frames;
use crate::surface::basis::Extent;
use crate::surface::seam::Seam;
use crate::texture::Texture;
use crate::vector::{far_origin, plus};
use shapelex_numeric::dense::Matrix;

/// Detail of a refined mesh.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Detail {
    /// The mesh of its level.
    Whole,
    /// A mesh with few faces, for drawings.
    Drawn,
}

/// Minimum and maximum number of places along a direction of a default grid.
const USUAL_CELLS: [usize; 2] = [24, 256];

impl Extent {
    /// Default number of places along `u` and `v` of a mesh: two for every interval between knots, at least 24 and at most
    /// 256.
    pub fn usual_grid(self) -> [usize; 2] {
        let closed = self.topology.closed();
        [0, 1].map(|i| {
            self.intervals[i].saturating_mul(2).clamp(USUAL_CELLS[0], USUAL_CELLS[1])
                + usize::from(!closed[i])
        })
    }

    /// Why no mesh of at most `most` vertices over `grid` exists, if none does.
    pub fn grid_fault(self, seam: Seam, grid: [usize; 2], most: usize) -> Option<String> {
        let closed = self.topology.closed();
        let fewest = [0, 1].map(|i| if closed[i] || self.topology.has_poles() { 3 } else { 2 });
        if grid[0] < fewest[0] || grid[1] < fewest[1] {
            return Some(format!(
                "expected at least {2},{3}, got {0},{1}",
                grid[0], grid[1], fewest[0], fewest[1]
            ));
        }
        let vertices = grid[0].saturating_mul(grid[1]);
        if vertices > most {
            return Some(format!("expected at most {most} vertices, got {vertices}"));
        }
        let odd = seam == Seam::HalfTurn && grid[1] % 2 == 1;
        odd.then(|| format!("expected an even number along v behind a half turn, got {}", grid[1]))
    }
}

/// The same mesh with vertex normals, for programs that shade it. Cost: linear.
pub fn with_normals(mesh: TriangleMesh) -> TriangleMesh {
    let normals = mesh.normals.clone();
    let of_faces = || frames(&mesh).iter().map(|frame| frame.normal.unwrap_or_default()).collect();
    TriangleMesh { normals: Some(normals.unwrap_or_else(of_faces)), ..mesh }
}

/// The same mesh, translated.
pub fn moved(mesh: TriangleMesh, by: [f64; 3]) -> TriangleMesh {
    let vertices = mesh.vertices.into_iter().map(|vertex| plus(vertex, by)).collect();
    TriangleMesh { vertices, ..mesh }
}

impl Representation {
    /// Faces of the control mesh of a refined surface; `None` for other shapes.
    pub fn control_faces(&self) -> Option<Vec<[u32; 3]>> {
        let control = self.subdivision()?.control().ok()?;
        Some(control.faces().to_vec())
    }
}

impl ShapeSpace {
    /// Texture coordinates of meshes over a valid `grid`; `None` for shapes without two parameters.
    pub fn texture(&self, grid: Option<[usize; 2]>) -> Option<Texture> {
        Some(self.surface()?.extent().texture(grid?))
    }

    /// Mesh of a shape with normals: over a valid `grid` ([`Extent::grid_fault`]), or of its level; `None` for shapes that are
    /// not surfaces, or without the grid that they need. One-sided surfaces have no normals.
    pub fn tessellate(&self, control_points: &Matrix, grid: Option<[usize; 2]>) -> Option<TriangleMesh> {
        match (self.surface(), self.subdivision()) {
            (Some(basis), _) => Some(basis.surface(control_points).tessellate(grid?)),
            (_, Some(basis)) => Some(with_normals(basis.mesh(control_points))),
            _ => None,
        }
    }

    /// Mesh of a shape at its level, refined about a point near the shape if that is far from the origin; `None` for shapes
    /// that are not refined.
    pub fn refined_mesh(&self, control_points: &Matrix, detail: Detail) -> Option<TriangleMesh> {
        let basis = self.subdivision()?;
        let points: Vec<[f64; 3]> =
            (0..control_points.nrows()).map(|i| [0, 1, 2].map(|c| control_points[(i, c)])).collect();
        let Some(origin) = far_origin(points.iter()) else {
            return Some(near(basis, control_points, detail));
        };
        let about = Matrix::from_fn(points.len(), 3, |i, c| points[i][c] - origin[c]);
        Some(moved(near(basis, &about, detail), origin))
    }
}

fn near(basis: &SubdivisionBasis, rows: &Matrix, detail: Detail) -> TriangleMesh {
    match detail {
        Detail::Whole => basis.mesh(rows),
        Detail::Drawn => basis.drawn(rows, basis.level_with(MAX_FACES)),
    }
}
