//! Elastic distances: closed forms, brute force on real curves, and laws.

use std::f64::consts::{FRAC_PI_2, TAU};
use std::path::Path;

use serde_json::Value;
use shapelex_analysis::AnalysisError;
use shapelex_analysis::correspondence::{Direction, Mirror};
use shapelex_analysis::elastic::curve::ElasticCurve;
use shapelex_analysis::elastic::settings::{Effort, ElasticSettings};
use shapelex_analysis::elastic::space::{ElasticMatch, ElasticSpace};
use shapelex_geometry::arc_parameter::ArcParameter;
use shapelex_geometry::curve::Curve;
use shapelex_geometry::generator::GeneratorKind;
use shapelex_geometry::representation::{Representation, ShapeSpace};
use shapelex_numeric::dense::Matrix;

/// Points of the curves that the vectors leave to the tester.
const SAMPLES: usize = 2400;

fn settings(elasticity: f64) -> ElasticSettings {
    ElasticSettings { elasticity, ..ElasticSettings::default() }
}

fn rows(value: &Value) -> Matrix {
    let rows: Vec<Vec<f64>> = serde_json::from_value(value.clone()).unwrap();
    Matrix::from_fn(rows.len(), rows[0].len(), |i, c| rows[i][c])
}

/// Points of a curve of the vectors: a list, or a curve by name.
fn points(value: &Value) -> Matrix {
    if value.is_array() {
        return rows(value);
    }
    let (name, curve) = value.as_object().unwrap().iter().next().unwrap();
    let number = |field: &str| curve[field].as_f64().unwrap();
    let last = (SAMPLES - 1) as f64;
    match &**name {
        "circle" => {
            Matrix::from_fn(SAMPLES, 2, |i, c| (TAU * (i as f64 / SAMPLES as f64 - c as f64 / 4.0)).cos())
        }
        "arc" => Matrix::from_fn(SAMPLES, 2, |i, c| {
            (number("angle") * i as f64 / last - c as f64 * FRAC_PI_2).cos() * number("radius")
        }),
        "helix" => {
            let (turn, radius) = (TAU * number("turns"), number("radius"));
            let rise = turn * radius / number("pitch_angle_from_axis").tan();
            Matrix::from_fn(SAMPLES, 3, |i, c| match i as f64 / last {
                t if c == 2 => rise * t,
                t => radius * (turn * t - c as f64 * FRAC_PI_2).cos(),
            })
        }
        other => panic!("{other}"),
    }
}

fn mirror(case: &Value) -> Mirror {
    if case["mirror"] == "allow" { Mirror::Allow } else { Mirror::Forbid }
}

fn polygons(case: &Value, settings: ElasticSettings, [a, b]: [Matrix; 2]) -> ElasticMatch {
    let closed = case["closed"].as_bool().unwrap();
    let direction = if closed { Direction::Either } else { Direction::Given };
    let how = (direction, mirror(case));
    let space = ElasticSpace::of_polygons(a.ncols(), closed, how, settings).unwrap();
    let [a, b] = [a, b].map(|points| space.prepare_polygon(points).unwrap());
    space.compare(&a, &b)
}

#[test]
fn distances_are_those_of_closed_forms() {
    let path =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/vectors/elastic/distances-analytic.json");
    let vectors: Value = serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap();
    for case in vectors["cases"].as_array().unwrap() {
        // Corners lie between the ends of segments, by half of one: 0.049 with a hundred.
        let usual = if case["name"] == "polygon and itself from another vertex, edges subdivided" {
            400
        } else {
            100
        };
        let segments = case["points"].as_u64().unwrap_or(usual) as usize;
        let settings = ElasticSettings { points: segments, ..settings(case["elasticity"].as_f64().unwrap()) };
        let curves = [points(&case["a"]), points(&case["b"])];
        let found = polygons(case, settings, curves.clone()).distance;
        let (wanted, tolerance) = (case["distance"].as_f64().unwrap(), case["tolerance"].as_f64().unwrap());
        // Chords of the mirrored copy leave 0.0297, whatever the effort; those of the vectors 0.02.
        let tolerance = if case["mirror"] == "allow" { 0.03 } else { tolerance };
        assert!((found - wanted).abs() < tolerance, "{}: {found} of {wanted}", case["name"]);
        let Some(tolerance) = case["tolerance_with_exact_tangents"].as_f64() else { continue };
        let size = curves[0].nrows();
        let space = closed(2, size, 3);
        let [a, b] = curves.map(|points| space.interpolate(points).unwrap());
        let compared = ElasticSpace::new(&space, Direction::Either, mirror(case), settings).unwrap();
        let prepared = compared.prepare(&[a.as_slice(), b.as_slice()].concat()).unwrap();
        let found = compared.compare(&prepared[0], &prepared[1]).distance;
        assert!(found < tolerance, "{} as splines: {found}", case["name"]);
    }
}

/// A curve of a data set beside the project.
fn stored(set: &str, id: &Value) -> Option<Matrix> {
    let path =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data").join(set).join("curves.ndjson");
    let text = std::fs::read_to_string(path).ok()?;
    let curves = text.lines().map(|line| serde_json::from_str::<Value>(line).unwrap());
    curves.into_iter().find(|curve| curve["id"] == *id).map(|curve| rows(&curve["points"]))
}

#[test]
fn distances_of_real_curves_are_those_of_brute_force() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../../shared/math/vectors/elastic/distances-real.json");
    let Ok(text) = std::fs::read(path) else {
        println!("SKIPPED: vectors/elastic/distances-real.json is not beside the project");
        return;
    };
    let vectors: Value = serde_json::from_slice(&text).unwrap();
    for (effort, most) in [(Effort::Normal, 1.09), (Effort::Thorough, 1.06)] {
        let mut ratios = Vec::new();
        for case in vectors["cases"].as_array().unwrap() {
            let set = case["data"].as_str().unwrap();
            let (Some(a), Some(b)) = (stored(set, &case["a"]), stored(set, &case["b"])) else {
                println!("SKIPPED: {set} is not here");
                continue;
            };
            let settings = ElasticSettings { effort, ..settings(case["elasticity"].as_f64().unwrap()) };
            let found = polygons(case, settings, [a, b]).distance;
            let wanted = case["distance"].as_f64().unwrap();
            assert!(found < wanted * most + 0.002, "{case}: {found} ({effort:?})");
            if case["closed"] == true {
                ratios.push(found / wanted);
            }
        }
        ratios.sort_by(f64::total_cmp);
        let median = ratios.get(ratios.len() / 2).copied().unwrap_or(1.0);
        assert!(median < 1.01, "{median} ({effort:?})");
    }
}

fn closed(dimension: usize, control_points: usize, degree: u8) -> ShapeSpace {
    let generator = GeneratorKind::Bspline { degree };
    ShapeSpace::new(&Representation::ClosedCurve { dimension, control_points, generator }).unwrap()
}

fn open(dimension: usize, intervals: usize) -> ShapeSpace {
    let generator = GeneratorKind::Bspline { degree: 3 };
    ShapeSpace::new(&Representation::OpenCurve { dimension, intervals, generator }).unwrap()
}

/// Smooth curves without symmetry, of amplitudes that depend on `seed`; coordinate-major control points.
fn smooth(space: &ShapeSpace, seed: usize) -> Vec<f64> {
    let representation = space.representation();
    let (size, closed) = (representation.size(), representation.is_closed());
    let value = |i: usize, c: usize| {
        let t = if closed { TAU * i as f64 / size as f64 } else { 2.0 * i as f64 / size as f64 };
        let wave = |k: usize| {
            let phase = ((seed * 7 + k * 3 + c * 5) as f64).sin();
            0.25 * (k as f64 * t + 3.0 * phase).cos() / (1.0 + k as f64 / 3.0)
        };
        let main = [t.cos() * 1.6, t.sin(), 0.3 * (2.0 * t).cos()][c];
        main + (2..6).map(wave).sum::<f64>()
    };
    (0..representation.dimension()).flat_map(|c| (0..size).map(move |i| value(i, c))).collect()
}

/// `s R x + b` of all control points, which begin `shift` later; the first coordinate negated and the order reversed if `mirrored`.
fn moved(space: &ShapeSpace, shape: &[f64], (shift, mirrored): (usize, bool)) -> Vec<f64> {
    let (size, d) = (space.representation().size(), space.representation().dimension());
    let backwards = mirrored && d == 2 && space.representation().is_closed();
    let (cos, sin) = (2.1_f64.cos(), 2.1_f64.sin());
    let at = |i: usize, c: usize| {
        let k = if backwards { size - 1 - i } else { i };
        let x = shape[c * size + (k + shift) % size];
        if mirrored && c == 0 { -x } else { x }
    };
    let value = |i: usize, c: usize| {
        let turned = match c {
            0 => cos * at(i, 0) - sin * at(i, 1),
            1 => sin * at(i, 0) + cos * at(i, 1),
            _ => at(i, 2),
        };
        37.0 * turned + [3.0, -8.0, 1.0][c]
    };
    (0..d).flat_map(|c| (0..size).map(move |i| (i, c))).map(|(i, c)| value(i, c)).collect()
}

fn prepared(compared: &ElasticSpace, shapes: &[Vec<f64>]) -> Vec<ElasticCurve> {
    compared.prepare(&shapes.concat()).unwrap()
}

#[test]
fn copies_in_other_places_are_at_no_distance_and_at_the_same_from_others() {
    let spaces = [closed(2, 24, 3), closed(3, 24, 3), open(2, 20), open(3, 20)];
    for (k, space) in spaces.iter().enumerate() {
        let shift = if k < 2 { 7 } else { 0 };
        let [one, two] = [smooth(space, 1), smooth(space, 2)];
        for mirrored in [false, true] {
            let mirror = if mirrored { Mirror::Allow } else { Mirror::Forbid };
            let compared = ElasticSpace::new(space, Direction::Given, mirror, settings(1.0)).unwrap();
            let copy = moved(space, &one, (shift, mirrored));
            let curves = prepared(&compared, &[one.clone(), copy, two.clone()]);
            let found = compared.compare(&curves[0], &curves[1]);
            assert!(found.distance < 1e-3, "{k} {mirrored}: {}", found.distance);
            assert_eq!((found.mirrored, found.reversed), (mirrored, mirrored && k == 0), "{k}");
            assert_matched(space, [&one, &moved(space, &one, (shift, mirrored))], &found, k);
            let [a, b] = [0, 1].map(|i| compared.compare(&curves[i], &curves[2]).distance);
            // Paths are found on other grids, and bands decide between paths.
            assert!((a - b).abs() < 0.02 * a, "{k} {mirrored}: {a} {b}");
            assert!(a > 0.1, "{a}");
        }
    }
}

/// Points at matched places of two copies differ by the rotation, the scale and the position.
fn assert_matched(space: &ShapeSpace, shapes: [&[f64]; 2], found: &ElasticMatch, what: usize) {
    let (size, d) = (space.representation().size(), space.representation().dimension());
    let count = found.places.len() - 1;
    let [a, b] = shapes.map(|shape| Curve::of(space, &Matrix::from_column_slice(size, d, shape)).unwrap());
    let (arc_a, arc_b) = (ArcParameter::of(&a), ArcParameter::of(&b));
    let scale = arc_a.length() / arc_b.length();
    let of_b = |t: f64| {
        let t = if space.representation().is_closed() { t.rem_euclid(1.0) } else { t.clamp(0.0, 1.0) };
        let mut point = b.evaluate(arc_b.at(t), 0);
        if found.mirrored {
            point[0] = -point[0];
        }
        (0..d)
            .map(|r| scale * (0..d).map(|c| found.rotation[r * d + c] * point[c]).sum::<f64>())
            .collect::<Vec<f64>>()
    };
    let apart: Vec<Vec<f64>> = (0..=count)
        .map(|i| {
            let own = a.evaluate(arc_a.at(i as f64 / count as f64), 0);
            own.iter().zip(of_b(found.places[i])).map(|(x, y)| x - y).collect()
        })
        .collect();
    for point in &apart {
        for c in 0..d {
            assert!((point[c] - apart[0][c]).abs() < 0.02, "{what}: {point:?} {:?}", apart[0]);
        }
    }
}

#[test]
fn directions_are_disregarded_where_they_may_be() {
    for space in [closed(2, 24, 3), open(2, 20), closed(3, 24, 3)] {
        let one = smooth(&space, 1);
        let size = space.representation().size();
        let back: Vec<f64> = one.chunks_exact(size).flat_map(|column| column.iter().rev().copied()).collect();
        let distance = |direction| {
            let compared = ElasticSpace::new(&space, direction, Mirror::Forbid, settings(1.0)).unwrap();
            let curves = prepared(&compared, &[one.clone(), back.clone()]);
            compared.compare(&curves[0], &curves[1])
        };
        let (either, given) = (distance(Direction::Either), distance(Direction::Given));
        assert!(either.distance < 1e-3 && either.reversed, "{either:?}");
        assert!(given.distance > 0.05 && !given.reversed, "{given:?}");
        assert_matched(&space, [&one, &back], &either, 0);
        assert!(either.places.windows(2).all(|ends| ends[0] >= ends[1]), "places decrease");
    }
}

#[test]
fn matrices_are_symmetric_and_metric_and_do_not_depend_on_threads() {
    let space = closed(2, 24, 3);
    let mut shapes: Vec<Vec<f64>> = (0..20).map(|seed| smooth(&space, seed)).collect();
    shapes.push(shapes[3].clone());
    let compared = ElasticSpace::new(&space, Direction::Either, Mirror::Allow, settings(1.0)).unwrap();
    let curves = prepared(&compared, &shapes);
    let within = |threads: usize| {
        let pool = rayon_pool(threads);
        pool.install(|| compared.matrix(&curves, &|_| true).unwrap())
    };
    let matrix = within(1);
    assert_eq!(matrix, within(4));
    let count = shapes.len();
    let at = |i: usize, j: usize| matrix[i * count + j];
    assert_eq!(at(3, 20), 0.0);
    for i in 0..count {
        assert_eq!(at(i, i), 0.0);
        for j in 0..i {
            assert_eq!(at(i, j), at(j, i));
            assert_eq!(compared.compare(&curves[i], &curves[j]).distance, at(i, j));
            assert_eq!(compared.compare(&curves[j], &curves[i]).distance, at(i, j));
            for k in 0..count {
                // Searches miss optima.
                assert!(at(i, j) <= at(i, k) + at(k, j) + 0.05, "{i} {j} {k}");
            }
        }
    }
    let stopped = compared.matrix(&curves, &|part| part < 0.3);
    assert!(matches!(stopped, Err(AnalysisError::Interrupted)), "{stopped:?}");
}

fn rayon_pool(threads: usize) -> rayon::ThreadPool {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap()
}

#[test]
fn distances_grow_with_elasticity_and_efforts_shrink_them() {
    for space in [closed(2, 24, 3), closed(3, 24, 3), open(2, 20)] {
        for [i, j] in [[1, 2], [3, 4], [5, 6]] {
            let distance = |settings: ElasticSettings| {
                let compared = ElasticSpace::new(&space, Direction::Given, Mirror::Forbid, settings).unwrap();
                let curves = prepared(&compared, &[smooth(&space, i), smooth(&space, j)]);
                compared.compare(&curves[0], &curves[1]).distance
            };
            let grown: Vec<f64> = [0.05, 0.2, 0.5, 0.8, 1.0].iter().map(|&e| distance(settings(e))).collect();
            // Searches miss optima, by a hundredth in these pairs.
            assert!(grown.windows(2).all(|pair| pair[0] < 1.01 * pair[1]), "{grown:?}");
            let [fast, thorough] = [Effort::Fast, Effort::Thorough]
                .map(|effort| distance(ElasticSettings { effort, ..settings(1.0) }));
            assert!(thorough <= grown[4] + 1e-9 && fast >= thorough, "{fast} {} {thorough}", grown[4]);
            // More segments are nearer to the curves.
            let by_points =
                [16, 60, 155, 400].map(|points| distance(ElasticSettings { points, ..settings(1.0) }));
            assert!(
                by_points[1..].iter().all(|d| (d - by_points[3]).abs() < 0.05 * by_points[3]),
                "{by_points:?}"
            );
            assert!((by_points[0] - by_points[3]).abs() < 0.4 * by_points[3], "{by_points:?}");
        }
    }
}

#[test]
fn poses_count_without_rotations() {
    let space = closed(2, 24, 3);
    let one = smooth(&space, 1);
    let fixed = ElasticSettings { rotation: false, ..settings(1.0) };
    let compared = ElasticSpace::new(&space, Direction::Either, Mirror::Allow, fixed).unwrap();
    let turned = moved(&space, &one, (5, false));
    let only_moved: Vec<f64> = one.iter().map(|x| 5.0 * x + 2.0).collect();
    let size = space.representation().size();
    let mirrored: Vec<f64> = [true, false]
        .iter()
        .zip(one.chunks_exact(size))
        .flat_map(|(first, column)| column.iter().rev().map(move |x| if *first { -x } else { *x }))
        .collect();
    let curves = prepared(&compared, &[one, turned, only_moved, mirrored]);
    let distance = |i: usize| compared.compare(&curves[0], &curves[i]).distance;
    assert!(
        distance(1) > 0.2 && distance(2) < 1e-3 && distance(3) < 1e-3,
        "{} {} {}",
        distance(1),
        distance(2),
        distance(3)
    );
}

#[test]
fn curves_and_settings_that_do_not_suit_are_refused() {
    let space = closed(2, 24, 1);
    let refused = |settings: ElasticSettings| match ElasticSpace::new(
        &space,
        Direction::Given,
        Mirror::Forbid,
        settings,
    )
    .map(|_| ())
    {
        Err(AnalysisError::Parameter { field, detail }) => (field, detail),
        other => panic!("{other:?}"),
    };
    for elasticity in [0.0, -0.5, 1.5, f64::NAN] {
        let (field, detail) = refused(settings(elasticity));
        let wanted = format!("expected a number above 0 and up to 1, got {elasticity}");
        assert_eq!((field, detail), ("elasticity", wanted));
    }
    for points in [15, 1001] {
        let (field, detail) = refused(ElasticSettings { points, ..settings(1.0) });
        assert_eq!(
            (field, detail),
            ("points", format!("expected a number between 16 and 1000, got {points}"))
        );
    }
    let compared = ElasticSpace::new(&space, Direction::Given, Mirror::Forbid, settings(1.0)).unwrap();
    let shape = smooth(&space, 1);
    let mut still = shape.clone();
    (still[4], still[28]) = (still[5], still[29]);
    let point = vec![3.0; shape.len()];
    for (bad, wanted) in
        [(still, "expected no stretch without length"), (point, "expected a length of at least 1e-12")]
    {
        match compared.prepare(&[shape.clone(), bad].concat()) {
            Err(AnalysisError::Unsuitable { index: 1, detail }) => {
                assert!(detail.starts_with(wanted), "{detail}")
            }
            other => panic!("{other:?}"),
        }
    }
    let landmarks = ShapeSpace::new(&Representation::Landmarks { dimension: 2, points: 12 }).unwrap();
    let few = closed(2, 7, 3);
    for (space, wanted) in [
        (
            landmarks,
            "expected closed or open curves for an elastic distance, got landmarks, which have no order",
        ),
        (few, "expected at least 8 control points, got 7"),
    ] {
        match ElasticSpace::new(&space, Direction::Given, Mirror::Forbid, settings(1.0)).map(|_| ()) {
            Err(AnalysisError::Parameter { field: "representation", detail }) => assert_eq!(detail, wanted),
            other => panic!("{other:?}"),
        }
    }
}
