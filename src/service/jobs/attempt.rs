//! Attempt at a job: claimed from the queue, kept alive by heartbeats, and settled.
//!
//! A worker owns a job for the duration of a lease, which heartbeats extend. After a temporary error the job is tried
//! again, up to a maximum number of attempts; all other errors are final.

use std::time::Duration;

use serde_json::Value;
use tokio::time::Instant;

use super::Outcome;
use crate::domain::job::{Job, Progress};
use crate::service::app::problem::{Problem, ProblemKind};
use crate::service::app::progress::JobContext;
use crate::service::app::{App, ServiceError, metrics, now_ms};
use crate::store::jobs::MAX_ATTEMPTS;
use crate::store::{Claim, Release, StoreError};

/// Duration of a lease without heartbeat, in milliseconds.
const LEASE_MS: i64 = 30_000;
/// Maximum time between two heartbeats.
const SIGN_OF_LIFE: Duration = Duration::from_secs(10);
/// Number of attempts to write an outcome; after that the lease expires, and the job runs again.
const WRITES: u32 = 4;

/// An attempt at a job. If it is dropped without being settled, its work is asked to stop, and the job runs again when
/// the lease expires.
#[derive(Debug)]
pub struct Attempt {
    claim: Claim,
    context: JobContext,
    /// Progress written last; `None` until the first heartbeat, which is sent at once, because a job cancelled between
    /// its claim and its context has no other way to learn of it.
    written: Option<Progress>,
    renewed: Instant,
    begun: Instant,
}

/// End of an attempt.
#[derive(Debug)]
enum End {
    Succeeded(Outcome),
    Failed(Value),
    Released(Release),
}

/// Claims the next job of the queue that is predicted to take at most `longest` seconds, if one is due.
///
/// # Errors
/// A failure of the store.
pub async fn claim(app: &App, longest: f64) -> Result<Option<Attempt>, ServiceError> {
    let now = now_ms();
    let claimed = app.store.claim_job(now, now + LEASE_MS, longest, &abandoned()).await?;
    metrics::jobs_abandoned(claimed.abandoned.len());
    for id in &claimed.abandoned {
        tracing::warn!(job = id, "a job was interrupted at every attempt and is given up");
        app.registry().announce(id);
    }
    let Some(claim) = claimed.claim else { return Ok(None) };
    let context = app.registry().begin(&claim.job.id);
    app.registry().announce(&claim.job.id);
    // There may be more jobs: let another worker look.
    app.registry().wake();
    let begun = Instant::now();
    Ok(Some(Attempt { claim, context, written: None, renewed: begun, begun }))
}

/// Stored problem of jobs that were interrupted at every attempt.
fn abandoned() -> Value {
    let detail = format!(
        "the service stopped {MAX_ATTEMPTS} times while it worked on the job, which is not retried: a common \
         cause is too little memory"
    );
    Problem::new(ProblemKind::Internal, detail).to_stored()
}

/// Waits until the queue may have work for a slot of short jobs or of any: a job was submitted, or more slots could take jobs.
pub async fn submitted(app: &App, short: bool) {
    app.registry().woken(short).await;
}

impl Attempt {
    /// The job.
    pub fn job(&self) -> &Job {
        &self.claim.job
    }

    /// Tenant of the job.
    pub fn tenant(&self) -> &str {
        &self.claim.tenant
    }

    /// Context through which the work reports progress and learns of cancellation.
    pub fn context(&self) -> &JobContext {
        &self.context
    }

    /// Writes progress and a heartbeat if needed; the write rate is bounded by that of the calls, about once a second.
    ///
    /// The work is asked to stop if the claim is lost.
    ///
    /// # Errors
    /// A failure of the store; the claim may still hold.
    pub async fn renew(&mut self, app: &App) -> Result<(), ServiceError> {
        let progress = self.context.progress();
        if self.written == Some(progress) && self.renewed.elapsed() < SIGN_OF_LIFE {
            return Ok(());
        }
        if !app.store.renew_job(&self.claim, &progress, now_ms() + LEASE_MS).await? {
            self.lost();
            self.context.interrupt();
        }
        (self.written, self.renewed) = (Some(progress), Instant::now());
        Ok(())
    }

    /// Counts a lost claim, unless the work was asked to stop by this process, in which case the reason is known.
    fn lost(&self) {
        if !self.context.is_cancelled() {
            metrics::claim_lost();
        }
    }

    /// Writes the outcome, unless the job was cancelled or taken over in the meantime. A `stopping` service returns
    /// interrupted jobs to the queue.
    pub async fn settle(self, app: &App, outcome: Result<Outcome, ServiceError>, stopping: bool) {
        let mut end = self.end(outcome, stopping);
        for write in 0..WRITES {
            let error = match self.write(app, &end).await {
                Ok(applied) => return self.settled(app, &end, applied),
                Err(error) => ServiceError::from(error),
            };
            tracing::warn!(
                job = self.claim.job.id,
                error = error.cause(),
                "the outcome of a job could not be written"
            );
            // An outcome that is refused for a permanent reason would be refused again.
            if matches!(end, End::Succeeded(_)) && !is_passing(&error) {
                end = self.failed(error);
            }
            tokio::time::sleep(Duration::from_secs(1 << write)).await;
        }
    }

    fn end(&self, outcome: Result<Outcome, ServiceError>, stopping: bool) -> End {
        let attempt = self.claim.job.attempt;
        match outcome {
            Ok(outcome) => End::Succeeded(outcome),
            Err(ServiceError::Cancelled) if stopping => End::Released(Release::Uncounted),
            Err(error) if is_passing(&error) && attempt < MAX_ATTEMPTS => {
                tracing::warn!(
                    job = self.claim.job.id,
                    attempt,
                    error = error.cause(),
                    "a job will be tried again"
                );
                End::Released(Release::RetryAt(now_ms() + back_off_ms(attempt)))
            }
            Err(error) => self.failed(error),
        }
    }

    fn failed(&self, error: ServiceError) -> End {
        End::Failed(Problem::from_job(error, &self.claim.job.id).to_stored())
    }

    async fn write(&self, app: &App, end: &End) -> Result<bool, StoreError> {
        match end {
            End::Succeeded(Outcome { result, dictionary, output }) => {
                let (dictionary, output) = (dictionary.as_deref(), output.as_deref());
                app.store.succeed_job(&self.claim, result, dictionary, output, now_ms()).await
            }
            End::Failed(problem) => app.store.fail_job(&self.claim, problem, now_ms()).await,
            End::Released(release) => app.store.release_job(&self.claim, *release).await,
        }
    }

    fn settled(&self, app: &App, end: &End, applied: bool) {
        let (job, attempt) = (&self.claim.job.id, self.claim.job.attempt);
        let end = match end {
            _ if !applied => {
                self.lost();
                "dropped"
            }
            End::Succeeded(_) => "succeeded",
            End::Failed(_) => "failed",
            End::Released(_) => "released",
        };
        metrics::attempt_ended(self.claim.job.kind, end, self.begun.elapsed());
        tracing::info!(job, attempt, end, "an attempt at a job has ended");
        app.registry().announce(job);
    }
}

impl Drop for Attempt {
    /// Stops the work, because its outcome can no longer be reported.
    fn drop(&mut self) {
        self.context.interrupt();
    }
}

/// Whether the error is a temporary one of the infrastructure.
fn is_passing(error: &ServiceError) -> bool {
    matches!(error, ServiceError::Unavailable(_) | ServiceError::NoSpace(_))
}

/// Delay before the attempt that follows `attempt`: none at first, then one second, doubled every time.
fn back_off_ms(attempt: u32) -> i64 {
    match attempt {
        0 | 1 => 0,
        _ => 1000 << (attempt - 2).min(16),
    }
}

#[cfg(test)]
mod tests {
    use super::back_off_ms;

    #[test]
    fn the_first_retry_is_at_once_and_the_others_wait_longer_every_time() {
        assert_eq!([1, 2, 3, 4, 5].map(back_off_ms), [0, 1000, 2000, 4000, 8000]);
        assert_eq!(back_off_ms(u32::MAX), 65_536_000);
    }
}
