//! Metrics of the service: one table of names and meanings, and recording functions.
//!
//! Names are stable and listed in `docs/observability.md`. Labels come from small fixed sets (route templates, kinds,
//! outcomes) and never contain data sent by a client.

use std::sync::OnceLock;
use std::time::Duration;

use metrics::{counter, gauge, histogram};

use super::pool::LANES;
pub use super::recorder::Kind;
use super::recorder::Registry;
use crate::domain::job::JobKind;
use crate::store::metrics as store;

/// Answered requests.
pub const HTTP_REQUESTS: &str = "shapelex_http_requests_total";
/// Time until the head of the response is sent.
pub const HTTP_DURATION: &str = "shapelex_http_request_duration_seconds";
/// Requests whose response is not complete.
pub const HTTP_IN_FLIGHT: &str = "shapelex_http_requests_in_flight";
/// Bytes of received bodies.
pub const HTTP_BYTES_IN: &str = "shapelex_http_request_body_bytes_total";
/// Bytes of sent bodies.
pub const HTTP_BYTES_OUT: &str = "shapelex_http_response_body_bytes_total";

pub(super) const JOBS_QUEUED: &str = "shapelex_jobs_queued";
pub(super) const JOBS_RUNNING: &str = "shapelex_jobs_running";
pub(super) const JOBS_OLDEST: &str = "shapelex_jobs_oldest_queued_seconds";
const JOB_ATTEMPTS: &str = "shapelex_job_attempts_total";
const JOB_DURATION: &str = "shapelex_job_attempt_duration_seconds";
pub(super) const JOBS_CANCELLED: &str = "shapelex_jobs_cancelled_total";
pub(super) const JOBS_ABANDONED: &str = "shapelex_jobs_abandoned_total";
const JOB_CLAIMS_LOST: &str = "shapelex_job_claims_lost_total";
pub(super) const STORE_UP: &str = "shapelex_store_up";
pub(super) const STORE_BYTES: &str = "shapelex_store_database_bytes";
pub(super) const STORE_FREE: &str = "shapelex_store_disk_free_bytes";
const COMPUTE_WAITING: &str = "shapelex_compute_waiting";
const COMPUTE_RUNNING: &str = "shapelex_compute_running";
const COMPUTE_WAIT: &str = "shapelex_compute_wait_seconds";
const COMPUTE_REFUSED: &str = "shapelex_compute_refused_total";
const COMPUTE_PREDICTED: &str = "shapelex_compute_predicted_microseconds_total";
const COMPUTE_TAKEN: &str = "shapelex_compute_microseconds_total";
pub(super) const COMPUTE_STUCK: &str = "shapelex_compute_stuck";
const CACHE_LOOKUPS: &str = "shapelex_cache_lookups_total";
const AUDIT_WAITING: &str = "shapelex_audit_waiting";
const AUDIT_WRITTEN: &str = "shapelex_audit_entries_total";
const AUDIT_FAILURES: &str = "shapelex_audit_write_failures_total";
const AUDIT_LOST: &str = "shapelex_audit_entries_lost_total";
const CLOCK: &str = "shapelex_clock_believed";
const HOOK_DELIVERIES: &str = "shapelex_hook_deliveries_total";
pub(super) const HOOK_LAG: &str = "shapelex_hook_lag_changes";
pub(super) const HOOKS_FAILED: &str = "shapelex_hooks_failed";
pub(super) const BUILD_INFO: &str = "shapelex_build_info";

/// All metrics: name, type, meaning.
pub const METRICS: &[(&str, Kind, &str)] = &[
    (HTTP_REQUESTS, Kind::Counter, "Requests, by method, route and class of the status"),
    (HTTP_DURATION, Kind::Histogram, "Time until the response headers"),
    (HTTP_IN_FLIGHT, Kind::Gauge, "Requests whose response is not yet sent completely"),
    (HTTP_BYTES_IN, Kind::Counter, "Bytes of request bodies, as received"),
    (HTTP_BYTES_OUT, Kind::Counter, "Bytes of response bodies, as sent"),
    (JOBS_QUEUED, Kind::Gauge, "Queued jobs"),
    (JOBS_RUNNING, Kind::Gauge, "Running jobs"),
    (JOBS_OLDEST, Kind::Gauge, "Time since the longest waiting job could have started"),
    (JOB_ATTEMPTS, Kind::Counter, "Finished attempts at jobs, by kind and outcome"),
    (JOB_DURATION, Kind::Histogram, "Time that attempts at jobs took, by kind"),
    (JOBS_CANCELLED, Kind::Counter, "Cancelled jobs"),
    (JOBS_ABANDONED, Kind::Counter, "Jobs given up because every attempt was interrupted"),
    (JOB_CLAIMS_LOST, Kind::Counter, "Attempts that lost their job to another process"),
    (HOOK_DELIVERIES, Kind::Counter, "Attempts at deliveries to hooks, by outcome"),
    (HOOK_LAG, Kind::Gauge, "Changes that the slowest active hook has not examined"),
    (HOOKS_FAILED, Kind::Gauge, "Hooks whose deliveries were given up"),
    (STORE_UP, Kind::Gauge, "Whether the store could be read for this scrape, 1 or 0"),
    (STORE_BYTES, Kind::Gauge, "Size of the database"),
    (STORE_FREE, Kind::Gauge, "Free space on the disk of the data folder"),
    (store::WRITE_WAIT, Kind::Histogram, "Time that transactions waited for their turn to write"),
    (store::WRITE, Kind::Histogram, "Time that transactions took to write"),
    (store::ERRORS, Kind::Counter, "Database failures, by kind"),
    (COMPUTE_WAITING, Kind::Gauge, "Computations waiting for a thread, by lane"),
    (COMPUTE_RUNNING, Kind::Gauge, "Running computations, by lane"),
    (COMPUTE_WAIT, Kind::Histogram, "Time that computations waited for a thread, by lane"),
    (COMPUTE_REFUSED, Kind::Counter, "Computations refused because the queue was full, by lane"),
    (COMPUTE_PREDICTED, Kind::Counter, "Predicted CPU time of the finished computations, by lane"),
    (COMPUTE_TAKEN, Kind::Counter, "Time that computations spent on a thread, by lane"),
    (
        COMPUTE_STUCK,
        Kind::Gauge,
        "Whether all threads have been busy with one computation past its time limit, 1 or 0, by lane",
    ),
    (CACHE_LOOKUPS, Kind::Counter, "Cache lookups, by cache and outcome"),
    (AUDIT_WAITING, Kind::Gauge, "Audit entries not yet on disk"),
    (AUDIT_WRITTEN, Kind::Counter, "Audit entries on disk"),
    (AUDIT_FAILURES, Kind::Counter, "Groups of audit entries that could not be written and are retried"),
    (AUDIT_LOST, Kind::Counter, "Reads missing from the audit trail because it could not be written"),
    (CLOCK, Kind::Gauge, "Whether the clock is trusted: while it is 0, nothing is removed for its age"),
    (BUILD_INFO, Kind::Gauge, "1, with the version, commit, compiler and database engine as labels"),
];

static REGISTRY: OnceLock<&'static Registry> = OnceLock::new();

/// Starts recording in this process; earlier events are not counted, and a second call has no effect.
pub fn start() {
    registry();
}

fn registry() -> &'static Registry {
    REGISTRY.get_or_init(|| {
        let registry: &'static Registry = Box::leak(Box::default());
        metrics::set_global_recorder(registry).expect("nothing else in this program counts");
        begin_at_zero();
        registry
    })
}

/// All metrics in the Prometheus text format.
pub(super) fn render() -> String {
    registry().render(METRICS)
}

/// Sets counters of rare events to zero, so that alerts notice the first event.
fn begin_at_zero() {
    for name in [JOBS_CANCELLED, JOBS_ABANDONED, JOB_CLAIMS_LOST, AUDIT_WRITTEN, AUDIT_FAILURES, AUDIT_LOST] {
        counter!(name).absolute(0);
    }
    for kind in store::ERROR_KINDS {
        counter!(store::ERRORS, "kind" => kind).absolute(0);
    }
    for outcome in ["delivered", "failed"] {
        counter!(HOOK_DELIVERIES, "outcome" => outcome).absolute(0);
    }
    for lane in LANES {
        counter!(COMPUTE_REFUSED, "lane" => lane).absolute(0);
        gauge!(COMPUTE_WAITING, "lane" => lane).set(0.0);
        gauge!(COMPUTE_RUNNING, "lane" => lane).set(0.0);
    }
    for lane in LANES {
        counter!(COMPUTE_PREDICTED, "lane" => lane).absolute(0);
        counter!(COMPUTE_TAKEN, "lane" => lane).absolute(0);
    }
    gauge!(AUDIT_WAITING).set(0.0);
    gauge!(HTTP_IN_FLIGHT).set(0.0);
    gauge!(CLOCK).set(1.0);
}

/// Records that a computation begins to wait in a lane.
pub(crate) fn compute_waits(lane: &'static str) -> InQueue {
    gauge!(COMPUTE_WAITING, "lane" => lane).increment(1);
    InQueue { lane, since: std::time::Instant::now() }
}

/// Records that a computation was refused.
pub(crate) fn compute_refused(lane: &'static str) {
    counter!(COMPUTE_REFUSED, "lane" => lane).increment(1);
}

/// Records the end of a computation, with predicted and actual time in seconds.
pub(crate) fn compute_ended(lane: &'static str, seconds: f64, taken: f64) {
    // Counters hold integers.
    counter!(COMPUTE_PREDICTED, "lane" => lane).increment((1e6 * seconds) as u64);
    counter!(COMPUTE_TAKEN, "lane" => lane).increment((1e6 * taken) as u64);
}

/// Records the predicted time in seconds of work that goes on in the computation that planned it.
pub(crate) fn compute_planned(lane: &'static str, seconds: f64) {
    counter!(COMPUTE_PREDICTED, "lane" => lane).increment((1e6 * seconds) as u64);
}

/// A waiting computation; dropped when it begins or is given up.
#[derive(Debug)]
pub(crate) struct InQueue {
    lane: &'static str,
    since: std::time::Instant,
}

impl InQueue {
    /// Records that the computation begins.
    pub(crate) fn begin(self) -> InWork {
        histogram!(COMPUTE_WAIT, "lane" => self.lane).record(self.since.elapsed());
        gauge!(COMPUTE_RUNNING, "lane" => self.lane).increment(1);
        InWork { lane: self.lane }
    }
}

impl Drop for InQueue {
    fn drop(&mut self) {
        gauge!(COMPUTE_WAITING, "lane" => self.lane).decrement(1);
    }
}

/// A running computation; dropped when it ends.
#[derive(Debug)]
pub(crate) struct InWork {
    lane: &'static str,
}

impl Drop for InWork {
    fn drop(&mut self) {
        gauge!(COMPUTE_RUNNING, "lane" => self.lane).decrement(1);
    }
}

/// Passes on the result of a cache lookup, counted as hit or miss.
pub(crate) fn looked_up<T>(cache: &'static str, found: Option<T>) -> Option<T> {
    let outcome = if found.is_some() { "hit" } else { "miss" };
    counter!(CACHE_LOOKUPS, "cache" => cache, "outcome" => outcome).increment(1);
    found
}

/// Records the end of an attempt at a job.
pub(crate) fn attempt_ended(kind: JobKind, outcome: &'static str, time: Duration) {
    counter!(JOB_ATTEMPTS, "kind" => kind.as_str(), "outcome" => outcome).increment(1);
    histogram!(JOB_DURATION, "kind" => kind.as_str()).record(time);
}

/// Records that a job was cancelled.
pub(crate) fn job_cancelled() {
    counter!(JOBS_CANCELLED).increment(1);
}

/// Records that jobs were given up.
pub(crate) fn jobs_abandoned(count: usize) {
    counter!(JOBS_ABANDONED).increment(count as u64);
}

/// Records an attempt at a delivery to a hook.
pub(crate) fn hook_delivery(succeeded: bool) {
    counter!(HOOK_DELIVERIES, "outcome" => if succeeded { "delivered" } else { "failed" }).increment(1);
}

/// Records that an attempt has lost its job to another process.
pub(crate) fn claim_lost() {
    counter!(JOB_CLAIMS_LOST).increment(1);
}

/// Sets the number of waiting audit entries.
pub(crate) fn audit_waits(count: usize) {
    gauge!(AUDIT_WAITING).set(count as f64);
}

/// Records that audit entries were written.
pub(crate) fn audit_written(count: usize) {
    counter!(AUDIT_WRITTEN).increment(count as u64);
}

/// Records that a group of audit entries could not be written.
pub(crate) fn audit_failed() {
    counter!(AUDIT_FAILURES).increment(1);
}

/// Records a read answered without an audit entry.
pub(crate) fn audit_lost() {
    counter!(AUDIT_LOST).increment(1);
}

/// Sets whether the clock is trusted.
pub(crate) fn clock_is_believed(is_believed: bool) {
    gauge!(CLOCK).set(if is_believed { 1.0 } else { 0.0 });
}
