//! Shapes of a cohort: add (as one body or as a stream), list, read, delete.

use std::collections::BTreeMap;
use std::sync::Arc;

use axum::body::Bytes;
use axum::extract::Request;
use axum::http::{HeaderMap, HeaderValue, StatusCode};
use axum::response::Response;
use serde::Serialize;
use serde_json::value::RawValue;

use crate::api::body::{self, is_stream};
use crate::api::extract::{
    Caller, Format, IfMatch, NoQuery, OnlyShapeFormat, Path, Query, ShapeFormat, TWICE, unknown_parameter,
};
use crate::api::media_type::{is_json, media_type};
use crate::api::problem::Problem;
use crate::api::respond::{compute, json, mesh, picture};
use crate::api::v1::cohorts::exports;
#[cfg(feature = "schema")]
use crate::api::v1::cohorts::exports::ShapeFileQuery;
use crate::api::v1::requests::batches::{FailedShape, InputShape};
#[cfg(feature = "schema")]
use crate::api::v1::requests::described::*;
use crate::api::v1::requests::entity_tags::{Asked, not_stored};
use crate::api::v1::requests::file_parameters::{FileParameters, take_writing, word_of};
use crate::api::v1::requests::request_macros::{PageQuery, checked};
use crate::api::v1::requests::shape_query::Parameters;
use crate::domain::cohort::Cohort;
use crate::domain::shape::{Shape, ShapeMeasures};
use crate::geometry::resample::RepeatedPoints;
use crate::service::app::{App, ServiceError, Work};
use crate::service::cohorts::catalogue::{Expected, ShapeListing, revision_tag};
use crate::service::cohorts::fits::MeshResidual;
use crate::service::cohorts::upload::{Returned, Stored, Treatment, UploadResult};
use crate::service::cohorts::{catalogue, upload, upload_file};
use crate::service::files::export::ShapeFile;
use crate::service::shapes::draw::draw_shapes;
use crate::service::shapes::outcome::OnError;
use crate::wire::checked::{List, document};
use crate::wire::fault::Fault;
use crate::wire::json;
use crate::wire::shape::{Points, ShapeInput};
use crate::wire::summary::FileSummary;
use crate::wire::time::rfc3339;

document! {
    /// Shapes to add.
    #[schema(example = json!({"shapes": [
        {"external_id": "scan-17", "label": "control", "points": [[0, 0], [4, 0], [4, 1], [0, 1]]},
        {"external_id": "scan-18", "label": "treated", "points": [[0, 0], [3, 0], [4, 2], [1, 3]]}
    ]}))]
    pub(in crate::api::v1) struct AddRequest {
        /// Shapes to add.
        #[schema(value_type = Vec<ShapeInput>, required = true)]
        shapes: List<ShapeInput>, required;
    }
}

/// Former name of the header `idempotency-replayed`, which every answer has: for clients of the releases before.
const FORMERLY_REPLAYED: &str = "idempotent-replayed";

/// Result of adding shapes.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct AddAnswer {
    /// Number of new shapes; repeated ones are not counted.
    added: usize,
    /// Number of shapes that stand in the cohort already, under the same external ids and with the same points. Their attributes stay as
    /// they are, also where the request has others.
    unchanged: usize,
    /// Revision of the cohort after the request.
    revision: u64,
    /// Number of points that were dropped, in all stored shapes, because they are equal to their predecessor.
    repeated_points: usize,
    /// Number of shapes that intersect themselves; `measures.self_intersecting=true` lists them.
    self_intersecting: usize,
    /// Number of shapes that were not stored under `on_error=skip`: invalid ones, and those whose external id belongs to a shape with
    /// other points.
    skipped: usize,
    /// Entries in the order of the input: with `return=results` one for each of the first 100 000 shapes; always one for each
    /// invalid shape.
    results: Vec<AddResult>,
    /// With `return=ids`, the ids of the first 100 000 shapes, in order; null for an invalid one.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    #[schema(required = false)]
    ids: Vec<Option<String>>,
    /// Number of stored shapes beyond the first 100 000, of which the answer says nothing else.
    unlisted: usize,
    /// Warnings about the shapes as a whole: contours drawn both ways round where their direction counts, surfaces that
    /// their control points represent coarsely. Absent if there are none.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    #[schema(required = false)]
    warnings: Vec<String>,
    /// Content of a file of another program beside its shapes.
    #[serde(skip_serializing_if = "Option::is_none")]
    file: Option<FileSummary>,
}

/// Entry of an input shape: its id, or the reason why it was not stored.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[serde(untagged)]
pub(in crate::api::v1) enum AddResult {
    /// Stored.
    Stored(AddedShape),
    /// Not stored.
    Failed(FailedShape),
}

/// Shape that is stored now.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct AddedShape {
    /// Position in the request, from 0.
    index: usize,
    /// Id, also of a shape that existed before with the same points.
    id: String,
    /// Identifier assigned by the client, if the shape has one.
    #[serde(skip_serializing_if = "Option::is_none")]
    external_id: Option<String>,
    /// Residual of the fit to a mesh, of a surface that came as one.
    #[serde(skip_serializing_if = "Option::is_none")]
    fit: Option<MeshResidual>,
}

impl From<UploadResult> for AddResult {
    fn from(UploadResult { index, external_id, id, faults, fit }: UploadResult) -> Self {
        match id {
            Some(id) => Self::Stored(AddedShape { index, id, external_id, fit }),
            None => Self::Failed(failed(index, external_id, faults)),
        }
    }
}

/// Entry of a shape that is not stored.
pub(in crate::api::v1) fn failed(
    index: usize,
    external_id: Option<String>,
    faults: Vec<Fault>,
) -> FailedShape {
    let shape = InputShape { index, id: None, external_id };
    FailedShape { shape, error: ServiceError::Invalid(faults.into()).into() }
}

impl From<Stored> for AddAnswer {
    fn from(stored: Stored) -> Self {
        let Stored { added, unchanged, revision, ids, skipped, results, left_out, .. } = stored;
        let Stored { repeated_points, self_intersecting, warnings, note, .. } = stored;
        let results = results.into_iter().map(AddResult::from).collect();
        let file = note.and_then(|note| json::from_value(&note).ok());
        Self {
            added,
            unchanged,
            revision,
            repeated_points,
            self_intersecting,
            skipped,
            results,
            ids,
            unlisted: left_out,
            warnings,
            file,
        }
    }
}

/// Handling of invalid shapes and of repeated points.
#[derive(Debug, Default, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
pub(in crate::api::v1) struct AddQuery {
    /// Handling of shapes that are invalid, broken in a file, or have the external id of another shape: `abort` stores nothing, `skip`
    /// stores the others. Default: `abort`.
    #[param(inline, required = false)]
    on_error: OnError,
    /// Points that are equal to their predecessor, where contours are resampled (correspondences `arc_length` and
    /// `cyclic`): `drop` leaves them out, `refuse` makes the shape invalid. Default: `drop`.
    #[param(inline, required = false)]
    repeated_points: RepeatedPoints,
    /// Account of stored shapes in the answer: `results` has an entry for each of them, `ids` their ids in a list,
    /// `none` nothing. Invalid shapes have an entry in any case. Default: `results`.
    #[param(inline, rename = "return", required = false)]
    returned: Returned,
}

impl AddQuery {
    pub(in crate::api::v1) fn treatment(self) -> Treatment {
        let Self { on_error, repeated_points, returned } = self;
        Treatment { on_error, conflicts: on_error, repeated_points, returned }
    }

    /// Reads the parameters that do not concern files.
    pub(in crate::api::v1) fn read(pairs: &[(String, String)]) -> Result<Self, Problem> {
        let mut query = Self::default();
        for (index, (name, word)) in pairs.iter().enumerate() {
            if pairs[..index].iter().any(|(before, _)| before == name) {
                return Err(Problem::of_parameter(name, TWICE));
            }
            match name.as_str() {
                "on_error" => query.on_error = word_of(name, word)?,
                "repeated_points" => query.repeated_points = word_of(name, word)?,
                "return" => query.returned = word_of(name, word)?,
                unknown => return Err(unknown_parameter(unknown)),
            }
        }
        Ok(query)
    }
}

/// Adds shapes, all or none.
///
/// Send JSON for one body, NDJSON (`application/x-ndjson`, one shape per line) for a stream of any length, or a file of another
/// program: with the media type of its format, or with any beside the parameter `format` or `name`. Repeating an
/// `external_id` with the same points is a safe retry, which leaves the stored attributes as they are; with other points it is a
/// conflict. Once the response is 201, the shapes are on disk.
#[utoipa::path(post, path = "/v1/cohorts/{cohort}/shapes", tag = "cohorts",
    params(("cohort" = String, Path, description = "Id or name"), AddQuery, FileQuery, PlacingQuery, ReadQuery, RetryHeader, IfMatchHeader),
    request_body(content((AddRequest = "application/json"), (ShapeInput = "application/x-ndjson", example = json!("{\"external_id\": \"scan-19\", \"points\": [[0, 0], [5, 1], [1, 3]]}\n")), (Binary = "application/octet-stream", example = json!("{\"points\": [[0, 0], [5, 1], [1, 3]], \"closed\": true}\n")))),
    responses(
        (status = 201, description = "Stored; `idempotency-replayed: true` if an earlier request with the same Idempotency-Key did", body = AddAnswer),
        (status = 404, description = "No such cohort"),
        (status = 412, description = "The cohort has changed meanwhile"),
        (status = 409, description = "An external id belongs to another shape")
    ))]
pub(in crate::api::v1) async fn add_shapes(
    Caller(app): Caller,
    Path(key): Path<String>,
    Query(mut pairs): Query<Vec<(String, String)>>,
    IfMatch(expected): IfMatch,
    request: Request,
) -> Result<Response, Problem> {
    let parameters = FileParameters::take(&mut pairs);
    let treatment = AddQuery::read(&pairs)?.treatment();
    let touched = app.touched.clone();
    let stored = add(app, &key, request, parameters, treatment, expected).await?;
    let mut response = json(StatusCode::CREATED, &AddAnswer::from(stored))?;
    if touched.is_repeat() {
        response.headers_mut().insert(FORMERLY_REPLAYED, HeaderValue::from_static("true"));
    }
    Ok(response)
}

/// Adds the shapes of a body by its media type, or by the parameters of a file.
async fn add(
    app: App,
    key: &str,
    request: Request,
    parameters: FileParameters,
    treatment: Treatment,
    expected: Option<Expected>,
) -> Result<Stored, Problem> {
    let (found, cohort) = (media_type(request.headers()), catalogue::find(&app, key).await?);
    let body = request.into_body();
    let stored = match found.as_str() {
        other if parameters.is_format_stated() || !(is_stream(other) || is_json(other)) => {
            let file = parameters.into_file(other, treatment.on_error, &app.limits)?;
            upload_file::add_file(&app, cohort, body::pieces(body), file, treatment, expected).await
        }
        _ if !parameters.is_empty() => return Err(unknown_parameter(parameters.first())),
        lines if is_stream(lines) => {
            upload::add_stream(&app, cohort, body::pieces(body), treatment, expected).await
        }
        _ => {
            let body = body::read(&app, body).await?;
            let app = app.with_body(&body);
            let shapes = read_shapes(&app, body).await?;
            upload::add(&app, cohort, shapes, treatment, expected).await
        }
    };
    Ok(stored?)
}

async fn read_shapes(app: &App, body: Bytes) -> Result<Vec<ShapeInput>, ServiceError> {
    let AddRequest { shapes, faults: mut errors } = app.read(body).await?;
    let shapes = shapes.unwrap_or_default().take("/shapes", &mut errors);
    checked(Some(()), errors, shapes).map(|((), shapes)| shapes)
}

/// A stored shape.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct StoredShape {
    /// Identifier.
    id: String,
    /// Identifier assigned by the client.
    external_id: Option<String>,
    /// Opaque identifier of the subject.
    subject: Option<String>,
    /// Class label.
    label: Option<String>,
    /// Additional attributes.
    #[schema(value_type = Attributes)]
    labels: BTreeMap<String, serde_json::Value>,
    /// Weight in means.
    weight: f64,
    /// Metadata, as posted.
    #[schema(value_type = serde_json::Value, required = false)]
    metadata: Option<Box<RawValue>>,
    /// Measures of the shape, computed when it arrived.
    measures: MeasuresOutput,
    /// Control points in the representation of the cohort.
    control_points: Points,
    /// Time of creation, RFC 3339 in UTC.
    created_at: String,
}

/// Measures of a stored shape, in the unit of its points.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct MeasuresOutput {
    /// Number of points as received.
    #[serde(skip_serializing_if = "Option::is_none")]
    points: Option<u64>,
    /// Centroid size: of landmarks the root of the sum of squared distances from their mean, of curves and surfaces the
    /// root of the integral.
    #[serde(skip_serializing_if = "Option::is_none")]
    centroid_size: Option<f64>,
    /// Length of a curve.
    #[serde(skip_serializing_if = "Option::is_none")]
    length: Option<f64>,
    /// Enclosed area of a closed planar curve, unsigned; area of a surface.
    #[serde(skip_serializing_if = "Option::is_none")]
    area: Option<f64>,
    /// Volume that a surface encloses, unsigned.
    #[serde(skip_serializing_if = "Option::is_none")]
    volume: Option<f64>,
    /// Whether a planar curve intersects itself.
    #[serde(skip_serializing_if = "Option::is_none")]
    self_intersecting: Option<bool>,
    /// Whether a closed planar curve runs clockwise.
    #[serde(skip_serializing_if = "Option::is_none")]
    clockwise: Option<bool>,
    /// Of a surface that came as a mesh without parameters: mean distance of the mesh from the surface that was fitted to it.
    #[serde(skip_serializing_if = "Option::is_none")]
    fit_mean: Option<f64>,
    /// Largest such distance.
    #[serde(skip_serializing_if = "Option::is_none")]
    fit_largest: Option<f64>,
    /// Area of the surface, relative to that of the mesh, minus one.
    #[serde(skip_serializing_if = "Option::is_none")]
    fit_area: Option<f64>,
}

impl From<ShapeMeasures> for MeasuresOutput {
    fn from(measures: ShapeMeasures) -> Self {
        let ShapeMeasures { points, centroid_size, length, area, volume, .. } = measures;
        let ShapeMeasures { self_intersecting, clockwise, fit, .. } = measures;
        let (fit_mean, fit_largest, fit_area) =
            (fit.map(|fit| fit.mean), fit.map(|fit| fit.largest), fit.map(|fit| fit.area));
        Self {
            points,
            centroid_size,
            length,
            area,
            volume,
            self_intersecting,
            clockwise,
            fit_mean,
            fit_largest,
            fit_area,
        }
    }
}

/// One page of shapes of a cohort.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct PageOfShapes {
    /// Entries of the page.
    items: Vec<ListedShape>,
    /// Cursor of the next page; null on the last page.
    next: Option<String>,
    /// Number of shapes that pass the filter, under `total=true`.
    #[serde(skip_serializing_if = "Option::is_none")]
    total: Option<u64>,
}

/// Names of fields of the entries of a list.
type FieldNames = Arc<Vec<String>>;

/// A shape of a list, with the fields that were asked for.
#[derive(Debug)]
pub(in crate::api::v1) struct ListedShape {
    shape: StoredShape,
    fields: Option<FieldNames>,
}

impl Serialize for ListedShape {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let Some(fields) = &self.fields else { return self.shape.serialize(serializer) };
        let mut all = json::to_value(&self.shape).map_err(serde::ser::Error::custom)?;
        if let Some(all) = all.as_object_mut() {
            all.retain(|name, _| fields.contains(name));
        }
        all.serialize(serializer)
    }
}

#[cfg(feature = "schema")]
mod described {
    use utoipa::openapi::{RefOr, Schema};
    use utoipa::{PartialSchema, ToSchema};

    use super::{ListedShape, StoredShape};

    /// That of a stored shape, with all fields optional.
    impl PartialSchema for ListedShape {
        fn schema() -> RefOr<Schema> {
            let mut schema = StoredShape::schema();
            if let RefOr::T(Schema::Object(object)) = &mut schema {
                object.required.clear();
                object.description =
                    Some("A shape of a list: all fields, or those that `fields` names.".into());
            }
            schema
        }
    }

    impl ToSchema for ListedShape {
        fn schemas(schemas: &mut Vec<(String, RefOr<Schema>)>) {
            StoredShape::schemas(schemas);
        }
    }
}

/// Fields that need the geometry of a shape.
const GEOMETRY: [&str; 2] = ["control_points", "weight"];

/// Fields of a stored shape.
const FIELDS: [&str; 10] = [
    "id",
    "external_id",
    "subject",
    "label",
    "labels",
    "weight",
    "metadata",
    "measures",
    "control_points",
    "created_at",
];

/// Takes the names of the fields of a list.
fn take_fields(parameters: &mut Parameters) -> Result<Option<FieldNames>, Problem> {
    let Some(text) = parameters.take("fields") else { return Ok(None) };
    let fields: Vec<String> = text.split(',').map(|field| field.trim().to_owned()).collect();
    match fields.iter().find(|field| !FIELDS.contains(&field.as_str())) {
        None => Ok(Some(Arc::new(fields))),
        Some(unknown) => {
            let detail = format!("expected some of {}, got '{unknown}'", FIELDS.join(", "));
            Err(Problem::of_parameter("fields", detail))
        }
    }
}

impl StoredShape {
    pub(in crate::api::v1) fn new(cohort: &Cohort, shape: Shape) -> Self {
        let Shape { id, attributes, measures, control_points, created_at_ms } = shape;
        Self {
            id,
            external_id: attributes.external_id,
            subject: attributes.subject,
            label: attributes.label,
            labels: attributes.labels,
            weight: attributes.weight,
            metadata: attributes.metadata.and_then(|text| RawValue::from_string(text).ok()),
            measures: measures.into(),
            control_points: Points::from_columns(control_points, cohort.spec.representation.dimension()),
            created_at: rfc3339(created_at_ms),
        }
    }
}

/// Query parameters of a list of shapes, beside filter, page and file.
#[derive(utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code, reason = "only for the document; `Parameters` reads them")]
pub(in crate::api::v1) struct ListQuery {
    /// With JSON: names of the fields of the entries, separated by commas. Default: all. Without `control_points` and `weight`
    /// no geometry is read.
    fields: Option<String>,
    /// Attribute that gives the order, such as `labels.age` or `measures.area`, after a minus sign with large values first:
    /// numbers, then texts, then shapes without it. Default: the order in which shapes were added.
    order: Option<String>,
    /// With JSON: whether all shapes that pass the filter are counted. Default: false.
    total: Option<bool>,
}

/// How a list of shapes is answered.
enum Wanted {
    /// As JSON, with the fields that are named.
    Document(Option<FieldNames>),
    /// As a file of shapes.
    File(ShapeFile),
}

/// Lists shapes in the order in which they were added, or in that of an attribute.
///
/// As JSON, or as a file in any format that is written, which `POST` takes again: by `format`, else by the header `Accept`. The
/// next page of a file is in the header `Link`. All shapes in one file: `GET /v1/cohorts/{cohort}/export`; their attributes and
/// measures as a table: `GET /v1/cohorts/{cohort}/table`.
#[utoipa::path(get, path = "/v1/cohorts/{cohort}/shapes", tag = "cohorts",
    params(
        ("cohort" = String, Path, description = "Id or name"),
        FilterQuery,
        ListQuery,
        PageQuery,
        ShapeFileQuery,
        WriteQuery
    ),
    responses(
        (status = 200, description = "A page of shapes", content((PageOfShapes = "application/json"), (Binary = "application/octet-stream"))),
        (status = 304, description = "Unchanged since the version in If-None-Match"),
        (status = 404, description = "No such cohort"),
        (status = "4XX", description = "The query was refused")
    ))]
pub(in crate::api::v1) async fn list_shapes(
    Caller(app): Caller,
    Path(key): Path<String>,
    Query(pairs): Query<Vec<(String, String)>>,
    headers: HeaderMap,
    asked: Asked,
) -> Result<Response, Problem> {
    let (listing, wanted) = take_listing(pairs, &headers)?;
    let response = match wanted {
        Wanted::Document(fields) => list_document(app, &key, listing, fields, &asked).await,
        Wanted::File(file) => list_file(app, &key, listing, file, &asked).await,
    };
    response.map(not_stored)
}

/// A page of shapes as JSON.
async fn list_document(
    app: App,
    key: &str,
    listing: ShapeListing,
    fields: Option<FieldNames>,
    asked: &Asked,
) -> Result<Response, Problem> {
    let (cohort, found) = catalogue::list_shapes(&app, key, &listing).await?;
    let revision = revision_tag(&cohort);
    let answer = compute(app.weighing(Work::MOMENT), move |_| {
        let (shapes, next) = found.page;
        let listed = |shape| ListedShape { shape: StoredShape::new(&cohort, shape), fields: fields.clone() };
        let items = shapes.into_iter().map(listed).collect();
        json(StatusCode::OK, &PageOfShapes { items, next, total: found.total })
    });
    asked.unless_known(&revision, "page", answer).await
}

/// A page of shapes as a file, at the revision that it names.
async fn list_file(
    app: App,
    key: &str,
    mut listing: ShapeListing,
    file: ShapeFile,
    asked: &Asked,
) -> Result<Response, Problem> {
    let cohort = catalogue::find(&app, key).await?;
    listing.revision = Some(cohort.revision);
    let (revision, format) = (revision_tag(&cohort), file.format.id);
    let answer = async {
        let (_, found) = catalogue::list_shapes(&app, &cohort.id, &listing).await?;
        let (shapes, next) = found.page;
        Ok(asked.linked(exports::page(app, cohort, shapes, file).await?, next))
    };
    asked.unless_known(&revision, format, answer).await
}

/// Refuses parameters that files have no place for.
fn refuse_fields(parameters: &mut Parameters, file: &ShapeFile) -> Result<(), Problem> {
    match ["fields", "total"].into_iter().find(|name| parameters.take(name).is_some()) {
        None => Ok(()),
        Some(name) => {
            let detail = format!("expected JSON beside it, got the format {}", file.format.id);
            Err(Problem::of_parameter(name, detail))
        }
    }
}

/// Takes the parameters of a list of shapes, and how it is answered.
fn take_listing(
    mut pairs: Vec<(String, String)>,
    headers: &HeaderMap,
) -> Result<(ShapeListing, Wanted), Problem> {
    let writing = take_writing(&mut pairs);
    let mut parameters = Parameters::read(pairs)?;
    let page = PageQuery { cursor: parameters.take("cursor"), limit: parameters.take_count("limit")? };
    let wanted = match exports::take_listed_file(writing, &mut parameters, headers)? {
        Some(file) => Wanted::File(file),
        None => Wanted::Document(take_fields(&mut parameters)?),
    };
    let needs_geometry = |fields: &FieldNames| fields.iter().any(|field| GEOMETRY.contains(&field.as_str()));
    let (geometry, total) = match &wanted {
        Wanted::Document(fields) => {
            (fields.as_ref().is_none_or(needs_geometry), parameters.take_flag("total")?)
        }
        Wanted::File(file) => {
            refuse_fields(&mut parameters, file)?;
            (true, false)
        }
    };
    let listing = ShapeListing {
        revision: None,
        filter: parameters.take_filter(),
        order: parameters.take_order()?,
        limit: page.limit()?,
        cursor: page.cursor,
        geometry,
        total,
    };
    parameters.refuse_rest()?;
    Ok((listing, wanted))
}

/// Returns a shape by id or external id.
///
/// As SVG: a drawing. As OBJ, PLY, STL or glTF: the mesh of a surface.
#[utoipa::path(get, path = "/v1/cohorts/{cohort}/shapes/{shape}", tag = "cohorts",
    params(
        ("cohort" = String, Path, description = "Id or name"),
        ("shape" = String, Path, description = "Id or external id"),
        ShapeFormatQuery, DrawingQuery
    ),
    responses(
        (status = 200, description = "The shape", content((StoredShape = "application/json"), (String = "image/svg+xml"), (Binary = "model/obj"), (Binary = "application/ply"), (Binary = "model/stl"), (Binary = "model/gltf-binary"))),
        (status = 304, description = "Unchanged since the version in If-None-Match"),
        (status = 404, description = "No such cohort or shape")
    ))]
pub(in crate::api::v1) async fn find_shape(
    Caller(app): Caller,
    Path((key, shape)): Path<(String, String)>,
    OnlyShapeFormat(format): OnlyShapeFormat,
    asked: Asked,
) -> Result<Response, Problem> {
    let (cohort, shape) = catalogue::find_shape(&app, &key, &shape).await?;
    let revision = revision_tag(&cohort);
    let answer = compute(app.weighing(Work::MOMENT + format.work()), move |app| {
        let space = app.space_of(&cohort.spec.representation)?;
        let file = match format {
            ShapeFormat::Mesh(format, grid) => return mesh(&space, &shape.control_points, format, grid),
            ShapeFormat::Plain(Format::Json) => {
                return json(StatusCode::OK, &StoredShape::new(&cohort, shape));
            }
            ShapeFormat::Plain(Format::Picture(file)) => file,
        };
        let title = shape.attributes.external_id.as_deref().unwrap_or(&shape.id);
        let unit = cohort.spec.shown_unit();
        picture(&draw_shapes(&space, title, &[&shape.control_points], unit), &file)
    });
    asked.unless_known(&revision, format, answer).await.map(not_stored)
}

/// Deletes a shape; the revision of the cohort grows.
#[utoipa::path(delete, path = "/v1/cohorts/{cohort}/shapes/{shape}", tag = "cohorts",
    params(("cohort" = String, Path, description = "Id or name"), ("shape" = String, Path, description = "Id or external id")),
    responses(
        (status = 204, description = "Deleted"),
        (status = 404, description = "No such cohort or shape")
    ))]
pub(in crate::api::v1) async fn delete_shape(
    Caller(app): Caller,
    _: NoQuery,
    Path((key, shape)): Path<(String, String)>,
) -> Result<StatusCode, Problem> {
    catalogue::delete_shape(&app, &key, &shape).await?;
    Ok(StatusCode::NO_CONTENT)
}
