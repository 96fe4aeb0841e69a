//! Groupwise correspondence of surfaces, and of new surfaces with a dictionary.

use std::f64::consts::{PI, TAU};

use serde_json::{Value, json};

use crate::http_dictionaries::{finished, submit};
use crate::server::{Server, shared};

const SIZE: [usize; 2] = [8, 8];

fn representation() -> Value {
    json!({"kind": "surface", "topology": "sphere", "control_points": SIZE})
}

/// A bean whose long half-axis grows with `t`, with its parameters turned about two axes by `turn`: points `[u][v]`.
fn bean(t: f64, turn: f64) -> Value {
    let ((s, c), (q, p)) = (turn.sin_cos(), (0.7 * turn).sin_cos());
    let at = |k: usize, l: usize| {
        let (u, v) = (TAU * k as f64 / SIZE[0] as f64, PI * l as f64 / SIZE[1] as f64);
        let [x, y, z] = [v.sin() * u.cos(), v.sin() * u.sin(), v.cos()];
        let [x, z] = [c * x + s * z, c * z - s * x];
        let [x, y] = [p * x - q * y, p * y + q * x];
        [10.0 + x * (1.0 + 0.1 * z), 1.4 * y + 0.2 * z * z, (2.0 + t) * z + 0.3 * z * z]
    };
    json!((0..SIZE[0]).map(|k| (0..=SIZE[1]).map(|l| at(k, l)).collect::<Vec<_>>()).collect::<Vec<_>>())
}

/// A cohort of beans with this name.
pub(crate) fn stored(server: &Server, name: &str, count: usize) {
    let body = json!({"name": name, "representation": representation(), "length_unit": "mm"});
    server.post("/v1/cohorts", &body).expect(201);
    let shape = |k: usize| {
        let t = 0.8 * k as f64 / count as f64;
        json!({"points": bean(t, 2.3 * k as f64), "external_id": format!("bean-{k}"), "subject": format!("s{}", k / 2),
            "label": if k.is_multiple_of(2) { "even" } else { "odd" }, "labels": {"t": t}})
    };
    let shapes: Vec<Value> = (0..count).map(shape).collect();
    server.post(&format!("/v1/cohorts/{name}/shapes"), &json!({ "shapes": shapes })).expect(201);
}

fn correspond(server: &Server, cohort: &str, body: &Value) -> Value {
    let job = server.post(&format!("/v1/cohorts/{cohort}/correspond"), body).expect(202);
    assert_eq!(job["kind"], "correspond");
    finished(server, job["id"].as_str().unwrap())["result"].clone()
}

/// Explained part of the first mode of a cohort, and the name of its dictionary.
pub(crate) fn first_mode(server: &Server, cohort: &str) -> f64 {
    let method = json!({"kind": "functional_pca", "components": 4, "centre": true});
    let body = json!({"name": cohort, "cohort": cohort, "transformation": "rigid", "alignment": "procrustes", "method": method});
    finished(server, &submit(server, &body));
    let dictionary = server.get(&format!("/v1/dictionaries/{cohort}")).expect(200);
    dictionary["atoms"][0]["explained"].as_f64().unwrap()
}

#[test]
fn turned_surfaces_get_corresponding_parameters_in_a_new_cohort() {
    let server = shared();
    stored(&server, "beans", 10);
    let found = correspond(&server, "beans", &json!({"name": "beans-corresponding", "degree": 2}));
    assert_eq!((&found["shape_count"], &found["source_revision"]), (&json!(10), &json!(1)));
    assert_eq!((&found["name"], &found["revision"]), (&json!("beans-corresponding"), &json!(1)));
    for shape in found["shapes"].as_array().unwrap() {
        assert!(shape["folded"].as_f64().unwrap() <= 0.01, "{shape}");
        assert!(shape["relative_residual"].as_f64().unwrap() < 0.05, "{shape}");
        assert!(shape["least_jacobian"].as_f64().unwrap() > 0.0, "{shape}");
        assert!(shape["id"].as_str().unwrap().starts_with("shp_"), "{shape}");
    }
    let cohort = server.get("/v1/cohorts/beans-corresponding").expect(200);
    assert_eq!((&cohort["correspondence"], &cohort["length_unit"]), (&json!("landmarks"), &json!("mm")));
    assert_eq!(cohort["id"], found["cohort"]);
    let shape = server.get("/v1/cohorts/beans-corresponding/shapes/bean-3").expect(200);
    assert_eq!((&shape["subject"], &shape["label"]), (&json!("s1"), &json!("odd")));
    assert_eq!(shape["metadata"]["correspondence"]["cohort"], found["source"]);
    assert_eq!(shape["metadata"]["correspondence"]["shape"], found["shapes"][3]["source"]);
    let explained = first_mode(&server, "beans-corresponding");
    assert!(explained > 0.95, "{explained}");
    // The same request under another name finds the same bits.
    let again = correspond(&server, "beans", &json!({"name": "beans-again", "degree": 2}));
    assert_eq!(again["digest"], found["digest"]);
    // A new surface against the dictionary.
    let body = json!({"shapes": [{"points": bean(0.45, 1.0)}], "degree": 2});
    let path = "/v1/dictionaries/beans-corresponding/correspond";
    let answer = server.post(path, &body).expect(200);
    let new = &answer["results"][0];
    assert!(new["folded"].as_f64().unwrap() <= 0.01, "{new}");
    let distance = |shape: &Value| {
        let body = json!({"shapes": [shape]});
        let scored = server.post("/v1/dictionaries/beans-corresponding/score", &body).expect(200);
        scored["results"][0]["novelty"]["squared_prediction_error"]
            .as_f64()
            .unwrap_or_else(|| panic!("{scored}"))
    };
    let (before, after) =
        (distance(&body["shapes"][0]), distance(&json!({"control_points": new["control_points"]})));
    assert!(after < 0.1 * before, "{after} {before}");
}

#[test]
fn what_cannot_correspond_is_refused() {
    let server = shared();
    stored(&server, "few-beans", 3);
    let path = "/v1/cohorts/few-beans/correspond";
    let refused = |body: &Value, pointers: &[&str]| {
        server.post(path, body).expect_problem(422, "invalid-input", pointers);
    };
    refused(&json!({}), &["/name"]);
    refused(
        &json!({"name": "x y", "degree": 7, "rounds": 0, "stiffness": 0.0}),
        &["/name", "/degree", "/rounds", "/stiffness"],
    );
    refused(&json!({"name": "z", "degree": "four"}), &["/degree"]);
    server.post(path, &json!({"name": "few-beans"})).expect_problem(409, "name-taken", &["/name"]);
    let one = json!({"name": "one", "filter": {"labels": {"t": 0.0}}});
    server.post(path, &one).expect_problem(422, "too-few-shapes", &[]);
    // Shapes without parameters on a sphere.
    let curve = json!({"kind": "closed_curve", "dimension": 2, "control_points": 8, "generator": {"name": "trigonometric"}});
    server.post("/v1/cohorts", &json!({"name": "curves-apart", "representation": curve})).expect(201);
    let problem =
        server.post("/v1/cohorts/curves-apart/correspond", &json!({"name": "z", "method": "groupwise"}));
    let problem = problem.expect_problem(400, "invalid-query", &[]);
    assert!(problem.to_string().contains("topology sphere"), "{problem}");
    server.post("/v1/cohorts/no-such-beans/correspond", &json!({"name": "z"})).expect_problem(
        404,
        "not-found",
        &[],
    );
    // A flat surface encloses nothing: the job names it.
    let flat: Value = bean(0.1, 0.0)
        .as_array()
        .unwrap()
        .iter()
        .map(|line| line.as_array().unwrap().iter().map(|p| json!([p[0], p[1], 0.0])).collect::<Value>())
        .collect();
    let body = json!({"shapes": [{"points": flat, "external_id": "pancake"}]});
    server.post("/v1/cohorts/few-beans/shapes", &body).expect(201);
    let job = server.post(path, &json!({"name": "with-a-pancake"})).expect(202);
    let problem = finished(&server, job["id"].as_str().unwrap());
    assert!(problem["problem"].to_string().contains("pancake"), "{problem}");
    server.get("/v1/cohorts/with-a-pancake").expect(404);
}

/// A cohort of curves with a lobe that wanders along them; the points begin anywhere, and every other contour runs clockwise.
fn lobed(server: &Server, name: &str, count: usize) {
    let representation = json!({"kind": "closed_curve", "dimension": 2, "control_points": 40, "generator": {"name": "bspline", "degree": 3}});
    let body = json!({"name": name, "representation": representation, "correspondence": "cyclic", "length_unit": "mm"});
    server.post("/v1/cohorts", &body).expect(201);
    let shape = |k: usize| {
        json!({"points": lobe(k as f64 / count as f64 - 0.5, k, 160), "external_id": format!("lobe-{k}"), "label": "l",
            "labels": {"k": k}, "subject": format!("s{k}")})
    };
    let shapes: Vec<Value> = (0..count).map(shape).collect();
    server.post(&format!("/v1/cohorts/{name}/shapes"), &json!({ "shapes": shapes })).expect(201);
}

fn lobe(part: f64, k: usize, points: usize) -> Value {
    let point = |i: usize| {
        let t = TAU * (i + 13 * k) as f64 / points as f64;
        let t = if k % 2 == 1 { -t } else { t };
        let radius = 1.0
            + 0.35 * (-(8.0 * ((t - 2.0 - 0.8 * part) / 2.0).sin().powi(2))).exp()
            + 0.15 * (2.0 * t).cos();
        let (x, y) = (1.5 * radius * t.cos(), radius * t.sin());
        let (sin, cos) = (0.7 * k as f64).sin_cos();
        [cos * x - sin * y + 4.0, sin * x + cos * y]
    };
    json!((0..points).map(point).collect::<Vec<_>>())
}

#[test]
fn curves_follow_their_elastic_mean_in_a_new_cohort() {
    let server = shared();
    lobed(&server, "lobes", 9);
    let found = correspond(&server, "lobes", &json!({"name": "lobes-elastic", "control_points": 60}));
    let objective = found["objective"].as_f64().unwrap();
    assert!(objective > 0.98 && objective <= 1.0, "{objective}");
    let [before, after] = [0, 1].map(|i| found["variance"][i].as_f64().unwrap());
    assert!(before > 0.0 && after > 0.0, "{found}");
    let grown = found["warnings"]
        .as_array()
        .unwrap()
        .iter()
        .any(|text| text.to_string().contains("positions vary more"));
    assert_eq!(grown, after > before, "{}", found["warnings"]);
    for field in ["degree", "entropy", "stiffness"] {
        assert_eq!(found[field], Value::Null, "{field}");
    }
    for shape in found["shapes"].as_array().unwrap() {
        assert!(shape["relative_residual"].as_f64().unwrap() < 0.01, "{shape}");
        assert!(shape["distance"].as_f64().unwrap() < 0.3 && shape["mirrored"] == false, "{shape}");
        assert!(shape["slopes"][0].as_f64().unwrap() > 0.019, "{shape}");
        assert_eq!(shape["folded"], Value::Null);
    }
    let cohort = server.get("/v1/cohorts/lobes-elastic").expect(200);
    assert_eq!((&cohort["correspondence"], &cohort["length_unit"]), (&json!("landmarks"), &json!("mm")));
    assert_eq!(cohort["representation"]["control_points"], 60);
    let shape = server.get("/v1/cohorts/lobes-elastic/shapes/lobe-3").expect(200);
    assert_eq!((&shape["subject"], &shape["labels"]["k"]), (&json!("s3"), &json!(3)));
    let origin = &shape["metadata"]["correspondence"];
    assert_eq!((&origin["cohort"], origin["places"].as_array().unwrap().len()), (&found["source"], 101));
    // The same bits again, and in another order of the shapes.
    let again = correspond(
        &server,
        "lobes",
        &json!({"name": "lobes-again", "control_points": 60, "method": "elastic"}),
    );
    assert_eq!((&again["digest"], &again["objective"]), (&found["digest"], &found["objective"]));
    let best =
        correspond(&server, "lobes", &json!({"name": "lobes-starts", "control_points": 60, "starts": 3}));
    assert!(best["objective"].as_f64().unwrap() >= objective, "{} {objective}", best["objective"]);
    assert_eq!(best["starts"], 3);
    // New contours, with other numbers of points, get the parameters of a dictionary.
    let method = json!({"kind": "functional_pca", "components": 3, "centre": true});
    let body =
        json!({"name": "lobes", "cohort": "lobes-elastic", "transformation": "similarity", "method": method});
    finished(&server, &submit(&server, &body));
    let path = "/v1/dictionaries/lobes/correspond";
    let body = json!({"shapes": [{"points": lobe(0.1, 5, 311)}, {"points": lobe(-0.3, 2, 90)}]});
    let answer = server.post(path, &body).expect(200);
    let error = |shape: &Value| {
        let scored = server.post("/v1/dictionaries/lobes/score", &json!({"shapes": [shape]})).expect(200);
        scored["results"][0]["novelty"]["squared_prediction_error"]
            .as_f64()
            .unwrap_or_else(|| panic!("{scored}"))
    };
    for new in answer["results"].as_array().unwrap() {
        assert!(
            new["relative_residual"].as_f64().unwrap() < 0.01 && new["distance"].as_f64().unwrap() < 0.3,
            "{new}"
        );
        let after = error(&json!({"control_points": new["control_points"]}));
        // The contour as control points at equal lengths from where it begins.
        let fitted = json!({"control_points": lobe(0.1, 5, 60)});
        assert!(after < 0.2 * error(&fitted), "{after} {}", error(&fitted));
    }
    // Curves of a cohort whose correspondence is another one.
    let stored = server.post(path, &json!({"cohort": "lobes-elastic", "ids": ["lobe-1"]})).expect(200);
    assert!(stored["results"][0]["distance"].as_f64().unwrap() < 0.3);
}

#[test]
fn points_slide_along_curves_to_a_smaller_variance() {
    let server = shared();
    lobed(&server, "sliding-lobes", 9);
    let body = json!({"name": "lobes-slid", "method": "sliding", "control_points": 60});
    let found = correspond(&server, "sliding-lobes", &body);
    let [before, after] = [0, 1].map(|i| found["variance"][i].as_f64().unwrap());
    assert!(after < 0.9 * before, "{before} {after}");
    assert_eq!((&found["criterion"], &found["converged"]), (&json!("procrustes"), &json!(true)), "{found}");
    for shape in found["shapes"].as_array().unwrap() {
        assert!(shape["relative_residual"].as_f64().unwrap() < 0.01, "{shape}");
        assert!(
            shape["slopes"][0].as_f64().unwrap() > 0.2 && shape["slopes"][1].as_f64().unwrap() < 4.1,
            "{shape}"
        );
        assert_eq!(shape["distance"], Value::Null);
    }
    let bent =
        json!({"name": "lobes-bent", "method": "sliding", "criterion": "bending_energy", "points": 60});
    let bent = correspond(&server, "sliding-lobes", &bent);
    assert_eq!((&bent["criterion"], &bent["points"]), (&json!("bending_energy"), &json!(60)));
    let path = "/v1/cohorts/sliding-lobes/correspond";
    let misplaced = json!({"name": "z", "method": "sliding", "elasticity": 0.5, "starts": 2});
    server.post(path, &misplaced).expect_problem(422, "invalid-input", &["/elasticity", "/starts"]);
    let criterion = json!({"name": "z", "criterion": "procrustes"});
    server.post(path, &criterion).expect_problem(422, "invalid-input", &["/criterion"]);
}

#[test]
fn curves_that_cannot_follow_are_refused() {
    let server = shared();
    lobed(&server, "few-lobes", 3);
    let path = "/v1/cohorts/few-lobes/correspond";
    let refused = |body: &Value, pointers: &[&str]| {
        server.post(path, body).expect_problem(422, "invalid-input", pointers);
    };
    refused(&json!({"name": "z", "elasticity": 0.0}), &["/elasticity"]);
    refused(&json!({"name": "z", "points": 15, "starts": 21}), &["/points", "/starts"]);
    refused(&json!({"name": "z", "points": 100, "starts": 0}), &["/starts"]);
    refused(&json!({"name": "z", "method": "rigid"}), &["/method"]);
    refused(&json!({"name": "z", "degree": 3, "stiffness": 2.0}), &["/degree", "/stiffness"]);
    refused(&json!({"name": "z", "method": "groupwise", "points": 50}), &["/points"]);
    refused(&json!({"name": "z", "control_points": 7}), &["/control_points"]);
    refused(&json!({"name": "z", "control_points": 100_000_000}), &["/control_points"]);
    stored(&server, "beans-elastic", 3);
    let beans = "/v1/cohorts/beans-elastic/correspond";
    server.post(beans, &json!({"name": "z", "starts": 2})).expect_problem(422, "invalid-input", &["/starts"]);
    let problem = server.post(beans, &json!({"name": "z", "method": "elastic"}));
    assert!(problem.expect_problem(400, "invalid-query", &[]).to_string().contains("surfaces"));
    let landmarks =
        json!({"name": "points-apart", "representation": {"kind": "landmarks", "dimension": 2, "points": 9}});
    server.post("/v1/cohorts", &landmarks).expect(201);
    for method in ["elastic", "sliding"] {
        server
            .post("/v1/cohorts/points-apart/correspond", &json!({"name": "z", "method": method}))
            .expect_problem(400, "invalid-query", &[]);
    }
}
