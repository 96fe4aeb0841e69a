//! Names of what the store counts; what they mean stands in the table of the service's metrics.

use std::time::Duration;

use super::engine::Failure;

/// Waiting for the turn to write.
pub const WRITE_WAIT: &str = "shapelex_store_write_wait_seconds";
/// Writing, from the begin of a transaction to its commit.
pub const WRITE: &str = "shapelex_store_write_seconds";
/// Failures, by kind.
pub const ERRORS: &str = "shapelex_store_errors_total";

/// The kinds of failures.
pub const ERROR_KINDS: [&str; 5] = ["busy", "damaged", "full", "read_only", "other"];

/// The database did not do it; texts that it refuses are the client's fault.
pub(super) fn failed(failure: Option<Failure>) {
    let [busy, damaged, full, read_only, other] = ERROR_KINDS;
    let kind = match failure {
        Some(Failure::Passing) => busy,
        Some(Failure::Damaged) => damaged,
        Some(Failure::Full) => full,
        Some(Failure::ReadOnly) => read_only,
        Some(Failure::Text) => return,
        None => other,
    };
    metrics::counter!(ERRORS, "kind" => kind).increment(1);
}

pub(super) fn waited(time: Duration) {
    metrics::histogram!(WRITE_WAIT).record(time);
}

pub(super) fn wrote(time: Duration) {
    metrics::histogram!(WRITE).record(time);
}
