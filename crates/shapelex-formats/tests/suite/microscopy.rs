//! Files of QuPath and ImageJ beside the checkout, compared with shapely and roifile.
//!
//! The figures: sum of the areas and lengths of `shapely.geometry.shape(feature["geometry"])` over all features; for regions, area of
//! the polygon of `roifile.ImagejRoi.fromfile(f).coordinates(multi=True)`, for ovals that of the ellipse. `tests/interop/microscopy.py`
//! compares every shape.

use std::path::Path;

use shapelex_formats::shape::{
    FileError, Geometry, Holes, Limits, Points, ReadOptions, Record, Source, Summary, WriteOptions, detect,
    find, read,
};

/// A file of the data, or a line that says that it is not there.
fn load(name: &str) -> Option<Vec<u8>> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data");
    let bytes = std::fs::read(folder.join(name)).ok();
    if bytes.is_none() {
        eprintln!("SKIPPED: {name} is not here");
    }
    bytes
}

fn read_all(bytes: &[u8], name: &str) -> Result<(Vec<Record>, Summary), FileError> {
    let mut records = Vec::new();
    let mut source = Source::new(bytes, Limits::default())?;
    let format = detect(source.head(), Some(name))?;
    let holes = format.options.contains(&"holes").then_some(Holes::Keep);
    let options = ReadOptions { holes, ..ReadOptions::default() };
    let summary = read(format, &mut source, &options, &mut |record| {
        records.push(record);
        Ok(())
    })?;
    Ok((records, summary))
}

fn written(records: &[Record], format: &str) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut writer = find(format).unwrap().writer(&mut bytes, &WriteOptions::default()).unwrap();
    records.iter().for_each(|record| writer.push(record).unwrap());
    writer.finish().unwrap();
    bytes
}

fn points(record: &Record) -> &Points {
    match &record.geometry {
        Geometry::Curve { points, .. } | Geometry::Landmarks(points) => points,
        other => panic!("expected points, got {other:?}"),
    }
}

/// Area, of holes negative, and length, of curves with their last edge.
fn figures(records: &[Record]) -> [f64; 2] {
    let mut sums = [0.0; 2];
    for record in records {
        let Geometry::Curve { points, closed } = &record.geometry else { continue };
        let rows: Vec<&[f64]> = points.rows().collect();
        let edges = rows.iter().zip(rows[1..].iter().chain(closed.then_some(&rows[0])));
        let (mut area, mut length) = (0.0, 0.0);
        for (a, b) in edges {
            area += a[0] * b[1] - a[1] * b[0];
            length += (a[0] - b[0]).hypot(a[1] - b[1]);
        }
        let is_hole = record.ring.as_ref().is_some_and(|ring| ring.hole);
        sums[0] += f64::from(u8::from(*closed)) * area.abs() / 2.0 * if is_hole { -1.0 } else { 1.0 };
        sums[1] += length;
    }
    sums
}

fn assert_near(found: f64, expected: f64, what: &str) {
    let tolerance = 1e-9 * expected.abs().max(1.0);
    assert!((found - expected).abs() <= tolerance, "{what}: {found} instead of {expected} ± {tolerance}");
}

#[test]
fn features_of_qupath_have_the_areas_of_shapely() {
    for (name, count, [area, length]) in [
        ("03012023_JN.geojson", 6, [328610.66929999983, 3458.067062719886]),
        ("2023_02_02__CD163_CD31_CDH1_CTB2.geojson", 6, [129511.3222, 5101.81329769335]),
        ("MultiPolygon.geojson", 155, [16112764.525, 173721.08328469875]),
        ("TD_01_verysmall_mIF.geojson", 9, [148764.57765000002, 4388.461801029382]),
        ("objects2.geojson", 2, [190980.27059999987, 2371.4322450894797]),
    ] {
        let Some(bytes) = load(&format!("formats-qupath-geojson/{name}")) else { continue };
        let (records, summary) = read_all(&bytes, name).unwrap();
        assert_eq!((records.len(), summary.dropped, summary.warnings), (count, vec![], vec![]), "{name}");
        let found = figures(&records);
        assert_near(found[0], area, name);
        assert_near(found[1], length, name);
        for format in ["geojson", "wkt"] {
            let (again, _) = read_all(&written(&records, format), &format!("x.{format}")).unwrap();
            assert_eq!(again.len(), count, "{name}");
            for (a, b) in records.iter().zip(&again) {
                assert_eq!((&a.geometry, &a.name), (&b.geometry, &b.name), "{name}");
                assert!(
                    format == "wkt" || (&a.label, &a.metadata) == (&b.label, &b.metadata),
                    "{name}: {a:?} {b:?}"
                );
            }
        }
        // A feature that is cut off is refused, whatever stands before it.
        for end in (1..bytes.len() - 4).step_by(bytes.len() / 97) {
            assert!(read_all(&bytes[..end], name).is_err(), "{name} {end}");
        }
    }
}

#[test]
fn regions_of_imagej_have_the_areas_of_roifile() {
    let pi = std::f64::consts::PI;
    for (name, rings, area, tolerance) in [
        ("composite-brush-donut", 2, 18.0, 0.0),
        ("composite-oval-in-rect", 2, 938.0, 0.0),
        ("composite-rect-in-rect", 2, 2562.0 - 558.0, 0.0),
        ("composite-two-ellipses", 2, 1397.019389138255, 1e-9),
        ("ellipse-top", 1, 32.724628988279164, 1e-9),
        ("ellipse", 1, 24.600253288354935, 1e-9),
        ("freeline", 1, 0.0, 0.0),
        ("line1", 1, 0.0, 0.0),
        // The chords depart by at most 0.01 from the ellipse: no more than that along the outline.
        ("oval-left", 1, 9.0 * pi, 0.01 * 6.0 * pi),
        ("oval", 1, 17.0 * 18.5 * pi, 0.01 * 37.0 * pi),
        ("point", 1, 0.0, 0.0),
        ("polygon-top", 1, 24.5, 0.0),
        ("polygon", 1, 7163.0, 0.0),
        ("polyline", 1, 0.0, 0.0),
        ("rectangle", 1, 1548.0, 0.0),
    ] {
        let Some(bytes) = load(&format!("formats-imagej-roi/{name}.roi")) else { continue };
        let (records, summary) = read_all(&bytes, "x").unwrap();
        assert_eq!((records.len(), summary.dropped), (rings, vec![]), "{name}");
        let [found, _] = figures(&records);
        assert!((found - area).abs() <= tolerance, "{name}: {found} instead of {area} ± {tolerance}");
        let (again, _) = read_all(&written(&records, "imagej-roi"), "x").unwrap();
        for (a, b) in records.iter().zip(&again) {
            let near = points(a).coordinates().iter().zip(points(b).coordinates());
            // Single precision, of numbers below 2⁹.
            assert!(near.into_iter().all(|(a, b)| (a - b).abs() <= 2f64.powi(-15)), "{name}");
            assert_eq!((&a.name, &a.ring, points(a).len()), (&b.name, &b.ring, points(b).len()), "{name}");
            assert_eq!(a.metadata.get("counters"), b.metadata.get("counters"), "{name}");
        }
        for end in 0..bytes.len() {
            assert!(read_all(&bytes[..end], "x.roi").is_err(), "{name} {end}");
        }
    }
}

#[test]
fn names_and_positions_are_those_of_imagej() {
    let Some(bytes) = load("formats-imagej-roi/point.roi") else { return };
    let (records, _) = read_all(&bytes, "point.roi").unwrap();
    assert_eq!(points(&records[0]).coordinates(), [68.0, 77.25]);
    assert_eq!(records[0].name.as_deref(), Some("0001-0077-0068"));
    for (key, value) in [
        ("channel", 1.into()),
        ("slice", 1.into()),
        ("frame", 1.into()),
        ("counters", serde_json::json!([0])),
    ] {
        assert_eq!(records[0].metadata.get(key), Some(&value), "{key}");
    }
}

#[test]
fn damaged_seeds_are_read_or_refused() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fuzz/corpus/shape_files");
    let seeds = [
        "cell.geojson",
        "kinds.geojsonl",
        "polygon.roi",
        "composite.roi",
        "oval.roi",
        "kinds.wkt",
        "instances.coco.json",
    ];
    let mut state = 7_u64;
    // The generator of Knuth (MMIX); its upper bits are used.
    let mut draw = |below: usize| {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (state >> 33) as usize % below
    };
    for name in seeds {
        let seed = std::fs::read(folder.join(name)).unwrap();
        assert!(read_all(&seed, name).is_ok(), "{name}");
        for _ in 0..1500 {
            let mut bytes = seed.clone();
            for _ in 0..=draw(3) {
                let at = draw(bytes.len());
                match draw(4) {
                    0 => bytes[at] = draw(256) as u8,
                    1 => bytes[at] ^= 1 << draw(8),
                    2 => drop(bytes.remove(at)),
                    _ => bytes.insert(at, b"{}[],:\"\\0-e(x"[draw(13)]),
                }
            }
            // What is read is finite and can be written and read again.
            let Ok((records, _)) = read_all(&bytes, name) else { continue };
            let finite =
                |record: &Record| points(record).coordinates().iter().all(|x| x.abs() <= 1e100 || x.is_nan());
            assert!(records.iter().all(finite), "{name}: {bytes:?}");
            let known: Vec<Record> = records
                .into_iter()
                .filter(|record| points(record).len() > 2 && points(record).missing().is_empty())
                .collect();
            assert_eq!(
                read_all(&written(&known, "geojson"), "x.geojson").unwrap().0.len(),
                known.len(),
                "{name}: {bytes:?}"
            );
        }
    }
}
