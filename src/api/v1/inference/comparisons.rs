//! Comparison of groups of shapes of a cohort by permutation tests.

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
use crate::domain::study::Comparison;
use crate::service::app::ServiceError;
use crate::service::inference::comparisons::{ComparedShapes, Grouping, NamedGroup, Options};
use crate::service::inference::study::StudyRequest;
use crate::wire::checked::{Checked, take_given};
use crate::wire::fault::Fault;

study_request! {
    /// Groups to compare, given as `groups` or by an attribute.
    #[schema(example = json!({
        "cohort": "example-cells", "permutations": 200,
        "groups": [
            {"name": "dlm8", "filter": {"labels": {"cell_line": "dlm8", "treatment": "control"}}},
            {"name": "dunn", "filter": {"labels": {"cell_line": "dunn", "treatment": "control"}}}
        ]
    }))]
    CompareRequest {
        /// Groups, 2 to 50, which share no shape. Give `groups` or `by`.
        #[schema(value_type = Option<Vec<NamedGroup>>, min_items = 2, max_items = 50)]
        groups: Checked<Vec<NamedGroup>>;
        /// Attribute that defines the groups, `label` or `labels.<attribute>`: each value forms a group.
        #[schema(value_type = Option<String>)]
        by: Checked<String>;
        /// With `by`: filter that selects shapes. Default: all shapes.
        #[schema(value_type = Option<ShapeFilter>)]
        filter: Checked<ShapeFilter>;
    } {
        /// Number of relabellings, 0 to 100000. Default: 1000. If no more than that exist, all of them are used.
        permutations
        /// Seed of the random relabellings. Default: 0.
        seed
        /// Attributes within whose values labels are exchanged: `subject`, `label`, `labels.<attribute>`, or a list.
        strata
    } {
        /// Number of points along the shape at which the effect is returned. Default: the number of control points.
        #[schema(value_type = Option<usize>, minimum = 1)]
        samples: Checked<usize>;
    }
}

/// Compares groups of shapes of a cohort.
///
/// All shapes are aligned to one mean, computed without knowledge of the groups. For every two groups the result has the
/// chordal distance of their mean spaces, the distance of their averages, pseudo-F, Hotelling's statistic, the effect along
/// the shape, and sizes, each with the p value of a permutation test. Small tests are answered at once; others become a job
/// (202) with this result. With `Prefer: wait=N` the response is the result if the job ends within `N` seconds, at most 60.
/// As SVG: the averages overlaid, with the effect as colour and width.
#[utoipa::path(post, path = "/v1/comparisons", tag = "inference", request_body = CompareRequest,
    params(
        ("format" = Option<String>, Query, description = "`json`, `svg` or `png`"), DrawingQuery,
        ("prefer" = Option<String>, Header, description = "`wait=10`: wait up to ten seconds for the job"), RetryHeader
    ),
    responses(
        (status = 200, description = "The comparison", content((Comparison = "application/json"), (String = "image/svg+xml"))),
        (status = 202, description = "The job that computes the comparison", body = JobOutput, headers(("Location" = String))),
        (status = 404, description = "No such cohort"),
        (status = "4XX", description = "The input was refused, or the job failed within the wait"),
        (status = 503, description = "Too many jobs are waiting")
    ))]
pub(in crate::api::v1) async fn compare(
    Caller(app): Caller,
    OnlyFormat(format): OnlyFormat,
    prefer: Prefer,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    answer_study::<CompareRequest>(app, format, prefer, body).await
}

impl StudyBody for CompareRequest {
    type Kind = ComparedShapes;

    fn take_priority(&mut self) -> Option<Checked<Priority>> {
        self.priority.take()
    }

    fn request(mut self) -> Result<StudyRequest<Options>, ServiceError> {
        let mut errors = std::mem::take(&mut self.faults);
        if self.groups.is_some() == self.by.is_some() {
            errors.push(Fault::new("", "expected either groups or by"));
        }
        if self.groups.is_some() && self.filter.is_some() {
            errors.push(Fault::new("/filter", "expected with by only: every group has its own filter"));
        }
        let cohort = take_given(self.cohort.take(), "/cohort", &mut errors);
        let groups = take_given(self.groups.take(), "/groups", &mut errors).map(Grouping::Named);
        let filter = take_filter(self.filter.take(), "/filter", &mut errors);
        let by = take_given(self.by.take(), "/by", &mut errors)
            .zip(filter)
            .map(|(attribute, filter)| Grouping::By { attribute, filter: Box::new(filter) });
        let common = self.take_common(&mut errors);
        let samples = take_given(self.samples.take(), "/samples", &mut errors);
        let options = groups.or(by).map(|grouping| Options { grouping, samples });
        common.request(cohort, options, errors)
    }
}
