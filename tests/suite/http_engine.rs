//! Jobs with an engine that fails: this process computes. That the engine has the same bits is tested beside it, in
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
