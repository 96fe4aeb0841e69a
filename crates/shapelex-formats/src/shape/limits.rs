//! Bounds on the claims of a file, checked before memory is taken.

use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;
use std::rc::Rc;

use crate::error::{FileError, Place};

/// Largest magnitude of a coordinate, that of the service.
pub const MAX_COORDINATE: f64 = 1e100;

/// Most coordinates of a point. A missing point takes as much memory as one that is there, and a few characters of a file.
pub(super) const MAX_DIMENSION: usize = 16;

/// Most bytes that attributes and metadata of one record take in memory. Many records may have the same, as the rings of an object
/// do.
pub(super) const MAX_ATTRIBUTES: usize = 16 << 20;

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

    /// A number of rings, lines and groups of points of one object, if it is not too large.
    pub(super) fn rings(&self, count: usize, place: impl FnOnce() -> Place) -> Result<usize, FileError> {
        self.count(count as u64, self.points, "rings of an object", place)
    }

    /// Number of bytes that may be made of a file of `size` bytes, which are held beside them: 8 MiB, and the amount of
    /// [`memory`](Self::memory).
    pub(super) fn made(&self, size: usize) -> usize {
        const FREE: usize = 8 << 20;
        FREE.saturating_add(self.memory(size)).saturating_sub(size.min(self.held))
    }

    /// Memory for a file of `size` bytes while it is read: three times the held part of it, the bytes themselves and the values made of
    /// them; and 16 times its size as far as that may be held, since formats compress their content.
    pub fn memory(&self, size: usize) -> usize {
        let expanded = size.saturating_mul(16).min(self.held);
        size.min(self.held).saturating_mul(3).saturating_add(expanded)
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

/// Memory for the numbers of a file, which may take more bytes than the file: they are compressed, narrow or used again.
#[derive(Debug)]
pub(super) struct Room {
    most: usize,
    left: Cell<usize>,
}

impl Room {
    /// Memory for those of a file of `size` bytes.
    pub(super) fn new(limits: &Limits, size: usize) -> Self {
        let most = limits.made(size);
        Self { most, left: Cell::new(most) }
    }

    /// Takes the memory of numbers in double precision.
    ///
    /// # Errors
    /// [`FaultKind::TooLarge`](super::FaultKind::TooLarge) at `place`.
    pub(super) fn take(&self, numbers: usize, place: impl FnOnce() -> Place) -> Result<(), FileError> {
        let left = self.left.get().checked_sub(numbers.saturating_mul(8)).ok_or_else(|| {
            let detail =
                format!("expected at most {} bytes of numbers in double precision, got more", self.most);
            FileError::too_large(place(), detail)
        })?;
        self.left.set(left);
        Ok(())
    }
}

/// Bound on work that the structure of a file may cause beyond that of its bytes: some for any file, and more for each byte.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bound {
    /// The work, in the plural; no two bounds have the same.
    pub(super) what: &'static str,
    pub(super) free: u64,
    pub(super) per_byte: u64,
}

/// Counts work within a bound. Clones count together.
#[derive(Debug, Clone)]
pub(super) struct Budget {
    bound: Bound,
    taken: Rc<Cell<u64>>,
    read: Rc<Cell<u64>>,
}

impl Budget {
    /// For bytes that `read` counts.
    pub(super) fn new(bound: Bound, read: Rc<Cell<u64>>) -> Self {
        Self { bound, taken: Rc::default(), read }
    }

    /// Takes an amount.
    ///
    /// # Errors
    /// [`FaultKind::TooLarge`](super::FaultKind::TooLarge), if more is taken than the bytes that are read may cause.
    pub(super) fn take(&self, amount: u64) -> Result<(), FileError> {
        let (taken, read) = (self.taken.get().saturating_add(amount), self.read.get());
        self.taken.set(taken);
        let most = self.bound.free.saturating_add(self.bound.per_byte.saturating_mul(read));
        if taken <= most {
            return Ok(());
        }
        let detail = format!("expected at most {most} {} in {read} bytes, got more", self.bound.what);
        Err(FileError::too_large(Place::default(), detail))
    }

    /// Amount taken so far.
    #[cfg(test)]
    pub(super) fn taken(&self) -> u64 {
        self.taken.get()
    }
}

/// The budgets of a file, which those within it share: an archive of many files may cause no more than one file of all bytes.
#[derive(Debug, Clone, Default)]
pub(super) struct Budgets(Rc<RefCell<BTreeMap<&'static str, Budget>>>);

impl Budgets {
    /// The budget of a bound, for bytes that `read` counts.
    pub(super) fn get(&self, bound: Bound, read: &Rc<Cell<u64>>) -> Budget {
        let mut all = self.0.borrow_mut();
        all.entry(bound.what).or_insert_with(|| Budget::new(bound, Rc::clone(read))).clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_made_of_a_file_grows_with_it() {
        let limits = Limits { held: 64 << 20, ..Limits::default() };
        let mega = 1 << 20;
        assert_eq!([0, mega, 64 * mega].map(|size| limits.made(size) / mega), [8, 26, 200]);
        let room = Room::new(&limits, 0);
        assert!(room.take(mega - 1, Place::default).is_ok());
        let refused = room.take(2, || Place::item(3)).expect_err("no room");
        assert_eq!(
            refused.to_string(),
            "item 3: expected at most 8388608 bytes of numbers in double precision, got more"
        );
        assert!(room.take(1, Place::default).is_ok());
    }

    #[test]
    fn work_is_in_proportion_to_bytes() {
        let read = Rc::new(Cell::new(0));
        let (bound, budgets) = (Bound { what: "cells", free: 1 << 23, per_byte: 64 }, Budgets::default());
        let budget = budgets.get(bound, &read);
        assert!(budget.take(1 << 23).is_ok());
        read.set(100);
        assert!(budget.take(6400).is_ok());
        let refused = budget.take(1).expect_err("one more");
        assert_eq!(refused.to_string(), "expected at most 8395008 cells in 100 bytes, got more");
        read.set(101);
        assert!(budgets.get(bound, &read).take(63).is_ok(), "of another file within the same one");
        assert!(budgets.get(bound, &read).take(1).is_err());
        assert!(budgets.get(Bound { what: "bytes", ..bound }, &read).take(1).is_ok());
        read.set(1000);
        assert!(budget.take(u64::MAX).is_err());
    }
}
