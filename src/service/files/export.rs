//! Shapes of a cohort as records of a file.

use std::collections::BTreeMap;

use rayon::prelude::*;
use tokio::sync::mpsc;

use crate::domain::cohort::Cohort;
use crate::domain::filter::ShapeFilter;
use crate::domain::shape::Shape;
use crate::formats::files::{FileError, Format, Geometry, Mesh, Place, Points, Record, Value, WriteOptions};
use crate::geometry::capability::domain::Domain;
use crate::geometry::capability::sample::Parameters;
use crate::geometry::mesh::TriangleMesh;
use crate::geometry::representation::{Representation, ShapeSpace};
use crate::numeric::dense::Matrix;
use crate::service::app::outgoing::BodyWriter;
use crate::service::app::{App, ServiceError, Work};
use crate::service::cohorts::catalogue::{self, ShapeListing};
use crate::service::cost::requests::{self, Counts};

/// Number of points on an exported curve, unless another one is asked for.
pub const USUAL_POINTS: usize = 128;
/// Number of shapes read at once.
const PAGE: usize = 1000;

/// What is written of each shape.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum ExportContent {
    /// Points on a curve, landmarks, the mesh of a surface.
    #[default]
    Points,
    /// Control points: as landmarks, of a subdivision surface as its control mesh.
    ControlPoints,
}

/// What is exported, and how.
#[derive(Debug)]
pub struct Export {
    /// Filter that the shapes pass.
    pub filter: ShapeFilter,
    /// Format of the file.
    pub format: &'static Format,
    /// Options of its writer.
    pub options: WriteOptions,
    /// What is written of each shape.
    pub content: ExportContent,
    /// Number of points on a curve.
    pub points: usize,
}

/// Writes all shapes of a cohort that pass a filter, in the order in which they were added, at the revision of `cohort`: what is added
/// or deleted while the file is written does not matter. Memory does not depend on their number.
///
/// # Errors
/// An attribute that no shape has; shapes that the format cannot hold; a reader that has gone.
pub async fn export(
    app: &App,
    cohort: Cohort,
    export: Export,
    output: BodyWriter,
) -> Result<(), ServiceError> {
    let Export { filter, format, mut options, content, points } = export;
    options.unit = options.unit.or_else(|| cohort.spec.length_unit.clone());
    let representation = serde_json::to_string(&cohort.spec.representation).unwrap_or_default();
    let facts = [
        ("cohort", cohort.id.clone()),
        ("revision", cohort.revision.to_string()),
        ("representation", representation),
    ];
    options.facts.extend(facts.map(|(name, value)| (name.to_owned(), value)));
    let (sender, mut batches) = mpsc::channel::<Vec<Record>>(1);
    let writing = app.pool.read_blocking(move || {
        let mut writer = format.writer(output, &options)?;
        while let Some(records) = batches.blocking_recv() {
            records.iter().try_for_each(|record| writer.push(record))?;
        }
        writer.finish()?;
        Ok(())
    });
    let revision = Some(cohort.revision);
    let mut listing = ShapeListing {
        revision,
        filter,
        order: None,
        cursor: None,
        limit: PAGE,
        geometry: true,
        total: false,
    };
    let space = app.space_of(&cohort.spec.representation)?;
    let reading = async {
        loop {
            let (_, found) = catalogue::list_shapes(app, &cohort.id, &listing).await?;
            let (shapes, next) = found.page;
            let counts = Counts::for_stored(space.representation(), shapes.len(), &app.limits);
            let work = Work::MOMENT + requests::draw(counts, shapes.len());
            let space = space.clone();
            let make = move || {
                let records: Result<_, FileError> =
                    shapes.into_par_iter().map(|shape| record(&space, shape, content, points)).collect();
                Ok(records?)
            };
            let records = app.pool.weighing(work).run(make).await?;
            if sender.send(records).await.is_err() || next.is_none() {
                // A writer that has failed says why.
                drop(sender);
                return Ok(());
            }
            listing.cursor = next;
        }
    };
    let ((), ()) = tokio::try_join!(writing, reading)?;
    Ok(())
}

/// A stored shape as a record.
fn record(
    space: &ShapeSpace,
    shape: Shape,
    content: ExportContent,
    points: usize,
) -> Result<Record, FileError> {
    let Shape { id, attributes, control_points, .. } = shape;
    let representation = space.representation();
    let matrix =
        Matrix::from_column_slice(representation.size(), representation.dimension(), &control_points);
    let place = Place { tag: Some(id.clone()), ..Place::default() };
    let geometry = match content {
        ExportContent::ControlPoints => control(representation, &matrix),
        ExportContent::Points => on_shape(space, &matrix, points),
    };
    let geometry = geometry.ok_or_else(|| {
        let detail = format!("expected a shape with points, got a {}", representation.kind_name());
        FileError::unsupported(place.clone(), detail)
    })?;
    let value = |value: serde_json::Value| match value {
        serde_json::Value::Bool(value) => Some(Value::Bool(value)),
        serde_json::Value::Number(value) => value.as_f64().map(Value::Number),
        serde_json::Value::String(value) => Some(Value::Text(value)),
        _ => None,
    };
    let labels = attributes.labels.into_iter().filter_map(|(name, found)| Some((name, value(found)?)));
    let metadata = attributes.metadata.as_deref().map(serde_json::from_str::<serde_json::Value>);
    let metadata = match metadata.and_then(Result::ok) {
        Some(serde_json::Value::Object(fields)) => fields,
        Some(other) => std::iter::once(("metadata".to_owned(), other)).collect(),
        None => serde_json::Map::new(),
    };
    Ok(Record {
        name: Some(attributes.external_id.unwrap_or(id)),
        subject: attributes.subject,
        label: attributes.label,
        labels: labels.collect::<BTreeMap<_, _>>(),
        weight: (attributes.weight != 1.0).then_some(attributes.weight),
        metadata,
        ..Record::new(geometry, place)
    })
}

/// Control points, with the faces of a control mesh.
fn control(representation: &Representation, control_points: &Matrix) -> Option<Geometry> {
    let points = rows(control_points);
    match representation.control_faces() {
        None => Some(Geometry::Landmarks(points)),
        Some(faces) => Some(mesh(points, &faces)),
    }
}

/// Points on a curve, landmarks, or the mesh of a surface.
fn on_shape(space: &ShapeSpace, control_points: &Matrix, count: usize) -> Option<Geometry> {
    match space.domain() {
        Domain::Points => Some(Geometry::Landmarks(rows(control_points))),
        Domain::Line { closed } => {
            let found = space.evaluate(control_points, &Parameters::Equidistant(count), 0, false)?;
            let (_, values) = found.derivatives.into_iter().next()?;
            let points = rows(&Matrix::from_column_slice(count, found.dimension, &values));
            Some(Geometry::Curve { points, closed })
        }
        Domain::Sheet { extent, .. } => {
            space.tessellate(control_points, Some(extent.usual_grid())).map(triangles)
        }
        Domain::Vertices => space.tessellate(control_points, None).map(triangles),
    }
}

fn triangles(found: TriangleMesh) -> Geometry {
    let points = Points::from_rows(3, found.vertices.as_flattened().to_vec());
    mesh(points, &found.faces)
}

fn mesh(vertices: Points, faces: &[[u32; 3]]) -> Geometry {
    let mut mesh = Mesh { vertices, ..Mesh::default() };
    faces.iter().for_each(|face| mesh.faces.push(*face));
    mesh.into()
}

fn rows(points: &Matrix) -> Points {
    let coordinates = points.row_iter().flat_map(|row| row.iter().copied().collect::<Vec<_>>()).collect();
    Points::from_rows(points.ncols().max(1), coordinates)
}
