//! Audit trail: entries are appended and expire, but never change.
//!
//! `audit_head` stores, for each tenant, position and digest of the last entry and of the last removed one; the entries
//! between them form a complete chain.

use std::collections::BTreeMap;

use super::answer::Answer;
use super::engine::{Row, Transaction};
use super::engine::{from_sql, rows_of_inserts, sql, to_sql};
use super::error::StoreError;
use super::handle::Store;
use crate::domain::audit::{AuditFilter, DIGEST_BYTES, Digest, Entry, FIRST_LINK, Recorded};

/// Lock scope of writers of the trail.
const SCOPE: &str = "audit";

/// Number of entries read or removed at a time.
const PIECE: u64 = 2000;

/// Beginning and end of a tenant's trail.
const HEAD: &str = "SELECT * FROM audit_head WHERE tenant = $1";

/// Maximum deviation between the order of entries and that of their times: entries wait in groups, and the clocks of
/// machines differ.
const DISORDER_MS: i64 = 60_000;

/// Result of verifying all trails.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct AuditCheck {
    /// Number of tenants that have a trail.
    pub tenants: u64,
    /// Number of entries with valid digests.
    pub entries: u64,
}

/// A chain between two links.
struct Chain {
    tenant: String,
    from: (u64, Digest),
    to: (u64, Digest),
}

impl Store {
    /// Appends entries to the trails of their tenants, in one transaction.
    ///
    /// # Errors
    /// Database errors; then none of the entries is stored.
    pub fn append_audit<'a>(&'a self, entries: &'a [Entry]) -> Answer<'a, ()> {
        Box::pin(async move {
            if entries.is_empty() {
                return Ok(());
            }
            let mut of_tenants: BTreeMap<&str, Vec<&Entry>> = BTreeMap::new();
            for entry in entries {
                of_tenants.entry(&entry.tenant).or_default().push(entry);
            }
            let mut transaction = self.begin_note(SCOPE).await?;
            for (tenant, entries) in of_tenants {
                append(&mut transaction, tenant, &entries).await?;
            }
            transaction.commit().await?;
            self.mark_entries(entries.len());
            Ok(())
        })
    }

    /// At most `limit` entries of a tenant in order, after the position `after`.
    ///
    /// # Errors
    /// Database errors.
    pub fn list_audit<'a>(
        &'a self,
        tenant: &'a str,
        filter: &'a AuditFilter,
        after: u64,
        limit: usize,
    ) -> Answer<'a, Vec<Recorded>> {
        Box::pin(async move {
            const FIRST: &str = "SELECT sequence FROM audit WHERE tenant = $1 AND at_ms >= $2
                ORDER BY at_ms, sequence LIMIT 1";
            const LIST: &str = "SELECT * FROM audit WHERE tenant = $1 AND sequence > $2
                AND at_ms >= $4 AND at_ms < $5 AND ($6 IS NULL OR caller = $6) AND ($7 IS NULL OR operation = $7)
                AND ($8 IS NULL OR replace(objects, $8, '') <> objects) AND ($9 IS NULL OR status = $9)
                ORDER BY sequence LIMIT $3";
            let mut after = to_sql(after);
            if let Some(since) = filter.since_ms {
                let first = sql(self.reader(), FIRST).bind(tenant).bind(since.saturating_sub(DISORDER_MS));
                let first: Option<i64> = first.optional_scalar().await?;
                let Some(first) = first else { return Ok(Vec::new()) };
                after = after.max(first - 1);
            }
            // Matches the value after a parameter name in the stored JSON.
            let object = filter.object.as_ref().map(|object| format!(":{}", text_of(object)));
            let rows = sql(self.reader(), LIST)
                .bind(tenant)
                .bind(after)
                .bind(to_sql(limit as u64))
                .bind(filter.since_ms.unwrap_or(i64::MIN))
                .bind(filter.until_ms.unwrap_or(i64::MAX))
                .bind(filter.key.as_deref())
                .bind(filter.operation.as_deref())
                .bind(object)
                .bind(filter.status.map(i64::from))
                .all()
                .await?;
            rows.iter().map(read_entry).collect()
        })
    }

    /// Removes the entries before `before_ms` from the beginning of all trails; returns their number.
    ///
    /// # Errors
    /// Database errors; entries already removed stay removed, and every trail remains valid.
    pub fn prune_audit(&self, before_ms: i64) -> Answer<'_, u64> {
        Box::pin(async move {
            let mut removed = 0;
            for Chain { tenant, .. } in self.audit_chains().await? {
                removed += self.prune_audit_of(&tenant, before_ms).await?;
            }
            Ok(removed)
        })
    }

    /// Removes the entries before `before_ms` from the beginning of a tenant's trail; returns their number.
    ///
    /// # Errors
    /// Database errors; entries already removed stay removed, and the trail remains valid.
    pub fn prune_audit_of<'a>(&'a self, tenant: &'a str, before_ms: i64) -> Answer<'a, u64> {
        Box::pin(async move {
            let mut removed = 0;
            loop {
                let mut transaction = self.begin_note(SCOPE).await?;
                let piece = prune(&mut transaction, tenant, before_ms).await?;
                transaction.commit().await?;
                removed += piece;
                if piece == 0 {
                    return Ok(removed);
                }
            }
        })
    }

    /// Position and digest of the last entry removed from a tenant's trail; 0 and [`FIRST_LINK`] if none was.
    ///
    /// # Errors
    /// Database errors.
    pub fn audit_beginning<'a>(&'a self, tenant: &'a str) -> Answer<'a, (u64, Digest)> {
        Box::pin(async move {
            let head = sql(self.reader(), HEAD).bind(tenant).optional().await?;
            head.map_or(Ok((0, FIRST_LINK)), |head| Ok(read_chain(&head)?.from))
        })
    }

    /// Verifies every trail from its beginning to its head.
    ///
    /// # Errors
    /// [`StoreError::Damaged`] with the position at which a chain is broken.
    pub fn check_audit(&self) -> Answer<'_, AuditCheck> {
        Box::pin(async move {
            let mut found = AuditCheck::default();
            for chain in self.audit_chains().await? {
                found.tenants += 1;
                found.entries += self.check_chain(&chain).await?;
            }
            Ok(found)
        })
    }

    async fn audit_chains(&self) -> Result<Vec<Chain>, StoreError> {
        const HEADS: &str = "SELECT * FROM audit_head ORDER BY tenant";
        let rows = sql(self.reader(), HEADS).all().await?;
        rows.iter().map(read_chain).collect()
    }

    /// Verifies one trail; returns its number of entries.
    async fn check_chain(&self, chain: &Chain) -> Result<u64, StoreError> {
        const PIECE_OF: &str = "SELECT * FROM audit WHERE tenant = $1 AND sequence > $2 AND sequence <= $3
            ORDER BY sequence LIMIT $4";
        let (mut place, mut link) = chain.from;
        while place < chain.to.0 {
            let rows = sql(self.reader(), PIECE_OF)
                .bind(&chain.tenant)
                .bind(to_sql(place))
                .bind(to_sql(chain.to.0))
                .bind(to_sql(PIECE))
                .all()
                .await?;
            if rows.is_empty() {
                return Err(broken(&chain.tenant, place + 1));
            }
            for row in &rows {
                let recorded = read_entry(row)?;
                if recorded.sequence != place + 1 || recorded.digest != recorded.expected_digest(&link) {
                    return Err(broken(&chain.tenant, place + 1));
                }
                (place, link) = (recorded.sequence, recorded.digest);
            }
        }
        if link != chain.to.1 {
            return Err(broken(&chain.tenant, place));
        }
        Ok(chain.to.0 - chain.from.0)
    }
}

fn broken(tenant: &str, place: u64) -> StoreError {
    StoreError::Damaged { detail: format!("the audit trail of tenant {tenant:?} is broken at entry {place}") }
}

/// Appends entries of one tenant within a transaction.
async fn append(transaction: &mut Transaction, tenant: &str, entries: &[&Entry]) -> Result<(), StoreError> {
    // Also locks the head until the end of the transaction, which excludes other writers.
    const ADVANCE: &str =
        "INSERT INTO audit_head (tenant, sequence, digest, removed_sequence, removed_digest)
        VALUES ($1, $2, $3, 0, $3)
        ON CONFLICT (tenant) DO UPDATE SET sequence = audit_head.sequence + $2 RETURNING sequence, digest";
    const LINK: &str = "UPDATE audit_head SET digest = $2 WHERE tenant = $1";
    let count = entries.len() as u64;
    let row = sql(&mut *transaction, ADVANCE)
        .bind(tenant)
        .bind(to_sql(count))
        .bind(FIRST_LINK.to_vec())
        .one()
        .await?;
    let mut place = from_sql(row.get("sequence")?) - count;
    let mut link = read_digest(row.get("digest")?)?;
    let chained = entries.iter().map(|entry| {
        let recorded = Recorded::after(place, &link, (*entry).clone());
        (place, link) = (recorded.sequence, recorded.digest);
        recorded
    });
    let chained: Vec<Recorded> = chained.collect();
    for rows in rows_of_inserts(&chained) {
        insert(transaction, rows).await?;
    }
    sql(&mut *transaction, LINK).bind(tenant).bind(link.to_vec()).execute().await?;
    Ok(())
}

/// Inserts entries in one statement: each statement is a round trip to the database.
async fn insert(transaction: &mut Transaction, entries: &[Recorded]) -> Result<(), StoreError> {
    const INSERT: &str =
        "INSERT INTO audit (tenant, sequence, at_ms, caller, subject, operation, method, route,
        objects, status, request_id, remote, digest) VALUES ";
    let mut query = sql(transaction, INSERT);
    for (i, Recorded { sequence, digest, entry, .. }) in entries.iter().enumerate() {
        query.push(if i == 0 { "(" } else { ", (" }).push_bind(entry.tenant.as_str());
        query.push(", ").push_bind(to_sql(*sequence)).push(", ").push_bind(entry.at_ms);
        for text in [&entry.key, &entry.subject, &entry.operation] {
            query.push(", ").push_bind(text.as_deref());
        }
        query.push(", ").push_bind(entry.method.as_str()).push(", ").push_bind(entry.route.as_deref());
        query.push(", ").push_bind(text_of(&entry.objects)).push(", ").push_bind(entry.status.map(i64::from));
        query.push(", ").push_bind(entry.request_id.as_str()).push(", ").push_bind(entry.remote.as_deref());
        query.push(", ").push_bind(digest.to_vec()).push(")");
    }
    query.execute().await?;
    Ok(())
}

/// Removes the oldest entries of a tenant, at most [`PIECE`], within a transaction; returns their number.
async fn prune(transaction: &mut Transaction, tenant: &str, before_ms: i64) -> Result<u64, StoreError> {
    const YOUNG: &str =
        "SELECT sequence FROM audit WHERE tenant = $1 AND at_ms >= $2 ORDER BY sequence LIMIT 1";
    const LAST: &str = "SELECT digest FROM audit WHERE tenant = $1 AND sequence = $2";
    const REMOVE: &str = "DELETE FROM audit WHERE tenant = $1 AND sequence <= $2";
    const REMEMBER: &str =
        "UPDATE audit_head SET removed_sequence = $2, removed_digest = $3 WHERE tenant = $1";
    let Some(head) = sql(&mut *transaction, HEAD).bind(tenant).optional().await? else { return Ok(0) };
    let Chain { from, to, .. } = read_chain(&head)?;
    let young: Option<i64> =
        sql(&mut *transaction, YOUNG).bind(tenant).bind(before_ms).optional_scalar().await?;
    let old = young.map_or(to.0, |young| from_sql(young - 1));
    let last = old.min(from.0 + PIECE);
    if last <= from.0 {
        return Ok(0);
    }
    let link: Vec<u8> = sql(&mut *transaction, LAST).bind(tenant).bind(to_sql(last)).scalar().await?;
    sql(&mut *transaction, REMOVE).bind(tenant).bind(to_sql(last)).execute().await?;
    sql(&mut *transaction, REMEMBER).bind(tenant).bind(to_sql(last)).bind(link).execute().await?;
    Ok(last - from.0)
}

fn read_chain(row: &Row) -> Result<Chain, StoreError> {
    Ok(Chain {
        tenant: row.get("tenant")?,
        from: (from_sql(row.get("removed_sequence")?), read_digest(row.get("removed_digest")?)?),
        to: (from_sql(row.get("sequence")?), read_digest(row.get("digest")?)?),
    })
}

fn read_entry(row: &Row) -> Result<Recorded, StoreError> {
    let objects: String = row.get("objects")?;
    let status: Option<i64> = row.get("status")?;
    Ok(Recorded {
        sequence: from_sql(row.get("sequence")?),
        entry: Entry {
            at_ms: row.get("at_ms")?,
            tenant: row.get("tenant")?,
            key: row.get("caller")?,
            subject: row.get("subject")?,
            operation: row.get("operation")?,
            method: row.get("method")?,
            route: row.get("route")?,
            objects: serde_json::from_str(&objects).map_err(|_| unreadable())?,
            status: status.map(u16::try_from).transpose().map_err(|_| unreadable())?,
            request_id: row.get("request_id")?,
            remote: row.get("remote")?,
        },
        digest: read_digest(row.get("digest")?)?,
    })
}

fn read_digest(bytes: Vec<u8>) -> Result<Digest, StoreError> {
    <[u8; DIGEST_BYTES]>::try_from(bytes).map_err(|_| unreadable())
}

fn unreadable() -> StoreError {
    StoreError::Damaged { detail: "an entry of the audit trail cannot be read".into() }
}

/// JSON of strings.
fn text_of(value: &impl serde::Serialize) -> String {
    serde_json::to_string(value).expect("texts are JSON")
}
