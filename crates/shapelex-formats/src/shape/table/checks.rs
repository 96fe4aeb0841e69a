//! Claims of a message of Arrow IPC, checked before the library trusts them.

use arrow_ipc::{
    CompressionType, DateUnit, Endianness, Field, IntervalUnit, Message, MessageHeader, RecordBatch, Schema,
    TimeUnit, Type, root_as_message,
};
use lz4_flex::frame::FrameDecoder;

use super::super::limits::Limits;
use super::columns::{check_name, gives};
use super::dictionaries::Dictionary;
use super::layout::{Layout, check_dictionary, check_rows};
use crate::error::{FileError, Place};

/// Depth of nested columns: a list of points of a struct is three deep.
const MAX_DEPTH: usize = 8;
/// Most that a byte compressed by LZ4 stands for.
const LZ4_RATIO: u64 = 255;

fn malformed(detail: impl Into<String>) -> FileError {
    FileError::malformed(Place::default(), detail)
}

fn unsupported(detail: impl Into<String>) -> FileError {
    FileError::unsupported(Place::default(), detail)
}

fn message(metadata: &[u8]) -> Result<Message<'_>, FileError> {
    root_as_message(metadata)
        .map_err(|error| malformed(format!("expected the metadata of a message, got {error}")))
}

/// Number of bytes of the body of a message, at most `held`. A schema has types that the library knows.
pub(super) fn check_message(metadata: &[u8], held: usize) -> Result<usize, FileError> {
    let message = message(metadata)?;
    match message.header_type() {
        MessageHeader::Schema => {
            let schema =
                message.header_as_schema().ok_or_else(|| malformed("expected a schema, got none"))?;
            check_schema(&schema)?;
        }
        MessageHeader::RecordBatch | MessageHeader::DictionaryBatch => {}
        other => {
            return Err(unsupported(format!("expected batches of rows, got a message of type {other:?}")));
        }
    }
    match usize::try_from(message.bodyLength()) {
        Ok(length) if length <= held => Ok(length),
        _ => {
            let detail = format!("expected a body of at most {held} bytes, got {}", message.bodyLength());
            Err(FileError::too_large(Place::default(), detail))
        }
    }
}

fn check_schema(schema: &Schema<'_>) -> Result<(), FileError> {
    if schema.endianness() != Endianness::Little {
        return Err(unsupported("expected numbers in little-endian order, got another order"));
    }
    let fields = schema.fields().ok_or_else(|| malformed("expected columns, got none"))?;
    fields.iter().try_for_each(|field| check_field(&field, 0))
}

/// A column whose type the library can name: it stops at others.
fn check_field(field: &Field<'_>, depth: usize) -> Result<(), FileError> {
    let name = field.name().unwrap_or_default();
    check_name(name)?;
    let refuse = || {
        let detail =
            format!("expected a column of a simple type, a list or a struct, got {:?}", field.type_type());
        Err(FileError::unsupported(Place::tag(format!("column '{name}'")), detail))
    };
    if depth > MAX_DEPTH {
        return refuse();
    }
    if let Some(dictionary) = field.dictionary() {
        let is_index =
            dictionary.indexType().is_some_and(|index| matches!(index.bitWidth(), 8 | 16 | 32 | 64));
        if !is_index {
            return refuse();
        }
    }
    if !is_known(field) {
        return refuse();
    }
    field.children().into_iter().flatten().try_for_each(|child| check_field(&child, depth + 1))
}

/// Whether the library knows the type of a column.
fn is_known(field: &Field<'_>) -> bool {
    let count = field.children().map_or(0, |children| children.len());
    let time = |unit: TimeUnit| (TimeUnit::SECOND..=TimeUnit::NANOSECOND).contains(&unit);
    match field.type_type() {
        Type::Null | Type::Bool | Type::Binary | Type::BinaryView | Type::LargeBinary => count == 0,
        Type::Utf8 | Type::Utf8View | Type::LargeUtf8 => count == 0,
        Type::Int => field.type_as_int().is_some_and(|int| matches!(int.bitWidth(), 8 | 16 | 32 | 64)),
        // Half, single and double precision.
        Type::FloatingPoint => {
            field.type_as_floating_point().is_some_and(|float| (0..=2).contains(&float.precision().0))
        }
        Type::FixedSizeBinary => {
            field.type_as_fixed_size_binary().is_some_and(|binary| binary.byteWidth() > 0)
        }
        Type::Date => field
            .type_as_date()
            .is_some_and(|date| matches!(date.unit(), DateUnit::DAY | DateUnit::MILLISECOND)),
        Type::Time => field.type_as_time().is_some_and(|time| match time.bitWidth() {
            32 => matches!(time.unit(), TimeUnit::SECOND | TimeUnit::MILLISECOND),
            64 => matches!(time.unit(), TimeUnit::MICROSECOND | TimeUnit::NANOSECOND),
            _ => false,
        }),
        Type::Timestamp => field.type_as_timestamp().is_some_and(|stamp| time(stamp.unit())),
        Type::Duration => field.type_as_duration().is_some_and(|duration| time(duration.unit())),
        Type::Interval => field.type_as_interval().is_some_and(|interval| {
            (IntervalUnit::YEAR_MONTH..=IntervalUnit::MONTH_DAY_NANO).contains(&interval.unit())
        }),
        Type::Decimal => field.type_as_decimal().is_some_and(|decimal| {
            matches!(
                (decimal.bitWidth(), decimal.precision(), decimal.scale()),
                (128, 1..=38, -38..=38) | (256, 1..=76, -76..=76)
            )
        }),
        Type::List | Type::LargeList => count == 1,
        Type::FixedSizeList => {
            count == 1 && field.type_as_fixed_size_list().is_some_and(|list| list.listSize() >= 0)
        }
        Type::Struct_ => true,
        _ => false,
    }
}

/// Checks that the buffers of a message lie within its body, that their decompressed size is at most the size that may be held, in
/// proportion to them, and that no column claims more values than these bytes can hold. `layout` are the columns of the schema.
pub(super) fn check_buffers(
    metadata: &[u8],
    body: &[u8],
    layout: Option<&Layout>,
    limits: &Limits,
) -> Result<Option<Batch>, FileError> {
    let message = message(metadata)?;
    let dictionary = message.header_as_dictionary_batch();
    let batch = match message.header_type() {
        MessageHeader::DictionaryBatch => dictionary.and_then(|batch| batch.data()),
        MessageHeader::RecordBatch => message.header_as_record_batch(),
        _ => return Ok(None),
    };
    let batch = batch.ok_or_else(|| malformed("expected a batch of rows, got none"))?;
    let made = limits.made(body.len()) as u64;
    let sizes = sizes(&batch, body, made.min(limits.held as u64))?;
    let bytes: u64 = sizes.iter().sum();
    // A value takes a bit at least; columns that are null throughout take nothing, beside others that do.
    let most = i64::try_from(bytes.saturating_mul(8).saturating_add(64)).unwrap_or(i64::MAX);
    let nodes = batch.nodes().ok_or_else(|| malformed("expected the lengths of columns, got none"))?;
    let lengths = nodes.iter().flat_map(|node| [node.length(), node.null_count()]).chain([batch.length()]);
    if let Some(length) = lengths.into_iter().find(|length| !(0..=most).contains(length)) {
        return Err(malformed(format!("expected at most {most} values in {bytes} bytes, got {length}")));
    }
    let layout = layout.ok_or_else(|| malformed("expected a schema before all rows, got rows"))?;
    let dictionary = match dictionary {
        Some(dictionary) => {
            let id = dictionary.id();
            check_dictionary(layout, id, &batch, &sizes)?;
            Some(Dictionary { id, bytes, is_delta: dictionary.isDelta() })
        }
        None => {
            check_rows(layout, &batch, &sizes, made)?;
            None
        }
    };
    // No length is negative.
    let values = nodes.iter().map(|node| node.length().unsigned_abs()).fold(0_u64, u64::saturating_add);
    Ok(Some(Batch { cells: values.saturating_add(layout.columns), dictionary }))
}

/// A batch of rows or of values of a dictionary.
pub(super) struct Batch {
    /// Number of values of all its columns, those within lists too, and one for each column of the schema: the library goes
    /// through all of them.
    pub(super) cells: u64,
    /// The dictionary, if it is one: the decoder keeps its values until others come in their place.
    pub(super) dictionary: Option<Dictionary>,
}

/// Number of bytes of each buffer after decompression, at most `most` together.
fn sizes(batch: &RecordBatch<'_>, body: &[u8], most: u64) -> Result<Vec<u64>, FileError> {
    let compressed = match batch.compression().map(|compression| compression.codec()) {
        None => false,
        Some(CompressionType::LZ4_FRAME) => true,
        Some(_) => {
            return Err(unsupported(
                "expected columns without compression or with LZ4, got Zstandard; write the file with compression='lz4'",
            ));
        }
    };
    let mut left = most;
    let size = |buffer: &arrow_ipc::Buffer| {
        let range = usize::try_from(buffer.offset()).ok().zip(usize::try_from(buffer.length()).ok());
        let bytes = range.and_then(|(start, length)| body.get(start..start.checked_add(length)?));
        let bytes = bytes.ok_or_else(|| {
            malformed(format!(
                "expected buffers within a body of {} bytes, got one of {} bytes at {}",
                body.len(),
                buffer.length(),
                buffer.offset()
            ))
        })?;
        let claimed = if compressed { claimed(bytes)? } else { bytes.len() as u64 };
        left = left.checked_sub(claimed).ok_or_else(|| {
            let detail = format!("expected a batch of at most {most} bytes, got more");
            FileError::too_large(Place::default(), detail)
        })?;
        if compressed {
            check_claim(bytes, claimed)?;
        }
        Ok(claimed)
    };
    batch.buffers().into_iter().flatten().map(size).collect()
}

/// Number in front of a buffer that is not compressed.
const PLAIN: i64 = -1;

/// Number of bytes that a compressed buffer claims to hold.
fn claimed(bytes: &[u8]) -> Result<u64, FileError> {
    match bytes.split_first_chunk::<8>() {
        None if bytes.is_empty() => Ok(0),
        None => Err(malformed("expected the size of a buffer, got its end")),
        Some((claim, rest)) => match i64::from_le_bytes(*claim) {
            PLAIN => Ok(rest.len() as u64),
            claim => u64::try_from(claim)
                .ok()
                .filter(|size| *size <= (rest.len() as u64).saturating_mul(LZ4_RATIO))
                .ok_or_else(|| other_size(rest, claim)),
        },
    }
}

/// Checks that a compressed buffer has the claimed size. One that claims nothing is not decompressed.
fn check_claim(bytes: &[u8], claimed: u64) -> Result<(), FileError> {
    let Some((claim, rest)) = bytes.split_first_chunk::<8>().filter(|_| claimed > 0) else { return Ok(()) };
    let claim = i64::from_le_bytes(*claim);
    if claim == PLAIN || gives(FrameDecoder::new(rest), claimed) {
        Ok(())
    } else {
        Err(other_size(rest, claim))
    }
}

fn other_size(rest: &[u8], claim: i64) -> FileError {
    malformed(format!("expected a size that {} bytes can decompress to, got {claim}", rest.len()))
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    #[test]
    fn buffers_decompress_to_what_they_claim() {
        let mut encoder = lz4_flex::frame::FrameEncoder::new(Vec::new());
        encoder.write_all(&[0; 100_000]).expect("memory");
        let frame = encoder.finish().expect("memory");
        let claim = |size: i64| {
            let buffer = [&size.to_le_bytes(), frame.as_slice()].concat();
            let claimed = claimed(&buffer)?;
            check_claim(&buffer, claimed).map(|()| claimed)
        };
        assert_eq!(claim(100_000).expect("its size"), 100_000);
        assert_eq!(claim(-1).expect("not compressed"), frame.len() as u64);
        for size in [1000, 100_001, 1 << 40] {
            let expected =
                format!("expected a size that {} bytes can decompress to, got {size}", frame.len());
            assert_eq!(claim(size).expect_err("another size").to_string(), expected);
        }
    }
}
