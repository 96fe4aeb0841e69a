//! Calls of libraries that may panic.

use crate::error::{FileError, Place};

/// Runs a step of a library of containers. Should it panic at a file that contradicts itself in a way that the checks before
/// it do not see, that is for the caller a malformed file, as any other contradiction. Tests are told: a check is missing.
pub(super) fn guarded<T>(what: &str, step: impl FnOnce() -> Result<T, FileError>) -> Result<T, FileError> {
    std::panic::catch_unwind(std::panic::AssertUnwindSafe(step)).unwrap_or_else(|panic| {
        if cfg!(test) {
            std::panic::resume_unwind(panic);
        }
        let detail = format!("expected {what} that does not contradict itself, got one that does");
        Err(FileError::malformed(Place::default(), detail))
    })
}
