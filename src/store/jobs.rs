//! Jobs: the table is the queue.
//!
//! A claim is a lease: an owner that nobody else has, until a time that the claimant keeps moving on. Every write of
//! a claimant is fenced: it applies to the running job with that owner and attempt, and says whether it did. Who
//! was cancelled or taken over therefore changes nothing any more.

use std::collections::HashMap;

use super::engine::to_sql;
use super::engine::{Link, Query, Row, Transaction, sql};
use super::error::StoreError;
use super::handle::Store;
use super::outputs::{self, MAX_OUTPUT_BYTES};
use super::text::{from_text, to_text};
use super::{dictionaries, receipts};
use crate::domain::dictionary::NewDictionary;
use crate::domain::job::{Job, JobOutput, JobStatus, Progress};
use crate::domain::retry::Receipt;
use serde_json::Value;

/// Jobs of a tenant that may wait; more are refused.
pub const MAX_QUEUED: u32 = 1000;
/// Attempts of a job, without those that a stop of the service ended.
pub const MAX_ATTEMPTS: u32 = 5;
/// Finished jobs of a tenant that are kept, the newest.
pub const MAX_FINISHED: u32 = 1000;

/// The right to work on a job, until its lease ends or the job is cancelled.
#[derive(Debug, Clone)]
pub struct Claim {
    /// The job as it was when it was claimed.
    pub job: Job,
    /// Whose it is.
    pub tenant: String,
    owner: String,
}

/// What a look into the queue found.
#[derive(Debug)]
pub struct Claimed {
    /// The job whose turn it is.
    pub claim: Option<Claim>,
    /// Ids of jobs that were given up meanwhile, because they had all their attempts.
    pub abandoned: Vec<String>,
}

/// How a claimed job goes back into the queue.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Release {
    /// At its old place; the attempt does not count.
    Uncounted,
    /// For another attempt, not before this time.
    RetryAt(i64),
}

/// How much of the queue one tenant may take.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Quota {
    /// Jobs that wait, at most [`MAX_QUEUED`].
    pub jobs: u32,
    /// Predicted seconds of those that wait, together.
    pub seconds: f64,
}

impl Default for Quota {
    fn default() -> Self {
        Self { jobs: MAX_QUEUED, seconds: f64::INFINITY }
    }
}

/// Jobs that may be claimed at the time `$3`.
const CLAIMABLE: &str =
    "((status = 'queued' AND run_at_ms <= $3) OR (status = 'running' AND lease_until_ms < $3))";
/// Finished jobs that are looked at to know who was served lately.
const LATELY: i64 = 16;

impl Store {
    /// Stores a new job at the end of the queue.
    ///
    /// # Errors
    /// [`StoreError::TooManyJobs`], [`StoreError::AlreadyDone`].
    pub async fn create_job(&self, job: &Job, receipt: Option<&Receipt>) -> Result<(), StoreError> {
        self.create_job_within(Quota::default(), job, receipt).await
    }

    /// Stores a new job at the end of the queue, when its tenant has room for it.
    ///
    /// # Errors
    /// [`StoreError::TooManyJobs`], [`StoreError::TooMuchWork`], [`StoreError::AlreadyDone`].
    pub async fn create_job_within(
        &self,
        quota: Quota,
        job: &Job,
        receipt: Option<&Receipt>,
    ) -> Result<(), StoreError> {
        const CREATE: &str = "INSERT INTO job
            (id, kind, parameters, status, progress, attempt, run_at_ms, created_at_ms, tenant, cohort)
            SELECT $1, $2, $3, 'queued', 0, 0, $4, $4, $6, $7
            WHERE (SELECT count(*) FROM job WHERE status = 'queued' AND tenant = $6) < $5";
        let limit = quota.jobs.min(MAX_QUEUED);
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
            .bind(job.parameters.get("cohort").and_then(Value::as_str))
            .execute()
            .await?;
        if created == 0 {
            return Err(StoreError::TooManyJobs { limit });
        }
        Ok(write.commit().await?)
    }

    /// The job with this id.
    ///
    /// # Errors
    /// Those of the database.
    pub async fn find_job(&self, id: &str) -> Result<Option<Job>, StoreError> {
        let row = self.select_job(self.reader(), id).optional().await?;
        row.as_ref().map(read_job).transpose()
    }

    /// The job with this id, if the caller may see it.
    fn select_job<'c>(&self, link: impl Into<Link<'c>>, id: &str) -> Query<'c> {
        let mut query = sql(link, "SELECT * FROM job WHERE id = ");
        query.push_bind(id).push(" AND tenant = ").push_bind(self.tenant());
        self.push_scope(&mut query, "cohort");
        query
    }

    /// At most `limit` jobs in the order of their ids, from the one after the id `after`.
    ///
    /// # Errors
    /// Those of the database.
    pub async fn list_jobs(
        &self,
        status: Option<JobStatus>,
        after: Option<&str>,
        limit: usize,
    ) -> Result<Vec<Job>, StoreError> {
        let mut query = sql(self.reader(), "SELECT * FROM job WHERE tenant = ");
        query.push_bind(self.tenant()).push(" AND id > ").push_bind(after.unwrap_or_default());
        self.push_scope(&mut query, "cohort");
        if let Some(status) = status {
            query.push(" AND status = ").push_bind(status.as_str());
        }
        query.push(" ORDER BY id LIMIT ").push_bind(to_sql(limit as u64));
        query.all().await?.iter().map(read_job).collect()
    }

    /// Claims the job whose turn it is until `lease_until_ms`: one that waits, or whose lease has ended. Tenants take turns:
    /// first who has fewest jobs running, of these who was served least lately. Of the jobs of a tenant the one of highest
    /// priority comes first, of these the one that waits longest.
    ///
    /// Jobs that had all their attempts and were interrupted again fail with the problem document `abandoned`.
    ///
    /// # Errors
    /// Those of the database.
    pub async fn claim_job(
        &self,
        now_ms: i64,
        lease_until_ms: i64,
        abandoned: &Value,
    ) -> Result<Claimed, StoreError> {
        // Who claims at the same time takes the next one.
        const SKIP: &str = " FOR UPDATE SKIP LOCKED";
        const CLAIM: &str = "UPDATE job SET status = 'running', lease_owner = $1, lease_until_ms = $2,
            attempt = attempt + 1, started_at_ms = $3, progress = 0, phase = NULL, objective = NULL
            WHERE id = (SELECT id FROM job WHERE tenant = $4 AND ";
        let owner = self.inner.replica.owned_id();
        let mut transaction = self.begin_write("job").await?;
        let abandoned = abandon(&mut transaction, now_ms, abandoned).await?;
        let skip = if transaction.is_postgres() { SKIP } else { "" };
        let priority = number_in_parameters(&transaction, "priority");
        let mut claim = None;
        for tenant in in_turn(&mut transaction, now_ms).await? {
            let mut query =
                sql(&mut transaction, CLAIM).bind(&owner).bind(lease_until_ms).bind(now_ms).bind(&tenant);
            query.push(CLAIMABLE).push(" ORDER BY ").push(priority).push(" DESC, run_at_ms, id LIMIT 1");
            query.push(skip).push(") RETURNING *");
            // Others may have taken all that one of the tenants has.
            let Some(row) = query.optional().await? else { continue };
            claim = Some(Claim { job: read_job(&row)?, tenant, owner });
            break;
        }
        transaction.commit().await?;
        Ok(Claimed { claim, abandoned })
    }

    /// Moves the end of the lease and writes the progress; whether the claim still holds.
    ///
    /// # Errors
    /// Those of the database.
    pub async fn renew_job(
        &self,
        claim: &Claim,
        progress: &Progress,
        lease_until_ms: i64,
    ) -> Result<bool, StoreError> {
        const RENEW: &str = "UPDATE job SET lease_until_ms = $4, progress = $5, phase = $6, objective = $7
            WHERE id = $1 AND status = 'running' AND lease_owner = $2 AND attempt = $3";
        let renewed = fenced(self.writer(), RENEW, claim)
            .bind(lease_until_ms)
            .bind(progress.fraction)
            .bind(progress.phase)
            .bind(progress.objective)
            .execute()
            .await?;
        Ok(renewed == 1)
    }

    /// The job is done, and what it has learnt or brought about is stored with it; whether the claim still held. Otherwise
    /// nothing is written.
    ///
    /// # Errors
    /// Those of the database.
    pub async fn succeed_job(
        &self,
        claim: &Claim,
        result: &Value,
        dictionary: Option<&NewDictionary>,
        output: Option<&JobOutput>,
        now_ms: i64,
    ) -> Result<bool, StoreError> {
        let mut transaction = self.begin_write(&claim.job.id).await?;
        let applied = finish_succeeded(&mut transaction, claim, result, now_ms).await?;
        if let Some(output) = output.filter(|_| applied) {
            outputs::insert(&mut transaction, &claim.job.id, output, MAX_OUTPUT_BYTES).await?;
        }
        if let Some(dictionary) = dictionary.filter(|_| applied) {
            dictionaries::insert(&mut transaction, &claim.tenant, dictionary, now_ms).await?;
        }
        transaction.commit().await?;
        Ok(applied)
    }

    /// The job is given up with a problem document; whether the claim still held.
    ///
    /// # Errors
    /// Those of the database.
    pub async fn fail_job(&self, claim: &Claim, problem: &Value, now_ms: i64) -> Result<bool, StoreError> {
        const FAIL: &str = "UPDATE job SET status = 'failed', finished_at_ms = $4, problem = $5,
            lease_owner = NULL, lease_until_ms = NULL
            WHERE id = $1 AND status = 'running' AND lease_owner = $2 AND attempt = $3";
        let mut transaction = self.begin_write(&claim.job.id).await?;
        let query = fenced(&mut transaction, FAIL, claim).bind(now_ms).bind(problem.to_string());
        let failed = query.execute().await?;
        prune(&mut transaction, &claim.tenant).await?;
        transaction.commit().await?;
        Ok(failed == 1)
    }

    /// Puts the job back into the queue; whether the claim still held.
    ///
    /// # Errors
    /// Those of the database.
    pub async fn release_job(&self, claim: &Claim, release: Release) -> Result<bool, StoreError> {
        const RELEASE: &str = "UPDATE job SET status = 'queued', lease_owner = NULL, lease_until_ms = NULL,
            attempt = attempt - $4, run_at_ms = coalesce($5, run_at_ms),
            started_at_ms = NULL, progress = 0, phase = NULL, objective = NULL
            WHERE id = $1 AND status = 'running' AND lease_owner = $2 AND attempt = $3";
        let (uncounted, run_at_ms) = match release {
            Release::Uncounted => (1_i64, None),
            Release::RetryAt(time) => (0, Some(time)),
        };
        let query = fenced(self.writer(), RELEASE, claim).bind(uncounted).bind(run_at_ms);
        Ok(query.execute().await? == 1)
    }

    /// Cancels the job unless it is finished, and returns it as it then is; none when there is no such job.
    ///
    /// # Errors
    /// Those of the database.
    pub async fn cancel_job(&self, id: &str, now_ms: i64) -> Result<Option<Job>, StoreError> {
        const CANCEL: &str = "UPDATE job SET status = 'cancelled', finished_at_ms = $2,
            lease_owner = NULL, lease_until_ms = NULL
            WHERE id = $1 AND status IN ('queued', 'running')";
        let mut transaction = self.begin_write(id).await?;
        if self.select_job(&mut transaction, id).optional().await?.is_none() {
            return Ok(None);
        }
        sql(&mut transaction, CANCEL).bind(id).bind(now_ms).execute().await?;
        let row = self.select_job(&mut transaction, id).optional().await?;
        prune(&mut transaction, self.tenant()).await?;
        transaction.commit().await?;
        row.as_ref().map(read_job).transpose()
    }

    /// Puts the job of an owner that is gone back at its old place.
    ///
    /// The attempt counts: it may have been the job that ended the process.
    pub(super) async fn requeue_job_of(&self, owner: &str) -> Result<(), StoreError> {
        const REQUEUE: &str = "UPDATE job SET status = 'queued', lease_owner = NULL, lease_until_ms = NULL,
            started_at_ms = NULL, progress = 0, phase = NULL, objective = NULL
            WHERE status = 'running' AND lease_owner = $1";
        sql(self.writer(), REQUEUE).bind(owner).execute().await?;
        Ok(())
    }

    /// Puts running jobs back at their old places: only at start, when nobody can be at work.
    ///
    /// The attempt counts: it may have been the job that ended the process.
    pub(super) async fn requeue_interrupted_jobs(&self) -> Result<(), StoreError> {
        const REQUEUE: &str = "UPDATE job SET status = 'queued', lease_owner = NULL, lease_until_ms = NULL,
            started_at_ms = NULL, progress = 0, phase = NULL, objective = NULL WHERE status = 'running'";
        sql(self.writer(), REQUEUE).execute().await?;
        Ok(())
    }
}

/// Inside a transaction: the job is done; whether the claim still held. When not, the caller rolls back what it has
/// written for the job.
///
/// # Errors
/// Those of the database.
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

/// A statement of a claimant, with what identifies its claim as the first three arguments.
fn fenced<'c>(link: impl Into<Link<'c>>, statement: &'static str, claim: &Claim) -> Query<'c> {
    sql(link, statement).bind(&claim.job.id).bind(&claim.owner).bind(i64::from(claim.job.attempt))
}

/// A number in the parameters of a job, 0 where there is none.
fn number_in_parameters(transaction: &Transaction, name: &'static str) -> &'static str {
    match (name, transaction.is_postgres()) {
        ("priority", true) => "coalesce((parameters::json ->> 'priority')::float8, 0)",
        ("priority", false) => "coalesce(parameters ->> '$.priority', 0)",
        (_, true) => "coalesce((parameters::json ->> 'predicted_seconds')::float8, 0)",
        (_, false) => "coalesce(parameters ->> '$.predicted_seconds', 0)",
    }
}

/// Predicted seconds of all jobs of a tenant that wait.
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

/// Tenants with jobs that may be claimed, in the order of their turns.
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

/// Fails the jobs that had all their attempts without an outcome; their ids.
async fn abandon(
    connection: &mut Transaction,
    now_ms: i64,
    problem: &Value,
) -> Result<Vec<String>, StoreError> {
    const ABANDON: &str = "UPDATE job SET status = 'failed', finished_at_ms = $1, problem = $2,
        lease_owner = NULL, lease_until_ms = NULL
        WHERE attempt >= $3 AND (status = 'queued' OR (status = 'running' AND lease_until_ms < $1))
        RETURNING id, tenant";
    let rows = sql(&mut *connection, ABANDON)
        .bind(now_ms)
        .bind(problem.to_string())
        .bind(i64::from(MAX_ATTEMPTS))
        .all()
        .await?;
    for row in &rows {
        prune(connection, row.get("tenant")?).await?;
    }
    rows.iter().map(|row| Ok(row.get("id")?)).collect()
}

/// Removes the oldest of too many finished jobs, and passes that nobody makes any more.
async fn prune(connection: &mut Transaction, tenant: &str) -> Result<(), StoreError> {
    const PRUNE: &str = "DELETE FROM job WHERE id IN (SELECT id FROM job WHERE finished_at_ms IS NOT NULL
        AND tenant = $1 ORDER BY finished_at_ms DESC, id DESC LIMIT $2 OFFSET $3)";
    const FORGET: &str = "DELETE FROM pass WHERE job IN (SELECT id FROM job WHERE status <> 'running')";
    let query = sql(&mut *connection, PRUNE).bind(tenant).bind(i64::MAX).bind(i64::from(MAX_FINISHED));
    query.execute().await?;
    sql(connection, FORGET).execute().await?;
    Ok(())
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
