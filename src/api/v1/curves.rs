//! Evaluation, measures and resampling of curves.

use axum::extract::State;
use axum::http::StatusCode;
use axum::response::Response;
use serde::Serialize;

use super::settings::checked;
use crate::analysis::alignment::Alignment;
use crate::analysis::correspondence::{Correspondence, Direction, Mirror};
use crate::analysis::frame::Frame;
use crate::analysis::transformation::{ClassName, Transformation};
use crate::api::extract::{Format, JsonBody, NoQuery, OnlyFormat, parse};
use crate::api::problem::{Problem, ProblemDocument};
use crate::api::respond::{compute, json, svg};
use crate::formats::InputError;
use crate::formats::checked::{Checked, List, document, take_given, take_or_default};
use crate::formats::representation::CheckedRepresentation;
use crate::formats::shape::{Points, ShapeInput};
use crate::geometry::measures::Orientation;
use crate::geometry::representation::Representation;
use crate::service::App;
use crate::service::cohorts::text_faults;
use crate::service::compute::{self, Measured, Parameters, Settings, Start};

/// Settings of a request about single curves: nothing is compared, so no class is removed.
fn settings(
    representation: Option<CheckedRepresentation>,
    correspondence: Option<Checked<Correspondence>>,
    errors: &mut Vec<InputError>,
) -> Option<Settings> {
    let representation = representation.and_then(|field| field.take("/representation", errors));
    let correspondence = take_or_default(correspondence, "/correspondence", errors);
    Some(Settings {
        representation: representation?,
        correspondence: correspondence?,
        direction: Direction::Given,
        mirror: Mirror::Forbid,
        transformation: Transformation::Named(ClassName::Translation),
        alignment: Alignment::Projection,
        frame: Frame::Training,
    })
}

document! {
    /// Curves to be evaluated.
    #[schema(example = json!({
        "representation": {"kind": "closed_curve", "dimension": 2, "control_points": 4, "generator": {"name": "trigonometric"}},
        "shapes": [{"points": [[2, 0], [0, 1], [-2, 0], [0, -1]]}], "samples": 8, "derivatives": 1
    }))]
    pub(super) struct EvaluateRequest {
        /// What the shapes are made of; a curve.
        #[schema(value_type = Representation, required = true)]
        representation: CheckedRepresentation, required;
        /// How points become control points; `landmarks` unless given.
        #[schema(value_type = Option<Correspondence>)]
        correspondence: Checked<Correspondence>;
        /// The shapes.
        #[schema(value_type = Vec<ShapeInput>, required = true)]
        shapes: List<ShapeInput>, required;
        /// Number of equally spaced parameters from `u = 0`; 100 unless `parameters` is given.
        #[schema(value_type = Option<usize>, minimum = 1)]
        samples: Checked<usize>;
        /// Parameters `u`, taken modulo 1, instead of `samples`.
        #[schema(value_type = Option<Vec<f64>>)]
        parameters: Checked<Vec<f64>>;
        /// Highest derivative with respect to `u`, 0 to 2; 0 unless given.
        #[schema(value_type = Option<usize>, maximum = 2)]
        derivatives: Checked<usize>;
    }
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
    OnlyFormat(format): OnlyFormat,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    compute(app, move |app| {
        let (request, mut errors) = (parse::<EvaluateRequest>(&body)?, Vec::new());
        errors.extend(request.faults);
        let settings = settings(request.representation, request.correspondence, &mut errors);
        let shapes = request.shapes.unwrap_or_default().take("/shapes", &mut errors);
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
        let (((settings, parameters), order), shapes) =
            checked(settings.zip(parameters).zip(order), errors, shapes)?;
        let (space, shapes) = compute::curves(app, &settings, shapes)?;
        if format == Format::Svg {
            let outlines: Vec<&[f64]> = shapes.iter().map(|shape| shape.as_slice()).collect();
            return Ok(svg(compute::draw_shapes(&space, &format!("{} curves", shapes.len()), &outlines)));
        }
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

document! {
    /// Curves to be measured.
    #[schema(example = json!({
        "representation": {"kind": "closed_curve", "dimension": 2, "control_points": 4, "generator": {"name": "trigonometric"}},
        "length_unit": "mm",
        "shapes": [{"points": [[2, 0], [0, 1], [-2, 0], [0, -1]]}]
    }))]
    pub(super) struct MeasureRequest {
        /// What the shapes are made of; a curve.
        #[schema(value_type = Representation, required = true)]
        representation: CheckedRepresentation, required;
        /// How points become control points; `landmarks` unless given.
        #[schema(value_type = Option<Correspondence>)]
        correspondence: Checked<Correspondence>;
        /// Unit of the coordinates; carried to the answer.
        #[schema(value_type = Option<String>)]
        length_unit: Checked<Option<String>>;
        /// The shapes.
        #[schema(value_type = Vec<ShapeInput>, required = true)]
        shapes: List<ShapeInput>, required;
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
pub(super) async fn measure(
    State(app): State<App>,
    _: NoQuery,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    compute(app, move |app| {
        let (request, mut errors) = (parse::<MeasureRequest>(&body)?, Vec::new());
        errors.extend(request.faults);
        let settings = settings(request.representation, request.correspondence, &mut errors);
        let shapes = request.shapes.unwrap_or_default().take("/shapes", &mut errors);
        let length_unit = take_given(request.length_unit, "/length_unit", &mut errors).flatten();
        let unit_faults = text_faults(None, None, length_unit.as_deref());
        errors.extend(unit_faults.into_iter().map(|fault| InputError::new(fault.pointer, fault.detail)));
        let (settings, shapes) = checked(settings, errors, shapes)?;
        let (space, shapes) = compute::curves(app, &settings, shapes)?;
        let measures = compute::measure(&space, &shapes).into_iter().map(Into::into).collect();
        json(StatusCode::OK, &MeasureAnswer { measures, length_unit })
    })
    .await
}

document! {
    /// Contours to be resampled.
    #[schema(example = json!({"count": 6, "start": "canonical", "shapes": [{"points": [[0, 0], [4, 0], [4, 1], [0, 1]]}]}))]
    pub(super) struct ResampleRequest {
        /// Number of points, at least 3.
        #[schema(value_type = usize, required = true, minimum = 3)]
        count: Checked<usize>, required;
        /// Where to start; `first` unless given.
        #[schema(value_type = Option<Start>)]
        start: Checked<Start>;
        /// The contours, closed.
        #[schema(value_type = Vec<ShapeInput>, required = true)]
        shapes: List<ShapeInput>, required;
    }
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
pub(super) async fn resample(
    State(app): State<App>,
    _: NoQuery,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    compute(app, move |app| {
        let (request, mut errors) = (parse::<ResampleRequest>(&body)?, Vec::new());
        errors.extend(request.faults);
        let count = take_given(request.count, "/count", &mut errors);
        let start = take_or_default(request.start, "/start", &mut errors);
        let shapes = request.shapes.unwrap_or_default().take("/shapes", &mut errors);
        let ((count, start), shapes) = checked(count.zip(start), errors, shapes)?;
        let shapes = compute::resample(app, count, start, shapes)?
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
