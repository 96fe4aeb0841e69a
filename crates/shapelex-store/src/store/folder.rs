//! Data folder, which belongs to one process and one user.

use std::fs::{File, OpenOptions, TryLockError};
use std::io;
use std::path::Path;

use super::error::StoreError;

/// Name of the database file in the data folder.
pub(super) const DATABASE_FILE: &str = "shapelex.db";

/// Name of the lock file that shows that a process uses the folder.
pub(super) const LOCK_FILE: &str = "shapelex.lock";
/// Database files, which contain patient data.
const PRIVATE: [&str; 3] = [DATABASE_FILE, "shapelex.db-wal", "shapelex.db-shm"];

/// Exclusive lock on a folder, released when the process ends.
#[derive(Debug)]
pub(super) struct FolderLock {
    /// Lock file, for programs that do not check the lock on the folder.
    file: File,
    /// Lock on the folder itself: removing the lock file does not let a second process in.
    folder: Option<File>,
}

impl FolderLock {
    /// Creates the folder, accessible only to its owner, and locks it.
    ///
    /// # Errors
    /// [`StoreError::Locked`], [`StoreError::Folder`].
    pub(super) fn take(path: &Path) -> Result<Self, StoreError> {
        let failed = |source| StoreError::Folder { path: path.to_path_buf(), source };
        make(path).map_err(failed)?;
        warn_of_others(path);
        let file = private_file(&path.join(LOCK_FILE)).map_err(failed)?;
        lock(&file, path)?;
        let folder = open_folder(path);
        if let Some(folder) = &folder {
            lock(folder, path)?;
        }
        Ok(Self { file, folder })
    }

    /// Releases the folder; errors are harmless, as the locks end with the process.
    pub(super) fn free(&self) {
        for lock in std::iter::once(&self.file).chain(&self.folder) {
            let _ = lock.unlock();
        }
    }
}

fn lock(file: &File, path: &Path) -> Result<(), StoreError> {
    match file.try_lock() {
        Ok(()) => Ok(()),
        Err(TryLockError::WouldBlock) => Err(StoreError::Locked { path: path.to_path_buf() }),
        // Some network file systems cannot lock folders; the file lock is already held.
        Err(TryLockError::Error(_)) if file.metadata().is_ok_and(|about| about.is_dir()) => Ok(()),
        Err(TryLockError::Error(source)) => Err(StoreError::Folder { path: path.to_path_buf(), source }),
    }
}

/// Opens a file of the folder that only its owner can read, creating it if missing.
pub(super) fn private_file(path: &Path) -> io::Result<File> {
    let mut options = OpenOptions::new();
    options.read(true).write(true).create(true).truncate(false);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    options.open(path)
}

/// Makes the database files readable only by their owner. A new file is created that way, and the files that the database
/// then creates beside it inherit its permissions; those of existing files are changed.
///
/// # Errors
/// [`StoreError::Folder`].
pub(super) fn protect(path: &Path) -> Result<(), StoreError> {
    let failed = |source| StoreError::Folder { path: path.to_path_buf(), source };
    let database = path.join(DATABASE_FILE);
    if !database.exists() {
        private_file(&database).map_err(failed)?;
    }
    for name in PRIVATE {
        narrow(&path.join(name));
    }
    Ok(())
}

#[cfg(unix)]
fn make(path: &Path) -> io::Result<()> {
    use std::os::unix::fs::DirBuilderExt as _;
    std::fs::DirBuilder::new().recursive(true).mode(0o700).create(path)
}

#[cfg(not(unix))]
fn make(path: &Path) -> io::Result<()> {
    std::fs::create_dir_all(path)
}

#[cfg(unix)]
fn open_folder(path: &Path) -> Option<File> {
    File::open(path).ok()
}

/// On other systems a folder cannot be opened, and an open file cannot be removed.
#[cfg(not(unix))]
fn open_folder(_: &Path) -> Option<File> {
    None
}

/// Permission bits of users other than the owner.
#[cfg(unix)]
const OTHERS: u32 = 0o077;

#[cfg(unix)]
fn warn_of_others(path: &Path) {
    use std::os::unix::fs::PermissionsExt as _;
    let mode = std::fs::metadata(path).map_or(0, |about| about.permissions().mode() & 0o777);
    if mode & OTHERS != 0 {
        let mode = format!("{mode:o}");
        tracing::warn!(mode, "the data folder is open to other users of this machine: chmod 700 closes it");
    }
}

#[cfg(not(unix))]
fn warn_of_others(_: &Path) {}

#[cfg(unix)]
fn narrow(path: &Path) {
    use std::os::unix::fs::PermissionsExt as _;
    let Ok(about) = std::fs::metadata(path) else { return };
    if about.permissions().mode() & OTHERS == 0 {
        return;
    }
    if let Err(error) = std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o600)) {
        tracing::warn!(%error, "a file of the database can be read by other users of this machine");
    }
}

#[cfg(not(unix))]
fn narrow(_: &Path) {}
