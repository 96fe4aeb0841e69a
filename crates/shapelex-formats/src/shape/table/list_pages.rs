//! Columns of lists of numbers as pages of Parquet.
//!
//! The library computes two levels for every number, and packs them again. Here the levels are written as runs, two for each list,
//! and the numbers go to the file from where the rows were collected:
//!
//! ```text
//! page = header, size of repetition levels (32 bits), levels, size of definition levels (32 bits), levels, numbers
//! ```
//!
//! A repetition level is 0 at the begin of a list and 1 within it. A run is `2 × count` as a variable number, then the level.
//!
//! Source: the Apache Parquet format (data pages of version 1, hybrid of runs and bit packing, compact protocol of Thrift).

use std::io::{self, Read, Write};
use std::ops::Range;

use arrow_array::cast::AsArray;
use arrow_array::types::{ArrowPrimitiveType, Float64Type, Int32Type};
use arrow_array::{Array, ListArray};
use arrow_buffer::{Buffer, NullBuffer};
use bytes::Bytes;
use parquet::basic::{Compression, Encoding, EncodingMask, PageType};
use parquet::column::writer::ColumnCloseResult;
use parquet::errors::ParquetError;
use parquet::file::metadata::{ColumnChunkMetaData, OffsetIndexBuilder, PageEncodingStats};
use parquet::file::reader::{ChunkReader, Length};
use parquet::file::writer::SerializedRowGroupWriter;
use parquet::schema::types::ColumnDescPtr;

use super::thrift::{I32, STRUCT};

/// Number of bytes of numbers at which a page ends, between two lists.
const PAGE: usize = 1 << 20;

// Definition levels of an optional list of optional numbers.
const NO_LIST: u8 = 0;
const EMPTY_LIST: u8 = 1;
const NO_NUMBER: u8 = 2;
const NUMBER: u8 = 3;

/// A column of a row group, encoded.
pub(super) struct ListColumn {
    pieces: Pieces,
    close: ColumnCloseResult,
}

impl ListColumn {
    /// Encodes the lists of all batches of a row group. Lists that are null have no numbers, as `rows` makes them.
    ///
    /// # Errors
    /// Lists of other types; one list of more bytes than a page may have.
    pub(super) fn encode<'a>(
        column: &ColumnDescPtr,
        batches: impl Iterator<Item = &'a ListArray>,
    ) -> Result<Self, ParquetError> {
        let mut encoder = Encoder::default();
        for lists in batches {
            encoder.push(lists)?;
        }
        encoder.close(column)
    }

    /// Writes the column as the next one of a row group.
    ///
    /// # Errors
    /// Those of the output.
    pub(super) fn append_to_row_group(
        self,
        group: &mut SerializedRowGroupWriter<'_, impl Write + Send>,
    ) -> Result<(), ParquetError> {
        group.append_column(&self.pieces, self.close)
    }
}

#[derive(Default)]
struct Encoder {
    pieces: Vec<Buffer>,
    index: OffsetIndexBuilder,
    pages: i32,
    bytes: usize,
    rows: usize,
    values: usize,
}

impl Encoder {
    fn push(&mut self, lists: &ListArray) -> Result<(), ParquetError> {
        let numbers = Numbers::of(lists)?;
        let offsets = lists.value_offsets();
        let mut begin = 0;
        for end in 1..=lists.len() {
            let count = (offsets[end] - offsets[begin]) as usize;
            if count * numbers.width >= PAGE || end == lists.len() {
                self.page(lists, &numbers, begin..end)?;
                begin = end;
            }
        }
        Ok(())
    }

    fn page(&mut self, lists: &ListArray, numbers: &Numbers, rows: Range<usize>) -> Result<(), ParquetError> {
        let offsets = lists.value_offsets();
        let (mut repetition, mut definition) = (Runs::default(), Runs::default());
        for row in rows.clone() {
            let numbers_of_row = offsets[row] as usize..offsets[row + 1] as usize;
            repetition.push(0, 1);
            if lists.is_null(row) {
                definition.push(NO_LIST, 1);
            } else if numbers_of_row.is_empty() {
                definition.push(EMPTY_LIST, 1);
            } else {
                repetition.push(1, numbers_of_row.len() - 1);
                numbers.define(numbers_of_row, &mut definition);
            }
        }
        let (values, repetition, definition) = (repetition.total, repetition.finish(), definition.finish());
        let numbers = numbers.present(offsets[rows.start] as usize..offsets[rows.end] as usize);
        let size = repetition.len() + definition.len() + numbers.len();
        let (size, count) = i32::try_from(size).ok().zip(i32::try_from(values).ok()).ok_or_else(|| {
            ParquetError::General(format!("expected lists of at most {} bytes, got {size}", i32::MAX))
        })?;
        let head = [header(size, count), repetition, definition].concat();
        let bytes = head.len() + numbers.len();
        self.index.append_row_count(rows.len() as i64);
        self.index.append_offset_and_size(self.bytes as i64, i32::try_from(bytes).unwrap_or(i32::MAX));
        self.pieces.extend([Buffer::from_vec(head), numbers]);
        self.pages += 1;
        self.bytes += bytes;
        self.rows += rows.len();
        self.values += values;
        Ok(())
    }

    fn close(self, column: &ColumnDescPtr) -> Result<ListColumn, ParquetError> {
        let pages = PageEncodingStats {
            page_type: PageType::DATA_PAGE,
            encoding: Encoding::PLAIN,
            count: self.pages,
        };
        let metadata = ColumnChunkMetaData::builder(column.clone())
            .set_compression(Compression::UNCOMPRESSED)
            .set_encodings_mask(EncodingMask::new_from_encodings([Encoding::PLAIN, Encoding::RLE].iter()))
            .set_page_encoding_stats(vec![pages])
            .set_total_compressed_size(self.bytes as i64)
            .set_total_uncompressed_size(self.bytes as i64)
            .set_num_values(self.values as i64)
            .set_data_page_offset(0)
            .build()?;
        let close = ColumnCloseResult {
            bytes_written: self.bytes as u64,
            rows_written: self.rows as u64,
            metadata,
            bloom_filter: None,
            column_index: None,
            offset_index: Some(self.index.build()),
        };
        Ok(ListColumn { pieces: Pieces(self.pieces), close })
    }
}

/// The numbers of a column of lists as bytes, in the order of this machine, which is that of the format wherever the library runs.
struct Numbers {
    bytes: Buffer,
    width: usize,
    nulls: Option<NullBuffer>,
}

impl Numbers {
    fn of(lists: &ListArray) -> Result<Self, ParquetError> {
        fn numbers<T: ArrowPrimitiveType>(array: &dyn Array) -> Option<Numbers> {
            let numbers = array.as_primitive_opt::<T>()?;
            let nulls = numbers.nulls().filter(|nulls| nulls.null_count() > 0).cloned();
            Some(Numbers { bytes: numbers.values().inner().clone(), width: size_of::<T::Native>(), nulls })
        }
        let array = lists.values();
        numbers::<Float64Type>(array).or_else(|| numbers::<Int32Type>(array)).ok_or_else(|| {
            ParquetError::General(format!("expected lists of doubles or integers, got {}", array.data_type()))
        })
    }

    /// Adds the definition levels of some numbers.
    fn define(&self, range: Range<usize>, levels: &mut Runs) {
        match &self.nulls {
            None => levels.push(NUMBER, range.len()),
            Some(nulls) => {
                range.for_each(|at| levels.push(if nulls.is_valid(at) { NUMBER } else { NO_NUMBER }, 1));
            }
        }
    }

    /// The bytes of those of some numbers that are not null.
    fn present(&self, range: Range<usize>) -> Buffer {
        let slice = |from: usize, to: usize| {
            self.bytes.slice_with_length(from * self.width, (to - from) * self.width)
        };
        let Some(nulls) = &self.nulls else { return slice(range.start, range.end) };
        let nulls = nulls.slice(range.start, range.len());
        let runs = nulls.valid_slices().map(|(from, to)| slice(range.start + from, range.start + to));
        Buffer::from_vec(runs.map(|run| run.to_vec()).collect::<Vec<_>>().concat())
    }
}

/// Levels of one page.
#[derive(Default)]
struct Runs {
    bytes: Vec<u8>,
    level: u8,
    count: usize,
    total: usize,
}

impl Runs {
    fn push(&mut self, level: u8, count: usize) {
        if level != self.level && count > 0 {
            self.end_run();
            self.level = level;
        }
        self.count += count;
        self.total += count;
    }

    fn end_run(&mut self) {
        if self.count > 0 {
            varint(self.count << 1, &mut self.bytes);
            self.bytes.push(self.level);
            self.count = 0;
        }
    }

    /// The levels behind their size.
    fn finish(mut self) -> Vec<u8> {
        self.end_run();
        let size = u32::try_from(self.bytes.len()).unwrap_or(u32::MAX);
        [&size.to_le_bytes(), self.bytes.as_slice()].concat()
    }
}

/// Adds a number of up to 64 bits, seven a byte.
fn varint(mut value: usize, bytes: &mut Vec<u8>) {
    while value >= 0x80 {
        bytes.push(value as u8 | 0x80);
        value >>= 7;
    }
    bytes.push(value as u8);
}

/// Header of a data page of plain numbers whose levels are runs, in the compact protocol of Thrift.
fn header(size: i32, values: i32) -> Vec<u8> {
    let mut bytes = Vec::new();
    // Fields of consecutive ids: a step of 1 and the type, then the number, whose sign is its last bit.
    let number = |value: i32, bytes: &mut Vec<u8>| {
        bytes.push(1 << 4 | I32);
        varint((value as usize) << 1, bytes);
    };
    for value in [PageType::DATA_PAGE as i32, size, size] {
        number(value, &mut bytes);
    }
    // The header of the data page is field 5.
    bytes.push(2 << 4 | STRUCT);
    for value in [values, Encoding::PLAIN as i32, Encoding::RLE as i32, Encoding::RLE as i32] {
        number(value, &mut bytes);
    }
    bytes.extend([0, 0]);
    bytes
}

/// Pieces of memory, one after the other.
struct Pieces(Vec<Buffer>);

impl Length for Pieces {
    fn len(&self) -> u64 {
        self.0.iter().map(|piece| piece.len() as u64).sum()
    }
}

impl ChunkReader for Pieces {
    type T = PieceReader;

    fn get_read(&self, start: u64) -> Result<PieceReader, ParquetError> {
        let mut reader = PieceReader { pieces: self.0.clone().into_iter(), rest: Buffer::default() };
        io::copy(&mut reader.by_ref().take(start), &mut io::sink())?;
        Ok(reader)
    }

    fn get_bytes(&self, start: u64, length: usize) -> Result<Bytes, ParquetError> {
        let mut bytes = vec![0; length];
        self.get_read(start)?.read_exact(&mut bytes)?;
        Ok(bytes.into())
    }
}

/// Reads pieces from front to back.
struct PieceReader {
    pieces: std::vec::IntoIter<Buffer>,
    rest: Buffer,
}

impl Read for PieceReader {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        while self.rest.is_empty() {
            let Some(next) = self.pieces.next() else { return Ok(0) };
            self.rest = next;
        }
        let count = bytes.len().min(self.rest.len());
        bytes[..count].copy_from_slice(&self.rest[..count]);
        self.rest.advance(count);
        Ok(count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_list_is_two_runs_of_repetition_levels() {
        let mut levels = Runs::default();
        for (level, count) in [(0, 1), (1, 99), (0, 1), (1, 0), (0, 1), (1, 1)] {
            levels.push(level, count);
        }
        assert_eq!(levels.total, 103);
        // One 0, ninety-nine 1, two 0, one 1.
        assert_eq!(levels.finish(), [9, 0, 0, 0, 2, 0, 0xc6, 1, 1, 4, 0, 2, 1]);
    }

    #[test]
    fn pieces_are_read_as_one_from_any_byte() {
        let pieces = Pieces([vec![1, 2, 3], vec![], vec![4, 5]].map(Buffer::from_vec::<u8>).into());
        assert_eq!(pieces.len(), 5);
        for start in 0..=5 {
            let bytes = pieces.get_bytes(start, 5 - start as usize).expect("bytes");
            assert_eq!(bytes.as_ref(), &[1, 2, 3, 4, 5][start as usize..]);
        }
        assert!(pieces.get_bytes(3, 3).is_err(), "more bytes than there are");
    }
}
