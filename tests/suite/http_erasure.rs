//! Erasure of subjects: nothing of them is left in the files, in receipts and in answers; its holdings are told, and erasures are
//! repeated in a store that was restored.

use std::ops::Range;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use reqwest::Method;
use serde_json::{Value, json};

use crate::http_access::{await_status, create_key};
use crate::http_segment::bright;
use crate::http_segment_cohort;
use crate::server::{Reply, Server, Setting, wait};

const COHORTS: [&str; 3] = ["feet", "hands", "ears"];
const PATIENTS: usize = 16;
const SHAPES: usize = 9;

fn make_cohort(server: &Server, name: &str) {
    let representation =
        json!({"kind": "closed_curve", "dimension": 2, "control_points": 6, "generator": {"name": "cubic"}});
    let body = json!({"name": name, "correspondence": "arc_length", "representation": representation});
    server.post("/v1/cohorts", &body).expect(201);
}

/// What every attribute of a patient holds, and nothing else.
fn token(patient: usize) -> String {
    format!("patient-{patient:04}-of-this-test")
}

/// A file of a patient, as another program writes it.
fn file(cohort: &str, patient: usize) -> Vec<u8> {
    let feature = |k: usize| {
        let side = 1.0 + k as f64 + patient as f64 / 32.0;
        let ring = json!([[0, 0], [side, 0], [side, 2], [0, 2.5], [0, 0]]);
        json!({"type": "Feature", "id": format!("{}/{cohort}/{k}", token(patient)), "geometry": {"type": "Polygon", "coordinates": [ring]},
            "properties": {"note": format!("note of {}", token(patient))}})
    };
    let features: Vec<Value> = (0..SHAPES).map(feature).collect();
    json!({"type": "FeatureCollection", "features": features}).to_string().into_bytes()
}

fn upload(server: &Server, cohort: &str, patient: usize) -> Reply {
    let path = format!("/v1/cohorts/{cohort}/shapes?format=geojson");
    let request = server.request(Method::POST, &path).header("content-type", "application/geo+json");
    let key = format!("{cohort}/{}.geojson", token(patient));
    server.send(request.header("idempotency-key", key).body(file(cohort, patient)))
}

/// Gives a shape its subject and more attributes, by its external id.
fn correct(server: &Server, cohort: &str, shape: &Value, patient: usize) {
    let name = shape["external_id"].as_str().unwrap().replace('/', "%2F");
    let path = format!("/v1/cohorts/{cohort}/shapes/{name}");
    let change = json!({"subject": token(patient), "label": format!("label of {}", token(patient)),
        "labels": {"scan": format!("scan of {}", token(patient))}, "metadata": {"of": token(patient)}});
    server.send(server.request(Method::PATCH, &path).json(&change)).expect(200);
}

/// A store with files of patients in several cohorts, in an order that makes the database move rows.
fn fill(server: &Server) {
    COHORTS.iter().for_each(|name| make_cohort(server, name));
    for patient in (0..PATIENTS).map(|k| k * 5 % PATIENTS) {
        for cohort in COHORTS {
            let stored = upload(server, cohort, patient).expect(201);
            assert_eq!(stored["added"], SHAPES, "{stored}");
            for result in stored["results"].as_array().unwrap() {
                correct(server, cohort, result, patient);
            }
        }
    }
}

fn done(command: &mut Command) -> String {
    let output = command.stderr(Stdio::inherit()).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stdout));
    String::from_utf8(output.stdout).unwrap()
}

/// Runs a statement in the database of the server, and returns a text that it selects.
fn ask(url: &str, statement: &'static str) -> Option<String> {
    wait(async {
        let pool = sqlx::PgPool::connect(url).await.unwrap();
        let found = sqlx::query_scalar(statement).fetch_optional(&pool).await.unwrap();
        pool.close().await;
        found
    })
}

/// All files below a folder.
fn files(folder: &Path) -> Vec<PathBuf> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    let paths = entries.map(|entry| entry.unwrap().path());
    paths.flat_map(|path| if path.is_dir() { files(&path) } else { vec![path] }).collect()
}

/// Where the store keeps its data, except for the log of PostgreSQL, which recycles it.
fn places(server: &Server) -> Vec<PathBuf> {
    match server.database() {
        None => vec![server.folder().join("data")],
        Some(url) => {
            ask(url, "CHECKPOINT");
            let folder = PathBuf::from(ask(url, "SHOW data_directory").unwrap());
            vec![folder.join("base"), folder.join("global")]
        }
    }
}

/// Those of some patients whose attributes stand in the files of the store, which tests share in PostgreSQL.
fn held(server: &Server, patients: Range<usize>) -> Vec<usize> {
    let files: Vec<PathBuf> = places(server).iter().flat_map(|folder| files(folder)).collect();
    let start = b"patient-";
    let mut found = std::collections::BTreeSet::new();
    for bytes in files.iter().filter_map(|file| std::fs::read(file).ok()) {
        for at in memchr_all(&bytes, start) {
            found.extend(patients.clone().find(|one| bytes[at..].starts_with(token(*one).as_bytes())));
        }
    }
    found.into_iter().collect()
}

fn memchr_all<'a>(bytes: &'a [u8], wanted: &'a [u8]) -> impl Iterator<Item = usize> + 'a {
    let first = wanted[0];
    (0..bytes.len()).filter(move |at| bytes[*at] == first && bytes[*at..].starts_with(wanted))
}

#[test]
fn nothing_of_erased_subjects_is_left_in_the_files() {
    let server = Server::fresh();
    fill(&server);
    if let Some(url) = server.database() {
        // The most common values of columns stand in the statistics.
        ask(url, "ANALYZE shape");
    }
    let everybody: Vec<usize> = (0..PATIENTS).collect();
    assert_eq!(held(&server, 0..PATIENTS), everybody, "the search finds everybody");
    let is_erased = |patient: &usize| patient.is_multiple_of(2);
    for patient in everybody.iter().copied().filter(is_erased) {
        let erased = server.delete(&format!("/v1/subjects/{}", token(patient))).expect(200);
        assert_eq!(erased["shape_count"], COHORTS.len() * SHAPES, "{erased}");
        let files = if server.database().is_some() { "pending" } else { "done" };
        assert_eq!(erased["files"], files);
    }
    if server.database().is_some() {
        let said = done(&mut server.command("compact"));
        assert!(said.contains(&format!("{} more erasures", PATIENTS / 2)), "{said}");
    }
    let left: Vec<usize> = everybody.iter().copied().filter(|patient| !is_erased(patient)).collect();
    assert_eq!(held(&server, 0..PATIENTS), left, "of the patients with even numbers nothing may be left");
    let again = server.delete(&format!("/v1/subjects/{}", token(0))).expect(200);
    assert_eq!((&again["shape_count"], &again["files"]), (&json!(0), &json!("done")));
    assert!(done(&mut server.command("check")).contains(": no findings"));
    // The old upload is not stored again, and says nothing of the erased shapes.
    let reply = upload(&server, "feet", 0);
    assert_eq!(reply.header("idempotency-replayed"), Some("true"));
    let stored = reply.expect(201);
    assert_eq!((&stored["added"], &stored["results"]), (&json!(0), &json!([])), "{stored}");
    assert!(!stored.to_string().contains("patient"), "{stored}");
    assert_eq!(server.get("/v1/cohorts/feet").expect(200)["shape_count"], left.len() * SHAPES);
}

/// Of an upload with shapes of others too, and of answers that list ids, or nothing.
#[test]
fn receipts_forget_erased_shapes_only() {
    let server = Server::fresh();
    make_cohort(&server, "feet");
    let shape = |k: usize| {
        json!({"external_id": format!("scan-{k}"), "subject": format!("subject-{}", k % 2),
            "points": [[0, 0], [4 + k, 0], [4, 3], [1, 5]]})
    };
    let send = |key: &str, query: &str, range: Range<usize>| {
        let path = format!("/v1/cohorts/feet/shapes{query}");
        let request = server.request(Method::POST, &path).header("idempotency-key", key);
        let shapes: Vec<Value> = range.map(shape).collect();
        server.send(request.json(&json!({"shapes": shapes}))).expect(201)
    };
    let uploads =
        [("results", "?return=results", 0..4), ("ids", "?return=ids", 4..8), ("none", "?return=none", 8..12)];
    let before: Vec<Value> =
        uploads.iter().map(|(key, query, range)| send(key, query, range.clone())).collect();
    // Known shapes, under another key.
    send("again", "", 0..2);
    let changed_before = server.get("/v1/changes").expect(200)["next"].clone();
    let erased = server.delete("/v1/subjects/subject-1").expect(200);
    assert_eq!(erased["shape_count"], 6);
    let after: Vec<Value> =
        uploads.iter().map(|(key, query, range)| send(key, query, range.clone())).collect();
    for (after, before) in after.iter().zip(&before) {
        assert_eq!((&before["added"], &after["added"]), (&json!(4), &json!(2)), "{after}");
    }
    let [results, ids] = ["results", "ids"].map(|list| before[usize::from(list == "ids")][list].clone());
    assert_eq!(after[0]["results"], json!([results[0], results[2]]));
    assert_eq!(after[1]["ids"], json!([ids[0], null, ids[2], null]), "the places of the others stay");
    let again = send("again", "", 0..2);
    assert_eq!((&again["added"], &again["results"]), (&json!(0), &json!([results[0]])));
    assert_eq!(server.get("/v1/cohorts/feet").expect(200)["shape_count"], 6);
    // A mirror learns which shapes are gone.
    let feed = server.get(&format!("/v1/changes?since={changed_before}")).expect(200);
    let change = &feed["items"][0];
    assert_eq!((&change["kind"], &change["shape_count"]), (&json!("subject_erased"), &json!(6)), "{feed}");
    let named = change["shape_ids"].as_array().unwrap();
    assert!(named.len() == 6 && named.contains(&results[1]["id"]) && named.contains(&ids[1]), "{change}");
    assert!(!feed.to_string().contains("scan-"), "{feed}");
}

/// An answer that holds the objects themselves is not kept.
#[test]
fn an_answer_with_the_shapes_of_an_erased_subject_is_gone() {
    let server = http_segment_cohort::with_cohort();
    let send = || {
        let parameters = http_segment_cohort::named(["a", "b"]);
        http_segment_cohort::post(&server, &parameters, &bright(), &[("idempotency-key", "one")])
    };
    assert_eq!(send().expect(201)["added"], 2);
    assert_eq!(server.delete("/v1/subjects/mouse-3").expect(200)["shape_count"], 2);
    let problem = send().expect_problem(404, "not-found", &[]);
    assert!(problem["detail"].as_str().unwrap().contains("was carried out"), "{problem}");
    assert_eq!(server.get("/v1/cohorts/cells").expect(200)["shape_count"], 0);
}

#[test]
fn the_holdings_of_a_subject_are_told() {
    let server = Server::fresh();
    for name in COHORTS {
        make_cohort(&server, name);
    }
    let shape = |k: usize, subject: &str| json!({"external_id": format!("scan-{k}"), "subject": subject, "points": [[0, 0], [4 + k, 0], [4, 3], [1, 5]]});
    let add = |cohort: &str, shapes: &[Value]| {
        let stored = server.post(&format!("/v1/cohorts/{cohort}/shapes"), &json!({"shapes": shapes}));
        stored.expect(201)["results"].clone()
    };
    let feet = add("feet", &[shape(0, "anna/1"), shape(1, "anna/1"), shape(2, "berta"), shape(3, "anna/1")]);
    let hands = add("hands", &[shape(0, "anna/1")]);
    add("ears", &[json!({"points": [[0, 0], [4, 0], [4, 3], [1, 5]]})]);
    let path = |k: usize| format!("/v1/cohorts/feet/shapes/{}", feet[k]["id"].as_str().unwrap());
    server.send(server.request(Method::PATCH, &path(0)).json(&json!({"subject": "berta"}))).expect(200);
    assert_eq!(server.delete(&path(1)).status, 204);
    assert_eq!(server.delete("/v1/cohorts/hands").status, 204);
    let of_anna = "/v1/subjects/anna%2F1";
    let found = server.get(of_anna).expect(200);
    assert_eq!(found["shape_count"], 4, "{found}");
    let cohorts = found["cohorts"].as_array().unwrap();
    let counts: Vec<Value> =
        cohorts.iter().map(|one| json!([one["name"], one["shape_count"], one["trashed"]])).collect();
    assert!(counts.contains(&json!(["feet", 3, false])) && counts.contains(&json!(["hands", 1, true])));
    let items = found["items"].as_array().unwrap();
    let current: Vec<&Value> =
        items.iter().filter(|item| item["current"] == true).map(|item| &item["id"]).collect();
    assert_eq!(current, [&feet[3]["id"], &hands[0]["id"]], "{found}");
    assert_eq!((items.len(), &items[0]["external_id"]), (4, &json!("scan-0")));
    // In pages.
    let first = server.get(&format!("{of_anna}?limit=3")).expect(200);
    let cursor = first["next"].as_str().unwrap();
    let second = server.get(&format!("{of_anna}?limit=3&cursor={cursor}")).expect(200);
    assert_eq!((&second["items"][0], &second["next"]), (&items[3], &Value::Null));
    assert_eq!(first["items"].as_array().unwrap()[..], items[..3]);
    // A subject never seen: proof of absence, and of a misspelling.
    for method in [Method::GET, Method::DELETE] {
        for query in ["", "?dry_run=true"] {
            if method == Method::GET && !query.is_empty() {
                continue;
            }
            let reply = server.send(server.request(method.clone(), &format!("/v1/subjects/typo{query}")));
            let problem = reply.expect_problem(404, "not-found", &[]);
            assert!(!problem["detail"].to_string().contains("typo"), "{problem}");
        }
    }
    for cohort in ["feet", "ears"] {
        let listed = server.get(&format!("/v1/cohorts/{cohort}/shapes?subject=typo")).expect(200);
        assert_eq!(listed["items"], json!([]), "{cohort}");
    }
    // A reader may ask; an administrator may erase, and try it first.
    let admin = create_key(&server, &["--role", "admin"]);
    let reader = create_key(&server, &["--role", "reader"]);
    let limited = create_key(&server, &["--role", "reader", "--cohort", "ears"]);
    let send =
        |method: Method, key: &str, path: &str| server.send(server.request(method, path).bearer_auth(key));
    await_status(401, || server.get("/v1/cohorts"));
    assert_eq!(send(Method::GET, &reader, of_anna).expect(200), found);
    assert_eq!(send(Method::GET, &limited, of_anna).status, 404);
    assert_eq!(send(Method::DELETE, &reader, of_anna).status, 403);
    let dry = send(Method::DELETE, &admin, &format!("{of_anna}?dry_run=true")).expect(200);
    assert_eq!((&dry["shape_count"], dry.get("files")), (&json!(4), None));
    let filtered = "/v1/cohorts/feet/shapes?subject=berta&dry_run=true";
    send(Method::DELETE, &admin, filtered).expect(200);
    assert_eq!(send(Method::DELETE, &admin, of_anna).expect(200)["shape_count"], 4);
    assert_eq!(send(Method::GET, &reader, of_anna).status, 404);
    assert_eq!(send(Method::DELETE, &admin, of_anna).expect(200)["shape_count"], 0, "it was erased before");
    let trail = send(Method::GET, &admin, "/v1/audit?limit=1000").expect(200);
    let objects = |operation: &str| {
        let items = trail["items"].as_array().unwrap().iter();
        let of = items.filter(|entry| entry["operation"] == operation && entry["status"] == 200);
        of.map(|entry| json!([entry["objects"]["dry_run"], entry["objects"]["shapes"]])).collect::<Vec<_>>()
    };
    assert_eq!(objects("erase_subject"), [json!(["true", "4"]), json!([null, "4"]), json!([null, "0"])]);
    assert_eq!(objects("delete_shapes"), [json!(["true", "2"])]);
    assert!(!trail.to_string().contains("anna"), "{trail}");
}

#[test]
fn erasures_are_repeated_in_a_store_that_was_restored() {
    let server = Server::fresh();
    make_cohort(&server, "feet");
    for patient in 20..23 {
        let stored = upload(&server, "feet", patient).expect(201);
        for result in stored["results"].as_array().unwrap() {
            correct(&server, "feet", result, patient);
        }
    }
    let (copy, list) = (server.folder().join("copy"), server.folder().join("erasures"));
    done(server.command("export").arg(&copy));
    server.delete(&format!("/v1/subjects/{}", token(21))).expect(200);
    let listed = done(&mut server.command("erasures"));
    assert_eq!(listed.lines().count(), 1, "{listed}");
    let entry: Value = serde_json::from_str(&listed).unwrap();
    assert_eq!((&entry["tenant"], entry["subject"].as_str().unwrap().len()), (&json!("default"), 64));
    assert!(!listed.contains("patient"), "{listed}");
    std::fs::write(&list, &listed).unwrap();
    let place = Setting::fresh();
    done(place.command("import").arg(&copy));
    let said = done(place.command("erasures").arg("--repeat").arg(&list));
    assert!(said.contains(&format!("erased {SHAPES} shapes of 1 subjects, of 1 in the list")), "{said}");
    let said = done(place.command("erasures").arg("--repeat").arg(&list));
    assert!(said.contains("erased 0 shapes of 0 subjects"), "{said}");
    assert!(done(&mut place.command("check")).contains(": no findings"));
    assert!(done(&mut place.command("erasures")).contains("\"files\":\"done\""));
    let restored = place.start();
    restored.get(&format!("/v1/subjects/{}", token(21))).expect_problem(404, "not-found", &[]);
    assert_eq!(restored.get("/v1/cohorts/feet").expect(200)["shape_count"], 2 * SHAPES);
    if restored.database().is_none() {
        assert_eq!(held(&restored, 20..23), [20, 22]);
    }
    let wrong = std::process::Command::new(env!("CARGO_BIN_EXE_shapelex"))
        .args(["erasures", "--repeat"])
        .arg(&copy)
        .arg("--data-dir")
        .arg(server.folder().join("elsewhere"))
        .output()
        .unwrap();
    assert_eq!(wrong.status.code(), Some(2), "a file of another kind");
}
