//! Long columns in pieces that a few vector registers hold, for loops that do several things with a piece in one pass.
//!
//! A column of `n` numbers is a list of `⌈n/16⌉` pieces of 16; numbers beyond its end are zero. Loops run within
//! [`vectorised`]. Every number has its own sum, so that the bits do not depend on the vectors of the machine.
//!
//! The compiler keeps a piece in registers if it is a local array and every loop over it does one thing.

/// Numbers in a piece.
pub const LANES: usize = 16;

/// A piece of a column.
pub type Lanes = [f64; LANES];

/// Runs a loop with the widest vectors of the machine; `work` must be `#[inline(always)]`. Products and sums are not fused.
#[inline(always)]
pub fn vectorised<R>(work: impl FnOnce() -> R) -> R {
    pulp::Arch::new().dispatch(work)
}

/// Replaces `pieces` by those of `column`.
pub fn set_pieces(pieces: &mut Vec<Lanes>, column: &[f64]) {
    let column = Pieces::of(column);
    pieces.clear();
    pieces.extend((0..column.count()).map(|k| *column.at(k)));
}

/// A slice, read in pieces.
#[derive(Debug)]
pub struct Pieces<'a> {
    whole: &'a [Lanes],
    /// The last numbers, if they do not fill a piece.
    rest: Option<Lanes>,
}

impl<'a> Pieces<'a> {
    /// The pieces of `column`.
    pub fn of(column: &'a [f64]) -> Self {
        let (whole, rest) = column.as_chunks::<LANES>();
        let padded = |rest: &[f64]| {
            let mut padded = [0.0; LANES];
            padded[..rest.len()].copy_from_slice(rest);
            padded
        };
        Self { whole, rest: (!rest.is_empty()).then(|| padded(rest)) }
    }

    /// Number of pieces.
    pub fn count(&self) -> usize {
        self.whole.len() + usize::from(self.rest.is_some())
    }

    /// Piece `k`; zeros beyond the end.
    #[inline(always)]
    pub fn at(&self, k: usize) -> &Lanes {
        self.whole.get(k).unwrap_or(self.rest.as_ref().unwrap_or(&[0.0; LANES]))
    }
}

/// Columns of equal length that come and go. The same piece of all columns is contiguous, so that a pass over all of them reads
/// one stream of memory.
#[derive(Debug, Clone, Default)]
pub struct ColumnStack {
    /// Number of columns.
    len: usize,
    /// Number of columns for which there is memory.
    room: usize,
    pieces: Vec<Lanes>,
    /// Number of pieces of a column.
    height: usize,
}

impl ColumnStack {
    /// Removes all columns. The next ones have `rows` numbers; memory is taken for `room` of them at least.
    pub fn reset(&mut self, rows: usize, room: usize) {
        (self.len, self.height, self.room) = (0, rows.div_ceil(LANES), self.room.max(room));
        self.pieces.resize(self.height * self.room, [0.0; LANES]);
    }

    /// Piece `k` of every column.
    #[inline(always)]
    pub fn piece(&self, k: usize) -> &[Lanes] {
        &self.pieces[k * self.room..k * self.room + self.len]
    }

    /// Adds a column: `piece(k, known)` is its piece `k`, from those of the columns before it.
    #[inline(always)]
    pub fn push(&mut self, mut piece: impl FnMut(usize, &[Lanes]) -> Lanes) {
        if self.len == self.room {
            self.grow();
        }
        for (k, pieces) in self.pieces.chunks_exact_mut(self.room).enumerate() {
            let (known, free) = pieces.split_at_mut(self.len);
            free[0] = piece(k, known);
        }
        self.len += 1;
    }

    /// Adds a column.
    pub fn push_column(&mut self, column: &[f64]) {
        let column = Pieces::of(column);
        self.push(|k, _| *column.at(k));
    }

    /// Removes the column at `position`.
    pub fn remove(&mut self, position: usize) {
        for pieces in self.pieces.chunks_exact_mut(self.room) {
            pieces.copy_within(position + 1..self.len, position);
        }
        self.len -= 1;
    }

    #[cold]
    fn grow(&mut self) {
        let room = (2 * self.room).max(4);
        let mut pieces = vec![[0.0; LANES]; self.height * room];
        for k in 0..self.height {
            pieces[k * room..k * room + self.len].copy_from_slice(self.piece(k));
        }
        (self.room, self.pieces) = (room, pieces);
    }
}

/// `sum ← sum + Σᵢ factorsᵢ columnsᵢ`, in order.
#[inline(always)]
pub fn add_pieces(sum: &mut Lanes, columns: &[Lanes], factors: &[f64]) {
    for (column, factor) in columns.iter().zip(factors) {
        for l in 0..LANES {
            sum[l] += factor * column[l];
        }
    }
}

/// The largest of many numbers, met piece by piece.
#[derive(Debug)]
pub struct Largest {
    most: Lanes,
    /// The piece that `most` was met in, in every lane.
    pieces: [u64; LANES],
}

impl Largest {
    /// Numbers must exceed `least`.
    #[inline(always)]
    pub fn above(least: f64) -> Self {
        Self { most: [least; LANES], pieces: [u64::MAX; LANES] }
    }

    /// Meets piece `k`; pieces come in order.
    #[inline(always)]
    pub fn offer(&mut self, k: usize, values: &Lanes) {
        for l in 0..LANES {
            let larger = values[l] > self.most[l];
            self.most[l] = if larger { values[l] } else { self.most[l] };
            self.pieces[l] = if larger { k as u64 } else { self.pieces[l] };
        }
    }

    /// The largest number with its position, the first one if there are several; `None` if no number exceeds the least.
    pub fn found(&self) -> Option<(f64, usize)> {
        let mut most = f64::NEG_INFINITY;
        for l in 0..LANES {
            most = if self.most[l] > most { self.most[l] } else { most };
        }
        let mut first = u64::MAX;
        for l in 0..LANES {
            let position = self.pieces[l].wrapping_mul(LANES as u64) + l as u64;
            let counts = (self.most[l] == most) & (self.pieces[l] != u64::MAX);
            first = first.min(if counts { position } else { u64::MAX });
        }
        (first != u64::MAX).then_some((most, first as usize))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numbers(n: usize, seed: usize) -> Vec<f64> {
        (0..n).map(|i| ((i * 7 + seed * 5) % 23) as f64 - 11.0).collect()
    }

    #[test]
    fn columns_are_what_they_were_after_others_have_gone() {
        let mut stack = ColumnStack::default();
        for n in [1, 16, 40, 7] {
            stack.reset(n, 1);
            (0..6).for_each(|seed| stack.push_column(&numbers(n, seed)));
            stack.remove(2);
            stack.push(|k, known| std::array::from_fn(|l| known[0][l] + (k * LANES + l) as f64));
            let mut wanted: Vec<Vec<f64>> = [0, 1, 3, 4, 5].map(|seed| numbers(n, seed)).to_vec();
            wanted.push(wanted[0].iter().enumerate().map(|(i, value)| value + i as f64).collect());
            for i in 0..n {
                let row: Vec<f64> = stack.piece(i / LANES).iter().map(|piece| piece[i % LANES]).collect();
                let expected: Vec<f64> = wanted.iter().map(|column| column[i]).collect();
                assert_eq!(row, expected, "row {i} of {n}");
            }
            let mut sum = [1.0; LANES];
            add_pieces(&mut sum, stack.piece(0), &[2.0, 0.0, -1.0]);
            assert_eq!(sum[0], 1.0 + 2.0 * wanted[0][0] - wanted[2][0]);
        }
    }

    #[test]
    fn the_first_of_the_largest_is_found() {
        let find = |numbers: &[f64], least: f64| {
            let (pieces, mut largest) = (Pieces::of(numbers), Largest::above(least));
            (0..pieces.count()).for_each(|k| largest.offer(k, pieces.at(k)));
            largest.found()
        };
        for n in [1, 15, 16, 17, 100] {
            let numbers = numbers(n, 3);
            let most = numbers.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            let first = numbers.iter().position(|value| *value == most).unwrap();
            assert_eq!(find(&numbers, -12.0), Some((most, first)), "{n}");
            assert_eq!(find(&numbers, most), None);
        }
    }
}
