//! The elastic match of two curves.

use axum::http::StatusCode;
use axum::response::Response;
use serde::{Deserialize, Serialize};

use crate::analysis::alignment::Alignment;
use crate::analysis::correspondence::{Correspondence, Direction, Mirror};
use crate::analysis::elastic::settings::{Effort, ElasticSettings};
use crate::analysis::factors::Estimator;
use crate::analysis::frame::Frame;
use crate::analysis::transformation::{ClassName, Transformation};
use crate::api::extract::{Caller, Format, JsonBody, OnlyFormat};
use crate::api::problem::Problem;
use crate::api::respond::{Planned, compute_planned, json, picture, planned};
#[cfg(feature = "schema")]
use crate::api::v1::requests::described::*;
use crate::api::v1::requests::request_macros::checked;
use crate::geometry::representation::Representation;
use crate::service::app::{App, ServiceError};
use crate::service::search::matched::{MatchFound, MatchTask};
use crate::service::statistics::Settings;
use crate::wire::checked::{Checked, List, document, take_given, take_or_default};
use crate::wire::fault::Fault;
use crate::wire::representation::Read;
use crate::wire::shape::{Points, ShapeInput};

document! {
    /// Two curves that are to be matched.
    #[schema(example = json!({
        "representation": {"kind": "closed_curve", "dimension": 2, "control_points": 32, "generator": {"name": "bspline", "degree": 3}},
        "shapes": [{"points": [[0, 0], [4, 0], [4, 1], [0, 1]]}, {"points": [[0, 0], [3, 0], [3, 2], [0, 1]]}]
    }))]
    pub(in crate::api::v1) struct ElasticMatchRequest {
        /// Two curves: control points, or contours of any number of points, which are resampled along their length.
        #[schema(value_type = Vec<ShapeInput>, required = true)]
        shapes: List<ShapeInput>, required;
        /// Representation of both: closed or open curves of at least 8 control points or intervals.
        #[schema(value_type = Representation, required = true)]
        representation: Read<Representation>, required;
        /// How to treat directions. Default: `either` for closed planar curves, else `given`.
        #[schema(value_type = Option<Direction>)]
        direction: Checked<Direction>;
        /// Whether the mirror image of the second curve may be matched. Default: `forbid`.
        #[schema(value_type = Option<Mirror>)]
        mirror: Checked<Mirror>;
        /// Whether rotations are removed. Default: true.
        #[schema(value_type = Option<bool>)]
        rotation: Checked<bool>;
        /// Weight of bending against stretching, above 0 and up to 1: near 0, lengths correspond. Default: 1.
        #[schema(value_type = Option<f64>, maximum = 1)]
        elasticity: Checked<f64>;
        /// Number of segments into which both curves are divided, 16 to 1000. Default: 100.
        #[schema(value_type = Option<usize>, minimum = 16, maximum = 1000)]
        points: Checked<usize>;
        /// Thoroughness of the search. Default: `normal`.
        #[schema(value_type = Option<Effort>)]
        effort: Checked<Effort>;
    }
}

/// Elastic match of two curves.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct ElasticMatch {
    /// Elastic distance, 0 to π/2.
    distance: f64,
    /// Rotation of the second curve to the first one, row by row; of its mirror image (first coordinate negated) if it is `mirrored`.
    rotation: Vec<Vec<f64>>,
    /// Place of the second curve, as a fraction of its length, that corresponds to the start of the first one.
    start: f64,
    /// Whether the second curve is traversed backwards.
    reversed: bool,
    /// Whether the mirror image of the second curve is matched.
    mirrored: bool,
    /// Places of the second curve, as fractions of its length, that correspond to the fractions `i/M` of the first one, `i = 0 … M`;
    /// on closed curves they go on beyond 0 and 1. They decrease if the curve is `reversed`.
    map: Vec<f64>,
    /// Points of both curves at corresponding places, in their own positions.
    #[schema(value_type = Vec<Vec<Vec<f64>>>)]
    curves: [Points; 2],
}

/// Matches two curves elastically: the distance, and what corresponds.
///
/// Directions are compared along the curves, modulo position, scale, rotation and parametrisation; closed curves may begin anywhere.
/// As SVG: both curves side by side with lines between corresponding places.
#[utoipa::path(post, path = "/v1/match", tag = "retrieval", request_body = ElasticMatchRequest,
    params(("format" = Option<String>, Query, description = "`json`, `svg` or `png`"), DrawingQuery),
    responses(
        (status = 200, description = "The match", content((ElasticMatch = "application/json"), (String = "image/svg+xml")))
    ))]
pub(in crate::api::v1) async fn match_curves(
    Caller(app): Caller,
    OnlyFormat(format): OnlyFormat,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    let plan = move |app: &App, body: &[u8]| app.parse::<ElasticMatchRequest>(body)?.plan(app, format);
    compute_planned(app, body, plan).await
}

/// Conversion of points to control points, or elastic correspondence of pairs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub(in crate::api::v1) enum PairCorrespondence {
    /// Points correspond as given.
    #[default]
    Landmarks,
    /// Contours are resampled at equal arc length from their first point.
    ArcLength,
    /// As `arc_length`, and start points are searched.
    Cyclic,
    /// Parameters of curves are searched for each pair: elastic distances.
    Elastic,
}

impl PairCorrespondence {
    /// The conversion of posted contours.
    pub(in crate::api::v1) fn conversion(self) -> Correspondence {
        match self {
            Self::Landmarks => Correspondence::Landmarks,
            Self::ArcLength => Correspondence::ArcLength,
            // Where contours begin and which way they run is of no account.
            Self::Cyclic | Self::Elastic => Correspondence::Cyclic,
        }
    }
}

/// Settings of an elastic distance as a request gives them.
pub(in crate::api::v1) struct ElasticFields {
    pub(in crate::api::v1) elasticity: Option<Checked<f64>>,
    pub(in crate::api::v1) points: Option<Checked<usize>>,
    pub(in crate::api::v1) rotation: Option<Checked<bool>>,
    pub(in crate::api::v1) effort: Option<Checked<Effort>>,
}

impl ElasticFields {
    /// The settings, with the usual values for those that are not given.
    pub(in crate::api::v1) fn take(self, errors: &mut Vec<Fault>) -> ElasticSettings {
        let usual = ElasticSettings::default();
        ElasticSettings {
            elasticity: take_given(self.elasticity, "/elasticity", errors).unwrap_or(usual.elasticity),
            points: take_given(self.points, "/points", errors).unwrap_or(usual.points),
            rotation: take_given(self.rotation, "/rotation", errors).unwrap_or(usual.rotation),
            effort: take_or_default(self.effort, "/effort", errors).unwrap_or_default(),
        }
    }
}

impl ElasticMatchRequest {
    fn plan(self, app: &App, format: Format) -> Result<Planned, ServiceError> {
        let mut errors = self.faults;
        let shapes = self.shapes.map(|shapes| shapes.take("/shapes", &mut errors)).unwrap_or_default();
        let representation = self.representation.and_then(|field| field.take("/representation", &mut errors));
        let direction = take_given(self.direction, "/direction", &mut errors);
        let mirror = take_or_default(self.mirror, "/mirror", &mut errors).unwrap_or_default();
        let Self { elasticity, points, rotation, effort, .. } = self;
        let elastic = ElasticFields { elasticity, points, rotation, effort }.take(&mut errors);
        let (representation, shapes) = checked(representation, errors, shapes)?;
        let direction =
            direction.unwrap_or_else(|| Direction::usual(Correspondence::Cyclic, &representation));
        let task = MatchTask::new(app, settings(representation, direction, mirror), elastic, shapes)?;
        planned(task.work(app) + format.work(), move |app| match format {
            Format::Picture(file) => picture(&task.drawing(app)?, &file),
            Format::Json => json(StatusCode::OK, &ElasticMatch::new(task.found(app)?)),
        })
    }
}

/// Settings of posted curves that are compared elastically.
fn settings(representation: Representation, direction: Direction, mirror: Mirror) -> Settings {
    let transformation = Transformation::Named(ClassName::Similarity);
    let alignment = Alignment::usual(&transformation, representation.dimension());
    Settings {
        representation,
        correspondence: Correspondence::default(),
        direction,
        mirror,
        transformation,
        alignment,
        frame: Frame::default(),
        estimator: Estimator::Plain,
    }
}

impl ElasticMatch {
    fn new(found: MatchFound) -> Self {
        let MatchFound { matched, points, .. } = found;
        let dimension = points[0].ncols();
        let rotation = matched.rotation.chunks_exact(dimension).map(<[f64]>::to_vec).collect();
        Self {
            distance: matched.distance,
            rotation,
            start: matched.places[0],
            reversed: matched.reversed,
            mirrored: matched.mirrored,
            map: matched.places,
            curves: points.map(|points| Points::from_columns(points.as_slice().to_vec(), dimension)),
        }
    }
}
