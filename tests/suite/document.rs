//! What clients generated from the OpenAPI document rely on.

use std::collections::BTreeSet;

use reqwest::Method;
use serde_json::{Value, json};

use crate::guards::{operations, resolve};
use crate::server::{Server, Setting, shared};

pub(crate) fn served() -> Value {
    shared().get("/openapi.json").expect(200)
}

/// All objects of a document with their pointers, but not those of examples and defaults.
fn objects(document: &Value) -> Vec<(String, &Value)> {
    fn walk<'a>(pointer: &str, value: &'a Value, found: &mut Vec<(String, &'a Value)>) {
        match value {
            Value::Object(fields) => {
                found.push((pointer.to_owned(), value));
                for (key, value) in fields {
                    if !["example", "examples", "default"].contains(&key.as_str()) {
                        walk(
                            &format!("{pointer}/{}", key.replace('~', "~0").replace('/', "~1")),
                            value,
                            found,
                        );
                    }
                }
            }
            Value::Array(items) => {
                items.iter().enumerate().for_each(|(i, item)| walk(&format!("{pointer}/{i}"), item, found));
            }
            _ => {}
        }
    }
    let mut found = Vec::new();
    walk("", document, &mut found);
    found
}

/// Entries of a list of a schema, none without it.
fn entries<'a>(schema: &'a Value, key: &str) -> &'a [Value] {
    schema[key].as_array().map_or(&[], Vec::as_slice)
}

#[test]
fn the_result_of_every_kind_of_job_is_described() {
    let document = served();
    let schemas = &document["components"]["schemas"];
    let results = entries(&schemas["JobResult"], "oneOf");
    let described = |kind: &str| {
        let of = format!("Of `{kind}`");
        results.iter().any(|result| result["description"].as_str().is_some_and(|text| text.starts_with(&of)))
    };
    let kinds: Vec<&str> = entries(&schemas["JobKind"], "enum").iter().filter_map(Value::as_str).collect();
    assert!(kinds.len() >= 8, "{kinds:?}");
    let forgotten: Vec<&&str> = kinds.iter().filter(|kind| !described(kind)).collect();
    assert!(
        forgotten.is_empty(),
        "JobResult in src/api/v1/administration/jobs.rs does not know the results of {forgotten:?}"
    );
}

#[test]
fn references_lead_somewhere_and_names_are_words() {
    let document = served();
    for (pointer, schema) in objects(&document) {
        if let Some(reference) = schema.get("$ref").and_then(Value::as_str) {
            let target = reference.strip_prefix('#').and_then(|target| document.pointer(target));
            assert!(target.is_some(), "{pointer} refers to {reference}");
        }
    }
    let schemas = document["components"]["schemas"].as_object().unwrap();
    assert!(schemas.len() > 200, "{} schemas", schemas.len());
    for name in schemas.keys() {
        let is_word = name.starts_with(|c: char| c.is_ascii_uppercase())
            && name.chars().all(|c| c.is_ascii_alphanumeric());
        assert!(is_word && name != "Vec", "{name} is no name of a type");
    }
    let titles: Vec<&str> = schemas.values().filter_map(|schema| schema["title"].as_str()).collect();
    assert_eq!(titles.len(), titles.iter().collect::<BTreeSet<_>>().len(), "two schemas have the same title");
}

#[test]
fn no_part_of_a_schema_is_a_choice() {
    let document = served();
    for (pointer, schema) in objects(&document) {
        for part in entries(schema, "allOf") {
            let part = resolve(&document, part);
            let is_choice = part.get("oneOf").or(part.get("anyOf")).is_some();
            assert!(!is_choice, "{pointer}: generators of clients cannot merge a choice into an object");
        }
    }
}

/// Whether a schema is an object with one constant for `tag`.
fn has_constant(schema: &Value, tag: &str) -> bool {
    schema["properties"][tag].get("const").is_some()
}

#[test]
fn variants_have_names_and_tagged_ones_a_discriminator() {
    let document = served();
    let mut tagged = 0;
    for (pointer, schema) in objects(&document) {
        let choices = entries(schema, "oneOf");
        for choice in
            choices.iter().filter(|choice| choice["type"] == "object" && choice.get("$ref").is_none())
        {
            assert!(choice["title"].is_string(), "{pointer}: {choice} has no title");
        }
        let variants: Vec<&Value> = choices.iter().map(|choice| resolve(&document, choice)).collect();
        let tag = ["kind", "name"]
            .into_iter()
            .find(|tag| !variants.is_empty() && variants.iter().all(|variant| has_constant(variant, tag)));
        let Some(tag) = tag else { continue };
        tagged += 1;
        assert_eq!(schema["discriminator"]["propertyName"], tag, "{pointer}");
        for (choice, variant) in choices.iter().zip(&variants) {
            let value = variant["properties"][tag]["const"].as_str().unwrap();
            assert_eq!(schema["discriminator"]["mapping"][value], choice["$ref"], "{pointer}: {value}");
            assert!(variant["required"].as_array().unwrap().contains(&json!(tag)), "{pointer}: {value}");
        }
    }
    assert!(tagged >= 6, "{tagged} tagged choices");
}

#[test]
fn every_operation_has_an_id_and_an_answer_with_a_type() {
    let document = served();
    let mut ids = BTreeSet::new();
    for (name, operation) in operations(&document) {
        let id = operation["operationId"].as_str().unwrap_or_default();
        assert!(!id.is_empty() && ids.insert(id), "{name} has the operation id '{id}'");
        let responses = operation["responses"].as_object().unwrap();
        for (status, response) in responses.iter().filter(|(status, _)| status.starts_with('2')) {
            let content = response["content"].as_object();
            assert_eq!(content.is_none(), status == "204", "{name} {status}: {response}");
            for (media_type, body) in content.into_iter().flatten() {
                let schema = &body["schema"];
                let named = schema.get("$ref").is_some();
                let is_typed = named || (media_type != "application/json" && schema["type"] == "string");
                assert!(is_typed, "{name} {status} {media_type}: {schema}");
            }
        }
    }
}

#[test]
fn objects_have_fields_or_say_what_their_values_are() {
    for (pointer, schema) in objects(&served()) {
        let is_object = schema["type"] == "object" || entries(schema, "type").contains(&json!("object"));
        let is_typed = schema.get("properties").is_some() || schema.get("additionalProperties").is_some();
        assert!(!is_object || is_typed, "{pointer}: generators of clients make an empty object of {schema}");
        let items = schema.get("items").filter(|_| schema["type"] == "array");
        assert!(items != Some(&json!({})), "{pointer}: {schema} says nothing of its entries");
    }
}

#[test]
fn parameters_have_plain_names_and_maps_are_deep_objects() {
    let document = served();
    let mut maps = 0;
    for (name, operation) in operations(&document) {
        for parameter in entries(operation, "parameters") {
            let own = parameter["name"].as_str().unwrap();
            assert!(own.chars().all(|c| c.is_ascii_alphanumeric() || "_-".contains(c)), "{name}: {own}");
            if parameter["schema"]["type"] == "object" {
                maps += 1;
                assert_eq!(
                    (&parameter["style"], &parameter["explode"]),
                    (&json!("deepObject"), &json!(true))
                );
            }
        }
    }
    assert!(maps >= 2, "{maps} maps");
}

#[test]
fn attributes_in_brackets_select_the_same_shapes() {
    let server = Setting::fresh().with_example().start();
    let page = |query: &str| server.get(&format!("/v1/cohorts/example-cells/shapes?limit=200&{query}"));
    let dots = page("labels.treatment=jasp&labels.cell_line=dunn").expect(200);
    let count = dots["items"].as_array().unwrap().len();
    assert!(count > 0 && count < 120, "{count} shapes");
    for query in
        ["labels[treatment]=jasp&labels[cell_line]=dunn", "labels%5Btreatment%5D=jasp&labels.cell_line=dunn"]
    {
        assert_eq!(page(query).expect(200), dots, "{query}");
    }
    let mean = |query: &str| {
        server.get(&format!("/v1/cohorts/example-cells/mean?transformation=similarity&{query}"))
    };
    let (dots, brackets) = (mean("labels.treatment=jasp"), mean("labels%5Btreatment%5D=jasp"));
    assert_eq!((dots.status, dots.header("etag")), (200, brackets.header("etag")), "{}", brackets.text());
    assert_eq!(dots.json(), brackets.json());
    for query in ["labels[treatment=jasp", "labels[a][b]=jasp", "limit=1&limit=2"] {
        assert_eq!(page(query).expect(400)["code"], "invalid-query", "{query}");
    }
}

/// Values at and beyond the bounds of a number or a list: what should be taken, and what must not.
fn around(schema: &Value) -> Vec<(Value, bool)> {
    let shifted = |bound: &Value, by: f64| match bound.as_i64() {
        Some(bound) => json!(bound + by as i64),
        None => json!(bound.as_f64().unwrap() * (1.0 + by.signum() * bound.as_f64().unwrap().signum() * 0.5)),
    };
    let mut values = Vec::new();
    for (key, outward) in [("minimum", -1.0), ("maximum", 1.0)] {
        if let Some(bound) = schema.get(key) {
            values.extend([(bound.clone(), true), (shifted(bound, outward), false)]);
        }
    }
    let exclusive = ["exclusiveMinimum", "exclusiveMaximum"];
    values.extend(exclusive.iter().filter_map(|key| schema.get(*key)).map(|bound| (bound.clone(), false)));
    let is_list = schema["type"] == "array" || entries(schema, "type").contains(&json!("array"));
    if is_list && schema["minItems"].as_u64().is_some_and(|fewest| fewest > 0) {
        values.push((json!([]), false));
    }
    values
}

/// Starts a service with the dictionary of the examples.
pub(crate) fn furnished() -> Server {
    furnish(Setting::fresh().with_example())
}

/// Starts a service with the example, and learns the dictionary of the examples.
pub(crate) fn furnish(setting: Setting) -> Server {
    let server = setting.start();
    let learn = json!({"name": "modes", "cohort": "example-cells", "transformation": "similarity",
        "method": {"kind": "functional_pca", "components": 3, "centre": true},
        "classifier": {"kind": "discriminant", "attribute": "labels.treatment", "repeats": 1}});
    let learn = server.request(Method::POST, "/v1/dictionaries").header("prefer", "wait=60").json(&learn);
    server.send(learn).expect(201);
    server
}

pub(crate) fn furnished_path(template: &str) -> String {
    let path = template.replace("{cohort}", "example-cells").replace("{dictionary}", "modes");
    path.replace("{name}", "bspline")
        .replace("{job}", "none")
        .replace("{hook}", "none")
        .replace("{alias}", "production")
}

/// A query that is read after the body, and a parameter of another generator than that of [`furnished_path`].
const ELSEWHERE: [&str; 4] = [
    "POST /v1/pca",
    "POST /v1/cohorts/{cohort}/shapes weight",
    "POST /v1/inspect weight",
    "GET /v1/generators/{name} support",
];

#[test]
fn the_bounds_of_parameters_are_those_of_the_service() {
    let (document, server, mut asked) = (served(), furnished(), 0);
    for (name, operation) in operations(&document) {
        let (method, path) = name.split_once(' ').unwrap();
        for parameter in
            entries(operation, "parameters").iter().filter(|parameter| parameter["in"] == "query")
        {
            let own = parameter["name"].as_str().unwrap();
            let whole = format!("{name} {own}");
            for (value, is_taken) in around(&parameter["schema"]) {
                if ELSEWHERE.iter().any(|start| whole.starts_with(start)) {
                    continue;
                }
                asked += 1;
                // Settings of drawings and of files belong to one format, those of uploads to a cohort.
                let format = match own {
                    "samples" if path == "/v1/inspect" => "&cohort=example-cells",
                    "width" => "&format=svg",
                    "points" => "&format=ndjson",
                    _ => "",
                };
                let path = format!("{}?{own}={value}{format}", furnished_path(path));
                let reply = server.send(server.request(method.parse().unwrap(), &path));
                let detail = if reply.status == 400 { reply.json()["detail"].clone() } else { json!("") };
                let mut faults = detail.as_str().unwrap().split("; ");
                let refused = faults.any(|fault| fault.starts_with(&format!("{own}: ")));
                assert_eq!(refused, !is_taken, "{whole}={value}: {}", reply.text());
            }
        }
    }
    assert!(asked >= 30, "{asked} values");
}

/// Fields whose bound depends on others, or that belong to other requests than the example. The first key closes the service.
const DEPENDENT: [&str; 14] = [
    "/v1/cohorts/{cohort}/correspond",
    "/v1/cohorts/{cohort}/search candidates",
    "/v1/cohorts/{cohort}/search elasticity",
    "/v1/cohorts/{cohort}/search points",
    "/v1/dictionaries/import format_version",
    "/v1/dictionaries/{dictionary}/correspond",
    "/v1/distances elasticity",
    "/v1/distances points",
    "/v1/fit turns",
    "/v1/keys",
    "/v1/models samples",
    "/v1/morph steps",
    "/v1/resample count",
    "/v1/subdivide",
];

#[test]
fn the_bounds_of_fields_are_those_of_the_service() {
    let (document, server, mut asked) = (served(), furnished(), 0);
    for (name, operation) in operations(&document) {
        let Some(body) = operation.pointer("/requestBody/content/application~1json") else { continue };
        let schema = resolve(&document, &body["schema"]);
        let example = body.get("example").unwrap_or(&schema["example"]).to_string();
        // The only cohort of the test.
        let example: Value = serde_json::from_str(&example.replace("hippocampi", "example-cells")).unwrap();
        let (method, path) = name.split_once(' ').unwrap();
        for (field, schema) in schema["properties"].as_object().into_iter().flatten() {
            let dependent = format!("{path} {field}");
            if DEPENDENT.iter().any(|start| dependent.starts_with(start)) {
                continue;
            }
            for (value, is_taken) in around(schema) {
                asked += 1;
                let mut body = example.clone();
                body[field] = value.clone();
                let request = server.request(method.parse().unwrap(), &furnished_path(path)).json(&body);
                let reply = server.send(request);
                let errors = if reply.status == 422 { reply.json()["errors"].clone() } else { json!([]) };
                let points =
                    |error: &Value| error["pointer"].as_str().unwrap().starts_with(&format!("/{field}"));
                let refused = errors.as_array().unwrap().iter().any(points);
                assert_eq!(refused, !is_taken, "{name} {field} = {value}: {}", reply.text());
            }
        }
    }
    assert!(asked >= 50, "{asked} values");
}
