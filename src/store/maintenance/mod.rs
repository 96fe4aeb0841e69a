//! Work on a whole store, of all tenants, for its operator.
//!
//! Parts: `tables` (everything that is kept, in one list), `schema` (versions and migration), `check` (is all of it whole?),
//! `backup` (the file of the embedded database, copied and brought back), `export` and `import` (a stream of lines that both
//! databases write and read).

mod backup;
mod check;
mod export;
mod import;
mod schema;
mod tables;

use std::path::PathBuf;

use super::engine::Pools;
use super::error::StoreError;
use super::folder::DATABASE_FILE;
use super::handle::Store;
use super::{mark, postgres, sqlite};

pub use backup::restore;
pub use check::Checked;
pub use schema::{Versions, migrate, versions};

/// Connections to PostgreSQL that a command takes.
const CONNECTIONS: u32 = 2;

/// Where a store is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Site {
    /// The folder of the embedded database.
    Folder(PathBuf),
    /// The address of a PostgreSQL database.
    Url(String),
}

/// Why the work was not done.
#[derive(Debug, thiserror::Error)]
pub enum MaintenanceError {
    /// The store failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// There is nothing to work on.
    #[error("there is no store in {}", .0.display())]
    NoStore(PathBuf),
    /// A newer program wrote the schema.
    #[error(
        "the schema of the store has version {found}, this program knows {known}: use the program that wrote it, or a newer one"
    )]
    Newer {
        /// Version of the store.
        found: i64,
        /// Version of this program.
        known: i64,
    },
    /// The schema is to be brought up to date first.
    #[error(
        "the schema of the store has version {found}, this program needs {known}: run `shapelex migrate` first"
    )]
    Older {
        /// Version of the store.
        found: i64,
        /// Version of this program.
        known: i64,
    },
    /// The file would be overwritten.
    #[error("{} exists already", .0.display())]
    Exists(PathBuf),
    /// The folder holds something.
    #[error("{} is not empty: a backup is restored into an empty folder", .0.display())]
    FolderInUse(PathBuf),
    /// The store holds something.
    #[error("the store is not empty (table {0}): an export is imported into an empty store")]
    StoreInUse(&'static str),
    /// A file cannot be read or written.
    #[error("{}: {source}", path.display())]
    File {
        /// Which one.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// The export cannot be read or written.
    #[error("the export cannot be read or written: {0}")]
    Stream(#[from] std::io::Error),
    /// A line of an export is not what it should be.
    #[error("line {line} of the export: {detail}")]
    Format {
        /// Its number, from 1.
        line: u64,
        /// What is wrong.
        detail: String,
    },
    /// The backup is not what was written.
    #[error("the backup is not restored: {0}")]
    BadBackup(String),
    /// The database has tools of its own for this.
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
    /// Opens the store at `site` as it is, also beside the service that uses it: nothing is migrated or tidied up.
    ///
    /// # Errors
    /// [`MaintenanceError::NoStore`], [`MaintenanceError::Older`] and [`MaintenanceError::Newer`].
    pub async fn inspect(site: &Site) -> Result<Self, MaintenanceError> {
        let pools = existing(site).await?;
        schema::require_present(&pools).await?;
        Ok(Self::new(pools, None, None, None))
    }
}

/// The connections of a store that exists, whatever its schema.
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
