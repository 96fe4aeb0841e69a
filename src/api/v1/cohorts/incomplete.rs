//! Principal components of shapes that miss control points.

use axum::http::StatusCode;
use axum::response::Response;
use serde::Serialize;

use crate::analysis::alignment::{Alignment, unwhitened};
use crate::analysis::correspondence::{Correspondence, Direction, Mirror};
use crate::analysis::factors::Estimator;
use crate::analysis::frame::Frame;
use crate::analysis::incomplete::IncompletePca;
use crate::analysis::transformation::Transformation;
use crate::api::extract::{Caller, JsonBody, NoQuery};
use crate::api::problem::Problem;
use crate::api::respond::{Planned, compute_planned, json, planned};
use crate::api::v1::requests::request_macros::{MeanOutput, ShapeOutput};
use crate::geometry::representation::Representation;
use crate::service::app::{App, ServiceError};
use crate::service::incomplete;
use crate::service::statistics::{Settings, Setup};
use crate::wire::checked::{Checked, LARGE, Many, document, take_given, take_many, take_or_default};
use crate::wire::fault::Fault;
use crate::wire::partial::PartialInput;
use crate::wire::representation::Read;
use crate::wire::shape::Points;

/// Default number of components.
const COMPONENTS: usize = 10;

document! {
    /// Shapes that miss control points, and the settings of their components.
    #[schema(example = json!({
        "representation": {"kind": "landmarks", "dimension": 2, "points": 4}, "transformation": "similarity", "components": 1,
        "shapes": [
            {"control_points": [[0, 0], [2, 0], [2, 1], [0, 1]]}, {"control_points": [[0, 0], [3, 0], null, [0, 1]]},
            {"control_points": [[0, 0], [2, 0.2], [2, 1.3], [0, 1]]}, {"control_points": [null, [2.5, 0], [2.4, 1], [0, 1.2]]}
        ]
    }))]
    pub(in crate::api::v1) struct IncompletePcaRequest {
        /// Representation of the shapes.
        #[schema(value_type = Representation, required = true)]
        representation: Read<Representation>, required;
        /// Transformation class removed before shapes are compared.
        #[schema(value_type = Transformation, required = true)]
        transformation: Checked<Transformation>, required;
        /// Alignment method. Default: `projection`, or `procrustes` where the class is no linear space.
        #[schema(value_type = Option<Alignment>)]
        alignment: Checked<Alignment>;
        /// Representative of the mean space. Default: `training`.
        #[schema(value_type = Option<Frame>)]
        frame: Checked<Frame>;
        /// Shapes: `control_points` with nulls, or with `observed`. Every control point is needed in at least two of them.
        #[schema(value_type = Vec<PartialInput>, required = true)]
        shapes: Many<PartialInput, LARGE>, required;
        /// Number of components, at most two fewer than shapes. Default: 10, or as many as there can be.
        #[schema(value_type = Option<usize>, minimum = 1)]
        components: Checked<usize>;
    }
}

/// Mean shape and principal components of incomplete shapes.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct IncompletePcaAnswer {
    #[serde(flatten)]
    mean: MeanOutput,
    /// The components.
    pca: IncompletePcaOutput,
    /// Completed shapes as given, in request order: missing control points at their most likely places.
    completed: Vec<ShapeOutput>,
    /// Number of missing control points of each shape.
    missing: Vec<usize>,
    /// Number of rounds of both steps.
    completion_rounds: usize,
    /// Whether the last of these rounds changed nothing.
    completion_converged: bool,
}

/// Functional principal components of incomplete shapes.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct IncompletePcaOutput {
    /// Arithmetic mean of the aligned, completed shapes.
    mean: ShapeOutput,
    /// Eigenvalues, descending: sums over the shapes, with the uncertainty of missing points.
    eigenvalues: Vec<f64>,
    /// Explained fractions.
    explained: Vec<f64>,
    /// Eigenshapes, orthonormal in `L₂`; the control coordinate of largest magnitude is positive.
    eigenshapes: Vec<ShapeOutput>,
    /// Scores of the completed shapes: one list per shape, one number per component.
    scores: Vec<Vec<f64>>,
    /// Standard deviation of the residual of the components, for each coordinate of an `L₂`-orthonormal basis.
    residual_deviation: f64,
}

/// Computes principal components of shapes that miss control points.
///
/// Missing points are replaced by their distribution given the seen ones, in turn with the components, until nothing changes
/// (expectation and maximisation of probabilistic principal components). Shapes without missing points have their usual components about
/// the mean. Points correspond as given.
#[utoipa::path(post, path = "/v1/pca/incomplete", tag = "statistics", request_body = IncompletePcaRequest,
    responses((status = 200, description = "Mean, components and completed shapes", body = IncompletePcaAnswer)))]
pub(in crate::api::v1) async fn incomplete_pca(
    Caller(app): Caller,
    _: NoQuery,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    compute_planned(app, body, |app, body| app.parse::<IncompletePcaRequest>(body)?.plan(app)).await
}

impl IncompletePcaRequest {
    fn plan(self, app: &App) -> Result<Planned, ServiceError> {
        let mut errors = self.faults;
        let representation = self.representation.and_then(|field| field.take("/representation", &mut errors));
        let transformation = take_given(self.transformation, "/transformation", &mut errors);
        let alignment = take_given(self.alignment, "/alignment", &mut errors);
        let frame = take_or_default(self.frame, "/frame", &mut errors);
        let shapes = take_many(self.shapes, "/shapes", &mut errors).unwrap_or_default();
        let components = take_given(self.components, "/components", &mut errors);
        if components == Some(0) {
            errors.push(Fault::new("/components", "expected at least 1, got 0"));
        }
        let (Some(representation), Some(transformation), true) =
            (representation, transformation, errors.is_empty())
        else {
            ServiceError::unless_empty(errors)?;
            return Err(ServiceError::invalid(
                "",
                "expected a representation and a transformation, got none",
            ));
        };
        let settings = Settings {
            alignment: alignment
                .unwrap_or_else(|| Alignment::usual(&transformation, representation.dimension())),
            representation,
            correspondence: Correspondence::Landmarks,
            direction: Direction::default(),
            mirror: Mirror::default(),
            transformation,
            frame: frame.unwrap_or_default(),
            estimator: Estimator::Plain,
        };
        let settings = settings.checked(&app.limits)?;
        let size = settings.representation.size();
        let most = (size * settings.representation.dimension()).saturating_sub(POSE);
        let components =
            components.unwrap_or_else(|| COMPONENTS.min(shapes.len().saturating_sub(2)).min(most).max(1));
        let work = incomplete::work(size * settings.representation.dimension(), shapes.len(), components);
        planned(work, move |app| {
            let setup = Setup::new(app, settings)?;
            let found = incomplete::pca(app, &setup, shapes, components)?;
            json(StatusCode::OK, &IncompletePcaAnswer::new(&setup, found))
        })
    }
}

/// Most unknowns of a pose, and one more.
const POSE: usize = 13;

impl IncompletePcaAnswer {
    fn new(setup: &Setup, found: incomplete::Found) -> Self {
        let incomplete::Found {
            pca: IncompletePca { mean, aligned, completed, pca, noise, rounds, converged },
            missing,
        } = found;
        let (metric, d) = (&setup.metric, setup.metric.dimension());
        let shape = |control_points: Vec<f64>| ShapeOutput {
            control_points: Points::from_columns(control_points, d),
        };
        let whole = |whitened: &[f64]| shape(unwhitened(metric, whitened));
        Self {
            mean: MeanOutput::new(&mean, d),
            completed: completed.chunks_exact(metric.len()).map(|points| shape(points.to_vec())).collect(),
            missing,
            completion_rounds: rounds,
            completion_converged: converged,
            pca: IncompletePcaOutput {
                mean: whole(&pca.mean),
                eigenshapes: pca.eigenshapes.column_iter().map(|xi| whole(xi.as_slice())).collect(),
                scores: aligned.iter().map(|shape| pca.scores(&shape.whitened)).collect(),
                eigenvalues: pca.eigenvalues,
                explained: pca.explained,
                residual_deviation: noise.sqrt(),
            },
        }
    }
}
