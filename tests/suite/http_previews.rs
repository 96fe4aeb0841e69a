//! Files looked at against a cohort: a preview says what the upload then does, and nothing is stored by it.

use std::collections::BTreeMap;
use std::path::Path;

use reqwest::Method;
use serde_json::{Value, json};

use crate::form::label_picture;
use crate::http_access::{await_status, create_key};
use crate::http_mesh_cohorts::bean;
use crate::http_names::structure_set;
use crate::server::{Reply, Server, Setting, shared};

/// A cohort, empty at first.
fn create(server: &Server, name: &str, representation: &Value, correspondence: &str, unit: Value) {
    let body = json!({"name": name, "representation": representation, "correspondence": correspondence,
        "length_unit": unit});
    server.post("/v1/cohorts", &body).expect(201);
}

fn landmarks(points: usize, dimension: usize) -> Value {
    json!({"kind": "landmarks", "dimension": dimension, "points": points})
}

fn closed(dimension: usize) -> Value {
    json!({"kind": "closed_curve", "dimension": dimension, "control_points": 12, "generator": {"name": "cubic"}})
}

fn open() -> Value {
    json!({"kind": "open_curve", "dimension": 2, "intervals": 9, "generator": {"name": "cubic"}})
}

/// A cohort of each kind, in different units.
fn cohorts(server: &Server, prefix: &str) -> Vec<String> {
    let sphere = json!({"kind": "surface", "topology": "sphere", "control_points": [4, 3]});
    let all = [
        ("land", landmarks(3, 2), "landmarks", Value::Null),
        ("space", landmarks(4, 3), "landmarks", json!("mm")),
        ("closed", closed(2), "arc_length", json!("cm")),
        ("cyclic", closed(2), "cyclic", Value::Null),
        ("cells", closed(2), "arc_length", json!("pixel")),
        ("hearts", closed(3), "arc_length", json!("um")),
        ("lines", open(), "arc_length", json!("none")),
        ("beans", sphere, "landmarks", Value::Null),
    ];
    let named = |(name, representation, correspondence, unit): (&str, Value, &str, Value)| {
        let name = format!("{prefix}-{name}");
        create(server, &name, &representation, correspondence, unit);
        name
    };
    all.into_iter().map(named).collect()
}

fn ask(server: &Server, path: &str, query: &str, bytes: &[u8]) -> Reply {
    server.post_bytes(&format!("{path}{query}"), "application/octet-stream", bytes.to_vec())
}

/// What is left of a refusal without the request.
fn refusal(problem: &Value) -> Value {
    json!({"code": problem["code"], "detail": problem["detail"], "errors": problem["errors"]})
}

/// Looks at a file, then uploads it; returns the status of the upload.
fn compare(server: &Server, cohort: &str, file: &str, query: &str, bytes: &[u8]) -> u16 {
    let what = format!("{file} into {cohort} with {query}");
    let present = || server.get(&format!("/v1/cohorts/{cohort}")).expect(200);
    let before = present();
    let query = format!("name={file}&{query}");
    let preview = ask(server, &format!("/v1/inspect?cohort={cohort}&"), &query, bytes);
    assert_eq!(present(), before, "{what}");
    let upload = ask(server, &format!("/v1/cohorts/{cohort}/shapes?"), &query, bytes);
    let (status, preview_status) = (upload.status, preview.status);
    let (told, done) = (preview.json(), upload.json());
    let found = &told["cohort"];
    if status != 201 {
        let expected = refusal(&done);
        if preview_status == 200 {
            // Single shapes refuse the file: all of them are told.
            assert_eq!(
                (&found["accepted"], &refusal(&found["refusal"])),
                (&json!(false), &expected),
                "{what}"
            );
            assert!(found["skipped"].as_u64() > Some(0), "{what}: {found}");
            assert!(query.contains("skip") || !found["results"].as_array().unwrap().is_empty(), "{what}");
        } else {
            assert_eq!((preview_status, refusal(&told)), (status, expected), "{what}");
        }
        return status;
    }
    assert_eq!(preview_status, 200, "{what}: {told}");
    assert_eq!((&found["accepted"], found.get("refusal")), (&json!(true), None), "{what}");
    for count in ["added", "unchanged", "skipped", "repeated_points", "self_intersecting"] {
        assert_eq!(found[count], done[count], "{what}: {count}");
    }
    assert_eq!(found["warnings"], *done.get("warnings").unwrap_or(&json!([])), "{what}");
    let failed = |entry: &&Value| entry.get("error").is_some();
    let results = done["results"].as_array().unwrap().iter().filter(failed).cloned();
    assert_eq!(found["results"], results.collect::<Value>(), "{what}");
    for (field, value) in done["file"].as_object().unwrap() {
        assert_eq!(&told[field], value, "{what}: {field}");
    }
    assert_eq!(told.get("units"), done["file"].get("units"), "{what}");
    let tag = format!("\"{}-{}\"", before["id"].as_str().unwrap(), before["revision"]);
    assert_eq!(found["etag"], tag, "{what}");
    let grows = u64::from(done["added"].as_u64() > Some(0));
    let revision = found["revision"].as_u64().unwrap();
    assert_eq!(
        (revision, revision + grows),
        (before["revision"].as_u64().unwrap(), done["revision"].as_u64().unwrap()),
        "{what}"
    );
    status
}

const MODES: [&str; 3] = ["", "on_error=skip", "on_error=skip&plane=xy&samples=24&return=ids"];

/// Lines of landmarks: equal ones, others under the same name, other attributes, too few points.
fn lines(bad: bool) -> Vec<u8> {
    let line = |name: &str, x: f64, label: &str| {
        json!({"points": [[0, 0], [4, 0], [x, 1]], "external_id": name, "label": label}).to_string()
    };
    let mut lines = vec![line("a", 4.0, "x"), line("b", 5.0, "x"), line("a", 4.0, "x"), line("a", 4.0, "y")];
    if bad {
        let short = json!({"points": [[0, 0], [4, 0]], "external_id": "short"}).to_string();
        let extent = json!({"points": [[2, 2], [2, 2], [2, 2]], "external_id": "point"}).to_string();
        lines.extend([short.clone(), line("b", 7.0, "x"), extent, short]);
    }
    lines.join("\n").into_bytes()
}

/// Outlines: drawn both ways round, with a hole, crossing itself, without extent, with a point twice.
fn outlines(bad: bool) -> Vec<u8> {
    let ring = |name: &str, points: &Value| {
        json!({"type": "Feature", "id": name, "properties": {"site": "zrh"},
            "geometry": {"type": "Polygon", "coordinates": points}})
    };
    let mut features = vec![
        ring("left", &json!([[[0, 0], [9, 0], [9, 4], [0, 5], [0, 0]]])),
        ring("right", &json!([[[0, 0], [0, 7], [9, 4], [9, 0], [0, 0]]])),
        ring("hole", &json!([[[0, 0], [9, 0], [9, 9], [0, 9], [0, 0]], [[2, 2], [2, 4], [4, 4], [2, 2]]])),
        ring("twice", &json!([[[0, 0], [8, 0], [8, 0], [8, 4], [0, 5], [0, 0]]])),
        ring("bow", &json!([[[0, 0], [9, 6], [9, 0], [0, 5], [0, 0]]])),
    ];
    if bad {
        features.push(ring("flat", &json!([[[1, 1], [1, 1], [1, 1], [1, 1]]])));
        features.push(ring("left", &json!([[[0, 0], [9, 0], [7, 4], [0, 5], [0, 0]]])));
    }
    json!({"type": "FeatureCollection", "features": features}).to_string().into_bytes()
}

/// Files, good and broken ones.
fn files(server: &Server) -> Vec<(&'static str, &'static str, Vec<u8>)> {
    let set = structure_set(server, "P-17");
    let mut broken = set.clone();
    let at = broken.windows(8).rposition(|bytes| bytes == b"\x06\x30\x46\x00\x02\x00\x00\x00").unwrap() + 8;
    broken[at] = b'9';
    let picture = label_picture();
    let tps = "LM=3\n0 0\n4 0\n4 1\nID=one\nLM=3\n0 0\n5 0\n4 1\nID=two\n";
    let person = "subject_from=PatientID";
    vec![
        ("good.ndjson", "label=a&labels.site=zrh", lines(false)),
        ("bad.ndjson", "prefix=p-", lines(true)),
        ("clash.ndjson", "", br#"{"points":[[0,0],[4,0],[4,9]],"external_id":"a"}"#.to_vec()),
        ("good.geojson", "unit=mm&weight=2", outlines(false)),
        ("bad.geojson", "unit=inch&subject=s", outlines(true)),
        ("cells.geojson", "unit=pixel&repeated_points=refuse", outlines(true)),
        ("open.geojson", "", outlines(false)[..300].to_vec()),
        ("good.tps", "", tps.into()),
        ("short.tps", "unit=mm", format!("{tps}LM=2\n0 0\n1 1\nID=three\n").into()),
        ("broken.tps", "", format!("{tps}LM=3\n0 0\nx 1\n2 2\nID=three\n").into()),
        ("cells.png", "holes=keep", picture.clone()),
        ("half.png", "", picture[..picture.len() / 2].to_vec()),
        ("set.dcm", person, set),
        ("broken.dcm", person, broken),
        ("bean.off", "unit=mm", bean(0.3, 0.7).off().into()),
        ("bad.off", "", "OFF\n4 1 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 1 9\n".into()),
        ("nothing.bin", "", b"\x01\x02".to_vec()),
        ("empty.csv", "", Vec::new()),
    ]
}

#[test]
fn a_preview_says_what_the_upload_then_does() {
    let server = shared();
    let files = files(&server);
    let mut statuses: BTreeMap<u16, usize> = BTreeMap::new();
    for (k, mode) in MODES.iter().enumerate() {
        for cohort in cohorts(&server, &format!("preview{k}")) {
            for (name, query, bytes) in &files {
                // Into what the files before have left, then the same again.
                for _ in 0..2 {
                    let status = compare(&server, &cohort, name, &format!("{query}&{mode}"), bytes);
                    *statuses.entry(status).or_default() += 1;
                }
            }
        }
    }
    let count = |status| statuses.get(&status).copied().unwrap_or_default();
    assert!(count(201) > 150 && count(422) > 150 && count(409) >= 2, "{statuses:?}");
}

/// The first files of the corpus of every format, whatever they hold.
#[test]
fn a_preview_of_any_file_says_what_the_upload_then_does() {
    let server = shared();
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus/shape_files");
    let mut paths: Vec<_> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    let cohorts = cohorts(&server, "any");
    let mut stored = 0;
    for (k, path) in paths.iter().enumerate() {
        let (name, bytes) = (path.file_name().unwrap().to_str().unwrap(), std::fs::read(path).unwrap());
        for (mode, cohort) in MODES.iter().cycle().skip(k).zip(&cohorts) {
            stored += usize::from(compare(&server, cohort, name, mode, &bytes) == 201);
        }
    }
    assert!(stored > 40, "{stored} of {}", paths.len());
}

/// Streams in several parts: names of one part are known in the next ones.
#[test]
fn a_long_file_is_compared_with_itself_and_with_the_cohort() {
    let server = shared();
    let line = |name: usize, x: usize| {
        json!({"points": [[0, 0], [4, 0], [x, 1]], "external_id": format!("s{name}")}).to_string()
    };
    let whole = |range: std::ops::Range<usize>| range.map(|k| line(k, 5 + k % 7)).collect::<Vec<_>>();
    let text = |lines: &[String]| lines.join("\n").into_bytes();
    for (number, (first_bad, taken)) in [(5000, 4000), (3000, 4000), (3000, 10)].into_iter().enumerate() {
        let cohort = format!("long{number}");
        create(&server, &cohort, &landmarks(3, 2), "landmarks", Value::Null);
        let stored = text(&[line(taken, 99), line(taken + 1, 5 + (taken + 1) % 7)]);
        assert_eq!(compare(&server, &cohort, "first.ndjson", "", &stored), 201);
        let mut lines = whole(0..6000);
        lines.extend(whole(1000..1500));
        lines.push(line(2000, 77));
        lines[first_bad] = json!({"points": [[0, 0]], "external_id": "bad"}).to_string();
        for mode in ["", "on_error=skip"] {
            compare(&server, &cohort, "long.ndjson", mode, &text(&lines));
        }
        let query = format!("/v1/inspect?cohort={cohort}&");
        let found = ask(&server, &query, "name=long.ndjson", &text(&lines)).expect(200)["cohort"].clone();
        let counts = ["added", "unchanged", "skipped", "conflicts"].map(|name| found[name].clone());
        assert_eq!(counts, [0, 6498, 3, 2].map(|count| json!(count)), "{found}");
        let faults = found["faults"].as_array().unwrap();
        assert!(faults.len() == 1 && faults[0]["index"] == first_bad, "{faults:?}");
    }
}

#[test]
fn the_answer_counts_by_kind_what_would_be_stored_and_what_not() {
    let server = shared();
    create(&server, "kinds", &closed(2), "arc_length", json!("cm"));
    let bytes = outlines(true);
    let looked = |query: &str| ask(&server, "/v1/inspect?cohort=kinds&name=a.geojson&", query, &bytes);
    let told = looked("unit=mm").expect(200);
    let found = &told["cohort"];
    let counts = ["added", "unchanged", "skipped", "conflicts"].map(|name| found[name].clone());
    assert_eq!(counts, [6, 0, 1, 0].map(|count| json!(count)), "{told}");
    assert_eq!((&told["units"]["stored"], &told["units"]["factor"]), (&json!("cm"), &json!(0.1)));
    assert_eq!(
        (&told["left_out"][0]["count"], &found["self_intersecting"]),
        (&json!(1), &json!(1)),
        "{told}"
    );
    // Names as they would be stored.
    assert_eq!(told["groups"][0]["names"][0], "a/left");
    let [fault] = found["faults"].as_array().unwrap().as_slice() else { panic!("{found}") };
    assert_eq!((&fault["index"], &found["refusal"]["code"]), (&json!(5), &json!("invalid-input")), "{found}");
    assert!(told.get("proposals").is_none(), "{told}");
    // A file of another unit is refused as a whole, in the words of the upload.
    looked("unit=pixel").expect_problem(422, "invalid-input", &[""]);
    let parameter = |query: &str| {
        looked(query).expect_problem(400, "invalid-query", &[])["errors"][0]["parameter"].clone()
    };
    for query in ["tolerance=0.1", "on_error=perhaps", "plane=zz", "cohort=kinds", "unit=mile", "weight=x"] {
        assert_eq!(parameter(query), query.split('=').next().unwrap(), "{query}");
    }
    // Without a cohort, nothing is asked about storing.
    ask(&server, "/v1/inspect?name=a.geojson&", "on_error=skip", &bytes).expect_problem(
        400,
        "invalid-query",
        &[],
    );
    ask(&server, "/v1/inspect?name=a.geojson&", "plane=xy", &bytes).expect_problem(400, "invalid-query", &[]);
    ask(&server, "/v1/inspect?cohort=missing&", "name=a.geojson", &bytes).expect_problem(
        404,
        "not-found",
        &[],
    );
}

#[test]
fn nothing_is_kept_of_a_preview() {
    let server = Server::fresh();
    create(&server, "c", &landmarks(3, 2), "landmarks", Value::Null);
    let state = || {
        let changes = server.get("/v1/changes").expect(200)["items"].clone();
        (server.get("/v1/cohorts/c").expect(200), server.get("/v1/cohorts/c/shapes").expect(200), changes)
    };
    let before = state();
    let keyed = |path: &str| {
        let request = server.request(Method::POST, path).header("idempotency-key", "the same");
        server.send(request.header("content-type", "application/octet-stream").body(lines(false)))
    };
    let told = keyed("/v1/inspect?cohort=c&name=a.ndjson&unit=mm").expect(200);
    assert_eq!((&told["cohort"]["added"], &told["units"]["adopted"]), (&json!(2), &json!(true)), "{told}");
    assert_eq!(state(), before);
    // Neither did it answer the upload with the same key.
    let done = keyed("/v1/cohorts/c/shapes?name=a.ndjson&unit=mm");
    assert_eq!(done.header("idempotency-replayed"), None);
    assert_eq!(done.expect(201)["added"], 2);
    let operations: Vec<Value> =
        server.get("/v1/audit?operation=inspect_file").expect(200)["items"].as_array().unwrap().clone();
    assert_eq!(operations.len(), 1, "{operations:?}");
    assert_eq!(operations[0]["objects"]["cohort_id"], before.0["id"], "{operations:?}");
}

#[test]
fn a_reader_looks_at_files_against_cohorts_that_it_sees() {
    let server = Setting::fresh().with_example().start();
    let keys = [
        (&["--role", "reader"][..], 200),
        (&["--role", "reader", "--cohort", "example-cells"], 200),
        (&["--role", "admin", "--tenant", "b"], 404),
    ];
    let keys = keys.map(|(arguments, status)| (create_key(&server, arguments), status));
    await_status(401, || server.get("/v1/cohorts"));
    for (key, status) in keys {
        let request = server.request(Method::POST, "/v1/inspect?cohort=example-cells&name=a.geojson");
        let reply = server.send(request.bearer_auth(&key).body(outlines(false)));
        assert_eq!(reply.status, status, "{}", reply.text());
    }
}
