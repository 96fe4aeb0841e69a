//! Use of dictionaries on posted or stored shapes: encode, reconstruct and score them, evaluate the shape prior, draw
//! samples.

#[cfg(feature = "schema")]
use crate::api::v1::requests::described::*;
use crate::wire::fault::Fault;
use std::sync::Arc;

use axum::http::StatusCode;
use axum::response::Response;
use serde::Serialize;

use crate::analysis::defaults::OUTLIER_QUANTILE;
use crate::analysis::dictionary::coding::{AnswerPose, Reconstruction};
use crate::analysis::dictionary::modes::Sample;
use crate::analysis::dictionary::posted_code::PostedCode;
use crate::analysis::dictionary::prior::{Energy, Reference};
use crate::analysis::dictionary::score::Score;
use crate::api::extract::{Caller, JsonBody, NoQuery, Path};
use crate::api::problem::Problem;
use crate::api::respond::{compute, compute_unwaiting, json, picture};
use crate::api::v1::dictionaries::pictures::draw_dictionary;
use crate::api::v1::requests::batches::{Batch, DrawnBatch, Form, ManyShapes, Places, ResultList, results};
use crate::api::v1::requests::request_macros::{ShapeOutput, checked};
use crate::service::app::{App, ServiceError, Work};
use crate::service::cost::requests;
use crate::service::dictionaries::answers::{ByDictionary, CodeOutput, NoveltyOutput, UsedDictionary};
use crate::service::dictionaries::coding::Asked;
use crate::service::dictionaries::ready::Ready;
use crate::service::dictionaries::{coding, pictures, ready};
use crate::service::shapes::names::InputNames;
use crate::service::shapes::outcome::{OnError, Outcomes, of_shape};
use crate::wire::checked::{Checked, List, Many, document, take_given, take_many, take_or_default};
use crate::wire::picture::PictureFile;
use crate::wire::shape::{Points, ShapeInput};

/// Declares a request with shapes, posted or stored, and further fields.
macro_rules! asking_request {
    ($(#[$meta:meta])* $name:ident { $($further:tt)* }) => {
        document! {
            $(#[$meta])*
            pub(in crate::api::v1) struct $name {
                /// Shapes, in the form used for the dictionary's cohort. Give `shapes`, or `cohort` and `ids`.
                #[schema(value_type = Option<Vec<ShapeInput>>)]
                shapes: List<ShapeInput>;
                /// Id or name of a cohort in the dictionary's representation.
                #[schema(value_type = Option<String>)]
                cohort: Checked<String>;
                /// Ids or external ids of shapes of that cohort.
                #[schema(value_type = Option<Vec<String>>)]
                ids: Many<String>;
                $($further)*
            }
        }

        impl crate::api::v1::requests::batches::ManyShapes for $name {
            fn put_shapes(&mut self, shapes: List<ShapeInput>) {
                self.shapes = Some(shapes);
            }
        }

        impl crate::api::v1::dictionaries::coding::AskingRequest for $name {
            fn take_shapes(&mut self, errors: &mut Vec<Fault>) -> Shapes {
                errors.append(&mut self.faults);
                Shapes {
                    posted: self.shapes.take().map(|shapes| shapes.take("/shapes", errors)),
                    cohort: take_given(self.cohort.take(), "/cohort", errors),
                    ids: take_many(self.ids.take(), "/ids", errors),
                    other_parameters: false,
                }
            }
        }
    };
}

pub(in crate::api::v1) use asking_request;

/// A request with shapes, posted or stored.
pub(in crate::api::v1) trait AskingRequest: ManyShapes {
    /// Takes the shapes; faults go to `errors`.
    fn take_shapes(&mut self, errors: &mut Vec<Fault>) -> Shapes;
}

/// A request for a dictionary, of which not all fields are checked yet.
pub(in crate::api::v1) struct Received<R> {
    /// The dictionary.
    pub(in crate::api::v1) ready: Arc<Ready>,
    /// The request without its shapes.
    pub(in crate::api::v1) request: R,
    /// Its shapes.
    pub(in crate::api::v1) shapes: Shapes,
    /// Faults found so far.
    pub(in crate::api::v1) errors: Vec<Fault>,
    /// Forms of the request and of its answer.
    pub(in crate::api::v1) form: Form,
    /// Where its fields are.
    pub(in crate::api::v1) places: Places,
}

/// Finds the dictionary and reads a request for it.
pub(in crate::api::v1) async fn receive<R: AskingRequest>(
    app: &App,
    key: &str,
    batch: Batch,
) -> Result<Received<R>, Problem> {
    let ready = ready::find(app, key).await?;
    let (Batch { body, form }, limits) = (batch, app.limits);
    let reader = form.clone();
    let (mut request, places) = app.pool.read(body, move |text| reader.parse::<R>(&limits, text)).await?;
    let mut errors = Vec::new();
    let shapes = request.take_shapes(&mut errors);
    Ok(Received { ready, request, shapes, errors, form, places })
}

/// Answers a request about shapes: checks its settings, resolves its shapes, predicts the work and computes. `settings` also
/// gives the number of numbers that the answer has for each shape, besides its code.
pub(in crate::api::v1) async fn ask_dictionary<
    R,
    T: Send + 'static,
    L: ResultList<Common = ByDictionary> + 'static,
>(
    app: App,
    received: Received<R>,
    settings: impl FnOnce(R, &Ready, &mut Vec<Fault>) -> Option<(T, usize)>,
    answer: impl FnOnce(&App, &Ready, Asked, T) -> Result<(Outcomes<L::Answer>, ByDictionary), ServiceError>
    + Send
    + 'static,
) -> Result<Response, Problem> {
    let Received { ready, request, shapes, mut errors, form, places } = received;
    let settings = settings(request, &ready, &mut errors);
    let asked = shapes.ask(&app, &ready, settings, errors, form.on_error).await;
    let ((settings, numbers), asked) = asked.map_err(|error| places.of(error))?;
    let (work, names) = (asked.work(&ready, numbers, &app.limits), asked.names.clone());
    let directions = asked.directions(&ready);
    compute_unwaiting(app.weighing(work), move |app| {
        let found = answer(app, &ready, asked, settings);
        let answered = found.and_then(|(outcomes, common)| {
            form.respond::<L>(&places, names, outcomes, common.and(directions))
        });
        answered.map_err(|error| places.of(error))
    })
    .await
}

/// A training quantile as the only setting.
pub(in crate::api::v1) fn quantile_of(
    quantile: Option<Checked<f64>>,
    errors: &mut Vec<Fault>,
) -> Option<(f64, usize)> {
    let quantile = quantile.map_or(Some(OUTLIER_QUANTILE), |quantile| quantile.take("/quantile", errors))?;
    Some((quantile, 0))
}

/// Number of parameters of residuals. Default: the number of control points.
pub(in crate::api::v1) fn samples_of(
    samples: Option<Checked<usize>>,
    ready: &Ready,
    errors: &mut Vec<Fault>,
) -> Option<usize> {
    samples.map_or(Some(ready.setup.metric.size()), |samples| samples.take("/samples", errors))
}

/// Shapes of a request: posted ones, or references to stored ones.
pub(in crate::api::v1) struct Shapes {
    pub(in crate::api::v1) posted: Option<Vec<ShapeInput>>,
    pub(in crate::api::v1) cohort: Option<String>,
    pub(in crate::api::v1) ids: Option<Vec<String>>,
    /// Whether the cohort may have another correspondence than the dictionary, whose parameters its shapes are to get.
    pub(in crate::api::v1) other_parameters: bool,
}

impl Shapes {
    /// Whether parts of posted shapes are missing.
    pub(in crate::api::v1) fn have_missing_parts(&self) -> bool {
        self.posted.iter().flatten().any(ShapeInput::has_missing_parts)
    }

    /// Resolves the shapes if the request has no faults.
    pub(in crate::api::v1) async fn ask<T>(
        self,
        app: &App,
        ready: &Ready,
        value: Option<T>,
        mut errors: Vec<Fault>,
        on_error: OnError,
    ) -> Result<(T, Asked), ServiceError> {
        let one_way = "expected either shapes, or cohort and ids";
        let stored = match (&self.posted, self.cohort, self.ids) {
            (Some(_), None, None) => None,
            (None, Some(cohort), Some(ids)) => Some((cohort, ids)),
            _ if !errors.is_empty() => None,
            _ => {
                errors.push(Fault::new("", one_way));
                None
            }
        };
        let (value, posted) = checked(value, errors, self.posted.unwrap_or_default())?;
        let asked = match stored {
            Some((cohort, ids)) => {
                Asked::stored(app, ready, (&cohort, &ids), (on_error, self.other_parameters)).await?
            }
            None => Asked::posted(posted, on_error),
        };
        Ok((value, asked))
    }
}

asking_request! {
    /// Shapes to encode.
    #[schema(example = json!({"cohort": "example-cells", "ids": ["cell0004"]}))]
    EncodeRequest {}
}

results! {
    /// Codes.
    EncodeAnswer with ByDictionary of EncodeResult: EncodedShape with CodeOutput
}

/// Encodes shapes in a dictionary: sparse codes with their certificates, or scores of components.
///
/// Lines of NDJSON are shapes; the other fields of the request are parameters then.
#[utoipa::path(post, path = "/v1/dictionaries/{dictionary}/encode", tag = "dictionaries",
    params(("dictionary" = String, Path, description = "Id, `name@version`, `name@alias` or name"), BatchQuery),
    request_body(content((EncodeRequest = "application/json"), (ShapeInput = "application/x-ndjson"), (Binary = "application/octet-stream"))),
    responses(
        (status = 200, description = "One code per shape, in order", content((EncodeAnswer = "application/json"), (EncodeResult = "application/x-ndjson"))),
        (status = 404, description = "No such dictionary or cohort")
    ))]
pub(in crate::api::v1) async fn encode(
    Caller(app): Caller,
    Path(key): Path<String>,
    batch: Batch,
) -> Result<Response, Problem> {
    let received = receive::<EncodeRequest>(&app, &key, batch).await?;
    let settings = |_, _: &Ready, _: &mut Vec<Fault>| Some(((), 0));
    ask_dictionary::<_, _, EncodeAnswer>(app, received, settings, |app, ready, asked, ()| {
        let codes = coding::encode(app, ready, asked)?.map(|index, coded| {
            CodeOutput::new(ready.dictionary(), &coded).map_err(|error| of_shape(index, error))
        });
        Ok((codes, ByDictionary::new(ready)))
    })
    .await
}

asking_request! {
    /// Shapes or codes to reconstruct.
    #[schema(example = json!({"cohort": "example-cells", "ids": ["cell0004"], "samples": 8}))]
    ReconstructRequest {
        /// Codes in place of shapes: `indices` with `values`, or with the `matrices` and the `offset` of invariant codes.
        #[schema(value_type = Option<Vec<PostedCode>>)]
        codes: Many<PostedCode>;
        /// Pose of the result: `input` (that of the shape) or `model` (that of the dictionary). Default: `input`.
        #[schema(value_type = Option<AnswerPose>)]
        pose: Checked<AnswerPose>;
        /// Number of parameters at which the distance to the shape is returned. Default: the number of control points.
        #[schema(value_type = Option<usize>)]
        samples: Checked<usize>;
    }
}

/// Shape reconstructed from its code.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct ReconstructionOutput {
    /// Control points in the representation.
    control_points: Points,
    /// `‖y − ŷ‖²/(‖y‖‖ŷ‖)` in the pose of the dictionary; null for posted codes.
    relative_error: Option<f64>,
    /// Distances between the shape and its reconstruction at equally spaced parameters: `i/samples` on closed curves,
    /// `i/(samples − 1)` on open ones, every point of landmarks. Null for posted codes.
    residual: Option<Vec<f64>>,
}

impl ReconstructionOutput {
    fn new(ready: &Ready, reconstruction: Reconstruction) -> Self {
        let dimension = ready.setup.metric.dimension();
        Self {
            control_points: Points::from_columns(reconstruction.control_points, dimension),
            residual: reconstruction.relative_error.map(|_| reconstruction.residual),
            relative_error: reconstruction.relative_error,
        }
    }
}

results! {
    /// Reconstructions.
    ReconstructAnswer with ByDictionary of ReconstructResult: ReconstructedShape with ReconstructionOutput
}

/// Reconstructs shapes from their codes in a dictionary, or from posted codes.
///
/// Lines of NDJSON are shapes; the other fields of the request are parameters then. As SVG or PNG: the first shapes, coloured by
/// the distance to their reconstructions, or the shapes of posted codes.
#[utoipa::path(post, path = "/v1/dictionaries/{dictionary}/reconstruct", tag = "dictionaries",
    params(
        ("dictionary" = String, Path, description = "Id, `name@version`, `name@alias` or name"), BatchQuery,
        ("format" = Option<String>, Query, description = "`json`, `svg` or `png`"), DrawingQuery
    ),
    request_body(content((ReconstructRequest = "application/json"), (ShapeInput = "application/x-ndjson"), (Binary = "application/octet-stream"))),
    responses(
        (status = 200, description = "One reconstruction per shape or code, in order", content((ReconstructAnswer = "application/json"), (ReconstructResult = "application/x-ndjson"), (String = "image/svg+xml"))),
        (status = 404, description = "No such dictionary or cohort")
    ))]
pub(in crate::api::v1) async fn reconstruct(
    Caller(app): Caller,
    Path(key): Path<String>,
    batch: DrawnBatch,
) -> Result<Response, Problem> {
    let DrawnBatch { batch, picture } = batch;
    let received = receive::<ReconstructRequest>(&app, &key, batch).await?;
    if received.request.codes.is_some() {
        return reconstruct_codes(app, received, picture).await;
    }
    let settings = ReconstructRequest::settings;
    if let Some(file) = picture {
        let draw =
            |app: &App, ready: &Ready, asked, (pose, _)| pictures::reconstructed(app, ready, asked, pose);
        return draw_dictionary(app, received, file, settings, draw).await;
    }
    let answer = |app: &App, ready: &Ready, asked, (pose, samples)| {
        let shapes = coding::reconstruct_shapes(app, ready, asked, pose, samples)?;
        let shapes = shapes.map(|_, shape| Ok(ReconstructionOutput::new(ready, shape)));
        Ok((shapes, ByDictionary::new(ready)))
    };
    ask_dictionary::<_, _, ReconstructAnswer>(app, received, settings, answer).await
}

impl ReconstructRequest {
    /// Pose of the results and number of distances.
    fn settings(self, ready: &Ready, errors: &mut Vec<Fault>) -> Option<((AnswerPose, usize), usize)> {
        let pose = take_or_default(self.pose, "/pose", errors);
        let samples = samples_of(self.samples, ready, errors);
        pose.zip(samples).map(|(pose, samples)| ((pose, samples), samples))
    }
}

/// Answers a request to reconstruct posted codes.
async fn reconstruct_codes(
    app: App,
    received: Received<ReconstructRequest>,
    file: Option<PictureFile>,
) -> Result<Response, Problem> {
    let Received { ready, request, shapes, mut errors, form, places } = received;
    let codes = take_many(request.codes, "/codes", &mut errors);
    let with_settings = request.pose.is_some() || request.samples.is_some();
    take_or_default(request.pose, "/pose", &mut errors);
    samples_of(request.samples, &ready, &mut errors);
    if shapes.posted.is_some() || shapes.cohort.is_some() || shapes.ids.is_some() || with_settings {
        let detail = "expected codes alone, without shapes, cohort, ids, pose and samples";
        errors.push(Fault::new("/codes", detail));
    }
    let (codes, _) = checked(codes, errors, shapes.posted.unwrap_or_default())?;
    let drawn = file.as_ref().map_or(Work::from_seconds(0.0), requests::picture);
    let work = ready.work(codes.len(), 0, &app.limits) + drawn;
    compute(app.weighing(work), move |app| {
        if let Some(file) = file {
            return picture(&pictures::reconstructed_codes(app, &ready, &codes)?, &file);
        }
        let names = vec![InputNames::default(); codes.len()];
        let shapes = coding::reconstruct_codes(app, &ready, &codes, form.on_error)?;
        let shapes = shapes.map(|_, shape| Ok(ReconstructionOutput::new(&ready, shape)));
        form.respond::<ReconstructAnswer>(&places, names, shapes, ByDictionary::new(&ready))
    })
    .await
}

asking_request! {
    /// Shapes to compare with the training shapes.
    #[schema(example = json!({"cohort": "example-cells", "ids": ["cell0004"], "quantile": 0.99}))]
    ScoreRequest {
        /// Fraction of shapes like the training shapes that should not count as outliers, at least 0.5. Default: 0.99.
        #[schema(value_type = Option<f64>, minimum = 0.5, exclusive_maximum = 1)]
        quantile: Checked<f64>;
    }
}

/// Scores of a shape.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct ScoreOutput {
    /// Scores of the components; null for sparse dictionaries.
    scores: Option<Vec<f64>>,
    /// Comparison with the training shapes.
    novelty: NoveltyOutput,
}

results! {
    /// Scores.
    ScoreAnswer with ByDictionary of ScoreResult: ScoredShape with ScoreOutput
}

/// Scores shapes: component scores, `T²`, squared prediction error, and whether they are outliers.
///
/// Shapes are compared with the training shapes as they scored when held out, so that among similar new shapes the fraction
/// called outliers matches the quantile. Older dictionaries without such a record compare with the shapes they were learnt
/// from, and say so in `warnings`.
///
/// Lines of NDJSON are shapes; the other fields of the request are parameters then.
#[utoipa::path(post, path = "/v1/dictionaries/{dictionary}/score", tag = "dictionaries",
    params(("dictionary" = String, Path, description = "Id, `name@version`, `name@alias` or name"), BatchQuery),
    request_body(content((ScoreRequest = "application/json"), (ShapeInput = "application/x-ndjson"), (Binary = "application/octet-stream"))),
    responses(
        (status = 200, description = "One score per shape, in order", content((ScoreAnswer = "application/json"), (ScoreResult = "application/x-ndjson"))),
        (status = 404, description = "No such dictionary or cohort")
    ))]
pub(in crate::api::v1) async fn score(
    Caller(app): Caller,
    Path(key): Path<String>,
    batch: Batch,
) -> Result<Response, Problem> {
    let received = receive::<ScoreRequest>(&app, &key, batch).await?;
    let settings = |request: ScoreRequest, _: &Ready, errors: &mut _| quantile_of(request.quantile, errors);
    ask_dictionary::<_, _, ScoreAnswer>(app, received, settings, |app, ready, asked, quantile| {
        let output = |score: Score| ScoreOutput { novelty: NoveltyOutput::new(&score), scores: score.scores };
        let scores = coding::score(app, ready, asked, quantile)?.map(|_, score| Ok(output(score)));
        Ok((scores, ByDictionary::with_warnings(ready)))
    })
    .await
}

asking_request! {
    /// Shapes at which to evaluate the prior.
    #[schema(example = json!({"cohort": "example-cells", "ids": ["cell0004"], "reference": "mean", "gamma": 1.0}))]
    PriorRequest {
        /// Subspace of the prior: `mean` (the mean shape under the class) or `atoms` (the span of all atoms under the class).
        /// Default: `mean`.
        #[schema(value_type = Option<Reference>)]
        reference: Checked<Reference>;
        /// Weight `γ` of the prior. Default: 1.
        #[schema(value_type = Option<f64>, exclusive_minimum = 0)]
        gamma: Checked<f64>;
    }
}

/// Prior energy at a shape.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct EnergyOutput {
    /// Energy `γ‖r − P r‖²`.
    energy: f64,
    /// Gradient of the energy with respect to the control points, one row per point.
    gradient: Points,
}

results! {
    /// Priors.
    PriorAnswer with ByDictionary of PriorResult: ShapeWithPrior with EnergyOutput
}

/// Computes the energy and gradient of the shape prior, for curves being fitted to an image.
///
/// Points correspond as given, and no start point is searched: a curve initialised with the mean shape keeps its parameters.
///
/// Lines of NDJSON are shapes; the other fields of the request are parameters then.
#[utoipa::path(post, path = "/v1/dictionaries/{dictionary}/prior", tag = "dictionaries",
    params(("dictionary" = String, Path, description = "Id, `name@version`, `name@alias` or name"), BatchQuery),
    request_body(content((PriorRequest = "application/json"), (ShapeInput = "application/x-ndjson"), (Binary = "application/octet-stream"))),
    responses(
        (status = 200, description = "One energy per shape, in order", content((PriorAnswer = "application/json"), (PriorResult = "application/x-ndjson"))),
        (status = 404, description = "No such dictionary or cohort")
    ))]
pub(in crate::api::v1) async fn prior(
    Caller(app): Caller,
    Path(key): Path<String>,
    batch: Batch,
) -> Result<Response, Problem> {
    let received = receive::<PriorRequest>(&app, &key, batch).await?;
    let settings = |request: PriorRequest, _: &Ready, errors: &mut Vec<Fault>| {
        let reference = take_or_default(request.reference, "/reference", errors);
        let gamma = request.gamma.map_or(Some(1.0), |gamma| gamma.take("/gamma", errors));
        reference.zip(gamma).map(|settings| (settings, 0))
    };
    ask_dictionary::<_, _, PriorAnswer>(app, received, settings, |app, ready, asked, (reference, gamma)| {
        let dimension = ready.setup.metric.dimension();
        let output = |prior: Energy| EnergyOutput {
            energy: prior.energy,
            gradient: Points::from_columns(prior.gradient, dimension),
        };
        let priors = coding::prior(app, ready, asked, reference, gamma)?;
        Ok((priors.map(|_, prior| Ok(output(prior))), ByDictionary::new(ready)))
    })
    .await
}

document! {
    /// Parameters of the random draw.
    #[schema(example = json!({"count": 2, "seed": 7}))]
    pub(in crate::api::v1) struct SampleRequest {
        /// Number of shapes. Default: 1.
        #[schema(value_type = Option<usize>, minimum = 1)]
        count: Checked<usize>;
        /// Seed: the same seed draws the same shapes. Default: 0.
        #[schema(value_type = Option<u64>)]
        seed: Checked<u64>;
        /// Scale of the deviations from the mean. Default: 1.
        #[schema(value_type = Option<f64>, minimum = 0, maximum = 1000000)]
        sigma: Checked<f64>;
    }
}

/// Random shape.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct SampleOutput {
    /// Scores of the shape.
    scores: Vec<f64>,
    #[serde(flatten)]
    shape: ShapeOutput,
}

impl SampleOutput {
    fn new(sample: Sample, dimension: usize) -> Self {
        let control_points = Points::from_columns(sample.control_points, dimension);
        Self { scores: sample.scores, shape: ShapeOutput { control_points } }
    }
}

/// Random shapes, in the pose of the dictionary.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct SampleAnswer {
    /// The dictionary.
    dictionary: UsedDictionary,
    /// Random shapes.
    shapes: Vec<SampleOutput>,
}

/// Draws plausible shapes, with scores from a normal distribution with the mean and covariance of the training scores.
#[utoipa::path(post, path = "/v1/dictionaries/{dictionary}/sample", tag = "dictionaries", request_body = SampleRequest,
    params(("dictionary" = String, Path, description = "Id, `name@version`, `name@alias` or name")),
    responses(
        (status = 200, description = "The shapes", body = SampleAnswer),
        (status = 404, description = "No such dictionary")
    ))]
pub(in crate::api::v1) async fn sample(
    Caller(app): Caller,
    _: NoQuery,
    Path(key): Path<String>,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    let ready = ready::find(&app, &key).await?;
    let request: SampleRequest = app.parse(&body)?;
    let mut errors = request.faults;
    let count = request.count.map_or(Some(1), |count| count.take("/count", &mut errors));
    let seed = take_or_default(request.seed, "/seed", &mut errors);
    let sigma = request.sigma.map_or(Some(1.0), |sigma| sigma.take("/sigma", &mut errors));
    let settings = count.zip(seed).zip(sigma);
    let (((count, seed), sigma), _) = checked(settings, errors, Vec::new())?;
    let work = ready.work(count, 0, &app.limits);
    compute(app.weighing(work), move |app| {
        let dimension = ready.setup.metric.dimension();
        let shapes = coding::sample(app, &ready, count, seed, sigma)?;
        let shapes = shapes.into_iter().map(|sample| SampleOutput::new(sample, dimension)).collect();
        json(StatusCode::OK, &SampleAnswer { dictionary: UsedDictionary::new(&ready), shapes })
    })
    .await
}
