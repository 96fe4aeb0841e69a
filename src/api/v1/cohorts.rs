//! Cohorts and their mean.

use std::collections::BTreeMap;

use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};

use super::settings::{MeanOutput, Page, PageQuery, time};
use crate::analysis::alignment::Alignment;
use crate::analysis::correspondence::{Correspondence, Direction, Mirror};
use crate::analysis::frame::Frame;
use crate::analysis::transformation::ClassName;
use crate::api::extract::{Format, JsonBody, Path, Query, parse};
use crate::api::problem::{Problem, ProblemDocument, ProblemKind};
use crate::api::respond::{compute, json, svg};
use crate::domain::cohort::Cohort;
use crate::domain::shape::ShapeFilter;
use crate::formats::checked::Checked;
use crate::formats::representation::CheckedRepresentation;
use crate::geometry::representation::Representation;
use crate::service::cohorts::{self, NewCohort};
use crate::service::compute::draw_mean;
use crate::service::live_mean::{self, MeanQuery};
use crate::service::{App, ServiceError};

/// A cohort to be created.
#[derive(Debug, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct CohortRequest {
    /// Unique name: letters, digits, '.', '_' and '-', at most 100.
    #[schema(example = "nuclei-2026")]
    name: String,
    /// Free text.
    description: Option<String>,
    /// What its shapes are made of.
    #[schema(value_type = Representation)]
    representation: CheckedRepresentation,
    /// How points correspond; `landmarks` unless given.
    #[serde(default)]
    #[schema(value_type = Correspondence)]
    correspondence: Checked<Correspondence>,
    /// Whether the direction of contours means something; `given` unless given.
    #[serde(default)]
    #[schema(value_type = Direction)]
    direction: Checked<Direction>,
    /// Whether mirror images may be matched; `forbid` unless given.
    #[serde(default)]
    #[schema(value_type = Mirror)]
    mirror: Checked<Mirror>,
    /// Unit of the coordinates.
    #[schema(example = "mm")]
    length_unit: Option<String>,
}

/// A cohort.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct CohortOutput {
    /// Identifier.
    #[schema(example = "coh_0198c0ffee00700080000000000000aa")]
    id: String,
    /// Name, usable in place of the identifier.
    name: String,
    /// Free text.
    description: Option<String>,
    /// What its shapes are made of.
    representation: Representation,
    /// How points correspond.
    correspondence: Correspondence,
    /// Whether the direction of contours means something.
    direction: Direction,
    /// Whether mirror images may be matched.
    mirror: Mirror,
    /// Unit of the coordinates.
    length_unit: Option<String>,
    /// Number of changes so far.
    revision: u64,
    /// Number of shapes.
    shapes: u64,
    /// RFC 3339 UTC.
    created_at: String,
    /// RFC 3339 UTC.
    updated_at: String,
}

impl From<Cohort> for CohortOutput {
    fn from(cohort: Cohort) -> Self {
        Self {
            id: cohort.id,
            name: cohort.name,
            description: cohort.description,
            representation: cohort.representation,
            correspondence: cohort.correspondence,
            direction: cohort.direction,
            mirror: cohort.mirror,
            length_unit: cohort.length_unit,
            revision: cohort.revision,
            shapes: cohort.shapes,
            created_at: time(cohort.created_at_ms),
            updated_at: time(cohort.updated_at_ms),
        }
    }
}

fn revision_tag(cohort: &Cohort) -> String {
    format!("\"{}-{}\"", cohort.id, cohort.revision)
}

fn tagged(mut response: Response, tag: &str) -> Response {
    if let Ok(value) = HeaderValue::from_str(tag) {
        response.headers_mut().insert(header::ETAG, value);
    }
    response
}

/// Whether the client has this version already.
fn known(headers: &HeaderMap, tag: &str) -> bool {
    let values = headers.get_all(header::IF_NONE_MATCH).iter().filter_map(|value| value.to_str().ok());
    values.flat_map(|value| value.split(',')).any(|value| matches!(value.trim(), "*") || value.trim() == tag)
}

/// Creates a cohort.
#[utoipa::path(post, path = "/cohorts", tag = "cohorts", request_body = CohortRequest,
    responses(
        (status = 201, description = "Created", body = CohortOutput, headers(("Location" = String))),
        (status = 409, description = "The name is taken", body = ProblemDocument, content_type = "application/problem+json"),
        (status = "4XX", description = "The input was refused", body = ProblemDocument, content_type = "application/problem+json")
    ))]
pub(super) async fn create_cohort(
    State(app): State<App>,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    let request: CohortRequest = parse(&body)?;
    let mut errors = Vec::new();
    let representation = request.representation.take("/representation", &mut errors);
    let correspondence = request.correspondence.take("/correspondence", &mut errors);
    let direction = request.direction.take("/direction", &mut errors);
    let mirror = request.mirror.take("/mirror", &mut errors);
    let (Some(representation), Some(correspondence), Some(direction), Some(mirror)) =
        (representation, correspondence, direction, mirror)
    else {
        return Err(ServiceError::below(errors, "").into());
    };
    let CohortRequest { name, description, length_unit, .. } = request;
    let new = NewCohort { name, description, representation, correspondence, direction, mirror, length_unit };
    let cohort = cohorts::create(&app, new).await?;
    let (tag, location) = (revision_tag(&cohort), format!("/v1/cohorts/{}", cohort.id));
    let response = json(StatusCode::CREATED, &CohortOutput::from(cohort))?;
    Ok(tagged(([(header::LOCATION, location)], response).into_response(), &tag))
}

/// Lists cohorts in the order of their creation.
#[utoipa::path(get, path = "/cohorts", tag = "cohorts", params(PageQuery),
    responses(
        (status = 200, description = "A page of cohorts", body = Page<CohortOutput>),
        (status = 400, description = "The query was refused", body = ProblemDocument, content_type = "application/problem+json")
    ))]
pub(super) async fn list_cohorts(
    State(app): State<App>,
    Query(page): Query<PageQuery>,
) -> Result<Response, Problem> {
    let (items, next) = cohorts::list(&app, page.cursor.as_deref(), page.limit()?).await?;
    let items: Vec<CohortOutput> = items.into_iter().map(Into::into).collect();
    Ok(json(StatusCode::OK, &Page { items, next })?)
}

/// Reads a cohort by id or name.
#[utoipa::path(get, path = "/cohorts/{cohort}", tag = "cohorts", params(("cohort" = String, Path, description = "Id or name")),
    responses(
        (status = 200, description = "The cohort; its ETag changes with its revision", body = CohortOutput),
        (status = 304, description = "Unchanged since the version in If-None-Match"),
        (status = 404, description = "No such cohort", body = ProblemDocument, content_type = "application/problem+json")
    ))]
pub(super) async fn find_cohort(
    State(app): State<App>,
    Path(key): Path<String>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let cohort = cohorts::find(&app, &key).await?;
    let tag = revision_tag(&cohort);
    if known(&headers, &tag) {
        return Ok(tagged(StatusCode::NOT_MODIFIED.into_response(), &tag));
    }
    Ok(tagged(json(StatusCode::OK, &CohortOutput::from(cohort))?, &tag))
}

/// Deletes a cohort with all its shapes, for good.
#[utoipa::path(delete, path = "/cohorts/{cohort}", tag = "cohorts", params(("cohort" = String, Path, description = "Id or name")),
    responses(
        (status = 204, description = "Deleted"),
        (status = 404, description = "No such cohort", body = ProblemDocument, content_type = "application/problem+json")
    ))]
pub(super) async fn delete_cohort(
    State(app): State<App>,
    Path(key): Path<String>,
) -> Result<StatusCode, Problem> {
    cohorts::delete(&app, &key).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// The parameters of a query by name, each at most once.
pub(super) type Parameters = BTreeMap<String, String>;

/// Takes the shape filter out of `parameters`: `label`, `subject` and `labels.{attribute}`.
pub(super) fn take_filter(parameters: &mut Parameters) -> ShapeFilter {
    let attributes: Vec<String> =
        parameters.keys().filter(|key| key.starts_with("labels.")).cloned().collect();
    let labels = attributes.into_iter().filter_map(|key| {
        let value = parameters.remove(&key)?;
        Some((key["labels.".len()..].to_owned(), value))
    });
    let labels = labels.collect();
    ShapeFilter { label: parameters.remove("label"), subject: parameters.remove("subject"), labels }
}

/// Takes one parameter that is one of a list of words.
fn take_word<T: serde::de::DeserializeOwned>(
    parameters: &mut Parameters,
    name: &str,
) -> Result<Option<T>, Problem> {
    let Some(word) = parameters.remove(name) else { return Ok(None) };
    serde_json::from_value(word.into())
        .map(Some)
        .map_err(|error| Problem::new(ProblemKind::InvalidQuery, format!("{name}: {error}")))
}

/// Refuses parameters that nobody took: a misspelt filter must not be passed over.
pub(super) fn refuse_rest(parameters: &Parameters) -> Result<(), Problem> {
    match parameters.keys().next() {
        None => Ok(()),
        Some(key) => {
            Err(Problem::new(ProblemKind::InvalidQuery, format!("'{key}' is not a parameter of this route")))
        }
    }
}

/// The mean of a cohort.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct CohortMeanOutput {
    #[serde(flatten)]
    mean: MeanOutput,
    /// Revision of the cohort that was averaged.
    revision: u64,
}

/// The mean of a cohort's shapes at its present revision.
///
/// The ETag changes with the revision and the query: `If-None-Match` saves the work. As SVG: the mean with some of the
/// aligned shapes behind it.
#[utoipa::path(get, path = "/cohorts/{cohort}/mean", tag = "cohorts",
    params(
        ("cohort" = String, Path, description = "Id or name"),
        ("transformation" = ClassName, Query, description = "The class that is removed"),
        ("alignment" = Option<Alignment>, Query, description = "`projection` unless given"),
        ("frame" = Option<Frame>, Query, description = "`training` unless given"),
        ("label" = Option<String>, Query, description = "Only shapes with this label"),
        ("subject" = Option<String>, Query, description = "Only shapes of this subject"),
        ("labels.{attribute}" = Option<String>, Query, description = "Only shapes whose attribute has this value"),
        ("format" = Option<String>, Query, description = "`json` or `svg`")
    ),
    responses(
        (status = 200, description = "The mean", content((CohortMeanOutput = "application/json"), (String = "image/svg+xml"))),
        (status = 304, description = "Unchanged since the version in If-None-Match"),
        (status = 404, description = "No such cohort", body = ProblemDocument, content_type = "application/problem+json"),
        (status = "4XX", description = "The query was refused, or the shapes have no mean", body = ProblemDocument, content_type = "application/problem+json")
    ))]
pub(super) async fn cohort_mean(
    State(app): State<App>,
    Path(key): Path<String>,
    format: Format,
    Query(mut parameters): Query<Parameters>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    parameters.remove("format");
    let transformation = take_word::<ClassName>(&mut parameters, "transformation")?.ok_or_else(|| {
        Problem::new(ProblemKind::InvalidQuery, "transformation is missing, such as similarity or affine")
    })?;
    let query = MeanQuery {
        transformation,
        alignment: take_word(&mut parameters, "alignment")?.unwrap_or_default(),
        frame: take_word(&mut parameters, "frame")?.unwrap_or_default(),
        filter: take_filter(&mut parameters),
    };
    refuse_rest(&parameters)?;
    let cohort = cohorts::find(&app, &key).await?;
    let what = blake3::hash(format!("{}{query:?}{format:?}", revision_tag(&cohort)).as_bytes()).to_hex();
    let tag = format!("\"{}\"", &what[..32]);
    if known(&headers, &tag) {
        return Ok(tagged(StatusCode::NOT_MODIFIED.into_response(), &tag));
    }
    let live = live_mean::mean(&app, cohort, query).await?;
    let response = compute(app, move |_| match format {
        Format::Svg => {
            let title = format!("mean of {} shapes of {}", live.mean.shapes, live.cohort.name);
            Ok(svg(draw_mean(&live.setup, &title, &live.mean, &live.drawn)))
        }
        Format::Json => {
            let mean = MeanOutput::new(&live.mean, live.setup.metric.dimension());
            json(StatusCode::OK, &CohortMeanOutput { mean, revision: live.cohort.revision })
        }
    })
    .await?;
    Ok(tagged(response, &tag))
}
