//! Parquet: in and out.
//!
//! The table of contents is at the end, so that a file is held while it is read. Row groups are written as they fill up; their
//! columns are encoded in parallel, and come out in the same order and bytes on any number of threads.

use std::collections::HashMap;
use std::io::Write;
use std::sync::Arc;

use arrow_array::RecordBatch;
use arrow_array::cast::AsArray;
use arrow_schema::{DataType, FieldRef, Fields, Schema, SchemaRef};
use bytes::Bytes;
use parquet::arrow::arrow_reader::{
    ArrowReaderMetadata, ArrowReaderOptions, ParquetRecordBatchReaderBuilder,
};
use parquet::arrow::arrow_writer::{
    ArrowColumnChunk, ArrowColumnWriter, ArrowRowGroupWriterFactory, compute_leaves,
};
use parquet::arrow::{ArrowSchemaConverter, ProjectionMask};
use parquet::basic::Compression;
use parquet::errors::ParquetError;
use parquet::file::metadata::{KeyValue, ParquetMetaData};
use parquet::file::properties::WriterProperties;
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::types::ColumnDescPtr;
use rayon::prelude::*;

use super::super::format::Format;
use super::super::guarded::guarded;
use super::super::options::{ReadOptions, WriteOptions};
use super::super::record::Sink;
use super::super::record::{Kind, Record};
use super::super::source::Source;
use super::super::write::{Opened, Output, Writer};
use super::columns::{CELLS, unwritten};
use super::decoded::rows_at_once;
use super::list_pages::ListColumn;
use super::pages::{Pages, check_column, check_metadata};
use super::read_rows::Reading;
use super::rows::Rows;
use crate::error::{FaultKind, FileError, Place};
use crate::summary::Summary;

/// Parquet.
pub(in super::super) static FORMAT: Format = Format {
    id: "parquet",
    name: "Parquet",
    media_types: &["application/vnd.apache.parquet"],
    extensions: &["parquet", "pq"],
    recognise: |head| head.starts_with(b"PAR1"),
    kinds: &[Kind::Curve, Kind::Landmarks, Kind::Mesh],
    options: &["closed", "columns", "dimension", "attributes"],
    read: Some(read),
    open: Some(open),
};

/// Number of batches of a row group.
const BATCHES: usize = 4;
/// Number of row groups that are encoded at once: a constant, so that memory does not depend on the machine.
const GROUPS: usize = 2;

fn read(source: &mut Source<'_>, options: &ReadOptions, sink: Sink<'_>) -> Result<Summary, FileError> {
    let bytes = Bytes::from(source.bytes()?);
    let at = || Place::byte(bytes.len() as u64);
    if bytes.len() < 12 || !bytes.ends_with(b"PAR1") {
        return Err(FileError::truncated(at(), "expected PAR1 at the end of the file, got other bytes"));
    }
    check_metadata(&bytes)?;
    let content = guarded("a table of contents", || contents(&bytes))?;
    let metadata = content.metadata();
    check_alone(&bytes, metadata)?;
    check_rows(metadata)?;
    let limits = *source.limits();
    let mut reading = Reading::new(options, limits, &facts(metadata));
    let roots = reading.of_use(content.schema())?;
    let schema = content.parquet_schema();
    let columns: Vec<usize> = (0..schema.num_columns())
        .filter(|column| roots.contains(&schema.get_column_root_idx(*column)))
        .collect();
    let mask = ProjectionMask::roots(schema, roots);
    let (mut left, cells) = (limits.content, source.budget(CELLS));
    for group in 0..metadata.num_row_groups() {
        let pages = check_group(&bytes, metadata, group, &columns, &mut left)?;
        let values = pages.iter().map(|(_, pages)| pages.values).fold(0, u64::saturating_add);
        cells.take(values).map_err(|error| error.at(place_of_group(group)))?;
        let rows = rows_at_once(&bytes, metadata, group, &pages, &limits)?;
        let builder = ParquetRecordBatchReaderBuilder::new_with_metadata(bytes.clone(), content.clone())
            .with_row_groups(vec![group])
            .with_projection(mask.clone())
            .with_batch_size(rows);
        let mut batches = guarded("a row group", || builder.build().map_err(malformed))?;
        let mut found = 0;
        while let Some(batch) = guarded("a row group", || Ok(batches.next()))? {
            let batch = batch.map_err(|error| {
                FileError::malformed(place_of_group(group), format!("expected valid pages, got {error}"))
            })?;
            found += batch.num_rows() as i64;
            reading.batch(&batch, sink)?;
        }
        let announced = metadata.row_group(group).num_rows();
        if found != announced {
            let detail = format!("expected {announced} rows by the table of contents, got {found}");
            return Err(FileError::malformed(place_of_group(group), detail));
        }
    }
    Ok(reading.summary)
}

/// Refuses files one after the other: the last table of contents would be read with the data of the first file.
fn check_alone(bytes: &[u8], metadata: &ParquetMetaData) -> Result<(), FileError> {
    let columns = metadata.row_groups().iter().flat_map(|group| group.columns());
    let end = columns.map(|column| {
        let start = column.dictionary_page_offset().unwrap_or(column.data_page_offset());
        start.max(0).saturating_add(column.compressed_size().max(0))
    });
    let end = usize::try_from(end.max().unwrap_or(4)).unwrap_or(usize::MAX);
    match bytes.get(end..).and_then(|rest| rest.windows(8).position(|bytes| bytes == b"PAR1PAR1")) {
        None => Ok(()),
        Some(at) => {
            let detail = "expected one table, got another one after its end";
            Err(FileError::malformed(Place::byte((end + at + 4) as u64), detail))
        }
    }
}

/// Refuses a table of contents whose numbers of rows contradict each other.
fn check_rows(metadata: &ParquetMetaData) -> Result<(), FileError> {
    let rows = metadata.row_groups().iter().map(|group| group.num_rows());
    let (announced, found) = (metadata.file_metadata().num_rows(), rows.fold(0, i64::saturating_add));
    if announced == found {
        return Ok(());
    }
    let detail = format!("expected row groups of {announced} rows in all, got {found}");
    Err(FileError::malformed(Place::tag("row group"), detail))
}

fn place_of_group(group: usize) -> Place {
    Place { item: u64::try_from(group).ok(), ..Place::tag("row group") }
}

/// The table of contents, with texts that stay in their pages: those of a dictionary may be as long as it is.
fn contents(bytes: &Bytes) -> Result<ArrowReaderMetadata, FileError> {
    // The Arrow schema of the writer says nothing that is needed here.
    let settings = ArrowReaderOptions::new().with_skip_arrow_metadata(true);
    let found = ArrowReaderMetadata::load(bytes, settings.clone()).map_err(malformed)?;
    let column = |field: &FieldRef| match field.data_type() {
        DataType::Utf8 => Arc::new(field.as_ref().clone().with_data_type(DataType::Utf8View)),
        _ => field.clone(),
    };
    let schema = Schema::new(found.schema().fields().iter().map(column).collect::<Fields>());
    ArrowReaderMetadata::try_new(found.metadata().clone(), settings.with_schema(Arc::new(schema)))
        .map_err(malformed)
}

/// Checks the pages of some columns of a row group, which may have `left` bytes.
fn check_group(
    bytes: &[u8],
    metadata: &ParquetMetaData,
    group: usize,
    columns: &[usize],
    left: &mut u64,
) -> Result<Vec<(usize, Pages)>, FileError> {
    let mut found = Vec::with_capacity(columns.len());
    for column in columns.iter().copied() {
        let pages = check_column(bytes, metadata, group, column, *left)?;
        *left -= pages.bytes;
        found.push((column, pages));
    }
    Ok(found)
}

/// Facts of the metadata of the file.
fn facts(metadata: &ParquetMetaData) -> HashMap<String, String> {
    let pairs = metadata.file_metadata().key_value_metadata().into_iter().flatten();
    pairs.filter_map(|pair| Some((pair.key.clone(), pair.value.clone()?))).collect()
}

pub(super) fn malformed(error: ParquetError) -> FileError {
    let kind =
        if matches!(error, ParquetError::NYI(_)) { FaultKind::Unsupported } else { FaultKind::Malformed };
    FileError::new(kind, format!("expected a Parquet file, got {error}"))
}

struct File<'a> {
    rows: Rows,
    output: Option<Box<dyn Write + Send + 'a>>,
    begun: Option<Begun<'a>>,
    /// Batches that are not encoded yet, in order.
    waiting: Vec<RecordBatch>,
}

/// A file whose columns are known.
struct Begun<'a> {
    writer: SerializedFileWriter<Box<dyn Write + Send + 'a>>,
    factory: ArrowRowGroupWriterFactory,
    columns: Vec<ColumnDescPtr>,
    groups: usize,
}

fn open<'a>(output: Output<'a>, options: &WriteOptions) -> Opened<'a> {
    Ok(Box::new(File { rows: Rows::new(options), output: Some(output), begun: None, waiting: Vec::new() }))
}

/// Settings of the columns that are not lists: Snappy, which every reader knows.
fn properties(schema: &SchemaRef) -> WriterProperties {
    let mut facts: Vec<KeyValue> =
        schema.metadata().iter().map(|(name, value)| KeyValue::new(name.clone(), value.clone())).collect();
    facts.sort_by(|a, b| a.key.cmp(&b.key));
    WriterProperties::builder()
        .set_created_by("shapelex".into())
        .set_compression(Compression::SNAPPY)
        .set_key_value_metadata(Some(facts))
        .build()
}

/// A column of a row group, encoded.
enum Encoded {
    /// Coordinates, faces and fields. They hardly repeat, so that dictionaries and compression save nothing, and no query filters by
    /// them, so that statistics do not either.
    Lists(ListColumn),
    /// Other columns, encoded by the library.
    Cells(ArrowColumnChunk),
}

/// The columns of a row group, encoded.
fn encode(
    (factory, columns): (&ArrowRowGroupWriterFactory, &[ColumnDescPtr]),
    group: usize,
    batches: &[RecordBatch],
) -> Result<Vec<Encoded>, ParquetError> {
    let writers = factory.create_column_writers(group)?;
    // Every column has one leaf.
    let encode = |(k, (mut writer, column)): (usize, (ArrowColumnWriter, &ColumnDescPtr))| {
        if column.max_rep_level() > 0 {
            let lists = batches.iter().map(|batch| batch.column(k).as_list());
            return ListColumn::encode(column, lists).map(Encoded::Lists);
        }
        for batch in batches {
            for leaf in compute_leaves(batch.schema().field(k), batch.column(k))? {
                writer.write(&leaf)?;
            }
        }
        writer.close().map(Encoded::Cells)
    };
    writers.into_iter().zip(columns).enumerate().map(encode).collect()
}

impl File<'_> {
    /// Takes a batch, and encodes row groups when there are enough of them.
    fn add(&mut self, batch: RecordBatch) -> Result<(), FileError> {
        self.waiting.push(batch);
        if self.waiting.len() < BATCHES * GROUPS { Ok(()) } else { self.encode() }
    }

    fn encode(&mut self) -> Result<(), FileError> {
        let batches = std::mem::take(&mut self.waiting);
        let Some(first) = batches.first() else { return Ok(()) };
        self.begin(&first.schema())?;
        let Some(Begun { writer, factory, columns, groups }) = &mut self.begun else { return Ok(()) };
        let encoded: Vec<_> = batches
            .par_chunks(BATCHES)
            .enumerate()
            .map(|(k, batches)| encode((factory, columns), *groups + k, batches))
            .collect();
        for columns in encoded {
            let mut group = writer.next_row_group().map_err(unwritten)?;
            for column in columns.map_err(unwritten)? {
                let written = match column {
                    Encoded::Lists(column) => column.append_to_row_group(&mut group),
                    Encoded::Cells(column) => column.append_to_row_group(&mut group),
                };
                written.map_err(unwritten)?;
            }
            group.close().map_err(unwritten)?;
            *groups += 1;
        }
        batches.into_iter().for_each(|batch| self.rows.reuse(batch));
        Ok(())
    }

    fn begin(&mut self, schema: &SchemaRef) -> Result<(), FileError> {
        let Some(output) = self.output.take() else { return Ok(()) };
        let description =
            ArrowSchemaConverter::new().schema_root("schema").convert(schema).map_err(unwritten)?;
        let properties = Arc::new(properties(schema));
        let writer = SerializedFileWriter::new(output, description.root_schema_ptr(), properties)
            .map_err(unwritten)?;
        let factory = ArrowRowGroupWriterFactory::new(&writer, Arc::clone(schema));
        let columns = description.columns().to_vec();
        self.begun = Some(Begun { writer, factory, columns, groups: 0 });
        Ok(())
    }
}

impl Writer for File<'_> {
    fn push(&mut self, record: &Record) -> Result<(), FileError> {
        match self.rows.push(record)? {
            Some(batch) => self.add(batch),
            None => Ok(()),
        }
    }

    fn finish(mut self: Box<Self>) -> Result<Summary, FileError> {
        if !self.rows.is_empty() || (self.output.is_some() && self.waiting.is_empty()) {
            let batch = self.rows.take()?;
            self.begin(&batch.schema())?;
            if batch.num_rows() > 0 {
                self.waiting.push(batch);
            }
        }
        self.encode()?;
        if let Some(begun) = self.begun.take() {
            let mut output = begun.writer.into_inner().map_err(unwritten)?;
            output.flush()?;
        }
        Ok(self.rows.summary)
    }
}
