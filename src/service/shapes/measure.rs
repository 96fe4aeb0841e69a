//! Measures of posted shapes, and their distances to a reference.
//!
//! The function is synchronous and runs on the pool.

use super::blocks::Layers;
use super::mesh;
use super::outcome::{OnError, Outcomes};
use super::request::Posted;
use crate::analysis::correspondence::Correspondence;
use crate::geometry::GeometryError;
use crate::geometry::capability::domain::Domain;
use crate::geometry::capability::measure::{Measures, Measuring};
use crate::geometry::capability::tessellate::Detail;
use crate::geometry::mesh::TriangleMesh;
use crate::geometry::representation::Representation;
use crate::geometry::surface::field::VectorField;
use crate::numeric::dense::Matrix;
use crate::service::app::{App, ServiceError};
use crate::wire::shape::ShapeInput;

/// Measurement of shapes.
#[derive(Debug)]
pub struct MeasureTask {
    /// Representation of the shapes, with the grids of their blocks.
    pub layers: Layers,
    /// Conversion of posted points to control points.
    pub correspondence: Correspondence,
    /// Shape to which distances are measured.
    pub reference: Option<ShapeInput>,
    /// Field whose flux through surfaces is measured.
    pub field: Option<VectorField>,
    /// Treatment of invalid shapes.
    pub on_error: OnError,
}

/// Maximum number of pairs of intervals over which distances are measured in one request: a minute of work.
const MAX_PAIRS: usize = 10_000_000;

/// Maximum number of cells between knots measured in one request: a minute of work.
const MAX_CELLS: usize = 2_000_000;

impl MeasureTask {
    /// Measures of the shapes.
    ///
    /// # Errors
    /// Faults of the shapes, and of the reference at `/reference…`; a reference for shapes without `L₂` distance; too much
    /// work. Under [`OnError::Skip`] faults of the shapes are among the outcomes.
    pub fn measure(self, app: &App, shapes: Vec<ShapeInput>) -> Result<Outcomes<Measures>, ServiceError> {
        let representation = self.layers.coarse();
        if !representation.is_linear() {
            return self.measure_oriented(app, shapes);
        }
        if representation.domain().is_mesh() {
            mesh::check_vertices(app, representation, shapes.len())?;
        }
        let posted = Posted::of_layers(app, &self.layers, self.correspondence)?;
        let (shapes, reference) = posted.read_with_reference(app, shapes, self.reference, self.on_error)?;
        check_work(self.layers.finest(), shapes.len(), reference.is_some())?;
        let measuring = Measuring::new(&posted.space, reference, self.field, shapes.len());
        let context = app.pool.context();
        let stop = || context.is_cancelled();
        shapes.each(&context, |_, shape: Matrix| {
            measuring.measure(&shape, &stop).ok_or(ServiceError::Cancelled)
        })
    }

    /// Measures of the meshes of shapes with points and normals.
    fn measure_oriented(
        self,
        app: &App,
        shapes: Vec<ShapeInput>,
    ) -> Result<Outcomes<Measures>, ServiceError> {
        let representation = self.layers.coarse();
        if self.reference.is_some() {
            let detail = format!(
                "expected no reference, because these shapes have no distance: {}",
                GeometryError::NotLinear
            );
            return Err(ServiceError::invalid("/reference", detail));
        }
        let meshes = mesh::refined_each(app, representation, self.correspondence, shapes, Detail::Whole)?;
        let context = app.pool.context();
        let (splits, stop) = (representation.splits(), || context.is_cancelled());
        meshes.checked(self.on_error)?.each(&context, |_, mesh: TriangleMesh| {
            Ok(Measures::from_mesh(&mesh, splits, self.field.as_ref(), &stop))
        })
    }
}

fn check_work(
    representation: &Representation,
    shapes: usize,
    has_reference: bool,
) -> Result<(), ServiceError> {
    let cells = representation.cells();
    match representation.domain() {
        Domain::Line { .. } if has_reference => {
            let pairs = shapes.saturating_mul(cells * cells);
            if pairs > MAX_PAIRS {
                let detail =
                    format!("expected at most {MAX_PAIRS} pairs of intervals in one request, got {pairs}");
                return Err(ServiceError::invalid("/reference", detail));
            }
        }
        Domain::Sheet { .. } => {
            let total = cells.saturating_mul(shapes);
            if total > MAX_CELLS {
                let detail =
                    format!("expected at most {MAX_CELLS} cells between knots in one request, got {total}");
                return Err(ServiceError::invalid("/shapes", detail));
            }
        }
        Domain::Line { .. } | Domain::Points | Domain::Vertices => {}
    }
    Ok(())
}
