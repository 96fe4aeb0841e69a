//! Priorities of threads: jobs give way to all requests, and heavy requests to light ones.

/// Niceness of threads for light requests.
pub(super) const LIGHT: i32 = 0;
/// Niceness of threads for heavy requests.
pub(super) const HEAVY: i32 = 5;
/// Niceness of threads for jobs.
pub(super) const JOB: i32 = 10;

/// Lowers the priority of this thread. On systems other than Linux it would affect the whole process.
#[cfg(target_os = "linux")]
pub(super) fn give_way(niceness: i32) {
    if let Err(error) = rustix::process::nice(niceness) {
        tracing::debug!(%error, "the priority of a compute thread could not be changed");
    }
}

#[cfg(not(target_os = "linux"))]
pub(super) fn give_way(_: i32) {}
