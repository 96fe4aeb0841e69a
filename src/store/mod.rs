//! Cohorts, shapes, jobs and dictionaries in SQLite.
//!
//! ```text
//! cohort ─< chunk ── chunk_data     up to 4096 shapes: points (little-endian f64), weights, checksum
//!              └──< shape           what is known about each, and when it was deleted
//! job ── job_output                   the queue, the history of what is finished, and what came out
//! dictionary ── dictionary_data     versions that are written once
//! ```
//!
//! A chunk carries the revision of its cohort that brought it, a shape the revision that removed it;
//! the set at revision `r` is therefore fixed for ever:
//! `chunk.revision ≤ r and not (deleted_revision ≤ r)`.
//!
//! One connection writes, in short transactions; four read. Parts:
//! [`cohorts`], [`upload`] (storing shapes), [`shapes`] (finding, listing, deleting), [`scan`] (reading
//! control points in bulk), [`jobs`] (the queue), [`outputs`] (what jobs bring about), [`dictionaries`]; `blob` turns numbers into bytes and back.

mod blob;
pub mod cohorts;
pub mod dictionaries;
mod filter;
pub mod jobs;
pub mod outputs;
pub mod scan;
pub mod shapes;
mod sqlite;
pub mod upload;

use std::fs::{File, TryLockError};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use sqlx::{Sqlite, SqlitePool, Transaction};

pub use dictionaries::DictionaryFilter;
pub use filter::Revisions;
pub use jobs::{Claim, Claimed, Release};
pub use scan::{Ids, ScanBatch};
pub use shapes::{Cursor, CursorError, ShapePage};
pub use upload::{Added, Upload};

/// Name of the database file in the data folder.
const DATABASE_FILE: &str = "shapelex.db";
/// Name of the file whose lock says that a process uses the folder.
const LOCK_FILE: &str = "shapelex.lock";
/// Chunks removed in one transaction: some 8 MiB and 30 000 rows, a fraction of a second.
const CHUNKS_PER_PURGE: i64 = 8;

/// The store. Clones share their connections.
#[derive(Debug, Clone)]
pub struct Store(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    writer: SqlitePool,
    reader: SqlitePool,
    lock: File,
}

/// Why the store did not do it.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// Another cohort has the name.
    #[error("the name {name:?} is taken")]
    NameTaken {
        /// The name asked for.
        name: String,
    },
    /// The external identifier belongs to a shape with other content, or to an unfinished upload.
    #[error("shape {position}: the external id {external_id:?} belongs to a shape with other content")]
    ExternalIdConflict {
        /// Position in the whole upload, from 0.
        position: u64,
        /// The identifier.
        external_id: String,
    },
    /// A shape has more or fewer numbers than the representation of its cohort.
    #[error("shape {position} has {found} numbers, expected {expected}")]
    WrongWidth {
        /// Position in the whole upload, from 0.
        position: u64,
        /// Its numbers.
        found: usize,
        /// `N·d` of the cohort.
        expected: usize,
    },
    /// The cohort was deleted.
    #[error("the cohort no longer exists")]
    CohortGone,
    /// Stored control points do not have their checksum.
    #[error("stored control points are damaged (chunk {chunk}): restore a backup")]
    Corrupt {
        /// Number of the chunk.
        chunk: i64,
    },
    /// The database is not what this program wrote.
    #[error("the database is damaged: restore a backup")]
    Damaged {
        /// What is wrong, for the log.
        detail: String,
    },
    /// Another process uses the data folder.
    #[error("the data folder {} is in use by another process", path.display())]
    Locked {
        /// The folder.
        path: PathBuf,
    },
    /// The SQLite library has a known fault.
    #[error("SQLite {version} is too old, at least 3.51.3 is needed")]
    TooOld {
        /// Its version.
        version: String,
    },
    /// The data folder cannot be used.
    #[error("the data folder {} cannot be used: {source}", path.display())]
    Folder {
        /// The folder.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// The schema cannot be brought up to date, for example because a newer program wrote it.
    #[error("the database schema does not fit this program")]
    Schema(#[source] sqlx::migrate::MigrateError),
    /// As many jobs wait as may.
    #[error("{limit} jobs are waiting, no more are taken")]
    TooManyJobs {
        /// Jobs that may wait.
        limit: u32,
    },
    /// No connection became free in time.
    #[error("the store is busy, try again")]
    Busy,
    /// Any other failure of the database.
    #[error("the database failed")]
    Database(#[source] sqlx::Error),
}

impl From<sqlx::Error> for StoreError {
    fn from(error: sqlx::Error) -> Self {
        if matches!(error, sqlx::Error::PoolTimedOut) {
            return Self::Busy;
        }
        if sqlite::is_damage(&error) {
            let detail = error.to_string();
            return Self::Damaged { detail };
        }
        Self::Database(error)
    }
}

impl Store {
    /// Opens the store in `data_dir`, creating folder and database when missing.
    ///
    /// Reads the whole file once to check it, brings the schema up to date, removes what interrupted uploads
    /// and deletions left behind, and puts interrupted jobs back into the queue.
    ///
    /// # Errors
    /// [`StoreError::Folder`], [`StoreError::Locked`], [`StoreError::TooOld`],
    /// [`StoreError::Damaged`] and [`StoreError::Schema`] when the folder cannot be used as it is.
    pub async fn open(data_dir: &Path) -> Result<Self, StoreError> {
        let lock = lock_folder(data_dir)?;
        let file = data_dir.join(DATABASE_FILE);
        let writer = sqlite::writer(&file).await?;
        sqlite::check_version(&writer).await?;
        sqlite::check_file(&writer).await?;
        sqlite::migrate(&writer).await?;
        let reader = sqlite::reader(&file).await?;
        let store = Self(Arc::new(Inner { writer, reader, lock }));
        store.purge(PURGE_PENDING, None).await?;
        store.purge(PURGE_ORPHANS, None).await?;
        store.requeue_interrupted_jobs().await?;
        Ok(store)
    }

    /// Whether the store can write now.
    ///
    /// Waits for its turn behind other writers, so that the caller may want a timeout.
    ///
    /// # Errors
    /// [`StoreError::Database`] on a disk that is full or read-only, for example.
    pub async fn ready(&self) -> Result<(), StoreError> {
        const PROBE: &str = "INSERT INTO probe (id, count) VALUES (1, 1)
            ON CONFLICT (id) DO UPDATE SET count = count + 1";
        sqlx::query(PROBE).execute(&self.0.writer).await?;
        Ok(())
    }

    /// Waits for work in progress, closes all connections and frees the data folder.
    pub async fn close(&self) {
        self.0.reader.close().await;
        // The writer last: the last connection to leave folds the write-ahead log into the file.
        self.0.writer.close().await;
        // The lock also ends with the process; nothing is lost when this fails.
        let _ = self.0.lock.unlock();
    }

    /// Connections for reading.
    fn reader(&self) -> &SqlitePool {
        &self.0.reader
    }

    /// Begins a transaction that holds the write lock from the start.
    async fn begin_write(&self) -> Result<Transaction<'static, Sqlite>, StoreError> {
        Ok(self.0.writer.begin_with("BEGIN IMMEDIATE").await?)
    }

    /// Runs one of the `PURGE_` statements until nothing is left, letting other writers in between.
    async fn purge(&self, statement: &'static str, upload: Option<&str>) -> Result<(), StoreError> {
        loop {
            let query = sqlx::query(statement).bind(CHUNKS_PER_PURGE).bind(upload);
            if query.execute(&self.0.writer).await?.rows_affected() == 0 {
                return Ok(());
            }
        }
    }
}

/// Removes chunks of unfinished uploads: only at start, when no upload can be in progress.
const PURGE_PENDING: &str = "DELETE FROM chunk WHERE id IN
    (SELECT id FROM chunk WHERE revision IS NULL LIMIT $1)";
/// Removes chunks of deleted cohorts.
const PURGE_ORPHANS: &str = "DELETE FROM chunk WHERE id IN
    (SELECT id FROM chunk WHERE cohort IS NULL LIMIT $1)";
/// Removes chunks of one unfinished upload.
const PURGE_UPLOAD: &str = "DELETE FROM chunk WHERE id IN
    (SELECT id FROM chunk WHERE revision IS NULL AND upload = $2 LIMIT $1)";

/// Creates the folder and locks it for this process.
fn lock_folder(data_dir: &Path) -> Result<File, StoreError> {
    let path = data_dir.to_path_buf();
    let lock = std::fs::create_dir_all(data_dir)
        .and_then(|()| File::create(data_dir.join(LOCK_FILE)))
        .map_err(|source| StoreError::Folder { path: path.clone(), source })?;
    match lock.try_lock() {
        Ok(()) => Ok(lock),
        Err(TryLockError::WouldBlock) => Err(StoreError::Locked { path }),
        Err(TryLockError::Error(source)) => Err(StoreError::Folder { path, source }),
    }
}

/// Runs arithmetic longer than a millisecond away from the threads that serve requests.
async fn blocking<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> T {
    match tokio::task::spawn_blocking(work).await {
        Ok(value) => value,
        Err(error) => std::panic::resume_unwind(error.into_panic()),
    }
}

/// An unsigned number for SQLite, whose integers are signed; too large ones mean "the last".
fn to_sql(number: u64) -> i64 {
    i64::try_from(number).unwrap_or(i64::MAX)
}

/// An unsigned number from SQLite; the schema never stores negative ones.
fn from_sql(number: i64) -> u64 {
    u64::try_from(number).unwrap_or_default()
}

#[cfg(test)]
mod tests;
