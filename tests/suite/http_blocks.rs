//! Blocks and modules of stored shapes: landmarks with labels, another cohort of the same subjects, parts of curves; refusals.

use serde_json::{Value, json};

use crate::server::{Server, Setting};

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("a number, got {value}"))
}

/// A value of shape `k`, and noise of its point `i`.
fn trait_of(k: usize) -> f64 {
    ((k * k * 5 + 3 * k + 1) as f64).sin()
}

fn noise(i: usize, k: usize) -> f64 {
    ((13 * i * i + 7 * k * k + 3 * i * k + 5) as f64).sin()
}

/// Eight landmarks on an ellipse that is bent by the trait of the subject.
fn points(k: usize, seed: usize) -> Vec<[f64; 2]> {
    let at = |i: usize| {
        let t = std::f64::consts::TAU * i as f64 / 8.0;
        let bend = 0.3 * trait_of(k);
        [
            2.0 * t.cos() + 0.02 * noise(i + seed, k),
            t.sin() + bend * (2.0 * t).cos() + 0.02 * noise(i + seed + 9, k),
        ]
    };
    (0..8).map(at).collect()
}

/// Two cohorts of twenty subjects, the second of which lacks two and is stored backwards.
fn made(server: &Server) {
    let representation = json!({"kind": "landmarks", "dimension": 2, "points": 8});
    for (name, seed, subjects) in [("skulls", 0, 0..20), ("mandibles", 40, 2..20)] {
        server.post("/v1/cohorts", &json!({"name": name, "representation": representation})).expect(201);
        let shape = |k: usize| {
            json!({"external_id": format!("{name}{k}"), "subject": format!("p{k}"), "points": points(k, seed),
                "labels": {"age": 40.0 + 10.0 * trait_of(k), "site": if k.is_multiple_of(2) { "x" } else { "y" }, "name": format!("n{k}")}})
        };
        let mut shapes: Vec<Value> = subjects.map(shape).collect();
        if seed > 0 {
            shapes.reverse();
        }
        server.post(&format!("/v1/cohorts/{name}/shapes"), &json!({"shapes": shapes})).expect(201);
    }
}

#[test]
fn blocks_of_one_trait_vary_together() {
    let server = Server::fresh();
    made(&server);
    let ask = |further: Value| {
        let mut body = json!({"cohort": "skulls", "permutations": 199});
        body.as_object_mut().unwrap().extend(further.as_object().unwrap().clone());
        server.post("/v1/two-blocks", &body).expect(200)
    };
    let labels = ask(json!({"y": {"labels": ["labels.age"]}}));
    let pair = &labels["pairs"][0];
    assert!(number(&pair["r"]["value"]) > 0.95 && number(&pair["r"]["p"]) == 0.005, "{labels}");
    assert_eq!((&pair["first"], &pair["second"]), (&json!("shape"), &json!("labels.age")));
    let first = &pair["components"][0];
    assert!((number(&first["second"]["labels"]["labels.age"]).abs() - 1.0).abs() < 1e-12, "{first}");
    assert_eq!(first["first"]["shape"].as_array().unwrap().len(), 8);
    assert_eq!(labels["scores"].as_array().unwrap().len(), 20);
    assert!(labels["overall"].is_null() && labels["blocks"][1]["average"].is_null());
    // The other cohort is brought into the order of the subjects.
    let both = ask(json!({"y": {"cohort": "mandibles"}}));
    let pair = &both["pairs"][0];
    assert!(number(&pair["r"]["value"]) > 0.95 && number(&pair["r"]["p"]) == 0.005, "{both}");
    assert!(number(&pair["rv"]["value"]) > 2.0 * number(&pair["rv"]["permuted_mean"]), "{pair}");
    assert_eq!((&both["shape_count"], &both["left_out"]), (&json!(18), &json!(2)));
    assert_eq!(both["scores"][0]["external_id"], "skulls2");
    assert!(both["warnings"].to_string().contains("no partner"), "{both}");
    // Parts share an alignment unless they are aligned apart.
    let parts = json!({"x": {"points": [0, 1, 2, 3]}, "y": {"points": [4, 5, 6, 7]}});
    let shared = ask(parts.clone());
    assert!(shared["warnings"].to_string().contains("share its alignment"), "{shared}");
    let mut apart = parts;
    apart["separate"] = json!(true);
    apart["others"] = json!([{"labels": ["labels.age", "measures.centroid_size"]}]);
    let apart = ask(apart);
    assert!(!apart["warnings"].to_string().contains("share its alignment"), "{apart}");
    let values: Vec<f64> =
        apart["pairs"].as_array().unwrap().iter().map(|pair| number(&pair["r"]["value"])).collect();
    assert_eq!(values.len(), 3);
    let mean = values.iter().sum::<f64>() / 3.0;
    assert!((number(&apart["overall"]["value"]) - mean).abs() < 1e-12, "{apart}");
    // In strata, and the same bits again.
    let within = ask(json!({"y": {"labels": ["labels.age"]}, "strata": "labels.site", "seed": 4}));
    let again = ask(json!({"y": {"labels": ["labels.age"]}, "strata": "labels.site", "seed": 4}));
    assert_eq!((&within["pairs"], &within["strata"]), (&again["pairs"], &json!(["labels.site"])));
    for body in [json!({"y": {"cohort": "mandibles"}}), json!({"y": {"labels": ["labels.age"]}})] {
        let mut body = body;
        body["cohort"] = json!("skulls");
        body["permutations"] = json!(99);
        let reply = server.post("/v1/two-blocks?format=svg", &body);
        let picture = reply.expect_svg();
        assert!(picture.contains("high scores in both blocks"), "{picture}");
    }
}

#[test]
fn parts_of_curves_are_blocks_and_modules() {
    let server = Setting::fresh().with_example().start();
    let halves = json!({"cohort": "example-cells", "x": {"range": [0, 0.49]}, "y": {"range": [0.5, 0.99]}, "permutations": 49});
    let found = server.post("/v1/two-blocks", &halves).expect(200);
    let numbers: Vec<f64> = (0..2).map(|k| number(&found["blocks"][k]["numbers"])).collect();
    assert!(numbers[0] > 4.0 && (numbers[0] - numbers[1]).abs() <= 2.0, "{numbers:?}");
    // Through the start.
    let wrapped = json!({"cohort": "example-cells", "x": {"range": [0.8, 0.2]}, "y": {"range": [0.3, 0.7]}, "permutations": 0});
    let wrapped = server.post("/v1/two-blocks", &wrapped).expect(200);
    assert!(wrapped["pairs"][0]["r"]["p"].is_null(), "{wrapped}");
    let modules = json!({"one": {"range": [0, 0.49]}, "other": {"range": [0.5, 0.99]}});
    let body = json!({"cohort": "example-cells", "modules": modules, "permutations": 1});
    let found = server.post("/v1/modularity", &body).expect(200);
    // Every shift of the modules along the curve.
    let count = found["average"].as_array().unwrap().len();
    assert_eq!((&found["exchanged"], &found["ratio"]["exact"]), (&json!("shifts"), &json!(true)));
    assert_eq!(found["ratio"]["permutations"], json!(count - 1));
    let reply = server.post("/v1/modularity?format=svg", &body);
    assert!(reply.expect_svg().contains("covariance ratio"));
}

#[test]
fn landmarks_are_exchanged_between_modules() {
    let server = Server::fresh();
    made(&server);
    let body = json!({"cohort": "skulls", "modules": {"a": {"points": [0, 1, 2, 3]}, "b": {"points": [4, 5, 6, 7]}}});
    let found = server.post("/v1/modularity", &body).expect(200);
    // All 70 choices of four of eight; the one that swaps the modules is a tie.
    assert_eq!((&found["ratio"]["permutations"], &found["ratio"]["exact"]), (&json!(69), &json!(true)));
    assert!(number(&found["ratio"]["exceeding"]) >= 1.0, "{found}");
    assert_eq!((&found["cr"], &found["exchanged"]), (&json!("invariant"), &json!("points")));
    assert_eq!(
        (&found["modules"][1]["name"], &found["modules"][1]["points"]),
        (&json!("b"), &json!([4, 5, 6, 7]))
    );
    let mut other = body.clone();
    other["cr"] = json!("adams2016");
    let other = server.post("/v1/modularity", &other).expect(200);
    assert!(number(&other["ratio"]["value"]) != number(&found["ratio"]["value"]), "{other}");
}

#[test]
fn copies_have_no_modules_to_compare() {
    let server = Server::fresh();
    let representation = json!({"kind": "landmarks", "dimension": 2, "points": 8});
    server.post("/v1/cohorts", &json!({"name": "copies", "representation": representation})).expect(201);
    // Turned copies differ by rounding once they are aligned.
    let turned = |k: usize| {
        let (sine, cosine) = (k as f64).sin_cos();
        points(0, 0).into_iter().map(move |[x, y]| [cosine * x - sine * y, sine * x + cosine * y])
    };
    let shapes: Vec<Value> = (0..9).map(|k| json!({"points": turned(k).collect::<Vec<_>>()})).collect();
    server.post("/v1/cohorts/copies/shapes", &json!({"shapes": shapes})).expect(201);
    let modules = json!({"a": {"points": [0, 1, 2, 3]}, "b": {"points": [4, 5, 6, 7]}});
    for cr in ["invariant", "adams2016"] {
        let body = json!({"cohort": "copies", "modules": modules, "cr": cr});
        let problem = server.post("/v1/modularity", &body).expect(422);
        assert!(problem.to_string().contains("vary"), "{problem}");
    }
}

#[test]
fn what_is_no_block_is_refused_at_its_place() {
    let server = Server::fresh();
    made(&server);
    let generator = json!({"name": "cubic"});
    let open = json!({"kind": "open_curve", "dimension": 2, "intervals": 6, "generator": generator});
    server.post("/v1/cohorts", &json!({"name": "lines", "representation": open})).expect(201);
    let line = |k: usize| {
        let at = |i: usize| [i as f64, noise(i, k)];
        json!({"points": (0..7).map(at).collect::<Vec<_>>()})
    };
    let shapes: Vec<Value> = (0..6).map(line).collect();
    server.post("/v1/cohorts/lines/shapes", &json!({"shapes": shapes})).expect(201);
    let refused = |route: &str, body: Value, pointer: &str, said: &str| {
        let problem = server.post(route, &body).expect(422);
        let first = &problem["errors"][0];
        assert!(
            first["pointer"] == pointer && first["detail"].as_str().unwrap().contains(said),
            "{body}: {problem}"
        );
    };
    let blocks = |y: Value| json!({"cohort": "skulls", "y": y, "permutations": 9});
    for (y, pointer, said) in [
        (json!({}), "/y", "expected different blocks"),
        (json!({"points": [0, 8]}), "/y/points", "expected indices below 8, got 8"),
        (json!({"points": [0, 0]}), "/y/points", "got 0 twice"),
        (json!({"points": [0], "range": [0, 1]}), "/y", "either points or range"),
        (json!({"range": [0, 0.5]}), "/y/range", "only curves"),
        (json!({"labels": []}), "/y/labels", "1 to 1000 labels"),
        (json!({"labels": ["subject"]}), "/y/labels/0", "got 'subject'"),
        (json!({"labels": ["labels.name"]}), "/y/labels/0", "no number on the shape 'skulls0'"),
        (json!({"labels": ["labels.age"], "points": [0]}), "/y", "got several"),
        (json!({"cohort": "lines"}), "/y/cohort", "expected a subject of every shape"),
        (json!({"filter": {}}), "/y/filter", "with another cohort only"),
    ] {
        refused("/v1/two-blocks", blocks(y), pointer, said);
    }
    server.post("/v1/two-blocks", &blocks(json!({"cohort": "none"}))).expect(404);
    refused(
        "/v1/two-blocks",
        json!({"cohort": "skulls", "y": {"labels": ["labels.age"]}, "strata": "subject"}),
        "/strata",
        "nothing can be exchanged",
    );
    let modules = |modules: Value| json!({"cohort": "skulls", "modules": modules, "permutations": 9});
    for (given, pointer, said) in [
        (json!({"a": {"points": [0, 1]}}), "/modules", "2 to 50 modules"),
        (json!({"a": {"points": [0, 1]}, "b": {"points": [1, 2]}}), "/modules/b", "got 1 in two"),
        (json!({"a": {"points": [0, 1]}, "b": {"points": [2]}}), "/modules/b/points", "at least 2"),
    ] {
        refused("/v1/modularity", modules(given), pointer, said);
    }
    let open = json!({"cohort": "lines", "modules": {"a": {"range": [0, 0.4]}, "b": {"range": [0.6, 1]}}});
    refused("/v1/modularity", open.clone(), "/permutations", "covary by construction");
    let mut plain = open;
    plain["permutations"] = json!(0);
    let plain = server.post("/v1/modularity", &plain).expect(200);
    assert!(plain["ratio"]["p"].is_null() && plain["exchanged"].is_null(), "{plain}");
}
