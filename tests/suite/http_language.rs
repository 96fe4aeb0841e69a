//! Refusals in one language: malformed variants of every operation, searched for words of the parser, and their places.

use reqwest::Method;
use reqwest::header::CONTENT_TYPE;
use serde_json::{Value, json};

use crate::server::{Reply, Server, pointers_of};

const JSON: &str = "application/json";

/// Words of the libraries that read requests.
const LEAKS: [&str; 10] = [
    "unknown variant",
    "unknown field",
    "failed to deserialize",
    "invalid type",
    "invalid value",
    "missing field",
    "expected one of `",
    "at line",
    "serde",
    "axum",
];

fn triangle(k: i32) -> Value {
    json!({"external_id": k.to_string(), "points": [[0, 0], [4 + k, 0], [1, 3 + k]]})
}

/// A cohort and a dictionary named `c`.
fn prepared() -> Server {
    let server = Server::fresh();
    let representation = json!({"kind": "landmarks", "dimension": 2, "points": 3});
    let cohort = json!({"name": "c", "representation": representation, "correspondence": "landmarks"});
    server.post("/v1/cohorts", &cohort).expect(201);
    let shapes: Vec<Value> = (0..5).map(triangle).collect();
    server.post("/v1/cohorts/c/shapes", &json!({ "shapes": shapes })).expect(201);
    let method = json!({"kind": "functional_pca", "components": 2, "centre": true});
    let body = json!({"name": "c", "cohort": "c", "transformation": "similarity", "method": method});
    let learnt = server.request(Method::POST, "/v1/dictionaries").header("prefer", "wait=60").json(&body);
    assert!(server.send(learnt).status < 300);
    server
}

/// One operation of the OpenAPI document.
struct Operation {
    method: Method,
    path: String,
    query: Vec<String>,
    /// Names of the fields of its body, if it has one.
    fields: Option<Vec<String>>,
}

/// All operations; those that delete come last.
fn operations(document: &Value) -> Vec<Operation> {
    let mut found = Vec::new();
    for (path, item) in document["paths"].as_object().unwrap() {
        for (method, operation) in item.as_object().unwrap() {
            let parameters = operation["parameters"].as_array().cloned().unwrap_or_default();
            let of_query = parameters.iter().filter(|parameter| parameter["in"] == "query");
            let schema = &operation["requestBody"]["content"][JSON]["schema"];
            found.push(Operation {
                method: method.to_uppercase().parse().unwrap(),
                path: path.clone(),
                query: of_query.map(|parameter| parameter["name"].as_str().unwrap().to_owned()).collect(),
                fields: (!operation["requestBody"].is_null()).then(|| fields(document, schema)),
            });
        }
    }
    found.sort_by_key(|operation| operation.method == Method::DELETE);
    found
}

fn fields(document: &Value, schema: &Value) -> Vec<String> {
    let name = schema["$ref"].as_str().unwrap_or_default().rsplit('/').next().unwrap();
    let properties = document["components"]["schemas"][name]["properties"].as_object();
    properties.map(|properties| properties.keys().cloned().collect()).unwrap_or_default()
}

/// The path with a name that exists in place of every parameter, or with another one.
fn filled(path: &str, name: &str) -> String {
    let parts = path.split('/').map(|part| if part.starts_with('{') { name } else { part });
    parts.collect::<Vec<_>>().join("/")
}

fn queries(operation: &Operation) -> Vec<String> {
    let mut queries = vec!["colour=red".to_owned(), "%FF=1".to_owned()];
    for name in &operation.query {
        let name = name.replace("{attribute}", "x");
        queries.extend(["x", "", "-1", "1e999", "1.5", "%FF"].map(|value| format!("{name}={value}")));
        queries.push(format!("{name}=1&{name}=1"));
    }
    queries
}

fn bodies(fields: &[String]) -> Vec<String> {
    let texts = [
        "",
        "{",
        "{\"a\": 1",
        "[1]",
        "null",
        "\"x\"",
        "7",
        "{\"a\": }",
        "{\"a\": 1e999}",
        "{} {}",
        "{'a': 1}",
        "{\"shapes\": \"x\"}",
        "{\"colour\": \"red\"}",
        "{\"shapes\": [{\"points\": [[0, 0], [1, nope]]}]}",
    ];
    let mut bodies: Vec<String> = texts.map(str::to_owned).to_vec();
    let values = [
        json!(3),
        json!(-1.5),
        json!("x"),
        json!([[]]),
        json!(true),
        json!({"kind": "x", "name": 3}),
        json!({"kind": 3, "colour": "red"}),
    ];
    for name in fields {
        bodies.extend(values.iter().map(|value| json!({name: value}).to_string()));
    }
    bodies
}

fn fault(what: &str, reply: &Reply) -> Option<String> {
    if reply.status < 400 {
        return None;
    }
    let text = reply.text().to_lowercase();
    let leak = LEAKS.into_iter().find(|leak| text.contains(leak));
    let problem = reply.header("content-type") == Some("application/problem+json");
    let nameless = reply.json()["code"] == "invalid-query" && reply.json()["errors"] == json!([]);
    let bad = leak.is_some() || !problem || reply.status >= 500 || nameless;
    bad.then(|| format!("{what}: {} {}", reply.status, reply.text().chars().take(300).collect::<String>()))
}

#[test]
fn no_word_of_a_parser_reaches_a_client() {
    let server = prepared();
    let document = server.get("/openapi.json").expect(200);
    let (mut faults, mut sent) = (Vec::new(), 0);
    let mut send = |method: &Method, path: &str, body: Option<(&str, &str)>| {
        let request = server.request(method.clone(), path);
        let request = match body {
            Some((media_type, text)) => request.header(CONTENT_TYPE, media_type).body(text.to_owned()),
            None => request,
        };
        let what = format!("{method} {path} {}", body.map_or("", |(_, text)| text));
        faults.extend(fault(&what, &server.send(request)));
        sent += 1;
    };
    for operation in operations(&document) {
        let Operation { method, path, fields, .. } = &operation;
        let named = filled(path, "c");
        let empty = fields.as_ref().map(|_| (JSON, "{}"));
        for query in queries(&operation) {
            send(method, &format!("{named}?{query}"), empty);
        }
        if path.contains('{') {
            send(method, &filled(path, "%FF"), empty);
        }
        for body in fields.iter().flat_map(|fields| bodies(fields)) {
            send(method, &named, Some((JSON, &body)));
            if path.ends_with("/shapes") {
                send(method, &named, Some(("application/x-ndjson", &body)));
            }
        }
    }
    assert!(sent > 1000, "{sent}");
    assert!(faults.is_empty(), "{} of {sent}:\n{}", faults.len(), faults[..faults.len().min(40)].join("\n"));
}

#[test]
fn pointers_and_parameters_are_exact() {
    let server = prepared();
    let learn = |method: Value| {
        let body = json!({"name": "p", "cohort": "c", "transformation": "similarity", "method": method});
        server.post("/v1/dictionaries", &body).expect(422)
    };
    for (method, pointer, said) in [
        (json!({"kind": "functional_pca", "components": -3, "centre": true}), "/method/components", "got -3"),
        (json!({"kind": "functional_pca", "components": 3, "centre": 1}), "/method/centre", "got 1"),
        (json!({"kind": "nothing", "components": 3}), "/method/kind", "got \"nothing\""),
        (
            json!({"kind": "functional_pca", "components": 3, "centre": true, "colour": 1}),
            "/method/colour",
            "got \"colour\"",
        ),
    ] {
        let problem = learn(method);
        assert_eq!(pointers_of(&problem), [pointer], "{problem}");
        let detail = problem["errors"][0]["detail"].as_str().unwrap();
        assert!(detail.starts_with("expected ") && detail.contains(said), "{problem}");
    }
    for (path, name) in [
        ("/v1/cohorts?limit=abc", "limit"),
        ("/v1/cohorts?limit=0", "limit"),
        ("/v1/cohorts?cursor=abc", "cursor"),
        ("/v1/jobs?colour=red", "colour"),
        ("/v1/cohorts/c/shapes?limit=x", "limit"),
        ("/v1/cohorts/c/shapes?colour=red", "colour"),
        ("/v1/cohorts/c/mean?transformation=sideways", "transformation"),
        ("/v1/cohorts/c/mean", "transformation"),
        ("/v1/cohorts/c/mean?transformation=affine&transformation=rigid", "transformation"),
        ("/v1/cohorts/c?colour=red", "colour"),
        ("/v1/cohorts/%FF", "cohort"),
        ("/v1/generators/keys?control_points=x", "control_points"),
        ("/v1/generators/bspline", "degree"),
        ("/v1/dictionaries/c/modes?component=99", "component"),
        ("/v1/dictionaries/c/drift?since=never", "since"),
    ] {
        let problem = server.get(path).expect(400);
        let errors = problem["errors"].as_array().unwrap();
        assert_eq!((errors.len(), &errors[0]["parameter"]), (1, &json!(name)), "{path}: {problem}");
        assert!(errors[0].get("pointer").is_none(), "{path}: {problem}");
        let detail = problem["detail"].as_str().unwrap();
        assert!(detail.starts_with(&format!("{name}: ")), "{path}: {problem}");
    }
    let unknown = "colour: expected a parameter of this route, got 'colour'";
    for path in [
        "/v1/jobs?colour=red",
        "/v1/cohorts/c/shapes?colour=red",
        "/v1/cohorts?colour=red",
        "/v1/version?colour=red",
    ] {
        assert_eq!(server.get(path).expect(400)["detail"], unknown, "{path}");
    }
}

#[test]
fn text_that_is_not_json_is_placed_by_line_and_column() {
    let server = prepared();
    for (text, detail) in [
        (
            "{\n  \"shapes\": [1 2]}",
            "not valid JSON (line 2, column 16): expected a comma or the end of the list, got another character",
        ),
        (
            "{\"shapes\": [",
            "not valid JSON (line 1, column 12): expected the end of a list, got the end of the text",
        ),
        ("{} x", "not valid JSON (line 1, column 4): expected the end of the text, got more"),
    ] {
        let problem = server.post_bytes("/v1/mean", JSON, text).expect(400);
        assert_eq!(problem["errors"][0]["detail"], detail, "{problem}");
    }
    let problem =
        server.send(server.request(Method::PATCH, "/v1/cohorts/c").json(&json!({"corespondence": "cyclic"})));
    let problem = problem.expect(422);
    assert_eq!(pointers_of(&problem), ["/corespondence"], "{problem}");
}
