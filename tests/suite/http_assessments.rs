//! Assessments of all shapes of a cohort: lines at once, or as the output of a job.

use std::time::{Duration, Instant};

use reqwest::Method;
use serde_json::{Value, json};

use crate::document::furnished;
use crate::server::{Reply, Server, Setting};

const PATH: &str = "/v1/dictionaries/modes/assessments";

/// Asks for a job.
fn submit(server: &Server, body: &Value, prefer: &str) -> Reply {
    server.send(server.request(Method::POST, PATH).header("prefer", prefer).json(body))
}

/// Lines of an answer.
#[track_caller]
fn lines(reply: &Reply) -> Vec<Value> {
    assert_eq!(
        (reply.status, reply.header("content-type")),
        (200, Some("application/x-ndjson")),
        "{}",
        reply.text()
    );
    reply.text().lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// Waits until a job has ended.
#[track_caller]
fn ended(server: &Server, path: &str) -> Value {
    let start = Instant::now();
    loop {
        let job = server.get(path).expect(200);
        if !["queued", "running"].contains(&job["status"].as_str().unwrap()) {
            return job;
        }
        assert!(start.elapsed() < Duration::from_secs(120), "{job}");
        std::thread::sleep(Duration::from_millis(50));
    }
}

/// Quadrilaterals of which every `degenerate`-th is a line.
fn quadrilaterals(count: usize, degenerate: usize) -> Vec<Value> {
    let shape = |k: usize| {
        let (x, y) = (2.0 + (k % 17) as f64 / 10.0, 1.0 + (k % 13) as f64 / 10.0);
        let points = match degenerate > 0 && k % degenerate == degenerate - 1 {
            true => json!([[0, 0], [1, 1], [2, 2], [3, 3]]),
            false => json!([[0, 0], [x, 0.1], [2, y], [0.2, 1]]),
        };
        json!({"points": points, "external_id": format!("t{k}"), "labels": {"part": (k % 2).to_string()}})
    };
    (0..count).map(shape).collect()
}

/// A service with the cohort `corners` and the dictionary `modes`, learnt from its first shapes.
fn with_quadrilaterals(setting: Setting, count: usize, degenerate: usize) -> Server {
    let server = setting.start();
    let cohort =
        json!({"name": "corners", "representation": {"kind": "landmarks", "dimension": 2, "points": 4}});
    server.post("/v1/cohorts", &cohort).expect(201);
    server.post("/v1/cohorts/corners/shapes", &json!({"shapes": quadrilaterals(20, 0)})).expect(201);
    let learn = json!({"name": "modes", "cohort": "corners", "transformation": "affine",
        "method": {"kind": "functional_pca", "components": 2, "centre": true}});
    let request = server.request(Method::POST, "/v1/dictionaries").header("prefer", "wait=60");
    server.send(request.json(&learn)).expect(201);
    let more: Vec<Value> = quadrilaterals(count, degenerate).split_off(20);
    for part in more.chunks(5000) {
        server.post_lines("/v1/cohorts/corners/shapes", part).expect(201);
    }
    server
}

#[test]
fn few_shapes_are_answered_at_once_as_assess_does() {
    let server = furnished();
    let reply = server.post(PATH, &json!({"cohort": "example-cells", "samples": 4}));
    let found = lines(&reply);
    assert_eq!(reply.header("shapelex-revision"), Some("1"));
    let shapes = server.get("/v1/cohorts/example-cells/shapes?limit=1000&fields=id,external_id").expect(200);
    let ids: Vec<&Value> = shapes["items"].as_array().unwrap().iter().map(|shape| &shape["id"]).collect();
    assert_eq!(found.iter().map(|line| &line["id"]).collect::<Vec<_>>(), ids);
    let asked = json!({"cohort": "example-cells", "ids": ids, "samples": 4});
    let answer = server.post("/v1/dictionaries/modes/assess", &asked).expect(200);
    for (line, entry) in found.iter().zip(answer["results"].as_array().unwrap()) {
        for field in ["external_id", "code", "class", "novelty", "relative_error", "residual"] {
            assert_eq!(line[field], entry[field], "{field}");
        }
        assert_eq!(line["dictionary"], answer["dictionary"]);
    }
    // Without samples there are no residuals; a filter selects.
    let some = json!({"cohort": "example-cells", "filter": {"labels": {"treatment": "control"}}});
    let some = lines(&server.post(PATH, &some));
    assert!(!some.is_empty() && some.len() < found.len(), "{} of {}", some.len(), found.len());
    assert!(some.iter().all(|line| line["residual"] == json!([])));
    assert_eq!(server.get("/v1/jobs?kind=assess").expect(200)["items"], json!([]));
}

#[test]
fn a_job_gives_the_same_lines() {
    let server = furnished();
    let body = json!({"cohort": "example-cells", "quantile": 0.9});
    let at_once = lines(&server.post(PATH, &body));
    let accepted = submit(&server, &body, "respond-async");
    let job = accepted.expect(202);
    assert_eq!((&job["kind"], job["result"].is_null()), (&json!("assess"), true));
    let path = accepted.header("location").unwrap();
    let job = ended(&server, path);
    assert_eq!((&job["status"], &job["progress"]), (&json!("succeeded"), &json!(1.0)), "{job}");
    let result = &job["result"];
    let outliers = at_once.iter().filter(|line| line["novelty"]["is_outlier"] == true).count();
    let counts =
        ["shape_count", "outlier_count", "error_count"].map(|name| result[name].as_u64().unwrap() as usize);
    assert_eq!(counts, [at_once.len(), outliers, 0]);
    assert_eq!(result["dictionary"], at_once[0]["dictionary"]);
    let output = result["output"].as_str().unwrap();
    assert_eq!(output, format!("{path}/output"));
    assert_eq!(lines(&server.get(output)), at_once);
    assert_eq!(lines(&server.get(&format!("{output}?format=ndjson"))), at_once);
    // Who waits gets them in the same answer.
    assert_eq!(lines(&submit(&server, &body, "respond-async, wait=60")), at_once);
    // They are lines and nothing else.
    server.get(&format!("{output}?format=csv")).expect_problem(400, "invalid-query", &[]);
    let json = server.request(Method::GET, output).header("accept", "application/json");
    server.send(json).expect_problem(406, "not-acceptable", &[]);
    server.get(&format!("{output}?format=xml")).expect_problem(400, "invalid-query", &[]);
}

#[test]
fn lines_of_many_shapes_are_kept_in_parts_and_shapes_without_an_assessment_have_an_error() {
    let server = with_quadrilaterals(Setting::fresh(), 6000, 1000);
    let job = submit(&server, &json!({"cohort": "corners"}), "respond-async").expect(202);
    let path = format!("/v1/jobs/{}", job["id"].as_str().unwrap());
    let job = ended(&server, &path);
    assert_eq!(job["status"], "succeeded", "{job}");
    assert_eq!((&job["result"]["shape_count"], &job["result"]["error_count"]), (&json!(6000), &json!(6)));
    let reply = server.get(&format!("{path}/output"));
    // More than a part.
    assert!(reply.body.len() > 3 << 20, "{}", reply.body.len());
    let found = lines(&reply);
    for (k, line) in found.iter().enumerate() {
        assert_eq!(line["external_id"], format!("t{k}"), "{line}");
        let is_flat = k >= 20 && k % 1000 == 999;
        assert_eq!(line.get("error").is_some(), is_flat, "{line}");
        if is_flat {
            assert_eq!(line["error"]["code"], "degenerate-shape", "{line}");
            let errors = &line["error"]["errors"][0];
            assert_eq!((&errors["pointer"], &errors["index"]), (&json!(""), &Value::Null), "{line}");
        }
    }
    let half = json!({"cohort": "corners", "filter": {"labels": {"part": "1"}}});
    let half = submit(&server, &half, "respond-async, wait=60");
    assert_eq!(lines(&half).len(), 3000);
    // The store is as it should be, with its parts.
    let server = server.terminate().start();
    assert_eq!(lines(&server.get(&format!("{path}/output"))).len(), 6000);
    let setting = server.terminate();
    let checked = setting.command("check").output().unwrap();
    assert!(checked.status.success(), "{}", String::from_utf8_lossy(&checked.stdout));
}

#[test]
fn later_changes_of_cohort_and_alias_do_not_alter_a_job() {
    let server = furnished();
    let alias = server.request(Method::PUT, "/v1/dictionaries/modes/aliases/production");
    server.send(alias.json(&json!({"version": 1}))).expect(201);
    let body = json!({"cohort": "example-cells"});
    let request = server.request(Method::POST, "/v1/dictionaries/modes@production/assessments");
    let job = server.send(request.header("prefer", "respond-async").json(&body)).expect(202);
    let path = format!("/v1/jobs/{}", job["id"].as_str().unwrap());
    let shapes = server.get("/v1/cohorts/example-cells/shapes?limit=1&fields=id").expect(200);
    let shape = shapes["items"][0]["id"].as_str().unwrap();
    assert_eq!(server.delete(&format!("/v1/cohorts/example-cells/shapes/{shape}")).status, 204);
    let job = ended(&server, &path);
    assert_eq!(
        (&job["status"], &job["result"]["cohort_revision"]),
        (&json!("succeeded"), &json!(1)),
        "{job}"
    );
    assert_eq!(job["result"]["dictionary"]["version"], 1);
    assert_eq!(lines(&server.get(&format!("{path}/output"))).len(), 120);
    // A repeated request is answered with its job.
    let again = || {
        let request = server.request(Method::POST, PATH).header("idempotency-key", "assess-1");
        server.send(request.header("prefer", "respond-async").json(&body)).expect(202)["id"].clone()
    };
    assert_eq!(again(), again());
}

#[test]
fn a_cancelled_job_leaves_no_lines() {
    let server = with_quadrilaterals(Setting::fresh(), 20_000, 0);
    let job = submit(&server, &json!({"cohort": "corners", "samples": 3}), "respond-async").expect(202);
    let path = format!("/v1/jobs/{}", job["id"].as_str().unwrap());
    let start = Instant::now();
    let running = |job: &Value| job["status"] == "running" && job["progress"].as_f64().unwrap() > 0.0;
    while !running(&server.get(&path).expect(200)) && start.elapsed() < Duration::from_secs(30) {
        std::thread::sleep(Duration::from_millis(5));
    }
    let reply = server.post(&format!("{path}/cancel"), &json!({}));
    // A fast machine may be done.
    if reply.status == 200 {
        assert_eq!(reply.json()["status"], "cancelled");
        server.get(&format!("{path}/output")).expect_problem(404, "not-found", &[]);
        assert_eq!(server.get(&path).expect(200)["status"], "cancelled");
    }
    server.get("/v1/jobs/job_none/output").expect_problem(404, "not-found", &[]);
}

#[test]
fn a_killed_service_goes_on_with_the_job() {
    let server = with_quadrilaterals(Setting::fresh(), 12_000, 0);
    let job = submit(&server, &json!({"cohort": "corners", "samples": 3}), "respond-async").expect(202);
    let path = format!("/v1/jobs/{}", job["id"].as_str().unwrap());
    std::thread::sleep(Duration::from_millis(400));
    let server = server.kill().start();
    let job = ended(&server, &path);
    assert_eq!(job["status"], "succeeded", "{job}");
    let found = lines(&server.get(&format!("{path}/output")));
    let ids: std::collections::BTreeSet<&str> =
        found.iter().map(|line| line["id"].as_str().unwrap()).collect();
    assert_eq!((found.len(), ids.len()), (12_000, 12_000));
}

#[test]
fn erased_shapes_vanish_from_stored_lines() {
    let server = furnished();
    let named = json!({"shapes": [{"points": [[0, 0], [4, 0], [4, 1], [0, 1]], "subject": "p-1", "external_id": "new"}]});
    server.post("/v1/cohorts/example-cells/shapes", &named).expect(201);
    let body = json!({"cohort": "example-cells"});
    let found = submit(&server, &body, "respond-async, wait=60");
    assert!(lines(&found).iter().any(|line| line["external_id"] == "new"));
    let job = server.get("/v1/jobs?kind=assess").expect(200)["items"][0]["id"].as_str().unwrap().to_owned();
    server.send(server.request(Method::DELETE, "/v1/subjects/p-1")).expect(200);
    server.get(&format!("/v1/jobs/{job}/output")).expect_problem(404, "not-found", &[]);
    let found = lines(&submit(&server, &body, "respond-async, wait=60"));
    assert!(found.iter().all(|line| line["external_id"] != "new"));
}

#[test]
fn bad_requests_for_assessments_are_refused() {
    let server = furnished();
    let post = |body: &Value| server.post(PATH, body);
    post(&json!({})).expect_problem(422, "invalid-input", &["/cohort"]);
    post(&json!({"cohort": "nobody"})).expect_problem(404, "not-found", &["/cohort"]);
    let cells = |field: &str, value: Value| {
        let mut body = json!({"cohort": "example-cells"});
        body[field] = value;
        post(&body)
    };
    for quantile in [json!(0.2), json!(1), json!("x"), json!(-1e300)] {
        cells("quantile", quantile).expect_problem(422, "invalid-input", &["/quantile"]);
    }
    for samples in [json!(-1), json!(1e9 as u64), json!(u64::MAX), json!(1.5)] {
        cells("samples", samples).expect_problem(422, "invalid-input", &["/samples"]);
    }
    for filter in [json!({"labels": {"nobody": "x"}}), json!({"labels": {"treatment": "nobody"}}), json!(3)] {
        let problem = cells("filter", filter.clone()).expect(422);
        assert!(
            problem["errors"][0]["pointer"].as_str().unwrap().starts_with("/filter"),
            "{filter}: {problem}"
        );
    }
    cells("priority", json!("now")).expect_problem(422, "invalid-input", &["/priority"]);
    cells("shapes", json!([])).expect_problem(422, "invalid-input", &["/shapes"]);
    let several = json!({"cohort": 3, "quantile": "x", "samples": [], "colour": 1});
    post(&several).expect_problem(422, "invalid-input", &["/cohort", "/quantile", "/samples", "/colour"]);
    let corners =
        json!({"name": "corners", "representation": {"kind": "landmarks", "dimension": 2, "points": 3}});
    server.post("/v1/cohorts", &corners).expect(201);
    post(&json!({"cohort": "corners"})).expect_problem(422, "invalid-input", &["/cohort"]);
    let unknown = json!({"cohort": "example-cells"});
    for key in ["nobody", "modes@9", "modes@nobody"] {
        let path = format!("/v1/dictionaries/{key}/assessments");
        server.post(&path, &unknown).expect_problem(404, "not-found", &[]);
    }
    let csv = server.request(Method::POST, PATH).header("accept", "text/csv").json(&unknown);
    server.send(csv).expect_problem(406, "not-acceptable", &[]);
    assert_eq!(server.get("/v1/jobs?kind=assess").expect(200)["items"], json!([]));
}

/// A page of stored assessments.
#[track_caller]
fn stored(server: &Server, query: &str) -> Value {
    server.get(&format!("/v1/cohorts/example-cells/assessments?{query}")).expect(200)
}

#[test]
fn assessments_are_stored_beside_the_shapes_and_listed() {
    let server = furnished();
    assert_eq!(stored(&server, ""), json!({"items": [], "next": null}));
    let quiet = lines(&server.post(PATH, &json!({"cohort": "example-cells"})));
    assert_eq!(stored(&server, "")["items"], json!([]));
    let body = json!({"cohort": "example-cells", "quantile": 0.9, "store": true});
    let at_once = lines(&server.post(PATH, &body));
    assert_ne!(quiet, at_once);
    // Entries are the lines, with the revision and the time; pages hold all of them.
    let (mut found, mut cursor) = (Vec::new(), String::new());
    loop {
        let page = stored(&server, &format!("dictionary=modes&limit=7{cursor}"));
        found.extend(page["items"].as_array().unwrap().clone());
        let Some(next) = page["next"].as_str() else { break };
        cursor = format!("&cursor={next}");
    }
    let mut bare = found.clone();
    for entry in &mut bare {
        let entry = entry.as_object_mut().unwrap();
        assert_eq!(entry.remove("cohort_revision"), Some(json!(1)));
        assert!(entry.remove("assessed_at").unwrap().as_str().unwrap().ends_with('Z'));
    }
    let id = |line: &Value| line["id"].as_str().unwrap().to_owned();
    let mut expected = at_once.clone();
    expected.sort_by_key(id);
    assert_eq!(bare, expected);
    // Filters: outliers, the accepted class, attributes of the shapes.
    let outliers = at_once.iter().filter(|line| line["novelty"]["is_outlier"] == true).count();
    let count = |query: &str| stored(&server, query)["items"].as_array().unwrap().len();
    assert!(outliers > 0 && outliers < at_once.len());
    assert_eq!(count("limit=1000&is_outlier=true"), outliers);
    assert_eq!(count("limit=1000&is_outlier=false"), at_once.len() - outliers);
    let of_class = |label: &str| {
        let is_of = |line: &&Value| line["class"]["label"] == label && line["class"]["accepted"] == true;
        at_once.iter().filter(is_of).count()
    };
    for label in ["control", "none such"] {
        assert_eq!(count(&format!("limit=1000&class={}", label.replace(' ', "%20"))), of_class(label));
    }
    let control =
        server.get("/v1/cohorts/example-cells/shapes?labels[treatment]=control&limit=1000&fields=id");
    let control = control.expect(200)["items"].as_array().unwrap().len();
    assert_eq!(count("limit=1000&labels[treatment]=control"), control);
    // A later assessment replaces the earlier one, by a job as well.
    let again = json!({"cohort": "example-cells", "quantile": 0.99, "store": true});
    let job = submit(&server, &again, "respond-async").expect(202);
    let job = ended(&server, &format!("/v1/jobs/{}", job["id"].as_str().unwrap()));
    assert_eq!(job["result"]["stored_count"], json!(at_once.len()), "{job}");
    let newest = stored(&server, "limit=1000");
    assert_eq!(newest["items"].as_array().unwrap().len(), at_once.len());
    let novelty = |lines: &[Value]| {
        let mut named: Vec<_> = lines.iter().map(|line| (id(line), line["novelty"].clone())).collect();
        named.sort_by(|a, b| a.0.cmp(&b.0));
        named
    };
    assert_eq!(novelty(newest["items"].as_array().unwrap()), novelty(&quiet));
}

#[test]
fn stored_assessments_follow_their_shapes() {
    let server = furnished();
    lines(&server.post(PATH, &json!({"cohort": "example-cells", "store": true})));
    let all = stored(&server, "limit=1000")["items"].as_array().unwrap().clone();
    let (first, second) = (all[0]["id"].as_str().unwrap(), all[1]["id"].as_str().unwrap());
    assert_eq!(server.delete(&format!("/v1/cohorts/example-cells/shapes/{first}")).status, 204);
    let ids = |page: &Value| -> Vec<Value> {
        page["items"].as_array().unwrap().iter().map(|item| item["id"].clone()).collect()
    };
    let left = ids(&stored(&server, "limit=1000"));
    assert_eq!(left.len(), all.len() - 1);
    assert!(!left.contains(&json!(first)) && left.contains(&json!(second)));
    // A corrected shape keeps its assessment, and is found by its new attributes.
    let path = format!("/v1/cohorts/example-cells/shapes/{second}");
    server.send(server.request(Method::PATCH, &path).json(&json!({"subject": "s"}))).expect(200);
    let found = stored(&server, "limit=1000&subject=s");
    assert_eq!(ids(&found), [json!(second)]);
    // Erasing the subject removes it.
    server.delete("/v1/subjects/s").expect(200);
    assert_eq!(ids(&stored(&server, "limit=1000")).len(), left.len() - 1);
    // So does removing the dictionary for good.
    let dictionary = all[0]["dictionary"]["id"].as_str().unwrap();
    assert_eq!(server.delete(&format!("/v1/dictionaries/{dictionary}")).status, 204);
    assert_eq!(server.delete(&format!("/v1/trash/{dictionary}")).status, 204);
    assert_eq!(stored(&server, ""), json!({"items": [], "next": null}));
}

#[test]
fn lists_of_stored_assessments_are_refused_by_name() {
    let server = furnished();
    let of = |query: &str| server.get(&format!("/v1/cohorts/example-cells/assessments?{query}"));
    of("is_outlier=perhaps").expect_problem(400, "invalid-query", &[]);
    of("cursor=elsewhere").expect_problem(400, "invalid-query", &[]);
    of("limit=0").expect_problem(400, "invalid-query", &[]);
    of("classes=a").expect_problem(400, "invalid-query", &[]);
    of("labels[treatmnt]=control").expect_problem(400, "invalid-query", &[]);
    of("dictionary=nothing").expect_problem(404, "not-found", &[]);
    server.get("/v1/cohorts/nothing/assessments").expect_problem(404, "not-found", &[]);
    let body = json!({"cohort": "example-cells", "store": "yes"});
    server.post(PATH, &body).expect_problem(422, "invalid-input", &["/store"]);
}
