//! The report card of a dictionary.

use std::f64::consts::TAU;

use serde_json::{Value, json};

use crate::http_dictionaries::{finished, submit};
use crate::server::{Server, flat, shared};

const POINTS: usize = 16;

/// An oval in the plane, in a pose of its own, in millimetres.
fn oval(k: usize, points: usize) -> Vec<[f64; 2]> {
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
    (0..points).map(point).collect()
}

/// A cohort of ovals, two of each subject, with a dictionary of components, both with this name.
fn learnt(server: &Server, name: &str, [count, points]: [usize; 2], method: Value) {
    let representation = json!({"kind": "closed_curve", "dimension": 2, "control_points": points, "generator": {"name": "trigonometric"}});
    let body = json!({"name": name, "representation": representation, "length_unit": "mm"});
    server.post("/v1/cohorts", &body).expect(201);
    let shape = |k: usize| json!({"points": oval(k, points), "external_id": format!("oval-{k}"), "subject": format!("s{}", k / 2)});
    let shapes: Vec<Value> = (0..count).map(shape).collect();
    server.post(&format!("/v1/cohorts/{name}/shapes"), &json!({ "shapes": shapes })).expect(201);
    let body = json!({"name": name, "cohort": name, "transformation": "similarity", "method": method});
    finished(server, &submit(server, &body));
}

fn components() -> Value {
    json!({"kind": "functional_pca", "components": 5, "centre": true})
}

fn path(name: &str) -> String {
    format!("/v1/dictionaries/{name}/report")
}

#[test]
fn a_report_says_how_well_the_modes_describe_shapes() {
    let server = shared();
    learnt(&server, "reported", [40, POINTS], components());
    let length = json!({"name": "length", "measure": {"kind": "distance", "between": [0.0, 0.5]}, "values": [64.0, 1e6]});
    let found = server.post(&path("reported"), &json!({"modes": 4, "measurements": [length]})).expect(200);
    assert_eq!((&found["shape_count"], &found["subject_count"]), (&json!(40), &json!(20)));
    assert_eq!(found["dictionary"]["name"], "reported");
    assert_eq!(found["length_unit"], "mm");
    let modes = found["modes"].as_array().unwrap();
    assert_eq!(modes.len(), 4);
    for mode in modes {
        for measure in
            ["compactness", "generalisation", "generalisation_to_set", "specificity", "specificity_to_set"]
        {
            let [low, value, high] = ["low", "value", "high"].map(|end| mode[measure][end].as_f64().unwrap());
            assert!(low <= value * 1.001 && value <= high * 1.001, "{measure}: {mode}");
        }
    }
    let general = |mode: &Value| mode["generalisation"]["value"].as_f64().unwrap();
    assert!(general(&modes[3]) < 0.4 * general(&found["mean_only"]), "{found}");
    let measured = &found["measurements"][0];
    assert_eq!(measured["unit"], "mm");
    assert!((measured["mean"].as_f64().unwrap() - 60.0).abs() < 5.0, "{measured}");
    let wanted = &measured["wanted"][0]["control_points"];
    let [a, b] = [0, POINTS / 2].map(|i| [0, 1].map(|c| wanted[i][c].as_f64().unwrap()));
    assert!(((a[0] - b[0]).hypot(a[1] - b[1]) - 64.0).abs() < 1e-6);
    // The same request has the same answer; another seed other random shapes.
    let body = json!({"modes": 2, "draws": 50, "resamples": 20});
    let first = server.post(&path("reported"), &body).expect(200);
    assert_eq!(first, server.post(&path("reported"), &body).expect(200));
    let other = json!({"modes": 2, "draws": 50, "resamples": 20, "seed": 1});
    assert_ne!(first["modes"], server.post(&path("reported"), &other).expect(200)["modes"]);
    // The picture tells the same.
    let svg = server.post(&format!("{}?format=svg", path("reported")), &json!({})).expect_svg().to_owned();
    assert!(svg.contains("compactness") && svg.contains("40 shapes of 20 subjects"), "{svg}");
}

#[test]
fn faults_of_a_report_are_named() {
    let server = shared();
    learnt(&server, "ill-reported", [12, POINTS], components());
    let refused = |body: Value, status: u16, code: &str, pointers: &[&str]| {
        server.post(&path("ill-reported"), &body).expect_problem(status, code, pointers);
    };
    let outside = json!({"modes": 0, "draws": 20_000, "resamples": 10_001});
    refused(outside, 422, "invalid-input", &["/modes", "/draws", "/resamples"]);
    let pair = json!({"kind": "distance", "between": [[0.1, 0.2], 0.5]});
    let twice = json!([{"name": "a", "measure": pair}, {"name": "a", "measure": {"kind": "angle", "at": [0, 0.2, 0.5]}}]);
    refused(json!({ "measurements": twice.clone() }), 422, "invalid-input", &["/measurements/1/name"]);
    refused(
        json!({"measurements": [twice[0]]}),
        422,
        "invalid-input",
        &["/measurements/0/measure/between/0"],
    );
    let nowhere = json!([{"name": "a", "measure": {"kind": "distance", "between": [0.3, 0.3]}}]);
    refused(json!({ "measurements": nowhere }), 422, "invalid-input", &["/measurements"]);
    server.post(&path("unknown"), &json!({})).expect_problem(404, "not-found", &[]);
    let sparse = json!({"kind": "sparse", "atoms": 4, "lambda": 0.05});
    learnt(&server, "sparsely-reported", [12, POINTS], sparse);
    server.post(&path("sparsely-reported"), &json!({})).expect_problem(400, "invalid-query", &[]);
}

/// The report is of the shapes as they were, whatever arrives, goes or is corrected later; without some of them there is none.
#[test]
fn a_report_is_of_the_shapes_that_were_learnt_from() {
    let server = Server::fresh();
    learnt(&server, "outdated", [12, POINTS], components());
    let ask = || server.post(&path("outdated"), &json!({"modes": 2}));
    let before = ask().expect(200);
    let more = json!({"shapes": [{"points": oval(99, POINTS)}]});
    server.post("/v1/cohorts/outdated/shapes", &more).expect(201);
    let listed = server.get("/v1/cohorts/outdated/shapes").expect(200);
    let shape =
        |k: usize| format!("/v1/cohorts/outdated/shapes/{}", listed["items"][k]["id"].as_str().unwrap());
    assert_eq!(server.delete(&shape(0)).status, 204);
    let patch = server.request(reqwest::Method::PATCH, &shape(1)).body(json!({"weight": 5.0}).to_string());
    server.send(patch.header("content-type", "application/merge-patch+json")).expect(200);
    assert_eq!(ask().expect(200), before);
    server.delete("/v1/subjects/s2").expect(200);
    let problem = ask().expect_problem(400, "invalid-query", &[]);
    assert!(problem.to_string().contains("10 of 12 are left"), "{problem}");
}

/// A long report is a job with the same answer.
#[test]
fn a_long_report_is_a_job() {
    let server = shared();
    learnt(&server, "long-reported", [90, 48], components());
    let body = json!({"modes": 5, "resamples": 5000, "draws": 10_000});
    let job = server.post(&path("long-reported"), &body).expect(202);
    assert_eq!(job["kind"], "report");
    let found = finished(&server, job["id"].as_str().unwrap());
    assert_eq!(found["result"]["resamples"], 5000);
    assert_eq!(found["result"]["modes"].as_array().unwrap().len(), 5);
}

/// The mean is a combination of the basis of its space, whose elements are orthogonal and of one size.
#[test]
fn a_mean_space_has_a_basis() {
    let representation = json!({"kind": "landmarks", "dimension": 2, "points": POINTS});
    let shapes: Vec<Value> = (0..8).map(|k| json!({"points": oval(k, POINTS)})).collect();
    let body = |class: &str, alignment: &str, basis: bool| json!({"representation": representation, "shapes": shapes, "transformation": class, "alignment": alignment, "basis": basis});
    let inner = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    for (class, size) in [("similarity", 2), ("affine", 4)] {
        let found = shared().post("/v1/mean", &body(class, "projection", true)).expect(200);
        let basis = found["basis"].as_array().unwrap();
        assert_eq!(basis.len(), size, "{class}");
        let columns: Vec<Vec<f64>> = basis.iter().map(|element| flat(&element["control_points"])).collect();
        let square = inner(&columns[0], &columns[0]);
        for (i, a) in columns.iter().enumerate() {
            for (j, b) in columns.iter().enumerate() {
                let wanted = if i == j { square } else { 0.0 };
                assert!((inner(a, b) - wanted).abs() < 1e-9 * square, "{class} {i} {j}: {}", inner(a, b));
            }
        }
        let mut rest = flat(&found["mean"]["control_points"]);
        for element in &columns {
            let part = inner(&rest, element) / square;
            rest.iter_mut().zip(element).for_each(|(rest, e)| *rest -= part * e);
        }
        assert!(inner(&rest, &rest) < 1e-18 * square, "{class}");
    }
    // Procrustes fits have no mean space; without `basis` the service answers none.
    let fitted = shared().post("/v1/align", &body("similarity", "procrustes", true)).expect(200);
    let plain = shared().post("/v1/mean", &body("similarity", "projection", false)).expect(200);
    assert!(fitted["basis"].is_null() && plain["basis"].is_null());
}
