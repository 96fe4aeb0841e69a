//! Shapes of several resolutions over HTTP: a region gets control points of a finer grid, they are moved, evaluated, measured, drawn and
//! stored, and what does not fit is refused by name.

use std::f64::consts::{PI, TAU};

use serde_json::{Value, json};

use crate::server::{Server, assert_close, shared};

fn shifts(w: f64) -> Value {
    json!({"name": "interpolator", "family": "half_integer_shifts", "domain_poles": [[0, 0], [0, w], [0, -w]]})
}

/// Closed curves through eight points, and one of them.
fn round_curve() -> (Value, Value) {
    let generator = shifts(TAU);
    let points: Vec<[f64; 2]> =
        (0..8).map(|k| (TAU * f64::from(k) / 8.0).sin_cos()).map(|(s, c)| [3.0 * c, 2.0 * s]).collect();
    let representation =
        json!({"kind": "closed_curve", "dimension": 2, "control_points": 8, "generator": generator});
    (representation, json!({"points": points}))
}

/// Spheres of 6 × 4 intervals with an odd number of poles along both directions, and one of them: radius 2.
fn round_sphere(server: &Server) -> (Value, Value) {
    let representation = json!({"kind": "surface", "topology": "sphere", "control_points": [6, 4], "generators": [shifts(TAU), shifts(PI)]});
    let body = json!({"representation": representation, "surfaces": [{"surface": {"name": "sphere", "radius": 2.0}}]});
    let ideal = server.post("/v1/idealised", &body).expect(200);
    (representation, ideal["shapes"][0].clone())
}

fn refine(server: &Server, representation: &Value, shape: &Value, further: &Value) -> Value {
    let mut body = json!({"representation": representation, "shapes": [shape]});
    for (key, value) in further.as_object().unwrap() {
        body[key] = value.clone();
    }
    server.post("/v1/refine", &body).expect(200)
}

fn points_at(server: &Server, representation: &Value, shape: &Value, parameters: &Value) -> Value {
    let body = json!({"representation": representation, "shapes": [shape], "parameters": parameters});
    server.post("/v1/evaluate", &body).expect(200)["evaluations"][0]["points"].clone()
}

fn move_of(shape: &Value, block: usize, place: usize, by: &Value) -> Value {
    json!({"control_point": shape["blocks"][block]["indices"][place], "by": by, "block": block})
}

fn deform(server: &Server, representation: &Value, shape: &Value, moves: &Value) -> Value {
    let body = json!({"representation": representation, "shape": shape, "moves": moves});
    server.post("/v1/deform", &body).expect(200)
}

fn numbers(value: &Value) -> Vec<f64> {
    match value {
        Value::Array(list) => list.iter().flat_map(numbers).collect(),
        other => vec![other.as_f64().unwrap()],
    }
}

/// The shape of an answer, as it is posted again.
fn shape_of(answer: &Value) -> Value {
    json!({"control_points": answer["control_points"], "blocks": answer["blocks"]})
}

/// A region of a curve, and one of it at twice the resolution: the same curve, whose edits stay where they are.
#[test]
fn a_part_of_a_curve_is_edited_at_three_resolutions() {
    let server = &shared();
    let (representation, shape) = round_curve();
    let places: Vec<f64> = (0..160).map(|k| f64::from(k) / 160.0).collect();
    let at = |shape: &Value| points_at(server, &representation, shape, &json!(places));
    let answer =
        refine(server, &representation, &shape, &json!({"factor": 4, "region": {"u": [0.25, 0.75]}}));
    let kept = &answer["representation"]["control_points"];
    assert_eq!((kept, &answer["exact"]), (&representation["control_points"], &json!(true)), "{answer}");
    let still = &answer["shapes"][0];
    assert!(numbers(&still["blocks"][0]["offsets"]).iter().all(|offset| *offset == 0.0), "{still}");
    assert_close(&at(still), &at(&shape), 1e-12, "a block of no offsets");
    let answer = deform(server, &representation, still, &json!([move_of(still, 0, 6, &json!([-0.5, 0.2]))]));
    let (once, found) = (shape_of(&answer), &answer["supports"][0]["parameters"][0]);
    assert!((numbers(found)[1] - numbers(found)[0] - 3.0 / 32.0).abs() < 1e-12, "{found}");
    let more = json!({"factor": 16, "region": {"u": [0.4, 0.6]}});
    let finer = refine(server, &representation, &once, &more)["shapes"][0].clone();
    assert_close(&at(&finer), &at(&once), 1e-12, "a finer block of no offsets");
    let moves = json!([move_of(&finer, 1, 9, &json!([0.1, 0.0]))]);
    let twice = shape_of(&deform(server, &representation, &finer, &moves));
    for (before, after, region) in [(&shape, &once, [0.25, 0.75]), (&once, &twice, [0.4, 0.6])] {
        let (before, after) = (numbers(&at(before)), numbers(&at(after)));
        let moved =
            |k: usize| (0..2).map(|c| (after[2 * k + c] - before[2 * k + c]).abs()).fold(0.0, f64::max);
        let outside = |u: f64| u < region[0] || u > region[1];
        let still = places
            .iter()
            .enumerate()
            .filter(|(_, u)| outside(**u))
            .map(|(k, _)| moved(k))
            .fold(0.0, f64::max);
        let largest = (0..places.len()).map(moved).fold(0.0, f64::max);
        // The unmoved curve is computed on another grid the first time: rounding.
        assert!(still < 1e-14 && largest > 0.02, "{still} outside of {region:?}, {largest} inside");
    }
    // On one grid: the same curve, with a start that the answer tells; other endpoints take it.
    let flat = refine(server, &representation, &twice, &json!({}));
    assert_eq!(
        (&flat["representation"]["control_points"], &flat["exact"]),
        (&json!(128), &json!(true)),
        "{flat}"
    );
    let shift = flat["parameter_shift"].as_f64().unwrap();
    let ahead: Vec<f64> = places.iter().map(|u| u + shift).collect();
    let flattened = points_at(server, &flat["representation"], &flat["shapes"][0], &json!(ahead));
    assert_close(&flattened, &at(&twice), 1e-12, "the flat curve");
}

/// A sphere with a block over its pole and one on its side: measured and drawn as it is, stored in a cohort of the finest grid.
#[test]
fn a_sphere_with_blocks_is_measured_drawn_and_stored() {
    let server = Server::fresh();
    let (representation, sphere) = round_sphere(&server);
    let places: Vec<[f64; 2]> =
        (0..60).map(|k| [f64::from(k) / 60.0, (f64::from(k * 7 % 60) + 0.5) / 60.0]).collect();
    let at =
        |representation: &Value, shape: &Value| points_at(&server, representation, shape, &json!(places));
    let cap =
        refine(&server, &representation, &sphere, &json!({"region": {"v": [0.0, 0.5]}}))["shapes"][0].clone();
    let side = json!({"control_points": [24, 32], "region": {"u": [0.8, 1.2], "v": [0.3, 0.7]}});
    let side = refine(&server, &representation, &cap, &side)["shapes"][0].clone();
    assert_eq!(side["blocks"][1]["factors"], json!([4, 8]));
    assert_close(
        &at(&representation, &side),
        &at(&representation, &sphere),
        1e-12,
        "two blocks of no offsets",
    );
    let moves = json!([
        move_of(&side, 0, 0, &json!([0.0, 0.0, 0.3])),
        move_of(&side, 1, 5, &json!([0.4, 0.0, 0.0])),
        {"control_point": 3, "by": [0.1, 0.1, 0.0]},
    ]);
    let edited = shape_of(&deform(&server, &representation, &side, &moves));
    let flat = refine(&server, &representation, &edited, &json!({}));
    let shifts = numbers(&flat["parameter_shifts"]);
    assert!(shifts[0] > 0.0 && shifts[1] == 0.0, "{shifts:?}");
    let ahead: Vec<[f64; 2]> = places.iter().map(|[u, v]| [u + shifts[0], *v]).collect();
    let found = points_at(&server, &flat["representation"], &flat["shapes"][0], &json!(ahead));
    assert_close(&found, &at(&representation, &edited), 1e-12, "the flat sphere");
    // A multiple of the grids of the blocks is as good.
    let more = refine(&server, &representation, &edited, &json!({"factor": 8}));
    assert_eq!(more["representation"]["control_points"], json!([48, 32]));
    let measure = |representation: &Value, shape: &Value| {
        let body = json!({"representation": representation, "shapes": [shape], "reference": shape});
        server.post("/v1/measure", &body).expect(200)["results"][0].clone()
    };
    let (own, flattened) =
        (measure(&representation, &edited), measure(&flat["representation"], &flat["shapes"][0]));
    for field in ["volume", "area"] {
        assert_close(&own[field], &flattened[field], 1e-9, field);
    }
    let drawn = server
        .post("/v1/evaluate?format=svg", &json!({"representation": representation, "shapes": [edited]}));
    assert_eq!((drawn.status, drawn.text().starts_with("<svg")), (200, true));
    let cohort =
        json!({"name": "edited", "representation": flat["representation"], "correspondence": "landmarks"});
    server.post("/v1/cohorts", &cohort).expect(201);
    server.post("/v1/cohorts/edited/shapes", &json!({"shapes": flat["shapes"]})).expect(201);
    let refused =
        json!({"shapes": [{"control_points": edited["control_points"], "blocks": edited["blocks"]}]});
    server.post("/v1/cohorts/edited/shapes", &refused).expect_problem(
        422,
        "invalid-input",
        &["/shapes/0/blocks", "/shapes/0/control_points"],
    );
}

/// Handles pull a shape where it is with its details.
#[test]
fn handles_are_met_over_blocks() {
    let server = &shared();
    let (representation, shape) = round_curve();
    let block =
        refine(server, &representation, &shape, &json!({"region": {"u": [0.9, 1.4]}}))["shapes"][0].clone();
    let edit = json!({"representation": representation, "shape": block, "moves": [move_of(&block, 0, 2, &json!([0.5, 0.5]))],
        "handles": [{"parameters": [0.1], "position": [4.0, 1.0]}]});
    let after = shape_of(&server.post("/v1/deform", &edit).expect(200));
    let found = points_at(server, &representation, &after, &json!([0.1]));
    assert_close(&found, &json!([[4.0, 1.0]]), 1e-12, "a handle");
    assert!(numbers(&after["blocks"][0]["offsets"]).contains(&0.5), "{after}");
}

#[test]
fn regions_that_do_not_fit_are_refused() {
    let server = &shared();
    let (representation, shape) = round_curve();
    let refused = |further: Value, pointers: &[&str], words: &str| {
        let mut body = json!({"representation": representation, "shapes": [shape]});
        for (key, value) in further.as_object().unwrap() {
            body[key] = value.clone();
        }
        let problem = server.post("/v1/refine", &body).expect_problem(422, "invalid-input", pointers);
        assert!(problem.to_string().contains(words), "{problem}");
    };
    refused(json!({"region": {}}), &["/region"], "expected an interval of u or v, got neither");
    refused(json!({"region": {"u": [0.5, 0.5]}}), &["/region/u"], "got [0.5, 0.5]");
    refused(
        json!({"region": {"u": [0.5, 1.0], "v": [0, 1]}}),
        &["/region/v"],
        "which the shapes do not have",
    );
    refused(json!({"region": {"u": [0.5, 0.6]}}), &["/region/u"], "at least 0.1875");
    refused(json!({"region": {"u": [0.5, 1.0]}, "factor": 3}), &["/factor"], "interpolator by 3");
    refused(
        json!({"region": {"u": [0.5, 1.0]}, "factor": 1024}),
        &["/factor"],
        "got 8192 on the finest grid",
    );
    refused(json!({"region": {"u": [0.5, 1.0]}, "factor": 1}), &["/factor"], "got 1");
    let cubic =
        json!({"kind": "closed_curve", "dimension": 2, "control_points": 8, "generator": {"name": "cubic"}});
    let body = json!({"representation": cubic, "shapes": [shape], "region": {"u": [0.2, 0.8]}});
    let problem = server.post("/v1/refine", &body).expect_problem(422, "invalid-input", &["/region"]);
    assert!(problem.to_string().contains("got cubic by 2"), "{problem}");
    let (sphere, round) = round_sphere(server);
    let body = json!({"representation": sphere, "shapes": [round], "region": {"v": [0.2, 0.8]}, "control_points": [9, 8]});
    server.post("/v1/refine", &body).expect_problem(422, "invalid-input", &["/control_points"]);
}

#[test]
fn blocks_that_do_not_fit_are_refused() {
    let server = &shared();
    let (representation, shape) = round_curve();
    let block = |factors: Value, indices: Value, offsets: Value| {
        let mut shape = shape.clone();
        shape["blocks"] = json!([{"factors": factors, "indices": indices, "offsets": offsets}]);
        shape
    };
    let cases = [
        (
            block(json!([2, 2]), json!([1]), json!([[0, 1]])),
            "/factors",
            "one number per direction, 1 in all, got 2",
        ),
        (block(json!([0]), json!([1]), json!([[0, 1]])), "/factors/0", "got 0"),
        (block(json!([1]), json!([1]), json!([[0, 1]])), "/factors", "at least 2, got 1"),
        (block(json!([3]), json!([1]), json!([[0, 1]])), "/factors", "interpolator by 3"),
        (block(json!([1000]), json!([1]), json!([[0, 1]])), "/factors", "got 8000"),
        (block(json!([2]), json!([16]), json!([[0, 1]])), "/indices/0", "below 16, got 16"),
        (block(json!([2]), json!([5, 5]), json!([[0, 1], [0, 1]])), "/indices/1", "got 5 after 5"),
        (block(json!([2]), json!([5]), json!([[0, 1], [0, 1]])), "/offsets", "one per index, got 2"),
        (block(json!([2]), json!([5]), json!([[0, 1, 2]])), "/offsets/0", "got 3"),
    ];
    for (shape, field, words) in cases {
        let body = json!({"representation": representation, "shapes": [shape]});
        for path in ["/v1/evaluate", "/v1/measure", "/v1/refine"] {
            let pointer = format!("/shapes/0/blocks/0{field}");
            let problem = server.post(path, &body).expect_problem(422, "invalid-input", &[&pointer]);
            assert!(problem.to_string().contains(words), "{path}: {problem}");
        }
    }
    // One grid must refine those of all blocks.
    let three = json!({"kind": "closed_curve", "dimension": 2, "control_points": 8, "generator": {"name": "bspline", "degree": 3}});
    let shape = block(json!([3]), json!([4]), json!([[0, 1]]));
    let body = json!({"representation": three, "shapes": [shape], "factor": 4});
    server.post("/v1/refine", &body).expect_problem(422, "invalid-input", &["/factor"]);
    // Others take shapes of one resolution.
    let body = json!({"representation": three, "transformation": "similarity", "shapes": [shape, shape]});
    let problem = server.post("/v1/mean", &body).expect_problem(
        422,
        "invalid-input",
        &["/shapes/0/blocks", "/shapes/1/blocks"],
    );
    assert!(problem.to_string().contains("refine brings it to the finest"), "{problem}");
    let moves = json!([{"control_point": 1, "by": [0, 1], "block": 0}, {"control_point": 4, "by": [0, 1], "block": 1}]);
    let body = json!({"representation": three, "shape": shape, "moves": moves});
    let pointers = ["/moves/0/control_point", "/moves/1/block"];
    server.post("/v1/deform", &body).expect_problem(422, "invalid-input", &pointers);
}
