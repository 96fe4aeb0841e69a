//! The columns of a batch of Arrow IPC against the buffers that it has: a column without enough bytes for its values is refused
//! here, since the library stops at it.

use arrow_ipc::{DateUnit, Field, FieldNode, IntervalUnit, Precision, RecordBatch, Schema, Type};

use super::super::error::{FileError, Place};

/// Largest width of the items of a fixed size, in bytes or elements.
const MAX_WIDTH: u64 = 1 << 31;

/// What is left of a batch while its columns are gone through.
struct Rest<'a, N> {
    nodes: N,
    /// Sizes of the buffers after decompression.
    sizes: std::slice::Iter<'a, u64>,
    /// Numbers of buffers of columns of views.
    views: std::vec::IntoIter<i64>,
    /// Bytes of what is made of the columns: numbers in double precision, places of lists and of texts of a dictionary.
    made: u64,
}

/// Checks that the columns of a batch of rows have the buffers that their types want, and that at most `most` bytes are made of them.
pub(super) fn check_rows(
    schema: &Schema<'_>,
    batch: &RecordBatch<'_>,
    sizes: &[u64],
    most: u64,
) -> Result<(), FileError> {
    let mut rest = Rest {
        nodes: batch.nodes().into_iter().flatten(),
        sizes: sizes.iter(),
        views: batch.variadicBufferCounts().into_iter().flatten().collect::<Vec<_>>().into_iter(),
        made: 0,
    };
    let fields = schema.fields().into_iter().flatten();
    fields.into_iter().try_for_each(|field| rest.column(&field, false))?;
    if rest.made > most {
        let detail = format!(
            "expected a batch of at most {most} bytes in double precision, got {}; write smaller batches",
            rest.made
        );
        return Err(FileError::too_large(Place::default(), detail));
    }
    Ok(())
}

/// Checks the values of a dictionary of the column with this id.
pub(super) fn check_dictionary(
    schema: &Schema<'_>,
    id: i64,
    batch: &RecordBatch<'_>,
    sizes: &[u64],
) -> Result<(), FileError> {
    let found = schema.fields().into_iter().flatten().find_map(|field| with_dictionary(field, id));
    let Some(field) = found else {
        let detail = format!("expected a dictionary of a column, got one with the unknown id {id}");
        return Err(FileError::malformed(Place::default(), detail));
    };
    let mut rest = Rest {
        nodes: batch.nodes().into_iter().flatten(),
        sizes: sizes.iter(),
        views: batch.variadicBufferCounts().into_iter().flatten().collect::<Vec<_>>().into_iter(),
        made: 0,
    };
    rest.column(&field, true)
}

fn with_dictionary(field: Field<'_>, id: i64) -> Option<Field<'_>> {
    if field.dictionary().is_some_and(|dictionary| dictionary.id() == id) {
        return Some(field);
    }
    field.children().into_iter().flatten().find_map(|child| with_dictionary(child, id))
}

impl<'a, N: Iterator<Item = &'a FieldNode>> Rest<'a, N> {
    /// Goes through a column. `values` are those of its dictionary.
    fn column(&mut self, field: &Field<'_>, values: bool) -> Result<(), FileError> {
        let name = field.name().unwrap_or_default();
        let fault = |detail: String| FileError::malformed(Place::tag(format!("column '{name}'")), detail);
        let node =
            self.nodes.next().ok_or_else(|| fault("expected the length of the column, got none".into()))?;
        let length = u64::try_from(node.length()).unwrap_or_default();
        let kind = field.type_type();
        let index = field.dictionary().filter(|_| !values).and_then(|dictionary| dictionary.indexType());
        if index.is_some()
            || matches!(kind, Type::Null | Type::Int | Type::FloatingPoint | Type::List | Type::LargeList)
        {
            self.made = self.made.saturating_add(length.saturating_mul(8));
        }
        if kind == Type::Null && index.is_none() {
            return Ok(());
        }
        // Buffers of offsets and views are whole numbers of items.
        let mut buffer = |what: &str, wanted: u64, item: u64| match self.sizes.next() {
            Some(size) if *size >= wanted && size.is_multiple_of(item) => Ok(()),
            Some(size) => Err(fault(format!(
                "expected {wanted} bytes of {what} for {length} rows, or more in items of {item}, got {size}"
            ))),
            None => Err(fault(format!("expected a buffer of {what}, got none"))),
        };
        let bits = length.div_ceil(8);
        buffer("validity", if node.null_count() == 0 { 0 } else { bits }, 1)?;
        // Offsets of no rows may be left out.
        let offsets = |width: u64| if length == 0 { 0 } else { (length + 1).saturating_mul(width) };
        let items = |width: u64| length.saturating_mul(width);
        if let Some(index) = index {
            return buffer("positions", items(u64::from(index.bitWidth().unsigned_abs()) / 8), 1);
        }
        match kind {
            Type::Bool => buffer("values", bits, 1),
            Type::Utf8 | Type::Binary => {
                buffer("offsets", offsets(4), 4).and_then(|()| buffer("content", 0, 1))
            }
            Type::LargeUtf8 | Type::LargeBinary => {
                buffer("offsets", offsets(8), 8).and_then(|()| buffer("content", 0, 1))
            }
            Type::Utf8View | Type::BinaryView => {
                buffer("views", items(16), 16)?;
                self.skip_views().map_err(fault)
            }
            Type::List | Type::LargeList | Type::FixedSizeList | Type::Struct_ => {
                match kind {
                    Type::List => buffer("offsets", offsets(4), 4)?,
                    Type::LargeList => buffer("offsets", offsets(8), 8)?,
                    _ => {}
                }
                field.children().into_iter().flatten().try_for_each(|child| self.column(&child, false))
            }
            _ => {
                let width = width(field).filter(|width| *width <= MAX_WIDTH);
                let width = width.ok_or_else(|| fault("expected values of a fixed width".into()))?;
                buffer("values", items(width), 1)
            }
        }
    }

    /// Passes over the buffers of a column of views.
    fn skip_views(&mut self) -> Result<(), String> {
        let count = self.views.next().and_then(|count| usize::try_from(count).ok());
        let count = count.ok_or("expected the number of buffers of views, got none")?;
        if count > self.sizes.len() {
            return Err(format!("expected {} buffers of views at most, got {count}", self.sizes.len()));
        }
        self.sizes.by_ref().take(count).for_each(drop);
        Ok(())
    }
}

/// Number of bytes of a value of a fixed width.
fn width(field: &Field<'_>) -> Option<u64> {
    let bytes = |bits: i32| u64::try_from(bits / 8).ok();
    match field.type_type() {
        Type::Int => bytes(field.type_as_int()?.bitWidth()),
        Type::FloatingPoint => match field.type_as_floating_point()?.precision() {
            Precision::HALF => Some(2),
            Precision::SINGLE => Some(4),
            _ => Some(8),
        },
        Type::FixedSizeBinary => u64::try_from(field.type_as_fixed_size_binary()?.byteWidth()).ok(),
        Type::Date => Some(if field.type_as_date()?.unit() == DateUnit::DAY { 4 } else { 8 }),
        Type::Time => bytes(field.type_as_time()?.bitWidth()),
        Type::Timestamp | Type::Duration => Some(8),
        Type::Interval => match field.type_as_interval()?.unit() {
            IntervalUnit::YEAR_MONTH => Some(4),
            IntervalUnit::DAY_TIME => Some(8),
            _ => Some(16),
        },
        Type::Decimal => bytes(field.type_as_decimal()?.bitWidth()),
        _ => None,
    }
}
