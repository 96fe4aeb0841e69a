//! The file of the embedded database, copied while it is in use, and brought back.
//!
//! A copy gets its name only when it is whole and on disk: a killed command leaves a file whose name tells it, and nothing
//! else.

use std::ffi::OsString;
use std::fs::{self, File, OpenOptions};
use std::path::{Path, PathBuf};

use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{ConnectOptions, Connection};

use super::super::engine::sql;
use super::super::error::StoreError;
use super::super::folder::DATABASE_FILE;
use super::super::folder::{FolderLock, LOCK_FILE, private_file};
use super::super::handle::{Store, blocking};
use super::super::sqlite;
use super::{Checked, MaintenanceError, schema};
use crate::domain::id;

/// What the name of a copy that is not finished ends with.
const PARTIAL: &str = ".partial";

impl Store {
    /// Copies the embedded store as it is at one moment to `file`, which must not exist; its size in bytes. Others go on
    /// reading and writing.
    ///
    /// # Errors
    /// [`MaintenanceError::Exists`], [`MaintenanceError::NotEmbedded`], [`MaintenanceError::File`].
    pub async fn back_up(&self, file: &Path) -> Result<u64, MaintenanceError> {
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
    }
}

/// Makes a store of the backup in `file`, in the folder `data_dir`, which must be empty or not exist. Everything in it is checked
/// first; each finding is reported.
///
/// A backup of an older version keeps its schema, and only its file is checked.
///
/// # Errors
/// [`MaintenanceError::FolderInUse`], [`MaintenanceError::BadBackup`], [`MaintenanceError::Newer`].
pub async fn restore(
    file: &Path,
    data_dir: &Path,
    report: &mut (dyn FnMut(&str) + Send),
) -> Result<Option<Checked>, MaintenanceError> {
    if !file.is_file() {
        return Err(MaintenanceError::BadBackup(format!("there is no file {}", file.display())));
    }
    let lock = FolderLock::take(data_dir)?;
    require_empty(data_dir)?;
    let copy = Partial { path: data_dir.join(format!("restore{PARTIAL}")) };
    let (from, to) = (file.to_path_buf(), copy.path.clone());
    // What exists keeps its rights, whatever those of the backup are.
    private_file(&to).map_err(|source| file_error(&to, source))?;
    blocking(move || copy_content(&from, &to)).await.map_err(|source| file_error(file, source))?;
    check_file(&copy.path).await?;
    let checked = check_content(&copy.path, report).await?;
    let target = data_dir.join(DATABASE_FILE);
    blocking(move || copy.finish(&target)).await?;
    drop(lock);
    Ok(checked)
}

/// Copies what is in a file: `fs::copy` would copy its rights too.
fn copy_content(from: &Path, to: &Path) -> std::io::Result<u64> {
    std::io::copy(&mut File::open(from)?, &mut OpenOptions::new().write(true).open(to)?)
}

/// Checks all that is in a copy, unless its schema is older.
async fn check_content(
    copy: &Path,
    report: &mut (dyn FnMut(&str) + Send),
) -> Result<Option<Checked>, MaintenanceError> {
    let store = Store::new(sqlite::connect(copy, false).await?, None, None, None);
    let checked = match schema::require_present(&store.inner.pools).await {
        Err(MaintenanceError::Older { found: 0, .. }) => {
            Err(MaintenanceError::BadBackup("it is not a backup of a store".into()))
        }
        Err(MaintenanceError::Older { .. }) => Ok(None),
        Err(error) => Err(error),
        Ok(_) => store.check(report).await.map(Some).map_err(MaintenanceError::from),
    };
    // Who has folded the write-ahead log into the file removes it at the end; a connection that never read would leave it.
    let folded = sql(store.writer(), "PRAGMA wal_checkpoint(TRUNCATE)").execute().await;
    store.close().await;
    folded?;
    match checked? {
        Some(Checked { findings, .. }) if findings > 0 => {
            Err(MaintenanceError::BadBackup(format!("findings: {findings}")))
        }
        checked => Ok(checked),
    }
}

/// Refuses a folder that holds anything but what an interrupted command left.
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

/// A file on its way; removed when dropped.
struct Partial {
    path: PathBuf,
}

impl Partial {
    /// A new empty file beside the one that it will become, for its owner alone.
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

    /// Writes it through to the disk and gives it its name; its size in bytes.
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
        // After a rename there is nothing left; what cannot be removed says by its name what it is.
        let _ = fs::remove_file(&self.path);
    }
}

/// Lets a new name survive a power cut.
fn sync_folder_of(file: &Path) -> std::io::Result<()> {
    let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    if cfg!(unix) { File::open(folder)?.sync_all() } else { Ok(()) }
}

/// Reads the whole file of a copy that nobody else uses.
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
