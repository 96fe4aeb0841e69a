//! What operators ask of the store: its engine, its size, the length of the queue.

use super::engine::sql;
use super::error::StoreError;
use super::handle::Store;

/// The state of the store at a moment.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Measures {
    /// Jobs that wait.
    pub jobs_queued: u64,
    /// Jobs that run.
    pub jobs_running: u64,
    /// Time since the job that waits longest could have begun.
    pub oldest_queued_ms: u64,
    /// Size of the database.
    pub database_bytes: u64,
}

impl Store {
    /// The state now.
    ///
    /// # Errors
    /// Those of the database.
    pub async fn measure(&self, now_ms: i64) -> Result<Measures, StoreError> {
        const COUNT: &str = "SELECT count(*) FROM job WHERE status = $1";
        const OLDEST: &str = "SELECT coalesce(min(run_at_ms), $1) FROM job WHERE status = 'queued'";
        const SQLITE: &str = "SELECT page_count * page_size FROM pragma_page_count(), pragma_page_size()";
        const POSTGRES: &str = "SELECT pg_database_size(current_database())";
        let count = async |status: &str| sql(self.reader(), COUNT).bind(status).scalar::<i64>().await;
        let oldest: i64 = sql(self.reader(), OLDEST).bind(now_ms).scalar().await?;
        let size = if self.inner.pools.is_postgres() { POSTGRES } else { SQLITE };
        let bytes: i64 = sql(self.reader(), size).scalar().await?;
        Ok(Measures {
            jobs_queued: count("queued").await?.unsigned_abs(),
            jobs_running: count("running").await?.unsigned_abs(),
            // Retries wait for their time first.
            oldest_queued_ms: u64::try_from(now_ms - oldest).unwrap_or(0),
            database_bytes: bytes.unsigned_abs(),
        })
    }

    /// Number of the last step of the schema that was taken.
    ///
    /// # Errors
    /// Those of the database.
    pub async fn schema_version(&self) -> Result<i64, StoreError> {
        const LAST: &str = "SELECT max(version) FROM _sqlx_migrations";
        Ok(sql(self.reader(), LAST).scalar().await?)
    }

    /// The database engine.
    pub fn engine(&self) -> &'static str {
        if self.inner.pools.is_postgres() { "postgres" } else { "sqlite" }
    }

    /// Free space where the data folder is; none when there is no folder, or the system does not say.
    pub fn free_bytes(&self) -> Option<u64> {
        free_bytes(self.inner.folder.as_deref()?)
    }
}

#[cfg(unix)]
fn free_bytes(folder: &std::path::Path) -> Option<u64> {
    let found = rustix::fs::statvfs(folder).ok()?;
    Some(found.f_bavail.saturating_mul(found.f_frsize))
}

#[cfg(not(unix))]
fn free_bytes(_: &std::path::Path) -> Option<u64> {
    None
}
