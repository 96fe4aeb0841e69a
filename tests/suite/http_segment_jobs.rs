//! Segmentations that become jobs: by prediction or preference, with their files until they end.

use std::time::{Duration, Instant};

use reqwest::Method;
use reqwest::header::{AUTHORIZATION, CONTENT_TYPE};
use serde_json::{Value, json};

use crate::form::{BOUNDARY, form, post_image};
use crate::http_access::create_key;
use crate::http_segment::{PATH, bright, curves, picture};
use crate::server::{Reply, Server, Setting};

const LONG: Duration = Duration::from_secs(240);

/// Sends a form with headers.
pub(crate) fn post(
    server: &Server,
    path: &str,
    parameters: &Value,
    files: &[(&str, &[u8])],
    headers: &[(&str, &str)],
) -> Reply {
    let parameters = parameters.to_string();
    let files = files.iter().map(|(name, file)| (*name, "application/octet-stream", *file));
    let parts: Vec<(&str, &str, &[u8])> =
        std::iter::once(("parameters", "application/json", parameters.as_bytes())).chain(files).collect();
    let media_type = format!("multipart/form-data; boundary={BOUNDARY}");
    let request = server.request(Method::POST, path).header(CONTENT_TYPE, media_type).body(form(&parts));
    server.send(headers.iter().fold(request, |request, (name, value)| request.header(*name, *value)))
}

pub(crate) const ASYNC: (&str, &str) = ("prefer", "respond-async");

/// The job of a reply, when it has ended.
pub(crate) fn ended(server: &Server, reply: &Reply) -> Value {
    let job = reply.expect(202);
    let path = format!("/v1/jobs/{}", job["id"].as_str().unwrap());
    assert_eq!(reply.header("location"), Some(path.as_str()));
    ended_at(server, &path)
}

fn ended_at(server: &Server, path: &str) -> Value {
    let begun = Instant::now();
    loop {
        let job = server.get(path).expect(200);
        if !["queued", "running"].contains(&job["status"].as_str().unwrap()) {
            return job;
        }
        assert!(begun.elapsed() < LONG, "{job}");
        std::thread::sleep(Duration::from_millis(100));
    }
}

/// The same box so often that the prediction is above the bound.
fn many(count: usize) -> Value {
    curves(json!({"boxes": vec![json!({"lower": [8, 15], "upper": [25, 26]}); count]}))
}

/// Findings of the check of the store, and its text.
fn check(server: &Setting) -> (bool, String) {
    let output = server.command("check").output().unwrap();
    let text = [output.stdout, output.stderr].concat();
    (output.status.success(), String::from_utf8(text).unwrap())
}

#[test]
fn what_is_predicted_to_take_long_becomes_a_job_with_the_same_answer() {
    let server = Setting::fresh().start();
    let body = many(3000);
    let estimate = post_image(&server, &format!("{PATH}?dry_run=true"), &body, &bright()).expect(200);
    assert!(estimate["estimate"]["seconds"].as_f64().unwrap() > 3.0, "{estimate}");
    let job = ended(&server, &post_image(&server, PATH, &body, &bright()));
    assert_eq!((&job["kind"], &job["status"]), (&json!("segment"), &json!("succeeded")), "{job}");
    let results = job["result"]["results"].as_array().unwrap();
    assert_eq!(results.len(), 3000);
    let one = post_image(&server, PATH, &many(1), &bright()).expect(200);
    assert_eq!(results[2999]["control_points"], one["results"][0]["control_points"]);
    // What is short is answered at once, unless the client prefers a job, for which it may wait.
    let parts = [("image", &bright()[..]), ("truth", &picture(|label| label)[..])];
    let at_once = post(&server, PATH, &many(1), &parts, &[]).expect(200);
    let job = ended(&server, &post(&server, PATH, &many(1), &parts, &[ASYNC]));
    assert_eq!(job["result"], at_once);
    let waited = post(&server, PATH, &many(1), &parts, &[("prefer", "respond-async, wait=60")]).expect(200);
    assert_eq!(waited, at_once);
}

#[test]
fn the_output_of_a_job_is_the_file_that_was_asked_for() {
    let server = Setting::fresh().start();
    let body = curves(json!({"mask": true}));
    let image = [("image", &bright()[..])];
    for (format, media_type) in [("png", "image/png"), ("nifti", "application/x-nifti")] {
        let path = format!("{PATH}?format={format}");
        let at_once = post(&server, &path, &body, &image, &[]);
        assert_eq!((at_once.status, at_once.header("content-type")), (200, Some(media_type)));
        let job = ended(&server, &post(&server, &path, &body, &image, &[ASYNC]));
        assert_eq!(job["result"]["results"].as_array().unwrap().len(), 2);
        let output = server.get(&format!("/v1/jobs/{}/output", job["id"].as_str().unwrap()));
        assert_eq!((output.status, output.header("content-type")), (200, Some(media_type)));
        assert_eq!(output.body, at_once.body);
        let waited = post(&server, &path, &body, &image, &[("prefer", "respond-async, wait=60")]);
        assert_eq!(waited.body, at_once.body);
        let other = format!("/v1/jobs/{}/output?format=csv", job["id"].as_str().unwrap());
        let problem = server.get(&other).expect_problem(400, "invalid-query", &[]);
        assert_eq!(problem["errors"][0]["parameter"], "format");
    }
    let drawn = post(&server, &format!("{PATH}?format=svg&theme=dark"), &curves(json!({})), &image, &[ASYNC]);
    let job = ended(&server, &drawn);
    let output = server.get(&format!("/v1/jobs/{}/output", job["id"].as_str().unwrap()));
    let at_once = post(&server, &format!("{PATH}?format=svg&theme=dark"), &curves(json!({})), &image, &[]);
    assert_eq!(output.expect_svg(), at_once.expect_svg());
    // Numbers have no output.
    let job = ended(&server, &post(&server, PATH, &curves(json!({})), &image, &[ASYNC]));
    let path = format!("/v1/jobs/{}/output", job["id"].as_str().unwrap());
    server.get(&path).expect_problem(404, "not-found", &[]);
}

#[test]
fn faults_are_found_before_there_is_a_job_and_those_of_the_image_end_it() {
    let server = Setting::fresh().start();
    let image = [("image", &bright()[..])];
    let bad = curves(json!({"terms": []}));
    post(&server, PATH, &bad, &image, &[ASYNC]).expect_problem(422, "invalid-input", &["/terms"]);
    let bad = curves(json!({"priority": "highest"}));
    post(&server, PATH, &bad, &image, &[ASYNC]).expect_problem(422, "invalid-input", &["/priority"]);
    // The header says what the file does not hold.
    let mut short = bright();
    short.truncate(short.len() - 30);
    let job = ended(&server, &post(&server, PATH, &curves(json!({})), &[("image", &short)], &[ASYNC]));
    assert_eq!((&job["status"], &job["problem"]["status"]), (&json!("failed"), &json!(422)), "{job}");
    assert_eq!(job["problem"]["errors"][0]["pointer"], "/image");
    assert_eq!(server.get("/v1/jobs").expect(200)["items"].as_array().unwrap().len(), 1);
}

#[test]
fn a_cancelled_job_leaves_no_files() {
    let server = Setting::fresh().start();
    let reply = post(&server, PATH, &many(60_000), &[("image", &bright())], &[]);
    let id = reply.expect(202)["id"].as_str().unwrap().to_owned();
    let path = format!("/v1/jobs/{id}");
    let begun = Instant::now();
    while server.get(&path).expect(200)["phase"] != "segment" {
        assert!(begun.elapsed() < LONG, "{}", server.get(&path).text());
        std::thread::sleep(Duration::from_millis(50));
    }
    std::thread::sleep(Duration::from_millis(1500));
    let running = server.get(&path).expect(200);
    let progress = running["progress"].as_f64().unwrap();
    assert!(progress > 0.0 && progress < 1.0, "{running}");
    let cancelled = server.post(&format!("{path}/cancel"), &json!({})).expect(200);
    assert_eq!(cancelled["status"], "cancelled");
    // The thread has stopped: the next job runs.
    let next = ended(&server, &post(&server, PATH, &many(1), &[("image", &bright())], &[ASYNC]));
    assert_eq!(next["status"], "succeeded");
    let (is_sound, text) = check(&server.terminate());
    assert!(is_sound, "{text}");
}

#[test]
fn a_job_survives_the_end_of_its_process() {
    let server = Setting::fresh().start();
    let reply = post(&server, PATH, &many(3000), &[("image", &bright())], &[]);
    let path = format!("/v1/jobs/{}", reply.expect(202)["id"].as_str().unwrap());
    let begun = Instant::now();
    while server.get(&path).expect(200)["status"] != "running" {
        assert!(begun.elapsed() < LONG);
        std::thread::sleep(Duration::from_millis(20));
    }
    let server = server.kill().start();
    let job = ended_at(&server, &path);
    assert_eq!((&job["status"], &job["attempt"]), (&json!("succeeded"), &json!(2)), "{}", job["problem"]);
    assert_eq!(job["result"]["results"].as_array().unwrap().len(), 3000);
    let (is_sound, text) = check(&server.terminate());
    assert!(is_sound, "{text}");
}

#[test]
fn a_job_adds_objects_to_a_cohort_once() {
    let server = Setting::fresh().start();
    let representation = curves(json!({}))["representation"].clone();
    server.post("/v1/cohorts", &json!({"name": "cells", "representation": representation})).expect(201);
    let path = "/v1/cohorts/cells/segment";
    let image = [("image", &bright()[..])];
    let body = |ids: [&str; 2]| {
        curves(json!({"objects": ids.map(|id| json!({"external_id": id, "subject": "mouse-3"})), "prior": {
            "reference": {"control_points": [[9, 0], [6, 6], [0, 9], [-6, 6], [-9, 0], [-6, -6], [0, -9], [6, -6]]},
            "transformation": "affine", "weight": 0.1
        }}))
    };
    let key = [ASYNC, ("idempotency-key", "one")];
    let first = post(&server, path, &body(["a", "b"]), &image, &key);
    let job = ended(&server, &first);
    assert_eq!((&job["status"], &job["result"]["added"]), (&json!("succeeded"), &json!(2)), "{job}");
    let stored = server.get("/v1/cohorts/cells/shapes/b").expect(200);
    assert_eq!(stored["id"], job["result"]["results"][1]["id"]);
    let digest = blake3::hash(&bright()).to_hex().to_string();
    assert_eq!(stored["metadata"]["segmentation"]["image"], json!(digest));
    // A repetition finds the job, by whichever way; another request is refused.
    for again in [
        post(&server, path, &body(["a", "b"]), &image, &key),
        post(&server, path, &body(["a", "b"]), &image, &[key[1]]),
    ] {
        assert_eq!(again.header("idempotency-replayed"), Some("true"));
        assert_eq!(again.expect(202)["id"], job["id"]);
    }
    let waited = [("prefer", "wait=60"), key[1]];
    assert_eq!(post(&server, path, &body(["a", "b"]), &image, &waited).expect(201), job["result"]);
    let other = post(&server, path, &body(["a", "c"]), &image, &key);
    other.expect_problem(422, "idempotency-key-reused", &[]);
    // The same objects again are no new shapes, and nothing is stored of a version that has changed.
    let again = ended(&server, &post(&server, path, &body(["a", "b"]), &image, &[ASYNC]));
    assert_eq!(again["result"]["added"], 0);
    let etag = server.get("/v1/cohorts/cells").header("etag").unwrap().to_owned();
    let conditional = [ASYNC, ("if-match", etag.as_str())];
    let third = ended(&server, &post(&server, path, &body(["c", "d"]), &image, &conditional));
    assert_eq!(third["result"]["added"], 2, "{third}");
    post(&server, path, &body(["e", "f"]), &image, &conditional).expect_problem(
        412,
        "precondition-failed",
        &[],
    );
    // A conflict is a failure of the job, at its place.
    let mut moved = body(["a", "b"]);
    moved["terms"] = json!([{"name": "local_contrast"}]);
    let conflict = ended(&server, &post(&server, path, &moved, &image, &[ASYNC]));
    let problem = &conflict["problem"];
    assert_eq!(
        (&problem["status"], &problem["errors"][0]["pointer"]),
        (&json!(409), &json!("/objects/0/external_id"))
    );
    let (is_sound, text) = check(&server.terminate());
    assert!(is_sound, "{text}");
}

#[test]
fn a_prior_of_the_store_is_that_of_the_request() {
    let server = Setting::fresh().start();
    let representation = curves(json!({}))["representation"].clone();
    server.post("/v1/cohorts", &json!({"name": "cells", "representation": representation})).expect(201);
    let image = [("image", &bright()[..])];
    let path = "/v1/cohorts/cells/segment";
    post(&server, path, &curves(json!({})), &image, &[]).expect(201);
    let body = curves(json!({"prior": {"cohort": "cells", "transformation": "similarity", "weight": 5}}));
    let at_once = post(&server, PATH, &body, &image, &[]).expect(200);
    let job = ended(&server, &post(&server, PATH, &body, &image, &[ASYNC]));
    assert_eq!(job["result"], at_once);
}

#[test]
fn who_would_not_see_a_job_is_answered_at_once_or_not_at_all() {
    let server = Setting::fresh().start();
    let representation = curves(json!({}))["representation"].clone();
    server.post("/v1/cohorts", &json!({"name": "cells", "representation": representation})).expect(201);
    let reader = create_key(&server, &["--role", "reader"]);
    let limited = create_key(&server, &["--role", "writer", "--cohort", "cells"]);
    let image = [("image", &bright()[..])];
    for secret in [&reader, &limited] {
        let bearer = format!("Bearer {secret}");
        let headers = [ASYNC, (AUTHORIZATION.as_str(), bearer.as_str())];
        post(&server, PATH, &many(1), &image, &headers).expect(200);
        post(&server, PATH, &many(60_000), &image, &headers).expect_problem(422, "too-costly", &[]);
    }
    // A job of its cohort is visible to a key that is limited to it.
    let bearer = format!("Bearer {limited}");
    let headers = [ASYNC, (AUTHORIZATION.as_str(), bearer.as_str()), ("prefer", "wait=60")];
    post(&server, "/v1/cohorts/cells/segment", &many(1), &image, &headers).expect(201);
}
