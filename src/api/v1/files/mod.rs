//! Files of other programs: their content, their conversion, answers that are files.
//!
//! A file is the body of a request: with the media type of its format, with any media type beside the parameter `format`, or with
//! one that no format has beside the file name `name`.

pub(in crate::api) mod formats;
pub(in crate::api) mod previews;
pub(in crate::api) mod series;

use std::collections::BTreeMap;

use axum::body::{Body, Bytes};
use axum::extract::Request;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use futures_util::stream::{self, BoxStream, StreamExt};
use serde::Serialize;
use tokio::sync::mpsc;
use tokio_util::task::AbortOnDropHandle;
use utoipa::{IntoParams, ToSchema};

use crate::api::body;
use crate::api::extract::{Caller, Query, TWICE, unknown_parameter};
use crate::api::form;
use crate::api::media_type::{is_form, media_type};
use crate::api::operation::ANY_FILE;
use crate::api::problem::Problem;
use crate::api::respond::{json, streamed};
#[cfg(feature = "schema")]
use crate::api::v1::cohorts::shapes::AddQuery;
#[cfg(feature = "schema")]
use crate::api::v1::files::previews::PreviewQuery;
use crate::api::v1::files::previews::{CohortPreview, preview};
#[cfg(feature = "schema")]
use crate::api::v1::files::series::ConvertForm;
use crate::api::v1::files::series::SeriesRequest;
#[cfg(feature = "schema")]
use crate::api::v1::requests::described::*;
#[cfg(feature = "schema")]
use crate::api::v1::requests::file_parameters::written_formats;
use crate::api::v1::requests::file_parameters::{FileParameters, written};
use crate::service::app::outgoing::{Arriving, BodyWriter};
use crate::service::app::{App, ServiceError};
use crate::service::files::proposal::{Proposal, USUAL_TOLERANCE, check_tolerance};
use crate::service::files::translate::{self, FileReading};
use crate::wire::files::{self, Group, Inspection, WriteOptions};
use crate::wire::summary::FileSummary;

/// Format of files that refer to a series of images.
const STRUCTURES: &str = "rtstruct";
/// Number of bytes of an answer that are kept until it is known that all of it can be written.
const KEPT: usize = 1 << 20;

/// Content of a file.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct InspectAnswer {
    /// Account of its reader.
    #[serde(flatten)]
    file: FileSummary,
    /// Its shapes by kind and dimension.
    groups: Vec<FileGroup>,
    /// Number of shapes by class label, of the first 100 labels.
    labels: BTreeMap<String, u64>,
    /// Number of shapes by the names of their attributes, of the first 100 names.
    attributes: BTreeMap<String, u64>,
    /// Numbers of control points for its curves and meshes; absent where it has none.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    #[schema(required = false)]
    proposals: Vec<Proposal>,
    /// Effect that an upload to the cohort would have, if one is named.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(required = false)]
    cohort: Option<CohortPreview>,
}

/// How numbers of control points are proposed.
#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code, reason = "only for the document; the handler reads it")]
pub(super) struct ProposalQuery {
    /// Root mean square distance that proposed control points may leave, as a part of the size of a shape, 0.0001 to 0.5. Default: 0.01.
    #[param(minimum = 0.0001, maximum = 0.5)]
    tolerance: Option<f64>,
}

/// Shapes of a file of one kind and one dimension.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct FileGroup {
    /// Kind: `curve`, `landmarks`, `mesh` or `fourier`.
    #[schema(example = "curve")]
    kind: &'static str,
    /// Number of coordinates of a point.
    dimension: usize,
    /// Number of them.
    records: u64,
    /// Least and largest number of points, vertices or harmonics.
    points: [usize; 2],
    /// Least and largest number of faces of meshes.
    faces: [usize; 2],
    /// Number of closed curves.
    closed: u64,
    /// Number of rings that bound holes.
    holes: u64,
    /// Number of shapes with missing points.
    incomplete: u64,
    /// Names of the first ones.
    names: Vec<String>,
    /// Least coordinates; empty without points.
    lower: Vec<f64>,
    /// Largest coordinates; empty without points.
    upper: Vec<f64>,
}

impl From<Group> for FileGroup {
    fn from(group: Group) -> Self {
        let Group { kind, dimension, records, points, faces, closed, holes, incomplete, names, lower, upper } =
            group;
        let names = names.into_iter().map(crate::wire::fault::brief).collect();
        let kind = kind.name();
        Self { kind, dimension, records, points, faces, closed, holes, incomplete, names, lower, upper }
    }
}

/// Lists the content of a file, without storing it.
///
/// The shapes that an upload would take by kind, with their names, boxes and labels, and the items that it would leave
/// out; and numbers of control points that represent its curves and meshes within a tolerance, with the error that they
/// leave. The file is the body of the request, with the media type of its format or as `application/octet-stream`.
///
/// With `cohort`, the file is looked at against that cohort: `cohort` of the answer tells the effect of
/// `POST /v1/cohorts/{cohort}/shapes` with the same file and the same parameters at this revision, how many shapes it
/// would add, which of them are there already, which it would refuse and why, and `units` to which unit their
/// coordinates would be converted. All parameters of an upload are taken, and nothing is stored. A file that no upload
/// can read, and one whose unit does not fit, is refused as the upload is. `on_error` and the parameters from `plane`
/// on need `cohort`; `tolerance` is refused beside it, as the cohort has its representation.
#[utoipa::path(post, path = "/v1/inspect", tag = "files",
    params(PreviewQuery, FileQuery, ReadQuery, ProposalQuery, AddQuery, PlacingQuery),
    request_body(content((Binary = "application/octet-stream", example = json!("{\"points\": [[0, 0], [5, 1], [1, 3]], \"closed\": true}\n")))),
    responses(
        (status = 200, description = "Content of the file, and the effect of an upload of it", body = InspectAnswer),
        (status = 404, description = "No such cohort"),
        (status = 409, description = "A file that cannot be read to its end, after an external id that belongs to another shape of the cohort"),
        (status = 412, description = "The cohort has changed while the file was looked at")))]
pub(super) async fn inspect_file(
    Caller(app): Caller,
    Query(mut pairs): Query<Vec<(String, String)>>,
    request: Request,
) -> Result<Response, Problem> {
    let mut parameters = FileParameters::take(&mut pairs);
    let (file, found, proposals, cohort) = match take_once(&mut pairs, "cohort")? {
        Some(key) => {
            let (file, found, cohort) = preview(&app, &key, parameters, &pairs, request).await?;
            (file, found, Vec::new(), Some(cohort))
        }
        None => {
            let tolerance = take_tolerance(&mut pairs)?;
            refuse_rest(&pairs)?;
            let reading = parameters.reading(&media_type(request.headers()))?;
            let stream = body::pieces(request.into_body());
            let (file, found, first) = translate::inspect(&app, stream, reading).await?;
            (file, found, first.propose(&app, tolerance).await?, None)
        }
    };
    let Inspection { groups, labels, attributes } = found;
    let groups = groups.into_iter().map(FileGroup::from).collect();
    let answer = InspectAnswer { file, groups, labels, attributes, proposals, cohort };
    Ok(json(StatusCode::OK, &answer)?)
}

/// Takes the value of a parameter out of `pairs`.
fn take_once(pairs: &mut Vec<(String, String)>, wanted: &str) -> Result<Option<String>, Problem> {
    let (mut taken, rest): (Vec<_>, Vec<_>) =
        std::mem::take(pairs).into_iter().partition(|(name, _)| name == wanted);
    *pairs = rest;
    match (taken.pop(), taken.is_empty()) {
        (found, true) => Ok(found.map(|(_, value)| value)),
        (_, false) => Err(Problem::of_parameter(wanted, TWICE)),
    }
}

/// Takes the tolerance of proposals out of `pairs`.
fn take_tolerance(pairs: &mut Vec<(String, String)>) -> Result<f64, Problem> {
    let Some(text) = take_once(pairs, "tolerance")? else { return Ok(USUAL_TOLERANCE) };
    let number = text.parse::<f64>();
    let wrong = |_| Problem::of_parameter("tolerance", format!("expected a number, got '{text}'"));
    let number = number.map_err(wrong)?;
    check_tolerance(number)?;
    Ok(number)
}

fn refuse_rest(pairs: &[(String, String)]) -> Result<(), Problem> {
    match pairs.first() {
        Some((name, _)) => Err(unknown_parameter(name)),
        None => Ok(()),
    }
}

/// Format of an answer.
#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code, reason = "only for the document")]
pub(super) struct ToQuery {
    /// Format to write, as an id, a media type or an ending. Default: `ndjson`; of a form, `rtstruct`.
    #[param(example = "ndjson")]
    to: Option<String>,
}

/// Translates a file, without storing it.
///
/// The answer is written while the file arrives. A fault within the first MiB of the answer is a problem document; a later one
/// breaks the connection off. `POST /v1/inspect` lists the content that the formats leave out. A DICOM structure set
/// (`to=rtstruct`) refers to the images of a series: the body is a form with the part `parameters`, which lists them,
/// and the part `file`.
#[utoipa::path(post, path = "/v1/convert", tag = "files",
    params(ToQuery, FileQuery, ReadQuery, WriteQuery),
    request_body(content(
        (Binary = "application/octet-stream", example = json!("{\"points\": [[0, 0], [5, 1], [1, 3]], \"closed\": true}\n")),
        (ConvertForm = "multipart/form-data"))),
    responses((status = 200, description = "The file", content((Binary = "application/octet-stream"), (Binary = "application/x-ndjson")))))]
pub(super) async fn convert_file(
    Caller(app): Caller,
    Query(mut pairs): Query<Vec<(String, String)>>,
    request: Request,
) -> Result<Response, Problem> {
    let mut parameters = FileParameters::take(&mut pairs);
    let media_type = media_type(request.headers());
    let is_form = is_form(&media_type);
    let format = take_target(&mut pairs, is_form)?;
    refuse_rest(&pairs)?;
    let mut options = parameters.writing()?;
    let reading = parameters.reading(if is_form { ANY_FILE } else { &media_type })?;
    if !is_form {
        let (stream, arriving) = Arriving::of(body::pieces(request.into_body()));
        return converted(app, stream.boxed(), arriving, reading, format, options).await;
    }
    let form = form::read(&app, request, &["file"]).await?;
    let file = stream::iter([Ok(form.required("file")?)]).boxed();
    options.series = app.read::<SeriesRequest>(form.parameters).await?.images()?;
    check_series(format, &options)?;
    converted(app, file, Arriving::default(), reading, format, options).await
}

/// Answers with a file in another format.
async fn converted(
    app: App,
    stream: BoxStream<'static, Result<Bytes, ServiceError>>,
    arriving: Arriving,
    reading: FileReading,
    format: &'static files::Format,
    options: WriteOptions,
) -> Result<Response, Problem> {
    let (output, pieces) = BodyWriter::during(arriving);
    let work =
        async move { translate::translate(&app, stream, reading, format, options, output).await.map(drop) };
    answer(format, None, pieces, work).await
}

/// Refuses a series that the format cannot refer to, before the file is read.
fn check_series(format: &'static files::Format, options: &WriteOptions) -> Result<(), ServiceError> {
    if format.id != STRUCTURES {
        let detail = format!("expected {STRUCTURES}, which refers to a series, got '{}'", format.id);
        return Err(ServiceError::parameter("to", detail));
    }
    match format.writer(std::io::sink(), options) {
        Ok(_) => Ok(()),
        Err(error) => Err(ServiceError::invalid("/series", error.detail)),
    }
}

/// Takes the format that is to be written; a form can list the images of a series.
fn take_target(pairs: &mut Vec<(String, String)>, is_form: bool) -> Result<&'static files::Format, Problem> {
    let format = match pairs.iter().position(|(name, _)| name == "to") {
        Some(at) => written(&pairs.remove(at).1, "to")?,
        None => written(if is_form { STRUCTURES } else { "ndjson" }, "to")?,
    };
    if !is_form {
        refuse_series(format, "to")?;
    }
    Ok(format)
}

/// Refuses a format that refers to the images of a series, where a request has no place for them.
pub(super) fn refuse_series(format: &files::Format, parameter: &str) -> Result<(), Problem> {
    if format.id != STRUCTURES {
        return Ok(());
    }
    let detail = format!(
        "expected a format that does not refer to the images of a series, got {STRUCTURES}: POST /v1/convert writes it from a \
         form with the part `parameters`, which lists the images, and the part `file`"
    );
    Err(Problem::of_parameter(parameter, detail))
}

/// Answers with a file that `work` writes. Its beginning is kept, so that an early fault is answered as such.
pub(super) async fn answer(
    format: &'static files::Format,
    name: Option<String>,
    mut pieces: mpsc::Receiver<Bytes>,
    work: impl Future<Output = Result<(), ServiceError>> + Send + 'static,
) -> Result<Response, Problem> {
    let work = AbortOnDropHandle::new(tokio::spawn(work));
    let (mut first, mut kept) = (Vec::new(), 0);
    let mut has_ended = false;
    while kept < KEPT {
        let Some(piece) = pieces.recv().await else {
            has_ended = true;
            break;
        };
        kept += piece.len();
        first.push(piece);
    }
    let media_type = format.media_types.first().copied().unwrap_or(ANY_FILE);
    let body = if has_ended {
        finished(work.await)?;
        Body::from(first.concat())
    } else {
        let rest = stream::unfold(Some((pieces, work)), |state| async move {
            let (mut pieces, work) = state?;
            match pieces.recv().await {
                Some(piece) => Some((Ok(piece), Some((pieces, work)))),
                None => finished(work.await).err().map(|error| {
                    tracing::warn!(error = error.cause(), "a file breaks off");
                    (Err(std::io::Error::other(error.to_string())), None)
                }),
            }
        });
        streamed(stream::iter(first.into_iter().map(Ok)).chain(rest))
    };
    let mut response = ([(header::CONTENT_TYPE, media_type)], body).into_response();
    if let Some(disposition) = name.and_then(|name| format!("attachment; filename=\"{name}\"").parse().ok()) {
        response.headers_mut().insert(header::CONTENT_DISPOSITION, disposition);
    }
    Ok(response)
}

fn finished(work: Result<Result<(), ServiceError>, tokio::task::JoinError>) -> Result<(), ServiceError> {
    work.unwrap_or_else(|error| Err(ServiceError::Internal(format!("the task that writes a file: {error}"))))
}

/// Media types of the formats that are written.
#[cfg(feature = "schema")]
pub(in crate::api) fn written_media_types() -> impl Iterator<Item = &'static str> {
    written_formats().filter_map(|format| format.media_types.first().copied())
}
