//! Tables written and read back, cut off, altered, and made by hand with claims that are not true.

use std::collections::BTreeMap;
use std::sync::Arc;

use arrow_array::cast::AsArray;
use arrow_array::types::{Float32Type, Int32Type, Int64Type};
use arrow_array::{
    Array, ArrayRef, DictionaryArray, FixedSizeListArray, Int64Array, LargeListArray, ListArray, RecordBatch,
    StringArray, TimestampMillisecondArray,
};
use arrow_ipc::writer::{FileWriter, StreamWriter};
use arrow_schema::{DataType, Field as Column, Schema};
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;

use super::super::record::{Domain, Field, Ring};
use super::super::{
    Columns, FaultKind, FileError, Format, Fourier, Geometry, Limits, Mesh, Place, Points, ReadOptions,
    Record, Source, Summary, Value, WriteOptions, detect, find, read,
};
use crate::unit::Unit;

/// The option by which a column has the points.
fn points_in(name: &str) -> Columns {
    Columns { coordinates: Some(vec![name.into()]), ..Columns::default() }
}

fn format(id: &str) -> &'static Format {
    find(id).expect("a format")
}

pub(super) fn written(id: &str, records: &[Record], options: &WriteOptions) -> (Vec<u8>, Summary) {
    let mut bytes = Vec::new();
    let mut writer = format(id).writer(&mut bytes, options).expect("a writer");
    for record in records {
        writer.push(record).expect("written");
    }
    let summary = writer.finish().expect("the end");
    (bytes, summary)
}

pub(super) fn read_with(
    bytes: &[u8],
    options: &ReadOptions,
    limits: Limits,
) -> Result<(Vec<Record>, Summary), FileError> {
    let mut source = Source::new(bytes, limits)?;
    let format = detect(source.head(), None)?;
    let mut found = Vec::new();
    let summary = read(format, &mut source, options, &mut |record| {
        found.push(record);
        Ok(())
    })?;
    Ok((found, summary))
}

pub(super) fn read_back(bytes: &[u8]) -> Result<(Vec<Record>, Summary), FileError> {
    read_with(bytes, &ReadOptions::default(), Limits::default())
}

/// Without the places, which a table does not keep.
fn placeless(records: &[Record]) -> Vec<Record> {
    records.iter().cloned().map(|record| Record { place: Place::default(), ..record }).collect()
}

pub(super) fn curve(points: &[[f64; 2]], closed: bool) -> Record {
    let points = Points::from_rows(2, points.concat());
    Record::new(Geometry::Curve { points, closed }, Place::default())
}

fn landmarks() -> Record {
    let points = Points::from_rows(3, vec![1e-300, -2.5, 1e99, f64::MIN_POSITIVE, 0.1, 0.2]);
    Record::new(Geometry::Landmarks(points), Place::default())
}

/// Curves and landmarks with everything that a record can have, but no missing points, which are not equal to themselves.
fn points() -> Vec<Record> {
    let mut full = curve(&[[0.1, 0.0], [2.0, 0.0], [2.0, 1e-7]], true);
    full.name = Some("Größe, \"x\"".into());
    full.subject = Some("s1".into());
    full.label = Some("a".into());
    full.weight = Some(0.25);
    full.labels = BTreeMap::from([
        ("age".into(), Value::Number(61.5)),
        ("left".into(), Value::Bool(true)),
        ("site".into(), Value::from("zrh")),
        ("mixed".into(), Value::Number(1.0)),
    ]);
    full.metadata = serde_json::json!({"a": [1, 2.5], "b": null}).as_object().cloned().expect("an object");
    let mut other = curve(&[[1.0, 2.0], [3.0, 4.0]], false);
    other.labels = BTreeMap::from([("mixed".into(), Value::from("text"))]);
    vec![full, other, landmarks()]
}

pub(super) fn meshes() -> Vec<Record> {
    let mut mesh = Mesh {
        vertices: Points::from_rows(3, vec![0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]),
        ..Mesh::default()
    };
    mesh.faces.push([0, 1, 2]);
    mesh.faces.push([0, 1, 3]);
    let mut squares = mesh.clone();
    squares.faces.push([0, 1, 2, 3]);
    mesh.fields.insert("colour".into(), Field { domain: Domain::Vertices, width: 3, values: vec![0.5; 12] });
    mesh.fields.insert("area".into(), Field { domain: Domain::Faces, width: 1, values: vec![0.5, 0.25] });
    let mut found = vec![Record::new(mesh, Place::default()), Record::new(squares, Place::default())];
    found[0].ring = Some(Ring { object: 3, part: 1, hole: true });
    found
}

#[test]
fn tables_come_back_as_they_were_written() {
    let in_mm = |record| Record { unit: Some(Unit::Millimetre), ..record };
    let records: Vec<Record> = [points(), meshes()].concat().into_iter().map(in_mm).collect();
    let facts = BTreeMap::from([("representation".to_owned(), "polygon".to_owned())]);
    let options = WriteOptions { unit: Some("mm".into()), facts, ..WriteOptions::default() };
    for id in ["arrow", "parquet"] {
        let (bytes, summary) = written(id, &records, &options);
        assert_eq!((summary.records, summary.dropped), (5, vec![]), "{id}");
        let (found, summary) = read_back(&bytes).expect("a table");
        assert_eq!(placeless(&found), records, "{id}");
        assert_eq!(summary.properties["unit"], "mm", "{id}");
        assert_eq!(summary.properties["representation"], "polygon", "{id}");
        assert_eq!(found[4].place, Place::item(4));
        let (empty, _) = written(id, &[], &options);
        assert_eq!(read_back(&empty).expect("no rows").0, vec![], "{id}");
    }
}

#[test]
fn arrays_come_back_as_they_were_written() {
    let mut records = points();
    records.pop();
    let (bytes, summary) = written("npz", &records, &WriteOptions::default());
    assert_eq!((summary.records, summary.dropped), (2, vec![]));
    assert_eq!(placeless(&read_back(&bytes).expect("arrays").0), records, "offsets");
    let equal = vec![curve(&[[1.0, 2.0], [3.0, 4.0]], true), curve(&[[0.1, 0.2], [0.3, 0.4]], true)];
    let (bytes, _) = written("npz", &equal, &WriteOptions::default());
    assert_eq!(placeless(&read_back(&bytes).expect("arrays").0), equal);
    let (bytes, summary) = written("npy", &equal, &WriteOptions::default());
    assert_eq!(summary.dropped[0].count, 2, "that they are closed");
    let options = ReadOptions { closed: Some(true), ..ReadOptions::default() };
    assert_eq!(placeless(&read_with(&bytes, &options, Limits::default()).expect("an array").0), equal);
    for id in ["npy", "npz"] {
        let (empty, _) = written(id, &[], &WriteOptions::default());
        assert_eq!(read_back(&empty).expect("no shapes").0, vec![], "{id}");
    }
}

#[test]
fn missing_points_stay_missing() {
    let points = Points::from_rows(2, vec![0.0, 1.0, f64::NAN, f64::NAN, 2.0, 3.0]);
    let records = [Record::new(Geometry::Landmarks(points), Place::default())];
    for id in ["arrow", "parquet", "npy", "npz"] {
        let (bytes, _) = written(id, &records, &WriteOptions::default());
        let (found, _) = read_back(&bytes).expect("a table");
        let Geometry::Landmarks(points) = &found[0].geometry else { panic!("landmarks") };
        assert_eq!((points.missing(), points.coordinates()[4]), (vec![1], 2.0), "{id}");
    }
}

#[test]
fn many_batches_and_row_groups_keep_the_order() {
    let count = 100_000;
    let records: Vec<Record> = (0..count)
        .map(|k| Record { name: Some(k.to_string()), ..curve(&[[f64::from(k), 0.5], [0.25, -1.0]], true) })
        .collect();
    for id in ["arrow", "parquet"] {
        let (bytes, _) = written(id, &records, &WriteOptions::default());
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a pool");
        let (alone, _) = pool.install(|| written(id, &records, &WriteOptions::default()));
        assert!(bytes == alone, "{id}: other bytes on one thread");
        assert!(placeless(&read_back(&bytes).expect("a table").0) == records, "{id}");
    }
}

/// The lists of all columns that have them, row by row.
fn lists_of(batches: &[RecordBatch]) -> Vec<Vec<Option<ArrayRef>>> {
    let rows = |batch: &RecordBatch| {
        let lists: Vec<&ListArray> = batch.columns().iter().filter_map(|array| array.as_list_opt()).collect();
        let row =
            |row: usize| lists.iter().map(|lists| lists.is_valid(row).then(|| lists.value(row))).collect();
        (0..batch.num_rows()).map(row).collect::<Vec<_>>()
    };
    batches.iter().flat_map(rows).collect()
}

/// Pages made here, as the library reads them: lists that are null, empty, longer than a page, with null numbers, in many pages.
#[test]
fn lists_of_parquet_are_those_of_arrow() {
    let mut records = [points(), meshes()].concat();
    let missing = [f64::NAN, f64::NAN, 2.0, 3.0, f64::NAN, f64::NAN];
    records.push(Record::new(Geometry::Landmarks(Points::from_rows(2, missing.into())), Place::default()));
    records.push(Record::new(Geometry::Landmarks(Points::new(2)), Place::default()));
    for count in [70_000_u32, 65_536, 1, 300, 40_000, 40_000] {
        let numbers = (0..2 * count).map(|k| f64::from(k) / 7.0).collect();
        records.push(Record::new(Geometry::Landmarks(Points::from_rows(2, numbers)), Place::default()));
    }
    records.extend((0..super::rows::ROWS).map(|k| curve(&[[k as f64, 0.5]], true)));
    records.extend(points());
    let (stream, _) = written("arrow", &records, &WriteOptions::default());
    let stream = arrow_ipc::reader::StreamReader::try_new(stream.as_slice(), None).expect("a stream");
    let expected = lists_of(&stream.collect::<Result<Vec<_>, _>>().expect("batches"));
    let (file, _) = written("parquet", &records, &WriteOptions::default());
    let file = ParquetRecordBatchReaderBuilder::try_new(bytes::Bytes::from(file)).expect("a file");
    let found = lists_of(&file.build().expect("batches").collect::<Result<Vec<_>, _>>().expect("batches"));
    assert_eq!(found.len(), records.len());
    for (row, (found, expected)) in found.iter().zip(&expected).enumerate() {
        assert_eq!(found, expected, "row {row}");
    }
}

#[test]
fn attributes_and_fields_of_later_rows() {
    let mut records: Vec<Record> = vec![curve(&[[0.0, 1.0]], true); super::rows::ROWS];
    records.push(Record {
        labels: BTreeMap::from([("late".into(), Value::Number(2.0))]),
        ..curve(&[[0.0, 1.0]], true)
    });
    records.push(meshes()[0].clone());
    let (bytes, summary) = written("parquet", &records, &WriteOptions::default());
    assert_eq!((summary.dropped[0].count, summary.dropped[0].names.len()), (2, 2), "two fields of the mesh");
    let (found, _) = read_back(&bytes).expect("a table");
    assert_eq!(found[super::rows::ROWS].labels["late"], Value::Number(2.0));
}

#[test]
fn what_a_format_cannot_hold_is_refused() {
    let fourier = Fourier { constant: vec![0.0; 2], cosine: vec![1.0; 2], sine: vec![0.5; 2] };
    let fourier = Record::new(fourier, Place::item(7));
    for (id, records, expected) in [
        (
            "parquet",
            vec![fourier],
            "item 7: expected curves, landmarks or meshes in a table, got Fourier coefficients",
        ),
        ("npz", meshes(), "expected curves or landmarks in an array of points, got Mesh"),
        (
            "npy",
            points(),
            "expected 3 points of 2 coordinates in every shape of an array, got 2 of 2; NPZ and Parquet hold others",
        ),
        ("npz", points(), "expected 2 coordinates in every shape of an array, got 3"),
    ] {
        let mut bytes = Vec::new();
        let mut writer = format(id).writer(&mut bytes, &WriteOptions::default()).expect("a writer");
        let error = records.iter().find_map(|record| writer.push(record).err()).expect("a refusal");
        assert_eq!((error.kind, error.to_string().as_str()), (FaultKind::Unsupported, expected));
    }
}

/// Files of all formats, small.
fn files() -> Vec<(&'static str, Vec<u8>)> {
    let equal = [curve(&[[1.0, 2.0], [3.0, 4.0]], true), curve(&[[0.1, 0.2], [0.3, 0.4]], true)];
    let all = [points(), meshes()].concat();
    let mut files: Vec<_> = ["arrow", "parquet"]
        .into_iter()
        .map(|id| (id, written(id, &all, &WriteOptions::default()).0))
        .collect();
    files.extend(["npy", "npz"].into_iter().map(|id| (id, written(id, &equal, &WriteOptions::default()).0)));
    files
}

#[test]
fn a_file_that_is_cut_off_is_refused_or_shorter() {
    for (id, bytes) in files() {
        let whole = read_back(&bytes).expect("a whole file").0.len();
        for end in (0..bytes.len()).step_by(if bytes.len() > 1000 { 13 } else { 3 }) {
            match read_back(&bytes[..end]) {
                Err(_) => {}
                // A stream of Arrow may end after any message.
                Ok((found, _)) => assert!(id == "arrow" && found.len() <= whole, "{id} of {end} bytes"),
            }
        }
    }
}

#[test]
fn altered_files_neither_panic_nor_take_memory() {
    let limits = Limits { content: 1 << 24, held: 1 << 22, points: 1 << 12, records: 1000, depth: 8 };
    for (_, bytes) in files() {
        // A sample of the bytes, each in two of five ways.
        for at in (0..bytes.len()).step_by(if bytes.len() > 1000 { 11 } else { 2 }) {
            let ways = [0x00, 0x7f, 0xff, bytes[at] ^ 0x01, bytes[at] ^ 0x80];
            for value in [ways[at % 5], ways[(at + 2) % 5]] {
                let mut altered = bytes.clone();
                altered[at] = value;
                let found = read_with(&altered, &ReadOptions::default(), limits);
                if let Err(error) = found {
                    assert!(error.to_string().starts_with(|c: char| c.is_ascii()), "{error}");
                }
            }
        }
    }
}

/// A table of another program: points as lists of lists, texts by position, numbers of other widths, times.
fn foreign(points: ArrayRef) -> RecordBatch {
    let class: DictionaryArray<Int32Type> = ["x", "y", "x"].into_iter().collect();
    let columns: Vec<(&str, ArrayRef)> = vec![
        ("contour", points),
        ("external_id", Arc::new(Int64Array::from(vec![11, 12, 13]))),
        ("label", Arc::new(class)),
        ("area", Arc::new(arrow_array::Float32Array::from(vec![Some(0.5), None, Some(2.0)]))),
        ("note", Arc::new(arrow_array::LargeStringArray::from(vec!["p", "q", "r"]))),
        ("at", Arc::new(TimestampMillisecondArray::from(vec![1, 2, 3]))),
    ];
    let schema = columns.iter().map(|(name, array)| Column::new(*name, array.data_type().clone(), true));
    let schema = Arc::new(Schema::new(schema.collect::<Vec<_>>()));
    RecordBatch::try_new(schema, columns.into_iter().map(|(_, array)| array).collect()).expect("a batch")
}

#[test]
fn tables_of_other_programs() {
    let rows = [vec![0.0_f32, 1.0, 2.0, 3.0], vec![4.0, 5.0], vec![6.0, 7.0, 8.0, 9.0, 10.0, 11.0]];
    let rows = rows.map(|row| Some(row.into_iter().map(Some)));
    let lists: ArrayRef = Arc::new(LargeListArray::from_iter_primitive::<Float32Type, _, _>(rows));
    let batch = foreign(lists);
    let mut bytes = Vec::new();
    let mut writer = FileWriter::try_new(&mut bytes, &batch.schema()).expect("a writer");
    writer.write(&batch).expect("written");
    writer.finish().expect("the end");
    drop(writer);
    let options = ReadOptions {
        columns: Some(points_in("contour")),
        dimension: Some(2),
        closed: Some(true),
        ..ReadOptions::default()
    };
    let (found, summary) = read_with(&bytes, &options, Limits::default()).expect("a table");
    let Geometry::Curve { points, closed: true } = &found[2].geometry else { panic!("a closed curve") };
    assert_eq!(points.coordinates(), [6.0, 7.0, 8.0, 9.0, 10.0, 11.0]);
    assert_eq!((found[1].name.as_deref(), found[1].label.as_deref()), (Some("12"), Some("y")));
    assert_eq!((&found[0].labels["area"], found[1].labels.get("area")), (&Value::Number(0.5), None));
    assert_eq!(found[2].labels["note"], Value::from("r"));
    assert_eq!(summary.dropped[0].names, ["at"]);

    let error = read_back(&bytes).expect_err("another column");
    assert!(
        error
            .to_string()
            .starts_with("expected a column 'points' of lists of numbers, or columns.coordinates")
    );
    let options = ReadOptions { columns: Some(points_in("contour")), ..ReadOptions::default() };
    let error = read_with(&bytes, &options, Limits::default()).expect_err("no dimension");
    assert_eq!((error.kind, error.place.item), (FaultKind::Option, Some(0)));
    let options = ReadOptions { columns: Some(points_in("area")), ..ReadOptions::default() };
    let error = read_with(&bytes, &options, Limits::default()).expect_err("no lists");
    assert_eq!(error.to_string(), "column 'area': expected lists of numbers, got Float32");
}

#[test]
fn lists_of_points() {
    let point = FixedSizeListArray::from_iter_primitive::<Int64Type, _, _>(
        [[0, 1], [2, 3], [4, 5]].map(|point| Some(point.map(Some))),
        2,
    );
    let offsets = arrow_buffer::OffsetBuffer::from_lengths([2, 0, 1]);
    let item = Arc::new(Column::new("item", point.data_type().clone(), true));
    let batch = foreign(Arc::new(ListArray::new(item, offsets, Arc::new(point), None)));
    let mut bytes = Vec::new();
    let mut writer = StreamWriter::try_new(&mut bytes, &batch.schema()).expect("a writer");
    writer.write(&batch).expect("written");
    writer.finish().expect("the end");
    drop(writer);
    let options = ReadOptions { columns: Some(points_in("contour")), ..ReadOptions::default() };
    let (found, summary) = read_with(&bytes, &options, Limits::default()).expect("a table");
    let Geometry::Landmarks(points) = &found[0].geometry else { panic!("landmarks") };
    assert_eq!((points.dimension(), points.coordinates()), (2, [0.0, 1.0, 2.0, 3.0].as_slice()));
    let left_out = summary.dropped.last().expect("a list without points");
    assert_eq!((&*left_out.what, left_out.first.item), ("shapes without points", Some(1)));
    assert_eq!(found[1].geometry, Geometry::Landmarks(Points::from_rows(2, vec![4.0, 5.0])));
}

#[test]
fn lying_sizes_of_arrow_are_refused_before_memory_is_taken() {
    let (bytes, _) = written("arrow", &points(), &WriteOptions::default());
    let mut lying = bytes.clone();
    lying[4..8].copy_from_slice(&0x7fff_fff8_u32.to_le_bytes());
    let error = super::arrow::FORMAT
        .read
        .map(|read| {
            let mut source = Source::new(lying.as_slice(), Limits::default()).expect("a source");
            read(&mut source, &ReadOptions::default(), &mut |_| Ok(()))
        })
        .expect("a reader")
        .expect_err("a length");
    assert_eq!(error.to_string(), "byte 0: expected metadata of at most 16777216 bytes, got 2147483640");
    // The body of the batch is as long as the limit allows; here it is not.
    let limits = Limits { held: 64, ..Limits::default() };
    let error = read_with(&bytes, &ReadOptions::default(), limits).expect_err("a long body");
    assert_eq!(error.kind, FaultKind::TooLarge);
    // Numbers of a byte take eight in double precision, those that are null throughout nothing before.
    let bytes: ArrayRef = Arc::new(arrow_array::Int8Array::from(vec![0; 1_000_000]));
    let nulls: ArrayRef = Arc::new(arrow_array::NullArray::new(1_000_000));
    let batch = RecordBatch::try_from_iter([("a", bytes), ("b", nulls)]).expect("a batch");
    let mut file = Vec::new();
    let mut writer = StreamWriter::try_new(&mut file, &batch.schema()).expect("a writer");
    writer.write(&batch).expect("written");
    writer.finish().expect("the end");
    drop(writer);
    let limits = Limits { held: 1_500_000, ..Limits::default() };
    let error = read_with(&file, &ReadOptions::default(), limits).expect_err("many numbers");
    assert!(error.to_string().contains(" bytes in double precision, got 16000000;"), "{error}");
}

#[test]
fn dictionaries_of_arrow_are_held_together() {
    let lists = ListArray::from_iter_primitive::<arrow_array::types::Float64Type, _, _>([Some([
        Some(1.0),
        Some(2.0),
    ])]);
    let text = "x".repeat(40_000);
    let class =
        || -> ArrayRef { Arc::new([text.as_str()].into_iter().collect::<DictionaryArray<Int32Type>>()) };
    let columns = [("points", Arc::new(lists) as ArrayRef), ("a", class()), ("b", class())];
    let batch = RecordBatch::try_from_iter(columns).expect("a batch");
    let mut file = Vec::new();
    let mut writer = StreamWriter::try_new(&mut file, &batch.schema()).expect("a writer");
    writer.write(&batch).expect("written");
    writer.finish().expect("the end");
    drop(writer);
    let options = ReadOptions { dimension: Some(2), ..ReadOptions::default() };
    let found = |held: usize| read_with(&file, &options, Limits { held, ..Limits::default() });
    assert_eq!(found(100_000).expect("a table").0.len(), 1);
    assert_eq!(found(60_000).expect_err("two long texts").kind, FaultKind::TooLarge);
}

#[test]
fn metadata_that_claim_lists_without_bytes_are_refused() {
    let (mut bytes, _) = written("parquet", &points(), &WriteOptions::default());
    let tail = bytes.len() - 8;
    let length = u32::from_le_bytes(bytes[tail..tail + 4].try_into().unwrap());
    // A field of the id 100, which is skipped: a list of 2³¹ − 1 Booleans.
    let field = [0x09, 0xc8, 0x01, 0xf1, 0xff, 0xff, 0xff, 0xff, 0x07];
    bytes[tail..tail + 4].copy_from_slice(&(length + field.len() as u32).to_le_bytes());
    bytes.splice(tail - 1..tail - 1, field);
    let refused = read_back(&bytes).unwrap_err();
    assert_eq!(refused.to_string(), "metadata: expected metadata of Parquet, got other bytes");
}

/// A file whose metadata have these elements of the schema, and no row group.
fn file_of_elements(count: u32, element: &[u8]) -> Vec<u8> {
    let number = |value: u32| {
        let seven = |k: u32| (value >> (7 * k)) as u8 & 0x7f;
        [seven(0) | 0x80, seven(1) | 0x80, seven(2) | 0x80, seven(3)]
    };
    // The version, the schema: a list of structures; no rows, no row groups.
    let mut metadata = vec![0x15, 0x02, 0x19, 0xfc];
    metadata.extend(number(count));
    metadata.extend(element.repeat(count as usize));
    metadata.extend([0x16, 0x00, 0x19, 0x0c, 0x00]);
    let mut bytes = b"PAR1".to_vec();
    bytes.extend(&metadata);
    bytes.extend((metadata.len() as u32).to_le_bytes());
    bytes.extend(b"PAR1");
    bytes
}

#[test]
fn schemas_are_one_tree_that_is_not_deep() {
    // A required group `a` with this number of children, of one byte.
    let group = |children: u8| [0x35, 0x00, 0x18, 0x01, b'a', 0x15, children << 1, 0x00];
    let shape =
        "metadata: expected a schema that is one tree of at most 32 levels, got other numbers of children";
    let other = "metadata: expected metadata of Parquet, got other bytes";
    for (count, children, expected) in [
        // The library descends by recursion, which would end the program.
        (60_000, 1, shape),
        // It takes memory for the children before it reads them.
        (3, 63, shape),
        (2, 0, shape),
        (0, 0, shape),
        (70_000, 1, other),
    ] {
        let refused = read_back(&file_of_elements(count, &group(children))).expect_err("no tree");
        assert_eq!(refused.to_string(), expected, "{count} groups of {children}");
    }
}

#[test]
fn fields_of_other_types_are_refused() {
    let (bytes, _) = written("parquet", &points(), &WriteOptions::default());
    let tail = bytes.len() - 8;
    let length = u32::from_le_bytes(bytes[tail..tail + 4].try_into().unwrap()) as usize;
    // The version is a structure without fields, which takes a byte as well: the library would read it as a number.
    let mut altered = bytes.clone();
    assert_eq!(altered[tail - length] & 0x0f, 5);
    altered[tail - length] = 0x1c;
    altered[tail - length + 1] = 0x00;
    let refused = read_back(&altered).expect_err("another type");
    assert_eq!(refused.to_string(), "metadata: expected metadata of Parquet, got other bytes");
}

/// A file of one row group with lists of zeros, and a label for every row.
fn long_rows(lengths: &[usize], label: &str) -> Vec<u8> {
    let zeros = |length: &usize| Some(vec![Some(0.0); *length]);
    let points: ArrayRef = Arc::new(ListArray::from_iter_primitive::<arrow_array::types::Float64Type, _, _>(
        lengths.iter().map(zeros),
    ));
    let labels: ArrayRef = Arc::new(StringArray::from(vec![label; lengths.len()]));
    let unused: ArrayRef = Arc::new(TimestampMillisecondArray::from(vec![0; lengths.len()]));
    let columns = [("points", points), ("label", labels), ("at", unused)];
    let batch = RecordBatch::try_from_iter(columns).expect("a batch");
    let settings = parquet::file::properties::WriterProperties::builder()
        .set_compression(parquet::basic::Compression::SNAPPY)
        .build();
    let mut bytes = Vec::new();
    let mut writer =
        parquet::arrow::ArrowWriter::try_new(&mut bytes, batch.schema(), Some(settings)).expect("a writer");
    writer.write(&batch).expect("written");
    writer.close().expect("the end");
    bytes
}

#[test]
fn rows_of_parquet_are_decoded_within_what_may_be_held() {
    let options = ReadOptions { dimension: Some(2), closed: Some(true), ..ReadOptions::default() };
    let limits = |held: usize| Limits { held, ..Limits::default() };
    let lengths = [[4; 1000].as_slice(), &[300_000], &[4; 1000], &[300_000]].concat();
    // 12 MB in all, more than may be made of so small a file: row after row, of which the longest take 6 MB.
    let (found, summary) =
        read_with(&long_rows(&lengths, "a"), &options, Limits::default()).expect("a table");
    let numbers = |record: &Record| match &record.geometry {
        Geometry::Curve { points, .. } => points.coordinates().len(),
        _ => 0,
    };
    assert_eq!(found.iter().map(numbers).collect::<Vec<_>>(), lengths);
    assert_eq!(summary.dropped[0].names, ["at"]);
    let long = read_with(&long_rows(&[4, 1_000_000], "a"), &options, Limits::default());
    let error = long.map(|_| ()).expect_err("a long row");
    assert_eq!(error.kind, FaultKind::TooLarge);
    assert!(error.to_string().contains("row group: expected rows of at most "), "{error}");

    // A long text of many rows is held once: as many texts would take 800 MB.
    let text = "x".repeat(100_000);
    let bytes = long_rows(&[4; 8000], &text);
    let mut count = 0;
    let mut source = Source::new(bytes.as_slice(), limits(2_000_000)).expect("a source");
    let all = super::parquet::FORMAT.read.expect("a reader")(&mut source, &options, &mut |record| {
        count += record.label.map_or(0, |label| label.len());
        Ok(())
    });
    all.expect("a table");
    assert_eq!(count, 8000 * text.len());
    // The decompressed size of pages counts as content.
    let much = Limits { content: 50_000, ..limits(2_000_000) };
    assert!(bytes.len() < 40_000);
    assert_eq!(read_with(&bytes, &options, much).map(|_| ()).expect_err("much").kind, FaultKind::TooLarge);
}

#[test]
fn pages_that_claim_more_than_they_hold_are_refused() {
    let texts: ArrayRef = Arc::new(StringArray::from(vec!["text"; 100]));
    let lists = ListArray::from_iter_primitive::<Int64Type, _, _>((0..100).map(|k| Some([Some(k), Some(k)])));
    let schema = Arc::new(Schema::new(vec![
        Column::new("external_id", DataType::Utf8, true),
        Column::new("points", lists.data_type().clone(), true),
    ]));
    let batch = RecordBatch::try_new(schema, vec![texts, Arc::new(lists)]).expect("a batch");
    let mut bytes = Vec::new();
    let settings = parquet::file::properties::WriterProperties::builder()
        .set_compression(parquet::basic::Compression::SNAPPY)
        .set_dictionary_enabled(false)
        .build();
    let mut writer =
        parquet::arrow::ArrowWriter::try_new(&mut bytes, batch.schema(), Some(settings)).expect("a writer");
    writer.write(&batch).expect("written");
    writer.close().expect("the end");
    let options = ReadOptions { dimension: Some(2), ..ReadOptions::default() };
    assert_eq!(read_with(&bytes, &options, Limits::default()).expect("a table").0.len(), 100);
    // The header of the first page: its type, then its size as a variable number of two bytes.
    assert_eq!(&bytes[4..7], [0x15, 0x00, 0x15], "a data page");
    let mut lying = bytes.clone();
    lying[7..9].copy_from_slice(&[0xff, 0x7f]);
    let error = read_with(&lying, &options, Limits::default()).expect_err("a size");
    assert!(error.to_string().contains("to hold at most"), "{error}");
    assert_eq!(error.place.tag.as_deref(), Some("row group, column 'external_id'"));
}

#[test]
fn batches_end_at_a_number_of_bytes_and_have_few_columns() {
    let points = Points::from_rows(2, vec![0.0; 4]);
    let mut record = Record::new(Geometry::Landmarks(points), Place::default());
    record.labels = (0..2000).map(|k| (format!("{k}"), Value::Number(f64::from(k)))).collect();
    record.metadata.insert("a".into(), "x".repeat(1 << 20).into());
    let mut rows = super::rows::Rows::new(&WriteOptions::default());
    let batch = (0..100).find_map(|_| rows.push(&record).expect("a row"));
    let batch = batch.expect("a batch before all rows");
    assert!((5..9).contains(&batch.num_rows()), "{}", batch.num_rows());
    assert!((1024..1050).contains(&batch.num_columns()), "{}", batch.num_columns());
    // Rows without the attributes of others have a cell for each all the same.
    let mut rows = super::rows::Rows::new(&WriteOptions::default());
    let bare = Record { labels: BTreeMap::new(), metadata: serde_json::Map::new(), ..record.clone() };
    for first in [true, false] {
        let wide = first.then_some(&record).into_iter();
        let batch =
            wide.chain(std::iter::repeat_n(&bare, 8192)).find_map(|row| rows.push(row).expect("a row"));
        assert_eq!(batch.expect("a batch").num_rows(), 2048, "{first}");
    }
    let mut bytes = Vec::new();
    let mut writer = super::arrow::FORMAT.writer(&mut bytes, &WriteOptions::default()).expect("a writer");
    writer.push(&record).expect("written");
    writer.finish().expect("the end");
    let (found, _) = read_back(&bytes).expect("a table");
    assert_eq!(found[0].labels, record.labels, "the others are in one column");
}
