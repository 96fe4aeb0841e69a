//! RT structure sets: files of other programs beside the checkout, and small ones made byte by byte.

use std::path::{Path, PathBuf};

use shapelex_formats::dicom::{SeriesImage, series};
use shapelex_formats::shape::{
    Contours, FaultKind, FileError, Geometry, Holes, Limits, Mesh, ReadOptions, Record, Source, Summary,
    WriteOptions, detect, find, read,
};

use crate::dicom::{BIG, EXPLICIT, Encoding, IMPLICIT, file};

const FRAME: &str = "1.2.3.4";

fn load(name: &str) -> Option<Vec<u8>> {
    let folder: PathBuf =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/formats-dicom-rtstruct");
    let bytes = std::fs::read(folder.join(name)).ok();
    if bytes.is_none() {
        eprintln!("SKIPPED: {name} is not here");
    }
    bytes
}

fn records(bytes: &[u8], options: &ReadOptions) -> Result<(Vec<Record>, Summary), FileError> {
    let mut found = Vec::new();
    let mut source = Source::new(bytes, Limits::default()).unwrap();
    let format = find("rtstruct").unwrap();
    let summary = read(format, &mut source, options, &mut |record| {
        found.push(record);
        Ok(())
    })?;
    Ok((found, summary))
}

fn all(bytes: &[u8]) -> (Vec<Record>, Summary) {
    records(bytes, &ReadOptions { holes: Some(Holes::Keep), ..ReadOptions::default() }).unwrap()
}

fn refusal(bytes: &[u8]) -> (FaultKind, String) {
    let error = records(bytes, &ReadOptions::default()).unwrap_err();
    (error.kind, error.to_string())
}

/// A region of a small file: its contours are types with their points.
struct Roi<'a> {
    name: &'a [u8],
    contours: Vec<(&'a str, Vec<[f64; 3]>)>,
}

/// What a small file says, each part of which can be wrong.
struct Small<'a> {
    encoding: Encoding,
    charset: &'a str,
    frame: &'a str,
    rois: Vec<Roi<'a>>,
    /// Replaces the number of points of all contours.
    claimed: Option<usize>,
}

impl Default for Small<'_> {
    fn default() -> Self {
        let square =
            |z: f64, half: f64| vec![[-half, -half, z], [half, -half, z], [half, half, z], [-half, half, z]];
        let rois = vec![
            Roi {
                name: b"Heart",
                contours: vec![
                    ("CLOSED_PLANAR", square(1.0, 4.0)),
                    ("CLOSED_PLANAR", square(2.5, 4.0)),
                    ("CLOSED_PLANAR", square(4.0, 2.0)),
                ],
            },
            Roi { name: b"Isocentre", contours: vec![("POINT", vec![[1.0, 2.0, 3.0]])] },
        ];
        Self { encoding: IMPLICIT, charset: "ISO_IR 100", frame: FRAME, rois, claimed: None }
    }
}

impl Small<'_> {
    fn data_set(&self) -> Vec<u8> {
        let e = self.encoding;
        let mut set = e.text(0x0008_0005, "CS", self.charset);
        set.extend(e.text(0x0008_0016, "UI", "1.2.840.10008.5.1.4.1.1.481.3"));
        set.extend(e.text(0x0008_0060, "CS", "RTSTRUCT"));
        set.extend(e.text(0x0010_0010, "PN", "Nobody^Known"));
        let numbered = || self.rois.iter().enumerate().map(|(k, roi)| ((k + 1).to_string(), roi));
        let names: Vec<Vec<u8>> = numbered()
            .map(|(number, roi)| {
                let frame = e.text(0x3006_0024, "UI", self.frame);
                [e.text(0x3006_0022, "IS", &number), frame, e.bytes(0x3006_0026, "LO", roi.name)].concat()
            })
            .collect();
        set.extend(e.open_sequence(0x3006_0020, &names));
        let contours: Vec<Vec<u8>> = numbered()
            .map(|(number, roi)| {
                let items: Vec<Vec<u8>> = roi.contours.iter().map(|contour| self.contour(contour)).collect();
                let colour = e.text(0x3006_002a, "IS", "255\\0\\7");
                [colour, e.sequence(0x3006_0040, &items), e.text(0x3006_0084, "IS", &number)].concat()
            })
            .collect();
        set.extend(e.sequence(0x3006_0039, &contours));
        let kinds: Vec<Vec<u8>> = numbered()
            .map(|(number, _)| {
                [e.text(0x3006_0084, "IS", &number), e.text(0x3006_00a4, "CS", "ORGAN")].concat()
            })
            .collect();
        set.extend(e.sequence(0x3006_0080, &kinds));
        set
    }

    fn contour(&self, (kind, points): &(&str, Vec<[f64; 3]>)) -> Vec<u8> {
        let e = self.encoding;
        let count = self.claimed.unwrap_or(points.len()).to_string();
        let data: Vec<String> = points.as_flattened().iter().map(f64::to_string).collect();
        let data = e.text(0x3006_0050, "DS", &data.join("\\"));
        [e.text(0x3006_0042, "CS", kind), e.text(0x3006_0046, "IS", &count), data].concat()
    }

    fn file(&self) -> Vec<u8> {
        self.encoding.file(&self.data_set())
    }
}

fn closed(name: &str, contours: Vec<Vec<[f64; 3]>>) -> Small<'_> {
    let contours = contours.into_iter().map(|points| ("CLOSED_PLANAR", points)).collect();
    Small { rois: vec![Roi { name: name.as_bytes(), contours }], ..Small::default() }
}

fn ring(x: f64, half: f64) -> Vec<[f64; 3]> {
    vec![[x - half, -half, 5.0], [x + half, -half, 5.0], [x + half, half, 5.0], [x - half, half, 5.0]]
}

fn coordinates(record: &Record) -> Vec<f64> {
    match &record.geometry {
        Geometry::Curve { points, .. } | Geometry::Landmarks(points) => points.coordinates().to_vec(),
        other => panic!("{other:?}"),
    }
}

#[test]
fn files_of_other_programs_have_the_regions_that_pydicom_finds() {
    for name in ["mim_phantom_rtstruct.dcm", "pydicom_rtstruct.dcm", "rt-utils_rtstruct.dcm"] {
        let (Some(bytes), Some(contents)) = (load(name), load("contents.json")) else { return };
        assert_eq!(detect(&bytes[..4096.min(bytes.len())], None).unwrap().id, "rtstruct");
        let contents: serde_json::Value = serde_json::from_slice(&contents).unwrap();
        let entry = contents.as_array().unwrap().iter().find(|entry| entry["file"] == name).unwrap();
        let (records, summary) = all(&bytes);
        let (mut counted, mut wanted) = (0, 0);
        for roi in entry["rois"].as_array().unwrap() {
            let own: Vec<&Record> =
                records.iter().filter(|record| record.metadata["roi"]["number"] == roi["number"]).collect();
            assert_eq!(own.len(), roi["contours"], "{name}");
            assert!(own.iter().all(|record| record.label.as_deref() == roi["name"].as_str()));
            let points: Vec<Vec<f64>> = own.iter().map(|record| coordinates(record)).collect();
            let rows = || points.iter().flat_map(|points| points.as_chunks::<3>().0);
            counted += rows().count() as u64;
            wanted += roi["points"].as_u64().unwrap();
            for k in 0..3 {
                let low = rows().map(|row| row[k]).fold(f64::INFINITY, f64::min);
                let high = rows().map(|row| row[k]).fold(f64::NEG_INFINITY, f64::max);
                assert_eq!(Some(low + 0.0), roi["bbox_min"][k].as_f64().map(|x| x + 0.0), "{name}");
                assert_eq!(Some(high + 0.0), roi["bbox_max"][k].as_f64().map(|x| x + 0.0), "{name}");
            }
        }
        // One file ends its contours with their first point.
        let repeated = summary.dropped.iter().find(|dropped| dropped.what.contains("repeat"));
        assert_eq!(counted + repeated.map_or(0, |dropped| dropped.count), wanted, "{name}");
        let identifying =
            summary.dropped.iter().find(|dropped| dropped.what == "identifying elements").unwrap();
        assert!(identifying.names.iter().any(|name| name == "PatientName"), "{identifying:?}");
        let said = serde_json::to_string(&summary).unwrap();
        assert!(!said.contains("PHANTOM") && !said.contains("Phantom30sep"), "{said}");
    }
}

#[test]
fn images_are_refused_by_what_they_are() {
    for (name, kind) in
        [("phantom_ct_1.dcm", "CT"), ("pydicom_CT_small.dcm", "CT"), ("pydicom_MR_small.dcm", "MR")]
    {
        let Some(bytes) = load(name) else { return };
        let expected = format!(
            "(0008,0016): expected a DICOM RT Structure Set, got {kind} Image Storage (modality {kind})"
        );
        assert_eq!(refusal(&bytes), (FaultKind::Unsupported, expected));
    }
}

#[test]
fn every_encoding_gives_the_same_shapes() {
    let expected = all(&Small::default().file());
    assert_eq!(expected.0.len(), 4);
    let first = &expected.0[0];
    assert_eq!((first.name.as_deref(), first.label.as_deref()), (Some("Heart 1"), Some("Heart")));
    assert_eq!(coordinates(first), [-4.0, -4.0, 1.0, 4.0, -4.0, 1.0, 4.0, 4.0, 1.0, -4.0, 4.0, 1.0]);
    let roi = &first.metadata["roi"];
    assert_eq!(roi["type"], "ORGAN");
    assert_eq!(roi["colour"], serde_json::json!([255.0, 0.0, 7.0]));
    assert_eq!(first.metadata["plane"]["offset"], 1.0);
    assert_eq!(first.metadata["frame_of_reference"], FRAME);
    assert!(matches!(expected.0[3].geometry, Geometry::Landmarks(_)));
    assert_eq!(expected.1.properties["unit"], "mm");
    let alike = |(records, _): (Vec<Record>, Summary)| {
        let shapes = |records: &[Record]| -> Vec<_> {
            records.iter().map(|r| (r.geometry.clone(), r.name.clone(), r.metadata.clone())).collect()
        };
        assert_eq!(shapes(&records), shapes(&expected.0));
    };
    for encoding in [IMPLICIT, EXPLICIT, BIG] {
        let small = Small { encoding, ..Small::default() };
        alike(all(&small.file()));
        // Without preamble and description.
        alike(all(&small.data_set()));
    }
    let mut encoder = flate2::write::DeflateEncoder::new(Vec::new(), flate2::Compression::default());
    let set = Small { encoding: EXPLICIT, ..Small::default() }.data_set();
    std::io::Write::write_all(&mut encoder, &set).unwrap();
    alike(all(&file("1.2.840.10008.1.2.1.99", &encoder.finish().unwrap())));
}

#[test]
fn shortened_files_are_refused() {
    for encoding in [IMPLICIT, EXPLICIT, BIG] {
        let bytes = Small { encoding, ..Small::default() }.file();
        let mut accepted = 0;
        for length in 0..bytes.len() {
            if let Ok((records, _)) = records(&bytes[..length], &ReadOptions::default()) {
                // Without the last element, the list of types, which is optional.
                assert!(records.len() == 4 && records[0].metadata["roi"].get("type").is_none(), "{length}");
                accepted += 1;
            }
        }
        assert_eq!(accepted, 1);
    }
}

#[test]
fn any_wrong_byte_is_refused_or_gives_numbers() {
    for encoding in [IMPLICIT, EXPLICIT] {
        let bytes = Small { encoding, ..Small::default() }.file();
        for at in 128..bytes.len() {
            for value in [0x00, 0x01, 0x5c, 0x7f, 0xfe, 0xff] {
                let mut bytes = bytes.clone();
                bytes[at] = value;
                if let Ok((records, _)) = records(&bytes, &ReadOptions::default()) {
                    assert!(records.iter().flat_map(coordinates).all(f64::is_finite), "{at} {value}");
                }
            }
        }
    }
}

#[test]
fn wrong_encodings_are_named() {
    let set = |encoding| Small { encoding, ..Small::default() }.data_set();
    let (kind, message) = refusal(&file(EXPLICIT.syntax(), &set(BIG)));
    assert_eq!(kind, FaultKind::Malformed);
    assert!(message.ends_with("got group 0800, which is 0008 in the other byte order"), "{message}");
    let (_, message) = refusal(&file(EXPLICIT.syntax(), &set(IMPLICIT)));
    assert!(message.contains("expected a type of two capital letters"), "{message}");
    let (_, message) = refusal(&file(IMPLICIT.syntax(), &set(EXPLICIT)));
    assert!(message.ends_with("got the type CS"), "{message}");
    let (kind, message) = refusal(&file("1.2.3", &set(EXPLICIT)));
    assert_eq!(kind, FaultKind::Unsupported);
    assert_eq!(message, "(0002,0010): expected a transfer syntax of the standard, got 1.2.3");
    let (_, message) = refusal(b"\0\0");
    assert_eq!(message, "byte 2: expected a file of DICOM, got one that ends too early");
}

#[test]
fn lengths_are_compared_with_the_bytes_that_are_left() {
    let mut set = Small::default().data_set();
    set.extend(IMPLICIT.header(0x7fe0_0010, "OW", 4_000_000_000));
    let (kind, message) = refusal(&IMPLICIT.file(&set));
    assert_eq!(kind, FaultKind::Truncated);
    assert!(message.starts_with("(7FE0,0010), byte "), "{message}");
    assert!(
        message.ends_with("expected 4000000000 bytes of a value, got the 0 that the file still has"),
        "{message}"
    );
    let mut set = IMPLICIT.header(0x3006_0020, "SQ", 4_000_000_000);
    set.extend([0xfe, 0xff, 0, 0xe0, 0xff, 0xff, 0xff, 0x7f]);
    let (kind, message) = refusal(&IMPLICIT.file(&set));
    assert_eq!(
        (kind, message.contains("got the end of the file")),
        (FaultKind::Truncated, true),
        "{message}"
    );
}

#[test]
fn nesting_is_bounded() {
    for depth in [100_usize, 100_000] {
        let mut set = Small::default().data_set();
        for _ in 0..depth {
            set.extend(IMPLICIT.header(0x3006_0040, "SQ", u32::MAX));
            set.extend([0xfe, 0xff, 0, 0xe0, 0xff, 0xff, 0xff, 0xff]);
        }
        let (kind, message) = refusal(&IMPLICIT.file(&set));
        assert_eq!(kind, FaultKind::TooLarge);
        assert!(message.ends_with("expected at most 64 sequences within each other, got more"), "{message}");
    }
}

#[test]
fn delimiters_without_a_beginning_are_refused() {
    for element in [0xe00d_u16, 0xe0dd, 0xe000] {
        let mut set = Small::default().data_set();
        set.extend([&[0xfe, 0xff][..], &element.to_le_bytes(), &[0; 4]].concat());
        set.extend(IMPLICIT.text(0x7fe0_0001, "LO", "x"));
        assert_eq!(refusal(&IMPLICIT.file(&set)).0, FaultKind::Malformed, "{element:x}");
    }
}

#[test]
fn a_frame_of_reference_is_expected() {
    let (kind, message) = refusal(&Small { frame: "", ..Small::default() }.file());
    assert_eq!(kind, FaultKind::Malformed);
    assert!(message.contains("(3006,0020)[0] (3006,0024)"), "{message}");
    assert!(message.ends_with("expected the frame of reference of region 1, got none"), "{message}");
}

#[test]
fn texts_that_every_contour_repeats_are_short() {
    let long = "1".repeat(1025);
    for (small, tag) in [
        (Small { frame: &long, ..Small::default() }, "(3006,0024)"),
        (closed(&long, vec![ring(0.0, 1.0)]), "(3006,0026)"),
    ] {
        let (kind, message) = refusal(&small.file());
        assert!(kind == FaultKind::Malformed && message.contains(tag), "{message}");
        assert!(message.ends_with("expected a text of at most 1024 bytes, got 1026"), "{message}");
    }
    assert_eq!(all(&closed(&long[..1024], vec![ring(0.0, 1.0)]).file()).0.len(), 1);
}

#[test]
fn counts_and_numbers_that_lie_are_refused() {
    let (_, message) = refusal(&Small { claimed: Some(1000), ..Small::default() }.file());
    assert!(message.starts_with("item 0, (3006,0039)[0] (3006,0040)[0] (3006,0046), byte "), "{message}");
    assert!(message.ends_with("expected 4 points, as many as there are, got 1000"), "{message}");
    for (number, message) in [
        ("1e101", "expected coordinates within ±1e100, got 1e101 in point 0"),
        ("1e999", "expected finite numbers, got '1e999' as number 0"),
        ("nan", "expected finite numbers, got 'nan' as number 0"),
        ("1\\2", "expected three numbers a point, got 2 numbers"),
    ] {
        let e = IMPLICIT;
        let data = if number.contains('\\') { number.to_owned() } else { format!("{number}\\0\\0") };
        let item = [e.text(0x3006_0042, "CS", "POINT"), e.text(0x3006_0050, "DS", &data)].concat();
        let roi = [e.sequence(0x3006_0040, &[item]), e.text(0x3006_0084, "IS", "1")].concat();
        let small = Small { rois: vec![Roi { name: b"a", contours: Vec::new() }], ..Small::default() };
        // The list of contours comes before that of the small file, and the first one counts.
        let at = e.text(0x0008_0005, "CS", small.charset).len();
        let mut set = small.data_set();
        set.splice(at..at, e.sequence(0x3006_0039, &[roi]));
        let found = refusal(&e.file(&set)).1;
        assert!(found.ends_with(message), "{found}");
    }
}

#[test]
fn names_are_read_in_their_character_set() {
    let named = |name: &'static [u8], charset: &'static str| {
        let rois = vec![Roi { name, contours: vec![("POINT", vec![[0.0; 3]])] }];
        Small { charset, rois, ..Small::default() }.file()
    };
    for (name, charset) in [
        (&b"K\xf6rper"[..], "ISO_IR 100"),
        ("Körper".as_bytes(), "ISO_IR 192"),
        ("Körper".as_bytes(), ""),
        (b"K\xf6rper", ""),
    ] {
        assert_eq!(all(&named(name, charset)).0[0].label.as_deref(), Some("Körper"), "{charset}");
    }
    let (kind, message) = refusal(&named(b"K\xf6rper", "ISO_IR 192"));
    assert_eq!(kind, FaultKind::Malformed);
    assert!(message.ends_with("expected text in UTF-8 (ISO_IR 192), got other bytes"), "{message}");
    assert!(refusal(&named(b"K\xf6rper", "EBCDIC")).1.ends_with("got 'EBCDIC'"));
    assert_eq!(all(&named(b"Heart", "EBCDIC")).0[0].label.as_deref(), Some("Heart"));
}

#[test]
fn regions_are_chosen_by_their_names() {
    let options = ReadOptions { select: Some("iso*".into()), ..ReadOptions::default() };
    let (records, summary) = records(&Small::default().file(), &options).unwrap();
    assert_eq!(records.len(), 1);
    let left =
        summary.dropped.iter().find(|dropped| dropped.what == "regions that are not selected").unwrap();
    assert_eq!(left.names, ["Heart"]);
}

#[test]
fn a_pattern_that_selects_nothing_is_reported() {
    let options = ReadOptions { select: Some("lung".into()), ..ReadOptions::default() };
    let (records, summary) = records(&Small::default().file(), &options).unwrap();
    assert!(records.is_empty());
    assert_eq!(summary.warnings, ["no region has a name that 'lung' selects"]);
}

#[test]
fn what_identifies_is_named_and_not_shown() {
    let e = IMPLICIT;
    let mut set = Small::default().data_set();
    let nested = [e.text(0x0008_0090, "PN", "Doctor^Secret"), e.text(0x3006_0036, "CS", "MANUAL")].concat();
    set.extend(e.sequence(0x4008_0050, &[nested]));
    set.extend(e.text(0x4009_0010, "LO", "Vendor secret"));
    set.extend(e.text(0x4010_1077, "DA", ""));
    let (records, summary) = all(&e.file(&set));
    let named = |what: &str| {
        let found = summary.dropped.iter().find(|dropped| dropped.what == what).unwrap();
        (found.count, found.names.iter().map(String::as_str).collect::<Vec<_>>())
    };
    assert_eq!(named("identifying elements"), (2, vec!["PatientName", "ReferringPhysicianName"]));
    assert_eq!(named("private elements"), (1, vec!["(4009,0010)"]));
    let said = format!("{records:?} {}", serde_json::to_string(&summary).unwrap());
    assert!(!said.to_lowercase().contains("secret") && !said.contains("Nobody"), "{said}");
}

#[test]
fn long_contours_of_explicit_files_have_no_type() {
    // Lengths of decimal strings have 16 bits where types are explicit: longer ones are of the type UN.
    let e = EXPLICIT;
    let points: Vec<String> = (0..9000).map(|k| format!("{k}.25\\{}.5\\7", k % 90)).collect();
    let data = e.bytes(0x3006_0050, "UN", points.join("\\").as_bytes());
    let item = [e.text(0x3006_0042, "CS", "OPEN_PLANAR"), data].concat();
    let roi = [e.sequence(0x3006_0040, &[item]), e.text(0x3006_0084, "IS", "1")].concat();
    let rois = vec![Roi { name: b"a", contours: Vec::new() }];
    let set = Small { encoding: e, rois, ..Small::default() }.data_set();
    let at = e.text(0x0008_0005, "CS", "ISO_IR 100").len();
    let set = [&set[..at], &e.sequence(0x3006_0039, &[roi]), &set[at..]].concat();
    let found = coordinates(&all(&e.file(&set)).0[0]);
    assert_eq!((found.len(), found[27_000 - 3]), (27_000, 8999.25));
}

#[test]
fn holes_and_parts_are_kept_apart() {
    let contours = vec![ring(2.0, 1.0), ring(0.0, 9.0), ring(30.0, 9.0)];
    let bytes = closed("a", contours).file();
    let (found, summary) = all(&bytes);
    let rings: Vec<_> = found
        .iter()
        .map(|record| {
            let ring = record.ring.as_ref().unwrap();
            (record.name.as_deref().unwrap(), ring.object, ring.part, ring.hole)
        })
        .collect();
    assert_eq!(rings, [("a 2", 0, 0, false), ("a 1", 0, 0, true), ("a 3", 0, 1, false)]);
    assert_eq!(
        summary.warnings,
        [
            "region 'a': 1 slices have several contours, which are records of their own",
            "region 'a': 1 contours of type CLOSED_PLANAR lie within another one and are taken for holes"
        ]
    );
    let (found, summary) = records(&bytes, &ReadOptions::default()).unwrap();
    assert_eq!(found.len(), 2);
    assert!(summary.dropped.iter().any(|dropped| dropped.what == "holes" && dropped.names == ["a 1"]));
    let refuse = ReadOptions { holes: Some(Holes::Refuse), ..ReadOptions::default() };
    assert!(records(&bytes, &refuse).unwrap_err().to_string().ends_with("got one within another"));
}

#[test]
fn keyholes_are_reported_and_kept() {
    let mut keyhole = ring(0.0, 9.0);
    keyhole.push(keyhole[0]);
    let mut inner = ring(0.0, 1.0);
    inner.reverse();
    inner.push(inner[0]);
    keyhole.extend(inner);
    let (found, summary) = all(&closed("a", vec![keyhole.clone()]).file());
    assert_eq!(coordinates(&found[0]).len(), 3 * keyhole.len());
    assert_eq!(found[0].metadata["contour"]["contact"], "keyhole");
    assert!(summary.warnings[0].contains("keyholes"), "{:?}", summary.warnings);
}

#[test]
fn contours_become_plane_curves() {
    let plane = ReadOptions { contours: Some(Contours::Plane), ..ReadOptions::default() };
    let (found, summary) = records(&Small::default().file(), &plane).unwrap();
    assert_eq!(coordinates(&found[0]), [-4.0, -4.0, 4.0, -4.0, 4.0, 4.0, -4.0, 4.0]);
    assert_eq!(found.len(), 3);
    assert!(summary.dropped.iter().any(|dropped| dropped.what.contains("in parallel planes")));
    // Turned by an orthonormal matrix: lengths stay, and the metadata give the point in space.
    let turn = |[x, y, z]: [f64; 3]| {
        [0.36 * x + 0.48 * y - 0.8 * z, -0.8 * x + 0.6 * y, 0.48 * x + 0.64 * y + 0.6 * z]
    };
    let oblique: Vec<[f64; 3]> = ring(3.0, 2.0).into_iter().map(turn).collect();
    let (found, _) = records(&closed("a", vec![oblique.clone()]).file(), &plane).unwrap();
    let points = coordinates(&found[0]);
    let side = (points[2] - points[0]).hypot(points[3] - points[1]);
    assert!((side - 4.0).abs() < 1e-12, "{side}");
    let axis = |name: &str, k: usize| found[0].metadata["plane"][name][k].as_f64().unwrap();
    let offset = found[0].metadata["plane"]["offset"].as_f64().unwrap();
    for (row, expected) in points.as_chunks::<2>().0.iter().zip(&oblique) {
        for k in 0..3 {
            let x = row[0] * axis("u", k) + row[1] * axis("v", k) + offset * axis("normal", k);
            assert!((x - expected[k]).abs() < 1e-12, "{x} {}", expected[k]);
        }
    }
}

fn volume(mesh: &Mesh) -> f64 {
    let rows: Vec<&[f64]> = mesh.vertices.rows().collect();
    let determinant = |face: [u32; 3]| {
        let [a, b, c] = face.map(|k| rows[k as usize]);
        a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0])
            + a[2] * (b[0] * c[1] - b[1] * c[0])
    };
    mesh.faces.triangles().map(determinant).sum::<f64>() / 6.0
}

#[test]
fn slices_become_a_surface() {
    let stack = ReadOptions { contours: Some(Contours::Stack), ..ReadOptions::default() };
    let (found, summary) = records(&Small::default().file(), &stack).unwrap();
    let [Record { geometry: Geometry::Mesh(mesh), .. }] = &found[..] else { panic!("{found:?}") };
    // A box of 8 × 8 × 1.5, and a frustum of 1.5 between squares of 8 and 4: h (A + √(AB) + B)/3.
    let expected = 64.0 * 1.5 + 1.5 * (64.0 + 32.0 + 16.0) / 3.0;
    let volume = volume(mesh);
    assert!((volume - expected).abs() < 1e-12 * expected, "{volume} {expected}");
    let left = summary.dropped.iter().find(|dropped| dropped.what.contains("parallel planes")).unwrap();
    assert_eq!(left.names, ["Isocentre"]);
    let branches = vec![ring(0.0, 1.0), ring(30.0, 1.0)];
    let (found, summary) = records(&closed("a", branches).file(), &stack).unwrap();
    assert!(found.is_empty());
    let expected = "region 'a' makes no surface: expected one contour in every slice, got 2 at z = 5.000 mm";
    assert!(summary.warnings.iter().any(|warning| warning == expected), "{:?}", summary.warnings);
}

/// Images of 5 mm distance, as a structure set knows them.
fn images() -> Vec<SeriesImage> {
    let image = |k: usize| {
        let e = EXPLICIT;
        let set = [
            e.text(0x0008_0016, "UI", "1.2.840.10008.5.1.4.1.1.2"),
            e.text(0x0008_0018, "UI", &format!("1.2.3.{k}")),
            e.text(0x0010_0010, "PN", "Nobody^Known"),
            e.text(0x0020_000d, "UI", "1.2.5"),
            e.text(0x0020_000e, "UI", "1.2.6"),
            e.text(0x0020_0032, "DS", &format!("-100\\-100\\{}", k as f64 * 0.5)),
            e.text(0x0020_0037, "DS", "1\\0\\0\\0\\1\\0"),
            e.text(0x0020_0052, "UI", FRAME),
            // The pixels are missing.
            e.header(0x7fe0_0010, "OW", 524_288),
        ];
        series(&e.file(&set.concat())).unwrap()
    };
    (0..9).map(image).collect()
}

fn written(records: &[Record], options: &WriteOptions) -> Result<(Vec<u8>, Summary), FileError> {
    let mut bytes = Vec::new();
    let mut writer = find("rtstruct").unwrap().writer(&mut bytes, options)?;
    for record in records {
        writer.push(record)?;
    }
    let summary = writer.finish()?;
    Ok((bytes, summary))
}

#[test]
fn what_is_written_comes_back() {
    let options = WriteOptions { series: images(), ..WriteOptions::default() };
    let options = WriteOptions { created: Some("2026-11-26T03:04:05".into()), ..options };
    let uneven = vec![[0.1 + 0.2, -1.0 / 3.0, 2.5], [1e-7, 2.0 / 3.0, 2.5], [-100.0 / 7.0, 8.0, 2.5]];
    let mut small = Small::default();
    small.rois.push(Roi { name: b"uneven", contours: vec![("CLOSEDPLANAR_XOR", uneven)] });
    small
        .rois
        .push(Roi { name: b"path", contours: vec![("OPEN_NONPLANAR", vec![[0.0; 3], [1.0, 2.0, 3.0]])] });
    let (before, _) = all(&small.file());
    let (bytes, summary) = written(&before, &options).unwrap();
    assert_eq!(summary.records, before.len() as u64);
    assert_eq!(summary.warnings, ["1 contours are in the plane of no image of the series and refer to none"]);
    let (after, _) = all(&bytes);
    assert_eq!(after.len(), before.len());
    for (before, after) in before.iter().zip(&after) {
        assert_eq!(
            (&before.name, &before.label, &before.metadata),
            (&after.name, &after.label, &after.metadata)
        );
        for (x, y) in coordinates(before).iter().zip(coordinates(after)) {
            // A sign, a point and a leading zero leave 13 digits of 16 characters.
            assert!((x - y).abs() <= 1e-13 * x.abs().max(1.0), "{x} {y}");
        }
    }
    assert_eq!(written(&before, &options).unwrap().0, bytes, "the same shapes make the same file");
    assert_ne!(written(&before[1..], &options).unwrap().0, bytes);
    let object = dicom_object::from_reader(&bytes[..]).unwrap();
    let tag = dicom_dictionary_std::tags::STRUCTURE_SET_DATE;
    assert_eq!(object.element(tag).unwrap().to_str().unwrap(), "20261126");
}

#[test]
fn plane_curves_are_written_in_their_planes() {
    let plane = ReadOptions { contours: Some(Contours::Plane), ..ReadOptions::default() };
    let (mut records, _) = records(&Small::default().file(), &plane).unwrap();
    let options = WriteOptions { series: images(), ..WriteOptions::default() };
    let (bytes, _) = written(&records, &options).unwrap();
    let (back, _) = all(&bytes);
    assert_eq!(coordinates(&back[0]), [-4.0, -4.0, 1.0, 4.0, -4.0, 1.0, 4.0, 4.0, 1.0, -4.0, 4.0, 1.0]);
    records[0].metadata.remove("plane");
    let error = written(&records, &options).unwrap_err().to_string();
    assert!(error.contains("expected three coordinates, or two and the plane they are in"), "{error}");
}

#[test]
fn what_cannot_be_written_is_named() {
    let (records, _) = all(&Small::default().file());
    let refused =
        |records: &[Record], options: &WriteOptions| written(records, options).unwrap_err().to_string();
    let expected = "series: expected the images of a series that the structure set refers to, got none";
    assert_eq!(refused(&records, &WriteOptions::default()), expected);
    let mut options = WriteOptions { series: images(), ..WriteOptions::default() };
    assert!(refused(&[], &options).ends_with("got none"));
    let mut other = records.clone();
    other[0].label = Some("a\\b".into());
    assert!(refused(&other, &options).contains("expected at most 64 characters for the name of a region"));
    other = records.clone();
    other[0].metadata.insert("frame_of_reference".into(), "9.9".into());
    assert!(
        refused(&other, &options)
            .contains("expected shapes in the frame of reference of the series, 1.2.3.4, got 9.9")
    );
    options.created = Some("yesterday".into());
    assert!(refused(&records, &options).contains("(option created)"));
    options.created = None;
    options.series[2].instance = "1.2\\3".into();
    assert!(refused(&records, &options).contains("at most 64 digits and points"));
    options.series[3].series = "1.2.7".into();
    assert!(refused(&records, &options).ends_with("got another at image 3"));
}

#[test]
fn headers_of_images_are_read() {
    let image = &images()[2];
    assert_eq!((image.instance.as_str(), image.position), ("1.2.3.2", [-100.0, -100.0, 1.0]));
    let (Some(bytes), Some(oblique)) = (load("phantom_ct_2.dcm"), load("oblique_ct_1.dcm")) else { return };
    let image = series(&bytes).unwrap();
    assert_eq!(image.position, [-125.0, -125.0, 65.0]);
    let error = series(&oblique).unwrap_err().to_string();
    assert_eq!(error, "(0020,0052): expected a frame of reference, got none");
    let error = series(&Small::default().file()).unwrap_err().to_string();
    assert!(error.ends_with("expected the identifier of an image, got none"), "{error}");
}
