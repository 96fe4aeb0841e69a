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
    let usual = json!({"representation": landmarks, "transformation": "similarity", "components": 2, "centre": true,
        "shapes": (0..count).map(|k| json!({"points": oval(k)})).collect::<Vec<_>>()});
    let usual = server.post("/v1/pca", &usual).expect(200);
    let same = server.post("/v1/pca/incomplete", &request(whole)).expect(200);
    let first = |found: &Value| found["pca"]["eigenvalues"][0].as_f64().unwrap();
    assert!((first(&same) / first(&usual) - 1.0).abs() < 1e-9, "{same}");
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
