//! TLS certificate of the service. It is reloaded when its files change or on SIGHUP, without closing connections. An
//! unusable pair is refused, and the current one stays in use.

use std::fs::Metadata;
use std::io;
use std::path::PathBuf;
use std::time::{Duration, SystemTime};

use axum_server::tls_rustls::RustlsConfig;

/// Interval between checks of the files.
const GLANCE: Duration = Duration::from_secs(2);

/// Modification time and size, which change when a file is replaced.
type Look = (Option<SystemTime>, u64);

/// Certificate chain and private key, in PEM files.
#[derive(Debug)]
pub(super) struct Certificate {
    chain: PathBuf,
    key: PathBuf,
    config: RustlsConfig,
    seen: Option<[Look; 2]>,
}

impl Certificate {
    /// Loads the files.
    ///
    /// # Errors
    /// Files that cannot be read or do not match, in one sentence.
    pub(super) async fn read(chain: PathBuf, key: PathBuf) -> Result<Self, String> {
        let seen = look(&chain, &key).await.ok();
        let config = RustlsConfig::from_pem_file(&chain, &key).await;
        let config = config.map_err(|error| {
            format!("the certificate {} with the key {}: {error}", chain.display(), key.display())
        })?;
        Ok(Self { chain, key, config, seen })
    }

    /// TLS configuration for connections, always with the latest certificate.
    pub(super) fn config(&self) -> RustlsConfig {
        self.config.clone()
    }

    /// Reloads the certificate whenever needed, forever.
    pub(super) async fn watch(mut self) {
        let mut told = Told::new();
        loop {
            tokio::select! {
                () = told.wait() => self.reload().await,
                () = tokio::time::sleep(GLANCE) => match look(&self.chain, &self.key).await {
                    Ok(found) if self.seen == Some(found) => {}
                    // The files may be missing while they are being replaced.
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
            Ok(()) => tracing::info!("the certificate was reloaded"),
            Err(error) => {
                tracing::warn!(%error, "the new certificate cannot be used, the old one stays in use")
            }
        }
    }
}

async fn look(chain: &std::path::Path, key: &std::path::Path) -> io::Result<[Look; 2]> {
    let (chain, key) = (chain.to_owned(), key.to_owned());
    let of = |found: Metadata| (found.modified().ok(), found.len());
    let both = move || Ok([of(std::fs::metadata(chain)?), of(std::fs::metadata(key)?)]);
    tokio::task::spawn_blocking(both).await.map_err(io::Error::other)?
}

/// Listens for the signal that requests a reload (SIGHUP).
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
