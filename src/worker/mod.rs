//! Worker: runs queued jobs. Each slot takes the next job, computes it on its own threads, and sends heartbeats for its
//! lease meanwhile. One slot more takes short jobs only, so that they do not wait for the end of long ones.
//!
//! Requests compute on the pool of the [`App`], jobs on the threads of their slots, so neither delays the other.

pub mod tidy;

use std::num::NonZeroUsize;
use std::sync::Arc;
use std::time::Duration;

use tokio::runtime::Handle;
use tokio::task::JoinSet;
use tokio::time::{Instant, MissedTickBehavior};
use tokio_util::sync::CancellationToken;

use crate::domain::access::Principal;
use crate::domain::job::Job;
use crate::service::app::pool::{JOB, Lane, thread_count};
use crate::service::app::progress::JobContext;
use crate::service::app::{App, ServiceError};
use crate::service::jobs::attempt::Attempt;
use crate::service::jobs::{Outcome, attempt};

/// Polling interval of the queue, for retries and expired leases; new jobs wake a slot at once.
const POLL: Duration = Duration::from_secs(1);
/// A job is stopped after this multiple of the longest duration that may be predicted: predictions of jobs are accurate to a
/// factor of three on other machines and in classes that were not measured.
const OVERRUN: u32 = 3;
/// Interval at which progress is written.
const TICK: Duration = Duration::from_secs(1);
/// Longest time for interrupted jobs to end. Those that do not are requeued at the next start.
const STOP: Duration = Duration::from_secs(5);

/// Number of job slots and compute threads.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Places {
    /// Number of jobs that run at once.
    pub jobs: NonZeroUsize,
    /// Number of compute threads, divided evenly among these jobs, at least one each; 0 means one per core.
    pub threads: usize,
    /// Longest predicted time, in seconds, of the jobs for the slot of short jobs. It has one thread. 0: there is no such slot.
    pub short_seconds: f64,
}

impl Places {
    /// Number of threads of each slot.
    fn threads_each(self) -> usize {
        (thread_count(self.threads) / self.jobs).max(1)
    }
}

/// Function that executes a job.
type Run = dyn Fn(&App, &Handle, &Job, &JobContext) -> Result<Outcome, ServiceError> + Send + Sync;

/// Takes jobs from the queue until it is stopped.
#[derive(Debug)]
pub struct Worker {
    stop: CancellationToken,
    places: JoinSet<()>,
}

impl Worker {
    /// Starts to take jobs. Each is executed by `run` on a compute thread, with a runtime handle for async calls.
    ///
    /// Must be called on an async runtime.
    pub fn start(
        app: &App,
        places: Places,
        run: impl Fn(&App, &Handle, &Job, &JobContext) -> Result<Outcome, ServiceError> + Send + Sync + 'static,
    ) -> Self {
        let (stop, run) = (CancellationToken::new(), Arc::new(run) as Arc<Run>);
        let mut tasks = JoinSet::new();
        let mut start = |threads, longest| {
            let place = Place {
                app: app.clone(),
                // One pool per slot: otherwise a thread waiting for its part of one job could start another job.
                lane: Lane::new(JOB, threads, 1),
                longest,
                run: Arc::clone(&run),
                stop: stop.clone(),
            };
            tasks.spawn(place.serve());
        };
        (0..places.jobs.get()).for_each(|_| start(places.threads_each(), f64::INFINITY));
        if places.short_seconds > 0.0 {
            start(1, places.short_seconds);
        }
        Self { stop, places: tasks }
    }

    /// Takes no more jobs, interrupts the running ones, and returns them to the queue.
    pub async fn stop(mut self) {
        self.stop.cancel();
        let ended = async { while self.places.join_next().await.is_some() {} };
        if tokio::time::timeout(STOP, ended).await.is_err() {
            tracing::warn!("a job did not stop in {} s; it runs again after the next start", STOP.as_secs());
        }
    }
}

/// Slot that runs one job at a time.
struct Place {
    app: App,
    lane: Lane,
    /// Longest predicted time of its jobs, in seconds.
    longest: f64,
    run: Arc<Run>,
    stop: CancellationToken,
}

impl Place {
    async fn serve(self) {
        while !self.stop.is_cancelled() {
            match self.turn().await {
                Ok(true) => {}
                Ok(false) => self.idle(attempt::submitted(&self.app, self.is_short())).await,
                Err(error) => {
                    tracing::warn!(error = error.cause(), "the queue of jobs cannot be read");
                    self.idle(std::future::pending()).await;
                }
            }
        }
    }

    /// Whether it takes short jobs only.
    fn is_short(&self) -> bool {
        self.longest.is_finite()
    }

    /// Runs the next job; `false` if there is none.
    async fn turn(&self) -> Result<bool, ServiceError> {
        let Some(attempt) = attempt::claim(&self.app, self.longest).await? else { return Ok(false) };
        self.work(attempt).await;
        Ok(true)
    }

    /// Waits until the queue should be polled again.
    async fn idle(&self, submitted: impl Future<Output = ()>) {
        tokio::select! {
            () = submitted => {}
            () = tokio::time::sleep(POLL) => {}
            () = self.stop.cancelled() => {}
        }
    }

    async fn work(&self, mut attempt: Attempt) {
        tracing::info!(job = attempt.job().id, attempt = attempt.job().attempt, "a job begins");
        let outcome = self.compute(&mut attempt).await;
        attempt.settle(&self.app, outcome, self.stop.is_cancelled()).await;
    }

    /// Executes the job on the pool, sending heartbeats until it has ended.
    async fn compute(&self, attempt: &mut Attempt) -> Result<Outcome, ServiceError> {
        let most = self.app.limits.job_time.saturating_mul(OVERRUN);
        let end = Instant::now() + most;
        let task = self.task(attempt);
        let mut computed = std::pin::pin!(self.lane.run(task));
        let mut ticks = tokio::time::interval(TICK);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut overran = false;
        loop {
            tokio::select! {
                outcome = &mut computed => return outcome.map_err(|error| match error {
                    ServiceError::Cancelled if overran => ServiceError::TookTooLong { seconds: most.as_secs() },
                    error => error,
                }),
                () = tokio::time::sleep_until(end), if !overran => {
                    overran = !attempt.context().is_cancelled();
                    attempt.context().interrupt();
                }
                () = self.stop.cancelled(), if !attempt.context().is_cancelled() => attempt.context().interrupt(),
                _ = ticks.tick() => {
                    if let Err(error) = attempt.renew(&self.app).await {
                        tracing::warn!(job = attempt.job().id, error = error.cause(), "progress could not be written");
                    }
                }
            }
        }
    }

    fn task(&self, attempt: &Attempt) -> impl FnOnce() -> Result<Outcome, ServiceError> + Send + 'static {
        let principal = Arc::new(Principal::system(attempt.tenant()));
        let (app, run, handle) = (self.app.of(principal), Arc::clone(&self.run), Handle::current());
        let (job, context) = (attempt.job().clone(), attempt.context().clone());
        move || {
            // The service may have been stopped while the job was claimed.
            context.check()?;
            run(&app, &handle, &job, &context)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn threads_are_shared_out_and_everybody_has_one() {
        for (jobs, threads, each) in [(1, 8, 8), (2, 8, 4), (3, 8, 2), (4, 2, 1)] {
            let jobs = NonZeroUsize::new(jobs).unwrap();
            assert_eq!(
                Places { jobs, threads, short_seconds: 10.0 }.threads_each(),
                each,
                "{jobs} jobs on {threads} threads"
            );
        }
    }
}
