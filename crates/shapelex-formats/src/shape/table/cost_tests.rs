//! Small tables that claim a large work.

use std::collections::BTreeMap;
use std::sync::Arc;

use arrow_array::types::{Float64Type, Int32Type};
use arrow_array::{
    Array, ArrayRef, BooleanArray, DictionaryArray, FixedSizeListArray, Float64Array, Int32Array, Int64Array,
    ListArray, NullArray, RecordBatch, StringArray, UInt64Array, new_null_array,
};
use arrow_ipc::writer::{DictionaryHandling, IpcWriteOptions, StreamWriter};
use arrow_schema::{DataType, Field as Column, Schema};

use super::super::{FaultKind, FileError, Geometry, Limits, ReadOptions, Record, Value, WriteOptions};
use super::tests::{curve, meshes, read_back, read_with, written};

/// Shapes of one point of one coordinate, which need few bytes.
fn points(rows: usize) -> ArrayRef {
    let lists = (0..rows).map(|_| Some([Some(1.0)]));
    Arc::new(ListArray::from_iter_primitive::<Float64Type, _, _>(lists))
}

fn found(bytes: &[u8]) -> Result<Vec<Record>, FileError> {
    let options = ReadOptions { dimension: Some(1), ..ReadOptions::default() };
    read_with(bytes, &options, Limits::default()).map(|(records, _)| records)
}

/// A stream of Arrow in which dictionaries grow.
fn stream(schema: &Schema, batches: impl IntoIterator<Item = RecordBatch>) -> Vec<u8> {
    let options = IpcWriteOptions::default().with_dictionary_handling(DictionaryHandling::Delta);
    let mut bytes = Vec::new();
    let mut writer = StreamWriter::try_new_with_options(&mut bytes, schema, options).expect("a writer");
    for batch in batches {
        writer.write(&batch).expect("written");
    }
    writer.finish().expect("the end");
    drop(writer);
    bytes
}

/// A file of Parquet with one page a column.
fn file_of(batch: &RecordBatch) -> Vec<u8> {
    let settings = parquet::file::properties::WriterProperties::builder()
        .set_data_page_row_count_limit(1 << 20)
        .set_statistics_enabled(parquet::file::properties::EnabledStatistics::None)
        .build();
    let mut bytes = Vec::new();
    let mut writer =
        parquet::arrow::ArrowWriter::try_new(&mut bytes, batch.schema(), Some(settings)).expect("a writer");
    writer.write(batch).expect("written");
    writer.close().expect("the end");
    bytes
}

#[test]
fn rows_need_a_schema_before_them() {
    let (bytes, _) = written("arrow", &[curve(&[[0.0, 1.0]], true)], &WriteOptions::default());
    let length = u32::from_le_bytes(bytes[4..8].try_into().expect("four bytes")) as usize;
    let refused = read_back(&bytes[8 + length..]).expect_err("no schema");
    assert_eq!(refused.to_string(), "byte 0: expected a schema before all rows, got rows");
}

#[test]
fn many_columns_with_dictionaries_are_refused() {
    let kind = DataType::Dictionary(Box::new(DataType::Int8), Box::new(DataType::Utf8));
    let file = |count: usize| {
        let first = Column::new("points", points(0).data_type().clone(), true);
        let others = (0..count).map(|k| Column::new(format!("{k}"), kind.clone(), true));
        stream(&Schema::new(std::iter::once(first).chain(others).collect::<Vec<_>>()), [])
    };
    assert_eq!(found(&file(1024)).expect("no rows").len(), 0);
    let refused = found(&file(1025)).expect_err("one more");
    assert_eq!(refused.to_string(), "schema: expected at most 1024 columns with dictionaries, got 1025");
}

/// Batches of one row. Each adds a short text, which is the label, to a dictionary with a long one.
fn growing(count: i32) -> Vec<u8> {
    let long = "x".repeat(1 << 20);
    let batch = |k: i32| {
        let texts = std::iter::once(long.clone()).chain((0..k).map(|k| k.to_string()));
        let texts: ArrayRef = Arc::new(StringArray::from_iter_values(texts));
        let labels = DictionaryArray::<Int32Type>::try_new(Int32Array::from(vec![k]), texts);
        let labels: ArrayRef = Arc::new(labels.expect("positions of texts"));
        RecordBatch::try_from_iter([("points", points(1)), ("label", labels)]).expect("a batch")
    };
    stream(&batch(1).schema(), (1..=count).map(batch))
}

#[test]
fn dictionaries_that_grow_are_copied_a_number_of_times() {
    let labels = found(&growing(40)).expect("40 MiB").into_iter().map(|record| record.label);
    assert!(labels.eq((0..40).map(|k| Some(k.to_string()))));
    // 64 MiB, and 16 for the one of the file.
    let refused = found(&growing(95)).expect_err("94 MiB");
    assert_eq!(refused.kind, FaultKind::TooLarge);
    let expected = " bytes of dictionaries that are copied to add values in ";
    assert!(refused.to_string().contains(expected), "{refused}");
}

#[test]
fn cells_of_arrow_without_bytes_are_refused() {
    let rows = 12_000;
    let nulls = || -> ArrayRef { Arc::new(NullArray::new(rows)) };
    let item = Arc::new(Column::new("item", DataType::Null, true));
    let points: ArrayRef = Arc::new(FixedSizeListArray::new(item, 1, nulls(), None));
    let flags: ArrayRef = Arc::new(BooleanArray::from(vec![true; rows]));
    let own = [("points".to_owned(), points), ("flag".to_owned(), flags)];
    let columns = own.into_iter().chain((0..80).map(|k| (format!("{k}"), nulls())));
    let batch = RecordBatch::try_from_iter(columns).expect("a batch");
    let file = |count: usize| stream(&batch.schema(), std::iter::repeat_n(batch.clone(), count));
    assert_eq!(found(&file(4)).expect("4 million cells").len(), 4 * rows);
    let refused = found(&file(16)).expect_err("16 million cells");
    assert_eq!(refused.kind, FaultKind::TooLarge);
    assert!(refused.to_string().contains(" cells (with those within lists) in "), "{refused}");
}

#[test]
fn cells_of_parquet_without_bytes_are_refused() {
    let file = |rows: usize| {
        let nulls = (0..20).map(|k| (format!("{k}"), new_null_array(&DataType::Boolean, rows)));
        let columns = std::iter::once(("points".to_owned(), points(rows))).chain(nulls);
        file_of(&RecordBatch::try_from_iter(columns).expect("a batch"))
    };
    assert_eq!(found(&file(2000)).expect("few cells").len(), 2000);
    let refused = found(&file(500_000)).expect_err("10 million cells");
    assert_eq!((refused.kind, refused.place.item), (FaultKind::TooLarge, Some(0)));
    assert!(refused.to_string().contains(" cells (with those within lists) in "), "{refused}");
}

#[test]
fn long_names_of_columns_are_refused() {
    for (length, is_read) in [(1024, true), (1025, false)] {
        let name = "x".repeat(length);
        let flags: ArrayRef = Arc::new(BooleanArray::from(vec![true]));
        let columns = [("points", points(1)), (name.as_str(), flags)];
        let batch = RecordBatch::try_from_iter(columns).expect("a batch");
        for file in [stream(&batch.schema(), [batch.clone()]), file_of(&batch)] {
            match found(&file) {
                Ok(records) => assert!(is_read && records[0].labels.contains_key(&name)),
                Err(error) => {
                    let expected = "expected a name of at most 1024 bytes, got 1025 of 'xxx";
                    assert!(!is_read && error.to_string().contains(expected), "{error}");
                }
            }
        }
    }
}

#[test]
fn long_names_are_written_without_columns() {
    let name = "x".repeat(1020);
    let mut record = curve(&[[0.0, 1.0]], true);
    record.labels = BTreeMap::from([(name.clone(), Value::Number(2.0)), ("short".into(), Value::Bool(true))]);
    let mut mesh = meshes().remove(0);
    if let Geometry::Mesh(mesh) = &mut mesh.geometry {
        let field = mesh.fields["area"].clone();
        mesh.fields.insert(name, field);
    }
    for id in ["arrow", "parquet"] {
        let (bytes, _) = written(id, std::slice::from_ref(&record), &WriteOptions::default());
        let (records, _) = read_back(&bytes).expect("a table");
        assert_eq!(records[0].labels, record.labels, "{id}");
        let (bytes, summary) = written(id, std::slice::from_ref(&mesh), &WriteOptions::default());
        let dropped: Vec<_> = summary.dropped.iter().map(|dropped| (&*dropped.what, dropped.count)).collect();
        assert_eq!(dropped, [("fields with names that are too long for a column", 1)], "{id}");
        assert_eq!(read_back(&bytes).expect("a table").0.len(), 1, "{id}");
    }
}

#[test]
fn whole_numbers_of_64_bits_are_exact() {
    let wholes = vec![Some(i64::MAX), Some(9_007_199_254_740_993), Some(-61), None];
    let unsigned = vec![Some(u64::MAX), Some(61), None, Some(9_007_199_254_740_991)];
    let columns: [(&str, ArrayRef); 4] = [
        ("points", points(4)),
        ("external_id", Arc::new(Int64Array::from(wholes.clone()))),
        ("pid", Arc::new(Int64Array::from(wholes))),
        ("uid", Arc::new(UInt64Array::from(unsigned))),
    ];
    let batch = RecordBatch::try_from_iter(columns).expect("a batch");
    let records = found(&file_of(&batch)).expect("a table");
    let labels = |k: usize, name: &str| records[k].labels.get(name).cloned();
    assert_eq!(records[0].name.as_deref(), Some("9223372036854775807"));
    assert_eq!(records[1].name.as_deref(), Some("9007199254740993"));
    assert_eq!(labels(0, "pid"), Some("9223372036854775807".into()));
    assert_eq!(labels(1, "pid"), Some("9007199254740993".into()));
    assert_eq!((labels(2, "pid"), labels(3, "pid")), (Some(Value::Number(-61.0)), None));
    assert_eq!(labels(0, "uid"), Some("18446744073709551615".into()));
    assert_eq!(labels(1, "uid"), Some(Value::Number(61.0)));
    assert_eq!(labels(3, "uid"), Some(Value::Number(9_007_199_254_740_991.0)));
}

#[test]
fn numbers_that_are_not_finite_are_refused() {
    for (name, number, wanted) in [
        ("weight", f64::NAN, "got NaN"),
        ("weight", f64::INFINITY, "got inf"),
        ("age", f64::NEG_INFINITY, "got -inf"),
    ] {
        let numbers: ArrayRef = Arc::new(Float64Array::from(vec![1.0, number]));
        let batch = RecordBatch::try_from_iter([("points", points(2)), (name, numbers)]).expect("a batch");
        let refused = found(&file_of(&batch)).expect_err("no finite number").to_string();
        assert!(refused.contains(wanted) && refused.contains(name), "{refused}");
        let rows = batch.slice(0, 1);
        assert_eq!(found(&file_of(&rows)).expect("a table").len(), 1);
    }
    // NaN among attributes stands for a missing one, as tables of Python have it.
    let numbers: ArrayRef = Arc::new(Float64Array::from(vec![f64::NAN]));
    let batch = RecordBatch::try_from_iter([("points", points(1)), ("age", numbers)]).expect("a batch");
    assert!(found(&file_of(&batch)).expect("a table")[0].labels.is_empty());
}
