//! The report card of a dictionary.

use axum::response::Response;

use crate::analysis::dictionary::report::{Measurement, ReportOptions};
use crate::api::extract::{Caller, JsonBody, OnlyFormat, Path, Prefer};
use crate::api::problem::Problem;
#[cfg(feature = "schema")]
use crate::api::v1::requests::described::*;
use crate::api::v1::requests::planned::answered;
use crate::api::v1::requests::request_macros::priority_of;
use crate::domain::job::Priority;
use crate::service::app::ServiceError;
#[cfg(feature = "schema")]
use crate::service::dictionaries::report::DictionaryReport;
use crate::service::dictionaries::report::PlannedReport;
use crate::wire::checked::{Checked, document, take_given, take_or_default};

/// Defaults.
const MODES: usize = 20;
const DRAWS: usize = 1000;
const RESAMPLES: usize = 200;

document! {
    /// Content of a report card.
    #[schema(example = json!({
        "modes": 10,
        "measurements": [{"name": "length", "measure": {"kind": "distance", "between": [0.0, 0.5]}, "values": [40.0]}]
    }))]
    pub(in crate::api::v1) struct ReportRequest {
        /// Number of modes, 1 to 64. Default: 20, or all if there are fewer.
        #[schema(value_type = Option<usize>, minimum = 1, maximum = 64)]
        modes: Checked<usize>;
        /// Number of random shapes of the specificity, 1 to 10000. Default: 1000.
        #[schema(value_type = Option<usize>, minimum = 1, maximum = 10000)]
        draws: Checked<usize>;
        /// Number of resamples of the subjects, 0 to 10000. Default: 200.
        #[schema(value_type = Option<usize>, minimum = 0, maximum = 10000)]
        resamples: Checked<usize>;
        /// Seed of all random choices. Default: 0.
        #[schema(value_type = Option<u64>)]
        seed: Checked<u64>;
        /// Named measurements, at most 50.
        #[schema(value_type = Option<Vec<Measurement>>, max_items = 50)]
        measurements: Checked<Vec<Measurement>>;
        /// Priority among the tenant's queued jobs if the request becomes a job. Default: `normal`.
        #[schema(value_type = Option<Priority>)]
        priority: Checked<Priority>;
    }
}

/// Examines the modes of a dictionary of components.
///
/// For each number of modes: compactness (explained variance), generalisation (error of shapes whose subject was left out, by exact
/// downdates), specificity (distance of random shapes to the nearest training shape), variances and angles of modes under resampling of
/// subjects, each with an interval that covers 95 %. Also a learning curve, and named measurements with their change by each mode and
/// the most likely shape that has a wanted value. Lengths are in the unit of the cohort. Quick reports are answered at once; others
/// become a job (202) with this result. With `Prefer: wait=N` the response is the result if the job ends within `N` seconds, at most
/// 60. As SVG: compactness, errors and stability against the number of modes, and the learning curve.
#[utoipa::path(post, path = "/v1/dictionaries/{dictionary}/report", tag = "dictionaries", request_body = ReportRequest,
    params(
        ("dictionary" = String, Path, description = "Id, `name@version`, `name@alias` or name"),
        ("format" = Option<String>, Query, description = "`json`, `svg` or `png`"), DrawingQuery,
        ("prefer" = Option<String>, Header, description = "`wait=10`: wait up to ten seconds for the job"), RetryHeader
    ),
    responses(
        (status = 200, description = "The report card", content((DictionaryReport = "application/json"), (String = "image/svg+xml"))),
        (status = 202, description = "The job that computes the report card", body = JobOutput, headers(("Location" = String))),
        (status = 404, description = "No such dictionary, or its cohort was deleted"),
        (status = "4XX", description = "The input was refused, or the job failed within the wait"),
        (status = 503, description = "Too many jobs are waiting")
    ))]
pub(in crate::api::v1) async fn dictionary_report(
    Caller(app): Caller,
    Path(key): Path<String>,
    OnlyFormat(format): OnlyFormat,
    prefer: Prefer,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    let app = app.with_body(&body);
    let mut request: ReportRequest = app.parse(&body)?;
    let app = app.with_priority(priority_of(request.priority.take())?);
    let report = PlannedReport::prepare(&app, &key, request.options()?).await?;
    answered(app, report, format, prefer).await
}

impl ReportRequest {
    fn options(mut self) -> Result<ReportOptions, ServiceError> {
        let mut errors = std::mem::take(&mut self.faults);
        let modes = take_given(self.modes.take(), "/modes", &mut errors);
        let draws = take_given(self.draws.take(), "/draws", &mut errors);
        let resamples = take_given(self.resamples.take(), "/resamples", &mut errors);
        let seed = take_or_default(self.seed.take(), "/seed", &mut errors);
        let measurements = take_or_default(self.measurements.take(), "/measurements", &mut errors);
        ServiceError::unless_empty(errors)?;
        Ok(ReportOptions {
            modes: modes.unwrap_or(MODES),
            draws: draws.unwrap_or(DRAWS),
            resamples: resamples.unwrap_or(RESAMPLES),
            seed: seed.unwrap_or_default(),
            measurements: measurements.unwrap_or_default(),
        })
    }
}
