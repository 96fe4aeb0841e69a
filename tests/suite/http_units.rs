//! Units of files and of cohorts: lengths are converted, cells are not taken for lengths.

use std::collections::BTreeMap;

use reqwest::Method;
use serde_json::{Value, json};
use shapelex_formats::dicom::{SeriesImage, Study};
use shapelex_formats::image::write::{nifti_u8, png_u8};
use shapelex_formats::image::{Grid, LengthUnit};
use shapelex_formats::shape::{Geometry, Place, Points, Record, WriteOptions, find};

use crate::form::post_image;
use crate::server::{Reply, Server, shared};

/// Corners of a rectangle of 8 × 4, in its plane.
const CORNERS: [[f64; 2]; 4] = [[2.0, 3.0], [10.0, 3.0], [10.0, 7.0], [2.0, 7.0]];

/// Units of cohorts, with their length in millimetres; none where they count cells or nothing.
const UNITS: [(&str, Option<f64>); 9] = [
    ("m", Some(1000.0)),
    ("cm", Some(10.0)),
    ("mm", Some(1.0)),
    ("um", Some(1e-3)),
    ("nm", Some(1e-6)),
    ("inch", Some(25.4)),
    ("pixel", None),
    ("voxel", None),
    ("none", None),
];

fn length_of(unit: &str) -> Option<f64> {
    UNITS.iter().find(|(word, _)| *word == unit).unwrap().1
}

/// A file, its format, the unit that it states, and how long it is in that unit along x.
struct File {
    format: &'static str,
    unit: &'static str,
    bytes: Vec<u8>,
}

/// The rectangle as a record.
fn record(dimension: usize, closed: Option<bool>) -> Record {
    let row = |corner: &[f64; 2]| [corner[0], corner[1], 5.0][..dimension].to_vec();
    let points = Points::from_rows(dimension, CORNERS.iter().flat_map(row).collect());
    let geometry = match closed {
        Some(closed) => Geometry::Curve { points, closed },
        None => Geometry::Landmarks(points),
    };
    Record { name: Some("a".into()), ..Record::new(geometry, Place::default()) }
}

/// The rectangle in a file of a format.
fn written(format: &'static str, unit: &'static str, record: &Record, options: WriteOptions) -> File {
    let mut bytes = Vec::new();
    let mut writer = find(format).unwrap().writer(&mut bytes, &options).unwrap();
    writer.push(record).unwrap();
    writer.finish().unwrap();
    File { format, unit, bytes }
}

/// Images of a series that a structure set refers to.
fn series() -> Vec<SeriesImage> {
    let study = Study { instance: "1.6".into(), ..Study::default() };
    let image = SeriesImage { class: "1.2".into(), instance: "1.3".into(), study, ..SeriesImage::default() };
    let image =
        SeriesImage { position: [0.0, 0.0, 5.0], orientation: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0], ..image };
    vec![SeriesImage { series: "1.4".into(), frame_of_reference: "1.5".into(), ..image }]
}

/// Cells of a label image with a rectangle of 8 × 4 cells.
fn cells() -> ([usize; 3], Vec<u8>) {
    let inside = |x: usize, y: usize| u8::from((2..10).contains(&x) && (3..7).contains(&y));
    ([12, 10, 1], (0..10).flat_map(|y| (0..12).map(move |x| inside(x, y))).collect())
}

fn nifti(unit: &'static str, code: u8) -> File {
    let (size, values) = cells();
    let mut bytes =
        nifti_u8(&Grid::along_axes(size, [1.0; 3], [LengthUnit::Millimetre; 3]).unwrap(), &values).unwrap();
    bytes[123] = code;
    File { format: "nii", unit, bytes }
}

fn nrrd(unit: &'static str, fields: &str) -> File {
    let (_, values) = cells();
    let head = format!("NRRD0004\ntype: uint8\ndimension: 2\nsizes: 12 10\nencoding: raw\n{fields}\n");
    File { format: "nrrd", unit, bytes: [head.as_bytes(), &values].concat() }
}

/// A TIFF with a description and a resolution of one cell in a unit.
fn tiff(unit: &'static str, description: &str) -> File {
    let (_, values) = cells();
    let text = format!("{description}\0");
    let short = |value: u16| u32::from(value).to_le_bytes();
    let (entries, pixels) = (11_u16, 8_u32);
    let directory = pixels + values.len() as u32;
    let after = directory + 2 + u32::from(entries) * 12 + 4;
    let tags: [(u16, u16, u32, [u8; 4]); 11] = [
        (256, 3, 1, short(12)),
        (257, 3, 1, short(10)),
        (258, 3, 1, short(8)),
        (259, 3, 1, short(1)),
        (262, 3, 1, short(1)),
        (270, 2, text.len() as u32, (after + 8).to_le_bytes()),
        (273, 4, 1, pixels.to_le_bytes()),
        (278, 3, 1, short(10)),
        (279, 4, 1, (values.len() as u32).to_le_bytes()),
        (282, 5, 1, after.to_le_bytes()),
        (283, 5, 1, after.to_le_bytes()),
    ];
    let mut bytes = [b"II*\0".as_slice(), &directory.to_le_bytes(), &values, &entries.to_le_bytes()].concat();
    for (tag, kind, count, value) in tags {
        bytes.extend([&tag.to_le_bytes()[..], &kind.to_le_bytes(), &count.to_le_bytes(), &value].concat());
    }
    bytes.extend([0_u32.to_le_bytes(), 1_u32.to_le_bytes(), 1_u32.to_le_bytes()].concat());
    bytes.extend(text.as_bytes());
    File { format: "tiff", unit, bytes }
}

/// The rectangle in every format that can state a unit.
fn files() -> Vec<File> {
    let plain = WriteOptions::default;
    let unit = |unit: &str| WriteOptions { unit: Some(unit.into()), ..WriteOptions::default() };
    let (size, values) = cells();
    let png = png_u8(&Grid::along_axes(size, [1.0; 3], [LengthUnit::Cell; 3]).unwrap(), &values).unwrap();
    let ome = "<?xml version=\"1.0\"?><OME><Image><Pixels PhysicalSizeX=\"1\" PhysicalSizeXUnit=\"UNIT\" \
               PhysicalSizeY=\"1\" PhysicalSizeYUnit=\"UNIT\"/></Image></OME>";
    let qupath = r#"{"type":"Feature","geometry":{"type":"Polygon","coordinates":[[[2,3],[10,3],[10,7],[2,7],[2,3]]]},"properties":{"objectType":"annotation","name":"a"}}"#;
    let structures = WriteOptions { series: series(), ..plain() };
    vec![
        written("rtstruct", "mm", &record(3, Some(true)), structures),
        written("fcsv", "mm", &record(3, None), plain()),
        written("mrk", "mm", &record(3, Some(true)), plain()),
        written("mrk", "um", &record(3, Some(true)), unit("um")),
        written("coco", "pixel", &record(2, Some(true)), plain()),
        written("imagej-roi", "pixel", &record(2, Some(true)), plain()),
        File { format: "zip", ..written("imagej-roi-set", "pixel", &record(2, Some(true)), plain()) },
        written("geojson", "cm", &record(2, Some(true)), unit("cm")),
        File { format: "geojson", unit: "pixel", bytes: qupath.into() },
        written("arrow", "inch", &record(2, Some(true)), unit("inch")),
        written("parquet", "nm", &record(2, Some(true)), unit("nm")),
        File { format: "png", unit: "pixel", bytes: png },
        nifti("mm", 2),
        nifti("um", 3),
        nrrd("mm", "spacings: 1 1\nspace units: \"mm\" \"mm\"\nspace dimension: 2\n"),
        nrrd("um", "spacings: 1 1\nspace units: \"micron\" \"micron\"\nspace dimension: 2\n"),
        nrrd("pixel", ""),
        tiff("um", &ome.replace("UNIT", "µm")),
        tiff("nm", &ome.replace("UNIT", "nm")),
        tiff("mm", &ome.replace("UNIT", "mm")),
        tiff("um", "ImageJ=1.54f\nunit=micron\n"),
        tiff("pixel", "ImageJ=1.54f\n"),
        tiff("pixel", ""),
    ]
}

fn cohort(server: &Server, name: &str, unit: Value) -> String {
    let body = json!({"name": name, "length_unit": unit, "correspondence": "arc_length",
        "representation": {"kind": "closed_curve", "dimension": 2, "control_points": 16, "generator": {"name": "cubic"}}});
    server.post("/v1/cohorts", &body).expect(201);
    format!("/v1/cohorts/{name}")
}

fn post(server: &Server, cohort: &str, file: &File, more: &str) -> Reply {
    let path = format!("{cohort}/shapes?format={}&plane=xy&{more}", file.format);
    server.post_bytes(&path, "application/octet-stream", file.bytes.clone())
}

/// Length of the only shape of a cohort.
fn length(server: &Server, cohort: &str) -> f64 {
    let shapes = server.get(&format!("{cohort}/shapes")).expect(200)["items"].clone();
    assert_eq!(shapes.as_array().unwrap().len(), 1, "{shapes}");
    shapes[0]["measures"]["length"].as_f64().unwrap()
}

fn unit_of(server: &Server, cohort: &str) -> Value {
    server.get(cohort).expect(200)["length_unit"].clone()
}

/// Every format that states a unit against every unit of a cohort.
#[test]
fn lengths_of_files_are_those_of_the_cohort() {
    let server = Server::fresh();
    for (k, file) in files().iter().enumerate() {
        let what = format!("{} in {}", file.format, file.unit);
        // Never set: the cohort takes the unit of its first file.
        let first = cohort(&server, &format!("c{k}"), Value::Null);
        let found = post(&server, &first, file, "").expect(201);
        let units = json!({"file": file.unit, "stored": file.unit, "factor": 1.0, "adopted": true});
        assert_eq!(found["file"]["units"], units, "{what}");
        assert_eq!(found["file"]["properties"]["unit"], file.unit, "{what}");
        assert_eq!(unit_of(&server, &first), file.unit, "{what}");
        let plain = length(&server, &first);
        assert!((plain / 24.0 - 1.0).abs() < 0.2, "{what}: {plain}");
        // The same again adds nothing where shapes have names, and the unit stays.
        let again = post(&server, &first, file, "").expect(201);
        let added = u64::from(found["results"][0].get("external_id").is_none());
        let wanted = (&json!(added), &json!(false));
        assert_eq!((&again["added"], &again["file"]["units"]["adopted"]), wanted, "{what}");
        for (unit, millimetres) in UNITS {
            let name = format!("c{k}-{unit}");
            let other = cohort(&server, &name, json!(unit));
            let factor = match (length_of(file.unit), millimetres) {
                (Some(from), Some(to)) => from / to,
                (None, None) => 1.0,
                _ => {
                    let refused = post(&server, &other, file, "on_error=skip").expect_problem(
                        422,
                        "invalid-input",
                        &[""],
                    );
                    let detail = refused["errors"][0]["detail"].as_str().unwrap();
                    let begin = format!(
                        "expected coordinates in {unit}, the length unit of the cohort, got {}",
                        file.unit
                    );
                    assert!(detail.starts_with(&begin), "{what}: {detail}");
                    assert_eq!(refused["errors"].as_array().unwrap().len(), 1, "{what}");
                    assert_eq!(server.get(&other).expect(200)["shape_count"], 0);
                    // What the request says counts: the numbers are as in the file.
                    post(&server, &other, file, &format!("unit={unit}")).expect(201);
                    let said = length(&server, &other);
                    assert!((said / plain - 1.0).abs() < 1e-12, "{what} as {unit}: {said} {plain}");
                    continue;
                }
            };
            let found = post(&server, &other, file, "").expect(201);
            let units = &found["file"]["units"];
            assert_eq!((&units["file"], &units["stored"]), (&json!(file.unit), &json!(unit)), "{what}");
            let said = units["factor"].as_f64().unwrap();
            assert!((said / factor - 1.0).abs() < 1e-15, "{what} in {unit}: {said} {factor}");
            let stored = length(&server, &other);
            assert!((stored / (plain * factor) - 1.0).abs() < 1e-12, "{what} in {unit}: {stored} {plain}");
            assert_eq!(unit_of(&server, &other), unit);
        }
    }
}

/// Requests about the shapes of a file: every route of a dictionary, and measures, convert as an upload does.
#[test]
fn lengths_of_files_are_those_of_the_dictionary() {
    let server = Server::fresh();
    let contour = |k: u32| {
        let corners =
            CORNERS.map(|[x, y]| [x * (1.0 + 0.01 * f64::from(k)), y * (1.0 - 0.02 * f64::from(k % 3))]);
        json!({"points": corners})
    };
    let shapes: Vec<_> = (0..6).map(contour).collect();
    for (name, unit) in [("cm", json!("cm")), ("pixel", json!("pixel")), ("silent", Value::Null)] {
        let path = cohort(&server, name, unit);
        server.post(&format!("{path}/shapes"), &json!({"shapes": shapes})).expect(201);
        let learn = json!({"name": name, "cohort": name, "transformation": "rigid",
            "method": {"kind": "functional_pca", "components": 2}});
        let learn = server.request(Method::POST, "/v1/dictionaries").header("prefer", "wait=60").json(&learn);
        server.send(learn).expect(201);
    }
    let ask = |dictionary: &str, file: &File, more: &str| {
        let path = format!("/v1/dictionaries/{dictionary}/{more}");
        server.post_bytes(&path, "application/octet-stream", file.bytes.clone())
    };
    let plain = |unit| {
        written(
            "geojson",
            unit,
            &record(2, Some(true)),
            WriteOptions { unit: Some(unit.into()), ..WriteOptions::default() },
        )
    };
    let (metres, centimetres) = (plain("m"), plain("cm"));
    for route in ["encode", "reconstruct", "score", "assess?samples=0"] {
        let and = if route.contains('?') { '&' } else { '?' };
        let own = ask("cm", &centimetres, route).expect(200);
        let asked = ask("cm", &metres, route).expect(200);
        let units = json!({"file": "m", "stored": "cm", "factor": 100.0, "adopted": false});
        assert_eq!(asked["file"]["units"], units, "{route}");
        assert_ne!(asked["results"], own["results"], "{route}");
        // The request says that the numbers are centimetres: the same answer, whatever the file states.
        let said = ask("cm", &metres, &format!("{route}{and}unit=cm")).expect(200);
        assert_eq!(said["results"], own["results"], "{route}");
        let refused = ask("pixel", &metres, route).expect_problem(422, "invalid-input", &[""]);
        let detail = refused["errors"][0]["detail"].as_str().unwrap();
        let begin = "expected coordinates in pixel, the length unit of the dictionary, got m";
        assert!(detail.starts_with(begin), "{route}: {detail}");
        let silent = ask("silent", &metres, route).expect(200);
        assert!(
            silent["file"]["warnings"].to_string().contains("the dictionary has no length unit"),
            "{route}"
        );
        assert_eq!(ask("cm", &metres, &format!("{route}{and}unit=Mm")).status, 400, "{route}");
    }
    let measured = |more: &str| {
        let path = format!(
            "/v1/measure?correspondence=arc_length&representation={{\"kind\":\"closed_curve\",\"dimension\":2,\"control_points\":16,\"generator\":{{\"name\":\"cubic\"}}}}{more}"
        );
        server.post_bytes(&path, "application/octet-stream", metres.bytes.clone()).expect(200)
    };
    let length = |answer: &Value| answer["results"][0]["length"].as_f64().unwrap();
    let plain = length(&measured(""));
    for unit in ["cm", "%22cm%22"] {
        let converted = measured(&format!("&length_unit={unit}"));
        assert_eq!(converted["length_unit"], "cm");
        assert!((length(&converted) / plain / 100.0 - 1.0).abs() < 1e-12, "{unit}");
    }
}

/// A file that lies, and one that says nothing.
#[test]
fn a_request_says_the_unit_of_a_file() {
    let server = Server::fresh();
    let file = written("mrk", "mm", &record(3, Some(true)), WriteOptions::default());
    let path = cohort(&server, "c", json!("um"));
    let found = post(&server, &path, &file, "unit=inch&on_error=skip").expect(201);
    assert_eq!(
        found["file"]["units"],
        json!({"file": "inch", "stored": "um", "factor": 25400.0, "adopted": false})
    );
    let shape = server.get(&format!("{path}/shapes/a")).expect(200);
    // What the metadata of the file say of the unit is said of the stored numbers.
    assert_eq!(shape["metadata"]["unit"], "um");
    let export = server.get(&format!("{path}/export?format=parquet&points=8"));
    let other = cohort(&server, "d", json!("mm"));
    let back = File { format: "parquet", unit: "um", bytes: export.body };
    let found = post(&server, &other, &back, "").expect(201);
    assert_eq!(
        found["file"]["units"],
        json!({"file": "um", "stored": "mm", "factor": 0.001, "adopted": false})
    );

    let silent = written("csv", "", &record(2, Some(true)), WriteOptions::default());
    let path = cohort(&server, "e", Value::Null);
    let found = post(&server, &path, &silent, "closed=true").expect(201);
    assert!(found["file"].get("units").is_none(), "{found}");
    assert_eq!(unit_of(&server, &path), Value::Null);
    let path = cohort(&server, "f", Value::Null);
    let found = post(&server, &path, &silent, "closed=true&unit=µm").expect(201);
    assert_eq!(found["file"]["units"], json!({"file": "um", "stored": "um", "factor": 1.0, "adopted": true}));
    assert_eq!(unit_of(&server, &path), "um");
    // A file without a unit is taken as it is; so are posted shapes.
    let path = cohort(&server, "g", json!("cm"));
    post(&server, &path, &silent, "closed=true").expect(201);
    assert!((length(&server, &path) / 24.0 - 1.0).abs() < 0.2);
    for word in ["furlong", "", "Mm"] {
        let refused =
            post(&server, &path, &silent, &format!("unit={word}")).expect_problem(400, "invalid-query", &[]);
        assert_eq!(refused["errors"][0]["parameter"], "unit");
    }
}

/// A cohort that has shapes of an unknown unit does not take one.
#[test]
fn a_cohort_with_shapes_takes_no_unit_by_itself() {
    let server = Server::fresh();
    let path = cohort(&server, "c", Value::Null);
    let shapes = json!({"shapes": [{"points": CORNERS}]});
    server.post(&format!("{path}/shapes"), &shapes).expect(201);
    let file = written("coco", "pixel", &record(2, Some(true)), WriteOptions::default());
    let found = post(&server, &path, &file, "").expect(201);
    let warnings = found["file"]["warnings"].to_string();
    assert!(warnings.contains("the cohort has shapes and no length unit"), "{warnings}");
    assert_eq!(found["file"]["units"]["adopted"], false);
    assert_eq!(unit_of(&server, &path), Value::Null);
    // Shapes of one file are in one unit all the same.
    let lines = ["mm", "cm"].map(|unit| {
        let mut record = record(3, Some(true));
        record.name = Some(unit.into());
        record.metadata.insert("unit".into(), unit.into());
        record
    });
    let mut bytes = Vec::new();
    let mut writer = find("mrk").unwrap().writer(&mut bytes, &WriteOptions::default()).unwrap();
    lines.iter().for_each(|record| writer.push(record).unwrap());
    writer.finish().unwrap();
    let path = cohort(&server, "d", Value::Null);
    post(&server, &path, &File { format: "mrk", unit: "mm", bytes }, "").expect(201);
    let of = |name: &str| {
        let shape = server.get(&format!("{path}/shapes/{name}")).expect(200);
        shape["measures"]["length"].as_f64().unwrap()
    };
    assert!((of("cm") / of("mm") / 10.0 - 1.0).abs() < 1e-12);
}

/// The unit of a cohort is one of a list, under whatever usual spelling it comes.
#[test]
fn units_of_cohorts_are_those_of_a_list() {
    let server = shared();
    let representation = json!({"kind": "landmarks", "dimension": 2, "points": 3});
    let post = |name: &str, unit: Value| {
        server.post(
            "/v1/cohorts",
            &json!({"name": name, "representation": representation, "length_unit": unit}),
        )
    };
    let spellings = BTreeMap::from([
        ("µm", "um"),
        ("micron", "um"),
        ("in", "inch"),
        ("[in_i]", "inch"),
        ("pixels", "pixel"),
        ("none", "none"),
    ]);
    for (k, (text, word)) in spellings.iter().enumerate() {
        assert_eq!(post(&format!("units-{k}"), json!(text)).expect(201)["length_unit"], *word, "{text}");
    }
    for text in ["furlong/fortnight", "", "MM", "m\u{0}m"] {
        let refused = post("units", json!(text)).expect_problem(422, "invalid-input", &["/length_unit"]);
        let detail = refused["errors"][0]["detail"].as_str().unwrap();
        assert!(
            detail.starts_with("expected one of m, cm, mm, um, nm, inch, pixel, voxel, none, got '"),
            "{detail}"
        );
    }
    let patch = |unit: Value| {
        let request = server.request(reqwest::Method::PATCH, "/v1/cohorts/units-0");
        server.send(request.json(&json!({"length_unit": unit})))
    };
    assert_eq!(patch(json!("Millimeters")).expect(200)["length_unit"], "mm");
    patch(json!("px2")).expect_problem(422, "invalid-input", &["/length_unit"]);
    assert_eq!(patch(Value::Null).expect(200)["length_unit"], Value::Null);
}

/// What drawings say of the scale of a cohort without a unit by intent.
#[test]
fn no_unit_stands_beside_numbers_that_have_none() {
    let server = Server::fresh();
    for (unit, shown) in [("none", false), ("mm", true)] {
        let path = cohort(&server, &format!("c-{unit}"), json!(unit));
        server
            .post(&format!("{path}/shapes"), &json!({"shapes": [{"points": CORNERS, "external_id": "a"}]}))
            .expect(201);
        let drawing = server.get(&format!("{path}/shapes/a?format=svg"));
        assert_eq!(drawing.text().contains(&format!(" {unit}<")), shown, "{unit}");
        assert!(!drawing.text().contains("none<"), "{unit}");
    }
}

/// Contours in the plane of a structure set come back as they were from a cohort in another unit.
#[test]
fn a_structure_set_is_written_in_millimetres_again() {
    let server = shared();
    let body = json!({"name": "units-landmarks", "length_unit": "cm", "representation": {"kind": "landmarks", "dimension": 2, "points": 4}});
    server.post("/v1/cohorts", &body).expect(201);
    let structures = WriteOptions { series: series(), ..WriteOptions::default() };
    let file = written("rtstruct", "mm", &record(3, Some(true)), structures);
    let path = "/v1/cohorts/units-landmarks";
    server
        .post_bytes(&format!("{path}/shapes?contours=plane&format=rtstruct"), "application/dicom", file.bytes)
        .expect(201);
    let stored = server.get(&format!("{path}/shapes")).expect(200)["items"][0].clone();
    // The plane stays where it is in the patient.
    assert_eq!(stored["metadata"]["plane"]["offset"], 5.0);
    let shape = server.get(&format!("{path}/shapes/{}", stored["id"].as_str().unwrap())).expect(200);
    assert_eq!(shape["control_points"], json!([[0.2, 0.3], [1.0, 0.3], [1.0, 0.7], [0.2, 0.7]]));
    let lines = server.get(&format!("{path}/export?format=ndjson")).body;
    let parameters = json!({"series": [{"class": "1.2", "instance": "1.3", "series": "1.4", "frame_of_reference": "1.5",
        "position": [0.0, 0.0, 5.0], "orientation": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0], "study": {"instance": "1.6"}}]});
    let parameters = parameters.to_string();
    let parts: [(&str, &str, &[u8]); 2] = [
        ("parameters", "application/json", parameters.as_bytes()),
        ("file", "application/x-ndjson", &lines[..]),
    ];
    let query = "to=rtstruct&format=ndjson&write_unit=cm";
    let file = crate::form::post_form(&server, &format!("/v1/convert?{query}"), crate::form::form(&parts));
    assert_eq!(file.status, 200, "{}", file.text());
    let back = server.post_bytes("/v1/convert?to=ndjson&format=rtstruct", "application/dicom", file.body);
    let points = |line: &str| serde_json::from_str::<Value>(line).unwrap()["points"][0].clone();
    let back: Vec<Value> = back.text().lines().map(points).collect();
    let corners: Vec<[f64; 3]> = CORNERS.iter().map(|[x, y]| [*x, *y, 5.0]).collect();
    assert_eq!(json!(back), json!(corners));
}

/// Volumes whose pages have no distance.
#[test]
fn a_volume_without_sizes_is_told() {
    let server = shared();
    let one = tiff("pixel", "").bytes;
    let found = server.post_bytes("/v1/inspect?format=tiff", "image/tiff", one).expect(200);
    assert_eq!(found["warnings"], json!([]));
    let values = vec![1_u8; 8];
    let head = "NRRD0004\ntype: uint8\ndimension: 3\nsizes: 2 2 2\nencoding: raw\n";
    let volume = |fields: &str| [head.as_bytes(), fields.as_bytes(), b"\n", &values].concat();
    let found = server.post_bytes("/v1/inspect?format=nrrd", "application/x-nrrd", volume("")).expect(200);
    assert_eq!(found["properties"]["unit"], "voxel");
    assert!(found["warnings"][0].as_str().unwrap().contains("no sizes of its voxels"), "{found}");
    let found = server
        .post_bytes("/v1/inspect?format=nrrd", "application/x-nrrd", volume("spacings: 1 1 2\n"))
        .expect(200);
    assert_eq!((found["properties"].get("unit"), &found["warnings"]), (None, &json!([])));
}

/// Objects that are segmented into a cohort.
#[test]
fn segmented_objects_are_stored_in_the_unit_of_the_cohort() {
    let server = Server::fresh();
    let disc = |at: usize| {
        let (x, y) = ((at % 40) as f64 - 20.0, (at / 40) as f64 - 20.0);
        if x.hypot(y) < 9.0 { 200_u8 } else { 10 }
    };
    let values: Vec<u8> = (0..1600).map(disc).collect();
    let grid = Grid::along_axes([40, 40, 1], [0.5; 3], [LengthUnit::Millimetre; 3]).unwrap();
    let (volume, picture) = (nifti_u8(&grid, &values).unwrap(), png_u8(&grid, &values).unwrap());
    let body = |more: Value| {
        let mut body = json!({"representation": {"kind": "closed_curve", "dimension": 2, "control_points": 16, "generator": {"name": "cubic"}},
            "terms": [{"name": "contour"}], "coordinates": "world"});
        body.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
        body
    };
    let in_millimetres = json!({"boxes": [{"lower": [5, 5], "upper": [15, 15]}]});
    let segment = |cohort: &str, more: &Value, image: &[u8]| {
        post_image(&server, &format!("{cohort}/segment"), &body(more.clone()), image)
    };
    let first = cohort(&server, "c", Value::Null);
    let found = segment(&first, &in_millimetres, &volume).expect(201);
    assert_eq!(found["units"], json!({"file": "mm", "stored": "mm", "factor": 1.0, "adopted": true}));
    let plain = length(&server, &first);
    let centimetres = cohort(&server, "d", json!("cm"));
    let answer = segment(&centimetres, &in_millimetres, &volume).expect(201);
    assert_eq!(answer["units"], json!({"file": "mm", "stored": "cm", "factor": 0.1, "adopted": false}));
    // The answer is in the coordinates of the request.
    assert_eq!(answer["results"][0]["control_points"], found["results"][0]["control_points"]);
    assert!((length(&server, &centimetres) / plain - 0.1).abs() < 1e-12);
    let pixels = json!({"boxes": [{"lower": [10, 10], "upper": [30, 30]}]});
    segment(&centimetres, &pixels, &picture).expect_problem(422, "invalid-input", &[""]);
    let said = json!({"boxes": [{"lower": [10, 10], "upper": [30, 30]}], "unit": "um"});
    let answer = segment(&centimetres, &said, &picture).expect(201);
    assert_eq!(answer["units"]["factor"], 1e-4);
    let odd = json!({"boxes": [{"lower": [10, 10], "upper": [30, 30]}], "unit": "furlong"});
    segment(&centimetres, &odd, &picture).expect_problem(422, "invalid-input", &["/unit"]);
    let cells = cohort(&server, "e", json!("pixel"));
    segment(&cells, &in_millimetres, &volume).expect_problem(422, "invalid-input", &[""]);
    segment(&cells, &pixels, &picture).expect(201);
}

/// A prior of the store, whose class keeps sizes, in an image of another unit.
#[test]
fn priors_of_the_store_are_converted_to_the_unit_of_the_image() {
    let server = Server::fresh();
    let disc = |at: usize| {
        let (x, y) = ((at % 40) as f64 - 20.0, (at / 40) as f64 - 20.0);
        if x.hypot(y) < 9.0 { 200_u8 } else { 10 }
    };
    let values: Vec<u8> = (0..1600).map(disc).collect();
    let grid = Grid::along_axes([40, 40, 1], [0.5; 3], [LengthUnit::Millimetre; 3]).unwrap();
    let (volume, picture) = (nifti_u8(&grid, &values).unwrap(), png_u8(&grid, &values).unwrap());
    let representation =
        json!({"kind": "closed_curve", "dimension": 2, "control_points": 16, "generator": {"name": "cubic"}});
    // Ellipses of some 6 mm, in the unit of each cohort.
    for (name, unit, scale) in
        [("mm", json!("mm"), 1.0), ("cm", json!("cm"), 0.1), ("unset", Value::Null, 1.0)]
    {
        let ellipse = |longer: f64| -> Vec<[f64; 2]> {
            let angle = |k: usize| std::f64::consts::TAU * k as f64 / 64.0;
            (0..64).map(|k| [scale * longer * angle(k).cos(), scale * 5.0 * angle(k).sin()]).collect()
        };
        let cohort = json!({"name": name, "length_unit": unit, "correspondence": "cyclic", "representation": representation});
        server.post("/v1/cohorts", &cohort).expect(201);
        let shapes: Vec<Value> = [6.0, 6.5, 7.0].map(|longer| json!({"points": ellipse(longer)})).into();
        server.post(&format!("/v1/cohorts/{name}/shapes"), &json!({"shapes": shapes})).expect(201);
        let learn = json!({"name": name, "cohort": name, "transformation": "rigid", "method": {"kind": "functional_pca", "components": 1}});
        let learn = server.request(Method::POST, "/v1/dictionaries").header("prefer", "wait=50").json(&learn);
        server.send(learn).expect(201);
    }
    let segment = |image: &[u8], of: &str, name: &str, class: &str| {
        let body = json!({"representation": representation, "terms": [{"name": "contour"}], "coordinates": "world",
            "boxes": [{"lower": [5, 5], "upper": [15, 15]}], "stages": [{"sigma": 1, "iterations": 0}],
            "prior": {of: name, "transformation": class}});
        post_image(&server, "/v1/segment", &body, image)
    };
    for of in ["cohort", "dictionary"] {
        let energy = |name: &str, class: &str| {
            let found = segment(&volume, of, name, class).expect(200);
            found["results"][0]["energies"]["prior"]["value"].as_f64().unwrap()
        };
        let plain = energy("mm", "rigid");
        assert!(plain > 0.0);
        assert!((energy("cm", "rigid") / plain - 1.0).abs() < 1e-9, "{of}");
        assert_eq!(energy("unset", "rigid"), plain);
        assert!((energy("cm", "similarity") / energy("mm", "similarity") - 1.0).abs() < 1e-9, "{of}");
        // Lengths against cells: refused where sizes matter.
        segment(&picture, of, "cm", "rigid").expect_problem(422, "invalid-input", &["/prior"]);
        segment(&picture, of, "cm", "similarity").expect(200);
        segment(&picture, of, "unset", "rigid").expect(200);
    }
}
