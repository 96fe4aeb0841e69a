//! Requests of any route through all layers: no answer is a failure on our side, and each is what its head says.
//!
//! The first line is method and target; then come headers, an empty line and the body. With `content-encoding: gzip` the
//! body is compressed here, unless `x-raw` is set.

#![no_main]

use std::io::Write;
use std::sync::Once;

use axum::body::Body;
use axum::http::{HeaderName, HeaderValue, Method, Request, StatusCode, Uri};
use flate2::{Compression, write::GzEncoder};
use libfuzzer_sys::{Corpus, fuzz_target};
use shapelex_fuzz::{Service, content_type};

/// What the requests find in the store: a cohort and a dictionary.
const COHORT: &str = r#"{"name": "cells", "representation":
    {"kind": "closed_curve", "dimension": 2, "control_points": 4, "generator": {"name": "trigonometric"}}}"#;
const SHAPES: &str = r#"{"shapes": [
    {"external_id": "a", "label": "x", "subject": "s", "points": [[0, 0], [4, 0], [4, 1], [0, 1]]},
    {"external_id": "b", "label": "x", "labels": {"age": 3}, "points": [[0, 0], [3, 0], [4, 2], [1, 3]]},
    {"external_id": "c", "label": "y", "labels": {"age": 5}, "points": [[0, 1], [3, 0], [5, 2], [1, 4]]},
    {"external_id": "d", "label": "y", "labels": {"age": 8}, "points": [[0, 0], [2, 0], [2, 2], [1, 5]]}]}"#;
const DICTIONARY: &str = include_str!("../dictionary.json");

fn post(target: &str, body: &'static str) {
    let request = Request::post(target).header("content-type", "application/json").body(Body::from(body));
    let (status, _, answer) = Service::get().send(request.expect("a request"));
    let stands = status.is_success() || status == StatusCode::CONFLICT;
    assert!(stands, "{target}: {status} {answer:?}");
}

/// Makes what is not there.
fn furnish() {
    post("/v1/cohorts", COHORT);
    post("/v1/cohorts/cells/shapes", SHAPES);
    post("/v1/dictionaries/import?name=atoms", DICTIONARY);
}

static FURNISH: Once = Once::new();

fuzz_target!(|data: &[u8]| -> Corpus {
    FURNISH.call_once(furnish);
    let Some(request) = read(data) else { return Corpus::Reject };
    let (method, target) = (request.method().clone(), request.uri().clone());
    let (status, headers, body) = Service::get().send(request);
    // Under these limits nothing waits for its turn.
    assert!(status < StatusCode::INTERNAL_SERVER_ERROR, "{target}: {status} {body:?}");
    let media_type = content_type(&headers);
    assert_eq!(status.is_client_error(), media_type == "application/problem+json", "{target}: {status}");
    // The answer to HEAD is a head.
    if method != Method::HEAD && media_type.ends_with("json") && !headers.contains_key("content-encoding") {
        serde_json::from_slice::<serde::de::IgnoredAny>(&body).expect("the body is JSON");
    }
    if method == Method::DELETE && status == StatusCode::NO_CONTENT {
        furnish();
    }
    Corpus::Keep
});

/// A request out of its text; nothing when no client could send it.
fn read(data: &[u8]) -> Option<Request<Body>> {
    let head_end = data.windows(2).position(|pair| pair == b"\n\n")?;
    let (head, body) = (&data[..head_end], &data[head_end + 2..]);
    let mut lines = head.split(|&byte| byte == b'\n');
    let (method, target) = std::str::from_utf8(lines.next()?).ok()?.split_once(' ')?;
    let mut request = Request::new(Body::empty());
    *request.method_mut() = Method::from_bytes(method.as_bytes()).ok()?;
    *request.uri_mut() = target.parse::<Uri>().ok().filter(|uri| uri.path().starts_with('/'))?;
    for line in lines {
        let colon = line.iter().position(|&byte| byte == b':')?;
        let name = HeaderName::from_bytes(&line[..colon]).ok()?;
        // Nobody runs the jobs here: a wait for one would be in vain.
        if name != "prefer" {
            request.headers_mut().append(name, HeaderValue::from_bytes(line[colon + 1..].trim_ascii()).ok()?);
        }
    }
    let zipped = request.headers().get("content-encoding").is_some_and(|value| value == "gzip");
    let body = if zipped && !request.headers().contains_key("x-raw") { gzip(body) } else { body.to_vec() };
    *request.body_mut() = Body::from(body);
    Some(request)
}

fn gzip(body: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::fast());
    encoder.write_all(body).and_then(|()| encoder.finish()).expect("compression in memory does not fail")
}
