//! Elastic means, matches to them, and curves with their parameters.

use std::f64::consts::TAU;
use std::path::Path;

use serde_json::Value;
use shapelex_analysis::AnalysisError;
use shapelex_analysis::correspondence::{Direction, Mirror};
use shapelex_analysis::elastic::curve::ElasticCurve;
use shapelex_analysis::elastic::settings::ElasticSettings;
use shapelex_analysis::elastic::space::ElasticSpace;
use shapelex_analysis::elastic::template::ElasticMean;
use shapelex_geometry::curve::Curve;
use shapelex_geometry::generator::GeneratorKind;
use shapelex_geometry::reparametrisation::LineRefit;
use shapelex_geometry::representation::{Representation, ShapeSpace};
use shapelex_numeric::dense::Matrix;

fn closed(control_points: usize) -> ShapeSpace {
    let generator = GeneratorKind::Bspline { degree: 3 };
    ShapeSpace::new(&Representation::ClosedCurve { dimension: 2, control_points, generator }).unwrap()
}

fn open(dimension: usize, intervals: usize) -> ShapeSpace {
    let generator = GeneratorKind::Bspline { degree: 3 };
    ShapeSpace::new(&Representation::OpenCurve { dimension, intervals, generator }).unwrap()
}

fn elastic(space: &ShapeSpace, elasticity: f64) -> ElasticSpace {
    let settings = ElasticSettings { elasticity, ..ElasticSettings::default() };
    ElasticSpace::new(space, Direction::Either, Mirror::Forbid, settings).unwrap()
}

/// Curves with a lobe that wanders along them: points are `r(γ)` for other places of the lobe, turned and scaled by their number.
fn wandering(space: &ShapeSpace, count: usize) -> Vec<Vec<f64>> {
    let (size, d) = (space.representation().size(), space.representation().dimension());
    let closed = space.representation().is_closed();
    let place = |k: usize, i: usize, c: usize| {
        let share = i as f64 / if closed { size as f64 } else { (size - 1) as f64 };
        let part = k as f64 / count as f64 - 0.5;
        let t = if closed { TAU } else { 2.0 } * share;
        let (x, y) = if closed {
            let radius = 1.0
                + 0.35 * (-(8.0 * ((t - 2.0 - 0.6 * part) / 2.0).sin().powi(2))).exp()
                + 0.15 * (2.0 * t).cos();
            (1.5 * radius * t.cos(), radius * t.sin())
        } else {
            (2.0 * t, (3.0 * t).sin() * 0.4 + 0.8 * (-12.0 * (t - 1.0 - 0.3 * part).powi(2)).exp())
        };
        let (sin, cos) = (0.7 * k as f64).sin_cos();
        let scale = 1.0 + 0.1 * k as f64;
        scale * [cos * x - sin * y, sin * x + cos * y, 0.2 * (3.0 * t).cos()][c]
    };
    (0..count)
        .map(|k| (0..d).flat_map(|c| (0..size).map(move |i| (c, i))).map(|(c, i)| place(k, i, c)).collect())
        .collect()
}

fn mean_of(space: &ElasticSpace, shapes: &[Vec<f64>]) -> (Vec<ElasticCurve>, ElasticMean) {
    let curves = space.prepare(&shapes.concat()).unwrap();
    let found = space.mean(&curves, &curves[..1], &|_| true).unwrap();
    (curves, found)
}

#[test]
fn a_mean_rises_and_its_matches_have_the_identity_as_their_mean() {
    for (curves, elasticity) in [(closed(40), 1.0), (closed(40), 0.5), (open(2, 40), 1.0), (open(3, 40), 0.7)]
    {
        let space = elastic(&curves, elasticity);
        let shapes = wandering(&curves, 7);
        let (_, found) = mean_of(&space, &shapes);
        assert!(found.history.windows(2).all(|two| two[1] > two[0] - 1e-7), "{:?}", found.history);
        let last = found.history.last().unwrap();
        assert!(found.objective > last - 2e-3 && found.objective <= 1.0 + 1e-9, "{} {last}", found.objective);
        let points = space.settings().points;
        for i in 0..=points {
            let mean: f64 = found.matches.iter().map(|one| (one.places[i] - one.places[0]) / 7.0).sum();
            let sign = if found.matches[0].reversed { -1.0 } else { 1.0 };
            assert!((sign * mean - i as f64 / points as f64).abs() < 1e-2, "{i}: {mean}");
        }
        let cosines: f64 = found.matches.iter().map(|one| one.distance.cos() / 7.0).sum();
        assert!((cosines - found.objective).abs() < 1e-3, "{cosines} {}", found.objective);
    }
}

#[test]
fn a_mean_is_that_of_the_set_whatever_its_order_and_threads() {
    let space = elastic(&closed(32), 1.0);
    let shapes = wandering(&closed(32), 9);
    let curves = space.prepare(&shapes.concat()).unwrap();
    let start = curves[4].clone();
    let backwards: Vec<ElasticCurve> = curves.iter().rev().cloned().collect();
    let run = |curves: &[ElasticCurve], threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| space.mean(curves, std::slice::from_ref(&start), &|_| true).unwrap())
    };
    let (one, two) = (run(&curves, 1), run(&backwards, 3));
    assert_eq!(one.objective.to_bits(), two.objective.to_bits());
    assert_eq!(one.template, two.template);
    assert!(one.matches.iter().eq(two.matches.iter().rev()));
    // Of several starts, the best is kept.
    let most = space.mean(&curves, &curves[..3], &|_| true).unwrap().objective;
    for k in 0..3 {
        assert!(space.mean(&curves, &curves[k..=k], &|_| true).unwrap().objective <= most);
    }
    let stopped = space.mean(&curves, &curves[..1], &|round| round < 2);
    assert!(matches!(stopped, Err(AnalysisError::Interrupted)));
    let none = space.mean(&[], &curves[..1], &|_| true);
    assert!(matches!(none, Err(AnalysisError::TooFewShapes { .. })));
}

#[test]
fn curves_with_the_parameters_of_the_mean_lie_nearer_to_each_other() {
    for (space, d) in [(closed(48), 2), (open(2, 48), 2), (open(3, 48), 3)] {
        let compared = elastic(&space, 1.0);
        let shapes = wandering(&space, 6);
        let (_, found) = mean_of(&compared, &shapes);
        let refits: Vec<_> = shapes
            .iter()
            .zip(&found.matches)
            .map(|(shape, matched)| compared.refit(shape, matched, &space).unwrap())
            .collect();
        for refit in &refits {
            let (curve, slopes) = refit;
            assert!(curve.relative_residual < 0.01, "{}", curve.relative_residual);
            assert!(slopes[0] > 0.019 && slopes[1] < 10.0, "{slopes:?}");
        }
        // Matched to the first curve as a template with its own parameter, the first curve keeps its points.
        let template = compared.template_of(&shapes[0]).unwrap();
        let own = compared.prepare(&shapes[0]).unwrap();
        let onto = compared.onto(&template, &own[0]);
        assert!(onto.distance < 0.03, "{}", onto.distance);
        let again = compared.refit(&shapes[0], &onto, &space).unwrap().0.control_points;
        let size = space.representation().size();
        let given = Matrix::from_column_slice(size, d, &shapes[0]);
        assert!((again - given).amax() < 0.1);
    }
}

#[test]
fn refits_are_those_of_the_vectors() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/vectors/elastic/refit.json");
    let vectors: Value = serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap();
    let tolerance = vectors["tolerance"].as_f64().unwrap();
    for case in vectors["cases"].as_array().unwrap() {
        let rows = |field: &str| {
            let rows: Vec<Vec<f64>> = serde_json::from_value(case[field].clone()).unwrap();
            Matrix::from_fn(rows.len(), 2, |i, c| rows[i][c])
        };
        let (given, wanted) = (rows("control_points"), rows("refit"));
        let (from, to) = (closed(given.nrows()), closed(wanted.nrows()));
        let curve = Curve::of(&from, &given).unwrap();
        let e = case["e"].as_f64().unwrap();
        let map = |s: f64| (s + e * (TAU * s).sin() / TAU).rem_euclid(1.0);
        // Places where the map crosses a knot: derivatives of the curve jump there.
        let corners: Vec<f64> =
            (0..given.nrows()).map(|k| inverse(&map, k as f64 / given.nrows() as f64)).collect();
        let found = LineRefit::new(&curve, &to, &corners, &map).unwrap();
        let apart = (&found.control_points - &wanted).amax();
        assert!(apart < tolerance, "{apart:.1e}");
        for (found, field) in [(found.residual, "residual"), (found.relative_residual, "relative_residual")] {
            let wanted = case[field].as_f64().unwrap();
            assert!((found - wanted).abs() < tolerance, "{field}: {found} {wanted}");
        }
    }
}

/// The place at which an increasing map has a value, by bisection.
fn inverse(map: &dyn Fn(f64) -> f64, value: f64) -> f64 {
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if map(middle) < value { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}

#[test]
fn the_mean_of_hearts_reaches_the_objective_of_the_vectors() {
    let shared = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared");
    let read = |path: &str| std::fs::read_to_string(shared.join(path)).ok();
    let texts = (read("math/vectors/elastic/mean.json"), read("data/curves-hearts/curves.ndjson"));
    let (Some(vectors), Some(curves)) = texts else {
        println!("SKIPPED: vectors/elastic/mean.json and curves-hearts are not beside the project");
        return;
    };
    let vectors: Value = serde_json::from_str(&vectors).unwrap();
    let known: Vec<Value> = curves.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let how = (Direction::Either, Mirror::Forbid);
    let space = ElasticSpace::of_polygons(2, true, how, ElasticSettings::default()).unwrap();
    let prepared = |id: &Value| {
        let curve = known.iter().find(|curve| curve["id"] == *id).unwrap();
        let rows: Vec<Vec<f64>> = serde_json::from_value(curve["points"].clone()).unwrap();
        space.prepare_polygon(Matrix::from_fn(rows.len(), 2, |i, c| rows[i][c])).unwrap()
    };
    let curves: Vec<ElasticCurve> = vectors["ids"].as_array().unwrap().iter().map(prepared).collect();
    let found = space.mean(&curves, &curves[..1], &|_| true).unwrap();
    let wanted = vectors["objective"].as_f64().unwrap();
    assert!(found.objective > wanted - 0.003, "{} {wanted}: {:?}", found.objective, found.history);
}
