//! Answers of JSON as tables with named columns: CSV, Arrow, Parquet, NPY and NPZ.
//!
//! A *table* of an answer is one of its lists, named by its path (`results`, `pca.scores`), or the answer itself as a single row
//! (`answer`). A list of objects has a column for each field, nested fields by their path (`novelty.t_squared`); any other list
//! has one column with its name. A path through a list of objects (`results.neighbours`) joins the inner lists, and says in a
//! column with the name of the outer one from which of its rows a row is.
//!
//! | values of a column | type |
//! |---|---|
//! | numbers; no values at all | double |
//! | Booleans | Boolean |
//! | texts | text |
//! | regular nested lists of numbers, which differ in their lengths at most | list of doubles, row-major |
//! | anything else | text: JSON |
//!
//! The rest of the answer is in the metadata: single values by their path, and for each column of lists of lists the lengths
//! of the inner ones (`item_shape.control_points`: `2`).

mod gather;

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

use arrow_array::{ArrayRef, BooleanArray, Float64Array, ListArray, RecordBatch, StringArray};
use arrow_buffer::{OffsetBuffer, ScalarBuffer};
use arrow_schema::{ArrowError, DataType, Field, Schema};
use serde_json::Value;
use shapelex_formats::shape::{ArrayZip, npy_header};

use self::gather::{Cell, Gathered, collect, facts_of, flatten, is_table, tables_of};
use super::batches::{ARROW, BatchError, BatchFormat, PARQUET, Pieces};
use super::table::quoted;

/// Name of the table that is the answer itself.
pub const ANSWER: &str = "answer";
/// Prefix of the metadata.
const PREFIX: &str = "shapelex.";

/// File format of the columns of an answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ColumnsFormat {
    /// Comma-separated values; lists of equal lengths have a column for each number.
    Csv,
    /// Arrow IPC stream.
    Arrow,
    /// Parquet file.
    Parquet,
    /// One array of NumPy.
    Npy,
    /// An array of NumPy for each column.
    Npz,
}

impl ColumnsFormat {
    /// All formats.
    pub const ALL: [Self; 5] = [Self::Csv, Self::Arrow, Self::Parquet, Self::Npy, Self::Npz];

    /// Name in requests.
    pub fn name(self) -> &'static str {
        match self {
            Self::Csv => "csv",
            Self::Arrow => "arrow",
            Self::Parquet => "parquet",
            Self::Npy => "npy",
            Self::Npz => "npz",
        }
    }

    /// Media type of the format.
    pub fn media_type(self) -> &'static str {
        match self {
            Self::Csv => "text/csv",
            Self::Arrow => ARROW,
            Self::Parquet => PARQUET,
            Self::Npy => "application/x-npy",
            Self::Npz => "application/x-npz",
        }
    }
}

/// Number of cells that every table may have.
const FEW_CELLS: usize = 1 << 20;
/// Number of further cells for each value.
const CELLS_PER_VALUE: usize = 8;

/// Why an answer has no such file.
#[derive(Debug, thiserror::Error)]
pub enum ColumnsError {
    /// A table that the answer does not have.
    #[error("expected one of the tables {}, got '{name}'", .known.join(", "))]
    Table {
        /// The name asked for.
        name: String,
        /// Names of those that there are.
        known: Vec<String>,
    },
    /// A column that the table does not have, or that is not an array.
    #[error(
        "expected the name of a column of numbers, or of lists of equal lengths, such as {known}, got '{name}'"
    )]
    Column {
        /// The name asked for.
        name: String,
        /// Names of those that are arrays.
        known: String,
    },
    /// A table that is nearly empty, as of objects with names that no others have: its cells would take many times the memory of the
    /// answer.
    #[error(
        "expected rows with the same fields, got {columns} columns of {rows} rows with {values} values together: JSON has them \
         without the missing ones"
    )]
    Sparse {
        /// Columns that there would be.
        columns: usize,
        /// Rows.
        rows: usize,
        /// Values.
        values: usize,
    },
    /// A file that could not be written: a bug.
    #[error("{0}")]
    Unwritten(String),
}

impl From<BatchError> for ColumnsError {
    fn from(error: BatchError) -> Self {
        Self::Unwritten(error.to_string())
    }
}

impl From<ArrowError> for ColumnsError {
    fn from(error: ArrowError) -> Self {
        Self::Unwritten(error.to_string())
    }
}

/// Values of a column, one per row.
#[derive(Debug, Clone, PartialEq)]
enum Column {
    /// Numbers; NaN if missing.
    Numbers(Vec<f64>),
    Flags(Vec<Option<bool>>),
    Texts(Vec<Option<String>>),
    /// Lists one after the other, by their ends; `None` is a row without a list. `item` is the shape of an element.
    Lists {
        values: Vec<f64>,
        ends: Vec<usize>,
        valid: Vec<bool>,
        item: Vec<usize>,
    },
}

/// A table of an answer.
#[derive(Debug, Clone, PartialEq)]
pub struct Columns {
    facts: BTreeMap<String, String>,
    columns: Vec<(String, Column)>,
    rows: usize,
}

impl Columns {
    /// A table of an answer.
    ///
    /// # Errors
    /// [`ColumnsError::Table`].
    pub fn of(answer: &Value, table: &str) -> Result<Self, ColumnsError> {
        let path: Vec<&str> = if table == ANSWER { Vec::new() } else { table.split('.').collect() };
        let mut rows = Vec::new();
        if !collect(answer, &path, &mut Vec::new(), &mut rows) {
            let known = tables_of(answer);
            return Err(ColumnsError::Table { name: table.into(), known });
        }
        let name = path.last().copied().unwrap_or(ANSWER);
        // Lists of objects are separate tables.
        let whole = path.is_empty();
        let mut gathered = Gathered::default();
        for (k, row) in rows.iter().enumerate() {
            for (outer, position) in &row.positions {
                gathered.put(k, outer, Cell::Position(*position));
            }
            flatten(row.value, name, 0, &mut |name, value| {
                if !(whole && is_table(value)) {
                    gathered.put(k, name, Cell::Value(value));
                }
            });
        }
        let mut facts = BTreeMap::from([("tables".to_owned(), tables_of(answer).join(","))]);
        if !whole {
            facts_of(answer, "", 0, &mut facts);
        }
        let count = rows.len();
        let (columns, values) = gathered.size();
        if columns.saturating_mul(count) > FEW_CELLS + CELLS_PER_VALUE * values {
            return Err(ColumnsError::Sparse { columns, rows: count, values });
        }
        let columns = gathered.columns(count);
        for (name, column) in &columns {
            if let Column::Lists { item, .. } = column
                && !item.is_empty()
            {
                let shape = item.iter().map(ToString::to_string).collect::<Vec<_>>().join(",");
                facts.insert(format!("item_shape.{name}"), shape);
            }
        }
        Ok(Self { facts, columns, rows: count })
    }

    /// The file of the table. `column` names the array of an NPY file; by default it is the first column of lists of equal
    /// lengths, else all columns of numbers side by side.
    ///
    /// # Errors
    /// [`ColumnsError::Column`].
    pub fn write(self, format: ColumnsFormat, column: Option<&str>) -> Result<Vec<u8>, ColumnsError> {
        match format {
            ColumnsFormat::Csv => Ok(self.csv().into_bytes()),
            ColumnsFormat::Arrow => self.batch_file(BatchFormat::Arrow),
            ColumnsFormat::Parquet => self.batch_file(BatchFormat::Parquet),
            ColumnsFormat::Npy => self.npy(column),
            ColumnsFormat::Npz => self.npz(),
        }
    }

    fn csv(&self) -> String {
        let width = |column: &Column| match column {
            Column::Lists { .. } => column.equal_width(),
            _ => None,
        };
        let mut text = String::new();
        let mut heads: Vec<String> = Vec::new();
        for (name, column) in &self.columns {
            match width(column) {
                Some(width) => heads.extend((1..=width).map(|k| quoted(&format!("{name}.{k}")))),
                None => heads.push(quoted(name)),
            }
        }
        text.push_str(&heads.join(","));
        text.push_str("\r\n");
        for row in 0..self.rows {
            let mut fields: Vec<String> = Vec::with_capacity(heads.len());
            for (_, column) in &self.columns {
                column.csv(row, width(column), &mut fields);
            }
            text.push_str(&fields.join(","));
            text.push_str("\r\n");
        }
        text
    }

    fn batch_file(self, format: BatchFormat) -> Result<Vec<u8>, ColumnsError> {
        let facts = self.facts.into_iter().map(|(name, value)| (format!("{PREFIX}{name}"), value));
        let metadata: HashMap<String, String> = facts.collect();
        let mut fields = Vec::new();
        let mut arrays = Vec::new();
        for (name, column) in self.columns {
            let array = column.array()?;
            fields.push(Field::new(name, array.data_type().clone(), true));
            arrays.push(array);
        }
        let schema = Arc::new(Schema::new_with_metadata(fields, metadata));
        let rows = arrow_array::RecordBatchOptions::new().with_row_count(Some(self.rows));
        let batch = RecordBatch::try_new_with_options(Arc::clone(&schema), arrays, &rows)?;
        let batches = std::iter::once(batch).filter(|batch| batch.num_rows() > 0);
        let pieces = Pieces::new(format, &schema, batches)?.collect::<Result<Vec<_>, _>>()?;
        Ok(pieces.concat())
    }

    fn npy(&self, name: Option<&str>) -> Result<Vec<u8>, ColumnsError> {
        let arrays = || self.columns.iter().filter(|(_, column)| column.shape(self.rows).is_some());
        let chosen = match name {
            Some(name) => arrays().find(|(other, _)| other == name),
            None => arrays().find(|(_, column)| matches!(column, Column::Lists { .. })),
        };
        if let (None, Some(name)) = (chosen, name) {
            let known = arrays().map(|(name, _)| name.as_str()).collect::<Vec<_>>().join(", ");
            return Err(ColumnsError::Column { name: name.into(), known });
        }
        let (shape, values) = match chosen {
            Some((_, column)) => (column.shape(self.rows).unwrap_or_default(), column.numbers(self.rows)),
            None => {
                let columns: Vec<Vec<f64>> = arrays().map(|(_, column)| column.numbers(self.rows)).collect();
                let row = |row: usize| columns.iter().map(move |column| column[row]);
                (vec![self.rows, columns.len()], (0..self.rows).flat_map(row).collect())
            }
        };
        let mut bytes = npy_header("<f8", &shape);
        bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
        Ok(bytes)
    }

    fn npz(&self) -> Result<Vec<u8>, ColumnsError> {
        let unwritten =
            |error: shapelex_formats::shape::FileError| ColumnsError::Unwritten(error.to_string());
        let mut zip = ArrayZip::new(Vec::new());
        for (name, column) in &self.columns {
            match column {
                Column::Flags(flags) => zip.flags(name, flags),
                Column::Texts(texts) => zip.texts(name, texts),
                Column::Numbers(values) => zip.numbers(name, &[self.rows], values),
                Column::Lists { values, ends, item, .. } => match column.shape(self.rows) {
                    Some(shape) => zip.numbers(name, &shape, &column.numbers(self.rows)),
                    None => {
                        let size = item.iter().product::<usize>().max(1);
                        let shape = [&[values.len() / size][..], item.as_slice()].concat();
                        let ends: Vec<usize> = ends.iter().map(|end| end / size).collect();
                        zip.numbers(name, &shape, values)
                            .and_then(|()| zip.offsets(&format!("{name}.offsets"), &ends))
                    }
                },
            }
            .map_err(unwritten)?;
        }
        zip.finish().map_err(unwritten)
    }
}

impl Column {
    /// Length of the lists, if all rows have lists of equal lengths.
    fn equal_width(&self) -> Option<usize> {
        let Self::Lists { ends, valid, .. } = self else { return None };
        let starts = std::iter::once(&0).chain(ends);
        let mut widths =
            starts.zip(ends).zip(valid).filter(|(_, valid)| **valid).map(|((start, end), _)| end - start);
        let first = widths.next()?;
        widths.all(|width| width == first).then_some(first)
    }

    /// Shape of the array that the column is, if it is one.
    fn shape(&self, rows: usize) -> Option<Vec<usize>> {
        match self {
            Self::Numbers(_) => Some(vec![rows]),
            Self::Lists { item, .. } => {
                let width = self.equal_width()?;
                let size = item.iter().product::<usize>().max(1);
                Some([&[rows, width / size][..], item.as_slice()].concat())
            }
            _ => None,
        }
    }

    /// The items of that array; NaN for rows without a list.
    fn numbers(&self, rows: usize) -> Vec<f64> {
        match self {
            Self::Numbers(values) => values.clone(),
            Self::Lists { values, ends, valid, .. } => {
                let width = self.equal_width().unwrap_or(0);
                let mut found = Vec::with_capacity(rows * width);
                for (end, valid) in ends.iter().zip(valid) {
                    if *valid {
                        found.extend_from_slice(&values[end - width..*end]);
                    } else {
                        found.extend(std::iter::repeat_n(f64::NAN, width));
                    }
                }
                found
            }
            _ => Vec::new(),
        }
    }

    /// The fields of a row.
    fn csv(&self, row: usize, width: Option<usize>, fields: &mut Vec<String>) {
        let number =
            |value: f64| if value.is_finite() { Value::from(value).to_string() } else { String::new() };
        match self {
            Self::Numbers(values) => fields.push(number(values[row])),
            Self::Flags(flags) => fields.push(flags[row].map_or_else(String::new, |flag| flag.to_string())),
            Self::Texts(texts) => {
                fields.push(texts[row].as_ref().map_or_else(String::new, |text| quoted(text)))
            }
            Self::Lists { values, ends, valid, .. } => {
                let start = row.checked_sub(1).map_or(0, |before| ends[before]);
                let list = &values[start..ends[row]];
                match width {
                    Some(width) if valid[row] => {
                        fields.extend(list.iter().map(|value| number(*value)).take(width))
                    }
                    Some(width) => fields.extend(std::iter::repeat_n(String::new(), width)),
                    None if valid[row] => fields.push(quoted(&Value::from(list.to_vec()).to_string())),
                    None => fields.push(String::new()),
                }
            }
        }
    }

    fn array(self) -> Result<ArrayRef, ArrowError> {
        let doubles = |values: Vec<f64>| {
            let nulls = values.iter().any(|value| value.is_nan()).then(|| {
                values.iter().map(|value| !value.is_nan()).collect::<arrow_buffer::BooleanBuffer>().into()
            });
            Float64Array::new(values.into(), nulls)
        };
        Ok(match self {
            Self::Numbers(values) => Arc::new(doubles(values)),
            Self::Flags(flags) => Arc::new(BooleanArray::from(flags)),
            Self::Texts(texts) => Arc::new(texts.into_iter().collect::<StringArray>()),
            Self::Lists { values, ends, valid, .. } => {
                let ends = std::iter::once(&0).chain(&ends).map(|end| i32::try_from(*end));
                let ends = ends.collect::<Result<Vec<_>, _>>();
                let ends = ends.map_err(|error| ArrowError::CastError(error.to_string()))?;
                let item = Arc::new(Field::new("item", DataType::Float64, true));
                let nulls = valid.contains(&false).then(|| valid.into());
                let offsets = OffsetBuffer::new(ScalarBuffer::from(ends));
                Arc::new(ListArray::try_new(item, offsets, Arc::new(doubles(values)), nulls)?)
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use arrow_array::Array;
    use arrow_array::cast::AsArray;
    use arrow_array::types::Float64Type;
    use arrow_ipc::reader::StreamReader;
    use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
    use serde_json::json;

    fn answer() -> Value {
        json!({
            "dictionary": {"name": "d", "version": 2},
            "warnings": ["few"],
            "results": [
                {"index": 0, "id": "a,\"b\"", "scores": [0.1, 2.0], "points": [[1, 2], [3, 4]], "ok": true,
                 "near": [{"d": 1.5}, {"d": 2.5}], "novelty": {"t": null}},
                {"index": 1, "error": {"detail": "x"}, "near": [{"d": 3.5}]},
                {"index": 2, "id": "c", "scores": [null, 4.0], "points": [[5, 6]], "ok": null, "near": []}
            ],
            "pca": {"scores": [[1, 2], [3, 4]], "eigenvalues": [5, 6]}
        })
    }

    #[test]
    fn lists_of_objects_have_a_column_a_field() {
        let table = Columns::of(&answer(), "results").unwrap();
        let names: Vec<_> = table.columns.iter().map(|(name, _)| name.as_str()).collect();
        let expected = ["index", "id", "scores", "points", "ok", "near", "novelty.t", "error.detail"];
        assert_eq!(names.iter().collect::<std::collections::BTreeSet<_>>(), expected.iter().collect());
        assert_eq!(table.facts["dictionary.version"], "2");
        assert_eq!(
            (table.facts["warnings"].as_str(), table.facts["item_shape.points"].as_str()),
            ("[\"few\"]", "2")
        );
        for format in [ColumnsFormat::Arrow, ColumnsFormat::Parquet] {
            let bytes = table.clone().write(format, None).unwrap();
            let (schema, batch) = if format == ColumnsFormat::Arrow {
                let mut reader = StreamReader::try_new(bytes.as_slice(), None).unwrap();
                (reader.schema(), reader.next().unwrap().unwrap())
            } else {
                let reader = ParquetRecordBatchReaderBuilder::try_new(bytes::Bytes::from(bytes)).unwrap();
                (reader.schema().clone(), reader.build().unwrap().next().unwrap().unwrap())
            };
            assert_eq!(schema.metadata()["shapelex.dictionary.name"], "d");
            let points = batch.column_by_name("points").unwrap().as_list::<i32>();
            assert_eq!(points.value(0).as_primitive::<Float64Type>().values(), &[1.0, 2.0, 3.0, 4.0]);
            let scores = batch.column_by_name("scores").unwrap().as_list::<i32>();
            assert!(points.is_null(1) && scores.value(2).is_null(0));
            assert_eq!(batch.column_by_name("near").unwrap().as_string::<i32>().value(1), "[{\"d\":3.5}]");
            assert!(batch.column_by_name("ok").unwrap().as_boolean().is_null(2));
        }
    }

    #[test]
    fn a_table_that_is_nearly_empty_is_refused() {
        let rows = |count: usize, own: bool| {
            let row =
                |k: usize| json!({"id": k, "labels": {(if own { format!("n{k}") } else { "n".into() }): k}});
            json!({"results": (0..count).map(row).collect::<Vec<_>>()})
        };
        assert!(Columns::of(&rows(3000, false), "results").is_ok());
        assert!(Columns::of(&rows(1000, true), "results").is_ok());
        let error = Columns::of(&rows(3000, true), "results").unwrap_err().to_string();
        assert!(error.contains("got 3001 columns of 3000 rows with 6000 values"), "{error}");
    }

    #[test]
    fn csv_has_a_column_for_each_number_of_equal_lists() {
        let table =
            json!({"results": [{"a": 1, "s": [0.1, 2]}, {"a": null, "s": null}, {"a": 2.5, "s": [3, 4]}]});
        let text = Columns::of(&table, "results").unwrap().write(ColumnsFormat::Csv, None).unwrap();
        assert_eq!(String::from_utf8(text).unwrap(), "a,s.1,s.2\r\n1.0,0.1,2.0\r\n,,\r\n2.5,3.0,4.0\r\n");
        let ragged = json!({"r": [{"s": [1]}, {"s": [1, 2]}]});
        let text = Columns::of(&ragged, "r").unwrap().write(ColumnsFormat::Csv, None).unwrap();
        assert_eq!(String::from_utf8(text).unwrap(), "s\r\n[1.0]\r\n\"[1.0,2.0]\"\r\n");
    }

    #[test]
    fn paths_lead_to_inner_tables() {
        let answer = answer();
        let near = Columns::of(&answer, "results.near").unwrap();
        assert_eq!(
            near.columns,
            [
                ("results".to_owned(), Column::Numbers(vec![0.0, 0.0, 1.0])),
                ("d".to_owned(), Column::Numbers(vec![1.5, 2.5, 3.5]))
            ]
        );
        let scores = Columns::of(&answer, "pca.scores").unwrap();
        let bytes = scores.write(ColumnsFormat::Npy, None).unwrap();
        assert!(String::from_utf8_lossy(&bytes).contains("'shape': (2, 2)"));
        assert_eq!(bytes[bytes.len() - 8..], 4.0_f64.to_le_bytes());
        let whole = Columns::of(&answer, ANSWER).unwrap();
        assert_eq!((whole.rows, whole.columns.iter().any(|(name, _)| name == "results")), (1, false));
        let error = Columns::of(&answer, "result").unwrap_err();
        let known = "answer, pca.eigenvalues, pca.scores, results, results.near, warnings";
        assert_eq!(error.to_string(), format!("expected one of the tables {known}, got 'result'"));
    }

    #[test]
    fn arrays_of_numpy() {
        let table = Columns::of(&answer(), "results").unwrap();
        let bytes = table.clone().write(ColumnsFormat::Npy, Some("scores")).unwrap();
        assert!(String::from_utf8_lossy(&bytes).contains("'shape': (3, 2)"));
        let error = table.clone().write(ColumnsFormat::Npy, Some("points")).unwrap_err();
        assert!(error.to_string().ends_with("got 'points'"), "{error}");
        let bytes = table.write(ColumnsFormat::Npz, None).unwrap();
        let text = String::from_utf8_lossy(&bytes);
        for name in ["points.npy", "points.offsets.npy", "ok.npy", "error.detail.npy"] {
            assert!(text.contains(name), "{name}");
        }
    }

    #[test]
    fn empty_answers_are_empty_tables() {
        for format in ColumnsFormat::ALL {
            let table = Columns::of(&json!({"results": []}), "results").unwrap();
            assert!(table.write(format, None).is_ok(), "{format:?}");
        }
    }
}
