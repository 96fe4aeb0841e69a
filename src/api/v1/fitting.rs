//! Fits of raw contours, refinement, and idealised curves.

use axum::http::StatusCode;
use axum::response::Response;
use serde::Serialize;

use super::settings::{ShapeOutput, checked, shapes_request};
use crate::analysis::correspondence::Correspondence;
use crate::api::extract::{Caller, JsonBody, NoQuery, parse};
use crate::api::problem::{Problem, ProblemDocument};
use crate::api::respond::{compute, json};
use crate::formats::checked::{Checked, List, document, take_given, take_or_default};
use crate::formats::representation::{FitTarget, Read};
use crate::formats::shape::{Points, ShapeInput};
use crate::geometry::fit::Fit;
use crate::geometry::ideal::{IdealCurve, Position};
use crate::geometry::representation::Representation;
use crate::numeric::dense::Matrix;
use crate::service::curves::Curves;
use crate::service::fitting::{self, Placed, Size};

fn output(control_points: &Matrix) -> ShapeOutput {
    let dimension = control_points.ncols();
    ShapeOutput { control_points: Points::from_columns(control_points.as_slice().to_vec(), dimension) }
}

document! {
    /// Contours to be fitted.
    #[schema(example = json!({
        "representation": {"kind": "closed_curve", "dimension": 2, "tolerance": 0.1, "generator": {"name": "keys"}},
        "shapes": [{"points": [[2, 0], [1.7, 0.5], [1, 0.87], [0, 1], [-1, 0.87], [-1.7, 0.5], [-2, 0], [-1.7, -0.5], [-1, -0.87], [0, -1], [1, -0.87], [1.7, -0.5]]}]
    }))]
    pub(super) struct FitRequest {
        /// What curves are fitted: closed or open, with `control_points` or `intervals`, or instead the largest
        /// residual (`tolerance`, in the unit of the points) for which their number is chosen.
        #[schema(value_type = Object, required = true)]
        representation: Read<FitTarget>, required;
        /// Parameters `u` of the points, strictly increasing from 0 to 1, one list a shape; the arc length of the
        /// polygon unless given.
        #[schema(value_type = Option<Vec<Vec<f64>>>)]
        parameters: Checked<Vec<Vec<f64>>>;
        /// The contours: `points`, at least as many as control points.
        #[schema(value_type = Vec<ShapeInput>, required = true)]
        shapes: List<ShapeInput>, required;
    }
}

/// A fitted curve.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct FitOutput {
    /// What it is made of.
    representation: Representation,
    #[serde(flatten)]
    shape: ShapeOutput,
    /// Root mean square distance of the points from the curve at their parameters: the `L₂` residual.
    residual: f64,
    /// Largest such distance.
    largest_residual: f64,
}

/// Fitted curves, in order.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct FitAnswer {
    /// One a contour.
    fits: Vec<FitOutput>,
}

/// Fits curves to raw contours by least squares in `L₂`.
///
/// Points of a curve of the representation, at their parameters, give back its control points.
#[utoipa::path(post, path = "/fit", tag = "curves", request_body = FitRequest,
    responses(
        (status = 200, description = "One entry a contour", body = FitAnswer),
        (status = "4XX", description = "The input was refused", body = ProblemDocument, content_type = "application/problem+json")
    ))]
pub(super) async fn fit(
    Caller(app): Caller,
    _: NoQuery,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    compute(app, move |app| {
        let (request, mut errors) = (parse::<FitRequest>(&body)?, Vec::new());
        errors.extend(request.faults);
        let target = request.representation.and_then(|field| field.take("/representation", &mut errors));
        let parameters = take_given(request.parameters, "/parameters", &mut errors);
        let shapes = request.shapes.unwrap_or_default().take("/shapes", &mut errors);
        let (FitTarget { representation, tolerance }, shapes) = checked(target, errors, shapes)?;
        let size = tolerance.map_or(Size::Given, Size::Tolerance);
        let fits = fitting::fit(app, &representation, size, parameters.as_deref(), shapes)?;
        let output = |fit: Fit| FitOutput {
            shape: output(&fit.control_points),
            representation: fit.representation,
            residual: fit.residual,
            largest_residual: fit.largest,
        };
        json(StatusCode::OK, &FitAnswer { fits: fits.into_iter().map(output).collect() })
    })
    .await
}

shapes_request! {
    /// Curves to be refined.
    #[schema(example = json!({
        "representation": {"kind": "closed_curve", "dimension": 2, "control_points": 3, "generator": {
            "name": "interpolator", "family": "half_integer_shifts",
            "domain_poles": [[0, 0], [0, std::f64::consts::TAU], [0, -std::f64::consts::TAU]]}},
        "shapes": [{"points": [[1, 0], [-0.5, 0.8660254037844386], [-0.5, -0.8660254037844386]]}], "factor": 2
    }))]
    RefineRequest {
        /// How many times as many knots; 2 unless given.
        #[schema(value_type = Option<usize>, minimum = 2)]
        factor: Checked<usize>;
    }
}

/// A curve on the finer grid.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct RefinedOutput {
    #[serde(flatten)]
    shape: ShapeOutput,
    /// `L₂` distance to the curve before, where it is not the same one.
    #[serde(skip_serializing_if = "Option::is_none")]
    l2_change: Option<f64>,
}

/// Refined curves, in order.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct RefineAnswer {
    /// The finer representation.
    representation: Representation,
    /// Whether the curves are the same functions: B-splines, and interpolators of half-integer shifts. Others are
    /// sampled at the finer knots.
    exact: bool,
    /// `δ`: the curve before at `u` is the refined one at `u + δ`. Half a fine interval where the knots of an odd order
    /// are split evenly, else 0.
    parameter_shift: f64,
    /// One a curve.
    shapes: Vec<RefinedOutput>,
}

/// Refines curves to a grid with more knots.
#[utoipa::path(post, path = "/refine", tag = "curves", request_body = RefineRequest,
    responses(
        (status = 200, description = "The finer representation and control points", body = RefineAnswer),
        (status = "4XX", description = "The input was refused", body = ProblemDocument, content_type = "application/problem+json")
    ))]
pub(super) async fn refine(
    Caller(app): Caller,
    _: NoQuery,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    compute(app, move |app| {
        let (mut request, mut errors) = (parse::<RefineRequest>(&body)?, Vec::new());
        let (settings, shapes) = request.take_shapes(&mut errors);
        let factor = request.factor.map_or(Some(2), |field| field.take("/factor", &mut errors));
        let (((representation, correspondence), factor), shapes) =
            checked(settings.zip(factor), errors, shapes)?;
        let curves = Curves::new(app, &representation, correspondence)?;
        let shapes = curves.read(app, shapes)?;
        let refined = fitting::refine(app, &curves, factor, &shapes)?;
        let shapes = refined.shapes.iter();
        json(
            StatusCode::OK,
            &RefineAnswer {
                representation: refined.refinement.representation().clone(),
                exact: refined.refinement.is_exact(),
                parameter_shift: refined.refinement.parameter_shift(),
                shapes: shapes
                    .map(|(shape, change)| RefinedOutput { shape: output(shape), l2_change: *change })
                    .collect(),
            },
        )
    })
    .await
}

/// An idealised curve of the catalogue.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct IdealEntry {
    /// How it stands in a request.
    curve: IdealCurve,
    /// Whether it fits on a closed curve.
    closed: bool,
    /// `domain_poles` that a generator needs to contain it, about the origin.
    domain_poles: Vec<[f64; 2]>,
}

/// The idealised curves.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct IdealCurves {
    /// One of each.
    items: Vec<IdealEntry>,
}

/// Lists the idealised curves.
#[utoipa::path(get, path = "/idealised", tag = "catalogue",
    responses((status = 200, description = "The curves with the poles they need", body = IdealCurves), (status = 400, description = "An unknown parameter", body = ProblemDocument, content_type = "application/problem+json")))]
pub(super) async fn list_idealised(_: NoQuery) -> axum::Json<IdealCurves> {
    let entry = |curve: IdealCurve| IdealEntry {
        closed: curve.is_closed(),
        domain_poles: curve.domain_poles(&Position::default()),
        curve,
    };
    axum::Json(IdealCurves { items: IdealCurve::catalogue().into_iter().map(entry).collect() })
}

document! {
    /// An idealised curve in its place.
    pub(super) struct IdealInput {
        /// The curve about the origin.
        #[schema(value_type = IdealCurve, required = true)]
        curve: Checked<IdealCurve>, required;
        /// Where the origin goes; it stays unless given.
        #[schema(value_type = Option<Vec<f64>>)]
        centre: Checked<[f64; 2]>;
        /// Angle in radians by which the curve is turned about the origin before, counter-clockwise.
        #[schema(value_type = Option<f64>)]
        angle: Checked<f64>;
    }
}

document! {
    /// Idealised curves in a representation.
    #[schema(example = json!({
        "representation": {"kind": "closed_curve", "dimension": 2, "control_points": 5, "generator": {"name": "trigonometric"}},
        "curves": [{"curve": {"name": "ellipse", "semi_axes": [2, 1]}, "centre": [3, 1], "angle": 0.5}]
    }))]
    pub(super) struct IdealRequest {
        /// What the shapes are made of; a curve.
        #[schema(value_type = Representation, required = true)]
        representation: Read<Representation>, required;
        /// The curves.
        #[schema(value_type = Vec<IdealInput>, required = true)]
        curves: List<IdealInput>, required;
    }
}

/// Exact control points, in order.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct IdealAnswer {
    /// One a curve.
    shapes: Vec<ShapeOutput>,
}

/// Exact control points of idealised curves; refused with the missing poles when the generator does not contain them.
#[utoipa::path(post, path = "/idealised", tag = "curves", request_body = IdealRequest,
    responses(
        (status = 200, description = "Control points", body = IdealAnswer),
        (status = "4XX", description = "The input was refused", body = ProblemDocument, content_type = "application/problem+json")
    ))]
pub(super) async fn idealise(
    Caller(app): Caller,
    _: NoQuery,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    compute(app, move |app| {
        let (request, mut errors) = (parse::<IdealRequest>(&body)?, Vec::new());
        errors.extend(request.faults);
        let representation =
            request.representation.and_then(|field| field.take("/representation", &mut errors));
        let mut wanted = Vec::new();
        for (index, input) in
            request.curves.unwrap_or_default().take("/curves", &mut errors).into_iter().enumerate()
        {
            let below = |name: &str| format!("/curves/{index}{name}");
            errors.extend(input.faults.into_iter().map(|fault| fault.below(&below(""))));
            let curve = take_given(input.curve, &below("/curve"), &mut errors);
            let centre = take_or_default(input.centre, &below("/centre"), &mut errors);
            let angle = take_or_default(input.angle, &below("/angle"), &mut errors);
            if let (Some(curve), Some((centre, angle))) = (curve, centre.zip(angle)) {
                wanted.push(Placed { curve, position: Position { centre, angle } });
            }
        }
        let (representation, _) = checked(representation, errors, Vec::new())?;
        let curves = Curves::new(app, &representation, Correspondence::Landmarks)?;
        let shapes = fitting::idealise(app, &curves, &wanted)?.iter().map(output).collect();
        json(StatusCode::OK, &IdealAnswer { shapes })
    })
    .await
}
