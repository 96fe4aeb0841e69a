//! The store as a principal sees it: opened, closed, its connections and transactions.

use std::any::Any;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use tokio::task::JoinHandle;

use super::answer::{Answer, Work};
use super::engine::{Link, Pools, Transaction, sql};
use super::error::StoreError;
use super::folder::{DATABASE_FILE, FolderLock};
use super::known_names::{KnownNames, Writes};
use super::mark::Mark;
use super::replica::Replica;
use super::{folder, mark, postgres, sqlite};
use crate::domain::access::{DEFAULT_TENANT, Principal};

/// Time for which a probe that found room for a change stands for others.
const ROOM_FOR: Duration = Duration::from_secs(60);
/// Free bytes of the disk below which it does not.
const LITTLE_ROOM: u64 = 64 << 20;

/// Chunks removed in one transaction: some 8 MiB and 30 000 rows, a fraction of a second.
pub(super) const CHUNKS_PER_PURGE: i64 = 8;

/// The store as a principal sees it. Clones share their connections.
#[derive(Debug, Clone)]
pub struct Store {
    pub(super) inner: Arc<Inner>,
    pub(super) principal: Arc<Principal>,
}

#[derive(Debug)]
pub(super) struct Inner {
    pub(super) pools: Pools,
    /// The folder of the embedded database, which is this process's own.
    pub(super) lock: Option<FolderLock>,
    /// How far the embedded database had come.
    pub(super) mark: Option<Mark>,
    pub(super) replica: Replica,
    /// Where the folder is.
    pub(super) folder: Option<PathBuf>,
    /// Fault of a large file that was checked beside the service.
    pub(super) damage: OnceLock<String>,
    /// When a probe found room for a change.
    found_room: Mutex<Option<Instant>>,
    /// Transactions that have changed something.
    pub(super) writes: Writes,
    /// Ids of names of dictionaries.
    pub(super) names: KnownNames,
    /// Held while the file of the embedded database is written anew.
    pub(super) rewriting: tokio::sync::Mutex<()>,
}

impl Store {
    /// Opens the store in `data_dir`, creating folder and database when missing.
    ///
    /// Reads the whole file once to check it (a large one beside the service), brings the schema up to date, removes leftovers of interrupted uploads
    /// and deletions, and puts interrupted jobs back into the queue.
    ///
    /// # Errors
    /// [`StoreError::Folder`], [`StoreError::Locked`], [`StoreError::TooOld`], [`StoreError::Older`],
    /// [`StoreError::Damaged`] and [`StoreError::Schema`] when the folder cannot be used as it is.
    pub fn open<'a>(data_dir: &'a Path) -> Answer<'a, Self> {
        Box::pin(async move { Self::open_locked(data_dir, false).await })
    }

    /// The same, going on with the rest when the newest part of the store is missing.
    ///
    /// # Errors
    /// Those of [`Store::open`] but [`StoreError::Older`].
    pub fn open_accepting_loss<'a>(data_dir: &'a Path) -> Answer<'a, Self> {
        Box::pin(async move { Self::open_locked(data_dir, true).await })
    }

    pub(super) async fn open_locked(data_dir: &Path, accepts_loss: bool) -> Result<Self, StoreError> {
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
        let mark = begin_mark(&pools, data_dir, accepts_loss).await?;
        let store = Self::new(pools, Some(lock), mark, Some(data_dir.into()));
        if !is_small {
            store.check_beside();
        }
        or_read(store.tidy_up().await)?;
        Ok(store)
    }

    /// Removes and hands back the leftovers of an earlier process.
    async fn tidy_up(&self) -> Result<(), StoreError> {
        self.purge(PURGE_PENDING, None).await?;
        self.purge(PURGE_ORPHANS, None).await?;
        self.requeue_interrupted_jobs().await?;
        self.release_all_hooks().await
    }

    /// Opens the store in `data_dir` beside the process that may be using it, for short work: nothing is checked or tidied
    /// up, and its writes wait for their turn.
    ///
    /// # Errors
    /// [`StoreError::Folder`] when there is no store, [`StoreError::TooOld`], [`StoreError::Older`], [`StoreError::Schema`].
    pub fn attach<'a>(data_dir: &'a Path) -> Answer<'a, Self> {
        Box::pin(async move {
            let file = data_dir.join(DATABASE_FILE);
            if let Err(source) = std::fs::metadata(&file) {
                return Err(StoreError::Folder { path: data_dir.to_path_buf(), source });
            }
            mark::require(data_dir).await?;
            Ok(Self::new(sqlite::attach(&file).await?, None, None, Some(data_dir.into())))
        })
    }

    /// Opens the store in the database at `url` (`postgres://…`), which other replicas may be using, with at most
    /// `connections` connections, and brings the schema up to date.
    ///
    /// # Errors
    /// [`StoreError::Url`], [`StoreError::Schema`]; [`StoreError::Busy`] while the database is not there.
    pub fn connect<'a>(url: &'a str, connections: u32) -> Answer<'a, Self> {
        Box::pin(async move {
            let options = postgres::options(url)?;
            let pool = postgres::connect(options.clone(), connections).await?;
            let store = Self::new(Pools::Postgres(pool), None, None, None);
            or_read(store.purge(PURGE_ORPHANS, None).await)?;
            store.live(options).await?;
            Ok(store)
        })
    }

    pub(super) fn new(
        pools: Pools,
        lock: Option<FolderLock>,
        mark: Option<Mark>,
        folder: Option<PathBuf>,
    ) -> Self {
        Self::around(Arc::new(Inner {
            pools,
            lock,
            mark,
            folder,
            replica: Replica::new(),
            damage: OnceLock::new(),
            found_room: Mutex::default(),
            writes: Writes::default(),
            names: KnownNames::default(),
            rewriting: tokio::sync::Mutex::default(),
        }))
    }

    pub(super) fn around(inner: Arc<Inner>) -> Self {
        Self { inner, principal: Arc::new(Principal::system(DEFAULT_TENANT)) }
    }

    /// Checks the file while the service runs. Readiness probes fail once the check has found damage.
    pub(super) fn check_beside(&self) {
        let store = self.clone();
        begin_task(Box::pin(async move {
            let found = sql(store.reader(), sqlite::QUICK_CHECK).scalar::<String>().await;
            let detail = match found {
                Ok(found) if found == sqlite::SOUND => return,
                Ok(found) => found,
                Err(error) => error.to_string(),
            };
            tracing::error!(detail, "the database is damaged: restore a backup");
            // Checked once.
            let _ = store.inner.damage.set(detail);
        }));
    }

    /// The same store as `principal` sees it.
    pub fn of(&self, principal: Arc<Principal>) -> Self {
        Self { inner: Arc::clone(&self.inner), principal }
    }

    /// Whether the store can write now, as much as a change needs.
    ///
    /// Waits for its turn behind other writers, so that the caller may want a timeout.
    ///
    /// # Errors
    /// [`StoreError::Full`] or [`StoreError::ReadOnly`], for example; [`StoreError::Damaged`] when the check of a large file
    /// has found something.
    pub fn ready(&self) -> Answer<'_, ()> {
        Box::pin(async move {
            if let Some(detail) = self.inner.damage.get() {
                return Err(StoreError::Damaged { detail: detail.clone() });
            }
            match self.probe().await {
                Err(error) if self.make_room(&error).await => self.probe().await,
                outcome => outcome,
            }
        })
    }

    /// Writes a number, and now and then as much as a small change needs: a page that is written again and again has room where no other
    /// has. On a disk that is almost full, every probe writes that much.
    pub(super) async fn probe(&self) -> Result<(), StoreError> {
        const PROBE: &str = "INSERT INTO probe (id, count) VALUES (1, 1)
            ON CONFLICT (id) DO UPDATE SET count = probe.count + 1";
        sql(self.writer(), PROBE).execute().await?;
        let found = *self.inner.found_room.lock().unwrap_or_else(PoisonError::into_inner);
        let is_known = found.is_some_and(|found| found.elapsed() < ROOM_FOR);
        if !is_known || self.free_bytes().is_some_and(|bytes| bytes < LITTLE_ROOM) {
            self.probe_room().await?;
            *self.inner.found_room.lock().unwrap_or_else(PoisonError::into_inner) = Some(Instant::now());
        }
        Ok(())
    }

    /// Writes and removes some 20 pages.
    async fn probe_room(&self) -> Result<(), StoreError> {
        const FILL: &str = "WITH RECURSIVE fill (id) AS
            (SELECT CAST(1000 AS BIGINT) UNION ALL SELECT id + 1 FROM fill WHERE id < 7000)
            INSERT INTO probe (id, count) SELECT id, 4611686018427387904 FROM fill";
        const CLEAR: &str = "DELETE FROM probe WHERE id >= 1000";
        let mut write = self.begin_write("probe").await?;
        sql(&mut write, FILL).execute().await?;
        sql(&mut write, CLEAR).execute().await?;
        Ok(write.commit().await?)
    }

    /// Empties the log of the embedded database into its file if a write found no room, and returns whether it did: on a full disk the
    /// log cannot grow by a page, and SQLite reuses its pages only once it is thousands of them long.
    pub fn make_room<'a>(&'a self, failure: &'a StoreError) -> Work<'a, bool> {
        Box::pin(async move {
            if !matches!(failure, StoreError::Full | StoreError::ReadOnly) {
                return false;
            }
            let folded = self.inner.pools.fold_log().await;
            if let Err(error) = &folded {
                tracing::warn!(%error, "the write-ahead log could not be emptied to make room");
            }
            folded.is_ok()
        })
    }

    /// Waits for work in progress, closes all connections and frees the data folder. The file of the embedded database then holds
    /// everything.
    pub fn close(&self) -> Work<'_, ()> {
        Box::pin(async move {
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
        })
    }

    /// So many audit entries have been committed.
    pub(super) fn mark_entries(&self, count: usize) {
        if let Some(mark) = &self.inner.mark {
            mark.advance(count as u64);
        }
    }

    /// Runs a statement that the store itself never runs.
    #[cfg(test)]
    pub(super) async fn meddle(&self, statement: &'static str) {
        sql(self.writer(), statement).execute().await.expect("a statement of a test");
    }

    pub(super) fn tenant(&self) -> &str {
        &self.principal.tenant
    }

    /// Stored form of a name of this tenant where it must be unique.
    pub(super) fn handle(&self, name: &str) -> String {
        handle(self.tenant(), name)
    }

    /// Where statements that only read go.
    pub(super) fn reader(&self) -> Link<'_> {
        self.inner.pools.reader()
    }

    /// Where single statements that write go.
    pub(super) fn writer(&self) -> Link<'_> {
        self.inner.pools.writer()
    }

    /// Begins a transaction that reads one state of the database.
    pub(super) async fn begin_read(&self) -> Result<Transaction, StoreError> {
        Ok(self.inner.pools.begin_read().await?)
    }

    /// Begins a transaction that no other one of the same `scope`, such as the id of a cohort, overlaps.
    pub(super) async fn begin_write(&self, scope: &str) -> Result<Transaction, StoreError> {
        Ok(self.inner.pools.begin_write(scope).await?.counted_by(&self.inner.writes))
    }

    /// The same for notes that no name depends on.
    pub(super) async fn begin_note(&self, scope: &str) -> Result<Transaction, StoreError> {
        Ok(self.inner.pools.begin_write(scope).await?)
    }

    /// Runs one of the `PURGE_` statements until nothing is left, letting other writers in between.
    pub(super) async fn purge(
        &self,
        statement: &'static str,
        upload: Option<&str>,
    ) -> Result<(), StoreError> {
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

/// A store that takes no writes is opened for reading: the leftovers to tidy up wait for a later start.
fn or_read(tidied: Result<(), StoreError>) -> Result<(), StoreError> {
    match tidied {
        Err(error @ (StoreError::Full | StoreError::ReadOnly)) => {
            tracing::warn!(%error, "the store is opened for reading, what an earlier process left behind stays");
            Ok(())
        }
        tidied => tidied,
    }
}

/// Stored form of a name of a tenant where it must be unique.
pub(super) fn handle(tenant: &str, name: &str) -> String {
    format!("{tenant}/{name}")
}

/// Removes chunks of unfinished uploads: only at start, when no upload can be in progress.
pub(super) const PURGE_PENDING: &str = "DELETE FROM chunk WHERE revision IS NULL AND id IN
    (SELECT id FROM chunk WHERE revision IS NULL LIMIT $1)";
/// Removes chunks of deleted cohorts.
pub(super) const PURGE_ORPHANS: &str = "DELETE FROM chunk WHERE id IN
    (SELECT id FROM chunk WHERE cohort IS NULL LIMIT $1)";
/// Removes chunks of one unfinished upload.
///
/// The pending state is asked twice: PostgreSQL, when it has waited for the commit that makes a chunk visible, looks at the
/// condition of the DELETE again, but not into the list, and would remove shapes just acknowledged.
pub(super) const PURGE_UPLOAD: &str = "DELETE FROM chunk WHERE revision IS NULL AND id IN
    (SELECT id FROM chunk WHERE revision IS NULL AND upload = $2 LIMIT $1)";

/// The mark of a store that has just been opened. None when there is no room for it: the store works without.
pub(super) async fn begin_mark(
    pools: &Pools,
    data_dir: &Path,
    accepts_loss: bool,
) -> Result<Option<Mark>, StoreError> {
    let entries = mark::entries(pools.reader()).await?;
    if !accepts_loss && let Some(marked) = mark::read(data_dir) {
        mark::compare(marked, entries)?;
    }
    let mark = Mark::begin(data_dir, entries);
    if let Err(error) = &mark {
        tracing::warn!(%error, "the mark of the store cannot be written: a missing write-ahead log will not be noticed");
    }
    Ok(mark.ok())
}

/// Runs arithmetic longer than a millisecond away from the threads that serve requests.
pub(super) async fn blocking<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> T {
    let outcome = run_aside(Box::new(move || -> Box<dyn Any + Send> { Box::new(work()) })).await;
    *outcome.downcast::<T>().expect("the outcome is that of the work")
}

/// Work of any kind: a separate type of task for each kind would be compiled with all that runs, wakes and ends it.
async fn run_aside(work: Box<dyn FnOnce() -> Box<dyn Any + Send> + Send>) -> Box<dyn Any + Send> {
    match tokio::task::spawn_blocking(work).await {
        Ok(outcome) => outcome,
        Err(error) => std::panic::resume_unwind(error.into_panic()),
    }
}

/// Begins a task in the background, whose end no caller awaits; all are of one type, as in [`blocking`].
pub(super) fn begin_task(work: Work<'static, ()>) -> JoinHandle<()> {
    tokio::spawn(work)
}
