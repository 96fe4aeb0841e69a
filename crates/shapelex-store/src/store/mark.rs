//! Mark of how far the store had come, kept outside the database to detect a missing or damaged write-ahead log.
//!
//! The newest commits of SQLite exist only in its write-ahead log. If that file is missing, truncated or damaged, the database
//! silently opens in an older state. The mark is the number of audit entries that all tenants have had, which never
//! decreases. Every acknowledged change has an entry committed after it, so a store that has lost an acknowledged change has
//! fewer entries than the mark says.
//!
//! The mark is written after the commit it records and is therefore never ahead of the store, even after `kill -9` or a power
//! cut: the disk then has an older mark, or an unreadable one, which is ignored. It is synced at most every
//! [`SYNCED_EVERY`]; no commit waits for it.

use std::fs::File;
use std::io::{self, Read as _, Seek as _, SeekFrom, Write as _};
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use super::engine::from_sql;
use super::engine::{self, Link, sql};
use super::error::StoreError;
use super::folder::DATABASE_FILE;
use super::{folder, sqlite};

/// Name of the file in the data folder.
pub(super) const MARK_FILE: &str = "shapelex.mark";
/// Longest time until the newest mark is synced to disk.
const SYNCED_EVERY: Duration = Duration::from_secs(5);
/// Beginning of a mark.
const HEAD: &str = "shapelex-mark 1";
/// Number of hexadecimal digits of the checksum.
const CHECK_DIGITS: usize = 16;

/// Mark of an open store.
#[derive(Debug)]
pub(super) struct Mark {
    file: Mutex<Written>,
    entries: AtomicU64,
}

#[derive(Debug)]
struct Written {
    file: Arc<File>,
    entries: u64,
    synced: Instant,
}

impl Mark {
    /// Starts the mark in the folder at `entries`.
    pub(super) fn begin(path: &Path, entries: u64) -> io::Result<Self> {
        let file = Arc::new(folder::private_file(&path.join(MARK_FILE))?);
        write(&file, entries)?;
        file.sync_data()?;
        let written = Written { file, entries, synced: Instant::now() };
        Ok(Self { file: Mutex::new(written), entries: AtomicU64::new(entries) })
    }

    /// Records `count` more entries on disk. If the mark cannot be written, only the warning is lost.
    pub(super) fn advance(&self, count: u64) {
        let entries = self.entries.fetch_add(count, Ordering::Relaxed) + count;
        let mut written = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        if entries <= written.entries {
            return;
        }
        if let Err(error) = write(&written.file, entries) {
            tracing::debug!(%error, "the mark could not be written");
            return;
        }
        written.entries = entries;
        if written.synced.elapsed() >= SYNCED_EVERY {
            written.synced = Instant::now();
            let file = Arc::clone(&written.file);
            // If the sync fails, the disk has an older mark, which is still valid.
            tokio::task::spawn_blocking(move || drop(file.sync_data()));
        }
    }

    /// Syncs the mark to disk.
    pub(super) fn sync(&self) {
        let written = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        if let Err(error) = written.file.sync_data() {
            tracing::debug!(%error, "the mark could not be synced to disk");
        }
    }
}

/// Writes the mark in one write of one sector.
fn write(mut file: &File, entries: u64) -> io::Result<()> {
    file.seek(SeekFrom::Start(0))?;
    file.write_all(text(entries).as_bytes())
}

fn text(entries: u64) -> String {
    let said = format!("{HEAD} {entries:020}");
    let check = blake3::hash(said.as_bytes()).to_hex();
    format!("{said} {}\n", &check[..CHECK_DIGITS])
}

/// Number of entries in the mark of the folder; `None` if there is no readable mark.
pub(super) fn read(path: &Path) -> Option<u64> {
    let mut found = String::new();
    // A mark has fewer than 100 bytes.
    File::open(path.join(MARK_FILE)).ok()?.take(100).read_to_string(&mut found).ok()?;
    let entries = found.strip_prefix(HEAD)?.split_whitespace().next()?.parse().ok()?;
    (found == text(entries)).then_some(entries)
}

/// Refuses the database in the folder if it has had fewer entries than the mark says. The database is opened read-only, so
/// that the remains of a damaged log are preserved.
///
/// # Errors
/// [`StoreError::Older`].
pub(super) async fn require(path: &Path) -> Result<(), StoreError> {
    // Read before the database is queried: while the service runs, both numbers grow.
    let Some(marked) = read(path) else { return Ok(()) };
    let file = path.join(DATABASE_FILE);
    let found = if is_absent(&file) { Ok(0) } else { in_file(&file).await };
    match found {
        Ok(found) => compare(marked, found),
        // The content of the log is known when the store is open, which compares again.
        Err(StoreError::Full) => Ok(()),
        Err(error) => Err(error),
    }
}

/// Refuses a database that has had fewer entries than the mark says.
///
/// # Errors
/// [`StoreError::Older`].
pub(super) fn compare(marked: u64, found: u64) -> Result<(), StoreError> {
    if found < marked { Err(StoreError::Older { missing: marked - found }) } else { Ok(()) }
}

async fn in_file(file: &Path) -> Result<u64, StoreError> {
    let count = async |whole| {
        let pool = sqlite::look(file, whole).await?;
        let found = entries(Link::SqlitePool(&pool)).await;
        pool.close().await;
        found
    };
    match count(false).await {
        // There is no room for the index of a log. Without a log none is needed.
        Err(StoreError::Full) if is_absent(&file.with_extension("db-wal")) => count(true).await,
        found => found,
    }
}

/// Whether a file is missing or empty.
fn is_absent(file: &Path) -> bool {
    std::fs::metadata(file).map_or(true, |about| about.len() == 0)
}

/// Number of audit entries that all tenants of an embedded database have had.
pub(super) async fn entries(link: Link<'_>) -> Result<u64, StoreError> {
    // A database without tables has none.
    const ENTRIES: &str = "SELECT CAST(coalesce(sum(sequence), 0) AS INTEGER) FROM audit_head";
    match sql(link, ENTRIES).scalar().await {
        Ok(found) => Ok(from_sql(found)),
        Err(error) if engine::is_missing_table(&error) => Ok(0),
        Err(error) => Err(error.into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mark_is_read_as_it_was_written_and_a_broken_one_is_none() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(read(folder.path()), None);
        for entries in [0, 1, 12_345_678_901_234_567_890] {
            let mark = Mark::begin(folder.path(), entries).unwrap();
            mark.sync();
            assert_eq!(read(folder.path()), Some(entries));
        }
        let whole = text(77);
        let file = folder.path().join(MARK_FILE);
        for length in 0..whole.len() {
            std::fs::write(&file, &whole[..length]).unwrap();
            assert_eq!(read(folder.path()), None, "{length}");
        }
        std::fs::write(&file, whole.replace("77", "78")).unwrap();
        assert_eq!(read(folder.path()), None);
        std::fs::write(&file, [0xff; 200]).unwrap();
        assert_eq!(read(folder.path()), None);
    }

    #[tokio::test]
    async fn a_mark_never_falls() {
        let folder = tempfile::tempdir().unwrap();
        let mark = Mark::begin(folder.path(), 5).unwrap();
        for (count, expected) in [(3, 8), (0, 8), (1, 9)] {
            mark.advance(count);
            assert_eq!(read(folder.path()), Some(expected));
        }
    }
}
