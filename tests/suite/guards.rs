//! What must stay true of the documents: the committed interface document, the commands of the README and of the recipes.

use std::collections::BTreeSet;
use std::path::Path;
use std::process::Command;

use reqwest::Method;
use serde_json::{Value, json};

use crate::document::furnished;
use crate::form::{form, label_picture, post_form, shell_volume};
use crate::http_correspond::{first_mode, stored};
use crate::server::{Server, Setting, shared};
use crate::structure::{name, program};

/// Every operation of the contract.
const OPERATIONS: &[&str] = &[
    "DELETE /v1/audit",
    "DELETE /v1/cohorts/{cohort}",
    "PATCH /v1/cohorts/{cohort}",
    "GET /v1/changes",
    "GET /v1/cohorts/{cohort}/assessments",
    "GET /v1/cohorts/{cohort}/attributes",
    "GET /v1/cohorts/{cohort}/table",
    "POST /v1/cohorts/{cohort}/table",
    "GET /v1/trash",
    "POST /v1/trash/{id}/restore",
    "DELETE /v1/trash/{id}",
    "PATCH /v1/cohorts/{cohort}/shapes",
    "DELETE /v1/cohorts/{cohort}/shapes",
    "DELETE /v1/cohorts/{cohort}/shapes/{shape}",
    "PATCH /v1/cohorts/{cohort}/shapes/{shape}",
    "DELETE /v1/subjects/{subject}",
    "DELETE /v1/dictionaries/{dictionary}",
    "DELETE /v1/hooks/{hook}",
    "GET /v1/hooks",
    "GET /v1/hooks/{hook}",
    "GET /v1/hooks/{hook}/failures",
    "POST /v1/hooks",
    "POST /v1/hooks/{hook}/pause",
    "POST /v1/hooks/{hook}/redeliver",
    "POST /v1/hooks/{hook}/resume",
    "DELETE /v1/keys/{key}",
    "GET /docs/",
    "GET /livez",
    "GET /metrics",
    "GET /openapi.json",
    "GET /readyz",
    "GET /v1/audit",
    "GET /v1/cohorts",
    "GET /v1/cohorts/{cohort}",
    "GET /v1/cohorts/{cohort}/export",
    "GET /v1/cohorts/{cohort}/mean",
    "GET /v1/cohorts/{cohort}/shapes",
    "GET /v1/cohorts/{cohort}/shapes/{shape}",
    "GET /v1/cohorts/{cohort}/sheet",
    "GET /v1/dictionaries",
    "GET /v1/dictionaries/{dictionary}",
    "DELETE /v1/dictionaries/{dictionary}/aliases/{alias}",
    "GET /v1/dictionaries/{dictionary}/aliases",
    "GET /v1/dictionaries/{dictionary}/aliases/{alias}",
    "PUT /v1/dictionaries/{dictionary}/aliases/{alias}",
    "GET /v1/dictionaries/{dictionary}/atoms",
    "GET /v1/dictionaries/{dictionary}/drift",
    "GET /v1/dictionaries/{dictionary}/export",
    "GET /v1/dictionaries/{dictionary}/modes",
    "GET /v1/dictionaries/{dictionary}/scatter",
    "GET /v1/events",
    "GET /v1/formats",
    "GET /v1/generators",
    "GET /v1/generators/{name}",
    "GET /v1/idealised",
    "GET /v1/jobs",
    "GET /v1/jobs/{job}",
    "GET /v1/jobs/{job}/events",
    "GET /v1/jobs/{job}/output",
    "GET /v1/keys",
    "GET /v1/keys/{key}",
    "GET /v1/models/{job}/predictions",
    "GET /v1/transformations",
    "GET /v1/settings",
    "GET /v1/subjects/{subject}",
    "GET /v1/version",
    "POST /v1/align",
    "POST /v1/cohorts",
    "POST /v1/cohorts/{cohort}/attributes",
    "POST /v1/cohorts/{cohort}/correspond",
    "POST /v1/cohorts/{cohort}/matching",
    "POST /v1/cohorts/{cohort}/search",
    "POST /v1/cohorts/{cohort}/segment",
    "POST /v1/cohorts/{cohort}/shapes",
    "POST /v1/comparisons",
    "POST /v1/contours",
    "POST /v1/convert",
    "POST /v1/deform",
    "POST /v1/dictionaries",
    "POST /v1/dictionaries/import",
    "POST /v1/dictionaries/{dictionary}/assess",
    "POST /v1/dictionaries/{dictionary}/assessments",
    "POST /v1/dictionaries/{dictionary}/classify",
    "POST /v1/dictionaries/{dictionary}/complete",
    "POST /v1/dictionaries/{dictionary}/correspond",
    "POST /v1/dictionaries/{dictionary}/encode",
    "POST /v1/dictionaries/{dictionary}/prior",
    "POST /v1/dictionaries/{dictionary}/reconstruct",
    "POST /v1/dictionaries/{dictionary}/report",
    "POST /v1/dictionaries/{dictionary}/sample",
    "POST /v1/dictionaries/{dictionary}/score",
    "POST /v1/distances",
    "POST /v1/evaluate",
    "POST /v1/fit",
    "POST /v1/idealised",
    "POST /v1/inspect",
    "POST /v1/jobs/{job}/cancel",
    "POST /v1/keys",
    "POST /v1/match",
    "POST /v1/mean",
    "POST /v1/measure",
    "POST /v1/models",
    "POST /v1/models/compare",
    "POST /v1/models/{job}/predictions",
    "POST /v1/modularity",
    "POST /v1/morph",
    "POST /v1/overlap",
    "POST /v1/pca",
    "POST /v1/pca/incomplete",
    "POST /v1/project",
    "POST /v1/prior",
    "POST /v1/refine",
    "POST /v1/regressions",
    "POST /v1/repeatability",
    "POST /v1/resample",
    "POST /v1/segment",
    "POST /v1/sheets",
    "POST /v1/slide",
    "POST /v1/subdivide",
    "POST /v1/symmetry",
    "POST /v1/two-blocks",
    "POST /v1/warp",
];

fn committed() -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("openapi/openapi.json");
    std::fs::read_to_string(path).unwrap()
}

/// `METHOD path` and the operation.
pub(crate) fn operations(document: &Value) -> Vec<(String, &Value)> {
    let paths = document["paths"].as_object().unwrap();
    let of_path = |(path, item): (&'_ String, &'_ Value)| {
        let methods = item.as_object().unwrap().keys().filter(|key| *key != "parameters").cloned();
        methods.map(|method| (path.clone(), method)).collect::<Vec<_>>()
    };
    paths
        .iter()
        .flat_map(of_path)
        .map(|(path, method)| (format!("{} {path}", method.to_uppercase()), &paths[&path][&method]))
        .collect()
}

#[test]
fn the_program_prints_the_committed_interface_document() {
    let output = Command::new(env!("CARGO_BIN_EXE_shapelex")).arg("openapi").output().unwrap();
    assert!(output.status.success());
    let generated = String::from_utf8(output.stdout).unwrap();
    assert!(
        generated == committed(),
        "openapi/openapi.json is old: run `cargo run --features schema -- openapi > openapi/openapi.json` and review the difference"
    );
}

#[test]
fn the_interface_document_covers_every_route_and_status() {
    let document: Value = serde_json::from_str(&committed()).unwrap();
    let operations = operations(&document);
    let documented: BTreeSet<&str> = operations.iter().map(|(operation, _)| operation.as_str()).collect();
    let wanted =
        OPERATIONS.iter().copied().filter(|o| !o.ends_with("/openapi.json") && !o.ends_with("/docs/"));
    assert_eq!(documented, wanted.collect());
    for (name, operation) in &operations {
        let responses = operation["responses"].as_object().unwrap();
        assert!(responses.keys().any(|status| status.starts_with('2')), "{name} has no success");
        // Who can send nothing wrong gets nothing refused.
        let takes_input = operation.get("parameters").is_some() || operation.get("requestBody").is_some();
        let refuses = responses.keys().any(|status| status.starts_with('4'));
        assert!(refuses || !takes_input, "{name} refuses nothing: {:?}", responses.keys());
        for (status, response) in responses {
            let is_refusal = status.starts_with('4') || status.starts_with('5');
            let content = response.get("content").and_then(Value::as_object);
            let types: Vec<&str> = content.into_iter().flat_map(|c| c.keys().map(String::as_str)).collect();
            assert_eq!(
                types.contains(&"application/problem+json"),
                is_refusal,
                "{name} {status}: {types:?} (refusals and only they are problem documents)"
            );
            assert!(!response["description"].as_str().unwrap().is_empty(), "{name} {status}");
        }
        assert!(operation["summary"].as_str().is_some_and(|text| text.len() > 5), "{name} has no summary");
    }
}

#[test]
fn every_operation_says_which_role_it_needs() {
    let document: Value = serde_json::from_str(&committed()).unwrap();
    for (name, operation) in operations(&document) {
        let (method, path) = name.split_once(' ').unwrap();
        let role = operation["x-role"].as_str().unwrap_or_default();
        assert!(
            shapelex_server::api::operation::find(method, path).is_some(),
            "{name} is not in the table of api/operation.rs"
        );
        let responses = operation["responses"].as_object().unwrap();
        let refuses = responses.contains_key("401") && responses.contains_key("403");
        assert_eq!(refuses, role != "none", "{name} needs {role}: {:?}", responses.keys());
        assert_eq!(operation["security"] == json!([]), role == "none", "{name}: {}", operation["security"]);
        // What changes nothing is for readers, and what deletes is not; only the probes are for everyone.
        match role {
            "none" => assert_eq!(operation["tags"], json!(["health"]), "{name}"),
            "reader" => assert_ne!(method, "DELETE", "{name}"),
            "writer" => assert_ne!(method, "GET", "{name}"),
            "admin" => {
                let for_admins =
                    ["/v1/hooks", "/v1/keys", "/v1/audit", "/v1/settings", "/v1/subjects/", "/v1/trash/"];
                assert!(for_admins.iter().any(|prefix| path.starts_with(prefix)), "{name}");
            }
            _ => panic!("{name} needs {role}"),
        }
    }
    assert!(shapelex_server::api::operation::find("GET", "/v1/unheard-of").is_none());
}

#[test]
fn the_routes_of_the_interface_document_exist() {
    let server = shared();
    for operation in OPERATIONS {
        let (method, path) = operation.split_once(' ').unwrap();
        let path = path
            .replace("{cohort}", "none")
            .replace("{shape}", "none")
            .replace("{name}", "keys")
            .replace("{dictionary}", "none")
            .replace("{alias}", "none")
            .replace("{hook}", "none")
            .replace("{key}", "none")
            .replace("{job}", "none");
        let reply = server.send(server.request(method.parse::<Method>().unwrap(), &path));
        if reply.status >= 400 {
            let code = reply.json()["code"].as_str().unwrap().to_owned();
            assert!(code != "route-not-found" && code != "method-not-allowed", "{operation}: {code}");
        }
    }
    let served: Value = server.get("/openapi.json").expect(200);
    assert_eq!(served, serde_json::from_str::<Value>(&committed()).unwrap());
}

#[test]
fn refusals_have_documented_statuses() {
    let document: Value = serde_json::from_str(&committed()).unwrap();
    let server = Setting::fresh().start();
    let mut undocumented = BTreeSet::new();
    for (name, operation) in operations(&document) {
        let (method, template) = name.split_once(' ').unwrap();
        let path = |id: &str| {
            let path = template.replace("{cohort}", id).replace("{shape}", "none").replace("{name}", id);
            let path = path.replace("{alias}", id);
            path.replace("{dictionary}", id).replace("{job}", id).replace("{key}", id).replace("{hook}", id)
        };
        let request = |path: &str| server.request(method.parse::<Method>().unwrap(), path);
        let requests = [
            request(&path("none")),
            request(&path("%ff")),
            request(&format!("{}?format=csv", path("none"))),
            request(&format!("{}?colour=red", path("none"))),
            request(&path("none")).header("accept", "text/csv"),
            request(&path("none")).header("content-type", "text/plain").body("x"),
            request(&path("none")).header("content-type", "application/json").body("{"),
            request(&path("none")).header("content-type", "application/json").body("{}"),
        ];
        let responses = operation["responses"].as_object().unwrap();
        for request in requests {
            let status = server.send(request).status.to_string();
            let range = format!("{}XX", &status[..1]);
            if !responses.contains_key(&status) && !responses.contains_key(&range) {
                undocumented.insert(format!("{name} answers {status}"));
            }
        }
    }
    assert!(undocumented.is_empty(), "not in the document: {undocumented:#?}");
}

/// What `reference` (`#/components/…`) points to.
pub(crate) fn resolve<'a>(document: &'a Value, value: &'a Value) -> &'a Value {
    match value.get("$ref").and_then(Value::as_str) {
        Some(reference) => document.pointer(reference.trim_start_matches('#')).unwrap(),
        None => value,
    }
}

/// A contour in a slice of a series.
const SLICE: &str =
    r#"{"points": [[0, 0, 12.5], [9, 0, 12.5], [0, 7, 12.5]], "closed": true, "external_id": "a"}"#;

#[test]
fn the_examples_of_the_interface_document_work() {
    let document: Value = serde_json::from_str(&committed()).unwrap();
    let server = furnished();
    let mut missing = Vec::new();
    // Creation first: the shapes go into the cohort of its example.
    let (mut cohort, mut hook) = (String::from("none"), String::from("none"));
    stored(&server, "beans", 6);
    first_mode(&server, "beans");
    let job = kept_model(&server);
    for (name, operation) in operations(&document) {
        let Some(content) = operation.pointer("/requestBody/content").and_then(Value::as_object) else {
            continue;
        };
        // The first key closes the service: it is made last.
        if name == "POST /v1/keys" {
            continue;
        }
        for (media_type, body) in content {
            // The example of a form is that of its JSON document; its file is a picture, or a contour.
            let parts = &resolve(&document, &body["schema"])["properties"];
            let form = parts.get("parameters").filter(|_| media_type == "multipart/form-data");
            if let Some(parameters) = form {
                let example = resolve(&document, parameters)["example"].to_string();
                let path = name.split_once(' ').unwrap().1.replace("{cohort}", &cohort);
                let (part, file) = match path.as_str() {
                    "/v1/sheets" => ("image", shell_volume()),
                    "/v1/convert" => ("file", SLICE.into()),
                    _ => ("image", label_picture()),
                };
                let parts: [(&str, &str, &[u8]); 2] =
                    [("parameters", "application/json", example.as_bytes()), (part, "image/png", &file)];
                let reply = post_form(&server, &path, self::form(&parts));
                assert!((200..300).contains(&reply.status), "{name}: {}", reply.text());
                continue;
            }
            let own = body.get("example");
            let of_schema = || resolve(&document, &body["schema"]).get("example");
            // The lines, or the file, are the shapes of the document, whose other fields are in the query: `http_results` and
            // `http_batch_files` send them.
            if ["application/x-ndjson", "application/octet-stream"].contains(&media_type.as_str())
                && own.is_none()
            {
                continue;
            }
            let Some(example) = own.or_else(of_schema) else {
                missing.push(format!("{name} {media_type}"));
                continue;
            };
            let (method, path) = name.split_once(' ').unwrap();
            // Operations come in their order: attributes and changes of shapes before there are any.
            let is_early =
                path.ends_with("/attributes") || name.starts_with("PATCH") && path.ends_with("/shapes");
            let is_of_surfaces = is_early || path.ends_with("/correspond") || path.ends_with("/matching");
            let shapes = if is_early { ["bean-1", "bean-2"] } else { ["scan-17", "scan-18"] };
            let [cohort_of, dictionary_of] = if is_of_surfaces { ["beans"; 2] } else { [&*cohort, "modes"] };
            let path = path.replace("{cohort}", cohort_of).replace("{dictionary}", dictionary_of);
            // The shapes of an earlier example.
            let path = path.replace("{shape}", "scan-17").replace("{hook}", &hook);
            let path = path.replace("{alias}", "production").replace("{job}", &job);
            let text = example.as_str().map_or_else(|| example.to_string(), str::to_owned);
            let text = text
                .replace("hippocampi", "beans")
                .replace("hippocampus_001", "bean-1")
                .replace("scan-17", shapes[0])
                .replace("scan-18", shapes[1]);
            let request = server.request(method.parse().unwrap(), &path).header("content-type", media_type);
            let reply = server.send(request.body(text));
            assert!((200..300).contains(&reply.status), "{name} {media_type}: {}", reply.text());
            if name == "POST /v1/cohorts" {
                cohort = reply.json()["id"].as_str().unwrap().to_owned();
            }
            if name == "POST /v1/hooks" {
                hook = reply.json()["id"].as_str().unwrap().to_owned();
            }
        }
    }
    assert_eq!(missing, [""; 0], "request bodies without an example");
    let body = &document["paths"]["/v1/keys"]["post"]["requestBody"]["content"]["application/json"]["schema"];
    server.post("/v1/keys", &resolve(&document, body)["example"]).expect(201);
    assert_eq!(server.get("/v1/keys").status, 401);
}

/// The job that keeps a model of the example cells.
pub(crate) fn kept_model(server: &Server) -> String {
    let body = json!({"cohort": "example-cells", "formula": "~ log_centroid_size", "permutations": 99, "keep": true});
    let request = server.request(Method::POST, "/v1/models").header("prefer", "wait=60").json(&body);
    let found = server.send(request).expect(200);
    found["kept_at"].as_str().unwrap().split('/').nth(3).unwrap().to_owned()
}

/// All references of a document.
fn references<'a>(value: &'a Value, found: &mut BTreeSet<&'a str>) {
    match value {
        Value::Object(map) => {
            found.extend(map.get("$ref").and_then(Value::as_str));
            map.values().for_each(|value| references(value, found));
        }
        Value::Array(list) => list.iter().for_each(|value| references(value, found)),
        _ => {}
    }
}

#[test]
fn every_reference_of_the_interface_document_leads_somewhere() {
    let document: Value = serde_json::from_str(&committed()).unwrap();
    let mut found = BTreeSet::new();
    references(&document, &mut found);
    found.retain(|reference| document.pointer(reference.trim_start_matches('#')).is_none());
    assert_eq!(found, BTreeSet::new(), "these lead nowhere");
}

/// Names of the types of a source file that have a schema.
fn schema_names(text: &str) -> Vec<String> {
    let mut names = Vec::new();
    let mut wanted = false;
    for line in text.lines().map(str::trim_start) {
        wanted |= line.contains("derive(") && line.contains("ToSchema");
        let line = line.trim_start_matches("pub(super) ").trim_start_matches("pub(crate) ");
        let line = line.trim_start_matches("pub(in crate::api::v1) ");
        let line = line.trim_start_matches("pub ");
        let declared = ["struct ", "enum "].iter().find_map(|word| line.strip_prefix(word));
        if let Some(rest) = declared.filter(|_| wanted) {
            names.push(name(rest).to_owned());
            wanted = false;
        }
    }
    // Documents derive it in their macro.
    let documents = text.split("document! {").skip(1);
    names.extend(documents.filter_map(|rest| Some(name(rest.split_once("struct ")?.1).to_owned())));
    // Other macros are given the name: `PageOfShapes of StoredShape`, `MeasureRequest {`.
    let given = |text: &str| {
        let declared = name(text);
        let rest = text[declared.len()..].trim_start();
        let is_type = declared.starts_with(|c: char| c.is_ascii_uppercase());
        (is_type && (rest.starts_with('{') || rest.starts_with("of "))).then(|| declared.to_owned())
    };
    let macros = ["page! {", "_request! {"].iter().flat_map(|start| text.split(start).skip(1));
    names.extend(macros.filter_map(|rest| rest.lines().map(str::trim).find_map(given)));
    names
}

#[test]
fn no_two_types_share_the_name_of_a_schema() {
    let mut places: std::collections::BTreeMap<String, BTreeSet<String>> = std::collections::BTreeMap::new();
    for (path, text) in program() {
        for name in schema_names(&text) {
            places.entry(name).or_default().insert(path.clone());
        }
    }
    for name in ["ShapeInput", "PageOfShapes", "MeasureRequest", "CompareRequest", "AddRequest"] {
        assert!(places.contains_key(name), "{name} is not among {} types that were found", places.len());
    }
    // Within macros that declare types the name is a variable.
    places.retain(|name, files| !name.is_empty() && files.len() > 1);
    assert!(places.is_empty(), "the document would keep one of each: {places:#?}");
}

/// Whether the schema of a field takes `null`.
fn is_nullable(document: &Value, schema: &Value) -> bool {
    let is_null = |schema: &Value| match &schema["type"] {
        Value::String(name) => name == "null",
        Value::Array(names) => names.iter().any(|name| name == "null"),
        _ => false,
    };
    let branches = ["oneOf", "anyOf"].iter().filter_map(|key| schema[*key].as_array()).flatten();
    is_null(schema) || branches.map(|branch| resolve(document, branch)).any(is_null)
}

/// A number that no other call returns.
fn number() -> usize {
    static NEXT: std::sync::atomic::AtomicUsize = std::sync::atomic::AtomicUsize::new(0);
    NEXT.fetch_add(1, std::sync::atomic::Ordering::Relaxed)
}

#[test]
fn null_is_as_good_as_nothing_where_the_document_says_so() {
    let document: Value = serde_json::from_str(&committed()).unwrap();
    let server = Setting::fresh().with_example().start();
    let learn = json!({"name": "modes", "cohort": "example-cells", "transformation": "similarity",
        "method": {"kind": "functional_pca", "components": 3, "centre": true},
        "classifier": {"kind": "discriminant", "attribute": "labels.treatment", "repeats": 1}});
    let learn = server.request(Method::POST, "/v1/dictionaries").header("prefer", "wait=60").json(&learn);
    server.send(learn).expect(201);
    let (mut asked, mut refused) = (0, Vec::new());
    for (name, operation) in operations(&document) {
        let Some(body) = operation.pointer("/requestBody/content/application~1json") else { continue };
        let schema = resolve(&document, &body["schema"]);
        let Some(properties) = schema["properties"].as_object().filter(|_| name != "POST /v1/keys") else {
            continue;
        };
        let example = body.get("example").unwrap_or(&schema["example"]);
        let (method, path) = name.split_once(' ').unwrap();
        let path = path.replace("{cohort}", "example-cells").replace("{dictionary}", "modes");
        let send = |body: &Value| {
            let mut body = body.clone();
            if body.get("name").is_some() {
                // Names of cohorts are given once.
                body["name"] = json!(format!("name-{}", number()));
            }
            server.send(server.request(method.parse().unwrap(), &path).json(&body))
        };
        for (field, schema) in properties {
            let given = !example[field].is_null();
            if given || !is_nullable(&document, schema) {
                continue;
            }
            let mut with_null = example.clone();
            with_null[field] = Value::Null;
            let (without, with) = (send(example), send(&with_null));
            asked += 1;
            if without.status != with.status {
                refused.push(format!("{name} {field}: {} becomes {}", without.status, with.text()));
            }
        }
    }
    assert!(asked > 80, "{asked} fields were found");
    assert!(refused.is_empty(), "{refused:#?}");
}

/// The shell blocks of a document that begin with curl.
fn curl_blocks(text: &str) -> Vec<String> {
    let blocks = text.split("```sh\n").skip(1).map(|rest| rest.split("```").next().unwrap());
    blocks.filter(|block| block.trim_start().starts_with("curl")).map(str::to_owned).collect()
}

/// The README, and the recipes in the order of their list.
fn pages_of_commands() -> Vec<String> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let read = |path: &str| std::fs::read_to_string(root.join(path)).unwrap();
    let list = read("docs/recipes/README.md");
    let names = list.lines().filter(|line| line.starts_with(|c: char| c.is_ascii_digit()));
    let names: Vec<&str> =
        names.filter_map(|line| line.split_once("](")?.1.split_once(')')).map(|(name, _)| name).collect();
    let files = std::fs::read_dir(root.join("docs/recipes")).unwrap();
    let pages =
        files.filter(|file| file.as_ref().unwrap().path().extension().is_some_and(|ending| ending == "md"));
    assert_eq!(pages.count(), names.len() + 1, "a recipe that docs/recipes/README.md does not list");
    std::iter::once(read("README.md"))
        .chain(names.iter().map(|name| read(&format!("docs/recipes/{name}"))))
        .collect()
}

#[test]
fn the_commands_of_the_readme_and_of_the_recipes_work() {
    let blocks: Vec<String> = pages_of_commands().iter().flat_map(|page| curl_blocks(page)).collect();
    assert!(blocks.len() > 30, "{} ```sh blocks that begin with curl", blocks.len());
    let found = Command::new("curl").arg("--version").output();
    assert!(found.is_ok(), "this test runs the curl commands of the README: install curl");
    let server = Setting::fresh().with_example().start();
    let address = server.address().trim_start_matches("http://");
    // Pictures that the commands write do not end up in the checkout.
    let folder = tempfile::tempdir().unwrap();
    let (bodies, copies) = (bodies_of_recipes(), folder.path().join("bodies"));
    std::fs::create_dir(&copies).unwrap();
    bodies.iter().for_each(|(name, text)| std::fs::write(copies.join(name), text).unwrap());
    for block in blocks {
        assert!(block.contains("127.0.0.1:8080"), "not against the service: {block}");
        // `-f` as a default of this run: an answer of 400 and above is a failure.
        let script = format!("set -e\ncurl() {{ command curl -q -sSf \"$@\"; }}\n{block}");
        let script = script.replace("127.0.0.1:8080", address);
        let output = Command::new("sh").arg("-c").arg(&script).current_dir(folder.path()).output().unwrap();
        let (stdout, stderr) =
            (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
        assert!(output.status.success(), "{block}\nended with {}\n{stdout}\n{stderr}", output.status);
    }
    for entry in std::fs::read_dir(folder.path()).unwrap() {
        let path = entry.unwrap().path();
        let is_picture = path.extension().is_some_and(|ending| ending == "svg");
        assert!(
            !is_picture || std::fs::read(&path).unwrap().starts_with(b"<svg"),
            "{} holds another answer",
            path.display()
        );
    }
}

/// Bodies of the requests of recipes, by the names of their files.
fn bodies_of_recipes() -> Vec<(String, String)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/recipes/bodies");
    let read = |file: std::io::Result<std::fs::DirEntry>| {
        let path = file.unwrap().path();
        (path.file_name().unwrap().to_str().unwrap().to_owned(), std::fs::read_to_string(path).unwrap())
    };
    std::fs::read_dir(folder).unwrap().map(read).collect()
}

#[test]
fn recipes_show_the_bodies_that_they_send() {
    let pages = pages_of_commands();
    let bodies = bodies_of_recipes();
    for page in &pages {
        for name in page.split("-d @bodies/").skip(1).filter_map(|rest| rest.split_whitespace().next()) {
            let (_, text) =
                bodies.iter().find(|(body, _)| body == name).unwrap_or_else(|| panic!("no {name}"));
            let shown = format!("`bodies/{name}`:\n\n```json\n{text}```\n");
            assert!(page.contains(&shown), "the page that sends {name} shows another body");
        }
    }
    for (name, _) in &bodies {
        assert!(
            pages.iter().any(|page| page.contains(&format!("-d @bodies/{name}"))),
            "no recipe sends {name}"
        );
    }
}

/// The program of the README prints the distance that the command answers.
#[test]
fn the_program_of_the_readme_works() {
    let pages = pages_of_commands();
    let program = pages[0].split("```python\n").nth(1).and_then(|rest| rest.split("```").next()).unwrap();
    let server = shared();
    let program = program.replace("http://127.0.0.1:8080", server.address());
    let Ok(output) = Command::new("python3").arg("-c").arg(program).output() else {
        println!("SKIPPED: the program of the README, there is no python3");
        return;
    };
    let printed = String::from_utf8_lossy(&output.stdout).trim().parse::<f64>();
    let distance = printed.unwrap_or_else(|_| panic!("{}", String::from_utf8_lossy(&output.stderr)));
    assert!((distance - 0.090_471_462_652_060_85).abs() < 1e-12, "{distance}");
}

/// What waits for a job may get the job itself, as JSON, after a wait on a slow machine.
#[test]
fn commands_save_no_job_as_a_picture() {
    let saving = |line: &&str| line.contains("prefer: wait") && line.contains(" -o ");
    for page in pages_of_commands() {
        for line in curl_blocks(&page).iter().flat_map(|block| block.lines()).filter(saving) {
            assert!(line.contains("%{http_code}") && line.contains("= 202"), "{line}");
        }
    }
}

#[test]
fn the_blocks_of_the_readme_are_found() {
    let text =
        "a\n```sh\nmake run\n```\nb\n```sh\ncurl -s x\n```\n```json\n{}\n```\n```sh\ncurl y \\\n z\n```\n";
    assert_eq!(curl_blocks(text), ["curl -s x\n", "curl y \\\n z\n"]);
}
