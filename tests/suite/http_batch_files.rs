//! Files of other programs in requests about shapes: read as the lines that a translation makes of them.

use serde_json::{Value, json};

use crate::form::label_picture;
use crate::server::{Reply, Server, Setting, shared};

const ANY: &str = "application/octet-stream";

/// A polygon with a hole, and another one.
fn map() -> String {
    let ring = |scale: f64| -> Vec<[f64; 2]> {
        let corners = [[0.0, 0.0], [4.0, 0.0], [5.0, 3.0], [1.0, 4.0], [0.0, 0.0]];
        corners.iter().map(|[x, y]| [1.0 + scale * x, 1.0 + scale * y]).collect()
    };
    let feature = |id: &str, rings: Vec<Vec<[f64; 2]>>| json!({"type": "Feature", "id": id, "properties": {}, "geometry": {"type": "Polygon", "coordinates": rings}});
    let hole: Vec<[f64; 2]> = ring(0.2).into_iter().rev().collect();
    json!({"type": "FeatureCollection", "features": [feature("first", vec![ring(1.0), hole]), feature("second", vec![ring(2.0)])]})
        .to_string()
}

fn post(server: &Server, path: &str, media_type: &str, file: &[u8]) -> Reply {
    server.post_bytes(path, media_type, file.to_vec())
}

/// Results without the names of shapes.
fn results(answer: &Value) -> Vec<Value> {
    let without = |mut one: Value| {
        one.as_object_mut().unwrap().remove("external_id");
        one
    };
    answer["results"].as_array().unwrap().iter().cloned().map(without).collect()
}

#[test]
fn files_are_answered_as_their_translation_is() {
    let server = Setting::fresh().with_example().start();
    let learn = json!({"name": "cells", "cohort": "example-cells", "transformation": "similarity",
        "method": {"kind": "functional_pca", "components": 3}});
    let learn =
        server.request(reqwest::Method::POST, "/v1/dictionaries").header("prefer", "wait=60").json(&learn);
    server.send(learn).expect(201);
    let measure = "representation={\"kind\":\"closed_curve\",\"dimension\":2,\"control_points\":8,\"generator\":{\"name\":\"trigonometric\"}}\
                   &correspondence=arc_length";
    let files = [("application/geo+json", map().into_bytes(), 2), ("image/png", label_picture(), 3)];
    let paths = [
        "/v1/dictionaries/cells/assess?samples=4".to_owned(),
        "/v1/dictionaries/cells/score?quantile=0.95".to_owned(),
        "/v1/dictionaries/cells/encode?".to_owned(),
        format!("/v1/measure?{measure}"),
    ];
    for (media_type, file, count) in &files {
        let lines = post(&server, "/v1/convert?to=ndjson", media_type, file).body;
        let alone = |line: &str| {
            let mut shape: Value = serde_json::from_str(line).unwrap();
            shape.as_object_mut().unwrap().remove("ring");
            format!("{shape}\n")
        };
        let lines: String = std::str::from_utf8(&lines).unwrap().lines().map(alone).collect();
        for path in &paths {
            let expected = post(&server, path, "application/x-ndjson", lines.as_bytes()).expect(200);
            let found = post(&server, path, media_type, file).expect(200);
            assert_eq!(found["results"], expected["results"], "{path} {media_type}");
            assert_eq!(found["file"]["records"], *count, "{path}: {}", found["file"]);
            assert!(expected["file"].is_null());
            // By its bytes, as any file.
            assert_eq!(post(&server, path, ANY, file).expect(200)["results"], expected["results"]);
        }
    }
    let found = post(&server, &paths[0], "application/geo+json", map().as_bytes()).expect(200);
    assert_eq!(found["results"][0]["external_id"], "first");
    assert_eq!(found["file"]["left_out"][0]["what"], "holes");
    let kept = post(&server, &format!("{}&holes=keep", paths[0]), "application/geo+json", map().as_bytes())
        .expect(200);
    assert_eq!((results(&kept).len(), results(&found).len()), (3, 2));
}

/// An answer about a file names its shapes as an upload of it does.
#[test]
fn shapes_of_files_have_the_names_of_an_upload() {
    let server = Server::fresh();
    let representation =
        json!({"kind": "closed_curve", "dimension": 2, "control_points": 8, "generator": {"name": "cubic"}});
    server
        .post(
            "/v1/cohorts",
            &json!({"name": "c", "correspondence": "arc_length", "representation": representation}),
        )
        .expect(201);
    let measure = format!("/v1/measure?representation={representation}&correspondence=arc_length");
    let files = [
        ("map.geojson", map().into_bytes()),
        ("cells.png", label_picture()),
        ("set.tps", b"LM=4\n0 0\n1 0\n1 1\n0 1\nLM=4\n0 0\n1 0\n2 1\n0 1\n".to_vec()),
        ("one.tps", b"LM=4\n0 0\n1 0\n1 1\n0 1\n".to_vec()),
    ];
    let names = |answer: &Value| -> Vec<Value> {
        answer["results"].as_array().unwrap().iter().map(|one| one["external_id"].clone()).collect()
    };
    for (name, file) in &files {
        for more in ["", "&prefix=monday-"] {
            let stored =
                post(&server, &format!("/v1/cohorts/c/shapes?name={name}{more}"), ANY, file).expect(201);
            let asked = post(&server, &format!("{measure}&name={name}{more}"), ANY, file).expect(200);
            assert_eq!(names(&asked), names(&stored), "{name} {more}");
            assert!(names(&asked).iter().all(Value::is_string), "{name} {more}");
        }
    }
}

#[test]
fn faults_of_files_name_the_shape() {
    let server = shared();
    let representation = "representation={\"kind\":\"closed_curve\",\"dimension\":2,\"control_points\":4,\
                          \"generator\":{\"name\":\"trigonometric\"}}";
    let path = format!("/v1/measure?{representation}");
    let tps = "LM=4\n0 0\n1 0\n1 1\n0 1\nID=good\nLM=3\n0 0\n1 0\n1 1\nID=bad\n";
    let refused = post(&server, &path, "text/x-tps", tps.as_bytes());
    let refused = if refused.status == 415 { post(&server, &path, ANY, tps.as_bytes()) } else { refused };
    let fault = refused.expect_problem(422, "invalid-input", &["/points"])["errors"][0].clone();
    assert_eq!((&fault["index"], &fault["line"]), (&json!(1), &Value::Null), "{fault}");
    let some = post(&server, &format!("{path}&on_error=skip"), ANY, tps.as_bytes()).expect(200);
    assert!(some["results"][1]["error"].is_object() && some["results"][0]["error"].is_null(), "{some}");
    post(&server, &path, ANY, b"neither this nor that").expect_problem(422, "invalid-input", &[""]);
    post(&server, &format!("{path}&holes=keep"), ANY, tps.as_bytes()).expect_problem(
        400,
        "invalid-query",
        &[],
    );
    // Broken in the middle: nothing is answered of the beginning.
    let broken = "LM=4\n0 0\n1 0\n1 1\n0 1\nID=good\nLM=4\n0 0\n1 0\n";
    assert!(post(&server, &path, ANY, broken.as_bytes()).status >= 400);
}
