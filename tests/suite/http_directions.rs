//! Directions of contours: what they are by default, and the warning where some are drawn the other way round and it counts.

use std::f64::consts::TAU;

use serde_json::{Value, json};

use crate::http_dictionaries::{finished, submit};
use crate::server::{Server, assert_close, shared};

const POINTS: usize = 40;

fn closed(control_points: usize) -> Value {
    json!({"kind": "closed_curve", "dimension": 2, "control_points": control_points, "generator": {"name": "trigonometric"}})
}

/// `count` points of a bean without symmetry, whose dent grows with `t`, clockwise if `backwards`.
fn points_of_bean(count: usize, t: f64, backwards: bool) -> Value {
    let at = |i: usize| {
        let i = if backwards { (count - i) % count } else { i };
        let u = TAU * i as f64 / count as f64;
        [2.0 * u.cos() + (0.3 + t) * (2.0 * u).cos(), u.sin() + 0.15 * (3.0 * u).sin()]
    };
    json!((0..count).map(at).collect::<Vec<_>>())
}

fn bean(t: f64, backwards: bool) -> Value {
    points_of_bean(POINTS, t, backwards)
}

/// Twelve beans; the first `backwards` of them are drawn clockwise.
fn beans(backwards: usize) -> Vec<Value> {
    let shape = |k: usize| {
        let label = if k.is_multiple_of(2) { "even" } else { "odd" };
        json!({"points": bean(0.03 * k as f64, k < backwards), "external_id": format!("b{k}"), "label": label, "labels": {"age": k * k}})
    };
    (0..12).map(shape).collect()
}

fn create(server: &Server, name: &str, settings: &Value) -> Value {
    let mut body = json!({"name": name, "representation": closed(15), "correspondence": "cyclic"});
    body.as_object_mut().unwrap().extend(settings.as_object().unwrap().clone());
    server.post("/v1/cohorts", &body).expect(201)
}

fn add(server: &Server, name: &str, shapes: &[Value]) -> Value {
    server.post(&format!("/v1/cohorts/{name}/shapes"), &json!({ "shapes": shapes })).expect(201)
}

/// The warnings about directions in an answer.
fn said(answer: &Value) -> Vec<String> {
    let warnings = answer["warnings"].as_array().cloned().unwrap_or_default();
    let texts = warnings.iter().filter_map(Value::as_str).map(str::to_owned);
    texts.filter(|text| text.contains("clockwise")).collect()
}

fn assert_said(answer: &Value, what: &str) {
    let found = said(answer);
    assert!(
        found.len() == 1 && found[0].starts_with("4 of 12 contours run clockwise, unlike the others"),
        "{what}: {answer}"
    );
}

#[test]
fn only_closed_planar_curves_under_cyclic_are_compared_in_either_direction_by_default() {
    let server = shared();
    let direction = |name: &str, settings: Value| create(&server, name, &settings)["direction"].clone();
    assert_eq!(direction("usual-cyclic", json!({})), "either");
    assert_eq!(direction("usual-given", json!({"direction": "given"})), "given");
    assert_eq!(direction("usual-arc", json!({"correspondence": "arc_length"})), "given");
    let space = json!({"kind": "closed_curve", "dimension": 3, "control_points": 15, "generator": {"name": "trigonometric"}});
    assert_eq!(direction("usual-space", json!({ "representation": space })), "given");
}

#[test]
fn contours_drawn_both_ways_have_the_mean_of_those_drawn_one_way() {
    let server = shared();
    let mean = |backwards: usize, direction: Value| {
        let body = json!({"representation": closed(15), "correspondence": "cyclic", "direction": direction,
            "transformation": "similarity", "shapes": beans(backwards)});
        server.post("/v1/mean", &body).expect(200)
    };
    let (wanted, found) = (mean(0, Value::Null), mean(4, Value::Null));
    // Points of a contour drawn backwards are the same; what differs is the rounding of sums in another order.
    let points = |answer: &Value| answer["mean"]["control_points"].clone();
    assert_close(&points(&found), &points(&wanted), 1e-9, "mean");
    assert!(said(&found).is_empty() && said(&wanted).is_empty());
    let given = mean(4, json!("given"));
    assert_said(&given, "mean");
    assert!(given["objective"].as_f64() < found["objective"].as_f64(), "{given} {found}");
}

#[test]
fn an_upload_says_which_contours_run_the_other_way() {
    let server = shared();
    create(&server, "drawn", &json!({"direction": "given"}));
    assert_said(&add(&server, "drawn", &beans(4)), "upload");
    let one = |name: &str, backwards| {
        json!([{"points": bean(0.2, backwards), "external_id": name}]).as_array().unwrap().clone()
    };
    // The first shape of the cohort runs clockwise.
    let beside = add(&server, "drawn", &one("c1", false));
    assert_eq!(said(&beside).len(), 1, "{beside}");
    assert!(
        said(&beside)[0].starts_with("1 new contours run counter-clockwise, unlike the first one"),
        "{beside}"
    );
    assert!(said(&add(&server, "drawn", &one("c2", true))).is_empty());
    let clockwise = server.get("/v1/cohorts/drawn/shapes?measures.clockwise=true").expect(200);
    assert_eq!(clockwise["items"].as_array().unwrap().len(), 5);
    create(&server, "drawn-either", &json!({}));
    assert!(said(&add(&server, "drawn-either", &beans(4))).is_empty());
    let none = server.get("/v1/cohorts/drawn-either/shapes?measures.clockwise=true").expect(200);
    assert_eq!(none["items"], json!([]));
}

#[test]
fn everything_that_is_computed_of_contours_drawn_both_ways_says_so() {
    let server = shared();
    create(&server, "both-ways", &json!({"direction": "given"}));
    add(&server, "both-ways", &beans(4));
    let cohort = "/v1/cohorts/both-ways";
    assert_said(&server.get(&format!("{cohort}/mean?transformation=similarity")).expect(200), "mean");
    let one_way = format!("{cohort}/mean?transformation=similarity&measures.clockwise=false");
    assert!(said(&server.get(&one_way).expect(200)).is_empty());
    let tests = json!({"cohort": "both-ways", "transformation": "similarity", "permutations": 9});
    let with = |more: Value| {
        let mut body = tests.clone();
        body.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
        body
    };
    let compared = server.post("/v1/comparisons", &with(json!({"by": "label"}))).expect(200);
    assert_said(&compared, "comparison");
    let regressed = server.post("/v1/regressions", &with(json!({"attribute": "labels.age"}))).expect(200);
    assert_said(&regressed, "regression");
    let distances = json!({"cohort": "both-ways", "transformation": "similarity"});
    assert_said(&server.post("/v1/distances", &distances).expect(200), "distances");
    let some = json!({"cohort": "both-ways", "transformation": "similarity", "ids": ["b7", "b8"]});
    assert!(said(&server.post("/v1/distances", &some).expect(200)).is_empty());
    let near = json!({"ids": ["b1"], "neighbours": 2});
    assert_said(&server.post(&format!("{cohort}/search"), &near).expect(200), "search");
}

#[test]
fn a_dictionary_of_contours_drawn_both_ways_says_so_in_all_its_answers() {
    let server = shared();
    create(&server, "both-learnt", &json!({"direction": "given"}));
    add(&server, "both-learnt", &beans(4));
    let method = json!({"kind": "functional_pca", "components": 2, "centre": true});
    let body = json!({"name": "both-learnt", "cohort": "both-learnt", "transformation": "similarity", "method": method});
    finished(&server, &submit(&server, &body));
    let path = "/v1/dictionaries/both-learnt";
    assert_said(&server.get(path).expect(200), "dictionary");
    assert_said(&server.get(&format!("{path}/modes")).expect(200), "modes");
    assert_said(&server.get(&format!("{path}/atoms")).expect(200)["dictionary"], "atoms");
    let shapes = json!({"shapes": [{"points": bean(0.1, false)}]});
    for operation in ["encode", "score", "assess", "reconstruct"] {
        assert_said(&server.post(&format!("{path}/{operation}"), &shapes).expect(200), operation);
    }
    let report = server.post(&format!("{path}/report"), &json!({"resamples": 0, "draws": 10})).expect(200);
    assert_said(&report, "report");
    let sampled = server.post(&format!("{path}/sample"), &json!({"count": 1})).expect(200);
    assert_said(&sampled["dictionary"], "sample");
    // The file keeps what is said, as a version of its own, and so does an import.
    let file = server.get(&format!("{path}/export")).expect(200);
    assert_eq!(file["format_version"], 4);
    let imported = server.post("/v1/dictionaries/import?name=both-imported", &file).expect(201);
    assert_said(&imported, "import");
    let mut long = file;
    long["provenance"]["warnings"] = json!(vec!["a"; 11]);
    server.post("/v1/dictionaries/import", &long).expect_problem(
        422,
        "invalid-input",
        &["/provenance/warnings"],
    );
}

#[test]
fn shapes_that_run_against_a_dictionary_are_told() {
    let server = shared();
    for (name, direction) in [("one-way", "given"), ("any-way", "either")] {
        create(&server, name, &json!({"direction": direction}));
        let shapes: Vec<Value> =
            (0..6).map(|k| json!({"points": bean(0.02 * f64::from(k), false)})).collect();
        add(&server, name, &shapes);
        let method = json!({"kind": "functional_pca", "components": 2});
        let body = json!({"name": name, "cohort": name, "transformation": "similarity", "method": method});
        finished(&server, &submit(&server, &body));
        for (clockwise, told) in [(true, name == "one-way"), (false, false)] {
            let shapes =
                json!({"shapes": [{"points": bean(0.05, clockwise)}, {"points": bean(0.06, false)}]});
            for operation in ["encode", "score", "assess", "reconstruct"] {
                let found =
                    said(&server.post(&format!("/v1/dictionaries/{name}/{operation}"), &shapes).expect(200));
                assert_eq!(found.len(), usize::from(told), "{name} {operation}: {found:?}");
                let beginning = "1 of 2 contours run clockwise, unlike the mean of the dictionary";
                assert!(found.iter().all(|text| text.starts_with(beginning)), "{found:?}");
            }
        }
    }
}

#[test]
fn landmarks_of_mirror_images_may_run_the_other_way() {
    let server = shared();
    let mean = |mirror: &str, direction: &str| {
        let shape = |k: usize| json!({"points": points_of_bean(15, 0.01 * k as f64, k < 2)});
        let body = json!({"representation": closed(15), "direction": direction, "mirror": mirror, "transformation": "similarity",
            "shapes": (0..5).map(shape).collect::<Vec<_>>()});
        said(&server.post("/v1/mean", &body).expect(200))
    };
    for direction in ["given", "either"] {
        let found = mean("forbid", direction);
        assert!(found.len() == 1 && found[0].starts_with("2 of 5 contours run clockwise"), "{found:?}");
        assert!(found[0].contains("point by point"), "{found:?}");
        assert_eq!(mean("allow", direction), Vec::<String>::new());
    }
}
