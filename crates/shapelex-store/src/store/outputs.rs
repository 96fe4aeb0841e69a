//! Outputs of jobs that are too large for their row.

use super::answer::Answer;
use super::engine::to_sql;
use super::engine::{Link, Query, Row, Transaction, sql};
use super::error::StoreError;
use super::handle::Store;
use crate::domain::job::{Job, JobOutput};

/// Maximum total size of the outputs kept; the oldest are removed first, and the last one is always kept.
pub const MAX_OUTPUT_BYTES: u64 = 2 << 30;

impl Store {
    /// Output of the job with this id, if it is still kept.
    ///
    /// # Errors
    /// [`StoreError::Damaged`] if it does not match its checksum.
    pub fn read_job_output<'a>(&'a self, job: &'a str) -> Answer<'a, Option<JobOutput>> {
        Box::pin(async move {
            const READ: &str = "SELECT checksum, head, data FROM job_output WHERE job = $1";
            let Some(row) = sql(self.reader(), READ).bind(job).optional().await? else {
                return Ok(None);
            };
            let damaged =
                || StoreError::Damaged { detail: format!("the output of {job} does not match its checksum") };
            let (checksum, head, data): (&[u8], &str, Vec<u8>) =
                (row.get("checksum")?, row.get("head")?, row.get("data")?);
            if checksum_of(head, &data).as_slice() != checksum {
                return Err(damaged());
            }
            Ok(Some(JobOutput { head: serde_json::from_str(head).map_err(|_| damaged())?, data }))
        })
    }

    /// Bytes of the output of the job with this id, without its parts, if it is still kept.
    ///
    /// # Errors
    /// Database errors.
    pub fn size_of_output<'a>(&'a self, job: &'a str) -> Answer<'a, Option<u64>> {
        Box::pin(async move {
            const SIZE: &str =
                "SELECT CAST(octet_length(head) + length(data) AS BIGINT) FROM job_output WHERE job = $1";
            let bytes = sql(self.reader(), SIZE).bind(job).optional_scalar::<i64>().await?;
            Ok(bytes.map(i64::cast_unsigned))
        })
    }

    /// Checksum of the output of the job with this id, if the caller may see the job and its output is still kept.
    ///
    /// # Errors
    /// Database errors.
    pub fn find_output_mark<'a>(&'a self, job: &'a str) -> Answer<'a, Option<Vec<u8>>> {
        Box::pin(async move {
            const FIND: &str =
                "SELECT o.checksum FROM job_output AS o JOIN job ON job.id = o.job WHERE job.id = ";
            let mut query = sql(self.reader(), FIND);
            query.push_bind(job).push(" AND job.tenant = ").push_bind(self.tenant());
            self.push_scope(&mut query, "job.cohort");
            let row = query.optional().await?;
            row.map(|row| Ok(row.get::<&[u8]>("checksum")?.to_vec())).transpose()
        })
    }

    /// Stores a part of the output of a running `job`, as it was claimed, while the attempt lasts; `false` if it has lost the job.
    ///
    /// # Errors
    /// Database errors.
    pub fn add_output_part<'a>(&'a self, job: &'a Job, part: u64, data: &'a [u8]) -> Answer<'a, bool> {
        Box::pin(async move {
            const ADD: &str = "INSERT INTO job_output_part (job, attempt, part, checksum, data)
                VALUES ($1, $2, $3, $4, $5)";
            let mut write = self.begin_write(&job.id).await?;
            if !self.holds(&mut write, job).await? {
                return Ok(false);
            }
            sql(&mut write, ADD)
                .bind(&job.id)
                .bind(i64::from(job.attempt))
                .bind(to_sql(part))
                .bind(blake3::hash(data).as_bytes().to_vec())
                .bind(data)
                .execute()
                .await?;
            write.commit().await?;
            Ok(true)
        })
    }

    /// Whether the attempt at a `job`, as it was claimed, lasts.
    pub(super) async fn holds(&self, write: &mut Transaction, job: &Job) -> Result<bool, StoreError> {
        // An erasure begins an attempt again under its number, but at another time.
        const HELD: &str = "SELECT id FROM job
            WHERE id = $1 AND tenant = $2 AND status = 'running' AND attempt = $3 AND started_at_ms = $4";
        // A cancellation waits for the end of the transaction.
        let lock = if write.is_postgres() { " FOR UPDATE" } else { "" };
        let held = sql(write, HELD).bind(&job.id).bind(self.tenant()).bind(i64::from(job.attempt));
        let mut held = held.bind(job.started_at_ms);
        held.push(lock);
        Ok(held.optional_scalar::<String>().await?.is_some())
    }

    /// Removes the parts of the output of a job that earlier attempts have stored.
    ///
    /// # Errors
    /// Database errors.
    pub fn clear_output_parts<'a>(&'a self, job: &'a str) -> Answer<'a, ()> {
        Box::pin(async move {
            let mut write = self.begin_write(job).await?;
            forget_parts(&mut write, job).await?;
            Ok(write.commit().await?)
        })
    }

    /// A part of the output of a job, if it is still kept.
    ///
    /// # Errors
    /// [`StoreError::Damaged`] if it does not match its checksum.
    pub fn read_output_part<'a>(
        &'a self,
        job: &'a str,
        attempt: u32,
        part: u64,
    ) -> Answer<'a, Option<Vec<u8>>> {
        Box::pin(async move {
            let row = select_part(self.reader(), job, attempt, part).optional().await?;
            let Some(row) = row else { return Ok(None) };
            match whole_part(&row)? {
                Some(data) => Ok(Some(data)),
                None => Err(StoreError::Damaged {
                    detail: format!("part {part} of the output of {job} does not match its checksum"),
                }),
            }
        })
    }
}

/// Selects a part of an output.
pub(super) fn select_part<'c>(link: impl Into<Link<'c>>, job: &str, attempt: u32, part: u64) -> Query<'c> {
    const READ: &str =
        "SELECT checksum, data FROM job_output_part WHERE job = $1 AND attempt = $2 AND part = $3";
    sql(link, READ).bind(job.to_owned()).bind(i64::from(attempt)).bind(to_sql(part))
}

/// Data of a part, if they match their checksum.
pub(super) fn whole_part(row: &Row) -> Result<Option<Vec<u8>>, StoreError> {
    let (checksum, data): (&[u8], Vec<u8>) = (row.get("checksum")?, row.get("data")?);
    Ok((blake3::hash(&data).as_bytes() == checksum).then_some(data))
}

/// Removes the parts of the output of a job.
pub(super) async fn forget_parts(write: &mut Transaction, job: &str) -> Result<(), StoreError> {
    sql(write, "DELETE FROM job_output_part WHERE job = $1").bind(job).execute().await?;
    Ok(())
}

/// Inserts the output of a job, within the transaction that ends it, and removes the oldest outputs beyond the limit.
pub(super) async fn insert(
    write: &mut Transaction,
    job: &str,
    output: &JobOutput,
    most_bytes: u64,
) -> Result<(), StoreError> {
    const INSERT: &str =
        "INSERT INTO job_output (job, bytes, checksum, head, data) VALUES ($1, $2, $3, $4, $5)";
    const PRUNE: &str = "DELETE FROM job_output WHERE number IN (SELECT number FROM
        (SELECT number, sum(bytes) OVER (ORDER BY number DESC) AS total FROM job_output) AS sums
        WHERE total > $1 AND number < (SELECT max(number) FROM job_output))";
    // Parts of outputs that are no longer kept, and of jobs that have ended without one.
    const PRUNE_PARTS: &str = "DELETE FROM job_output_part WHERE job IN (SELECT DISTINCT p.job
        FROM job_output_part AS p JOIN job AS j ON j.id = p.job
        WHERE j.status NOT IN ('queued', 'running')
            AND NOT EXISTS (SELECT 1 FROM job_output AS o WHERE o.job = p.job))";
    let head = output.head.to_string();
    sql(&mut *write, INSERT)
        .bind(job)
        .bind(to_sql(bytes_of(output)))
        .bind(checksum_of(&head, &output.data))
        .bind(&head)
        .bind(&output.data)
        .execute()
        .await?;
    sql(&mut *write, PRUNE).bind(to_sql(most_bytes)).execute().await?;
    sql(&mut *write, PRUNE_PARTS).execute().await?;
    Ok(())
}

/// Size of an output with its parts.
pub(super) fn bytes_of(output: &JobOutput) -> u64 {
    output.data.len() as u64 + output.parts().map_or(0, |parts| parts.bytes)
}

/// Checksum stored with an output.
pub(super) fn checksum_of(head: &str, data: &[u8]) -> Vec<u8> {
    blake3::Hasher::new().update(head.as_bytes()).update(data).finalize().as_bytes().to_vec()
}
