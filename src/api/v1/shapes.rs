//! Shapes of a cohort: add (as one body or as a stream), list, read, delete.

use std::collections::BTreeMap;

use axum::body::Bytes;
use axum::extract::Request;
use axum::http::StatusCode;
use axum::response::Response;
use serde::{Deserialize, Serialize};
use serde_json::value::RawValue;

use super::request_macros::{IfMatchHeader, PageQuery, RetryHeader, checked, page, time};
use super::shape_query::{FilterQuery, Parameters};
use crate::api::body::{self, is_stream};
use crate::api::extract::{
    Caller, DrawingQuery, Format, IfMatch, NoQuery, OnlyShapeFormat, Path, Query, ShapeFormat,
    ShapeFormatQuery, is_json, media_type,
};
use crate::api::problem::{Problem, ProblemKind};
use crate::api::respond::{Binary, compute, json, mesh, svg};
use crate::domain::cohort::Cohort;
use crate::domain::shape::Shape;
use crate::formats::checked::{List, document};
use crate::formats::fault::Fault;
use crate::formats::shape::{Attributes, Points, ShapeInput};
use crate::geometry::resample::RepeatedPoints;
use crate::service::app::{App, ServiceError, Work};
use crate::service::cohorts::upload::{OnError, Stored, Treatment};
use crate::service::cohorts::{catalogue, upload};
use crate::service::shapes::draw::draw_shapes;

document! {
    /// Shapes to add.
    #[schema(example = json!({"shapes": [
        {"external_id": "scan-17", "label": "control", "points": [[0, 0], [4, 0], [4, 1], [0, 1]]},
        {"external_id": "scan-18", "label": "treated", "points": [[0, 0], [3, 0], [4, 2], [1, 3]]}
    ]}))]
    pub(super) struct AddRequest {
        /// Shapes to add.
        #[schema(value_type = Vec<ShapeInput>, required = true)]
        shapes: List<ShapeInput>, required;
    }
}

/// Result of adding shapes.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct AddAnswer {
    /// Number of new shapes; repeated ones with the same content are not counted.
    added: usize,
    /// Revision of the cohort after the request.
    revision: u64,
    /// Ids in the order of the input, at most 100 000.
    ids: Vec<String>,
    /// Number of points that were dropped, in all stored shapes, because they are equal to their predecessor.
    repeated_points: usize,
    /// Number of shapes skipped under `on_error=skip`.
    #[serde(skip_serializing_if = "is_zero")]
    skipped: usize,
    /// Reasons for skipping, at most 100 entries.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    errors: Vec<Fault>,
}

fn is_zero(count: &usize) -> bool {
    *count == 0
}

impl From<Stored> for AddAnswer {
    fn from(stored: Stored) -> Self {
        let Stored { added, revision, ids, skipped, faults, repeated_points } = stored;
        Self { added, revision, ids, repeated_points, skipped, errors: faults }
    }
}

/// Handling of invalid shapes and of repeated points.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct AddQuery {
    /// Handling of invalid shapes: `abort` stores nothing, `skip` stores the valid ones. Default: `abort`.
    #[serde(default)]
    #[param(inline)]
    on_error: OnError,
    /// Points that are equal to their predecessor, where contours are resampled (correspondences `arc_length` and
    /// `cyclic`): `drop` leaves them out, `refuse` makes the shape invalid. Default: `drop`.
    #[serde(default)]
    #[param(inline)]
    repeated_points: RepeatedPoints,
}

/// Adds shapes, all or none.
///
/// Send JSON for one body, or NDJSON (`application/x-ndjson`, one shape per line) for a stream of any length. Repeating an
/// `external_id` with the same content is a safe retry; with other content it is a conflict. Once the response is 201, the
/// shapes are on disk.
#[utoipa::path(post, path = "/cohorts/{cohort}/shapes", tag = "cohorts",
    params(("cohort" = String, Path, description = "Id or name"), AddQuery, RetryHeader, IfMatchHeader),
    request_body(content((AddRequest = "application/json"), (ShapeInput = "application/x-ndjson", example = json!("{\"external_id\": \"scan-19\", \"points\": [[0, 0], [5, 1], [1, 3]]}\n")))),
    responses(
        (status = 201, description = "Stored", body = AddAnswer),
        (status = 404, description = "No such cohort"),
        (status = 412, description = "The cohort has changed meanwhile"),
        (status = 409, description = "An external id belongs to another shape")
    ))]
pub(super) async fn add_shapes(
    Caller(app): Caller,
    Path(key): Path<String>,
    Query(query): Query<AddQuery>,
    IfMatch(expected): IfMatch,
    request: Request,
) -> Result<Response, Problem> {
    let (found, cohort) = (media_type(request.headers()), catalogue::find(&app, &key).await?);
    let AddQuery { on_error, repeated_points } = query;
    let (treatment, body) = (Treatment { on_error, repeated_points }, request.into_body());
    let stored = match found.as_str() {
        lines if is_stream(lines) => {
            upload::add_stream(&app, cohort, body::pieces(body), treatment, expected).await
        }
        json if is_json(json) => {
            let body = body::read(&app, body).await?;
            let app = app.with_body(&body);
            let shapes = read_shapes(&app, body).await?;
            upload::add(&app, cohort, shapes, treatment, expected).await
        }
        other => return Err(unsupported(other)),
    };
    Ok(json(StatusCode::CREATED, &AddAnswer::from(stored?))?)
}

fn unsupported(media_type: &str) -> Problem {
    let detail = format!("expected application/json or application/x-ndjson, got '{media_type}'");
    Problem::new(ProblemKind::UnsupportedMediaType, detail)
}

async fn read_shapes(app: &App, body: Bytes) -> Result<Vec<ShapeInput>, ServiceError> {
    let AddRequest { shapes, faults: mut errors } = app.read(body).await?;
    let shapes = shapes.unwrap_or_default().take("/shapes", &mut errors);
    checked(Some(()), errors, shapes).map(|((), shapes)| shapes)
}

/// A stored shape.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct StoredShape {
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
    /// Control points in the representation of the cohort.
    control_points: Points,
    /// Time of creation, RFC 3339 in UTC.
    created_at: String,
}

page! {
    /// One page of shapes of a cohort.
    PageOfShapes of StoredShape
}

impl StoredShape {
    fn new(cohort: &Cohort, shape: Shape) -> Self {
        let Shape { id, attributes, control_points, created_at_ms } = shape;
        Self {
            id,
            external_id: attributes.external_id,
            subject: attributes.subject,
            label: attributes.label,
            labels: attributes.labels,
            weight: attributes.weight,
            metadata: attributes.metadata.and_then(|text| RawValue::from_string(text).ok()),
            control_points: Points::from_columns(control_points, cohort.spec.representation.dimension()),
            created_at: time(created_at_ms),
        }
    }
}

/// Lists shapes in the order in which they were added.
#[utoipa::path(get, path = "/cohorts/{cohort}/shapes", tag = "cohorts",
    params(
        ("cohort" = String, Path, description = "Id or name"),
        FilterQuery,
        PageQuery
    ),
    responses(
        (status = 200, description = "A page of shapes", body = PageOfShapes),
        (status = 404, description = "No such cohort"),
        (status = "4XX", description = "The query was refused")
    ))]
pub(super) async fn list_shapes(
    Caller(app): Caller,
    Path(key): Path<String>,
    Query(pairs): Query<Vec<(String, String)>>,
) -> Result<Response, Problem> {
    let mut parameters = Parameters::once_each(pairs)?;
    let filter = parameters.take_filter();
    let limit = parameters.take("limit").map(|text| text.parse()).transpose();
    let limit = limit.map_err(|_| Problem::of_parameter("limit", "expected a non-negative whole number"))?;
    let page = PageQuery { cursor: parameters.take("cursor"), limit };
    parameters.refuse_rest()?;
    let limit = page.limit()?;
    let (cohort, (shapes, next)) =
        catalogue::list_shapes(&app, &key, &filter, page.cursor.as_deref(), limit).await?;
    compute(app.weighing(Work::MOMENT), move |_| {
        let items: Vec<StoredShape> =
            shapes.into_iter().map(|shape| StoredShape::new(&cohort, shape)).collect();
        json(StatusCode::OK, &PageOfShapes { items, next })
    })
    .await
}

/// Returns a shape by id or external id.
///
/// As SVG: a drawing. As OBJ, PLY, STL or glTF: the mesh of a surface.
#[utoipa::path(get, path = "/cohorts/{cohort}/shapes/{shape}", tag = "cohorts",
    params(
        ("cohort" = String, Path, description = "Id or name"),
        ("shape" = String, Path, description = "Id or external id"),
        ShapeFormatQuery, DrawingQuery
    ),
    responses(
        (status = 200, description = "The shape", content((StoredShape = "application/json"), (String = "image/svg+xml"), (Binary = "model/obj"), (Binary = "application/ply"), (Binary = "model/stl"), (Binary = "model/gltf-binary"))),
        (status = 404, description = "No such cohort or shape")
    ))]
pub(super) async fn find_shape(
    Caller(app): Caller,
    Path((key, shape)): Path<(String, String)>,
    OnlyShapeFormat(format): OnlyShapeFormat,
) -> Result<Response, Problem> {
    let (cohort, shape) = catalogue::find_shape(&app, &key, &shape).await?;
    compute(app.weighing(Work::MOMENT), move |app| {
        let space = app.space_of(&cohort.spec.representation)?;
        let style = match format {
            ShapeFormat::Mesh(format, grid) => return mesh(&space, &shape.control_points, format, grid),
            ShapeFormat::Plain(Format::Json) => {
                return json(StatusCode::OK, &StoredShape::new(&cohort, shape));
            }
            ShapeFormat::Plain(Format::Svg(style)) => style,
        };
        let title = shape.attributes.external_id.as_deref().unwrap_or(&shape.id);
        let unit = cohort.spec.length_unit.as_deref();
        Ok(svg(&draw_shapes(&space, title, &[&shape.control_points], unit), &style))
    })
    .await
}

/// Deletes a shape; the revision of the cohort grows.
#[utoipa::path(delete, path = "/cohorts/{cohort}/shapes/{shape}", tag = "cohorts",
    params(("cohort" = String, Path, description = "Id or name"), ("shape" = String, Path, description = "Id or external id")),
    responses(
        (status = 204, description = "Deleted"),
        (status = 404, description = "No such cohort or shape")
    ))]
pub(super) async fn delete_shape(
    Caller(app): Caller,
    _: NoQuery,
    Path((key, shape)): Path<(String, String)>,
) -> Result<StatusCode, Problem> {
    catalogue::delete_shape(&app, &key, &shape).await?;
    Ok(StatusCode::NO_CONTENT)
}
