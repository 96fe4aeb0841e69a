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

use shapelex_geometry::GeometryError;
use shapelex_geometry::mesh::TriangleMesh;
use shapelex_geometry::raster::{Grid, Mask, from_contours, from_mesh};
use shapelex_geometry::vector::{cross, dot, minus, plus};
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

    /// The points of the polygon, or the vertices of the mesh; in the plane, the third coordinate is 0.
    pub fn points(&self) -> Vec<[f64; 3]> {
        match self {
            Self::Polygon(points) => points.iter().map(|[x, y]| [*x, *y, 0.0]).collect(),
            Self::Mesh(mesh) => mesh.vertices.clone(),
        }
    }

    /// The smallest grid of whole cells around the outline; `None` without points, or with points that are not finite.
    pub fn grid(&self) -> Option<Grid> {
        let [lower, upper] = self.bounds()?;
        let first = lower.map(f64::floor);
        let size = std::array::from_fn(|c| (upper[c] - first[c]).ceil() as usize + 1);
        let is_finite = lower.iter().chain(&upper).all(|x| x.is_finite());
        is_finite.then_some(Grid { first, spacing: [1.0; 3], size })
    }

    /// The centroid of the enclosed part; of an outline that encloses nothing, a point of it. In the plane, the third coordinate is 0.
    ///
    /// ```text
    /// c = o + Σ V_i (vertices of simplex i − o)/((d + 1) Σ V_i),   V_i: signed volume of the simplex of a face and the point o
    /// ```
    pub fn centroid(&self) -> [f64; 3] {
        let (mut total, mut moment) = (0.0, [0.0; 3]);
        let mut add = |volume: f64, sum: [f64; 3]| {
            total += volume;
            (0..3).for_each(|c| moment[c] += volume * sum[c]);
        };
        let (origin, share) = match self {
            Self::Polygon(points) => {
                let origin = points.first().map_or([0.0; 3], |[x, y]| [*x, *y, 0.0]);
                let from = |[x, y]: [f64; 2]| [x - origin[0], y - origin[1], 0.0];
                for (a, b) in points.iter().zip(points.iter().cycle().skip(1)) {
                    let [a, b] = [from(*a), from(*b)];
                    add(0.5 * (a[0] * b[1] - a[1] * b[0]), plus(a, b));
                }
                (origin, 1.0 / 3.0)
            }
            Self::Mesh(mesh) => {
                let origin = mesh.vertices.first().copied().unwrap_or_default();
                for face in &mesh.faces {
                    let [a, b, c] = face.map(|vertex| minus(mesh.vertices[vertex as usize], origin));
                    add(dot(a, cross(b, c)) / 6.0, plus(plus(a, b), c));
                }
                (origin, 0.25)
            }
        };
        let scale = share / total;
        if scale.is_finite() { std::array::from_fn(|c| origin[c] + scale * moment[c]) } else { origin }
    }

    /// Lower and upper corner; `None` without points. In the plane, the third coordinate is 0.
    pub fn bounds(&self) -> Option<[[f64; 3]; 2]> {
        match self {
            Self::Polygon(points) => {
                shapelex_geometry::vector::bounds(points.iter().map(|[x, y]| [*x, *y, 0.0]))
            }
            Self::Mesh(mesh) => shapelex_geometry::vector::bounds(mesh.vertices.iter().copied()),
        }
    }
}

/// A model of finer shapes, and the map from the free points of the coarser one to its own.
pub type Refined<const D: usize> = (Box<dyn Model<D>>, SparseRows);

/// A kind of shape with a number of free points.
pub trait Model<const D: usize>: Send + Sync {
    /// Number of free points.
    fn rows(&self) -> usize;

    /// The boundary, sampled finely enough for a field with a blur of `sigma` cells and shapes of about the size of `rows`.
    fn boundary(&self, rows: &[[f64; D]], sigma: f64, frame: Frame<D>) -> Box<dyn Boundary<D>>;

    /// The boundary by which areas and volumes of curves, spheres and tori are exact but for rounding; meshes and cylinders with their
    /// caps have those of their faces.
    fn exact(&self, rows: &[[f64; D]], frame: Frame<D>) -> Box<dyn Boundary<D>> {
        self.boundary(rows, 1.0, frame)
    }

    /// The model of the same shapes with a finer control mesh, and the map from the free points of this model to those of it; `None`
    /// where there is none.
    ///
    /// # Errors
    /// A control mesh without rules.
    fn refined(&self) -> Result<Option<Refined<D>>, GeometryError> {
        Ok(None)
    }

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
