//! Elastic distances and matches over HTTP against the real program.

use reqwest::Method;
use serde_json::{Value, json};

use crate::http_bad_input::{Differences, Wanted};
use crate::http_contract::cells;
use crate::http_dictionaries::finished;
use crate::server::{Reply, Server, Setting, flat, shared};

/// An egg, given by points that are closer where `warp` is larger, from the place `start`, turned and scaled.
fn egg(count: usize, [warp, start, angle, scale]: [f64; 4], mirrored: bool) -> Value {
    let tau = std::f64::consts::TAU;
    let point = |k: usize| {
        let t = k as f64 / count as f64;
        let u = tau * (t + start + warp * (tau * t).sin() / tau);
        let u = if mirrored { -u } else { u };
        let (x, y) =
            (2.0 * u.cos() + 0.4 * (2.0 * u).cos(), u.sin() + 0.2 * (3.0 * u).sin() + 0.25 * (2.0 * u).cos());
        let x = if mirrored { -x } else { x };
        [scale * (angle.cos() * x - angle.sin() * y) + 3.0, scale * (angle.sin() * x + angle.cos() * y) - 7.0]
    };
    json!((0..count).map(point).collect::<Vec<_>>())
}

fn curves(count: usize) -> Value {
    json!({"kind": "closed_curve", "dimension": 2, "control_points": count, "generator": {"name": "bspline", "degree": 3}})
}

/// Two copies of an egg and another curve.
fn posted() -> Value {
    copies(80, 300)
}

/// As [`posted`], as `control_points` of so many points: what a curve loses by them is no distance of copies.
fn copies(control_points: usize, points: usize) -> Value {
    let triangle: Value =
        json!([[0, 0], [4, 0], [4.5, 0.5], [4.2, 1], [0.5, 3], [0, 3], [-0.3, 2], [-0.2, 1]]);
    json!({"representation": curves(control_points), "correspondence": "elastic", "shapes": [
        {"points": egg(points, [0.0, 0.0, 0.0, 1.0], false)},
        {"points": egg(points, [0.4, 0.3, 1.1, 6.0], false)},
        {"points": triangle}
    ]})
}

fn with(body: &Value, more: Value) -> Value {
    let mut body = body.clone();
    for (field, value) in more.as_object().unwrap() {
        body[field] = value.clone();
    }
    body
}

fn elastic(more: Value) -> Value {
    with(&json!({"cohort": "example-cells", "correspondence": "elastic", "effort": "fast"}), more)
}

fn matrix(body: &Value) -> Value {
    shared().post("/v1/distances", body).expect(200)
}

#[test]
fn copies_are_at_no_distance_and_exchanged_shapes_at_the_same() {
    let body = copies(240, 3000);
    let answer = matrix(&body);
    let numbers = flat(&answer["distances"]);
    assert!(numbers[1] < 1e-3, "{numbers:?}");
    assert!(numbers[2] > 0.1 && numbers[2] < 1.6 && (numbers[2] - numbers[5]).abs() < 0.01, "{numbers:?}");
    assert!((0..9).all(|k| numbers[k] == numbers[k % 3 * 3 + k / 3]));
    let mut turned = body.clone();
    turned["shapes"].as_array_mut().unwrap().reverse();
    let mut reversed = flat(&matrix(&turned)["distances"]);
    reversed.reverse();
    assert_eq!(reversed, numbers, "bit for bit");

    let mirrored = json!([body["shapes"][0], {"points": egg(3000, [0.2, 0.1, 2.0, 2.0], true)}]);
    let both = |mirror: &str| {
        flat(&matrix(&with(&body, json!({"shapes": mirrored, "mirror": mirror})))["distances"])[1]
    };
    // Control points of contours that are cut at other places are no exact copies.
    assert!(both("allow") < 4e-3 && both("forbid") > 0.05, "{} {}", both("allow"), both("forbid"));
    let fixed = flat(&matrix(&with(&body, json!({"rotation": false})))["distances"]);
    assert!(fixed[1] > 0.3, "{fixed:?}");
    let soft = flat(&matrix(&with(&body, json!({"elasticity": 0.3})))["distances"]);
    assert!(soft[2] < numbers[2] && soft[1] < 1e-3, "{soft:?}");
    let thorough = flat(&matrix(&with(&body, json!({"effort": "thorough", "points": 200})))["distances"]);
    assert!((thorough[2] - numbers[2]).abs() < 0.03, "{thorough:?}");
}

#[test]
fn cohorts_are_compared_in_every_format_at_once_or_by_a_job() {
    let server = Setting::fresh().with_example().start();
    let ids: Vec<Value> = cells().iter().take(30).map(|cell| cell["external_id"].clone()).collect();
    let body = elastic(json!({"ids": ids}));
    let answer = server.post("/v1/distances", &body).expect(200);
    assert_eq!((&answer["ids"], answer["cohort_revision"].is_u64()), (&json!(ids), true));
    let numbers = flat(&answer["distances"]);
    let in_format = |server: &Server, format: &str| -> Reply {
        let path = format!("/v1/distances?format={format}");
        server.send(server.request(Method::POST, &path).header("prefer", "wait=50").json(&body))
    };
    let npy = in_format(&server, "npy").body;
    let (bytes, _) = npy[npy.len() - 8 * 900..].as_chunks();
    assert_eq!(bytes.iter().map(|bytes| f64::from_le_bytes(*bytes)).collect::<Vec<f64>>(), numbers);
    let csv = in_format(&server, "csv");
    let read: Vec<f64> = csv
        .text()
        .lines()
        .skip(1)
        .flat_map(|line| line.split(',').map(|n| n.parse::<f64>().unwrap()))
        .collect();
    assert_eq!(read, numbers);
    for format in ["arrow", "parquet"] {
        assert_eq!(in_format(&server, format).status, 200, "{format}");
    }
    // A filter that selects these and others gives the same distances.
    let all = server.post("/v1/distances", &elastic(json!({"filter": {"labels": {"cell_line": "dunn"}}})));
    assert_eq!(all.status, 200, "{}", all.text());

    let jobs = Setting::fresh().with_example().flags(&["--max-matrix-operations", "1"]).start();
    let job = jobs.post("/v1/distances", &body).expect(202);
    let done = finished(&jobs, job["id"].as_str().unwrap());
    assert_eq!(
        (&done["status"], &done["result"]["shape_count"]),
        (&json!("succeeded"), &json!(30)),
        "{done}"
    );
    let path = done["result"]["output"].as_str().unwrap();
    assert_eq!(jobs.get(&format!("{path}?format=npy")).body, npy, "the same bits as at once");
    assert_eq!(in_format(&jobs, "npy").body, npy);
}

#[test]
fn a_match_tells_what_corresponds() {
    let two = |second: Value| json!({"representation": curves(240), "shapes": [{"points": egg(3000, [0.0, 0.0, 0.0, 1.0], false)}, {"points": second}]});
    let body = two(egg(3000, [0.4, 0.3, 1.1, 6.0], false));
    let found = shared().post("/v1/match", &body).expect(200);
    assert!(found["distance"].as_f64().unwrap() < 1e-3, "{}", found["distance"]);
    assert_eq!((&found["mirrored"], &found["reversed"]), (&json!(false), &json!(false)));
    let map: Vec<f64> = serde_json::from_value(found["map"].clone()).unwrap();
    assert!(map.len() == 101 && map.is_sorted() && (map[100] - map[0] - 1.0).abs() < 1e-12);
    assert_eq!(found["start"], map[0]);
    // A copy is parametrised otherwise, and its places are at the same fractions of the length.
    let places: Vec<f64> = map.iter().enumerate().map(|(k, t)| t - map[0] - k as f64 / 100.0).collect();
    assert!(places.iter().all(|apart| apart.abs() < 0.01), "{places:?}");
    let rotation = flat(&found["rotation"]);
    assert!(
        (rotation[0] - 1.1_f64.cos()).abs() < 0.01 && (rotation[1] - 1.1_f64.sin()).abs() < 0.01,
        "{rotation:?}"
    );
    for (a, b) in flat(&found["curves"][0]).chunks(2).zip(flat(&found["curves"][1]).chunks(2)) {
        let back = [b[0] - 3.0, b[1] + 7.0].map(|x| x / 6.0);
        let turned =
            [rotation[0] * back[0] + rotation[1] * back[1], rotation[2] * back[0] + rotation[3] * back[1]];
        assert!(
            (turned[0] - a[0] + 3.0).abs() < 0.05 && (turned[1] - a[1] - 7.0).abs() < 0.05,
            "{a:?} {turned:?}"
        );
    }
    let mirrored = with(&two(egg(3000, [0.2, 0.1, 2.0, 2.0], true)), json!({"mirror": "allow"}));
    let found = shared().post("/v1/match", &mirrored).expect(200);
    assert_eq!((&found["mirrored"], found["distance"].as_f64().unwrap() < 4e-3), (&json!(true), true));
    let open = json!({"kind": "open_curve", "dimension": 3, "intervals": 20, "generator": {"name": "cubic"}});
    let arc = |bend: f64| -> Value {
        let point = |k: usize| {
            let t = k as f64 / 60.0;
            [t, bend * (3.0 * t).sin(), bend * t * t]
        };
        json!({"points": (0..=60).map(point).collect::<Vec<_>>()})
    };
    let body = json!({"representation": open, "shapes": [arc(0.2), arc(0.4)], "points": 50});
    let found = shared().post("/v1/match", &body).expect(200);
    let map: Vec<f64> = serde_json::from_value(found["map"].clone()).unwrap();
    assert_eq!((map.len(), map[0], map[50]), (51, 0.0, 1.0));
    assert_eq!(found["curves"][0].as_array().unwrap().len(), 51);
    for (format, start) in [("svg", &b"<svg"[..]), ("png", &b"\x89PNG"[..])] {
        for body in [&mirrored, &body] {
            let drawn = shared().post(&format!("/v1/match?format={format}"), body);
            assert!(drawn.status == 200 && drawn.body.starts_with(start), "{}", drawn.text());
        }
    }
}

#[test]
fn what_has_no_elastic_distance_is_refused() {
    let server = Setting::fresh().with_example().start();
    let surface = json!({"kind": "surface", "topology": "torus", "control_points": [6, 6]});
    let landmarks = json!({"kind": "landmarks", "dimension": 2, "points": 8});
    let grid: Vec<Vec<[f64; 3]>> =
        (0..6).map(|i| (0..6).map(|j| [f64::from(i), f64::from(j), f64::from(i * j)]).collect()).collect();
    let body = posted();
    let affine = json!({"transformation": "affine"});
    let point = json!([{"control_points": vec![[1.0, 2.0]; 80]}]);
    let mut still: Vec<[f64; 2]> = (0..80).map(|k| [f64::from(k % 9), f64::from(k * k % 7)]).collect();
    (11..16).for_each(|k| still[k] = still[10]);
    let still = json!([body["shapes"][0], {"control_points": still}]);
    let cases = [
        ("/v1/distances", with(&body, affine.clone()), Wanted::invalid(&["/transformation"])),
        ("/v1/distances", elastic(affine), Wanted::invalid(&["/transformation"])),
        (
            "/v1/distances",
            elastic(json!({"transformation": "similarity", "alignment": "projection"})),
            Wanted::invalid(&["/alignment"]),
        ),
        ("/v1/distances", elastic(json!({"elasticity": 0})), Wanted::invalid(&["/elasticity"])),
        ("/v1/distances", elastic(json!({"elasticity": 1.01})), Wanted::invalid(&["/elasticity"])),
        ("/v1/distances", elastic(json!({"points": 15})), Wanted::invalid(&["/points"])),
        ("/v1/distances", elastic(json!({"points": 1001})), Wanted::invalid(&["/points"])),
        ("/v1/distances", elastic(json!({"effort": "great"})), Wanted::invalid(&["/effort"])),
        ("/v1/distances", elastic(json!({"rotation": 1})), Wanted::invalid(&["/rotation"])),
        (
            "/v1/distances",
            json!({"cohort": "example-cells", "transformation": "similarity", "elasticity": 1, "points": 100, "rotation": true, "effort": "fast"}),
            Wanted::invalid(&["/elasticity", "/points", "/rotation", "/effort"]),
        ),
        ("/v1/distances", json!({"cohort": "example-cells"}), Wanted::invalid(&["/transformation"])),
        (
            "/v1/distances",
            json!({"cohort": "example-cells", "correspondence": "bogus", "effort": "fast", "points": 50}),
            Wanted::invalid(&["/correspondence"]),
        ),
        (
            "/v1/distances",
            json!({"cohort": "example-cells", "correspondence": "cyclic", "transformation": "similarity"}),
            Wanted::invalid(&["/correspondence"]),
        ),
        (
            "/v1/distances",
            with(&body, json!({"representation": curves(7)})),
            Wanted::invalid(&["/representation"]),
        ),
        (
            "/v1/distances",
            with(&body, json!({"representation": surface, "shapes": [{"points": grid}]})),
            Wanted::invalid(&["/representation"]),
        ),
        (
            "/v1/distances",
            with(&body, json!({"representation": landmarks, "shapes": [{"points": vec![[0, 1]; 8]}]})),
            Wanted::invalid(&["/representation"]),
        ),
        ("/v1/distances", with(&body, json!({"shapes": still})), Wanted::invalid(&["/shapes/1"])),
        ("/v1/distances", with(&body, json!({"shapes": point})), Wanted::invalid(&["/shapes/0"])),
        ("/v1/match", with(&match_body(), json!({"shapes": [{}]})), Wanted::invalid(&["/shapes"])),
        ("/v1/match", with(&match_body(), json!({"elasticity": 2})), Wanted::invalid(&["/elasticity"])),
        ("/v1/match", with(&match_body(), json!({"points": 3})), Wanted::invalid(&["/points"])),
        (
            "/v1/match",
            with(&match_body(), json!({"representation": curves(6)})),
            Wanted::invalid(&["/representation"]),
        ),
        ("/v1/match", with(&match_body(), json!({"colour": "red"})), Wanted::invalid(&["/colour"])),
    ];
    let mut differences = Differences::default();
    for (path, body, wanted) in &cases {
        let mut text = body.to_string();
        text.truncate(300);
        differences.compare(&text, &server.post(path, body), wanted);
    }
    drop(differences);
    let refusal = server.post("/v1/distances", &with(&body, json!({"shapes": still})));
    let detail = refusal.expect_problem(422, "invalid-input", &["/shapes/1"])["errors"][0]["detail"].clone();
    assert!(
        detail.as_str().unwrap().starts_with("expected no stretch without length, got one of "),
        "{detail}"
    );
    server.post("/v1/cohorts", &json!({"name": "marks", "representation": landmarks})).expect(201);
    server
        .post("/v1/cohorts/marks/shapes", &json!({"shapes": [{"points": [[0, 0], [1, 0], [2, 1], [2, 2], [1, 3], [0, 3], [-1, 2], [-1, 1]]}]}))
        .expect(201);
    let of_landmarks = json!({"cohort": "marks", "correspondence": "elastic"});
    let problem =
        server.post("/v1/distances", &of_landmarks).expect_problem(422, "invalid-input", &["/cohort"]);
    assert!(problem["detail"].as_str().unwrap().contains("landmarks, which have no order"), "{problem}");
    server
        .post(
            "/v1/cohorts",
            &json!({"name": "stills", "correspondence": "cyclic", "representation": curves(80)}),
        )
        .expect(201);
    server.post("/v1/cohorts/stills/shapes", &json!({"shapes": still})).expect(201);
    let problem = server
        .post("/v1/distances", &json!({"cohort": "stills", "correspondence": "elastic"}))
        .expect_problem(422, "invalid-input", &[""]);
    assert!(problem["detail"].as_str().unwrap().contains("of the cohort 'stills'"), "{problem}");
    server.assert_alive();
}

fn match_body() -> Value {
    json!({"representation": curves(16), "shapes": [
        {"points": egg(40, [0.0, 0.0, 0.0, 1.0], false)}, {"points": egg(40, [0.2, 0.1, 0.5, 2.0], false)}]})
}

#[test]
fn a_search_answers_the_nearest_curves_by_elastic_distances() {
    let server = Setting::fresh().with_example().start();
    let filter = json!({"label": "dlm8/control"});
    let all =
        server.post("/v1/distances", &elastic(json!({"mirror": "allow", "filter": filter}))).expect(200);
    let names: Vec<&str> = all["ids"].as_array().unwrap().iter().map(|id| id.as_str().unwrap()).collect();
    let usual = json!({"ids": names[..2], "neighbours": 4, "correspondence": "elastic", "effort": "fast", "filter": filter});
    let search = |more: Value| server.post("/v1/cohorts/example-cells/search", &with(&usual, more));
    let found = search(json!({"candidates": 1000, "mirror": "allow"})).expect(200);
    for (row, result) in found["results"].as_array().unwrap().iter().enumerate() {
        let distance = |k: usize| all["distances"][row][k].as_f64().unwrap();
        let mut wanted: Vec<usize> = (0..names.len()).filter(|k| *k != row).collect();
        wanted.sort_by(|a, b| distance(*a).total_cmp(&distance(*b)));
        let neighbours = result["neighbours"].as_array().unwrap();
        assert_eq!(neighbours.len(), 4);
        for (neighbour, k) in neighbours.iter().zip(wanted) {
            assert_eq!(
                (&neighbour["external_id"], &neighbour["distance"]),
                (&json!(names[k]), &json!(distance(k)))
            );
        }
    }
    assert!(!found["warnings"].to_string().contains("compared elastically"), "{}", found["warnings"]);
    // Work is that of the shapes that there are, not of the candidates that may be asked for.
    let many = json!({"ids": names[..16], "candidates": 1000, "mirror": "allow", "effort": "thorough"});
    search(many).expect(200);
    let few = search(json!({"candidates": 5})).expect(200);
    assert!(few["warnings"].to_string().contains("only the 5 shapes nearest"), "{}", few["warnings"]);
    let drawing = server.post("/v1/cohorts/example-cells/search?format=svg", &usual);
    assert!(drawing.status == 200 && drawing.text().contains("<svg"));
    // A posted copy of a stored curve, turned, is at no distance from it.
    let stored = server.get(&format!("/v1/cohorts/example-cells/shapes/{}", names[1])).expect(200);
    let points = stored["control_points"].as_array().unwrap().iter();
    let turned: Value = points.map(|p| json!([-p[1].as_f64().unwrap(), p[0].as_f64().unwrap()])).collect();
    let body = json!({"shapes": [{"control_points": turned}], "neighbours": 1, "correspondence": "elastic"});
    let own = server.post("/v1/cohorts/example-cells/search", &body).expect(200);
    let nearest = &own["results"][0]["neighbours"][0];
    assert!(nearest["external_id"] == names[1] && nearest["distance"].as_f64().unwrap() < 1e-3, "{nearest}");
    for (more, pointer) in [
        (json!({"candidates": 0}), "/candidates"),
        (json!({"candidates": 1001}), "/candidates"),
        (json!({"elasticity": 2}), "/elasticity"),
        (json!({"correspondence": "cyclic"}), "/correspondence"),
        (json!({"transformation": "affine"}), "/transformation"),
    ] {
        search(more).expect_problem(422, "invalid-input", &[pointer]);
    }
    let plain = json!({"ids": names[..2], "points": 50, "candidates": 10});
    let plain = server.post("/v1/cohorts/example-cells/search", &plain);
    plain.expect_problem(422, "invalid-input", &["/candidates", "/points"]);
}
