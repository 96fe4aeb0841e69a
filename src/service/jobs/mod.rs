//! Jobs: long computations that are stored before they are answered, run in the background, and survive a restart.
//!
//! * this file — operations for clients: submit, find, list, cancel, wait;
//! * [`registry`] — volatile state of running jobs: progress, cancellation, watchers;
//! * [`attempt`] — operations for workers: claim, renew, settle;
//! * [`inline_or_job`] — answers at once if the predicted time is short, otherwise by a job;
//! * [`watch`] — successive changes of a job.

pub mod attempt;
pub mod inline_or_job;
pub mod registry;
pub mod watch;

use std::time::Duration;

use serde_json::Value;
use tokio::time::Instant;

use crate::domain::access::Role;
use crate::domain::dictionary::NewDictionary;
use crate::domain::id;
use crate::domain::job::{Job, JobFilter, JobKind, JobOutput, JobStatus, OutputParts};
use crate::domain::retry::Receipt;
use crate::service::app::memory::{Held, Purpose};
use crate::service::app::progress::Channel;
use crate::service::app::{App, Page, ServiceError, Work, metrics, now_ms};
use crate::store::jobs::Quota;

/// Outcome of an attempt.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome {
    /// Result of the job.
    pub result: Value,
    /// Learnt dictionary; stored if and only if the job succeeds.
    pub dictionary: Option<Box<NewDictionary>>,
    /// Output kept with the job while there is room.
    pub output: Option<Box<JobOutput>>,
}

/// Stores a new job with its predicted time in seconds; a worker takes it when its turn comes. A repetition of the same
/// request returns the job it created.
///
/// # Errors
/// [`ServiceError::KeyReused`]; [`ServiceError::TooCostly`] if the predicted time exceeds the maximum for a job;
/// [`ServiceError::Unavailable`] if the tenant has too many waiting jobs, or too much waiting work.
pub async fn submit(app: &App, kind: JobKind, parameters: Value, seconds: f64) -> Result<Job, ServiceError> {
    if let Some(id) = app.done_before::<String>().await? {
        return find(app, &id).await;
    }
    create(app, (kind, parameters, seconds), &[], |id| app.receipt(id)).await
}

/// As [`submit`] for a request that was not executed before, with a receipt for the id of the job. The `files` are kept until the job
/// ends.
///
/// # Errors
/// As [`submit`]; [`ServiceError::Unavailable`] also if the files of other jobs of the tenant leave no room.
pub async fn create(
    app: &App,
    (kind, parameters, seconds): (JobKind, Value, f64),
    files: &[(&str, &[u8])],
    receipt: impl FnOnce(&str) -> Option<Receipt>,
) -> Result<Job, ServiceError> {
    Work::from_seconds(seconds).check(app.limits.job_time.as_secs_f64())?;
    let job = Job::new(kind, parameters, now_ms()).weighing(seconds, app.priority);
    let job = job.submitted_by(&app.principal);
    let quota = Quota { jobs: app.limits.queued_jobs, seconds: app.limits.queued_work.as_secs_f64() };
    app.store.create_job_with(quota, &job, receipt(&job.id).as_ref(), files).await?;
    app.registry().wake();
    Ok(job)
}

/// Finds the job with this id, with its current progress.
///
/// # Errors
/// [`ServiceError::NotFound`].
pub async fn find(app: &App, id: &str) -> Result<Job, ServiceError> {
    let found = app.store.find_job(id).await?;
    found.map(|job| app.registry().up_to_date(job)).ok_or_else(|| not_found(id))
}

/// The job as it was when one of its watchers has read it less than `age` ago, with its current progress: the number of watchers costs the
/// store nothing. Each must have found the job by itself before.
async fn read(app: &App, id: &str, channel: &Channel, age: Duration) -> Result<Job, ServiceError> {
    let mut read = channel.read.lock().await;
    if let Some((at, job)) = &*read
        && at.elapsed() < age
    {
        return Ok(app.registry().up_to_date(job.clone()));
    }
    let begun = std::time::Instant::now();
    let job = find(app, id).await?;
    *read = Some((begun, job.clone()));
    Ok(job)
}

/// Output of the job with this id, with the memory that it takes while it is read and used.
///
/// # Errors
/// [`ServiceError::NotFound`] for the job, and for its output if it has none: not yet, never, or no longer; those of
/// [`Memory::hold`] before anything is read.
///
/// [`Memory::hold`]: crate::service::app::memory::Memory::hold
pub async fn output(app: &App, id: &str) -> Result<(JobOutput, Held), ServiceError> {
    let job = find(app, id).await?;
    let missing = || ServiceError::NotFound { kind: "output of the job", key: id.into() };
    let bytes = app.store.size_of_output(&job.id).await?.ok_or_else(missing)?;
    let room = app.memory.hold(Purpose::Answers, usize::try_from(bytes).unwrap_or(usize::MAX))?;
    let output = app.store.read_job_output(&job.id).await?;
    Ok((output.ok_or_else(missing)?, room))
}

/// A part of the output of the job with this id.
///
/// # Errors
/// [`ServiceError::NotFound`] if the output is no longer kept.
pub async fn output_part(
    app: &App,
    id: &str,
    parts: OutputParts,
    part: u64,
) -> Result<Vec<u8>, ServiceError> {
    let found = app.store.read_output_part(id, parts.attempt, part).await?;
    found.ok_or_else(|| ServiceError::NotFound { kind: "output of the job", key: id.into() })
}

fn not_found(id: &str) -> ServiceError {
    ServiceError::NotFound { kind: "job", key: id.into() }
}

/// Jobs without their results, the newest first, from `cursor` on (the id of the last job of the previous page).
///
/// # Errors
/// An invalid cursor.
pub async fn list(
    app: &App,
    filter: &JobFilter,
    cursor: Option<&str>,
    limit: usize,
) -> Result<Page<Job>, ServiceError> {
    if cursor.is_some_and(|cursor| !cursor.starts_with(&format!("{}_", id::JOB))) {
        return Err(ServiceError::foreign_cursor());
    }
    let mut items = app.store.list_jobs(filter, cursor, limit + 1).await?;
    let next = (items.len() > limit).then(|| items[limit - 1].id.clone());
    items.truncate(limit);
    Ok((items.into_iter().map(|job| app.registry().up_to_date(job)).collect(), next))
}

/// Cancels an unfinished job; a job that is already cancelled stays so. Readers cancel only those that they have submitted.
///
/// The job is cancelled when this function returns; its thread stops at its next [`JobContext::check`](crate::service::app::progress::JobContext::check).
///
/// # Errors
/// [`ServiceError::NotFound`]; [`ServiceError::Forbidden`] for the job of somebody else; [`ServiceError::JobFinished`] if it has
/// succeeded or failed before.
pub async fn cancel(app: &App, id: &str) -> Result<Job, ServiceError> {
    if app.principal.role < Role::Writer {
        let job = find(app, id).await?;
        if !job.status.is_finished() && !job.is_of(&app.principal) {
            let detail = "expected a job that the caller has submitted, or the role writer";
            return Err(ServiceError::Forbidden(detail.into()));
        }
    }
    let job = app.store.cancel_job(id, now_ms()).await?.ok_or_else(|| not_found(id))?;
    if job.status != JobStatus::Cancelled {
        return Err(ServiceError::JobFinished { id: job.id, status: job.status.as_str() });
    }
    metrics::job_cancelled();
    app.registry().interrupt(id);
    app.registry().announce(id);
    Ok(job)
}

/// Tells those who watch a job that it was `removed`, or returned to the queue. The attempt at a removed job is stopped; another
/// one learns from its heartbeat that it has lost the job, which may already run again.
pub(crate) fn taken_away(app: &App, id: &str, removed: bool) {
    if removed {
        app.registry().interrupt(id);
    }
    app.registry().announce(id);
    app.registry().wake();
}

/// Returns the job as soon as it is finished, after `time`, or when the service is stopping.
///
/// # Errors
/// [`ServiceError::NotFound`].
pub async fn wait(app: &App, id: &str, time: Duration) -> Result<Job, ServiceError> {
    let channel = app.registry().channel(id);
    let mut states = channel.states();
    let (end, mut age) = (Instant::now() + time, Duration::ZERO);
    loop {
        let job = read(app, id, &channel, age).await?;
        if job.status.is_finished() {
            return Ok(job);
        }
        age = tokio::select! {
            // Cannot fail: the channel held here owns the sender.
            _ = states.changed() => Duration::ZERO,
            // Another replica may be running it.
            () = tokio::time::sleep(watch::LOOK) => watch::FRESH,
            () = tokio::time::sleep_until(end) => return find(app, id).await,
            () = app.stopping() => return Ok(job),
        }
    }
}
