//! Deformation of one shape by moved control points and by handles.

use axum::http::StatusCode;
use axum::response::Response;
use serde::Serialize;

use crate::analysis::correspondence::Correspondence;
use crate::api::extract::{Caller, JsonBody, NoQuery};
use crate::api::problem::Problem;
use crate::api::respond::{Planned, compute_planned, json, planned};
use crate::api::v1::requests::request_macros::{LayeredOutput, checked};
use crate::geometry::capability::deform::MovedOriented;
use crate::geometry::deformation::{ControlPointMove, Deformation, Handle, Support};
use crate::geometry::representation::Representation;
use crate::geometry::subdivision::normal_based::Oriented;
use crate::numeric::dense::Matrix;
use crate::service::app::{App, ServiceError};
use crate::service::cost::requests::{self, Counts};
use crate::service::shapes::blocks::Layers;
use crate::service::shapes::deform;
use crate::service::shapes::read::own_faults;
use crate::service::shapes::refine::Layered;
use crate::service::shapes::request::Posted;
use crate::wire::checked::{Checked, LARGE, document, take_or_default};
use crate::wire::representation::Read;
use crate::wire::shape::ShapeInput;

document! {
    /// A shape with moves and handles that deform it.
    #[schema(example = json!({
        "representation": {"kind": "closed_curve", "dimension": 2, "control_points": 6, "generator": {"name": "cubic"}},
        "shape": {"points": [[2, 0], [1, 1.7], [-1, 1.7], [-2, 0], [-1, -1.7], [1, -1.7]]},
        "handles": [{"parameters": [0.0], "position": [3, 0]}, {"parameters": [0.5], "position": [-2, 0]}]
    }))]
    pub(in crate::api::v1) struct DeformRequest {
        /// Representation of the shape: a curve or a surface.
        #[schema(value_type = Representation, required = true)]
        representation: Read<Representation>, required;
        /// Shape to deform.
        #[schema(value_type = ShapeInput, required = true)]
        shape: ShapeInput, required;
        /// Control points to move, before the handles are applied; for `normal_based`, with their normals.
        #[schema(value_type = Option<Vec<ControlPointMove>>)]
        moves: Checked<Vec<ControlPointMove>, LARGE>;
        /// Places on the shape and their target positions. The change of the shape is the smallest possible in `L₂`. For
        /// `normal_based`, places are control points, which move there.
        #[schema(value_type = Option<Vec<Handle>>)]
        handles: Checked<Vec<Handle>, LARGE>;
    }
}

/// A deformed shape.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct DeformAnswer {
    #[serde(flatten)]
    shape: LayeredOutput,
    /// Unit normals; only for the subdivision scheme `normal_based`.
    #[serde(skip_serializing_if = "Option::is_none")]
    normals: Option<Vec<[f64; 3]>>,
    /// Part of the shape that each moved control point changes, one entry per move.
    supports: Vec<Support>,
    /// `L₂` norm of the change; null for the subdivision scheme `normal_based`, which has no inner product.
    l2_change: Option<f64>,
    /// Largest change at the knots, or at the vertices of the level for `normal_based`.
    largest_change: f64,
}

/// Deforms a curve or surface: moves control points, then pulls the shape to handle targets with the least change.
///
/// Shapes of the subdivision scheme `normal_based` are edited by moving their points and normals.
#[utoipa::path(post, path = "/v1/deform", tag = "curves", request_body = DeformRequest,
    responses(
        (status = 200, description = "The deformed shape", body = DeformAnswer)
    ))]
pub(in crate::api::v1) async fn deform(
    Caller(app): Caller,
    _: NoQuery,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    compute_planned(app, body, |app, body| app.parse::<DeformRequest>(body)?.plan(app)).await
}

impl DeformRequest {
    fn plan(self, app: &App) -> Result<Planned, ServiceError> {
        let mut errors = self.faults;
        let representation = self.representation.and_then(|field| field.take("/representation", &mut errors));
        let moves = take_or_default(self.moves, "/moves", &mut errors);
        let handles = take_or_default(self.handles, "/handles", &mut errors);
        let shape = self.shape.unwrap_or_default();
        if !errors.is_empty() {
            errors.extend(own_faults(shape.clone()).into_iter().map(|error| error.below("/shape")));
        }
        let ((representation, (moves, handles)), _) =
            checked(representation.zip(moves.zip(handles)), errors, Vec::new())?;
        let representation = app.admit(representation)?;
        if !representation.is_linear() {
            let work = requests::deform_oriented(&representation, &app.limits);
            return planned(work, move |app| {
                let moved = deform::deform_oriented(app, &representation, shape, &moves, &handles)?;
                json(StatusCode::OK, &DeformAnswer::of_oriented(moved, &moves))
            });
        }
        let layers = Layers::new(app, representation, [("/shape".to_owned(), &shape)], None)?;
        let counts = Counts::new(layers.finest(), 1, &app.limits);
        let work = requests::deform(counts, handles.len()) + requests::grids(counts, layers.count());
        planned(work, move |app| {
            let posted = Posted::of_layers(app, &layers, Correspondence::Landmarks)?;
            let deformed = deform::deform(app, &posted, shape, &moves, &handles)?;
            json(StatusCode::OK, &DeformAnswer::new(&posted, deformed)?)
        })
    }
}

impl DeformAnswer {
    fn new(posted: &Posted, deformed: Deformation) -> Result<Self, ServiceError> {
        Ok(Self {
            shape: Layered::new(posted, deformed.shape)?.into(),
            normals: None,
            supports: deformed.supports,
            l2_change: Some(deformed.l2_change),
            largest_change: deformed.largest_change,
        })
    }

    fn of_oriented(moved: MovedOriented, moves: &[ControlPointMove]) -> Self {
        let MovedOriented { shape: Oriented { points, normals }, largest_change } = moved;
        let control_points = Matrix::from_fn(points.len(), 3, |k, c| points[k][c]);
        let support =
            |moved: &ControlPointMove| Support { control_point: moved.control_point, parameters: Vec::new() };
        Self {
            shape: Layered { control_points, blocks: Vec::new() }.into(),
            normals: Some(normals),
            supports: moves.iter().map(support).collect(),
            l2_change: None,
            largest_change,
        }
    }
}
