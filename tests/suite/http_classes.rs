//! Classifiers of dictionaries over HTTP against the real program: validated without leaks, used, exported, refused.

use std::f64::consts::TAU;

use rand::rngs::ChaCha12Rng;
use rand::{RngExt, SeedableRng};
use reqwest::Method;
use serde_json::{Value, json};
use shapelex_server::analysis::classification::folds::stratified;

use crate::http_bad_input::{Differences, Wanted};
use crate::http_dictionaries::{finished, submit};
use crate::server::{Reply, Server, Setting, assert_close};

const POINTS: usize = 10;
/// Long enough for a slow machine, shorter than the patience of the client.
const PATIENCE: &str = "wait=50";

/// Numbers between −1 and 1 that `seed` draws.
fn noise(seed: u64) -> impl FnMut() -> f64 {
    let mut random = ChaCha12Rng::seed_from_u64(seed);
    move || random.random_range(-1.0..1.0)
}

/// Landmarks on a shape with `lobes` lobes, disturbed by `spread`, in a pose of its own.
fn lobed(lobes: f64, spread: f64, seed: u64) -> Vec<[f64; 2]> {
    let mut draw = noise(seed);
    let (size, turn, x, y) = (2.0 + draw(), 3.0 * draw(), 50.0 * draw(), 50.0 * draw());
    let point = |i: usize| {
        let t = TAU * i as f64 / POINTS as f64;
        let r = size * (2.0 + 0.4 * (lobes * t).cos() + spread * draw());
        [x + r * (t + turn).cos(), y + r * (t + turn).sin()]
    };
    (0..POINTS).map(point).collect()
}

/// Shapes of two classes, `count` of each, alternating.
fn two_classes(count: usize, spread: f64) -> Vec<Value> {
    let shape = |k: usize| {
        let (label, lobes) = if k.is_multiple_of(2) { ("three", 3.0) } else { ("two", 2.0) };
        json!({"external_id": format!("s{k}"), "label": label, "labels": {"side": k % 2, "scan": k},
               "points": lobed(lobes, spread, k as u64)})
    };
    (0..2 * count).map(shape).collect()
}

/// Noise of no class, labelled by nothing.
fn unrelated(count: usize) -> Vec<Value> {
    let mut draw = noise(77);
    let shape = |k: usize| {
        let label = if draw() > 0.0 { "a" } else { "b" };
        json!({"external_id": format!("s{k}"), "label": label, "points": lobed(0.0, 0.4, 1000 + k as u64)})
    };
    (0..count).map(shape).collect()
}

fn new_cohort(server: &Server, name: &str, shapes: &[Value]) {
    let representation = json!({"kind": "landmarks", "dimension": 2, "points": POINTS});
    let cohort = json!({"name": name, "representation": representation, "correspondence": "landmarks"});
    server.post("/v1/cohorts", &cohort).expect(201);
    server.post(&format!("/v1/cohorts/{name}/shapes"), &json!({ "shapes": shapes })).expect(201);
}

fn request(name: &str, cohort: &str, classifier: &Value) -> Value {
    json!({"name": name, "cohort": cohort, "transformation": "similarity",
           "method": {"kind": "functional_pca", "components": 6, "centre": true}, "classifier": classifier})
}

fn learnt(server: &Server, body: &Value) -> Reply {
    server.send(server.request(Method::POST, "/v1/dictionaries").header("prefer", PATIENCE).json(body))
}

fn ask(server: &Server, dictionary: &str, what: &str, body: &Value) -> Value {
    server.post(&format!("/v1/dictionaries/{dictionary}/{what}"), body).expect(200)
}

/// What a list of classes says.
fn labels(answer: &Value) -> Vec<&str> {
    answer["results"].as_array().unwrap().iter().map(|class| class["label"].as_str().unwrap()).collect()
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is not a number"))
}

// ---------------------------------------------------------------- what is learnt

#[test]
fn every_kind_tells_classes_apart_that_differ_and_reports_it() {
    let server = Server::fresh();
    new_cohort(&server, "lobes", &two_classes(12, 0.05));
    let sparse = json!({"kind": "sparse", "atoms": 4, "lambda": 0.02, "max_epochs": 20});
    let kinds = [
        (json!({"kind": "mean_space"}), None),
        (json!({"kind": "discriminant"}), None),
        (json!({"kind": "discriminant", "pooling": 0.5, "shrinkage": 0.1, "components": 3}), None),
        (json!({"kind": "discriminant", "features": ["shape", "size"]}), None),
        (json!({"kind": "nearest_neighbours", "neighbours": 3}), None),
        (json!({"kind": "nearest_neighbours", "features": ["size", "shape"]}), None),
        (json!({"kind": "nearest_atom"}), Some(&sparse)),
        (json!({"kind": "sparse_residual"}), Some(&sparse)),
        (json!({"kind": "best"}), None),
    ];
    let new: Vec<Value> = [3.0, 2.0].map(|lobes| json!({"points": lobed(lobes, 0.05, 999)})).into();
    for (i, (classifier, method)) in kinds.iter().enumerate() {
        let name = format!("kind{i}");
        let mut body = request(&name, "lobes", classifier);
        if let Some(method) = method {
            body["method"] = (*method).clone();
        }
        let dictionary = learnt(&server, &body).expect(201);
        let (found, validation) = (&dictionary["classifier"], &dictionary["classifier"]["validation"]);
        let sizes = json!([{"label": "three", "shape_count": 12}, {"label": "two", "shape_count": 12}]);
        assert_eq!(found["classes"], sizes, "{classifier}");
        assert_eq!((&validation["folds"], &validation["repeats"]), (&json!(5), &json!(3)));
        let accuracy = &validation["accuracy"];
        // Lobes of a fifth of the radius, four times what disturbs them: the atoms alone are a coarse description.
        assert!(number(&accuracy["value"]) >= 0.85, "{classifier}: {accuracy}");
        assert!(number(&accuracy["low"]) < number(&accuracy["value"]), "{accuracy}");
        let confusion = validation["confusion"].as_array().unwrap();
        let counted: f64 = confusion.iter().flat_map(|row| row.as_array().unwrap()).map(number).sum();
        let right: f64 = (0..2).map(|c| number(&confusion[c][c])).sum();
        assert_eq!(counted, 3.0 * 24.0);
        assert!((right / counted - number(&accuracy["value"])).abs() < 1e-12);
        let binned: f64 =
            validation["reliability"].as_array().unwrap().iter().map(|bin| number(&bin["count"])).sum();
        assert_eq!(binned, counted);
        assert!(number(&validation["brier"]) < 0.5, "{classifier}: {validation}");
        let answer = ask(&server, &name, "classify", &json!({"shapes": new}));
        assert_eq!(labels(&answer), ["three", "two"], "{classifier}");
        for class in answer["results"].as_array().unwrap() {
            let ranking = class["ranking"].as_array().unwrap();
            assert_eq!(ranking.len(), 2);
            let sum: f64 = ranking.iter().map(|ranked| number(&ranked["confidence"])).sum();
            assert!((sum - 1.0).abs() < 1e-12);
            let first = &ranking[0];
            assert_eq!(class["label"], first["label"]);
            let margin = number(&first["confidence"]) - number(&ranking[1]["confidence"]);
            assert!((number(&class["margin"]) - margin).abs() < 1e-12 && margin > 0.0, "{class}");
        }
    }
    // `best` names what it tried, and trains another kind than it was asked for.
    let best = server.get("/v1/dictionaries/kind8").expect(200);
    let candidates = best["classifier"]["validation"]["candidates"].as_array().unwrap();
    let parts: Vec<&Value> = candidates.iter().filter(|candidate| !candidate["weight"].is_null()).collect();
    let kind = if parts.len() == 1 { &parts[0]["kind"] } else { &json!("ensemble") };
    assert_eq!(kind, &best["classifier"]["kind"]);
    assert!(number(&candidates[0]["accuracy"]) >= number(&candidates[1]["accuracy"]));
    let listed = server.get("/v1/dictionaries?name=kind8").expect(200);
    assert_eq!(listed["items"][0]["accuracy"], best["classifier"]["validation"]["accuracy"]["value"]);
}

#[test]
fn a_shape_of_no_class_is_not_accepted() {
    let server = Server::fresh();
    new_cohort(&server, "lobes", &two_classes(15, 0.04));
    for kind in ["mean_space", "discriminant", "nearest_neighbours"] {
        learnt(&server, &request(kind, "lobes", &json!({"kind": kind}))).expect(201);
        let own: Vec<Value> = (0..10).map(|k| json!({"points": lobed(3.0, 0.04, 500 + k)})).collect();
        let accepted = ask(&server, kind, "classify", &json!({"shapes": own}));
        let count = accepted["results"].as_array().unwrap().iter().filter(|class| class["accepted"] == true);
        assert!(count.count() >= 8, "{kind}: {accepted}");
        let strange = json!({"shapes": [{"points": lobed(5.0, 0.9, 3)}]});
        let strange = ask(&server, kind, "classify", &strange);
        assert_eq!(strange["results"][0]["accepted"], false, "{kind}: {strange}");
        assert_eq!(strange["results"][0]["novelty"]["is_outlier"], true);
    }
}

/// One field for a pipeline: a shape unlike all training shapes has no class, whatever the distance to the class says.
#[test]
fn the_verdict_joins_class_and_novelty() {
    let server = Server::fresh();
    new_cohort(&server, "lobes", &two_classes(15, 0.04));
    let mut seen = std::collections::BTreeSet::new();
    for kind in ["mean_space", "discriminant", "nearest_neighbours"] {
        learnt(&server, &request(kind, "lobes", &json!({"kind": kind}))).expect(201);
        let lobed_ones =
            (0..40).map(|k| lobed(2.0 + 0.1 * f64::from(k), 0.01 * f64::from(k), 900 + k as u64));
        let shapes: Vec<Value> = lobed_ones.map(|points| json!({"points": points})).collect();
        for what in ["classify", "assess"] {
            let answer = ask(&server, kind, what, &json!({"shapes": shapes, "quantile": 0.9}));
            for result in answer["results"].as_array().unwrap() {
                let class = if what == "assess" { &result["class"] } else { result };
                let wanted = match (&result["novelty"]["is_outlier"], &class["accepted"]) {
                    (Value::Bool(true), _) => "outlier",
                    (_, Value::Bool(true)) => "accepted",
                    _ => "no_class",
                };
                assert_eq!(result["verdict"], wanted, "{kind} {what}: {result}");
                seen.insert((wanted, class["accepted"].as_bool()));
            }
        }
    }
    assert!(seen.contains(&("outlier", Some(false))) && seen.contains(&("accepted", Some(true))), "{seen:?}");
}

#[test]
fn classes_do_not_depend_on_pose() {
    let server = Server::fresh();
    new_cohort(&server, "lobes", &two_classes(10, 0.2));
    let shapes: Vec<Vec<[f64; 2]>> = (0..6).map(|k| lobed(2.0 + (k % 2) as f64, 0.3, 700 + k)).collect();
    let (s, c) = 2.1_f64.sin_cos();
    let turn = |p: &[f64; 2]| [7.0 * (c * p[0] - s * p[1]) - 30.0, 7.0 * (s * p[0] + c * p[1]) + 4.0];
    let moved: Vec<Vec<[f64; 2]>> = shapes.iter().map(|points| points.iter().map(turn).collect()).collect();
    let posted = |shapes: &[Vec<[f64; 2]>]| json!({"shapes": shapes.iter().map(|points| json!({"points": points})).collect::<Vec<_>>()});
    for kind in ["mean_space", "discriminant", "nearest_neighbours"] {
        learnt(&server, &request(kind, "lobes", &json!({"kind": kind}))).expect(201);
        let here = ask(&server, kind, "classify", &posted(&shapes));
        let there = ask(&server, kind, "classify", &posted(&moved));
        for (a, b) in here["results"].as_array().unwrap().iter().zip(there["results"].as_array().unwrap()) {
            assert_eq!(a["label"], b["label"]);
            for (a, b) in a["ranking"].as_array().unwrap().iter().zip(b["ranking"].as_array().unwrap()) {
                assert_close(&json!([a["distance"]]), &json!([b["distance"]]), 1e-9, kind);
            }
        }
    }
}

#[test]
fn nothing_of_a_part_leaks_into_what_classifies_it() {
    let server = Server::fresh();
    let shapes = two_classes(8, 0.35);
    new_cohort(&server, "all", &shapes);
    let classifier = json!({"kind": "discriminant", "components": 4, "folds": 4, "repeats": 1, "seed": 11});
    let whole = learnt(&server, &request("whole", "all", &classifier)).expect(201);
    // The same by hand: dictionaries of cohorts without the part, asked about the part.
    let classes: Vec<usize> = (0..shapes.len()).map(|k| k % 2).collect();
    let groups: Vec<usize> = (0..shapes.len()).collect();
    let fold_of = stratified(&classes, &groups, 4, 11);
    let mut confusion = [[0; 2]; 2];
    for fold in 0..4 {
        let part = |inside: bool| {
            (0..shapes.len())
                .filter(|&k| (fold_of[k] != fold) == inside)
                .map(|k| &shapes[k])
                .collect::<Vec<_>>()
        };
        let training: Vec<Value> = part(true).into_iter().cloned().collect();
        let name = format!("without{fold}");
        new_cohort(&server, &name, &training);
        let plain = json!({"kind": "discriminant", "components": 4, "folds": 2, "repeats": 1});
        learnt(&server, &request(&name, &name, &plain)).expect(201);
        let held: Vec<Value> = part(false).iter().map(|shape| json!({"points": shape["points"]})).collect();
        let answer = ask(&server, &name, "classify", &json!({"shapes": held}));
        for (shape, found) in part(false).iter().zip(labels(&answer)) {
            confusion[usize::from(shape["label"] == "two")][usize::from(found == "two")] += 1;
        }
    }
    assert_eq!(whole["classifier"]["validation"]["confusion"], json!(confusion));
}

#[test]
fn leaking_would_look_better() {
    let server = Server::fresh();
    let shapes = unrelated(60);
    new_cohort(&server, "noise", &shapes);
    let mut body = request("noise", "noise", &json!({"kind": "best", "repeats": 2, "seed": 5}));
    body["method"]["components"] = json!(16);
    let dictionary = learnt(&server, &body).expect(201);
    let validation = &dictionary["classifier"]["validation"];
    let accuracy = number(&validation["accuracy"]["value"]);
    // There is nothing to be found: half, within three standard deviations of 60 coins.
    assert!(accuracy <= 0.5 + 3.0 * 0.5 / 60_f64.sqrt(), "{accuracy}");
    // What looks at the answers: the figure that chose, and the classes of shapes that were trained on.
    let chosen = number(&validation["candidates"][0]["accuracy"]);
    assert!(chosen >= accuracy + 0.05, "{chosen} against {accuracy}");
    let mut body =
        request("seen", "noise", &json!({"kind": "discriminant", "pooling": 0.5, "shrinkage": 0.01}));
    body["method"]["components"] = json!(16);
    let dictionary = learnt(&server, &body).expect(201);
    let accuracy = number(&dictionary["classifier"]["validation"]["accuracy"]["value"]);
    let posted: Vec<Value> = shapes.iter().map(|shape| json!({"points": shape["points"]})).collect();
    let answer = ask(&server, "seen", "classify", &json!({"shapes": posted}));
    let right = shapes.iter().zip(labels(&answer)).filter(|(shape, found)| shape["label"] == *found).count();
    let seen = right as f64 / shapes.len() as f64;
    assert!(seen >= accuracy + 0.15, "{seen} against {accuracy}");
}

#[test]
fn shapes_of_a_subject_stay_on_one_side() {
    let server = Server::fresh();
    // Three nearly equal scans of each of 20 subjects, whose class says nothing about their shape.
    let mut draw = noise(3);
    let of_subject: Vec<&str> = (0..20).map(|_| if draw() > 0.0 { "a" } else { "b" }).collect();
    let scan = |k: usize, with_subject: bool| {
        let mut near = noise(k as u64);
        let mut points = lobed(0.0, 0.4, 400 + (k / 3) as u64);
        points.iter_mut().flatten().for_each(|value| *value += 1e-3 * near());
        let mut shape = json!({"external_id": format!("s{k}"), "label": of_subject[k / 3], "points": points});
        if with_subject {
            shape["subject"] = json!(format!("subject {}", k / 3));
        }
        shape
    };
    let classifier = json!({"kind": "nearest_neighbours", "neighbours": 1});
    let accuracy = |name: &str, with_subject: bool| {
        new_cohort(&server, name, &(0..60).map(|k| scan(k, with_subject)).collect::<Vec<_>>());
        let dictionary = learnt(&server, &request(name, name, &classifier)).expect(201);
        let validation = &dictionary["classifier"]["validation"];
        assert_eq!(validation["subjects"], if with_subject { json!(20) } else { Value::Null });
        number(&validation["accuracy"]["value"])
    };
    let (leaking, ours) = (accuracy("loose", false), accuracy("subjects", true));
    assert!(leaking > 0.95, "the nearest shape is another scan of the same subject: {leaking}");
    assert!(ours < 0.75, "{ours}");
}

#[test]
fn the_same_classifier_is_learnt_again_on_any_number_of_threads() {
    let shapes = two_classes(9, 0.3);
    let digest = |threads: &str| {
        let server = Setting::fresh().flags(&["--threads", threads]).start();
        new_cohort(&server, "lobes", &shapes);
        let body = request("lobes", "lobes", &json!({"kind": "best", "folds": 3, "repeats": 2}));
        let first = learnt(&server, &body).expect(201);
        let again = learnt(&server, &body).expect(201);
        assert_eq!(first["provenance"]["digest"], again["provenance"]["digest"]);
        first["provenance"]["digest"].clone()
    };
    assert_eq!(digest("1"), digest("3"));
}

// ---------------------------------------------------------------- what is asked

#[test]
fn an_assessment_is_everything_at_once() {
    let server = Setting::fresh().with_example().start();
    let classifier = json!({"kind": "discriminant", "attribute": "labels.treatment", "repeats": 1});
    learnt(&server, &request("cells", "example-cells", &classifier)).expect(201);
    let asked = json!({"cohort": "example-cells", "ids": ["cell0004", "cell0010"]});
    let mut with_samples = asked.clone();
    with_samples["samples"] = json!(16);
    let answer = ask(&server, "cells", "assess", &with_samples);
    let codes = ask(&server, "cells", "encode", &asked);
    let classes = ask(&server, "cells", "classify", &asked);
    let scores = ask(&server, "cells", "score", &asked);
    let shapes = ask(&server, "cells", "reconstruct", &with_samples);
    let stored = server.get("/v1/dictionaries/cells").expect(200);
    let used =
        json!({"id": stored["id"], "name": "cells", "version": 1, "digest": stored["provenance"]["digest"]});
    let priors = ask(&server, "cells", "prior", &asked);
    let samples = ask(&server, "cells", "sample", &json!({}));
    let [atoms, modes, drift] = ["atoms", "modes", "drift"]
        .map(|part| server.get(&format!("/v1/dictionaries/cells/{part}")).expect(200));
    for named in [&answer, &codes, &classes, &scores, &shapes, &priors, &samples, &atoms, &modes, &drift] {
        assert_eq!(named["dictionary"], used, "which version was it");
    }
    let own = |entry: &Value| {
        let mut entry = entry.clone();
        let names = ["index", "id", "external_id"].map(|name| entry.as_object_mut().unwrap().remove(name));
        (entry, names)
    };
    for (i, assessment) in answer["results"].as_array().unwrap().iter().enumerate() {
        let names = own(assessment).1;
        assert_eq!((&names[0], &names[2]), (&Some(json!(i)), &Some(asked["ids"][i].clone())));
        assert!(names[1].as_ref().unwrap().as_str().unwrap().starts_with("shp_"), "{assessment}");
        let (code, of_code) = own(&codes["results"][i]);
        let (mut class, of_class) = own(&classes["results"][i]);
        assert_eq!((&of_code, &of_class), (&names, &names));
        assert_eq!(assessment["code"], code);
        for both in ["novelty", "verdict"] {
            assert_eq!(class.as_object_mut().unwrap().remove(both).as_ref(), Some(&assessment[both]));
        }
        assert_eq!(assessment["class"], class);
        assert_eq!(assessment["novelty"], scores["results"][i]["novelty"]);
        assert_eq!(assessment["residual"], shapes["results"][i]["residual"]);
        assert_eq!(assessment["relative_error"], shapes["results"][i]["relative_error"]);
    }
    // Without a classifier there is no class, and the rest stays.
    let mut plain = request("plain", "example-cells", &Value::Null);
    plain.as_object_mut().unwrap().remove("classifier");
    learnt(&server, &plain).expect(201);
    assert_eq!(ask(&server, "plain", "assess", &asked)["results"][0]["class"], Value::Null);
    server.post("/v1/dictionaries/plain/classify", &asked).expect_problem(422, "invalid-input", &[""]);
}

#[test]
fn a_classifier_travels_with_its_dictionary() {
    let server = Server::fresh();
    new_cohort(&server, "lobes", &two_classes(8, 0.3));
    let asked = json!({"shapes": [{"points": lobed(3.0, 0.3, 42)}, {"points": lobed(2.0, 0.3, 43)}]});
    let sparse = json!({"kind": "sparse", "atoms": 4, "lambda": 0.02, "max_epochs": 5});
    let kinds = ["mean_space", "discriminant", "nearest_neighbours", "nearest_atom", "sparse_residual"];
    let other = Server::fresh();
    let mut differences = Differences::default();
    for kind in kinds {
        let mut body = request(kind, "lobes", &json!({"kind": kind, "repeats": 1}));
        if kind == "sparse_residual" || kind == "nearest_atom" {
            body["method"] = sparse.clone();
        }
        learnt(&server, &body).expect(201);
        let file = server.get(&format!("/v1/dictionaries/{kind}/export")).expect(200);
        other.post("/v1/dictionaries/import", &file).expect(201);
        let answers = [&server, &other].map(|server| ask(server, kind, "classify", &asked));
        assert_eq!(answers[0]["results"], answers[1]["results"], "{kind}");
        assert_eq!(answers[0]["dictionary"]["digest"], answers[1]["dictionary"]["digest"], "{kind}");
        // Numbers that training never makes are refused, also under a digest of their own.
        let breakages: Vec<(&str, Value)> = match kind {
            "mean_space" => vec![("means", json!([])), ("means", json!([[[0.0, 0.0]], [[1.0, 1.0]]]))],
            "discriminant" => vec![
                ("features", json!([])),
                ("features", json!([0, 1, 2, 3, 4, 99])),
                ("scales", json!([0, 1, 1, 1, 1, 1])),
                ("means", json!([[1, 2]])),
                ("factors", json!([[1.0]])),
                ("log_priors", json!([0.0])),
            ],
            "nearest_neighbours" => vec![
                ("neighbours", json!(0)),
                ("features", json!([[1.0]])),
                ("classes", json!([7])),
                ("size_factor", json!(1.0)),
            ],
            _ => vec![("atoms", json!([[0]])), ("atoms", json!([[0], [9]])), ("atoms", json!([[1, 0], []]))],
        };
        for (field, value) in breakages {
            let mut broken = file.clone();
            broken["content"]["classifier"]["trained"][field] = value.clone();
            let content: shapelex_server::analysis::dictionary::content::Content =
                serde_json::from_value(broken["content"].clone()).unwrap();
            let text = serde_json::to_vec(&content).unwrap();
            broken["digest"] = json!(blake3::hash(&text).to_hex().to_string());
            let reply = other.post("/v1/dictionaries/import", &broken);
            let pointers = crate::server::pointers_of(&reply.json());
            let below = pointers.iter().all(|pointer| pointer.starts_with("/content/classifier/trained/"));
            assert!(reply.status == 422 && below, "{kind} {field} {value}: {}", reply.text());
        }
        differences.compare(
            kind,
            &other.post(&format!("/v1/dictionaries/{kind}/classify"), &json!({"shapes": []})),
            &Wanted::new(422, "too-few-shapes", &[]),
        );
    }
}

// ---------------------------------------------------------------- what changes

#[test]
fn drift_tells_new_shapes_that_differ_from_those_that_do_not() {
    let server = Server::fresh();
    new_cohort(&server, "lobes", &two_classes(40, 0.1));
    // One component, the lobes: components that are learnt from noise describe new shapes worse than those they were
    // learnt from, and the test would see that.
    let mut body = request("lobes", "lobes", &json!({"kind": "discriminant"}));
    body["method"]["components"] = json!(1);
    learnt(&server, &body).expect(201);
    let drift = |query: &str| server.get(&format!("/v1/dictionaries/lobes/drift{query}")).expect(200);
    let nothing = drift("");
    assert_eq!(
        (&nothing["shape_count"], &nothing["since_revision"], &nothing["mean"]),
        (&json!(0), &json!(1), &Value::Null)
    );
    let add = |lobes: f64, spread: f64, first: u64| {
        let shapes: Vec<Value> = (first..first + 30)
            .map(|k| json!({"label": "x", "points": lobed(if lobes > 0.0 { lobes } else { 2.0 + (k % 2) as f64 }, spread, k)}))
            .collect();
        server.post("/v1/cohorts/lobes/shapes", &json!({ "shapes": shapes })).expect(201)
    };
    add(0.0, 0.1, 2000);
    let same = drift("");
    assert_eq!((&same["shape_count"], &same["cohort_revision"]), (&json!(30), &json!(2)));
    assert!(number(&same["outliers"]["rate"]) <= 0.15, "{same}");
    let mean = &same["mean"];
    assert!(number(&mean["angle_deg"]) < 3.0 * number(&mean["expected_deg"]), "{mean}");
    let classes = same["classes"].as_array().unwrap();
    assert!(classes.iter().all(|class| (number(&class["new"]) - 0.5).abs() < 0.1), "{same}");
    // One class alone, and more disturbed.
    add(3.0, 0.3, 3000);
    let other = drift("?since=2");
    assert_eq!(other["shape_count"], 30);
    assert!(number(&other["outliers"]["rate"]) > 0.5, "{other}");
    assert!(number(&other["mean"]["angle_deg"]) > 2.0 * number(&mean["angle_deg"]), "{other}");
    assert!(number(&other["classes"][0]["new"]) > 0.8, "{other}");
    let (before, after) =
        (&other["squared_prediction_error"]["training"], &other["squared_prediction_error"]["new"]);
    assert!(number(&after[1]) > number(&before[1]), "{other}");
    // From the middle between the two classes to one of them.
    assert!(number(&other["scores"][0]["shift"]).abs() > 0.5, "{other}");
    // A time instead of a revision.
    assert_eq!(drift("?since=2000-01-01T00:00:00Z")["shape_count"], 140);
    assert_eq!(drift("?since=2199-01-01T00:00:00Z")["shape_count"], 0);
    for query in ["?since=9", "?since=yesterday", "?quantile=0.2", "?since=-1", "?weather=1"] {
        server.get(&format!("/v1/dictionaries/lobes/drift{query}")).expect_problem(400, "invalid-query", &[]);
    }
    server.delete("/v1/cohorts/lobes");
    server.get("/v1/dictionaries/lobes/drift").expect_problem(404, "not-found", &[]);
}

// ---------------------------------------------------------------- what is refused

#[test]
fn bad_classifiers_are_refused() {
    let server = Server::fresh();
    new_cohort(&server, "lobes", &two_classes(6, 0.3));
    let mut differences = Differences::default();
    let plain = |kind: &str| json!({"kind": kind});
    let with = |kind: &str, field: &str, value: Value| json!({"kind": kind, field: value});
    let cases = [
        (plain("random_forest"), vec!["/classifier/kind"]),
        (json!({}), vec!["/classifier"]),
        (with("discriminant", "depth", json!(3)), vec!["/classifier/depth"]),
        (plain("sparse_residual"), vec!["/classifier/kind"]),
        (plain("nearest_atom"), vec!["/classifier/kind"]),
        (with("discriminant", "attribute", json!("labels.weather")), vec!["/classifier/attribute"]),
        (with("discriminant", "attribute", json!("weather")), vec!["/classifier/attribute"]),
        (with("discriminant", "attribute", json!("labels.scan")), vec!["/classifier/attribute"]),
        (with("discriminant", "features", json!(["size"])), vec!["/classifier/features"]),
        (with("discriminant", "features", json!(["shape", "shape"])), vec!["/classifier/features"]),
        (with("mean_space", "features", json!(["shape", "size"])), vec!["/classifier/features"]),
        (with("discriminant", "components", json!(0)), vec!["/classifier/components"]),
        (with("discriminant", "components", json!(7)), vec!["/classifier/components"]),
        (with("discriminant", "pooling", json!(1.5)), vec!["/classifier/pooling"]),
        (with("discriminant", "shrinkage", json!(-0.1)), vec!["/classifier/shrinkage"]),
        (with("mean_space", "pooling", json!(0.5)), vec!["/classifier/pooling"]),
        (with("nearest_neighbours", "neighbours", json!(0)), vec!["/classifier/neighbours"]),
        (with("nearest_neighbours", "neighbours", json!(7)), vec!["/classifier/neighbours"]),
        (with("discriminant", "neighbours", json!(3)), vec!["/classifier/neighbours"]),
        (with("discriminant", "folds", json!(1)), vec!["/classifier/folds"]),
        (with("discriminant", "folds", json!(7)), vec!["/classifier/folds"]),
        (with("discriminant", "repeats", json!(0)), vec!["/classifier/repeats"]),
        (
            json!({"kind": "discriminant", "folds": 0, "repeats": 1000, "pooling": 2}),
            vec!["/classifier/folds", "/classifier/pooling", "/classifier/repeats"],
        ),
    ];
    for (classifier, pointers) in cases {
        let reply = server.post("/v1/dictionaries", &request("bad", "lobes", &classifier));
        differences.compare(&classifier.to_string(), &reply, &Wanted::invalid(&pointers));
    }
    // One class only; a class with one member; shapes without a label.
    let discriminant = plain("discriminant");
    let mut filtered = request("bad", "lobes", &discriminant);
    filtered["filter"] = json!({"label": "two"});
    let one_class = Wanted::invalid(&["/classifier/attribute"]);
    differences.compare("one class", &server.post("/v1/dictionaries", &filtered), &one_class);
    let lone = json!({"external_id": "lone", "label": "lone", "points": lobed(4.0, 0.1, 1)});
    server.post("/v1/cohorts/lobes/shapes", &json!({"shapes": [lone]})).expect(201);
    let reply = server.post("/v1/dictionaries", &request("bad", "lobes", &discriminant));
    differences.compare("one member", &reply, &one_class);
    assert!(reply.text().contains("'lone'"), "{}", reply.text());
    let bare = json!({"external_id": "bare", "points": lobed(4.0, 0.1, 2)});
    server.post("/v1/cohorts/lobes/shapes", &json!({"shapes": [bare]})).expect(201);
    let reply = server.post("/v1/dictionaries", &request("bad", "lobes", &discriminant));
    differences.compare("no label", &reply, &one_class);
    assert!(reply.text().contains("(bare)"), "{}", reply.text());
    assert_eq!(server.get("/v1/jobs").expect(200)["items"], json!([]));
    // More classes than anybody reads.
    let pair = |k: usize| json!({"label": format!("class {}", k / 2), "points": lobed(3.0, 0.1, k as u64)});
    new_cohort(&server, "many", &(0..2002).map(pair).collect::<Vec<_>>());
    let mut body = request("bad", "many", &discriminant);
    body["classifier"]["folds"] = json!(2);
    differences.compare("1001 classes", &server.post("/v1/dictionaries", &body), &one_class);
    // What is asked of a classifier.
    server.delete("/v1/cohorts/lobes/shapes/bare");
    server.delete("/v1/cohorts/lobes/shapes/lone");
    learnt(&server, &request("good", "lobes", &discriminant)).expect(201);
    for (body, pointers) in [
        (json!({"shapes": [{"points": lobed(2.0, 0.0, 1)}], "quantile": 1.0}), vec!["/quantile"]),
        (json!({"shapes": [{"points": lobed(2.0, 0.0, 1)}], "quantile": "high"}), vec!["/quantile"]),
        (json!({}), vec![""]),
    ] {
        let reply = server.post("/v1/dictionaries/good/classify", &body);
        differences.compare(&format!("classify {body}"), &reply, &Wanted::invalid(&pointers));
    }
    let body = json!({"shapes": [{"points": lobed(2.0, 0.0, 1)}], "samples": 100_000_000});
    let reply = server.post("/v1/dictionaries/good/assess", &body);
    differences.compare("samples", &reply, &Wanted::invalid(&["/samples"]));
    let body = json!({"name": "good", "cohort": "lobes", "continue_from": "good"});
    server.post("/v1/cohorts/lobes/shapes", &json!({"shapes": [{"points": lobed(2.0, 0.1, 9)}]})).expect(201);
    let reply = server.post("/v1/dictionaries", &body);
    differences.compare("continued", &reply, &Wanted::invalid(&["/continue_from"]));
    // Covariances that cannot be inverted are found out by the job, which says so.
    server.delete("/v1/cohorts/lobes");
    new_cohort(&server, "lobes", &two_classes(3, 0.3));
    let singular = json!({"kind": "discriminant", "pooling": 0, "shrinkage": 0, "folds": 3});
    let job = finished(&server, &submit(&server, &request("singular", "lobes", &singular)));
    assert_eq!(job["status"], "failed", "{job}");
    assert_eq!(job["problem"]["errors"][0]["pointer"], "/classifier/shrinkage", "{job}");
}
