//! Jobs: the table is the queue.
//!
//! A claim is a lease: it has a unique owner and an end, which the claimant's heartbeats extend. Every write of a claimant is
//! fenced: it applies only to the running job with that owner and attempt, and reports whether it did. A claimant whose job
//! was cancelled or taken over therefore cannot change anything.

use std::collections::HashMap;

use super::answer::Answer;
use super::engine::to_sql;
use super::engine::{Link, Query, Row, Transaction, sql};
use super::error::StoreError;
use super::files::MAX_FILE_BYTES;
use super::handle::Store;
use super::outputs::{self, MAX_OUTPUT_BYTES};
use super::text::{from_text, to_text};
use super::{changes, dictionaries, files, receipts};
use crate::domain::change::{ChangeKind, NewChange};
use crate::domain::dictionary::NewDictionary;
use crate::domain::job::{Job, JobFilter, JobOutput, Progress};
use crate::domain::retry::Receipt;
use serde_json::Value;

/// Upper limit on the queued jobs of a tenant; more are refused.
pub const MAX_QUEUED: u32 = 1000;
/// Maximum number of attempts at a job, not counting those that ended because the service stopped.
pub const MAX_ATTEMPTS: u32 = 5;
/// Number of finished jobs kept per tenant; older ones are removed.
pub const MAX_FINISHED: u32 = 1000;

/// The right to work on a job until the lease ends or the job is cancelled.
#[derive(Debug, Clone)]
pub struct Claim {
    /// The job at the time of the claim.
    pub job: Job,
    /// Tenant of the job.
    pub tenant: String,
    owner: String,
}

/// Result of polling the queue.
#[derive(Debug)]
pub struct Claimed {
    /// Claim on the next job, if any.
    pub claim: Option<Claim>,
    /// Ids of jobs that failed because they had used all their attempts.
    pub abandoned: Vec<String>,
}

/// How a claimed job returns to the queue.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Release {
    /// At its previous position; the attempt does not count.
    Uncounted,
    /// For another attempt, not before this time.
    RetryAt(i64),
}

/// Share of the queue that one tenant may use.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Quota {
    /// Maximum number of queued jobs, at most [`MAX_QUEUED`].
    pub jobs: u32,
    /// Maximum total of their predicted seconds.
    pub seconds: f64,
}

impl Default for Quota {
    fn default() -> Self {
        Self { jobs: MAX_QUEUED, seconds: f64::INFINITY }
    }
}

/// Condition for jobs that may be claimed at the time `$3`.
const CLAIMABLE: &str =
    "((status = 'queued' AND run_at_ms <= $3) OR (status = 'running' AND lease_until_ms < $3))";
/// Number of recently finished jobs that determine which tenants were served last.
const LATELY: i64 = 16;

impl Store {
    /// Stores a new job at the end of the queue.
    ///
    /// # Errors
    /// [`StoreError::TooManyJobs`], [`StoreError::AlreadyDone`].
    pub fn create_job<'a>(&'a self, job: &'a Job, receipt: Option<&'a Receipt>) -> Answer<'a, ()> {
        Box::pin(async move { self.create_job_within(Quota::default(), job, receipt).await })
    }

    /// Stores a new job at the end of the queue, if its tenant's quota allows it.
    ///
    /// # Errors
    /// [`StoreError::TooManyJobs`], [`StoreError::TooMuchWork`], [`StoreError::AlreadyDone`].
    pub fn create_job_within<'a>(
        &'a self,
        quota: Quota,
        job: &'a Job,
        receipt: Option<&'a Receipt>,
    ) -> Answer<'a, ()> {
        Box::pin(async move { self.create_job_with(quota, job, receipt, &[]).await })
    }

    /// As [`Store::create_job_within`], with files by their names, which are kept until the job ends.
    ///
    /// # Errors
    /// Also [`StoreError::TooManyBytes`].
    pub fn create_job_with<'a>(
        &'a self,
        quota: Quota,
        job: &'a Job,
        receipt: Option<&'a Receipt>,
        job_files: &'a [(&'a str, &'a [u8])],
    ) -> Answer<'a, ()> {
        Box::pin(async move {
            const CREATE: &str = "INSERT INTO job
                (id, kind, parameters, status, progress, attempt, run_at_ms, created_at_ms, tenant, cohort)
                SELECT $1, $2, $3, 'queued', 0, 0, $4, $4, $6, $7
                WHERE (SELECT count(*) FROM job WHERE status = 'queued' AND tenant = $6) < $5";
            let limit = quota.jobs.min(MAX_QUEUED);
            let cohort = job.cohort();
            let mut write = self.begin_write(self.tenant()).await?;
            receipts::keep(&mut write, self.tenant(), receipt, job.created_at_ms).await?;
            let waiting = queued_seconds(&mut write, self.tenant()).await?;
            if waiting + job.predicted_seconds() > quota.seconds {
                return Err(StoreError::TooMuchWork { waiting, limit: quota.seconds });
            }
            let created = sql(&mut write, CREATE)
                .bind(&job.id)
                .bind(to_text(&job.kind))
                .bind(job.parameters.to_string())
                .bind(job.created_at_ms)
                .bind(i64::from(limit))
                .bind(self.tenant())
                .bind(cohort)
                .execute()
                .await?;
            if created == 0 {
                return Err(StoreError::TooManyJobs { limit });
            }
            if !job_files.is_empty() {
                files::insert(&mut write, self.tenant(), &job.id, job_files, MAX_FILE_BYTES).await?;
            }
            let change = NewChange::for_job(ChangeKind::JobQueued, &job.id, cohort);
            changes::record(&mut write, self.tenant(), &change, job.created_at_ms).await?;
            Ok(write.commit().await?)
        })
    }

    /// Finds the job with this id.
    ///
    /// # Errors
    /// Database errors.
    pub fn find_job<'a>(&'a self, id: &'a str) -> Answer<'a, Option<Job>> {
        Box::pin(async move {
            let row = self.select_job(self.reader(), id).optional().await?;
            row.as_ref().map(read_job).transpose()
        })
    }

    /// Selects the job with this id, if the caller may see it.
    fn select_job<'c>(&self, link: impl Into<Link<'c>>, id: &str) -> Query<'c> {
        let mut query = sql(link, "SELECT * FROM job WHERE id = ");
        query.push_bind(id).push(" AND tenant = ").push_bind(self.tenant());
        self.push_scope(&mut query, "cohort");
        query
    }

    /// At most `limit` jobs without their results, the newest first, starting before the id `before`.
    ///
    /// # Errors
    /// Database errors.
    pub fn list_jobs<'a>(
        &'a self,
        filter: &'a JobFilter,
        before: Option<&'a str>,
        limit: usize,
    ) -> Answer<'a, Vec<Job>> {
        Box::pin(async move {
            // Results take up to megabytes each.
            const LIST: &str =
                "SELECT id, kind, parameters, status, progress, phase, objective, attempt, created_at_ms,
                started_at_ms, finished_at_ms, NULL AS result, problem FROM job WHERE tenant = ";
            let mut query = sql(self.reader(), LIST);
            query.push_bind(self.tenant());
            if let Some(before) = before {
                query.push(" AND id < ").push_bind(before);
            }
            self.push_scope(&mut query, "cohort");
            if let Some(status) = filter.status {
                query.push(" AND status = ").push_bind(status.as_str());
            }
            if let Some(kind) = filter.kind {
                query.push(" AND kind = ").push_bind(kind.as_str());
            }
            if let Some(cohort) = &filter.cohort {
                query.push(" AND cohort = ").push_bind(cohort.as_str());
            }
            if let Some(since) = filter.since_ms {
                query.push(" AND created_at_ms >= ").push_bind(since);
            }
            query.push(" ORDER BY id DESC LIMIT ").push_bind(to_sql(limit as u64));
            query.all().await?.iter().map(read_job).collect()
        })
    }

    /// Claims the next job until `lease_until_ms`: a queued one, or one whose lease has expired. Tenants take turns: first
    /// those with the fewest running jobs, then those served least recently. Among the jobs of a tenant the highest priority
    /// comes first, then the longest waiting. Jobs that are predicted to take more than `longest` seconds stay in the queue.
    ///
    /// Jobs that were interrupted in their last attempt fail with the problem document `abandoned`.
    ///
    /// # Errors
    /// Database errors.
    pub fn claim_job<'a>(
        &'a self,
        now_ms: i64,
        lease_until_ms: i64,
        longest: f64,
        abandoned: &'a Value,
    ) -> Answer<'a, Claimed> {
        Box::pin(async move {
            // Concurrent claimants skip locked rows and take the next one.
            const SKIP: &str = " FOR UPDATE SKIP LOCKED";
            const CLAIM: &str = "UPDATE job SET status = 'running', lease_owner = $1, lease_until_ms = $2,
                attempt = attempt + 1, started_at_ms = $3, progress = 0, phase = NULL, objective = NULL
                WHERE id = (SELECT id FROM job WHERE tenant = $4 AND ";
            let owner = self.inner.replica.owned_id();
            let mut transaction = self.begin_write("job").await?;
            let abandoned = abandon(&mut transaction, now_ms, abandoned).await?;
            let skip = if transaction.is_postgres() { SKIP } else { "" };
            let priority = number_in_parameters(&transaction, "priority");
            let seconds = number_in_parameters(&transaction, "predicted_seconds");
            let mut claim = None;
            for tenant in in_turn(&mut transaction, now_ms).await? {
                let mut query =
                    sql(&mut transaction, CLAIM).bind(&owner).bind(lease_until_ms).bind(now_ms).bind(&tenant);
                query.push(CLAIMABLE);
                if longest.is_finite() {
                    query.push(" AND ").push(seconds).push(" <= ").push_bind(longest);
                }
                query.push(" ORDER BY ").push(priority).push(" DESC, run_at_ms, id LIMIT 1");
                query.push(skip).push(") RETURNING *");
                // Other claimants may have taken all jobs of this tenant; those left may take too long.
                let Some(row) = query.optional().await? else { continue };
                claim = Some(Claim { job: read_job(&row)?, tenant, owner });
                break;
            }
            transaction.commit().await?;
            Ok(Claimed { claim, abandoned })
        })
    }

    /// Extends the lease and writes the progress; returns whether the claim still holds.
    ///
    /// # Errors
    /// Database errors.
    pub fn renew_job<'a>(
        &'a self,
        claim: &'a Claim,
        progress: &'a Progress,
        lease_until_ms: i64,
    ) -> Answer<'a, bool> {
        Box::pin(async move {
            const RENEW: &str =
                "UPDATE job SET lease_until_ms = $4, progress = $5, phase = $6, objective = $7
                WHERE id = $1 AND status = 'running' AND lease_owner = $2 AND attempt = $3";
            let renewed = fenced(self.writer(), RENEW, claim)
                .bind(lease_until_ms)
                .bind(progress.fraction)
                .bind(progress.phase)
                .bind(progress.objective)
                .execute()
                .await?;
            Ok(renewed == 1)
        })
    }

    /// Marks the job as succeeded and stores its result with it; returns whether the claim still held. If not, nothing is
    /// written.
    ///
    /// # Errors
    /// Database errors.
    pub fn succeed_job<'a>(
        &'a self,
        claim: &'a Claim,
        result: &'a Value,
        dictionary: Option<&'a NewDictionary>,
        output: Option<&'a JobOutput>,
        now_ms: i64,
    ) -> Answer<'a, bool> {
        Box::pin(async move {
            let mut transaction = self.begin_write(&claim.job.id).await?;
            let applied = finish_succeeded(&mut transaction, claim, result, now_ms).await?;
            if let Some(output) = output.filter(|_| applied) {
                outputs::insert(&mut transaction, &claim.job.id, output, MAX_OUTPUT_BYTES).await?;
            }
            if let Some(dictionary) = dictionary.filter(|_| applied) {
                dictionaries::insert(&mut transaction, &claim.tenant, dictionary, now_ms).await?;
            }
            if applied {
                let change = NewChange::for_job(ChangeKind::JobSucceeded, &claim.job.id, claim.job.cohort());
                changes::record(&mut transaction, &claim.tenant, &change, now_ms).await?;
            }
            transaction.commit().await?;
            Ok(applied)
        })
    }

    /// Marks the job as failed with a problem document; returns whether the claim still held.
    ///
    /// # Errors
    /// Database errors.
    pub fn fail_job<'a>(&'a self, claim: &'a Claim, problem: &'a Value, now_ms: i64) -> Answer<'a, bool> {
        Box::pin(async move {
            const FAIL: &str = "UPDATE job SET status = 'failed', finished_at_ms = $4, problem = $5,
                lease_owner = NULL, lease_until_ms = NULL
                WHERE id = $1 AND status = 'running' AND lease_owner = $2 AND attempt = $3";
            let mut transaction = self.begin_write(&claim.job.id).await?;
            let query = fenced(&mut transaction, FAIL, claim).bind(now_ms).bind(problem.to_string());
            let failed = query.execute().await?;
            prune(&mut transaction, &claim.tenant).await?;
            if failed == 1 {
                outputs::forget_parts(&mut transaction, &claim.job.id).await?;
                let change = NewChange::for_job(ChangeKind::JobFailed, &claim.job.id, claim.job.cohort());
                changes::record(&mut transaction, &claim.tenant, &change, now_ms).await?;
            }
            transaction.commit().await?;
            Ok(failed == 1)
        })
    }

    /// Returns the job to the queue; returns whether the claim still held.
    ///
    /// # Errors
    /// Database errors.
    pub fn release_job<'a>(&'a self, claim: &'a Claim, release: Release) -> Answer<'a, bool> {
        Box::pin(async move {
            const RELEASE: &str =
                "UPDATE job SET status = 'queued', lease_owner = NULL, lease_until_ms = NULL,
                attempt = attempt - $4, run_at_ms = coalesce($5, run_at_ms),
                started_at_ms = NULL, progress = 0, phase = NULL, objective = NULL
                WHERE id = $1 AND status = 'running' AND lease_owner = $2 AND attempt = $3";
            let (uncounted, run_at_ms) = match release {
                Release::Uncounted => (1_i64, None),
                Release::RetryAt(time) => (0, Some(time)),
            };
            let query = fenced(self.writer(), RELEASE, claim).bind(uncounted).bind(run_at_ms);
            Ok(query.execute().await? == 1)
        })
    }

    /// Cancels the job unless it is finished; returns its resulting state, or `None` if there is no such job.
    ///
    /// # Errors
    /// Database errors.
    pub fn cancel_job<'a>(&'a self, id: &'a str, now_ms: i64) -> Answer<'a, Option<Job>> {
        Box::pin(async move {
            const CANCEL: &str = "UPDATE job SET status = 'cancelled', finished_at_ms = $2,
                lease_owner = NULL, lease_until_ms = NULL
                WHERE id = $1 AND status IN ('queued', 'running')";
            let mut transaction = self.begin_write(id).await?;
            if self.select_job(&mut transaction, id).optional().await?.is_none() {
                return Ok(None);
            }
            let cancelled = sql(&mut transaction, CANCEL).bind(id).bind(now_ms).execute().await?;
            let row = self.select_job(&mut transaction, id).optional().await?;
            let job = row.as_ref().map(read_job).transpose()?;
            prune(&mut transaction, self.tenant()).await?;
            if let Some(job) = job.as_ref().filter(|_| cancelled == 1) {
                outputs::forget_parts(&mut transaction, id).await?;
                let change = NewChange::for_job(ChangeKind::JobCancelled, id, job.cohort());
                changes::record(&mut transaction, self.tenant(), &change, now_ms).await?;
            }
            transaction.commit().await?;
            Ok(job)
        })
    }

    /// Requeues the job of a dead owner at its previous position.
    ///
    /// The attempt counts, because the job may have caused the crash.
    pub(super) async fn requeue_job_of(&self, owner: &str) -> Result<(), StoreError> {
        const REQUEUE: &str = "UPDATE job SET status = 'queued', lease_owner = NULL, lease_until_ms = NULL,
            started_at_ms = NULL, progress = 0, phase = NULL, objective = NULL
            WHERE status = 'running' AND lease_owner = $1";
        sql(self.writer(), REQUEUE).bind(owner).execute().await?;
        Ok(())
    }

    /// Requeues running jobs at their previous positions; used only at start, when no worker can be active.
    ///
    /// The attempt counts, because the job may have caused the crash.
    pub(super) async fn requeue_interrupted_jobs(&self) -> Result<(), StoreError> {
        const REQUEUE: &str = "UPDATE job SET status = 'queued', lease_owner = NULL, lease_until_ms = NULL,
            started_at_ms = NULL, progress = 0, phase = NULL, objective = NULL WHERE status = 'running'";
        sql(self.writer(), REQUEUE).execute().await?;
        Ok(())
    }
}

/// Marks the job as succeeded within a transaction; returns whether the claim still held. If not, the caller rolls back
/// its writes for the job.
///
/// # Errors
/// Database errors.
pub(super) async fn finish_succeeded(
    connection: &mut Transaction,
    claim: &Claim,
    result: &Value,
    now_ms: i64,
) -> Result<bool, StoreError> {
    const SUCCEED: &str =
        "UPDATE job SET status = 'succeeded', finished_at_ms = $4, result = $5, progress = 1,
        lease_owner = NULL, lease_until_ms = NULL
        WHERE id = $1 AND status = 'running' AND lease_owner = $2 AND attempt = $3";
    let query = fenced(&mut *connection, SUCCEED, claim).bind(now_ms).bind(result.to_string());
    let done = query.execute().await?;
    prune(connection, &claim.tenant).await?;
    Ok(done == 1)
}

/// A claimant's statement, with the identification of its claim as the first three arguments.
fn fenced<'c>(link: impl Into<Link<'c>>, statement: &'static str, claim: &Claim) -> Query<'c> {
    sql(link, statement).bind(&claim.job.id).bind(&claim.owner).bind(i64::from(claim.job.attempt))
}

/// SQL for a number in the parameters of a job, 0 if absent.
fn number_in_parameters(transaction: &Transaction, name: &'static str) -> &'static str {
    match (name, transaction.is_postgres()) {
        ("priority", true) => "coalesce((parameters::json ->> 'priority')::float8, 0)",
        ("priority", false) => "coalesce(parameters ->> '$.priority', 0)",
        (_, true) => "coalesce((parameters::json ->> 'predicted_seconds')::float8, 0)",
        (_, false) => "coalesce(parameters ->> '$.predicted_seconds', 0)",
    }
}

/// Total predicted seconds of the queued jobs of a tenant.
async fn queued_seconds(transaction: &mut Transaction, tenant: &str) -> Result<f64, StoreError> {
    let seconds = number_in_parameters(transaction, "predicted_seconds");
    let mut query = sql(&mut *transaction, "SELECT coalesce(sum(0.0 + ");
    query
        .push(seconds)
        .push("), 0.0) AS seconds FROM job WHERE status = 'queued' AND tenant = ")
        .push_bind(tenant);
    let row = query.optional().await?;
    Ok(row.map(|row| row.get("seconds")).transpose()?.unwrap_or(0.0))
}

/// Tenants with claimable jobs, in the order of their turns.
async fn in_turn(transaction: &mut Transaction, now_ms: i64) -> Result<Vec<String>, StoreError> {
    const RUNNING: &str = "SELECT tenant, count(*) AS jobs FROM job
        WHERE status = 'running' AND lease_until_ms >= $1 GROUP BY tenant";
    const SERVED: &str =
        "SELECT tenant FROM job WHERE finished_at_ms IS NOT NULL AND started_at_ms IS NOT NULL
        ORDER BY finished_at_ms DESC, id DESC LIMIT $1";
    const WAITING: &str = "SELECT tenant, min(run_at_ms) AS since FROM job
        WHERE (status = 'queued' AND run_at_ms <= $1) OR (status = 'running' AND lease_until_ms < $1)
        GROUP BY tenant";
    let mut waiting = Vec::new();
    for row in sql(&mut *transaction, WAITING).bind(now_ms).all().await? {
        waiting.push((row.get::<&str>("tenant")?.to_owned(), row.get::<i64>("since")?));
    }
    if waiting.len() > 1 {
        let (mut running, mut served) = (HashMap::new(), Vec::new());
        for row in sql(&mut *transaction, RUNNING).bind(now_ms).all().await? {
            running.insert(row.get::<&str>("tenant")?.to_owned(), row.get::<i64>("jobs")?);
        }
        for row in sql(&mut *transaction, SERVED).bind(LATELY).all().await? {
            served.push(row.get::<&str>("tenant")?.to_owned());
        }
        waiting.sort_by_key(|(tenant, since)| {
            let lately =
                served.iter().position(|served| served == tenant).map_or(0, |place| served.len() - place);
            (running.get(tenant).copied().unwrap_or(0), lately, *since)
        });
    }
    Ok(waiting.into_iter().map(|(tenant, _)| tenant).collect())
}

/// Fails the jobs that used all their attempts without an outcome; returns their ids.
async fn abandon(
    connection: &mut Transaction,
    now_ms: i64,
    problem: &Value,
) -> Result<Vec<String>, StoreError> {
    const ABANDON: &str = "UPDATE job SET status = 'failed', finished_at_ms = $1, problem = $2,
        lease_owner = NULL, lease_until_ms = NULL
        WHERE attempt >= $3 AND (status = 'queued' OR (status = 'running' AND lease_until_ms < $1))
        RETURNING id, tenant, cohort";
    let rows = sql(&mut *connection, ABANDON)
        .bind(now_ms)
        .bind(problem.to_string())
        .bind(i64::from(MAX_ATTEMPTS))
        .all()
        .await?;
    let mut failed: Vec<(&str, &str, Option<&str>)> = Vec::with_capacity(rows.len());
    for row in &rows {
        failed.push((row.get("tenant")?, row.get("id")?, row.get("cohort")?));
    }
    // The numbers of each tenant are drawn under a lock: everybody takes the locks in the same order.
    failed.sort_unstable();
    for &(tenant, ..) in &failed {
        prune(connection, tenant).await?;
    }
    for &(tenant, id, cohort) in &failed {
        changes::record(connection, tenant, &NewChange::for_job(ChangeKind::JobFailed, id, cohort), now_ms)
            .await?;
    }
    Ok(failed.into_iter().map(|(_, id, _)| id.to_owned()).collect())
}

/// Removes the oldest finished jobs beyond the limit, and files of finished ones.
async fn prune(connection: &mut Transaction, tenant: &str) -> Result<(), StoreError> {
    const PRUNE: &str = "DELETE FROM job WHERE id IN (SELECT id FROM job WHERE finished_at_ms IS NOT NULL
        AND tenant = $1 ORDER BY finished_at_ms DESC, id DESC LIMIT $2 OFFSET $3)";
    let query = sql(&mut *connection, PRUNE).bind(tenant).bind(i64::MAX).bind(i64::from(MAX_FINISHED));
    query.execute().await?;
    files::forget(connection).await
}

pub(super) fn read_job(row: &Row) -> Result<Job, StoreError> {
    Ok(Job {
        id: row.get("id")?,
        kind: from_text(row.get("kind")?)?,
        parameters: read_json(row.get("parameters")?)?,
        status: from_text(row.get("status")?)?,
        progress: row.get("progress")?,
        phase: row.get("phase")?,
        objective: row.get("objective")?,
        attempt: u32::try_from(row.get::<i64>("attempt")?).unwrap_or(u32::MAX),
        created_at_ms: row.get("created_at_ms")?,
        started_at_ms: row.get("started_at_ms")?,
        finished_at_ms: row.get("finished_at_ms")?,
        result: row.get::<Option<&str>>("result")?.map(read_json).transpose()?,
        problem: row.get::<Option<&str>>("problem")?.map(read_json).transpose()?,
    })
}

fn read_json(text: &str) -> Result<Value, StoreError> {
    serde_json::from_str(text)
        .map_err(|e| StoreError::Damaged { detail: format!("unreadable JSON of a job: {e}") })
}
