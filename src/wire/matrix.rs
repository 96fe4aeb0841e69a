//! Square matrices as JSON, CSV, NPY, Arrow and Parquet, written row by row, so that the text of a whole matrix is never in memory.
//!
//! * JSON — `{"ids": […], "labels": […], "distances": [[…], …]}`, preceded by further fields;
//! * CSV (RFC 4180) — a line of ids, then one line of numbers per row;
//! * NPY (version 1.0) — little-endian `f64` in C order, readable by `numpy.load`;
//! * Arrow and Parquet — a row per row: `id`, `label`, and `distances` as a list, the further fields in the metadata.
//!
//! Numbers in text formats have as many digits as needed to read back the same bits.

use std::collections::HashMap;
use std::sync::Arc;

use arrow_array::{ArrayRef, FixedSizeListArray, Float64Array, RecordBatch, StringArray};
use arrow_schema::{ArrowError, DataType, Field, Schema, SchemaRef};
use serde_json::{Map, Value};
use shapelex_formats::shape::npy_header;

use super::batches::{ARROW, BatchError, BatchFormat, PARQUET, Pieces, Written};
use super::table::quoted;

/// File format of a matrix.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MatrixFormat {
    /// JSON object.
    Json,
    /// Comma-separated values.
    Csv,
    /// NumPy binary format.
    Npy,
    /// Arrow IPC stream.
    Arrow,
    /// Parquet file.
    Parquet,
}

/// A square matrix with row names.
#[derive(Debug, Clone, PartialEq)]
pub struct NamedMatrix {
    /// Additional fields of the JSON object.
    pub fields: Map<String, Value>,
    /// Name of each row and column.
    pub ids: Vec<String>,
    /// Label of each row and column, if it has one.
    pub labels: Vec<Option<String>>,
    /// Values, row by row.
    pub values: Vec<f64>,
}

impl MatrixFormat {
    /// All formats.
    pub const ALL: [Self; 5] = [Self::Json, Self::Csv, Self::Npy, Self::Arrow, Self::Parquet];

    /// Name in requests.
    pub fn name(self) -> &'static str {
        match self {
            Self::Json => "json",
            Self::Csv => "csv",
            Self::Npy => "npy",
            Self::Arrow => "arrow",
            Self::Parquet => "parquet",
        }
    }

    /// Media type of the format.
    pub fn media_type(self) -> &'static str {
        match self {
            Self::Json => "application/json",
            Self::Csv => "text/csv",
            Self::Npy => "application/x-npy",
            Self::Arrow => ARROW,
            Self::Parquet => PARQUET,
        }
    }
}

/// Number of values of a batch of rows.
const BATCH: usize = 1 << 20;

impl NamedMatrix {
    /// Writes the file in pieces of about one row each, or a batch of rows.
    ///
    /// # Errors
    /// None that values can cause: an error of a piece is a bug, after which the file ends.
    pub fn pieces(self, format: MatrixFormat) -> Result<Written, BatchError> {
        let text = match format {
            MatrixFormat::Json => Text::Json,
            MatrixFormat::Csv => Text::Csv,
            MatrixFormat::Npy => Text::Npy,
            MatrixFormat::Arrow => return Ok(Box::new(self.batches(BatchFormat::Arrow)?)),
            MatrixFormat::Parquet => return Ok(Box::new(self.batches(BatchFormat::Parquet)?)),
        };
        let size = self.ids.len();
        let pieces = (0..size + 2).map(move |piece| match piece {
            0 => self.head(text),
            last if last == size + 1 => tail(text),
            row => write_row(text, row == 1, &self.values[(row - 1) * size..row * size]),
        });
        Ok(Box::new(pieces.map(Ok)))
    }

    fn head(&self, format: Text) -> Vec<u8> {
        match format {
            Text::Json => {
                let mut head = self.fields.clone();
                head.insert("ids".into(), Value::from(self.ids.clone()));
                head.insert("labels".into(), Value::from(self.labels.clone()));
                let mut text = Value::from(head).to_string();
                text.pop();
                text.push_str(",\"distances\":[");
                text.into_bytes()
            }
            Text::Csv => {
                let ids: Vec<String> = self.ids.iter().map(|id| quoted(id)).collect();
                (ids.join(",") + "\r\n").into_bytes()
            }
            Text::Npy => npy_header("<f8", &[self.ids.len(), self.ids.len()]),
        }
    }

    /// Pieces of a columnar file.
    fn batches(
        self,
        format: BatchFormat,
    ) -> Result<impl Iterator<Item = Result<Vec<u8>, BatchError>> + Send, BatchError> {
        let size = self.ids.len();
        let schema = self.schema()?;
        let rows = (BATCH / size.max(1)).max(1);
        let of_matrix = Arc::clone(&schema);
        let batches = (0..size).step_by(rows).map_while(move |start| {
            // Columns of equal lengths with the types of the schema.
            self.batch(&of_matrix, start..size.min(start + rows)).ok()
        });
        Pieces::new(format, &schema, batches)
    }

    fn schema(&self) -> Result<SchemaRef, ArrowError> {
        let size = i32::try_from(self.ids.len()).map_err(|error| ArrowError::CastError(error.to_string()))?;
        let text = |value: &Value| value.as_str().map_or_else(|| value.to_string(), str::to_owned);
        let metadata: HashMap<String, String> =
            self.fields.iter().map(|(name, value)| (name.clone(), text(value))).collect();
        let item = Arc::new(Field::new("item", DataType::Float64, false));
        let fields = vec![
            Field::new("id", DataType::Utf8, false),
            Field::new("label", DataType::Utf8, true),
            Field::new("distances", DataType::FixedSizeList(item, size), false),
        ];
        Ok(Arc::new(Schema::new_with_metadata(fields, metadata)))
    }

    fn batch(&self, schema: &SchemaRef, rows: std::ops::Range<usize>) -> Result<RecordBatch, ArrowError> {
        let size = self.ids.len();
        let values = Float64Array::from(self.values[rows.start * size..rows.end * size].to_vec());
        let DataType::FixedSizeList(item, width) = schema.field(2).data_type() else {
            return Err(ArrowError::SchemaError("expected lists".into()));
        };
        let columns: [ArrayRef; 3] = [
            Arc::new(StringArray::from_iter_values(&self.ids[rows.clone()])),
            Arc::new(self.labels[rows].iter().map(Option::as_deref).collect::<StringArray>()),
            Arc::new(FixedSizeListArray::try_new(Arc::clone(item), *width, Arc::new(values), None)?),
        ];
        RecordBatch::try_new(Arc::clone(schema), columns.into())
    }
}

/// Formats that are written row by row.
#[derive(Clone, Copy)]
enum Text {
    Json,
    Csv,
    Npy,
}

fn tail(format: Text) -> Vec<u8> {
    match format {
        Text::Json => b"]}".to_vec(),
        Text::Csv | Text::Npy => Vec::new(),
    }
}

fn write_row(format: Text, first: bool, row: &[f64]) -> Vec<u8> {
    let list = || serde_json::to_vec(row).expect("numbers are JSON");
    match format {
        Text::Json if first => list(),
        Text::Json => [b",".as_slice(), &list()].concat(),
        Text::Csv => {
            // A CSV line is the JSON list without its brackets.
            let list = list();
            [&list[1..list.len() - 1], b"\r\n"].concat()
        }
        Text::Npy => row.iter().flat_map(|value| value.to_le_bytes()).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn written(format: MatrixFormat, ids: &[&str]) -> Vec<u8> {
        let count = ids.len();
        let matrix = NamedMatrix {
            fields: [("revision".to_owned(), Value::from(3))].into_iter().collect(),
            ids: ids.iter().map(ToString::to_string).collect(),
            labels: (0..count).map(|k| (k % 2 == 0).then(|| "x".into())).collect(),
            values: (0..count * count).map(|k| k as f64 / 10.0).collect(),
        };
        matrix.pieces(format).unwrap().flat_map(Result::unwrap).collect()
    }

    #[test]
    fn json_is_one_object() {
        let text = written(MatrixFormat::Json, &["a", "b"]);
        let wanted = serde_json::json!({"revision": 3, "ids": ["a", "b"], "labels": ["x", null],
            "distances": [[0.0, 0.1], [0.2, 0.3]]});
        assert_eq!(serde_json::from_slice::<Value>(&text).unwrap(), wanted);
        let none: Value = serde_json::from_slice(&written(MatrixFormat::Json, &[])).unwrap();
        assert_eq!(none["distances"], serde_json::json!([]));
    }

    #[test]
    fn csv_quotes_what_must_be() {
        let text = String::from_utf8(written(MatrixFormat::Csv, &["a,1", "b\"2\""])).unwrap();
        assert_eq!(text, "\"a,1\",\"b\"\"2\"\"\"\r\n0.0,0.1\r\n0.2,0.3\r\n");
    }

    #[test]
    fn npy_is_aligned_and_tells_its_shape() {
        let bytes = written(MatrixFormat::Npy, &["a", "b", "c"]);
        assert_eq!(&bytes[..8], b"\x93NUMPY\x01\x00");
        let head = 10 + usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
        assert_eq!(head % 64, 0);
        let text = std::str::from_utf8(&bytes[10..head]).unwrap();
        assert!(
            text.starts_with("{'descr': '<f8', 'fortran_order': False, 'shape': (3, 3), }")
                && text.ends_with('\n')
        );
        assert_eq!(bytes.len(), head + 72);
        assert_eq!(bytes[head + 8..head + 16], 0.1_f64.to_le_bytes());
    }
}
