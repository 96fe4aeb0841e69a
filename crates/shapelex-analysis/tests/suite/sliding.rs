//! Sliding against `elastic/sliding.json`: the iteration of `gpagen` to 1e-10, the centred one to 1e-8. The scallops of the vectors are
//! copyleft and are read beside the project. Laws.

use std::collections::HashMap;
use std::path::Path;

use serde_json::Value;
use shapelex_analysis::sliding::error::SlidingError;
use shapelex_analysis::sliding::table::Sliders;
use shapelex_analysis::sliding::{Slid, SlidingCriterion, centred, gpagen};
use shapelex_analysis::watch::Unwatched;
use shapelex_numeric::dense::{Matrix, svd};

type Rows = Vec<Vec<f64>>;

/// Coordinate-major.
fn columns(rows: &Rows) -> Vec<f64> {
    (0..rows[0].len()).flat_map(|c| rows.iter().map(move |row| row[c])).collect()
}

fn rows(value: &Value) -> Rows {
    serde_json::from_value(value.clone()).unwrap()
}

fn largest(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// `shape` after the best rotation onto `onto`.
fn turned(shape: &[f64], onto: &[f64], d: usize) -> Vec<f64> {
    let [x, y] = [shape, onto].map(|of| Matrix::from_column_slice(of.len() / d, d, of));
    let found = svd(y.transpose() * &x, true, true).unwrap();
    let (mut u, v) = (found.u.unwrap(), found.v_t.unwrap());
    if (&u * &v).determinant() < 0.0 {
        u.column_mut(found.singular_values.imin()).neg_mut();
    }
    (x * (u * v).transpose()).as_slice().to_vec()
}

/// A set of the vectors.
struct Set {
    shapes: Vec<Vec<f64>>,
    dimension: usize,
    sliders: Sliders,
}

fn criterion(case: &Value) -> SlidingCriterion {
    serde_json::from_value(case["criterion"].clone()).unwrap()
}

fn check_gpagen(set: &Set, case: &Value) {
    let options = (set.dimension, criterion(case));
    let found = gpagen::slide(&set.shapes, &set.sliders, options, [true, false], &Unwatched).unwrap();
    let name = format!("{} {}", case["name"], case["criterion"]);
    assert_eq!(found.rounds as u64, case["rounds"].as_u64().unwrap(), "{name}");
    let shape = |key: &str| columns(&rows(&case[key]));
    assert!(
        largest(&found.consensus, &shape("consensus")) < 1e-10,
        "{name} {:e}",
        largest(&found.consensus, &shape("consensus"))
    );
    assert!(largest(&found.aligned[0], &shape("first")) < 1e-10, "{name}");
    assert!(largest(found.aligned.last().unwrap(), &shape("last")) < 1e-10, "{name}");
    let values: Vec<f64> = serde_json::from_value(case["criterion_values"].clone()).unwrap();
    assert!(largest(&found.criterion, &values) < 1e-10, "{name}");
    assert!(!found.converged, "{name}");
}

fn check_centred(set: &Set, case: &Value) {
    let d = set.dimension;
    let found = centred::slide(&set.shapes, &set.sliders, (d, criterion(case)), &Unwatched).unwrap();
    let name = format!("{} {}", case["name"], case["criterion"]);
    println!("{name}: {} rounds, {} without acceleration", found.rounds, case["rounds"]);
    assert!(found.converged && found.last_move < 1e-12, "{name} {:e}", found.last_move);
    let wanted = columns(&rows(&case["consensus"]));
    let error = largest(&turned(&found.consensus, &wanted, d), &wanted);
    assert!(error < 1e-8, "{name} {error:e}");
    let displacements = rows(&case["displacements"]);
    for (found, wanted) in found.displacements.unwrap().iter().zip(&displacements) {
        let error = largest(found, wanted);
        assert!(error < 1e-8, "{name} {error:e}");
    }
}

fn check(text: &[u8], only: Option<&str>) {
    let vectors: Value = serde_json::from_slice(text).unwrap();
    let mut sets: HashMap<String, Set> = HashMap::new();
    for case in vectors["cases"].as_array().unwrap() {
        let name = case["name"].as_str().unwrap();
        if only.is_some_and(|only| only != name) {
            continue;
        }
        if case["points"].is_array() {
            let shapes: Vec<Rows> = serde_json::from_value(case["points"].clone()).unwrap();
            let dimension = shapes[0][0].len();
            let table: Vec<[usize; 3]> = serde_json::from_value(case["sliders"].clone()).unwrap();
            let surface: Vec<usize> = serde_json::from_value(case["surface"].clone()).unwrap();
            let sliders = Sliders::new([shapes[0].len(), dimension], &table, &surface).unwrap();
            let shapes = shapes.iter().map(columns).collect();
            sets.insert(name.into(), Set { shapes, dimension, sliders });
        }
        if case["protocol"] == "centred" {
            check_centred(&sets[name], case);
        } else {
            check_gpagen(&sets[name], case);
        }
    }
}

#[test]
fn trilobites_and_arches_slide_as_in_the_vectors() {
    check(include_bytes!("../../../../tests/vectors/elastic/sliding.json"), None);
}

#[test]
fn scallops_slide_as_in_the_vectors() {
    let path =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/math/vectors/elastic/sliding.json");
    match std::fs::read(path) {
        Ok(text) => check(&text, Some("scallops")),
        Err(_) => println!("SKIPPED: vectors/elastic/sliding.json is not beside the project"),
    }
}

/// Arches of `size` points whose inner ones slide, made at different parameters, turned and scaled, with three fixed points below.
fn arches(count: usize, size: usize) -> Set {
    let arch = |k: usize| -> Vec<f64> {
        let bend = 0.3 * ((3 * k + 1) as f64).sin();
        let (sine, cosine) = (k as f64).sin_cos();
        let scale = 1.0 + 0.2 * ((2 * k) as f64).cos();
        let place = |i: usize| {
            let own = 0.5 * ((5 * k + 3 * i) as f64).sin() / (size - 1) as f64;
            let t = if i == 0 || i + 1 == size { i as f64 } else { i as f64 + own } / (size - 1) as f64;
            [4.0 * t, (std::f64::consts::PI * (t + bend * t * (1.0 - t))).sin() + 0.2 * (9.0 * t).sin()]
        };
        let below = [[0.5, -1.0 - 0.1 * bend], [3.5, -1.0 + bend], [2.0, -2.0]];
        let points: Vec<[f64; 2]> = (0..size).map(place).chain(below).collect();
        let turned = points
            .iter()
            .map(|[x, y]| [cosine * x - sine * y, sine * x + cosine * y].map(|x| scale * x + k as f64));
        let turned: Vec<[f64; 2]> = turned.collect();
        (0..2).flat_map(|c| turned.iter().map(move |point| point[c])).collect()
    };
    let table: Vec<[usize; 3]> = (1..size - 1).map(|i| [i - 1, i, i + 1]).collect();
    Set {
        shapes: (0..count).map(arch).collect(),
        dimension: 2,
        sliders: Sliders::new([size + 3, 2], &table, &[]).unwrap(),
    }
}

fn slide(set: &Set, criterion: SlidingCriterion) -> Slid {
    centred::slide(&set.shapes, &set.sliders, (set.dimension, criterion), &Unwatched).unwrap()
}

#[test]
fn the_order_of_shapes_and_their_threads_change_no_bit() {
    for criterion in [SlidingCriterion::BendingEnergy, SlidingCriterion::Procrustes] {
        let set = arches(7, 12);
        let found = slide(&set, criterion);
        let mut reversed = arches(7, 12);
        reversed.shapes.reverse();
        let mut other = slide(&reversed, criterion);
        other.aligned.reverse();
        other.points.as_mut().unwrap().reverse();
        other.displacements.as_mut().unwrap().reverse();
        assert_eq!(found, other);
        let one = rayon_free(|| slide(&set, criterion));
        assert_eq!(found, one);
    }
}

/// On a pool of one thread.
fn rayon_free<T: Send>(work: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap().install(work)
}

#[test]
fn fixed_points_stay_and_displacements_cancel() {
    let set = arches(6, 9);
    let found = slide(&set, SlidingCriterion::BendingEnergy);
    let size = set.shapes[0].len() / 2;
    for (slid, given) in found.points.unwrap().iter().zip(&set.shapes) {
        for k in [0, 8, 9, 10, 11] {
            let apart = (slid[k] - given[k]).abs() + (slid[size + k] - given[size + k]).abs();
            assert!(apart < 1e-12, "{k} {apart:e}");
        }
    }
    let displacements = found.displacements.unwrap();
    for j in 0..7 {
        let mean: f64 = displacements.iter().map(|one| one[j]).sum();
        assert!(mean.abs() < 1e-13, "{mean:e}");
    }
    // Shapes that have slid bend less than those given.
    assert!(displacements.iter().flatten().any(|t| t.abs() > 1e-3));
}

#[test]
fn shapes_that_cannot_slide_are_refused() {
    let of = |set: &Set| {
        centred::slide(&set.shapes, &set.sliders, (2, SlidingCriterion::BendingEnergy), &Unwatched)
            .unwrap_err()
    };
    let mut point = arches(3, 6);
    point.shapes[1].fill(2.0);
    assert_eq!(of(&point), SlidingError::NoExtent { shape: 1 });
    let mut folded = arches(3, 6);
    let size = folded.shapes[2].len() / 2;
    for c in 0..2 {
        folded.shapes[2][c * size + 3] = folded.shapes[2][c * size + 1];
    }
    assert_eq!(of(&folded), SlidingError::NoDirection { shape: 2, point: 2 });
    let mut twins = arches(3, 6);
    for shape in &mut twins.shapes {
        for c in 0..2 {
            shape[c * size + 3] = shape[c * size + 2];
        }
    }
    assert_eq!(of(&twins), SlidingError::OnePlace { first: 2, second: 3 });
    // A circle of sliders may turn.
    let circle = |k: usize| -> Vec<f64> {
        let at = |i: usize| std::f64::consts::TAU * (i as f64 + 0.1 * k as f64) / 8.0;
        (0..8).map(|i| at(i).cos()).chain((0..8).map(|i| at(i).sin())).collect()
    };
    let table: Vec<[usize; 3]> = (0..8).map(|i| [(i + 7) % 8, i, (i + 1) % 8]).collect();
    let sliders = Sliders::new([8, 2], &table, &[]).unwrap();
    let circles = Set { shapes: (0..3).map(circle).collect(), dimension: 2, sliders };
    assert!(matches!(of(&circles), SlidingError::Free { .. }));
}

#[test]
fn rounds_do_not_grow_with_the_number_of_shapes() {
    for (criterion, most) in [(SlidingCriterion::BendingEnergy, 30), (SlidingCriterion::Procrustes, 60)] {
        let [few, many] = [8, 200].map(|count| slide(&arches(count, 30), criterion));
        assert!(few.converged && many.converged, "{criterion:?}");
        let rounds = [few.rounds, many.rounds];
        // Those that the predicted work of a request counts.
        assert!(rounds.iter().all(|rounds| *rounds <= most), "{criterion:?}: {rounds:?}");
    }
}
