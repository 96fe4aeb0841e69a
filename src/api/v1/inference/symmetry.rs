//! Symmetry and asymmetry: of the shapes of a cohort, or of one posted curve without markings.

use axum::http::StatusCode;
use axum::response::Response;
use serde::Serialize;
use serde::de::IgnoredAny;

use crate::analysis::correspondence::Mirror;
use crate::analysis::models::effect_size::Transform;
use crate::analysis::symmetry::records::{CurvePlaneRecord, SymmetryKind};
use crate::api::extract::{Caller, Format, JsonBody, OnlyFormat, Prefer};
use crate::api::problem::Problem;
use crate::api::respond::{Planned, compute_planned, json, picture, planned};
#[cfg(feature = "schema")]
use crate::api::v1::requests::described::*;
use crate::api::v1::requests::planned::{StudyBody, answer_study, study_request};
use crate::api::v1::requests::shape_query::take_filter;
use crate::domain::filter::ShapeFilter;
use crate::domain::job::Priority;
#[cfg(feature = "schema")]
use crate::domain::study::ShapeSymmetry;
use crate::service::app::{App, ServiceError};
use crate::service::cost::requests;
use crate::service::inference::study::StudyRequest;
use crate::service::inference::symmetry::{Options, SymmetricShapes};
use crate::service::shapes::symmetry::CurvePlanes;
use crate::wire::checked::{Checked, document, take_given, take_or_default};
use crate::wire::shape::ShapeInput;

study_request! {
    /// Shapes of a cohort: those that have a plane of symmetry in themselves, or left and right ones.
    #[schema(example = json!({"cohort": "example-cells", "kind": "object", "permutations": 200}))]
    SymmetryRequest {
        /// Filter that selects shapes of the cohort. Default: all shapes.
        #[schema(value_type = Option<ShapeFilter>)]
        filter: Checked<ShapeFilter>;
        /// `object`: shapes that have a plane of symmetry in themselves; `matching`: left shapes and right ones.
        #[schema(value_type = SymmetryKind, required = true)]
        kind: Checked<SymmetryKind>, required;
        /// Object symmetry of landmarks and control meshes: pairs of points that change places; all others lie on the midline. Curves and
        /// surfaces are traversed backwards instead.
        #[schema(value_type = Option<Vec<[usize; 2]>>)]
        pairs: Checked<Vec<[usize; 2]>>;
        /// Attribute whose values are the individuals: several shapes of one individual and side are replicates. Default: `subject` for
        /// matching symmetry; for object symmetry each shape is an individual.
        #[schema(value_type = Option<String>)]
        individual: Checked<String>;
        /// Matching symmetry: attribute whose two values are the sides.
        #[schema(value_type = Option<String>)]
        side: Checked<String>;
        /// Matching symmetry: value of the left side, from which the mirrored right one is subtracted. Default: the first of both.
        #[schema(value_type = Option<String>)]
        left: Checked<String>;
        /// Attribute that tells replicates apart: each value once for each individual and side. Default: not checked.
        #[schema(value_type = Option<String>)]
        replicate: Checked<String>;
        /// Matching symmetry: whether the right shapes were mirrored before they were stored. Default: false.
        #[schema(value_type = Option<bool>)]
        mirrored: Checked<bool>;
        /// Whether each individual has a map of its asymmetry along the shape. Default: false.
        #[schema(value_type = Option<bool>)]
        maps: Checked<bool>;
        /// Transformation of F before it is standardised. Default: `box_cox`.
        #[schema(value_type = Option<Transform>)]
        z: Checked<Transform>;
    } {
        /// Number of permutations, 0 to 100000. Default: 1000. If no more than that exist, all of them are used.
        permutations
        /// Seed of the permutations. Default: 0.
        seed
        /// Not for symmetry: expected empty.
        strata
    } {
        /// Number of points along the shape at which asymmetry is returned. Default: the number of control points.
        #[schema(value_type = Option<usize>, minimum = 1)]
        samples: Checked<usize>;
    }
}

document! {
    /// One closed curve without markings.
    #[schema(example = json!({"shape": {"points": [[2, 0], [1, 1], [-1, 1.2], [-2, 0], [-1, -1.2], [1, -1]]}, "count": 64}))]
    pub(in crate::api::v1) struct CurveSymmetryRequest {
        /// The curve: points along a closed contour in the plane or in space.
        #[schema(value_type = ShapeInput, required = true)]
        shape: ShapeInput, required;
        /// Number of points of equal arc length at which it is compared with its images, at least 8. Default: as many as are posted.
        #[schema(value_type = Option<usize>, minimum = 8)]
        count: Checked<usize>;
    }
}

/// Shapes whose symmetry is asked for.
#[derive(utoipa::ToSchema)]
#[schema(example = json!({"cohort": "example-cells", "kind": "object", "permutations": 200}))]
#[serde(untagged)]
#[allow(dead_code, reason = "only for the document")]
pub(in crate::api::v1) enum SymmetryBody {
    /// Shapes of a cohort.
    Cohort(Box<SymmetryRequest>),
    /// One closed curve.
    Curve(Box<CurveSymmetryRequest>),
}

/// Results.
#[derive(utoipa::ToSchema)]
#[serde(untagged)]
#[allow(dead_code, reason = "only for the document")]
#[cfg(feature = "schema")]
pub(in crate::api::v1) enum SymmetryAnswer {
    /// Of the shapes of a cohort.
    Cohort(Box<ShapeSymmetry>),
    /// Of one closed curve.
    Curve(CurveSymmetryAnswer),
}

/// Planes of symmetry of a closed curve.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct CurveSymmetryAnswer {
    /// Number of points of equal arc length.
    count: usize,
    /// Mean of the points, through which all planes pass.
    centre: Vec<f64>,
    /// Length of the posted polygon.
    polygon_length: f64,
    /// Planes whose correlation is a local maximum of at least 95 % of the best, which comes first; at most 16.
    planes: Vec<CurvePlaneRecord>,
}

/// The fields that tell both requests apart.
#[derive(serde::Deserialize)]
struct Fields {
    shape: Option<IgnoredAny>,
}

/// Measures symmetry and asymmetry: of the shapes of a cohort, or of one closed curve without markings.
///
/// Of a cohort: shapes beside their own images (`object`), or left beside mirrored right ones (`matching`), aligned to one mean; the
/// table of individuals, sides (directional asymmetry) and their interaction (fluctuating asymmetry) with F, Z and p, indices of each
/// individual, and where the sides differ. Small tests are answered at once; others become a job (202) with this result. With
/// `Prefer: wait=N` the response is the result if the job ends within `N` seconds, at most 60. As SVG: both asymmetries along the average.
///
/// Of a curve given as `shape`: the planes in which it is most like its mirror image, whatever its start and direction. As SVG: the
/// curve with its axes.
#[utoipa::path(post, path = "/v1/symmetry", tag = "inference", request_body = SymmetryBody,
    params(
        ("format" = Option<String>, Query, description = "`json`, `svg` or `png`"), DrawingQuery,
        ("prefer" = Option<String>, Header, description = "`wait=10`: wait up to ten seconds for the job"), RetryHeader
    ),
    responses(
        (status = 200, description = "Symmetry and asymmetry", content((SymmetryAnswer = "application/json"), (String = "image/svg+xml"))),
        (status = 202, description = "The job that measures symmetry", body = JobOutput, headers(("Location" = String))),
        (status = 404, description = "No such cohort"),
        (status = "4XX", description = "The input was refused, or the job failed within the wait"),
        (status = 503, description = "Too many jobs are waiting")
    ))]
pub(in crate::api::v1) async fn symmetry(
    Caller(app): Caller,
    OnlyFormat(format): OnlyFormat,
    prefer: Prefer,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    // A body that is not JSON is refused by its reader.
    let is_curve = serde_json::from_slice::<Fields>(&body).is_ok_and(|fields| fields.shape.is_some());
    if is_curve {
        let plan = move |app: &App, body: &[u8]| app.parse::<CurveSymmetryRequest>(body)?.plan(app, format);
        return compute_planned(app, body, plan).await;
    }
    answer_study::<SymmetryRequest>(app, format, prefer, body).await
}

impl CurveSymmetryRequest {
    fn plan(mut self, app: &App, format: Format) -> Result<Planned, ServiceError> {
        let mut errors = std::mem::take(&mut self.faults);
        let count = take_given(self.count.take(), "/count", &mut errors);
        ServiceError::unless_empty(errors)?;
        let shape = self.shape.ok_or_else(|| ServiceError::invalid("/shape", "required field is missing"))?;
        let shapes = [shape];
        let work = requests::resample(&shapes, count.unwrap_or_default(), &app.limits) + format.work();
        let [shape] = shapes;
        planned(work, move |app| {
            let found = CurvePlanes::of(app, shape, count)?;
            match format {
                Format::Picture(file) => picture(&found.drawing(), &file),
                Format::Json => json(
                    StatusCode::OK,
                    &CurveSymmetryAnswer {
                        count: found.points.nrows(),
                        centre: found.centre,
                        polygon_length: found.length,
                        planes: found.planes,
                    },
                ),
            }
        })
    }
}

impl StudyBody for SymmetryRequest {
    type Kind = SymmetricShapes;

    fn take_priority(&mut self) -> Option<Checked<Priority>> {
        self.priority.take()
    }

    fn request(mut self) -> Result<StudyRequest<Options>, ServiceError> {
        let mut errors = std::mem::take(&mut self.faults);
        let cohort = take_given(self.cohort.take(), "/cohort", &mut errors);
        let filter = take_filter(self.filter.take(), "/filter", &mut errors);
        let kind = take_given(self.kind.take(), "/kind", &mut errors);
        let pairs = take_or_default(self.pairs.take(), "/pairs", &mut errors);
        let individual = take_given(self.individual.take(), "/individual", &mut errors);
        let side = take_given(self.side.take(), "/side", &mut errors);
        let left = take_given(self.left.take(), "/left", &mut errors);
        let replicate = take_given(self.replicate.take(), "/replicate", &mut errors);
        let mirrored = take_or_default(self.mirrored.take(), "/mirrored", &mut errors);
        let samples = take_given(self.samples.take(), "/samples", &mut errors);
        let maps = take_or_default(self.maps.take(), "/maps", &mut errors);
        let z = take_or_default(self.z.take(), "/z", &mut errors);
        let mut common = self.take_common(&mut errors);
        // An image that were matched to its own mirror image would be the shape again.
        common.mirror.get_or_insert(Mirror::Forbid);
        let options = (|| {
            Some(Options {
                filter: filter?,
                kind: kind?,
                pairs: pairs?,
                individual,
                side,
                left,
                replicate,
                mirrored: mirrored?,
                samples,
                maps: maps?,
                z: z?,
            })
        })();
        common.request(cohort, options, errors)
    }
}
