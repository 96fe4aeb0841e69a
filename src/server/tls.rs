//! The certificate of the service: read again when its files change or the process is told to (SIGHUP), without a
//! connection being cut. A pair that cannot be used is refused, and the one in use stays.

use std::fs::Metadata;
use std::io;
use std::path::PathBuf;
use std::time::{Duration, SystemTime};

use axum_server::tls_rustls::RustlsConfig;

/// How often the files are looked at.
const GLANCE: Duration = Duration::from_secs(2);

/// What changes when a file is replaced.
type Look = (Option<SystemTime>, u64);

/// A certificate chain and its key, in PEM files.
#[derive(Debug)]
pub(super) struct Certificate {
    chain: PathBuf,
    key: PathBuf,
    config: RustlsConfig,
    seen: Option<[Look; 2]>,
}

impl Certificate {
    /// Reads the files.
    ///
    /// # Errors
    /// Files that cannot be read, or do not belong together, in one sentence.
    pub(super) async fn read(chain: PathBuf, key: PathBuf) -> Result<Self, String> {
        let seen = look(&chain, &key).await.ok();
        let config = RustlsConfig::from_pem_file(&chain, &key).await;
        let config = config.map_err(|error| {
            format!("the certificate {} with the key {}: {error}", chain.display(), key.display())
        })?;
        Ok(Self { chain, key, config, seen })
    }

    /// What connections use, always the newest.
    pub(super) fn config(&self) -> RustlsConfig {
        self.config.clone()
    }

    /// Keeps the certificate new for ever.
    pub(super) async fn watch(mut self) {
        let mut told = Told::new();
        loop {
            tokio::select! {
                () = told.wait() => self.reload().await,
                () = tokio::time::sleep(GLANCE) => match look(&self.chain, &self.key).await {
                    Ok(found) if self.seen == Some(found) => {}
                    // While a file is being replaced there may be none.
                    Err(_) => {}
                    Ok(found) => {
                        self.seen = Some(found);
                        self.reload().await;
                    }
                },
            }
        }
    }

    async fn reload(&self) {
        match self.config.reload_from_pem_file(&self.chain, &self.key).await {
            Ok(()) => tracing::info!("the certificate was read again"),
            Err(error) => tracing::warn!(%error, "the new certificate cannot be used, the old one stays"),
        }
    }
}

async fn look(chain: &std::path::Path, key: &std::path::Path) -> io::Result<[Look; 2]> {
    let (chain, key) = (chain.to_owned(), key.to_owned());
    let of = |found: Metadata| (found.modified().ok(), found.len());
    let both = move || Ok([of(std::fs::metadata(chain)?), of(std::fs::metadata(key)?)]);
    tokio::task::spawn_blocking(both).await.map_err(io::Error::other)?
}

/// Hears the signal by which an operator asks for a reload.
struct Told {
    #[cfg(unix)]
    signal: Option<tokio::signal::unix::Signal>,
}

impl Told {
    #[cfg(unix)]
    fn new() -> Self {
        Self { signal: tokio::signal::unix::signal(tokio::signal::unix::SignalKind::hangup()).ok() }
    }

    #[cfg(not(unix))]
    fn new() -> Self {
        Self {}
    }

    async fn wait(&mut self) {
        #[cfg(unix)]
        if let Some(signal) = &mut self.signal
            && signal.recv().await.is_some()
        {
            return;
        }
        std::future::pending().await
    }
}
