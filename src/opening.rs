//! The store that the settings name, for the service and for the commands beside it.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use crate::store::{Store, StoreError};

/// How long a start waits for its database.
const PATIENCE: Duration = Duration::from_secs(60);
/// How often it looks.
const PAUSE: Duration = Duration::from_millis(500);

/// Where the store is.
#[derive(Debug, Clone)]
pub(crate) struct Place {
    /// `postgres://…`, or empty for the embedded database.
    pub(crate) database_url: String,
    /// Connections to PostgreSQL.
    pub(crate) database_connections: u32,
    /// Folder of the embedded database.
    pub(crate) data_dir: PathBuf,
    /// Whether to go on with what is left of an embedded store whose newest part is missing.
    pub(crate) accepts_loss: bool,
}

/// The address of the database: as it is given, or what stands in the file that is given instead. A file is read by its owner
/// alone; a flag stands in the list of processes.
///
/// # Errors
/// A file that cannot be read, or that is given besides the address.
pub(crate) fn database_url(given: &str, file: Option<&Path>) -> Result<String, String> {
    match (given.is_empty(), file.filter(|file| !file.as_os_str().is_empty())) {
        (_, None) => Ok(given.to_owned()),
        (false, Some(_)) => Err("expected database_url or database_url_file, got both".into()),
        (true, Some(file)) => {
            let text =
                std::fs::read_to_string(file).map_err(|error| format!("{}: {error}", file.display()))?;
            let text = text.trim();
            // Nothing would mean the embedded database.
            if text.is_empty() {
                return Err(format!("{}: expected the address of a database, got nothing", file.display()));
            }
            Ok(text.to_owned())
        }
    }
}

impl Place {
    /// Opens the store for a command beside the service, which may be running.
    ///
    /// # Errors
    /// Why it does not open.
    pub(crate) async fn attach(&self) -> Result<Store, String> {
        if !self.database_url.is_empty() {
            return self.open().await;
        }
        let failed = |error| format!("the store in {} does not open: {error}", self.data_dir.display());
        match Store::attach(&self.data_dir).await {
            // There is none yet: made as the service would make it.
            Err(StoreError::Folder { .. }) => Store::open(&self.data_dir).await.map_err(failed),
            attached => attached.map_err(failed),
        }
    }

    /// Opens the store; waits up to a minute for a database that is not there yet.
    ///
    /// # Errors
    /// Why it does not open, without the address, which may hold a password.
    pub(crate) async fn open(&self) -> Result<Store, String> {
        if self.database_url.is_empty() {
            let failed = |error| format!("the store in {} does not open: {error}", self.data_dir.display());
            let opened = if self.accepts_loss {
                Store::open_accepting_loss(&self.data_dir).await
            } else {
                Store::open(&self.data_dir).await
            };
            return opened.map_err(failed);
        }
        let begun = Instant::now();
        loop {
            match Store::connect(&self.database_url, self.database_connections).await {
                Err(StoreError::Busy) if begun.elapsed() < PATIENCE => {
                    tracing::warn!("the database does not answer yet");
                    tokio::time::sleep(PAUSE).await;
                }
                opened => {
                    return opened.map_err(|error| format!("the database does not open: {}", cause(&error)));
                }
            }
        }
    }
}

/// The error with what lies behind it.
fn cause(error: &StoreError) -> String {
    match std::error::Error::source(error) {
        Some(source) => format!("{error}: {source}"),
        None => error.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_address_of_the_database_may_stand_in_a_file() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("url");
        assert_eq!(database_url("", Some(Path::new(""))).unwrap(), "");
        assert_eq!(database_url("postgres://a", None).unwrap(), "postgres://a");
        assert!(database_url("", Some(&file)).unwrap_err().contains("url"));
        std::fs::write(&file, "\n").unwrap();
        assert!(database_url("", Some(&file)).unwrap_err().contains("got nothing"));
        std::fs::write(&file, "postgres://b:c@d/e\n").unwrap();
        assert_eq!(database_url("", Some(&file)).unwrap(), "postgres://b:c@d/e");
        let both = database_url("postgres://a", Some(&file)).unwrap_err();
        assert!(both.contains("got both") && !both.contains("b:c"), "{both}");
    }
}
