//! Requests that are sent again, versions that are expected, the feed of changes, the trash.

use reqwest::Method;
use serde_json::{Value, json};

use crate::server::{Reply, Server};

fn cohort(name: &str) -> Value {
    json!({"name": name, "representation": {"kind": "landmarks", "dimension": 2, "points": 3}})
}

fn triangle(x: f64) -> Value {
    json!({"control_points": [[0, 0], [x, 0], [0, 1]]})
}

fn post_as(server: &Server, key: &str, path: &str, body: &Value) -> Reply {
    server.send(server.request(Method::POST, path).header("idempotency-key", key).json(body))
}

fn stream_as(server: &Server, key: &str, path: &str, lines: &[Value]) -> Reply {
    let text: Vec<String> = lines.iter().map(ToString::to_string).collect();
    let request = server.request(Method::POST, path).header("content-type", "application/x-ndjson");
    server.send(request.header("idempotency-key", key).body(text.join("\n")))
}

#[test]
fn a_request_that_is_sent_again_is_done_once() {
    let server = Server::fresh();
    let created = post_as(&server, "one", "/v1/cohorts", &cohort("feet")).expect(201);
    let again = post_as(&server, "one", "/v1/cohorts", &cohort("feet")).expect(201);
    assert_eq!(created["id"], again["id"]);
    // Another request under the key, and the same one under another key.
    post_as(&server, "one", "/v1/cohorts", &cohort("hands")).expect_problem(
        422,
        "idempotency-key-reused",
        &[],
    );
    post_as(&server, "two", "/v1/cohorts", &cohort("feet")).expect_problem(409, "name-taken", &["/name"]);
    // What was refused may be sent again when it is corrected.
    post_as(&server, "two", "/v1/cohorts", &cohort("hands")).expect(201);

    let shapes = json!({"shapes": [triangle(1.0), triangle(2.0)]});
    let path = "/v1/cohorts/feet/shapes";
    let stored = post_as(&server, "s1", path, &shapes).expect(201);
    assert_eq!((&stored["added"], &stored["revision"]), (&json!(2), &json!(1)));
    assert_eq!(post_as(&server, "s1", path, &shapes).expect(201), stored);
    let other = json!({"shapes": [triangle(1.0), triangle(3.0)]});
    post_as(&server, "s1", path, &other).expect_problem(422, "idempotency-key-reused", &[]);

    let lines = [triangle(3.0), triangle(4.0)];
    let streamed = stream_as(&server, "s2", path, &lines).expect(201);
    assert_eq!(stream_as(&server, "s2", path, &lines).expect(201), streamed);
    stream_as(&server, "s2", path, &lines[..1]).expect_problem(422, "idempotency-key-reused", &[]);
    assert_eq!(server.get("/v1/cohorts/feet").expect(200)["shape_count"], 4, "nothing is doubled");

    let learn = json!({"name": "modes", "cohort": "feet", "transformation": "similarity",
        "method": {"kind": "functional_pca", "components": 1}});
    let job = post_as(&server, "learn", "/v1/dictionaries", &learn).expect(202);
    assert_eq!(post_as(&server, "learn", "/v1/dictionaries", &learn).expect(202)["id"], job["id"]);
    // Also when it is over.
    let events = format!("/v1/jobs/{}/events", job["id"].as_str().unwrap());
    assert!(server.get(&events).text().contains("succeeded"));
    assert_eq!(post_as(&server, "learn", "/v1/dictionaries", &learn).expect(202)["status"], "succeeded");
    assert_eq!(server.get("/v1/jobs").expect(200)["items"].as_array().unwrap().len(), 1);

    let request = server.request(Method::POST, "/v1/cohorts").header("idempotency-key", "\u{e4}");
    server.send(request.json(&cohort("x"))).expect_problem(400, "invalid-query", &[]);
}

/// A client sees whether its request took effect now or before.
#[test]
fn replayed_answers_are_marked() {
    let server = Server::fresh();
    let shapes = json!({"shapes": [triangle(1.0), triangle(2.0)]});
    let learn = json!({"name": "modes", "cohort": "feet", "transformation": "similarity",
        "method": {"kind": "functional_pca", "components": 1}});
    for (path, body) in
        [("/v1/cohorts", &cohort("feet")), ("/v1/cohorts/feet/shapes", &shapes), ("/v1/dictionaries", &learn)]
    {
        for replayed in [None, Some("true")] {
            let reply = post_as(&server, path, path, body);
            assert!([201, 202].contains(&reply.status), "{path}: {}", reply.text());
            assert_eq!(reply.header("idempotency-replayed"), replayed, "{path}");
        }
    }
    for replayed in [None, Some("true")] {
        let lines = [triangle(3.0), triangle(4.0)];
        let reply = stream_as(&server, "lines", "/v1/cohorts/feet/shapes", &lines);
        assert_eq!((reply.status, reply.header("idempotency-replayed")), (201, replayed));
    }
    let reused = post_as(&server, "/v1/cohorts", "/v1/cohorts", &cohort("hands"));
    assert_eq!((reused.status, reused.header("idempotency-replayed")), (422, None));
}

#[test]
fn a_version_that_is_not_the_present_one_is_left_as_it_is() {
    let server = Server::fresh();
    let created = server.post("/v1/cohorts", &cohort("feet"));
    let first = created.header("etag").unwrap().to_owned();
    let patch = |tag: &str, body: Value| {
        let request = server.request(Method::PATCH, "/v1/cohorts/feet").header("if-match", tag);
        server.send(request.json(&body))
    };
    let changed = patch(&first, json!({"description": "left", "length_unit": "mm"}));
    let second = changed.header("etag").unwrap().to_owned();
    let changed = changed.expect(200);
    assert_eq!((&changed["description"], &changed["revision"]), (&json!("left"), &json!(1)));
    patch(&first, json!({"description": "right"})).expect_problem(412, "precondition-failed", &[]);
    assert_eq!(patch("*", json!({"description": null})).expect(200)["description"], Value::Null);
    assert_eq!(server.get("/v1/cohorts/feet").expect(200)["length_unit"], "mm", "what is not given stays");
    patch("*", json!({"name": "a b"})).expect_problem(422, "invalid-input", &["/name"]);
    patch("*", json!({"nmae": "b"})).expect_problem(422, "invalid-input", &["/nmae"]);

    let add = |tag: &str| {
        let request = server.request(Method::POST, "/v1/cohorts/feet/shapes").header("if-match", tag);
        server.send(request.json(&json!({"shapes": [triangle(1.0)]})))
    };
    add(&second).expect_problem(412, "precondition-failed", &[]);
    let present = server.get("/v1/cohorts/feet").header("etag").unwrap().to_owned();
    add(&present).expect(201);
    let delete = |tag: &str| {
        server.send(server.request(Method::DELETE, "/v1/cohorts/feet").header("if-match", tag)).status
    };
    assert_eq!(delete(&present), 412);
    let present = server.get("/v1/cohorts/feet").header("etag").unwrap().to_owned();
    assert_eq!(delete(&format!("\"x\", {present}")), 204);
}

#[test]
fn changes_are_listed_in_their_order_and_a_pipeline_can_go_on() {
    let server = Server::fresh();
    assert_eq!(server.get("/v1/changes").expect(200), json!({"items": [], "next": 0, "done": true}));
    let id = server.post("/v1/cohorts", &cohort("feet")).expect(201)["id"].clone();
    let body = json!({"shapes": [triangle(1.0), triangle(2.0)]});
    let stored = server.post("/v1/cohorts/feet/shapes", &body).expect(201);
    let shape = stored["results"][0]["id"].as_str().unwrap().to_owned();
    assert_eq!(server.delete(&format!("/v1/cohorts/feet/shapes/{shape}")).status, 204);
    let first = server.get("/v1/changes?limit=2").expect(200);
    let kinds = |answer: &Value| -> Vec<String> {
        let changes = answer["items"].as_array().unwrap().iter();
        changes.map(|change| change["kind"].as_str().unwrap().to_owned()).collect()
    };
    assert_eq!(kinds(&first), ["cohort_created", "shapes_added"]);
    assert_eq!((&first["next"], &first["done"]), (&json!(2), &json!(false)));
    let added = &first["items"][1];
    assert_eq!((&added["cohort"], &added["revision"], &added["shape_count"]), (&id, &json!(1), &json!(2)));
    let rest = server.get("/v1/changes?since=2").expect(200);
    assert_eq!((kinds(&rest), &rest["done"]), (vec!["shape_deleted".to_owned()], &json!(true)));
    assert_eq!(rest["items"][0]["object"], shape);
    assert_eq!(server.get("/v1/changes?since=99").expect(200)["next"], 99);
    server.get("/v1/changes?since=-1").expect_problem(400, "invalid-query", &[]);
    server.get("/v1/changes?limit=0").expect_problem(400, "invalid-query", &[]);
}

#[test]
fn what_was_deleted_comes_back_from_the_trash() {
    let server = Server::fresh();
    let id = server.post("/v1/cohorts", &cohort("feet")).expect(201)["id"].as_str().unwrap().to_owned();
    server.post("/v1/cohorts/feet/shapes", &json!({"shapes": [triangle(1.0)]})).expect(201);
    assert_eq!(server.delete("/v1/cohorts/feet").status, 204);
    server.get(&format!("/v1/cohorts/{id}")).expect_problem(404, "not-found", &[]);
    let trash = server.get("/v1/trash").expect(200);
    assert_eq!((&trash["items"][0]["id"], &trash["items"][0]["name"]), (&json!(id), &json!("feet")));
    // The name is free; what has it keeps it.
    server.post("/v1/cohorts", &cohort("feet")).expect(201);
    let restore = format!("/v1/trash/{id}/restore");
    server.send(server.request(Method::POST, &restore)).expect_problem(409, "name-taken", &["/name"]);
    assert_eq!(server.delete("/v1/cohorts/feet").status, 204);
    assert_eq!(server.send(server.request(Method::POST, &restore)).status, 204);
    assert_eq!(server.get("/v1/cohorts/feet").expect(200)["shape_count"], 1);
    server.send(server.request(Method::POST, &restore)).expect_problem(404, "not-found", &[]);

    assert_eq!(server.delete("/v1/cohorts/feet").status, 204);
    assert_eq!(server.delete(&format!("/v1/trash/{id}")).status, 204);
    server.send(server.request(Method::POST, &restore)).expect_problem(404, "not-found", &[]);
    assert_eq!(server.get("/v1/trash").expect(200)["items"].as_array().unwrap().len(), 1);
}

#[test]
fn the_trash_is_emptied_when_its_term_ends() {
    let setting = crate::server::Setting::fresh();
    let server = setting.start();
    server.post("/v1/cohorts", &cohort("feet")).expect(201);
    assert_eq!(server.delete("/v1/cohorts/feet").status, 204);
    let server = server.kill().flags(&["--trash-days", "0"]).start();
    for _ in 0..100 {
        if server.get("/v1/trash").expect(200)["items"] == json!([]) {
            return;
        }
        std::thread::sleep(std::time::Duration::from_millis(50));
    }
    panic!("the trash is not empty: {}", server.get("/v1/trash").text());
}
