//! A part as Parquet: one row, its numbers in one binary value, facts about its shapes in lists beside.
//!
//! | column | type | content |
//! |---|---|---|
//! | `part`, `first`, `shapes` | integer | number of the part, position of its first shape, number of shapes |
//! | `control_points` | binary | little-endian doubles: shape after shape, all `x`, then all `y`, … |
//! | `weights` | list of doubles | weights in means |
//! | `ids`, `created_at` | list of strings | of every shape |
//! | `external_ids`, `subjects`, `labels`, `attributes`, `metadata` | list of strings | null where a shape has none; attributes and metadata as JSON |
//! | `points`, `centroid_size`, `length`, `area`, `volume`, `self_intersecting`, `clockwise`, `fit_mean`, `fit_largest`, `fit_area` | list | measures |
//!
//! Equal shapes give equal bytes, so that parts can be named by their digest: nothing is compressed, there are no statistics and no
//! times. The metadata of the file say `shapelex.format`, `shapelex.points` (`N`) and `shapelex.dimension` (`d`).

use std::sync::Arc;

use arrow_array::cast::AsArray;
use arrow_array::types::{Float64Type, Int32Type, Int64Type};
use arrow_array::{
    Array, ArrayRef, BinaryArray, BooleanArray, Float64Array, Int32Array, Int64Array, ListArray, RecordBatch,
    StringArray,
};
use arrow_buffer::OffsetBuffer;
use arrow_schema::{DataType, Field, Schema};
use bytes::Bytes;
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use parquet::arrow::{ArrowWriter, ProjectionMask};
use parquet::basic::Compression;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::{EnabledStatistics, WriterProperties};
use shapelex_analysis::accumulate::PART;

use super::manifest::FORMAT;
use crate::EngineError;
use crate::cohort::record::{Measures, Record};

/// Maximum length of all texts of a part in bytes: a list of strings holds less than 2 GiB.
const MAX_TEXT_BYTES: usize = 1 << 30;

/// Columns that a pass reads.
const NUMBERS: [&str; 5] = ["part", "first", "shapes", "control_points", "weights"];

/// Name of the list of ids.
pub(crate) const IDS: &str = "ids";

/// The shapes of a part, while they are collected.
#[derive(Debug, Default)]
pub struct Rows {
    control_points: Vec<u8>,
    weights: Vec<f64>,
    texts: [Vec<Option<String>>; TEXTS.len()],
    text_bytes: usize,
    measures: Vec<Measures>,
}

/// Columns of texts.
const TEXTS: [&str; 7] = [IDS, "created_at", "external_ids", "subjects", "labels", "attributes", "metadata"];

impl Rows {
    /// Number of shapes.
    pub fn len(&self) -> usize {
        self.weights.len()
    }

    /// Whether there are no shapes.
    pub fn is_empty(&self) -> bool {
        self.weights.is_empty()
    }

    /// Adds a shape.
    ///
    /// # Errors
    /// [`EngineError::Refused`] if the texts of the part become too long.
    pub fn push(&mut self, shape: Record) -> Result<(), EngineError> {
        self.control_points.extend(shape.control_points.iter().flat_map(|value| value.to_le_bytes()));
        self.weights.push(shape.weight);
        self.measures.push(shape.measures);
        let texts = [
            Some(shape.id),
            shape.created_at,
            shape.external_id,
            shape.subject,
            shape.label,
            shape.attributes,
            shape.metadata,
        ];
        for (column, text) in self.texts.iter_mut().zip(texts) {
            self.text_bytes += text.as_ref().map_or(0, String::len);
            column.push(text);
        }
        if self.text_bytes > MAX_TEXT_BYTES {
            let detail =
                format!("expected at most {MAX_TEXT_BYTES} bytes of texts in {PART} shapes, got more");
            return Err(EngineError::refused("shapes", detail));
        }
        Ok(())
    }

    /// The part as Parquet, and no shapes left.
    ///
    /// # Errors
    /// [`EngineError::Refused`] if it cannot be written as Parquet, which does not happen to a part.
    pub fn encode(&mut self, number: usize, [points, dimension]: [usize; 2]) -> Result<Vec<u8>, EngineError> {
        let columns = std::mem::take(self).columns(number);
        let fields: Vec<Field> = columns
            .iter()
            .map(|(name, column)| Field::new(*name, column.data_type().clone(), true))
            .collect();
        let schema = Arc::new(Schema::new(fields));
        let key = |name: &str, value: usize| KeyValue::new(format!("shapelex.{name}"), value.to_string());
        let metadata =
            vec![key("format", FORMAT as usize), key("points", points), key("dimension", dimension)];
        let properties = WriterProperties::builder()
            .set_created_by("shapelex-engine".into())
            .set_compression(Compression::UNCOMPRESSED)
            .set_dictionary_enabled(false)
            .set_statistics_enabled(EnabledStatistics::None)
            .set_key_value_metadata(Some(metadata))
            .build();
        let failed = |error: &dyn std::fmt::Display| EngineError::refused("shapes", error.to_string());
        let columns = columns.into_iter().map(|(_, column)| column).collect();
        let row = RecordBatch::try_new(schema.clone(), columns).map_err(|error| failed(&error))?;
        let mut writer =
            ArrowWriter::try_new(Vec::new(), schema, Some(properties)).map_err(|error| failed(&error))?;
        writer.write(&row).map_err(|error| failed(&error))?;
        writer.into_inner().map_err(|error| failed(&error))
    }

    fn columns(self, number: usize) -> Vec<(&'static str, ArrayRef)> {
        let count = self.len();
        let measures = &self.measures;
        let numbers = |of: fn(&Measures) -> Option<f64>| -> ArrayRef {
            list(Arc::new(measures.iter().map(of).collect::<Float64Array>()))
        };
        let points = measures.iter().map(|measures| measures.points).collect::<Int64Array>();
        let crossing = measures.iter().map(|measures| measures.self_intersecting).collect::<BooleanArray>();
        let clockwise = measures.iter().map(|measures| measures.clockwise).collect::<BooleanArray>();
        let control_points = BinaryArray::from_iter_values([&self.control_points]);
        let mut columns: Vec<(&'static str, ArrayRef)> = vec![
            ("part", Arc::new(Int64Array::from(vec![number as i64]))),
            ("first", Arc::new(Int64Array::from(vec![(number * PART) as i64]))),
            ("shapes", Arc::new(Int32Array::from(vec![count as i32]))),
            ("control_points", Arc::new(control_points)),
            ("weights", list(Arc::new(Float64Array::from(self.weights)))),
        ];
        let texts = TEXTS.into_iter().zip(self.texts);
        columns.extend(texts.map(|(name, texts)| (name, list(Arc::new(StringArray::from(texts))))));
        columns.push(("points", list(Arc::new(points))));
        columns.push(("centroid_size", numbers(|measures| measures.centroid_size)));
        columns.push(("length", numbers(|measures| measures.length)));
        columns.push(("area", numbers(|measures| measures.area)));
        columns.push(("volume", numbers(|measures| measures.volume)));
        columns.push(("self_intersecting", list(Arc::new(crossing))));
        columns.push(("clockwise", list(Arc::new(clockwise))));
        columns.push(("fit_mean", numbers(|measures| measures.fit_mean)));
        columns.push(("fit_largest", numbers(|measures| measures.fit_largest)));
        columns.push(("fit_area", numbers(|measures| measures.fit_area)));
        columns
    }
}

/// One row that is the list of these values.
fn list(values: ArrayRef) -> ArrayRef {
    let field = Arc::new(Field::new("element", values.data_type().clone(), true));
    Arc::new(ListArray::new(field, OffsetBuffer::from_lengths([values.len()]), values, None))
}

/// The numbers of a part.
#[derive(Debug, Clone, PartialEq)]
pub struct Numbers {
    /// Control points, shape after shape, coordinate-major.
    pub control_points: Vec<f64>,
    /// Weights.
    pub weights: Vec<f64>,
    /// The lists that were asked for, each with a value for every shape.
    lists: Vec<(&'static str, ArrayRef)>,
}

impl Numbers {
    /// The ids, which were asked for by [`IDS`].
    ///
    /// # Errors
    /// [`EngineError::Refused`] if they were not.
    pub(crate) fn ids(&self) -> Result<StringArray, EngineError> {
        let ids = self.list(IDS).and_then(|ids| ids.as_string_opt::<i32>()).cloned();
        ids.ok_or_else(|| EngineError::refused("part", "expected ids, got none"))
    }

    /// The numbers of the shapes at these positions, without lists.
    pub(crate) fn within(mut self, shapes: std::ops::Range<usize>) -> Self {
        let width = self.control_points.len() / self.weights.len().max(1);
        self.control_points.truncate(shapes.end * width);
        self.control_points.drain(..shapes.start * width);
        self.weights.truncate(shapes.end);
        self.weights.drain(..shapes.start);
        self.lists.clear();
        self
    }

    /// The list with this name, if it was asked for.
    pub(crate) fn list(&self, name: &str) -> Option<&ArrayRef> {
        self.lists.iter().find(|(own, _)| *own == name).map(|(_, list)| list)
    }
}

/// Requirements on a part.
#[derive(Debug, Clone, Copy)]
pub struct Expected {
    /// Its number.
    pub number: usize,
    /// Number of its shapes.
    pub shapes: usize,
    /// Number of coordinates of a shape.
    pub width: usize,
}

impl Expected {
    /// Reads the numbers of a part whose digest has been checked, and the lists with these names.
    ///
    /// # Errors
    /// [`EngineError::Damaged`] for a part with another number or other counts, and for numbers that are not finite or weights
    /// that are not positive.
    pub fn decode(self, object: &str, bytes: Bytes, lists: &[&'static str]) -> Result<Numbers, EngineError> {
        let not = |error: &dyn std::fmt::Display| EngineError::damaged(object, "a part", error.to_string());
        let builder = ParquetRecordBatchReaderBuilder::try_new(bytes).map_err(|error| not(&error))?;
        let names = NUMBERS.iter().chain(lists);
        let mask: Vec<usize> = names
            .map(|name| builder.schema().index_of(name))
            .collect::<Result<_, _>>()
            .map_err(|error| not(&error))?;
        let mask = ProjectionMask::roots(builder.parquet_schema(), mask);
        let mut reader = builder.with_projection(mask).build().map_err(|error| not(&error))?;
        let row = reader.next().ok_or_else(|| EngineError::damaged(object, "one row", "none"))?;
        let row = row.map_err(|error| not(&error))?;
        let read = || {
            let mut numbers = self.read(&row)?;
            for name in lists {
                numbers.lists.push((name, self.list(&row, name)?));
            }
            Ok(numbers)
        };
        read().map_err(|(expected, got): (String, String)| EngineError::damaged(object, expected, got))
    }

    /// The values of a list, one for each shape.
    fn list(self, row: &RecordBatch, name: &str) -> Result<ArrayRef, (String, String)> {
        let list = row[name].as_list_opt::<i32>().map(|list| list.value(0));
        let list = list.ok_or_else(|| (format!("a list in '{name}'"), row[name].data_type().to_string()))?;
        let found = if name == IDS { list.len() - list.null_count() } else { list.len() };
        if found != self.shapes {
            return Err((format!("{} values in '{name}'", self.shapes), found.to_string()));
        }
        Ok(list)
    }

    fn read(self, row: &RecordBatch) -> Result<Numbers, (String, String)> {
        let Self { number, shapes, width } = self;
        let types = [DataType::Int64, DataType::Int64, DataType::Int32, DataType::Binary];
        for (name, expected) in NUMBERS.iter().zip(types) {
            let found = row[*name].data_type();
            if *found != expected || row[*name].null_count() > 0 {
                return Err((format!("{expected} in '{name}'"), format!("{found}")));
            }
        }
        let found =
            (row["part"].as_primitive::<Int64Type>().value(0), row["first"].as_primitive::<Int64Type>());
        let held = row["shapes"].as_primitive::<Int32Type>().value(0);
        let found = (found.0, found.1.value(0), i64::from(held));
        let expected = (number as i64, (number * PART) as i64, shapes as i64);
        if found != expected {
            let text = |(part, first, shapes)| format!("part {part} from shape {first}, {shapes} shapes");
            return Err((text(expected), text(found)));
        }
        let bytes = row["control_points"].as_binary::<i32>().value(0);
        if bytes.len() != shapes * width * 8 {
            return Err((format!("{shapes} shapes of {width} numbers"), format!("{} bytes", bytes.len())));
        }
        let control_points: Vec<f64> =
            bytes.as_chunks::<8>().0.iter().map(|chunk| f64::from_le_bytes(*chunk)).collect();
        let weights = row["weights"].as_list_opt::<i32>().map(|list| list.value(0));
        let weights = weights.as_ref().and_then(|values| values.as_primitive_opt::<Float64Type>());
        let weights = weights.ok_or_else(|| ("a list of weights".to_string(), "none".to_string()))?;
        if weights.len() != shapes || weights.null_count() > 0 {
            return Err((format!("{shapes} weights"), weights.len().to_string()));
        }
        let weights = weights.values().to_vec();
        if !weights.iter().all(|weight| *weight > 0.0 && weight.is_finite()) {
            return Err(("positive weights".into(), "others".into()));
        }
        if !control_points.iter().all(|value| value.is_finite()) {
            return Err(("finite control points".into(), "others".into()));
        }
        Ok(Numbers { control_points, weights, lists: Vec::new() })
    }
}
