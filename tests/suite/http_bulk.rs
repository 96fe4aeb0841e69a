//! Attributes of many shapes changed by one request: by a filter, by ids, or by a table.

use reqwest::Method;
use serde_json::{Value, json};

use crate::server::{Reply, Server};

const SHAPES: &str = "/v1/cohorts/feet/shapes";
const ATTRIBUTES: &str = "/v1/cohorts/feet/attributes";

/// A cohort of six triangles, `s/0` to `s/5`, of two sites.
fn filled() -> Server {
    let server = Server::fresh();
    let body = json!({"name": "feet", "representation": {"kind": "landmarks", "dimension": 2, "points": 3}});
    server.post("/v1/cohorts", &body).expect(201);
    let shape = |k: usize| {
        json!({"external_id": format!("s/{k}"), "labels": {"site": if k < 4 { "zrh" } else { "gva" }, "n": k},
            "metadata": {"k": k}, "control_points": [[0, 0], [k + 1, 0], [0.5, 1.0 + k as f64 / 8.0]]})
    };
    server.post(SHAPES, &json!({"shapes": (0..6).map(shape).collect::<Vec<_>>()})).expect(201);
    server
}

fn patch(server: &Server, query: &str, body: &Value) -> Reply {
    server.send(server.request(Method::PATCH, &format!("{SHAPES}{query}")).json(body))
}

fn table(server: &Server, query: &str, text: &str) -> Reply {
    server.post_bytes(&format!("{ATTRIBUTES}{query}"), "text/csv", text)
}

fn shape(server: &Server, name: &str) -> Value {
    server.get(&format!("{SHAPES}/{name}")).expect(200)
}

fn revision(server: &Server) -> Value {
    server.get("/v1/cohorts/feet").expect(200)["revision"].clone()
}

fn counts(answer: &Value) -> [&Value; 3] {
    ["updated", "unchanged", "skipped"].map(|name| &answer[name])
}

#[test]
fn shapes_of_a_filter_change_as_one_revision() {
    let server = filled();
    let before = shape(&server, "s/1");
    let body = json!({"filter": {"labels": {"site": "zrh"}}, "changes": {"label": "treated", "labels": {"dose": 3, "n": null}}});
    let tried = patch(&server, "?dry_run=true", &body).expect(200);
    assert_eq!((counts(&tried), &tried["dry_run"]), ([&json!(4), &json!(0), &json!(0)], &json!(true)));
    assert_eq!((tried.get("revision"), revision(&server)), (None, json!(1)));
    let done = patch(&server, "", &body).expect(200);
    assert_eq!((counts(&done), &done["revision"]), ([&json!(4), &json!(0), &json!(0)], &json!(2)));
    let after = shape(&server, "s/1");
    let mut wanted = before;
    wanted["label"] = json!("treated");
    wanted["labels"] = json!({"dose": 3, "site": "zrh"});
    assert_eq!(after, wanted, "times of creation, measures and points stay");
    assert_eq!(shape(&server, "s/4")["label"], Value::Null);
    let changes = server.get("/v1/changes").expect(200);
    let last = changes["items"].as_array().unwrap().last().unwrap().clone();
    assert_eq!(
        (&last["kind"], &last["shape_count"], &last["revision"]),
        (&json!("shapes_updated"), &json!(4), &json!(2))
    );
    // What changes nothing makes no revision.
    let again = patch(&server, "", &body).expect(200);
    assert_eq!((counts(&again), &again["revision"]), ([&json!(0), &json!(4), &json!(0)], &json!(2)));
    // Earlier revisions keep them, and the cohort has each of them once.
    let listed = server.get(SHAPES).expect(200);
    assert_eq!(listed["items"].as_array().unwrap().len(), 6);
    let all = patch(&server, "", &json!({"all": true, "changes": {"subject": "p"}})).expect(200);
    assert_eq!(counts(&all), [&json!(6), &json!(0), &json!(0)]);
    assert_eq!(server.get("/v1/cohorts/feet").expect(200)["shape_count"], 6);
    // One person's shapes are erased as a whole.
    server.send(server.request(Method::DELETE, "/v1/subjects/p")).expect(200);
    assert_eq!(server.get("/v1/cohorts/feet").expect(200)["shape_count"], 0);
}

#[test]
fn changes_that_cannot_be_made_refuse_all_or_are_skipped() {
    let server = filled();
    let ids = json!({"ids": ["s/0", "none", "s/0"], "changes": {"label": "x"}});
    patch(&server, "", &ids).expect_problem(422, "invalid-input", &["/ids/1", "/ids/2"]);
    assert_eq!(revision(&server), 1);
    let skipped = patch(&server, "?on_error=skip", &ids).expect(200);
    assert_eq!(counts(&skipped), [&json!(1), &json!(0), &json!(2)]);
    assert_eq!(
        (&skipped["results"][0]["index"], &skipped["results"][1]["external_id"]),
        (&json!(1), &json!("s/0"))
    );
    for (body, pointer) in [
        (json!({"changes": {"label": "x"}}), ""),
        (json!({"filter": {}, "changes": {"label": "x"}}), ""),
        (json!({"all": true, "ids": ["s/0"], "changes": {"label": "x"}}), ""),
        (json!({"all": true}), "/changes"),
        (json!({"all": true, "changes": {"points": []}}), "/changes/points"),
        (json!({"all": true, "changes": {"weight": -1}}), "/changes/weight"),
        (json!({"all": true, "changes": {"external_id": "x"}}), "/changes/external_id"),
        (json!({"filter": {"labels": {"sight": "zrh"}}, "changes": {"label": "x"}}), "/filter/labels/sight"),
        (
            json!({"filter": {"labels": {"sight": {"ne": "zrh"}}}, "changes": {"label": "x"}}),
            "/filter/labels/sight",
        ),
    ] {
        patch(&server, "", &body).expect_problem(422, "invalid-input", &[pointer]);
    }
    patch(&server, "?colour=red", &ids).expect(400);
    let tag = server.get("/v1/cohorts/feet").header("etag").unwrap().to_owned();
    let at = |tag: &str, label: &str| {
        let request = server.request(Method::PATCH, SHAPES).header("if-match", tag);
        server.send(request.json(&json!({"all": true, "changes": {"label": label}})))
    };
    at(&tag, "a").expect(200);
    at(&tag, "b").expect_problem(412, "precondition-failed", &[]);
}

#[test]
fn attributes_come_from_a_table_or_a_list() {
    let server = filled();
    let text = "external_id;subject;label;weight;dose;site\r\ns/0;p-0;a;2;1,5;\r\ns/1;p-1;;;3;bsl\r\n";
    let done = table(&server, "", text).expect(200);
    assert_eq!((counts(&done), &done["revision"]), ([&json!(2), &json!(0), &json!(0)], &json!(2)));
    let first = shape(&server, "s/0");
    assert_eq!(
        (&first["subject"], &first["label"], &first["weight"]),
        (&json!("p-0"), &json!("a"), &json!(2.0))
    );
    assert_eq!(first["labels"], json!({"dose": "1,5", "n": 0, "site": "zrh"}));
    assert_eq!(shape(&server, "s/1")["labels"], json!({"dose": 3, "n": 1, "site": "bsl"}));
    let problem = table(&server, "", "id,dose\ns/0,4\nnone,5\ns/0,6\n").expect(422);
    let lines: Vec<&Value> =
        problem["errors"].as_array().unwrap().iter().map(|error| &error["line"]).collect();
    assert_eq!(lines, [&json!(3), &json!(4)]);
    let skipped = table(&server, "?on_error=skip", "id,dose\ns/0,4\nnone,5\n").expect(200);
    assert_eq!(counts(&skipped), [&json!(1), &json!(0), &json!(1)]);
    table(&server, "", "name,dose\ns/0,4\n").expect_problem(422, "invalid-input", &[""]);
    table(&server, "", "id,dose\n").expect_problem(422, "too-few-shapes", &[]);
    let list = json!({"shapes": [
        {"external_id": "s/2", "subject": "p-2", "labels": {"n": null}},
        {"id": shape(&server, "s/3")["id"], "metadata": {"why": "late"}},
    ]});
    let done = server.post(ATTRIBUTES, &list).expect(200);
    assert_eq!(counts(&done), [&json!(2), &json!(0), &json!(0)]);
    assert_eq!(shape(&server, "s/2")["labels"], json!({"site": "zrh"}));
    assert_eq!(shape(&server, "s/3")["metadata"], json!({"k": 3, "why": "late"}));
    let wrong = json!({"shapes": [{"label": "x"}, {"id": "a", "external_id": "b"}, {"id": 3}]});
    let refused = server.post(ATTRIBUTES, &wrong);
    refused.expect_problem(422, "invalid-input", &["/shapes/0", "/shapes/1", "/shapes/2"]);
    let wrong = json!({"shapes": [{"id": "s/0", "colour": "red"}, {"id": "s/1", "weight": 0}]});
    let refused = server.post(ATTRIBUTES, &wrong);
    refused.expect_problem(422, "invalid-input", &["/shapes/0/colour", "/shapes/1/weight"]);
    server.post_bytes(ATTRIBUTES, "text/plain", text).expect_problem(415, "unsupported-media-type", &[]);
}
