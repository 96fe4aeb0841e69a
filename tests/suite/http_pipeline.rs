//! The program of docs/pipeline.md, run as a hospital runs it: night after night over the same folder.

use std::f64::consts::TAU;
use std::path::Path;
use std::process::Command;

use serde_json::{Value, json};

use crate::form::label_picture;
use crate::server::{Server, Setting};

/// Rings of an organ that varies, as a map.
fn map(first: usize, count: usize) -> String {
    let feature = |k: usize| {
        let at = |i: usize| {
            let (t, wave) = (TAU * i as f64 / 24.0, 0.1 * (k as f64).sin());
            let r = 20.0 * (1.0 + 0.2 * (2.0 * t).cos() + wave * (3.0 * t).cos());
            [r * t.cos() + 100.0, r * t.sin() + 50.0]
        };
        let ring: Vec<[f64; 2]> = (0..=24).map(|i| at(i % 24)).collect();
        json!({"type": "Feature", "id": format!("organ-{k}"), "properties": {}, "geometry": {"type": "Polygon", "coordinates": [ring]}})
    };
    json!({"type": "FeatureCollection", "features": (first..first + count).map(feature).collect::<Vec<_>>()})
        .to_string()
}

/// What the program prints; `None` without Python.
fn night(server: &Server, program: &Path, folder: &Path) -> Option<String> {
    let run =
        Command::new("python3").arg(program).arg(folder).env("SHAPELEX", server.address()).output().ok()?;
    let (out, error) = (String::from_utf8_lossy(&run.stdout), String::from_utf8_lossy(&run.stderr));
    assert!(run.status.success(), "{out}\n{error}");
    Some(out.into_owned())
}

#[test]
fn nights_over_the_same_folder_store_and_learn_what_is_new() {
    let page =
        std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/pipeline.md")).unwrap();
    let program = page.split("```python\n").nth(1).and_then(|rest| rest.split("```").next()).unwrap();
    let place = tempfile::tempdir().unwrap();
    let (script, folder) = (place.path().join("pipeline.py"), place.path().join("files"));
    std::fs::write(&script, program).unwrap();
    std::fs::create_dir(&folder).unwrap();
    std::fs::write(folder.join("monday.geojson"), map(0, 12)).unwrap();
    std::fs::write(folder.join("mask.png"), label_picture()).unwrap();
    std::fs::write(folder.join("notes.txt"), "no shapes").unwrap();
    let server = Setting::fresh().start();
    let Some(first) = night(&server, &script, &folder) else {
        println!("SKIPPED: the program of docs/pipeline.md, there is no python3");
        return;
    };
    assert!(
        first.contains("monday.geojson: 12 new, 0 known, 0 left out") && first.contains("notes.txt: refused"),
        "{first}"
    );
    let count = |server: &Server| server.get("/v1/cohorts/organs").expect(200)["shape_count"].clone();
    let version = |server: &Server| server.get("/v1/dictionaries/organs").expect(200)["version"].clone();
    let (stored, learnt) = (count(&server), version(&server));
    assert!(stored.as_u64().unwrap() > 12 && learnt == 1, "{stored} {learnt} {first}");
    let again = || {
        std::fs::copy(folder.join("done/monday.geojson"), folder.join("monday.geojson")).unwrap();
        let printed = night(&server, &script, &folder).unwrap();
        assert!(printed.contains("monday.geojson: 0 new, 12 known, 0 left out"), "{printed}");
    };
    again();
    assert_eq!((count(&server), version(&server)), (stored.clone(), learnt));
    // A correction is no conflict for a file that is sent again, and stays.
    let path = "/v1/cohorts/organs/shapes/monday/organ-3";
    server.send(server.request(reqwest::Method::PATCH, path).json(&json!({"label": "checked"}))).expect(200);
    again();
    assert_eq!((count(&server), server.get(path).expect(200)["label"].clone()), (stored, json!("checked")));
    let before = version(&server);
    std::fs::write(folder.join("tuesday.geojson"), map(12, 3)).unwrap();
    let third = night(&server, &script, &folder).unwrap();
    assert!(
        third.contains("tuesday.geojson: 3 new") && third.contains("shapes of 1 files need a look"),
        "{third}"
    );
    assert_eq!(version(&server).as_u64(), before.as_u64().map(|version| version + 1));
    let alias: Value = server.get("/v1/dictionaries/organs/aliases").expect(200);
    assert_eq!(alias["items"][0]["dictionary"]["version"], version(&server), "{alias}");
    let empty = night(&server, &script, &folder).unwrap();
    assert!(empty.contains("notes.txt: refused") && empty.contains("0 shapes of 0 files"), "{empty}");
}
