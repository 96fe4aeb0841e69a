//! Models: shapes given by free points, with their boundaries.
//!
//! * [`curve`] — closed planar curves with any generator; [`surface`] — spheres and tori;
//! * [`cylinder`] — cylinders with caps; [`subdivision`] — subdivision surfaces;
//! * [`kind`] — the model of a representation;
//! * [`reparametrisation`] — stages in which only affine maps, or distances from the centre, are free.
//!
//! Free points and all lengths in this module are in index coordinates.

pub mod curve;
pub mod cylinder;
pub mod kind;
pub mod reparametrisation;
pub mod subdivision;
pub mod surface;

use shapelex_geometry::mesh::TriangleMesh;
use shapelex_geometry::raster::{Grid, Mask, from_contours, from_mesh};
use shapelex_numeric::sparse::SparseRows;

use crate::boundary::Boundary;
use crate::frame::Frame;

/// Distance of samples on surfaces, in cells, for fields without blur: one sample per cell face.
const SPACING: f64 = 1.0;
/// Distance of the points of an outline, in cells: its area is accurate to a thousandth.
const OUTLINE_SPACING: f64 = 0.5;
/// Maximum number of samples per span, which a span of 40 cells does not need.
const MAX_PER_SPAN: usize = 64;

/// A closed polygon or mesh.
#[derive(Debug, Clone, PartialEq)]
pub enum Outline {
    /// The points of a planar curve.
    Polygon(Vec<[f64; 2]>),
    /// The mesh of a surface.
    Mesh(TriangleMesh),
}

impl Outline {
    /// The cells inside: those with a winding number that is not zero.
    pub fn cells(&self, grid: &Grid) -> Mask {
        match self {
            Self::Polygon(points) => from_contours(std::slice::from_ref(points), grid),
            Self::Mesh(mesh) => from_mesh(mesh, grid),
        }
    }

    /// Lower and upper corner; `None` without points. In the plane, the third coordinate is 0.
    pub fn bounds(&self) -> Option<[[f64; 3]; 2]> {
        match self {
            Self::Polygon(points) => {
                shapelex_geometry::raster::bounds(points.iter().map(|[x, y]| [*x, *y, 0.0]))
            }
            Self::Mesh(mesh) => shapelex_geometry::raster::bounds(mesh.vertices.iter().copied()),
        }
    }
}

/// A kind of shape with a number of free points.
pub trait Model<const D: usize>: Send + Sync {
    /// Number of free points.
    fn rows(&self) -> usize;

    /// The boundary, sampled finely enough for a field with a blur of `sigma` cells and shapes of about the size of `rows`.
    fn boundary(&self, rows: &[[f64; D]], sigma: f64, frame: Frame<D>) -> Box<dyn Boundary<D>>;

    /// The outline of a shape.
    fn outline(&self, rows: &[[f64; D]]) -> Outline;

    /// Whether the boundary of a shape crosses or touches itself, where there is an exact test: of planar curves.
    fn crosses_itself(&self, rows: &[[f64; D]]) -> bool {
        let _ = rows;
        false
    }

    /// Weights of the free points in the centre of a shape; their sum is 1.
    fn centre(&self) -> Vec<f64>;

    /// The map from free points to all control points of the representation; `None` if they are the same.
    fn lift(&self) -> Option<SparseRows>;

    /// The free points of a shape that has these control points; the others are not free, and get lost.
    fn free_points(&self, control_points: &[[f64; D]]) -> Vec<[f64; D]> {
        control_points[..self.rows()].to_vec()
    }

    /// All control points of the representation.
    fn control_points(&self, rows: &[[f64; D]]) -> Vec<[f64; D]> {
        self.lift().map_or_else(|| rows.to_vec(), |lift| lift.apply(rows))
    }
}

/// Number of samples per span for spans of a given total length, at least `least`.
fn per_span(length: f64, spans: usize, spacing: f64, least: usize) -> usize {
    ((length / (spans as f64 * spacing)).ceil() as usize).clamp(least, MAX_PER_SPAN)
}

/// Equal weights.
fn equal(count: usize) -> Vec<f64> {
    vec![1.0 / count as f64; count]
}
