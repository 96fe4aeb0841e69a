//! Passes over a cohort, divided into parts that any replica may compute.
//!
//! The job that starts a pass owns it through its claim. When the job ends, is cancelled or taken over, no more parts are
//! handed out and no results accepted. A part is claimed with a lease, as a job is, and every write of a claimant is fenced
//! by it.

use super::answer::Answer;
use super::engine::to_sql;
use super::engine::{Pools, Query, sql};
use super::error::StoreError;
use super::filter::{Revisions, Selection};
use super::handle::Store;
use super::shapes::Cursor;
use crate::domain::filter::ShapeFilter;

/// Start of a part.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Start {
    /// Id of its first chunk.
    pub chunk: i64,
    /// Number of shapes of that chunk, among those that pass the filter, that belong to the previous part.
    pub skip: usize,
}

impl Start {
    /// Position after which a scan reads the first chunk.
    pub fn before(self) -> Cursor {
        Cursor { chunk: self.chunk - 1, position: i64::MAX }
    }
}

/// The right to compute a part until its lease or the pass ends.
#[derive(Debug, Clone)]
pub struct PartClaim {
    number: i64,
    owner: String,
    pass: i64,
    /// Index of the part, from 0.
    pub part: usize,
    /// Start of the part.
    pub start: Start,
}

/// Pass that a part belongs to.
#[derive(Debug, Clone)]
pub struct PassOf {
    /// Id of the job.
    pub job: String,
    /// Tenant of the job.
    pub tenant: String,
    /// Description of the work.
    pub description: String,
}

/// Outcome of a claimed part.
#[derive(Debug, Clone, Copy)]
pub enum PartEnd<'a> {
    /// Computed; without bytes if the owner of the pass has already used them.
    Done(Option<&'a [u8]>),
    /// Cannot be computed here; the owner of the pass computes it.
    Refused,
    /// Available to any idle worker.
    Open,
}

impl Store {
    /// Whether other processes may use the same database.
    pub fn is_shared(&self) -> bool {
        matches!(self.inner.pools, Pools::Postgres(_))
    }

    /// Starts of parts of `size` shapes each, in storage order.
    ///
    /// # Errors
    /// [`StoreError::CohortGone`].
    pub fn part_starts<'a>(
        &'a self,
        cohort_id: &'a str,
        revisions: Revisions,
        filter: &'a ShapeFilter,
        size: usize,
    ) -> Answer<'a, Vec<Start>> {
        Box::pin(async move {
            const WHOLE: &str = "SELECT c.id AS chunk_id, c.rows - (SELECT count(*) FROM shape AS s
                    WHERE s.cohort = $1 AND s.chunk_id = c.id AND s.deleted_revision <= $3) AS shapes
                FROM chunk AS c WHERE c.cohort = $1 AND c.revision > $2 AND c.revision <= $3 ORDER BY c.id";
            let mut read = self.begin_read().await?;
            let cohort = self.number(&mut read, cohort_id).await?;
            let query = if filter.is_everything() {
                let whole = sql(&mut read, WHOLE).bind(cohort);
                whole.bind(to_sql(revisions.after)).bind(to_sql(revisions.until))
            } else {
                let selection = Selection { cohort, revisions, filter, after: (0, -1) };
                let mut query = selection.select(&mut read, "s.chunk_id AS chunk_id, count(*) AS shapes");
                query.push(" GROUP BY s.chunk_id ORDER BY s.chunk_id");
                query
            };
            let (mut starts, mut before) = (Vec::new(), 0);
            for row in &query.all().await? {
                let (chunk, shapes) = (row.get("chunk_id")?, row.get::<i64>("shapes")?);
                let end = before + usize::try_from(shapes).unwrap_or_default();
                while starts.len() * size < end {
                    starts.push(Start { chunk, skip: starts.len() * size - before });
                }
                before = end;
            }
            Ok(starts)
        })
    }

    /// Begins a pass for an attempt at a job, with a part for each of `starts`, for replicas with the same `arithmetic`.
    /// Returns its number, or `None` if the attempt has lost its claim.
    ///
    /// # Errors
    /// Database errors.
    pub fn begin_pass<'a>(
        &'a self,
        (job, attempt): (&'a str, u32),
        arithmetic: &'a str,
        description: &'a str,
        starts: &'a [Start],
    ) -> Answer<'a, Option<i64>> {
        Box::pin(async move {
            const FORGET: &str = "DELETE FROM pass WHERE job = $1
                AND EXISTS (SELECT 1 FROM job WHERE id = $1 AND status = 'running' AND attempt = $2)";
            const BEGIN: &str = "INSERT INTO pass (job, owner, arithmetic, description)
                SELECT id, lease_owner, $3, $4 FROM job WHERE id = $1 AND status = 'running' AND attempt = $2
                RETURNING number";
            const PART: &str =
                "INSERT INTO task (pass, part, chunk, skip, status) VALUES ($1, $2, $3, $4, 'open')";
            let mut write = self.begin_write(job).await?;
            // Only the holder of the claim deletes the previous pass: other claimants would skip rows locked by a lost claim.
            sql(&mut write, FORGET).bind(job).bind(i64::from(attempt)).execute().await?;
            let begin = sql(&mut write, BEGIN).bind(job).bind(i64::from(attempt));
            let number = begin.bind(arithmetic).bind(description).optional_scalar::<i64>().await?;
            let Some(number) = number else { return Ok(None) };
            for (part, start) in starts.iter().enumerate() {
                let insert = sql(&mut write, PART).bind(number).bind(to_sql(part as u64));
                insert.bind(start.chunk).bind(to_sql(start.skip as u64)).execute().await?;
            }
            write.commit().await?;
            Ok(Some(number))
        })
    }

    /// Removes a pass with its remaining parts.
    ///
    /// # Errors
    /// Database errors.
    pub fn end_pass(&self, pass: i64) -> Answer<'_, ()> {
        Box::pin(async move {
            const END: &str = "DELETE FROM pass WHERE number = $1";
            sql(self.writer(), END).bind(pass).execute().await?;
            Ok(())
        })
    }

    /// Claims the first unclaimed part before `end`, for the owner of the pass.
    ///
    /// # Errors
    /// Database errors.
    pub fn claim_own_part(&self, pass: i64, end: usize, now_ms: i64) -> Answer<'_, Option<PartClaim>> {
        Box::pin(async move {
            // The lease holds as long as the claim on the job.
            self.claim_part(i64::MAX, now_ms, |query| {
                query.push(" AND t.status <> 'done' AND t.pass = ").push_bind(pass);
                query.push(" AND t.part < ").push_bind(to_sql(end as u64));
            })
            .await
        })
    }

    /// Claims the first unclaimed part of any pass, for a replica whose `arithmetic` gives the same bits.
    ///
    /// # Errors
    /// Database errors.
    pub fn claim_any_part<'a>(
        &'a self,
        now_ms: i64,
        lease_until_ms: i64,
        arithmetic: &'a str,
    ) -> Answer<'a, Option<(PartClaim, PassOf)>> {
        Box::pin(async move {
            const OF: &str =
                "SELECT p.job, p.description, j.tenant FROM pass AS p JOIN job AS j ON j.id = p.job
                WHERE p.number = $1";
            let claim = self.claim_part(lease_until_ms, now_ms, |query| {
                query.push(" AND t.status = 'open' AND p.arithmetic = ").push_bind(arithmetic);
            });
            let Some(claim) = claim.await? else { return Ok(None) };
            // The pass may have ended in the meantime.
            let Some(row) = sql(self.writer(), OF).bind(claim.pass).optional().await? else {
                return Ok(None);
            };
            let of = PassOf {
                job: row.get("job")?,
                tenant: row.get("tenant")?,
                description: row.get("description")?,
            };
            Ok(Some((claim, of)))
        })
    }

    async fn claim_part(
        &self,
        lease_until_ms: i64,
        now_ms: i64,
        which: impl FnOnce(&mut Query<'_>),
    ) -> Result<Option<PartClaim>, StoreError> {
        const CLAIM: &str = "UPDATE task SET lease_owner = $1, lease_until_ms = $2
            WHERE number = (SELECT t.number FROM task AS t
                JOIN pass AS p ON p.number = t.pass JOIN job AS j ON j.id = p.job
                WHERE j.status = 'running' AND j.lease_owner = p.owner
                AND (t.lease_until_ms IS NULL OR t.lease_until_ms < $3)";
        // Concurrent claimants skip locked rows and take the next one.
        const SKIP: &str = " FOR UPDATE OF t SKIP LOCKED";
        let owner = self.inner.replica.owned_id();
        let mut query = sql(self.writer(), CLAIM).bind(&owner).bind(lease_until_ms).bind(now_ms);
        which(&mut query);
        query.push(" ORDER BY t.number LIMIT 1").push(if self.is_shared() { SKIP } else { "" });
        query.push(") RETURNING number, pass, part, chunk, skip");
        let Some(row) = query.optional().await? else { return Ok(None) };
        let count =
            |column| Ok::<_, StoreError>(usize::try_from(row.get::<i64>(column)?).unwrap_or_default());
        Ok(Some(PartClaim {
            number: row.get("number")?,
            pass: row.get("pass")?,
            part: count("part")?,
            start: Start { chunk: row.get("chunk")?, skip: count("skip")? },
            owner,
        }))
    }

    /// Extends the lease; returns whether the claim still holds.
    ///
    /// # Errors
    /// Database errors.
    pub fn renew_part<'a>(&'a self, claim: &'a PartClaim, lease_until_ms: i64) -> Answer<'a, bool> {
        Box::pin(async move {
            const RENEW: &str = "UPDATE task SET lease_until_ms = $3 WHERE number = $1 AND lease_owner = $2
                AND EXISTS (SELECT 1 FROM pass AS p JOIN job AS j ON j.id = p.job
                    WHERE p.number = task.pass AND j.status = 'running' AND j.lease_owner = p.owner)";
            let renew = sql(self.writer(), RENEW).bind(claim.number).bind(&claim.owner).bind(lease_until_ms);
            Ok(renew.execute().await? == 1)
        })
    }

    /// Ends a claim; returns whether it still held. If not, nothing is written.
    ///
    /// # Errors
    /// Database errors.
    pub fn settle_part<'a>(&'a self, claim: &'a PartClaim, end: PartEnd<'a>) -> Answer<'a, bool> {
        Box::pin(async move {
            const SETTLE: &str = "UPDATE task SET status = $3, result = $4, checksum = $5,
                lease_owner = NULL, lease_until_ms = NULL WHERE number = $1 AND lease_owner = $2";
            let (status, result) = match end {
                PartEnd::Done(result) => ("done", result),
                PartEnd::Refused => ("refused", None),
                PartEnd::Open => ("open", None),
            };
            let checksum = result.map(|bytes| blake3::hash(bytes).as_bytes().to_vec());
            let settle = sql(self.writer(), SETTLE).bind(claim.number).bind(&claim.owner).bind(status);
            Ok(settle.bind(result).bind(checksum).execute().await? == 1)
        })
    }

    /// Result of a part of a pass, if available.
    ///
    /// # Errors
    /// [`StoreError::Damaged`] if it does not match its checksum.
    pub fn read_part(&self, pass: i64, part: usize) -> Answer<'_, Option<Vec<u8>>> {
        Box::pin(async move {
            const READ: &str = "SELECT result, checksum FROM task
                WHERE pass = $1 AND part = $2 AND status = 'done' AND result IS NOT NULL";
            let read = sql(self.reader(), READ).bind(pass).bind(to_sql(part as u64));
            let Some(row) = read.optional().await? else { return Ok(None) };
            let (result, checksum): (Vec<u8>, &[u8]) = (row.get("result")?, row.get("checksum")?);
            if blake3::hash(&result).as_bytes() != checksum {
                let detail = format!("the result of part {part} of a pass does not match its checksum");
                return Err(StoreError::Damaged { detail });
            }
            Ok(Some(result))
        })
    }

    /// Returns the parts of a dead owner to the queue.
    pub(super) async fn release_part_of(&self, owner: &str) -> Result<(), StoreError> {
        const RELEASE: &str =
            "UPDATE task SET lease_owner = NULL, lease_until_ms = NULL WHERE lease_owner = $1";
        sql(self.writer(), RELEASE).bind(owner).execute().await?;
        Ok(())
    }
}
