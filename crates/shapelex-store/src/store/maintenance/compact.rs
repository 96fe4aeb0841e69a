//! The files of a store written anew: nothing is left of rows that were removed or changed, such as those of erased shapes.

use std::time::Duration;

use super::super::answer::Answer;
use super::super::engine::sql;
use super::super::handle::Store;
use super::MaintenanceError;
use super::tables::TABLES;

/// Attempts to empty the log of the embedded database while others read, and the pause between them.
const ATTEMPTS: usize = 12;
const PAUSE: Duration = Duration::from_secs(5);
/// Where PostgreSQL keeps the most common values of columns.
const STATISTICS: &str = "VACUUM (FULL) pg_catalog.pg_statistic";

impl Store {
    /// Completes erasures, then writes the file of the embedded database anew and empties its log, or writes the tables, indexes and
    /// statistics in PostgreSQL anew; returns the number of erasures of which nothing is left. Others wait meanwhile.
    ///
    /// # Errors
    /// [`MaintenanceError::Read`] if others read for so long that the log cannot be emptied; those of the database.
    pub fn compact(&self, now_ms: i64) -> Answer<'_, usize, MaintenanceError> {
        Box::pin(async move {
            self.finish_erasures(None, now_ms).await?;
            let pending = self.pending_erasures().await?;
            if self.is_embedded() {
                self.rewrite().await?;
                self.empty_log().await?;
            } else {
                for table in TABLES {
                    let mut anew = sql(self.writer(), "VACUUM (FULL, ANALYZE) ").persistent(false);
                    anew.push(table.name);
                    anew.execute().await?;
                }
                sql(self.writer(), STATISTICS).persistent(false).execute().await?;
            }
            self.settle_erasures(&pending).await?;
            Ok(pending.len())
        })
    }

    async fn empty_log(&self) -> Result<(), MaintenanceError> {
        for _ in 0..ATTEMPTS {
            if self.inner.pools.fold_log().await? {
                return Ok(());
            }
            tokio::time::sleep(PAUSE).await;
        }
        Err(MaintenanceError::Read)
    }
}
