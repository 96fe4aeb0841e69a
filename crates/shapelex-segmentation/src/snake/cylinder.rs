//! Cylinders of splines, closed by caps.
//!
//! The free points are `c[k, l]`, `l = 0 … M_v`; points beyond the ends follow by linear extrapolation
//! ([`extension`]).

use std::f64::consts::TAU;
use std::sync::Arc;

use shapelex_geometry::GeometryError;
use shapelex_geometry::mesh::TriangleMesh;
use shapelex_geometry::surface::Topology;
use shapelex_geometry::surface::basis::SurfaceBasis;
use shapelex_numeric::sparse::SparseRows;

use super::{Model, OUTLINE_SPACING, Outline, equal};
use crate::boundary::Boundary;
use crate::boundary::cylinder::{CylinderBoundary, CylinderMesh, extension};
use crate::boundary::tensor::lengths;
use crate::frame::Frame;

/// Length of edges, in cells, for fields without blur: diagonals are then about one cell.
const EDGE: f64 = 0.8;
/// Minimum number of vertices per span.
const LEAST: usize = 4;
/// Maximum number of vertices around or along: more cells than a volume has.
const MOST: usize = 2048;

/// Cylinders of one size.
#[derive(Debug, Clone)]
pub struct CylinderSnake {
    basis: Arc<SurfaceBasis>,
    net: SparseRows,
}

impl CylinderSnake {
    /// The cylinders of a basis.
    ///
    /// # Errors
    /// [`GeometryError::Surface`] for other topologies.
    pub fn new(basis: Arc<SurfaceBasis>) -> Result<Self, GeometryError> {
        if basis.extent().topology != Topology::Cylinder {
            let detail = "expected a cylinder".into();
            return Err(GeometryError::Surface { field: "topology", detail });
        }
        if basis.lines()[1].is_shifted() {
            let detail = "expected another generator than \"shifted_exponential\" along the axis, which has other points beyond its ends";
            return Err(GeometryError::Surface { field: "generators/1", detail: detail.into() });
        }
        let net = extension(basis.lines());
        Ok(Self { basis, net })
    }

    /// The mesh of a shape with edges of about `spacing` cells.
    fn mesh(&self, rows: &[[f64; 3]], spacing: f64) -> CylinderMesh {
        let lengths = lengths(self.basis.lines(), &self.net, rows);
        let counts = [0, 1].map(|i| {
            let least = LEAST * self.basis.lines()[i].intervals();
            ((lengths[i] / spacing).ceil() as usize).clamp(least, MOST.max(least))
        });
        let rings = (lengths[0] / (TAU * spacing)).ceil() as usize;
        CylinderMesh { counts, rings: rings.clamp(2, MOST) }
    }

    fn closed(&self, rows: &[[f64; 3]], spacing: f64, frame: Frame<3>) -> CylinderBoundary {
        CylinderBoundary::new(self.basis.lines(), self.mesh(rows, spacing), rows, frame)
    }
}

impl Model<3> for CylinderSnake {
    fn rows(&self) -> usize {
        self.net.columns()
    }

    fn boundary(&self, rows: &[[f64; 3]], sigma: f64, frame: Frame<3>) -> Box<dyn Boundary<3>> {
        Box::new(self.closed(rows, EDGE * sigma.max(1.0), frame))
    }

    fn outline(&self, rows: &[[f64; 3]]) -> Outline {
        let boundary = self.closed(rows, OUTLINE_SPACING, Frame::identity());
        let faces = boundary.closed().faces().to_vec();
        Outline::Mesh(TriangleMesh { vertices: boundary.sample(rows).vertices, normals: None, faces })
    }

    fn centre(&self) -> Vec<f64> {
        equal(self.rows())
    }

    fn lift(&self) -> Option<SparseRows> {
        Some(self.net.clone())
    }

    fn free_points(&self, control_points: &[[f64; 3]]) -> Vec<[f64; 3]> {
        let line = &self.basis.lines()[1];
        let [before, after] = line.beyond();
        let free = before..before + line.intervals() + 1;
        let length = free.end + after;
        control_points.chunks_exact(length).flat_map(|along| along[free.clone()].to_vec()).collect()
    }
}
