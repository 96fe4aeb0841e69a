//! Drawings over HTTP: weight, settings of the viewer, what is refused.

use reqwest::Method;
use reqwest::header::ACCEPT;
use serde_json::{Value, json};

use crate::server::{Reply, Server, Setting};

const CELLS: &str = "/v1/cohorts/example-cells";

fn landmarks(seed: usize) -> Value {
    let at =
        |k: usize| [(k * k) as f64 + 0.1 * (seed * k % 3) as f64, (3 * k) as f64 - 0.2 * (seed % 4) as f64];
    json!({"points": (0..5).map(at).collect::<Vec<_>>(), "external_id": format!("l{seed}")})
}

/// A server with the example cohort, a dictionary of it, and a cohort of landmarks in millimetres.
fn server() -> Server {
    let server = Setting::fresh().with_example().start();
    let dictionary = json!({"name": "cells", "cohort": "example-cells", "transformation": "similarity",
        "method": {"kind": "functional_pca", "components": 4}});
    let request =
        server.request(Method::POST, "/v1/dictionaries").header("prefer", "wait=50").json(&dictionary);
    server.send(request).expect(201);
    let cohort = json!({"name": "marks", "correspondence": "landmarks", "length_unit": "mm",
        "representation": {"kind": "landmarks", "dimension": 2, "points": 5}});
    server.post("/v1/cohorts", &cohort).expect(201);
    let shapes: Vec<Value> = (0..12).map(landmarks).collect();
    server.post("/v1/cohorts/marks/shapes", &json!({ "shapes": shapes })).expect(201);
    server
}

/// Every route that draws, with a body where one is posted.
fn drawn() -> Vec<(&'static str, Option<Value>)> {
    let curve = json!({"kind": "closed_curve", "dimension": 2, "control_points": 4,
        "generator": {"name": "trigonometric"}});
    let ring = |a: f64, b: f64| json!({"points": [[a, 0.0], [0.0, b], [-a, 0.5], [0.0, -b]]});
    let shapes = json!([ring(2.0, 1.0), ring(1.0, 1.5), ring(1.2, 0.7)]);
    let statistics = json!({"representation": curve, "transformation": "similarity", "shapes": shapes});
    let morph = json!({"representation": curve, "from": ring(2.0, 1.0), "to": ring(1.0, 3.0)});
    let polyline = json!({"scheme": "normal_based", "level": 3, "polyline": {"points": [[0, 0], [2, 0], [2, 1], [0, 1]]}});
    vec![
        ("/v1/cohorts/example-cells/mean?transformation=similarity", None),
        ("/v1/cohorts/marks/shapes/l1", None),
        ("/v1/dictionaries/cells/atoms", None),
        ("/v1/dictionaries/cells/modes?component=2&sigma=1.5", None),
        ("/v1/generators/keys?control_points=8", None),
        ("/v1/mean", Some(statistics.clone())),
        ("/v1/align", Some(statistics.clone())),
        ("/v1/pca?component=1", Some(statistics)),
        ("/v1/evaluate", Some(json!({"representation": curve, "shapes": shapes}))),
        ("/v1/morph", Some(morph)),
        ("/v1/subdivide", Some(polyline)),
        (
            "/v1/comparisons",
            Some(json!({"cohort": "example-cells", "by": "labels.treatment", "permutations": 19})),
        ),
        (
            "/v1/regressions",
            Some(json!({"cohort": "example-cells", "attribute": "log_centroid_size", "permutations": 19})),
        ),
    ]
}

fn ask(server: &Server, path: &str, query: &str, body: Option<&Value>) -> Reply {
    let path = format!("{path}{}{query}", if path.contains('?') { '&' } else { '?' });
    match body {
        Some(body) => server.send(server.request(Method::POST, &path).header("prefer", "wait=50").json(body)),
        None => server.get(&path),
    }
}

/// Checks that every element ends where its parent does.
fn assert_nested(svg: &str) {
    let mut open = Vec::new();
    for tag in svg.split('<').skip(1) {
        let (tag, _) = tag.split_once('>').expect("a tag ends");
        let name = tag.split([' ', '/']).find(|name| !name.is_empty()).unwrap_or_default();
        match (tag.starts_with('/'), tag.ends_with('/')) {
            (true, _) => assert_eq!(open.pop(), Some(name), "{tag}"),
            (false, true) => {}
            (false, false) => open.push(name),
        }
        assert_eq!(tag.matches('"').count() % 2, 0, "{tag}");
    }
    assert!(open.is_empty(), "{open:?}");
}

#[test]
fn every_drawing_obeys_the_settings_of_its_viewer() {
    let server = server();
    let settings = "format=svg&theme=dark&background=none&width=200&title=false&scale_bar=false";
    for (path, body) in drawn() {
        let usual = ask(&server, path, "format=svg", body.as_ref());
        let usual = usual.expect_svg();
        assert_nested(usual);
        assert!(usual.contains("prefers-color-scheme:dark") && usual.contains("<rect y=\"-28\""), "{path}");
        assert!(usual.contains(" width=\"640\""), "{path}");
        let bare = ask(&server, path, settings, body.as_ref());
        let bare = bare.expect_svg();
        assert_nested(bare);
        assert!(
            !bare.contains("<style") && bare.contains(" width=\"200\"") && bare.contains("<title>"),
            "{path}"
        );
        assert!(
            !bare.contains("height=\"100%\"") && bare.contains("#e8e8e8"),
            "{path}: no page, light lines"
        );
        assert!(bare.len() < usual.len(), "{path}: {} of {}", bare.len(), usual.len());
    }
}

#[test]
fn settings_are_refused_where_they_mean_nothing() {
    let server = server();
    for (path, body) in drawn() {
        for (query, says) in [
            ("format=svg&theme=blue", "theme"),
            ("format=svg&background=white", "background"),
            ("format=svg&width=15", "between 16 and 4096"),
            ("format=svg&width=4097", "between 16 and 4096"),
            ("format=svg&width=wide", "width"),
            ("format=svg&title=no", "title"),
            ("format=svg&scale_bar=1", "scale_bar"),
            ("format=svg&theme=dark&theme=light", "twice"),
            ("format=svg&colour=red", "colour"),
            ("theme=dark", "only with the format svg"),
            ("format=json&scale_bar=false", "only with the format svg"),
        ] {
            let reply = ask(&server, path, query, body.as_ref());
            let detail = reply.expect_problem(400, "invalid-query", &[])["detail"].to_string();
            assert!(detail.contains(says), "{path} {query}: {detail}");
        }
    }
    server.get("/v1/cohorts?theme=dark").expect_problem(400, "invalid-query", &[]);
    let pictures = server.request(Method::GET, &format!("{CELLS}/mean?transformation=similarity&width=99"));
    server.send(pictures.header(ACCEPT, "image/svg+xml")).expect_svg();
}

#[test]
fn the_mean_of_the_example_is_light() {
    let server = Setting::fresh().with_example().start();
    let path = format!("{CELLS}/mean?transformation=similarity&format=svg");
    let reply = server.get(&path);
    assert!(reply.expect_svg().len() <= 200_000, "{} bytes", reply.text().len());
    assert!(reply.text().contains(">120 shapes<"), "the legend counts");
    let small = server.get(&format!("{path}&width=160"));
    assert!(small.expect_svg().len() <= 120_000, "{} bytes", small.text().len());
    assert_ne!(reply.header("etag"), small.header("etag"));
}

#[test]
fn drawings_of_shapes_with_their_sizes_have_a_scale_bar() {
    let server = server();
    let shape = server.get("/v1/cohorts/marks/shapes/l1?format=svg");
    assert!(shape.expect_svg().contains(" mm</text>"), "{}", shape.text());
    let without = server.get("/v1/cohorts/marks/shapes/l1?format=svg&scale_bar=false");
    assert!(!without.expect_svg().contains(" mm</text>"));
    for (query, has_bar) in [
        ("transformation=rigid&alignment=procrustes", true),
        ("transformation=translation", true),
        ("transformation=similarity", false),
    ] {
        let mean = server.get(&format!("/v1/cohorts/marks/mean?{query}&format=svg"));
        assert_eq!(mean.expect_svg().contains(" mm</text>"), has_bar, "{query}");
    }
}
