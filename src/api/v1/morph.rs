//! Morphing: shapes on a path between two shapes.

use crate::formats::fault::Fault;
use axum::http::StatusCode;
use axum::response::Response;
use serde::Serialize;

use super::request_macros::{ShapeOutput, checked};
use crate::analysis::correspondence::Correspondence;
use crate::api::extract::{Caller, Format, JsonBody, OnlyFormat};
use crate::api::problem::Problem;
use crate::api::respond::{compute_planned, json, planned, svg};
use crate::formats::checked::{Checked, LARGE, document, take_given, take_or_default};
use crate::formats::representation::Read;
use crate::formats::shape::{Points, ShapeInput};
use crate::geometry::GeometryError;
use crate::geometry::drawing::svg::{self as drawing, Layer, colour};
use crate::geometry::representation::Representation;
use crate::geometry::subdivision::normal_based::Oriented;
use crate::geometry::subdivision::{Scheme, Subdivision};
use crate::service::app::{App, ServiceError};
use crate::service::cost::requests::{self, Counts};
use crate::service::shapes::morph::{PathKind, Positions};
use crate::service::shapes::read::{check_correspondence, own_faults};
use crate::service::shapes::request::Posted;
use crate::service::shapes::{morph, subdivisions};

document! {
    /// Two shapes and the kind of path between them.
    #[schema(example = json!({
        "representation": {"kind": "closed_curve", "dimension": 2, "control_points": 4, "generator": {"name": "trigonometric"}},
        "from": {"points": [[2, 0], [0, 1], [-2, 0], [0, -1]]}, "to": {"points": [[1, 0], [0, 2], [-1, 0], [0, -2]]},
        "path": "sphere", "positions": [0, 0.5, 1, 1.25]
    }))]
    pub(super) struct MorphRequest {
        /// Representation of the shapes: curves or surfaces.
        #[schema(value_type = Representation, required = true)]
        representation: Read<Representation>, required;
        /// Conversion of posted points to control points. Default: `landmarks`.
        #[schema(value_type = Option<Correspondence>)]
        correspondence: Checked<Correspondence>;
        /// Shape at the start of the path.
        #[schema(value_type = ShapeInput, required = true)]
        from: ShapeInput, required;
        /// Shape at the end of the path.
        #[schema(value_type = ShapeInput, required = true)]
        to: ShapeInput, required;
        /// Kind of path: the straight line, or the great circle between the shapes scaled to unit norm. Default: `plane`.
        #[schema(value_type = Option<PathKind>)]
        path: Checked<PathKind>;
        /// Positions on the path: 0 is `from`, 1 is `to`; other values extrapolate. Between −1000 and 1000.
        #[schema(value_type = Option<Vec<f64>>)]
        positions: Checked<Vec<f64>, LARGE>;
        /// Number of equally spaced positions from 0 to 1, in place of `positions`. Default: 11.
        #[schema(value_type = Option<usize>, minimum = 2)]
        steps: Checked<usize>;
    }
}

/// A shape on the path.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct MorphFrame {
    /// Position on the path.
    position: f64,
    #[serde(flatten)]
    shape: ShapeOutput,
    /// Unit normals; only for the subdivision scheme `normal_based`.
    #[serde(skip_serializing_if = "Option::is_none")]
    normals: Option<Vec<[f64; 3]>>,
}

/// A path between two shapes.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct MorphAnswer {
    /// One shape per position, in order.
    frames: Vec<MorphFrame>,
    /// Angle between the two shapes in radians; null on the straight line.
    angle: Option<f64>,
}

/// Largest number of equally spaced positions.
const MAX_STEPS: usize = 1000;

/// Computes shapes on a path between two curves or surfaces, with extrapolation.
///
/// As SVG: an animation through the curves and back; surfaces are drawn side by side.
#[utoipa::path(post, path = "/morph", tag = "curves", request_body = MorphRequest,
    params(("format" = Option<String>, Query, description = "`json` or `svg`")),
    responses(
        (status = 200, description = "Shapes on the path", content((MorphAnswer = "application/json"), (String = "image/svg+xml")))
    ))]
pub(super) async fn morph(
    Caller(app): Caller,
    OnlyFormat(format): OnlyFormat,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    compute_planned(app, body, move |app, body| {
        let (request, mut errors) = (app.parse::<MorphRequest>(body)?, Vec::new());
        errors.extend(request.faults);
        let representation =
            request.representation.and_then(|field| field.take("/representation", &mut errors));
        let correspondence = take_or_default(request.correspondence, "/correspondence", &mut errors);
        let kind = take_or_default(request.path, "/path", &mut errors);
        let steps = take_given(request.steps, "/steps", &mut errors);
        let positions = take_given(request.positions, "/positions", &mut errors);
        let positions = match (positions, steps) {
            (Some(_), Some(_)) => {
                errors.push(Fault::new("/steps", "expected either positions or steps, got both"));
                None
            }
            (Some(positions), None) => Some(Positions::At(positions)),
            (None, steps) => {
                let steps = steps.unwrap_or(11);
                if !(2..=MAX_STEPS).contains(&steps) {
                    errors.push(Fault::new(
                        "/steps",
                        format!("expected a number between 2 and {MAX_STEPS}, got {steps}"),
                    ));
                }
                Some(Positions::Steps(steps.clamp(2, MAX_STEPS)))
            }
        };
        let wanted = representation.zip(correspondence).zip(kind.zip(positions));
        let (from, to) = (request.from.unwrap_or_default(), request.to.unwrap_or_default());
        if !errors.is_empty() {
            // Faults of the shapes that do not depend on the representation; a missing shape is already reported.
            for (shape, pointer) in [(&from, "/from"), (&to, "/to")] {
                let found = own_faults(shape.clone());
                errors.extend(found.into_iter().map(|error| error.below(pointer)));
            }
        }
        let (((representation, correspondence), (kind, positions)), _) = checked(wanted, errors, Vec::new())?;
        let counts = Counts::new(&representation, 2, &app.limits);
        let work = requests::morph(counts, positions.count(), format == Format::Svg, &app.limits);
        planned(work, move |app| {
            if let Some(Subdivision { scheme: Scheme::NormalBased { .. }, .. }) = representation.subdivision()
            {
                if kind == PathKind::Sphere {
                    let detail = format!(
                        "expected another path than \"sphere\", which requires norms: {}",
                        GeometryError::NotLinear
                    );
                    return Err(ServiceError::invalid("/path", detail));
                }
                check_correspondence(&representation, correspondence)?;
                return morph_oriented(app, &representation, &positions, [from, to], format);
            }
            let posted = Posted::new(app, &representation, correspondence)?;
            let morph = morph::morph(app, &posted, kind, &positions, from, to)?;
            if format == Format::Svg {
                let name = if kind == PathKind::Plane { "straight path" } else { "great circle" };
                return Ok(svg(morph::draw_morph(&posted, name, &morph)?));
            }
            let frame = |(position, shape): (f64, crate::numeric::dense::Matrix)| {
                let points = Points::from_columns(shape.as_slice().to_vec(), shape.ncols());
                MorphFrame { position, shape: ShapeOutput { control_points: points }, normals: None }
            };
            json(
                StatusCode::OK,
                &MorphAnswer { angle: morph.angle, frames: morph.frames.into_iter().map(frame).collect() },
            )
        })
    })
    .await
}

/// Straight path between two shapes of points and normals.
fn morph_oriented(
    app: &App,
    representation: &Representation,
    positions: &Positions,
    ends: [ShapeInput; 2],
    format: Format,
) -> Result<Response, ServiceError> {
    let drawn = format == Format::Svg;
    let morph = subdivisions::morph(app, representation, positions, ends, drawn)?;
    if drawn {
        return Ok(svg(drawing::draw("straight path", &[Layer::of_meshes(&morph.meshes, colour::BACK)])));
    }
    let frame = |(position, shape): (f64, Oriented)| {
        let columns = (0..3).flat_map(|c| shape.points.iter().map(move |point| point[c])).collect();
        let shape_output = ShapeOutput { control_points: Points::from_columns(columns, 3) };
        MorphFrame { position, shape: shape_output, normals: Some(shape.normals) }
    };
    json(StatusCode::OK, &MorphAnswer { angle: None, frames: morph.frames.into_iter().map(frame).collect() })
}
