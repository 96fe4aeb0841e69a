//! Points with normals as posted.

use super::each::each_of;
use super::outcome::Outcomes;
use super::read;
use super::read_points::take_points;
use crate::geometry::representation::Representation;
use crate::geometry::subdivision::normal_based::Oriented;
use crate::geometry::subdivision::oriented::OrientedMeshes;
use crate::service::app::ServiceError;
use crate::service::app::progress::JobContext;
use crate::wire::fault::Fault;
use crate::wire::shape::ShapeInput;

/// Reader of shapes with points and normals on one control mesh.
pub(crate) struct OrientedReader<'a> {
    /// The shapes of the control mesh.
    pub(crate) meshes: OrientedMeshes<'a>,
}

impl<'a> OrientedReader<'a> {
    /// Succeeds for shapes of points and normals; `None` for all others.
    ///
    /// # Errors
    /// Faults of the control mesh.
    pub(crate) fn new(representation: &'a Representation) -> Result<Option<Self>, ServiceError> {
        let meshes = representation
            .oriented()
            .map_err(|error| ServiceError::invalid("/representation/connectivity", error.to_string()))?;
        Ok(meshes.map(|meshes| Self { meshes }))
    }

    /// All shapes of a request; at least one is required.
    ///
    /// # Errors
    /// No shapes; [`ServiceError::Cancelled`].
    pub(crate) fn read_each(
        &self,
        context: &JobContext,
        shapes: Vec<ShapeInput>,
    ) -> Result<Outcomes<Oriented>, ServiceError> {
        if shapes.is_empty() {
            return Err(ServiceError::TooFewShapes { found: 0, needed: 1 });
        }
        each_of(context, "shapes", shapes, |_, shape| self.read(shape))
    }

    /// Points (which are control points, because the scheme interpolates) and normals, with defaults.
    ///
    /// # Errors
    /// All faults of the shape, with pointers relative to it.
    pub(crate) fn read(&self, mut shape: ShapeInput) -> Result<Oriented, Vec<Fault>> {
        if shape.points.is_some() && shape.control_points.is_some() {
            return Err(vec![Fault::new("", "expected either points or control_points, got both")]);
        }
        if shape.poles.is_some() {
            return Err(vec![Fault::new(
                "/poles",
                "expected no poles: they belong to the points of a sphere",
            )]);
        }
        let pointer = if shape.control_points.is_some() { "/control_points" } else { "/points" };
        let points = shape.points.take().or_else(|| shape.control_points.take());
        let normals = shape.normals.take();
        read::attributes(shape)?;
        let mut errors = Vec::new();
        let points = take_points::<3>(&points, pointer, &mut errors);
        let normals = take_points::<3>(&normals, "/normals", &mut errors);
        let (Some(points), true) = (points, errors.is_empty()) else {
            if errors.is_empty() {
                errors.push(Fault::new("", "expected either points or control_points, got neither"));
            }
            return Err(errors);
        };
        let count = self.meshes.count();
        if points.len() != count {
            let detail =
                format!("expected {count} control points for this representation, got {}", points.len());
            return Err(vec![Fault::new(pointer, detail)]);
        }
        let oriented = Oriented::from_given(points, normals, |points| self.meshes.usual_normals(points));
        oriented.map(|(shape, _)| shape).map_err(|fault| vec![fault.into()])
    }
}
