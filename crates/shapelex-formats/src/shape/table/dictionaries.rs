//! The dictionaries of a stream of Arrow.

use std::collections::BTreeMap;

use super::super::limits::{Bound, Budget};
use crate::error::FileError;

/// Values of a dictionary, or more of them.
#[derive(Debug, Clone, Copy)]
pub(super) struct Dictionary {
    pub(super) id: i64,
    pub(super) bytes: u64,
    /// Whether the values are added to those that are known.
    pub(super) is_delta: bool,
}

/// Bytes of a dictionary beside its values, of which 64 take no bytes.
const OWN: u64 = 64;
/// The decoder copies a dictionary as a whole whenever values are added to it.
pub(super) const COPIED: Bound =
    Bound { what: "bytes of dictionaries that are copied to add values", free: 64 << 20, per_byte: 16 };

/// Sizes of the dictionaries that the decoder keeps.
#[derive(Debug)]
pub(super) struct Dictionaries {
    by_id: BTreeMap<i64, u64>,
    kept: u64,
    copied: Budget,
}

impl Dictionaries {
    pub(super) fn new(copied: Budget) -> Self {
        Self { by_id: BTreeMap::new(), kept: 0, copied }
    }

    /// Number of bytes of all dictionaries.
    pub(super) fn kept(&self) -> u64 {
        self.kept
    }

    /// Adds or replaces values of a dictionary.
    ///
    /// # Errors
    /// More copies than a file of this size may want.
    pub(super) fn add(&mut self, dictionary: Dictionary) -> Result<(), FileError> {
        let known = self.by_id.entry(dictionary.id).or_default();
        let before = *known;
        let new = dictionary.bytes.saturating_add(OWN);
        let after = if dictionary.is_delta { before.saturating_add(new) } else { new };
        *known = after;
        self.kept = self.kept.saturating_sub(before).saturating_add(after);
        if dictionary.is_delta { self.copied.take(after) } else { Ok(()) }
    }
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;
    use std::rc::Rc;

    use super::*;

    #[test]
    fn sizes_of_dictionaries_are_summed_as_they_change() {
        let mut dictionaries = Dictionaries::new(Budget::new(COPIED, Rc::default()));
        let mut add = |id: i64, bytes: u64, is_delta: bool| {
            dictionaries.add(Dictionary { id, bytes, is_delta }).expect("small");
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
        let read: Rc<Cell<u64>> = Rc::default();
        let mut dictionaries = Dictionaries::new(Budget::new(COPIED, Rc::clone(&read)));
        let mut add = |bytes: u64, is_delta: bool| dictionaries.add(Dictionary { id: 7, bytes, is_delta });
        assert!(add((1 << 20) - 64, false).is_ok());
        assert!((0..63).all(|_| add(0, true).is_ok()), "63 MiB");
        let refused = add(0, true).expect_err("64 MiB and a little");
        assert!(
            refused.to_string().starts_with("expected at most 67108864 bytes of dictionaries"),
            "{refused}"
        );
        read.set(1 << 20);
        assert!(add(0, true).is_ok(), "a larger file");
        // Dictionaries that are sent as a whole are read once.
        assert!((0..1000).all(|_| add(1 << 20, false).is_ok()));
    }
}
