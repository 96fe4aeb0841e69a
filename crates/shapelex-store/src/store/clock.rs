//! Notes about the clock, stored in the rows of `probe` after the row of the readiness probe.
//!
//! They concern one database only and are not exported. If there are none yet, the newest time among the data is taken as
//! the last trusted time.

use super::answer::Answer;
use super::engine::sql;
use super::error::StoreError;
use super::handle::Store;

/// Ids of rows in `probe`.
const BELIEVED: i64 = 2;
const CANDIDATE: i64 = 3;
const PROVEN: i64 = 4;

/// Notes about the clock; times in milliseconds since 1970 UTC.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ClockNotes {
    /// Newest trusted time.
    pub believed_ms: Option<i64>,
    /// Last time shown by a clock that is not trusted.
    pub candidate_ms: Option<i64>,
    /// Time for which that clock has advanced plausibly.
    pub proven_ms: i64,
}

impl ClockNotes {
    /// Notes of a trusted clock.
    pub fn believing(now_ms: i64) -> Self {
        Self { believed_ms: Some(now_ms), ..Self::default() }
    }
}

impl Store {
    /// Reads the notes about the clock.
    ///
    /// # Errors
    /// Database errors.
    pub fn clock_notes(&self) -> Answer<'_, ClockNotes> {
        Box::pin(async move {
            const READ: &str = "SELECT id, count FROM probe WHERE id > 1";
            let mut notes = ClockNotes::default();
            for row in sql(self.reader(), READ).all().await? {
                let count: i64 = row.get("count")?;
                match row.get::<i64>("id")? {
                    BELIEVED => notes.believed_ms = Some(count),
                    CANDIDATE => notes.candidate_ms = (count != 0).then_some(count),
                    PROVEN => notes.proven_ms = count,
                    _ => {}
                }
            }
            if notes.believed_ms.is_none() {
                notes.believed_ms = self.newest_ms().await?;
            }
            Ok(notes)
        })
    }

    /// Stores the notes about the clock.
    ///
    /// # Errors
    /// Database errors.
    pub fn note_clock(&self, notes: ClockNotes) -> Answer<'_, ()> {
        Box::pin(async move {
            const NOTE: &str = "INSERT INTO probe (id, count) VALUES ($1, $2), ($3, $4), ($5, $6)
                ON CONFLICT (id) DO UPDATE SET count = excluded.count";
            const FORGET: &str = "DELETE FROM probe WHERE id = $1";
            if notes.believed_ms.is_none() {
                sql(self.writer(), FORGET).bind(BELIEVED).execute().await?;
                return Ok(());
            }
            sql(self.writer(), NOTE)
                .bind(BELIEVED)
                .bind(notes.believed_ms.unwrap_or_default())
                .bind(CANDIDATE)
                .bind(notes.candidate_ms.unwrap_or_default())
                .bind(PROVEN)
                .bind(notes.proven_ms)
                .execute()
                .await?;
            Ok(())
        })
    }

    /// Newest time among the data of all tenants; `None` in an empty store.
    async fn newest_ms(&self) -> Result<Option<i64>, StoreError> {
        const NEWEST: &str = "SELECT max(newest) FROM (
            SELECT max(updated_at_ms) AS newest FROM cohort
            UNION ALL SELECT max(deleted_at_ms) FROM cohort
            UNION ALL SELECT (SELECT a.at_ms FROM audit AS a
                WHERE a.tenant = h.tenant AND a.sequence = h.sequence) FROM audit_head AS h
            UNION ALL SELECT (SELECT c.at_ms FROM change AS c
                WHERE c.tenant = q.tenant AND c.sequence = q.last) FROM change_sequence AS q) AS times";
        Ok(sql(self.reader(), NEWEST).scalar::<Option<i64>>().await?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::domain::audit::Entry;
    use crate::store::tests::{cohort, fresh};

    #[tokio::test]
    async fn notes_come_back_and_before_them_the_newest_time_stands_for_them() {
        let (_folder, store) = fresh().await;
        assert_eq!(store.clock_notes().await.unwrap(), ClockNotes::default());
        store.create_cohort(&cohort("hands"), None).await.unwrap();
        let found = store.clock_notes().await.unwrap();
        assert_eq!(found.believed_ms, Some(12));
        store.append_audit(&[Entry { at_ms: 99, tenant: "a".into(), ..Entry::default() }]).await.unwrap();
        assert_eq!(store.clock_notes().await.unwrap().believed_ms, Some(99));
        store.ready().await.unwrap();
        for notes in [
            ClockNotes { believed_ms: Some(7), candidate_ms: Some(-8), proven_ms: 9 },
            ClockNotes::believing(12),
        ] {
            store.note_clock(notes).await.unwrap();
            assert_eq!(store.clock_notes().await.unwrap(), notes);
        }
    }
}
