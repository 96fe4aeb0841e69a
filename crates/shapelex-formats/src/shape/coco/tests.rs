//! Annotations of every kind, and files that are wrong.

use super::super::{
    FaultKind, FileError, Geometry, Limits, Place, Points, ReadOptions, Record, Ring, Source, Summary, Value,
    WriteOptions,
};
use super::*;

fn read_with(text: &str, options: &ReadOptions) -> Result<(Vec<Record>, Summary), FileError> {
    let mut records = Vec::new();
    let mut source = Source::new(text.as_bytes(), Limits::default())?;
    let summary = super::super::read(&FORMAT, &mut source, options, &mut |record| {
        records.push(record);
        Ok(())
    })?;
    Ok((records, summary))
}

fn written(records: &[Record]) -> Result<String, FileError> {
    let mut bytes = Vec::new();
    let mut writer = FORMAT.writer(&mut bytes, &WriteOptions::default())?;
    for record in records {
        writer.push(record)?;
    }
    writer.finish()?;
    Ok(String::from_utf8(bytes).expect("text"))
}

const TEXT: &str = r#"{"info":{"images":[]},"images":[{"id":9,"file_name":"a.png","width":40,"height":30}],
"annotations":[
{"id":1,"image_id":9,"category_id":3,"iscrowd":0,"area":6,"bbox":[0,0,4,3],"segmentation":[[0,0,4,0,4,3,0,0]],"score":0.5,"attributes":{"occluded":false,"list":[1]}},
{"id":2,"image_id":9,"category_id":3,"iscrowd":0,"segmentation":[[0,0,4,0,4,3],[10,0,14,0,14.5,3]]},
{"id":3,"image_id":9,"category_id":4,"iscrowd":1,"segmentation":{"counts":[6,1,40],"size":[5,5]}},
{"id":4,"image_id":9,"category_id":4,"keypoints":[1,2,2,0,0,0,3,4,1],"num_keypoints":2},
{"id":5,"image_id":9,"category_id":77,"bbox":[0,0,1,1]}],
"categories":[{"id":3,"name":"cell","supercategory":"x"},{"id":4,"name":"nerve"}]}"#;

#[test]
fn annotations_have_category_image_and_attributes() {
    let (records, summary) = read_with(TEXT, &ReadOptions::default()).expect("annotations");
    let found: Vec<_> =
        records.iter().map(|r| (r.name.as_deref(), r.label.as_deref(), r.ring.clone())).collect();
    let ring = |part| Some(Ring { object: 1, part, hole: false });
    let expected = [
        (Some("1"), Some("cell"), None),
        (Some("2"), Some("cell"), ring(0)),
        (Some("2/2"), Some("cell"), ring(1)),
        (Some("4"), Some("nerve"), None),
    ];
    assert_eq!(found, expected);
    assert_eq!(records[0].metadata["image"]["file_name"], "a.png");
    let labels: Vec<_> =
        records[0].labels.iter().map(|(name, value)| (name.as_str(), value.clone())).collect();
    assert_eq!(labels, [("occluded", Value::Bool(false)), ("score", Value::Number(0.5))]);
    let Geometry::Landmarks(points) = &records[3].geometry else { panic!("{records:?}") };
    assert_eq!((points.len(), points.missing()), (3, vec![1]));
    let dropped: Vec<_> = summary.dropped.iter().map(|d| (d.what.as_str(), d.count)).collect();
    let expected = [
        ("attributes that are no text, number or Boolean", 1),
        ("masks", 1),
        ("annotations without outline", 1),
    ];
    assert_eq!(dropped, expected);
    assert_eq!(summary.warnings.len(), 1);
    let byte = records[1].place.byte.and_then(|byte| usize::try_from(byte).ok()).expect("an offset");
    assert!(TEXT[byte..].starts_with("{\"id\":2"));
    let options = ReadOptions { select: Some("n*".into()), ..ReadOptions::default() };
    assert_eq!(read_with(TEXT, &options).expect("nerves").0.len(), 1);
    assert!(
        recognise(TEXT.as_bytes())
            && recognise(b" {\"info\":{},\"images\" : [")
            && !recognise(b"{\"a\":{\"images\":[]}}")
    );
}

#[test]
fn records_come_back_as_they_were_written() {
    let (records, _) = read_with(TEXT, &ReadOptions::default()).expect("annotations");
    let mut records = records;
    records[0].name = Some("the first".into());
    records[0].label = None;
    let text = written(&records).expect("written");
    assert!(recognise(text.as_bytes()));
    let (again, _) = read_with(&text, &ReadOptions::default()).expect("annotations");
    records[0].label = Some("object".into());
    assert_eq!(again.len(), records.len());
    for (a, b) in records.iter().zip(&again) {
        let bare = |record: &Record| {
            let mut record = Record { place: Place::default(), ring: None, ..record.clone() };
            record.metadata.entry("iscrowd").or_insert(0.into());
            let missing = match &record.geometry {
                Geometry::Landmarks(points) => points.missing(),
                _ => Vec::new(),
            };
            // NaN, which stands for a missing coordinate, is not equal to itself.
            if !missing.is_empty() {
                record.geometry = Geometry::Landmarks(Points::new(2));
            }
            (record, missing)
        };
        assert_eq!(bare(a), bare(b));
    }
    let json: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    assert_eq!(json["annotations"][0]["area"], 6.0);
    assert_eq!(json["annotations"][1]["bbox"], serde_json::json!([0.0, 0.0, 14.5, 3.0]));
    assert_eq!(json["images"].as_array().map(Vec::len), Some(1));
}

#[test]
fn metadata_do_not_replace_what_an_annotation_says() {
    let (records, _) = read_with(TEXT, &ReadOptions::default()).expect("annotations");
    let mut record = records[0].clone();
    for name in ["segmentation", "area", "id", "name", "category_id", "attributes", "score", "source"] {
        record.metadata.insert(name.into(), serde_json::json!([67.0]));
    }
    let mut bytes = Vec::new();
    let mut writer = FORMAT.writer(&mut bytes, &WriteOptions::default()).expect("a file");
    writer.push(&record).expect("an annotation");
    let summary = writer.finish().expect("a file");
    let [dropped] = &summary.dropped[..] else { panic!("{summary:?}") };
    assert_eq!((dropped.what.as_str(), dropped.count), ("metadata with the name of a member", 7));
    let text = String::from_utf8(bytes).expect("text");
    let (again, _) = read_with(&text, &ReadOptions::default()).expect("annotations");
    assert_eq!((&again[0].geometry, &again[0].labels), (&record.geometry, &record.labels));
    assert_eq!(again[0].metadata["source"], serde_json::json!([67.0]));
}

#[test]
fn what_does_not_fit_is_refused_by_name() {
    let points = Points::from_rows(2, vec![0.0, 0.0, 1.0, 0.0, 1.0, 1.0]);
    let curve = |closed, hole| Record {
        name: Some("a".into()),
        ring: Some(Ring { object: 0, part: 0, hole }),
        ..Record::new(Geometry::Curve { points: points.clone(), closed }, Place::default())
    };
    let message = |records: &[Record]| written(records).expect_err("refused").to_string();
    let prefix = "expected curves and points that COCO can hold, got";
    assert_eq!(message(&[curve(true, false), curve(true, true)]), format!("{prefix} holes of 'a'"));
    assert_eq!(message(&[curve(false, false)]), format!("{prefix} an open line of 'a'"));
}

#[test]
fn faults_name_annotation_and_byte() {
    for (text, kind, message) in [
        ("{\"images\":[]}", FaultKind::Malformed, "annotations: expected a list of annotations, got none"),
        (
            "{\"annotations\":[{\"segmentation\":[[1,2,3]]}]}",
            FaultKind::Malformed,
            "item 0, segmentation, byte 16: expected x and y of every point of a polygon, got 3 numbers",
        ),
        (
            "{\"annotations\":[{\"keypoints\":[1,2]}]}",
            FaultKind::Malformed,
            "item 0, keypoints, byte 16: expected x, y and visibility of every keypoint, got 2 numbers",
        ),
        (
            "{\"annotations\":[{\"segmentation\":7}]}",
            FaultKind::Malformed,
            "item 0, byte 16: expected a list of polygons or a mask, got 7",
        ),
        (
            "[{\"segmentation\":{\"counts\":\"x\",\"size\":[1,1]}}]",
            FaultKind::Unsupported,
            "item 0, byte 1: expected annotations with polygons, got 1 masks: make label images of them, with annToMask of pycocotools for example, and import these",
        ),
        (
            &format!(
                "{{\"annotations\":[],\"categories\":[{{\"id\":1,\"name\":\"{}\"}}]}}",
                "x".repeat(1025)
            ),
            FaultKind::Malformed,
            &format!(
                "item 0, categories, byte 32: expected a name of at most 1024 bytes, got 1025 of '{}…'",
                "x".repeat(40)
            ),
        ),
        (
            "[{\"segmentation\":[[1,2,3,1e101]]}]",
            FaultKind::Malformed,
            "item 0, byte 1: expected coordinates within ±1e100, got 1e101 in point 1",
        ),
    ] {
        let error = read_with(text, &ReadOptions::default());
        // A bare list is known by its name only.
        let error = error.expect_err(text);
        assert_eq!((error.kind, error.to_string().as_str()), (kind, message), "{text}");
    }
    for end in 1..TEXT.len() {
        if let Some(cut) = TEXT.get(..end) {
            assert!(read_with(cut, &ReadOptions::default()).is_err(), "{end}");
        }
    }
    let deep = format!("{{\"annotations\":[{}", "[".repeat(100_000));
    assert!(read_with(&deep, &ReadOptions::default()).is_err());
    let deep = format!("{{\"annotations\":[{}{}]}}", "[".repeat(100_000), "]".repeat(100_000));
    assert_eq!(read_with(&deep, &ReadOptions::default()).expect_err("deep").kind, FaultKind::Malformed);
}

#[test]
fn what_annotations_say_is_small() {
    let small = "{\"a\":0},".repeat(50_000);
    let images = format!(r#"{{"images":[{{"id":1,"a":[{small}0]}}],"annotations":[]}}"#);
    let categories = format!(r#"{{"categories":[{{"id":[{small}0],"name":"a"}}],"annotations":[]}}"#);
    let annotation = |members: &str| format!(r#"{{"annotations":[{{"id":1,{members}}}]}}"#);
    for (text, place) in [
        (&images, "item 0, images, byte 11"),
        (&categories, "item 0, categories, byte 15"),
        (&annotation(&format!("\"a\":[{small}0]")), "item 0, byte 16"),
        (&annotation(&format!("\"segmentation\":[{}[]]", "[],".repeat(300_000))), "item 0, byte 16"),
    ] {
        let error = read_with(text, &ReadOptions::default()).expect_err("too large");
        assert_eq!((error.kind, error.place.to_string().as_str()), (FaultKind::TooLarge, place), "{error}");
    }
    let counts =
        annotation(&format!(r#""segmentation":{{"counts":[{}1],"size":[5,5]}}"#, "1,".repeat(300_000)));
    let error = read_with(&counts, &ReadOptions::default()).expect_err("a mask alone");
    assert!(error.to_string().contains("masks"), "{error}");
    let polygon = annotation(&format!("\"segmentation\":[[{}1]]", "1,".repeat(299_999)));
    assert_eq!(read_with(&polygon, &ReadOptions::default()).expect("a polygon").0.len(), 1);
}

#[test]
fn copies_of_images_are_bounded_and_made_of_what_is_wanted_alone() {
    let note = "x".repeat(1 << 20);
    let list = vec![r#"{"image_id":1,"category_id":2,"segmentation":[[0,0,1,0,0,1]]}"#; 100].join(",");
    let text = format!(
        r#"{{"images":[{{"id":1,"note":"{note}"}}],"categories":[{{"id":2,"name":"a"}}],"annotations":[{list}]}}"#
    );
    let select = |label: &str| ReadOptions { select: Some(label.into()), ..ReadOptions::default() };
    let error = read_with(&text, &select("a")).expect_err("100 MiB");
    assert_eq!((error.kind, error.place.item), (FaultKind::TooLarge, Some(80)), "{error}");
    let (records, summary) = read_with(&text, &select("b")).expect("no copies");
    assert_eq!((records.len(), summary.dropped[0].count), (0, 100));
    let (records, summary) =
        read_with(&text.replace(r#""segmentation""#, r#""outline""#), &select("a")).expect("no copies");
    assert_eq!((records.len(), summary.dropped[0].count), (0, 100));
}
