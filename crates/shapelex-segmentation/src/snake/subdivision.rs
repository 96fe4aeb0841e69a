//! Subdivision surfaces of a linear scheme.
//!
//! The vertices of the mesh at the level are `V = S p` for the control points `p`. A shape with a coarse control mesh is a
//! shape with the next finer one as well.

use shapelex_geometry::GeometryError;
use shapelex_geometry::mesh::TriangleMesh;
use shapelex_geometry::subdivision::Subdivision;
use shapelex_geometry::subdivision::basis::steps;
use shapelex_numeric::sparse::SparseRows;

use super::{Model, Outline, Refined, equal};
use crate::boundary::Boundary;
use crate::boundary::mesh::MeshBoundary;
use crate::frame::Frame;

/// Subdivision surfaces of one control mesh and level; the free points are the control points.
#[derive(Debug, Clone)]
pub struct SubdivisionSnake {
    subdivision: Subdivision,
    operator: SparseRows,
    faces: Vec<[u32; 3]>,
}

impl SubdivisionSnake {
    /// The surfaces of a control mesh.
    ///
    /// # Errors
    /// Faces that are not a closed mesh; vertices without a rule; [`GeometryError::NotLinear`].
    pub fn new(subdivision: Subdivision) -> Result<Self, GeometryError> {
        let control = subdivision.connectivity.connectivity()?;
        let (steps, levels, _) = steps(subdivision.scheme, &control, subdivision.level)?;
        let mut operator = SparseRows::new(control.vertices(), control.vertices(), control.vertices());
        (0..control.vertices()).for_each(|row| operator.push(&[(row as u32, 1.0)]));
        for step in &steps {
            operator = step.multiply(&operator);
        }
        let faces = levels.last().map_or_else(Vec::new, |finest| finest.faces().to_vec());
        Ok(Self { subdivision, operator, faces })
    }

    /// The control mesh, the scheme and the level.
    pub fn subdivision(&self) -> &Subdivision {
        &self.subdivision
    }

    /// The model with the control mesh after one step and one level less, and the map from the control points of this model to
    /// those of the finer one: see [`Subdivision::finer`]. `None` at level 0.
    ///
    /// # Errors
    /// As for [`Self::new`].
    pub fn refined(&self) -> Result<Option<(Self, SparseRows)>, GeometryError> {
        let Some((finer, step)) = self.subdivision.finer()? else { return Ok(None) };
        Ok(Some((Self::new(finer)?, step)))
    }
}

impl Model<3> for SubdivisionSnake {
    fn rows(&self) -> usize {
        self.operator.columns()
    }

    fn boundary(&self, rows: &[[f64; 3]], _sigma: f64, frame: Frame<3>) -> Box<dyn Boundary<3>> {
        Box::new(MeshBoundary::new(self.operator.clone(), self.faces.clone(), rows, frame))
    }

    fn outline(&self, rows: &[[f64; 3]]) -> Outline {
        let vertices = self.operator.apply(rows);
        Outline::Mesh(TriangleMesh { vertices, normals: None, faces: self.faces.clone() })
    }

    fn centre(&self) -> Vec<f64> {
        equal(self.rows())
    }

    fn refined(&self) -> Result<Option<Refined<3>>, GeometryError> {
        let refined = Self::refined(self)?;
        Ok(refined.map(|(finer, step)| (Box::new(finer) as Box<dyn Model<3>>, step)))
    }

    fn lift(&self) -> Option<SparseRows> {
        None
    }
}
