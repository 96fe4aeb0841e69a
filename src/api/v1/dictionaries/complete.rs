//! Completion of shapes of which a part is known.

use std::sync::Arc;

use axum::http::StatusCode;
use axum::response::Response;
use serde::Serialize;

use crate::analysis::defaults::{BAND_LEVEL, OUTLIER_QUANTILE};
use crate::api::extract::{Caller, Format, JsonBody, OnlyFormat, Path};
use crate::api::problem::Problem;
use crate::api::respond::{compute, json, picture};
#[cfg(feature = "schema")]
use crate::api::v1::requests::described::*;
use crate::api::v1::requests::request_macros::rows;
use crate::geometry::sampling::Places;
use crate::service::app::{App, ServiceError};
use crate::service::cost::requests::{self, Counts};
use crate::service::dictionaries::answers::UsedDictionary;
use crate::service::dictionaries::posterior::{self, Asking, Completion, Factors, MAX_DRAWN, Prepared};
use crate::service::dictionaries::ready::{self, Ready};
use crate::service::shapes::outcome::Outcomes;
use crate::wire::checked::{Checked, LARGE, Many, document, take_given, take_many, take_or_default};
use crate::wire::fault::Fault;
use crate::wire::partial::PartialInput;
use crate::wire::shape::Points;

/// Pose of the shapes of a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub(in crate::api::v1) enum PartialPose {
    /// Unknown: a member of the transformation class of the dictionary, found with the shape.
    #[default]
    Free,
    /// That of the dictionary: aligned, normalised.
    Model,
}

document! {
    /// Shapes with missing parts.
    #[schema(example = json!({
        "shapes": [{
            "points": [{"at": 0.0, "point": [2.0, 0.1]}, {"at": 0.25, "point": [0.1, 1.4]}, {"at": 0.5, "point": [-1.9, 0.0]}],
            "conditions": [{"measure": {"kind": "width", "along": [0.0, 0.5]}, "value": 2.9, "deviation": 0.1}]
        }]
    }))]
    pub(in crate::api::v1) struct CompleteRequest {
        /// Shapes of which a part is known.
        #[schema(value_type = Vec<PartialInput>, required = true)]
        shapes: Many<PartialInput, LARGE>, required;
        /// Pose of the shapes: `free` (unknown, found with the shape) or `model` (that of the dictionary, in its unit). Default: `free`.
        #[schema(value_type = Option<PartialPose>)]
        pose: Checked<PartialPose>;
        /// Fraction of shapes that a band covers, from 0.5 to below 1. Default: 0.95.
        #[schema(value_type = Option<f64>, minimum = 0.5, exclusive_maximum = 1)]
        level: Checked<f64>;
        /// Number of places of the bands on a curve. Default: the number of control points. Bands of other shapes are at landmarks
        /// and knots.
        #[schema(value_type = Option<usize>, minimum = 1)]
        samples: Checked<usize>;
        /// Whether bands are widened to the need of held-out training shapes. Default: true. The first such request
        /// after a start learns the factors and takes longer.
        #[schema(value_type = Option<bool>)]
        calibrated: Checked<bool>;
        /// Quantile of the held-out training shapes, from 0.5, beyond which the seen part is an outlier. Default: 0.99.
        #[schema(value_type = Option<f64>, minimum = 0.5, exclusive_maximum = 1)]
        quantile: Checked<f64>;
    }
}

/// Completed shapes.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct CompleteAnswer {
    /// The dictionary, at the version that was used.
    dictionary: UsedDictionary,
    /// Fraction of shapes that a band covers.
    level: f64,
    /// Factor of the standard deviations of each place alone: `r` is in its region if `(r − point)ᵀ covariance⁻¹ (r − point)` is at
    /// most the square of the factor.
    pointwise_factor: f64,
    /// The same for all places of the hidden part together.
    simultaneous_factor: f64,
    /// Number of subjects whose shapes were held out to learn the factors; null for those of normal errors.
    calibration_subjects: Option<usize>,
    /// Limitations of the numbers; absent if there are none.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    #[schema(required = false)]
    warnings: Vec<String>,
    /// One entry for each shape, in order.
    results: Vec<CompletedShape>,
}

/// A completed shape.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct CompletedShape {
    /// Position in the request, from 0.
    index: usize,
    /// Control points of the most likely shape, in the pose in which it is seen. The seen part is described by the
    /// modes, not copied.
    control_points: Points,
    /// Scores of the components.
    scores: Vec<f64>,
    /// Standard deviations of the scores.
    score_deviations: Vec<f64>,
    /// Mahalanobis distance of the scores from the mean.
    distance: f64,
    /// Matrix `A` of the pose `y = A r + b` of the dictionary, row by row.
    matrix: Vec<Vec<f64>>,
    /// Offset `b`.
    offset: Vec<f64>,
    /// Root mean square deviation of the seen part from the shape, in standard deviations of the noise; null if no
    /// points are seen.
    misfit: Option<f64>,
    /// Comparison of the seen part with parts of held-out training shapes; null if no points are seen, and without
    /// calibration.
    novelty: Option<PartialNovelty>,
    /// Whether the search of the pose converged.
    converged: bool,
    /// Points along the shape with their bands.
    bands: Bands,
}

/// Comparison of the seen part of a shape with parts of held-out training shapes, each completed by the components of all others.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct PartialNovelty {
    /// Whether this is an outlier, as `assess` finds it: by the scores and by the residual of the seen part.
    is_outlier: bool,
    /// Squared Mahalanobis distance of the seen part from the mean, in any pose, divided by the number of seen numbers
    /// less those of the pose.
    distance_per_number: f64,
    /// Fraction of the held-out parts with a smaller or equal distance.
    rank: f64,
}

impl PartialNovelty {
    fn new(prepared: &Prepared, completion: &Completion, quantile: f64) -> Option<Self> {
        let calibration = prepared.calibration.as_ref().ok().filter(|_| !completion.seen.is_empty())?;
        let posterior = &completion.posterior;
        let distance_per_number = posterior.misfit_per_number();
        let hidden = completion.observed.iter().filter(|seen| !**seen).count();
        let hidden = hidden as f64 / completion.observed.len().max(1) as f64;
        Some(Self {
            is_outlier: calibration.score(posterior.measures(), hidden, quantile).is_outlier,
            rank: calibration.rank(distance_per_number),
            distance_per_number,
        })
    }
}

/// Points along a shape with their bands, in the unit of the shape.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct Bands {
    /// Parameters of the points on a curve; null for other shapes.
    parameters: Option<Vec<f64>>,
    /// The points.
    points: Points,
    /// Whether each of them is seen.
    observed: Vec<bool>,
    /// Covariance of each of them, row by row.
    covariances: Vec<Vec<Vec<f64>>>,
    /// Largest deviation within the region of each place alone.
    pointwise: Vec<f64>,
    /// Largest deviation within the region of each place, all together.
    simultaneous: Vec<f64>,
}

/// Completes shapes of which a part is known: some points, control points, landmarks or arcs, or values that they are to have.
///
/// The answer is the most likely shape of the dictionary's components, in the pose in which the part is seen, with its scores and bands.
/// Residuals outside of the components count as noise. Bands cover the fraction `level` of shapes like those of the training: at each
/// place alone, and at all places of the hidden part together. Their factors are learnt from training shapes that are held out by subject.
/// Points correspond as given: no start point, direction or mirror image is searched. As SVG or PNG: the first shapes with the
/// regions of hidden places.
#[utoipa::path(post, path = "/v1/dictionaries/{dictionary}/complete", tag = "dictionaries", request_body = CompleteRequest,
    params(
        ("dictionary" = String, Path, description = "Id, `name@version`, `name@alias` or name"),
        ("format" = Option<String>, Query, description = "`json`, `svg` or `png`"), DrawingQuery
    ),
    responses(
        (status = 200, description = "One completed shape for each, in order", content((CompleteAnswer = "application/json"), (String = "image/svg+xml"))),
        (status = 404, description = "No such dictionary"),
        (status = "4XX", description = "The input was refused: nothing seen, contradictory conditions, a pose that is not determined")
    ))]
pub(in crate::api::v1) async fn complete(
    Caller(app): Caller,
    Path(key): Path<String>,
    OnlyFormat(format): OnlyFormat,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    let app = app.with_body(&body);
    let request: CompleteRequest = app.parse(&body)?;
    let ready = ready::find(&app, &key).await?;
    let (shapes, asking, calibrated) = request.checked(&app, &ready)?;
    let prepared = posterior::prepare(&app, &ready, calibrated).await?;
    let places: usize = shapes.iter().map(|shape| shape.len() + asking.samples).sum();
    let drawn = requests::draw(Counts::for_space(&ready.setup.space, 0, &app.limits), 2 * MAX_DRAWN);
    let work = ready.work_of_parts(shapes.len(), places) + format.work();
    let work = if matches!(format, Format::Picture(_)) { work + drawn } else { work };
    compute(app.weighing(work), move |app| answered(app, &ready, &prepared, shapes, asking, format)).await
}

fn answered(
    app: &App,
    ready: &Arc<Ready>,
    prepared: &Prepared,
    shapes: Vec<PartialInput>,
    asking: Asking,
    format: Format,
) -> Result<Response, ServiceError> {
    let space = &ready.setup.space;
    let read = shapes.into_iter().map(|shape| shape.checked(space, app.limits.control_points));
    let read = Outcomes::all_of_list("shapes", read)?;
    let context = app.pool.context();
    let mut cancelled = Ok(());
    let completions = read.iter().map_while(|shape| {
        cancelled = context.check();
        cancelled.is_ok().then(|| posterior::complete(ready, prepared, shape, asking))
    });
    let completed = Outcomes::all_of_list("shapes", completions);
    cancelled?;
    let completed = completed?;
    let hidden = |completion: &Completion| completion.observed.iter().filter(|seen| !**seen).count();
    let most = completed.iter().map(hidden).max().unwrap_or(0);
    let (factors, warning) = prepared.factors(asking.level, ready.setup.metric.dimension(), most);
    if let Format::Picture(file) = format {
        return picture(&posterior::draw(ready, &completed, factors), &file);
    }
    let places = Places::along(space, asking.samples);
    let of = |(index, completion): (usize, Completion)| {
        let novelty = PartialNovelty::new(prepared, &completion, asking.quantile);
        CompletedShape::new(ready, &places, factors, (index, completion), novelty)
    };
    let mut warnings: Vec<String> = warning.into_iter().collect();
    warnings.extend(ready.listed.provenance.warnings.clone());
    if completed.iter().any(|completion| !completion.posterior.converged) {
        warnings.push("the search of a pose did not converge: see more of the shape".into());
    }
    let answer = CompleteAnswer {
        dictionary: UsedDictionary::new(ready),
        level: asking.level,
        pointwise_factor: factors.pointwise,
        simultaneous_factor: factors.simultaneous,
        calibration_subjects: prepared.calibration.as_ref().ok().map(|calibration| calibration.subjects),
        warnings,
        results: completed.into_iter().enumerate().map(of).collect(),
    };
    json(StatusCode::OK, &answer)
}

impl CompleteRequest {
    /// The checked parts of the request.
    fn checked(self, app: &App, ready: &Ready) -> Result<(Vec<PartialInput>, Asking, bool), ServiceError> {
        let mut errors = self.faults;
        let shapes = take_many(self.shapes, "/shapes", &mut errors);
        let pose = take_or_default(self.pose, "/pose", &mut errors);
        let level = take_given(self.level, "/level", &mut errors).unwrap_or(BAND_LEVEL);
        let samples = take_given(self.samples, "/samples", &mut errors).unwrap_or(ready.setup.metric.size());
        let calibrated = take_given(self.calibrated, "/calibrated", &mut errors).unwrap_or(true);
        let quantile = take_given(self.quantile, "/quantile", &mut errors).unwrap_or(OUTLIER_QUANTILE);
        let count = shapes.as_ref().map_or(1, Vec::len);
        if count == 0 || count > app.limits.shapes {
            let detail = format!("expected between 1 and {} shapes, got {count}", app.limits.shapes);
            errors.push(Fault::new("/shapes", detail));
        }
        for (pointer, part) in [("/level", level), ("/quantile", quantile)] {
            if !(0.5..1.0).contains(&part) {
                let detail = format!("expected a number of at least 0.5 and below 1, got {part}");
                errors.push(Fault::new(pointer, detail));
            }
        }
        // A covariance of d² numbers for each place.
        let most = app.limits.samples / (4 * count.max(1));
        if samples == 0 || samples > most.max(1) {
            let detail =
                format!("expected a number between 1 and {} for {count} shapes, got {samples}", most.max(1));
            errors.push(Fault::new("/samples", detail));
        }
        ServiceError::unless_empty(errors)?;
        let asking = Asking { level, quantile, samples, posed: pose == Some(PartialPose::Model) };
        Ok((shapes.unwrap_or_default(), asking, calibrated))
    }
}

impl CompletedShape {
    fn new(
        ready: &Ready,
        places: &Places,
        factors: Factors,
        (index, completion): (usize, Completion),
        novelty: Option<PartialNovelty>,
    ) -> Self {
        let Completion { posterior, control_points, scores, deviations, predicted, observed, seen } =
            completion;
        let dimension = ready.setup.metric.dimension();
        let radii = predicted.deviations();
        let scaled = |factor: f64| radii.iter().map(|radius| factor * radius).collect();
        let on_curve = ready.setup.space.domain().is_line();
        let numbers = (dimension * seen.len()) as f64;
        Self {
            index,
            control_points: Points::from_columns(control_points, dimension),
            scores,
            score_deviations: deviations,
            distance: posterior.distance(),
            matrix: rows(&posterior.pose.matrix),
            offset: posterior.pose.offset.clone(),
            misfit: (!seen.is_empty()).then(|| (posterior.misfit / numbers).sqrt()),
            novelty,
            converged: posterior.converged,
            bands: Bands {
                parameters: on_curve.then(|| (0..places.count()).map(|i| places.parameter(i)).collect()),
                pointwise: scaled(factors.pointwise),
                simultaneous: scaled(factors.simultaneous),
                covariances: predicted.covariances.iter().map(rows).collect(),
                points: Points::from_columns(predicted.points, dimension),
                observed,
            },
        }
    }
}
