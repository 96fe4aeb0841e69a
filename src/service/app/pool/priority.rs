//! Priorities of threads: jobs give way to all requests, and heavy requests to light ones.

#[cfg(target_os = "linux")]
use std::sync::Once;

/// Niceness of threads for light requests.
pub(super) const LIGHT: i32 = 0;
/// Niceness of threads for heavy requests.
pub(super) const HEAVY: i32 = 5;
/// Niceness of threads for jobs.
pub(super) const JOB: i32 = 10;

/// Lowers the priority of this thread. On systems other than Linux it would affect the whole process.
#[cfg(target_os = "linux")]
pub(super) fn give_way(niceness: i32) {
    static SAID: Once = Once::new();
    if let Err(error) = rustix::process::nice(niceness) {
        SAID.call_once(|| {
            tracing::warn!(
                %error,
                "the priority of a thread cannot be changed (setpriority): jobs and heavy requests do not give way to light ones"
            );
        });
    }
}

#[cfg(not(target_os = "linux"))]
pub(super) fn give_way(_: i32) {}
