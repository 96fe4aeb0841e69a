//! Comparison of groups of shapes of a cohort by permutation tests.

use crate::formats::fault::Fault;
use axum::response::Response;
use serde::Deserialize;

use super::jobs::JobOutput;
use super::planned::answered;
use super::request_macros::{RetryHeader, priority_of};
use crate::analysis::alignment::Alignment;
use crate::analysis::correspondence::Mirror;
use crate::analysis::transformation::{ClassName, Transformation};
use crate::api::extract::{Caller, JsonBody, OnlyFormat, Prefer};
use crate::api::problem::Problem;
use crate::domain::comparison::Comparison;
use crate::domain::job::Priority;
use crate::domain::shape::ShapeFilter;
use crate::formats::checked::{Checked, document, take_given, take_or_default};
use crate::service::app::ServiceError;
use crate::service::inference::comparisons::{self, Compare, Grouping, NamedGroup};
use crate::service::inference::test_sample::DEFAULT_PERMUTATIONS;

document! {
    /// Groups to compare, given as `groups` or by an attribute.
    #[schema(example = json!({
        "cohort": "example-cells", "permutations": 200,
        "groups": [
            {"name": "dlm8", "filter": {"labels": {"cell_line": "dlm8", "treatment": "control"}}},
            {"name": "dunn", "filter": {"labels": {"cell_line": "dunn", "treatment": "control"}}}
        ]
    }))]
    pub(super) struct CompareRequest {
        /// Id or name of the cohort.
        #[schema(value_type = String, required = true)]
        cohort: Checked<String>, required;
        /// Groups, 2 to 50, which share no shape. Give `groups` or `by`.
        #[schema(value_type = Option<Vec<NamedGroup>>)]
        groups: Checked<Vec<NamedGroup>>;
        /// Attribute that defines the groups, `label` or `labels.<attribute>`: each value forms a group.
        #[schema(value_type = Option<String>)]
        by: Checked<String>;
        /// With `by`: filter that selects shapes. Default: all shapes.
        #[schema(value_type = Option<ShapeFilter>)]
        filter: Checked<ShapeFilter>;
        /// Transformation class to remove. Default: `similarity`.
        #[schema(value_type = Option<Transformation>)]
        transformation: Checked<Transformation>;
        /// Alignment method: projection onto the class, or Procrustes. Default: `projection`.
        #[schema(value_type = Option<Alignment>)]
        alignment: Checked<Alignment>;
        /// Whether shapes may be matched to mirror images. Default: the cohort's setting.
        #[schema(value_type = Option<Mirror>)]
        mirror: Checked<Mirror>;
        /// Number of relabellings, 0 to 100000. Default: 1000. If no more than that exist, all of them are used.
        #[schema(value_type = Option<usize>, maximum = 100000)]
        permutations: Checked<usize>;
        /// Seed of the random relabellings. Default: 0.
        #[schema(value_type = Option<u64>)]
        seed: Checked<u64>;
        /// Attributes within whose values labels are exchanged: `subject`, `label`, `labels.<attribute>`, or a list.
        #[schema(value_type = Option<Vec<String>>)]
        strata: Checked<Names>;
        /// Number of points along the shape at which the effect is returned. Default: the number of control points.
        #[schema(value_type = Option<usize>, minimum = 1)]
        samples: Checked<usize>;
        /// Priority among the tenant's queued jobs if the request becomes a job. Default: `normal`.
        #[schema(value_type = Option<Priority>)]
        priority: Checked<Priority>;
    }
}

/// One name or a list of names.
#[derive(Debug, Clone, Default)]
pub(super) struct Names(pub(super) Vec<String>);

/// Written by hand: the derived error of an untagged enum names neither the place nor the fault.
impl<'de> Deserialize<'de> for Names {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct NamesVisitor;
        impl<'de> serde::de::Visitor<'de> for NamesVisitor {
            type Value = Names;

            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str("the name of an attribute or a list of names")
            }

            fn visit_str<E: serde::de::Error>(self, name: &str) -> Result<Names, E> {
                Ok(Names(vec![name.to_owned()]))
            }

            fn visit_seq<A: serde::de::SeqAccess<'de>>(self, list: A) -> Result<Names, A::Error> {
                Vec::deserialize(serde::de::value::SeqAccessDeserializer::new(list)).map(Names)
            }
        }
        deserializer.deserialize_any(NamesVisitor)
    }
}

/// Compares groups of shapes of a cohort.
///
/// All shapes are aligned to one mean, computed without knowledge of the groups. For every two groups the result has the
/// chordal distance of their mean spaces, the distance of their averages, pseudo-F, Hotelling's statistic, the effect along
/// the shape, and sizes, each with the p value of a permutation test. Small tests are answered at once; others become a job
/// (202) with this result. With `Prefer: wait=N` the response is the result if the job ends within `N` seconds, at most 60.
/// As SVG: the averages overlaid, with the effect as colour and width.
#[utoipa::path(post, path = "/comparisons", tag = "tests", request_body = CompareRequest,
    params(
        ("format" = Option<String>, Query, description = "`json` or `svg`"),
        ("prefer" = Option<String>, Header, description = "`wait=10`: wait up to ten seconds for the job"), RetryHeader
    ),
    responses(
        (status = 200, description = "The comparison", content((Comparison = "application/json"), (String = "image/svg+xml"))),
        (status = 202, description = "The job that computes the comparison", body = JobOutput, headers(("Location" = String))),
        (status = 404, description = "No such cohort"),
        (status = "4XX", description = "The input was refused, or the job failed within the wait"),
        (status = 503, description = "Too many jobs are waiting")
    ))]
pub(super) async fn compare(
    Caller(app): Caller,
    OnlyFormat(format): OnlyFormat,
    prefer: Prefer,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    let app = app.with_body(&body);
    let mut request: CompareRequest = app.parse(&body)?;
    let app = app.with_priority(priority_of(request.priority.take())?);
    let prepared = comparisons::prepare(&app, compare_of(request)?).await?;
    answered(app, prepared, format, prefer).await
}

fn compare_of(request: CompareRequest) -> Result<Compare, ServiceError> {
    let mut errors = request.faults;
    if request.groups.is_some() == request.by.is_some() {
        errors.push(Fault::new("", "expected either groups or by"));
    }
    if request.groups.is_some() && request.filter.is_some() {
        errors.push(Fault::new("/filter", "expected with by only: every group has its own filter"));
    }
    let cohort = take_given(request.cohort, "/cohort", &mut errors);
    let groups = take_given(request.groups, "/groups", &mut errors).map(Grouping::Named);
    let filter = take_or_default(request.filter, "/filter", &mut errors);
    let by = take_given(request.by, "/by", &mut errors)
        .zip(filter)
        .map(|(attribute, filter)| Grouping::By { attribute, filter });
    let transformation = take_given(request.transformation, "/transformation", &mut errors);
    let alignment = take_or_default(request.alignment, "/alignment", &mut errors);
    let mirror = take_given(request.mirror, "/mirror", &mut errors);
    let permutations = take_given(request.permutations, "/permutations", &mut errors);
    let seed = take_or_default(request.seed, "/seed", &mut errors);
    let strata = take_or_default(request.strata, "/strata", &mut errors);
    let samples = take_given(request.samples, "/samples", &mut errors);
    ServiceError::unless_empty(errors)?;
    let incomplete = || ServiceError::invalid("", "the request is incomplete");
    Ok(Compare {
        cohort: cohort.ok_or_else(incomplete)?,
        grouping: groups.or(by).ok_or_else(incomplete)?,
        transformation: transformation.unwrap_or(Transformation::Named(ClassName::Similarity)),
        alignment: alignment.ok_or_else(incomplete)?,
        mirror,
        permutations: permutations.unwrap_or(DEFAULT_PERMUTATIONS),
        seed: seed.ok_or_else(incomplete)?,
        strata: strata.ok_or_else(incomplete)?.0,
        samples,
    })
}
