//! Lines of every type, with ids, and lines that are wrong.

use super::super::{FaultKind, Holes, Limits, WriteOptions};
use super::*;

fn read_with(text: &str, limits: Limits) -> Result<(Vec<Record>, Summary), FileError> {
    let mut records = Vec::new();
    let mut source = Source::new(text.as_bytes(), limits)?;
    let options = ReadOptions { holes: Some(Holes::Keep), ..ReadOptions::default() };
    let summary = super::super::read(&FORMAT, &mut source, &options, &mut |record| {
        records.push(record);
        Ok(())
    })?;
    Ok((records, summary))
}

fn read_all(text: &str) -> (Vec<Record>, Summary) {
    read_with(text, Limits::default()).expect("valid lines")
}

fn written(records: &[Record]) -> String {
    let mut bytes = Vec::new();
    let mut writer = FORMAT.writer(&mut bytes, &WriteOptions::default()).expect("a writer");
    records.iter().for_each(|record| writer.push(record).expect("written"));
    writer.finish().expect("the end");
    String::from_utf8(bytes).expect("text")
}

#[test]
fn lines_come_back_as_they_were_written() {
    let text = concat!(
        "POINT (1 2)\n",
        "b\tSRID=4326;MULTIPOINT (1 2, 3 4.5)\n",
        "c d\tLINESTRING Z (1 2 3, 4 5 -0.125)\n",
        "\"e,\"\"f\"\tPOLYGON ((0 0, 4 0, 4 3, 0 0), (1 1, 2 1, 2 2, 1 1))\n",
        "g\tMULTILINESTRING ((0 0, 1 1), (2 2, 3 3, 1e-7 1e+100))\n",
        "h\tMULTIPOLYGON (((0 0, 4 0, 4 3, 0 0)), ((10 0, 14 0, 14 3, 10 0)))\n",
        "\"wkt\"\tGEOMETRYCOLLECTION (POINT (0 0), LINESTRING (0 0, 1 1), POLYGON ((0 0, 1 0, 1 1, 0 0)))\n",
    );
    let (records, summary) = read_all(text);
    assert_eq!(records.len(), 12);
    assert!(summary.dropped.is_empty());
    let names: Vec<_> = records.iter().filter_map(|r| r.name.as_deref()).collect();
    assert_eq!(names, ["b", "c d", "e,\"f", "e,\"f/2", "g", "g/2", "h", "h/2", "wkt", "wkt/2", "wkt/3"]);
    assert_eq!(written(&records), text);
    assert!(recognise(text) && !recognise("pointed (1 2)") && !recognise("POINT"));
}

fn recognise(text: &str) -> bool {
    (FORMAT.recognise)(text.as_bytes())
}

#[test]
fn ids_stand_before_or_behind_and_forms_vary() {
    let text = concat!(
        "\u{feff}id,WKT\r\n",
        "7,\"POLYGON((0 0,4 0,4 3,0 0))\"\r\n",
        "# a comment\n",
        "srid=4326;Point(1 2)\t8\n",
        "\"MULTIPOINT((1 2),(3 4))\",\"a \"\"b\"\"\"\n",
        "POINTZM(1 2 3 4)\n",
        "LINESTRING M (1 2 9, 3 4 9);x\n",
        "point\tLINEARRING (0 0, 1 0, 1 1, 0 0)\n",
        "POLYGON EMPTY\n",
        "GEOMETRYCOLLECTION(POINT EMPTY,MULTIPOLYGON EMPTY)\n",
    );
    let (records, summary) = read_all(text);
    let found: Vec<_> = records.iter().map(|r| (r.name.as_deref(), r.place.line, r.place.item)).collect();
    let expected = [
        (Some("7"), Some(2), Some(0)),
        (Some("8"), Some(4), Some(1)),
        (Some("a \"b\""), Some(5), Some(2)),
        (None, Some(6), Some(3)),
        (Some("x"), Some(7), Some(4)),
        (Some("point"), Some(8), Some(5)),
    ];
    assert_eq!(found, expected);
    assert_eq!(records[1].metadata.get("srid"), Some(&4326.into()));
    let Geometry::Landmarks(points) = &records[3].geometry else { panic!("{records:?}") };
    assert_eq!(points.coordinates(), [1.0, 2.0, 3.0]);
    assert!(matches!(&records[5].geometry, Geometry::Curve { points, closed: true } if points.len() == 3));
    let dropped: Vec<_> = summary.dropped.iter().map(|d| (d.what.as_str(), d.count)).collect();
    assert_eq!(dropped, [("measures of points", 2), ("empty geometries", 2)]);
}

#[test]
fn faults_name_line_and_column() {
    for (text, kind, message) in [
        (
            "\nPOINT (1 x)",
            FaultKind::Malformed,
            "item 0, column 8, line 2: expected positions of 2 or 3, or those of Z, M and ZM, coordinates, got 1",
        ),
        (
            "POINT (1 2",
            FaultKind::Malformed,
            "item 0, column 11, line 1: expected ')', got the end of the line",
        ),
        (
            "POINT (1 2) 7",
            FaultKind::Malformed,
            "item 0, column 13, line 1: expected the end of the line, got '7'",
        ),
        (
            "POINT (1 2, 3 4)",
            FaultKind::Malformed,
            "item 0, column 1, line 1: expected one position of a POINT, got 2",
        ),
        (
            "LINESTRING (1 2, 3 4 5)",
            FaultKind::Malformed,
            "item 0, column 18, line 1: expected positions of 2 coordinates, got 3",
        ),
        (
            "a\tTRIANGLE ((0 0, 1 0, 1 1, 0 0))",
            FaultKind::Unsupported,
            "item 0, column 3, line 1: expected one of POINT, LINESTRING, LINEARRING, POLYGON, MULTIPOINT, MULTILINESTRING, MULTIPOLYGON, GEOMETRYCOLLECTION, got 'TRIANGLE'",
        ),
        (
            "hello",
            FaultKind::Malformed,
            "item 0, column 6, line 1: expected a geometry, such as POLYGON ((0 0, 1 0, 0 1, 0 0)), got the end of the line",
        ),
        ("POINT (1 1-2)", FaultKind::Malformed, "item 0, column 10, line 1: expected a number, got '1'"),
        (
            "POLYGON (EMPTY)",
            FaultKind::Malformed,
            "item 0, column 10, line 1: expected the positions of a ring, got EMPTY",
        ),
        (
            "POINT (1e999 0)",
            FaultKind::Malformed,
            "item 0, line 1: expected coordinates within ±1e100, got inf in point 0",
        ),
        ("\"a", FaultKind::Malformed, "item 0, column 2, line 1: expected a quotation mark, got 'a'"),
        (
            "SRID=x;POINT (1 2)",
            FaultKind::Malformed,
            "item 0, column 6, line 1: expected the number of a system of reference, got 'x'",
        ),
    ] {
        let error = read_with(text, Limits::default()).expect_err(text);
        assert_eq!((error.kind, error.to_string().as_str()), (kind, message), "{text}");
    }
}

#[test]
fn depth_ends_and_points_are_checked() {
    let deep = "GEOMETRYCOLLECTION (".repeat(100_000);
    assert_eq!(read_with(&deep, Limits::default()).expect_err("too deep").kind, FaultKind::TooLarge);
    let line = "a\tPOLYGON Z ((0 0 1, 4 0 1, 4 3 1, 0 0 1), (1 1 1, 2 1 1, 2 2 1, 1 1 1))";
    for end in 2..line.len() {
        assert!(read_with(&line[..end], Limits::default()).is_err(), "{}", &line[..end]);
    }
    let limits = Limits { points: 2, ..Limits::default() };
    assert_eq!(read_with(line, limits).expect_err("too many").kind, FaultKind::TooLarge);
}

#[test]
fn what_a_line_cannot_say_is_counted() {
    let points = Points::from_rows(2, vec![0.0, 0.0, 1.0, 0.0, 0.0, 1.0]);
    let mut record = Record::new(Geometry::Curve { points, closed: true }, Place::default());
    (record.name, record.label, record.weight) = (Some("a".into()), Some("b".into()), Some(2.0));
    record.metadata.insert("srid".into(), 4326.into());
    record.metadata.insert("scanner".into(), 7.into());
    let mut writer = FORMAT.writer(std::io::sink(), &WriteOptions::default()).unwrap();
    writer.push(&record).unwrap();
    let summary = writer.finish().unwrap();
    let dropped: Vec<_> = summary.dropped.iter().map(|d| (d.what.as_str(), d.names.join(" "))).collect();
    assert_eq!(
        dropped,
        [("label", "a"), ("weight", "a"), ("metadata", "scanner")].map(|(k, n)| (k, n.to_owned()))
    );
}
