//! Warps and sliding semilandmarks over HTTP: vectors, pictures, refusals, a file of trilobites from its curves to components.

use std::path::Path;

use serde_json::{Value, json};

use crate::server::{Server, flat, shared};

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("a number, got {value}"))
}

#[track_caller]
fn near(found: &Value, wanted: &Value, tolerance: f64) {
    let (found, wanted) = (flat(found), flat(wanted));
    assert_eq!(found.len(), wanted.len());
    let error = found.iter().zip(&wanted).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(error < tolerance, "{error:e} of {tolerance:e}");
}

const SQUARE: [[f64; 2]; 5] = [[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0], [2.0, 2.0]];
const BENT: [[f64; 2]; 5] = [[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0], [2.5, 2.2]];

/// A cube with a point in its middle, which moves by `shift`.
fn cube(shift: f64) -> Vec<[f64; 3]> {
    let corner = |k: usize| [k & 1, k >> 1 & 1, k >> 2].map(|x| x as f64);
    (0..8).map(corner).chain([[0.5 + shift, 0.5, 0.4]]).collect()
}

#[test]
fn warps_meet_their_targets_and_tell_where_they_fold() {
    let server = shared();
    let body = json!({"reference": SQUARE, "target": BENT, "points": SQUARE, "partial_warps": true,
        "grid": {"cells": 4, "margin": 0}});
    let found = server.post("/v1/warp", &body).expect(200);
    near(&found["points"], &json!(BENT), 1e-12);
    assert!(number(&found["residual"]) < 1e-12);
    let parts = found["partial_warps"].as_array().unwrap();
    let sum: f64 = parts.iter().map(|part| number(&part["energy"])).sum();
    let energy = number(&found["bending_energy"]);
    assert!(parts.len() == 2 && energy > 0.0 && (sum - energy).abs() < 1e-10 * energy, "{found}");
    let grid = &found["grid"];
    assert_eq!(
        (&grid["size"], &grid["spacing"], &grid["first"]),
        (&json!([5, 5]), &json!(1.0), &json!([0.0, 0.0]))
    );
    assert_eq!((grid["nodes"].as_array().unwrap().len(), &found["folds"]), (25, &json!(0)));
    assert_eq!(found["warnings"], json!([]));
    // Twice as far as the corner: the middle passes it.
    let far = json!({"reference": SQUARE, "target": BENT, "magnify": 20, "points": [[90, 0]]});
    let far = server.post("/v1/warp", &far).expect(200);
    assert!(far["folds"].as_u64().unwrap() > 0 && far["warnings"].as_array().unwrap().len() == 2, "{far}");
    assert!(far["grid"].is_null() && far["partial_warps"].is_null());
    // A target that is turned and scaled is affine: nothing bends.
    let turned: Vec<[f64; 2]> = SQUARE.iter().map(|[x, y]| [5.0 - 3.0 * y, 1.0 + 3.0 * x]).collect();
    let same = json!({"reference": SQUARE, "target": turned, "superimpose": true, "points": SQUARE});
    let same = server.post("/v1/warp", &same).expect(200);
    near(&same["points"], &json!(SQUARE), 1e-12);
    assert!(number(&same["bending_energy"]) < 1e-20);
    let smooth = json!({"reference": SQUARE, "target": BENT, "smoothing": 1});
    let smooth = server.post("/v1/warp", &smooth).expect(200);
    assert!(number(&smooth["bending_energy"]) < energy && number(&smooth["residual"]) > 0.01);
}

#[test]
fn landmarks_are_transferred_onto_a_surface() {
    let server = shared();
    let faces = [[0, 1, 3], [0, 3, 2]];
    let body = json!({"reference": cube(0.0), "target": cube(0.1), "points": [[0.5, 0.5, 0.1], [0.2, 0.3, 0.0]],
        "onto": {"vertices": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], "faces": faces}});
    let found = server.post("/v1/warp", &body).expect(200);
    let points = flat(&found["points"]);
    assert!(points[2].abs() < 1e-15 && points[5].abs() < 1e-15, "{found}");
    assert!(number(&found["distances"][0]) > 0.05);
    let wrong = |body: Value, pointers: &[&str]| {
        server.post("/v1/warp", &body).expect_problem(422, "invalid-input", pointers);
    };
    wrong(
        json!({"reference": cube(0.0), "target": cube(0.1), "points": [[0, 0, 0]],
        "onto": {"vertices": [[0, 0, 0], [1, 0, 0], [0, 1, 0]], "faces": [[0, 1, 3]]}}),
        &["/onto/faces/0"],
    );
    wrong(
        json!({"reference": cube(0.0), "target": cube(0.1), "onto": {"vertices": [[0, 0, 0]], "faces": []}}),
        &["/onto/faces"],
    );
    wrong(
        json!({"reference": SQUARE, "target": BENT, "points": [[0, 0]],
        "onto": {"vertices": [[0, 0, 0], [1, 0, 0], [0, 1, 0]], "faces": [[0, 1, 2]]}}),
        &["/onto"],
    );
}

#[test]
fn warps_are_drawn_in_three_ways() {
    let server = shared();
    let plane = json!({"reference": SQUARE, "target": BENT, "links": [[0, 1], [1, 2], [2, 3], [3, 0]]});
    let space = json!({"reference": cube(0.0), "target": cube(0.2), "links": [[0, 1], [1, 3]]});
    for body in [&plane, &space] {
        for show in ["grid", "arrows", "wireframe"] {
            let path = format!("/v1/warp?format=svg&show={show}");
            let numbered = server.post(&path, body);
            let words = |svg: &str| svg.matches("font-size=\"10\"").count();
            let views = if show == "grid" && body == &space { 2 } else { 1 };
            let count = body["reference"].as_array().unwrap().len();
            assert_eq!(words(numbered.expect_svg()), views * count, "{show}");
            let bare = server.post(&format!("{path}&numbers=false"), body);
            assert_eq!(words(bare.expect_svg()), 0, "{show}");
            let png = server.post(&format!("/v1/warp?format=png&show={show}"), body);
            assert_eq!((png.status, png.header("content-type")), (200, Some("image/png")));
        }
    }
    let folded = json!({"reference": SQUARE, "target": BENT, "magnify": 20});
    assert!(server.post("/v1/warp?format=svg", &folded).expect_svg().contains("folds at"));
    server.post("/v1/warp?show=grid", &plane).expect(400);
    server.post("/v1/warp?format=svg&show=map", &plane).expect(400);
    let fine = json!({"reference": SQUARE, "target": BENT, "grid": {"cells": 201}});
    server.post("/v1/warp?format=svg", &fine).expect_problem(422, "invalid-input", &["/grid/cells"]);
}

#[test]
fn warps_that_cannot_be_are_refused_at_their_places() {
    let server = shared();
    let refused = |change: Value, pointers: &[&str]| {
        let mut body = json!({"reference": SQUARE, "target": BENT});
        body.as_object_mut().unwrap().extend(change.as_object().unwrap().clone());
        let problem = server.post("/v1/warp", &body).expect_problem(422, "invalid-input", pointers);
        assert!(problem.to_string().contains("expected"), "{problem}");
    };
    refused(json!({"reference": [[0, 0], [1, 0]], "target": [[0, 0], [1, 0]]}), &["/reference"]);
    refused(json!({"reference": []}), &["/reference", "/target"]);
    refused(json!({"target": [[0, 0], [1, 0], [1, 1]]}), &["/target"]);
    refused(json!({"target": [[0, 0], [1, 0], [1, 1], null, [0, 1, 2]]}), &["/target/3", "/target/4"]);
    refused(json!({"reference": [[0, 0], [1, 1], [2, 2], [3, 3], [4, 4]]}), &["/reference"]);
    refused(json!({"reference": [[0, 0], [1, 1], [2, 0], [3, 3], [1, 1]]}), &["/reference/4"]);
    refused(json!({"reference": [[[0, 0], [1, 1]], [[2, 0], [3, 3]]]}), &["/reference"]);
    refused(json!({"points": [[0, 0, 0]]}), &["/points/0"]);
    refused(
        json!({"magnify": 1e4, "smoothing": -1, "links": [[0, 1], [2, 5]]}),
        &["/magnify", "/smoothing", "/links/1"],
    );
    refused(json!({"grid": {"cells": 0}}), &["/grid/cells"]);
    refused(json!({"grid": {"cells": 100_000}}), &["/grid/cells"]);
    refused(json!({"grid": {"margin": -1}}), &["/grid/margin"]);
    refused(json!({"grid": {"size": 3}}), &["/grid/size"]);
    let many: Vec<[f64; 2]> = (0..501).map(|k| [f64::from(k), f64::from(k * k % 97)]).collect();
    refused(json!({"reference": many, "target": many, "partial_warps": true}), &["/partial_warps"]);
}

/// Vectors of sliding: the points of a set, and its cases.
fn vectors(name: &str) -> (Value, Vec<Value>) {
    let text = include_bytes!("../vectors/elastic/sliding.json");
    let vectors: Value = serde_json::from_slice(text).unwrap();
    let cases: Vec<Value> =
        vectors["cases"].as_array().unwrap().iter().filter(|case| case["name"] == name).cloned().collect();
    (cases[0]["points"].clone(), cases)
}

fn shapes(points: &Value, metadata: &Value) -> Vec<Value> {
    let shape = |(k, points): (usize, &Value)| json!({"external_id": format!("s{k}"), "label": "a", "points": points, "metadata": metadata});
    points.as_array().unwrap().iter().enumerate().map(shape).collect()
}

#[test]
fn trilobites_slide_from_their_metadata_as_in_the_vectors() {
    let server = shared();
    let (points, cases) = vectors("trilobites");
    let shapes = shapes(&points, &json!({"landmarks": 6, "curves": [12, 20, 20, 20]}));
    let attach = json!([[1, 3], [0, 4], [0, 5], [2, 5]]);
    for case in &cases {
        let criterion = &case["criterion"];
        let mut body = json!({"shapes": shapes, "sliders": "auto", "attach": attach, "criterion": criterion});
        if case["protocol"] == "centred" {
            let found = server.post("/v1/slide", &body).expect(200);
            near(&found["displacements"], &case["displacements"], 1e-8);
            assert_eq!((&found["converged"], &found["protocol"]), (&json!(true), &json!("centred")));
            assert_eq!(found["sliders"].as_array().unwrap().len(), 72);
            // What has slid may be posted again.
            let again = json!({"shapes": found["shapes"], "sliders": "auto", "attach": attach});
            let again = server.post("/v1/slide", &again).expect(200);
            assert_eq!(again["shapes"][7]["external_id"], "s7");
            body["shapes"].as_array_mut().unwrap().reverse();
            let reversed = server.post("/v1/slide", &body).expect(200);
            assert_eq!(reversed["consensus"], found["consensus"]);
            assert_eq!(reversed["aligned"][0], found["aligned"][7]);
        } else {
            body["protocol"] = json!("gpagen");
            body["principal_axes"] = json!(false);
            let found = server.post("/v1/slide", &body).expect(200);
            near(&found["aligned"][0], &case["first"], 1e-10);
            near(&found["aligned"][7], &case["last"], 1e-10);
            near(&found["consensus"], &case["consensus"], 1e-10);
            near(&json!([found["criterion_values"]]), &json!([case["criterion_values"]]), 1e-10);
            let warnings = found["warnings"].to_string();
            assert!(warnings.contains("does not converge") && warnings.contains("unit size"), "{warnings}");
            assert_eq!((&found["rounds"], &found["displacements"]), (&json!(10), &Value::Null));
        }
    }
}

#[test]
fn sliders_of_tables_and_curves_are_the_same() {
    let server = shared();
    let (points, cases) = vectors("arches");
    let rows = &cases[0]["sliders"];
    let text: String =
        rows.as_array().unwrap().iter().fold("before,slide,after\n".into(), |text: String, row| {
            let row: Vec<usize> = serde_json::from_value(row.clone()).unwrap();
            text + &format!("{},{},{}\n", row[0] + 1, row[1] + 1, row[2] + 1)
        });
    let shapes = shapes(&points, &json!({}));
    let of = |key: &str, value: &Value| {
        let mut body = json!({"shapes": shapes});
        body[key] = value.clone();
        server.post("/v1/slide", &body).expect(200)
    };
    let found = of("sliders", rows);
    assert_eq!(of("sliders", &json!(text)), found);
    assert_eq!(of("curves", &json!([[0, 1, 2, 3, 4, 5, 6, 7, 8]])), found);
    let case = cases.iter().find(|case| case["protocol"] == "centred").unwrap();
    near(&found["displacements"], &case["displacements"], 1e-8);
}

/// A file of trilobites becomes a cohort whose points of curves slide; the result becomes a cohort with components.
#[test]
fn a_file_of_trilobites_slides_end_to_end() {
    let file =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data/landmarks-trilobite-cephala/cephala.tps");
    let Ok(text) = std::fs::read(file) else {
        println!("SKIPPED: landmarks-trilobite-cephala is not beside the project");
        return;
    };
    let server = Server::fresh();
    let representation = json!({"kind": "landmarks", "dimension": 2, "points": 88});
    for name in ["given", "slid"] {
        server.post("/v1/cohorts", &json!({"name": name, "representation": representation})).expect(201);
    }
    let path = "/v1/cohorts/given/shapes?curves=append&on_error=skip&name=cephala.tps";
    let stored = server.post_bytes(path, "application/octet-stream", text);
    assert!(stored.status < 300, "{}", stored.text());
    let body = json!({"cohort": "given", "sliders": "auto", "attach": [[1, 5], [0, 10], [0, 14], [3, 14]]});
    let found = server.post("/v1/slide", &body).expect(200);
    let count = found["shapes"].as_array().unwrap().len();
    println!("{count} of 210 specimens have all points; {} rounds, {}", found["rounds"], found["warnings"]);
    assert!(count > 180);
    assert_eq!(found["converged"], true, "{}", found["warnings"]);
    server.post("/v1/cohorts/slid/shapes", &json!({"shapes": found["shapes"]})).expect(201);
    let mean = server.get("/v1/cohorts/slid/mean?transformation=similarity").expect(200);
    assert_eq!(mean["shape_count"], count, "{mean}");
}

#[test]
fn scallops_slide_on_surfaces() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/math/vectors/elastic/sliding.json");
    let Ok(text) = std::fs::read(file) else {
        println!("SKIPPED: vectors/elastic/sliding.json is not beside the project");
        return;
    };
    let vectors: Value = serde_json::from_slice(&text).unwrap();
    let cases: Vec<&Value> =
        vectors["cases"].as_array().unwrap().iter().filter(|case| case["name"] == "scallops").collect();
    let shapes = shapes(&cases[0]["points"], &json!({}));
    for case in &cases {
        let mut body = json!({"shapes": shapes, "sliders": cases[0]["sliders"], "surface": cases[0]["surface"],
            "criterion": case["criterion"]});
        if case["protocol"] == "centred" {
            let found = server_slide(&body);
            near(&found["displacements"], &case["displacements"], 1e-8);
        } else {
            body["protocol"] = json!("gpagen");
            body["principal_axes"] = json!(false);
            near(&server_slide(&body)["aligned"][0], &case["first"], 1e-10);
        }
    }
}

fn server_slide(body: &Value) -> Value {
    shared().post("/v1/slide", body).expect(200)
}

#[test]
fn shapes_that_cannot_slide_are_refused_at_their_places() {
    let server = shared();
    let (points, _) = vectors("arches");
    let shapes = shapes(&points, &json!({"landmarks": 2, "curves": [9]}));
    let refused = |change: Value, pointers: &[&str]| {
        let mut body = json!({"shapes": shapes, "sliders": [[0, 1, 2]]});
        body.as_object_mut().unwrap().extend(change.as_object().unwrap().clone());
        let problem = server.post("/v1/slide", &body).expect_problem(422, "invalid-input", pointers);
        assert!(problem.to_string().contains("expected"), "{problem}");
    };
    refused(json!({"sliders": [[0, 1, 2], [1, 11, 2]]}), &["/sliders/1"]);
    refused(json!({"sliders": [[0, 1, 2], [2, 1, 3]]}), &["/sliders/1"]);
    refused(json!({"sliders": []}), &["/sliders"]);
    refused(json!({"sliders": "1,2\n"}), &["/sliders"]);
    refused(json!({"sliders": "1 2 3\n2 20 3"}), &["/sliders"]);
    refused(json!({"sliders": "auto", "attach": [null, [0, 1]]}), &["/attach"]);
    refused(json!({"attach": [[0, 1]]}), &["/attach"]);
    refused(json!({"curves": [[0, 1, 2]]}), &["/curves"]);
    refused(json!({"surface": [9]}), &["/surface/0"]);
    refused(json!({"project": false}), &["/project"]);
    refused(json!({"criterion": "energy"}), &["/criterion"]);
    refused(json!({"filter": {"label": "a"}}), &["/filter"]);
    refused(json!({"cohort": "none"}), &[""]);
    refused(json!({"shapes": [{"points": SQUARE}]}), &["/shapes"]);
    refused(json!({"shapes": [{"points": SQUARE}, {"points": cube(0.0)}]}), &["/shapes/1/points"]);
    refused(
        json!({"shapes": [{"points": SQUARE}, {"points": [[0, 0], null, [1, 1], [1, 0], [2, 2]]}]}),
        &["/shapes/1/points/1"],
    );
    refused(
        json!({"shapes": [{"points": SQUARE}, {"points": [[1, 1], [0, 0], [1, 1], [3, 0], [2, 2]]}]}),
        &["/shapes/1/points/1"],
    );
    refused(
        json!({"shapes": [{"points": SQUARE}, {"points": [[1, 1], [1, 1], [1, 1], [1, 1], [1, 1]]}]}),
        &["/shapes/1/points"],
    );
    let mut told = shapes.clone();
    told[2]["metadata"]["curves"] = json!([8]);
    refused(json!({"shapes": told, "sliders": "auto"}), &["/shapes/2/metadata"]);
    told[2]["metadata"] = Value::Null;
    refused(json!({"shapes": told, "sliders": "auto"}), &["/shapes/2/metadata"]);
}
