//! Claims of a Parquet file, checked before the library trusts them.

use flate2::read::MultiGzDecoder;
use lz4_flex::frame::FrameDecoder;
use parquet::basic::{Compression, Encoding};
use parquet::file::metadata::{ColumnChunkMetaData, ParquetMetaData};

use super::columns::gives;
use super::structures::{CHILDREN, METADATA, PAGE, SCHEMA};
use super::thrift::{Broken, FALSE, Fields, check, list, skip, zigzag};
use crate::error::{FaultKind, FileError, Place};

/// Number of values of a column of lists that need no bytes: runs of nulls, or of one value.
const FREE_VALUES: u64 = 1 << 22;
/// Number of values for each byte of a column of lists beyond them.
const VALUES_PER_BYTE: u64 = 64;
/// Depth of the schema: a list is two levels.
const MAX_LEVELS: usize = 32;

/// Checks the metadata, before the last eight bytes: known fields have their types, lists have the items that they claim, and the
/// schema is one tree. The library takes memory for the claims of lists and elements of the schema, and descends into these without end.
///
/// # Errors
/// Bytes that are not metadata, a schema that is not a tree or is deep.
pub(super) fn check_metadata(bytes: &[u8]) -> Result<(), FileError> {
    let expected = |what: &str| FileError::malformed(Place::tag("metadata"), format!("expected {what}"));
    let other = || expected("metadata of Parquet, got other bytes");
    let (rest, tail) = bytes.split_last_chunk::<8>().ok_or_else(other)?;
    let [length @ .., _, _, _, _] = tail;
    let length = usize::try_from(u32::from_le_bytes(*length)).ok();
    let start = length.and_then(|length| rest.len().checked_sub(length)).ok_or_else(other)?;
    let metadata = &rest[start..];
    check(&mut &*metadata, METADATA).map_err(|Broken| other())?;
    let children = children(metadata).map_err(|Broken| other())?;
    if is_tree(&children) {
        return Ok(());
    }
    Err(expected(&format!(
        "a schema that is one tree of at most {MAX_LEVELS} levels, got other numbers of children"
    )))
}

/// Number of children of every element of the schema, in depth-first order.
fn children(mut metadata: &[u8]) -> Result<Vec<i64>, Broken> {
    let bytes = &mut metadata;
    let mut all = Vec::new();
    let mut fields = Fields::default();
    while let Some((id, tag)) = fields.next(bytes)? {
        if id == SCHEMA {
            for _ in 0..list(bytes)?.0 {
                all.push(children_of_element(bytes)?);
            }
        } else {
            skip(bytes, tag)?;
        }
    }
    Ok(all)
}

fn children_of_element(bytes: &mut &[u8]) -> Result<i64, Broken> {
    let mut children = 0;
    let mut fields = Fields::default();
    while let Some((id, tag)) = fields.next(bytes)? {
        if id == CHILDREN { children = zigzag(bytes)? } else { skip(bytes, tag)? }
    }
    Ok(children)
}

/// Whether nodes with these numbers of children, in depth-first order, are one tree that is not too deep.
fn is_tree(children: &[i64]) -> bool {
    // Nodes that are still expected at each level; the first is that of the root.
    let mut expected = vec![1_i64];
    for &count in children {
        let Some(here) = expected.last_mut() else { return false };
        *here -= 1;
        if count < 0 || expected.len() > MAX_LEVELS {
            return false;
        }
        expected.push(count);
        while expected.last() == Some(&0) {
            expected.pop();
        }
    }
    expected.is_empty()
}

/// Content of the pages of a column of a row group.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Pages {
    /// Number of values, those of all lists together.
    pub(super) values: u64,
    /// Number of bytes after decompression.
    pub(super) bytes: u64,
    /// Number of bytes of the dictionary.
    pub(super) dictionary: u64,
    /// Number of bytes of the longest page beside the dictionary.
    pub(super) longest: u64,
}

/// Checks all pages of a column of a row group, which may hold `most` bytes after decompression.
///
/// # Errors
/// More bytes, pages beyond the file, pages that decompress to another size than they claim or to more than their compression can give, more
/// values in lists than their bytes can hold, compressions and encodings that are not read.
pub(super) fn check_column(
    bytes: &[u8],
    metadata: &ParquetMetaData,
    group: usize,
    column: usize,
    most: u64,
) -> Result<Pages, FileError> {
    let chunk = metadata.row_group(group).column(column);
    check_chunk(bytes, chunk, most).map_err(|error| error.at(place_of(metadata, group, column)))
}

/// The place of a column of a row group.
pub(super) fn place_of(metadata: &ParquetMetaData, group: usize, column: usize) -> Place {
    let path = metadata.row_group(group).column(column).column_path().string();
    Place { item: u64::try_from(group).ok(), ..Place::tag(format!("row group, column '{path}'")) }
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

fn check_chunk(bytes: &[u8], chunk: &ColumnChunkMetaData, most: u64) -> Result<Pages, FileError> {
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
    let mut pages = Pages::default();
    while !rest.is_empty() {
        let header = Header::read(&mut rest)?;
        let size = usize::try_from(header.compressed).ok();
        let Some((page, after)) = size.and_then(|size| rest.split_at_checked(size)) else {
            let detail =
                format!("expected a page of at most {} bytes, got {}", rest.len(), header.compressed);
            return Err(FileError::truncated(Place::default(), detail));
        };
        let size = header.size_of(page, ratio)?;
        pages.bytes = pages.bytes.saturating_add(size);
        if pages.bytes > most {
            let detail = "expected no more bytes in the pages than may be read of a file, got more";
            return Err(FileError::too_large(Place::default(), detail));
        }
        if !header.is_plain {
            check_compression(chunk.compression(), page, size, header.levels)?;
        }
        header.check_encoding()?;
        match header.page {
            DATA | DATA_2 => {
                pages.longest = pages.longest.max(size);
                pages.values = pages.values.saturating_add(header.values.unsigned_abs());
            }
            _ => pages.dictionary = pages.dictionary.max(size),
        }
        if header.values < 0 || (is_list && pages.values > allowed) {
            let detail = format!(
                "expected at most {allowed} values in the lists of a column, got {} or more",
                pages.values
            );
            return Err(FileError::too_large(Place::default(), detail));
        }
        rest = after;
    }
    if i64::try_from(pages.values).is_ok_and(|values| values == chunk.num_values()) {
        return Ok(pages);
    }
    let detail =
        format!("expected {} values in the pages of a column, got {}", chunk.num_values(), pages.values);
    Err(FileError::malformed(Place::default(), detail))
}

/// Checks that a page does not decompress to more than the `size` that it claims, of which `levels` are not compressed. The library
/// takes memory for the claim, but decompresses gzip and frames of LZ4 to their end.
fn check_compression(compression: Compression, page: &[u8], size: u64, levels: i64) -> Result<(), FileError> {
    let levels = usize::try_from(levels).ok().and_then(|levels| page.split_at_checked(levels));
    let Some((levels, compressed)) = levels else {
        return Err(FileError::malformed(
            Place::default(),
            "expected levels within their page, got a shorter page",
        ));
    };
    let expected = size.saturating_sub(levels.len() as u64);
    let is_frame = |mark: &[u8; 4]| {
        matches!(u32::from_le_bytes(*mark), 0x184d_2204 | 0x184c_2102 | 0x184d_2a50..=0x184d_2a5f)
    };
    let is_so = match compression {
        // A page without values need not be compressed.
        _ if expected == 0 => true,
        Compression::GZIP(_) => gives(MultiGzDecoder::new(compressed), expected),
        Compression::LZ4 if compressed.first_chunk().is_some_and(is_frame) => {
            gives(FrameDecoder::new(compressed), expected)
        }
        _ => true,
    };
    if is_so {
        return Ok(());
    }
    let detail = format!("expected a page that decompresses to {size} bytes, got another size");
    Err(FileError::malformed(Place::default(), detail))
}

/// Needed part of the header of a page.
#[derive(Default)]
struct Header {
    page: i64,
    uncompressed: i64,
    compressed: i64,
    values: i64,
    encoding: i64,
    /// Bytes of levels before the compressed part.
    levels: i64,
    /// Whether the page is not compressed, whatever its column is.
    is_plain: bool,
}

// Types of pages.
const DATA: i64 = 0;
const INDEX: i64 = 1;
const DICTIONARY: i64 = 2;
const DATA_2: i64 = 3;

impl Header {
    fn read(bytes: &mut &[u8]) -> Result<Self, FileError> {
        let broken =
            |Broken| FileError::malformed(Place::default(), "expected the header of a page, got other bytes");
        check(&mut &**bytes, PAGE).map_err(broken)?;
        Self::read_checked(bytes).map_err(broken)
    }

    /// Reads a header whose fields have their types. It has the part of its type of page, and no other, so that there is no doubt
    /// which numbers the library takes.
    fn read_checked(bytes: &mut &[u8]) -> Result<Self, Broken> {
        let mut header = Self::default();
        let mut parts = Vec::new();
        let mut fields = Fields::default();
        while let Some((id, tag)) = fields.next(bytes)? {
            match id {
                1 => header.page = zigzag(bytes)?,
                2 => header.uncompressed = zigzag(bytes)?,
                3 => header.compressed = zigzag(bytes)?,
                5..=8 => {
                    parts.push(id);
                    header.read_part(bytes, id)?;
                }
                _ => skip(bytes, tag)?,
            }
        }
        let part = match header.page {
            DATA => 5,
            INDEX => 6,
            DICTIONARY => 7,
            DATA_2 => 8,
            _ => return Err(Broken),
        };
        if parts == [part] { Ok(header) } else { Err(Broken) }
    }

    /// Reads the part of a type of page.
    fn read_part(&mut self, bytes: &mut &[u8], part: i64) -> Result<(), Broken> {
        let mut fields = Fields::default();
        while let Some((id, tag)) = fields.next(bytes)? {
            match (part, id) {
                (5 | 7 | 8, 1) => self.values = zigzag(bytes)?,
                (5 | 7, 2) | (8, 4) => self.encoding = zigzag(bytes)?,
                (8, 5 | 6) => {
                    let levels = zigzag(bytes)?;
                    self.levels = self.levels.checked_add(levels).filter(|_| levels >= 0).ok_or(Broken)?;
                }
                (8, 7) => self.is_plain = tag == FALSE,
                _ => skip(bytes, tag)?,
            }
        }
        Ok(())
    }

    /// Number of bytes after decompression: each of the page stands for at most `ratio`.
    fn size_of(&self, page: &[u8], ratio: u64) -> Result<u64, FileError> {
        let most = (page.len() as u64).saturating_mul(ratio).saturating_add(64);
        u64::try_from(self.uncompressed).ok().filter(|size| *size <= most).ok_or_else(|| {
            let detail = format!(
                "expected a page of {} bytes to hold at most {most}, got {}",
                page.len(),
                self.uncompressed
            );
            FileError::malformed(Place::default(), detail)
        })
    }

    /// Other encodings have separate sizes, which are claims as well.
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

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    /// A header of a data page without values, of 3 bytes.
    fn header(parts: &[u8]) -> Result<Header, FileError> {
        let bytes = [&[0x15, 0x00, 0x15, 0x06, 0x15, 0x06], parts, &[0x00]].concat();
        Header::read(&mut bytes.as_slice())
    }

    #[test]
    fn a_header_has_the_part_of_its_page() {
        // Five values, plain, with levels in runs.
        let data = [0x2c, 0x15, 0x0a, 0x15, 0x00, 0x15, 0x06, 0x15, 0x06, 0x00];
        // One value of a dictionary, by the id 7 behind 3 or 5.
        let [alone, behind] = [0x4c, 0x2c].map(|field| [field, 0x15, 0x02, 0x15, 0x00, 0x00]);
        let read = header(&data).expect("a header");
        assert_eq!((read.page, read.values, read.uncompressed, read.compressed), (DATA, 5, 3, 3));
        for parts in [&[] as &[u8], &alone, &[data.as_slice(), &behind].concat()] {
            let refused = header(parts).err().expect("other parts");
            assert_eq!(refused.to_string(), "expected the header of a page, got other bytes");
        }
    }

    #[test]
    fn pages_decompress_to_what_they_claim() {
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
        encoder.write_all(&[0; 100_000]).expect("memory");
        let page = [&[1, 2], encoder.finish().expect("memory").as_slice()].concat();
        let gzip = Compression::GZIP(parquet::basic::GzipLevel::default());
        let check =
            |compression, page: &[u8], size, levels| check_compression(compression, page, size, levels);
        assert!(check(gzip, &page, 100_002, 2).is_ok());
        for (size, levels) in [(1000, 2), (100_003, 2), (100_000, 0)] {
            let refused = check(gzip, &page, size, levels).expect_err("another size");
            let expected = format!("expected a page that decompresses to {size} bytes, got another size");
            assert_eq!(refused.to_string(), expected);
        }
        assert!(check(gzip, &[1, 2], 2, 2).is_ok());
        assert_eq!(check(gzip, &[1, 2], 2, 3).expect_err("levels").kind, FaultKind::Malformed);
        let mut encoder = lz4_flex::frame::FrameEncoder::new(Vec::new());
        encoder.write_all(&[0; 1000]).expect("memory");
        let frame = encoder.finish().expect("memory");
        assert!(check(Compression::LZ4, &frame, 1000, 0).is_ok());
        assert!(check(Compression::LZ4, &frame, 999, 0).is_err());
        assert!(check(Compression::LZ4_RAW, &frame, 9, 0).is_ok());
    }

    #[test]
    fn trees_have_the_children_that_they_claim() {
        for (children, expected) in [
            (&[0_i64] as &[i64], true),
            (&[2, 0, 0], true),
            (&[1, 2, 0, 0], true),
            (&[2, 1, 0, 0], true),
            (&[2, 0], false),
            (&[1, 0, 0], false),
            (&[-1, 0], false),
            (&[], false),
        ] {
            assert_eq!(is_tree(children), expected, "{children:?}");
        }
        let chain = |levels: usize| [vec![1; levels - 1], vec![0]].concat();
        assert!(is_tree(&chain(MAX_LEVELS)) && !is_tree(&chain(MAX_LEVELS + 1)));
    }
}
