//! Which correspondence of a cohort lies nearer, and cohorts whose correspondence or direction is changed.

use std::f64::consts::TAU;

use reqwest::Method;
use serde_json::{Value, json};

use crate::http_dictionaries::{finished, submit};
use crate::server::{Reply, Server, flat, shared};

const POINTS: usize = 90;

/// A pear with a dent, which turns, grows and varies with `k`, traced from `start` (part of its length, about), clockwise if
/// `backwards`.
fn pear(k: usize, start: f64, backwards: bool) -> Value {
    let wave = |f: f64| (f * k as f64).sin();
    let (turn, size) = (2.0 * wave(1.7), 2.0 + wave(0.9));
    let at = |i: usize| {
        let along = i as f64 / POINTS as f64;
        let u = TAU * (start + if backwards { -along } else { along });
        let x = 1.6 * u.cos() + (0.35 + 0.05 * wave(2.3)) * (2.0 * u).cos();
        let y = u.sin() + 0.12 * (3.0 * u).sin() + 0.05 * wave(3.1) * (2.0 * u).sin();
        [size * (turn.cos() * x - turn.sin() * y), size * (turn.sin() * x + turn.cos() * y)]
    };
    json!((0..POINTS).map(at).collect::<Vec<_>>())
}

/// Numbers without a pattern, from 0 to 1.
fn anywhere(k: usize) -> f64 {
    (0.618_033_988_749_895 * (k + 1) as f64).fract()
}

fn create(server: &Server, name: &str, settings: &Value, shapes: Vec<Value>) {
    let generator = json!({"name": "trigonometric"});
    let mut body = json!({"name": name, "correspondence": "cyclic",
        "representation": {"kind": "closed_curve", "dimension": 2, "control_points": 25, "generator": generator}});
    body.as_object_mut().unwrap().extend(settings.as_object().unwrap().clone());
    server.post("/v1/cohorts", &body).expect(201);
    server.post(&format!("/v1/cohorts/{name}/shapes"), &json!({ "shapes": shapes })).expect(201);
}

fn pears(count: usize, start: impl Fn(usize) -> f64, backwards: impl Fn(usize) -> bool) -> Vec<Value> {
    let shape = |k: usize| json!({"points": pear(k, start(k), backwards(k)), "external_id": format!("p{k}"), "label": if k.is_multiple_of(2) {"a"} else {"b"}});
    (0..count).map(shape).collect()
}

fn matching(server: &Server, name: &str, body: &Value) -> Value {
    server.post(&format!("/v1/cohorts/{name}/matching"), body).expect(200)
}

fn of<'a>(answer: &'a Value, correspondence: &str) -> &'a Value {
    let entries = answer["matchings"].as_array().unwrap();
    entries.iter().find(|entry| entry["correspondence"] == correspondence).unwrap()
}

#[test]
fn starts_at_one_place_are_told_from_starts_anywhere() {
    let server = shared();
    create(&server, "begun", &json!({}), pears(24, |k| 0.3 + 0.004 * anywhere(k), |_| false));
    create(&server, "begun-anywhere", &json!({}), pears(24, anywhere, |_| false));
    let found = matching(&server, "begun", &json!({}));
    let other = matching(&server, "begun-anywhere", &json!({}));
    assert_eq!((&found["recommended"], &other["recommended"]), (&json!("arc_length"), &json!("cyclic")));
    assert_eq!((&found["present"], &found["sample"]), (&json!("cyclic"), &json!(24)));
    let number = |answer: &Value, correspondence: &str, field: &str| {
        of(answer, correspondence)[field].as_f64().unwrap()
    };
    // The cohorts were moved to canonical starts: that they began at one place is known nevertheless.
    assert!(number(&found, "arc_length", "explained") > 0.95, "{found}");
    assert!(number(&other, "arc_length", "explained") < 0.4, "{other}");
    for answer in [&found, &other] {
        let [arc, cyclic] = ["arc_length", "cyclic"].map(|one| number(answer, one, "residual_variance"));
        assert!(cyclic <= 1.05 * arc && arc <= 1.5 * answer["random_variance"].as_f64().unwrap(), "{answer}");
        assert!(number(answer, "cyclic", "seconds") > number(answer, "arc_length", "seconds"), "{answer}");
        assert_eq!(answer["warnings"], json!([]));
    }
}

#[test]
fn a_trial_depends_on_the_shapes_and_the_seed_alone() {
    let server = shared();
    let shapes = pears(20, anywhere, |_| false);
    create(&server, "tried", &json!({}), shapes);
    let found = matching(&server, "tried", &json!({"sample": 8, "seed": 3}));
    assert_eq!(matching(&server, "tried", &json!({"sample": 8, "seed": 3})), found);
    let other = matching(&server, "tried", &json!({"sample": 8, "seed": 4}));
    assert_ne!(of(&other, "cyclic")["residual_variance"], of(&found, "cyclic")["residual_variance"]);
    for (body, pointer) in [
        (json!({"sample": 2}), "/sample"),
        (json!({"seed": -1}), "/seed"),
        (json!({"sample": 501}), "/sample"),
    ] {
        server.post("/v1/cohorts/tried/matching", &body).expect_problem(422, "invalid-input", &[pointer]);
    }
    server.post("/v1/cohorts", &json!({"name": "no-choice", "representation": {"kind": "landmarks", "dimension": 2, "points": 4}})).expect(201);
    let refused = server.post("/v1/cohorts/no-choice/matching", &json!({})).expect(400);
    assert_eq!(refused["errors"][0]["parameter"], "cohort", "{refused}");
}

#[test]
fn turned_spheres_are_better_searched() {
    let server = shared();
    crate::http_correspond::stored(&server, "tried-spheres", 4);
    let found = matching(&server, "tried-spheres", &json!({"transformation": "rigid", "sample": 3}));
    assert_eq!(found["recommended"], "cyclic", "{found}");
    let [given, searched] =
        ["landmarks", "cyclic"].map(|one| of(&found, one)["residual_variance"].as_f64().unwrap());
    assert!(searched < 0.8 * given, "{found}");
    assert_eq!(found["random_variance"], Value::Null);
}

fn patch(server: &Server, name: &str, body: &Value) -> Reply {
    server.send(server.request(Method::PATCH, &format!("/v1/cohorts/{name}")).json(body))
}

fn control_points(server: &Server, name: &str) -> Vec<Vec<f64>> {
    let shapes = server.get(&format!("/v1/cohorts/{name}/shapes")).expect(200);
    shapes["items"].as_array().unwrap().iter().map(|shape| flat(&shape["control_points"])).collect()
}

fn apart(a: &[Vec<f64>], b: &[Vec<f64>]) -> f64 {
    assert_eq!(a.len(), b.len());
    let pairs = a.iter().flatten().zip(b.iter().flatten());
    pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

#[test]
fn a_cohort_with_another_direction_has_the_shapes_of_an_upload_with_it() {
    let server = shared();
    let shapes = || pears(10, anywhere, |k| k < 4);
    create(&server, "turned", &json!({"direction": "given"}), shapes());
    create(&server, "turned-wanted", &json!({"direction": "either"}), shapes());
    let before = control_points(&server, "turned");
    let mean = "/v1/cohorts/turned/mean?transformation=similarity";
    assert_eq!(server.get(mean).expect(200)["warnings"].as_array().unwrap().len(), 1);
    let changed = patch(&server, "turned", &json!({"direction": "either"})).expect(200);
    assert_eq!(
        (&changed["direction"], &changed["revision"], &changed["shape_count"]),
        (&json!("either"), &json!(2), &json!(10))
    );
    let (found, wanted) = (control_points(&server, "turned"), control_points(&server, "turned-wanted"));
    // Contours are turned from their canonical start, where both directions begin: what differs is rounding.
    assert!(apart(&found, &wanted) < 1e-9, "{:.1e}", apart(&found, &wanted));
    assert!(apart(&found, &before) > 0.1);
    assert_eq!(server.get(mean).expect(200)["warnings"], json!([]));
    // And back again.
    patch(&server, "turned", &json!({"direction": "given"})).expect(200);
    assert!(apart(&control_points(&server, "turned"), &before) < 1e-12);
}

#[test]
fn a_cohort_with_another_correspondence_has_nearly_the_shapes_of_an_upload_with_it() {
    let server = shared();
    let shapes = || pears(6, anywhere, |_| false);
    create(&server, "begun-again", &json!({"direction": "given"}), shapes());
    create(&server, "begun-wanted", &json!({"direction": "given", "correspondence": "arc_length"}), shapes());
    let ids = |name: &str| {
        let shapes = server.get(&format!("/v1/cohorts/{name}/shapes")).expect(200);
        shapes["items"]
            .as_array()
            .unwrap()
            .iter()
            .map(|shape| (shape["id"].clone(), shape["external_id"].clone(), shape["created_at"].clone()))
            .collect::<Vec<_>>()
    };
    let named = ids("begun-again");
    patch(&server, "begun-again", &json!({"correspondence": "arc_length", "description": "from the stalk"}))
        .expect(200);
    let (found, wanted) = (control_points(&server, "begun-again"), control_points(&server, "begun-wanted"));
    // Pears of size 2 through 25 control points at other places: some thousandths of their size apart.
    assert!(apart(&found, &wanted) < 0.05, "{:.1e}", apart(&found, &wanted));
    assert_eq!(ids("begun-again"), named);
    patch(&server, "begun-again", &json!({"correspondence": "cyclic"})).expect(200);
    let refused = patch(&server, "begun-again", &json!({"mirror": "perhaps"}));
    assert_eq!(refused.expect(422)["code"], "invalid-input");
    let open = json!({"name": "open-again", "representation": {"kind": "open_curve", "dimension": 2, "intervals": 6, "generator": {"name": "cubic"}}});
    server.post("/v1/cohorts", &open).expect(201);
    let refused = patch(&server, "open-again", &json!({"correspondence": "cyclic"}));
    refused.expect_problem(422, "invalid-input", &["/correspondence"]);
}

#[test]
fn dictionaries_are_of_the_rule_of_their_revision() {
    let server = shared();
    create(&server, "pinned", &json!({"direction": "given"}), pears(12, anywhere, |k| k < 4));
    let method = json!({"kind": "functional_pca", "components": 2, "centre": true});
    let body =
        json!({"name": "pinned", "cohort": "pinned", "transformation": "similarity", "method": method});
    finished(&server, &submit(&server, &body));
    let path = "/v1/dictionaries/pinned@1";
    let report = || {
        let report = server.post(&format!("{path}/report"), &json!({"resamples": 0, "draws": 10})).json();
        let job = report["kind"] == "report";
        let report =
            if job { finished(&server, report["id"].as_str().unwrap())["result"].clone() } else { report };
        assert!(report["modes"].is_array(), "{report}");
        report["modes"].clone()
    };
    let (before, modes) = (server.get(path).expect(200), report());
    patch(&server, "pinned", &json!({"direction": "either"})).expect(200);
    assert_eq!(server.get(path).expect(200), before);
    assert_eq!(report(), modes);
    let again = json!({"name": "pinned", "cohort": "pinned", "continue_from": "pinned@1"});
    server.post("/v1/dictionaries", &again).expect_problem(422, "invalid-input", &["/continue_from"]);
    finished(&server, &submit(&server, &body));
    let second = server.get("/v1/dictionaries/pinned@2").expect(200);
    assert_eq!((&second["direction"], &before["direction"]), (&json!("either"), &json!("given")));
    assert!(second.get("warnings").is_none() && before["warnings"].is_array(), "{before}");
}
