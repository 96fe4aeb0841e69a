//! The columns of a batch of Arrow IPC against the buffers that it has: a column without enough bytes for its values is refused
//! here, since the library stops at it.

use std::collections::BTreeMap;

use arrow_ipc::{FieldNode, RecordBatch};
use arrow_schema::{DataType, FieldRef, SchemaRef};

use crate::error::{FileError, Place};

/// Largest width of the items of a fixed size, in bytes or elements.
const MAX_WIDTH: u64 = 1 << 31;
/// Most columns with dictionaries: for each dictionary, the library goes through all columns.
const MAX_DICTIONARIES: u64 = 1024;

/// The columns of a stream as the library takes them, made once: the message with them is long, and batches may be short.
pub(super) struct Layout {
    schema: SchemaRef,
    /// Columns by the id of their dictionary: the first one of an id, as the library does.
    dictionaries: BTreeMap<i64, FieldRef>,
    /// Number of columns, those within others too.
    pub(super) columns: u64,
}

impl Layout {
    /// The columns of a schema.
    ///
    /// # Errors
    /// Many columns with dictionaries.
    pub(super) fn new(schema: SchemaRef) -> Result<Self, FileError> {
        let (dictionaries, mut count) = (BTreeMap::new(), 0);
        let mut layout = Self { schema: SchemaRef::clone(&schema), dictionaries, columns: 0 };
        layout.add(schema.fields(), &mut count);
        if count <= MAX_DICTIONARIES {
            return Ok(layout);
        }
        let detail = format!("expected at most {MAX_DICTIONARIES} columns with dictionaries, got {count}");
        Err(FileError::too_large(Place::tag("schema"), detail))
    }

    /// Adds columns and those within them, of which `count` have dictionaries.
    fn add(&mut self, fields: &[FieldRef], count: &mut u64) {
        for field in fields {
            self.columns += 1;
            // Only the id connects a dictionary with its columns, in the library too.
            #[allow(deprecated)]
            let id = field.dict_id();
            if let Some(id) = id {
                *count += 1;
                self.dictionaries.entry(id).or_insert_with(|| FieldRef::clone(field));
            }
            self.add(children(field.data_type()), count);
        }
    }
}

/// The columns within a column, or within the values of its dictionary.
fn children(kind: &DataType) -> &[FieldRef] {
    match kind {
        DataType::List(item) | DataType::LargeList(item) | DataType::FixedSizeList(item, _) => {
            std::slice::from_ref(item)
        }
        DataType::Struct(fields) => &fields[..],
        DataType::Dictionary(_, values) => children(values),
        _ => &[],
    }
}

/// Rest of a batch while its columns are gone through.
struct Rest<'a, N> {
    nodes: N,
    /// Sizes of the buffers after decompression.
    sizes: std::slice::Iter<'a, u64>,
    /// Numbers of buffers of columns of views.
    views: std::vec::IntoIter<i64>,
    /// Bytes made of the columns: numbers in double precision, places of lists and of texts of a dictionary.
    made: u64,
}

/// Checks that the columns of a batch of rows have the buffers that their types want, and that at most `most` bytes are made of them.
pub(super) fn check_rows(
    layout: &Layout,
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
    layout.schema.fields().iter().try_for_each(|field| rest.column(field.name(), field.data_type()))?;
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
    layout: &Layout,
    id: i64,
    batch: &RecordBatch<'_>,
    sizes: &[u64],
) -> Result<(), FileError> {
    let found = layout.dictionaries.get(&id).map(|field| (field.name(), field.data_type()));
    let Some((name, DataType::Dictionary(_, values))) = found else {
        let detail = format!("expected a dictionary of a column, got one with the unknown id {id}");
        return Err(FileError::malformed(Place::default(), detail));
    };
    let mut rest = Rest {
        nodes: batch.nodes().into_iter().flatten(),
        sizes: sizes.iter(),
        views: batch.variadicBufferCounts().into_iter().flatten().collect::<Vec<_>>().into_iter(),
        made: 0,
    };
    rest.column(name, values)
}

impl<'a, N: Iterator<Item = &'a FieldNode>> Rest<'a, N> {
    /// Goes through a column: of one with a dictionary, through the positions.
    fn column(&mut self, name: &str, kind: &DataType) -> Result<(), FileError> {
        let fault = |detail: String| FileError::malformed(Place::tag(format!("column '{name}'")), detail);
        let node =
            self.nodes.next().ok_or_else(|| fault("expected the length of the column, got none".into()))?;
        let length = u64::try_from(node.length()).unwrap_or_default();
        if is_made_anew(kind) {
            self.made = self.made.saturating_add(length.saturating_mul(8));
        }
        if matches!(kind, DataType::Null) {
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
        match kind {
            DataType::Boolean => buffer("values", bits, 1),
            DataType::Utf8 | DataType::Binary => {
                buffer("offsets", offsets(4), 4).and_then(|()| buffer("content", 0, 1))
            }
            DataType::LargeUtf8 | DataType::LargeBinary => {
                buffer("offsets", offsets(8), 8).and_then(|()| buffer("content", 0, 1))
            }
            DataType::Utf8View | DataType::BinaryView => {
                buffer("views", items(16), 16)?;
                self.skip_views().map_err(fault)
            }
            DataType::List(_)
            | DataType::LargeList(_)
            | DataType::FixedSizeList(..)
            | DataType::Struct(_) => {
                match kind {
                    DataType::List(_) => buffer("offsets", offsets(4), 4)?,
                    DataType::LargeList(_) => buffer("offsets", offsets(8), 8)?,
                    _ => {}
                }
                children(kind).iter().try_for_each(|child| self.column(child.name(), child.data_type()))
            }
            _ => {
                let width = width(kind).filter(|width| *width <= MAX_WIDTH);
                let width = width.ok_or_else(|| fault("expected values of a fixed width".into()))?;
                let what = if matches!(kind, DataType::Dictionary(..)) { "positions" } else { "values" };
                buffer(what, items(width), 1)
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

/// Whether values of a type are not used as they are: numbers become doubles, offsets and positions other integers.
fn is_made_anew(kind: &DataType) -> bool {
    let is_other = matches!(
        kind,
        DataType::Null | DataType::Dictionary(..) | DataType::List(_) | DataType::LargeList(_)
    );
    is_other || kind.is_integer() || kind.is_floating()
}

/// Number of bytes of a value of a fixed width, or of its position in a dictionary.
fn width(kind: &DataType) -> Option<u64> {
    match kind {
        DataType::FixedSizeBinary(width) => u64::try_from(*width).ok(),
        DataType::Dictionary(position, _) => width(position),
        _ => kind.primitive_width().and_then(|width| u64::try_from(width).ok()),
    }
}
