//! Evaluation, measures and resampling of curves.

use axum::extract::State;
use axum::http::StatusCode;
use axum::response::Response;
use serde::{Deserialize, Serialize};

use crate::analysis::alignment::Alignment;
use crate::analysis::correspondence::{Correspondence, Direction, Mirror};
use crate::analysis::frame::Frame;
use crate::analysis::transformation::{ClassName, Transformation};
use crate::api::extract::{Format, JsonBody, parse};
use crate::api::problem::{Problem, ProblemDocument};
use crate::api::respond::{compute, json, svg};
use crate::formats::checked::Checked;
use crate::formats::representation::CheckedRepresentation;
use crate::formats::shape::{Points, ShapeInput};
use crate::geometry::measures::Orientation;
use crate::geometry::representation::Representation;
use crate::service::compute::{self, Measured, Parameters, Settings, Start};
use crate::service::{App, ServiceError};

/// Settings of a request about single curves: nothing is compared, so no class is removed.
fn settings(
    representation: CheckedRepresentation,
    correspondence: Checked<Correspondence>,
) -> Result<Settings, ServiceError> {
    let mut errors = Vec::new();
    let representation = representation.take("/representation", &mut errors);
    let correspondence = correspondence.take("/correspondence", &mut errors);
    let (Some(representation), Some(correspondence)) = (representation, correspondence) else {
        return Err(ServiceError::below(errors, ""));
    };
    Ok(Settings {
        representation,
        correspondence,
        direction: Direction::Given,
        mirror: Mirror::Forbid,
        transformation: Transformation::Named(ClassName::Translation),
        alignment: Alignment::Projection,
        frame: Frame::Training,
    })
}

/// Curves to be evaluated.
#[derive(Debug, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct EvaluateRequest {
    /// What the shapes are made of; a curve.
    #[schema(value_type = Representation)]
    representation: CheckedRepresentation,
    /// How points become control points; `landmarks` unless given.
    #[serde(default)]
    #[schema(value_type = Correspondence)]
    correspondence: Checked<Correspondence>,
    /// The shapes.
    shapes: Vec<ShapeInput>,
    /// Number of equally spaced parameters from `u = 0`; 100 unless `parameters` is given.
    samples: Option<usize>,
    /// Parameters `u`, taken modulo 1, instead of `samples`.
    parameters: Option<Vec<f64>>,
    /// Highest derivative with respect to `u`, 0 to 2; 0 unless given.
    derivatives: Option<usize>,
}

/// Values of one curve.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct EvaluationOutput {
    /// Points on the curve.
    points: Points,
    /// `dr/du`, when asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    first_derivatives: Option<Points>,
    /// `d²r/du²`, when asked for; the right limit at knots.
    #[serde(skip_serializing_if = "Option::is_none")]
    second_derivatives: Option<Points>,
}

/// Values, one entry a curve, in order.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct EvaluateAnswer {
    /// One a curve.
    evaluations: Vec<EvaluationOutput>,
}

/// Evaluates curves and their derivatives.
///
/// As SVG: a drawing of the curves.
#[utoipa::path(post, path = "/evaluate", tag = "curves", request_body = EvaluateRequest,
    params(("format" = Option<String>, Query, description = "`json` or `svg`")),
    responses(
        (status = 200, description = "Points and derivatives", content((EvaluateAnswer = "application/json"), (String = "image/svg+xml"))),
        (status = "4XX", description = "The input was refused", body = ProblemDocument, content_type = "application/problem+json")
    ))]
pub(super) async fn evaluate(
    State(app): State<App>,
    format: Format,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    compute(app, move |app| {
        let request: EvaluateRequest = parse(&body)?;
        let parameters = match (request.samples, request.parameters) {
            (Some(_), Some(_)) => {
                return Err(ServiceError::invalid(
                    "/parameters",
                    "is given together with samples: give one of them",
                ));
            }
            (None, Some(parameters)) => Parameters::At(parameters),
            (samples, None) => Parameters::Equidistant(samples.unwrap_or(100)),
        };
        let settings = settings(request.representation, request.correspondence)?;
        let (space, shapes) = compute::curves(app, &settings, request.shapes)?;
        if format == Format::Svg {
            let outlines: Vec<&[f64]> = shapes.iter().map(|shape| shape.as_slice()).collect();
            return Ok(svg(compute::draw_shapes(&space, &format!("{} curves", shapes.len()), &outlines)));
        }
        let order = request.derivatives.unwrap_or(0);
        let evaluations = compute::evaluate(app, &space, &shapes, &parameters, order)?;
        let dimension = settings.representation.dimension();
        let output = |evaluation: compute::Evaluation| {
            let mut derivatives =
                evaluation.derivatives.into_iter().map(|values| Points::from_columns(values, dimension));
            EvaluationOutput {
                points: derivatives.next().expect("the curve itself is always evaluated"),
                first_derivatives: derivatives.next(),
                second_derivatives: derivatives.next(),
            }
        };
        json(StatusCode::OK, &EvaluateAnswer { evaluations: evaluations.into_iter().map(output).collect() })
    })
    .await
}

/// Curves to be measured.
#[derive(Debug, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct MeasureRequest {
    /// What the shapes are made of; a curve.
    #[schema(value_type = Representation)]
    representation: CheckedRepresentation,
    /// How points become control points; `landmarks` unless given.
    #[serde(default)]
    #[schema(value_type = Correspondence)]
    correspondence: Checked<Correspondence>,
    /// Unit of the coordinates; carried to the answer.
    #[schema(example = "mm")]
    length_unit: Option<String>,
    /// The shapes.
    shapes: Vec<ShapeInput>,
}

/// Smallest and largest coordinates.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct BoundingBox {
    /// Smallest coordinates.
    min: Vec<f64>,
    /// Largest coordinates.
    max: Vec<f64>,
}

/// Measures of one curve.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct MeasureOutput {
    /// Enclosed area, exact; planar curves.
    area: Option<f64>,
    /// Enclosed area, counter-clockwise positive (y up); planar curves.
    signed_area: Option<f64>,
    /// Centroid of the enclosed area; planar curves that enclose one.
    centroid: Option<Vec<f64>>,
    /// Mean position along the parameter.
    mean_position: Vec<f64>,
    /// Length of the curve, to 1e-10 relative.
    perimeter: f64,
    /// Bounding box of the curve, not of its control points.
    bounding_box: BoundingBox,
    /// Direction; planar curves.
    orientation: Option<Orientation>,
    /// Whether the curve crosses or touches itself; planar curves.
    self_intersecting: Option<bool>,
}

/// Measures, one entry a curve, in order.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct MeasureAnswer {
    /// One a curve.
    measures: Vec<MeasureOutput>,
    /// Unit of lengths; areas are in its square.
    length_unit: Option<String>,
}

impl From<Measured> for MeasureOutput {
    fn from(Measured { measures, self_intersecting }: Measured) -> Self {
        let (min, max) = measures.bounding_box;
        Self {
            area: measures.signed_area.map(f64::abs),
            signed_area: measures.signed_area,
            centroid: measures.centroid,
            mean_position: measures.mean_position,
            perimeter: measures.perimeter,
            bounding_box: BoundingBox { min, max },
            orientation: measures.orientation,
            self_intersecting,
        }
    }
}

/// Measures curves: area, centroid, perimeter, bounding box, orientation, self-intersection.
#[utoipa::path(post, path = "/measure", tag = "curves", request_body = MeasureRequest,
    responses(
        (status = 200, description = "One entry a curve", body = MeasureAnswer),
        (status = "4XX", description = "The input was refused", body = ProblemDocument, content_type = "application/problem+json")
    ))]
pub(super) async fn measure(State(app): State<App>, JsonBody(body): JsonBody) -> Result<Response, Problem> {
    compute(app, move |app| {
        let request: MeasureRequest = parse(&body)?;
        let settings = settings(request.representation, request.correspondence)?;
        let (space, shapes) = compute::curves(app, &settings, request.shapes)?;
        let measures = compute::measure(&space, &shapes).into_iter().map(Into::into).collect();
        json(StatusCode::OK, &MeasureAnswer { measures, length_unit: request.length_unit })
    })
    .await
}

/// Contours to be resampled.
#[derive(Debug, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct ResampleRequest {
    /// Number of points, at least 3.
    #[schema(minimum = 3, example = 100)]
    count: usize,
    /// Where to start; `first` unless given.
    #[serde(default)]
    #[schema(value_type = Start)]
    start: Checked<Start>,
    /// The contours, closed.
    shapes: Vec<ShapeInput>,
}

/// One resampled contour.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct ResampledOutput {
    /// Points of equal distance along the polygon.
    points: Points,
    /// Perimeter of the polygon that was posted.
    polygon_length: f64,
}

/// Resampled contours, in order.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct ResampleAnswer {
    /// One a contour.
    shapes: Vec<ResampledOutput>,
}

/// Resamples closed contours to points of equal arc length.
#[utoipa::path(post, path = "/resample", tag = "curves", request_body = ResampleRequest,
    responses(
        (status = 200, description = "The contours", body = ResampleAnswer),
        (status = "4XX", description = "The input was refused", body = ProblemDocument, content_type = "application/problem+json")
    ))]
pub(super) async fn resample(State(app): State<App>, JsonBody(body): JsonBody) -> Result<Response, Problem> {
    compute(app, move |app| {
        let request: ResampleRequest = parse(&body)?;
        let mut errors = Vec::new();
        let Some(start) = request.start.take("/start", &mut errors) else {
            return Err(ServiceError::below(errors, ""));
        };
        let shapes = compute::resample(app, request.count, start, &request.shapes)?
            .into_iter()
            .map(|(dimension, points, polygon_length)| ResampledOutput {
                points: Points::from_columns(points, dimension),
                polygon_length,
            })
            .collect();
        json(StatusCode::OK, &ResampleAnswer { shapes })
    })
    .await
}
