//! Tables in JSON by columns, CSV, NDJSON, Arrow and Parquet, written in blocks of rows.
//!
//! * JSON — `{…, "rows": n, "columns": [{"name", "type", "values"}]}`, preceded by further fields;
//! * CSV (RFC 4180) — a line of names, then a line per row; missing values are empty;
//! * NDJSON — an object per row; missing values are null;
//! * Arrow — an IPC stream of record batches, texts that repeat as dictionaries, the further fields in the metadata of the schema;
//! * Parquet — the same columns and metadata as a file.
//!
//! Numbers in text formats have as many digits as needed to read back the same bits.

use std::collections::HashMap;
use std::sync::Arc;

use arrow_array::types::{ArrowDictionaryKeyType, Int8Type, Int16Type, Int32Type};
use arrow_array::{
    ArrayRef, BooleanArray, DictionaryArray, Float64Array, PrimitiveArray, RecordBatch, StringArray,
    TimestampMillisecondArray,
};
use arrow_schema::{ArrowError, Field, Schema};
use serde_json::{Map, Value};

use super::batches::{ARROW, BatchError, BatchFormat, PARQUET, Pieces, Written};
use super::time::rfc3339;

/// File format of a table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TableFormat {
    /// JSON object with a list per column.
    Json,
    /// Comma-separated values.
    Csv,
    /// One JSON object per line.
    Ndjson,
    /// Arrow IPC stream.
    Arrow,
    /// Parquet file.
    Parquet,
}

impl TableFormat {
    /// All formats.
    pub const ALL: [Self; 5] = [Self::Json, Self::Csv, Self::Ndjson, Self::Arrow, Self::Parquet];

    /// Name in requests.
    pub fn name(self) -> &'static str {
        match self {
            Self::Json => "json",
            Self::Csv => "csv",
            Self::Ndjson => "ndjson",
            Self::Arrow => "arrow",
            Self::Parquet => "parquet",
        }
    }

    /// Media type of the format.
    pub fn media_type(self) -> &'static str {
        match self {
            Self::Json => "application/json",
            Self::Csv => "text/csv",
            Self::Ndjson => "application/x-ndjson",
            Self::Arrow => ARROW,
            Self::Parquet => PARQUET,
        }
    }
}

/// Number of a missing text.
pub const NO_TEXT: u32 = u32::MAX;

/// Values of a column, one per row.
#[derive(Debug, Clone, PartialEq)]
pub enum Values {
    /// Texts, each row by the number of its text, or [`NO_TEXT`].
    Text {
        /// Number of the text of each row.
        rows: Vec<u32>,
        /// Texts that may occur.
        texts: Vec<Arc<str>>,
    },
    /// Numbers; NaN if missing.
    Number(Vec<f64>),
    /// Booleans.
    Flag(Vec<Option<bool>>),
    /// Times, in milliseconds since 1970 UTC.
    Time(Vec<i64>),
}

impl Values {
    fn type_name(&self) -> &'static str {
        match self {
            Self::Text { .. } => "text",
            Self::Number(_) => "number",
            Self::Flag(_) => "boolean",
            Self::Time(_) => "time",
        }
    }

    /// Memory in bytes.
    fn bytes(&self) -> usize {
        match self {
            Self::Text { rows, texts } => {
                size_of_val(rows.as_slice()) + texts.iter().map(|text| text.len() + 32).sum::<usize>()
            }
            Self::Number(values) => size_of_val(values.as_slice()),
            Self::Flag(values) => size_of_val(values.as_slice()),
            Self::Time(values) => size_of_val(values.as_slice()),
        }
    }

    /// The value of a row as text, if there is one.
    pub fn text(&self, row: usize) -> Option<String> {
        match self.json(row) {
            Value::Null => None,
            Value::String(text) => Some(text),
            value => Some(value.to_string()),
        }
    }

    /// The value of a row as JSON.
    fn json(&self, row: usize) -> Value {
        match self {
            Self::Text { rows, texts } => {
                texts.get(rows[row] as usize).map_or(Value::Null, |text| Value::from(text.as_ref()))
            }
            Self::Number(values) => Value::from(values[row]),
            Self::Flag(values) => Value::from(values[row]),
            Self::Time(values) => Value::from(rfc3339(values[row])),
        }
    }

    /// The value of a row as a CSV field.
    fn write_csv(&self, row: usize, line: &mut String) {
        match self {
            Self::Text { rows, texts } => {
                line.push_str(&texts.get(rows[row] as usize).map_or_else(String::new, |text| quoted(text)));
            }
            other => match other.json(row) {
                Value::Null => {}
                Value::String(text) => line.push_str(&text),
                value => line.push_str(&value.to_string()),
            },
        }
    }
}

/// A table with named columns of equal lengths.
#[derive(Debug, Clone)]
pub struct Table {
    /// Sources of the table.
    pub fields: Map<String, Value>,
    /// Names and values of the columns.
    pub columns: Vec<(String, Values)>,
    /// Number of rows.
    pub rows: usize,
}

/// Number of rows written at once.
const BLOCK: usize = 4096;
/// Number of rows of a batch.
const BATCH: usize = 16 * BLOCK;

impl Table {
    /// Memory in bytes.
    pub fn bytes(&self) -> usize {
        self.columns.iter().map(|(_, values)| values.bytes()).sum()
    }

    /// Writes the file in pieces of some thousand rows each.
    ///
    /// # Errors
    /// None that values can cause: an error of a piece is a bug, after which the file ends.
    pub fn pieces(self, format: TableFormat) -> Result<Written, BatchError> {
        Ok(match format {
            TableFormat::Json => Box::new(self.json().map(Ok)),
            TableFormat::Csv | TableFormat::Ndjson => Box::new(self.lines(format).map(Ok)),
            TableFormat::Arrow => Box::new(self.batches(BatchFormat::Arrow)?),
            TableFormat::Parquet => Box::new(self.batches(BatchFormat::Parquet)?),
        })
    }

    /// Pieces of a columnar file.
    fn batches(
        self,
        format: BatchFormat,
    ) -> Result<impl Iterator<Item = Result<Vec<u8>, BatchError>> + Send, BatchError> {
        let batch = record_batch(self)?;
        let (schema, rows) = (batch.schema(), batch.num_rows());
        let starts = (0..rows).step_by(BATCH);
        Pieces::new(format, &schema, starts.map(move |start| batch.slice(start, BATCH.min(rows - start))))
    }

    /// Ranges of rows that are written at once.
    fn blocks(&self) -> impl Iterator<Item = std::ops::Range<usize>> + use<> {
        let rows = self.rows;
        (0..rows).step_by(BLOCK).map(move |start| start..rows.min(start + BLOCK))
    }

    /// JSON by columns: the head, then each column in blocks, then the tail.
    fn json(self) -> impl Iterator<Item = Vec<u8>> + Send {
        let mut fields = self.fields.clone();
        fields.insert("rows".into(), self.rows.into());
        let mut head = Value::from(fields).to_string();
        head.pop();
        head.push_str(",\"columns\":[");
        let blocks: Vec<_> = self.blocks().collect();
        let columns = self.columns.into_iter().enumerate().flat_map(move |(index, (name, values))| {
            let comma = if index == 0 { "" } else { "," };
            let (name, kind) = (Value::from(name), values.type_name());
            let open = format!("{comma}{{\"name\":{name},\"type\":\"{kind}\",\"values\":[");
            let written = blocks.clone().into_iter().map(move |block| {
                let first = block.start == 0;
                let list: Vec<Value> = block.map(|row| values.json(row)).collect();
                let list = Value::from(list).to_string();
                let comma = if first { "" } else { "," };
                format!("{comma}{}", &list[1..list.len() - 1]).into_bytes()
            });
            std::iter::once(open.into_bytes()).chain(written).chain([b"]}".to_vec()])
        });
        std::iter::once(head.into_bytes()).chain(columns).chain([b"]}".to_vec()])
    }

    /// CSV or NDJSON in blocks of lines.
    fn lines(self, format: TableFormat) -> impl Iterator<Item = Vec<u8>> + Send {
        let names: Vec<String> = self.columns.iter().map(|(name, _)| name.clone()).collect();
        let head = (format == TableFormat::Csv).then(|| {
            let names: Vec<String> = names.iter().map(|name| quoted(name)).collect();
            (names.join(",") + "\r\n").into_bytes()
        });
        let keys: Vec<String> = names.into_iter().map(|name| Value::from(name).to_string()).collect();
        let blocks = self.blocks();
        head.into_iter().chain(blocks.map(move |block| {
            let mut text = String::new();
            for row in block {
                match format {
                    TableFormat::Csv => self.write_csv_row(row, &mut text),
                    _ => self.write_json_row(&keys, row, &mut text),
                }
            }
            text.into_bytes()
        }))
    }

    fn write_csv_row(&self, row: usize, text: &mut String) {
        for (index, (_, values)) in self.columns.iter().enumerate() {
            text.push_str(if index == 0 { "" } else { "," });
            values.write_csv(row, text);
        }
        text.push_str("\r\n");
    }

    fn write_json_row(&self, keys: &[String], row: usize, text: &mut String) {
        for (index, (key, (_, values))) in keys.iter().zip(&self.columns).enumerate() {
            text.push(if index == 0 { '{' } else { ',' });
            text.push_str(key);
            text.push(':');
            text.push_str(&values.json(row).to_string());
        }
        text.push_str("}\n");
    }
}

fn record_batch(table: Table) -> Result<RecordBatch, ArrowError> {
    let text = |value: &Value| value.as_str().map_or_else(|| value.to_string(), str::to_owned);
    let metadata: HashMap<String, String> =
        table.fields.iter().map(|(name, value)| (name.clone(), text(value))).collect();
    let mut fields = Vec::with_capacity(table.columns.len());
    let mut arrays = Vec::with_capacity(table.columns.len());
    for (name, values) in table.columns {
        let array = array_of(values)?;
        fields.push(Field::new(name, array.data_type().clone(), true));
        arrays.push(array);
    }
    RecordBatch::try_new(Arc::new(Schema::new_with_metadata(fields, metadata)), arrays)
}

fn array_of(values: Values) -> Result<ArrayRef, ArrowError> {
    Ok(match values {
        Values::Number(values) => Arc::new(
            values
                .into_iter()
                .map(|value| Some(value).filter(|value| !value.is_nan()))
                .collect::<Float64Array>(),
        ),
        Values::Flag(values) => Arc::new(BooleanArray::from(values)),
        Values::Time(values) => Arc::new(TimestampMillisecondArray::from(values).with_timezone("UTC")),
        Values::Text { rows, texts } => texts_of(&rows, &texts)?,
    })
}

/// Texts that repeat as a dictionary with the narrowest numbers, others one by one.
fn texts_of(rows: &[u32], texts: &[Arc<str>]) -> Result<ArrayRef, ArrowError> {
    if texts.len() * 2 > rows.len() {
        let text = |row: &u32| texts.get(*row as usize).map(AsRef::as_ref);
        return Ok(Arc::new(rows.iter().map(text).collect::<StringArray>()));
    }
    match texts.len() {
        0..=0x7f => dictionary::<Int8Type>(rows, texts, |row| i8::try_from(row).ok()),
        0x80..=0x7fff => dictionary::<Int16Type>(rows, texts, |row| i16::try_from(row).ok()),
        _ => dictionary::<Int32Type>(rows, texts, |row| i32::try_from(row).ok()),
    }
}

fn dictionary<K: ArrowDictionaryKeyType>(
    rows: &[u32],
    texts: &[Arc<str>],
    key: impl Fn(u32) -> Option<K::Native>,
) -> Result<ArrayRef, ArrowError> {
    let key = |row: &u32| if *row == NO_TEXT { None } else { key(*row) };
    let keys: PrimitiveArray<K> = rows.iter().map(key).collect();
    let texts: StringArray = texts.iter().map(|text| Some(text.as_ref())).collect();
    Ok(Arc::new(DictionaryArray::try_new(keys, Arc::new(texts))?))
}

/// Quotes a field as RFC 4180 requires.
pub(super) fn quoted(text: &str) -> String {
    if text.contains([',', '"', '\r', '\n']) {
        return format!("\"{}\"", text.replace('"', "\"\""));
    }
    text.to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use arrow_array::Array;
    use arrow_array::cast::AsArray;
    use arrow_ipc::reader::StreamReader;
    use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;

    fn table(rows: usize) -> Table {
        let names = (0..rows).map(|row| Arc::from(format!("s{row}, \"x\""))).collect();
        let groups = (0..rows).map(|row| if row % 5 == 4 { NO_TEXT } else { (row % 3) as u32 }).collect();
        let columns = vec![
            ("external_id".to_owned(), Values::Text { rows: (0..rows as u32).collect(), texts: names }),
            (
                "label".to_owned(),
                Values::Text { rows: groups, texts: ["a", "b", "c"].map(Arc::from).to_vec() },
            ),
            (
                "area".to_owned(),
                Values::Number(
                    (0..rows).map(|row| if row == 1 { f64::NAN } else { 0.1 * row as f64 }).collect(),
                ),
            ),
            (
                "flag".to_owned(),
                Values::Flag((0..rows).map(|row| Some(row % 2 == 0).filter(|_| row != 2)).collect()),
            ),
            ("at".to_owned(), Values::Time(vec![1_000; rows])),
        ];
        let fields = [("revision".to_owned(), Value::from(7))].into_iter().collect();
        Table { fields, columns, rows }
    }

    fn written(rows: usize, format: TableFormat) -> Vec<u8> {
        let pieces = table(rows).pieces(format).unwrap();
        pieces.flat_map(Result::unwrap).collect()
    }

    #[test]
    fn json_has_a_list_per_column() {
        for rows in [0, 3, BLOCK + 1] {
            let json: Value = serde_json::from_slice(&written(rows, TableFormat::Json)).unwrap();
            assert_eq!((&json["revision"], &json["rows"]), (&Value::from(7), &Value::from(rows)));
            let columns = json["columns"].as_array().unwrap();
            assert!(columns.iter().all(|column| column["values"].as_array().unwrap().len() == rows));
            assert_eq!(columns[2]["type"], "number");
            if rows > 4 {
                assert_eq!(
                    (&columns[2]["values"][1], &columns[1]["values"][4]),
                    (&Value::Null, &Value::Null)
                );
            }
        }
    }

    #[test]
    fn lines_hold_every_row() {
        let csv = String::from_utf8(written(3, TableFormat::Csv)).unwrap();
        let lines: Vec<&str> = csv.split_terminator("\r\n").collect();
        assert_eq!(lines[0], "external_id,label,area,flag,at");
        assert_eq!(lines[2], "\"s1, \"\"x\"\"\",b,,false,1970-01-01T00:00:01Z");
        let lines = String::from_utf8(written(BLOCK + 2, TableFormat::Ndjson)).unwrap();
        let rows: Vec<Value> = lines.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
        assert_eq!(rows.len(), BLOCK + 2);
        assert_eq!((&rows[2]["flag"], &rows[3]["area"]), (&Value::Null, &Value::from(0.1 * 3.0)));
    }

    #[test]
    fn parquet_files_are_read_by_the_library() {
        for rows in [0, 3, 17 * BLOCK] {
            let bytes = bytes::Bytes::from(written(rows, TableFormat::Parquet));
            let reader = ParquetRecordBatchReaderBuilder::try_new(bytes).unwrap();
            assert_eq!(reader.schema().metadata()["revision"], "7");
            let batches: Vec<RecordBatch> = reader.build().unwrap().map(Result::unwrap).collect();
            assert_eq!(batches.iter().map(RecordBatch::num_rows).sum::<usize>(), rows);
            if rows == 3 {
                let areas = batches[0].column(2).as_primitive::<arrow_array::types::Float64Type>();
                assert!(areas.is_null(1) && areas.value(2) == 0.1 * 2.0);
            }
        }
    }

    #[test]
    fn arrow_streams_are_read_by_the_library() {
        for rows in [0, 3, 40, 17 * BLOCK] {
            let bytes = written(rows, TableFormat::Arrow);
            let reader = StreamReader::try_new(bytes.as_slice(), None).unwrap();
            assert_eq!(reader.schema().metadata()["revision"], "7");
            let batches: Vec<RecordBatch> = reader.map(Result::unwrap).collect();
            assert_eq!(batches.iter().map(RecordBatch::num_rows).sum::<usize>(), rows);
            if rows == 40 {
                let batch = &batches[0];
                let labels = batch.column(1).as_dictionary::<Int8Type>();
                assert!(labels.is_null(4) && labels.values().len() == 3);
                assert_eq!(batch.column(0).as_string::<i32>().value(39), "s39, \"x\"");
                assert!(batch.column(2).is_null(1) && batch.column(3).is_null(2));
            }
        }
    }
}
