//! Repeatability of the shapes of a cohort.

use axum::response::Response;

use crate::api::extract::{Caller, JsonBody, OnlyFormat, Prefer};
use crate::api::problem::Problem;
#[cfg(feature = "schema")]
use crate::api::v1::requests::described::*;
use crate::api::v1::requests::planned::{StudyBody, answer_study, study_request};
use crate::api::v1::requests::shape_query::take_filter;
use crate::domain::filter::ShapeFilter;
use crate::domain::job::Priority;
#[cfg(feature = "schema")]
use crate::domain::study::ShapeRepeatability;
use crate::service::app::ServiceError;
use crate::service::inference::regressions::Missing;
use crate::service::inference::repeatability::{Options, RepeatedShapes};
use crate::service::inference::study::StudyRequest;
use crate::wire::checked::{Checked, take_given, take_or_default};

/// Draws of subjects by default.
const DRAWS: usize = 1000;

study_request! {
    /// A study of shapes that were taken several times of each subject.
    #[schema(example = json!({
        "cohort": "example-cells", "subject": "labels.cell_line", "permutations": 200, "bootstrap": 200
    }))]
    RepeatabilityRequest {
        /// Filter that selects shapes of the cohort. Default: all shapes.
        #[schema(value_type = Option<ShapeFilter>)]
        filter: Checked<ShapeFilter>;
        /// Attribute whose values are the subjects. Default: `subject`.
        #[schema(value_type = Option<String>)]
        subject: Checked<String>;
        /// Attribute whose values are the replicates, such as the device, the observer or the session. Default: none, and no table of
        /// measurement error.
        #[schema(value_type = Option<String>)]
        replicate: Checked<String>;
        /// Attribute whose values are groups of subjects, between which the replicates may differ unequally.
        #[schema(value_type = Option<String>)]
        groups: Checked<String>;
        /// Handling of shapes without a value. Default: `refuse`.
        #[schema(value_type = Option<Missing>)]
        missing: Checked<Missing>;
        /// Number of points along the shape. Default: the number of control points.
        #[schema(value_type = Option<usize>, minimum = 1)]
        samples: Checked<usize>;
        /// Number of draws of subjects for the intervals, 0 to 10000. Default: 1000.
        #[schema(value_type = Option<usize>, maximum = 10000)]
        bootstrap: Checked<usize>;
    } {
        /// Number of permutations, 0 to 100000. Default: 1000.
        permutations
        /// Seed of the permutations and draws. Default: 0.
        seed
        /// Attributes within whose values residuals are exchanged.
        strata
    } {}
}

/// Measures the repeatability of shapes.
///
/// All shapes are aligned to their mean. The answer is the part of the subjects in the variance (intraclass correlation) with an interval
/// from draws of subjects, along the shape, and by directions; with replicates also agreement, consistency, and the table of the error of
/// measurement with the systematic displacement of each replicate. Small studies are answered at once; others become a job (202) with this
/// result. With `Prefer: wait=N` the response is the result if the job ends within `N` seconds, at most 60. As SVG: the part of the
/// variance within subjects along the mean shape.
#[utoipa::path(post, path = "/v1/repeatability", tag = "inference", request_body = RepeatabilityRequest,
    params(
        ("format" = Option<String>, Query, description = "`json`, `svg` or `png`"), DrawingQuery,
        ("prefer" = Option<String>, Header, description = "`wait=10`: wait up to ten seconds for the job"), RetryHeader
    ),
    responses(
        (status = 200, description = "The repeatability", content((ShapeRepeatability = "application/json"), (String = "image/svg+xml"))),
        (status = 202, description = "The job that measures it", body = JobOutput, headers(("Location" = String))),
        (status = 404, description = "No such cohort"),
        (status = "4XX", description = "The input was refused, or the job failed within the wait"),
        (status = 503, description = "Too many jobs are waiting")
    ))]
pub(in crate::api::v1) async fn repeatability(
    Caller(app): Caller,
    OnlyFormat(format): OnlyFormat,
    prefer: Prefer,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    answer_study::<RepeatabilityRequest>(app, format, prefer, body).await
}

impl StudyBody for RepeatabilityRequest {
    type Kind = RepeatedShapes;

    fn take_priority(&mut self) -> Option<Checked<Priority>> {
        self.priority.take()
    }

    fn request(mut self) -> Result<StudyRequest<Options>, ServiceError> {
        let mut errors = std::mem::take(&mut self.faults);
        let cohort = take_given(self.cohort.take(), "/cohort", &mut errors);
        let filter = take_filter(self.filter.take(), "/filter", &mut errors);
        let subject = take_given(self.subject.take(), "/subject", &mut errors);
        let replicate = take_given(self.replicate.take(), "/replicate", &mut errors);
        let groups = take_given(self.groups.take(), "/groups", &mut errors);
        let missing = take_or_default(self.missing.take(), "/missing", &mut errors);
        let samples = take_given(self.samples.take(), "/samples", &mut errors);
        let bootstrap = take_given(self.bootstrap.take(), "/bootstrap", &mut errors);
        let common = self.take_common(&mut errors);
        let options = filter.zip(missing).map(|(filter, missing)| Options {
            filter,
            subject: subject.unwrap_or_else(|| "subject".into()),
            replicate,
            groups,
            missing,
            samples,
            bootstrap: bootstrap.unwrap_or(DRAWS),
        });
        common.request(cohort, options, errors)
    }
}
