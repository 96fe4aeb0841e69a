//! One cohort, one answer: on any number of threads, on SQLite and on PostgreSQL.

use serde_json::{Value, json};

use crate::http_dictionaries::{finished, submit};
use crate::server::{Server, Setting};

const POINTS: usize = 8;
/// Shapes of the cohort of means and dictionaries: more than a part of 8192.
const MANY: usize = 9000;
/// Shapes of the cohort of distances.
const FEW: usize = 150;

/// Contours with two bumps, each from a start point of its own.
fn contours(count: usize) -> Vec<Value> {
    let mut state = 5_u64;
    let mut noise = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
    };
    let contour = |k| {
        let (start, low, high) = (noise(), noise(), noise());
        let point = |i: usize| {
            let t = std::f64::consts::TAU * (i as f64 / POINTS as f64 + start);
            let r = 2.0 + low * (2.0 * t).cos() + 0.5 * high * (3.0 * t).sin() + 0.05 * noise();
            [r * t.cos(), 0.7 * r * t.sin()]
        };
        let points: Vec<[f64; 2]> = (0..POINTS).map(point).collect();
        json!({"external_id": format!("s{k}"), "points": points})
    };
    (0..count).map(contour).collect()
}

fn stored(server: &Server, name: &str, correspondence: &str, shapes: &[Value]) {
    let representation = json!({"kind": "closed_curve", "dimension": 2, "control_points": POINTS,
        "generator": {"name": "trigonometric"}});
    let cohort = json!({"name": name, "representation": representation, "correspondence": correspondence});
    server.post("/v1/cohorts", &cohort).expect(201);
    for piece in shapes.chunks(3001) {
        server.post_lines(&format!("/v1/cohorts/{name}/shapes"), piece).expect(201);
    }
}

fn digest(server: &Server, name: &str, cohort: &str, method: &Value) -> Vec<u8> {
    let body = json!({"name": name, "cohort": cohort, "transformation": "similarity", "method": method});
    let done = finished(server, &submit(server, &body));
    assert_eq!(done["status"], "succeeded", "{done}");
    done["result"]["digest"].as_str().unwrap().into()
}

/// Everything that is compared, by name.
fn answers(setting: Setting, threads: &str) -> Vec<(String, Vec<u8>)> {
    let server = setting.flags(&["--threads", threads]).start();
    let shapes = contours(MANY);
    stored(&server, "given", "landmarks", &shapes);
    stored(&server, "cyclic", "cyclic", &shapes[..FEW]);
    let mut found = Vec::new();
    for (cohort, class) in
        [("given", "similarity"), ("given", "affine"), ("cyclic", "similarity"), ("cyclic", "affine")]
    {
        let mean = server.get(&format!("/v1/cohorts/{cohort}/mean?transformation={class}"));
        mean.expect(200);
        found.push((format!("mean of {cohort}, {class}"), mean.body));
        let robust = server.get(&format!("/v1/cohorts/{cohort}/mean?transformation={class}&robust=true"));
        robust.expect(200);
        // Ids are drawn anew on every server.
        let (mean, counts) =
            (robust.json()["mean"].clone(), robust.json()["robust"]["effective_count"].clone());
        found.push((format!("robust mean of {cohort}, {class}"), format!("{mean} {counts}").into()));
        let body = json!({"cohort": "cyclic", "transformation": class});
        let request = server.request(reqwest::Method::POST, "/v1/distances?format=npy");
        let matrix = server.send(request.header("prefer", "wait=50").json(&body));
        assert_eq!(matrix.status, 200, "{}", matrix.text());
        found.push((format!("distances, {class}"), matrix.body));
    }
    for (name, cohort, method) in [
        ("components", "given", json!({"kind": "functional_pca", "components": 5, "centre": true})),
        ("lasso", "given", json!({"kind": "sparse", "atoms": 6, "lambda": 0.05, "max_epochs": 3})),
        ("pursuit", "cyclic", json!({"kind": "sparse", "atoms": 6, "nonzeros": 2})),
        ("invariant", "cyclic", json!({"kind": "sparse", "atoms": 4, "nonzeros": 2, "codes": "invariant"})),
    ] {
        found.push((format!("dictionary, {name}"), digest(&server, name, cohort, &method)));
    }
    let body = json!({"name": "robust", "cohort": "given", "transformation": "similarity", "robust": true,
        "method": {"kind": "functional_pca", "components": 5, "centre": true}});
    let done = finished(&server, &submit(&server, &body));
    found.push(("robust dictionary".into(), done["result"]["digest"].to_string().into()));
    let components = json!({"kind": "functional_pca", "components": 5, "centre": true});
    digest(&server, "reported", "cyclic", &components);
    let measurements =
        json!([{"name": "length", "measure": {"kind": "distance", "between": [0, 0.5]}, "values": [4]}]);
    let body = json!({"draws": 100, "resamples": 30, "measurements": measurements});
    let report = server.post("/v1/dictionaries/reported/report", &body).expect(200);
    for part in ["mean_only", "modes", "learning_curve", "measurements"] {
        found.push((format!("report, {part}"), report[part].to_string().into()));
    }
    let search = json!({"shapes": [{"points": shapes[FEW]["points"]}], "neighbours": 20});
    let answer = server.post("/v1/cohorts/cyclic/search", &search).expect(200);
    let nearest = answer["results"][0]["neighbours"].as_array().unwrap();
    assert_eq!(nearest.len(), 20);
    let bits = nearest.iter().map(|n| format!("{} {} {}", n["external_id"], n["distance"], n["start"]));
    found.push(("search".into(), bits.collect::<Vec<_>>().join("\n").into()));
    found
}

#[test]
fn means_distances_and_dictionaries_have_the_same_bits_on_any_threads_and_databases() {
    let one = answers(Setting::fresh().embedded(), "1");
    // On PostgreSQL where the tests have one.
    let others = [
        ("embedded, two threads", answers(Setting::fresh().embedded(), "2")),
        ("embedded, eight threads", answers(Setting::fresh().embedded(), "8")),
        ("two threads", answers(Setting::fresh(), "2")),
        ("eight threads", answers(Setting::fresh(), "8")),
    ];
    for (what, other) in others {
        for ((name, expected), (_, found)) in one.iter().zip(&other) {
            assert!(
                expected == found,
                "{name} on {what}: expected {}, got {}",
                String::from_utf8_lossy(&expected[..expected.len().min(500)]),
                String::from_utf8_lossy(&found[..found.len().min(500)])
            );
        }
    }
}
