//! Tests of stored shapes, answered inline or by a job.

use axum::http::StatusCode;
use axum::response::Response;
use tokio::runtime::Handle;

use super::jobs::accepted;
use crate::api::extract::{Format, Prefer};
use crate::api::problem::Problem;
use crate::api::respond::{compute, json, svg};
use crate::domain::job::JobStatus;
use crate::service::app::{App, ServiceError, Work};
use crate::service::jobs;
use crate::service::jobs::inline_or_job::{PlannedTest, submit};

/// Answers small tests inline. Others become a job: returns its result if it is ready within the client's `wait`, else the job.
pub(super) async fn answered<T: PlannedTest>(
    app: App,
    test: T,
    format: Format,
    prefer: Prefer,
) -> Result<Response, Problem> {
    if test.is_quick() {
        let (handle, work) = (Handle::current(), Work::of_seconds(test.seconds()));
        return compute(app.weighing(work), move |app| {
            let answer = test.answer(app, &handle, &app.pool.context())?;
            match format {
                Format::Svg => Ok(svg(test.draw(&answer))),
                Format::Json => json(StatusCode::OK, &answer),
            }
        })
        .await;
    }
    let job = submit(&app, &test).await?;
    // Without `wait`, the client gets the job, even if a replayed request finds it finished.
    let Some(time) = prefer.wait else { return Ok(accepted(job)?) };
    let mut job = jobs::wait(&app, &job.id, time).await?;
    match (job.status, job.result.take()) {
        (JobStatus::Succeeded, Some(result)) => {
            compute(app.weighing(Work::MOMENT), move |_| match format {
                Format::Json => json(StatusCode::OK, &result),
                Format::Svg => {
                    let answer = serde_json::from_value(result)
                        .map_err(|error| ServiceError::Internal(format!("the result of a job: {error}")))?;
                    Ok(svg(test.draw(&answer)))
                }
            })
            .await
        }
        (JobStatus::Failed, _) => Err(Problem::of_failed(&job)),
        _ => Ok(accepted(job)?),
    }
}
