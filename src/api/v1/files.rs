//! Files of other programs: what is in them, the same in another format, cohorts as files.
//!
//! A file is the body of a request: with the media type of its format, with any media type beside the parameter `format`, or with
//! one that no format has beside the file name `name`.

use std::collections::BTreeMap;

use axum::body::{Body, Bytes};
use axum::extract::Request;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use futures_util::future::Either;
use futures_util::stream;
use serde::Serialize;
use tokio::sync::mpsc;
use tokio_util::task::AbortOnDropHandle;
use utoipa::openapi::RefOr;
use utoipa::openapi::path::{Operation, Parameter, ParameterIn};
use utoipa::{IntoParams, ToSchema};

use super::entity_tags::not_stored;
use super::series::{ConvertForm, SeriesRequest};
use super::shape_query::{FilterQuery, Parameters};
use crate::api::body;
use crate::api::document::text_parameter;
use crate::api::extract::{ANYTHING, Caller, Path, Query, accepted, media_type, preferred};
use crate::api::form;
use crate::api::problem::{Problem, ProblemKind};
use crate::api::respond::{Binary, json};
use crate::domain::cohort::Cohort;
use crate::domain::filter::ShapeFilter;
use crate::domain::shape::Shape;
use crate::formats::files::{self, Group, Inspection, ReadOptions, WriteOptions};
use crate::formats::record::{MAX_SAMPLES, Placing, Plane};
use crate::formats::summary::FileSummary;
use crate::formats::words::plain_sentence;
use crate::service::app::outgoing::BodyWriter;
use crate::service::app::{App, Limits, ServiceError};
use crate::service::cohorts::catalogue;
use crate::service::cohorts::upload_file::FileToAdd;
use crate::service::files::export::{self, ExportContent, ShapeFile, USUAL_POINTS};
use crate::service::files::translate::{self, FileReading};
use crate::service::files::{FileFormat, file_limits, unknown_format};

/// Media type that says nothing of a file.
const ANY_FILE: &str = "application/octet-stream";
/// Format of files that refer to a series of images.
const STRUCTURES: &str = "rtstruct";
/// Answers that are no files.
const JSON: OtherFormat = OtherFormat { id: "json", media_type: "application/json" };
/// Number of bytes of an answer that are kept until it is known that all of it can be written.
const KEPT: usize = 1 << 20;

/// What an operation answers beside files.
#[derive(Debug, Clone, Copy)]
struct OtherFormat {
    id: &'static str,
    media_type: &'static str,
}

/// Parameters of files.
#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code, reason = "only for the document; `FileParameters` reads them")]
pub(super) struct FileQuery {
    /// Format of the file, as an id, a media type or an ending. Default: the media type of the request, else by the first
    /// bytes, else by the name.
    format: Option<String>,
    /// Name of the file, by which its format is known where its bytes do not tell it.
    name: Option<String>,
}

/// How records of a file become shapes of a cohort.
#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code, reason = "only for the document; `FileParameters` reads them")]
pub(super) struct PlacingQuery {
    /// Plane onto which curves and points in space are projected, where the cohort is planar. Default: they are refused.
    #[param(inline)]
    plane: Option<Plane>,
    /// Number of points at which curves given by Fourier coefficients are taken, where the representation of the cohort does
    /// not contain them. Default: they are refused.
    #[param(minimum = 3, maximum = 10_000)]
    samples: Option<usize>,
    /// Text before the names of the shapes, which become their external ids.
    prefix: Option<String>,
}

/// Options of reading by name, with the formats that have them.
pub(super) struct ReadQuery;

impl IntoParams for ReadQuery {
    fn into_params(_: impl Fn() -> Option<ParameterIn>) -> Vec<Parameter> {
        let of = |name: &str| {
            let formats = FileFormat::all().filter(|format| format.options().contains(&name));
            let formats = formats.map(FileFormat::id).collect::<Vec<_>>().join(", ");
            text_parameter(name, format!("Option of reading files of the formats {formats}."))
        };
        names_of(&ReadOptions::default()).iter().map(|name| of(name)).collect()
    }
}

/// Options of writing by name.
pub(super) struct WriteQuery;

impl IntoParams for WriteQuery {
    fn into_params(_: impl Fn() -> Option<ParameterIn>) -> Vec<Parameter> {
        let said = "Option of the format that is written.";
        let of = |name: &String| text_parameter(&format!("{WRITE}{name}"), said);
        names_of(&WriteOptions::default()).iter().map(of).collect()
    }
}

/// What stands before the names of options of writing.
const WRITE: &str = "write_";

/// Names of options.
fn names_of(options: &impl Serialize) -> Vec<String> {
    let options = serde_json::to_value(options).unwrap_or_default();
    options.as_object().into_iter().flatten().map(|(name, _)| name.clone()).collect()
}

/// Parameters of a request with a file.
#[derive(Debug)]
pub(super) struct FileParameters(Vec<(String, String)>);

impl FileParameters {
    /// Takes the parameters that concern files from `pairs`, and leaves the others.
    pub(super) fn take(pairs: &mut Vec<(String, String)>) -> Self {
        let known = names_of(&ReadOptions::default());
        let own = ["format", "name", "plane", "samples", "prefix"];
        let is_own = |name: &str| {
            own.contains(&name) || name.starts_with(WRITE) || known.iter().any(|known| known == name)
        };
        let (taken, rest) = std::mem::take(pairs).into_iter().partition(|(name, _)| is_own(name));
        *pairs = rest;
        Self(taken)
    }

    /// Whether they say the format, whatever the media type.
    pub(super) fn is_format_stated(&self) -> bool {
        self.0.iter().any(|(name, _)| name == "format")
    }

    /// Whether there are none.
    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Name of the first one.
    pub(super) fn first(&self) -> &str {
        self.0.first().map_or("", |(name, _)| name)
    }

    /// Takes the value of one parameter.
    fn value(&mut self, name: &str) -> Result<Option<String>, Problem> {
        let Some(at) = self.0.iter().position(|(found, _)| found == name) else { return Ok(None) };
        let (_, value) = self.0.remove(at);
        match self.0.iter().any(|(found, _)| found == name) {
            true => Err(Problem::of_parameter(name, crate::api::extract::TWICE)),
            false => Ok(Some(value)),
        }
    }

    /// The options of writing.
    fn writing(&mut self) -> Result<WriteOptions, Problem> {
        let Self(writing) = take_writing(&mut self.0);
        let pairs = writing.iter().map(|(name, value)| (&name[WRITE.len()..], value.as_str()));
        WriteOptions::from_pairs(pairs).map_err(|mut error| {
            if let Some(name) = &mut error.place.tag {
                name.insert_str(0, WRITE);
            }
            ServiceError::from(error).into()
        })
    }

    /// How a file is read whose request has a media type.
    ///
    /// # Errors
    /// An unknown format; a media type of none without the parameters that tell it.
    fn reading(&mut self, media_type: &str) -> Result<FileReading, Problem> {
        let (format, name) = (self.value("format")?, self.value("name")?);
        let found = match &format {
            Some(word) => {
                let format = FileFormat::find(word).filter(|format| format.is_read());
                Some(format.ok_or_else(|| Problem::of_parameter("format", unknown_format(word).detail))?)
            }
            None if media_type == ANY_FILE => None,
            None => {
                let mut named = FileFormat::of_media_type(media_type);
                match (named.next(), named.next()) {
                    (Some(format), None) => Some(format),
                    // Several formats: the first bytes tell.
                    (Some(_), Some(_)) => None,
                    // Programs send a type of their own where they know none of the file: curl that of a web form.
                    (None, _) if name.is_some() && !form::is_form(media_type) => None,
                    (None, _) => return Err(unsupported(media_type)),
                }
            }
        };
        let options = self.0.iter().map(|(name, value)| (name.as_str(), value.as_str()));
        let options = ReadOptions::from_pairs(options).map_err(ServiceError::from)?;
        Ok(FileReading { format: found, name, options })
    }

    /// The file that a request adds to a cohort.
    ///
    /// # Errors
    /// Parameters with values that they cannot have; as for the format.
    pub(super) fn into_file(mut self, media_type: &str, limits: &Limits) -> Result<FileToAdd, Problem> {
        let plane = self.value("plane")?.map(|word| word_of::<Plane>("plane", &word)).transpose()?;
        let samples =
            self.value("samples")?.map(|text| count_of("samples", &text, MAX_SAMPLES)).transpose()?;
        let prefix = self.value("prefix")?;
        let placing = Placing { plane, samples, prefix, metadata_bytes: limits.metadata_bytes };
        let reading = self.reading(media_type)?;
        let service = *limits;
        let read: crate::service::cohorts::upload_file::ReadFile = Box::new(move |source, stop, sink| {
            let format = reading.format_of(source.head())?;
            let summary = format.read(source, &reading.options, &service, stop, sink)?;
            Ok(FileSummary::new(format.id(), summary))
        });
        Ok(FileToAdd { limits: file_limits(limits), placing, read })
    }
}

/// Refusal of a body whose format is not known.
fn unsupported(media_type: &str) -> Problem {
    let known: Vec<&str> =
        FileFormat::all().filter_map(|format| format.media_types().first().copied()).collect();
    let detail = format!(
        "expected application/json for a document, or for a file a media type of a format ({}), application/octet-stream, or the parameter name, got '{media_type}'",
        known.join(", ")
    );
    Problem::new(ProblemKind::UnsupportedMediaType, detail)
}

pub(super) fn word_of<T: serde::de::DeserializeOwned>(name: &str, word: &str) -> Result<T, Problem> {
    let read = serde_json::from_value(word.into());
    read.map_err(|error: serde_json::Error| Problem::of_parameter(name, plain_sentence(&error.to_string())))
}

fn count_of(name: &str, text: &str, most: usize) -> Result<usize, Problem> {
    match text.parse() {
        Ok(count) if (3..=most).contains(&count) => Ok(count),
        _ => Err(Problem::of_parameter(
            name,
            format!("expected a whole number from 3 to {most}, got '{text}'"),
        )),
    }
}

/// What is in a file.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct InspectAnswer {
    /// What its reader says.
    #[serde(flatten)]
    file: FileSummary,
    /// Its shapes by kind and dimension.
    groups: Vec<FileGroup>,
    /// Number of shapes by class label, of the first 100 labels.
    labels: BTreeMap<String, u64>,
    /// Number of shapes by the names of their attributes, of the first 100 names.
    attributes: BTreeMap<String, u64>,
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
        let names = names.into_iter().map(crate::formats::fault::brief).collect();
        let kind = kind.name();
        Self { kind, dimension, records, points, faces, closed, holes, incomplete, names, lower, upper }
    }
}

/// Tells what is in a file, without storing it.
///
/// The shapes that an upload would take by kind, with their names, boxes and labels, and what it would leave out. The file is
/// the body of the request, with the media type of its format or as `application/octet-stream`.
#[utoipa::path(post, path = "/inspect", tag = "files",
    params(FileQuery, ReadQuery),
    request_body(content((Binary = "application/octet-stream", example = json!("{\"points\": [[0, 0], [5, 1], [1, 3]], \"closed\": true}\n")))),
    responses((status = 200, description = "What is in the file", body = InspectAnswer)))]
pub(super) async fn inspect_file(
    Caller(app): Caller,
    Query(mut pairs): Query<Vec<(String, String)>>,
    request: Request,
) -> Result<Response, Problem> {
    let mut parameters = FileParameters::take(&mut pairs);
    refuse_rest(&pairs)?;
    let reading = parameters.reading(&media_type(request.headers()))?;
    let (file, found) = translate::inspect(&app, body::pieces(request.into_body()), reading).await?;
    let Inspection { groups, labels, attributes } = found;
    let groups = groups.into_iter().map(FileGroup::from).collect();
    Ok(json(StatusCode::OK, &InspectAnswer { file, groups, labels, attributes })?)
}

fn refuse_rest(pairs: &[(String, String)]) -> Result<(), Problem> {
    match pairs.first() {
        Some((name, _)) => Err(crate::api::extract::unknown_parameter(name)),
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
/// breaks the connection off. What the formats leave out is told by `POST /v1/inspect`. A DICOM structure set (`to=rtstruct`)
/// refers to the images of a series: the body is a form with the part `parameters`, which lists them, and the part `file`.
#[utoipa::path(post, path = "/convert", tag = "files",
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
    let is_form = form::is_form(&media_type);
    let format = take_target(&mut pairs, if is_form { STRUCTURES } else { "ndjson" })?;
    refuse_rest(&pairs)?;
    let mut options = parameters.writing()?;
    let (reading, stream) = if is_form {
        let reading = parameters.reading(ANY_FILE)?;
        let form = form::read(&app, request, &["file"]).await?;
        let file = form.required("file")?;
        options.series = app.read::<SeriesRequest>(form.parameters).await?.images()?;
        check_series(format, &options)?;
        (reading, Either::Left(stream::iter([Ok(file)])))
    } else {
        (parameters.reading(&media_type)?, Either::Right(body::pieces(request.into_body())))
    };
    let (output, pieces) = BodyWriter::new();
    let work = async move { translate::translate(&app, stream, reading, format, options, output).await };
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

/// Takes the format that is to be written, by default the `usual` one.
fn take_target(pairs: &mut Vec<(String, String)>, usual: &str) -> Result<&'static files::Format, Problem> {
    match pairs.iter().position(|(name, _)| name == "to") {
        Some(at) => written(&pairs.remove(at).1, "to"),
        None => written(usual, "to"),
    }
}

/// The format that a word names, if it is written.
fn written(word: &str, parameter: &str) -> Result<&'static files::Format, Problem> {
    written_format(word).ok_or_else(|| unwritten(parameter, word, None))
}

/// The written format with an id, a media type or an ending.
fn written_format(word: &str) -> Option<&'static files::Format> {
    files::find(word).filter(|format| format.is_written())
}

/// All formats that are written.
fn written_formats() -> impl Iterator<Item = &'static files::Format> {
    files::FORMATS.iter().copied().filter(|format| format.is_written())
}

/// Refusal of a word that names no format among those that are written and perhaps another one.
fn unwritten(parameter: &str, word: &str, other: Option<&str>) -> Problem {
    let known: Vec<&str> = other.into_iter().chain(written_formats().map(|format| format.id)).collect();
    let known = known.join(", ");
    let detail = format!("expected one of the formats that are written ({known}), got '{word}'");
    Problem::of_parameter(parameter, detail)
}

/// Answers with a file that `work` writes. Its beginning is kept, so that an early fault is answered as such.
async fn answer(
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
        Body::from_stream(stream_of(first, rest))
    };
    let mut response = ([(header::CONTENT_TYPE, media_type)], body).into_response();
    if let Some(disposition) = name.and_then(|name| format!("attachment; filename=\"{name}\"").parse().ok()) {
        response.headers_mut().insert(header::CONTENT_DISPOSITION, disposition);
    }
    Ok(response)
}

/// The pieces that were kept, and those that follow.
fn stream_of(
    first: Vec<Bytes>,
    rest: impl stream::Stream<Item = Result<Bytes, std::io::Error>>,
) -> impl stream::Stream<Item = Result<Bytes, std::io::Error>> {
    use futures_util::StreamExt;
    stream::iter(first.into_iter().map(Ok)).chain(rest)
}

fn finished(work: Result<Result<(), ServiceError>, tokio::task::JoinError>) -> Result<(), ServiceError> {
    work.unwrap_or_else(|error| Err(ServiceError::Internal(format!("the task that writes a file: {error}"))))
}

/// What a file says of each shape.
#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code, reason = "only for the document; `Parameters` reads them")]
pub(super) struct ShapeFileQuery {
    /// Format of the file, as an id, a media type or an ending. Default: by the header `Accept`, else that of the operation:
    /// `ndjson` of an export, `json` of a list.
    #[param(example = "ndjson")]
    format: Option<String>,
    /// What a file says of each shape: `points` on curves, landmarks and meshes of surfaces, `control_points`, or Fourier
    /// coefficients (`fourier`) of closed curves, `write_harmonics` of them. Default: `points`.
    #[param(inline)]
    content: Option<ExportContent>,
    /// Number of points on a curve. Default: 128.
    #[param(minimum = 3, maximum = 10_000)]
    points: Option<usize>,
}

/// Writes all shapes of a cohort that pass a filter as a file.
///
/// In the order in which they were added, with their external ids (else ids), labels and metadata, all at the revision that the
/// cohort has when the request arrives. The answer is written while shapes are read: a fault within its first MiB is a problem
/// document, a later one breaks the connection off.
#[utoipa::path(get, path = "/cohorts/{cohort}/export", tag = "files",
    params(("cohort" = String, Path, description = "Id or name"), FilterQuery, ShapeFileQuery, WriteQuery),
    responses(
        (status = 200, description = "The file", content((Binary = "application/octet-stream"), (Binary = "application/x-ndjson"))),
        (status = 404, description = "No such cohort"),
        (status = "4XX", description = "The query was refused")
    ))]
pub(super) async fn export_cohort(
    Caller(app): Caller,
    Path(key): Path<String>,
    Query(pairs): Query<Vec<(String, String)>>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let (filter, file) = take_export(pairs, &headers)?;
    let (cohort, format) = (catalogue::find(&app, &key).await?, file.format);
    let ending = format.extensions.first().copied().unwrap_or(format.id);
    let name = format!("{}.{ending}", cohort.spec.name);
    let (output, pieces) = BodyWriter::new();
    let work = async move { export::export(&app, &cohort, filter, file, output).await.map(drop) };
    answer(format, Some(name), pieces, work).await.map(not_stored)
}

/// Takes the parameters of an export.
fn take_export(
    mut pairs: Vec<(String, String)>,
    headers: &HeaderMap,
) -> Result<(ShapeFilter, ShapeFile), Problem> {
    let writing = take_writing(&mut pairs);
    let mut parameters = Parameters::read(pairs)?;
    let format = match take_format(&mut parameters, headers, None)? {
        Some(format) => format,
        None => written("ndjson", "format")?,
    };
    let file = take_shape_file(format, writing, &mut parameters)?;
    let filter = parameters.take_filter();
    parameters.refuse_rest()?;
    Ok((filter, file))
}

/// Takes the options of writing from `pairs`, and leaves the others.
pub(super) fn take_writing(pairs: &mut Vec<(String, String)>) -> FileParameters {
    let (taken, rest) = std::mem::take(pairs).into_iter().partition(|(name, _)| name.starts_with(WRITE));
    *pairs = rest;
    FileParameters(taken)
}

/// Takes what a file of a format says of each shape.
fn take_shape_file(
    format: &'static files::Format,
    mut writing: FileParameters,
    parameters: &mut Parameters,
) -> Result<ShapeFile, Problem> {
    let options = writing.writing()?;
    let content = parameters.take_word("content")?.unwrap_or_default();
    let points = parameters.take("points").map(|text| count_of("points", &text, MAX_SAMPLES)).transpose()?;
    Ok(ShapeFile { format, options, content, points: points.unwrap_or(USUAL_POINTS) })
}

/// Takes the file in which a list of shapes is wanted; none for JSON, which has none of its parameters.
pub(super) fn take_listed_file(
    writing: FileParameters,
    parameters: &mut Parameters,
    headers: &HeaderMap,
) -> Result<Option<ShapeFile>, Problem> {
    let format = take_format(parameters, headers, Some(JSON))?;
    if let Some(format) = format {
        return take_shape_file(format, writing, parameters).map(Some);
    }
    let mut others = ["content", "points"].into_iter().filter(|name| parameters.take(name).is_some());
    let first = (!writing.is_empty()).then(|| writing.first());
    match first.or_else(|| others.next()) {
        Some(name) => Err(Problem::of_parameter(name, "expected a format of files beside it, got JSON")),
        None => Ok(None),
    }
}

/// A page of a list of shapes as a file.
pub(super) async fn page(
    app: App,
    cohort: Cohort,
    shapes: Vec<Shape>,
    file: ShapeFile,
) -> Result<Response, Problem> {
    let format = file.format;
    let (output, pieces) = BodyWriter::new();
    let work = async move { export::export_page(&app, &cohort, shapes, file, output).await.map(drop) };
    answer(format, None, pieces, work).await
}

/// Describes the answers of an operation that writes files: in the media type of any format.
pub(in crate::api) fn describe(operation: &mut Operation) {
    let media_types: Vec<&str> =
        written_formats().filter_map(|format| format.media_types.first().copied()).collect();
    for response in operation.responses.responses.values_mut() {
        let RefOr::T(response) = response else { continue };
        let Some(file) = response.content.get(ANY_FILE).cloned() else { continue };
        for media_type in &media_types {
            response.content.entry((*media_type).into()).or_insert_with(|| file.clone());
        }
    }
}

/// Takes the format of a file, by the parameter, else by the header `Accept`; none where they leave it open, or name the `other` one.
fn take_format(
    parameters: &mut Parameters,
    headers: &HeaderMap,
    other: Option<OtherFormat>,
) -> Result<Option<&'static files::Format>, Problem> {
    let (other_id, other_type) = (other.map(|other| other.id), other.map(|other| other.media_type));
    if let Some(word) = parameters.take("format") {
        let is_other = [other_id, other_type].contains(&Some(&word));
        let found = is_other.then_some(None).or_else(|| written_format(&word).map(Some));
        return found.ok_or_else(|| unwritten("format", &word, other_id));
    }
    let accept = accepted(headers);
    let offered = |range: &str| match range {
        "" | ANYTHING | "application/*" => Some(None),
        range if other_type == Some(range) => Some(None),
        range => written_format(range).map(Some),
    };
    preferred(&accept, offered).ok_or_else(|| {
        let known = written_formats().filter_map(|format| format.media_types.first().copied());
        let known = other_type.into_iter().chain(known).collect::<Vec<_>>().join(", ");
        let detail = format!("expected a media type among {known}, got '{accept}'");
        Problem::new(ProblemKind::NotAcceptable, detail)
    })
}
