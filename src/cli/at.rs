//! Where a command finds its store, and how it ends.

use std::path::PathBuf;

use clap::Args;

use crate::store::maintenance::Site;
use crate::store_location;

/// Location of the store.
#[derive(Debug, Args)]
pub(super) struct At {
    /// Folder of the embedded store
    #[arg(long, env = "SHAPELEX_DATA_DIR", default_value = "shapelex-data")]
    data_dir: PathBuf,
    /// Address of the PostgreSQL database, if the store is not embedded
    #[arg(long, env = "DATABASE_URL", hide_env_values = true, default_value = "")]
    database_url: String,
    /// File with the address of the PostgreSQL database, in place of the address itself
    #[arg(long, env = "SHAPELEX_DATABASE_URL_FILE", value_name = "FILE")]
    database_url_file: Option<PathBuf>,
}

impl At {
    /// Folder, address, and the file with the address.
    pub(super) fn parts(self) -> (PathBuf, String, Option<PathBuf>) {
        (self.data_dir, self.database_url, self.database_url_file)
    }

    pub(super) fn site(self) -> Result<Site, String> {
        let url = store_location::database_url(&self.database_url, self.database_url_file.as_deref())?;
        Ok(if url.is_empty() { Site::Folder(self.data_dir) } else { Site::Url(url) })
    }
}

/// Outcome of a completed command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Outcome {
    Done,
    /// There are findings that need the operator's attention.
    Findings,
}
