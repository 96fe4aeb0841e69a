//! Bounds on what a file may claim, checked before memory is taken.

use super::error::{FileError, Place};

/// Largest magnitude of a coordinate, that of the service.
pub const MAX_COORDINATE: f64 = 1e100;

/// Most that is read of one file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Number of bytes after decompression, of all files of an archive together.
    pub content: u64,
    /// Number of bytes that are held at once: whole files of formats that cannot be streamed, one feature of others.
    pub held: usize,
    /// Number of points of one record; a mesh may have four times as many faces.
    pub points: usize,
    /// Number of records.
    pub records: u64,
    /// Depth of nested sequences, groups and lists.
    pub depth: usize,
}

impl Default for Limits {
    /// For files on the machine of the caller: 64 GiB in all, 1 GiB at once, 2²² points, 10⁹ records, depth 64.
    fn default() -> Self {
        Self { content: 64 << 30, held: 1 << 30, points: 1 << 22, records: 1_000_000_000, depth: 64 }
    }
}

impl Limits {
    /// A number of points of one record, if it is not too large.
    ///
    /// # Errors
    /// [`FaultKind::TooLarge`](super::FaultKind::TooLarge) at `place`.
    pub fn points(&self, count: u64, place: impl FnOnce() -> Place) -> Result<usize, FileError> {
        self.count(count, self.points, "points of a shape", place)
    }

    /// A number of faces of one mesh, if it is not too large.
    ///
    /// # Errors
    /// [`FaultKind::TooLarge`](super::FaultKind::TooLarge) at `place`.
    pub fn faces(&self, count: u64, place: impl FnOnce() -> Place) -> Result<usize, FileError> {
        self.count(count, self.points.saturating_mul(4), "faces of a mesh", place)
    }

    fn count(
        &self,
        count: u64,
        limit: usize,
        what: &str,
        place: impl FnOnce() -> Place,
    ) -> Result<usize, FileError> {
        match usize::try_from(count) {
            Ok(count) if count <= limit => Ok(count),
            _ => Err(FileError::too_large(place(), format!("expected at most {limit} {what}, got {count}"))),
        }
    }
}
