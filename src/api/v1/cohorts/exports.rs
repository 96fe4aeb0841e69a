//! Shapes of a cohort as files: all of them, or a page of a list.

use axum::http::HeaderMap;
use axum::response::Response;
use utoipa::IntoParams;

use crate::api::extract::{ANYTHING, Caller, Path, Query, accepted, preferred};
use crate::api::problem::{Problem, ProblemKind};
use crate::api::v1::files::{answer, refuse_series};
#[cfg(feature = "schema")]
use crate::api::v1::requests::described::*;
use crate::api::v1::requests::entity_tags::not_stored;
use crate::api::v1::requests::file_parameters::{
    FileParameters, count_of, take_writing, unwritten, written, written_format, written_formats,
};
use crate::api::v1::requests::shape_query::Parameters;
use crate::domain::cohort::Cohort;
use crate::domain::filter::ShapeFilter;
use crate::domain::shape::Shape;
use crate::service::app::App;
use crate::service::app::outgoing::BodyWriter;
use crate::service::cohorts::catalogue;
use crate::service::files::export::{self, ExportContent, ShapeFile, USUAL_POINTS};
use crate::wire::files::Format;
use crate::wire::record::MAX_SAMPLES;

/// Answers that are not files.
const JSON: OtherFormat = OtherFormat { id: "json", media_type: "application/json" };

/// Another format of an operation beside files.
#[derive(Debug, Clone, Copy)]
struct OtherFormat {
    id: &'static str,
    media_type: &'static str,
}

/// What a file says of each shape.
#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code, reason = "only for the document; `Parameters` reads them")]
pub(in crate::api::v1) struct ShapeFileQuery {
    /// Format of the file, as an id, a media type or an ending. Default: by the header `Accept`, else that of the operation:
    /// `ndjson` of an export, `json` of a list.
    #[param(example = "ndjson")]
    format: Option<String>,
    /// Content of the file for each shape: `points` on curves, landmarks and meshes of surfaces, `control_points`, or
    /// Fourier coefficients (`fourier`) of closed curves, `write_harmonics` of them. Default: `points`; of formats that
    /// hold nothing but Fourier coefficients, `fourier`.
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
#[utoipa::path(get, path = "/v1/cohorts/{cohort}/export", tag = "files",
    params(("cohort" = String, Path, description = "Id or name"), FilterQuery, ShapeFileQuery, WriteQuery),
    responses(
        (status = 200, description = "The file", content((Binary = "application/octet-stream"), (Binary = "application/x-ndjson"))),
        (status = 404, description = "No such cohort"),
        (status = "4XX", description = "The query was refused")
    ))]
pub(in crate::api::v1) async fn export_cohort(
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

/// Takes the content of each shape in a file of a format.
fn take_shape_file(
    format: &'static Format,
    mut writing: FileParameters,
    parameters: &mut Parameters,
) -> Result<ShapeFile, Problem> {
    refuse_series(format, "format")?;
    let options = writing.writing()?;
    let content = parameters.take_word("content")?.unwrap_or_else(|| ExportContent::usual(format));
    let points = parameters.take("points").map(|text| count_of("points", &text, MAX_SAMPLES)).transpose()?;
    Ok(ShapeFile { format, options, content, points: points.unwrap_or(USUAL_POINTS) })
}

/// Takes the file in which a list of shapes is wanted; none for JSON, which has none of its parameters.
pub(in crate::api::v1) fn take_listed_file(
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
pub(in crate::api::v1) async fn page(
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

/// Takes the format of a file, by the parameter, else by the header `Accept`; none where they leave it open, or name the `other` one.
fn take_format(
    parameters: &mut Parameters,
    headers: &HeaderMap,
    other: Option<OtherFormat>,
) -> Result<Option<&'static Format>, Problem> {
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
