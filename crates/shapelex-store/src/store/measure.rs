//! Operational figures of the store: engine, size, length of the queue.

use super::answer::Answer;
use super::engine::sql;
use super::handle::Store;

/// State of the store at one moment.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Measures {
    /// Number of queued jobs.
    pub jobs_queued: u64,
    /// Number of running jobs.
    pub jobs_running: u64,
    /// Time since the longest waiting job became ready to run.
    pub oldest_queued_ms: u64,
    /// Size of the database in bytes.
    pub database_bytes: u64,
}

impl Store {
    /// Current state of the store.
    ///
    /// # Errors
    /// Database errors.
    pub fn measure(&self, now_ms: i64) -> Answer<'_, Measures> {
        Box::pin(async move {
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
                // Jobs to be retried first wait for their time, so this can be negative.
                oldest_queued_ms: u64::try_from(now_ms - oldest).unwrap_or(0),
                database_bytes: bytes.unsigned_abs(),
            })
        })
    }

    /// Number of the last migration applied.
    ///
    /// # Errors
    /// Database errors.
    pub fn schema_version(&self) -> Answer<'_, i64> {
        Box::pin(async move {
            const LAST: &str = "SELECT max(version) FROM _sqlx_migrations";
            Ok(sql(self.reader(), LAST).scalar().await?)
        })
    }

    /// Database engine.
    pub fn engine(&self) -> &'static str {
        if self.inner.pools.is_postgres() { "postgres" } else { "sqlite" }
    }

    /// Free bytes on the disk of the data folder; `None` without a folder, or if the system does not report it.
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
