//! Completion of shapes of which a part is known.

use std::f64::consts::TAU;

use serde_json::{Value, json};

use crate::http_dictionaries::{finished, submit};
use crate::server::{Server, shared};

const POINTS: usize = 16;

/// An oval in the plane, in a pose of its own, in millimetres.
fn oval(k: usize) -> Vec<[f64; 2]> {
    let noise = |i: usize| (12.9898 * i as f64 + 78.233 * k as f64).sin() * 43758.547 % 1.0;
    let (length, bulge, turn) = (3.0 + 0.5 * noise(1), 0.3 * noise(2), 3.0 * noise(3));
    let point = |i: usize| {
        let t = TAU * i as f64 / POINTS as f64;
        let (x, y) = (
            length * t.cos() + 0.02 * noise(10 + i),
            (2.0 + bulge * t.cos()) * t.sin() + 0.02 * noise(400 + i),
        );
        [10.0 * (x * turn.cos() - y * turn.sin()) + 5.0, 10.0 * (x * turn.sin() + y * turn.cos())]
    };
    (0..POINTS).map(point).collect()
}

/// A cohort of ovals with a dictionary, both with this name.
fn learnt(server: &Server, name: &str, count: usize, representation: &Value, method: &Value) {
    let body = json!({"name": name, "representation": representation, "length_unit": "mm"});
    server.post("/v1/cohorts", &body).expect(201);
    let shape = |k: usize| json!({"points": oval(k), "external_id": format!("oval-{k}")});
    let shapes: Vec<Value> = (0..count).map(shape).collect();
    server.post(&format!("/v1/cohorts/{name}/shapes"), &json!({ "shapes": shapes })).expect(201);
    let body = json!({"name": name, "cohort": name, "transformation": "similarity", "method": method});
    finished(server, &submit(server, &body));
}

fn curve() -> Value {
    json!({"kind": "closed_curve", "dimension": 2, "control_points": POINTS, "generator": {"name": "trigonometric"}})
}

fn components() -> Value {
    json!({"kind": "functional_pca", "components": 5, "centre": true})
}

fn path(name: &str) -> String {
    format!("/v1/dictionaries/{name}/complete")
}

/// Points of an oval, those from `hidden` on missing.
fn part(k: usize, hidden: usize) -> Value {
    let points = oval(k).into_iter().enumerate();
    points.map(|(i, point)| if i < hidden { json!(point) } else { Value::Null }).collect()
}

#[test]
fn hidden_parts_are_completed_with_bands() {
    let server = shared();
    learnt(&server, "completed", 40, &curve(), &components());
    let count = 60;
    let shapes: Vec<Value> = (40..40 + count).map(|k| json!({"control_points": part(k, 12)})).collect();
    let found = server.post(&path("completed"), &json!({ "shapes": shapes })).expect(200);
    assert_eq!(
        (&found["dictionary"]["name"], &found["calibration_subjects"]),
        (&json!("completed"), &json!(40))
    );
    assert_eq!(found["warnings"], Value::Null);
    let factor = found["simultaneous_factor"].as_f64().unwrap();
    assert!(factor > found["pointwise_factor"].as_f64().unwrap() && factor < 10.0, "{found}");
    let mut covered = 0;
    for (k, result) in found["results"].as_array().unwrap().iter().enumerate() {
        let (truth, bands) = (oval(40 + k), &result["bands"]);
        assert_eq!(bands["points"].as_array().unwrap().len(), POINTS);
        assert_eq!((&bands["observed"][11], &bands["observed"][12]), (&json!(true), &json!(false)));
        let mut within = true;
        for i in 12..POINTS {
            let at = |c: usize| bands["points"][i][c].as_f64().unwrap();
            let [x, y] = [truth[i][0] - at(0), truth[i][1] - at(1)];
            let c = |a: usize, b: usize| bands["covariances"][i][a][b].as_f64().unwrap();
            let square = (c(1, 1) * x * x - 2.0 * c(0, 1) * x * y + c(0, 0) * y * y)
                / (c(0, 0) * c(1, 1) - c(0, 1) * c(1, 0));
            within &= square <= factor * factor;
            // A completed oval is near the real one: these are some 60 mm long.
            assert!(x.hypot(y) < 6.0, "{k} {i}: {x} {y}");
        }
        covered += usize::from(within);
    }
    assert!(covered * 10 >= count * 8, "{covered} of {count}");
    // The same request has the same answer.
    assert_eq!(found, server.post(&path("completed"), &json!({ "shapes": shapes })).expect(200));
}

/// Nulls, a mask, an arc and named points say the same.
#[test]
fn what_is_missing_can_be_said_in_four_ways() {
    let server = shared();
    learnt(&server, "missing", 30, &curve(), &components());
    let mask: Vec<bool> = (0..POINTS).map(|i| i < 12).collect();
    let whole = oval(40);
    let named: Vec<Value> =
        (0..12).map(|i| json!({"at": i as f64 / POINTS as f64, "point": whole[i]})).collect();
    let shapes = json!([
        {"control_points": part(40, 12)},
        {"control_points": whole, "observed": mask},
        {"points": named},
        {"control_points": whole, "observed": [[0.0, 11.0 / POINTS as f64]]},
    ]);
    let found = server.post(&path("missing"), &json!({ "shapes": shapes })).expect(200);
    let scores = |k: usize| {
        let scores = found["results"][k]["scores"].as_array().unwrap();
        scores.iter().map(|s| s.as_f64().unwrap()).collect::<Vec<f64>>()
    };
    for (a, b) in [(0, 1), (2, 3)] {
        let off: f64 = scores(a).iter().zip(scores(b)).map(|(x, y)| (x - y).abs()).sum();
        assert!(off < 1e-7, "{a} {b}: {off}");
    }
    for k in 0..4 {
        assert_eq!(found["results"][k]["bands"]["observed"], json!(mask), "{k}");
    }
    let svg = server
        .post(&format!("{}?format=svg", path("missing")), &json!({ "shapes": shapes }))
        .expect_svg()
        .to_owned();
    assert!(svg.contains("75 % seen") && svg.contains("regions of all hidden places together"), "{svg}");
    // Landmarks, with values that they are to have.
    let landmarks = json!({"kind": "landmarks", "dimension": 2, "points": POINTS});
    learnt(&server, "missing-landmarks", 30, &landmarks, &components());
    let wanted = json!({"measure": {"kind": "distance", "between": [0, 8]}, "value": 61.5});
    let shapes = json!([{"control_points": part(40, 12), "conditions": [wanted]}]);
    let found =
        server.post(&path("missing-landmarks"), &json!({ "shapes": shapes, "level": 0.9 })).expect(200);
    let at = |i: usize, c: usize| found["results"][0]["control_points"][i][c].as_f64().unwrap();
    let length = (at(0, 0) - at(8, 0)).hypot(at(0, 1) - at(8, 1));
    assert!((length - 61.5).abs() < 0.01, "{length}");
}

#[test]
fn faults_of_partial_shapes_are_named() {
    let server = shared();
    learnt(&server, "ill-completed", 12, &curve(), &components());
    let refused = |body: Value, pointers: &[&str]| {
        server.post(&path("ill-completed"), &body).expect_problem(422, "invalid-input", pointers);
    };
    let one = |shape: Value| json!({ "shapes": [shape] });
    // All points missing; too few for the pose.
    refused(one(json!({"control_points": part(0, 0)})), &["/shapes/0"]);
    refused(one(json!({})), &["/shapes/0"]);
    refused(one(json!({"control_points": part(0, 1)})), &["/shapes/0"]);
    let at_one_place: Vec<Value> =
        (0..5).map(|i| json!({"at": 0.1 * f64::from(i), "point": [3, 4]})).collect();
    refused(one(json!({ "points": at_one_place })), &["/shapes/0"]);
    // Contradictory conditions.
    let between = json!({"kind": "distance", "between": [0.0, 0.5]});
    let conditions = json!([{"measure": between, "value": 60.0}, {"measure": between, "value": 62.0}]);
    let found = server
        .post(&path("ill-completed"), &one(json!({"control_points": part(0, 12), "conditions": conditions})))
        .expect_problem(422, "invalid-input", &["/shapes/0/conditions/0"]);
    assert!(found["errors"][0]["detail"].as_str().unwrap().contains("contradiction"), "{found}");
    // A condition alone leaves the pose open.
    refused(
        one(json!({"conditions": [{"measure": {"kind": "coordinate", "at": 0.1, "axis": 0}, "value": 1}]})),
        &["/shapes/0"],
    );
    // Shapes that the representation does not have.
    refused(one(json!({"control_points": [[1, 2]]})), &["/shapes/0/control_points"]);
    refused(
        one(json!({"points": [{"at": [0.1, 0.2], "point": [1, 2, 3], "deviation": -1}]})),
        &["/shapes/0/points/0/at", "/shapes/0/points/0/point", "/shapes/0/points/0/deviation"],
    );
    refused(one(json!({"control_points": part(0, 12), "observed": [true]})), &["/shapes/0/observed"]);
    refused(one(json!({"control_points": part(0, 16), "observed": [[0.2, 0.2]]})), &["/shapes/0/observed/0"]);
    let nowhere = json!({"measure": {"kind": "coordinate", "at": 0.1, "axis": 2}, "value": 1.0});
    refused(
        one(json!({"control_points": part(0, 12), "conditions": [nowhere]})),
        &["/shapes/0/conditions/0/measure/axis"],
    );
    refused(json!({"shapes": [], "level": 1.5, "samples": 0}), &["/shapes", "/level", "/samples"]);
    server.post(&path("unknown"), &one(json!({}))).expect_problem(404, "not-found", &[]);
    learnt(
        &server,
        "sparsely-completed",
        12,
        &curve(),
        &json!({"kind": "sparse", "atoms": 4, "lambda": 0.05}),
    );
    server.post(&path("sparsely-completed"), &one(json!({}))).expect_problem(400, "invalid-query", &[]);
}

/// Without the training shapes, bands are those of normal errors, and the answer says so.
#[test]
fn bands_without_training_shapes_say_so() {
    let server = Server::fresh();
    learnt(&server, "orphaned", 12, &curve(), &components());
    assert_eq!(server.delete("/v1/cohorts/orphaned").status, 204);
    let found =
        server.post(&path("orphaned"), &json!({"shapes": [{"control_points": part(20, 12)}]})).expect(200);
    assert_eq!(found["calibration_subjects"], Value::Null);
    assert!(found["warnings"][0].as_str().unwrap().contains("not calibrated"), "{found}");
    assert!((found["pointwise_factor"].as_f64().unwrap() - 5.991_464_5_f64.sqrt()).abs() < 1e-6);
}

/// Points that some shapes miss do not change the components much; complete shapes have their usual ones.
#[test]
fn components_of_incomplete_shapes() {
    let server = shared();
    let landmarks = json!({"kind": "landmarks", "dimension": 2, "points": POINTS});
    let request = |shapes: Vec<Value>| json!({"representation": landmarks, "transformation": "similarity", "components": 2, "shapes": shapes});
    let count = 40;
    let whole: Vec<Value> = (0..count).map(|k| json!({"control_points": oval(k)})).collect();
    let usual = json!({"representation": landmarks, "transformation": "similarity", "components": 2, "alignment": "projection",
        "shapes": (0..count).map(|k| json!({"points": oval(k)})).collect::<Vec<_>>()});
    let usual = server.post("/v1/pca", &usual).expect(200);
    let same = server.post("/v1/pca/incomplete", &request(whole)).expect(200);
    let first = |found: &Value| found["pca"]["eigenvalues"][0].as_f64().unwrap();
    assert!((first(&same) / first(&usual) - 1.0).abs() < 1e-9, "{} {}", first(&same), first(&usual));
    assert_eq!((&same["completion_rounds"], &same["missing"][0]), (&json!(1), &json!(0)));
    let holes = |k: usize| if k.is_multiple_of(3) { part(k, 12) } else { json!(oval(k)) };
    let partly: Vec<Value> = (0..count).map(|k| json!({"control_points": holes(k)})).collect();
    let found = server.post("/v1/pca/incomplete", &request(partly)).expect(200);
    assert_eq!((&found["missing"][0], &found["missing"][1]), (&json!(4), &json!(0)));
    assert!((first(&found) / first(&usual) - 1.0).abs() < 0.2, "{} {}", first(&found), first(&usual));
    let at = |c: usize| found["completed"][3]["control_points"][14][c].as_f64().unwrap();
    let truth = oval(3)[14];
    assert!((at(0) - truth[0]).hypot(at(1) - truth[1]) < 4.0, "{found}");
    // Fewer shapes than components; a point that no shape has; nothing seen.
    let refused = |shapes: Vec<Value>, pointers: &[&str]| {
        server.post("/v1/pca/incomplete", &request(shapes)).expect_problem(422, "invalid-input", pointers);
    };
    refused((0..3).map(|k| json!({"control_points": oval(k)})).collect(), &["/components"]);
    refused((0..9).map(|k| json!({"control_points": part(k, 12)})).collect(), &["/shapes"]);
    refused(
        (0..9).map(|k| json!({"control_points": part(k, if k == 4 { 0 } else { 16 })})).collect(),
        &["/shapes/4/control_points"],
    );
    refused(
        (0..9).map(|k| json!({"control_points": part(k, if k == 4 { 1 } else { 16 })})).collect(),
        &["/shapes/4"],
    );
}

fn assess_path(name: &str) -> String {
    format!("/v1/dictionaries/{name}/assess")
}

fn outlier(result: &Value) -> bool {
    result["novelty"]["is_outlier"].as_bool().unwrap()
}

/// Few of new ovals of which a quarter is hidden are outliers, and nearly all with a dent in what is seen.
#[test]
fn assess_scores_what_is_seen() {
    let server = shared();
    learnt(&server, "assessed", 60, &curve(), &components());
    let count = 80;
    let shapes: Vec<Value> = (100..100 + count).map(|k| json!({"control_points": part(k, 12)})).collect();
    let asked = json!({"shapes": shapes, "quantile": 0.95});
    let found = server.post(&assess_path("assessed"), &asked).expect(200);
    assert_eq!(found["warnings"], Value::Null);
    let results = found["results"].as_array().unwrap();
    let alarms = results.iter().filter(|result| outlier(result)).count();
    // Nominal are 4; more than 12 have a probability below 0.001.
    assert!(alarms <= 12, "{alarms} of {count}");
    for (k, result) in results.iter().enumerate() {
        let part = &result["part"];
        let seen: Vec<usize> = serde_json::from_value(part["seen"].clone()).unwrap();
        assert_eq!((seen, &part["seen_fraction"]), ((0..12).collect(), &json!(0.75)));
        assert_eq!(result["residual"].as_array().unwrap().len(), 12);
        assert_eq!((&result["class"], &part["converged"]), (&Value::Null, &json!(true)));
        let (truth, at) = (oval(100 + k), |c: usize| part["control_points"][14][c].as_f64().unwrap());
        assert!((at(0) - truth[14][0]).hypot(at(1) - truth[14][1]) < 6.0, "{k} {part}");
        // Residuals of the noise of 0.2 mm.
        let largest = result["residual"].as_array().unwrap().iter().map(|x| x.as_f64().unwrap());
        assert!(largest.fold(0.0, f64::max) < 2.0, "{k} {result}");
    }
    let dented = |k: usize| -> Value {
        let points = oval(k).into_iter().enumerate();
        points
            .map(
                |(i, [x, y])| {
                    if i < 12 { json!([x + if i == 5 { 5.0 } else { 0.0 }, y]) } else { Value::Null }
                },
            )
            .collect()
    };
    let shapes: Vec<Value> = (100..140).map(|k| json!({"control_points": dented(k)})).collect();
    let found = server.post(&assess_path("assessed"), &json!({ "shapes": shapes })).expect(200);
    let results = found["results"].as_array().unwrap();
    let alarms = results.iter().filter(|result| outlier(result)).count();
    assert!(alarms >= 36, "{alarms} of 40");
    let at = |i: usize| results[0]["residual"][i].as_f64().unwrap();
    assert!((0..12).all(|i| at(i) <= at(5)), "{}", results[0]);
}

/// Nulls and a mask say the same, arcs nearly; a shape of which all is seen is a whole one.
#[test]
fn parts_are_assessed_as_given() {
    let server = shared();
    learnt(&server, "parts", 40, &curve(), &components());
    let whole = oval(50);
    let mask = |seen: usize| (0..POINTS).map(|i| i < seen).collect::<Vec<bool>>();
    let turned: Vec<Value> = whole.iter().map(|p| json!([7.0 - 3.0 * p[1], 2.0 + 3.0 * p[0]])).collect();
    let shapes = json!([
        {"control_points": part(50, 12), "external_id": "nulls"},
        {"control_points": whole, "observed": mask(12)},
        {"points": whole, "observed": [[0.0, 11.0 / POINTS as f64]]},
        {"control_points": turned, "observed": mask(12)},
        {"control_points": whole, "observed": mask(POINTS)},
        {"control_points": whole},
    ]);
    let found = server.post(&assess_path("parts"), &json!({ "shapes": shapes })).expect(200);
    let result = |k: usize| &found["results"][k];
    assert_eq!(result(0)["external_id"], "nulls");
    let near = |a: &Value, b: &Value, tolerance: f64| {
        let [a, b] = [a, b].map(|value| value.as_f64().unwrap());
        assert!((a - b).abs() <= tolerance * b.abs().max(1.0), "{a} {b}");
    };
    for (k, tolerance) in [(1, 1e-9), (3, 1e-5)] {
        near(&result(k)["novelty"]["t_squared"], &result(0)["novelty"]["t_squared"], tolerance);
        let error = |k: usize| &result(k)["novelty"]["squared_prediction_error"];
        near(error(k), error(0), tolerance);
        for i in 0..5 {
            near(&result(k)["code"]["values"][i], &result(0)["code"]["values"][i], tolerance);
        }
    }
    near(&result(2)["novelty"]["t_squared"], &result(0)["novelty"]["t_squared"], 0.5);
    assert_eq!(result(2)["part"]["seen"], result(0)["part"]["seen"]);
    assert_eq!(result(4)["part"], Value::Null);
    for field in ["code", "novelty", "residual", "relative_error"] {
        assert_eq!(result(4)[field], result(5)[field], "{field}");
    }
    // Lines, of which one has an error of its own, and a picture.
    let lines = [json!({"control_points": part(50, 12)}), json!({"control_points": part(50, 1)})];
    let body = lines.map(|line| line.to_string()).join("\n");
    let request = server.request(reqwest::Method::POST, &format!("{}?on_error=skip", assess_path("parts")));
    let request = request.header("content-type", "application/x-ndjson").body(body);
    let found = server.send(request).expect(200);
    assert_eq!(found["results"][0]["part"]["seen"], result(0)["part"]["seen"]);
    assert_eq!(found["results"][1]["error"]["code"], "invalid-input", "{found}");
    let svg = server.post(&format!("{}?format=svg", assess_path("parts")), &json!({ "shapes": shapes }));
    assert!(svg.expect_svg().contains("75 % seen"));
    // Landmarks are given as points too.
    let landmarks = json!({"kind": "landmarks", "dimension": 2, "points": POINTS});
    learnt(&server, "parts-landmarks", 40, &landmarks, &components());
    let shapes = json!([{"points": part(50, 12)}, {"control_points": part(50, 12)}]);
    let found = server.post(&assess_path("parts-landmarks"), &json!({ "shapes": shapes })).expect(200);
    assert_eq!(found["results"][0]["code"], found["results"][1]["code"]);
}

#[test]
fn parts_that_cannot_be_assessed_are_refused() {
    let server = shared();
    learnt(&server, "ill-assessed", 12, &curve(), &components());
    let refused = |shape: Value, pointers: &[&str]| {
        server.post(&assess_path("ill-assessed"), &json!({ "shapes": [shape] })).expect_problem(
            422,
            "invalid-input",
            pointers,
        );
    };
    // All missing, too little for the pose, no more than the pose, no extent.
    refused(json!({"control_points": part(0, 0)}), &["/shapes/0"]);
    refused(json!({"control_points": part(0, 1)}), &["/shapes/0"]);
    refused(json!({"control_points": part(0, 2)}), &["/shapes/0"]);
    let at_one_place: Value = (0..POINTS).map(|i| if i < 9 { json!([3, 4]) } else { Value::Null }).collect();
    refused(json!({ "control_points": at_one_place }), &["/shapes/0"]);
    refused(json!({"control_points": oval(0), "observed": vec![false; POINTS]}), &["/shapes/0"]);
    // Not numbers; another representation.
    let mut nan = part(0, 12);
    nan[3] = json!([3, "NaN"]);
    refused(json!({ "control_points": nan }), &["/shapes/0/control_points/3/1"]);
    refused(json!({"control_points": [[1, 2], null]}), &["/shapes/0/control_points"]);
    refused(json!({"control_points": part(0, 12), "observed": [true]}), &["/shapes/0/observed"]);
    refused(json!({"control_points": oval(0), "observed": [[0.2, 0.2]]}), &["/shapes/0/observed/0"]);
    refused(json!({"control_points": oval(0), "observed": "all"}), &["/shapes/0/observed"]);
    refused(json!({"points": part(0, 12)}), &["/shapes/0/points"]);
    refused(json!({"observed": [true]}), &["/shapes/0"]);
    // Other operations take whole shapes.
    let body = json!({"shapes": [{"control_points": oval(0), "observed": vec![true; POINTS]}]});
    for operation in ["encode", "score"] {
        let path = format!("/v1/dictionaries/ill-assessed/{operation}");
        server.post(&path, &body).expect_problem(422, "invalid-input", &["/shapes/0/observed"]);
    }
    let body = json!({"shapes": [{"control_points": part(0, 12)}]});
    server.post("/v1/dictionaries/ill-assessed/score", &body).expect_problem(
        422,
        "invalid-input",
        &["/shapes/0/control_points/12"],
    );
    learnt(
        &server,
        "sparsely-assessed",
        12,
        &curve(),
        &json!({"kind": "sparse", "atoms": 4, "lambda": 0.05}),
    );
    server.post(&assess_path("sparsely-assessed"), &body).expect_problem(400, "invalid-query", &[]);
}

/// Without the training shapes, parts are compared with whole held-out shapes, and the answer says so.
#[test]
fn parts_without_training_shapes_say_so() {
    let server = Server::fresh();
    learnt(&server, "orphaned-parts", 40, &curve(), &components());
    assert_eq!(server.delete("/v1/cohorts/orphaned-parts").status, 204);
    let body = json!({"shapes": [{"control_points": part(60, 12)}]});
    let found = server.post(&assess_path("orphaned-parts"), &body).expect(200);
    assert!(found["warnings"][0].as_str().unwrap().contains("was deleted"), "{found}");
    assert!(!outlier(&found["results"][0]), "{found}");
}

/// Shapes that are equal within the region coincide there: what differs is outside of it.
#[test]
fn shapes_are_aligned_on_a_region() {
    let server = shared();
    let arm = |k: usize| -> Vec<[f64; 2]> {
        let (turn, size) = (0.9 * k as f64, 1.0 + 0.2 * k as f64);
        let flat = [[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [0.0, 1.0], [5.0, 0.5 + k as f64]];
        flat.map(|[x, y]| {
            [size * (x * turn.cos() - y * turn.sin()) + 9.0, size * (x * turn.sin() + y * turn.cos())]
        })
        .to_vec()
    };
    let shapes: Vec<Value> = (0..5).map(|k| json!({"points": arm(k)})).collect();
    let landmarks = json!({"kind": "landmarks", "dimension": 2, "points": 5});
    let body = |region: Value| json!({"representation": landmarks, "transformation": "similarity", "shapes": shapes, "region": region});
    let mask = json!([true, true, true, true, false]);
    let found = server.post("/v1/align", &body(mask.clone())).expect(200);
    let at = |shape: &Value, i: usize, c: usize| shape["control_points"][i][c].as_f64().unwrap();
    for shape in found["aligned"].as_array().unwrap() {
        for i in 0..4 {
            for c in 0..2 {
                let (found, mean) = (at(shape, i, c), at(&found["mean"], i, c));
                assert!((found - mean).abs() < 1e-9, "{i} {found} {mean}");
            }
        }
    }
    assert_eq!(found["aligned"][0]["reflected"], json!(false));
    let mut request = body(mask);
    request["components"] = json!(1);
    request["centre"] = json!(true);
    let found = server.post("/v1/pca", &request).expect(200);
    assert!((found["pca"]["explained"][0].as_f64().unwrap() - 1.0).abs() < 1e-9, "{found}");
    // An arc of a curve: the same pose as with the whole, if the shapes are similar.
    let curves: Vec<Value> = (0..4).map(|k| json!({"points": oval(7).iter().map(|p| [p[0] * (1.0 + k as f64), p[1] * (1.0 + k as f64)]).collect::<Vec<_>>()})).collect();
    let mut request = json!({"representation": curve(), "transformation": "similarity", "shapes": curves, "region": [[0.9, 0.3]]});
    let found = server.post("/v1/align", &request).expect(200);
    for shape in found["aligned"].as_array().unwrap() {
        assert!(shape["residual"].as_f64().unwrap() < 1e-9, "{shape}");
    }
    let refused = |request: &Value, pointers: &[&str]| {
        server.post("/v1/align", request).expect_problem(422, "invalid-input", pointers);
    };
    request["region"] = json!([[0.3, 0.3]]);
    refused(&request, &["/region/0"]);
    request["region"] = json!([true, false]);
    refused(&request, &["/region"]);
    request["region"] = json!([[0.0, 0.5]]);
    request["correspondence"] = json!("cyclic");
    refused(&request, &["/correspondence"]);
    refused(&body(json!([true, true])), &["/region"]);
    refused(&body(json!([true, false, false, false, false])), &["/region"]);
    let mut request = body(json!([true, true, true, false, false]));
    request["robust"] = json!(true);
    refused(&request, &["/robust"]);
}
