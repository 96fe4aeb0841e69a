//! Text form of the metrics.

use metrics::gauge;

use super::build;
use super::clock::now_ms;
use super::context::App;
use super::metrics::*;
use super::pool::REQUEST_LANES;

/// All metrics in the Prometheus text format, with current values for those of the database.
pub async fn scrape(app: &App) -> String {
    start();
    let read = app.store.measure(now_ms()).await;
    gauge!(STORE_UP).set(if read.is_ok() { 1.0 } else { 0.0 });
    match read {
        Ok(found) => {
            gauge!(JOBS_QUEUED).set(found.jobs_queued as f64);
            gauge!(JOBS_RUNNING).set(found.jobs_running as f64);
            gauge!(JOBS_OLDEST).set(found.oldest_queued_ms as f64 / 1000.0);
            gauge!(STORE_BYTES).set(found.database_bytes as f64);
        }
        Err(error) => tracing::warn!(%error, "the store could not be read for a scrape of the metrics"),
    }
    match app.store.measure_hooks().await {
        Ok(found) => {
            gauge!(HOOK_LAG).set(found.lag as f64);
            gauge!(HOOKS_FAILED).set(found.failed as f64);
        }
        Err(error) => tracing::warn!(%error, "the hooks could not be read for a scrape of the metrics"),
    }
    let stuck = app.pool.stuck_lane();
    for lane in REQUEST_LANES {
        gauge!(COMPUTE_STUCK, "lane" => lane).set(if stuck == Some(lane) { 1.0 } else { 0.0 });
    }
    if let Some(bytes) = app.store.free_bytes() {
        gauge!(STORE_FREE).set(bytes as f64);
    }
    let commit = build::COMMIT.unwrap_or_default();
    gauge!(BUILD_INFO, "version" => build::VERSION, "commit" => commit, "rustc" => build::RUSTC,
        "engine" => app.store.engine())
    .set(1.0);
    render()
}
