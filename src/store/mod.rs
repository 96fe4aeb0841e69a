//! Cohorts, shapes, jobs and dictionaries in SQLite or PostgreSQL.
//!
//! ```text
//! cohort ─< chunk ── chunk_data     up to 4096 shapes: points (little-endian f64), weights, checksum
//!              └──< shape           what is known about each, and when it was deleted
//! job ── job_output                   the queue, the history of what is finished, and what came out
//!  └── pass ─< task                  what a job has cut into parts, and the parts
//! dictionary ── dictionary_data     versions that are written once
//! ```
//!
//! A chunk carries the revision of its cohort that brought it, a shape the revision that removed it;
//! the set at revision `r` is therefore fixed for ever:
//! `chunk.revision ≤ r and not (deleted_revision ≤ r)`.
//!
//! A [`Store`] shows what one [`Principal`] may see: the things of its tenant, and of these the cohorts that are open to it.
//!
//! SQLite: one connection writes, in short transactions; four read; the folder belongs to one process. PostgreSQL: any
//! number of processes; writers of one cohort wait for each other, all others do not. The SQL is the same (`engine`).
//! Parts: [`cohorts`], [`upload`] (storing shapes), [`shapes`] (finding, listing, deleting), [`scan`] (reading control points
//! in bulk), [`changes`] (the feed), [`receipts`] (what was done once), `trash`, [`jobs`] (the queue), [`outputs`] (what jobs bring about),
//! [`passes`] (parts of jobs), [`dictionaries`], [`audit`] (who asked for what), [`metrics`] (what is counted), [`maintenance`] (checks, backups, exports of all of it); `blob` turns numbers into bytes and back; `sqlite`, `postgres` (connections, checks, schema), `replica` (which processes live), `clock` (what was believed of it).

pub mod audit;
mod blob;
pub mod changes;
mod clock;
pub mod cohorts;
pub mod dictionaries;
mod engine;
mod filter;
mod folder;
pub mod jobs;
pub mod keys;
pub mod maintenance;
mod mark;
mod measure;
pub mod metrics;
pub mod outputs;
pub mod passes;
mod postgres;
pub mod receipts;
mod replica;
pub mod scan;
pub mod shapes;
mod sqlite;
mod trash;
pub mod upload;

use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

use crate::domain::access::{DEFAULT_TENANT, Principal};
use engine::{Failure, Link, Pools, Transaction, sql};
use folder::FolderLock;
use mark::Mark;
use replica::Replica;

pub use audit::AuditCheck;
pub use clock::ClockNotes;
pub use dictionaries::DictionaryFilter;
pub use filter::Revisions;
pub use jobs::{Claim, Claimed, Release};
pub use measure::Measures;
pub use passes::{PartClaim, PartEnd, PassOf, Start};
pub use scan::{Ids, ScanBatch};
pub use shapes::{Cursor, CursorError, ShapePage};
pub use upload::{Added, Upload};

/// Name of the database file in the data folder.
const DATABASE_FILE: &str = "shapelex.db";
/// Chunks removed in one transaction: some 8 MiB and 30 000 rows, a fraction of a second.
const CHUNKS_PER_PURGE: i64 = 8;

/// The store as a principal sees it. Clones share their connections.
#[derive(Debug, Clone)]
pub struct Store {
    inner: Arc<Inner>,
    principal: Arc<Principal>,
}

#[derive(Debug)]
struct Inner {
    pools: Pools,
    /// The folder of the embedded database, which is this process's own.
    lock: Option<FolderLock>,
    /// How far the embedded database had come.
    mark: Option<Mark>,
    replica: Replica,
    /// Where the folder is.
    folder: Option<PathBuf>,
    /// What is wrong with a large file that was checked beside the service.
    damage: OnceLock<String>,
}

/// Why the store did not do it. What it says ends in the log: never a text that a client has sent.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// Another cohort has the name.
    #[error("the name is taken")]
    NameTaken {
        /// The name asked for.
        name: String,
    },
    /// The external identifier belongs to a shape with other content.
    #[error("the external id of shape {position} belongs to a shape with other content")]
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
    /// The shape is part of an upload that is not finished; it may yet vanish.
    #[error("shape {position}: the external id {external_id:?} is part of an unfinished upload")]
    ExternalIdPending {
        /// Position in the whole upload, from 0.
        position: u64,
        /// The identifier.
        external_id: String,
    },
    /// Another process took this one for dead and removed what it had stored so far.
    #[error("the upload was interrupted, send it again")]
    UploadLost,
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
    /// The newest part of it is missing.
    #[error(
        "the store is older than it was: its last {missing} audit entries are missing, and with them what was acknowledged then. \
         The write-ahead log beside the database (shapelex.db-wal) is missing, cut off or damaged, or the database was replaced. \
         Put the log back or restore a backup; `shapelex serve --accept-loss true` goes on with what is left"
    )]
    Older {
        /// Audit entries that are missing.
        missing: u64,
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
    /// What was given as the place of the database is not one.
    #[error("the address of the database cannot be read: {detail}")]
    Url {
        /// Why, without the address, which may hold a password.
        detail: String,
    },
    /// It is not as it was when the client looked.
    #[error("it was changed meanwhile")]
    Changed,
    /// A request with the same key was done before.
    #[error("the request was done before")]
    AlreadyDone,
    /// Changes that old are not kept any more.
    #[error("changes before number {first} are not kept any more")]
    ChangesGone {
        /// The first that is.
        first: u64,
    },
    /// As many jobs wait as may.
    #[error("{limit} jobs are waiting, no more are taken")]
    TooManyJobs {
        /// Jobs that may wait.
        limit: u32,
    },
    /// The jobs of a tenant that wait, and a new one, are predicted to take too long together.
    #[error(
        "jobs of {waiting:.0} predicted seconds are waiting, at most {limit:.0} may wait together with a new one"
    )]
    TooMuchWork {
        /// Of those that wait.
        waiting: f64,
        /// Of all.
        limit: f64,
    },
    /// No connection became free in time, or the database is away for a moment.
    #[error("the store is busy, try again")]
    Busy,
    /// The disk is full; reading goes on.
    #[error("the disk of the store is full")]
    Full,
    /// The database may only be read.
    #[error("the store can only be read now")]
    ReadOnly,
    /// A text holds the character U+0000.
    #[error("a text holds the character U+0000, which is not stored")]
    Text,
    /// Any other failure of the database.
    #[error("the database failed")]
    Database(#[source] sqlx::Error),
}

impl From<sqlx::Error> for StoreError {
    fn from(error: sqlx::Error) -> Self {
        let failure = engine::failure(&error);
        metrics::failed(failure);
        match failure {
            Some(Failure::Passing) => Self::Busy,
            Some(Failure::Damaged) => Self::Damaged { detail: error.to_string() },
            Some(Failure::Full) => Self::Full,
            Some(Failure::ReadOnly) => Self::ReadOnly,
            Some(Failure::Text) => Self::Text,
            None => Self::Database(error),
        }
    }
}

impl Store {
    /// Opens the store in `data_dir`, creating folder and database when missing.
    ///
    /// Reads the whole file once to check it (a large one beside the service), brings the schema up to date, removes what interrupted uploads
    /// and deletions left behind, and puts interrupted jobs back into the queue.
    ///
    /// # Errors
    /// [`StoreError::Folder`], [`StoreError::Locked`], [`StoreError::TooOld`], [`StoreError::Older`],
    /// [`StoreError::Damaged`] and [`StoreError::Schema`] when the folder cannot be used as it is.
    pub async fn open(data_dir: &Path) -> Result<Self, StoreError> {
        Self::open_locked(data_dir, false).await
    }

    /// The same, going on with what is left when the newest part of the store is missing.
    ///
    /// # Errors
    /// Those of [`Store::open`] but [`StoreError::Older`].
    pub async fn open_accepting_loss(data_dir: &Path) -> Result<Self, StoreError> {
        Self::open_locked(data_dir, true).await
    }

    async fn open_locked(data_dir: &Path, accepts_loss: bool) -> Result<Self, StoreError> {
        let lock = FolderLock::take(data_dir)?;
        match mark::require(data_dir).await {
            Err(StoreError::Older { missing }) if accepts_loss => {
                tracing::warn!(missing, "the newest part of the store is missing, which is accepted");
            }
            marked => marked?,
        }
        folder::protect(data_dir)?;
        let file = data_dir.join(DATABASE_FILE);
        let is_small = sqlite::is_small(&file);
        let pools = sqlite::open(&file, is_small).await?;
        let mark = begin_mark(&pools, data_dir).await?;
        let store = Self::new(pools, Some(lock), mark, Some(data_dir.into()));
        if !is_small {
            store.check_beside();
        }
        store.purge(PURGE_PENDING, None).await?;
        store.purge(PURGE_ORPHANS, None).await?;
        store.requeue_interrupted_jobs().await?;
        Ok(store)
    }

    /// Opens the store in `data_dir` beside the process that may be using it, for short work: nothing is checked or tidied
    /// up, and its writes wait for their turn.
    ///
    /// # Errors
    /// [`StoreError::Folder`] when there is no store, [`StoreError::TooOld`], [`StoreError::Older`], [`StoreError::Schema`].
    pub async fn attach(data_dir: &Path) -> Result<Self, StoreError> {
        let file = data_dir.join(DATABASE_FILE);
        if let Err(source) = std::fs::metadata(&file) {
            return Err(StoreError::Folder { path: data_dir.to_path_buf(), source });
        }
        mark::require(data_dir).await?;
        Ok(Self::new(sqlite::attach(&file).await?, None, None, Some(data_dir.into())))
    }

    /// Opens the store in the database at `url` (`postgres://…`), whoever else uses it, with at most so many `connections`, and
    /// brings the schema up to date.
    ///
    /// # Errors
    /// [`StoreError::Url`], [`StoreError::Schema`]; [`StoreError::Busy`] while the database is not there.
    pub async fn connect(url: &str, connections: u32) -> Result<Self, StoreError> {
        let options = postgres::options(url)?;
        let pool = postgres::connect(options.clone(), connections).await?;
        let store = Self::new(Pools::Postgres(pool), None, None, None);
        store.purge(PURGE_ORPHANS, None).await?;
        store.live(options).await?;
        Ok(store)
    }

    fn new(pools: Pools, lock: Option<FolderLock>, mark: Option<Mark>, folder: Option<PathBuf>) -> Self {
        Self::around(Arc::new(Inner {
            pools,
            lock,
            mark,
            folder,
            replica: Replica::new(),
            damage: OnceLock::new(),
        }))
    }

    fn around(inner: Arc<Inner>) -> Self {
        Self { inner, principal: Arc::new(Principal::system(DEFAULT_TENANT)) }
    }

    /// Checks the file while the service runs: whoever waits for readiness hears of damage then.
    fn check_beside(&self) {
        let store = self.clone();
        tokio::spawn(async move {
            let found = sql(store.reader(), sqlite::QUICK_CHECK).scalar::<String>().await;
            let detail = match found {
                Ok(found) if found == sqlite::SOUND => return,
                Ok(found) => found,
                Err(error) => error.to_string(),
            };
            tracing::error!(detail, "the database is damaged: restore a backup");
            // Checked once.
            let _ = store.inner.damage.set(detail);
        });
    }

    /// The same store as `principal` sees it.
    pub fn of(&self, principal: Arc<Principal>) -> Self {
        Self { inner: Arc::clone(&self.inner), principal }
    }

    /// Whether the store can write now.
    ///
    /// Waits for its turn behind other writers, so that the caller may want a timeout.
    ///
    /// # Errors
    /// [`StoreError::Full`] or [`StoreError::ReadOnly`], for example; [`StoreError::Damaged`] when the check of a large file
    /// has found something.
    pub async fn ready(&self) -> Result<(), StoreError> {
        if let Some(detail) = self.inner.damage.get() {
            return Err(StoreError::Damaged { detail: detail.clone() });
        }
        const PROBE: &str = "INSERT INTO probe (id, count) VALUES (1, 1)
            ON CONFLICT (id) DO UPDATE SET count = probe.count + 1";
        sql(self.writer(), PROBE).execute().await?;
        Ok(())
    }

    /// Waits for work in progress, closes all connections and frees the data folder. The file of the embedded database then holds
    /// everything.
    pub async fn close(&self) {
        if self.inner.lock.is_some()
            && let Err(error) = self.inner.pools.fold_log().await
        {
            // It stays where it is, and is read at the next start.
            tracing::warn!(%error, "the write-ahead log could not be folded into the database");
        }
        self.inner.pools.close().await;
        if let Some(mark) = &self.inner.mark {
            mark.sync();
        }
        if let Some(lock) = &self.inner.lock {
            lock.free();
        }
    }

    /// So many audit entries have been committed.
    fn mark_entries(&self, count: usize) {
        if let Some(mark) = &self.inner.mark {
            mark.advance(count as u64);
        }
    }

    /// Runs a statement that the store itself never runs.
    #[cfg(test)]
    pub(crate) async fn meddle(&self, statement: &'static str) {
        sql(self.writer(), statement).execute().await.expect("a statement of a test");
    }

    fn tenant(&self) -> &str {
        &self.principal.tenant
    }

    /// What a name of this tenant is stored as where it must be unique.
    fn handle(&self, name: &str) -> String {
        handle(self.tenant(), name)
    }

    /// Where statements that only read go.
    fn reader(&self) -> Link<'_> {
        self.inner.pools.reader()
    }

    /// Where single statements that write go.
    fn writer(&self) -> Link<'_> {
        self.inner.pools.writer()
    }

    /// Begins a transaction that reads one state of the database.
    async fn begin_read(&self) -> Result<Transaction, StoreError> {
        Ok(self.inner.pools.begin_read().await?)
    }

    /// Begins a transaction that no other one of the same `scope`, such as the id of a cohort, overlaps.
    async fn begin_write(&self, scope: &str) -> Result<Transaction, StoreError> {
        Ok(self.inner.pools.begin_write(scope).await?)
    }

    /// Runs one of the `PURGE_` statements until nothing is left, letting other writers in between.
    async fn purge(&self, statement: &'static str, upload: Option<&str>) -> Result<(), StoreError> {
        loop {
            let query = sql(self.writer(), statement).bind(CHUNKS_PER_PURGE);
            let query = match upload {
                Some(upload) => query.bind(upload.to_owned()),
                None => query,
            };
            if query.execute().await? == 0 {
                return Ok(());
            }
        }
    }
}

/// What a name of a tenant is stored as where it must be unique.
fn handle(tenant: &str, name: &str) -> String {
    format!("{tenant}/{name}")
}

/// Removes chunks of unfinished uploads: only at start, when no upload can be in progress.
const PURGE_PENDING: &str = "DELETE FROM chunk WHERE revision IS NULL AND id IN
    (SELECT id FROM chunk WHERE revision IS NULL LIMIT $1)";
/// Removes chunks of deleted cohorts.
const PURGE_ORPHANS: &str = "DELETE FROM chunk WHERE id IN
    (SELECT id FROM chunk WHERE cohort IS NULL LIMIT $1)";
/// Removes chunks of one unfinished upload.
///
/// What is pending is asked twice: PostgreSQL, when it has waited for the commit that makes a chunk visible, looks at the
/// condition of the DELETE again, but not into the list, and would remove what was just acknowledged.
const PURGE_UPLOAD: &str = "DELETE FROM chunk WHERE revision IS NULL AND id IN
    (SELECT id FROM chunk WHERE revision IS NULL AND upload = $2 LIMIT $1)";

/// The mark of a store that has just been opened. None when there is no room for it: the store works without.
async fn begin_mark(pools: &Pools, data_dir: &Path) -> Result<Option<Mark>, StoreError> {
    let entries = mark::entries(pools.reader()).await?;
    let mark = Mark::begin(data_dir, entries);
    if let Err(error) = &mark {
        tracing::warn!(%error, "the mark of the store cannot be written: a missing write-ahead log will not be noticed");
    }
    Ok(mark.ok())
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
