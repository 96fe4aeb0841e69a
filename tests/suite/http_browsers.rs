//! What browsers and caches need: pages of other origins, media types, headers of cached answers.

use reqwest::Method;
use reqwest::header::{ACCEPT, CONTENT_TYPE};
use serde_json::json;

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
        ("/v1/cohorts/none/shapes", "text/csv"),
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
