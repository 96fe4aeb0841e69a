//! What browsers and caches need: pages of other origins, media types, headers of cached answers.

use reqwest::Method;
use reqwest::header::{ACCEPT, CONTENT_TYPE};
use serde_json::json;

use crate::http_contract::cells;
use crate::server::{Reply, Server, Setting, shared};

fn asked(server: &Server, method: Method, path: &str, headers: &[(&str, &str)]) -> Reply {
    let request = headers
        .iter()
        .fold(server.request(method, path), |request, (name, value)| request.header(*name, *value));
    server.send(request)
}

#[test]
fn pages_of_listed_origins_may_read_answers() {
    let page = ("origin", "https://dashboard.example");
    let site = ("sec-fetch-site", "cross-site");
    let preflight =
        [page, ("access-control-request-method", "PATCH"), ("access-control-request-headers", "if-match")];
    let server = Setting::fresh()
        .flags(&["--allow-origin", "https://dashboard.example,http://localhost:3000"])
        .start();
    let reply = asked(&server, Method::OPTIONS, "/v1/cohorts", &preflight);
    assert_eq!((reply.status, reply.header("access-control-allow-origin")), (200, Some(page.1)));
    assert!(reply.header("access-control-allow-methods").unwrap().contains("PATCH"));
    assert!(reply.header("access-control-allow-headers").unwrap().contains("if-match"));
    let reply = asked(&server, Method::GET, "/v1/cohorts", &[page, site]);
    assert_eq!((reply.status, reply.header("access-control-allow-origin")), (200, Some(page.1)));
    assert!(reply.header("access-control-expose-headers").unwrap().contains("etag"));
    assert!(reply.header("vary").unwrap().contains("accept"));

    for other in [
        "https://other.example",
        "https://dashboard.example.evil.example",
        "null",
        "http://dashboard.example",
    ] {
        let reply = asked(&server, Method::GET, "/v1/cohorts", &[("origin", other), site]);
        reply.expect_problem(403, "forbidden", &[]);
        assert_eq!(reply.header("access-control-allow-origin"), None, "{other}");
    }
    asked(&server, Method::GET, "/v1/cohorts", &[site]).expect_problem(403, "forbidden", &[]);

    let closed = Server::fresh();
    let reply = asked(&closed, Method::OPTIONS, "/v1/cohorts", &preflight);
    assert_eq!((reply.status, reply.header("access-control-allow-origin")), (405, None));
    let reply = asked(&closed, Method::GET, "/v1/cohorts", &[page]);
    assert_eq!((reply.status, reply.header("access-control-allow-origin")), (403, None));
}

#[test]
fn accept_is_obeyed_or_refused() {
    let server = shared();
    for (path, accept) in [
        ("/v1/cohorts", "text/csv"),
        ("/v1/jobs", "image/svg+xml, text/*;q=0.5"),
        ("/v1/generators", "application/json;q=0"),
        ("/v1/cohorts/none/shapes", "text/x-nothing"),
    ] {
        let reply = asked(&server, Method::GET, path, &[(ACCEPT.as_str(), accept)]);
        let problem = reply.expect_problem(406, "not-acceptable", &[]);
        assert!(problem["detail"].as_str().unwrap().contains("application/json"), "{problem}");
    }
    for accept in
        ["*/*", "application/*", "text/html, application/json;q=0.9", "APPLICATION/JSON; charset=utf-8"]
    {
        assert_eq!(
            asked(&server, Method::GET, "/v1/cohorts", &[(ACCEPT.as_str(), accept)]).status,
            200,
            "{accept}"
        );
    }
    // Before the work is done: nothing is created.
    let body = json!({"name": "unwelcome", "correspondence": "landmarks",
        "representation": {"kind": "landmarks", "dimension": 2, "points": 3}});
    let request = server.request(Method::POST, "/v1/cohorts").header(ACCEPT, "text/csv").json(&body);
    server.send(request).expect_problem(406, "not-acceptable", &[]);
    server.get("/v1/cohorts/unwelcome").expect(404);
    let reply = server.get("/v1/cohorts");
    assert_eq!(reply.header("vary"), Some("accept, accept-encoding, authorization"));
}

#[test]
fn media_types_of_bodies_are_compared_exactly() {
    let server = shared();
    for wrong in
        ["application/geo+json", "application/vnd.api+json", "application/merge-patch+json", "text/json"]
    {
        let request = server.request(Method::POST, "/v1/mean").header(CONTENT_TYPE, wrong).body("{}");
        server.send(request).expect_problem(415, "unsupported-media-type", &[]);
    }
    let request = server
        .request(Method::PATCH, "/v1/cohorts/none")
        .header(CONTENT_TYPE, "application/merge-patch+json");
    server.send(request.body("{}")).expect_problem(404, "not-found", &[]);
}

const REVALIDATED: &str = "private, no-cache";
const IMMUTABLE: &str = "private, max-age=86400, immutable";

/// The address of a version, and no other one, says that its answers never change.
#[test]
fn answers_at_the_address_of_a_version_need_not_be_asked_for_again() {
    let server = Setting::fresh().with_example().start();
    let body = json!({"name": "modes", "cohort": "example-cells", "transformation": "similarity",
                      "method": {"kind": "functional_pca", "components": 3, "centre": true}});
    let request = server.request(Method::POST, "/v1/dictionaries").header("prefer", "wait=50");
    let learnt = server.send(request.json(&body)).expect(201);
    server.send(
        server.request(Method::PUT, "/v1/dictionaries/modes/aliases/production").json(&json!({"version": 1})),
    );
    let id = learnt["id"].as_str().unwrap();
    let keys =
        [(id, IMMUTABLE), ("modes@1", IMMUTABLE), ("modes", REVALIDATED), ("modes@production", REVALIDATED)];
    for (key, caching) in keys {
        for part in ["", "/modes", "/modes?format=svg", "/atoms"] {
            let path = format!("/v1/dictionaries/{key}{part}");
            let reply = server.get(&path);
            assert_eq!((reply.status, reply.header("cache-control")), (200, Some(caching)), "{path}");
            let tag = reply.header("etag").unwrap();
            let again = asked(&server, Method::GET, &path, &[("if-none-match", tag)]);
            assert_eq!((again.status, again.header("cache-control")), (304, Some(caching)), "{path}");
        }
        // Its answer changes with the cohort.
        let drift = server.get(&format!("/v1/dictionaries/{key}/drift"));
        assert_eq!((drift.status, drift.header("cache-control")), (200, Some(REVALIDATED)), "{key}");
    }
    let missing = server.get("/v1/dictionaries/modes@2/modes");
    assert_eq!((missing.status, missing.header("cache-control")), (404, Some("no-store")));
}

/// What follows from a revision or a version is asked again only after a change.
#[test]
fn answers_that_follow_from_a_revision_or_a_version_have_entity_tags() {
    let server = Setting::fresh().with_example().start();
    let body = json!({"name": "modes", "cohort": "example-cells", "transformation": "similarity",
                      "method": {"kind": "functional_pca", "components": 3, "centre": true}});
    let request = server.request(Method::POST, "/v1/dictionaries").header("prefer", "wait=50");
    server.send(request.json(&body)).expect(201);
    let listed = server.get("/v1/cohorts/example-cells/shapes?limit=1&fields=external_id").expect(200);
    let shape =
        format!("/v1/cohorts/example-cells/shapes/{}", listed["items"][0]["external_id"].as_str().unwrap());
    let of_revision =
        [shape.as_str(), "/v1/cohorts/example-cells/shapes?limit=5", "/v1/dictionaries/modes/drift"];
    let of_version =
        ["/v1/dictionaries/modes/modes", "/v1/dictionaries/modes/atoms", "/v1/dictionaries/modes/export"];
    let tag_of = |path: &str| {
        let reply = server.get(path);
        let is_of_persons = path.contains("/shapes");
        let caching = if is_of_persons { "no-store" } else { REVALIDATED };
        assert_eq!(reply.header("cache-control"), Some(caching), "{path}");
        reply.header("etag").unwrap_or_else(|| panic!("{path}: no tag")).to_owned()
    };
    let status = |path: &str, tag: &str| {
        server.send(server.request(Method::GET, path).header("if-none-match", tag)).status
    };
    let tags: Vec<(&str, String)> =
        of_revision.iter().chain(&of_version).map(|path| (*path, tag_of(path))).collect();
    for (path, tag) in &tags {
        assert_eq!(status(path, tag), 304, "{path}");
        let separator = if path.contains('?') { '&' } else { '?' };
        let other = format!("{path}{separator}limit=7");
        assert_ne!(status(&other, tag), 304, "{other}");
    }
    let picture =
        server.request(Method::GET, "/v1/dictionaries/modes/modes").header("accept", "image/svg+xml");
    assert_eq!(server.send(picture.header("if-none-match", &tags[3].1)).status, 200);
    let mean = "/v1/cohorts/example-cells/mean?transformation=similarity";
    let picture = asked(&server, Method::GET, mean, &[(ACCEPT.as_str(), "image/svg+xml")]);
    assert_eq!(
        (picture.status, picture.header("vary")),
        (200, Some("accept, accept-encoding, authorization"))
    );
    // A browser would take the policy of data for the picture that it keeps, and lose its styles.
    let policy = "content-security-policy";
    assert!(picture.header(policy).unwrap().contains("style-src 'unsafe-inline'"));
    let known = [(ACCEPT.as_str(), "image/svg+xml"), ("if-none-match", picture.header("etag").unwrap())];
    let again = asked(&server, Method::GET, mean, &known);
    assert_eq!((again.status, again.header(policy)), (304, None));
    let moved = json!({"shapes": [{"external_id": "one-more", "points": cells()[0]["points"]}]});
    server.post("/v1/cohorts/example-cells/shapes", &moved).expect(201);
    for (path, tag) in &tags {
        let wanted = if of_revision.contains(path) { 200 } else { 304 };
        assert_eq!(status(path, tag), wanted, "{path}");
    }
}
