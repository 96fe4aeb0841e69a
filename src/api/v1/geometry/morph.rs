//! Morphing: shapes on a path between two shapes, or through several.

#[cfg(feature = "schema")]
use crate::api::v1::requests::described::*;
use crate::wire::fault::Fault;
use axum::http::StatusCode;
use axum::response::Response;
use serde::{Deserialize, Serialize};

use crate::analysis::correspondence::Correspondence;
use crate::analysis::path::{PathKind, Positions};
use crate::api::extract::{BesideFormat, Caller, Format, JsonBody, ShapeFormat};
use crate::api::problem::Problem;
use crate::api::respond::{Planned, compute_planned, file_of, json, picture, planned};
use crate::api::v1::requests::request_macros::{ShapeOutput, checked};
use crate::geometry::capability::domain::Domain;
use crate::geometry::representation::Representation;
use crate::service::app::work::Work;
use crate::service::app::{App, ServiceError};
use crate::service::cost::requests::{self, Counts};
use crate::service::shapes::morph::{Morph, MorphTask, PathShape, Stops};
use crate::service::shapes::read::{own_faults, shape_faults};
use crate::wire::checked::{Checked, LARGE, List, document, take_given, take_or_default};
use crate::wire::picture::{PictureFile, PictureFormat};
use crate::wire::representation::Read;
use crate::wire::shape::{Points, ShapeInput};

document! {
    /// Two shapes or more, and the kind of path between them: `from` and `to`, or `shapes`.
    #[schema(example = json!({
        "representation": {"kind": "closed_curve", "dimension": 2, "control_points": 4, "generator": {"name": "trigonometric"}},
        "from": {"points": [[2, 0], [0, 1], [-2, 0], [0, -1]]}, "to": {"points": [[1, 0], [0, 2], [-1, 0], [0, -2]]},
        "path": "sphere", "positions": [0, 0.5, 1, 1.25]
    }))]
    pub(in crate::api::v1) struct MorphRequest {
        /// Representation of the shapes: curves or surfaces.
        #[schema(value_type = Representation, required = true)]
        representation: Read<Representation>, required;
        /// Conversion of posted points to control points. Default: `landmarks`.
        #[schema(value_type = Option<Correspondence>)]
        correspondence: Checked<Correspondence>;
        /// Shape at the start of the path.
        #[schema(value_type = Option<ShapeInput>)]
        from: ShapeInput;
        /// Shape at the end of the path.
        #[schema(value_type = Option<ShapeInput>)]
        to: ShapeInput;
        /// Shapes that the path leads through, in this order, in place of `from` and `to`. At least 2.
        #[schema(value_type = Option<Vec<ShapeInput>>, min_items = 2)]
        shapes: List<ShapeInput>;
        /// Kind of path from each shape to the next: the straight line, or the great circle between the shapes scaled to unit norm.
        /// Default: `plane`.
        #[schema(value_type = Option<PathKind>)]
        path: Checked<PathKind>;
        /// Positions on the path: 0 is `from`, 1 is `to`; of `shapes`, `k` is the shape at index `k`, and `k + 0.5` half way from it to
        /// the next. Values beyond the ends extrapolate, by 1000 paths or less.
        #[schema(value_type = Option<Vec<f64>>)]
        positions: Checked<Vec<f64>, LARGE>;
        /// Number of equally spaced positions from the first shape to the last, in place of `positions`. Default: 11 for two shapes,
        /// 10 more for each further shape.
        #[schema(value_type = Option<usize>, minimum = 2, maximum = 1000)]
        steps: Checked<usize>;
    }
}

/// A shape on the path.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct MorphFrame {
    /// Position on the path.
    position: f64,
    #[serde(flatten)]
    shape: ShapeOutput,
    /// Unit normals; only for the subdivision scheme `normal_based`.
    #[serde(skip_serializing_if = "Option::is_none")]
    normals: Option<Vec<[f64; 3]>>,
}

/// A path through shapes.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct MorphAnswer {
    /// One shape per position, in order.
    frames: Vec<MorphFrame>,
    /// Length of a path on the sphere in radians: the angle between two shapes, the sum of `angles` for several; null on straight
    /// lines.
    angle: Option<f64>,
    /// Angles from each of several `shapes` to the next in radians, on the sphere.
    #[serde(skip_serializing_if = "Option::is_none")]
    angles: Option<Vec<f64>>,
}

/// Largest number of equally spaced positions.
const MAX_STEPS: usize = 1000;
/// Default number of equally spaced positions from one shape to the next, without the first.
const USUAL_STEPS: usize = 10;

/// Kind of drawing of a path.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(in crate::api::v1) struct MorphQuery {
    /// Whether a drawing moves. Default: true for SVG.
    animate: Option<bool>,
}

impl MorphQuery {
    /// Whether a drawing in this format moves.
    fn animated(&self, format: ShapeFormat) -> Result<bool, Problem> {
        let refused = |detail: &str| Err(Problem::of_parameter("animate", detail));
        match (format, self.animate) {
            (
                ShapeFormat::Plain(Format::Picture(PictureFile { format: PictureFormat::Png, .. })),
                Some(true),
            ) => refused("expected false with the format png, which does not move"),
            (ShapeFormat::Plain(Format::Picture(file)), animate) => {
                Ok(animate.unwrap_or(file.format == PictureFormat::Svg))
            }
            (_, Some(_)) => refused("expected only with the format svg"),
            (_, None) => Ok(false),
        }
    }
}

/// Computes shapes on a path between two curves or surfaces, or through several, with extrapolation.
///
/// As SVG: an animation through the curves and back, or, with `animate=false` and as PNG, some of them side by side. Surfaces are
/// always drawn side by side.
///
/// As glTF, surfaces only: the first shape with displacements to all others, and an animation through them and back. As OBJ: an object
/// for each shape. As PLY or STL: one shape, for one position.
#[utoipa::path(post, path = "/v1/morph", tag = "curves", request_body = MorphRequest,
    params(MorphQuery, ShapeFormatQuery, DrawingQuery),
    responses(
        (status = 200, description = "Shapes on the path", content((MorphAnswer = "application/json"), (String = "image/svg+xml"), (Binary = "model/obj"), (Binary = "application/ply"), (Binary = "model/stl"), (Binary = "model/gltf-binary")))
    ))]
pub(in crate::api::v1) async fn morph(
    Caller(app): Caller,
    format: ShapeFormat,
    BesideFormat(query): BesideFormat<MorphQuery>,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    let animated = query.animated(format)?;
    let plan = move |app: &App, body: &[u8]| app.parse::<MorphRequest>(body)?.plan(app, format, animated);
    compute_planned(app, body, plan).await
}

impl MorphRequest {
    fn plan(mut self, app: &App, format: ShapeFormat, animated: bool) -> Result<Planned, ServiceError> {
        let mut errors = std::mem::take(&mut self.faults);
        let representation =
            self.representation.take().and_then(|field| field.take("/representation", &mut errors));
        let correspondence = take_or_default(self.correspondence.take(), "/correspondence", &mut errors);
        let kind = take_or_default(self.path.take(), "/path", &mut errors);
        let stops = self.take_stops(&mut errors);
        let positions = self.take_positions(stops.count().saturating_sub(1), &mut errors);
        let wanted = representation.zip(correspondence).zip(kind.zip(positions));
        if !errors.is_empty() {
            errors.extend(faults_of_stops(&stops));
        }
        let (((representation, correspondence), (kind, positions)), _) = checked(wanted, errors, Vec::new())?;
        let representation = app.admit(representation)?;
        let counts = Counts::new(&representation, 2, &app.limits);
        let reading = requests::morph(counts, stops.count(), false, &app.limits);
        let count = positions.count();
        let drawn = matches!(format, ShapeFormat::Plain(Format::Picture(_)));
        let work = requests::morph(counts, count, drawn, &app.limits)
            + reading
            + mesh_work(&representation, count, format, app);
        let task = MorphTask { representation, correspondence, kind, positions, stops };
        planned(work + format.work(), move |app| match format {
            ShapeFormat::Plain(Format::Picture(file)) => {
                picture(&task.drawing(app, &file.style, animated)?, &file)
            }
            ShapeFormat::Mesh(format, grid) => Ok(file_of(format, task.file(app, format, grid)?)),
            ShapeFormat::Plain(Format::Json) => json(StatusCode::OK, &MorphAnswer::from(task.morph(app)?)),
        })
    }

    /// Takes the shapes that the path leads through.
    fn take_stops(&mut self, errors: &mut Vec<Fault>) -> Stops {
        let ends = [self.from.take(), self.to.take()];
        let Some(shapes) = self.shapes.take() else {
            for (name, shape) in ["/from", "/to"].into_iter().zip(&ends) {
                if shape.is_none() {
                    errors
                        .push(Fault::new(name, "required field is missing: expected an object, or `shapes`"));
                }
            }
            return Stops::Ends(Box::new(ends.map(Option::unwrap_or_default)));
        };
        for (name, shape) in ["/from", "/to"].into_iter().zip(&ends) {
            if shape.is_some() {
                errors.push(Fault::new(name, "expected either from and to or shapes, got both"));
            }
        }
        let before = errors.len();
        let shapes = shapes.take("/shapes", errors);
        if shapes.len() < 2 && errors.len() == before {
            let detail = format!("expected at least 2 shapes, got {}", shapes.len());
            errors.push(Fault::new("/shapes", detail));
        }
        Stops::Listed(shapes)
    }

    /// Takes the positions on a path of so many pieces, or their number.
    fn take_positions(&mut self, pieces: usize, errors: &mut Vec<Fault>) -> Option<Positions> {
        let steps = take_given(self.steps.take(), "/steps", errors);
        let positions = take_given(self.positions.take(), "/positions", errors);
        match (positions, steps) {
            (Some(_), Some(_)) => {
                errors.push(Fault::new("/steps", "expected either positions or steps, got both"));
                None
            }
            (Some(positions), None) => Some(Positions::At(positions)),
            (None, steps) => {
                let usual = pieces.saturating_mul(USUAL_STEPS).saturating_add(1).clamp(2, MAX_STEPS);
                let steps = steps.unwrap_or(usual);
                if !(2..=MAX_STEPS).contains(&steps) {
                    let detail = format!("expected a number between 2 and {MAX_STEPS}, got {steps}");
                    errors.push(Fault::new("/steps", detail));
                }
                Some(Positions::Steps(steps.clamp(2, MAX_STEPS)))
            }
        }
    }
}

/// Faults of shapes that do not depend on the representation; a missing shape is already reported.
fn faults_of_stops(stops: &Stops) -> Vec<Fault> {
    match stops {
        Stops::Listed(shapes) => shape_faults(shapes.clone()),
        Stops::Ends(ends) => {
            let below = |(shape, pointer): (&ShapeInput, &'static str)| {
                own_faults(shape.clone()).into_iter().map(move |error| error.below(pointer))
            };
            ends.iter().zip(["/from", "/to"]).flat_map(below).collect()
        }
    }
}

/// Predicted work of `count` meshes of shapes of `representation`.
fn mesh_work(representation: &Representation, count: usize, format: ShapeFormat, app: &App) -> Work {
    let ShapeFormat::Mesh(_, grid) = format else { return Work::from_seconds(0.0) };
    let vertices = match (grid, representation.domain()) {
        (Some([u, v]), _) => u.saturating_mul(v),
        (None, Domain::Sheet { extent, .. }) => extent.usual_grid().iter().product(),
        _ => representation.refined_vertices(),
    };
    // More are refused.
    let count = count.min(app.limits.samples / vertices.max(1) + 1);
    count as f64 * requests::mesh([vertices, 1])
}

impl From<Morph> for MorphAnswer {
    fn from(Morph { frames, angles }: Morph) -> Self {
        let frame = |PathShape { position, control_points, normals }: PathShape| {
            let points = Points::from_columns(control_points.as_slice().to_vec(), control_points.ncols());
            MorphFrame { position, shape: ShapeOutput { control_points: points }, normals }
        };
        let angle = angles.as_ref().map(|angles| angles.iter().sum());
        let angles = angles.filter(|angles| angles.len() > 1);
        Self { frames: frames.into_iter().map(frame).collect(), angle, angles }
    }
}
