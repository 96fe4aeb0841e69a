//! The list of erasures, and the files of the store written anew after them.
//!
//! Erased rows are overwritten. Other copies of these rows may be left in parts of the files that the database does not use:
//! the embedded one moves rows between pages and leaves copies behind, PostgreSQL keeps earlier versions of rows. Only writing the files
//! anew removes them. The embedded database does so after an erasure, while nothing else writes: at once if the file is small, otherwise
//! by a command, as PostgreSQL.

use std::time::Duration;

use tokio::task::JoinHandle;

use super::answer::Answer;
use super::engine::{Row, Transaction, sql};
use super::error::StoreError;
use super::folder::DATABASE_FILE;
use super::handle::{Store, begin_task};
use super::text::{from_text, to_text};
use crate::domain::erasure::{Erasure, ErasureState, subject_digest};

/// Largest file that is written anew without being asked: on a slow disk nothing else is written for 15 s.
const MOST_BYTES: u64 = 1 << 29;
/// Pause before the log is emptied again, when a reader has kept it.
const PAUSE: Duration = Duration::from_secs(5);
/// Erasures read at once.
const PAGE: i64 = 1000;

impl Store {
    /// The last erasure of a subject of the tenant, if there was one.
    ///
    /// # Errors
    /// Database errors, as for all functions here.
    pub fn find_erasure<'a>(&'a self, subject: &'a str) -> Answer<'a, Option<Erasure>> {
        Box::pin(async move {
            const FIND: &str = "SELECT * FROM erasure WHERE tenant = $1 AND subject = $2";
            let digest = subject_digest(self.tenant(), subject);
            let found = sql(self.reader(), FIND).bind(self.tenant()).bind(digest.as_slice());
            found.optional().await?.as_ref().map(read).transpose()
        })
    }

    /// Erasures of all tenants in the order of tenant and digest, those after the last one of the page before.
    ///
    /// # Errors
    /// Database errors.
    pub fn list_erasures<'a>(&'a self, after: Option<&'a Erasure>) -> Answer<'a, Vec<Erasure>> {
        Box::pin(async move {
            let mut query = sql(self.reader(), "SELECT * FROM erasure WHERE (tenant, subject) > (");
            query.push_bind(after.map_or("", |after| after.tenant.as_str())).push(", ");
            query.push_bind(after.map_or(&[] as &[u8], |after| after.subject.as_slice()));
            query.push(") ORDER BY tenant, subject LIMIT ").push_bind(PAGE);
            query.all().await?.iter().map(read).collect()
        })
    }

    /// Begins to write the file of the embedded database anew if erased shapes may have left copies in it, unless that takes long or the
    /// disk has no room for it. Other writers wait meanwhile; several erasures share it.
    pub fn begin_rewriting(&self) -> JoinHandle<()> {
        let store = self.clone();
        begin_task(Box::pin(async move {
            if let Err(error) = store.rewrite_if_small().await {
                tracing::warn!(%error, "files of the store may still hold copies of erased shapes: `shapelex compact` removes them");
            }
        }))
    }

    async fn rewrite_if_small(&self) -> Result<(), StoreError> {
        let Some(folder) = self.inner.folder.as_deref().filter(|_| !self.inner.pools.is_postgres()) else {
            return Ok(());
        };
        let _turn = self.inner.rewriting.lock().await;
        let pending = self.pending_erasures().await?;
        if pending.is_empty() {
            return Ok(());
        }
        let bytes = std::fs::metadata(folder.join(DATABASE_FILE)).map_or(u64::MAX, |about| about.len());
        // A copy beside the database, and one in its log.
        let has_room = self.free_bytes().is_none_or(|free| free / 2 > bytes);
        let is_small = bytes <= MOST_BYTES && has_room;
        if is_small {
            self.rewrite().await?;
        } else {
            tracing::warn!(
                bytes,
                "the file of the store is not written anew, and may hold copies of erased shapes: `shapelex compact` removes them"
            );
        }
        while !self.inner.pools.fold_log().await? {
            if self.inner.pools.is_closed() {
                return Ok(());
            }
            tokio::time::sleep(PAUSE).await;
        }
        if is_small { self.settle_erasures(&pending).await } else { Ok(()) }
    }

    /// Writes the file of the embedded database anew. Its pages are then in the write-ahead log.
    pub(super) async fn rewrite(&self) -> Result<(), StoreError> {
        sql(self.writer(), "VACUUM").persistent(false).execute().await?;
        Ok(())
    }

    /// Erasures of all tenants that may have left copies in the files.
    pub(super) async fn pending_erasures(&self) -> Result<Vec<Erasure>, StoreError> {
        const PENDING: &str = "SELECT * FROM erasure WHERE state = 'pending'";
        sql(self.reader(), PENDING).all().await?.iter().map(read).collect()
    }

    /// Records that the files were written anew after these erasures; a subject that was erased again meanwhile waits for its turn.
    pub(super) async fn settle_erasures(&self, pending: &[Erasure]) -> Result<(), StoreError> {
        const SETTLE: &str = "UPDATE erasure SET state = 'done'
            WHERE tenant = $1 AND subject = $2 AND erased_at_ms = $3 AND state = 'pending'";
        let mut write = self.begin_write("erasures").await?;
        for Erasure { tenant, subject, erased_at_ms, .. } in pending {
            let settle = sql(&mut write, SETTLE).bind(tenant.as_str()).bind(subject.as_slice());
            settle.bind(*erased_at_ms).execute().await?;
        }
        Ok(write.commit().await?)
    }

    /// Records that the control points of a subject of the tenant, or of all that were erased until `began_ms`, are overwritten.
    pub(super) async fn note_overwritten(
        &self,
        subject: Option<&str>,
        began_ms: i64,
    ) -> Result<(), StoreError> {
        const OVERWRITTEN: &str = "UPDATE erasure SET state = 'pending' WHERE state = 'erasing' AND ";
        let mut note = sql(self.writer(), OVERWRITTEN);
        if let Some(subject) = subject {
            note.push("tenant = ").push_bind(self.tenant());
            note.push(" AND subject = ").push_bind(&subject_digest(self.tenant(), subject)[..]);
        } else {
            note.push("erased_at_ms <= ").push_bind(began_ms);
        }
        note.execute().await?;
        Ok(())
    }
}

/// Records an erasure, in its transaction.
pub(super) async fn record(
    write: &mut Transaction,
    tenant: &str,
    subject: &str,
    now_ms: i64,
) -> Result<(), StoreError> {
    const RECORD: &str = "INSERT INTO erasure (tenant, subject, erased_at_ms, state) VALUES ($1, $2, $3, $4)
        ON CONFLICT (tenant, subject) DO UPDATE
        SET erased_at_ms = excluded.erased_at_ms, state = excluded.state";
    let record = sql(write, RECORD).bind(tenant).bind(&subject_digest(tenant, subject)[..]).bind(now_ms);
    record.bind(to_text(&ErasureState::Erasing)).execute().await?;
    Ok(())
}

fn read(row: &Row) -> Result<Erasure, StoreError> {
    let damaged = |_| StoreError::Damaged { detail: "an unreadable erasure".into() };
    Ok(Erasure {
        tenant: row.get("tenant")?,
        subject: row.get::<&[u8]>("subject")?.try_into().map_err(damaged)?,
        erased_at_ms: row.get("erased_at_ms")?,
        state: from_text(row.get("state")?)?,
    })
}
