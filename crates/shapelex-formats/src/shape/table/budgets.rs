//! What may be made of a table beyond its bytes: cells without bytes of their own, dictionaries that grow piece by piece.

use std::collections::BTreeMap;

use super::super::error::{FileError, Place};

/// Cells of a file: the values of all its columns, those within lists too. Columns of nulls, flags and constants take next to no
/// bytes for them, but as much work as others.
#[derive(Debug, Default)]
pub(super) struct Cells {
    taken: u64,
}

impl Cells {
    /// Number of cells that need no bytes.
    const FREE: u64 = 1 << 23;
    /// Number of cells for each byte of the file beyond them.
    const PER_BYTE: u64 = 64;

    /// Takes cells of a file of which `bytes` are read.
    ///
    /// # Errors
    /// More cells than these bytes may have.
    pub(super) fn take(&mut self, cells: u64, bytes: u64) -> Result<(), FileError> {
        self.taken = self.taken.saturating_add(cells);
        let most = bytes.saturating_mul(Self::PER_BYTE).saturating_add(Self::FREE);
        if self.taken <= most {
            return Ok(());
        }
        let detail = format!(
            "expected at most {most} cells, columns times rows, got more: {} in {bytes} bytes",
            self.taken
        );
        Err(FileError::too_large(Place::default(), detail))
    }
}

/// Values of a dictionary, or more of them.
#[derive(Debug, Clone, Copy)]
pub(super) struct Dictionary {
    pub(super) id: i64,
    pub(super) bytes: u64,
    /// Whether the values are added to those that are known.
    pub(super) is_delta: bool,
}

/// Sizes of the dictionaries that the decoder keeps. It copies a dictionary as a whole whenever values are added to it.
#[derive(Debug, Default)]
pub(super) struct Dictionaries {
    by_id: BTreeMap<i64, u64>,
    kept: u64,
    /// Bytes that were copied.
    copied: u64,
}

impl Dictionaries {
    /// Number of bytes that may be copied in any file.
    const FREE: u64 = 64 << 20;
    /// Number of bytes that may be copied for each byte of the file beyond them.
    const PER_BYTE: u64 = 16;
    /// Bytes of a dictionary beside its values, of which 64 take no bytes.
    const OWN: u64 = 64;

    /// Number of bytes of all dictionaries.
    pub(super) fn kept(&self) -> u64 {
        self.kept
    }

    /// Adds or replaces values of a dictionary in a file of which `read` bytes are read.
    ///
    /// # Errors
    /// More copies than a file of this size may want.
    pub(super) fn add(&mut self, dictionary: Dictionary, read: u64) -> Result<(), FileError> {
        let known = self.by_id.entry(dictionary.id).or_default();
        let before = *known;
        let new = dictionary.bytes.saturating_add(Self::OWN);
        let after = if dictionary.is_delta { before.saturating_add(new) } else { new };
        *known = after;
        self.kept = self.kept.saturating_sub(before).saturating_add(after);
        if !dictionary.is_delta {
            return Ok(());
        }
        self.copied = self.copied.saturating_add(after);
        let most = read.saturating_mul(Self::PER_BYTE).saturating_add(Self::FREE);
        if self.copied <= most {
            return Ok(());
        }
        let detail = format!(
            "expected additions to dictionaries that copy at most {most} bytes, got {}; write whole dictionaries",
            self.copied
        );
        Err(FileError::too_large(Place::default(), detail))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_in_proportion_to_bytes() {
        let mut cells = Cells::default();
        assert!(cells.take(1 << 23, 0).is_ok());
        assert!(cells.take(6400, 100).is_ok());
        let refused = cells.take(1, 100).expect_err("one more");
        assert_eq!(
            refused.to_string(),
            "expected at most 8395008 cells, columns times rows, got more: 8395009 in 100 bytes"
        );
        assert!(cells.take(63, 101).is_ok());
        assert!(cells.take(u64::MAX, 1000).is_err());
    }

    #[test]
    fn sizes_of_dictionaries_are_summed_as_they_change() {
        let mut dictionaries = Dictionaries::default();
        let mut add = |id: i64, bytes: u64, is_delta: bool| {
            dictionaries.add(Dictionary { id, bytes, is_delta }, 0).expect("small");
            dictionaries.kept()
        };
        assert_eq!(add(1, 1000, false), 1064);
        assert_eq!(add(2, 500, false), 1628);
        assert_eq!(add(1, 100, true), 1792);
        assert_eq!(add(1, 10, false), 638, "others in the place of 1228 bytes");
        assert_eq!(add(3, 10, true), 712, "of a dictionary that is not known, which the decoder refuses");
    }

    #[test]
    fn every_addition_counts_as_the_dictionary_that_it_makes() {
        let mut dictionaries = Dictionaries::default();
        let mut add = |bytes: u64, is_delta: bool, read: u64| {
            dictionaries.add(Dictionary { id: 7, bytes, is_delta }, read)
        };
        assert!(add((1 << 20) - 64, false, 0).is_ok());
        assert!((0..63).all(|_| add(0, true, 0).is_ok()), "63 MiB");
        let refused = add(0, true, 0).expect_err("64 MiB and a little");
        assert!(refused.to_string().contains(" that copy at most 67108864 bytes, got "), "{refused}");
        assert!(add(0, true, 1 << 20).is_ok(), "a larger file");
        // Dictionaries that are sent as a whole are read once.
        assert!((0..1000).all(|_| add(1 << 20, false, 0).is_ok()));
    }
}
