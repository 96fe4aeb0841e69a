//! Evaluation, measures and resampling of curves.

use axum::http::StatusCode;
use axum::response::Response;
use serde::Serialize;

use super::settings::{checked, shapes_request};
use crate::api::extract::{Caller, Format, JsonBody, NoQuery, OnlyFormat, parse};
use crate::api::problem::{Problem, ProblemDocument};
use crate::api::respond::{compute, json, svg};
use crate::formats::InputError;
use crate::formats::checked::{Checked, List, document, take_given, take_or_default};
use crate::formats::shape::{Points, ShapeInput};
use crate::geometry::distance::Distances;
use crate::geometry::frame::Frame;
use crate::geometry::measures::Orientation;
use crate::service::cohorts::text_faults;
use crate::service::compute::draw_shapes;
use crate::service::curves::{self, Curves, Evaluation, Measured, Parameters, Start};
use crate::service::pool::Weight;

shapes_request! {
    /// Curves to be evaluated.
    #[schema(example = json!({
        "representation": {"kind": "closed_curve", "dimension": 2, "control_points": 4, "generator": {"name": "trigonometric"}},
        "shapes": [{"points": [[2, 0], [0, 1], [-2, 0], [0, -1]]}], "samples": 8, "derivatives": 1
    }))]
    EvaluateRequest {
        /// Number of equally spaced parameters from `u = 0`, to `u = 1` on open curves; 100 unless `parameters` is
        /// given.
        #[schema(value_type = Option<usize>, minimum = 1)]
        samples: Checked<usize>;
        /// Parameters `u` instead of `samples`: modulo 1 on closed curves, from 0 to 1 on open ones.
        #[schema(value_type = Option<Vec<f64>>)]
        parameters: Checked<Vec<f64>>;
        /// Highest derivative with respect to `u`, 0 to 2; 0 unless given.
        #[schema(value_type = Option<usize>, maximum = 2)]
        derivatives: Checked<usize>;
        /// Whether tangents, normals and curvatures are answered; not unless given.
        #[schema(value_type = Option<bool>)]
        frames: Checked<bool>;
    }
}

/// Values of one curve.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct EvaluationOutput {
    /// Points on the curve.
    points: Points,
    /// `dr/du`, when asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    first: Option<Points>,
    /// `d²r/du²`, when asked for; the right limit at knots, the left one at the end of an open curve.
    #[serde(skip_serializing_if = "Option::is_none")]
    second: Option<Points>,
    /// Unit tangents, when frames are asked for; null where the curve stops.
    #[serde(skip_serializing_if = "Option::is_none")]
    tangents: Option<Vec<Option<Vec<f64>>>>,
    /// Unit normals: to the left of the tangent in the plane; towards the centre of curvature in space, null where the
    /// curve is straight.
    #[serde(skip_serializing_if = "Option::is_none")]
    normals: Option<Vec<Option<Vec<f64>>>>,
    /// Curvatures in 1/length: positive to the left in the plane, never negative in space.
    #[serde(skip_serializing_if = "Option::is_none")]
    curvatures: Option<Vec<Option<f64>>>,
}

impl EvaluationOutput {
    fn new(evaluation: Evaluation, dimension: usize) -> Self {
        let mut derivatives =
            evaluation.derivatives.into_iter().map(|values| Points::from_columns(values, dimension));
        let each = |part: fn(&Frame) -> Option<Vec<f64>>| {
            evaluation.frames.as_ref().map(|frames| frames.iter().map(part).collect())
        };
        Self {
            points: derivatives.next().expect("the curve itself is always evaluated"),
            first: derivatives.next(),
            second: derivatives.next(),
            tangents: each(|frame| frame.tangent.clone()),
            normals: each(|frame| frame.normal.clone()),
            curvatures: evaluation.frames.as_ref().map(|frames| frames.iter().map(|f| f.curvature).collect()),
        }
    }
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
    Caller(app): Caller,
    OnlyFormat(format): OnlyFormat,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    compute(app.weighing(Weight::of_bytes(body.len())), move |app| {
        let (mut request, mut errors) = (parse::<EvaluateRequest>(&body)?, Vec::new());
        let (settings, shapes) = request.take_shapes(&mut errors);
        let samples = take_given(request.samples, "/samples", &mut errors);
        let parameters = match (samples, take_given(request.parameters, "/parameters", &mut errors)) {
            (Some(_), Some(_)) => {
                errors
                    .push(InputError::new("/parameters", "is given together with samples: give one of them"));
                None
            }
            (None, Some(parameters)) => Some(Parameters::At(parameters)),
            (samples, None) => Some(Parameters::Equidistant(samples.unwrap_or(100))),
        };
        let order = take_or_default(request.derivatives, "/derivatives", &mut errors);
        let frames = take_or_default(request.frames, "/frames", &mut errors);
        let wanted = settings.zip(parameters).zip(order.zip(frames));
        let ((((representation, correspondence), parameters), (order, frames)), shapes) =
            checked(wanted, errors, shapes)?;
        let curves = Curves::new(app, &representation, correspondence)?;
        let shapes = curves.read(app, shapes)?;
        if format == Format::Svg {
            let outlines: Vec<&[f64]> = shapes.iter().map(|shape| shape.as_slice()).collect();
            return Ok(svg(draw_shapes(&curves.space, &format!("{} curves", shapes.len()), &outlines)));
        }
        let evaluations = curves::evaluate(app, &curves, &shapes, &parameters, order, frames)?;
        let output = |evaluation| EvaluationOutput::new(evaluation, representation.dimension());
        json(StatusCode::OK, &EvaluateAnswer { evaluations: evaluations.into_iter().map(output).collect() })
    })
    .await
}

shapes_request! {
    /// Curves to be measured.
    #[schema(example = json!({
        "representation": {"kind": "closed_curve", "dimension": 2, "control_points": 4, "generator": {"name": "trigonometric"}},
        "length_unit": "mm",
        "reference": {"points": [[1, 0], [0, 1], [-1, 0], [0, -1]]},
        "shapes": [{"points": [[2, 0], [0, 1], [-2, 0], [0, -1]]}]
    }))]
    MeasureRequest {
        /// Unit of the coordinates; carried to the answer.
        #[schema(value_type = Option<String>)]
        length_unit: Checked<Option<String>>;
        /// A curve in the same representation, to which distances are measured.
        #[schema(value_type = Option<ShapeInput>)]
        reference: ShapeInput;
    }
}

/// Smallest and largest coordinates.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct BoundingBox {
    /// Smallest coordinates.
    min: Vec<f64>,
    /// Largest coordinates.
    max: Vec<f64>,
}

/// Measures of one curve. Parts that need a closed planar curve, or a smooth one, are null on others.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct MeasureOutput {
    /// Enclosed area, exact; closed planar curves.
    area: Option<f64>,
    /// Enclosed area, counter-clockwise positive (y up).
    signed_area: Option<f64>,
    /// Centroid of the enclosed area; null when there is none.
    centroid: Option<[f64; 2]>,
    /// Second moments of the enclosed area about its centroid, `∬ (x − x̄)(x − x̄)ᵀ dA`.
    second_moments: Option<[[f64; 2]; 2]>,
    /// Mean position along the parameter.
    mean_position: Vec<f64>,
    /// Length of the curve, to 1e-10 relative.
    length: f64,
    /// Length of a closed curve.
    perimeter: Option<f64>,
    /// Bounding box of the curve, not of its control points.
    bounding_box: BoundingBox,
    /// Direction of a closed planar curve.
    orientation: Option<Orientation>,
    /// Whether a planar curve crosses or touches itself.
    self_intersecting: Option<bool>,
    /// `∫ |r'|² du`, exact.
    stretching_energy: f64,
    /// `∫ |r''|² du`, exact; null for curves with corners.
    bending_energy: Option<f64>,
    /// `∫ |κ| dl` in radians; null for curves with corners or points without direction.
    total_curvature: Option<f64>,
    /// `∫ κ dl` in radians, counter-clockwise positive; planar curves.
    turning: Option<f64>,
    /// Distances to the reference, when there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    distances: Option<DistancesOutput>,
}

/// Distances of two curves, in the unit of their points.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct DistancesOutput {
    /// `(∫ |r − s|² du)^½`, exact: as functions of the parameter.
    l2: f64,
    /// Root mean square distance to the nearest point of the other curve, over both.
    symmetric_l2: f64,
    /// Largest distance to the nearest point of the other curve, over both.
    hausdorff: f64,
}

impl From<Distances> for DistancesOutput {
    fn from(Distances { l2, symmetric, hausdorff }: Distances) -> Self {
        Self { l2, symmetric_l2: symmetric, hausdorff }
    }
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
    fn from(Measured { measures, self_intersecting, distances }: Measured) -> Self {
        let (min, max) = measures.bounding_box;
        let enclosed = measures.enclosed.as_ref();
        Self {
            area: enclosed.map(|enclosed| enclosed.signed_area.abs()),
            signed_area: enclosed.map(|enclosed| enclosed.signed_area),
            centroid: enclosed.and_then(|enclosed| enclosed.centroid),
            second_moments: enclosed.and_then(|enclosed| enclosed.second_moments),
            mean_position: measures.mean_position,
            length: measures.length,
            perimeter: measures.closed.then_some(measures.length),
            bounding_box: BoundingBox { min, max },
            orientation: enclosed.map(|enclosed| enclosed.orientation),
            self_intersecting,
            stretching_energy: measures.stretching_energy,
            bending_energy: measures.bending_energy,
            total_curvature: measures.total_curvature,
            turning: measures.turning,
            distances: distances.map(Into::into),
        }
    }
}

/// Measures curves: area, moments, length, curvature, energies, bounding box, orientation, self-intersection; and their
/// distances to a reference.
#[utoipa::path(post, path = "/measure", tag = "curves", request_body = MeasureRequest,
    responses(
        (status = 200, description = "One entry a curve", body = MeasureAnswer),
        (status = "4XX", description = "The input was refused", body = ProblemDocument, content_type = "application/problem+json")
    ))]
pub(super) async fn measure(
    Caller(app): Caller,
    _: NoQuery,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    compute(app.weighing(Weight::of_bytes(body.len())), move |app| {
        let (mut request, mut errors) = (parse::<MeasureRequest>(&body)?, Vec::new());
        let (settings, shapes) = request.take_shapes(&mut errors);
        let length_unit = take_given(request.length_unit, "/length_unit", &mut errors).flatten();
        let unit_faults = text_faults(None, None, length_unit.as_deref());
        errors.extend(unit_faults.into_iter().map(|fault| InputError::new(fault.pointer, fault.detail)));
        let ((representation, correspondence), shapes) = checked(settings, errors, shapes)?;
        let curves = Curves::new(app, &representation, correspondence)?;
        let measures = curves::measure(app, &curves, shapes, request.reference)?;
        let measures = measures.into_iter().map(Into::into).collect();
        json(StatusCode::OK, &MeasureAnswer { measures, length_unit })
    })
    .await
}

document! {
    /// Contours to be resampled.
    #[schema(example = json!({"count": 6, "start": "canonical", "shapes": [{"points": [[0, 0], [4, 0], [4, 1], [0, 1]]}]}))]
    pub(super) struct ResampleRequest {
        /// Number of points, at least 3 for closed contours and 2 for open ones.
        #[schema(value_type = usize, required = true, minimum = 2)]
        count: Checked<usize>, required;
        /// Where to start; `first` unless given.
        #[schema(value_type = Option<Start>)]
        start: Checked<Start>;
        /// Whether the contours are closed; they are unless given.
        #[schema(value_type = Option<bool>)]
        closed: Checked<bool>;
        /// The contours.
        #[schema(value_type = Vec<ShapeInput>, required = true)]
        shapes: List<ShapeInput>, required;
    }
}

/// One resampled contour.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct ResampledOutput {
    /// Points of equal distance along the polygon.
    points: Points,
    /// Length of the polygon that was posted.
    polygon_length: f64,
}

/// Resampled contours, in order.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct ResampleAnswer {
    /// One a contour.
    shapes: Vec<ResampledOutput>,
}

/// Resamples contours to points of equal arc length; open ones keep both ends.
#[utoipa::path(post, path = "/resample", tag = "curves", request_body = ResampleRequest,
    responses(
        (status = 200, description = "The contours", body = ResampleAnswer),
        (status = "4XX", description = "The input was refused", body = ProblemDocument, content_type = "application/problem+json")
    ))]
pub(super) async fn resample(
    Caller(app): Caller,
    _: NoQuery,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    compute(app.weighing(Weight::of_bytes(body.len())), move |app| {
        let (request, mut errors) = (parse::<ResampleRequest>(&body)?, Vec::new());
        errors.extend(request.faults);
        let count = take_given(request.count, "/count", &mut errors);
        let start = take_or_default(request.start, "/start", &mut errors);
        let closed = request.closed.map_or(Some(true), |field| field.take("/closed", &mut errors));
        let shapes = request.shapes.unwrap_or_default().take("/shapes", &mut errors);
        let (((count, start), closed), shapes) = checked(count.zip(start).zip(closed), errors, shapes)?;
        let shapes = curves::resample(app, count, start, closed, shapes)?
            .into_iter()
            .map(|resampled| ResampledOutput {
                points: Points::from_columns(resampled.points, resampled.dimension),
                polygon_length: resampled.length,
            })
            .collect();
        json(StatusCode::OK, &ResampleAnswer { shapes })
    })
    .await
}
