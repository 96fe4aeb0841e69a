//! The program of docs/pipeline.md, run as a hospital runs it: night after night over the same folder.

use std::collections::BTreeMap;
use std::f64::consts::TAU;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::thread;
use std::time::Duration;

use serde_json::{Value, json};
use shapelex_formats::image::write::nifti_u8;
use shapelex_formats::image::{Grid, LengthUnit};

use crate::form::label_picture;
use crate::http_names::structure_set;
use crate::segments::{SIZE, Segments, disc};
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

/// The program of the page in a folder.
fn script(place: &Path) -> PathBuf {
    let page =
        std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/pipeline.md")).unwrap();
    let program = page.split("```python\n").nth(1).and_then(|rest| rest.split("```").next()).unwrap();
    let script = place.join("pipeline.py");
    std::fs::write(&script, program).unwrap();
    script
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
    let place = tempfile::tempdir().unwrap();
    let (script, folder) = (script(place.path()), place.path().join("files"));
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

/// Files of a night: a structure set, a segmentation, a volume, a picture and a map.
fn arrive(server: &Server, folder: &Path, night: i64) {
    let file =
        |name: &str, bytes: &[u8]| std::fs::write(folder.join(format!("{night}-{name}")), bytes).unwrap();
    file("a.dcm", &structure_set(server, &format!("P-{night}")));
    let cells: [&dyn Fn(i64, i64) -> bool; 2] = [&disc(9 + night, 10, 6), &disc(14 + night, 10, 6)];
    let instance = format!("1.2.9.{night}");
    file("b.dcm", &Segments { instance: &instance, patient: &format!("P-{night}"), cells: &cells }.file());
    let [columns, rows] = SIZE.map(|side| side as usize);
    let grid = Grid::along_axes([columns, rows, 1], [0.5; 3], [LengthUnit::Millimetre; 3]).unwrap();
    let inside = disc(20 + night, 12, 7);
    let cell = |at: usize| u8::from(inside((at % columns) as i64, (at / columns) as i64));
    file("c.nii", &nifti_u8(&grid, &(0..grid.cells()).map(cell).collect::<Vec<_>>()).unwrap());
    file("d.png", &label_picture());
    file("e.geojson", map(12 * night as usize, 12).as_bytes());
}

/// Number of shapes that a night brings.
const OF_A_NIGHT: usize = 2 + 2 + 1 + 3 + 12;

/// A request as its client sends it.
fn request(client: &TcpStream) -> Option<(String, Vec<u8>)> {
    let mut reader = BufReader::new(client.try_clone().ok()?);
    let mut head = String::new();
    while !head.ends_with("\r\n\r\n") {
        if reader.read_line(&mut head).ok()? == 0 {
            return None;
        }
    }
    let length = head
        .lines()
        .find_map(|line| line.to_lowercase().strip_prefix("content-length:")?.trim().parse().ok());
    let mut body = vec![0; length.unwrap_or(0)];
    reader.read_exact(&mut body).ok()?;
    Some((head, body))
}

/// Passes requests on to a service, each over its connection. Of the `last`-th upload it passes half of the body and keeps the
/// connection, which it returns.
fn pass_until(listener: &TcpListener, service: &str, last: usize) -> TcpStream {
    let mut uploads = 0;
    loop {
        let (mut client, _) = listener.accept().unwrap();
        let Some((head, body)) = request(&client) else { continue };
        let mut service = TcpStream::connect(service).unwrap();
        service.write_all(head.as_bytes()).unwrap();
        uploads += usize::from(head.starts_with("POST /v1/cohorts/organs/shapes"));
        if uploads == last {
            service.write_all(&body[..body.len() / 2]).unwrap();
            return service;
        }
        service.write_all(&body).unwrap();
        let mut answer = Vec::new();
        service.read_to_end(&mut answer).unwrap();
        client.write_all(&answer).unwrap();
    }
}

/// Runs the program until the `last`-th upload has begun, and kills the service and the program.
fn broken_night(server: Server, script: &Path, folder: &Path, last: usize) -> Server {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("http://{}", listener.local_addr().unwrap());
    let mut program = Command::new("python3")
        .arg(script)
        .arg(folder)
        .env("SHAPELEX", address)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let service = server.address().trim_start_matches("http://").to_owned();
    let connection = pass_until(&listener, &service, last);
    // The service has begun to read.
    thread::sleep(Duration::from_millis(50));
    let server = server.kill().start();
    drop(connection);
    assert!(program.try_wait().unwrap().is_none(), "the program waits for its answer");
    program.kill().unwrap();
    program.wait().unwrap();
    server
}

/// External ids of a cohort, with the subject of each.
fn stored(server: &Server) -> BTreeMap<String, Value> {
    let page = server.get("/v1/cohorts/organs/shapes?limit=1000").expect(200);
    let items = page["items"].as_array().unwrap();
    let named: BTreeMap<_, _> = items
        .iter()
        .map(|item| (item["external_id"].as_str().unwrap().to_owned(), item["subject"].clone()))
        .collect();
    assert_eq!(named.len(), items.len(), "each shape once");
    named
}

#[test]
fn nights_in_which_the_service_is_killed_store_each_shape_once() {
    let place = tempfile::tempdir().unwrap();
    let (script, folder) = (script(place.path()), place.path().join("files"));
    std::fs::create_dir(&folder).unwrap();
    let mut server = Setting::fresh().start();
    if night(&server, &script, &folder).is_none() {
        println!("SKIPPED: the program of docs/pipeline.md, there is no python3");
        return;
    }
    for (number, last) in [(1, 3), (2, 5)] {
        arrive(&server, &folder, number);
        let before = stored(&server).len();
        server = broken_night(server, &script, &folder, last);
        // What was answered is there, and nothing of the upload that was broken off.
        let whole = stored(&server).len() - before;
        assert_eq!(whole, if last == 3 { 4 } else { 8 }, "night {number}");
        let printed = night(&server, &script, &folder).unwrap();
        assert!(printed.contains("a.dcm: 0 new, 2 known, 0 left out"), "{printed}");
        assert!(printed.contains("e.geojson: 12 new, 0 known, 0 left out"), "{printed}");
        assert!(!printed.contains("refused") && printed.contains("of 5 files need a look"), "{printed}");
        let all = stored(&server);
        assert_eq!(all.len(), OF_A_NIGHT * number as usize, "{all:?}");
    }
    let all = stored(&server);
    // A patient is one subject in the structure set and the segmentation, and another one the next night.
    let subjects = ["1.2.9.1/1/1", "1.2.9.1/2/1", "1.2.9.2/1/1"].map(|name| all[name].as_str().unwrap());
    assert!(subjects[0] == subjects[1] && subjects[1] != subjects[2], "{subjects:?}");
    assert_eq!(all.values().filter(|subject| subject.as_str() == Some(subjects[0])).count(), 4);
    let version = server.get("/v1/dictionaries/organs").expect(200)["version"].clone();
    assert_eq!(version, 2, "one version a night");
}
