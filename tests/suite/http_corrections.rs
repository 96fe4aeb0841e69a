//! Shapes corrected, deleted by a filter, and erased by their subject.

use reqwest::Method;
use serde_json::{Value, json};

use crate::server::{Reply, Server, Setting};

fn cohort(server: &Server, name: &str) -> String {
    let body = json!({"name": name, "representation": {"kind": "landmarks", "dimension": 2, "points": 3}});
    server.post("/v1/cohorts", &body).expect(201)["id"].as_str().unwrap().to_owned()
}

fn triangle(number: usize, label: &str, subject: &str) -> Value {
    json!({"external_id": format!("scan/{number}"), "label": label, "subject": subject,
        "labels": {"site": "zrh", "age": number}, "metadata": {"scanner": {"name": "m1", "dose": 3}},
        "control_points": [[0, 0], [number + 1, 0], [0.5, 1.0 + number as f64 / 8.0]]})
}

fn add(server: &Server, name: &str, shapes: &[Value]) -> Value {
    server.post(&format!("/v1/cohorts/{name}/shapes"), &json!({"shapes": shapes})).expect(201)
}

fn patch(server: &Server, path: &str, body: &Value) -> Reply {
    let request = server.request(Method::PATCH, path);
    server.send(request.header("content-type", "application/merge-patch+json").body(body.to_string()))
}

fn last_change(server: &Server) -> Value {
    server.get("/v1/changes").expect(200)["items"].as_array().unwrap().last().unwrap().clone()
}

#[test]
fn a_shape_is_corrected_by_a_merge_patch() {
    let server = Server::fresh();
    let id = cohort(&server, "feet");
    let shapes: Vec<Value> = (0..3).map(|k| triangle(k, "control", "patient-1")).collect();
    let added = add(&server, "feet", &shapes);
    let path = "/v1/cohorts/feet/shapes/scan%2F1";
    let before = server.get(path).expect(200);
    let change = json!({"label": "treated", "labels": {"site": null, "reader": "r2"}, "subject": "patient-2",
        "metadata": {"scanner": {"dose": null}, "why": "mislabelled"}, "weight": 2.5});
    let reply = patch(&server, path, &change);
    let after = reply.expect(200);
    let mut wanted = before.clone();
    wanted["label"] = json!("treated");
    wanted["labels"] = json!({"age": 1, "reader": "r2"});
    wanted["subject"] = json!("patient-2");
    wanted["metadata"] = json!({"scanner": {"name": "m1"}, "why": "mislabelled"});
    wanted["weight"] = json!(2.5);
    assert_eq!(after, wanted);
    assert_eq!(server.get(path).expect(200), wanted);
    let feet = server.get("/v1/cohorts/feet");
    assert_eq!(reply.header("etag"), feet.header("etag"));
    let feet = feet.expect(200);
    assert_eq!((&feet["revision"], &feet["shape_count"]), (&json!(2), &json!(3)));
    let change = last_change(&server);
    assert_eq!(
        (&change["kind"], &change["object"], &change["cohort"], &change["revision"]),
        (&json!("shape_updated"), &added["results"][1]["id"], &json!(id), &json!(2))
    );
    // By its id; null removes.
    let by_id = format!("/v1/cohorts/{id}/shapes/{}", added["results"][1]["id"].as_str().unwrap());
    let all = json!({"label": null, "labels": null, "subject": null, "metadata": null, "weight": null});
    let bare = patch(&server, &by_id, &all).expect(200);
    for (field, value) in
        [("label", json!(null)), ("labels", json!({})), ("subject", json!(null)), ("weight", json!(1.0))]
    {
        assert_eq!(bare[field], value, "{field}");
    }
    assert_eq!((&bare["metadata"], &bare["external_id"]), (&json!(null), &json!("scan/1")));
    // What changes nothing makes no revision.
    for nothing in [json!({}), json!({"label": null}), json!({"labels": {"gone": null}, "weight": 1})] {
        patch(&server, path, &nothing).expect(200);
    }
    assert_eq!(server.get("/v1/cohorts/feet").expect(200)["revision"], 3);
    // Lists and filters see the shape once, as it is now.
    let listed = server.get("/v1/cohorts/feet/shapes").expect(200);
    assert_eq!(listed["items"].as_array().unwrap().len(), 3);
    let controls = server.get("/v1/cohorts/feet/shapes?label=control").expect(200);
    assert_eq!(controls["items"].as_array().unwrap().len(), 2);
}

#[test]
fn corrections_are_checked_as_what_arrives() {
    let server = Server::fresh();
    cohort(&server, "feet");
    let shape = triangle(1, "control", "patient-1");
    let added = add(&server, "feet", std::slice::from_ref(&shape));
    let path = "/v1/cohorts/feet/shapes/scan%2F1";
    let refused = |body: Value, pointers: &[&str]| {
        patch(&server, path, &body).expect_problem(422, "invalid-input", pointers)
    };
    let problem = refused(
        json!({"labell": "x", "points": [[0, 0]], "id": "a", "external_id": "b"}),
        &["/labell", "/points", "/id", "/external_id"],
    );
    let text = problem.to_string();
    assert!(text.contains("label, labels, metadata, subject, weight"), "{text}");
    assert!(text.contains("expected no geometry") && text.contains("expected no identifier"), "{text}");
    refused(
        json!({"label": 7, "labels": {"a/b": [1]}, "weight": -1, "subject": ""}),
        &["/label", "/labels/a~1b", "/weight", "/subject"],
    );
    refused(json!({"labels": "none"}), &["/labels"]);
    refused(json!([1]), &[""]);
    refused(json!({"metadata": "x".repeat(70_000)}), &["/metadata"]);
    let twice = server.request(Method::PATCH, path).header("content-type", "application/json");
    let twice = server.send(twice.body(r#"{"label": "a", "label": "b"}"#));
    twice.expect_problem(422, "invalid-input", &["/label"]);
    let other = server.request(Method::PATCH, path).header("content-type", "application/geo+json");
    server.send(other.body("{}")).expect_problem(415, "unsupported-media-type", &[]);
    for path in ["/v1/cohorts/feet/shapes/none", "/v1/cohorts/none/shapes/none"] {
        patch(&server, path, &json!({"label": "a"})).expect_problem(404, "not-found", &[]);
    }
    // At the version that the client has seen.
    let tag = server.get("/v1/cohorts/feet").header("etag").unwrap().to_owned();
    let change = |tag: &str, label: &str| {
        let request = server.request(Method::PATCH, path).header("if-match", tag);
        server.send(request.json(&json!({"label": label})))
    };
    let next = change(&tag, "treated").header("etag").unwrap().to_owned();
    change(&tag, "else").expect_problem(412, "precondition-failed", &[]);
    change(&next, "other").expect(200);
    // A repeated upload adds nothing, and leaves the correction as it is.
    let again = server.post("/v1/cohorts/feet/shapes", &json!({"shapes": [shape]})).expect(201);
    assert_eq!((&again["added"], &again["unchanged"]), (&json!(0), &json!(1)));
    assert!(again["warnings"].to_string().contains("1 shapes stand in the cohort"), "{again}");
    let mut moved = shape.clone();
    moved["control_points"] = json!([[0, 0], [9, 0], [0.5, 3]]);
    let moved = server.post("/v1/cohorts/feet/shapes", &json!({"shapes": [moved]}));
    moved.expect_problem(409, "external-id-conflict", &["/shapes/0/external_id"]);
    let mut corrected = shape.clone();
    corrected["label"] = json!("other");
    let again = add(&server, "feet", &[corrected]);
    assert_eq!((&again["added"], &again["results"]), (&json!(0), &added["results"]));
    assert_eq!(again.get("warnings"), None);
}

/// Neither of two values takes precedence, at any depth, wherever a document is taken.
#[test]
fn names_that_are_given_twice_are_refused_at_any_depth() {
    let server = Server::fresh();
    cohort(&server, "feet");
    add(&server, "feet", &[triangle(1, "control", "p")]);
    let send = |method: Method, path: &str, body: &str| {
        let request = server.request(method, path).header("content-type", "application/json");
        server.send(request.body(body.to_owned()))
    };
    let shape = "/v1/cohorts/feet/shapes/scan%2F1";
    for (body, pointers) in [
        (r#"{"labels": {"n": 1, "n": 2}}"#, &["/labels/n"][..]),
        (r#"{"labels": {"n": 1}, "labels": {"m": 2}}"#, &["/labels"]),
        (
            r#"{"metadata": {"a": [{"b": 1, "b": 1}]}, "labels": {"n": null, "n": null}}"#,
            &["/metadata/a/0/b", "/labels/n"],
        ),
    ] {
        send(Method::PATCH, shape, body).expect_problem(422, "invalid-input", pointers);
    }
    let points = r#""points": [[0, 0], [1, 0], [0, 1]]"#;
    for (fields, pointer) in [
        (r#""labels": {"n": 1, "n": 2}"#, "/shapes/0/labels/n"),
        (r#""metadata": {"a": {"b": 1, "b": 2}}"#, "/shapes/0/metadata/a/b"),
    ] {
        let body = format!(r#"{{"shapes": [{{{points}, {fields}}}]}}"#);
        send(Method::POST, "/v1/cohorts/feet/shapes", &body).expect_problem(422, "invalid-input", &[pointer]);
    }
    let body = r#"{"filter": {"labels": {"age": 1, "age": 2}}}"#;
    send(Method::POST, "/v1/cohorts/feet/table", body).expect_problem(
        422,
        "invalid-input",
        &["/filter/labels/age"],
    );
    assert_eq!(server.get(shape).expect(200)["labels"], json!({"site": "zrh", "age": 1}));
}

#[test]
fn shapes_are_deleted_by_a_filter() {
    let server = Server::fresh();
    let id = cohort(&server, "feet");
    let label = |k: usize| if k.is_multiple_of(3) { "treated" } else { "control" };
    let shapes: Vec<Value> = (0..9).map(|k| triangle(k, label(k), &format!("patient-{}", k % 2))).collect();
    add(&server, "feet", &shapes);
    let path = "/v1/cohorts/feet/shapes";
    let delete = |query: &str| server.delete(&format!("{path}{query}"));
    for query in ["", "?dry_run=true"] {
        let problem = delete(query).expect_problem(400, "invalid-query", &[]);
        assert!(problem["detail"].as_str().unwrap().contains("expected a filter, or all=true"), "{problem}");
    }
    delete("?all=true&label=control").expect_problem(400, "invalid-query", &[]);
    delete("?colour=red").expect(400);
    delete("?labels.colour=red").expect(400);
    delete("?label=control&dry_run=yes").expect(400);
    server.delete("/v1/cohorts/none/shapes?all=true").expect_problem(404, "not-found", &[]);
    let dry = delete("?label=treated&dry_run=true").expect(200);
    assert_eq!(dry, json!({"deleted": 3, "dry_run": true}));
    assert_eq!(server.get("/v1/cohorts/feet").expect(200)["revision"], 1);
    assert_eq!(delete("?label=unheard-of").expect(200), json!({"deleted": 0, "revision": 1}));
    let tag = server.get("/v1/cohorts/feet").header("etag").unwrap().to_owned();
    let conditional = |tag: &str| {
        let path = format!("{path}?label=treated&subject=patient-0");
        server.send(server.request(Method::DELETE, &path).header("if-match", tag))
    };
    conditional("\"other\"").expect_problem(412, "precondition-failed", &[]);
    assert_eq!(conditional(&tag).expect(200), json!({"deleted": 2, "revision": 2}));
    let change = last_change(&server);
    assert_eq!(
        (&change["kind"], &change["object"], &change["shape_count"], &change["revision"]),
        (&json!("shapes_deleted"), &json!(id), &json!(2), &json!(2))
    );
    assert_eq!(delete("?labels.age=3").expect(200), json!({"deleted": 1, "revision": 3}));
    assert_eq!(server.get("/v1/cohorts/feet").expect(200)["shape_count"], 6);
    assert_eq!(delete("?all=true").expect(200), json!({"deleted": 6, "revision": 4}));
    assert_eq!(server.get(path).expect(200)["items"], json!([]));
}

fn learning(name: &str, filter: &Value) -> Value {
    json!({"name": name, "cohort": "feet", "transformation": "similarity", "filter": filter,
        "method": {"kind": "functional_pca", "components": 1}})
}

/// Learns a dictionary, and returns its id and digest.
fn learn(server: &Server, name: &str, filter: &Value) -> (Value, Value) {
    let body = learning(name, filter);
    let request = server.request(Method::POST, "/v1/dictionaries").header("prefer", "wait=60").json(&body);
    server.send(request).expect(201);
    let learnt = server.get(&format!("/v1/dictionaries/{name}")).expect(200);
    (learnt["id"].clone(), learnt["provenance"]["digest"].clone())
}

/// Computes the distances of a cohort as a job, and returns its id.
fn distances(server: &Server) -> String {
    let body = json!({"cohort": "feet", "transformation": "similarity"});
    let job = server.post("/v1/distances", &body).expect(202);
    let id = job["id"].as_str().unwrap().to_owned();
    assert!(server.get(&format!("/v1/jobs/{id}/events")).text().contains("succeeded"));
    id
}

#[test]
fn a_subject_is_erased_everywhere() {
    let server = Setting::fresh().flags(&["--max-matrix-operations", "1"]).start();
    let (feet, hands, gone) = (cohort(&server, "feet"), cohort(&server, "hands"), cohort(&server, "gone"));
    let subject = "subject-of-anna/1";
    let who = |k: usize| if k.is_multiple_of(4) { subject } else { "patient-2" };
    let shapes: Vec<Value> = (0..12).map(|k| triangle(k, if k < 6 { "a" } else { "b" }, who(k))).collect();
    add(&server, "feet", &shapes);
    add(&server, "hands", &shapes[..3]);
    add(&server, "gone", &shapes[..2]);
    server.delete("/v1/cohorts/gone");
    let everything = learn(&server, "everything", &json!({}));
    let others = learn(&server, "others", &json!({"subject": "patient-2"}));
    let early = learn(&server, "early", &json!({"label": "a"}));
    assert_eq!(server.delete("/v1/dictionaries/early").status, 204);
    let job = distances(&server);
    patch(&server, "/v1/cohorts/feet/shapes/scan%2F4", &json!({"label": "c"})).expect(200);
    server.delete("/v1/cohorts/feet/shapes/scan%2F8");
    let mean = "/v1/cohorts/feet/mean?transformation=similarity&stale=true";
    assert_eq!(server.get(mean).expect(200)["revision"], 3);

    let path = "/v1/subjects/subject-of-anna%2F1";
    let dry = server.delete(&format!("{path}?dry_run=true")).expect(200);
    assert_eq!((&dry["dry_run"], &dry["shape_count"]), (&json!(true), &json!(5)), "{dry}");
    assert_eq!(server.get("/v1/cohorts/feet").expect(200)["revision"], 3);
    let erased = server.delete(path).expect(200);
    assert_eq!((&erased["shape_count"], erased.get("dry_run")), (&json!(5), None), "{erased}");
    let mut cohorts = vec![
        json!({"id": feet, "name": "feet", "revision": 4, "shape_count": 3, "trashed": false}),
        json!({"id": hands, "name": "hands", "revision": 2, "shape_count": 1, "trashed": false}),
        json!({"id": gone, "name": "gone", "revision": 3, "shape_count": 1, "trashed": true}),
    ];
    cohorts.sort_by_key(|cohort| cohort["id"].as_str().unwrap().to_owned());
    assert_eq!(erased["cohorts"], json!(cohorts));
    let versions = erased["dictionaries"].as_array().unwrap().iter();
    let named: Vec<Value> =
        versions.map(|version| json!([version["id"], version["digest"], version["trashed"]])).collect();
    let wanted = [json!([everything.0, everything.1, false]), json!([early.0, early.1, true])];
    assert!(named.len() == 2 && wanted.iter().all(|version| named.contains(version)), "{erased}");
    assert_eq!(erased["dictionaries"][0]["cohort"], json!(feet));
    assert!(!erased.to_string().contains(others.0.as_str().unwrap()), "{erased}");
    let jobs = erased["jobs"].as_array().unwrap();
    let is_removed = |found: &Value| found["id"] == json!(job) && found["outcome"] == "removed";
    assert!(jobs.iter().any(is_removed), "{erased}");
    server.get(&format!("/v1/jobs/{job}")).expect_problem(404, "not-found", &[]);
    server.get(&format!("/v1/jobs/{job}/output")).expect_problem(404, "not-found", &[]);

    assert_eq!(server.get("/v1/dictionaries/everything").expect(200)["provenance"]["digest"], everything.1);
    // What was learnt from erased shapes is not continued.
    let mut further = learning("everything", &json!({}));
    further["continue_from"] = json!("everything");
    for field in ["transformation", "filter", "method"] {
        further.as_object_mut().unwrap().remove(field);
    }
    let refused = server.post("/v1/dictionaries", &further);
    let refused = refused.expect_problem(422, "invalid-input", &["/continue_from"]);
    assert!(refused.to_string().contains("3 of the shapes"), "{refused}");
    assert_eq!(server.get(mean).expect(200)["revision"], 4, "no mean that holds erased shapes");
    let left = server.get("/v1/cohorts/feet/shapes").expect(200);
    assert_eq!(left["items"].as_array().unwrap().len(), 9);
    assert!(!left.to_string().contains("anna"), "{left}");
    assert_eq!(server.get("/v1/cohorts/feet").expect(200)["shape_count"], 9);
    server.get("/v1/cohorts/feet/shapes/scan%2F4").expect_problem(404, "not-found", &[]);
    let changes = server.get("/v1/changes").expect(200);
    let kinds = changes["items"].as_array().unwrap();
    let of_subject: Vec<&Value> = kinds.iter().filter(|change| change["kind"] == "subject_erased").collect();
    assert_eq!(of_subject.len(), 2, "{changes}");
    assert!(of_subject.iter().any(|change| change["cohort"] == json!(feet) && change["shape_count"] == 3));
    let audit = server.get("/v1/audit").expect(200);
    let entries = audit["items"].as_array().unwrap();
    let entry = entries.iter().rfind(|entry| entry["operation"] == "erase_subject").unwrap();
    assert_eq!((&entry["objects"]["shapes"], &entry["status"]), (&json!("5"), &json!(200)), "{entry}");
    for text in [changes.to_string(), audit.to_string(), server.log()] {
        assert!(!text.contains("anna"), "the subject is named: {text}");
    }

    let again = server.delete(path).expect(200);
    let files = if server.database().is_some() { "pending" } else { "done" };
    let nothing = json!({"shape_count": 0, "cohorts": [], "dictionaries": [], "jobs": [], "files": files});
    assert_eq!(again, nothing);
    server.send(server.request(Method::POST, &format!("/v1/trash/{gone}/restore")));
    assert_eq!(server.get("/v1/cohorts/gone").expect(200)["shape_count"], 1);
    // An external id of an erased shape is free.
    assert_eq!(add(&server, "feet", &[triangle(0, "a", "patient-2")])["added"], 1);
    let check = server.command("check").output().unwrap();
    assert!(check.status.success(), "{}", String::from_utf8_lossy(&check.stdout));
}

/// The job, as soon as it is in this phase of a run that began after a time.
fn job_in(server: &Server, job: &str, phase: &str, after: &Value) -> Value {
    for _ in 0..600 {
        let found = server.get(&format!("/v1/jobs/{job}")).expect(200);
        assert!(["queued", "running"].contains(&found["status"].as_str().unwrap()), "{found}");
        if found["phase"] == phase && found["started_at"] != *after {
            return found;
        }
        std::thread::sleep(std::time::Duration::from_millis(50));
    }
    panic!("the job is not in the phase {phase}");
}

#[test]
fn a_running_job_begins_again_without_the_erased_shapes() {
    let server = Setting::fresh().with_example().start();
    let shapes = server.get("/v1/cohorts/example-cells/shapes?limit=1").expect(200);
    let path = format!("/v1/cohorts/example-cells/shapes/{}", shapes["items"][0]["id"].as_str().unwrap());
    patch(&server, &path, &json!({"subject": "patient-0"})).expect(200);
    let long = json!({"kind": "sparse", "atoms": 30, "lambda": 0.02, "max_epochs": 1500, "tolerance": 0.0});
    let body =
        json!({"name": "cells", "cohort": "example-cells", "transformation": "similarity", "method": long});
    let submitted = server.post("/v1/dictionaries", &body).expect(202);
    let job = submitted["id"].as_str().unwrap();
    let running = job_in(&server, job, "learn", &Value::Null);
    let erased = server.delete("/v1/subjects/patient-0").expect(200);
    assert_eq!(erased["shape_count"], 1);
    let wanted = json!([{"id": job, "kind": "learn_dictionary", "outcome": "restarted"}]);
    assert_eq!(erased["jobs"], wanted);
    let again = job_in(&server, job, "learn", &running["started_at"]);
    assert_eq!(again["attempt"], 1, "the attempt that was broken off does not count");
    server.send(server.request(Method::POST, &format!("/v1/jobs/{job}/cancel"))).expect(200);
}

#[test]
fn another_replica_answers_no_older_mean_after_an_erasure() {
    let server = Server::fresh();
    if server.database().is_none() {
        return;
    }
    let other = server.beside().start();
    cohort(&server, "feet");
    let shapes: Vec<Value> = (0..6).map(|k| triangle(k, "a", &format!("patient-{k}"))).collect();
    add(&server, "feet", &shapes);
    let mean = "/v1/cohorts/feet/mean?transformation=similarity&stale=true";
    assert_eq!(other.get(mean).expect(200)["revision"], 1);
    patch(&server, "/v1/cohorts/feet/shapes/scan%2F1", &json!({"label": "b"})).expect(200);
    assert_eq!(other.get(mean).expect(200)["revision"], 1, "a correction leaves earlier revisions");
    assert_eq!(server.delete("/v1/subjects/patient-3").expect(200)["shape_count"], 1);
    let found = other.get(mean).expect(200);
    assert_eq!((&found["revision"], &found["shape_count"]), (&json!(3), &json!(5)));
}

#[test]
fn the_files_of_the_store_keep_nothing_of_an_erased_subject() {
    let server = Setting::fresh().embedded().start();
    cohort(&server, "feet");
    let shapes: Vec<Value> = (0..30)
        .map(|k| {
            let mut shape = triangle(k, "label", if k == 11 { "subject-anna" } else { "patient" });
            if k == 11 {
                shape["external_id"] = json!("external-anna");
                shape["metadata"] = json!({"note": "metadata-anna"});
                shape["control_points"][1][0] = json!(1234.567891);
            }
            shape
        })
        .collect();
    add(&server, "feet", &shapes);
    let held = |wanted: &[u8]| {
        let files = std::fs::read_dir(server.folder().join("data")).unwrap();
        let mut bytes = files.filter_map(|file| std::fs::read(file.unwrap().path()).ok());
        bytes.any(|bytes| bytes.windows(wanted.len()).any(|window| window == wanted))
    };
    let number = 1_234.567_891_f64.to_le_bytes();
    assert!(held(&number) && held(b"anna"));
    assert_eq!(server.delete("/v1/subjects/subject-anna").expect(200)["shape_count"], 1);
    assert!(!held(&number) && !held(b"anna") && held(b"patient"));
}
