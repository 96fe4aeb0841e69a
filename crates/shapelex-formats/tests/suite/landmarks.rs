//! Landmarks of real studies beside the checkout, compared with ktch and pandas.
//!
//! The figures: `ktch.io.read_tps(f)` and the sums of `landmarks` and `curves` of its specimens without NaN, and
//! `a = pandas.read_csv(f)[columns].to_numpy()` with the columns `x1`, `y1`, …, its sum, and the sum of
//! `a * (numpy.arange(a.size).reshape(a.shape) % 97)`, which another order of points or axes changes.

use std::path::{Path, PathBuf};

use shapelex_formats::shape::{
    Curves, FaultKind, Format, Geometry, Layout, Limits, Points, ReadOptions, Record, Scale, Source, Summary,
    WriteOptions, detect, find, read,
};

/// A file of the data, or a line that says that it is not there.
fn load(name: &str) -> Option<Vec<u8>> {
    let folder: PathBuf = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data");
    let bytes = std::fs::read(folder.join(name)).ok();
    if bytes.is_none() {
        eprintln!("SKIPPED: {name} is not here");
    }
    bytes
}

fn records(bytes: &[u8], format: &Format, options: &ReadOptions) -> (Vec<Record>, Summary) {
    let mut found = Vec::new();
    let mut source = Source::new(bytes, Limits::default()).unwrap();
    let summary = read(format, &mut source, options, &mut |record| {
        found.push(record);
        Ok(())
    });
    (found, summary.unwrap())
}

/// The records of a file of the data, whose format is detected.
fn read_file(name: &str, options: &ReadOptions) -> Option<(Vec<Record>, Summary)> {
    let bytes = load(name)?;
    let format = detect(&bytes[..bytes.len().min(4096)], Some(name)).unwrap();
    Some(records(&bytes, format, options))
}

fn write(records: &[Record], format: &str, options: &WriteOptions) -> (Vec<u8>, Summary) {
    let mut bytes = Vec::new();
    let mut writer = find(format).unwrap().writer(&mut bytes, options).unwrap();
    for record in records {
        writer.push(record).unwrap();
    }
    let summary = writer.finish().unwrap();
    (bytes, summary)
}

fn points(record: &Record) -> &Points {
    match &record.geometry {
        Geometry::Landmarks(points) | Geometry::Curve { points, .. } => points,
        _ => panic!("no points"),
    }
}

/// Compares the sum of the coordinates that are not missing, to 1e-12 of that of their sizes: another order of summation rounds
/// otherwise. `weight`: what the coordinate at a position counts.
fn assert_sum(records: &[&Record], weight: impl Fn(usize) -> f64, expected: f64, name: &str) {
    let all = records.iter().flat_map(|record| points(record).coordinates()).enumerate();
    let terms: Vec<f64> = all.map(|(k, x)| weight(k) * x).filter(|x| !x.is_nan()).collect();
    let (sum, size) = (terms.iter().sum::<f64>(), terms.iter().map(|x| x.abs()).sum::<f64>());
    assert!(
        (sum - expected).abs() <= 1e-12 * size,
        "{name}: {sum} instead of {expected}, of terms of {size}"
    );
}

/// As texts: missing coordinates do not equal themselves.
fn assert_same(a: &[Record], b: &[Record]) {
    assert_eq!(a.len(), b.len());
    for (a, b) in a.iter().zip(b) {
        assert_eq!(format!("{:?}", a.geometry), format!("{:?}", b.geometry), "{:?}", a.name);
        assert_eq!((&a.name, &a.label, &a.labels), (&b.name, &b.label, &b.labels));
    }
}

#[test]
fn tps_files_are_those_of_ktch() {
    let leave = ReadOptions { scale: Some(Scale::Leave), ..ReadOptions::default() };
    for (name, specimens, landmarks, sums) in [
        ("formats-tps/landmarks_triangle.tps", 50, 3, [147.61756849280735, 0.0]),
        ("formats-tps/sample_curve_data.tps", 1, 1, [400.0, 30475.0]),
        ("landmarks-dragonfly-wings/forewing.tps", 80, 20, [1741664.0, 0.0]),
        ("landmarks-trilobite-cephala/cephala.tps", 210, 16, TRILOBITES),
    ] {
        let Some((found, summary)) = read_file(name, &leave) else { continue };
        let is_curve = |record: &&Record| matches!(record.geometry, Geometry::Curve { .. });
        let (curves, points_of): (Vec<_>, Vec<_>) = found.iter().partition(is_curve);
        assert_eq!(points_of.len(), specimens, "{name}");
        assert!(points_of.iter().all(|record| points(record).len() == landmarks), "{name}");
        assert_sum(&points_of, |_| 1.0, sums[0], name);
        assert_sum(&curves, |_| 1.0, sums[1], name);
        assert_eq!(summary.dropped, [], "{name}");
        // What is written is read as the same, and written as the same.
        let (bytes, summary) = write(&found, "tps", &WriteOptions::default());
        assert_eq!(summary.dropped, [], "{name}");
        let (again, _) = records(&bytes, find("tps").unwrap(), &leave);
        assert_same(&found, &again);
        assert_eq!(
            found.iter().map(|r| &r.metadata).collect::<Vec<_>>(),
            again.iter().map(|r| &r.metadata).collect::<Vec<_>>()
        );
    }
}

/// Sums of landmarks and curves of the trilobites.
const TRILOBITES: [f64; 2] = [106709.03482100001, 519191.7968190002];

#[test]
fn trilobites_keep_curves_missing_points_and_units() {
    let name = "landmarks-trilobite-cephala/cephala.tps";
    let Some((found, summary)) = read_file(name, &ReadOptions::default()) else { return };
    assert_eq!((found.len(), found[1].name.as_deref()), (1050, Some("1023_Liu_1977 curve 1")));
    assert_eq!(found.iter().map(|record| points(record).missing().len()).sum::<usize>(), 23);
    assert_eq!(summary.properties["scale"], "left");
    assert!(summary.warnings[0].starts_with("202 of 210 specimens have SCALE="), "{}", summary.warnings[0]);
    let append = ReadOptions { curves: Some(Curves::Append), ..ReadOptions::default() };
    let (found, _) = read_file(name, &append).unwrap();
    assert!(found.iter().all(|record| points(record).len() == 16 + 12 + 20 + 20 + 20));
    let apply = ReadOptions { scale: Some(Scale::Apply), ..ReadOptions::default() };
    let bytes = load(name).unwrap();
    let mut source = Source::new(&bytes[..], Limits::default()).unwrap();
    let error = read(find("tps").unwrap(), &mut source, &apply, &mut |_| Ok(())).unwrap_err();
    assert_eq!(
        (error.kind, error.detail.as_str()),
        (FaultKind::Malformed, "expected SCALE= in every specimen, got one without")
    );
}

#[test]
fn a_scale_multiplies_landmarks_and_curves() {
    let Some((found, _)) = read_file("formats-tps/sample_curve_data.tps", &ReadOptions::default()) else {
        return;
    };
    assert_eq!(points(&found[0]).coordinates(), [3.75, 6.25]);
    assert_sum(&[&found[1]], |_| 1.0, 30475.0 * 0.025, "curve");
    assert_eq!(found[0].metadata["variables"][0], "Area=25.750");
}

#[test]
fn tables_are_those_of_pandas() {
    for (name, shapes, [dimension, count], sums, attributes) in [
        ("landmarks-ape-skulls", 117, [2, 8], [104637.0, 5011414.0], 3),
        ("landmarks-brains-3d", 58, [3, 24], [243545.0, 11677854.5], 4),
        ("landmarks-digit3", 30, [2, 13], [-1535.0, -68513.0], 0),
        ("landmarks-macaque-skulls-3d", 18, [3, 7], [27614.597719999998, 1291639.1374599999], 1),
        ("landmarks-mosquito-wings", 90, [2, 18], [-0.002299999999991087, -51.01440000000012], 1),
        ("landmarks-nasal-bone-3d", 56, [3, 10], [126220.00829999999, 5959389.101399999], 2),
        ("landmarks-oak-leaves", 176, [2, 11], [33587.936204000005, 1607498.894506], 4),
        ("landmarks-optic-nerve-3d", 22, [3, 5], [557199.86, 24818697.37], 2),
        ("landmarks-passiflora-leaves", 2325, [2, 15], [1.621432602405548e-06, 109031.7465681514], 2),
        ("landmarks-plethodon", 40, [2, 12], [30976.329191999997, 1480225.973435], 2),
        ("landmarks-primate-crania-3d", 28, [3, 55], [-642622.5445112999, -30807626.297949784], 1),
        ("landmarks-pupfish", 54, [2, 56], [1.7479351299698465e-11, 169.5652392498485], 3),
        ("landmarks-pupfish-species", 678, [2, 34], [62.623360053021884, 3059.3399561167626], 4),
        ("landmarks-rat-growth", 144, [2, 8], [-739271.0, -35496422.0], 2),
    ] {
        let Some((found, summary)) = read_file(&format!("{name}/landmarks.csv"), &ReadOptions::default())
        else {
            continue;
        };
        assert_eq!((found.len(), summary.dropped.len()), (shapes, 0), "{name}");
        let size = |record: &Record| [points(record).dimension(), points(record).len()];
        assert!(found.iter().all(|record| size(record) == [dimension, count]), "{name}");
        assert!(found.iter().all(|record| record.labels.len() <= attributes), "{name}");
        let all: Vec<&Record> = found.iter().collect();
        assert_sum(&all, |_| 1.0, sums[0], name);
        assert_sum(&all, |k| (k % 97) as f64, sums[1], name);
        let text = find("csv").unwrap();
        for layout in [Layout::Wide, Layout::Long] {
            let options = WriteOptions { layout: Some(layout), ..WriteOptions::default() };
            let (bytes, _) = write(&found, "csv", &options);
            assert_same(&found, &records(&bytes, text, &ReadOptions::default()).0);
        }
    }
}

#[test]
fn landmarks_pass_through_every_format_of_landmarks() {
    let Some((found, _)) = read_file("landmarks-brains-3d/landmarks.csv", &ReadOptions::default()) else {
        return;
    };
    for format in ["tps", "nts", "morphologika", "csv", "mrk"] {
        let (bytes, _) = write(&found, format, &WriteOptions::default());
        let (again, _) = records(&bytes, find(format).unwrap(), &ReadOptions::default());
        for (a, b) in found.iter().zip(&again) {
            assert_eq!((&a.name, &a.geometry), (&b.name, &b.geometry), "{format}");
        }
        assert_eq!(found.len(), again.len(), "{format}");
        if format == "morphologika" {
            assert_same(&found, &again);
        }
        assert_eq!(detect(&bytes[..bytes.len().min(4096)], Some(&format!("a.{format}"))).unwrap().id, format);
    }
    let (bytes, _) = write(&found[..1], "fcsv", &WriteOptions::default());
    let (again, _) = records(&bytes, find("fcsv").unwrap(), &ReadOptions::default());
    assert_eq!(found[0].geometry, again[0].geometry);
}

/// Seeds of the fuzz target with changed bytes: whatever is read of them can be written, and what is written is read as the same
/// shapes.
#[test]
fn changed_files_are_refused_or_pass_through_every_format() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fuzz/corpus/shape_files");
    let formats = ["tps", "nts", "morphologika", "fcsv", "mrk", "csv", "chc", "nef"];
    let mut names: Vec<_> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    names.retain(|path| {
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        detect(b"", Some(&name)).is_ok_and(|format| formats.contains(&format.id))
    });
    names.sort();
    assert!(names.len() >= 12);
    let mut random = 1_u64;
    let mut draw = |below: usize| {
        // The generator of Knuth's MMIX, whose high bits are good.
        random = random.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (random >> 33) as usize % below
    };
    let (mut read_back, mut refused, mut faults) = (0, 0, Vec::new());
    for path in names {
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        let format = detect(b"", Some(&name)).unwrap();
        let seed = std::fs::read(&path).unwrap();
        for _ in 0..200 {
            let mut bytes = seed.clone();
            for _ in 0..1 + draw(2) {
                let at = draw(bytes.len());
                match draw(4) {
                    0 => bytes[at] = b"0123456789-.eNA=[]{},;\"' \n\t\xff"[draw(28)],
                    1 => drop(bytes.remove(at)),
                    2 => bytes.insert(at, b"0-.e[\"=#\n"[draw(9)]),
                    _ => drop(bytes.splice(at..at, seed[draw(seed.len())..].iter().copied().take(20))),
                }
            }
            let mut found = Vec::new();
            let limits = Limits { points: 1000, records: 100, held: 1 << 20, ..Limits::default() };
            let mut source = Source::new(&bytes[..], limits).unwrap();
            let result = read(format, &mut source, &ReadOptions::default(), &mut |record| {
                found.push(record);
                Ok(())
            });
            refused += usize::from(result.is_err());
            read_back +=
                found.iter().map(|record| pass_through(record, &formats, &mut faults)).sum::<usize>();
        }
    }
    assert!(
        faults.is_empty(),
        "{} faults, such as {}",
        faults.len(),
        faults[..faults.len().min(8)].join("\n\n")
    );
    // Neither is rare: the test would be empty.
    assert!(refused > 1000 && read_back > 3000, "{refused} refused, {read_back} read back");
}

/// Writes a record to each format that holds it, and compares what is read of that. Returns the number of formats.
fn pass_through(record: &Record, formats: &[&str], faults: &mut Vec<String>) -> usize {
    let mut count = 0;
    for id in formats {
        let (format, mut bytes) = (find(id).unwrap(), Vec::new());
        let mut writer = format.writer(&mut bytes, &WriteOptions::default()).unwrap();
        if writer.push(record).is_err() {
            continue;
        }
        let summary = writer.finish().unwrap();
        // As the record may have a scale that was left.
        let scale = (*id == "tps").then_some(Scale::Leave);
        let options = ReadOptions { scale, ..ReadOptions::default() };
        let mut again = Vec::new();
        let mut source = Source::new(&bytes[..], Limits::default()).unwrap();
        let result = read(format, &mut source, &options, &mut |record| {
            again.push(record);
            Ok(())
        });
        let shape = |record: &Record| match &record.geometry {
            Geometry::Landmarks(points) | Geometry::Curve { points, .. } => format!("{points:?}"),
            other => format!("{other:?}"),
        };
        let is_less = |what: &str| what.starts_with("digits") || what == "centres";
        let is_whole = summary.dropped.iter().all(|dropped| !is_less(&dropped.what));
        let text = String::from_utf8_lossy(&bytes);
        if result.is_err() || again.len() != 1 || is_whole && shape(record) != shape(&again[0]) {
            faults.push(format!("{id}: {result:?}\n{text}\n{record:?}"));
        }
        count += 1;
    }
    count
}
