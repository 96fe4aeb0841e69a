//! Hooks: the table is the queue of deliveries.
//!
//! A hook is claimed with a lease by the replica that delivers to it, as a job is. Every write of a claimant is fenced: it
//! applies only while the hook is active under the claim. Pausing a hook, setting its position or deleting it ends the claim.

use super::answer::Answer;
use super::engine::{Query, Row, Transaction, from_sql, sql, to_sql};
use super::error::StoreError;
use super::handle::Store;
use super::text::{from_text, to_text};
use crate::domain::change::ChangeFilter;
use crate::domain::hook::{Hook, HookFailure, HookStatus, SigningSecret};

/// Maximum number of hooks of a tenant.
pub const MAX_HOOKS: u32 = 100;
/// Number of failed attempts kept per hook; older ones are removed.
pub const MAX_FAILURES: u32 = 100;

/// Condition for hooks that may be claimed at the time `$1`.
const DUE: &str = "status = 'active' AND due_ms <= $1 AND (lease_until_ms IS NULL OR lease_until_ms < $1)
    AND position < (SELECT q.last FROM change_sequence AS q WHERE q.tenant = hook.tenant)";

/// The right to deliver to a hook until the lease ends.
#[derive(Debug, Clone)]
pub struct HookClaim {
    /// The hook at the time of the claim.
    pub hook: Hook,
    owner: String,
}

/// Figures of all hooks.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct HookMeasures {
    /// Hooks whose deliveries were given up.
    pub failed: u64,
    /// Changes that the slowest active hook has not examined.
    pub lag: u64,
}

impl Store {
    /// Stores a new hook; `false` if the tenant has [`MAX_HOOKS`].
    ///
    /// # Errors
    /// Database errors, as for all functions here.
    pub fn create_hook<'a>(&'a self, hook: &'a Hook) -> Answer<'a, bool> {
        Box::pin(async move {
            const COUNT: &str = "SELECT count(*) FROM hook WHERE tenant = $1";
            const CREATE: &str = "INSERT INTO hook (id, tenant, url, description, kinds, cohort, secret, status,
                position, attempts, due_ms, created_at_ms) VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, 0, $10, $10)";
            let mut write = self.begin_write(&hook.tenant).await?;
            let count: i64 = sql(&mut write, COUNT).bind(hook.tenant.as_str()).scalar().await?;
            if count >= i64::from(MAX_HOOKS) {
                return Ok(false);
            }
            sql(&mut write, CREATE)
                .bind(hook.id.as_str())
                .bind(hook.tenant.as_str())
                .bind(hook.url.as_str())
                .bind(hook.description.as_str())
                .bind(hook.filter.kinds.as_ref().map(to_text))
                .bind(hook.filter.cohort.as_deref())
                .bind(hook.secret.bytes())
                .bind(to_text(&hook.status))
                .bind(to_sql(hook.position))
                .bind(hook.created_at_ms)
                .execute()
                .await?;
            write.commit().await?;
            Ok(true)
        })
    }

    /// Finds the hook with this id.
    ///
    /// # Errors
    /// Database errors.
    pub fn find_hook<'a>(&'a self, id: &'a str) -> Answer<'a, Option<Hook>> {
        Box::pin(async move {
            const FIND: &str = "SELECT * FROM hook WHERE id = $1 AND tenant = $2";
            let row = sql(self.reader(), FIND).bind(id).bind(self.tenant()).optional().await?;
            row.as_ref().map(read_hook).transpose()
        })
    }

    /// At most `limit` hooks in id order, starting after the id `after`.
    ///
    /// # Errors
    /// Database errors.
    pub fn list_hooks<'a>(&'a self, after: Option<&'a str>, limit: usize) -> Answer<'a, Vec<Hook>> {
        Box::pin(async move {
            const LIST: &str = "SELECT * FROM hook WHERE tenant = $1 AND id > $2 ORDER BY id LIMIT $3";
            let query = sql(self.reader(), LIST).bind(self.tenant()).bind(after.unwrap_or_default());
            query.bind(to_sql(limit as u64)).all().await?.iter().map(read_hook).collect()
        })
    }

    /// Removes the hook with this id; `false` if there is none.
    ///
    /// # Errors
    /// Database errors.
    pub fn delete_hook<'a>(&'a self, id: &'a str) -> Answer<'a, bool> {
        Box::pin(async move {
            const DELETE: &str = "DELETE FROM hook WHERE id = $1 AND tenant = $2";
            Ok(sql(self.writer(), DELETE).bind(id).bind(self.tenant()).execute().await? > 0)
        })
    }

    /// Pauses the hook, or resumes it with its next attempt at once; `None` if there is no such hook.
    ///
    /// # Errors
    /// Database errors.
    pub fn set_hook_status<'a>(
        &'a self,
        id: &'a str,
        status: HookStatus,
        now_ms: i64,
    ) -> Answer<'a, Option<Hook>> {
        Box::pin(async move {
            const SET: &str = "UPDATE hook SET status = $3, reason = NULL, attempts = 0, failing_since_ms = NULL,
                due_ms = $4, lease_owner = NULL, lease_until_ms = NULL WHERE id = $1 AND tenant = $2 RETURNING *";
            let query =
                sql(self.writer(), SET).bind(id).bind(self.tenant()).bind(to_text(&status)).bind(now_ms);
            query.all().await?.first().map(read_hook).transpose()
        })
    }

    /// Delivers again the changes after the one with number `position`; resumes the hook. `None` if there is no such hook.
    ///
    /// # Errors
    /// Database errors.
    pub fn move_hook<'a>(&'a self, id: &'a str, position: u64, now_ms: i64) -> Answer<'a, Option<Hook>> {
        Box::pin(async move {
            const MOVE: &str =
                "UPDATE hook SET status = 'active', reason = NULL, attempts = 0, failing_since_ms = NULL,
                due_ms = $4, position = $3, lease_owner = NULL, lease_until_ms = NULL
                WHERE id = $1 AND tenant = $2 RETURNING *";
            let query =
                sql(self.writer(), MOVE).bind(id).bind(self.tenant()).bind(to_sql(position)).bind(now_ms);
            query.all().await?.first().map(read_hook).transpose()
        })
    }

    /// Failed attempts at deliveries to the hook, the newest first.
    ///
    /// # Errors
    /// Database errors.
    pub fn list_hook_failures<'a>(&'a self, id: &'a str, limit: usize) -> Answer<'a, Vec<HookFailure>> {
        Box::pin(async move {
            const LIST: &str = "SELECT f.* FROM hook_failure AS f JOIN hook AS h ON h.id = f.hook
                WHERE f.hook = $1 AND h.tenant = $2 ORDER BY f.at_ms DESC, f.sequence DESC, f.attempt DESC LIMIT $3";
            let query = sql(self.reader(), LIST).bind(id).bind(self.tenant()).bind(to_sql(limit as u64));
            query.all().await?.iter().map(read_failure).collect()
        })
    }

    /// Figures of the hooks of all tenants.
    ///
    /// # Errors
    /// Database errors.
    pub fn measure_hooks(&self) -> Answer<'_, HookMeasures> {
        Box::pin(async move {
            const FAILED: &str = "SELECT count(*) FROM hook WHERE status = 'failed'";
            const LAG: &str = "SELECT coalesce(max(q.last - h.position), 0) FROM hook AS h
                JOIN change_sequence AS q ON q.tenant = h.tenant WHERE h.status = 'active'";
            let failed: i64 = sql(self.reader(), FAILED).scalar().await?;
            let lag: i64 = sql(self.reader(), LAG).scalar().await?;
            Ok(HookMeasures { failed: from_sql(failed), lag: from_sql(lag) })
        })
    }

    /// Claims a hook that waits for a delivery until `lease_until_ms`, if one waits. Tenants take turns: the first are those with the
    /// fewest claimed hooks; among them the hook that has waited longest. Hooks of the tenants in `crowding` are claimed only while no
    /// other tenant has an active one.
    ///
    /// # Errors
    /// Database errors.
    pub fn claim_hook<'a>(
        &'a self,
        now_ms: i64,
        lease_until_ms: i64,
        crowding: &'a [&'a str],
    ) -> Answer<'a, Option<HookClaim>> {
        Box::pin(async move {
            const CLAIM: &str =
                "UPDATE hook SET lease_owner = $2, lease_until_ms = $3 WHERE id = (SELECT hook.id
                FROM hook LEFT JOIN (SELECT tenant, count(*) AS claims FROM hook WHERE lease_until_ms >= $1
                GROUP BY tenant) AS busy ON busy.tenant = hook.tenant WHERE ";
            // Most of the time nothing waits: looking takes no turn of a writer.
            let mut look = sql(self.reader(), "SELECT count(*) FROM hook WHERE ").bind(now_ms);
            push_due(&mut look, crowding);
            if look.scalar::<i64>().await? == 0 {
                return Ok(None);
            }
            let owner = self.inner.replica.owned_id();
            let mut write = self.begin_write("hook").await?;
            let mut claim = sql(&mut write, CLAIM).bind(now_ms).bind(&owner).bind(lease_until_ms);
            push_due(&mut claim, crowding);
            claim.push(" ORDER BY coalesce(busy.claims, 0), hook.due_ms, hook.id LIMIT 1) RETURNING *");
            let row = claim.optional().await?;
            let claimed = row.as_ref().map(read_hook).transpose()?.map(|hook| HookClaim { hook, owner });
            write.commit().await?;
            Ok(claimed)
        })
    }

    /// Moves the position of a claimed hook forward, after a delivery at `delivered_at_ms` or over changes that need none, and
    /// extends the lease; returns whether the claim still holds.
    ///
    /// # Errors
    /// Database errors.
    pub fn advance_hook<'a>(
        &'a self,
        claim: &'a HookClaim,
        position: u64,
        delivered_at_ms: Option<i64>,
        lease_until_ms: i64,
    ) -> Answer<'a, bool> {
        Box::pin(async move {
            const ADVANCE: &str = "UPDATE hook SET position = $3, attempts = 0, failing_since_ms = NULL,
                delivered_at_ms = coalesce($4, delivered_at_ms), lease_until_ms = $5
                WHERE id = $1 AND lease_owner = $2 AND status = 'active'";
            let query = fenced(self, ADVANCE, claim).bind(to_sql(position)).bind(delivered_at_ms);
            Ok(query.bind(lease_until_ms).execute().await? == 1)
        })
    }

    /// Records a failed attempt and ends the claim. The next attempt is at `due_ms`; with a `reason`, deliveries are given up.
    ///
    /// # Errors
    /// Database errors.
    pub fn fail_hook<'a>(
        &'a self,
        claim: &'a HookClaim,
        failure: &'a HookFailure,
        due_ms: i64,
        reason: Option<&'a str>,
    ) -> Answer<'a, bool> {
        Box::pin(async move {
            const FAIL: &str =
                "UPDATE hook SET attempts = $3, failing_since_ms = coalesce(failing_since_ms, $4),
                due_ms = $5, status = $6, reason = $7, lease_owner = NULL, lease_until_ms = NULL
                WHERE id = $1 AND lease_owner = $2 AND status = 'active'";
            let status = if reason.is_some() { HookStatus::Failed } else { HookStatus::Active };
            let mut write = self.begin_write(&claim.hook.id).await?;
            let query = sql(&mut write, FAIL).bind(claim.hook.id.as_str()).bind(claim.owner.as_str());
            let query = query.bind(i64::from(failure.attempt)).bind(failure.at_ms).bind(due_ms);
            if query.bind(to_text(&status)).bind(reason).execute().await? == 0 {
                return Ok(false);
            }
            note_failure(&mut write, &claim.hook.id, failure).await?;
            write.commit().await?;
            Ok(true)
        })
    }

    /// Gives up the deliveries of a claimed hook for a reason other than a failed attempt.
    ///
    /// # Errors
    /// Database errors.
    pub fn give_up_hook<'a>(&'a self, claim: &'a HookClaim, reason: &'a str) -> Answer<'a, bool> {
        Box::pin(async move {
            const GIVE_UP: &str = "UPDATE hook SET status = 'failed', reason = $3, lease_owner = NULL,
                lease_until_ms = NULL WHERE id = $1 AND lease_owner = $2 AND status = 'active'";
            Ok(fenced(self, GIVE_UP, claim).bind(reason).execute().await? == 1)
        })
    }

    /// Ends the claim; the next delivery can be made by any replica from `due_ms` on.
    ///
    /// # Errors
    /// Database errors.
    pub fn release_hook<'a>(&'a self, claim: &'a HookClaim, due_ms: i64) -> Answer<'a, ()> {
        Box::pin(async move {
            const RELEASE: &str = "UPDATE hook SET lease_owner = NULL, lease_until_ms = NULL, due_ms = $3
                WHERE id = $1 AND lease_owner = $2";
            fenced(self, RELEASE, claim).bind(due_ms).execute().await?;
            Ok(())
        })
    }

    /// Ends the claim of a dead owner.
    pub(super) async fn release_hook_of(&self, owner: &str) -> Result<(), StoreError> {
        const RELEASE: &str =
            "UPDATE hook SET lease_owner = NULL, lease_until_ms = NULL WHERE lease_owner = $1";
        sql(self.writer(), RELEASE).bind(owner).execute().await?;
        Ok(())
    }

    /// Ends all claims; used only at start, when no other process can be delivering.
    pub(super) async fn release_all_hooks(&self) -> Result<(), StoreError> {
        const RELEASE: &str =
            "UPDATE hook SET lease_owner = NULL, lease_until_ms = NULL WHERE lease_owner IS NOT NULL";
        sql(self.writer(), RELEASE).execute().await?;
        Ok(())
    }
}

/// Appends the conditions for hooks that may be claimed at the time `$1`; those of tenants in `crowding` only where no other tenant has
/// an active one.
fn push_due(query: &mut Query<'_>, crowding: &[&str]) {
    query.push(DUE);
    if !crowding.is_empty() {
        query.push(" AND (hook.tenant NOT IN ").push_texts(crowding.iter().copied());
        query.push(
            " OR NOT EXISTS (SELECT 1 FROM hook AS other WHERE other.tenant <> hook.tenant
            AND other.status = 'active'))",
        );
    }
}

/// A claimant's statement, with the identification of its claim as the first two arguments.
fn fenced<'c>(store: &'c Store, statement: &'static str, claim: &HookClaim) -> Query<'c> {
    sql(store.writer(), statement).bind(claim.hook.id.clone()).bind(claim.owner.clone())
}

async fn note_failure(write: &mut Transaction, hook: &str, failure: &HookFailure) -> Result<(), StoreError> {
    const NOTE: &str = "INSERT INTO hook_failure (hook, at_ms, sequence, attempt, status, detail)
        VALUES ($1, $2, $3, $4, $5, $6) ON CONFLICT DO NOTHING";
    const PRUNE: &str = "DELETE FROM hook_failure WHERE hook = $1 AND at_ms < (SELECT min(at_ms) FROM
        (SELECT at_ms FROM hook_failure WHERE hook = $1 ORDER BY at_ms DESC LIMIT $2) AS newest)";
    sql(&mut *write, NOTE)
        .bind(hook)
        .bind(failure.at_ms)
        .bind(to_sql(failure.sequence))
        .bind(i64::from(failure.attempt))
        .bind(failure.status.map(i64::from))
        .bind(failure.detail.as_str())
        .execute()
        .await?;
    sql(write, PRUNE).bind(hook).bind(i64::from(MAX_FAILURES)).execute().await?;
    Ok(())
}

fn read_hook(row: &Row) -> Result<Hook, StoreError> {
    let kinds: Option<&str> = row.get("kinds")?;
    Ok(Hook {
        id: row.get("id")?,
        tenant: row.get("tenant")?,
        url: row.get("url")?,
        description: row.get("description")?,
        filter: ChangeFilter { kinds: kinds.map(from_text).transpose()?, cohort: row.get("cohort")? },
        secret: SigningSecret::new(row.get::<&[u8]>("secret")?.to_vec()),
        status: from_text(row.get("status")?)?,
        reason: row.get("reason")?,
        position: from_sql(row.get("position")?),
        attempts: u32::try_from(row.get::<i64>("attempts")?).unwrap_or(u32::MAX),
        failing_since_ms: row.get("failing_since_ms")?,
        due_ms: row.get("due_ms")?,
        delivered_at_ms: row.get("delivered_at_ms")?,
        created_at_ms: row.get("created_at_ms")?,
    })
}

fn read_failure(row: &Row) -> Result<HookFailure, StoreError> {
    Ok(HookFailure {
        at_ms: row.get("at_ms")?,
        sequence: from_sql(row.get("sequence")?),
        attempt: u32::try_from(row.get::<i64>("attempt")?).unwrap_or(u32::MAX),
        status: row.get::<Option<i64>>("status")?.and_then(|status| u16::try_from(status).ok()),
        detail: row.get("detail")?,
    })
}
