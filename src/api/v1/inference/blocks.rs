//! Blocks that vary together, and modules of the shapes of a cohort.

use std::collections::BTreeMap;

use axum::response::Response;

use crate::analysis::blocks::modularity::CovarianceRatio;
use crate::analysis::models::effect_size::Transform;
use crate::api::extract::{Caller, JsonBody, OnlyFormat, Prefer};
use crate::api::problem::Problem;
#[cfg(feature = "schema")]
use crate::api::v1::requests::described::*;
use crate::api::v1::requests::planned::{StudyBody, answer_study, study_request};
use crate::api::v1::requests::shape_query::take_filter;
use crate::domain::filter::ShapeFilter;
use crate::domain::job::Priority;
#[cfg(feature = "schema")]
use crate::domain::study::{ShapeBlocks, ShapeModularity};
use crate::service::app::ServiceError;
use crate::service::inference::blocks::{self, BlocksOfShapes};
use crate::service::inference::modularity::{self, ModularShapes};
use crate::service::inference::parts::{BlockSpec, PartSpec};
use crate::service::inference::study::StudyRequest;
use crate::wire::checked::{Checked, take_given, take_or_default};

study_request! {
    /// Blocks of the same shapes or subjects.
    #[schema(example = json!({
        "cohort": "example-cells", "permutations": 200, "x": {"range": [0, 0.49]}, "y": {"range": [0.5, 0.99]}, "separate": true
    }))]
    BlocksRequest {
        /// Filter that selects shapes of the cohort. Default: all shapes.
        #[schema(value_type = Option<ShapeFilter>)]
        filter: Checked<ShapeFilter>;
        /// First block. Default: the shapes of the cohort.
        #[schema(value_type = Option<BlockSpec>)]
        x: Checked<BlockSpec>;
        /// Second block.
        #[schema(value_type = BlockSpec, required = true)]
        y: Checked<BlockSpec>, required;
        /// Further blocks, at most 18: every two are compared.
        #[schema(value_type = Option<Vec<BlockSpec>>, max_items = 18)]
        others: Checked<Vec<BlockSpec>>;
        /// Whether parts are aligned on their own, by the points that belong to them. Default: false, as aligned with the whole shape.
        #[schema(value_type = Option<bool>)]
        separate: Checked<bool>;
        /// Transformation of the statistics before they are standardised. Default: `box_cox`.
        #[schema(value_type = Option<Transform>)]
        z: Checked<Transform>;
    } {
        /// Number of permutations, 0 to 100000. Default: 1000. If no more than that exist, all of them are used.
        permutations
        /// Seed of the permutations. Default: 0.
        seed
        /// Attributes within whose values shapes are exchanged: `subject`, `label`, `labels.<attribute>`, or a list.
        strata
    } {}
}

/// Measures how two blocks of the same shapes or subjects vary together.
///
/// Two-block partial least squares: pairs of singular shapes, the correlation of the scores of the first, and RV, each with Z and p of
/// permutations of the shapes of one block. A block is the shape, a part of it, a shape of another cohort, or labels. Small tests are
/// answered at once; others become a job (202) with this result. With `Prefer: wait=N` the response is the result if the job ends within
/// `N` seconds, at most 60. As SVG: the first pair of singular shapes from low to high scores.
#[utoipa::path(post, path = "/v1/two-blocks", tag = "inference", request_body = BlocksRequest,
    params(
        ("format" = Option<String>, Query, description = "`json`, `svg` or `png`"), DrawingQuery,
        ("prefer" = Option<String>, Header, description = "`wait=10`: wait up to ten seconds for the job"), RetryHeader
    ),
    responses(
        (status = 200, description = "How the blocks vary together", content((ShapeBlocks = "application/json"), (String = "image/svg+xml"))),
        (status = 202, description = "The job that compares the blocks", body = JobOutput, headers(("Location" = String))),
        (status = 404, description = "No such cohort"),
        (status = "4XX", description = "The input was refused, or the job failed within the wait"),
        (status = 503, description = "Too many jobs are waiting")
    ))]
pub(in crate::api::v1) async fn two_blocks(
    Caller(app): Caller,
    OnlyFormat(format): OnlyFormat,
    prefer: Prefer,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    answer_study::<BlocksRequest>(app, format, prefer, body).await
}

impl StudyBody for BlocksRequest {
    type Kind = BlocksOfShapes;

    fn take_priority(&mut self) -> Option<Checked<Priority>> {
        self.priority.take()
    }

    fn request(mut self) -> Result<StudyRequest<blocks::Options>, ServiceError> {
        let mut errors = std::mem::take(&mut self.faults);
        let cohort = take_given(self.cohort.take(), "/cohort", &mut errors);
        let filter = take_filter(self.filter.take(), "/filter", &mut errors);
        let x = take_or_default(self.x.take(), "/x", &mut errors);
        let y = take_given(self.y.take(), "/y", &mut errors);
        let others = take_or_default(self.others.take(), "/others", &mut errors);
        let separate = take_or_default(self.separate.take(), "/separate", &mut errors);
        let z = take_or_default(self.z.take(), "/z", &mut errors);
        let common = self.take_common(&mut errors);
        let options = (|| Some(blocks::Options::new(filter?, [x?, y?], others?, separate?, z?)))();
        common.request(cohort, options, errors)
    }
}

study_request! {
    /// Modules of the shapes of a cohort.
    #[schema(example = json!({
        "cohort": "example-cells", "modules": {"one": {"range": [0, 0.49]}, "other": {"range": [0.5, 0.99]}}
    }))]
    ModularityRequest {
        /// Filter that selects shapes of the cohort. Default: all shapes.
        #[schema(value_type = Option<ShapeFilter>)]
        filter: Checked<ShapeFilter>;
        /// The modules by their names, 2 to 50, which share no control point.
        #[schema(value_type = BTreeMap<String, PartSpec>, required = true)]
        modules: Checked<BTreeMap<String, PartSpec>>, required;
        /// Form of the covariance ratio: `invariant`, or `adams2016`, which depends on the frame. Default: `invariant`.
        #[schema(value_type = Option<CovarianceRatio>)]
        cr: Checked<CovarianceRatio>;
        /// Transformation of the ratio before it is standardised. Default: `box_cox`.
        #[schema(value_type = Option<Transform>)]
        z: Checked<Transform>;
    } {
        /// Number of permutations of landmarks, 0 to 100000. Default: 1000. Modules of closed curves are shifted along them, once by
        /// each control point. Shapes without a test, open curves and surfaces, take 0.
        permutations
        /// Seed of the permutations. Default: 0.
        seed
        /// Not for modules: expected empty.
        strata
    } {}
}

/// Measures whether parts of the shapes of a cohort are modules.
///
/// The covariance ratio of every two modules and its mean, with Z and p: landmarks are exchanged between modules, modules of closed curves
/// are shifted. Small tests are answered at once; others become a job (202) with this result. With `Prefer: wait=N` the response is the
/// result if the job ends within `N` seconds, at most 60. As SVG: the average with the control points of the modules.
#[utoipa::path(post, path = "/v1/modularity", tag = "inference", request_body = ModularityRequest,
    params(
        ("format" = Option<String>, Query, description = "`json`, `svg` or `png`"), DrawingQuery,
        ("prefer" = Option<String>, Header, description = "`wait=10`: wait up to ten seconds for the job"), RetryHeader
    ),
    responses(
        (status = 200, description = "The covariance ratio", content((ShapeModularity = "application/json"), (String = "image/svg+xml"))),
        (status = 202, description = "The job that tests the modules", body = JobOutput, headers(("Location" = String))),
        (status = 404, description = "No such cohort"),
        (status = "4XX", description = "The input was refused, or the job failed within the wait"),
        (status = 503, description = "Too many jobs are waiting")
    ))]
pub(in crate::api::v1) async fn modularity(
    Caller(app): Caller,
    OnlyFormat(format): OnlyFormat,
    prefer: Prefer,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    answer_study::<ModularityRequest>(app, format, prefer, body).await
}

impl StudyBody for ModularityRequest {
    type Kind = ModularShapes;

    fn take_priority(&mut self) -> Option<Checked<Priority>> {
        self.priority.take()
    }

    fn request(mut self) -> Result<StudyRequest<modularity::Options>, ServiceError> {
        let mut errors = std::mem::take(&mut self.faults);
        let cohort = take_given(self.cohort.take(), "/cohort", &mut errors);
        let filter = take_filter(self.filter.take(), "/filter", &mut errors);
        let modules = take_given(self.modules.take(), "/modules", &mut errors);
        let cr = take_or_default(self.cr.take(), "/cr", &mut errors);
        let z = take_or_default(self.z.take(), "/z", &mut errors);
        let common = self.take_common(&mut errors);
        let options = (|| Some(modularity::Options { filter: filter?, modules: modules?, cr: cr?, z: z? }))();
        common.request(cohort, options, errors)
    }
}
