//! Jobs: the table is the queue.
//!
//! A claim is a lease: an owner that nobody else has, until a time that the claimant keeps moving on. Every write of
//! a claimant is fenced: it applies to the running job with that owner and attempt, and says whether it did. Who
//! was cancelled or taken over therefore changes nothing any more.

use serde_json::Value;
use sqlx::query::Query;
use sqlx::sqlite::{SqliteArguments, SqliteRow};
use sqlx::{Row, Sqlite, SqliteConnection};

use super::cohorts::{from_text, to_text};
use super::outputs::{self, MAX_OUTPUT_BYTES};
use super::{Store, StoreError, dictionaries, to_sql};
use crate::domain::dictionary::NewDictionary;
use crate::domain::id;
use crate::domain::job::{Job, JobOutput, JobStatus, Progress};

/// Jobs that may wait; more are refused.
pub const MAX_QUEUED: u32 = 1000;
/// Attempts of a job, without those that a stop of the service ended.
pub const MAX_ATTEMPTS: u32 = 5;
/// Finished jobs that are kept, the newest.
pub const MAX_FINISHED: u32 = 1000;

/// The right to work on a job, until its lease ends or the job is cancelled.
#[derive(Debug, Clone)]
pub struct Claim {
    /// The job as it was when it was claimed.
    pub job: Job,
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

impl Store {
    /// Stores a new job at the end of the queue.
    ///
    /// # Errors
    /// [`StoreError::TooManyJobs`].
    pub async fn create_job(&self, job: &Job) -> Result<(), StoreError> {
        const CREATE: &str = "INSERT INTO job
            (id, kind, parameters, status, progress, attempt, run_at_ms, created_at_ms)
            SELECT $1, $2, $3, 'queued', 0, 0, $4, $4
            WHERE (SELECT count(*) FROM job WHERE status = 'queued') < $5";
        let created = sqlx::query(CREATE)
            .bind(&job.id)
            .bind(to_text(&job.kind))
            .bind(job.parameters.to_string())
            .bind(job.created_at_ms)
            .bind(MAX_QUEUED)
            .execute(&self.0.writer)
            .await?;
        if created.rows_affected() == 0 {
            return Err(StoreError::TooManyJobs { limit: MAX_QUEUED });
        }
        Ok(())
    }

    /// The job with this id.
    ///
    /// # Errors
    /// Those of the database.
    pub async fn find_job(&self, id: &str) -> Result<Option<Job>, StoreError> {
        let row =
            sqlx::query("SELECT * FROM job WHERE id = $1").bind(id).fetch_optional(self.reader()).await?;
        row.as_ref().map(read_job).transpose()
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
        const ALL: &str = "SELECT * FROM job WHERE id > $1 ORDER BY id LIMIT $2";
        const OF_STATUS: &str = "SELECT * FROM job WHERE id > $1 AND status = $3 ORDER BY id LIMIT $2";
        let rows = sqlx::query(if status.is_some() { OF_STATUS } else { ALL })
            .bind(after.unwrap_or_default())
            .bind(to_sql(limit as u64));
        let rows = match status {
            Some(status) => rows.bind(status.as_str()),
            None => rows,
        };
        rows.fetch_all(self.reader()).await?.iter().map(read_job).collect()
    }

    /// Claims the job that waits longest, or one whose lease has ended, until `lease_until_ms`.
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
        const CLAIM: &str = "UPDATE job SET status = 'running', lease_owner = $1, lease_until_ms = $2,
            attempt = attempt + 1, started_at_ms = $3, progress = 0, phase = NULL, objective = NULL
            WHERE id = (SELECT id FROM job
                WHERE (status = 'queued' AND run_at_ms <= $3) OR (status = 'running' AND lease_until_ms < $3)
                ORDER BY run_at_ms, id LIMIT 1)
            RETURNING *";
        let owner = id::new_id("claim");
        let mut transaction = self.begin_write().await?;
        let abandoned = abandon(&mut transaction, now_ms, abandoned).await?;
        let row = sqlx::query(CLAIM)
            .bind(&owner)
            .bind(lease_until_ms)
            .bind(now_ms)
            .fetch_optional(&mut *transaction)
            .await?;
        let job = row.as_ref().map(read_job).transpose()?;
        transaction.commit().await?;
        Ok(Claimed { claim: job.map(|job| Claim { job, owner }), abandoned })
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
        let renewed = fenced(RENEW, claim)
            .bind(lease_until_ms)
            .bind(progress.fraction)
            .bind(progress.phase)
            .bind(progress.objective)
            .execute(&self.0.writer)
            .await?;
        Ok(renewed.rows_affected() == 1)
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
        let mut transaction = self.begin_write().await?;
        let applied = finish_succeeded(&mut transaction, claim, result, now_ms).await?;
        if let Some(dictionary) = dictionary.filter(|_| applied) {
            dictionaries::insert(&mut transaction, dictionary).await?;
        }
        if let Some(output) = output.filter(|_| applied) {
            outputs::insert(&mut transaction, &claim.job.id, output, MAX_OUTPUT_BYTES).await?;
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
        let mut transaction = self.begin_write().await?;
        let failed =
            fenced(FAIL, claim).bind(now_ms).bind(problem.to_string()).execute(&mut *transaction).await?;
        prune(&mut transaction).await?;
        transaction.commit().await?;
        Ok(failed.rows_affected() == 1)
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
            Release::Uncounted => (1, None),
            Release::RetryAt(time) => (0, Some(time)),
        };
        let released = fenced(RELEASE, claim).bind(uncounted).bind(run_at_ms).execute(&self.0.writer).await?;
        Ok(released.rows_affected() == 1)
    }

    /// Cancels the job unless it is finished, and returns it as it then is; none when there is no such job.
    ///
    /// # Errors
    /// Those of the database.
    pub async fn cancel_job(&self, id: &str, now_ms: i64) -> Result<Option<Job>, StoreError> {
        const CANCEL: &str = "UPDATE job SET status = 'cancelled', finished_at_ms = $2,
            lease_owner = NULL, lease_until_ms = NULL
            WHERE id = $1 AND status IN ('queued', 'running')";
        let mut transaction = self.begin_write().await?;
        sqlx::query(CANCEL).bind(id).bind(now_ms).execute(&mut *transaction).await?;
        let row = sqlx::query("SELECT * FROM job WHERE id = $1").bind(id);
        let row = row.fetch_optional(&mut *transaction).await?;
        prune(&mut transaction).await?;
        transaction.commit().await?;
        row.as_ref().map(read_job).transpose()
    }

    /// Puts running jobs back at their old places: only at start, when nobody can be at work.
    ///
    /// The attempt counts: it may have been the job that ended the process.
    pub(super) async fn requeue_interrupted_jobs(&self) -> Result<(), StoreError> {
        const REQUEUE: &str = "UPDATE job SET status = 'queued', lease_owner = NULL, lease_until_ms = NULL,
            started_at_ms = NULL, progress = 0, phase = NULL, objective = NULL WHERE status = 'running'";
        sqlx::query(REQUEUE).execute(&self.0.writer).await?;
        Ok(())
    }
}

/// Inside a transaction: the job is done; whether the claim still held. When not, the caller rolls back what it has
/// written for the job.
///
/// # Errors
/// Those of the database.
pub(super) async fn finish_succeeded(
    connection: &mut SqliteConnection,
    claim: &Claim,
    result: &Value,
    now_ms: i64,
) -> Result<bool, StoreError> {
    const SUCCEED: &str =
        "UPDATE job SET status = 'succeeded', finished_at_ms = $4, result = $5, progress = 1,
        lease_owner = NULL, lease_until_ms = NULL
        WHERE id = $1 AND status = 'running' AND lease_owner = $2 AND attempt = $3";
    let done = fenced(SUCCEED, claim).bind(now_ms).bind(result.to_string()).execute(&mut *connection).await?;
    prune(connection).await?;
    Ok(done.rows_affected() == 1)
}

/// A statement of a claimant, with what identifies its claim as the first three arguments.
fn fenced<'q>(statement: &'static str, claim: &Claim) -> Query<'q, Sqlite, SqliteArguments> {
    sqlx::query(statement).bind(claim.job.id.clone()).bind(claim.owner.clone()).bind(claim.job.attempt)
}

/// Fails the jobs that had all their attempts without an outcome; their ids.
async fn abandon(
    connection: &mut SqliteConnection,
    now_ms: i64,
    problem: &Value,
) -> Result<Vec<String>, StoreError> {
    const ABANDON: &str = "UPDATE job SET status = 'failed', finished_at_ms = $1, problem = $2,
        lease_owner = NULL, lease_until_ms = NULL
        WHERE attempt >= $3 AND (status = 'queued' OR (status = 'running' AND lease_until_ms < $1))
        RETURNING id";
    let rows = sqlx::query(ABANDON)
        .bind(now_ms)
        .bind(problem.to_string())
        .bind(MAX_ATTEMPTS)
        .fetch_all(&mut *connection)
        .await?;
    if !rows.is_empty() {
        prune(connection).await?;
    }
    rows.iter().map(|row| Ok(row.try_get("id")?)).collect()
}

/// Removes the oldest of too many finished jobs.
async fn prune(connection: &mut SqliteConnection) -> Result<(), StoreError> {
    const PRUNE: &str = "DELETE FROM job WHERE id IN (SELECT id FROM job WHERE finished_at_ms IS NOT NULL
        ORDER BY finished_at_ms DESC, id DESC LIMIT -1 OFFSET $1)";
    sqlx::query(PRUNE).bind(MAX_FINISHED).execute(connection).await?;
    Ok(())
}

fn read_job(row: &SqliteRow) -> Result<Job, StoreError> {
    Ok(Job {
        id: row.try_get("id")?,
        kind: from_text(row.try_get("kind")?)?,
        parameters: read_json(row.try_get("parameters")?)?,
        status: from_text(row.try_get("status")?)?,
        progress: row.try_get("progress")?,
        phase: row.try_get("phase")?,
        objective: row.try_get("objective")?,
        attempt: row.try_get("attempt")?,
        created_at_ms: row.try_get("created_at_ms")?,
        started_at_ms: row.try_get("started_at_ms")?,
        finished_at_ms: row.try_get("finished_at_ms")?,
        result: row.try_get::<Option<&str>, _>("result")?.map(read_json).transpose()?,
        problem: row.try_get::<Option<&str>, _>("problem")?.map(read_json).transpose()?,
    })
}

fn read_json(text: &str) -> Result<Value, StoreError> {
    serde_json::from_str(text)
        .map_err(|e| StoreError::Damaged { detail: format!("unreadable JSON of a job: {e}") })
}
