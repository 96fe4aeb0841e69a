//! Files that jobs work on, such as images: stored with the job, and removed by the transaction that ends it.

use super::answer::Answer;
use super::engine::{Transaction, from_sql, sql};
use super::error::StoreError;
use super::handle::Store;
use super::outputs::whole_part;
use crate::domain::job::Job;
use crate::domain::retry::JOB_MARK;

/// Maximum number of bytes of the files of a tenant's jobs that wait or run. One job alone may have more.
pub const MAX_FILE_BYTES: u64 = 2 << 30;
/// Bytes of a piece, and number of pieces read at once.
const PIECE_BYTES: usize = 1 << 20;
const PIECES: i64 = 4;

impl Store {
    /// Files of a `job` with their names, in the order of these.
    ///
    /// # Errors
    /// [`StoreError::Damaged`] if a piece does not match its checksum, or if one is missing between others.
    pub fn read_job_files<'a>(&'a self, job: &'a Job) -> Answer<'a, Vec<(String, Vec<u8>)>> {
        Box::pin(async move {
            const READ: &str = "SELECT f.name, f.piece, f.checksum, f.data
                FROM job_file AS f JOIN job AS j ON j.id = f.job
                WHERE f.job = $1 AND j.tenant = $2 AND (f.name, f.piece) > ($3, $4)
                ORDER BY f.name, f.piece LIMIT $5";
            let (mut read, mut last) = (self.begin_read().await?, (String::new(), 0_i64));
            let mut files: Vec<(String, Vec<u8>)> = Vec::new();
            loop {
                let page = sql(&mut read, READ).bind(&job.id).bind(self.tenant()).bind(&last.0).bind(last.1);
                let rows = page.bind(PIECES).all().await?;
                if rows.is_empty() {
                    return Ok(files);
                }
                for row in &rows {
                    let (name, piece): (String, i64) = (row.get("name")?, row.get("piece")?);
                    let expected = if name == last.0 { last.1 + 1 } else { 0 };
                    let data = whole_part(row)?.filter(|_| piece == expected);
                    let data = data.ok_or_else(|| StoreError::Damaged {
                        detail: format!("the file {name} of {} does not match its checksum", job.id),
                    })?;
                    match files.last_mut() {
                        Some((known, bytes)) if *known == name => bytes.extend_from_slice(&data),
                        _ => files.push((name.clone(), data)),
                    }
                    last = (name, piece);
                }
            }
        })
    }
}

/// Stores the files of a job within the transaction that creates it.
///
/// # Errors
/// [`StoreError::TooManyBytes`] if those of other jobs of the tenant are there and there is no more room.
pub(super) async fn insert(
    write: &mut Transaction,
    tenant: &str,
    job: &str,
    files: &[(&str, &[u8])],
    most_bytes: u64,
) -> Result<(), StoreError> {
    const WAITING: &str = "SELECT CAST(coalesce(sum(length(f.data)), 0) AS BIGINT) FROM job_file AS f
        JOIN job AS j ON j.id = f.job WHERE j.tenant = $1";
    const INSERT: &str =
        "INSERT INTO job_file (job, name, piece, checksum, data) VALUES ($1, $2, $3, $4, $5)";
    let waiting: i64 = sql(&mut *write, WAITING).bind(tenant).scalar().await?;
    let (waiting, new) = (from_sql(waiting), files.iter().map(|(_, file)| file.len() as u64).sum::<u64>());
    if waiting > 0 && waiting.saturating_add(new) > most_bytes {
        return Err(StoreError::TooManyBytes { waiting, limit: most_bytes });
    }
    for (name, file) in files {
        // An empty file has a piece too.
        let count = file.len().div_ceil(PIECE_BYTES).max(1);
        for piece in 0..count {
            let data = &file[piece * PIECE_BYTES..file.len().min((piece + 1) * PIECE_BYTES)];
            sql(&mut *write, INSERT)
                .bind(job)
                .bind(*name)
                .bind(piece as i64)
                .bind(blake3::hash(data).as_bytes().to_vec())
                .bind(data)
                .execute()
                .await?;
        }
    }
    Ok(())
}

/// Removes the files of jobs that have ended, with the receipts of their writes: they do not run again.
pub(super) async fn forget(write: &mut Transaction) -> Result<(), StoreError> {
    const SETTLE: &str = "DELETE FROM receipt WHERE (tenant, key) IN
        (SELECT j.tenant, $1 || j.id FROM job_file AS f JOIN job AS j ON j.id = f.job WHERE j.finished_at_ms IS NOT NULL)";
    const FORGET: &str = "DELETE FROM job_file WHERE job IN
        (SELECT f.job FROM job_file AS f JOIN job AS j ON j.id = f.job WHERE j.finished_at_ms IS NOT NULL)";
    sql(&mut *write, SETTLE).bind(JOB_MARK.to_string()).execute().await?;
    sql(write, FORGET).execute().await?;
    Ok(())
}
