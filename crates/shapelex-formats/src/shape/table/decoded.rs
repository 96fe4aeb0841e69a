//! Memory of rows of Parquet, known before they are decoded.
//!
//! Rows are decoded in batches, each whole. How long a row is, only the levels of its lists say, and these are decompressed for that
//! only if a whole row group takes more than may be held.

use std::sync::Arc;

use bytes::Bytes;
use parquet::basic::Encoding;
use parquet::column::page::Page;
use parquet::file::metadata::ParquetMetaData;
use parquet::file::serialized_reader::SerializedPageReader;

use super::super::guarded::guarded;
use super::super::limits::Limits;
use super::pages::{Pages, place_of};
use super::parquet::malformed;
use super::thrift::varint;
use crate::error::{FaultKind, FileError, Place};

/// Most values that are decoded at once on average.
const VALUES: u64 = 1 << 21;
/// Most rows that are decoded at once.
const ROWS: u64 = super::rows::ROWS as u64;
/// Bytes of a value in a list: the number as it is and in double precision, and its levels.
const VALUE: u64 = 20;
/// Bytes of any other value: a number, or where a text is.
const CELL: u64 = 17;

/// Bytes of a column in memory.
#[derive(Clone, Copy)]
struct Column {
    /// Those of all rows.
    all: u64,
    /// Most of one row.
    row: u64,
    /// Those that every batch has.
    fixed: u64,
}

/// Number of rows of a row group that are decoded at once, so that they take no more than may be made of the file.
///
/// # Errors
/// Rows that are longer than that.
pub(super) fn rows_at_once(
    bytes: &Bytes,
    metadata: &ParquetMetaData,
    group: usize,
    columns: &[(usize, Pages)],
    limits: &Limits,
) -> Result<usize, FileError> {
    let most = limits.made(bytes.len()) as u64;
    let count = u64::try_from(metadata.row_group(group).num_rows()).unwrap_or(0).max(1);
    let values = columns.iter().map(|(_, pages)| pages.values).max().unwrap_or(0).max(1);
    let mut rows = (VALUES.saturating_mul(count) / values).clamp(1, ROWS);
    let is_list = |column: usize| metadata.row_group(group).column(column).column_descr().max_rep_level() > 0;
    let mut taken: Vec<Column> =
        columns.iter().map(|(column, pages)| Column::new(pages, is_list(*column), count)).collect();
    let batch = |taken: &[Column], rows: u64| {
        taken.iter().map(|column| column.batch(rows)).fold(0_u64, u64::saturating_add)
    };
    // Pages are not decompressed for their levels if they are too long themselves.
    let fits = taken.iter().map(|column| column.fixed).fold(0_u64, u64::saturating_add) <= most;
    if fits && batch(&taken, rows) > most {
        for ((column, _), taken) in columns.iter().zip(&mut taken).filter(|((column, _), _)| is_list(*column))
        {
            let list = guarded("a column", || longest_list(bytes, metadata, group, *column))
                .map_err(|error| error.at(place_of(metadata, group, *column)))?;
            taken.row = list.saturating_mul(VALUE);
        }
    }
    while rows > 1 && batch(&taken, rows) > most {
        rows /= 2;
    }
    let bytes = batch(&taken, rows);
    if bytes > most {
        let place = Place { item: u64::try_from(group).ok(), ..Place::tag("row group") };
        let detail = format!(
            "expected rows of at most {most} bytes when they are decoded, with their pages, got {bytes}"
        );
        return Err(FileError::too_large(place, detail));
    }
    Ok(usize::try_from(rows).unwrap_or(1))
}

impl Column {
    fn new(pages: &Pages, is_list: bool, rows: u64) -> Self {
        let fixed = pages.dictionary.saturating_add(pages.longest);
        if is_list {
            // One list may have all values.
            let all = pages.values.saturating_mul(VALUE);
            return Self { all, row: all, fixed };
        }
        // Texts stay in their pages.
        let all = pages.bytes.saturating_add(rows.saturating_mul(CELL));
        Self { all, row: pages.longest.saturating_add(CELL), fixed }
    }

    fn batch(&self, rows: u64) -> u64 {
        self.fixed.saturating_add(self.all.min(self.row.saturating_mul(rows)))
    }
}

/// Number of values of the longest list of a column.
fn longest_list(
    bytes: &Bytes,
    metadata: &ParquetMetaData,
    group: usize,
    column: usize,
) -> Result<u64, FileError> {
    let group = metadata.row_group(group);
    let chunk = group.column(column);
    let width = u32::from(chunk.column_descr().max_rep_level().unsigned_abs()).ilog2() + 1;
    let rows = usize::try_from(group.num_rows()).unwrap_or(0);
    let pages = SerializedPageReader::new(Arc::new(bytes.clone()), chunk, rows, None).map_err(malformed)?;
    let mut lists = Lists::default();
    for page in pages {
        let page = page.map_err(malformed)?;
        let (levels, count) = match &page {
            Page::DictionaryPage { .. } => continue,
            Page::DataPage { rep_level_encoding, .. } if *rep_level_encoding != Encoding::RLE => {
                let detail = format!("expected levels as runs, got {rep_level_encoding}");
                return Err(FileError::new(FaultKind::Unsupported, detail));
            }
            Page::DataPage { buf, num_values, .. } => {
                let levels = buf.split_first_chunk::<4>().and_then(|(length, rest)| {
                    rest.get(..usize::try_from(u32::from_le_bytes(*length)).ok()?)
                });
                (levels, *num_values)
            }
            Page::DataPageV2 { buf, rep_levels_byte_len, num_values, .. } => {
                (usize::try_from(*rep_levels_byte_len).ok().and_then(|length| buf.get(..length)), *num_values)
            }
        };
        levels.and_then(|levels| lists.push(levels, width, count.into())).ok_or_else(|| {
            FileError::malformed(Place::default(), "expected a repetition level for every value, got others")
        })?;
    }
    Ok(lists.longest)
}

/// Lengths of lists by their repetition levels: 0 where a list begins.
#[derive(Default)]
struct Lists {
    length: u64,
    longest: u64,
}

impl Lists {
    /// Adds the levels of `count` values: runs of one level, or of levels packed in `width` bits, at most 2.
    fn push(&mut self, mut levels: &[u8], width: u32, count: u64) -> Option<()> {
        let mut left = count;
        while left > 0 {
            let head = varint(&mut levels).ok()?;
            let (half, is_packed) = (head >> 1, head & 1 == 1);
            let number = if is_packed { half.checked_mul(8)? } else { half }.min(left);
            // A run of none would go on for ever.
            left = left.checked_sub(number).filter(|_| number > 0)?;
            let length = if is_packed { half.checked_mul(width.into())? } else { 1 };
            let (run, rest) = levels.split_at_checked(usize::try_from(length).ok()?)?;
            levels = rest;
            if is_packed {
                let width = width as usize;
                let level = |k: usize| run[k * width / 8] >> (k * width % 8) & ((1 << width) - 1);
                (0..usize::try_from(number).ok()?).for_each(|k| self.add(level(k) == 0, 1));
            } else {
                self.add(run[0] == 0, number);
            }
        }
        Some(())
    }

    fn add(&mut self, begins: bool, number: u64) {
        self.length = if begins { 1 } else { self.length + number };
        self.longest = self.longest.max(self.length);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_of_lists_are_those_of_their_levels() {
        let longest = |levels: &[u8], width: u32, count: u64| {
            let mut lists = Lists::default();
            lists.push(levels, width, count).map(|()| lists.longest)
        };
        // A list of 1 + 3 values, then two of one.
        assert_eq!(longest(&[2, 0, 6, 1, 4, 0], 1, 6), Some(4));
        // 0 1 1 0 0 1 1 1, packed, and a run that goes on.
        assert_eq!(longest(&[3, 0b1110_0110, 4, 1], 1, 10), Some(6));
        // Two bits each: 0 2 1 2 0 2 2 2; the last two values are padding.
        assert_eq!(longest(&[3, 0b1001_1000, 0b1010_1000], 2, 6), Some(4));
        // Levels that end early, and a run of none.
        assert_eq!(longest(&[4, 1], 1, 3), None);
        assert_eq!(longest(&[0, 1, 4, 1], 1, 2), None);
        assert_eq!(longest(&[3], 1, 8), None);
    }
}
