//! Jobs: long work that is stored before it is answered, runs beside the requests, and survives a restart.
//!
//! * this file — what clients do: submit, find, list, cancel, wait;
//! * [`registry`] — what is known of a job while it runs: its progress, whether it shall stop, who wants to hear of it;
//! * [`attempt`] — what the worker does: claim, renew, settle;
//! * [`inline_or_job`] — answered at once when it is predicted to be quick, else by a job;
//! * [`watch`] — the changes of a job, one after the other.

pub mod attempt;
pub mod inline_or_job;
pub mod registry;
pub mod watch;

use std::time::Duration;

use serde_json::Value;
use tokio::time::Instant;

use crate::domain::dictionary::NewDictionary;
use crate::domain::id;
use crate::domain::job::{Job, JobKind, JobOutput, JobStatus};
use crate::service::app::{App, Page, ServiceError, Work, metrics, now_ms};
use crate::store::jobs::Quota;

/// What an attempt brought about.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome {
    /// What the job answers.
    pub result: Value,
    /// What it has learnt: stored when, and only when, the job succeeds.
    pub dictionary: Option<Box<NewDictionary>>,
    /// What is kept beside the job, as long as there is room.
    pub output: Option<Box<JobOutput>>,
}

/// Stores a new job that is predicted to take so many seconds; a worker takes it when its turn comes. The same request again
/// finds the job it has made.
///
/// # Errors
/// [`ServiceError::KeyReused`]; [`ServiceError::TooCostly`] when it is predicted to take longer than a job may;
/// [`ServiceError::Unavailable`] when too many of the tenant wait, or too much.
pub async fn submit(app: &App, kind: JobKind, parameters: Value, seconds: f64) -> Result<Job, ServiceError> {
    if let Some(id) = app.done_before::<String>().await? {
        return find(app, &id).await;
    }
    Work::of_seconds(seconds).check(app.limits.job_time.as_secs_f64())?;
    let job = Job::new(kind, parameters, now_ms()).weighing(seconds, app.priority);
    let quota = Quota { jobs: app.limits.queued_jobs, seconds: app.limits.queued_work.as_secs_f64() };
    app.store.create_job_within(quota, &job, app.receipt(&job.id).as_ref()).await?;
    app.registry().wake();
    Ok(job)
}

/// The job with this id, with its progress of this moment.
///
/// # Errors
/// [`ServiceError::NotFound`].
pub async fn find(app: &App, id: &str) -> Result<Job, ServiceError> {
    let found = app.store.find_job(id).await?;
    found.map(|job| app.registry().up_to_date(job)).ok_or_else(|| not_found(id))
}

/// What the job with this id has brought about.
///
/// # Errors
/// [`ServiceError::NotFound`] for the job; for its output when there is none: not yet, not for ever, or not any more.
pub async fn output(app: &App, id: &str) -> Result<JobOutput, ServiceError> {
    let job = find(app, id).await?;
    let output = app.store.read_job_output(&job.id).await?;
    output.ok_or(ServiceError::NotFound { kind: "output of the job", key: job.id })
}

fn not_found(id: &str) -> ServiceError {
    ServiceError::NotFound { kind: "job", key: id.into() }
}

/// Jobs in the order of their creation, after `cursor` (the id of the last one seen).
///
/// # Errors
/// A cursor that is not one.
pub async fn list(
    app: &App,
    status: Option<JobStatus>,
    cursor: Option<&str>,
    limit: usize,
) -> Result<Page<Job>, ServiceError> {
    if cursor.is_some_and(|cursor| !cursor.starts_with(&format!("{}_", id::JOB))) {
        return Err(ServiceError::Query("cursor is not one of this list".into()));
    }
    let mut items = app.store.list_jobs(status, cursor, limit + 1).await?;
    let next = (items.len() > limit).then(|| items[limit - 1].id.clone());
    items.truncate(limit);
    Ok((items.into_iter().map(|job| app.registry().up_to_date(job)).collect(), next))
}

/// Cancels a job that is not finished; one that is cancelled stays so.
///
/// The job is cancelled when this returns; its thread stops at its next [`JobContext::check`].
///
/// # Errors
/// [`ServiceError::NotFound`]; [`ServiceError::JobFinished`] when it succeeded or failed before.
pub async fn cancel(app: &App, id: &str) -> Result<Job, ServiceError> {
    let job = app.store.cancel_job(id, now_ms()).await?.ok_or_else(|| not_found(id))?;
    if job.status != JobStatus::Cancelled {
        return Err(ServiceError::JobFinished { id: job.id, status: job.status.as_str() });
    }
    metrics::job_cancelled();
    app.registry().interrupt(id);
    app.registry().announce(id);
    Ok(job)
}

/// The job as soon as it is finished, or as it is after `time`, or when the service is asked to stop.
///
/// # Errors
/// [`ServiceError::NotFound`].
pub async fn wait(app: &App, id: &str, time: Duration) -> Result<Job, ServiceError> {
    let channel = app.registry().channel(id);
    let mut states = channel.states();
    let end = Instant::now() + time;
    loop {
        let job = find(app, id).await?;
        if job.status.is_finished() {
            return Ok(job);
        }
        tokio::select! {
            // The channel, which is held here, is what sends.
            _ = states.changed() => {}
            // Another process may work on it.
            () = tokio::time::sleep(watch::LOOK) => {}
            () = tokio::time::sleep_until(end) => return find(app, id).await,
            () = app.stopping() => return Ok(job),
        }
    }
}
