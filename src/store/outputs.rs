//! Outputs of jobs that are too large for their row.

use super::engine::to_sql;
use super::engine::{Transaction, sql};
use super::error::StoreError;
use super::handle::Store;
use crate::domain::job::JobOutput;

/// Maximum total size of the outputs kept; the oldest are removed first, and the last one is always kept.
pub const MAX_OUTPUT_BYTES: u64 = 2 << 30;

impl Store {
    /// Output of the job with this id, if it is still kept.
    ///
    /// # Errors
    /// [`StoreError::Damaged`] if it does not match its checksum.
    pub async fn read_job_output(&self, job: &str) -> Result<Option<JobOutput>, StoreError> {
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
    }
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
    let head = output.head.to_string();
    sql(&mut *write, INSERT)
        .bind(job)
        .bind(to_sql(output.data.len() as u64))
        .bind(checksum_of(&head, &output.data))
        .bind(&head)
        .bind(&output.data)
        .execute()
        .await?;
    sql(&mut *write, PRUNE).bind(to_sql(most_bytes)).execute().await?;
    Ok(())
}

/// Checksum stored with an output.
pub(super) fn checksum_of(head: &str, data: &[u8]) -> Vec<u8> {
    blake3::Hasher::new().update(head.as_bytes()).update(data).finalize().as_bytes().to_vec()
}
