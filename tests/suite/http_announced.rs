//! Every operation with the largest header: files, forms and documents that are short and announce the largest numbers, sent to a
//! process that ends when it takes too many addresses. All are refused, and it lives.

use std::collections::BTreeSet;

use reqwest::Method;
use serde_json::{Value, json};

use crate::announced::{announced, whole};
use crate::document::{furnish, furnished_path, served};
use crate::form::{form, label_picture, post_form, shell_volume};
use crate::guards::{operations, resolve};
use crate::http_segment::curves;
use crate::server::{Reply, Server, Setting, shared};

/// Addresses of the process. It takes half of them at rest: its program, and stacks and arenas of its threads.
const MEBIBYTES: u32 = 3 << 10;
const FILE: &str = "application/octet-stream";
const FORM: &str = "multipart/form-data";
/// The largest numbers of fields and parameters.
const LARGEST: [u64; 3] = [u64::MAX, i64::MAX as u64, u32::MAX as u64];

fn limited() -> Server {
    furnish(Setting::fresh().with_example().flags(&["--max-memory", "1000000000"]).address_space(MEBIBYTES))
}

/// Ids of the formats that the service reads, those of images alone in the second list.
fn formats(server: &Server) -> (Vec<String>, Vec<String>) {
    let listed = server.get("/v1/formats").expect(200);
    let read = |format: &&Value| format["read"].as_bool().unwrap();
    let ids = listed["items"].as_array().unwrap().iter().filter(read);
    let ids: Vec<String> = ids.map(|format| format["id"].as_str().unwrap().to_owned()).collect();
    let images: Vec<&str> = shapelex_formats::image::FORMATS.iter().map(|format| format.id).collect();
    let of_images = ids.iter().filter(|id| images.contains(&id.as_str())).cloned().collect();
    (ids, of_images)
}

/// Collects what is not refused as it should be.
#[derive(Default)]
struct Refusals {
    count: usize,
    wrong: Vec<String>,
}

impl Refusals {
    fn check(&mut self, what: &str, reply: &Reply, is_right: bool) {
        self.count += 1;
        if !is_right {
            let text: String = reply.text().chars().take(300).collect();
            self.wrong.push(format!("{what}: {} {text}", reply.status));
        }
    }

    fn end(self, server: &Server, fewest: usize) {
        server.assert_alive();
        assert!(self.wrong.is_empty(), "{} of {}:\n{}", self.wrong.len(), self.count, self.wrong.join("\n"));
        assert!(self.count >= fewest, "{} requests", self.count);
    }
}

fn is_refused(reply: &Reply) -> bool {
    (400..500).contains(&reply.status) && reply.header("content-type") == Some("application/problem+json")
}

/// Operations that take a file as their body, or in a form, with the media type.
fn takers(media_type: &str) -> Vec<(String, Value)> {
    let document = served();
    let pointer = format!("/requestBody/content/{}", media_type.replace('/', "~1"));
    let taken = operations(&document).into_iter().filter_map(|(name, operation)| {
        let body = operation.pointer(&pointer)?;
        Some((name, resolve(&document, &body["schema"]).clone()))
    });
    taken.collect()
}

/// The path by which a file of a format is sent to an operation. Requests about shapes know files by their bytes and names: their
/// parameter `format` is that of the answer.
fn path_of(operation: &str, format: &str) -> String {
    let ending = shapelex_formats::shape::find(format).map_or(format, |format| format.extensions[0]);
    let curve =
        r#"{"kind":"closed_curve","dimension":2,"control_points":8,"generator":{"name":"trigonometric"}}"#;
    match operation {
        "POST /v1/cohorts/{cohort}/shapes" => format!("/v1/cohorts/example-cells/shapes?format={format}"),
        "POST /v1/convert" => format!("/v1/convert?to=ndjson&format={format}"),
        "POST /v1/inspect" => format!("/v1/inspect?format={format}"),
        "POST /v1/measure" => format!("/v1/measure?representation={curve}&name=x.{ending}"),
        other => {
            let path = other.split_once(' ').unwrap().1.replace("{dictionary}", "modes");
            format!("{path}?name=x.{ending}")
        }
    }
}

/// Requests about shapes read their files by the same code: one of them is asked with all files.
fn is_alike(operation: &str) -> bool {
    let own = ["/shapes", "/convert", "/inspect", "/measure"];
    !own.iter().any(|end| operation.ends_with(end))
}

#[test]
fn files_that_announce_the_largest_numbers_are_refused_by_every_operation() {
    let server = limited();
    let (ids, _) = formats(&server);
    let takers = takers(FILE);
    let mut refusals = Refusals::default();
    for id in &ids {
        let files = announced(id).unwrap_or_else(|| panic!("files of {id} are missing in announced.rs"));
        assert!(!files.is_empty(), "{id}");
        for (operation, _) in &takers {
            let asked = if is_alike(operation) { 1 } else { files.len() };
            for (what, file) in &files[..asked] {
                let path = path_of(operation, id);
                let reply = server.post_bytes(&path, FILE, file.clone());
                refusals.check(&format!("{operation} {id}: {what}"), &reply, is_refused(&reply));
            }
        }
    }
    refusals.end(&server, 3 * ids.len());
}

/// What the files above say wrongly is what they announce: without it they are taken.
#[test]
fn the_same_files_are_read_where_they_announce_what_follows() {
    let server = shared();
    for (id, file) in whole() {
        // Images of one cell.
        let is_image = shapelex_formats::image::FORMATS.iter().any(|format| format.id == id);
        let least = if is_image { "&least_cells=1" } else { "" };
        let found = server.post_bytes(&format!("/v1/inspect?format={id}{least}"), FILE, file).expect(200);
        assert!(found["records"].as_u64() > Some(0), "{id}: {found}");
    }
}

/// Parameters of a form with which the service reads its part, and a good file of each other part that is needed.
fn parameters_of(operation: &str, part: &str, cohort: &Value) -> (Value, Vec<(&'static str, Vec<u8>)>) {
    let mut segment = curves(json!({"truth_labels": [3, 7]}));
    if part != "truth" {
        segment.as_object_mut().unwrap().remove("truth_labels");
    }
    if part == "mask" {
        segment.as_object_mut().unwrap().remove("boxes");
    }
    let image = if part == "image" { Vec::new() } else { vec![("image", label_picture())] };
    match operation {
        "POST /v1/segment" => (segment, image),
        "POST /v1/cohorts/{cohort}/segment" => {
            segment["representation"] = cohort["representation"].clone();
            (segment, image)
        }
        "POST /v1/contours" => (json!({}), image),
        "POST /v1/sheets" => {
            (json!({"sigma": 1}), if part == "image" { Vec::new() } else { vec![("image", shell_volume())] })
        }
        "POST /v1/convert" => (
            resolve(&served(), &json!({"$ref": "#/components/schemas/SeriesRequest"}))["example"].clone(),
            Vec::new(),
        ),
        other => panic!("{other} takes forms: parameters for it are missing here"),
    }
}

/// Names of the parts of a form that are files.
fn file_parts(schema: &Value) -> Vec<String> {
    let parts = schema["properties"].as_object().unwrap().iter();
    parts
        .filter(|(_, part)| part.to_string().contains("schemas/Binary"))
        .map(|(name, _)| name.clone())
        .collect()
}

#[test]
fn parts_that_announce_the_largest_numbers_are_refused_by_every_form() {
    let server = limited();
    let (all, images) = formats(&server);
    let cohort = server.get("/v1/cohorts/example-cells").expect(200);
    let mut refusals = Refusals::default();
    for (operation, schema) in takers(FORM) {
        for part in file_parts(&schema) {
            let (parameters, others) = parameters_of(&operation, &part, &cohort);
            let parameters = parameters.to_string();
            // A form with shapes takes all formats.
            for id in if part == "file" { &all } else { &images } {
                for (what, file) in announced(id).unwrap() {
                    let mut parts = vec![("parameters", "application/json", parameters.as_bytes())];
                    parts.extend(others.iter().map(|(name, file)| (*name, FILE, file.as_slice())));
                    parts.push((&part, FILE, &file));
                    let path = operation.split_once(' ').unwrap().1.replace("{cohort}", "example-cells");
                    let query =
                        if part == "file" { format!("?to=rtstruct&format={id}") } else { String::new() };
                    let reply = post_form(&server, &format!("{path}{query}"), form(&parts));
                    let is_right = is_refused(&reply) && points_at(&reply, &part);
                    refusals.check(&format!("{operation} {part} {id}: {what}"), &reply, is_right);
                }
            }
        }
    }
    refusals.end(&server, 8 * images.len());
}

/// Whether what is refused is a part of a form, or all that its file takes of memory.
fn points_at(reply: &Reply, part: &str) -> bool {
    let problem = reply.json();
    let mut pointers = problem["errors"]
        .as_array()
        .into_iter()
        .flatten()
        .map(|error| error["pointer"].as_str().unwrap_or_default());
    pointers.all(|pointer| {
        pointer.is_empty() || pointer.strip_prefix('/').is_some_and(|name| name.starts_with(part))
    })
}

/// Places of the numbers in a document.
fn places(value: &Value, pointer: &str, found: &mut Vec<String>) {
    match value {
        Value::Number(_) => found.push(pointer.to_owned()),
        Value::Array(items) => {
            items.iter().enumerate().for_each(|(i, item)| places(item, &format!("{pointer}/{i}"), found))
        }
        Value::Object(fields) => {
            fields.iter().for_each(|(key, item)| places(item, &format!("{pointer}/{key}"), found))
        }
        _ => {}
    }
}

/// A document with one number at another place.
fn with(document: &Value, pointer: &str, number: u64) -> Value {
    let mut document = document.clone();
    *document.pointer_mut(pointer).unwrap() = json!(number);
    document
}

/// What is made of a schema: `number` for each number; `turn` chooses one of several schemas and words, and whether what is not
/// required is there.
struct Largest<'d> {
    document: &'d Value,
    number: u64,
    turn: usize,
}

/// Deepest schema within a schema: some hold themselves.
const DEPTH: usize = 12;

impl Largest<'_> {
    fn of(&self, schema: &Value, depth: usize) -> Value {
        let schema = resolve(self.document, schema);
        let list = |key: &str| schema[key].as_array().filter(|list| !list.is_empty());
        let is = |name: &str| {
            schema["type"] == name || list("type").is_some_and(|types| types.contains(&json!(name)))
        };
        if depth > DEPTH {
            return Value::Null;
        }
        if let Some(choices) = list("oneOf").or(list("anyOf")) {
            let choices: Vec<&Value> = choices.iter().filter(|choice| choice["type"] != "null").collect();
            return self.of(choices[self.turn % choices.len()], depth + 1);
        }
        if let Some(words) = list("enum") {
            return words[self.turn % words.len()].clone();
        }
        if is("integer") || is("number") {
            return json!(self.number);
        }
        if is("array") {
            let count = schema["minItems"].as_u64().unwrap_or(1).clamp(1, 3);
            return (0..count).map(|_| self.of(&schema["items"], depth + 1)).collect();
        }
        if schema["properties"].is_object() {
            return self.fields(schema, depth);
        }
        if is("boolean") { json!(self.turn.is_multiple_of(4)) } else { json!("example-cells") }
    }

    fn fields(&self, schema: &Value, depth: usize) -> Value {
        let is_required =
            |name: &String| schema["required"].as_array().is_some_and(|names| names.contains(&json!(name)));
        let kept = schema["properties"].as_object().unwrap().iter();
        let kept = kept.filter(|(name, _)| self.turn % 2 == 1 || is_required(name));
        let of = |(name, field): (&String, &Value)| match name.as_str() {
            "connectivity" => (name.clone(), json!(format!("octahedron/{}", self.number))),
            _ => (name.clone(), self.of(field, depth + 1)),
        };
        Value::Object(kept.map(of).collect())
    }
}

/// Documents for an operation: its example with each of its numbers, or its representation, at the largest, and what its schema
/// describes.
fn documents(document: &Value, body: &Value) -> Vec<Value> {
    let schema = resolve(document, &body["schema"]);
    let example = body.get("example").unwrap_or(&schema["example"]);
    let mut numbers = Vec::new();
    places(example, "", &mut numbers);
    let representation = &document["components"]["schemas"]["Representation"];
    let mut all = Vec::new();
    for number in LARGEST {
        all.extend(numbers.iter().map(|place| with(example, place, number)));
        for turn in 0..6 {
            let largest = Largest { document, number, turn };
            all.push(largest.of(schema, 0));
            if example.get("representation").is_some() {
                let mut other = example.clone();
                other["representation"] = largest.of(representation, 0);
                all.push(other);
            }
        }
    }
    all
}

#[test]
fn documents_with_the_largest_numbers_do_not_end_the_process() {
    let (document, server) = (served(), limited());
    let mut answers = Refusals::default();
    let mut refused = BTreeSet::new();
    for (name, operation) in operations(&document) {
        let Some(body) = operation.pointer("/requestBody/content/application~1json") else { continue };
        // The first key closes the service.
        if name == "POST /v1/keys" {
            continue;
        }
        let (method, path) = name.split_once(' ').unwrap();
        for sent in documents(&document, body) {
            let request = server.request(method.parse().unwrap(), &furnished_path(path)).json(&sent);
            let reply = server.send(request);
            answers.check(&format!("{name} {sent}"), &reply, reply.status < 500);
            if is_refused(&reply) {
                refused.insert(name.clone());
            }
        }
    }
    assert!(refused.len() > 40, "refused by {refused:?} alone");
    answers.end(&server, 1000);
}

#[test]
fn parameters_with_the_largest_numbers_do_not_end_the_process() {
    let (document, server) = (served(), limited());
    let mut answers = Refusals::default();
    for (name, operation) in operations(&document) {
        let (method, path) = name.split_once(' ').unwrap();
        // Events do not end.
        let parameters = operation["parameters"].as_array().filter(|_| path != "/v1/events");
        for parameter in parameters.into_iter().flatten().filter(|parameter| parameter["in"] == "query") {
            if !parameter["schema"].to_string().contains("integer") {
                continue;
            }
            let most = parameter["schema"]["maximum"].as_u64();
            for number in LARGEST.into_iter().chain(most) {
                let own = parameter["name"].as_str().unwrap();
                // The largest picture takes a second and more of an unoptimised program: one operation draws it.
                let format = match (own, path) {
                    ("width", "/v1/generators/{name}") => "&format=png",
                    ("width", _) => "&format=svg",
                    _ => "",
                };
                let path = format!("{}?{own}={number}{format}", furnished_path(path));
                let mut request = server.request(method.parse::<Method>().unwrap(), &path);
                if let Some(body) = operation.pointer("/requestBody/content/application~1json") {
                    request = request.json(&resolve(&document, &body["schema"])["example"]);
                }
                let reply = server.send(request);
                answers.check(&format!("{name} {own}={number}"), &reply, reply.status < 500);
            }
        }
    }
    answers.end(&server, 150);
}
