//! Requests about many shapes, and their answers: one entry for each shape, in order.
//!
//! A request is a JSON document, or NDJSON with one shape per line. The other fields of the document are then parameters of the
//! query, whose values are JSON or plain text. A file of another program is read as the lines that `POST /v1/convert` makes of it, in the
//! unit of the dictionary and under the names of an upload. An answer is a JSON document with a list `results`, or NDJSON with one entry
//! per line, beside which stand the other fields of the document.

use std::convert::Infallible;
use std::sync::Arc;

use axum::body::{Body, Bytes};
use axum::extract::{FromRequest, FromRequestParts, RawPathParams, Request};
use axum::http::request::Parts;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use futures_util::stream;
use serde::Serialize;
use serde::de::{DeserializeOwned, IgnoredAny};

use crate::api::body::{self, is_file, is_stream};
use crate::api::extract::{BesideFormat, Caller, Format, PrefersLines, Query, TWICE, unknown_parameter};
use crate::api::media_type::{is_json, media_type};
use crate::api::problem::{Problem, ProblemKind};
use crate::api::respond::{compute_planned, json, planned};
use crate::api::v1::requests::file_parameters::FileParameters;
use crate::service::app::outgoing::BodyWriter;
use crate::service::app::{App, Limits, ServiceError, Work};
use crate::service::cohorts::lengths::Lengths;
use crate::service::dictionaries::ready;
use crate::service::files::translate::{Asking, FileReading, shape_lines};
use crate::service::shapes::names::InputNames;
use crate::service::shapes::outcome::{OnError, Outcomes, ShapeError};
use crate::service::shapes::read;
use crate::wire::checked::List;
use crate::wire::fault::Fault;
use crate::wire::json;
use crate::wire::picture::PictureFile;
use crate::wire::shape::ShapeInput;
use crate::wire::summary::FileSummary;

/// Parameter of requests about many shapes.
#[derive(Debug, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code, reason = "only for the document; the extractor reads it")]
pub(in crate::api::v1) struct BatchQuery {
    /// Treatment of shapes that have no answer: `abort` refuses the request with the faults of all shapes, `skip` gives
    /// them an entry with `error` and answers the others. Default: `abort`.
    #[param(inline)]
    on_error: Option<OnError>,
}

/// A request about many shapes.
#[derive(Debug)]
pub(in crate::api::v1) struct Batch {
    /// Its body.
    pub(in crate::api::v1) body: Bytes,
    /// Forms of the request and of its answer.
    pub(in crate::api::v1) form: Form,
}

/// Forms of a request about many shapes and of its answer.
#[derive(Debug, Clone)]
pub(in crate::api::v1) struct Form {
    /// The fields other than the shapes as a JSON object, if the body is NDJSON.
    settings: Option<String>,
    /// Treatment of shapes that have no answer.
    pub(in crate::api::v1) on_error: OnError,
    /// Whether the answer is NDJSON.
    answers_lines: bool,
    /// Summary of the file that the body is, if it is one.
    file: Option<FileSummary>,
}

impl FromRequest<App> for Batch {
    type Rejection = Problem;

    async fn from_request(request: Request, app: &App) -> Result<Self, Problem> {
        let (mut parts, body) = request.into_parts();
        let PrefersLines(answers_lines) = PrefersLines::from_request_parts(&mut parts, app).await?;
        let Query(parameters) = Query::<Vec<(String, String)>>::from_request_parts(&mut parts, app).await?;
        Self::read(app, &mut parts, parameters, body, answers_lines).await
    }
}

/// A request about many shapes that may be answered with a picture.
#[derive(Debug)]
pub(in crate::api::v1) struct DrawnBatch {
    /// The request.
    pub(in crate::api::v1) batch: Batch,
    /// The picture, if one is asked for.
    pub(in crate::api::v1) picture: Option<PictureFile>,
}

impl FromRequest<App> for DrawnBatch {
    type Rejection = Problem;

    async fn from_request(request: Request, app: &App) -> Result<Self, Problem> {
        let (mut parts, body) = request.into_parts();
        let answers_lines =
            matches!(PrefersLines::from_request_parts(&mut parts, app).await, Ok(PrefersLines(true)));
        let picture = match answers_lines {
            true => None,
            false => match Format::from_request_parts(&mut parts, app).await? {
                Format::Picture(file) => Some(file),
                Format::Json => None,
            },
        };
        let BesideFormat(parameters) =
            BesideFormat::<Vec<(String, String)>>::from_request_parts(&mut parts, app).await?;
        let batch = Batch::read(app, &mut parts, parameters, body, answers_lines).await?;
        if picture.is_some() && batch.form.on_error == OnError::Skip {
            return Err(Problem::of_parameter(
                "on_error",
                "expected \"abort\" beside a picture, got \"skip\"",
            ));
        }
        Ok(Self { batch, picture })
    }
}

impl Batch {
    async fn read(
        app: &App,
        parts: &mut Parts,
        mut parameters: Vec<(String, String)>,
        body: Body,
        answers_lines: bool,
    ) -> Result<Self, Problem> {
        let on_error = take_on_error(&mut parameters)?;
        let settings = match media_type(&parts.headers).as_str() {
            lines if is_stream(lines) => Some(settings(&parameters)?),
            document if is_json(document) => {
                parameters.first().map_or(Ok(()), |(name, _)| Err(unknown_parameter(name)))?;
                None
            }
            other if is_file(other) => {
                let lengths = lengths_of(app, parts, &parameters).await?;
                let mut file = FileParameters::take_asking(&mut parameters);
                let asking = file.asking(on_error, lengths)?;
                let reading = file.reading(other)?;
                let settings = Some(settings(&parameters)?);
                let (file, body) = lines_of(app, body, reading, asking).await?;
                return Ok(Self { body, form: Form { settings, on_error, answers_lines, file: Some(file) } });
            }
            other => return Err(unsupported(other)),
        };
        let body = body::read(app, body).await?;
        Ok(Self { body, form: Form { settings, on_error, answers_lines, file: None } })
    }
}

/// Unit in which a request asks about shapes: that of its dictionary, else the one that it gives for the answer.
async fn lengths_of(
    app: &App,
    parts: &mut Parts,
    parameters: &[(String, String)],
) -> Result<Lengths, Problem> {
    let path = RawPathParams::from_request_parts(parts, app).await.ok();
    let key = path.iter().flatten().find(|(name, _)| *name == "dictionary").map(|(_, key)| key.to_owned());
    let Some(key) = key else {
        let given = parameters.iter().find(|(name, _)| name == "length_unit");
        // A value is JSON or plain text.
        let text = |unit: &String| serde_json::from_str(unit).unwrap_or_else(|_| unit.clone());
        return Ok(Lengths::of_answer(given.map(|(_, unit)| text(unit))));
    };
    let Caller(app) = Caller::from_request_parts(parts, app).await?;
    let ready = ready::find(&app, &key).await?;
    Ok(Lengths::of_dictionary(ready.dictionary().content.length_unit.clone()))
}

/// The shapes of a file as lines, within the memory for bodies, and its summary by the reader.
async fn lines_of(
    app: &App,
    body: Body,
    reading: FileReading,
    asking: Asking,
) -> Result<(FileSummary, Bytes), Problem> {
    let (output, pieces) = BodyWriter::new();
    let work = async move {
        shape_lines(app, body::pieces(body), reading, asking, output).await.map_err(Problem::from)
    };
    let pieces = stream::unfold(pieces, |mut pieces| async move {
        pieces.recv().await.map(|piece| (Ok::<_, Infallible>(piece), pieces))
    });
    tokio::try_join!(work, body::read(app, Body::from_stream(pieces)))
}

/// Refusal of a body that is neither JSON nor NDJSON.
pub(in crate::api::v1) fn unsupported(media_type: &str) -> Problem {
    let detail =
        format!("expected application/json, application/x-ndjson or a file of shapes, got '{media_type}'");
    Problem::new(ProblemKind::UnsupportedMediaType, detail)
}

fn take_on_error(parameters: &mut Vec<(String, String)>) -> Result<OnError, Problem> {
    let Some(place) = parameters.iter().position(|(name, _)| name == "on_error") else {
        return Ok(OnError::default());
    };
    match parameters.remove(place).1.as_str() {
        "abort" => Ok(OnError::Abort),
        "skip" => Ok(OnError::Skip),
        other => {
            let detail = format!("expected \"abort\" or \"skip\", got \"{other}\"");
            Err(Problem::of_parameter("on_error", detail))
        }
    }
}

/// The JSON object of parameters, with an empty list of shapes. A value that is not JSON is a text.
fn settings(parameters: &[(String, String)]) -> Result<String, Problem> {
    let text = |text: &str| serde_json::Value::from(text).to_string();
    let mut object = String::from("{\"shapes\":[]");
    for (place, (name, value)) in parameters.iter().enumerate() {
        if name == "shapes" || name == "on_error" {
            return Err(unknown_parameter(name));
        }
        if parameters[..place].iter().any(|(other, _)| other == name) {
            return Err(Problem::of_parameter(name, TWICE));
        }
        let value = match serde_json::from_str::<IgnoredAny>(value) {
            Ok(_) => value.clone(),
            Err(_) => text(value),
        };
        object.push_str(&format!(",{}:{value}", text(name)));
    }
    object.push('}');
    Ok(object)
}

/// A request with a list of shapes.
pub(in crate::api::v1) trait ManyShapes: DeserializeOwned + Send + 'static {
    /// Sets the shapes.
    fn put_shapes(&mut self, shapes: List<ShapeInput>);
}

impl Form {
    /// Parses a request, and notes where its shapes are.
    ///
    /// # Errors
    /// A document that is not JSON.
    pub(in crate::api::v1) fn parse<R: ManyShapes>(
        &self,
        limits: &Limits,
        body: &[u8],
    ) -> Result<(R, Places), ServiceError> {
        let Some(settings) = &self.settings else {
            return Ok((read::parse(limits, body)?, Places::Document));
        };
        let mut request: R = read::parse(limits, settings.as_bytes())?;
        let json::Lines { items, numbers, count } = json::parse_lines(limits.bounds(), body);
        // A line that is no JSON is a shape with that fault.
        let unreadable = |fault| ShapeInput { faults: vec![fault], ..ShapeInput::default() };
        let shapes = items.into_iter().map(|item: Result<ShapeInput, Fault>| item.unwrap_or_else(unreadable));
        request.put_shapes(List::of(shapes.collect(), count));
        let places = if self.file.is_some() { Places::File } else { Places::Lines(numbers.into()) };
        Ok((request, places))
    }

    /// Answer with one entry for each shape.
    ///
    /// # Errors
    /// Under [`OnError::Abort`] the faults of all shapes without an answer.
    pub(in crate::api::v1) fn respond<L: ResultList>(
        &self,
        places: &Places,
        names: Vec<InputNames>,
        outcomes: Outcomes<L::Answer>,
        common: L::Common,
    ) -> Result<Response, ServiceError> {
        let outcomes = outcomes.checked(self.on_error)?.into_vec();
        let entry = |(index, (names, outcome)): (usize, (InputNames, Result<L::Answer, ServiceError>))| {
            let shape = InputShape { index, id: names.id, external_id: names.external_id };
            let entry: Entry<L::Answer> = match outcome {
                Ok(answer) => Ok((shape, answer)),
                Err(error) => Err(FailedShape { shape, error: places.of(error).into() }),
            };
            entry.into()
        };
        let results = names.into_iter().zip(outcomes).enumerate().map(entry).collect();
        let list = L::new(common, results, self.file.clone());
        if self.answers_lines { lines(&list) } else { json(StatusCode::OK, &list) }
    }
}

/// Where the fields and shapes of a request are.
#[derive(Debug, Clone)]
pub(in crate::api::v1) enum Places {
    /// In one JSON document.
    Document,
    /// The shapes in the lines of these numbers, the other fields in the query.
    Lines(Arc<[u64]>),
    /// The shapes in a file, the other fields in the query.
    File,
}

impl Places {
    /// The same error, with its faults where they are in the request as it was sent.
    pub(in crate::api::v1) fn of(&self, error: ServiceError) -> ServiceError {
        let lines: &[u64] = match self {
            Self::Document => return error,
            Self::Lines(lines) => lines,
            Self::File => &[],
        };
        let place = |fault| placed(fault, lines);
        match error {
            ServiceError::Invalid(faults) => ServiceError::Invalid(faults.map(place)),
            ServiceError::DegenerateShape(faults) => {
                ServiceError::DegenerateShape(faults.into_iter().map(place).collect())
            }
            other => other,
        }
    }
}

/// A fault of a document, in the lines or in the query that it was made of.
fn placed(fault: Fault, lines: &[u64]) -> Fault {
    if let Some(index) = fault.index {
        let prefix = format!("/shapes/{index}");
        let pointer = fault.pointer.strip_prefix(&prefix).unwrap_or(&fault.pointer).to_owned();
        return Fault { pointer, line: lines.get(index).copied(), ..fault };
    }
    let Some(path) = fault.pointer.strip_prefix('/') else { return fault };
    match path.split_once('/').unwrap_or((path, "")) {
        ("shapes", _) => Fault { pointer: String::new(), ..fault },
        (name, "") => Fault::of_parameter(name, fault.detail),
        (name, rest) => Fault::of_parameter(name, format!("/{rest}: {}", fault.detail)),
    }
}

/// Work of a request, names of its shapes, and the function that finds the outcomes and the other fields of the answer.
pub(in crate::api::v1) type PlannedResults<L> = (Work, Vec<InputNames>, Box<FindResults<L>>);

/// Finds the outcomes and the other fields of an answer.
type FindResults<L> = dyn FnOnce(&App) -> Result<(Outcomes<<L as ResultList>::Answer>, <L as ResultList>::Common), ServiceError>
    + Send;

/// Parses a request, then computes its answer on the lane that suits the planned work.
pub(in crate::api::v1) async fn answer_batch<R: ManyShapes, L: ResultList + 'static>(
    app: App,
    batch: Batch,
    plan: impl FnOnce(R, &App, OnError) -> Result<PlannedResults<L>, ServiceError> + Send + 'static,
) -> Result<Response, Problem> {
    let Batch { body, form } = batch;
    compute_planned(app, body, move |app, body| {
        let (request, places) = form.parse(&app.limits, body)?;
        let (work, names, find) = plan(request, app, form.on_error).map_err(|error| places.of(error))?;
        planned(work, move |app| {
            let found = find(app);
            let answered =
                found.and_then(|(outcomes, common)| form.respond::<L>(&places, names, outcomes, common));
            answered.map_err(|error| places.of(error))
        })
    })
    .await
}

/// Place and names of an input shape.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct InputShape {
    /// Position in the request, from 0.
    pub(in crate::api::v1) index: usize,
    /// Id of a stored shape.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(in crate::api::v1) id: Option<String>,
    /// Identifier assigned by the client, if the shape has one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(in crate::api::v1) external_id: Option<String>,
}

/// Input shape without an answer.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct FailedShape {
    #[serde(flatten)]
    pub(in crate::api::v1) shape: InputShape,
    /// Reason.
    pub(in crate::api::v1) error: ShapeError,
}

/// An input shape with its answer, or without one.
pub(in crate::api::v1) type Entry<A> = Result<(InputShape, A), FailedShape>;

/// Answer to a request about many shapes.
pub(in crate::api::v1) trait ResultList: Serialize {
    /// Fields about all shapes.
    type Common: Serialize;
    /// Answer for one shape.
    type Answer;
    /// Entry of a shape.
    type Entry: Serialize + From<Entry<Self::Answer>>;

    /// The answer with these parts, to a file or not.
    fn new(common: Self::Common, results: Vec<Self::Entry>, file: Option<FileSummary>) -> Self;

    /// Its parts; no common ones if it has no further fields.
    fn parts(&self) -> (Option<&Self::Common>, &[Self::Entry]);
}

/// An entry beside the fields about all shapes.
#[derive(Serialize)]
struct ResultLine<'a, E, C> {
    #[serde(flatten)]
    entry: &'a E,
    #[serde(flatten)]
    common: Option<&'a C>,
}

/// Answer as NDJSON.
fn lines<L: ResultList>(list: &L) -> Result<Response, ServiceError> {
    let (common, results) = list.parts();
    let mut text = Vec::new();
    for entry in results {
        let written = serde_json::to_writer(&mut text, &ResultLine { entry, common });
        written.map_err(|error| ServiceError::Internal(error.to_string()))?;
        text.push(b'\n');
    }
    Ok(([(header::CONTENT_TYPE, "application/x-ndjson")], text).into_response())
}

/// Declares an answer to a request about many shapes, the entry of a shape, and the shape with its answer.
macro_rules! results {
    ($(#[$meta:meta])* $list:ident $(with $common:ident)? of $entry:ident: $answered:ident with $answer:ident) => {
        /// Input shape with its answer.
        #[derive(Debug, serde::Serialize, utoipa::ToSchema)]
        pub(in crate::api::v1) struct $answered {
            #[serde(flatten)]
            shape: crate::api::v1::requests::batches::InputShape,
            #[serde(flatten)]
            answer: $answer,
        }

        /// Entry of an input shape: its answer, or the reason why there is none.
        #[derive(Debug, serde::Serialize, utoipa::ToSchema)]
        #[serde(untagged)]
        pub(in crate::api::v1) enum $entry {
            /// With an answer.
            Answered(Box<$answered>),
            /// Without an answer.
            Failed(crate::api::v1::requests::batches::FailedShape),
        }

        impl From<crate::api::v1::requests::batches::Entry<$answer>> for $entry {
            fn from(entry: crate::api::v1::requests::batches::Entry<$answer>) -> Self {
                match entry {
                    Ok((shape, answer)) => Self::Answered(Box::new($answered { shape, answer })),
                    Err(failed) => Self::Failed(failed),
                }
            }
        }

        crate::api::v1::requests::batches::result_list! { $(#[$meta])* $list $(with $common)? of $entry for $answer }
    };
}
pub(in crate::api::v1) use results;

/// Declares an answer to a request about many shapes whose entries are `$entry`.
macro_rules! result_list {
    ($(#[$meta:meta])* $list:ident with $common:ident of $entry:ident for $answer:ident) => {
        $(#[$meta])*
        #[derive(Debug, serde::Serialize, utoipa::ToSchema)]
        pub(in crate::api::v1) struct $list {
            #[serde(flatten)]
            common: $common,
            /// One entry for each input shape, in order.
            results: Vec<$entry>,
            /// Further content of the file of the request; absent where the body was no file.
            #[serde(skip_serializing_if = "Option::is_none")]
            #[schema(required = false)]
            file: Option<crate::wire::summary::FileSummary>,
        }

        impl crate::api::v1::requests::batches::ResultList for $list {
            type Common = $common;
            type Answer = $answer;
            type Entry = $entry;

            fn new(
                common: $common,
                results: Vec<$entry>,
                file: Option<crate::wire::summary::FileSummary>,
            ) -> Self {
                Self { common, results, file }
            }

            fn parts(&self) -> (Option<&$common>, &[$entry]) {
                (Some(&self.common), &self.results)
            }
        }
    };
    ($(#[$meta:meta])* $list:ident of $entry:ident for $answer:ident) => {
        $(#[$meta])*
        #[derive(Debug, serde::Serialize, utoipa::ToSchema)]
        pub(in crate::api::v1) struct $list {
            /// One entry for each input shape, in order.
            results: Vec<$entry>,
            /// Further content of the file of the request; absent where the body was no file.
            #[serde(skip_serializing_if = "Option::is_none")]
            #[schema(required = false)]
            file: Option<crate::wire::summary::FileSummary>,
        }

        impl crate::api::v1::requests::batches::ResultList for $list {
            type Common = ();
            type Answer = $answer;
            type Entry = $entry;

            fn new((): (), results: Vec<$entry>, file: Option<crate::wire::summary::FileSummary>) -> Self {
                Self { results, file }
            }

            fn parts(&self) -> (Option<&()>, &[$entry]) {
                (None, &self.results)
            }
        }
    };
}
pub(in crate::api::v1) use result_list;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parameters_become_fields_of_the_document() {
        let pair = |(name, value): &(&str, &str)| ((*name).to_owned(), (*value).to_owned());
        let written = |pairs: &[(&str, &str)]| settings(&pairs.iter().map(pair).collect::<Vec<_>>());
        let pairs =
            [("quantile", "0.99"), ("transformation", "rigid"), ("reference", "{\"points\": [[0, 1]]}")];
        let text = "{\"shapes\":[],\"quantile\":0.99,\"transformation\":\"rigid\",\"reference\":{\"points\": [[0, 1]]}}";
        assert_eq!(written(&pairs).unwrap(), text);
        assert_eq!(
            written(&[("a\"b", "0,\"x\":1")]).unwrap(),
            "{\"shapes\":[],\"a\\\"b\":\"0,\\\"x\\\":1\"}"
        );
        for refused in [&[("shapes", "[]")][..], &[("a", "1"), ("a", "1")], &[("on_error", "skip")]] {
            assert!(written(refused).is_err(), "{refused:?}");
        }
    }

    #[test]
    fn faults_are_where_the_client_wrote_the_text() {
        let found = |pointer: &str, index: Option<usize>| {
            let fault = placed(Fault { index, ..Fault::new(pointer, "wrong") }, &[1, 4]);
            (fault.pointer, fault.parameter, fault.line, fault.detail)
        };
        let fault = |pointer: &str, parameter: Option<&str>, line, detail: &str| {
            (pointer.to_owned(), parameter.map(str::to_owned), line, detail.to_owned())
        };
        assert_eq!(found("/shapes/1/points/3", Some(1)), fault("/points/3", None, Some(4), "wrong"));
        assert_eq!(found("/shapes/1", Some(1)), fault("", None, Some(4), "wrong"));
        assert_eq!(found("/quantile", None), fault("", Some("quantile"), None, "wrong"));
        let nested = fault("", Some("representation"), None, "/generator/name: wrong");
        assert_eq!(found("/representation/generator/name", None), nested);
        assert_eq!(found("/shapes", None), fault("", None, None, "wrong"));
        assert_eq!(found("", None), fault("", None, None, "wrong"));
    }
}
