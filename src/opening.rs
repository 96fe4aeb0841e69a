//! The store that the settings name, for the service and for the commands beside it.

use std::path::PathBuf;
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
            return Store::open(&self.data_dir).await.map_err(failed);
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
