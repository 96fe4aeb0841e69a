//! Features of every kind, faults with their places, and files that are read as they were written.

use super::super::{FaultKind, Geometry, Holes, Limits, Nuclei, Record, Value, WriteOptions};
use super::*;

fn read_with(
    text: &[u8],
    options: &ReadOptions,
    limits: Limits,
) -> Result<(Vec<Record>, Summary), FileError> {
    let mut records = Vec::new();
    let mut source = Source::new(text, limits)?;
    let summary = super::super::read(&FORMAT, &mut source, options, &mut |record| {
        records.push(record);
        Ok(())
    })?;
    Ok((records, summary))
}

fn read_all(text: &str) -> (Vec<Record>, Summary) {
    read_with(text.as_bytes(), &ReadOptions::default(), Limits::default()).expect("valid GeoJSON")
}

fn refused(text: &str) -> FileError {
    read_with(text.as_bytes(), &ReadOptions::default(), Limits::default()).expect_err(text)
}

fn written(records: &[Record]) -> String {
    let mut bytes = Vec::new();
    let mut writer = FORMAT.writer(&mut bytes, &WriteOptions::default()).expect("a writer");
    for record in records {
        writer.push(record).expect("written");
    }
    writer.finish().expect("the end");
    String::from_utf8(bytes).expect("text")
}

const CELL: &str = r#"{"type":"Feature","id":"e7ac14bf-1f34-4531-974f-08196f93867a","geometry":{"type":"Polygon","coordinates":[[[0,0],[4,0],[4,3.25],[0,0]],[[1,1],[2,1],[2,2],[1,1]]],"plane":{"c":-1,"z":2,"t":0}},"nucleusGeometry":{"type":"Polygon","coordinates":[[[1,0],[2,0],[2,1],[1,0]]]},"properties":{"objectType":"cell","name":"one","classification":{"name":"Tumor: Positive","color":[1,2,3]},"isLocked":true,"measurements":{"Area µm^2":6.5,"Empty":NaN}}}"#;

#[test]
fn a_cell_of_qupath_has_class_measurements_and_colours() {
    let (records, summary) = read_all(&format!("{{\"features\":[{CELL}],\"type\":\"FeatureCollection\"}}"));
    assert_eq!(records.len(), 1);
    let cell = &records[0];
    assert_eq!((cell.name.as_deref(), cell.label.as_deref()), (Some("one"), Some("Tumor: Positive")));
    assert_eq!(cell.labels.get("Area µm^2"), Some(&Value::Number(6.5)));
    let metadata = serde_json::json!({
        "objectType": "cell", "isLocked": true, "classification": {"color": [1, 2, 3]},
        "id": "e7ac14bf-1f34-4531-974f-08196f93867a", "geometry": {"plane": {"c": -1, "z": 2, "t": 0}},
    });
    assert_eq!(Json::Object(cell.metadata.clone()), metadata);
    let Geometry::Curve { points, closed: true } = &cell.geometry else { panic!("{cell:?}") };
    assert_eq!(points.coordinates(), [0.0, 0.0, 4.0, 0.0, 4.0, 3.25]);
    let dropped: Vec<_> = summary.dropped.iter().map(|d| (d.what.as_str(), d.count)).collect();
    assert_eq!(dropped, [("measurements without a number", 1), ("nuclei of cells", 1), ("holes", 1)]);
    assert_eq!(summary.warnings, ["1 features have NaN or Infinity, which is no JSON, taken as null"]);
    let options =
        ReadOptions { nuclei: Some(Nuclei::Keep), holes: Some(Holes::Keep), ..ReadOptions::default() };
    let (records, _) = read_with(CELL.as_bytes(), &options, Limits::default()).expect("a cell");
    let names: Vec<_> = records.iter().filter_map(|r| r.name.as_deref()).collect();
    assert_eq!(names, ["one", "one/2", "one/nucleus"]);
    assert!(records[1].ring.as_ref().is_some_and(|ring| ring.hole));
}

#[test]
fn every_type_of_geometry_is_read() {
    let text = r#"[{"type":"Point","coordinates":[1,2]},
        {"coordinates":[[1,2],[3,4]],"type":"MultiPoint"},
        {"type":"Feature","id":7,"properties":null,"geometry":{"type":"LineString","coordinates":[[1,2,9],[3,4,9]]}},
        {"type":"MultiLineString","coordinates":[[[0,0],[1,1]],[[2,2],[3,3],[4,5]]]},
        {"type":"GeometryCollection","geometries":[{"type":"Point","coordinates":[0,0]},
            {"type":"GeometryCollection","geometries":[{"type":"LineString","coordinates":[[0,0],[1,1]]}]}]},
        {"type":"MultiPolygon","coordinates":[[[[0,0],[1,0],[1,1],[0,0]]],[[[5,5],[6,5],[6,6]]]]},
        {"type":"Polygon","coordinates":[]},
        {"type":"Feature","geometry":null,"properties":{"name":"none"}}]"#;
    let (records, summary) = read_all(text);
    let kinds: Vec<_> = records
        .iter()
        .map(|record| match &record.geometry {
            Geometry::Curve { points, closed: true } => ("ring", points.len()),
            Geometry::Curve { points, closed: false } => ("line", points.len()),
            Geometry::Landmarks(points) => ("points", points.len()),
            other => panic!("{other:?}"),
        })
        .collect();
    let expected = [
        ("points", 1),
        ("points", 2),
        ("line", 2),
        ("line", 2),
        ("line", 3),
        ("points", 1),
        ("line", 2),
        ("ring", 3),
        ("ring", 3),
    ];
    assert_eq!(kinds, expected);
    assert_eq!(records[2].name.as_deref(), Some("7"));
    let dropped: Vec<_> = summary.dropped.iter().map(|d| (d.what.as_str(), d.count)).collect();
    assert_eq!(dropped, [("empty geometries", 1), ("features without geometry", 1)]);
    assert_eq!(summary.warnings, ["1 rings do not repeat their first point, taken as closed"]);
    assert_eq!(read_all(&written(&records)).0.len(), records.len());
}

#[test]
fn files_are_collections_lists_features_and_sequences_of_them() {
    let feature = r#"{"type":"Feature","geometry":{"type":"Point","coordinates":[1,2]},"properties":{"name":"a]}\"\\"}}"#;
    for text in [
        format!("\u{feff}{{\"type\":\"FeatureCollection\",\"features\":[{feature},{feature}]}}"),
        format!(
            "{{\"crs\":{{\"a\":[1]}},\"features\" : [ {feature} , {feature} ] , \"type\":\"FeatureCollection\",\"x\":1}}"
        ),
        format!("[{feature},\n{feature}]"),
        format!("{feature}\n{feature}\n"),
        format!("\u{1e}{feature}\n\u{1e}{feature}\n"),
        format!("{{\"type\":\"FeatureCollection\",\"features\":[]}} [{feature}] {feature}"),
    ] {
        let (records, _) = read_all(&text);
        let found: Vec<_> = records.iter().map(|r| (r.name.as_deref(), r.place.item)).collect();
        assert_eq!(found, [(Some("a]}\"\\"), Some(0)), (Some("a]}\"\\~2"), Some(1))], "{text}");
        let byte = records[1].place.byte.and_then(|byte| usize::try_from(byte).ok()).expect("an offset");
        assert!(text[byte..].starts_with("{\"type\":\"Feature\""), "{text}");
        assert!(recognise(text.as_bytes()), "{text}");
        assert!(std::ptr::eq(
            super::super::detect(text.as_bytes(), Some("a.json")).expect("a format"),
            &FORMAT
        ));
    }
    assert!(!recognise(b"{\"type\":\"Topology\"}") && !recognise(b"x{\"type\":\"Feature\"}"));
}

#[test]
fn records_come_back_as_they_were_written() {
    let text = format!("[{},{}]", CELL.replace("NaN", "1e-7"), CELL.replace("\"name\":\"one\",", ""));
    let options =
        ReadOptions { nuclei: Some(Nuclei::Keep), holes: Some(Holes::Keep), ..ReadOptions::default() };
    let (mut records, _) = read_with(text.as_bytes(), &options, Limits::default()).expect("cells");
    records[0].subject = Some("p1".into());
    records[1].subject = Some("p1".into());
    records[2].weight = Some(2.0);
    records[2].labels.insert("left".into(), Value::Bool(true));
    // The name of the second cell is its id; that of its nucleus is none.
    let (again, summary) =
        read_with(written(&records).as_bytes(), &options, Limits::default()).expect("cells");
    assert!(summary.dropped.is_empty() && summary.warnings.is_empty(), "{summary:?}");
    assert_eq!(again.len(), 6);
    for (a, b) in records.iter().zip(&again) {
        let bare = |record: &Record| Record { place: Place::default(), ring: None, ..record.clone() };
        assert_eq!(bare(a), bare(b));
        assert_eq!(a.ring.as_ref().map(|r| (r.part, r.hole)), b.ring.as_ref().map(|r| (r.part, r.hole)));
    }
    let bytes = [0.1, -0.0, 1e100, 5e-324, 123456789012345680.0, -7.0];
    let line = Geometry::Curve { points: super::super::Points::from_rows(2, bytes.to_vec()), closed: false };
    let text = written(&[Record::new(line.clone(), Place::default())]);
    let back = read_all(&text).0;
    let Geometry::Curve { points, .. } = &back[0].geometry else { panic!("{back:?}") };
    assert!(points.coordinates().iter().zip(bytes).all(|(a, b)| a.to_bits() == b.to_bits()), "{text}");
}

#[test]
fn metadata_do_not_replace_what_a_feature_says() {
    let (mut records, _) = read_all(CELL);
    records.truncate(1);
    let record = &mut records[0];
    for name in ["shapelex", "measurements", "name", "classification", "source"] {
        record.metadata.insert(name.into(), serde_json::json!([67.0]));
    }
    let mut bytes = Vec::new();
    let mut writer = FORMAT.writer(&mut bytes, &WriteOptions::default()).expect("a writer");
    writer.push(&records[0]).expect("a feature");
    let summary = writer.finish().expect("the end");
    let [dropped] = &summary.dropped[..] else { panic!("{summary:?}") };
    assert_eq!((dropped.what.as_str(), dropped.count), ("metadata with the name of a member", 4));
    let (again, _) = read_all(&String::from_utf8(bytes).expect("text"));
    let (a, b) = (&records[0], &again[0]);
    assert_eq!((&a.name, &a.label, &a.labels), (&b.name, &b.label, &b.labels));
    assert_eq!(b.metadata["source"], serde_json::json!([67.0]));
}

#[test]
fn a_property_called_geometry_is_kept() {
    let known = super::feature::KNOWN.map(|name| serde_json::json!({ name: [1], "plane": 0 }));
    for property in known.into_iter().chain(["round".into(), serde_json::json!({"plane": 0})]) {
        let text = format!(
            r#"{{"type":"Feature","properties":{{"geometry":{property}}},"geometry":{{"type":"Point","coordinates":[1,2]}}}}"#
        );
        let (records, _) = read_all(&text);
        assert_eq!(records[0].metadata["geometry"], property);
        let (again, summary) = read_all(&written(&records));
        assert_eq!((&again[0].geometry, &again[0].metadata["geometry"]), (&records[0].geometry, &property));
        assert!(summary.dropped.is_empty(), "{summary:?}");
    }
}

#[test]
fn members_do_not_replace_properties() {
    let text = r#"{"type":"Feature","properties":{"geometry":"round","colour":1},"colour":2,"stain":3,
        "geometry":{"type":"Point","coordinates":[1,2],"plane":{"z":1}}}"#;
    let (records, summary) = read_all(text);
    let metadata = serde_json::json!({"geometry": "round", "colour": 1, "stain": 3});
    assert_eq!(serde_json::Value::from(records[0].metadata.clone()), metadata);
    let [dropped] = &summary.dropped[..] else { panic!("{summary:?}") };
    assert_eq!((dropped.what.as_str(), dropped.count), ("members with the name of a property", 2));
}

#[test]
fn ids_may_name_the_shapes() {
    let options = ReadOptions { names: Some(super::super::Names::Id), ..ReadOptions::default() };
    let (records, _) = read_with(CELL.as_bytes(), &options, Limits::default()).expect("a cell");
    assert_eq!(records[0].name.as_deref(), Some("e7ac14bf-1f34-4531-974f-08196f93867a"));
    assert_eq!(records[0].metadata.get("name"), Some(&"one".into()));
    let (again, _) = read_with(written(&records).as_bytes(), &options, Limits::default()).expect("a cell");
    assert_eq!((&again[0].name, &again[0].metadata), (&records[0].name, &records[0].metadata));
}

#[test]
fn classes_and_measurements_of_older_versions() {
    let text = r#"{"type":"Feature","geometry":{"type":"Point","coordinates":[1,2]},"properties":{
        "classification":{"names":["Tumor","Positive"],"colorRGB":-377282},
        "measurements":[{"name":"a","value":1.5},{"name":"b","value":null}]}}"#;
    let (records, summary) = read_all(text);
    assert_eq!(records[0].label.as_deref(), Some("Tumor: Positive"));
    assert_eq!(records[0].labels.get("a"), Some(&Value::Number(1.5)));
    assert_eq!((summary.dropped[0].count, &summary.dropped[0].names[..]), (1, &["b".to_owned()][..]));
    let options = ReadOptions { select: Some("stroma".into()), ..ReadOptions::default() };
    let (records, summary) = read_with(text.as_bytes(), &options, Limits::default()).expect("nothing");
    assert!(records.is_empty() && summary.dropped.iter().any(|d| d.what == "features that are not selected"));
}

#[test]
fn faults_name_feature_and_byte() {
    let point = r#"{"type":"Point","coordinates":[0,1]}"#;
    for (text, kind, message) in [
        (
            String::new(),
            FaultKind::Truncated,
            "byte 0: expected a FeatureCollection, a Feature or a list of features, got the end of the file",
        ),
        (
            "7".into(),
            FaultKind::Malformed,
            "byte 0: expected a FeatureCollection, a Feature or a list of features, got '7'",
        ),
        (
            format!("[{point},{{\"type\":\"Point\",\"coordinates\":[0,x]}}]"),
            FaultKind::Malformed,
            "item 1, byte 71: expected a value, got another character",
        ),
        (
            format!("[{point},\n{{\"type\":\"Point\",\n\"coordinates\":[0]}}]"),
            FaultKind::Malformed,
            "item 1, byte 72: expected positions of 2 or 3 coordinates, got 1",
        ),
        (
            format!("[{point} {point}]"),
            FaultKind::Malformed,
            "item 0, byte 38: expected a comma or the end of the list, got '{'",
        ),
        (format!("[{point},]"), FaultKind::Malformed, "item 1, byte 38: expected a value, got ']'"),
        (
            "[{\"type\":\"Polygon\",\"coordinates\":[[0,1]]}]".into(),
            FaultKind::Malformed,
            "item 0, coordinates, byte 1: expected lists of positions as coordinates of a Polygon, got a list of positions",
        ),
    ] {
        let error = refused(&text);
        assert_eq!((error.kind, error.to_string().as_str()), (kind, message), "{text}");
    }
}

#[test]
fn faults_of_objects_name_feature_and_byte() {
    let point = r#"{"type":"Point","coordinates":[0,1]}"#;
    for (text, kind, message) in [
        (
            "[{\"type\":\"Topology\"}]".into(),
            FaultKind::Malformed,
            "item 0, byte 1: expected a Feature or a geometry, got type 'Topology'",
        ),
        (
            "{\"type\":\"Topology\",\"features\":[]}".into(),
            FaultKind::Malformed,
            "byte 0: expected the type \"FeatureCollection\" of an object with features, got \"Topology\"",
        ),
        (
            "{\"type\":\"Point\",\"type\":\"Point\",\"coordinates\":[0,1]}".into(),
            FaultKind::Malformed,
            "item 0, byte 21: expected the field \"type\" once, got it twice",
        ),
        (
            "[{\"type\":\"Point\",\"coordinates\":[0,1e101]}]".into(),
            FaultKind::Malformed,
            "item 0, byte 1: expected coordinates within ±1e100, got 1e101 in point 0",
        ),
        (
            format!("[{}", &point[..20]),
            FaultKind::Truncated,
            "item 0, byte 21: expected the end of a value, got the end of the file",
        ),
    ] {
        let error = refused(&text);
        assert_eq!((error.kind, error.to_string().as_str()), (kind, message), "{text}");
    }
    let error = read_with(
        b"[{\"type\":\"Point\",\"x\":\"\xff\",\"coordinates\":[0,1]}]",
        &ReadOptions::default(),
        Limits::default(),
    );
    assert_eq!(error.expect_err("no UTF-8").kind, FaultKind::Malformed);
}

#[test]
fn depth_and_size_of_features_are_bounded() {
    let options = ReadOptions::default();
    let deep = "[".repeat(100_000);
    let error = read_with(deep.as_bytes(), &options, Limits::default()).expect_err("too deep");
    assert_eq!(error.to_string(), "item 0, byte 66: expected at most 64 nested lists and objects, got more");
    let collections =
        format!("{}{}", "{\"type\":\"GeometryCollection\",\"geometries\":[".repeat(60), "]}".repeat(60));
    assert_eq!(refused(&collections).kind, FaultKind::TooLarge);
    let limits = Limits { held: 60, ..Limits::default() };
    let long = format!("[{{\"type\":\"Point\",\"coordinates\":[0,1],\"x\":\"{}\"}}]", "y".repeat(100));
    let error = read_with(long.as_bytes(), &options, limits).expect_err("too long");
    assert_eq!((error.kind, error.place.item), (FaultKind::TooLarge, Some(0)));
    let many = format!("[{}]", ["{\"type\":\"Point\",\"coordinates\":[0,1]}"; 50].join(","));
    assert_eq!(read_with(many.as_bytes(), &options, limits).expect("short features").0.len(), 50);
    let limits = Limits { points: 2, ..Limits::default() };
    let error = read_with(CELL.as_bytes(), &options, limits).expect_err("too many points");
    assert_eq!(error.to_string(), "item 0, byte 0: expected at most 2 points of a shape, got 3");
}

#[test]
fn files_that_end_early_are_refused() {
    let text = format!("{{\"type\":\"FeatureCollection\",\"features\":[{CELL}]}}");
    for end in 0..text.len() {
        let cut = &text.as_bytes()[..end];
        let error = read_with(cut, &ReadOptions::default(), Limits::default()).expect_err("cut off");
        assert_eq!(error.kind, FaultKind::Truncated, "{end}: {error}");
    }
}

/// Gives a byte at a time, so that every boundary of blocks is met.
struct Slow<'a>(&'a [u8]);

impl std::io::Read for Slow<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let count = self.0.len().min(buffer.len()).min(1);
        buffer[..count].copy_from_slice(&self.0[..count]);
        self.0 = &self.0[count..];
        Ok(count)
    }
}

#[test]
fn blocks_may_end_anywhere() {
    let text = format!("{{\"type\":\"FeatureCollection\",\"features\":[{}]}}", vec![CELL; 20].join(" ,\n"));
    let mut records = Vec::new();
    let mut source = Source::new(Slow(text.as_bytes()), Limits::default()).expect("a source");
    super::super::read(&FORMAT, &mut source, &ReadOptions::default(), &mut |record| {
        records.push(record);
        Ok(())
    })
    .expect("cells");
    assert_eq!(records, read_all(&text).0);
}

#[test]
fn what_features_say_is_small() {
    let ring = "[[[0,0],[1,0],[1,1],[0,0]]]";
    let feature = |properties: &str, geometry: &str| {
        format!(r#"[{{"type":"Feature","properties":{{{properties}}},"geometry":{geometry}}}]"#)
    };
    let polygon = format!(r#"{{"type":"Polygon","coordinates":{ring}}}"#);
    let many = format!(r#"{{"type":"Polygon","coordinates":[[{}[0,0]]]}}"#, "[0,0],[1,0],".repeat(50_000));
    let children = format!("\"childObjects\":[{}0]", "{\"a\":[0]},".repeat(50_000));
    assert_eq!(read_all(&feature("", &many)).0.len(), 1);
    assert_eq!(read_all(&feature(&children, &polygon)).1.dropped[0].count, 50_001);
    let text = "x".repeat(17 << 20);
    let small = "{\"a\":0},".repeat(50_000);
    for (text, place) in [
        (feature(&format!("\"a\":\"{text}\""), &polygon), "item 0, byte 1"),
        (feature(&format!("\"a\":[{small}0]"), &polygon), "item 0, byte 1"),
        (feature(&format!("\"a\":NaN,\"b\":[{small}0]"), &polygon), "item 0, byte 1"),
        (
            feature(
                "",
                &format!(r#"{{"type":"GeometryCollection","geometries":[{}{{}}]}}"#, "{},".repeat(50_000)),
            ),
            "item 0, byte 1",
        ),
        (format!(r#"{{"features":[],"a":[{small}0]}}"#), "byte 0"),
    ] {
        let error = refused(&text);
        assert_eq!(error.kind, FaultKind::TooLarge, "{error}");
        assert_eq!(error.place.to_string(), place, "{error}");
    }
    // A text that is no JSON is refused as such.
    assert_eq!(refused(&feature(&format!("\"a\":[{small}"), &polygon)).kind, FaultKind::Malformed);
}

/// A feature of lines of one point, with a property of some bytes.
fn feature_of_lines(count: usize, property: usize) -> String {
    let (lines, property) = ("[[0,0]],".repeat(count - 1), "x".repeat(property));
    format!(
        r#"{{"type":"Feature","properties":{{"a":"{property}"}},"geometry":{{"type":"MultiLineString","coordinates":[{lines}[[0,0]]]}}}}"#
    )
}

#[test]
fn rings_with_the_same_properties_count_as_content() {
    let text = feature_of_lines(1000, 10_000);
    let options = ReadOptions::default();
    let limits = |content: u64| Limits { content, ..Limits::default() };
    assert_eq!(read_with(text.as_bytes(), &options, limits(4 << 20)).expect("records").0.len(), 1000);
    let error = read_with(text.as_bytes(), &options, limits(1 << 20)).expect_err("4 MB");
    assert_eq!(error.kind, FaultKind::TooLarge);
    assert!(
        error.to_string().contains("expected shapes that take at most 4194304 bytes in memory in all"),
        "{error}"
    );
    let limits = Limits { points: 500, ..Limits::default() };
    let error = read_with(text.as_bytes(), &options, limits).expect_err("1000 lines");
    assert!(error.to_string().contains("expected at most 500 rings of an object, got 1000"), "{error}");
}

#[test]
fn a_writer_holds_the_properties_of_an_object_once() {
    let (records, _) = read_all(&feature_of_lines(100, 100_000));
    let mut writer = FORMAT.writer(std::io::sink(), &WriteOptions::default()).expect("a writer");
    for record in &records {
        writer.push(record).expect("written");
    }
    assert!((100_000..200_000).contains(&writer.held()), "{}", writer.held());
    assert_eq!(read_all(&written(&records)).0.len(), 100);
}

/// Items left out of a text: kind, number, names.
fn dropped(text: &str) -> Vec<(String, u64, String)> {
    read_all(text).1.dropped.into_iter().map(|d| (d.what, d.count, d.names.join(" "))).collect()
}

#[test]
fn members_without_a_place_are_counted() {
    let text = r#"{"type":"Feature","id":"x","coordinates":[1,2],"properties":{"name":"a","id":3},"geometry":{
        "type":"GeometryCollection","coordinates":[0,0],"plane":{"z":1},"id":4,"geometries":[
            {"type":"Point","coordinates":[0,1],"plane":{"z":2},"properties":{"b":1}},
            {"type":"Point","coordinates":[]},
            {"type":"GeometryCollection","geometries":[]}]}}"#;
    let expected = [
        ("members of features", 1, "coordinates"),
        ("properties with the name of a member", 1, "id"),
        ("members of geometries", 4, "id coordinates properties plane"),
        ("empty geometries", 2, "a a"),
    ];
    assert_eq!(dropped(text), expected.map(|(what, count, names)| (what.into(), count, names.into())));
    let (records, _) = read_all(text);
    let metadata = serde_json::json!({"id": "x", "geometry": {"plane": {"z": 1}}});
    assert_eq!((records.len(), Json::Object(records[0].metadata.clone())), (1, metadata));
    assert_eq!(records[0].name.as_deref(), Some("a"));
}

#[test]
fn members_of_other_types_are_kept() {
    let text = r#"{"type":"Feature","id":[7],"geometry":{"type":"Point","coordinates":[0,1]},
        "properties":{"classification":{"name":5,"names":["a",6]},"childObjects":[{},{},{}]}}"#;
    let metadata = serde_json::json!({"id": [7], "classification": {"name": 5, "names": ["a", 6]}});
    let (records, _) = read_all(text);
    assert_eq!((records[0].label.as_deref(), Json::Object(records[0].metadata.clone())), (None, metadata));
    assert_eq!(dropped(text), [("child objects".to_owned(), 3, String::new())]);
}

#[test]
fn members_twice() {
    let twice = [
        r#""type":"Point","type":"Point","coordinates":[0,1]"#,
        r#""type":"Point","coordinates":[0,1],"coordinates":[0,1]"#,
        r#""type":"Feature","geometry":{"type":"Point","coordinates":[0,1]},"geometry":{"type":"Point","coordinates":[0,1]}"#,
        r#""type":"Feature","properties":{"a":1},"properties":{"a":1}"#,
    ];
    for text in twice {
        assert!(refused(&format!("[{{{text}}}]")).to_string().ends_with(" once, got it twice"), "{text}");
    }
    let (records, _) = read_all(r#"{"type":"Point","coordinates":[0,1],"plane":1,"plane":2}"#);
    assert_eq!(records[0].metadata["geometry"], serde_json::json!({"plane": 2}));
}
