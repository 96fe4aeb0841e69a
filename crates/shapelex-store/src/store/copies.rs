//! Copies of a store: each has an id, and begins without deliveries.
//!
//! A copy numbers its changes on from where it was made, so that two copies have different changes with the same number. The id of the store
//! is part of the id of every delivery, and a copy delivers nothing until its hooks are resumed.

use uuid::Uuid;

use super::answer::Answer;
use super::engine::{self, Transaction, sql};
use super::error::StoreError;
use super::handle::Store;

/// Id of the row in `probe` that holds the id of the store: like the notes about the clock, it concerns one database only and is not
/// exported.
const IDENTITY: i64 = 5;
/// Reason that the hooks of a copy give.
const REASON: &str = "the store is a copy: resume the hook once this copy is the one that delivers";

impl Store {
    /// Id of this store, which copies do not share; made when it is first needed.
    ///
    /// # Errors
    /// Database errors.
    pub fn identity(&self) -> Answer<'_, String> {
        Box::pin(async move {
            const FIND: &str = "SELECT count FROM probe WHERE id = $1";
            const MAKE: &str = "INSERT INTO probe (id, count) VALUES ($1, $2) ON CONFLICT (id) DO NOTHING";
            let mut found: Option<i64> = sql(self.reader(), FIND).bind(IDENTITY).optional_scalar().await?;
            if found.is_none() {
                // The lower half of such a number is random.
                let random = (Uuid::now_v7().as_u64_pair().1 >> 1) as i64;
                sql(self.writer(), MAKE).bind(IDENTITY).bind(random).execute().await?;
                found = Some(sql(self.writer(), FIND).bind(IDENTITY).scalar().await?);
            }
            Ok(format!("{:016x}", found.unwrap_or_default()))
        })
    }

    /// Makes a copy that was made by other means silent: it gets an id, and its active hooks are paused. Returns their number.
    ///
    /// # Errors
    /// Database errors.
    pub fn silence(&self) -> Answer<'_, u64> {
        Box::pin(async move {
            let mut write = self.begin_write("copy").await?;
            let paused = settle_copy(&mut write, false).await?;
            write.commit().await?;
            Ok(paused)
        })
    }
}

/// Makes a store the copy that it is: it forgets the id of the original, and pauses the active hooks unless they are to `resume`. Returns the
/// number of paused hooks. A schema that has no hooks yet is left as it is.
pub(super) async fn settle_copy(write: &mut Transaction, resume: bool) -> Result<u64, StoreError> {
    const FORGET: &str = "DELETE FROM probe WHERE id = $1";
    const PAUSE: &str =
        "UPDATE hook SET status = 'paused', reason = $1, lease_owner = NULL, lease_until_ms = NULL
        WHERE status = 'active'";
    sql(&mut *write, FORGET).bind(IDENTITY).execute().await?;
    if resume {
        return Ok(0);
    }
    match sql(write, PAUSE).bind(REASON).execute().await {
        Err(error) if engine::is_missing_table(&error) => Ok(0),
        paused => Ok(paused?),
    }
}
