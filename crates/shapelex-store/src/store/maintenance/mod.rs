//! Operator's work on a whole store, of all tenants.
//!
//! * `tables` — list of all stored tables; `schema` — versions and migration;
//! * `check` — integrity check; `compact` — files written anew; `backup` — copy and restoration of the embedded database's file;
//! * `export`, `import` — a stream of lines that both databases write and read.

mod backup;
mod check;
mod compact;
mod export;
mod import;
mod schema;
mod tables;

use std::path::PathBuf;

use super::answer::Answer;
use super::engine::Pools;
use super::error::StoreError;
use super::folder::DATABASE_FILE;
use super::handle::Store;
use super::{mark, postgres, sqlite};

pub use backup::{Restored, restore};
pub use check::Checked;
pub use schema::{Versions, migrate, versions};

/// Number of PostgreSQL connections of a command.
const CONNECTIONS: u32 = 2;

/// Location of a store.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Site {
    /// Folder of the embedded database.
    Folder(PathBuf),
    /// Address of a PostgreSQL database.
    Url(String),
}

/// Reason why a command failed.
#[derive(Debug, thiserror::Error)]
pub enum MaintenanceError {
    /// The store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// There is no store.
    #[error("no store in {}", .0.display())]
    NoStore(PathBuf),
    /// The schema must be upgraded first.
    #[error(
        "the schema of the store has version {found}, this program needs {known}: run `shapelex migrate` first"
    )]
    Older {
        /// Schema version of the store.
        found: i64,
        /// Schema version of this program.
        known: i64,
    },
    /// The file already exists.
    #[error("{} already exists", .0.display())]
    Exists(PathBuf),
    /// The folder is not empty.
    #[error("{} is not empty: a backup can only be restored into an empty folder", .0.display())]
    FolderInUse(PathBuf),
    /// The store is not empty.
    #[error("the store is not empty (table {0}): an export can only be imported into an empty store")]
    StoreInUse(&'static str),
    /// A file cannot be read or written.
    #[error("{}: {source}", path.display())]
    File {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// The export cannot be read or written.
    #[error("the export cannot be read or written: {0}")]
    Stream(#[from] std::io::Error),
    /// A line of an export is invalid.
    #[error("line {line} of the export: {detail}")]
    Format {
        /// Line number, from 1.
        line: u64,
        /// Description of the fault.
        detail: String,
    },
    /// The backup is damaged.
    #[error("the backup is not restored: {0}")]
    BadBackup(String),
    /// Others read from the log for too long.
    #[error(
        "the tables are written anew, but others still read from the write-ahead log: run the command again"
    )]
    Read,
    /// PostgreSQL has its own backup tools.
    #[error(
        "PostgreSQL is backed up with `pg_dump`; `shapelex export` writes a file that any store can import"
    )]
    NotEmbedded,
}

impl From<sqlx::Error> for MaintenanceError {
    fn from(error: sqlx::Error) -> Self {
        StoreError::from(error).into()
    }
}

impl Store {
    /// Opens the store at `site` as it is, even while the service uses it: nothing is migrated or cleaned up.
    ///
    /// # Errors
    /// [`MaintenanceError::NoStore`], [`MaintenanceError::Older`] and [`StoreError::Newer`].
    pub fn inspect<'a>(site: &'a Site) -> Answer<'a, Self, MaintenanceError> {
        Box::pin(async move {
            let pools = existing(site).await?;
            schema::require_present(&pools).await?;
            Ok(Self::new(pools, None, None, None))
        })
    }
}

/// Connections to an existing store, whatever its schema.
async fn existing(site: &Site) -> Result<Pools, MaintenanceError> {
    match site {
        Site::Folder(folder) => {
            let file = folder.join(DATABASE_FILE);
            if !file.is_file() {
                return Err(MaintenanceError::NoStore(folder.clone()));
            }
            mark::require(folder).await?;
            Ok(sqlite::connect(&file, false).await?)
        }
        Site::Url(url) => Ok(Pools::Postgres(postgres::pool(postgres::options(url)?, CONNECTIONS).await?)),
    }
}

#[cfg(test)]
mod tests;
