//! Starts the service, prints where it is, and stops it in order.

use std::time::Duration;

use axum::serve::ListenerExt;
use tokio::net::TcpListener;

use crate::api;
use crate::config::ServeConfig;
use crate::service::{App, example, jobs};
use crate::store::Store;
use crate::worker::Worker;

/// Longest time for requests to finish after a stop was asked for.
const DRAIN: Duration = Duration::from_secs(20);

/// Runs until the process is asked to stop.
///
/// # Errors
/// What keeps the service from starting, in one sentence.
pub(crate) async fn serve(config: ServeConfig) -> Result<(), String> {
    let store = Store::open(&config.data_dir)
        .await
        .map_err(|error| format!("the store in {} does not open: {error}", config.data_dir.display()))?;
    let app = App::new(store, config.limits(), config.threads);
    if !config.no_example {
        example::load_into_empty(&app).await.map_err(|error| format!("the example cohort: {error}"))?;
    }
    let listener = TcpListener::bind(config.listen)
        .await
        .map_err(|error| format!("cannot listen on {}: {error}", config.listen))?;
    let address = listener.local_addr().map_err(|error| error.to_string())?;
    announce(&format!("http://{address}"));
    tracing::info!(%address, "listening");
    let listener = listener.tap_io(|stream| {
        // Small answers must not wait for more; without the option they are only slower.
        let _ = stream.set_nodelay(true);
    });
    let (stopping, worker) = (app.clone(), Worker::start(&app, config.places(), jobs::run));
    let (stopped, mut stop) = tokio::sync::watch::channel(false);
    let server = axum::serve(listener, api::router(app)).with_graceful_shutdown(async move {
        stop_signal().await;
        tracing::info!("stopping: no new requests");
        stopping.drain();
        worker.stop().await;
        // The receiver lives as long as the server.
        let _ = stopped.send(true);
    });
    tokio::select! {
        outcome = server => outcome.map_err(|error| error.to_string()),
        () = async {
            // The sender is only dropped after a send.
            let _ = stop.wait_for(|stopped| *stopped).await;
            tokio::time::sleep(DRAIN).await;
        } => {
            tracing::warn!("requests were cut off after {} s", DRAIN.as_secs());
            Ok(())
        }
    }
}

/// The one line on standard output that programs wait for, and one to try.
fn announce(address: &str) {
    #[allow(clippy::print_stdout, reason = "programs read the address from here")]
    {
        println!("shapelex is listening on {address}");
        println!("try: curl '{address}/v1/cohorts/example-cells/mean?transformation=similarity'");
    }
}

async fn stop_signal() {
    let interrupt = async {
        if tokio::signal::ctrl_c().await.is_err() {
            std::future::pending::<()>().await;
        }
    };
    #[cfg(unix)]
    let terminate = async {
        match tokio::signal::unix::signal(tokio::signal::unix::SignalKind::terminate()) {
            Ok(mut signal) => {
                signal.recv().await;
            }
            Err(_) => std::future::pending::<()>().await,
        }
    };
    #[cfg(not(unix))]
    let terminate = std::future::pending::<()>();
    tokio::select! { () = interrupt => {}, () = terminate => {} }
}
