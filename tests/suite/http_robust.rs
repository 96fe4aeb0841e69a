//! Robust means, components and dictionaries over HTTP: what is answered, refused, and never taken for a plain result.

use std::f64::consts::TAU;

use serde_json::{Value, json};

use crate::http_dictionaries::{finished, submit};
use crate::server::{Server, shared};

const POINTS: usize = 16;
const RIGHT: usize = 28;
const WRONG: usize = 12;

/// Beans with two modes; the last ones are stars.
fn shapes() -> Vec<Value> {
    let shape = |k: usize| {
        let (a, b) = ((7.0 * k as f64).sin(), (5.0 * k as f64).cos());
        let radius = |u: f64| {
            if k < RIGHT {
                1.0 + 0.3 * (2.0 * u).cos() + 0.05 * a * (3.0 * u).sin() + 0.03 * b * (4.0 * u).cos()
            } else {
                1.0 + 0.5 * (5.0 * u + 0.1 * a).cos()
            }
        };
        let point = |i: usize| {
            let u = TAU * i as f64 / POINTS as f64;
            let noise = 0.002 * ((k * 31 + i * 17) as f64).sin();
            let r = radius(u) + noise;
            [r * u.cos(), r * u.sin()]
        };
        let points: Vec<[f64; 2]> = (0..POINTS).map(point).collect();
        json!({"external_id": format!("s{k}"), "points": points})
    };
    (0..RIGHT + WRONG).map(shape).collect()
}

fn representation() -> Value {
    json!({"kind": "closed_curve", "dimension": 2, "control_points": POINTS, "generator": {"name": "trigonometric"}})
}

fn request(robust: bool, shapes: &[Value]) -> Value {
    let points: Vec<Value> = shapes.iter().map(|shape| json!({"points": shape["points"]})).collect();
    let mut body =
        json!({"representation": representation(), "transformation": "similarity", "shapes": points});
    if robust {
        body["robust"] = json!(true);
    }
    body
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|value| value.as_f64().unwrap()).collect()
}

fn cohort(server: &Server, name: &str) {
    server.post("/v1/cohorts", &json!({"name": name, "representation": representation()})).expect(201);
    server.post(&format!("/v1/cohorts/{name}/shapes"), &json!({"shapes": shapes()})).expect(201);
}

#[test]
fn means_alignments_and_components_answer_the_weights_of_shapes_and_points() {
    let server = shared();
    let all = shapes();
    let right = server.post("/v1/mean", &request(false, &all[..RIGHT])).expect(200);
    let plain = server.post("/v1/mean", &request(false, &all)).expect(200);
    let robust = server.post("/v1/mean", &request(true, &all)).expect(200);
    let off = |answer: &Value| {
        let of = |answer: &Value| crate::server::flat(&answer["mean"]["control_points"]);
        of(answer).iter().zip(of(&right)).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
    };
    assert!(off(&robust) < 0.1 * off(&plain), "{} and {}", off(&robust), off(&plain));
    assert!(plain.get("robust").is_none(), "{plain}");
    let weights = numbers(&robust["robust"]["weights"]);
    assert!(weights[..RIGHT].iter().all(|w| *w > 0.9) && weights[RIGHT..].iter().all(|w| *w == 0.0));
    assert_eq!((&robust["robust"]["rejected_count"], &robust["shape_count"]), (&json!(WRONG), &json!(40)));
    // Written out, `false` is the default: the same bytes.
    let mut written = request(false, &all);
    written["robust"] = json!(false);
    assert_eq!(server.post("/v1/mean", &written).body, server.post("/v1/mean", &request(false, &all)).body);

    let aligned = server.post("/v1/align", &request(true, &all)).expect(200);
    for (entry, weight) in aligned["aligned"].as_array().unwrap().iter().zip(&weights) {
        assert_eq!(entry["weight"], json!(weight));
        let points = numbers(&entry["point_weights"]);
        assert!(points.len() == POINTS && points.iter().all(|v| (0.0..=1.0).contains(v)), "{points:?}");
    }
    let first = &server.post("/v1/align", &request(false, &all)).expect(200)["aligned"][0];
    assert!(first.get("weight").is_none() && first.get("point_weights").is_none(), "{first}");

    let components = |robust, shapes: &[Value]| {
        let mut body = request(robust, shapes);
        (body["components"], body["centre"]) = (json!(2), json!(true));
        server.post("/v1/pca", &body).expect(200)
    };
    let explained = |answer: &Value| numbers(&answer["pca"]["eigenvalues"])[0];
    let (wanted, found, plain) =
        (components(false, &all[..RIGHT]), components(true, &all), components(false, &all));
    assert!((explained(&found) / explained(&wanted) - 1.0).abs() < 0.05, "{}", explained(&found));
    assert!(explained(&plain) > 3.0 * explained(&wanted), "{}", explained(&plain));
    assert_eq!(found["pca"]["scores"].as_array().unwrap().len(), RIGHT + WRONG);
    let mut body = request(true, &all);
    body["centre"] = json!(true);
    server.post("/v1/pca?format=svg&component=1", &body).expect_svg();
}

#[test]
fn the_mean_of_a_cohort_names_what_it_leaves_out_and_is_kept_apart() {
    let server = Server::fresh();
    cohort(&server, "robust-cohort");
    let path = "/v1/cohorts/robust-cohort/mean?transformation=similarity";
    let robust_path = format!("{path}&robust=true");
    for _ in 0..2 {
        // The second time from the cache.
        let (plain, robust) = (server.get(path), server.get(&robust_path));
        let (tag, other) = (plain.header("etag").unwrap(), robust.header("etag").unwrap());
        assert_ne!(tag, other);
        assert!(plain.expect(200).get("robust").is_none());
        let robust = robust.expect(200);
        let left_out = &robust["robust"];
        assert_eq!(left_out["rejected_count"], json!(WRONG));
        let listed = left_out["shapes"].as_array().unwrap();
        assert!(listed.len() >= WRONG && left_out.get("weights").is_none(), "{left_out}");
        for (k, shape) in listed[..WRONG].iter().enumerate() {
            let points = numbers(&shape["point_weights"]);
            assert!(points.len() == POINTS && points.iter().all(|v| (0.0..=1.0).contains(v)), "{points:?}");
            let id = shape["id"].as_str().unwrap();
            let found = server.get(&format!("/v1/cohorts/robust-cohort/shapes/{id}")).expect(200);
            assert_eq!(
                (&found["external_id"], &shape["weight"]),
                (&json!(format!("s{}", RIGHT + k)), &json!(0.0))
            );
        }
        let posted = server.post("/v1/mean", &request(true, &shapes())).expect(200);
        assert_eq!(posted["mean"], robust["mean"]);
    }
    assert_eq!(server.get(&format!("{path}&robust=false")).body, server.get(path).body);
    server.get(&format!("{robust_path}&format=svg")).expect_svg();
    server.get(&format!("{path}&robust=yes")).expect_problem(400, "invalid-query", &[]);
}

#[test]
fn robust_dictionaries_are_other_dictionaries() {
    let server = Server::fresh();
    cohort(&server, "robust-learning");
    let body = |robust: bool, name: &str| {
        let method = json!({"kind": "functional_pca", "components": 2, "centre": true});
        let mut body = json!({"name": name, "cohort": "robust-learning", "transformation": "similarity", "method": method});
        if robust {
            body["robust"] = json!(true);
        }
        body
    };
    let learn = |robust, name: &str| {
        let done = finished(&server, &submit(&server, &body(robust, name)));
        assert_eq!(done["status"], "succeeded", "{done}");
        server.get(&format!("/v1/dictionaries/{name}")).expect(200)
    };
    let (plain, robust, again) = (learn(false, "plain"), learn(true, "robust"), learn(true, "again"));
    assert_eq!(
        (&robust["robust"]["rejected"], &robust["statistics"]["shapes"]),
        (&json!(WRONG), &json!(RIGHT))
    );
    let listed = robust["robust"]["shapes"].as_array().unwrap();
    assert!(listed.len() >= WRONG && listed.len() <= 20, "{listed:?}");
    for (k, shape) in listed[..WRONG].iter().enumerate() {
        let id = shape["id"].as_str().unwrap();
        let found = server.get(&format!("/v1/cohorts/robust-learning/shapes/{id}")).expect(200);
        assert_eq!(found["external_id"], json!(format!("s{}", RIGHT + k)));
        assert_eq!((&shape["weight"], numbers(&shape["point_weights"]).len()), (&json!(0.0), POINTS));
    }
    assert!(plain.get("robust").is_none());
    assert_ne!(plain["provenance"]["digest"], robust["provenance"]["digest"]);
    assert_eq!(again["provenance"]["digest"], robust["provenance"]["digest"]);
    assert_eq!(plain["provenance"]["shapes_digest"], robust["provenance"]["shapes_digest"]);

    // A file keeps it.
    let file = server.get("/v1/dictionaries/robust/export").expect(200);
    assert_eq!((&file["format_version"], &file["content"]["robust"]["rejected"]), (&json!(4), &json!(WRONG)));
    let imported = server.post("/v1/dictionaries/import?name=imported", &file).expect(201);
    assert_eq!(imported["provenance"]["digest"], robust["provenance"]["digest"]);
    assert_eq!(imported["robust"], robust["robust"]);
    let mut long = file.clone();
    long["provenance"]["less_counted"] = json!(vec![file["provenance"]["less_counted"][0].clone(); 21]);
    server.post("/v1/dictionaries/import?name=long", &long).expect_problem(
        422,
        "invalid-input",
        &["/provenance/less_counted"],
    );

    // A prediction counts its passes.
    let dry = |robust| {
        let mut body = body(robust, "dry");
        body["dry_run"] = json!(true);
        server.post("/v1/dictionaries", &body).expect(200)["estimate"].clone()
    };
    let of = |estimate: Value, field: &str| estimate[field].as_f64().unwrap();
    assert!(of(dry(true), "multiply_adds") > of(dry(false), "multiply_adds"));
    assert!(of(dry(true), "memory_bytes") > of(dry(false), "memory_bytes"));

    // The weights depend on all shapes, so that it cannot be continued; classes would be left out.
    server
        .post(
            "/v1/dictionaries",
            &json!({"name": "more", "cohort": "robust-learning", "continue_from": "robust"}),
        )
        .expect_problem(422, "invalid-input", &["/continue_from"]);
    let mut continued = json!({"name": "more", "cohort": "robust-learning", "continue_from": "plain"});
    continued["robust"] = json!(true);
    server.post("/v1/dictionaries", &continued).expect_problem(422, "invalid-input", &["/robust"]);
    let mut classes = body(true, "classes");
    classes["classifier"] = json!({"kind": "discriminant", "attribute": "label"});
    server.post("/v1/dictionaries", &classes).expect_problem(422, "invalid-input", &["/robust"]);
}

#[test]
fn bad_input_is_refused_and_equal_shapes_are_not() {
    let server = shared();
    let all = shapes();
    let few = server.post("/v1/mean", &request(true, &all[..4]));
    let problem = few.expect_problem(422, "too-few-shapes", &[]);
    assert!(problem["detail"].as_str().unwrap().contains("expected at least 5, got 4"), "{problem}");
    server.post("/v1/mean", &request(true, &vec![all[0].clone(); 6])).expect(200);
    let mut weighted = request(true, &all);
    for shape in weighted["shapes"].as_array_mut().unwrap() {
        shape["weight"] = json!(1e-9);
    }
    weighted["shapes"][0]["weight"] = json!(1.0);
    for path in ["mean", "align", "pca"] {
        let problem =
            server.post(&format!("/v1/{path}"), &weighted).expect_problem(422, "invalid-input", &["/robust"]);
        assert!(problem["detail"].as_str().unwrap().contains("got 1.00"), "{problem}");
        let mut wrong = request(false, &all);
        wrong["robust"] = json!("yes");
        server.post(&format!("/v1/{path}"), &wrong).expect_problem(422, "invalid-input", &["/robust"]);
    }
    // Not a parameter of projections.
    let mut project = request(true, &all);
    project["reference"] = json!({"points": all[0]["points"]});
    server.post("/v1/project", &project).expect_problem(422, "invalid-input", &["/robust"]);
}

/// A stretch of two control points is displaced, in a cohort and in a dictionary: it has the smallest weights there.
#[test]
fn cohorts_and_dictionaries_tell_where_a_shape_is_damaged() {
    const DAMAGED: usize = 5;
    let server = Server::fresh();
    let mut right = shapes();
    right.truncate(RIGHT);
    for i in 6..8 {
        let point = right[DAMAGED]["points"][i].as_array().unwrap().clone();
        let moved: Vec<f64> = point.iter().map(|value| 1.8 * value.as_f64().unwrap()).collect();
        right[DAMAGED]["points"][i] = json!(moved);
    }
    server.post("/v1/cohorts", &json!({"name": "damaged", "representation": representation()})).expect(201);
    server.post("/v1/cohorts/damaged/shapes", &json!({"shapes": right})).expect(201);
    let located = |answer: &Value| {
        let shape = &answer["robust"]["shapes"][0];
        let id = shape["id"].as_str().unwrap();
        let found = server.get(&format!("/v1/cohorts/damaged/shapes/{id}")).expect(200);
        assert_eq!(found["external_id"], json!(format!("s{DAMAGED}")), "{answer}");
        let points = numbers(&shape["point_weights"]);
        assert!(points[6..8].iter().all(|v| *v < 0.05), "{points:?}");
        let elsewhere: f64 = points[10..].iter().chain(&points[..4]).sum();
        assert!(elsewhere > 5.0, "{points:?}");
    };
    for alignment in ["projection", "procrustes"] {
        let path =
            format!("/v1/cohorts/damaged/mean?transformation=similarity&alignment={alignment}&robust=true");
        located(&server.get(&path).expect(200));
    }
    let method = json!({"kind": "functional_pca", "components": 2, "centre": true});
    let body = json!({"name": "damaged", "cohort": "damaged", "transformation": "similarity", "method": method, "robust": true});
    let done = finished(&server, &submit(&server, &body));
    assert_eq!(done["status"], "succeeded", "{done}");
    located(&server.get("/v1/dictionaries/damaged").expect(200));
}
