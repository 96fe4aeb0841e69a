//! Dictionaries in use: encode, reconstruct, score, prior, sample.

use axum::http::StatusCode;
use axum::response::Response;
use serde::Serialize;

use super::settings::{ShapeOutput, checked, rows};
use crate::api::extract::{Caller, JsonBody, NoQuery, Path};
use crate::api::problem::{Problem, ProblemDocument};
use crate::api::respond::{compute, json};
use crate::formats::InputError;
use crate::formats::checked::{Checked, List, Many, document, take_given, take_many, take_or_default};
use crate::formats::shape::{Points, ShapeInput};
use crate::service::app::{App, ServiceError};
use crate::service::dictionaries::coding::{AnswerPose, Asked, Coded, PostedCode, Reconstruction, Reference};
use crate::service::dictionaries::ready::Ready;
use crate::service::dictionaries::{coding, ready};

/// Declares a request with shapes, posted or stored, and further fields.
macro_rules! asking_request {
    ($(#[$meta:meta])* $name:ident { $($further:tt)* }) => {
        document! {
            $(#[$meta])*
            pub(super) struct $name {
                /// Shapes, as for the cohorts of the dictionary; or `cohort` and `ids`.
                #[schema(value_type = Option<Vec<ShapeInput>>)]
                shapes: List<ShapeInput>;
                /// Id or name of a cohort in the representation of the dictionary.
                #[schema(value_type = Option<String>)]
                cohort: Checked<String>;
                /// Ids or external ids of its shapes.
                #[schema(value_type = Option<Vec<String>>)]
                ids: Many<String>;
                $($further)*
            }
        }

        impl $name {
            /// The dictionary that is asked, the request without its shapes, these, and what is wrong so far.
            async fn receive(
                app: &App,
                key: &str,
                body: axum::body::Bytes,
            ) -> Result<(std::sync::Arc<Ready>, Self, Shapes, Vec<InputError>), Problem> {
                let ready = ready::find(app, key).await?;
                let mut request: Self = app.read(body).await?;
                let mut errors = std::mem::take(&mut request.faults);
                let shapes = Shapes {
                    posted: request.shapes.take().map(|shapes| shapes.take("/shapes", &mut errors)),
                    cohort: take_given(request.cohort.take(), "/cohort", &mut errors),
                    ids: take_many(request.ids.take(), "/ids", &mut errors),
                };
                Ok((ready, request, shapes, errors))
            }
        }
    };
}

pub(super) use asking_request;

/// The shapes of a request, as they stand there.
pub(super) struct Shapes {
    pub(super) posted: Option<Vec<ShapeInput>>,
    pub(super) cohort: Option<String>,
    pub(super) ids: Option<Vec<String>>,
}

impl Shapes {
    /// The shapes, when nothing is wrong with the request.
    pub(super) async fn ask<T>(
        self,
        app: &App,
        ready: &Ready,
        value: Option<T>,
        mut errors: Vec<InputError>,
    ) -> Result<(T, Asked), ServiceError> {
        let one_way = "give either shapes, or cohort and ids";
        let stored = match (&self.posted, self.cohort, self.ids) {
            (Some(_), None, None) => None,
            (None, Some(cohort), Some(ids)) => Some((cohort, ids)),
            _ if !errors.is_empty() => None,
            _ => {
                errors.push(InputError::new("", one_way));
                None
            }
        };
        let (value, posted) = checked(value, errors, self.posted.unwrap_or_default())?;
        let asked = match stored {
            Some((cohort, ids)) => coding::stored(app, ready, &cohort, &ids).await?,
            None => Asked::Posted(posted),
        };
        Ok((value, asked))
    }
}

asking_request! {
    /// Shapes to be coded.
    #[schema(example = json!({"cohort": "example-cells", "ids": ["cell0004"]}))]
    EncodeRequest {}
}

/// The transformation that brings a shape into the pose of the dictionary: `y = A r + b`.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct TransformationOutput {
    /// Matrix `A`, row by row.
    matrix: Vec<Vec<f64>>,
    /// `b`.
    offset: Vec<f64>,
    /// Row of the control points that becomes the first.
    start: u32,
    /// Whether the shape is traversed in reverse.
    reversed: bool,
    /// Whether the match is a mirror image.
    mirrored: bool,
}

/// A code with its certificate.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct CodeOutput {
    /// Atoms in use, from 0, ascending.
    indices: Vec<usize>,
    /// Their coefficients, or scores; for moved atoms the norms `‖B_j d_j‖` in the pose of the dictionary, which do not
    /// depend on the pose of the shape.
    values: Vec<f64>,
    /// For invariant codes: `B_j`, row by row, in the pose of the shape, `r ≈ Σ B_j d_j + offset`.
    #[serde(skip_serializing_if = "Option::is_none")]
    matrices: Option<Vec<Vec<Vec<f64>>>>,
    /// For invariant codes: what is added.
    #[serde(skip_serializing_if = "Option::is_none")]
    offset: Option<Vec<f64>>,
    /// Real numbers in the code.
    parameters: usize,
    /// `½‖y − ŷ‖²` plus the penalty.
    objective: f64,
    /// The objective is at most this far above the minimum; null without a penalty.
    duality_gap: Option<f64>,
    /// `‖y − ŷ‖/‖y‖`.
    relative_error: f64,
    /// How the shape comes into the pose of the dictionary.
    transformation: TransformationOutput,
}

impl CodeOutput {
    pub(super) fn new(ready: &Ready, coded: &Coded) -> Result<Self, ServiceError> {
        let (code, prepared) = (&coded.code, &coded.prepared);
        let moves = coded.moves(ready)?;
        Ok(Self {
            indices: code.indices.clone(),
            values: coded.magnitudes(ready),
            matrices: moves.as_ref().map(|moves| moves.matrices.iter().map(rows).collect()),
            offset: moves.map(|moves| moves.offset),
            parameters: code.values.len(),
            objective: code.objective,
            duality_gap: code.duality_gap,
            relative_error: code.relative_error,
            transformation: TransformationOutput {
                matrix: rows(&prepared.matrix),
                offset: prepared.offset.clone(),
                start: prepared.placement.shift,
                reversed: prepared.placement.reversed,
                mirrored: prepared.placement.mirrored,
            },
        })
    }
}

/// Codes, one a shape, in order.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct EncodeAnswer {
    /// One entry per shape.
    codes: Vec<CodeOutput>,
}

/// Codes shapes in a dictionary: sparse codes with their certificate, or the scores of components.
#[utoipa::path(post, path = "/dictionaries/{dictionary}/encode", tag = "dictionaries", request_body = EncodeRequest,
    params(("dictionary" = String, Path, description = "Id, `name@version` or name")),
    responses(
        (status = 200, description = "One code a shape, in order", body = EncodeAnswer),
        (status = 404, description = "No such dictionary or cohort", body = ProblemDocument, content_type = "application/problem+json"),
        (status = "4XX", description = "The input was refused", body = ProblemDocument, content_type = "application/problem+json")
    ))]
pub(super) async fn encode(
    Caller(app): Caller,
    _: NoQuery,
    Path(key): Path<String>,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    let (ready, _, shapes, errors) = EncodeRequest::receive(&app, &key, body).await?;
    let ((), asked) = shapes.ask(&app, &ready, Some(()), errors).await?;
    let work = asked.work(&ready, 0, &app.limits);
    compute(app.weighing(work), move |app| {
        let coded = coding::encode(app, &ready, asked)?;
        let codes = coded.iter().map(|coded| CodeOutput::new(&ready, coded)).collect::<Result<_, _>>()?;
        json(StatusCode::OK, &EncodeAnswer { codes })
    })
    .await
}

asking_request! {
    /// Shapes, or codes, to be reconstructed.
    #[schema(example = json!({"cohort": "example-cells", "ids": ["cell0004"], "samples": 8}))]
    ReconstructRequest {
        /// Codes instead of shapes: `indices` with `values`, or with the `matrices` and the `offset` of invariant codes.
        #[schema(value_type = Option<Vec<PostedCode>>)]
        codes: Many<PostedCode>;
        /// `input` (the pose of the shape) unless given, or `model` (that of the dictionary).
        #[schema(value_type = Option<AnswerPose>)]
        pose: Checked<AnswerPose>;
        /// Parameters at which the distance to the shape is answered; as many as control points unless given.
        #[schema(value_type = Option<usize>)]
        samples: Checked<usize>;
    }
}

/// A reconstructed shape.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct ReconstructionOutput {
    /// Control points in the representation.
    control_points: Points,
    /// `‖y − ŷ‖²/(‖y‖‖ŷ‖)` in the pose of the dictionary; null for codes.
    relative_error: Option<f64>,
    /// Distances between the shape and its reconstruction at equally spaced parameters: `i/samples` of closed curves,
    /// `i/(samples − 1)` of open ones, every landmark; null for codes.
    residual: Option<Vec<f64>>,
}

/// Reconstructions, one a shape or code, in order.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct ReconstructAnswer {
    /// One entry per shape or code.
    shapes: Vec<ReconstructionOutput>,
}

impl ReconstructAnswer {
    fn new(reconstructions: Vec<Reconstruction>, dimension: usize) -> Self {
        let output = |reconstruction: Reconstruction| ReconstructionOutput {
            control_points: Points::from_columns(reconstruction.control_points, dimension),
            residual: reconstruction.relative_error.map(|_| reconstruction.residual),
            relative_error: reconstruction.relative_error,
        };
        Self { shapes: reconstructions.into_iter().map(output).collect() }
    }
}

/// Reconstructs shapes from their codes in a dictionary, or from posted codes.
#[utoipa::path(post, path = "/dictionaries/{dictionary}/reconstruct", tag = "dictionaries", request_body = ReconstructRequest,
    params(("dictionary" = String, Path, description = "Id, `name@version` or name")),
    responses(
        (status = 200, description = "One reconstruction a shape or code, in order", body = ReconstructAnswer),
        (status = 404, description = "No such dictionary or cohort", body = ProblemDocument, content_type = "application/problem+json"),
        (status = "4XX", description = "The input was refused", body = ProblemDocument, content_type = "application/problem+json")
    ))]
pub(super) async fn reconstruct(
    Caller(app): Caller,
    _: NoQuery,
    Path(key): Path<String>,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    let (ready, request, shapes, mut errors) = ReconstructRequest::receive(&app, &key, body).await?;
    let with_codes = request.codes.is_some();
    let codes = take_many(request.codes, "/codes", &mut errors);
    let with_settings = request.pose.is_some() || request.samples.is_some();
    let pose = take_or_default(request.pose, "/pose", &mut errors);
    let samples =
        request.samples.map_or(Some(ready.setup.metric.size()), |s| s.take("/samples", &mut errors));
    let dimension = ready.setup.metric.dimension();
    if with_codes {
        if shapes.posted.is_some() || shapes.cohort.is_some() || shapes.ids.is_some() || with_settings {
            let detail = "codes stand alone: without shapes, cohort, ids, pose and samples";
            errors.push(InputError::new("/codes", detail));
        }
        let (codes, _) = checked(codes, errors, shapes.posted.unwrap_or_default())?;
        let work = ready.work(codes.len(), 0, &app.limits);
        return compute(app.weighing(work), move |app| {
            let shapes = coding::reconstruct_codes(app, &ready, &codes)?;
            json(StatusCode::OK, &ReconstructAnswer::new(shapes, dimension))
        })
        .await;
    }
    let ((pose, samples), asked) = shapes.ask(&app, &ready, pose.zip(samples), errors).await?;
    let work = asked.work(&ready, samples, &app.limits);
    compute(app.weighing(work), move |app| {
        let shapes = coding::reconstruct_shapes(app, &ready, asked, pose, samples)?;
        json(StatusCode::OK, &ReconstructAnswer::new(shapes, dimension))
    })
    .await
}

asking_request! {
    /// Shapes to be compared with those that were learnt from.
    #[schema(example = json!({"cohort": "example-cells", "ids": ["cell0004"], "quantile": 0.99}))]
    ScoreRequest {
        /// Part of shapes like those that were learnt from that shall not be called outliers, from 0.5; 0.99 unless given.
        #[schema(value_type = Option<f64>)]
        quantile: Checked<f64>;
    }
}

/// How a shape compares with those that were learnt from.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct ScoreOutput {
    /// Scores of the components; null for sparse dictionaries.
    scores: Option<Vec<f64>>,
    /// `T²`: squared Mahalanobis distance of the scores; null for sparse dictionaries.
    t_squared: Option<f64>,
    /// Part of the training shapes with a smaller or equal one when they were held out.
    t_squared_rank: Option<f64>,
    /// Squared prediction error `‖y − ŷ‖²`.
    squared_prediction_error: f64,
    /// Part of the training shapes with a smaller or equal one when they were held out.
    squared_prediction_error_rank: f64,
    /// Whether one of the two exceeds the limit that the quantile sets for both together.
    outlier: bool,
}

impl ScoreOutput {
    pub(super) fn new(score: coding::Score) -> Self {
        Self {
            scores: score.scores,
            t_squared: score.t_squared,
            t_squared_rank: score.t_squared_rank,
            squared_prediction_error: score.residual,
            squared_prediction_error_rank: score.residual_rank,
            outlier: score.outlier,
        }
    }
}

/// Scores, one a shape, in order.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct ScoreAnswer {
    /// One entry per shape.
    scores: Vec<ScoreOutput>,
    /// What to know about them; absent when there is nothing.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    warnings: Vec<String>,
}

/// Scores shapes: component scores, `T²`, squared prediction error, and whether they are outliers.
///
/// A shape is compared with the training shapes as they looked when they were held out, so that of new shapes like them
/// as many are called outliers as the quantile says. Dictionaries from before there was such a record compare with the
/// shapes they were learnt from, and say so in `warnings`.
#[utoipa::path(post, path = "/dictionaries/{dictionary}/score", tag = "dictionaries", request_body = ScoreRequest,
    params(("dictionary" = String, Path, description = "Id, `name@version` or name")),
    responses(
        (status = 200, description = "One score a shape, in order", body = ScoreAnswer),
        (status = 404, description = "No such dictionary or cohort", body = ProblemDocument, content_type = "application/problem+json"),
        (status = "4XX", description = "The input was refused", body = ProblemDocument, content_type = "application/problem+json")
    ))]
pub(super) async fn score(
    Caller(app): Caller,
    _: NoQuery,
    Path(key): Path<String>,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    let (ready, request, shapes, mut errors) = ScoreRequest::receive(&app, &key, body).await?;
    let quantile = request.quantile.map_or(Some(0.99), |q| q.take("/quantile", &mut errors));
    let (quantile, asked) = shapes.ask(&app, &ready, quantile, errors).await?;
    let work = asked.work(&ready, 0, &app.limits);
    compute(app.weighing(work), move |app| {
        let scores = coding::score(app, &ready, asked, quantile)?;
        let scores = scores.into_iter().map(ScoreOutput::new).collect();
        json(StatusCode::OK, &ScoreAnswer { scores, warnings: coding::outlier_warnings(&ready) })
    })
    .await
}

asking_request! {
    /// Shapes at which a prior is evaluated.
    #[schema(example = json!({"cohort": "example-cells", "ids": ["cell0004"], "reference": "mean", "gamma": 1.0}))]
    PriorRequest {
        /// `mean` (the mean shape under the class) unless given, or `atoms` (the span of all atoms under the class).
        #[schema(value_type = Option<Reference>)]
        reference: Checked<Reference>;
        /// Weight of the prior; 1 unless given.
        #[schema(value_type = Option<f64>)]
        gamma: Checked<f64>;
    }
}

/// The prior at a shape.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct EnergyOutput {
    /// `γ‖r − P r‖²`.
    energy: f64,
    /// Its derivatives by the control points, one row a point.
    gradient: Points,
}

/// Priors, one a shape, in order.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct PriorAnswer {
    /// One entry per shape.
    priors: Vec<EnergyOutput>,
}

/// Energy and gradient of the shape prior at shapes, for curves that are being fitted to an image.
///
/// Points correspond as they stand: a curve that started from the mean shape keeps its parameters, and no start point is
/// searched.
#[utoipa::path(post, path = "/dictionaries/{dictionary}/prior", tag = "dictionaries", request_body = PriorRequest,
    params(("dictionary" = String, Path, description = "Id, `name@version` or name")),
    responses(
        (status = 200, description = "One energy a shape, in order", body = PriorAnswer),
        (status = 404, description = "No such dictionary or cohort", body = ProblemDocument, content_type = "application/problem+json"),
        (status = "4XX", description = "The input was refused", body = ProblemDocument, content_type = "application/problem+json")
    ))]
pub(super) async fn prior(
    Caller(app): Caller,
    _: NoQuery,
    Path(key): Path<String>,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    let (ready, request, shapes, mut errors) = PriorRequest::receive(&app, &key, body).await?;
    let reference = take_or_default(request.reference, "/reference", &mut errors);
    let gamma = request.gamma.map_or(Some(1.0), |gamma| gamma.take("/gamma", &mut errors));
    let ((reference, gamma), asked) = shapes.ask(&app, &ready, reference.zip(gamma), errors).await?;
    let work = asked.work(&ready, 0, &app.limits);
    compute(app.weighing(work), move |app| {
        let dimension = ready.setup.metric.dimension();
        let priors = coding::prior(app, &ready, asked, reference, gamma)?;
        let output = |prior: crate::analysis::dictionary::prior::Energy| EnergyOutput {
            energy: prior.energy,
            gradient: Points::from_columns(prior.gradient, dimension),
        };
        json(StatusCode::OK, &PriorAnswer { priors: priors.into_iter().map(output).collect() })
    })
    .await
}

document! {
    /// Shapes to be drawn.
    #[schema(example = json!({"count": 2, "seed": 7}))]
    pub(super) struct SampleRequest {
        /// Number of shapes, 1 unless given.
        #[schema(value_type = Option<usize>, minimum = 1)]
        count: Checked<usize>;
        /// The same seed draws the same shapes; 0 unless given.
        #[schema(value_type = Option<u64>)]
        seed: Checked<u64>;
        /// Scale of the deviations from the mean; 1 unless given.
        #[schema(value_type = Option<f64>)]
        sigma: Checked<f64>;
    }
}

/// A drawn shape.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct SampleOutput {
    /// Its scores.
    scores: Vec<f64>,
    #[serde(flatten)]
    shape: ShapeOutput,
}

/// Drawn shapes, in the pose of the dictionary.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct SampleAnswer {
    /// Shapes.
    shapes: Vec<SampleOutput>,
}

/// Draws plausible shapes: scores from a normal distribution with the mean and covariance of the training scores.
#[utoipa::path(post, path = "/dictionaries/{dictionary}/sample", tag = "dictionaries", request_body = SampleRequest,
    params(("dictionary" = String, Path, description = "Id, `name@version` or name")),
    responses(
        (status = 200, description = "The shapes", body = SampleAnswer),
        (status = 404, description = "No such dictionary", body = ProblemDocument, content_type = "application/problem+json"),
        (status = "4XX", description = "The input was refused", body = ProblemDocument, content_type = "application/problem+json")
    ))]
pub(super) async fn sample(
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
        let output = |sample: coding::Sample| SampleOutput {
            scores: sample.scores,
            shape: ShapeOutput { control_points: Points::from_columns(sample.control_points, dimension) },
        };
        let shapes = coding::sample(app, &ready, count, seed, sigma)?;
        json(StatusCode::OK, &SampleAnswer { shapes: shapes.into_iter().map(output).collect() })
    })
    .await
}
