//! What was answered 201 survives `kill -9`; what was not answered is there in whole or not at all.

use std::collections::BTreeMap;
use std::io::Write;
use std::net::TcpStream;
use std::time::Duration;

use serde_json::{Value, json};

use crate::server::{Server, Setting};

const ROUNDS: usize = 30;

/// A shape whose points say which upload it belongs to.
fn shape(round: usize, k: usize) -> Value {
    json!({"external_id": format!("r{round}-{k}"), "label": format!("r{round}"),
        "points": [[round + 1, k], [0, 1], [-2, 0.5], [k, -1]]})
}

fn upload(round: usize) -> Vec<Value> {
    // One chunk of the store, or several.
    let count = [1, 7, 300, 9000][round % 4];
    (0..count).map(|k| shape(round, k)).collect()
}

/// Shapes per label, and the revision.
fn stored(server: &Server) -> (BTreeMap<String, usize>, u64) {
    let cohort = server.get("/v1/cohorts/c").expect(200);
    let mut counts = BTreeMap::new();
    let mut cursor = String::new();
    loop {
        let page = server.get(&format!("/v1/cohorts/c/shapes?limit=1000{cursor}")).expect(200);
        for item in page["items"].as_array().unwrap() {
            *counts.entry(item["label"].as_str().unwrap().to_owned()).or_insert(0) += 1;
        }
        let Some(next) = page["next"].as_str() else { break };
        cursor = format!("&cursor={next}");
    }
    assert_eq!(cohort["shape_count"], counts.values().sum::<usize>(), "the count of the cohort");
    (counts, cohort["revision"].as_u64().unwrap())
}

/// Begins an upload of `lines` and sends a part of it.
fn begin(server: &Server, lines: &[Value], part: usize) -> TcpStream {
    let address = server.address().trim_start_matches("http://");
    let text: String = lines.iter().map(|line| format!("{line}\n")).collect();
    let mut stream = TcpStream::connect(address).unwrap();
    let head = format!(
        "POST /v1/cohorts/c/shapes HTTP/1.1\r\nhost: {address}\r\ncontent-type: application/x-ndjson\r\n\
         content-length: {}\r\n\r\n",
        text.len()
    );
    stream.write_all(head.as_bytes()).unwrap();
    stream.write_all(&text.as_bytes()[..text.len() * part / 100]).unwrap();
    stream
}

#[test]
fn what_was_acknowledged_survives_and_nothing_is_partial() {
    let mut server = Setting::fresh().start();
    let representation =
        json!({"kind": "closed_curve", "dimension": 2, "control_points": 4, "generator": {"name": "cubic"}});
    server.post("/v1/cohorts", &json!({"name": "c", "representation": representation})).expect(201);
    let mut acknowledged: BTreeMap<String, usize> = BTreeMap::new();
    for round in 0..ROUNDS {
        let lines = upload(round);
        let label = format!("r{round}");
        if round % 3 == 2 {
            // Killed in the middle of a stream, at another place every time; 100: all was sent, nothing answered.
            let part = [20, 55, 90, 99, 100][round / 3 % 5];
            let stream = begin(&server, &lines, part);
            std::thread::sleep(Duration::from_millis(3 * (round as u64 % 7)));
            server = server.kill().start();
            drop(stream);
            let (found, _) = stored(&server);
            let count = found.get(&label).copied().unwrap_or(0);
            let whole = part == 100 && count == lines.len();
            assert!(count == 0 || whole, "round {round}: {count} of {} shapes, {part} % sent", lines.len());
            if whole {
                acknowledged.insert(label, count);
            }
        } else {
            let answer = if round % 2 == 0 {
                server.post_lines("/v1/cohorts/c/shapes", &lines)
            } else {
                server.post("/v1/cohorts/c/shapes", &json!({ "shapes": lines }))
            };
            let answer = answer.expect(201);
            server = server.kill().start();
            assert_eq!(answer["added"], lines.len());
            acknowledged.insert(label, lines.len());
            let cohort = server.get("/v1/cohorts/c").expect(200);
            assert_eq!(cohort["revision"], answer["revision"], "round {round}");
        }
        if round % 10 == 9 {
            assert_eq!(stored(&server), (acknowledged.clone(), acknowledged.len() as u64), "round {round}");
        }
    }
    // A retry of an acknowledged upload changes nothing; one of a lost upload stores it.
    let again = server.post_lines("/v1/cohorts/c/shapes", &upload(3)).expect(201);
    assert_eq!(again["added"], 0, "{again}");
    let lost = (0..ROUNDS).find(|round| !acknowledged.contains_key(&format!("r{round}")));
    let lost = upload(lost.unwrap_or(ROUNDS));
    assert_eq!(server.post_lines("/v1/cohorts/c/shapes", &lost).expect(201)["added"], lost.len());
}

#[test]
fn created_and_deleted_things_survive() {
    let server = Setting::fresh().start();
    let representation = json!({"kind": "landmarks", "dimension": 2, "points": 3});
    for name in ["kept", "gone"] {
        server.post("/v1/cohorts", &json!({"name": name, "representation": representation})).expect(201);
        let shapes: Vec<Value> = (0..3)
            .map(|k| json!({"external_id": k.to_string(), "points": [[k, 1], [2, 0], [5, 5]]}))
            .collect();
        server.post(&format!("/v1/cohorts/{name}/shapes"), &json!({ "shapes": shapes })).expect(201);
    }
    assert_eq!(server.delete("/v1/cohorts/gone").status, 204);
    assert_eq!(server.delete("/v1/cohorts/kept/shapes/1").status, 204);
    let before = server.get("/v1/cohorts/kept").expect(200);
    let server = server.kill().start();
    assert_eq!(server.get("/v1/cohorts/kept").expect(200), before);
    assert_eq!(server.get("/v1/cohorts").expect(200)["items"], json!([before]));
    let page = server.get("/v1/cohorts/kept/shapes").expect(200);
    let ids: Vec<&Value> =
        page["items"].as_array().unwrap().iter().map(|item| &item["external_id"]).collect();
    assert_eq!(ids, ["0", "2"]);
    server.get("/v1/cohorts/kept/shapes/1").expect_problem(404, "not-found", &[]);
}

#[test]
fn a_folder_in_use_is_not_opened_twice() {
    let server = Setting::fresh().embedded().start();
    let output = std::process::Command::new(env!("CARGO_BIN_EXE_shapelex"))
        .args(["serve", "--listen", "127.0.0.1:0", "--no-example", "--data-dir"])
        .arg(server.folder().join("data"))
        .output()
        .unwrap();
    assert!(!output.status.success());
    let message = String::from_utf8(output.stderr).unwrap();
    assert!(message.contains("in use"), "{message}");
    server.assert_alive();
}
