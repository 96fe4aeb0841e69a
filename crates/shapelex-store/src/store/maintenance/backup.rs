//! Backup of the embedded database while it is in use, and its restoration.
//!
//! A copy gets its final name only when it is complete and on disk: a killed command leaves only a file whose name marks it
//! as partial.

use std::ffi::OsString;
use std::fs::{self, File, OpenOptions};
use std::path::{Path, PathBuf};

use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{ConnectOptions, Connection};

use super::super::answer::Answer;
use super::super::copies::settle_copy;
use super::super::engine::sql;
use super::super::error::StoreError;
use super::super::folder::DATABASE_FILE;
use super::super::folder::{FolderLock, LOCK_FILE, private_file};
use super::super::handle::{Store, blocking};
use super::super::sqlite;
use super::{Checked, MaintenanceError, schema};
use crate::domain::id;

/// Suffix of the name of an unfinished copy.
const PARTIAL: &str = ".partial";

impl Store {
    /// Copies the embedded store, as it is at one moment, to `file`, which must not exist; returns its size in bytes. Readers
    /// and writers are not blocked.
    ///
    /// # Errors
    /// [`MaintenanceError::Exists`], [`MaintenanceError::NotEmbedded`], [`MaintenanceError::File`].
    pub fn back_up<'a>(&'a self, file: &'a Path) -> Answer<'a, u64, MaintenanceError> {
        Box::pin(async move {
            if !self.is_embedded() {
                return Err(MaintenanceError::NotEmbedded);
            }
            if file.exists() {
                return Err(MaintenanceError::Exists(file.to_path_buf()));
            }
            let copy = Partial::beside(file)?;
            let path = copy.path.to_str().ok_or_else(|| wrong_name(file))?;
            sql(self.reader(), "VACUUM INTO $1").bind(path).persistent(false).execute().await?;
            check_file(&copy.path).await?;
            let target = file.to_path_buf();
            blocking(move || copy.finish(&target)).await
        })
    }
}

/// Outcome of a restoration.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Restored {
    /// Numbers of the check; `None` for the schema of an older version, of which only the file is checked.
    pub checked: Option<Checked>,
    /// Number of hooks that are paused.
    pub paused: u64,
}

/// Creates a store from the backup in `file`, in the folder `data_dir`, which must be empty or absent. Its content is
/// checked first; each finding is reported. Active hooks are paused unless they are to `resume`.
///
/// A backup of an older version keeps its schema.
///
/// # Errors
/// [`MaintenanceError::FolderInUse`], [`MaintenanceError::BadBackup`], [`StoreError::Newer`].
pub fn restore<'a>(
    file: &'a Path,
    data_dir: &'a Path,
    resume: bool,
    report: &'a mut (dyn FnMut(&str) + Send),
) -> Answer<'a, Restored, MaintenanceError> {
    Box::pin(async move {
        if !file.is_file() {
            return Err(MaintenanceError::BadBackup(format!("no file {}", file.display())));
        }
        let lock = FolderLock::take(data_dir)?;
        require_empty(data_dir)?;
        let copy = Partial { path: data_dir.join(format!("restore{PARTIAL}")) };
        let (from, to) = (file.to_path_buf(), copy.path.clone());
        // An existing file keeps its permissions, whatever those of the backup are.
        private_file(&to).map_err(|source| file_error(&to, source))?;
        blocking(move || copy_content(&from, &to)).await.map_err(|source| file_error(file, source))?;
        check_file(&copy.path).await?;
        let restored = settle_content(&copy.path, resume, report).await?;
        let target = data_dir.join(DATABASE_FILE);
        blocking(move || copy.finish(&target)).await?;
        drop(lock);
        Ok(restored)
    })
}

/// Copies the content of a file; `fs::copy` would also copy its permissions.
fn copy_content(from: &Path, to: &Path) -> std::io::Result<u64> {
    std::io::copy(&mut File::open(from)?, &mut OpenOptions::new().write(true).open(to)?)
}

/// Checks the content of a copy, unless its schema is older, and makes it an independent store.
async fn settle_content(
    copy: &Path,
    resume: bool,
    report: &mut (dyn FnMut(&str) + Send),
) -> Result<Restored, MaintenanceError> {
    let store = Store::new(sqlite::connect(copy, false).await?, None, None, None);
    let restored = checked_copy(&store, resume, report).await;
    // The connection that merges the write-ahead log removes it when it closes; one that never read would leave it.
    let folded = sql(store.writer(), "PRAGMA wal_checkpoint(TRUNCATE)").execute().await;
    store.close().await;
    folded?;
    restored
}

async fn checked_copy(
    store: &Store,
    resume: bool,
    report: &mut (dyn FnMut(&str) + Send),
) -> Result<Restored, MaintenanceError> {
    let checked = match schema::require_present(&store.inner.pools).await {
        Err(MaintenanceError::Older { found: 0, .. }) => {
            return Err(MaintenanceError::BadBackup("it is not a backup of a store".into()));
        }
        Err(MaintenanceError::Older { .. }) => None,
        Err(error) => return Err(error),
        Ok(_) => Some(store.check(report).await?),
    };
    if let Some(Checked { findings, .. }) = checked
        && findings > 0
    {
        return Err(MaintenanceError::BadBackup(format!("findings: {findings}")));
    }
    let mut write = store.begin_write("copy").await?;
    let paused = settle_copy(&mut write, resume).await?;
    write.commit().await?;
    Ok(Restored { checked, paused })
}

/// Refuses a folder that contains anything other than the remains of an interrupted command.
fn require_empty(folder: &Path) -> Result<(), MaintenanceError> {
    let read = || -> std::io::Result<Vec<PathBuf>> {
        fs::read_dir(folder)?.map(|entry| Ok(entry?.path())).collect()
    };
    let entries = read().map_err(|source| file_error(folder, source))?;
    let is_partial = |path: &Path| {
        path.file_name().is_some_and(|name| name.to_string_lossy().starts_with("restore.partial"))
    };
    for path in entries {
        if is_partial(&path) {
            fs::remove_file(&path).map_err(|source| file_error(&path, source))?;
        } else if path.file_name().is_none_or(|name| name != LOCK_FILE) {
            return Err(MaintenanceError::FolderInUse(folder.to_path_buf()));
        }
    }
    Ok(())
}

/// An unfinished file; removed when dropped.
struct Partial {
    path: PathBuf,
}

impl Partial {
    /// Creates an empty file beside the final one, accessible only to its owner.
    fn beside(file: &Path) -> Result<Self, MaintenanceError> {
        let mut name = file.file_name().map(OsString::from).ok_or_else(|| wrong_name(file))?;
        name.push(format!(".{}{PARTIAL}", id::unique()));
        let path = file.with_file_name(name);
        let mut options = OpenOptions::new();
        options.write(true).create_new(true);
        #[cfg(unix)]
        std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
        options.open(&path).map_err(|source| file_error(&path, source))?;
        Ok(Self { path })
    }

    /// Syncs it to disk and gives it its final name; returns its size in bytes.
    fn finish(&self, file: &Path) -> Result<u64, MaintenanceError> {
        if file.exists() {
            return Err(MaintenanceError::Exists(file.to_path_buf()));
        }
        let finish = || {
            let copy = OpenOptions::new().read(true).write(true).open(&self.path)?;
            copy.sync_all()?;
            fs::rename(&self.path, file)?;
            sync_folder_of(file)?;
            Ok(copy.metadata()?.len())
        };
        finish().map_err(|source| file_error(file, source))
    }
}

impl Drop for Partial {
    fn drop(&mut self) {
        // After the rename nothing is left; if removal fails, the name marks the file as partial.
        let _ = fs::remove_file(&self.path);
    }
}

/// Makes a new name survive a power cut.
fn sync_folder_of(file: &Path) -> std::io::Result<()> {
    let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    if cfg!(unix) { File::open(folder)?.sync_all() } else { Ok(()) }
}

/// Checks the whole file of a copy that no other process uses.
async fn check_file(file: &Path) -> Result<(), MaintenanceError> {
    let options = SqliteConnectOptions::new().filename(file).read_only(true).immutable(true);
    let damaged = |error: sqlx::Error| match StoreError::from(error) {
        StoreError::Damaged { detail } => MaintenanceError::BadBackup(detail),
        error => error.into(),
    };
    let mut connection = options.connect().await.map_err(damaged)?;
    let verdict: Result<String, _> =
        sqlx::query_scalar("PRAGMA quick_check(1)").fetch_one(&mut connection).await;
    let verdict = verdict.map_err(damaged)?;
    connection.close().await?;
    if verdict == "ok" { Ok(()) } else { Err(MaintenanceError::BadBackup(verdict)) }
}

fn file_error(path: &Path, source: std::io::Error) -> MaintenanceError {
    MaintenanceError::File { path: path.to_path_buf(), source }
}

fn wrong_name(path: &Path) -> MaintenanceError {
    file_error(path, std::io::Error::new(std::io::ErrorKind::InvalidInput, "not the name of a file"))
}
