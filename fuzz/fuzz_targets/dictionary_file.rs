//! A dictionary file, imported with the digest that its content has, so that what lies behind the digest is reached.
//!
//! What is imported is exported again, drawn, and asked; nothing of it may fail on our side.

#![no_main]

use axum::body::Body;
use axum::http::{Request, StatusCode};
use libfuzzer_sys::fuzz_target;
use shapelex_server::wire::checked::Checked;
use shapelex_server::service::app::ServiceError;
use shapelex_server::service::dictionaries::file::{DictionaryFile, import};
use shapelex_server::service::dictionaries::planning;
use shapelex_server::service::shapes::read::parse;
use shapelex_fuzz::LIMITS;
use shapelex_fuzz::Service;

fuzz_target!(|text: &[u8]| {
    let Ok(read) = parse::<Checked<DictionaryFile>>(&LIMITS, text) else { return };
    let mut errors = Vec::new();
    let Some(mut file) = read.take("", &mut errors) else {
        assert!(!errors.is_empty(), "a refusal without a reason");
        return;
    };
    let content = serde_json::to_vec(&file.content).expect("a content is JSON");
    file.digest = blake3::hash(&content).to_hex().to_string();
    let service = Service::get();
    let ready = match service.run(import(service.app(), file, Some("fuzzed".into()))) {
        Ok(ready) => ready,
        Err(error @ (ServiceError::Internal(_) | ServiceError::Unavailable(_))) => panic!("{error}"),
        Err(_) => return,
    };
    let id = ready.listed.id.clone();
    let get = ["", "/export", "/atoms", "/atoms?format=svg", "/modes", "/modes?format=svg"];
    let post = [("/sample", "{}"), ("/reconstruct", r#"{"codes": [{"indices": [0], "values": [0.5]}]}"#)];
    let get = get.map(|what| ("GET", what, ""));
    let post = post.map(|(what, body)| ("POST", what, body));
    for (method, what, body) in get.into_iter().chain(post) {
        let request = Request::builder()
            .method(method)
            .uri(format!("/v1/dictionaries/{id}{what}"))
            .header("content-type", "application/json")
            .body(Body::from(body))
            .expect("a request");
        let (status, _, answer) = service.send(request);
        assert!(status < StatusCode::INTERNAL_SERVER_ERROR, "{method} {what}: {status} {answer:?}");
    }
    service.run(planning::delete(service.app(), &id)).expect("what was imported is deleted");
});
