use super::super::options::Holes;
use super::super::testing::{self, converted};
use super::super::{FaultKind, Limits, find};
use super::*;

fn records(text: &str, limits: Limits) -> Result<Vec<Record>, FileError> {
    let mut found = Vec::new();
    let mut source = Source::new(text.as_bytes(), limits)?;
    let format = find("ndjson").expect("a format");
    super::super::read(format, &mut source, &ReadOptions::default(), &mut |record| {
        found.push(record);
        Ok(())
    })?;
    Ok(found)
}

#[test]
fn lines_come_back_as_they_were_written() {
    let text = concat!(
        r#"{"points":[[0.1,0.0],[2.0,0.0],[2.0,1e-7]],"closed":true,"external_id":"a","label":"x","labels":{"age":61,"left":true}}"#,
        "\n",
        r#"{"points":[[0.0,0.0,1.0],null]}"#,
        "\n",
        r#"{"vertices":[[0.0,0.0,0.0],[1.0,0.0,0.0],[0.0,1.0,0.0]],"faces":[[0,1,2]],"fields":{"t":{"on":"faces","width":1,"values":[null]}}}"#,
        "\n",
        r#"{"fourier":{"constant":[0.0,1.0],"cosine":[[1.0,0.0]],"sine":[[0.0,1.0]]},"metadata":{"a":[1,2]}}"#,
        "\n",
    );
    let found = records(text, Limits::default()).expect("valid lines");
    assert_eq!(found.iter().map(|r| r.geometry.kind()).collect::<Vec<_>>(), FORMAT.kinds);
    let mut bytes = Vec::new();
    let mut writer = FORMAT.writer(&mut bytes, &WriteOptions::default()).expect("a writer");
    for record in &found {
        writer.push(record).expect("written");
    }
    assert_eq!(writer.finish().expect("the end").records, 4);
    assert_eq!(String::from_utf8(bytes).expect("text"), text);
}

#[test]
fn rings_of_an_object_come_back_as_such() {
    let coordinates =
        "[[[[0,0],[9,0],[9,9],[0,0]],[[4,1],[6,1],[6,3],[4,1]]],[[[20,0],[29,0],[29,9],[20,0]]]]";
    let geometry = format!(r#"{{"type":"MultiPolygon","coordinates":{coordinates}}}"#);
    let feature = |name: &str| {
        format!(r#"{{"type":"Feature","geometry":{geometry},"properties":{{"name":"{name}"}}}}"#)
    };
    let features = format!("[{},{}]", feature("a"), feature("b"));
    let geojson = find("geojson").expect("a format");
    let options = ReadOptions { holes: Some(Holes::Keep), ..ReadOptions::default() };
    let (found, _) = testing::records(geojson, &features, &options).expect("features");
    let mut again = records(&converted(&FORMAT, &found), Limits::default()).expect("lines");
    for (record, before) in again.iter_mut().zip(&found) {
        record.place = before.place.clone();
    }
    assert_eq!(again, found);
    let rings: Vec<_> = again.iter().flat_map(|r| &r.ring).map(|r| (r.object, r.part, r.hole)).collect();
    let of = |object: u64| [(object, 0, false), (object, 0, true), (object, 1, false)];
    assert_eq!(rings, [of(0), of(1)].concat());
    let text = converted(geojson, &again);
    assert_eq!(text.matches(coordinates).count(), 2, "{text}");
}

#[test]
fn other_rings_are_refused() {
    let line = |ring: &str| format!(r#"{{"points":[[0,1]],"ring":{ring}}}"#);
    for ring in [
        "7",
        "[0,0,true]",
        r#"{"object":0,"part":0}"#,
        r#"{"object":0,"part":-1,"hole":true}"#,
        r#"{"object":0.5,"part":0,"hole":true}"#,
        r#"{"object":0,"part":0,"hole":1}"#,
        r#"{"object":0,"part":0,"hole":true,"a":0}"#,
    ] {
        let error = records(&format!("\n{}", line(ring)), Limits::default()).expect_err(ring);
        let message = format!(
            "ring, line 2: expected whole numbers up to 2⁵³ as object and part, and true or false as hole, got {}",
            shown(ring)
        );
        assert_eq!((error.kind, error.to_string()), (FaultKind::Malformed, message));
    }
    let most = 1_u64 << 53;
    let text = |object: u64| line(&format!(r#"{{"object":{object},"part":0,"hole":false}}"#));
    let found = records(&text(most), Limits::default()).expect("the largest number");
    assert_eq!(found[0].ring, Some(Ring { object: most, part: 0, hole: false }));
    assert!(records(&text(most + 1), Limits::default()).is_err());
    assert_eq!(records(&line("null"), Limits::default()).expect("none")[0].ring, None);
}

#[test]
fn files_are_recognised_by_their_first_field() {
    for (text, expected) in [
        ("{\"points\": []}", true),
        ("\u{feff}\n { \"external_id\":\"a\"}", true),
        ("{\"pointsets\": []}", false),
        ("{\"type\": \"FeatureCollection\"}", false),
        ("[{\"points\": []}]", false),
        ("", false),
    ] {
        assert_eq!(recognise(text.as_bytes()), expected, "{text}");
    }
}

#[test]
fn large_labels_and_metadata_are_refused_before_they_are_parsed() {
    let text = format!("{{\"points\":[],\"metadata\":{{\"a\":[{}0]}}}}", "0,".repeat(1 << 19));
    let error = records(&text, Limits::default()).expect_err("too large");
    assert_eq!((error.kind, error.place.tag.as_deref()), (FaultKind::TooLarge, Some("metadata")));
}

#[test]
fn faults_name_their_line() {
    for (text, kind, message) in [
        (
            "\n{\"points\":[[0,1],[2]]}",
            FaultKind::Malformed,
            "line 2: expected 2 coordinates, got 1 in point 1",
        ),
        (
            // Each missing point would take as much memory as the long one.
            "{\"points\":[null,null,[0,1,2,3,4,5,6,7,8,9,10,11,12,13,14,15,16],null]}",
            FaultKind::Malformed,
            "line 1: expected at most 16 coordinates, got 17 in point 2",
        ),
        (
            "{\"points\":[[0,1e101]]}",
            FaultKind::Malformed,
            "line 1: expected coordinates within ±1e100, got 1e101 in point 0",
        ),
        (
            "{\"vertices\":[[0,1,2]],\"faces\":[[0,0,7]]}",
            FaultKind::Malformed,
            "line 1: expected indices of vertices below 1, got 7 in face 0",
        ),
        (
            "{\"point\":[]}",
            FaultKind::Malformed,
            "column 8, line 1: expected one of \"points\", \"closed\", \"vertices\", \"faces\", \"fields\", \"fourier\", \
             \"external_id\", \"subject\", \"label\", \"labels\", \"weight\", \"metadata\", \"ring\" as the name of a field, \
             got \"point\"",
        ),
    ] {
        let error = records(text, Limits::default()).expect_err("a fault");
        assert_eq!((error.kind, error.to_string().as_str()), (kind, message));
    }
    let limits = Limits { records: 1, ..Limits::default() };
    let error = records("{\"points\":[]}\n{\"points\":[]}\n", limits).expect_err("too many");
    assert_eq!(error.to_string(), "line 2: expected at most 1 shapes, got more");
    let limits = Limits { held: 10, ..Limits::default() };
    let error = records("{\"points\":[]}\n", limits).expect_err("too long");
    assert_eq!(error.to_string(), "line 1: expected lines of at most 10 bytes, got a longer one");
}

#[test]
fn options_of_other_formats_are_refused() {
    let mut source = Source::new(&b""[..], Limits::default()).expect("a source");
    let options = ReadOptions { select: Some("*".into()), ..ReadOptions::default() };
    let error = super::super::read(&FORMAT, &mut source, &options, &mut |_| Ok(())).expect_err("an option");
    assert_eq!(error.to_string(), "select: expected options of NDJSON (closed, attributes), got select");
}
