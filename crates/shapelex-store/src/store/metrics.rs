//! Names of the store's metrics; the metrics table of the service describes them.

use std::time::Duration;

use super::failure::Failure;

/// Time spent waiting for the turn to write.
pub const WRITE_WAIT: &str = "shapelex_store_write_wait_seconds";
/// Duration of write transactions, from begin to commit.
pub const WRITE: &str = "shapelex_store_write_seconds";
/// Number of failures, by kind.
pub const ERRORS: &str = "shapelex_store_errors_total";

/// Kinds of failures.
pub const ERROR_KINDS: [&str; 5] = ["busy", "damaged", "full", "read_only", "other"];

/// Counts a failure of the database; texts it refuses are the client's fault and not counted.
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
