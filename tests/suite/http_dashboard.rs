//! The page for people: served without a key, with a policy that lets it run its own files only.

use std::time::{Duration, Instant};

use reqwest::Method;

use crate::http_access::create_key;
use crate::server::{Reply, Server, shared};

/// What a page loads: the values of `src` and `href`.
fn links(html: &str) -> Vec<&str> {
    ["src=\"", "href=\""]
        .iter()
        .flat_map(|attribute| html.split(attribute).skip(1))
        .map(|rest| rest.split('"').next().unwrap())
        .collect()
}

fn with(server: &Server, path: &str, name: &'static str, value: &str) -> Reply {
    server.send(server.request(Method::GET, path).header(name, value))
}

#[test]
fn every_view_has_an_address_that_answers_the_page() {
    let server = shared();
    let page = server.get("/");
    assert_eq!((page.status, page.header("content-type")), (200, Some("text/html; charset=utf-8")));
    assert_eq!(page.header("cache-control"), Some("no-cache"));
    for view in
        ["/?lang=de", "/app", "/app/cohorts/example-cells/table?order=label", "/app/dictionaries/cells@2"]
    {
        let reply = server.get(view);
        assert_eq!((reply.status, reply.text()), (200, page.text()), "{view}");
    }
    let tag = page.header("etag").unwrap().to_owned();
    for known in [tag.clone(), format!("\"other\", W/{tag}")] {
        let again = with(&server, "/app/jobs", "if-none-match", &known);
        assert_eq!((again.status, again.body.len(), again.header("etag")), (304, 0, Some(tag.as_str())));
        // A browser takes the policy of the page that it keeps from this answer.
        let name = "content-security-policy";
        assert_eq!(again.header(name), page.header(name));
    }
}

#[test]
fn the_page_runs_its_own_files_and_nothing_else() {
    let server = shared();
    for address in ["/", "/docs", "/docs/"] {
        check_page(&server, address);
    }
}

fn check_page(server: &Server, address: &str) {
    let page = server.get(address);
    assert_eq!((page.status, page.header("cache-control")), (200, Some("no-cache")), "{address}");
    let policy = page.header("content-security-policy").unwrap();
    for needed in ["default-src 'none'", "script-src 'self'", "style-src 'self'", "connect-src 'self'"] {
        assert!(policy.split("; ").any(|part| part == needed), "{policy}");
    }
    assert!(!policy.contains("unsafe") && !policy.contains("data:") && !policy.contains('*'), "{policy}");
    assert_eq!(page.header("x-content-type-options"), Some("nosniff"));
    let html = page.text();
    assert!(!html.contains("<style") && !html.contains(" style=") && !html.contains(" on"), "{html}");
    assert!(html.split("<script").skip(1).all(|rest| rest.contains("></script>") && rest.contains("src=")));
    let links = links(html);
    assert!(links.iter().any(|link| link.ends_with(".js")), "{links:?}");
    for link in links {
        assert!(link.starts_with("/assets/"), "{link} is elsewhere");
        let asset = server.get(link);
        assert_eq!(asset.status, 200, "{link}");
        assert_eq!(asset.header("cache-control"), Some("public, max-age=31536000, immutable"), "{link}");
        assert_eq!(with(server, link, "if-none-match", asset.header("etag").unwrap()).status, 304);
        let kind = if link.ends_with(".js") {
            "text/javascript"
        } else if link.ends_with(".css") {
            "text/css"
        } else {
            "image/"
        };
        assert!(asset.header("content-type").unwrap().starts_with(kind), "{link}");
        if kind != "image/" {
            let small = with(server, link, "accept-encoding", "gzip");
            assert_eq!(small.header("content-encoding"), Some("gzip"), "{link}");
            assert!(small.body.len() < asset.body.len());
        }
    }
}

/// Old links of the reference have another fragment, which the page reads.
#[test]
fn the_reference_shows_the_document_of_the_service() {
    let server = shared();
    let page = server.get("/docs");
    assert_eq!(page.text(), server.get("/docs/").text());
    assert_ne!(page.text(), server.get("/").text());
    let document = server.get("/openapi.json");
    assert_eq!((document.status, document.header("content-type")), (200, Some("application/json")));
    assert!(document.header("content-security-policy").unwrap().starts_with("default-src 'none'; frame"));
    let head = server.send(server.request(Method::HEAD, "/openapi.json"));
    assert_eq!((head.status, head.body.len()), (200, 0));
    let small = with(&server, "/openapi.json", "accept-encoding", "gzip");
    assert_eq!(small.header("content-encoding"), Some("gzip"));
    assert!(small.body.len() < document.body.len() / 5, "{}", small.body.len());
}

#[test]
fn other_addresses_are_refused_as_before() {
    let server = shared();
    for path in
        ["/assets/none.js", "/assets/../index.html", "/index.html", "/docs.html", "/docs/x.js", "/apps"]
    {
        server.get(path).expect_problem(404, "route-not-found", &[]);
    }
    let reply = server.send(server.request(Method::POST, "/"));
    assert_eq!(reply.expect(405)["code"], "method-not-allowed");
}

#[test]
fn the_page_needs_no_key_and_the_api_does() {
    let server = Server::fresh();
    create_key(&server, &["--role", "admin"]);
    for path in ["/", "/app/jobs"] {
        let request = server.request(Method::GET, path);
        assert_eq!(server.send(request).status, 200, "{path}");
    }
    // A running service learns of its first key within two seconds.
    let start = Instant::now();
    while server.get("/v1/cohorts").status == 200 && start.elapsed() < Duration::from_secs(5) {
        std::thread::sleep(Duration::from_millis(100));
    }
    server.get("/v1/cohorts").expect_problem(401, "unauthenticated", &[]);
}
