//! Server: starts the service, announces its address, and shuts it down in order.
//!
//! * [`connections`] — accepting connections, and their time limits;
//! * [`connection_slots`] — a fixed number of connection slots with idle eviction;
//! * [`tls`] — the certificate.

mod connection_slots;
mod connections;
mod tls;

use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use axum::http::HeaderValue;
use axum::http::header::STRICT_TRANSPORT_SECURITY;
use axum_server::tls_rustls::RustlsConfig;
use tokio::net::{TcpListener, TcpSocket};
use tokio_util::sync::CancellationToken;
use tower_http::set_header::SetResponseHeaderLayer;

use self::connections::Connections;
use self::tls::Certificate;
use crate::api;
use crate::config::ServeConfig;
use crate::service::access::Access;
use crate::service::app::{App, build, clock, memory, metrics};
use crate::service::cohorts::{catalogue, example};
use crate::service::hooks::deliver::Deliveries;
use crate::service::{access, dispatch};
use crate::worker::{Worker, tidy};

/// Longest time for requests to finish after a stop was requested.
const DRAIN: Duration = Duration::from_secs(20);

/// HSTS: browsers that connected over TLS use only TLS for a year.
const TLS_ONLY: HeaderValue = HeaderValue::from_static("max-age=31536000");
/// Connections that may wait to be accepted.
const BACKLOG: u32 = 1024;
/// Longest time for the store to merge its data into one file.
const CLOSE: Duration = Duration::from_secs(5);

/// Service that accepts connections.
pub(crate) struct Announced {
    /// Its address, with `http` or `https`.
    pub(crate) address: String,
    is_open: bool,
    has_example: bool,
}

/// Runs until the process is asked to stop.
///
/// # Errors
/// Reason why the service cannot start, in one sentence.
pub(crate) async fn serve(config: ServeConfig) -> Result<(), String> {
    run(config, stop_signal, announce).await
}

/// Runs until `stopped`, which is asked for before the address is announced.
///
/// # Errors
/// As of [`serve`].
pub(crate) async fn run<S: Future<Output = ()>>(
    config: ServeConfig,
    stopped: impl FnOnce() -> io::Result<S>,
    announce: impl FnOnce(&Announced),
) -> Result<(), String> {
    memory::use_large_pages(false);
    ignore_hangup().map_err(|error| format!("signals cannot be handled: {error}"))?;
    // A port in use is found before the data folder is made.
    let socket =
        bind(config.listen).map_err(|error| format!("cannot listen on {}: {error}", config.listen))?;
    let app = start(&config).await?;
    // Installed before the address is announced: an unhandled signal would end the process at once.
    let asked_to_stop = stopped().map_err(|error| format!("signals cannot be handled: {error}"))?;
    let (listener, tls, announced) = listen(&config, socket, &app).await?;
    announce(&announced);
    let worker = Worker::start(&app, config.places(), dispatch::run);
    let deliveries = Deliveries::start(&app);
    let stop = CancellationToken::new();
    let mut router = api::router(app.clone());
    if tls.is_some() {
        router = router.layer(SetResponseHeaderLayer::overriding(STRICT_TRANSPORT_SECURITY, TLS_ONLY));
    }
    let connections = Connections::new(router, tls, &config.connections(), stop.clone());
    let mut served = tokio::spawn(connections.serve(listener));
    tokio::select! {
        // Ends after a stop, or because of a bug.
        ended = &mut served => return ended.map_err(|error| error.to_string()),
        () = asked_to_stop => {}
    }
    tracing::info!("stopping: no new requests");
    // Until the last response is sent, uploads are told to end, new requests are refused, and probes report it.
    app.drain();
    stop.cancel();
    let served = tokio::time::timeout(DRAIN, served);
    let (ended, (), ()) = tokio::join!(served, worker.stop(), deliveries.stop());
    let outcome = match ended {
        Ok(ended) => ended.map_err(|error| error.to_string()),
        Err(_) => {
            tracing::warn!("requests were cut off after {} s", DRAIN.as_secs());
            Ok(())
        }
    };
    close(&app).await;
    outcome
}

/// Opens the store, and starts the work beside requests: metrics, the audit trail, upkeep of the store.
async fn start(config: &ServeConfig) -> Result<App, String> {
    clock::check()?;
    build::check();
    let store = config.place().open().await?;
    metrics::start();
    let access = Access::new(config.access())?;
    let app = App::new(store, config.limits(), config.threads)
        .with_access(access)
        .with_hooks(config.hooks())
        .with_engine(config.engine());
    app.memory.watch(Arc::clone(&app.cache));
    access::check_start(&app, config.listen).await?;
    app.trail().start(&app.store, config.audit_required);
    if !config.no_example
        && access::is_open(&app).await.map_err(|error| error.to_string())?
        && let Err(error) = example::load_into_empty(&app).await
    {
        tracing::warn!(error = error.cause(), "the example cohort cannot be loaded");
    }
    tokio::spawn(tidy::keep_tidy(app.clone(), config.terms()));
    Ok(app)
}

/// Takes an address, on which nobody is listened to yet.
fn bind(address: SocketAddr) -> io::Result<TcpSocket> {
    let socket = if address.is_ipv4() { TcpSocket::new_v4() } else { TcpSocket::new_v6() }?;
    // Elsewhere it would take the port of a running process.
    #[cfg(unix)]
    socket.set_reuseaddr(true)?;
    socket.bind(address)?;
    Ok(socket)
}

/// Listens; returns the configuration of TLS, if the service uses it, and the lines to announce.
async fn listen(
    config: &ServeConfig,
    socket: TcpSocket,
    app: &App,
) -> Result<(TcpListener, Option<RustlsConfig>, Announced), String> {
    let is_open = access::is_open(app).await.map_err(|error| error.to_string())?;
    let listener =
        socket.listen(BACKLOG).map_err(|error| format!("cannot listen on {}: {error}", config.listen))?;
    let address = listener.local_addr().map_err(|error| error.to_string())?;
    let certificate = certificate(config).await?;
    let scheme = if certificate.is_some() { "https" } else { "http" };
    // Logged before the address is announced, so that readers of the address find it in the log.
    if is_open {
        tracing::warn!(
            "access is open: without keys and identity provider, all users of this machine are administrators"
        );
    }
    tracing::info!(%address, scheme, "listening");
    let has_example = is_open && catalogue::find(app, example::NAME).await.is_ok();
    let announced = Announced { address: format!("{scheme}://{address}"), is_open, has_example };
    let tls = certificate.as_ref().map(Certificate::config);
    if let Some(certificate) = certificate {
        tokio::spawn(certificate.watch());
    }
    Ok((listener, tls, announced))
}

/// Writes the rest of the audit trail, and closes the store.
async fn close(app: &App) {
    app.trail().close().await;
    if tokio::time::timeout(CLOSE, app.store.close()).await.is_err() {
        tracing::warn!("the store is still at work after {} s; nothing is lost", CLOSE.as_secs());
    }
}

/// Certificate, if the service uses TLS.
async fn certificate(config: &ServeConfig) -> Result<Option<Certificate>, String> {
    let (chain, key) = (config.tls_cert.clone(), config.tls_key.clone());
    if chain.as_os_str().is_empty() {
        return Ok(None);
    }
    Certificate::read(chain, key).await.map(Some)
}

/// Prints the address line that programs wait for, a request for the example cohort if that exists, and a warning if access
/// is open.
fn announce(announced: &Announced) {
    let Announced { address, is_open, has_example } = announced;
    #[allow(clippy::print_stdout, reason = "programs read the address from here")]
    {
        println!("shapelex is listening on {address}");
        if *has_example {
            let name = example::NAME;
            println!("try: curl '{address}/v1/cohorts/{name}/mean?transformation=similarity'");
        }
        if *is_open {
            println!(
                "access is open to all users of this machine; `shapelex key create` makes the first key and closes it"
            );
        }
    }
}

/// Catches SIGHUP, which asks a service to read its certificate again: without one there is nothing to read.
#[cfg(unix)]
fn ignore_hangup() -> io::Result<()> {
    use tokio::signal::unix::{SignalKind, signal};
    // The handler stays installed after the listener is dropped.
    signal(SignalKind::hangup()).map(drop)
}

#[cfg(not(unix))]
fn ignore_hangup() -> io::Result<()> {
    Ok(())
}

/// Installs handlers for the stop signals; the future resolves at the first one.
#[cfg(unix)]
fn stop_signal() -> io::Result<impl Future<Output = ()>> {
    use tokio::signal::unix::{SignalKind, signal};
    let (mut interrupt, mut terminate) = (signal(SignalKind::interrupt())?, signal(SignalKind::terminate())?);
    Ok(async move {
        tokio::select! { _ = interrupt.recv() => {}, _ = terminate.recv() => {} }
    })
}

/// Future that resolves when a stop is requested at the terminal.
#[cfg(not(unix))]
fn stop_signal() -> io::Result<impl Future<Output = ()>> {
    Ok(async {
        if tokio::signal::ctrl_c().await.is_err() {
            std::future::pending::<()>().await;
        }
    })
}
