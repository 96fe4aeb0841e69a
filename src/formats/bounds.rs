//! What a document may become in memory: how much of it is kept while it is read, and what its text foretells.
//!
//! Lists are cut at their limit while they are read, the rest is counted and passed over. The limits are those of the
//! thread that reads, for as long as [`within`] runs: readers of `serde` have no other way to hear of them.

use std::cell::Cell;

/// Limits of what is kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Bounds {
    /// Entries of a list of shapes, meshes, ids or codes.
    pub items: usize,
    /// Points of one shape.
    pub points: usize,
    /// Bytes of the metadata of a shape.
    pub metadata_bytes: usize,
}

impl Default for Bounds {
    fn default() -> Self {
        Self { items: 100_000, points: 300_000, metadata_bytes: 64 << 10 }
    }
}

/// Faults of a document that are kept in full: later ones only as the first of their object or list, so that no shape with a
/// fault passes for one without.
const FAULTS_IN_FULL: usize = 1000;

/// The limits of a thread, and the faults that it has kept since they hold.
#[derive(Clone, Copy)]
struct State {
    bounds: Bounds,
    faults: usize,
}

thread_local! {
    static STATE: Cell<State> = Cell::new(State { bounds: Bounds::default(), faults: 0 });
}

/// Puts the former limits back, also when the reader panics.
struct Former(State);

impl Drop for Former {
    fn drop(&mut self) {
        STATE.set(self.0);
    }
}

/// Reads a document of its own within `bounds`.
pub fn within<T>(bounds: Bounds, read: impl FnOnce() -> T) -> T {
    let _former = Former(STATE.replace(State { bounds, faults: 0 }));
    read()
}

/// The limits that hold.
pub(super) fn current() -> Bounds {
    STATE.get().bounds
}

/// Whether one more fault is kept by an object or list that has kept `of_its_own` and keeps `most` at most.
pub(super) fn keeps_fault(of_its_own: usize, most: usize) -> bool {
    let state = STATE.get();
    let keeps = of_its_own < most && (of_its_own == 0 || state.faults < FAULTS_IN_FULL);
    if keeps {
        STATE.set(State { faults: state.faults + 1, ..state });
    }
    keeps
}

/// What stands in JSON text, counted in its bytes: an upper bound, because commas in texts count too.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Census {
    /// Bytes.
    pub bytes: usize,
    /// Values: one after every comma, and one in every list and object.
    pub values: usize,
    /// Lists and objects.
    pub openings: usize,
}

/// Memory of a number in a list, with the half that a growing list is ahead.
const VALUE_BYTES: usize = 12;
/// Memory of an entry of a list of shapes (measured by `tests/memory.rs`): its own and that of one small field.
const ITEM_BYTES: usize = 640;

impl Census {
    /// Of one piece of a text; pieces add up.
    pub fn of(piece: &[u8]) -> Self {
        let openings = count(piece, |byte| byte == b'[' || byte == b'{');
        let commas = count(piece, |byte| byte == b',');
        Self { bytes: piece.len(), values: commas + openings, openings }
    }

    /// With another piece.
    #[must_use]
    pub fn and(self, other: Self) -> Self {
        Self {
            bytes: self.bytes + other.bytes,
            values: self.values + other.values,
            openings: self.openings + other.openings,
        }
    }

    /// Most memory that the text and what is read from it take together, when lists keep at most `items` entries.
    pub fn memory(self, items: usize) -> usize {
        let entries = self.openings.min(items);
        self.bytes
            .saturating_add(self.values.saturating_mul(VALUE_BYTES))
            .saturating_add(entries.saturating_mul(ITEM_BYTES))
    }
}

/// How many bytes are counted in one lane of a vector register before it could overflow.
const LANE: usize = 255;

/// Written so that the compiler counts many bytes at a time.
fn count(piece: &[u8], counts: impl Fn(u8) -> bool) -> usize {
    let of = |part: &[u8]| part.iter().fold(0_u8, |sum, &byte| sum + u8::from(counts(byte)));
    piece.chunks(LANE).map(|part| usize::from(of(part))).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pieces_add_up_to_the_whole() {
        let text = br#"{"shapes":[[],[1,2,"a,b"],{"a":[0]}]}"#.repeat(40);
        let whole = Census::of(&text);
        assert_eq!((whole.bytes, whole.openings, whole.values), (37 * 40, 6 * 40, 11 * 40));
        for cut in [0, 1, 254, 255, 256, 700] {
            let (head, tail) = text.split_at(cut);
            assert_eq!(Census::of(head).and(Census::of(tail)), whole);
        }
    }

    #[test]
    fn limits_end_with_their_reader_and_later_faults_are_kept_once() {
        let usual = current();
        within(Bounds { items: 3, ..Bounds::default() }, || {
            assert_eq!(current().items, 3);
            let kept = (0..5000).filter(|i| keeps_fault(i % 5, 20)).count();
            assert_eq!(kept, FAULTS_IN_FULL + (5000 - FAULTS_IN_FULL) / 5);
            within(Bounds::default(), || assert!(keeps_fault(1, 20)));
            assert!(!keeps_fault(1, 20));
        });
        assert_eq!(current(), usual);
        assert!(!keeps_fault(20, 20));
    }
}
