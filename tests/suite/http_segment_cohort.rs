//! Segmented objects that become members of a cohort.

use reqwest::Method;
use reqwest::header::CONTENT_TYPE;
use serde_json::{Value, json};

use crate::form::{BOUNDARY, form};
use crate::http_segment::{bright, curves};
use crate::server::{Reply, Server, Setting};

const PATH: &str = "/v1/cohorts/cells/segment";

pub(crate) fn with_cohort() -> Server {
    let server = Setting::fresh().start();
    let representation = curves(json!({}))["representation"].clone();
    server.post("/v1/cohorts", &json!({"name": "cells", "representation": representation})).expect(201);
    server
}

/// Sends parameters and an image with further headers.
pub(crate) fn post(server: &Server, parameters: &Value, image: &[u8], headers: &[(&str, &str)]) -> Reply {
    post_to(server, PATH, parameters, image, headers)
}

fn post_to(server: &Server, path: &str, parameters: &Value, image: &[u8], headers: &[(&str, &str)]) -> Reply {
    let parameters = parameters.to_string();
    let parts: [(&str, &str, &[u8]); 2] =
        [("parameters", "application/json", parameters.as_bytes()), ("image", "image/png", image)];
    let media_type = format!("multipart/form-data; boundary={BOUNDARY}");
    let request = server.request(Method::POST, path).header(CONTENT_TYPE, media_type).body(form(&parts));
    server.send(headers.iter().fold(request, |request, (name, value)| request.header(*name, *value)))
}

pub(crate) fn named(ids: [&str; 2]) -> Value {
    curves(json!({"objects": ids.map(|id| json!({
        "external_id": id, "subject": "mouse-3", "label": "control", "labels": {"plate": 7}, "metadata": {"well": id}
    }))}))
}

fn digest(bytes: &[u8]) -> String {
    blake3::hash(bytes).to_hex().to_string()
}

#[test]
fn objects_become_members_with_their_origin() {
    let server = with_cohort();
    let body = named(["a", "b"]);
    let answer = post(&server, &body, &bright(), &[]).expect(201);
    assert_eq!((&answer["added"], &answer["revision"]), (&json!(2), &json!(1)));
    let result = &answer["results"][1];
    assert_eq!((&result["external_id"], &result["not_stored"]), (&json!("b"), &Value::Null));
    let stored = server.get("/v1/cohorts/cells/shapes/b").expect(200);
    assert_eq!((&stored["id"], &stored["control_points"]), (&result["id"], &result["control_points"]));
    let attributes = (&stored["subject"], &stored["label"], &stored["labels"]["plate"]);
    assert_eq!(attributes, (&json!("mouse-3"), &json!("control"), &json!(7)));
    let expected = json!({"well": "b", "segmentation": {
        "image": digest(&bright()), "parameters": digest(body.to_string().as_bytes()), "index": 1, "stop": result["stop"]
    }});
    assert_eq!(stored["metadata"], expected);
    // The shapes of the cohort are those of an upload: they are measured, and can be segmented again.
    assert!(stored["measures"]["area"].as_f64().unwrap() > 250.0, "{stored}");
    // The same content with the same external ids is no new shape, another content is a conflict.
    let again = post(&server, &body, &bright(), &[]).expect(201);
    assert_eq!((&again["added"], &again["results"][1]["id"]), (&json!(0), &result["id"]));
    let other = curves(json!({"terms": [{"name": "local_contrast"}], "objects": body["objects"]}));
    post(&server, &other, &bright(), &[]).expect_problem(
        409,
        "external-id-conflict",
        &["/objects/0/external_id"],
    );
}

#[test]
fn a_repeated_request_is_recognised_by_all_parts() {
    let server = with_cohort();
    let (body, key) = (named(["a", "b"]), [("idempotency-key", "one")]);
    let first = post(&server, &body, &bright(), &key);
    let again = post(&server, &body, &bright(), &key);
    assert_eq!(again.header("idempotency-replayed"), Some("true"));
    assert_eq!(first.expect(201), again.expect(201));
    let listed = server.get("/v1/cohorts/cells/shapes").expect(200);
    assert_eq!(listed["items"].as_array().unwrap().len(), 2);
    let mut other = bright();
    other.push(0);
    post(&server, &body, &other, &key).expect_problem(422, "idempotency-key-reused", &[]);
    let other = named(["a", "c"]);
    post(&server, &other, &bright(), &key).expect_problem(422, "idempotency-key-reused", &[]);
}

#[test]
fn failed_objects_are_stored_only_when_asked_for() {
    let server = with_cohort();
    let boxes = json!([{"lower": [8, 15], "upper": [25, 26]}, {"lower": [200, 15], "upper": [225, 26]}]);
    let body = |boxes: &Value, store: bool| {
        curves(
            json!({"boxes": boxes, "store_failed": store, "objects": [{"external_id": "a"}, {"external_id": "lost"}]}),
        )
    };
    let answer = post(&server, &body(&boxes, false), &bright(), &[]).expect(201);
    let lost = &answer["results"][1];
    assert_eq!(
        (&answer["added"], &lost["id"], &lost["not_stored"]),
        (&json!(1), &Value::Null, &json!("left_image"))
    );
    assert!(lost["control_points"].is_array(), "{lost}");
    server.get("/v1/cohorts/cells/shapes/lost").expect_problem(404, "not-found", &[]);
    let beside = json!([boxes[1], boxes[1]]);
    let mut unnamed = body(&beside, false);
    unnamed["objects"] = json!([{}, {}]);
    let answer = post(&server, &unnamed, &bright(), &[]).expect(200);
    assert_eq!((&answer["added"], &answer["revision"]), (&json!(0), &json!(1)));
    unnamed["store_failed"] = json!(true);
    let answer = post(&server, &unnamed, &bright(), &[]).expect(201);
    assert_eq!((&answer["added"], &answer["revision"]), (&json!(2), &json!(2)));
}

#[test]
fn a_dry_run_stores_nothing() {
    let server = with_cohort();
    let path = format!("{PATH}?dry_run=true");
    let answer = post_to(&server, &path, &named(["a", "b"]), &bright(), &[]).expect(200);
    assert_eq!(answer["estimate"]["objects"], 2);
    let bad = curves(json!({"objects": [{}]}));
    post_to(&server, &path, &bad, &bright(), &[]).expect_problem(422, "invalid-input", &["/objects"]);
    assert_eq!(server.get("/v1/cohorts/cells").expect(200)["shape_count"], 0);
}

#[test]
fn bad_members_are_refused_before_they_are_computed() {
    let server = with_cohort();
    let refused = |further: Value, pointers: &[&str]| {
        post(&server, &curves(further), &bright(), &[]).expect_problem(422, "invalid-input", pointers);
    };
    let mut other = curves(json!({}))["representation"].clone();
    other["control_points"] = json!(9);
    refused(json!({"representation": other}), &["/representation"]);
    refused(json!({"objects": [{}]}), &["/objects"]);
    refused(json!({"objects": [{}, {"external_id": ""}]}), &["/objects/1/external_id"]);
    refused(json!({"objects": [{}, {"name": "b"}]}), &["/objects/1/name"]);
    refused(json!({"objects": {}}), &["/objects"]);
    refused(json!({"store_failed": "no"}), &["/store_failed"]);
    let body = curves(json!({}));
    post(&server, &body, &bright(), &[("if-match", "\"old\"")]).expect_problem(
        412,
        "precondition-failed",
        &[],
    );
    // Posted shapes have attributes of their own.
    let found = post(&server, &body, &bright(), &[]).expect(201);
    let shape = json!({"external_id": "mine", "control_points": found["results"][0]["control_points"]});
    let mut shapes = curves(json!({"shapes": [shape], "objects": [{}]}));
    shapes.as_object_mut().unwrap().remove("boxes");
    post(&server, &shapes, &bright(), &[]).expect_problem(422, "invalid-input", &["/objects"]);
    shapes.as_object_mut().unwrap().remove("objects");
    post(&server, &shapes, &bright(), &[]).expect(201);
    assert_eq!(server.get("/v1/cohorts/cells/shapes/mine").expect(200)["external_id"], "mine");
}
