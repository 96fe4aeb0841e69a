//! Cohorts: create, list, read, update, delete; and their mean shapes.

pub(in crate::api) mod bulk;
pub(in crate::api) mod changes;
pub(in crate::api) mod corrections;
pub(in crate::api) mod correspond;
pub(in crate::api) mod exports;
pub(in crate::api) mod incomplete;
pub(in crate::api) mod matching;
pub(in crate::api) mod shapes;
pub(in crate::api) mod sheet;
pub(in crate::api) mod subjects;
pub(in crate::api) mod tables;

use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};

#[cfg(feature = "schema")]
use crate::analysis::alignment::Alignment;
use crate::analysis::correspondence::{Correspondence, Direction, Mirror};
#[cfg(feature = "schema")]
use crate::analysis::frame::Frame;
use crate::analysis::transformation::ClassName;
use crate::api::extract::{
    BesideFormat, Caller, Format, IfMatch, JsonBody, NoQuery, Path, Query, ShapeFormat,
};
use crate::api::problem::Problem;
use crate::api::respond::{compute, json, mesh, picture};
#[cfg(feature = "schema")]
use crate::api::v1::requests::described::*;
use crate::api::v1::requests::entity_tags::{tag_of, tagged, unless_known};
use crate::api::v1::requests::request_macros::{MeanOutput, PageQuery, page};
use crate::api::v1::requests::shape_query::Parameters;
use crate::domain::cohort::{Cohort, CohortSpec};
use crate::geometry::representation::Representation;
use crate::service::app::{ServiceError, Work};
use crate::service::cohorts::catalogue::{CohortChanges, revision_tag, text_faults};
#[cfg(feature = "schema")]
use crate::service::cohorts::live_mean::SearchStart;
use crate::service::cohorts::live_mean::{LiveMean, MeanQuery};
use crate::service::cohorts::{catalogue, live_mean};
use crate::service::statistics::draw_mean;
use crate::wire::checked::{Checked, document, take_given, take_or_default};
use crate::wire::representation::Read;
use crate::wire::time::rfc3339;

document! {
    /// A cohort to create.
    #[schema(example = json!({
        "name": "nuclei-2026", "length_unit": "mm", "correspondence": "cyclic",
        "representation": {"kind": "closed_curve", "dimension": 2, "control_points": 24, "generator": {"name": "cubic"}}
    }))]
    pub(super) struct CohortRequest {
        /// Unique name: letters, digits, '.', '_' and '-', at most 100 characters.
        #[schema(value_type = String, required = true)]
        name: Checked<String>, required;
        /// Free-text description.
        #[schema(value_type = Option<String>)]
        description: Checked<Option<String>>;
        /// Representation of the cohort's shapes.
        #[schema(value_type = Representation, required = true)]
        representation: Read<Representation>, required;
        /// Point correspondence between shapes. Default: `landmarks`.
        #[schema(value_type = Option<Correspondence>)]
        correspondence: Checked<Correspondence>;
        /// How to treat contour direction. Default: `either` for closed planar curves under `cyclic`, else `given` (keep the
        /// direction as posted).
        #[schema(value_type = Option<Direction>)]
        direction: Checked<Direction>;
        /// Whether shapes may be matched to mirror images. Default: `forbid`.
        #[schema(value_type = Option<Mirror>)]
        mirror: Checked<Mirror>;
        /// Unit of the coordinates: `m`, `cm`, `mm`, `um`, `nm`, `inch`, `pixel`, `voxel`, or `none` for numbers without a unit; other
        /// spellings of these, such as `µm`, are stored as the word. Files that state another length are converted to it. Null: not
        /// known; the first file with a unit sets it.
        #[schema(value_type = Option<String>, example = "mm")]
        length_unit: Checked<Option<String>>;
    }
}

/// A named set of shapes in one representation.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct CohortOutput {
    /// Identifier.
    #[schema(example = "coh_0198c0ffee00700080000000000000aa")]
    id: String,
    /// Name; can be used in place of the identifier.
    name: String,
    /// Free-text description.
    description: Option<String>,
    /// Representation of the cohort's shapes.
    representation: Representation,
    /// Point correspondence between shapes.
    correspondence: Correspondence,
    /// Treatment of contour direction.
    direction: Direction,
    /// Whether shapes may be matched to mirror images.
    mirror: Mirror,
    /// Unit of the coordinates; a text of an earlier release that names none counts as not known.
    length_unit: Option<String>,
    /// Revision number, which grows with every change.
    revision: u64,
    /// Number of shapes.
    #[serde(rename = "shape_count")]
    shapes: u64,
    /// Time of creation, RFC 3339 in UTC.
    created_at: String,
    /// Time of the last change, RFC 3339 in UTC.
    updated_at: String,
}

page! {
    /// One page of cohorts.
    PageOfCohorts of CohortOutput
}

impl From<Cohort> for CohortOutput {
    fn from(cohort: Cohort) -> Self {
        Self {
            id: cohort.id,
            name: cohort.spec.name,
            description: cohort.spec.description,
            representation: cohort.spec.representation,
            correspondence: cohort.spec.correspondence,
            direction: cohort.spec.direction,
            mirror: cohort.spec.mirror,
            length_unit: cohort.spec.length_unit,
            revision: cohort.revision,
            shapes: cohort.shapes,
            created_at: rfc3339(cohort.created_at_ms),
            updated_at: rfc3339(cohort.updated_at_ms),
        }
    }
}

/// Creates a cohort.
#[utoipa::path(post, path = "/v1/cohorts", tag = "cohorts", params(RetryHeader), request_body = CohortRequest,
    responses(
        (status = 201, description = "Created", body = CohortOutput, headers(("Location" = String))),
        (status = 409, description = "The name is already in use")
    ))]
pub(super) async fn create_cohort(
    Caller(app): Caller,
    _: NoQuery,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    let new = new_cohort(app.parse(&body)?)?;
    let cohort = catalogue::create(&app.with_body(&body), new).await?;
    let (tag, location) = (revision_tag(&cohort), format!("/v1/cohorts/{}", cohort.id));
    let response = json(StatusCode::CREATED, &CohortOutput::from(cohort))?;
    Ok(tagged(([(header::LOCATION, location)], response).into_response(), &tag))
}

fn new_cohort(request: CohortRequest) -> Result<CohortSpec, ServiceError> {
    let mut errors = request.faults;
    let name = take_given(request.name, "/name", &mut errors);
    let description = take_given(request.description, "/description", &mut errors).flatten();
    let representation = request.representation.and_then(|field| field.take("/representation", &mut errors));
    let correspondence = take_or_default(request.correspondence, "/correspondence", &mut errors);
    let direction = take_given(request.direction, "/direction", &mut errors);
    let mirror = take_or_default(request.mirror, "/mirror", &mut errors);
    let length_unit = take_given(request.length_unit, "/length_unit", &mut errors).flatten();
    match (name.as_ref(), representation, correspondence, mirror) {
        (Some(name), Some(representation), Some(correspondence), Some(mirror)) if errors.is_empty() => {
            let name = name.clone();
            let direction = direction.unwrap_or_else(|| Direction::usual(correspondence, &representation));
            Ok(CohortSpec {
                name,
                description,
                representation,
                correspondence,
                direction,
                mirror,
                length_unit,
            })
        }
        _ => {
            errors.extend(text_faults(name.as_deref(), description.as_deref(), length_unit.as_deref()));
            Err(ServiceError::Invalid(errors.into()))
        }
    }
}

/// Lists cohorts in order of creation.
#[utoipa::path(get, path = "/v1/cohorts", tag = "cohorts", params(PageQuery),
    responses(
        (status = 200, description = "A page of cohorts", body = PageOfCohorts),
        (status = 400, description = "The query was refused")
    ))]
pub(super) async fn list_cohorts(
    Caller(app): Caller,
    Query(page): Query<PageQuery>,
) -> Result<Response, Problem> {
    let (items, next) = catalogue::list(&app, page.cursor.as_deref(), page.limit()?).await?;
    let items: Vec<CohortOutput> = items.into_iter().map(Into::into).collect();
    Ok(json(StatusCode::OK, &PageOfCohorts { items, next })?)
}

/// Returns a cohort by id or name.
#[utoipa::path(get, path = "/v1/cohorts/{cohort}", tag = "cohorts", params(("cohort" = String, Path, description = "Id or name")),
    responses(
        (status = 200, description = "The cohort; its ETag changes with its revision", body = CohortOutput),
        (status = 304, description = "Unchanged since the version in If-None-Match"),
        (status = 404, description = "No such cohort")
    ))]
pub(super) async fn find_cohort(
    Caller(app): Caller,
    _: NoQuery,
    Path(key): Path<String>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let cohort = catalogue::find(&app, &key).await?;
    let tag = revision_tag(&cohort);
    let answer = async { Ok(json(StatusCode::OK, &CohortOutput::from(cohort))?) };
    unless_known(&headers, &tag, answer).await
}

/// Fields of a cohort to change; absent fields keep their values.
#[derive(Debug, Default, Deserialize, utoipa::ToSchema)]
#[serde(default, deny_unknown_fields)]
#[schema(example = json!({"description": "left hands, second scanner"}))]
pub(super) struct CohortPatch {
    /// New name.
    name: Option<String>,
    /// New description; null to remove it.
    #[serde(deserialize_with = "given")]
    #[schema(value_type = Option<String>)]
    description: Option<Option<String>>,
    /// New unit, one of `m`, `cm`, `mm`, `um`, `nm`, `inch`, `pixel`, `voxel` and `none`; null to remove it. Stored coordinates stay
    /// as they are.
    #[serde(deserialize_with = "given")]
    #[schema(value_type = Option<String>)]
    length_unit: Option<Option<String>>,
    /// New correspondence. Curves are stored again.
    correspondence: Option<Correspondence>,
    /// New treatment of contour direction. Closed planar curves are stored again.
    direction: Option<Direction>,
    /// New treatment of mirror images.
    mirror: Option<Mirror>,
}

/// Deserialises a present field, either null or a value.
fn given<'de, D: serde::Deserializer<'de>>(field: D) -> Result<Option<Option<String>>, D::Error> {
    Option::deserialize(field).map(Some)
}

/// Changes the name, description, unit, correspondence, direction or mirror images of a cohort.
///
/// The revision grows by one. Curves that another correspondence or direction stores otherwise are stored again: as points along
/// them, from where they began and in the direction in which they were given. Earlier revisions keep their shapes and their rule, and so do
/// dictionaries and jobs that are of them; dictionaries of another correspondence are applied to posted shapes only. With `If-Match`, the change is made only if the cohort is still at that version.
#[utoipa::path(patch, path = "/v1/cohorts/{cohort}", tag = "cohorts", request_body = CohortPatch,
    params(("cohort" = String, Path, description = "Id or name"), IfMatchHeader),
    responses(
        (status = 200, description = "The updated cohort", body = CohortOutput),
        (status = 404, description = "No such cohort"),
        (status = 409, description = "The name is already in use"),
        (status = 412, description = "The cohort has changed meanwhile")
    ))]
pub(super) async fn update_cohort(
    Caller(app): Caller,
    _: NoQuery,
    Path(key): Path<String>,
    IfMatch(expected): IfMatch,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    let CohortPatch { name, description, length_unit, correspondence, direction, mirror } =
        app.parse_whole(&body)?;
    let changes = CohortChanges { name, description, length_unit, correspondence, direction, mirror };
    let cohort = catalogue::update(&app, &key, changes, expected).await?;
    let tag = revision_tag(&cohort);
    Ok(tagged(json(StatusCode::OK, &CohortOutput::from(cohort))?, &tag))
}

/// Moves a cohort with all its shapes to the trash; its name can be reused at once.
#[utoipa::path(delete, path = "/v1/cohorts/{cohort}", tag = "cohorts",
    params(("cohort" = String, Path, description = "Id or name"), IfMatchHeader),
    responses(
        (status = 204, description = "Moved to the trash"),
        (status = 412, description = "The cohort has changed meanwhile"),
        (status = 404, description = "No such cohort")
    ))]
pub(super) async fn delete_cohort(
    Caller(app): Caller,
    _: NoQuery,
    Path(key): Path<String>,
    IfMatch(expected): IfMatch,
) -> Result<StatusCode, Problem> {
    catalogue::delete(&app, &key, expected).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// Mean shape of a cohort.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct CohortMeanOutput {
    #[serde(flatten)]
    mean: MeanOutput,
    /// Revision of the cohort that was averaged.
    revision: u64,
    /// Revision of the mean with whose start points the search for start points began; null if it began with the shapes as
    /// given, or if there is nothing to search.
    started_from: Option<u64>,
}

/// Computes the mean of a cohort's shapes at its current revision.
///
/// A search for start points ends in one of many local optima. From the shapes as given (`start=given`) it depends on the
/// shapes alone, and for more than 8192 plane curves under `similarity` on their order: most of them are searched first, then all.
/// The service remembers where the first search ended, so that a few curves more cost a few rounds. With `start=last` the search begins with the start points that the last search with the same parameters has found,
/// as far as the service remembers it: this takes the fewest rounds, and the mean has the same certificate, but it
/// depends on the means that were computed before. `started_from` names the revision of those.
///
/// The ETag changes with the revision and the query; a request with a matching `If-None-Match` is not computed again. As SVG:
/// the mean in front of some of the aligned shapes. As OBJ, PLY, STL or glTF: the mesh of a mean surface.
#[utoipa::path(get, path = "/v1/cohorts/{cohort}/mean", tag = "cohorts",
    params(
        ("cohort" = String, Path, description = "Id or name"),
        ("transformation" = ClassName, Query, description = "Class of transformations that is removed"),
        ("alignment" = Option<Alignment>, Query, description = "Alignment. Default: `projection`, or \
            `procrustes` for `rigid`, and for `similarity` in three dimensions"),
        ("frame" = Option<Frame>, Query, description = "Frame. Default: `training`"),
        ("start" = inline(Option<SearchStart>), Query, description = "Start points with which the search begins: `given`, those of the shapes, or `last`, those of the last search. Default: `given`"),
        ("robust" = Option<bool>, Query, description = "Whether shapes unlike the majority count less or not at all. At least five shapes. Default: false"),
        ("corresponding" = Option<bool>, Query, description = "Whether the parameters of surfaces with poles that came as meshes correspond, as those of meshes with common vertices do. They are refused otherwise: `POST /v1/cohorts/{cohort}/correspond` makes a cohort in which they do. Default: false"),
        ("stale" = Option<bool>, Query, description = "Whether the last mean computed is answered at once, with its revision, while that of the current revision is computed in the background. Default: false"),
        FilterQuery,
        ShapeFormatQuery,
        DrawingQuery
    ),
    responses(
        (status = 200, description = "The mean", content((CohortMeanOutput = "application/json"), (String = "image/svg+xml"), (Binary = "model/obj"), (Binary = "application/ply"), (Binary = "model/stl"), (Binary = "model/gltf-binary"))),
        (status = 304, description = "Unchanged since the version in If-None-Match"),
        (status = 404, description = "No such cohort"),
        (status = "4XX", description = "The query was refused, or the shapes have no mean")
    ))]
pub(super) async fn cohort_mean(
    Caller(app): Caller,
    Path(key): Path<String>,
    format: ShapeFormat,
    BesideFormat(pairs): BesideFormat<Vec<(String, String)>>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let (query, stale) = take_mean_query(pairs)?;
    let cohort = catalogue::find(&app, &key).await?;
    let cohort = if stale { live_mean::at_last_mean(&app, cohort, &query).await? } else { cohort };
    let tag = mean_tag(&cohort, &query, format);
    let answer = async {
        let live = live_mean::mean(&app, cohort, query).await?;
        compute(app.weighing(Work::MOMENT + format.work()), move |_| answer_mean(&live, format)).await
    };
    unless_known(&headers, &tag, answer).await
}

/// Entity tag of a mean in a format.
fn mean_tag(cohort: &Cohort, query: &MeanQuery, format: ShapeFormat) -> String {
    tag_of(&format!("{}{query:?}{format:?}", revision_tag(cohort)))
}

/// Takes the parameters of a mean, and whether an older one may be answered.
fn take_mean_query(pairs: Vec<(String, String)>) -> Result<(MeanQuery, bool), Problem> {
    let mut parameters = Parameters::read(pairs)?;
    let transformation = parameters.take_word::<ClassName>("transformation")?.ok_or_else(|| {
        let detail = "required parameter is missing, such as similarity or affine";
        Problem::of_parameter("transformation", detail)
    })?;
    let query = MeanQuery {
        transformation,
        alignment: parameters.take_word("alignment")?,
        frame: parameters.take_word("frame")?.unwrap_or_default(),
        start: parameters.take_word("start")?.unwrap_or_default(),
        robust: parameters.take_flag("robust")?,
        corresponding: parameters.take_flag("corresponding")?,
        filter: parameters.take_filter(),
    };
    let stale = parameters.take_flag("stale")?;
    parameters.refuse_rest()?;
    Ok((query, stale))
}

fn answer_mean(live: &LiveMean, format: ShapeFormat) -> Result<Response, ServiceError> {
    match format {
        ShapeFormat::Mesh(format, grid) => mesh(&live.setup.space, &live.mean.control_points, format, grid),
        ShapeFormat::Plain(Format::Picture(file)) => {
            let title = format!("mean of {} shapes of {}", live.mean.shapes, live.cohort.spec.name);
            let unit = live.cohort.spec.shown_unit();
            picture(&draw_mean(&live.setup, &title, &live.mean, &live.drawn, unit), &file)
        }
        ShapeFormat::Plain(Format::Json) => {
            let mean = MeanOutput::new(&live.mean, live.setup.metric.dimension());
            let mut mean = mean.leaving_out(live.robust.as_ref());
            mean.warnings.extend(live.mixed.clone());
            json(
                StatusCode::OK,
                &CohortMeanOutput { mean, revision: live.cohort.revision, started_from: live.started_from },
            )
        }
    }
}
