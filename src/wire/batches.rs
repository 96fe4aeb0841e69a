//! Batches of rows as an Arrow stream or a Parquet file, written in pieces.

use arrow_array::RecordBatch;
use arrow_ipc::writer::StreamWriter;
use arrow_schema::{ArrowError, SchemaRef};
use parquet::arrow::ArrowWriter;
use parquet::basic::Compression;
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;

/// Media type of Arrow streams.
pub const ARROW: &str = "application/vnd.apache.arrow.stream";
/// Media type of Parquet files.
pub const PARQUET: &str = "application/vnd.apache.parquet";

/// Columnar file format.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BatchFormat {
    /// Arrow IPC stream.
    Arrow,
    /// Parquet, compressed by Snappy.
    Parquet,
}

/// Why a batch cannot be written: a bug, since nothing of the content is refused.
#[derive(Debug, thiserror::Error)]
pub enum BatchError {
    /// Of Arrow.
    #[error(transparent)]
    Arrow(#[from] ArrowError),
    /// Of Parquet.
    #[error(transparent)]
    Parquet(#[from] ParquetError),
}

/// Pieces of a file, written one after the other while it is sent.
pub type Written = Box<dyn Iterator<Item = Result<Vec<u8>, BatchError>> + Send>;

enum Writer {
    Arrow(Box<StreamWriter<Vec<u8>>>),
    Parquet(Box<ArrowWriter<Vec<u8>>>),
}

impl Writer {
    fn new(format: BatchFormat, schema: &SchemaRef) -> Result<Self, BatchError> {
        Ok(match format {
            BatchFormat::Arrow => Self::Arrow(Box::new(StreamWriter::try_new(Vec::new(), schema)?)),
            BatchFormat::Parquet => {
                let facts = schema.metadata().iter();
                let mut facts: Vec<_> =
                    facts.map(|(name, value)| KeyValue::new(name.clone(), value.clone())).collect();
                facts.sort_by(|a, b| a.key.cmp(&b.key));
                let properties = WriterProperties::builder()
                    .set_compression(Compression::SNAPPY)
                    .set_created_by("shapelex".into())
                    .set_key_value_metadata(Some(facts))
                    .build();
                Self::Parquet(Box::new(ArrowWriter::try_new(Vec::new(), schema.clone(), Some(properties))?))
            }
        })
    }

    /// Writes a batch. Returns the bytes that are complete.
    fn write(&mut self, batch: &RecordBatch) -> Result<Vec<u8>, BatchError> {
        Ok(match self {
            Self::Arrow(writer) => {
                writer.write(batch)?;
                std::mem::take(writer.get_mut())
            }
            Self::Parquet(writer) => {
                writer.write(batch)?;
                writer.flush()?;
                std::mem::take(writer.inner_mut())
            }
        })
    }

    fn finish(self) -> Result<Vec<u8>, BatchError> {
        Ok(match self {
            Self::Arrow(writer) => writer.into_inner()?,
            Self::Parquet(writer) => writer.into_inner()?,
        })
    }
}

/// Pieces of a file of batches, one for each and one for the end.
pub struct Pieces<B> {
    writer: Option<Writer>,
    batches: B,
}

impl<B: Iterator<Item = RecordBatch>> Pieces<B> {
    /// A file of batches with this schema.
    ///
    /// # Errors
    /// None that a schema of plain columns can cause.
    pub fn new(format: BatchFormat, schema: &SchemaRef, batches: B) -> Result<Self, BatchError> {
        Ok(Self { writer: Some(Writer::new(format, schema)?), batches })
    }
}

impl<B: Iterator<Item = RecordBatch>> Iterator for Pieces<B> {
    type Item = Result<Vec<u8>, BatchError>;

    fn next(&mut self) -> Option<Self::Item> {
        match self.batches.next() {
            Some(batch) => {
                let written = self.writer.as_mut()?.write(&batch);
                if written.is_err() {
                    self.writer = None;
                }
                Some(written)
            }
            None => self.writer.take().map(Writer::finish),
        }
    }
}
