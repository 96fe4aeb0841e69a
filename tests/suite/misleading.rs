//! Numbers that once misled: rings that close, lines far away, cylinders, refined surfaces, and meshes that enclose nothing.

use std::f64::consts::{PI, TAU};

use serde_json::{Value, json};

use crate::server::{assert_relative, shared};

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("no number: {value}"))
}

fn warnings(answer: &Value) -> Vec<String> {
    answer["warnings"].as_array().unwrap().iter().map(|text| text.as_str().unwrap().to_owned()).collect()
}

/// A clockwise ring that repeats its first point is the ring without it, whatever its direction.
#[test]
fn a_ring_that_closes_is_reversed_like_one_that_does_not() {
    let server = shared();
    let mean = |first: Value, second: Value| {
        let body = json!({"representation": {"kind": "closed_curve", "dimension": 2, "control_points": 12,
            "generator": {"name": "cubic"}}, "transformation": "similarity", "correspondence": "cyclic", "direction": "either",
            "shapes": [{"points": first}, {"points": second}]});
        server.post("/v1/mean", &body).expect(200)["mean"].clone()
    };
    let closed =
        mean(json!([[0, 0], [0, 2], [3, 2], [3, 0], [0, 0]]), json!([[0, 0], [0, 2], [4, 0], [0, 0]]));
    let open = mean(json!([[0, 0], [0, 2], [3, 2], [3, 0]]), json!([[0, 0], [0, 2], [4, 0]]));
    assert_eq!(closed, open);
}

/// Points of a line, and of one that bends by `bend`, on both coordinates moved by `offset`.
fn along(bend: f64, offset: f64) -> Value {
    let point = |i: i32| {
        let t = f64::from(i) / 8.0;
        [offset + t, offset + 0.7 * t + bend * (1.0 - t) * t]
    };
    json!({"points": (0..=8).map(point).collect::<Vec<_>>()})
}

/// Rounding at 5·10⁸ is 6·10⁻⁸: wider than 10⁻¹⁰ of the line, which is all that its subspace may lack.
#[test]
fn a_line_far_away_is_a_line() {
    let server = shared();
    let body = |bend: f64, offset: f64, transformation: &str| {
        json!({"representation": {"kind": "open_curve", "dimension": 2, "intervals": 8, "generator": {"name": "cubic"}},
            "transformation": transformation, "shapes": [along(0.5, 0.0), along(bend, offset)]})
    };
    for offset in [0.0, 1e5, 5e8, 1e11] {
        let problem = server.post("/v1/mean", &body(0.0, offset, "affine"));
        problem.expect_problem(422, "degenerate-shape", &["/shapes/1"]);
        // What is wider than rounding is a shape, and a line has its similarities.
        server.post("/v1/mean", &body(0.1, offset, "affine")).expect(200);
        server.post("/v1/mean", &body(0.0, offset, "similarity")).expect(200);
    }
}

/// A cylinder of radius and height 1: V = π, A = 4π with both lids, 36πV²/A³ = 9/16.
#[test]
fn a_cylinder_is_less_round_than_a_ball() {
    let ring = |i: usize| {
        let (s, c) = (TAU * i as f64 / 3.0).sin_cos();
        (0..3).map(|j| [c, s, 0.5 * f64::from(j)]).collect::<Vec<_>>()
    };
    let body = json!({"representation": {"kind": "surface", "topology": "cylinder", "control_points": [3, 2]},
        "shapes": [{"points": (0..3).map(ring).collect::<Vec<_>>()}]});
    let answer = shared().post("/v1/measure", &body).expect(200);
    let measures = &answer["results"][0];
    assert_relative("volume", number(&measures["volume"]), PI, 1e-12);
    assert_relative("sphericity", number(&measures["sphericity"]), 0.5625, 1e-10);
    assert_eq!(measures["self_intersecting"], false, "{answer}");
    assert_eq!(measures["warnings"], json!([]));
}

/// The `L₂` distance of a refined torus from the one before: against the finest midpoint rule that an evaluation answers.
#[test]
fn refined_surfaces_say_exactly_how_far_they_are() {
    let server = shared();
    let keys = json!([{"name": "cubic"}, {"name": "cubic"}]);
    let representation = |count: usize| json!({"kind": "surface", "topology": "torus", "control_points": [count, count], "generators": keys});
    let mut rows = vec![[0.0; 3]; 9];
    rows[0] = [1.0, 0.0, 0.0];
    let body =
        json!({"representation": representation(3), "factor": 2, "shapes": [{"control_points": rows}]});
    let answer = server.post("/v1/refine", &body).expect(200);
    let refined = &answer["shapes"][0];
    // Places that are no knots of either: the error of the rule is that of products of kinks, 10⁻⁶ of the value.
    let count = 480;
    let middle = |i: usize| (i as f64 + 0.5) / f64::from(count);
    let places: Vec<[f64; 2]> =
        (0..count as usize).flat_map(|i| (0..60).map(move |j| [middle(i), middle(8 * j + 3)])).collect();
    let evaluate = |size: usize, rows: &Value| {
        let body = json!({"representation": representation(size), "parameters": places, "shapes": [{"control_points": rows}]});
        let answer = server.post("/v1/evaluate", &body).expect(200);
        let points = answer["evaluations"][0]["points"].as_array().unwrap().clone();
        points.iter().map(|point| number(&point[0])).collect::<Vec<f64>>()
    };
    let (before, after) = (evaluate(3, &json!(rows)), evaluate(6, &refined["control_points"]));
    assert_eq!(before.len(), after.len());
    // The value by an independent rule.
    assert_relative("l2_change", number(&refined["l2_change"]), 0.014_243, 1e-4);
    let mean = before.iter().zip(&after).map(|(a, b)| (a - b).powi(2)).sum::<f64>() / before.len() as f64;
    assert_relative("sampled", mean.sqrt(), number(&refined["l2_change"]), 0.03);
}

/// The octahedron with its vertices where `map` says.
fn octahedron(map: impl Fn([f64; 3]) -> [f64; 3]) -> Value {
    let body = json!({"scheme": "loop", "level": 0, "start": "octahedron"});
    let mesh = shared().post("/v1/subdivide", &body).expect(200)["mesh"].clone();
    let vertices: Vec<[f64; 3]> = serde_json::from_value(mesh["vertices"].clone()).unwrap();
    json!({"vertices": vertices.into_iter().map(map).collect::<Vec<_>>(), "faces": mesh["faces"]})
}

fn subdivided(map: impl Fn([f64; 3]) -> [f64; 3]) -> Value {
    refined(3, map)
}

fn refined(level: usize, map: impl Fn([f64; 3]) -> [f64; 3]) -> Value {
    let body = json!({"scheme": "loop", "level": level, "mesh": octahedron(map)});
    shared().post("/v1/subdivide", &body).expect(200)
}

#[test]
fn meshes_that_enclose_nothing_or_the_outside_are_named() {
    let sound = subdivided(|point| point);
    assert_eq!((&sound["warnings"], &sound["self_intersecting"]), (&json!([]), &json!(false)));
    for (what, answer) in [
        ("one point", subdivided(|_| [1.0, 2.0, 3.0])),
        ("flat", subdivided(|[x, y, _]| [x, y, 0.5 * x])),
        ("inside out", subdivided(|[x, y, z]| [y, x, z])),
        ("no length", subdivided(|[x, y, z]| if z > 0.5 { [1.0, 0.0, 0.0] } else { [x, y, z] })),
        (
            "crosses or lies on itself",
            // Out through the side.
            refined(0, |[x, y, z]| if x > 0.5 { [-0.5, 3.0, 0.0] } else { [x, y, z] }),
        ),
    ] {
        assert!(
            warnings(&answer).iter().any(|warning| warning.contains(what)),
            "{what}: {:?}",
            warnings(&answer)
        );
    }
}

/// The volume costs no more digits than the coordinates have: at 10¹⁵ they are multiples of 1/8, which the octahedron has.
#[test]
fn subdivision_far_away_keeps_the_digits_that_there_are() {
    let volume = number(&subdivided(|point| point)["volume"]);
    for offset in [1e6, 1e15] {
        let answer = subdivided(|point| point.map(|x| x + offset));
        assert_relative("volume", number(&answer["volume"]), volume, 1e-12);
        let told = warnings(&answer).iter().any(|warning| warning.contains("far from the origin"));
        assert_eq!(told, offset > 1e10, "{answer}");
    }
    let lost = subdivided(|point| point.map(|x| 3.0 * x + 1e99));
    assert!(warnings(&lost).iter().any(|warning| warning.contains("one point")), "{lost}");
}

/// A sphere whose halves are both the upper one.
#[test]
fn a_surface_whose_sheets_coincide_is_told() {
    let server = shared();
    let (count_u, count_v) = (6, 6);
    let point = |i: usize, j: usize| {
        let ((su, cu), (sv, cv)) =
            ((TAU * i as f64 / count_u as f64).sin_cos(), (PI * j as f64 / count_v as f64).sin_cos());
        [sv * cu, sv * su, cv]
    };
    let measure = |map: &dyn Fn([f64; 3]) -> [f64; 3]| {
        let row = |i: usize| (0..=count_v).map(|j| map(point(i, j))).collect::<Vec<_>>();
        let grid: Vec<_> = (0..count_u).map(row).collect();
        let body = json!({"representation": {"kind": "surface", "topology": "sphere", "control_points": [count_u, count_v]},
            "shapes": [{"points": grid}]});
        server.post("/v1/measure", &body).expect(200)["results"][0].clone()
    };
    let round = measure(&|point| point);
    assert_eq!((&round["warnings"], &round["self_intersecting"]), (&json!([]), &json!(false)));
    let flat = measure(&|[x, y, _]| [x, y, 0.0]);
    assert!(warnings(&flat)[0].contains("it is flat"), "{flat}");
    let turned = measure(&|[x, y, z]| [x, y, -z]);
    assert!(warnings(&turned)[0].contains("inside out"), "{turned}");
    // Far away the volume keeps what digits the coordinates have.
    let far = measure(&|point| point.map(|x| x + 1e6));
    assert_relative("volume", number(&far["volume"]), 4.0 * PI / 3.0, 1e-8);
}
