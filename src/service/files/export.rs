//! Shapes of a cohort as records of a file.

use std::collections::BTreeMap;
use std::pin::pin;
use std::sync::Arc;

use futures_util::stream::BoxStream;
use futures_util::{StreamExt, TryStreamExt, stream};
use serde_json::json;
use tokio::sync::mpsc;

use crate::domain::cohort::Cohort;
use crate::domain::filter::ShapeFilter;
use crate::domain::shape::Shape;
use crate::geometry::capability::domain::Domain;
use crate::geometry::capability::fourier::{FourierExpansion, FourierSeries};
use crate::geometry::capability::sample::Parameters;
use crate::geometry::mesh::TriangleMesh;
use crate::geometry::representation::{Representation, ShapeSpace};
use crate::numeric::dense::Matrix;
use crate::service::app::memory::Memory;
use crate::service::app::outgoing::BodyWriter;
use crate::service::app::parallel;
use crate::service::app::{App, ServiceError, Work};
use crate::service::cohorts::catalogue::{self, ShapeListing};
use crate::service::cost::requests::{self, Counts};
use crate::store::{Ids, Revisions};
use crate::wire::files::{
    FileError, Format, Fourier, Geometry, Kind, MAX_HARMONICS, Mesh, Place, Points, Record, Summary, Value,
    WriteOptions,
};

use super::writing::write;

/// Number of points on an exported curve, unless another one is asked for.
pub const USUAL_POINTS: usize = 128;
/// Number of shapes read at once.
const PAGE: usize = 1000;
/// Number of points on curves that are held at once.
const POINTS_AT_ONCE: usize = 1 << 20;
/// Share of the harmonic power of a curve that may be left without a word: rounding.
const ROUNDING: f64 = 1e-24;

/// Content that is written for each shape.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum ExportContent {
    /// Points on a curve, landmarks, the mesh of a surface.
    Points,
    /// Control points: as landmarks, of a subdivision surface as its control mesh.
    ControlPoints,
    /// Fourier coefficients of closed curves, exact for their own parameter.
    Fourier,
}

impl ExportContent {
    /// Default content of each shape in a file of a format: points, where it holds any.
    pub fn usual(format: &Format) -> Self {
        if format.kinds == [Kind::Fourier] { Self::Fourier } else { Self::Points }
    }
}

/// A file of shapes: its format, and its content for each shape.
#[derive(Debug)]
pub struct ShapeFile {
    /// Format.
    pub format: &'static Format,
    /// Options of its writer.
    pub options: WriteOptions,
    /// Written content of each shape.
    pub content: ExportContent,
    /// Number of points on a curve.
    pub points: usize,
}

impl ShapeFile {
    /// Number of shapes that become records at once.
    fn at_once(&self) -> usize {
        match self.content {
            ExportContent::Points => (POINTS_AT_ONCE / self.points.max(1)).clamp(1, PAGE),
            ExportContent::ControlPoints | ExportContent::Fourier => PAGE,
        }
    }
}

/// Writes all shapes of a cohort that pass a filter, in the order in which they were added, at the revision of `cohort`: shapes that are added
/// or deleted while the file is written do not matter. Memory does not depend on their number, but in formats that hold them until
/// the last one. Returns the content that the file lacks.
///
/// # Errors
/// An attribute that no shape has; content that the shapes do not have; shapes that the format cannot hold; a reader that has gone.
pub async fn export(
    app: &App,
    cohort: &Cohort,
    filter: ShapeFilter,
    file: ShapeFile,
    output: BodyWriter,
) -> Result<Summary, ServiceError> {
    let numbers_only = file.format.holds_numbers_only();
    let listing = ShapeListing {
        revision: Some(cohort.revision),
        filter,
        order: None,
        cursor: None,
        limit: if numbers_only { 1 } else { PAGE },
        geometry: !numbers_only,
        total: false,
    };
    let (_, found) = catalogue::list_shapes(app, &cohort.id, &listing).await?;
    let count = app.store.count(&cohort.id, Revisions::until(cohort.revision), &listing.filter).await?;
    if numbers_only {
        return write_pages(app, cohort, file, count, numbers_of(app, cohort, &listing.filter), output).await;
    }
    let (first, next) = found.page;
    let rest = stream::try_unfold((listing, next), |(mut listing, next)| async move {
        if next.is_none() {
            return Ok(None);
        }
        listing.cursor = next;
        let (_, found) = catalogue::list_shapes(app, &cohort.id, &listing).await?;
        let (shapes, next) = found.page;
        Ok(Some((shapes, (listing, next))))
    });
    write_pages(app, cohort, file, count, stream::iter([Ok(first)]).chain(rest).boxed(), output).await
}

/// The shapes that pass a filter as chunks hold them, without their descriptions.
fn numbers_of<'a>(
    app: &'a App,
    cohort: &'a Cohort,
    filter: &'a ShapeFilter,
) -> BoxStream<'a, Result<Vec<Shape>, ServiceError>> {
    let revisions = Revisions::until(cohort.revision);
    let batches = stream::try_unfold(None, move |after| async move {
        let read = app.store.scan(&cohort.id, revisions, filter, after, Ids::Skip).await?;
        Ok(read.map(|batch| {
            let length = batch.control_points.len() / batch.weights.len().max(1);
            let rows = batch.control_points.chunks_exact(length.max(1)).zip(&batch.weights);
            let shapes = rows.map(|(numbers, weight)| Shape::of_numbers(numbers.to_vec(), *weight)).collect();
            (shapes, Some(batch.position))
        }))
    });
    batches.boxed()
}

/// Writes shapes of a page of a list, at the revision of `cohort`. Returns the content that the file lacks.
///
/// # Errors
/// Content that the shapes do not have; shapes that the format cannot hold; a reader that has gone.
pub async fn export_page(
    app: &App,
    cohort: &Cohort,
    shapes: Vec<Shape>,
    file: ShapeFile,
    output: BodyWriter,
) -> Result<Summary, ServiceError> {
    let count = shapes.len() as u64;
    write_pages(app, cohort, file, count, stream::iter([Ok(shapes)]).boxed(), output).await
}

/// Writes `count` shapes that come in pages.
async fn write_pages(
    app: &App,
    cohort: &Cohort,
    file: ShapeFile,
    count: u64,
    pages: BoxStream<'_, Result<Vec<Shape>, ServiceError>>,
    output: BodyWriter,
) -> Result<Summary, ServiceError> {
    let space = app.space_of(&cohort.spec.representation)?;
    let content = Arc::new(Content::new(&space, &file)?);
    let at_once = file.at_once();
    let ShapeFile { format, mut options, .. } = file;
    options.unit = options.unit.or_else(|| cohort.spec.shown_unit().map(str::to_owned));
    options.facts.extend(facts(cohort));
    options.shapes = Some(count);
    let memory = app.memory.clone();
    // A batch is read while one is made into records and one is written.
    let (sender, records) = mpsc::channel(1);
    let (read, mut to_make) = mpsc::channel::<Vec<Shape>>(1);
    let writing = app.pool.read_blocking(move || write_batches(&memory, format, output, &options, records));
    let reading = async {
        let batches = pages.map_ok(|page| stream::iter(batches_of(page, at_once).map(Ok::<_, ServiceError>)));
        let mut batches = pin!(batches.try_flatten());
        while let Some(shapes) = batches.try_next().await? {
            if read.send(shapes).await.is_err() {
                break;
            }
        }
        drop(read);
        Ok(())
    };
    let making = async {
        while let Some(shapes) = to_make.recv().await {
            let counts = Counts::for_stored(space.representation(), shapes.len(), &app.limits);
            let work = Work::MOMENT + requests::draw(counts, shapes.len());
            let (space, content) = (space.clone(), content.clone());
            let make = move || {
                let records = parallel::map(shapes, |_, shape| record(&space, shape, &content));
                let records: Result<_, FileError> = records.into_iter().collect();
                Ok(records?)
            };
            let records = app.pool.weighing(work).run(make).await?;
            if sender.send(records).await.is_err() {
                // The writer has failed, and says why.
                break;
            }
        }
        drop((sender, to_make));
        Ok(())
    };
    let (summary, (), ()) = tokio::try_join!(writing, making, reading)?;
    Ok(summary)
}

/// The shapes of a page, `most` at a time.
fn batches_of(mut page: Vec<Shape>, most: usize) -> impl Iterator<Item = Vec<Shape>> {
    std::iter::from_fn(move || {
        let rest = page.split_off(most.min(page.len()));
        let batch = std::mem::replace(&mut page, rest);
        (!batch.is_empty()).then_some(batch)
    })
}

/// Facts in a file about its cohort.
fn facts(cohort: &Cohort) -> [(String, String); 3] {
    let representation = serde_json::to_string(&cohort.spec.representation).unwrap_or_default();
    [
        ("cohort", cohort.id.clone()),
        ("revision", cohort.revision.to_string()),
        ("representation", representation),
    ]
    .map(|(name, value)| (name.to_owned(), value))
}

/// Writes the batches as a file.
fn write_batches(
    memory: &Memory,
    format: &'static Format,
    output: BodyWriter,
    options: &WriteOptions,
    mut batches: mpsc::Receiver<Vec<Written>>,
) -> Result<Summary, ServiceError> {
    let mut cut = Cut::default();
    let ((), mut summary) = write(memory, format, output, options, |push| {
        while let Some(written) = batches.blocking_recv() {
            for Written { record, residual_power } in &written {
                cut.add(*residual_power);
                push(record)?;
            }
        }
        Ok(())
    })?;
    summary.warnings.extend(cut.warning());
    Ok(summary)
}

/// The conversion of each shape, prepared.
enum Content {
    Points(usize),
    ControlPoints,
    Fourier(FourierSeries),
}

impl Content {
    fn new(space: &ShapeSpace, file: &ShapeFile) -> Result<Self, ServiceError> {
        Ok(match file.content {
            ExportContent::Points => Self::Points(file.points),
            ExportContent::ControlPoints => Self::ControlPoints,
            ExportContent::Fourier => {
                let representation = space.representation();
                // As many as the control points tell apart.
                let usual = (representation.size().saturating_sub(1) / 2).clamp(1, MAX_HARMONICS);
                let harmonics = file.options.harmonics.unwrap_or(usual);
                let refused = || {
                    let kind = representation.kind_name();
                    let detail = format!("expected a cohort of closed curves, got one of the kind '{kind}'");
                    ServiceError::parameter("content", detail)
                };
                Self::Fourier(FourierSeries::new(space, harmonics).ok_or_else(refused)?)
            }
        })
    }

    /// The geometry of a shape, and the share of its harmonic power that it leaves.
    fn of(&self, space: &ShapeSpace, control_points: &Matrix) -> Option<(Geometry, f64)> {
        match self {
            Self::Points(count) => Some((on_shape(space, control_points, *count)?, 0.0)),
            Self::ControlPoints => Some((control(space.representation(), control_points)?, 0.0)),
            Self::Fourier(series) => {
                let FourierExpansion { constant, cosine, sine, residual_power } = series.of(control_points);
                Some((Fourier { constant, cosine, sine }.into(), residual_power))
            }
        }
    }
}

/// A record, and the share of harmonic power that it leaves.
struct Written {
    record: Record,
    residual_power: f64,
}

/// Residuals of harmonics for the shapes so far.
#[derive(Default)]
struct Cut {
    shapes: u64,
    most: f64,
}

impl Cut {
    fn add(&mut self, residual_power: f64) {
        self.shapes += u64::from(residual_power > ROUNDING);
        self.most = self.most.max(residual_power);
    }

    fn warning(&self) -> Option<String> {
        let Self { shapes, most } = self;
        (*shapes > 0).then(|| {
            format!("{shapes} shapes have further harmonics; these have at most {most:.3e} of the harmonic power of one")
        })
    }
}

/// A stored shape as a record.
fn record(space: &ShapeSpace, shape: Shape, content: &Content) -> Result<Written, FileError> {
    let Shape { id, attributes, control_points, .. } = shape;
    let representation = space.representation();
    let matrix =
        Matrix::from_column_slice(representation.size(), representation.dimension(), &control_points);
    let place = Place { tag: (!id.is_empty()).then(|| id.clone()), ..Place::default() };
    let (geometry, residual_power) = content.of(space, &matrix).ok_or_else(|| {
        let detail = format!("expected a shape with points, got a {}", representation.kind_name());
        FileError::unsupported(place.clone(), detail)
    })?;
    let value = |value: serde_json::Value| match value {
        serde_json::Value::Bool(value) => Some(Value::Bool(value)),
        serde_json::Value::Number(value) => Value::number(&value),
        serde_json::Value::String(value) => Some(Value::Text(value)),
        _ => None,
    };
    let labels = attributes.labels.into_iter().filter_map(|(name, found)| Some((name, value(found)?)));
    let metadata = attributes.metadata.as_deref().map(serde_json::from_str::<serde_json::Value>);
    let mut metadata = match metadata.and_then(Result::ok) {
        Some(serde_json::Value::Object(fields)) => fields,
        Some(other) => std::iter::once(("metadata".to_owned(), other)).collect(),
        None => serde_json::Map::new(),
    };
    if let Geometry::Fourier(fourier) = &geometry {
        let harmonics = json!({"harmonics": fourier.harmonics(), "residual_power": residual_power});
        metadata.insert("fourier".to_owned(), harmonics);
    }
    let record = Record {
        name: Some(attributes.external_id.unwrap_or(id)).filter(|name| !name.is_empty()),
        subject: attributes.subject,
        label: attributes.label,
        labels: labels.collect::<BTreeMap<_, _>>(),
        weight: (attributes.weight != 1.0).then_some(attributes.weight),
        metadata,
        ..Record::new(geometry, place)
    };
    Ok(Written { record, residual_power })
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
    // Rows of points are the columns of the transpose.
    Points::from_rows(points.ncols().max(1), points.transpose().as_slice().to_vec())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::files::find;

    #[test]
    fn a_batch_holds_a_million_points_whatever_is_asked_for() {
        let file = |content, points| ShapeFile {
            format: find("ndjson").unwrap(),
            options: WriteOptions::default(),
            content,
            points,
        };
        assert_eq!(file(ExportContent::Points, USUAL_POINTS).at_once(), PAGE);
        assert_eq!(file(ExportContent::Points, 10_000).at_once(), 104);
        assert_eq!(file(ExportContent::Points, usize::MAX).at_once(), 1);
        assert_eq!(file(ExportContent::ControlPoints, 10_000).at_once(), PAGE);
    }
}
