//! Memory bounds of JSON documents: how much is kept while reading, and how much memory a text may need.
//!
//! Lists are cut at their limit while they are read; further entries are counted and skipped. The limits are
//! thread-local for as long as [`within`] runs, because `serde` offers readers no other way to receive them.

use std::cell::Cell;

use super::fault::Fault;

/// Limits on values kept in memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Bounds {
    /// Maximum number of entries of a list of shapes, meshes, ids or codes.
    pub items: usize,
    /// Maximum number of points of one shape.
    pub points: usize,
    /// Maximum size of the metadata of a shape in bytes.
    pub metadata_bytes: usize,
}

impl Default for Bounds {
    fn default() -> Self {
        Self { items: 100_000, points: 300_000, metadata_bytes: 64 << 10 }
    }
}

/// Number of faults of a document that are kept with their texts; a response lists fewer. Beyond it, each object or list keeps
/// only that it has one, so that no faulty shape passes for a valid one.
const FAULTS_IN_FULL: usize = 1000;
/// Text of the faults beyond, short because there may be one for each entry of a list.
const ONE_OF_MANY: &str = "faulty, like many before";

/// Limits of a thread, and the number of faults kept since they were set.
#[derive(Clone, Copy)]
struct State {
    bounds: Bounds,
    faults: usize,
}

thread_local! {
    static STATE: Cell<State> = Cell::new(State { bounds: Bounds::default(), faults: 0 });
}

/// Restores the previous limits on drop, even if the reader panics.
struct Former(State);

impl Drop for Former {
    fn drop(&mut self) {
        STATE.set(self.0);
    }
}

/// Reads a document within `bounds`.
pub fn within<T>(bounds: Bounds, read: impl FnOnce() -> T) -> T {
    let _former = Former(STATE.replace(State { bounds, faults: 0 }));
    read()
}

/// Limits in force.
pub(super) fn current() -> Bounds {
    STATE.get().bounds
}

/// Adds a fault to those of an object or list, of at most `most`; beyond [`FAULTS_IN_FULL`] of the document, without its text.
pub(super) fn keep_fault(faults: &mut Vec<Fault>, most: usize, fault: impl FnOnce() -> Fault) {
    let state = STATE.get();
    let in_full = state.faults < FAULTS_IN_FULL;
    if faults.len() >= most || !(in_full || faults.is_empty()) {
        return;
    }
    STATE.set(State { faults: state.faults + 1, ..state });
    // Most objects have one fault or none; a list has many objects.
    faults.reserve_exact(1);
    faults.push(if in_full { fault() } else { Fault::new("", ONE_OF_MANY) });
}

/// Counts over the bytes of a JSON text. They are upper bounds, because commas inside strings count too.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Census {
    /// Number of bytes.
    pub bytes: usize,
    /// Number of values: one for every comma, list and object.
    pub values: usize,
    /// Number of lists and objects.
    pub openings: usize,
}

/// Memory per number in a list, including half as much again for the spare capacity of a growing list.
const VALUE_BYTES: usize = 12;
/// Memory per entry of a list of shapes (measured by `tests/memory.rs`), with one small field.
const ITEM_BYTES: usize = 640;

impl Census {
    /// Counts one piece of a text; the counts of pieces add up.
    pub fn of(piece: &[u8]) -> Self {
        let openings = count(piece, |byte| byte == b'[' || byte == b'{');
        let commas = count(piece, |byte| byte == b',');
        Self { bytes: piece.len(), values: commas + openings, openings }
    }

    /// Sum with the counts of another piece.
    #[must_use]
    pub fn and(self, other: Self) -> Self {
        Self {
            bytes: self.bytes + other.bytes,
            values: self.values + other.values,
            openings: self.openings + other.openings,
        }
    }

    /// Upper bound on the memory of the text and the values read from it, if lists keep at most `items` entries.
    pub fn memory(self, items: usize) -> usize {
        let entries = self.openings.min(items);
        self.bytes
            .saturating_add(self.values.saturating_mul(VALUE_BYTES))
            .saturating_add(entries.saturating_mul(ITEM_BYTES))
    }
}

/// Number of bytes counted in one lane of a vector register before it could overflow.
const LANE: usize = 255;

/// Counts matching bytes, written so that the compiler vectorises it.
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
        let keep = |faults: &mut Vec<Fault>| keep_fault(faults, 20, || Fault::new("/a", "wrong"));
        within(Bounds { items: 3, ..Bounds::default() }, || {
            assert_eq!(current().items, 3);
            let objects: Vec<Vec<Fault>> = (0..1000)
                .map(|_| {
                    let mut faults = Vec::new();
                    (0..5).for_each(|_| keep(&mut faults));
                    faults
                })
                .collect();
            let first = FAULTS_IN_FULL / 5;
            assert!(objects[..first].iter().all(|faults| faults.len() == 5 && faults[4].detail == "wrong"));
            assert!(
                objects[first..].iter().all(|faults| faults.len() == 1 && faults[0].detail == ONE_OF_MANY)
            );
            let (mut one, mut inner) = (vec![Fault::new("", "")], Vec::new());
            within(Bounds::default(), || keep(&mut inner));
            keep(&mut one);
            assert_eq!((one.len(), inner[0].detail.as_str()), (1, "wrong"));
        });
        assert_eq!(current(), usual);
        let mut many = vec![Fault::new("", ""); 20];
        keep(&mut many);
        assert_eq!(many.len(), 20);
    }
}
