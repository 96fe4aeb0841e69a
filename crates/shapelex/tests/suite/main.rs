//! Laws of the front, and files of other programs where they are there.
#![allow(clippy::unwrap_used, clippy::print_stdout)]

use std::f64::consts::TAU;
use std::path::{Path, PathBuf};

use shapelex::{Class, Contours, Error, Landmarks, Mirror, Points, Setting};

/// An ellipse with a bump, drawn from point `start` on, and the other way round if `backwards`.
fn outline(k: usize, start: usize, backwards: bool) -> Vec<[f64; 2]> {
    let width = 1.5 + 0.3 * (3.0 * k as f64).sin();
    let point = |i: usize| {
        let angle = TAU * ((i + start) % 60) as f64 / 60.0;
        let radius = 1.0 + 0.1 * (2.0 * angle + k as f64).cos();
        [width * radius * angle.cos(), radius * angle.sin()]
    };
    let mut points: Vec<[f64; 2]> = (0..60).map(point).collect();
    if backwards {
        points.reverse();
    }
    points
}

/// Where a contour begins and which way it runs changes the mean by the resampling alone.
#[test]
fn beginnings_and_directions_of_contours_do_not_count() {
    let mean =
        |contours: Vec<Vec<[f64; 2]>>| Contours::new(contours).unwrap().mean(Class::Similarity).unwrap();
    let given = mean((0..8).map(|k| outline(k, 0, false)).collect());
    let other = mean((0..8).map(|k| outline(k, 7 * k, k % 2 == 1)).collect());
    assert_eq!((given.shapes, given.unique), (8, Some(true)));
    for (a, b) in given.distances.iter().zip(&other.distances) {
        // 60 points of polygons are resampled to 64: a thousandth of the size, as the polygon leaves the curve.
        assert!((a - b).abs() < 2e-3, "{a}, {b}");
    }
}

#[test]
fn a_robust_mean_leaves_another_organ_out() {
    let organ = |k: usize| {
        let star = |i: usize| {
            let angle = TAU * i as f64 / 60.0;
            let radius = 1.0 + 0.5 * (3.0 * angle).cos() + 0.01 * (k as f64).sin();
            [radius * angle.cos(), radius * angle.sin()]
        };
        (0..60).map(star).collect()
    };
    let contours =
        Contours::new((0..20).map(|k| if k < 15 { outline(k, 0, false) } else { organ(k) })).unwrap();
    let mut setting = Setting::new(Class::Similarity);
    setting.robust = true;
    let mean = contours.mean(&setting).unwrap();
    assert!(mean.weights[15..].iter().all(|weight| *weight == 0.0), "{:?}", mean.weights);
    let plain = contours.mean(Class::Similarity).unwrap();
    assert_eq!(plain.weights, vec![1.0; 20]);
    let labelled = contours.with_labels((0..20).map(|k| if k < 15 { "a" } else { "b" })).unwrap();
    assert!(matches!(labelled.compare(setting), Err(Error::Setting { field: "robust", .. })));
}

#[test]
fn what_does_not_fit_is_refused_at_its_place() {
    let triangle = vec![[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]];
    let refused = |found: Result<shapelex::Mean, Error>| found.unwrap_err().to_string();
    let with = |points: Vec<[f64; 2]>| Landmarks::new([triangle.clone(), points]);
    assert_eq!(
        with(vec![[0.0, 0.0]]).unwrap_err().to_string(),
        "shape 1: expected 3 points, as all shapes have, got 1"
    );
    let wild = with(vec![[0.0, 0.0], [f64::NAN, 0.0], [0.0, 1.0]]).unwrap();
    let said = refused(wild.mean(Class::Similarity));
    assert!(said.starts_with("shape 1: point 1: expected a number within"), "{said}");
    let still = with(vec![[2.0, 2.0]; 3]).unwrap();
    assert!(matches!(still.mean(Class::Similarity), Err(Error::Analysis(_))));
    assert!(matches!(Contours::new::<2>([]), Err(Error::Setting { field: "shapes", .. })));
    let mixed = [Points::from_arrays(&[[0.0; 2]; 3]), Points::from_arrays(&[[0.0; 3]; 3])];
    assert!(matches!(Contours::from_points(mixed, true), Err(Error::Shape { index: 1, .. })));
    let few = Contours::new([outline(0, 0, false), outline(1, 0, false)]).unwrap().resample(1);
    assert!(few.mean(Class::Similarity).is_err());
    let mut mirrored = Setting::default();
    mirrored.mirror = Mirror::Allow;
    assert!(with(triangle.clone()).unwrap().mean(mirrored).is_ok());
    let pca = Contours::new((0..9).map(|k| outline(k, 0, false))).unwrap().pca(Class::Similarity, 2).unwrap();
    let said = pca.score(&with(triangle.clone()).unwrap()).unwrap_err().to_string();
    assert!(said.starts_with("shape 0: expected 64 control points"), "{said}");
    let said = pca.reconstruct(&[0.0]).unwrap_err().to_string();
    assert_eq!(said, "values: expected 2, one for each component, got 1");
    assert!(matches!(Contours::read("nowhere.geojson"), Err(Error::Open { .. })));
    let lines = b"{\"points\": [[0, 0], [2, 0], [1, 1]], \"closed\": true}\n{\"points\": [[0, 0], [2, 0], [1";
    assert!(matches!(Contours::read_from("cut.ndjson", &lines[..]), Err(Error::File(_))));
}

/// The folder of shared data beside the checkout; `None` says that it is not there.
fn shared(path: &str) -> Option<PathBuf> {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data").join(path);
    if !file.exists() {
        println!("SKIPPED: {path}, there is no folder of data beside the checkout");
    }
    file.exists().then_some(file)
}

/// Outlines of hearts in eight hands: a model of them scores its own shapes, and few are called outliers.
#[test]
fn real_contours_are_described() {
    let Some(path) = shared("curves-hearts/curves.ndjson") else { return };
    let lines = std::fs::read_to_string(path).unwrap();
    let records = lines.lines().map(|line| serde_json::from_str::<serde_json::Value>(line).unwrap());
    let points = |record: serde_json::Value| {
        serde_json::from_value::<Vec<[f64; 2]>>(record["points"].clone()).unwrap()
    };
    let hearts = Contours::new(records.map(points)).unwrap().resample(48);
    assert_eq!(hearts.len(), 168);
    let pca = hearts.pca(Class::Similarity, 8).unwrap();
    let explained: f64 = pca.explained().iter().sum();
    assert!((0.8..=1.0).contains(&explained), "{explained}");
    let outliers = pca.score(&hearts).unwrap().iter().filter(|score| score.is_outlier).count();
    assert!(outliers <= 8, "{outliers}");
}

/// Regions of QuPath, as it wrote them; cut in the middle, the same file is refused, as one with points among its regions is.
#[test]
fn files_of_other_programs_are_read_whole_or_refused() {
    let Some(path) = shared("formats-qupath-geojson/2023_02_02__CD163_CD31_CDH1_CTB2.geojson") else {
        return;
    };
    let regions = Contours::read(&path).unwrap();
    assert!(!regions.is_empty() && regions.points().iter().all(|points| points.len() >= 3));
    let whole = std::fs::read(&path).unwrap();
    let cut = Contours::read_from("cut.geojson", &whole[..whole.len() / 2]);
    assert!(matches!(cut, Err(Error::File(_))), "{cut:?}");
    let Some(mixed) = shared("formats-qupath-geojson/03012023_JN.geojson") else { return };
    assert!(matches!(Contours::read(mixed), Err(Error::Shape { index: 0, .. })));
}
