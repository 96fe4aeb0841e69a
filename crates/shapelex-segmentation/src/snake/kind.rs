//! The model of a representation.

use std::sync::Arc;

use shapelex_geometry::GeometryError;
use shapelex_geometry::capability::enclose::Enclosure;
use shapelex_geometry::field_fault::FieldFault;
use shapelex_geometry::representation::ShapeSpace;
use shapelex_geometry::surface::Topology;

use super::Model;
use super::curve::CurveSnake;
use super::cylinder::CylinderSnake;
use super::subdivision::SubdivisionSnake;
use super::surface::SurfaceSnake;

/// A model in the plane or in space.
pub enum SpaceModel {
    /// Its shapes enclose a region of the plane.
    Plane(Box<dyn Model<2>>),
    /// Its shapes enclose a region of space.
    Space(Box<dyn Model<3>>),
}

impl SpaceModel {
    /// The model of the shapes of a space. All control points are free, except those of a cylinder beyond its ends.
    ///
    /// # Errors
    /// A fault of a field of the representation if its shapes enclose nothing.
    pub fn new(space: &ShapeSpace) -> Result<Self, FieldFault> {
        Ok(match space.enclosure()? {
            Enclosure::Curve(line) => Self::Plane(Box::new(CurveSnake::on(line.clone()))),
            Enclosure::Surface(basis) if basis.extent().topology == Topology::Cylinder => {
                Self::Space(Box::new(CylinderSnake::new(Arc::clone(basis)).map_err(fault)?))
            }
            Enclosure::Surface(basis) => {
                Self::Space(Box::new(SurfaceSnake::new(Arc::clone(basis)).map_err(fault)?))
            }
            Enclosure::Mesh(subdivision) => {
                Self::Space(Box::new(SubdivisionSnake::new(subdivision.clone()).map_err(fault)?))
            }
        })
    }
}

fn fault(error: GeometryError) -> FieldFault {
    match error {
        GeometryError::Surface { field, detail } => FieldFault::new(field, detail),
        other => FieldFault::new("", other.to_string()),
    }
}
