//! Change feed, numbered in commit order, without gaps that could be filled later.

use super::answer::Answer;
use super::engine::{Row, Transaction, sql};
use super::engine::{from_sql, to_sql};
use super::error::StoreError;
use super::handle::Store;
use super::text::{from_text, to_text};
use crate::domain::change::{Change, NewChange};

/// Number of changes kept per tenant; older ones are removed.
pub const MAX_CHANGES: u64 = 1_000_000;

impl Store {
    /// At most `limit` changes after number `since`, in order, restricted to objects that the caller may see.
    ///
    /// # Errors
    /// [`StoreError::ChangesGone`] if some of them are no longer kept.
    pub fn list_changes(&self, since: u64, limit: usize) -> Answer<'_, Vec<Change>> {
        Box::pin(async move {
            const FIRST: &str = "SELECT coalesce(min(sequence), 0) FROM change WHERE tenant = $1";
            let mut read = self.begin_read().await?;
            let first: i64 = sql(&mut read, FIRST).bind(self.tenant()).scalar().await?;
            if to_sql(since).saturating_add(1) < first {
                return Err(StoreError::ChangesGone { first: from_sql(first) });
            }
            let mut query = sql(&mut read, "SELECT * FROM change WHERE tenant = ");
            query.push_bind(self.tenant()).push(" AND sequence > ").push_bind(to_sql(since));
            self.push_scope(&mut query, "cohort");
            query.push(" ORDER BY sequence LIMIT ").push_bind(to_sql(limit as u64));
            query.all().await?.iter().map(read_change).collect()
        })
    }

    /// Number of the last change, 0 if there is none.
    ///
    /// # Errors
    /// Database errors.
    pub fn last_change(&self) -> Answer<'_, u64> {
        Box::pin(async move {
            const LAST: &str = "SELECT last FROM change_sequence WHERE tenant = $1";
            let last: Option<i64> = sql(self.reader(), LAST).bind(self.tenant()).optional_scalar().await?;
            Ok(from_sql(last.unwrap_or_default()))
        })
    }
}

/// Records a change as the last statement of its transaction. The number is drawn under a lock held until the commit, so
/// that a reader that has seen a number has seen all before it.
pub(super) async fn record(
    write: &mut Transaction,
    tenant: &str,
    change: &NewChange<'_>,
    now_ms: i64,
) -> Result<(), StoreError> {
    const NEXT: &str = "INSERT INTO change_sequence (tenant, last) VALUES ($1, 1)
        ON CONFLICT (tenant) DO UPDATE SET last = change_sequence.last + 1 RETURNING last";
    const RECORD: &str = "INSERT INTO change
        (tenant, sequence, at_ms, kind, object, cohort, revision, shapes, shape_ids)
        VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9)";
    const PRUNE: &str = "DELETE FROM change WHERE tenant = $1 AND sequence <= $2";
    let sequence: i64 = sql(&mut *write, NEXT).bind(tenant).scalar().await?;
    sql(&mut *write, RECORD)
        .bind(tenant)
        .bind(sequence)
        .bind(now_ms)
        .bind(to_text(&change.kind))
        .bind(change.object)
        .bind(change.cohort)
        .bind(change.revision.map(to_sql))
        .bind(change.shapes.map(to_sql))
        .bind(change.shape_ids.map(|ids| to_text(&ids)))
        .execute()
        .await?;
    let last_gone = sequence - to_sql(MAX_CHANGES);
    if last_gone > 0 {
        sql(&mut *write, PRUNE).bind(tenant).bind(last_gone).execute().await?;
    }
    Ok(())
}

fn read_change(row: &Row) -> Result<Change, StoreError> {
    let number = |column: &str| -> Result<Option<u64>, StoreError> {
        Ok(row.get::<Option<i64>>(column)?.map(from_sql))
    };
    Ok(Change {
        sequence: from_sql(row.get("sequence")?),
        at_ms: row.get("at_ms")?,
        kind: from_text(row.get("kind")?)?,
        object: row.get("object")?,
        cohort: row.get("cohort")?,
        revision: number("revision")?,
        shapes: number("shapes")?,
        shape_ids: row.get::<Option<&str>>("shape_ids")?.map(from_text).transpose()?,
    })
}
