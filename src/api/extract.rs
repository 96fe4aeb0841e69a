//! Extractors for request parts and response formats; their rejections are problem documents.

use std::sync::Arc;
use std::time::Duration;

use axum::body::Bytes;
use axum::extract::path::ErrorKind;
use axum::extract::rejection::PathRejection;
use axum::extract::{FromRequest, FromRequestParts, Request};
use axum::http::request::Parts;
use axum::http::{HeaderMap, HeaderValue, Method, header};
use serde::de::DeserializeOwned;

use super::media_type::{is_json, media_type};
use super::observe::Asker;
use super::overload::Deadline;
use super::problem::{Problem, ProblemKind};
use crate::domain::access::Principal;
use crate::geometry::drawing::svg::{Background, Style, Theme};
use crate::service::app::idempotency::Retry;
use crate::service::app::{App, Work};
use crate::service::cohorts::catalogue::Expected;
use crate::service::cost::requests;
use crate::wire::matrix::MatrixFormat;
use crate::wire::mesh::MeshFormat;
use crate::wire::picture::{PictureFile, PictureFormat};
use crate::wire::words::plain_sentence;

/// The service restricted to the caller's tenant and to the cohorts of the caller's key.
#[derive(Debug)]
pub struct Caller(pub App);

impl FromRequestParts<App> for Caller {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, app: &App) -> Result<Self, Problem> {
        let principal = parts.extensions.get::<Arc<Principal>>().ok_or_else(|| {
            let detail = "a route that asks who calls stands outside of access control";
            Problem::new(ProblemKind::Internal, detail)
        })?;
        let app = app.of(Arc::clone(principal)).with_retry(retry_of(parts)?);
        let app = match parts.extensions.get::<Deadline>() {
            Some(Deadline(end)) => app.until(*end),
            None => app,
        };
        Ok(Self(match parts.extensions.get::<Asker>() {
            Some(asker) => app.noting(asker.touched().clone()),
            None => app,
        }))
    }
}

/// Idempotency key and fingerprint of a request, if it has the header and its method is POST.
fn retry_of(parts: &Parts) -> Result<Option<Retry>, Problem> {
    let Some(key) = parts.headers.get("idempotency-key").filter(|_| parts.method == Method::POST) else {
        return Ok(None);
    };
    let target = format!("{} {}", parts.method, parts.uri);
    // A value that is not text has unprintable characters, so it is refused as a key.
    Ok(Some(Retry::new(key.to_str().unwrap_or_default(), &target)?))
}

/// Versions that the client expects: `If-Match`.
#[derive(Debug)]
pub struct IfMatch(pub Option<Expected>);

impl<S: Send + Sync> FromRequestParts<S> for IfMatch {
    type Rejection = std::convert::Infallible;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Self::Rejection> {
        let values = parts.headers.get_all(header::IF_MATCH).iter();
        let tags = values.flat_map(|value| value.to_str().unwrap_or_default().split(','));
        let tags: Vec<String> = tags.map(|tag| tag.trim().to_owned()).collect();
        Ok(Self((!tags.is_empty()).then_some(Expected(tags))))
    }
}

/// A JSON body within the size limit.
#[derive(Debug)]
pub struct JsonBody(pub Bytes);

/// Whether `media_type` is that of the changes of a resource: JSON, or a merge patch (RFC 7396).
fn is_change(method: &Method, media_type: &str) -> bool {
    method == Method::PATCH && media_type == "application/merge-patch+json"
}

impl FromRequest<App> for JsonBody {
    type Rejection = Problem;

    async fn from_request(request: Request, app: &App) -> Result<Self, Problem> {
        let found = media_type(request.headers());
        if !is_json(&found) && !is_change(request.method(), &found) {
            let detail = format!("expected application/json, got '{found}'");
            return Err(Problem::new(ProblemKind::UnsupportedMediaType, detail));
        }
        super::body::read(app, request.into_body()).await.map(Self)
    }
}

/// Query string, parsed as `T`.
#[derive(Debug)]
pub struct Query<T>(pub T);

impl<T: DeserializeOwned, S: Send + Sync> FromRequestParts<S> for Query<T> {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Problem> {
        axum::extract::Query::<T>::try_from_uri(&parts.uri)
            .map(|query| Self(query.0))
            .map_err(|rejection| unreadable_query(&rejection.body_text()))
    }
}

/// No query parameters: rejects any, since a misspelt one must not be ignored.
#[derive(Debug)]
pub struct NoQuery;

impl<S: Send + Sync> FromRequestParts<S> for NoQuery {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Problem> {
        only(parts, &[]).map(|()| Self)
    }
}

/// The fault of a parameter that is given twice.
pub const TWICE: &str = "expected the parameter once, got it twice";

/// Refusal of a parameter that the route does not have.
pub fn unknown_parameter(name: &str) -> Problem {
    Problem::of_parameter(name, format!("expected a parameter of this route, got '{name}'"))
}

/// Problem of a query that could not be parsed, from the text of the rejection.
fn unreadable_query(text: &str) -> Problem {
    let text = text.strip_prefix("Failed to deserialize query string: ").unwrap_or(text);
    let (name, fault) = match text.split_once(": ") {
        Some((name, fault)) if !name.contains(' ') => (name, fault),
        _ => ("", text),
    };
    let named = |prefix: &str| fault.strip_prefix(prefix)?.split('`').next();
    if let Some(unknown) = named("unknown field `") {
        return unknown_parameter(unknown);
    }
    if let Some(repeated) = named("duplicate field `") {
        return Problem::of_parameter(repeated, TWICE);
    }
    if let Some(missing) = named("missing field `") {
        return Problem::of_parameter(missing, "required parameter is missing");
    }
    let detail = match fault {
        "invalid digit found in string" | "cannot parse integer from empty string" => {
            "expected a non-negative whole number".into()
        }
        "number too large to fit in target type" => "expected a smaller number".into(),
        "invalid float literal" | "cannot parse float from empty string" => "expected a number".into(),
        "provided string was not `true` or `false`" => "expected true or false".into(),
        other => plain_sentence(other),
    };
    if name.is_empty() {
        return Problem::new(ProblemKind::InvalidQuery, detail);
    }
    Problem::of_parameter(name, detail)
}

/// Refuses query parameters that are not in `known`.
fn only(parts: &Parts, known: &[&str]) -> Result<(), Problem> {
    let query = axum::extract::Query::<Vec<(String, String)>>::try_from_uri(&parts.uri)
        .map_err(|rejection| unreadable_query(&rejection.body_text()))?;
    match query.0.iter().find(|(key, _)| !known.contains(&key.as_str())) {
        None => Ok(()),
        Some((key, _)) => Err(unknown_parameter(key)),
    }
}

/// Response format, on a route without other query parameters.
#[derive(Debug)]
pub struct OnlyFormat(pub Format);

impl<S: Send + Sync> FromRequestParts<S> for OnlyFormat {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        only(parts, &FORMAT_PARAMETERS)?;
        Format::from_request_parts(parts, state).await.map(Self)
    }
}

/// Path segments, parsed as `T`.
#[derive(Debug)]
pub struct Path<T>(pub T);

impl<T: DeserializeOwned + Send, S: Send + Sync> FromRequestParts<S> for Path<T> {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        axum::extract::Path::<T>::from_request_parts(parts, state)
            .await
            .map(|path| Self(path.0))
            .map_err(|rejection| unreadable_path(&rejection))
    }
}

/// Problem of path segments that could not be parsed: all are read as text.
fn unreadable_path(rejection: &PathRejection) -> Problem {
    let name = match rejection {
        PathRejection::FailedToDeserializePathParams(error) => match error.kind() {
            ErrorKind::InvalidUtf8InPathParam { key } | ErrorKind::ParseErrorAtKey { key, .. } => {
                key.as_str()
            }
            _ => "",
        },
        _ => "",
    };
    let detail = "expected text in UTF-8, got other bytes";
    if name.is_empty() {
        return Problem::new(ProblemKind::InvalidQuery, format!("path: {detail}"));
    }
    Problem::of_parameter(name, detail)
}

/// Response format: `?format=json|svg|png`, else the `Accept` header, else JSON.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// Numbers.
    Json,
    /// A drawing.
    Picture(PictureFile),
}

impl Format {
    /// Predicted work of writing the answer, in addition to that of making the drawing or the numbers.
    pub fn work(self) -> Work {
        match self {
            Self::Json => Work::from_seconds(0.0),
            Self::Picture(file) => requests::picture(&file),
        }
    }
}

#[derive(serde::Deserialize)]
struct FormatQuery {
    format: Option<String>,
}

/// Parameters that belong to the format of an answer.
const FORMAT_PARAMETERS: [&str; 7] =
    ["format", "theme", "background", "width", "title", "scale_bar", "legend"];

/// Settings of drawings.
#[derive(Debug, serde::Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
pub struct DrawingQuery {
    /// Colours of a drawing. Default: `auto`, light or dark as the viewer prefers.
    #[param(inline)]
    theme: Option<Theme>,
    /// Background of a drawing: a painted page, or nothing. Default: `page`.
    #[param(inline)]
    background: Option<Background>,
    /// Width of a drawing in pixels; its height follows. Default: 640.
    #[param(minimum = 16, maximum = 4096)]
    width: Option<u16>,
    /// Whether the title of a drawing is written above it. Default: true.
    title: Option<bool>,
    /// Whether a drawing of shapes that keep their sizes has a scale bar. Default: true.
    scale_bar: Option<bool>,
    /// Whether a drawing has its legend below. Default: true.
    legend: Option<bool>,
}

impl DrawingQuery {
    fn read(parts: &Parts) -> Result<Self, Problem> {
        let query = axum::extract::Query::<Self>::try_from_uri(&parts.uri);
        query.map(|query| query.0).map_err(|rejection| unreadable_query(&rejection.body_text()))
    }

    /// The settings, with defaults for those not given.
    ///
    /// # Errors
    /// A width out of range.
    fn style(&self) -> Result<Style, Problem> {
        let usual = Style::default();
        let (least, most) = Style::WIDTHS;
        let width = self.width.unwrap_or(usual.width);
        if !(least..=most).contains(&width) {
            let detail = format!("expected a number between {least} and {most}, got {width}");
            return Err(Problem::of_parameter("width", detail));
        }
        Ok(Style {
            theme: self.theme.unwrap_or(usual.theme),
            background: self.background.unwrap_or(usual.background),
            width,
            title: self.title.unwrap_or(usual.title),
            scale_bar: self.scale_bar.unwrap_or(usual.scale_bar),
            legend: self.legend.unwrap_or(usual.legend),
        })
    }

    /// Refuses settings beside a format that is not a drawing.
    fn unused(&self) -> Result<(), Problem> {
        let given = [
            ("theme", self.theme.is_some()),
            ("background", self.background.is_some()),
            ("width", self.width.is_some()),
            ("title", self.title.is_some()),
            ("scale_bar", self.scale_bar.is_some()),
            ("legend", self.legend.is_some()),
        ];
        match given.iter().find(|(_, given)| *given) {
            None => Ok(()),
            Some((name, _)) => {
                Err(Problem::of_parameter(*name, "expected only with the formats svg and png"))
            }
        }
    }
}

/// The `format` of a query, if given.
fn format_of(parts: &Parts) -> Result<Option<String>, Problem> {
    let query = axum::extract::Query::<FormatQuery>::try_from_uri(&parts.uri);
    query.map(|query| query.0.format).map_err(|rejection| unreadable_query(&rejection.body_text()))
}

impl<S: Send + Sync> FromRequestParts<S> for Format {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Problem> {
        let settings = DrawingQuery::read(parts)?;
        let format = match format_of(parts)?.as_deref() {
            Some("json") => None,
            Some(name) => Some(picture_format(name).ok_or_else(|| {
                let detail = format!("expected 'json', 'svg' or 'png', got '{name}'");
                Problem::of_parameter("format", detail)
            })?),
            None => {
                let accept = accepted(&parts.headers);
                preferred(&accept, picture_or_numbers).ok_or_else(|| {
                    let detail = format!(
                        "expected application/json, image/svg+xml or image/png to be accepted, got '{accept}'"
                    );
                    Problem::new(ProblemKind::NotAcceptable, detail)
                })?
            }
        };
        match format {
            Some(format) => Ok(Self::Picture(PictureFile { format, style: settings.style()? })),
            None => settings.unused().map(|()| Self::Json),
        }
    }
}

/// A picture whose width follows from other parameters: `?format=svg|png`, else the `Accept` header, else SVG.
#[derive(Debug)]
pub struct PictureRequest {
    /// Format of the file.
    pub format: PictureFormat,
    settings: DrawingQuery,
}

impl PictureRequest {
    /// The picture file.
    ///
    /// # Errors
    /// Settings out of range.
    pub fn file(self) -> Result<PictureFile, Problem> {
        Ok(PictureFile { format: self.format, style: self.settings.style()? })
    }

    /// The picture file of this width.
    ///
    /// # Errors
    /// A width in the query.
    pub fn of_width(mut self, width: u16) -> Result<PictureFile, Problem> {
        if let Some(given) = self.settings.width.replace(width) {
            let detail = format!("expected none, which follows from columns and size, got {given}");
            return Err(Problem::of_parameter("width", detail));
        }
        Ok(PictureFile { format: self.format, style: self.settings.style()? })
    }
}

impl<S: Send + Sync> FromRequestParts<S> for PictureRequest {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Problem> {
        let settings = DrawingQuery::read(parts)?;
        let format = match format_of(parts)? {
            Some(name) => picture_format(&name).ok_or_else(|| {
                Problem::of_parameter("format", format!("expected 'svg' or 'png', got '{name}'"))
            })?,
            None => {
                let accept = accepted(&parts.headers);
                let offered = |range: &str| match range {
                    ANYTHING | "" => Some(PictureFormat::Svg),
                    range => picture_or_numbers(range).flatten(),
                };
                preferred(&accept, offered).ok_or_else(|| {
                    let detail =
                        format!("expected image/svg+xml or image/png to be accepted, got '{accept}'");
                    Problem::new(ProblemKind::NotAcceptable, detail)
                })?
            }
        };
        Ok(Self { format, settings })
    }
}

/// The picture format with this name.
fn picture_format(name: &str) -> Option<PictureFormat> {
    PictureFormat::ALL.into_iter().find(|format| format.name() == name)
}

/// Parameters of a query but those of the response format, parsed as `T`; the extractor of the format reads the others.
#[derive(Debug)]
pub struct BesideFormat<T>(pub T);

impl<T: DeserializeOwned, S: Send + Sync> FromRequestParts<S> for BesideFormat<T> {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Problem> {
        let of_format = |parameter: &&str| {
            let name = parameter.split('=').next().unwrap_or_default();
            name == "grid" || FORMAT_PARAMETERS.contains(&name)
        };
        let query = parts.uri.query().unwrap_or_default().split('&');
        let rest: Vec<&str> = query.filter(|parameter| !of_format(parameter)).collect();
        let uri = format!("/?{}", rest.join("&")).parse();
        let uri = uri.map_err(|error| unreadable_query(&format!("{error}")))?;
        axum::extract::Query::<T>::try_from_uri(&uri)
            .map(|query| Self(query.0))
            .map_err(|rejection| unreadable_query(&rejection.body_text()))
    }
}

/// Response format of a shape: a [`Format`], or for surfaces a mesh (`?format=obj|ply|stl|gltf`), with as many points along
/// `u` and `v` as `?grid=u,v` specifies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ShapeFormat {
    /// JSON or a drawing.
    Plain(Format),
    /// A mesh with this grid.
    Mesh(MeshFormat, Option<[usize; 2]>),
}

impl ShapeFormat {
    /// Predicted work of writing the answer, as [`Format::work`].
    pub fn work(self) -> Work {
        match self {
            Self::Plain(format) => format.work(),
            Self::Mesh(..) => Work::from_seconds(0.0),
        }
    }
}

#[derive(serde::Deserialize)]
struct MeshQuery {
    format: Option<String>,
    grid: Option<String>,
}

impl<S: Send + Sync> FromRequestParts<S> for ShapeFormat {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        let query = axum::extract::Query::<MeshQuery>::try_from_uri(&parts.uri)
            .map_err(|rejection| unreadable_query(&rejection.body_text()))?;
        let MeshQuery { format, grid } = query.0;
        let grid = match grid {
            None => None,
            Some(text) => {
                let numbers: Vec<Option<usize>> =
                    text.split(',').map(|number| number.trim().parse().ok()).collect();
                match numbers[..] {
                    [Some(u), Some(v)] => Some([u, v]),
                    _ => {
                        let detail = format!("expected two numbers such as 48,33, got '{text}'");
                        return Err(Problem::of_parameter("grid", detail));
                    }
                }
            }
        };
        let mesh = match format.as_deref() {
            Some(name) => MeshFormat::ALL.into_iter().find(|format| format.name() == name),
            None => preferred(&accepted(&parts.headers), |range| {
                // JSON and SVG take precedence for wildcards in `Accept`.
                let mesh = MeshFormat::ALL.into_iter().find(|format| format.media_type() == range).map(Some);
                mesh.or_else(|| picture_or_numbers(range).map(|_| None))
            })
            .flatten(),
        };
        if let Some(format) = mesh {
            DrawingQuery::read(parts)?.unused()?;
            return Ok(Self::Mesh(format, grid));
        }
        if grid.is_some() {
            let detail = "expected only with the formats obj, ply, stl and gltf";
            return Err(Problem::of_parameter("grid", detail));
        }
        Format::from_request_parts(parts, state).await.map(Self::Plain).map_err(|problem| {
            let known = format.is_none_or(|format| format == "json" || picture_format(&format).is_some());
            if known {
                problem
            } else {
                Problem::of_parameter(
                    "format",
                    "expected 'json', 'svg', 'png', 'obj', 'ply', 'stl' or 'gltf'",
                )
            }
        })
    }
}

/// Response format of objects in an image: a [`Format`], or a volume of labels (`?format=nifti`).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ImageFormat {
    /// JSON, a drawing, or a picture of labels.
    Plain(Format),
    /// NIfTI.
    Nifti,
}

impl ImageFormat {
    /// Predicted work of writing the answer, as [`Format::work`].
    pub fn work(self) -> Work {
        match self {
            Self::Plain(format) => format.work(),
            Self::Nifti => Work::from_seconds(0.0),
        }
    }
}

/// Media type of NIfTI files.
const NIFTI: &str = "application/x-nifti";

impl<S: Send + Sync> FromRequestParts<S> for ImageFormat {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        let asked = format_of(parts)?;
        let accepts_nifti = |range: &str| match range {
            NIFTI => Some(true),
            range => picture_or_numbers(range).map(|_| false),
        };
        let is_nifti = match asked.as_deref() {
            Some(name) => name == "nifti",
            None => preferred(&accepted(&parts.headers), accepts_nifti).unwrap_or(false),
        };
        if is_nifti {
            return DrawingQuery::read(parts)?.unused().map(|()| Self::Nifti);
        }
        let is_unknown = asked.is_some_and(|name| name != "json" && picture_format(&name).is_none());
        match Format::from_request_parts(parts, state).await {
            Err(_) if is_unknown => {
                Err(Problem::of_parameter("format", "expected 'json', 'svg', 'png' or 'nifti'"))
            }
            found => found.map(Self::Plain),
        }
    }
}

/// [`ShapeFormat`] on a route without other query parameters.
#[derive(Debug)]
pub struct OnlyShapeFormat(pub ShapeFormat);

impl<S: Send + Sync> FromRequestParts<S> for OnlyShapeFormat {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        only(parts, &[&FORMAT_PARAMETERS[..], &["grid"]].concat())?;
        ShapeFormat::from_request_parts(parts, state).await.map(Self)
    }
}

/// Query parameters of [`ShapeFormat`], for the OpenAPI document.
#[derive(utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
pub struct ShapeFormatQuery {
    /// Response format: `json`, `svg`, `png`, or for surfaces `obj`, `ply`, `stl`, `gltf`.
    #[allow(dead_code, reason = "only for the document; the extractor reads it")]
    format: Option<String>,
    /// Numbers of mesh points along `u` and `v`, such as `48,33`. Default: two per interval between knots.
    #[allow(dead_code, reason = "only for the document; the extractor reads it")]
    grid: Option<String>,
}

/// Media range of everything.
pub(super) const ANYTHING: &str = "*/*";

/// Media ranges that a client accepts, separated by commas.
pub(super) fn accepted(headers: &HeaderMap) -> String {
    let values: Vec<&str> =
        headers.get_all(header::ACCEPT).iter().filter_map(|value| value.to_str().ok()).collect();
    if values.is_empty() { ANYTHING.into() } else { values.join(",") }
}

/// The picture format that a media range asks for; `Some(None)` for numbers, `None` for neither.
fn picture_or_numbers(media_range: &str) -> Option<Option<PictureFormat>> {
    match media_range {
        "application/json" | "application/*" | "*/*" | "" => Some(None),
        "image/*" => Some(PictureFormat::ALL.first().copied()),
        range => PictureFormat::ALL.into_iter().find(|format| format.media_type() == range).map(Some),
    }
}

/// Whether the `Accept` header prefers lines of JSON to one document.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PrefersLines(pub bool);

impl<S: Send + Sync> FromRequestParts<S> for PrefersLines {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Problem> {
        let is_lines = |media_range: &str| match media_range {
            "application/json" | "application/*" | "*/*" | "" => Some(false),
            "application/x-ndjson" => Some(true),
            _ => None,
        };
        let accept = accepted(&parts.headers);
        preferred(&accept, is_lines).map(Self).ok_or_else(|| {
            let detail =
                format!("expected application/json or application/x-ndjson to be accepted, got '{accept}'");
            Problem::new(ProblemKind::NotAcceptable, detail)
        })
    }
}

/// Response format of the output of a job, whose kind decides which formats there are.
#[derive(Debug)]
pub struct OutputFormat {
    asked: Option<String>,
    accept: String,
}

impl<S: Send + Sync> FromRequestParts<S> for OutputFormat {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Problem> {
        only(parts, &["format"])?;
        let query = axum::extract::Query::<FormatQuery>::try_from_uri(&parts.uri).ok();
        let asked = query.and_then(|query| query.0.format);
        const NAMES: [&str; 9] = ["json", "csv", "npy", "arrow", "parquet", "ndjson", "svg", "png", "nifti"];
        if let Some(other) = asked.as_deref().filter(|name| !NAMES.contains(name)) {
            let detail = format!("expected one of {}, got '{other}'", NAMES.join(", "));
            return Err(Problem::of_parameter("format", detail));
        }
        Ok(Self { asked, accept: accepted(&parts.headers) })
    }
}

impl OutputFormat {
    /// Format of a matrix.
    ///
    /// # Errors
    /// A format that matrices do not have.
    pub fn of_matrix(&self) -> Result<MatrixFormat, Problem> {
        matrix_format_of(self.asked.as_deref(), &self.accept)
    }

    /// Checks that a file of this media type is accepted.
    ///
    /// # Errors
    /// Another format.
    pub fn check_file(&self, media_type: &str) -> Result<(), Problem> {
        let name = match media_type {
            NIFTI => "nifti",
            "image/svg+xml" => "svg",
            _ => "png",
        };
        match self.asked.as_deref() {
            Some(asked) if asked == name => Ok(()),
            Some(other) => {
                let detail = format!("expected '{name}', the format of this file, got '{other}'");
                Err(Problem::of_parameter("format", detail))
            }
            None => {
                let kind = media_type.split('/').next().unwrap_or_default();
                let is_file = |range: &str| {
                    let of_kind = range.strip_suffix("/*") == Some(kind);
                    (range == media_type || of_kind || matches!(range, "*/*" | "")).then_some(())
                };
                preferred(&self.accept, is_file).ok_or_else(|| {
                    let detail = format!("expected {media_type} to be accepted, got '{}'", self.accept);
                    Problem::new(ProblemKind::NotAcceptable, detail)
                })
            }
        }
    }

    /// Checks that lines are accepted.
    ///
    /// # Errors
    /// Another format.
    pub fn check_lines(&self) -> Result<(), Problem> {
        match self.asked.as_deref() {
            Some("ndjson") => Ok(()),
            Some(other) => {
                let detail = format!("expected 'ndjson', the only format of lines, got '{other}'");
                Err(Problem::of_parameter("format", detail))
            }
            None => {
                let is_lines = |media_range: &str| {
                    matches!(media_range, "application/x-ndjson" | "application/*" | "*/*" | "").then_some(())
                };
                preferred(&self.accept, is_lines).ok_or_else(|| {
                    let detail =
                        format!("expected application/x-ndjson to be accepted, got '{}'", self.accept);
                    Problem::new(ProblemKind::NotAcceptable, detail)
                })
            }
        }
    }
}

/// Response format of a matrix, on a route without other query parameters: `?format=json|csv|npy|arrow|parquet`, else the `Accept`
/// header, else JSON.
#[derive(Debug)]
pub struct OnlyMatrixFormat(pub MatrixFormat);

impl<S: Send + Sync> FromRequestParts<S> for OnlyMatrixFormat {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Problem> {
        only(parts, &["format"])?;
        let query = axum::extract::Query::<FormatQuery>::try_from_uri(&parts.uri).ok();
        let asked = query.and_then(|query| query.0.format);
        matrix_format_of(asked.as_deref(), &accepted(&parts.headers)).map(Self)
    }
}

fn matrix_format_of(asked: Option<&str>, accept: &str) -> Result<MatrixFormat, Problem> {
    if let Some(name) = asked {
        return MatrixFormat::ALL.into_iter().find(|format| format.name() == name).ok_or_else(|| {
            let detail = format!("expected 'json', 'csv', 'npy', 'arrow' or 'parquet', got '{name}'");
            Problem::of_parameter("format", detail)
        });
    }
    preferred(accept, matrix_format).ok_or_else(|| {
        let types = MatrixFormat::ALL.map(MatrixFormat::media_type).join(", ");
        let detail = format!("expected one of {types} to be accepted, got '{accept}'");
        Problem::new(ProblemKind::NotAcceptable, detail)
    })
}

fn matrix_format(media_range: &str) -> Option<MatrixFormat> {
    match media_range {
        "application/*" | "*/*" | "" => Some(MatrixFormat::Json),
        "text/*" => Some(MatrixFormat::Csv),
        "application/octet-stream" => Some(MatrixFormat::Npy),
        range => MatrixFormat::ALL.into_iter().find(|format| format.media_type() == range),
    }
}

/// Offered format with the highest quality; the first in the header wins ties.
pub(super) fn preferred<T>(accept: &str, offered: impl Fn(&str) -> Option<T>) -> Option<T> {
    let mut best: Option<(f64, T)> = None;
    for range in accept.split(',') {
        let mut parts = range.split(';').map(str::trim);
        let media_range = parts.next().unwrap_or_default().to_ascii_lowercase();
        let Some(format) = offered(&media_range) else { continue };
        let quality = parts.find_map(|p| p.strip_prefix("q=")).and_then(|q| q.parse().ok()).unwrap_or(1.0);
        if quality > 0.0 && best.as_ref().is_none_or(|(highest, _)| quality > *highest) {
            best = Some((quality, format));
        }
    }
    best.map(|(_, format)| format)
}

/// Normalises `Accept-Encoding` to the encoding of the response: gzip or none.
///
/// If neither is acceptable the header is ignored, as RFC 9110 §12.5 allows: otherwise the compression layer would turn the
/// response into a 406 after the work is done, and stored data would seem to have been refused.
pub fn settle_encoding(mut request: Request) -> Request {
    let headers = request.headers_mut();
    let zipped = {
        let values = headers.get_all(header::ACCEPT_ENCODING).iter().filter_map(|value| value.to_str().ok());
        gzip_wanted(&values.collect::<Vec<_>>().join(","))
    };
    headers.remove(header::ACCEPT_ENCODING);
    if zipped {
        headers.insert(header::ACCEPT_ENCODING, HeaderValue::from_static("gzip"));
    }
    request
}

/// Whether gzip is acceptable, and at least as welcome as no encoding.
fn gzip_wanted(accept_encoding: &str) -> bool {
    let quality = |coding: &str| {
        let entry = accept_encoding.split(',').find_map(|entry| {
            let (name, parameter) = entry.split_once(';').unwrap_or((entry, ""));
            name.trim().eq_ignore_ascii_case(coding).then(|| parameter.trim())
        })?;
        Some(entry.strip_prefix("q=").map_or(1.0, |quality| quality.parse().unwrap_or(0.0)))
    };
    let any = quality("*");
    let (gzip, identity) = (quality("gzip").or(any).unwrap_or(0.0), quality("identity").unwrap_or(0.0));
    gzip > 0.0 && gzip >= identity
}

/// Longest time that a request may wait for a job.
const MAX_WAIT: Duration = Duration::from_secs(60);

/// Preferences of the client (RFC 7240); unknown or malformed ones are ignored.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Prefer {
    /// `wait=SECONDS`: time that the client is willing to wait for the outcome, at most a minute.
    pub wait: Option<Duration>,
    /// `respond-async`: the client prefers a job to an answer at once.
    pub respond_async: bool,
}

impl<S: Send + Sync> FromRequestParts<S> for Prefer {
    type Rejection = std::convert::Infallible;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Self::Rejection> {
        let values = parts.headers.get_all("prefer").iter().filter_map(|value| value.to_str().ok());
        Ok(Self::read(values))
    }
}

impl Prefer {
    /// Reads the values of the header; of repeated preferences the first counts.
    fn read<'a>(values: impl Iterator<Item = &'a str>) -> Self {
        let (mut wait, mut respond_async) = (None, false);
        for preference in values.flat_map(|value| split_unquoted(value, ',')) {
            // Drops the parameters of the preference; these have none.
            let preference = split_unquoted(preference, ';').next().unwrap_or_default();
            let (name, value) = preference.split_once('=').unwrap_or((preference, ""));
            if name.trim().eq_ignore_ascii_case("wait") {
                wait.get_or_insert_with(|| value.trim().trim_matches('"').to_owned());
            }
            respond_async |= name.trim().eq_ignore_ascii_case("respond-async");
        }
        Self { wait: wait.and_then(|seconds| read_seconds(&seconds)), respond_async }
    }
}

/// Whole seconds, at most [`MAX_WAIT`].
fn read_seconds(text: &str) -> Option<Duration> {
    let digits = !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    // A number too large to parse exceeds the maximum anyway.
    digits.then(|| text.parse().map_or(MAX_WAIT, Duration::from_secs).min(MAX_WAIT))
}

/// Parts of `text` between separators that are not inside a quoted string.
fn split_unquoted(text: &str, separator: char) -> impl Iterator<Item = &str> {
    let (mut quoted, mut escaped) = (false, false);
    text.split(move |c: char| {
        let ends = c == separator && !quoted;
        match c {
            _ if escaped => escaped = false,
            '\\' if quoted => escaped = true,
            '"' => quoted = !quoted,
            _ => {}
        }
        ends
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn preferences_are_read_as_the_standard_says() {
        let cases: [(&[&str], Option<u64>); 18] = [
            (&[], None),
            (&["wait=10"], Some(10)),
            (&["WAIT = 10"], Some(10)),
            (&["wait=\"7\""], Some(7)),
            (&["respond-async, wait=10"], Some(10)),
            (&["respond-async", "wait=10"], Some(10)),
            (&["wait=3, wait=10"], Some(3)),
            (&["wait=3", "wait=10"], Some(3)),
            (&["handling=lenient; wait=4"], None),
            (&["wait=5; foo=\"a, wait=6\""], Some(5)),
            (&["foo=\"a, wait=6\", wait=8"], Some(8)),
            (&["foo=\"a\\\", wait=6\", wait=8"], Some(8)),
            (&["wait=100000"], Some(60)),
            (&["wait=99999999999999999999999999"], Some(60)),
            (&["wait"], None),
            (&["wait=-1"], None),
            (&["wait=1.5"], None),
            (&["waits=10, =, ;, \""], None),
        ];
        for (values, seconds) in cases {
            let found = Prefer::read(values.iter().copied());
            assert_eq!(found.wait, seconds.map(Duration::from_secs), "{values:?}");
        }
    }

    #[test]
    fn gzip_is_sent_where_it_is_wanted() {
        let wanted = [
            "gzip",
            "deflate, GZIP;q=0.5",
            "*",
            "br, *;q=0.1",
            "gzip;q=1.0, identity;q=0.5",
            "identity;q=0, *",
        ];
        for header in wanted {
            assert!(gzip_wanted(header), "{header}");
        }
        let not = [
            "",
            "identity",
            "br",
            "gzip;q=0",
            "*;q=0",
            "gzip;q=0, *",
            "identity, gzip;q=0.5",
            "gzip;q=nan",
            "gzip;q=",
        ];
        for header in not {
            assert!(!gzip_wanted(header), "{header}");
        }
    }

    #[test]
    fn formats_are_negotiated() {
        let preferred = |accept| super::preferred(accept, picture_or_numbers);
        let (svg, png) = (Some(Some(PictureFormat::Svg)), Some(Some(PictureFormat::Png)));
        assert_eq!(preferred("*/*"), Some(None));
        assert_eq!(preferred("image/svg+xml"), svg);
        assert_eq!(preferred("text/html, image/svg+xml;q=0.9, */*;q=0.8"), svg);
        assert_eq!(preferred("application/json;q=0.5, image/*"), svg);
        assert_eq!(preferred("image/png, image/svg+xml;q=0.9"), png);
        assert_eq!(preferred("text/csv"), None);
        let preferred = |accept| super::preferred(accept, matrix_format);
        assert_eq!(preferred("text/csv"), Some(MatrixFormat::Csv));
        assert_eq!(preferred("application/json;q=0.5, application/octet-stream"), Some(MatrixFormat::Npy));
        assert_eq!(preferred("image/svg+xml"), None);
    }
}
