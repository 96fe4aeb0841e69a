//! Exact nearest-neighbour search in a cohort, and matrices of pairwise distances; jobs compute the large ones.

#[cfg(feature = "schema")]
use crate::api::v1::requests::described::*;
use crate::wire::fault::Fault;
use std::collections::BTreeMap;

use axum::http::StatusCode;
use axum::response::Response;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::analysis::AnalysisError;
use crate::analysis::alignment::Alignment;
use crate::analysis::correspondence::{Direction, Mirror};
use crate::analysis::defaults::NEIGHBOURS;
use crate::analysis::elastic::settings::{Effort, ElasticSettings};
use crate::analysis::factors::Estimator;
use crate::analysis::frame::Frame;
use crate::analysis::transformation::{ClassName, Transformation};
use crate::api::extract::{
    Caller, Format, JsonBody, OnlyFormat, OnlyMatrixFormat, OutputFormat, Path, Prefer,
};
use crate::api::problem::Problem;
use crate::api::respond::{self, compute, json, picture};
use crate::api::v1::dictionaries::assessments::stored_lines;
use crate::api::v1::requests::planned::{Waited, waited};
use crate::api::v1::requests::request_macros::{checked, priority_of};
use crate::api::v1::requests::shape_query::take_filter;
use crate::api::v1::segmentation::segment;
use crate::api::v1::statistics::matched::{ElasticFields, PairCorrespondence};
use crate::domain::filter::ShapeFilter;
use crate::domain::job::Priority;
use crate::geometry::representation::Representation;
use crate::service::app::{App, ServiceError, Work};
#[cfg(feature = "schema")]
use crate::service::dictionaries::assessments::CohortAssessment;
use crate::service::jobs;
use crate::service::search::distances::{Answer, Chosen, Comparison};
use crate::service::search::matched::contour_settings;
use crate::service::search::neighbours::{FoundNeighbour, MAX_NEIGHBOURS, Queries, Search};
use crate::service::search::pairs::check_elastic_class;
use crate::service::search::{self, distances, neighbours};
use crate::service::statistics::Settings;
use crate::wire::checked::{Checked, List, Many, document, take_given, take_many, take_or_default};
use crate::wire::matrix::{MatrixFormat, NamedMatrix};
use crate::wire::representation::Read;
use crate::wire::shape::ShapeInput;

/// Default number of nearest curves that are compared elastically: all ten nearest ones are among the first 25 in the median, for silhouettes.
const CANDIDATES: usize = 100;

document! {
    /// Shapes whose nearest neighbours in a cohort are wanted.
    #[schema(example = json!({"shapes": [{"points": [[0, 0], [4, 0], [4, 1], [0, 1]]}], "neighbours": 5}))]
    pub(in crate::api::v1) struct SearchRequest {
        /// Query shapes, in the form used for the cohort. Give `shapes` or `ids`.
        #[schema(value_type = Option<Vec<ShapeInput>>)]
        shapes: List<ShapeInput>;
        /// Ids or external ids of query shapes in the cohort; a shape is not its own neighbour.
        #[schema(value_type = Option<Vec<String>>)]
        ids: Many<String>;
        /// Number of neighbours per shape, 1 to 1000. Default: 10.
        #[schema(value_type = Option<usize>, minimum = 1, maximum = 1000)]
        neighbours: Checked<usize>;
        /// Transformation class to remove. Default: `similarity`.
        #[schema(value_type = Option<Transformation>)]
        transformation: Checked<Transformation>;
        /// Alignment method. Default: `projection`, or `procrustes` where the class is no linear space: `rigid`, and `similarity`
        /// in three dimensions.
        #[schema(value_type = Option<Alignment>)]
        alignment: Checked<Alignment>;
        /// Whether shapes may be matched to mirror images. Default: the cohort's setting.
        #[schema(value_type = Option<Mirror>)]
        mirror: Checked<Mirror>;
        /// Filter that selects the shapes to search. Default: all shapes.
        #[schema(value_type = Option<ShapeFilter>)]
        filter: Checked<ShapeFilter>;
        /// `elastic`: the nearest curves modulo the class are compared by their directions, and answered by that distance.
        #[schema(value_type = Option<SearchCorrespondence>)]
        correspondence: Checked<SearchCorrespondence>;
        /// `elastic`: number of nearest curves modulo the class that are compared with each query, 1 to 1000. Default: 100.
        #[schema(value_type = Option<usize>, minimum = 1, maximum = 1000)]
        candidates: Checked<usize>;
        /// `elastic`: weight of bending against stretching, above 0 and up to 1: near 0, lengths correspond. Default: 1.
        #[schema(value_type = Option<f64>, maximum = 1)]
        elasticity: Checked<f64>;
        /// `elastic`: number of segments into which curves are divided, 16 to 1000. Default: 100.
        #[schema(value_type = Option<usize>, minimum = 16, maximum = 1000)]
        points: Checked<usize>;
        /// `elastic`: whether rotations are removed. Default: true.
        #[schema(value_type = Option<bool>)]
        rotation: Checked<bool>;
        /// `elastic`: thoroughness of the search of a pair. Default: `normal`.
        #[schema(value_type = Option<Effort>)]
        effort: Checked<Effort>;
    }
}

/// A search that is not one modulo the class alone.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub(in crate::api::v1) enum SearchCorrespondence {
    /// Curves are compared by their directions.
    Elastic,
}

/// Neighbour of a query shape.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct NeighbourOutput {
    /// Identifier.
    #[schema(example = "shp_0198c0ffee00700080000000000000aa")]
    id: String,
    /// Identifier assigned by the client.
    external_id: Option<String>,
    /// Class label.
    label: Option<String>,
    /// Additional attributes.
    #[schema(value_type = Attributes)]
    labels: BTreeMap<String, Value>,
    /// Distance to the query: in [0, 1], under `partial_procrustes` in [0, 2], under `elastic` in [0, π/2], or a length under `rigid`
    /// and `translation`.
    distance: f64,
    /// Index of the neighbour's control point that corresponds to the first one of the query, modulo the class, also under `elastic`
    /// (`POST /v1/match` answers what corresponds elastically).
    start: u32,
    /// Whether the neighbour is traversed in reverse, modulo the class.
    reversed: bool,
    /// Whether the match modulo the class is a mirror image.
    mirrored: bool,
}

impl From<FoundNeighbour> for NeighbourOutput {
    fn from(found: FoundNeighbour) -> Self {
        let FoundNeighbour { id, external_id, label, labels, distance, placement } = found;
        let (start, reversed, mirrored) = (placement.shift, placement.reversed, placement.mirrored);
        Self { id, external_id, label, labels, distance, start, reversed, mirrored }
    }
}

/// Neighbours of one query shape.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct SearchResult {
    /// Neighbours, nearest first; among equal distances the one added first comes first.
    neighbours: Vec<NeighbourOutput>,
}

/// Neighbours of all query shapes, in request order.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct SearchAnswer {
    /// Revision of the cohort that was searched.
    cohort_revision: u64,
    /// Warnings about the shapes that were compared: contours drawn both ways round where their direction counts,
    /// surfaces whose parameters do not correspond.
    warnings: Vec<String>,
    /// One entry per shape.
    results: Vec<SearchResult>,
}

/// Finds the nearest shapes of a cohort.
///
/// The search is exact: every shape of the cohort that passes the filter is compared, at all start points, directions and
/// mirror images that the cohort allows. Under `elastic` the nearest curves of that search are compared elastically. As SVG: the first query shapes, each with its nearest shapes side by side.
#[utoipa::path(post, path = "/v1/cohorts/{cohort}/search", tag = "retrieval", request_body = SearchRequest,
    params(
        ("cohort" = String, Path, description = "Id or name"),
        ("format" = Option<String>, Query, description = "`json`, `svg` or `png`"), DrawingQuery
    ),
    responses(
        (status = 200, description = "The neighbours of each shape", content((SearchAnswer = "application/json"), (String = "image/svg+xml"))),
        (status = 404, description = "No such cohort")
    ))]
pub(in crate::api::v1) async fn search_cohort(
    Caller(app): Caller,
    OnlyFormat(format): OnlyFormat,
    Path(key): Path<String>,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    let reader = app.clone();
    let search = app.pool.read(body, move |body| search_of(reader.parse(body)?)).await?;
    if let Format::Picture(file) = format {
        let drawing = search::picture::draw(&app, &key, search).await?;
        return compute(app.weighing(format.work()), move |_| picture(&drawing, &file)).await;
    }
    let found = neighbours::search(&app, &key, search).await?;
    let answers: usize = found.neighbours.iter().map(Vec::len).sum();
    compute(app.weighing(Work::numbers(10.0 * answers as f64)), move |_| {
        let result = |list: Vec<FoundNeighbour>| SearchResult {
            neighbours: list.into_iter().map(Into::into).collect(),
        };
        let results = found.neighbours.into_iter().map(result).collect();
        let (cohort_revision, warnings) = (found.cohort_revision, found.warnings);
        json(StatusCode::OK, &SearchAnswer { cohort_revision, warnings, results })
    })
    .await
}

fn search_of(mut request: SearchRequest) -> Result<Search, ServiceError> {
    let mut errors = std::mem::take(&mut request.faults);
    let is_elastic = request.correspondence.is_some();
    take_given(request.correspondence.take(), "/correspondence", &mut errors);
    let given = [
        ("/candidates", request.candidates.is_some()),
        ("/elasticity", request.elasticity.is_some()),
        ("/points", request.points.is_some()),
        ("/rotation", request.rotation.is_some()),
        ("/effort", request.effort.is_some()),
    ];
    let SearchRequest { elasticity, points, rotation, effort, .. } = request;
    let elastic = elastic_fields(
        is_elastic,
        given.as_slice(),
        ElasticFields { elasticity, points, rotation, effort },
        &mut errors,
    );
    let candidates = take_given(request.candidates, "/candidates", &mut errors).unwrap_or(CANDIDATES);
    if !(1..=MAX_NEIGHBOURS).contains(&candidates) {
        let detail = format!("expected a number between 1 and {MAX_NEIGHBOURS}, got {candidates}");
        errors.push(Fault::new("/candidates", detail));
    }
    let posted = request.shapes.map(|shapes| shapes.take("/shapes", &mut errors));
    if posted.is_some() == request.ids.is_some() {
        errors.push(Fault::new("", "expected either shapes or ids"));
    }
    let ids = take_many(request.ids, "/ids", &mut errors);
    let neighbours = take_given(request.neighbours, "/neighbours", &mut errors).unwrap_or(NEIGHBOURS);
    if !(1..=MAX_NEIGHBOURS).contains(&neighbours) {
        let detail = format!("expected a number between 1 and {MAX_NEIGHBOURS}, got {neighbours}");
        errors.push(Fault::new("/neighbours", detail));
    }
    let similarity = Transformation::Named(ClassName::Similarity);
    let transformation =
        take_given(request.transformation, "/transformation", &mut errors).unwrap_or(similarity);
    let alignment = take_given(request.alignment, "/alignment", &mut errors);
    let mirror = take_given(request.mirror, "/mirror", &mut errors);
    let filter = take_filter(request.filter, "/filter", &mut errors).unwrap_or_default();
    let is_posted = posted.is_some();
    let ((), shapes) = checked(Some(()), errors, posted.unwrap_or_default())?;
    let queries = if is_posted { Queries::Posted(shapes) } else { Queries::Stored(ids.unwrap_or_default()) };
    if is_elastic {
        check_elastic_class(&transformation)?;
    }
    let comparison = Comparison { transformation, alignment, mirror, elastic };
    Ok(Search { queries, neighbours, comparison, filter, candidates })
}

document! {
    /// Shapes whose pairwise distances are wanted: posted shapes with their representation and correspondence, or shapes of
    /// a cohort.
    #[schema(example = json!({
        "cohort": "example-cells", "filter": {"labels": {"cell_line": "dlm8"}}, "transformation": "similarity"
    }))]
    pub(in crate::api::v1) struct DistancesRequest {
        /// Posted shapes; cannot be combined with `cohort`.
        #[schema(value_type = Option<Vec<ShapeInput>>)]
        shapes: List<ShapeInput>;
        /// Representation of posted shapes.
        #[schema(value_type = Option<Representation>)]
        representation: Read<Representation>;
        /// Conversion of posted points to control points (default: `landmarks`), or `elastic`: curves, also those of a cohort, are
        /// compared by their directions, modulo position, scale, rotation, start and parametrisation; posted contours are then resampled
        /// along their length.
        #[schema(value_type = Option<PairCorrespondence>)]
        correspondence: Checked<PairCorrespondence>;
        /// How to treat the direction of posted contours. Default: `either` for closed planar curves under `cyclic` and `elastic`, else
        /// `given` (keep the direction as posted).
        #[schema(value_type = Option<Direction>)]
        direction: Checked<Direction>;
        /// Id or name of a cohort.
        #[schema(value_type = Option<String>)]
        cohort: Checked<String>;
        /// Filter that selects shapes of the cohort. Default: all shapes.
        #[schema(value_type = Option<ShapeFilter>)]
        filter: Checked<ShapeFilter>;
        /// Ids or external ids of shapes of the cohort, each once; cannot be combined with `filter`.
        #[schema(value_type = Option<Vec<String>>)]
        ids: Many<String>;
        /// Whether shapes may be matched to mirror images. Default: the cohort's setting; `forbid` for posted shapes.
        #[schema(value_type = Option<Mirror>)]
        mirror: Checked<Mirror>;
        /// Transformation class removed before shapes are compared. Required; optional under `elastic`, which removes similarities.
        #[schema(value_type = Option<Transformation>)]
        transformation: Checked<Transformation>;
        /// Alignment method. Default: `projection`, or `procrustes` where the class is no linear space: `rigid`, and `similarity`
        /// in three dimensions.
        #[schema(value_type = Option<Alignment>)]
        alignment: Checked<Alignment>;
        /// `elastic`: weight of bending against stretching, above 0 and up to 1: near 0, lengths correspond. Default: 1.
        #[schema(value_type = Option<f64>, maximum = 1)]
        elasticity: Checked<f64>;
        /// `elastic`: number of segments into which curves are divided, 16 to 1000. Default: 100.
        #[schema(value_type = Option<usize>, minimum = 16, maximum = 1000)]
        points: Checked<usize>;
        /// `elastic`: whether rotations are removed. Default: true.
        #[schema(value_type = Option<bool>)]
        rotation: Checked<bool>;
        /// `elastic`: thoroughness of the search. Default: `normal`.
        #[schema(value_type = Option<Effort>)]
        effort: Checked<Effort>;
        /// Priority among the tenant's queued jobs if the request becomes a job. Default: `normal`.
        #[schema(value_type = Option<Priority>)]
        priority: Checked<Priority>;
    }
}

/// Pairwise distances.
#[cfg(feature = "schema")]
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct DistancesAnswer {
    /// Id of the cohort; null for posted shapes.
    cohort: Option<String>,
    /// Revision of the cohort; null for posted shapes.
    cohort_revision: Option<u64>,
    /// Names of the rows and columns: the external id, else the id; for posted shapes the position.
    ids: Vec<String>,
    /// Class labels of the rows and columns.
    labels: Vec<Option<String>>,
    /// Warnings about the shapes: contours drawn both ways round where their direction counts, surfaces whose
    /// parameters do not correspond. Absent in matrices of jobs of earlier versions.
    #[schema(required = false)]
    warnings: Vec<String>,
    /// Distance matrix, symmetric with a zero diagonal: values in [0, 1], under `partial_procrustes` in [0, 2], under `elastic` in
    /// [0, π/2], or lengths under `rigid` and `translation`.
    distances: Vec<Vec<f64>>,
}

/// Computes the distances between all pairs of shapes.
///
/// Few shapes are answered at once (200). For many shapes of a cohort the response is a job (202), whose matrix is available
/// at `/v1/jobs/{job}/output`; with `Prefer: wait=N` it is the matrix if that is ready within `N` seconds, at most 60.
#[utoipa::path(post, path = "/v1/distances", tag = "retrieval", request_body = DistancesRequest,
    params(
        ("format" = Option<String>, Query, description = "`json`, `csv`, `npy`, `arrow` or `parquet`"),
        ("prefer" = Option<String>, Header, description = "`wait=10`: wait up to ten seconds for the matrix of the job"), RetryHeader
    ),
    responses(
        (status = 200, description = "The matrix", content((DistancesAnswer = "application/json"), (String = "text/csv"), (Binary = "application/x-npy"), (Binary = "application/vnd.apache.arrow.stream"), (Binary = "application/vnd.apache.parquet"))),
        (status = 202, description = "The job that computes the matrix", body = JobOutput, headers(("Location" = String))),
        (status = 404, description = "No such cohort"),
        (status = 503, description = "Too many jobs are waiting")
    ))]
pub(in crate::api::v1) async fn compute_distances(
    Caller(app): Caller,
    OnlyMatrixFormat(format): OnlyMatrixFormat,
    prefer: Prefer,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    let app = app.with_body(&body);
    let reader = app.clone();
    let reading = app.pool.read(body, move |body| {
        let mut request: DistancesRequest = reader.parse(body)?;
        let priority = priority_of(request.priority.take())?;
        Ok((matrix_request(request)?, priority))
    });
    let (request, priority) = reading.await?;
    let app = app.with_priority(priority);
    let job = match request.answer(&app).await? {
        Answer::Matrix(matrix) => return Ok(respond::matrix(&app, matrix, format)?),
        Answer::Job(job) => *job,
    };
    match waited(&app, job, prefer).await? {
        Waited::Succeeded(job) => Ok(output(&app, &job.id, format).await?),
        Waited::Else(response) => Ok(response),
    }
}

async fn output(app: &App, job: &str, format: MatrixFormat) -> Result<Response, ServiceError> {
    let matrix: NamedMatrix = distances::output(app, job).await?;
    respond::matrix(app, matrix, format)
}

/// A validated request for a distance matrix.
enum MatrixRequest {
    Posted(Box<Settings>, Option<ElasticSettings>, Vec<ShapeInput>),
    Cohort(String, Chosen, Comparison),
}

impl MatrixRequest {
    async fn answer(self, app: &App) -> Result<Answer, ServiceError> {
        match self {
            Self::Posted(settings, elastic, shapes) => {
                Ok(Answer::Matrix(distances::for_posted(app, *settings, elastic, shapes).await?))
            }
            Self::Cohort(key, chosen, comparison) => {
                distances::for_cohort(app, &key, chosen, comparison).await
            }
        }
    }
}

fn matrix_request(mut request: DistancesRequest) -> Result<MatrixRequest, ServiceError> {
    let mut errors = std::mem::take(&mut request.faults);
    let of_cohort = request.cohort.is_some();
    let gives_correspondence = request.correspondence.is_some();
    let correspondence = take_or_default(request.correspondence.take(), "/correspondence", &mut errors);
    // Unknown of a correspondence that cannot be read: nothing is misplaced beside it.
    let asked = correspondence.map(|known| known == PairCorrespondence::Elastic);
    let (is_elastic, correspondence) = (asked == Some(true), correspondence.unwrap_or_default());
    errors.extend(misplaced(&request, gives_correspondence && asked == Some(false)));
    let elastic = elastic_of(&mut request, asked, &mut errors);
    let posted = request.shapes.take().map(|shapes| shapes.take("/shapes", &mut errors));
    let representation = request.representation.and_then(|field| field.take("/representation", &mut errors));
    let direction = take_given(request.direction, "/direction", &mut errors);
    let cohort = take_given(request.cohort, "/cohort", &mut errors);
    let filter = take_filter(request.filter, "/filter", &mut errors).unwrap_or_default();
    let ids = take_many(request.ids, "/ids", &mut errors);
    let mirror = take_given(request.mirror, "/mirror", &mut errors);
    let usual = is_elastic.then_some(Transformation::Named(ClassName::Similarity));
    let transformation = take_given(request.transformation, "/transformation", &mut errors).or(usual);
    let alignment = take_given(request.alignment, "/alignment", &mut errors);
    let (transformation, shapes) = checked(transformation, errors, posted.unwrap_or_default())?;
    if is_elastic {
        check_elastic_class(&transformation)?;
    }
    match (cohort, representation) {
        (Some(cohort), _) if of_cohort => {
            let chosen = ids.map_or(Chosen::Filter(Box::new(filter)), Chosen::Ids);
            let comparison = Comparison { transformation, alignment, mirror, elastic };
            Ok(MatrixRequest::Cohort(cohort, chosen, comparison))
        }
        (_, Some(representation)) => {
            let mirror = mirror.unwrap_or_default();
            let frame = Frame::default();
            let usual = Alignment::usual(&transformation, representation.dimension());
            let alignment = alignment.unwrap_or(usual);
            let correspondence = correspondence.conversion();
            let direction = direction.unwrap_or_else(|| Direction::usual(correspondence, &representation));
            let settings = Settings {
                representation,
                correspondence,
                direction,
                mirror,
                transformation,
                alignment,
                frame,
                estimator: Estimator::Plain,
            };
            let settings = if is_elastic { contour_settings(settings) } else { settings };
            Ok(MatrixRequest::Posted(Box::new(settings), elastic, shapes))
        }
        _ => Err(ServiceError::invalid("", "the request is incomplete")),
    }
}

/// Settings of elastic distances if they are asked for, and faults of fields that belong to the other kind.
fn elastic_of(
    request: &mut DistancesRequest,
    asked: Option<bool>,
    errors: &mut Vec<Fault>,
) -> Option<ElasticSettings> {
    let given = [
        ("/elasticity", request.elasticity.is_some()),
        ("/points", request.points.is_some()),
        ("/rotation", request.rotation.is_some()),
        ("/effort", request.effort.is_some()),
    ];
    let fields = ElasticFields {
        elasticity: request.elasticity.take(),
        points: request.points.take(),
        rotation: request.rotation.take(),
        effort: request.effort.take(),
    };
    if asked == Some(false) && request.transformation.is_none() {
        errors.push(Fault::new("/transformation", "required field is missing"));
    }
    if asked == Some(true) && request.alignment.is_some() {
        let detail =
            "expected no value with elastic distances, whose rotations are those of the best match, got one";
        errors.push(Fault::new("/alignment", detail));
    }
    elastic_fields(asked != Some(false), &given, fields, errors)
}

/// Settings of elastic distances if they are asked for; `given` fields belong to them alone.
fn elastic_fields(
    is_elastic: bool,
    given: &[(&str, bool)],
    fields: ElasticFields,
    errors: &mut Vec<Fault>,
) -> Option<ElasticSettings> {
    if !is_elastic {
        let misplaced = given.iter().filter(|(_, given)| *given);
        errors.extend(misplaced.map(|(field, _)| {
            Fault::new(*field, "expected no value unless the correspondence is \"elastic\", got one")
        }));
        return None;
    }
    let settings = fields.take(errors);
    match settings.checked() {
        Err(AnalysisError::Parameter { field, detail }) => {
            errors.push(Fault::new(format!("/{field}"), detail))
        }
        _ => return Some(settings),
    }
    None
}

/// Fields that are missing, or that do not apply to the way in which shapes are given; `converts`: whether a conversion of posted points
/// is given.
fn misplaced(request: &DistancesRequest, converts: bool) -> Vec<Fault> {
    let (posted, stored) = (request.shapes.is_some(), request.cohort.is_some());
    if posted == stored {
        return vec![Fault::new("", "expected either shapes with their representation, or a cohort")];
    }
    let of_posted = [
        ("/representation", request.representation.is_some()),
        ("/correspondence", converts),
        ("/direction", request.direction.is_some()),
    ];
    let of_cohort = [("/filter", request.filter.is_some()), ("/ids", request.ids.is_some())];
    let mut errors = Vec::new();
    for (field, given) in if stored { of_posted.as_slice() } else { &of_cohort } {
        if *given {
            let detail = if stored {
                "expected no value with a cohort, which has its own"
            } else {
                "this field belongs to a cohort"
            };
            errors.push(Fault::new(*field, detail));
        }
    }
    if posted && request.representation.is_none() {
        errors.push(Fault::new("/representation", "required field is missing"));
    }
    if stored && request.filter.is_some() && request.ids.is_some() {
        errors.push(Fault::new("/ids", "expected either ids or filter, got both"));
    }
    errors
}

/// Returns the matrix, the lines or the file that a job has computed.
///
/// Jobs of the kind `distances` give a matrix, those of the kind `assess` one line per shape, sent as they are read, those of the kind
/// `segment` the picture or the volume of labels that was asked for; predictions of those of the kind `model` are asked
/// for at `/v1/models/{job}/predictions`. Outputs are kept as long as their job; if together they exceed 2 GiB, only
/// the newest are kept.
#[utoipa::path(get, path = "/v1/jobs/{job}/output", tag = "jobs",
    params(
        ("job" = String, Path, description = "Id"),
        ("format" = Option<String>, Query, description = "`json`, `csv`, `npy`, `arrow` or `parquet` of a matrix, `ndjson` of lines; `svg`, `png` or `nifti` as the segmentation was asked for")
    ),
    responses(
        (status = 200, description = "The matrix, the lines or the file", content((DistancesAnswer = "application/json"), (String = "text/csv"), (Binary = "application/x-npy"), (Binary = "application/vnd.apache.arrow.stream"), (Binary = "application/vnd.apache.parquet"), (CohortAssessment = "application/x-ndjson"), (String = "image/svg+xml"), (Binary = "image/png"), (Binary = "application/x-nifti"))),
        (status = 404, description = "No such job, or the job has no output (not yet, none at all, or no longer)")
    ))]
pub(in crate::api::v1) async fn job_output(
    Caller(app): Caller,
    format: OutputFormat,
    Path(id): Path<String>,
) -> Result<Response, Problem> {
    let (output, _room) = jobs::output(&app, &id).await?;
    if output.is_model() {
        return Err(ServiceError::NotFound { kind: "output of the job", key: id }.into());
    }
    if let Some(parts) = output.parts() {
        format.check_lines()?;
        return Ok(stored_lines(app, id, parts));
    }
    if let Some(media_type) = output.media_type().map(str::to_owned) {
        format.check_file(&media_type)?;
        return Ok(segment::file(media_type, output.data));
    }
    let matrix = distances::read_output(&app, output).await?;
    Ok(respond::matrix(&app, matrix, format.of_matrix()?)?)
}
