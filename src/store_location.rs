//! Opens the store that the settings name, for the service and for command-line tools.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use crate::store::{Store, StoreError};

/// Longest time that a start waits for its database.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(60);
/// Interval between connection attempts.
const PAUSE: Duration = Duration::from_millis(500);

/// Location of the store.
#[derive(Debug, Clone)]
pub(crate) struct StoreLocation {
    /// Address `postgres://…`, or empty for the embedded database.
    pub(crate) database_url: String,
    /// Maximum number of connections to PostgreSQL.
    pub(crate) database_connections: u32,
    /// Folder of the embedded database.
    pub(crate) data_dir: PathBuf,
    /// Whether to continue with an embedded store whose newest part is missing.
    pub(crate) accepts_loss: bool,
}

/// Address of the database, given directly or read from a file. A file can be readable by its owner alone, whereas a flag
/// is visible in the list of processes.
///
/// # Errors
/// A file that cannot be read, or that is given together with an address.
pub(crate) fn database_url(given: &str, file: Option<&Path>) -> Result<String, String> {
    match (given.is_empty(), file.filter(|file| !file.as_os_str().is_empty())) {
        (_, None) => Ok(given.to_owned()),
        (false, Some(_)) => Err("expected database_url or database_url_file, got both".into()),
        (true, Some(file)) => {
            let text =
                std::fs::read_to_string(file).map_err(|error| format!("{}: {error}", file.display()))?;
            let text = text.trim();
            // An empty address would select the embedded database.
            if text.is_empty() {
                return Err(format!("{}: expected the address of a database, got nothing", file.display()));
            }
            Ok(text.to_owned())
        }
    }
}

impl StoreLocation {
    /// Opens the store for a command, while the service may be running.
    ///
    /// # Errors
    /// Reason why it does not open.
    pub(crate) async fn attach(&self) -> Result<Store, String> {
        if !self.database_url.is_empty() {
            return self.open().await;
        }
        let failed = |error| format!("the store in {} cannot be opened: {error}", self.data_dir.display());
        match Store::attach(&self.data_dir).await {
            // There is no store yet: create it as the service would.
            Err(StoreError::Folder { .. }) => Store::open(&self.data_dir).await.map_err(failed),
            attached => attached.map_err(failed),
        }
    }

    /// Opens the store; waits up to a minute for a database that is not yet available.
    ///
    /// # Errors
    /// Reason why it does not open, without the address, which may contain a password.
    pub(crate) async fn open(&self) -> Result<Store, String> {
        if self.database_url.is_empty() {
            let failed =
                |error| format!("the store in {} cannot be opened: {error}", self.data_dir.display());
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
                Err(StoreError::Busy) if begun.elapsed() < CONNECT_TIMEOUT => {
                    tracing::warn!("the database does not answer yet");
                    tokio::time::sleep(PAUSE).await;
                }
                opened => {
                    return opened
                        .map_err(|error| format!("the database cannot be opened: {}", cause(&error)));
                }
            }
        }
    }
}

/// The error with its source.
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
