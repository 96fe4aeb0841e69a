//! Regions of every type, faults with their places, and files that are read as they were written.

use serde_json::json;

use super::super::{
    FaultKind, FileError, Geometry, Holes, Limits, Place, Points, ReadOptions, Record, Source, Summary,
    WriteOptions,
};
use super::*;
use crate::unit::Unit;

fn read(bytes: &[u8]) -> Result<(Vec<Record>, Summary), FileError> {
    let mut records = Vec::new();
    let mut source = Source::new(bytes, Limits::default())?;
    let options = ReadOptions { holes: Some(Holes::Keep), ..ReadOptions::default() };
    let summary = super::super::read(&FORMAT, &mut source, &options, &mut |record| {
        records.push(record);
        Ok(())
    })?;
    Ok((records, summary))
}

fn written(records: &[Record]) -> Result<(Vec<u8>, Summary), FileError> {
    let mut bytes = Vec::new();
    let mut writer = FORMAT.writer(&mut bytes, &WriteOptions::default())?;
    for record in records {
        writer.push(record)?;
    }
    let summary = writer.finish()?;
    Ok((bytes, summary))
}

fn curve(closed: bool, coordinates: &[f64]) -> Record {
    let points = Points::from_rows(2, coordinates.to_vec());
    Record::new(Geometry::Curve { points, closed }, Place::item(0))
}

/// A header of 64 bytes with a type and 16-bit numbers at offsets.
fn header(kind: u8, numbers: &[(usize, i16)]) -> Vec<u8> {
    let mut bytes = vec![0; HEADER];
    bytes[..8].copy_from_slice(&[b'I', b'o', b'u', b't', 0, 228, kind, 0]);
    for (at, number) in numbers {
        bytes[*at..at + 2].copy_from_slice(&number.to_be_bytes());
    }
    bytes
}

fn floats(numbers: &[f32]) -> Vec<u8> {
    numbers.iter().flat_map(|x| x.to_be_bytes()).collect()
}

fn points(record: &Record) -> &Points {
    match &record.geometry {
        Geometry::Curve { points, .. } | Geometry::Landmarks(points) => points,
        other => panic!("{other:?}"),
    }
}

#[test]
fn regions_come_back_as_they_were_written() {
    let mut polygon = curve(true, &[-3.0, 60000.0, 7.0, 60001.0, 7.0, 60535.0]);
    (polygon.name, polygon.label) = (Some("Zelle α".into()), Some("big".into()));
    let metadata = json!({
        "type": "traced", "stroke_color": "#ff00ff7f", "fill_color": "#12345678", "stroke_width": 2.5, "position": 7,
        "channel": 1, "slice": 2, "frame": 3, "group": 9, "properties": {"stain": "HE"},
    });
    polygon.metadata = metadata.as_object().expect("an object").clone();
    let mut angle = curve(false, &[0.0, 0.0, 1.0, 5.0, 1.0, 6.0]);
    angle.metadata.insert("type".into(), "angle".into());
    let point = Record::new(Geometry::Landmarks(Points::from_rows(2, vec![68.0, 77.25])), Place::item(0));
    let mut counted = point.clone();
    counted.metadata.insert("counters".into(), json!([7]));
    counted.metadata.insert("slices".into(), json!([70000]));
    for (record, kind) in [
        (polygon, "traced"),
        (angle, "angle"),
        (curve(true, &[0.5, 0.0, 1.0, 5.0, 1.0, 6.0]), "polygon"),
        (curve(true, &[1e6, 0.0, 1e6, 5.0, -1e6, 6.0]), "polygon"),
        (curve(false, &[0.5, 0.0, 1.0, 5.0]), "line"),
        (curve(false, &[1.0, 0.0, 1.0, 5.0, 3.0, 1.0, 9.0, 9.0]), "polyline"),
        (point, "point"),
        (counted, "point"),
    ] {
        let (bytes, summary) = written(std::slice::from_ref(&record)).expect("written");
        assert!(summary.warnings.is_empty(), "{summary:?}");
        let (again, summary) = read(&bytes).expect("read");
        assert_eq!((again.len(), summary.records), (1, 1));
        assert_eq!(again[0].metadata.get("type"), Some(&kind.into()));
        let mut expected = Record { unit: Some(Unit::Pixel), ..record.clone() };
        expected.metadata.insert("type".into(), kind.into());
        assert_eq!(again[0], expected);
        for end in 0..HEADER.min(bytes.len()) {
            assert_eq!(read(&bytes[..end]).expect_err("cut off").kind, FaultKind::Truncated, "{end}");
        }
        for end in HEADER..bytes.len() {
            assert_eq!(read(&bytes[..end]).expect_err("cut off").kind, FaultKind::Truncated, "{kind} {end}");
        }
    }
    let many = curve(true, &(0..140_000).map(|k| f64::from(k % 1000)).collect::<Vec<_>>());
    let (bytes, _) = written(std::slice::from_ref(&many)).expect("written");
    assert_eq!(points(&read(&bytes).expect("read").0[0]), points(&many));
    let (_, summary) = written(&[curve(true, &[0.1, 0.0, 1.0, 5.0, 1.0, 6.0])]).expect("written");
    assert_eq!(summary.warnings, ["1 coordinates are rounded to single precision"]);
}

#[test]
fn composites_come_back_with_their_holes() {
    let path = [
        0.0, 2.0, 2.0, 1.0, 4.0, 2.0, 1.0, 4.0, 4.0, 4.0, 0.0, 0.0, 0.0, 1.0, 9.0, 0.0, 1.0, 9.0, 9.0, 1.0,
        0.0, 9.0, 1.0, 0.0, 0.0, 4.0, 0.0, 20.0, 0.0, 2.0, 25.0, 10.0, 30.0, 0.0, 3.0, 28.0, -4.0, 22.0,
        -4.0, 20.0, 0.0, 4.0,
    ];
    let mut bytes = header(RECTANGLE, &[]);
    bytes[36..40].copy_from_slice(&(path.len() as i32).to_be_bytes());
    bytes.extend(floats(&path));
    let (records, _) = read(&bytes).expect("a composite");
    let rings: Vec<_> = records.iter().filter_map(|r| r.ring.as_ref()).map(|r| (r.part, r.hole)).collect();
    assert_eq!(rings, [(0, false), (0, true), (1, false)]);
    assert_eq!(points(&records[1]).coordinates(), [2.0, 2.0, 4.0, 2.0, 4.0, 4.0]);
    assert!(points(&records[2]).len() > 20);
    // Least and greatest y of the two curves: 5 and −3, within the tolerance of their chords.
    let y: Vec<f64> = points(&records[2]).rows().map(|row| row[1]).collect();
    let ends = [y.iter().copied().fold(0.0, f64::min), y.iter().copied().fold(0.0, f64::max)];
    assert!((ends[0] + 3.0).abs() < 0.01 && (ends[1] - 5.0).abs() < 0.01, "{ends:?}");
    let (bytes, _) = written(&records).expect("written");
    let (again, _) = read(&bytes).expect("read");
    assert_eq!(again.len(), 3);
    for (a, b) in records.iter().zip(&again) {
        let near =
            points(a).coordinates().iter().zip(points(b).coordinates()).all(|(a, b)| (a - b).abs() < 1e-5);
        assert!(near && a.ring == b.ring && points(a).len() == points(b).len());
    }
}

#[test]
fn rectangles_and_ovals_are_outlines() {
    let bounds = [(8, 19), (10, 43), (12, 55), (14, 86)];
    let (records, _) = read(&header(RECTANGLE, &bounds)).expect("a rectangle");
    assert_eq!(points(&records[0]).coordinates(), [43.0, 19.0, 86.0, 19.0, 86.0, 55.0, 43.0, 55.0]);
    let (records, _) = read(&header(2, &bounds)).expect("an oval");
    assert!(points(&records[0]).len() > 50);
    let mut rounded = header(RECTANGLE, &bounds);
    rounded[55] = 10;
    assert!(points(&read(&rounded).expect("a rectangle").0[0]).len() > 20);
    let mut fractions = header(RECTANGLE, &[(50, 128)]);
    fractions[18..34].copy_from_slice(&floats(&[0.5, 1.5, 2.0, 3.0]));
    let (records, _) = read(&fractions).expect("a rectangle");
    assert_eq!(points(&records[0]).coordinates(), [0.5, 1.5, 2.5, 1.5, 2.5, 4.5, 0.5, 4.5]);
}

#[test]
fn drawings_are_counted() {
    for (kind, subtype, what) in
        [(RECTANGLE, 1, "texts"), (RECTANGLE, 4, "images"), (6, 0, "empty regions"), (0, 0, "empty regions")]
    {
        let (records, summary) = read(&header(kind, &[(48, subtype)])).expect("a drawing");
        assert_eq!((records.len(), summary.dropped[0].what.as_str()), (0, what));
    }
}

#[test]
fn counts_and_offsets_are_claims() {
    let path = |length: i32, numbers: &[f32]| {
        let mut bytes = header(RECTANGLE, &[]);
        bytes[36..40].copy_from_slice(&length.to_be_bytes());
        bytes.extend(floats(numbers));
        bytes
    };
    let with = |kind: u8, at: usize, number: i32| {
        let mut bytes = header(kind, &[]);
        bytes[at..at + 4].copy_from_slice(&number.to_be_bytes());
        bytes
    };
    for (bytes, message) in [
        (header(0, &[(16, -1)]), "byte 64: expected 262140 bytes, got 0 up to the end of the file"),
        (with(0, 18, i32::MAX), "byte 18: expected at most 4194304 points of a shape, got 2147483647"),
        (with(0, 18, -5), "byte 18: expected a number of points of at least 0, got -5"),
        (with(0, 60, -5), "byte 60: expected an offset of at least 0, got -5"),
        (with(0, 60, i32::MAX), "byte 2147483647: expected 64 bytes, got 0 up to the end of the file"),
        (with(11, 60, 0), "byte 6: expected a type of at most 10, got 11"),
        (with(2, 36, 4), "byte 6: expected the type 1 of a composite, got 2"),
        (path(-1, &[]), "byte 36: expected a length of a path of at least 0, got -1"),
        (path(i32::MAX, &[]), "byte 64: expected 8589934588 bytes, got 0 up to the end of the file"),
        (path(1, &[7.0]), "byte 64: expected a command of a path from 0 to 4, got 7"),
        (path(2, &[0.0, 1.0]), "byte 64: expected 2 numbers of a command, got the end of the path"),
        (path(3, &[0.0, 1.0, f32::NAN]), "byte 72: expected a finite coordinate, got NaN"),
        (
            path(5, &[2.0, 1.0, 1.0, 1.0, 1.0]),
            "byte 64: expected a command that begins a path before a curve, got none",
        ),
        (vec![0; 64], "byte 0: expected an ImageJ ROI that begins with 'Iout', got other bytes"),
    ] {
        assert_eq!(read(&bytes).expect_err(message).to_string(), message);
    }
    let mut little = header(0, &[(16, 3)]);
    little[4..6].copy_from_slice(&228_u16.to_le_bytes());
    assert!(read(&little).is_err());
}

#[test]
fn a_file_holds_one_region() {
    let line = curve(false, &[0.0, 0.0, 1.0, 1.0]);
    let message = |records: &[Record]| written(records).expect_err("refused").to_string();
    assert_eq!(message(&[]), "expected one shape, as a file of ImageJ ROI holds, got none");
    let second = message(&[line.clone(), Record { name: Some("b".into()), ..line.clone() }]);
    assert_eq!(second, "item 0: expected one shape, as a file of ImageJ ROI holds, got a second one, 'b'");
    let space = Record::new(Geometry::Landmarks(Points::from_rows(3, vec![0.0; 3])), Place::default());
    assert_eq!(
        message(&[space]),
        "expected curves and points that ImageJ ROI can hold, got points of 3 coordinates"
    );
    let far = curve(false, &[0.0, 0.0, 1e40, 1.0]);
    assert_eq!(
        message(&[far]),
        "item 0: expected curves and points that ImageJ ROI can hold, got a coordinate 1e40 beyond single precision"
    );
}
