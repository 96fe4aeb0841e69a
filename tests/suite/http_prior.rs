//! The shape prior of a posted reference, without an image.

use std::f64::consts::{PI, TAU};

use reqwest::Method;
use serde_json::{Value, json};

use crate::form::post_image;
use crate::http_segment::{PATH as SEGMENT, bright, curves, number};
use crate::server::{Setting, flat, shared};

const PATH: &str = "/v1/prior";
const COUNT: usize = 8;

fn representation() -> Value {
    curves(json!({}))["representation"].clone()
}

/// A pear, which is no mirror image of itself, scaled, turned, moved, and begun at point `shift`.
fn pear(scale: f64, angle: f64, offset: [f64; 2], shift: usize) -> Vec<[f64; 2]> {
    let point = |k: usize| {
        let t = ((k + shift) % COUNT) as f64 / COUNT as f64 * TAU;
        let r = 3.0 + t.cos() + 0.4 * (2.0 * t + 0.5).sin();
        let ([x, y], (sine, cosine)) = ([r * t.cos(), r * t.sin()], angle.sin_cos());
        [0, 1].map(|c| scale * [x * cosine - y * sine, x * sine + y * cosine][c] + offset[c])
    };
    (0..COUNT).map(point).collect()
}

/// A shape off the class.
fn dented(scale: f64) -> Vec<[f64; 2]> {
    let mut points = pear(scale, 0.3, [5.0, -2.0], 0);
    points[2][0] += 0.7 * scale;
    points[5][1] -= 0.4 * scale;
    points
}

fn shape(points: &[[f64; 2]]) -> Value {
    json!({"control_points": points})
}

fn request(shapes: &[Vec<[f64; 2]>], further: Value) -> Value {
    let shapes: Vec<Value> = shapes.iter().map(|points| shape(points)).collect();
    let mut body = json!({
        "representation": representation(), "transformation": "similarity", "reference": shape(&pear(1.0, 0.0, [0.0; 2], 0)),
        "shapes": shapes
    });
    body.as_object_mut().unwrap().extend(further.as_object().unwrap().clone());
    body
}

fn energies(shapes: &[Vec<[f64; 2]>], further: Value) -> Vec<Value> {
    shared().post(PATH, &request(shapes, further)).expect(200)["results"].as_array().unwrap().clone()
}

#[test]
fn members_of_the_class_have_no_energy_however_they_begin() {
    let posed = |shift| pear(2.5, 1.1, [40.0, 7.0], shift);
    let mut backwards = posed(3);
    backwards.reverse();
    let cyclic = json!({"correspondence": "cyclic", "direction": "either", "weight": 30});
    for class in ["projection", "procrustes"] {
        let mut further = cyclic.clone();
        further["alignment"] = json!(class);
        for found in energies(&[posed(0), posed(3), backwards.clone()], further) {
            assert!(number(&found["energy"]).abs() < 1e-9, "{class}: {found}");
        }
    }
    // Without a search, another start point is another shape.
    let found = energies(&[posed(0), posed(3)], json!({}));
    assert!(number(&found[0]["energy"]) < 1e-12 && number(&found[1]["energy"]) > 1e-3, "{found:?}");
}

#[test]
fn the_energy_has_no_unit_and_its_gradient_is_that_of_differences() {
    let further = json!({"weight": 30});
    let sizes = energies(&[dented(1.0), dented(1000.0), dented(1e-3)], further.clone());
    let energy = number(&sizes[0]["energy"]);
    for found in &sizes {
        assert!((number(&found["energy"]) / energy - 1.0).abs() < 1e-9, "{found} {energy}");
        let area = number(&found["volume"]);
        let expected = 30.0 * number(&found["squared_distance"]) / area;
        assert!((expected / energy - 1.0).abs() < 1e-9, "{expected} {energy}");
    }
    let gradient = flat(&sizes[0]["gradient"]);
    for (k, c) in [(0, 0), (2, 1), (5, 0), (7, 1)] {
        let moved = |step: f64| {
            let mut points = dented(1.0);
            points[k][c] += step;
            points
        };
        let found = energies(&[moved(1e-4), moved(-1e-4)], further.clone());
        let difference = (number(&found[0]["energy"]) - number(&found[1]["energy"])) / 2e-4;
        let slope = gradient[2 * k + c];
        assert!((difference - slope).abs() < 1e-6 * (1.0 + slope.abs()), "{k} {c}: {difference} {slope}");
    }
}

/// What a shape encloses is one number on every route: of curves, spheres and tori, of pieces of all kinds.
#[test]
fn areas_and_volumes_are_exact() {
    let (cubic, waves) = (json!({"name": "cubic"}), json!({"name": "trigonometric"}));
    let squares = json!({"name": "exponential", "poles": [[0, 0], [0, 0], [0, 0]]});
    let line = |generator: &Value| {
        let representation =
            json!({"kind": "closed_curve", "dimension": 2, "control_points": 7, "generator": generator});
        let point = |k: usize| {
            let t = TAU * k as f64 / 7.0;
            let r = 3.0 + 0.7 * (2.0 * t + 0.4).sin();
            [r * t.cos() + 9.0, r * t.sin() - 4.0]
        };
        (representation, json!((0..7).map(point).collect::<Vec<_>>()), "signed_area")
    };
    let surface = |topology: &str, rows: usize, generator: &Value| {
        let representation = json!({"kind": "surface", "topology": topology, "control_points": [8, 5], "generators": [generator, generator]});
        let point = |k: usize, l: usize| {
            let (u, v) = (TAU * k as f64 / 8.0, l as f64 / 5.0);
            let r = 1.0 + 0.2 * (2.0 * u).sin() * (TAU * v).sin();
            let (out, up) = if rows == 5 {
                (4.0 + r * (TAU * v).cos(), r * (TAU * v).sin())
            } else {
                (r * (PI * v).sin(), 2.0 * (PI * v).cos())
            };
            [out * u.cos() + 3.0, out * u.sin() + 0.3 * up, up]
        };
        let points: Vec<Vec<[f64; 3]>> = (0..8).map(|k| (0..rows).map(|l| point(k, l)).collect()).collect();
        (representation, json!(points), "signed_volume")
    };
    let kinds = [
        line(&cubic),
        line(&squares),
        line(&waves),
        surface("torus", 5, &cubic),
        surface("torus", 5, &waves),
        surface("sphere", 6, &waves),
        surface("sphere", 6, &cubic),
    ];
    for (representation, points, name) in kinds {
        let shapes = json!([{"points": points}]);
        let measured = shared()
            .post("/v1/measure", &json!({"representation": representation, "shapes": shapes}))
            .expect(200);
        let expected = number(&measured["results"][0][name]).abs();
        let body = json!({"representation": representation, "transformation": "similarity", "reference": shapes[0], "shapes": shapes});
        let found = number(&shared().post(PATH, &body).expect(200)["results"][0]["volume"]);
        assert!((found / expected - 1.0).abs() < 1e-12, "{representation}: {found} {expected}");
    }
}

/// The gradient belongs to the points as posted, wherever the shape begins.
#[test]
fn gradients_follow_the_points_of_a_search() {
    let cyclic = json!({"correspondence": "cyclic", "direction": "either"});
    let points = dented(1.0);
    let mut turned = points.clone();
    turned.rotate_left(3);
    let found = energies(&[points, turned], cyclic);
    let [first, second] = [&found[0], &found[1]].map(|found| number(&found["energy"]));
    assert!((first / second - 1.0).abs() < 1e-9, "{first} {second}");
    let total = |found: &Value| flat(&found["gradient"]).iter().map(|slope| slope * slope).sum::<f64>();
    assert!((total(&found[0]) / total(&found[1]) - 1.0).abs() < 1e-9);
}

#[test]
fn the_prior_is_the_term_of_a_segmentation() {
    let points = pear(2.0, 0.4, [16.0, 20.0], 0);
    let reference = json!({"control_points": dented(1.0)});
    let further = json!({"reference": reference, "weight": 7});
    let found = energies(std::slice::from_ref(&points), further)[0].clone();
    let mut body = curves(json!({
        "shapes": [shape(&points)], "stages": [{"sigma": 2, "iterations": 0}],
        "prior": {"reference": reference, "transformation": "similarity", "weight": 7}
    }));
    body.as_object_mut().unwrap().remove("boxes");
    let term =
        post_image(&shared(), SEGMENT, &body, &bright()).expect(200)["results"][0]["energies"]["prior"]
            .clone();
    let (prior, weighted) = (number(&found["energy"]), number(&term["weighted"]));
    assert!((prior / weighted - 1.0).abs() < 1e-12, "{prior} {weighted}");
}

/// Under `cyclic` initial shapes begin where they fit the reference of the prior best.
#[test]
fn initial_shapes_begin_where_they_fit_the_reference() {
    let term = |correspondence: &str, backwards: bool| {
        let mut points = pear(2.0, 0.4, [16.0, 20.0], 3);
        if backwards {
            points.reverse();
        }
        let mut body = curves(json!({
            "shapes": [shape(&points)], "stages": [{"sigma": 2, "iterations": 0}], "correspondence": correspondence,
            "prior": {"reference": shape(&pear(1.0, 0.0, [0.0; 2], 0)), "transformation": "similarity"}
        }));
        body.as_object_mut().unwrap().remove("boxes");
        let found = post_image(&shared(), SEGMENT, &body, &bright()).expect(200);
        number(&found["results"][0]["energies"]["prior"]["value"])
    };
    assert!(term("landmarks", false) > 0.003, "{}", term("landmarks", false));
    assert!(term("cyclic", false) < 1e-9 && term("cyclic", true) < 1e-9, "{}", term("cyclic", false));
}

/// Among several dictionaries the one that lies nearest attracts, and the answer names it (thesis 8.2).
#[test]
fn a_prior_chooses_among_dictionaries() {
    let server = Setting::fresh().start();
    let waved = |turns: f64, depth: f64| -> Vec<[f64; 2]> {
        let point = |k: usize| {
            let t = TAU * k as f64 / COUNT as f64;
            let r = 6.0 * (1.0 + depth * (turns * t).cos());
            [r * t.cos(), r * t.sin()]
        };
        (0..COUNT).map(point).collect()
    };
    for (name, turns) in [("long", 2.0), ("three", 3.0)] {
        let shapes: Vec<Value> = (0..6).map(|i| shape(&waved(turns, 0.2 + 0.03 * f64::from(i)))).collect();
        server.post("/v1/cohorts", &json!({"name": name, "representation": representation()})).expect(201);
        server.post(&format!("/v1/cohorts/{name}/shapes"), &json!({"shapes": shapes})).expect(201);
        let learn = json!({"name": name, "cohort": name, "transformation": "similarity",
            "method": {"kind": "functional_pca", "components": 1}});
        let learn = server.request(Method::POST, "/v1/dictionaries").header("prefer", "wait=50").json(&learn);
        server.send(learn).expect(201);
    }
    let found = |points: &[[f64; 2]], prior: Value| {
        let mut body = curves(
            json!({"shapes": [shape(points)], "stages": [{"sigma": 2, "iterations": 0}], "prior": prior}),
        );
        body.as_object_mut().unwrap().remove("boxes");
        post_image(&server, SEGMENT, &body, &bright()).expect(200)["results"][0].clone()
    };
    let of = |field: &str, keys: Value, part: &str| json!({field: keys, "reference": part, "transformation": "similarity"});
    let value = |found: &Value| number(&found["energies"]["prior"]["value"]);
    let names = json!(["long", "three@1"]);
    for (turns, nearest) in [(2.0, "long"), (3.0, "three")] {
        let placed: Vec<[f64; 2]> = waved(turns, 0.25).iter().map(|[x, y]| [x + 16.0, y + 20.0]).collect();
        for part in ["mean", "components"] {
            let single =
                ["long", "three"].map(|name| value(&found(&placed, of("dictionary", json!(name), part))));
            let several = found(&placed, of("dictionaries", names.clone(), part));
            let id = server.get(&format!("/v1/dictionaries/{nearest}")).expect(200)["id"].clone();
            assert_eq!(several["chosen_dictionary"], id, "{part}");
            assert_eq!(value(&several), single[0].min(single[1]), "{part}: {single:?}");
        }
        assert!(found(&placed, of("dictionary", json!("long"), "mean"))["chosen_dictionary"].is_null());
    }
    let refused = |prior: Value| post_image(&server, SEGMENT, &curves(json!({"prior": prior})), &bright());
    refused(of("dictionaries", json!(["long"]), "mean")).expect_problem(
        422,
        "invalid-input",
        &["/prior/dictionaries"],
    );
    refused(of("dictionaries", json!(["long", "none"]), "mean")).expect_problem(404, "not-found", &[]);
    let mut both = of("dictionaries", names, "mean");
    both["dictionary"] = json!("long");
    refused(both).expect_problem(422, "invalid-input", &["/prior/reference"]);
}

#[test]
fn bodies_are_compared_by_rotations() {
    let mesh = json!({"kind": "subdivision", "scheme": "loop", "connectivity": "octahedron/1", "level": 3});
    let points = |scale: f64| -> Vec<[f64; 3]> {
        let found =
            shared().post("/v1/subdivide", &json!({"scheme": "loop", "level": 0, "start": "octahedron/1"}));
        let vertices = found.expect(200)["mesh"]["vertices"].as_array().unwrap().clone();
        let vertices = vertices.iter().map(|vertex| [0, 1, 2].map(|c| number(&vertex[c])));
        vertices.map(|[x, y, z]| [scale * x, scale * 1.4 * z, scale * -0.8 * y]).collect()
    };
    let body = json!({
        "representation": mesh, "transformation": "similarity", "alignment": "procrustes",
        "reference": {"control_points": points(1.0).iter().map(|[x, y, z]| [*x, -*z, *y]).collect::<Vec<_>>()},
        "shapes": [{"control_points": points(3.0)}]
    });
    let found = shared().post(PATH, &body).expect(200)["results"][0].clone();
    assert!(number(&found["energy"]).abs() < 1e-12 && number(&found["volume"]).abs() > 1.0, "{found}");
}

/// Shapes that enclose nothing: relative to the squared size about the mean, with the gradient of differences.
#[test]
fn priors_of_open_shapes_are_relative_to_their_size() {
    let open = json!({"kind": "open_curve", "dimension": 2, "intervals": 6, "generator": {"name": "cubic"}});
    let landmarks = json!({"kind": "landmarks", "dimension": 2, "points": COUNT});
    for (representation, alignment) in
        [(&landmarks, "projection"), (&landmarks, "procrustes"), (&open, "procrustes")]
    {
        let found = |shapes: &[Vec<[f64; 2]>]| -> Vec<Value> {
            let points = |points: &[[f64; 2]]| json!({"points": &points[..if representation == &open { 7 } else { COUNT }]});
            let shapes: Vec<Value> = shapes.iter().map(|shape| points(shape)).collect();
            let body = json!({"representation": representation, "transformation": "similarity", "alignment": alignment,
                "reference": points(&pear(1.0, 0.0, [0.0; 2], 0)), "shapes": shapes, "weight": 30});
            shared().post(PATH, &body).expect(200)["results"].as_array().unwrap().clone()
        };
        let zero = found(&[pear(2.5, 1.1, [40.0, 7.0], 0)]);
        assert!(number(&zero[0]["energy"]).abs() < 1e-12 && zero[0]["volume"].is_null(), "{zero:?}");
        let sizes = found(&[dented(1.0), dented(1000.0)]);
        let energy = number(&sizes[0]["energy"]);
        assert!(energy > 1e-3 && (number(&sizes[1]["energy"]) / energy - 1.0).abs() < 1e-9, "{sizes:?}");
        if representation == &open {
            continue;
        }
        // Control points of landmarks are the landmarks: the size is that of the points.
        let points = dented(1.0);
        let mean = [0, 1].map(|c| points.iter().map(|point| point[c]).sum::<f64>() / COUNT as f64);
        let square =
            points.iter().flat_map(|point| [0, 1].map(|c| (point[c] - mean[c]).powi(2))).sum::<f64>();
        let expected = 30.0 * number(&sizes[0]["squared_distance"]) / (square / COUNT as f64);
        assert!((expected / energy - 1.0).abs() < 1e-9, "{alignment}: {expected} {energy}");
        let gradient = flat(&sizes[0]["gradient"]);
        for (k, c) in [(0, 0), (2, 1), (7, 1)] {
            let moved = |step: f64| {
                let mut points = dented(1.0);
                points[k][c] += step;
                points
            };
            let found = found(&[moved(1e-4), moved(-1e-4)]);
            let difference = (number(&found[0]["energy"]) - number(&found[1]["energy"])) / 2e-4;
            let slope = gradient[2 * k + c];
            assert!(
                (difference - slope).abs() < 1e-6 * (1.0 + slope.abs()),
                "{alignment} {k} {c}: {difference} {slope}"
            );
        }
    }
}

#[test]
fn bad_priors_are_refused_at_their_place() {
    let server = shared();
    let refused = |further: Value, pointers: &[&str]| {
        let body = request(&[dented(1.0)], further);
        server.post(PATH, &body).expect_problem(422, "invalid-input", pointers);
    };
    refused(json!({"weight": -1}), &["/weight"]);
    refused(json!({"weight": "x"}), &["/weight"]);
    refused(json!({"reference": {"control_points": [[0, 0]]}}), &["/reference/control_points"]);
    let point = vec![[1.0, 1.0]; COUNT];
    let flat: Vec<[f64; 2]> = (0..COUNT).map(|k| [(k as f64 - 3.5).abs(), 0.0]).collect();
    let body = request(&[dented(1.0), flat], json!({}));
    server.post(PATH, &body).expect_problem(422, "invalid-input", &["/shapes/1"]);
    let found = server.post(&format!("{PATH}?on_error=skip"), &body).expect(200);
    assert!(found["results"][0]["energy"].is_number() && found["results"][1]["error"].is_object(), "{found}");
    server.post(PATH, &request(&[point], json!({}))).expect_problem(422, "degenerate-shape", &["/shapes/0"]);
}
