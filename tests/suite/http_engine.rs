//! Jobs and means with an engine that fails: this process computes. That the engine has the same bits is tested beside it, in
//! `crates/shapelex-engine/tests/service.py`.

use std::os::unix::fs::PermissionsExt;

use serde_json::{Value, json};

use crate::http_dictionaries::{dictionary, finished};
use crate::server::{Server, Setting};

fn learn(server: &Server) -> Value {
    let body = json!({"name": "cells", "cohort": "example-cells", "transformation": "similarity",
                      "method": {"kind": "functional_pca", "components": 3}});
    let job = server.post("/v1/dictionaries", &body).expect(202);
    let job = finished(server, job["id"].as_str().unwrap());
    assert_eq!(job["status"], "succeeded", "{job}");
    dictionary(server, "cells")
}

/// A program that does this.
fn program(folder: &std::path::Path, name: &str, script: &str) -> String {
    let path = folder.join(name);
    std::fs::write(&path, format!("#!/bin/sh\n{script}\n")).unwrap();
    std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).unwrap();
    path.to_str().unwrap().into()
}

#[test]
fn what_an_engine_does_not_compute_is_computed_here() {
    let folder = tempfile::tempdir().unwrap();
    let store = folder.path().join("store");
    let expected = learn(&Setting::fresh().with_example().start())["digest"].clone();
    let scripts = [
        ("missing", None, "the engine failed"),
        ("refusing", Some("echo 'shapelex-engine: no room' >&2; exit 1"), "no room"),
        ("silent", Some("exec cat > /dev/null"), "the engine failed"),
    ];
    for (name, script, said) in scripts {
        let program = match script {
            Some(script) => program(folder.path(), name, script),
            None => folder.path().join(name).to_str().unwrap().into(),
        };
        let flags =
            ["--engine", &program, "--engine-store", store.to_str().unwrap(), "--engine-min-shapes", "100"];
        let server = Setting::fresh().with_example().flags(&flags).start();
        // A silent program answers nothing, which is no sum.
        let learnt = learn(&server);
        assert_eq!(learnt["digest"], expected, "{name}");
        let log = server.log();
        assert!(log.contains(said), "{name}: {log}");
    }
}

#[test]
fn cohorts_below_the_minimum_have_no_engine() {
    let folder = tempfile::tempdir().unwrap();
    let mark = folder.path().join("started");
    let program = program(folder.path(), "engine", &format!("touch {}; exit 1", mark.display()));
    let flags = ["--engine", &program, "--engine-store", "somewhere"];
    learn(&Setting::fresh().with_example().flags(&flags).start());
    assert!(!mark.exists());
}

/// Triangles, of which every other one is labelled `a`.
fn with_triangles(server: Server) -> Server {
    let representation = json!({"kind": "landmarks", "dimension": 2, "points": 3});
    server.post("/v1/cohorts", &json!({"name": "triangles", "representation": representation})).expect(201);
    let triangle = |k: u32| {
        let (x, y) = ((f64::from(k) * 0.7).sin(), (f64::from(k) * 0.3).cos());
        json!({"label": if k.is_multiple_of(2) { "a" } else { "b" }, "points": [[x, 0.0], [20.0, y], [5.0, 15.0 + x]]})
    };
    let triangles: Vec<Value> = (0..120).map(triangle).collect();
    server.post_lines("/v1/cohorts/triangles/shapes", &triangles).expect(201);
    server
}

#[test]
fn a_stored_mean_of_a_whole_cohort_goes_to_the_engine_first() {
    let folder = tempfile::tempdir().unwrap();
    let of = |server: &Server, filter: &str| {
        let query = format!("/v1/cohorts/triangles/mean?transformation=similarity{filter}");
        server.get(&query).expect(200)["mean"].clone()
    };
    let alone = with_triangles(Setting::fresh().start());
    let (whole, part) = (of(&alone, ""), of(&alone, "&label=a"));
    let mark = folder.path().join("started");
    let program = program(folder.path(), "engine", &format!("echo $* >> {}; exit 1", mark.display()));
    let store = folder.path().join("store");
    let flags =
        ["--engine", &program, "--engine-store", store.to_str().unwrap(), "--engine-min-shapes", "20"];
    let server = with_triangles(Setting::fresh().flags(&flags).start());
    assert_eq!(of(&server, "&label=a"), part);
    assert!(!mark.exists(), "there are no files of a selection");
    assert_eq!(of(&server, ""), whole);
    let started = std::fs::read_to_string(&mark).unwrap();
    // Once it has failed, it is asked to clear what it has begun, and nothing else.
    let commands: Vec<&str> = started.lines().filter_map(|line| line.split(' ').nth(2)).collect();
    assert_eq!(commands, ["ingest", "collect"], "{started}");
    assert!(server.log().contains("the engine failed; this process computes"));
}
