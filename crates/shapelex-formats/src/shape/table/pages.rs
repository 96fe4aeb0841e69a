//! What a Parquet file claims, checked before the library takes it at its word.
//!
//! Its metadata and the header before every page are in the compact protocol of Thrift: fields with a type and the difference of their
//! ids.

use parquet::basic::{Compression, Encoding};
use parquet::file::metadata::{ColumnChunkMetaData, ParquetMetaData};

use super::super::error::{FaultKind, FileError, Place};

/// Number of values of a column of lists that need no bytes: runs of nulls, or of one value.
const FREE_VALUES: u64 = 1 << 22;
/// Number of values for each byte of a column of lists beyond them.
const VALUES_PER_BYTE: u64 = 64;

/// Checks that the values of the metadata, before the last eight bytes, are as many as they claim: the library skips Booleans of lists
/// without reading a byte, and two billion of them that six bytes claim.
///
/// # Errors
/// Bytes that are no metadata.
pub(super) fn check_metadata(bytes: &[u8]) -> Result<(), FileError> {
    let refused =
        || FileError::malformed(Place::tag("metadata"), "expected metadata of Parquet, got other bytes");
    let (rest, tail) = bytes.split_last_chunk::<8>().ok_or_else(refused)?;
    let [length @ .., _, _, _, _] = tail;
    let length = usize::try_from(u32::from_le_bytes(*length)).ok();
    let start = length.and_then(|length| rest.len().checked_sub(length)).ok_or_else(refused)?;
    skip(&mut &rest[start..], STRUCT, 0).map_err(|_| refused())
}

/// Checks all pages of some columns of a row group. Returns the largest number of values of a column.
///
/// # Errors
/// Pages beyond the file, pages that claim to decompress to more than their compression can give, more values in lists than
/// their bytes can hold, compressions and encodings that are not read.
pub(super) fn check_columns(
    bytes: &[u8],
    metadata: &ParquetMetaData,
    group: usize,
    columns: &[usize],
) -> Result<u64, FileError> {
    let mut most = 0;
    for column in columns {
        let chunk = metadata.row_group(group).column(*column);
        let place = || Place {
            item: u64::try_from(group).ok(),
            ..Place::tag(format!("row group, column '{}'", chunk.column_path().string()))
        };
        most = most.max(check_chunk(bytes, chunk).map_err(|error| error.at(place()))?);
    }
    Ok(most)
}

/// Most that a compressed byte stands for.
fn ratio(compression: Compression) -> Result<u64, FileError> {
    match compression {
        Compression::UNCOMPRESSED => Ok(1),
        // A copy of 64 bytes takes two or three.
        Compression::SNAPPY => Ok(32),
        Compression::GZIP(_) => Ok(1032),
        Compression::LZ4_RAW | Compression::LZ4 => Ok(255),
        other => {
            let name = match other {
                Compression::ZSTD(_) => "Zstandard",
                Compression::BROTLI(_) => "Brotli",
                _ => "LZO",
            };
            let detail = format!(
                "expected Snappy, gzip, LZ4 or no compression, got {name}; write the file with compression='snappy'"
            );
            Err(FileError::new(FaultKind::Unsupported, detail))
        }
    }
}

fn check_chunk(bytes: &[u8], chunk: &ColumnChunkMetaData) -> Result<u64, FileError> {
    let ratio = ratio(chunk.compression())?;
    let start = chunk.dictionary_page_offset().filter(|at| *at > 0).unwrap_or(chunk.data_page_offset());
    let range = usize::try_from(start).ok().zip(usize::try_from(chunk.compressed_size()).ok());
    let mut rest =
        range.and_then(|(start, length)| bytes.get(start..start.checked_add(length)?)).ok_or_else(|| {
            let detail = format!(
                "expected pages within the {} bytes of the file, got {} bytes at {start}",
                bytes.len(),
                chunk.compressed_size()
            );
            FileError::truncated(Place::default(), detail)
        })?;
    let is_list = chunk.column_descr().max_rep_level() > 0;
    let allowed = FREE_VALUES + VALUES_PER_BYTE * rest.len() as u64;
    let mut values = 0;
    while !rest.is_empty() {
        let header = Header::read(&mut rest)?;
        let size = usize::try_from(header.compressed).ok();
        let Some((page, after)) = size.and_then(|size| rest.split_at_checked(size)) else {
            let detail =
                format!("expected a page of at most {} bytes, got {}", rest.len(), header.compressed);
            return Err(FileError::truncated(Place::default(), detail));
        };
        let most = (page.len() as u64).saturating_mul(ratio).saturating_add(64);
        if !u64::try_from(header.uncompressed).is_ok_and(|size| size <= most) {
            let detail = format!(
                "expected a page of {} bytes to hold at most {most}, got {}",
                page.len(),
                header.uncompressed
            );
            return Err(FileError::malformed(Place::default(), detail));
        }
        header.check_encoding()?;
        if header.is_data {
            values += u64::try_from(header.values).unwrap_or(u64::MAX >> 1).min(u64::MAX >> 1);
        }
        if header.values < 0 || (is_list && values > allowed) {
            let detail =
                format!("expected at most {allowed} values in the lists of a column, got {values} or more");
            return Err(FileError::too_large(Place::default(), detail));
        }
        rest = after;
    }
    if i64::try_from(values).is_ok_and(|values| values == chunk.num_values()) {
        return Ok(values);
    }
    let detail = format!("expected {} values in the pages of a column, got {values}", chunk.num_values());
    Err(FileError::malformed(Place::default(), detail))
}

/// What is needed of the header of a page.
#[derive(Default)]
struct Header {
    uncompressed: i64,
    compressed: i64,
    values: i64,
    encoding: i64,
    is_data: bool,
}

impl Header {
    fn read(bytes: &mut &[u8]) -> Result<Self, FileError> {
        let mut header = Self::default();
        let mut outer = Fields::default();
        while let Some((id, kind)) = outer.next(bytes)? {
            match (id, kind) {
                (2, I32) => header.uncompressed = zigzag(bytes)?,
                (3, I32) => header.compressed = zigzag(bytes)?,
                // Headers of data pages, dictionary pages and data pages of version 2 begin with the number of values.
                (5 | 7 | 8, STRUCT) => {
                    header.is_data = id != 7;
                    header.read_inner(bytes, if id == 8 { 4 } else { 2 })?;
                }
                _ => skip(bytes, kind, 0)?,
            }
        }
        Ok(header)
    }

    fn read_inner(&mut self, bytes: &mut &[u8], encoding: i64) -> Result<(), FileError> {
        let mut inner = Fields::default();
        while let Some((id, kind)) = inner.next(bytes)? {
            match (id, kind) {
                (1, I32) => self.values = zigzag(bytes)?,
                (id, I32) if id == encoding => self.encoding = zigzag(bytes)?,
                _ => skip(bytes, kind, 0)?,
            }
        }
        Ok(())
    }

    /// Other encodings have sizes of their own, which are claims as well.
    fn check_encoding(&self) -> Result<(), FileError> {
        let known = [
            Encoding::PLAIN,
            Encoding::RLE,
            Encoding::RLE_DICTIONARY,
            #[allow(deprecated)]
            Encoding::PLAIN_DICTIONARY,
            Encoding::BYTE_STREAM_SPLIT,
        ];
        if known.iter().any(|encoding| *encoding as i64 == self.encoding) {
            return Ok(());
        }
        let detail = format!(
            "expected plain, dictionary, run-length or byte-stream-split encoding, got encoding {}",
            self.encoding
        );
        Err(FileError::new(FaultKind::Unsupported, detail))
    }
}

// Types of the compact protocol.
const TRUE: u8 = 1;
const FALSE: u8 = 2;
const BYTE: u8 = 3;
const I16: u8 = 4;
pub(super) const I32: u8 = 5;
const I64: u8 = 6;
const DOUBLE: u8 = 7;
const BINARY: u8 = 8;
const LIST: u8 = 9;
const SET: u8 = 10;
pub(super) const STRUCT: u8 = 12;

/// Depth of structures that are skipped: those of metadata take nine.
const MAX_DEPTH: usize = 16;

/// Fields of a structure.
#[derive(Default)]
struct Fields {
    id: i64,
}

impl Fields {
    /// Id and type of the next field, or `None` at the end of the structure.
    fn next(&mut self, bytes: &mut &[u8]) -> Result<Option<(i64, u8)>, FileError> {
        let head = byte(bytes)?;
        let kind = head & 0x0f;
        if kind == 0 {
            return Ok(None);
        }
        self.id = match head >> 4 {
            0 => zigzag(bytes)?,
            step => self.id.saturating_add(i64::from(step)),
        };
        Ok(Some((self.id, kind)))
    }
}

fn broken() -> FileError {
    FileError::malformed(Place::default(), "expected the header of a page, got other bytes")
}

fn byte(bytes: &mut &[u8]) -> Result<u8, FileError> {
    let (first, rest) = bytes.split_first().ok_or_else(broken)?;
    *bytes = rest;
    Ok(*first)
}

/// A number of up to 64 bits, seven a byte.
fn varint(bytes: &mut &[u8]) -> Result<u64, FileError> {
    let mut value = 0;
    for shift in (0..64).step_by(7) {
        let next = byte(bytes)?;
        value |= u64::from(next & 0x7f) << shift;
        if next & 0x80 == 0 {
            return Ok(value);
        }
    }
    Err(broken())
}

/// A signed number.
fn zigzag(bytes: &mut &[u8]) -> Result<i64, FileError> {
    let value = varint(bytes)?;
    let half = i64::try_from(value >> 1).map_err(|_| broken())?;
    Ok(if value & 1 == 0 { half } else { -half - 1 })
}

fn take(bytes: &mut &[u8], count: u64) -> Result<(), FileError> {
    let count = usize::try_from(count).ok();
    *bytes = count.and_then(|count| bytes.get(count..)).ok_or_else(broken)?;
    Ok(())
}

/// Skips a value.
fn skip(bytes: &mut &[u8], kind: u8, depth: usize) -> Result<(), FileError> {
    if depth > MAX_DEPTH {
        return Err(broken());
    }
    match kind {
        TRUE | FALSE => Ok(()),
        BYTE => take(bytes, 1),
        I16 | I32 | I64 => varint(bytes).map(|_| ()),
        DOUBLE => take(bytes, 8),
        BINARY => {
            let length = varint(bytes)?;
            take(bytes, length)
        }
        LIST | SET => {
            let head = byte(bytes)?;
            let (count, kind) =
                (if head >> 4 == 15 { varint(bytes)? } else { u64::from(head >> 4) }, head & 0x0f);
            // No list of the format has Booleans, of which the library skips any number without a byte.
            if count > 0 && kind <= FALSE {
                return Err(broken());
            }
            (0..count).try_for_each(|_| skip(bytes, kind, depth + 1))
        }
        STRUCT => {
            let mut fields = Fields::default();
            while let Some((_, kind)) = fields.next(bytes)? {
                skip(bytes, kind, depth + 1)?;
            }
            Ok(())
        }
        _ => Err(broken()),
    }
}
