//! Passes over a stored cohort that are distributed to the workers of all replicas.
//!
//! The learning job divides a pass into parts of [`PART`] shapes, computes them one after the other, and merges their
//! results in the order of the parts. At the same time, every idle worker of every process on the same database takes
//! parts too. The result of a part does not depend on the worker, so that the bits are those of a single process. If a
//! worker dies, its part is computed again.

use std::sync::LazyLock;
use std::time::Duration;

use serde::{Deserialize, Serialize};
use tokio::runtime::Handle;

use super::plan::{Plan, program};
use crate::analysis::accumulate::{MergePart, PART};
use crate::analysis::dictionary::in_use::Dictionary;
use crate::domain::job::Job;
use crate::numeric::fingerprint::fingerprint;
use crate::service::app::progress::JobContext;
use crate::service::app::{App, ServiceError, now_ms};
use crate::service::cohorts::source::{Distribute, MakePart, StoredShapes, Work};
use crate::service::statistics::Setup;
use crate::store::{PartClaim, PartEnd, PassOf};

/// Below this many parts, distributing the work costs more than it saves.
const MIN_PARTS: usize = 3;

/// Maximum number of coordinates of a shape: the result of a part can contain their square, here 64 MiB.
const MAX_NUMBERS: usize = 2896;

/// Duration of a lease without heartbeat, in milliseconds.
const LEASE_MS: i64 = 30_000;

/// Polling interval for results when no other work is left.
const WAIT: Duration = Duration::from_millis(20);

/// Complete description of a pass for other processes, which otherwise read only the stored shapes of that revision.
#[derive(Debug, Serialize, Deserialize)]
struct Description {
    plan: Plan,
    /// Shapes added up to this revision are excluded.
    since: u64,
    /// Number of shapes.
    shapes: usize,
    work: Work,
}

/// The job whose passes are distributed.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Spreading<'a> {
    pub(crate) app: &'a App,
    pub(crate) handle: &'a Handle,
    pub(crate) job: &'a Job,
    pub(crate) plan: &'a Plan,
}

impl Distribute for Spreading<'_> {
    fn run(
        &self,
        shapes: &StoredShapes<'_>,
        work: &dyn Fn() -> Work,
        make: &MakePart<'_>,
        merge: &mut MergePart<'_>,
    ) -> Result<bool, ServiceError> {
        let Self { app, handle, job, plan } = *self;
        let parts = shapes.len().div_ceil(PART);
        if parts < MIN_PARTS || !app.store.is_shared() || shapes.width() > MAX_NUMBERS {
            return Ok(false);
        }
        let since = shapes.revisions().after;
        let description = Description { plan: plan.clone(), since, shapes: shapes.len(), work: work() };
        let description = serde_json::to_string(&description)
            .map_err(|error| ServiceError::Internal(format!("a pass is not JSON: {error}")))?;
        let starts = app.store.part_starts(&plan.cohort, shapes.revisions(), &plan.filter, PART);
        let starts = handle.block_on(starts)?;
        if starts.len() != parts {
            return Err(ServiceError::Internal(
                "the parts of a pass are not as many as its shapes make".into(),
            ));
        }
        let begin = app.store.begin_pass((&job.id, job.attempt), arithmetic(), &description, &starts);
        let pass = handle.block_on(begin)?.ok_or(ServiceError::Cancelled)?;
        let own = OwnPass { app, handle, shapes, pass, parts }.make(make, merge);
        if let Err(error) = handle.block_on(app.store.end_pass(pass)) {
            tracing::warn!(job = job.id, %error, "a pass could not be removed; it goes when the job ends");
        }
        tracing::info!(job = job.id, parts, own = own?, "a pass was made in parts");
        Ok(true)
    }
}

/// Identifies the arithmetic: processes with the same value compute the same bits.
fn arithmetic() -> &'static str {
    static ARITHMETIC: LazyLock<String> = LazyLock::new(|| format!("{} {}", program(), fingerprint()));
    &ARITHMETIC
}

/// A pass as seen by its owner.
struct OwnPass<'a> {
    app: &'a App,
    handle: &'a Handle,
    shapes: &'a StoredShapes<'a>,
    pass: i64,
    parts: usize,
}

impl OwnPass<'_> {
    /// Computes the parts that no other worker takes, and merges all; returns the number of parts computed here.
    fn make(&self, make: &MakePart<'_>, merge: &mut MergePart<'_>) -> Result<usize, ServiceError> {
        let Self { app, handle, pass, .. } = *self;
        let (mut next, mut own) = (0, 0);
        // The failed part with the lowest position determines the error, not the one that fails first.
        let mut failed: Option<(usize, ServiceError)> = None;
        while next < self.parts {
            self.shapes.check()?;
            match failed {
                Some((part, error)) if part == next => return Err(error),
                other => failed = other,
            }
            if let Some(result) = handle.block_on(app.store.read_part(pass, next))? {
                merge(&result)?;
                next += 1;
                continue;
            }
            let end = failed.as_ref().map_or(self.parts, |(part, _)| *part);
            let Some(claim) = handle.block_on(app.store.claim_own_part(pass, end, now_ms()))? else {
                std::thread::sleep(WAIT);
                continue;
            };
            let result = match make(&self.shapes.part(claim.part, claim.start)) {
                Ok(result) => result,
                Err(ServiceError::Cancelled) => return Err(ServiceError::Cancelled),
                Err(error) => {
                    failed = Some((claim.part, error));
                    continue;
                }
            };
            own += 1;
            let end = if claim.part == next {
                merge(&result)?;
                next += 1;
                PartEnd::Done(None)
            } else {
                PartEnd::Done(Some(&result))
            };
            handle.block_on(app.store.settle_part(&claim, end))?;
        }
        Ok(own)
    }
}

/// A part of another job's pass, claimed by this process.
#[derive(Debug, Clone)]
pub struct Help {
    claim: PartClaim,
    of: PassOf,
    context: JobContext,
}

/// Claims the next open part, if there is one.
///
/// # Errors
/// A failure of the store.
pub async fn claim(app: &App) -> Result<Option<Help>, ServiceError> {
    if !app.store.is_shared() {
        return Ok(None);
    }
    let now = now_ms();
    let found = app.store.claim_any_part(now, now + LEASE_MS, arithmetic()).await?;
    Ok(found.map(|(claim, of)| Help { claim, of, context: JobContext::default() }))
}

impl Help {
    /// Id of the job.
    pub fn job(&self) -> &str {
        &self.of.job
    }

    /// Tenant of the job.
    pub fn tenant(&self) -> &str {
        &self.of.tenant
    }

    /// Context that tells the work to stop.
    pub fn context(&self) -> &JobContext {
        &self.context
    }

    /// Sends a heartbeat; the work is asked to stop if its result is no longer needed.
    ///
    /// # Errors
    /// A failure of the store; the claim may still hold.
    pub async fn renew(&self, app: &App) -> Result<(), ServiceError> {
        if !app.store.renew_part(&self.claim, now_ms() + LEASE_MS).await? {
            self.context.interrupt();
        }
        Ok(())
    }

    /// Computes the part on a compute thread.
    ///
    /// # Errors
    /// The reason why it cannot be computed; [`ServiceError::Cancelled`].
    pub fn run(&self, app: &App, handle: &Handle) -> Result<Vec<u8>, ServiceError> {
        let Description { plan, since, shapes, work } = serde_json::from_str(&self.of.description)
            .map_err(|error| ServiceError::Internal(format!("the description of a pass: {error}")))?;
        let cohort = plan.cohort(app, handle)?;
        let setup = Setup::of(app, plan.settings(&cohort))?;
        let stop = || self.context.is_cancelled();
        let shapes = StoredShapes::counted(app, handle, &cohort, &plan.filter, since, &setup, &stop, shapes);
        let part = shapes.part(self.claim.part, self.claim.start);
        match work {
            Work::Sum(pass) => Ok(pass.make(&part, setup.measured())?),
            Work::Codes(content) => {
                let dictionary = Dictionary::new(*content, setup.measured())?;
                Ok(dictionary.coded(&part, &self.context)?.to_bytes())
            }
        }
    }

    /// Delivers the result. Interrupted parts return to the queue. Failed parts are retried by the owner of the pass,
    /// which reports the error if it is reproducible.
    pub async fn settle(self, app: &App, outcome: Result<Vec<u8>, ServiceError>) {
        let (job, part) = (&self.of.job, self.claim.part);
        let end = match &outcome {
            Ok(result) => PartEnd::Done(Some(result)),
            Err(ServiceError::Cancelled) => PartEnd::Open,
            Err(error) => {
                tracing::warn!(job, part, error = error.cause(), "a part of a pass cannot be made here");
                PartEnd::Refused
            }
        };
        match app.store.settle_part(&self.claim, end).await {
            Ok(true) if outcome.is_ok() => {
                tracing::info!(job, part, "a part of a pass was made for its owner")
            }
            Ok(_) => {}
            // The lease expires, and another worker computes the part.
            Err(error) => tracing::warn!(job, part, %error, "a part of a pass could not be handed over"),
        }
    }
}
