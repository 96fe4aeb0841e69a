//! Files of other programs over HTTP: uploads, descriptions, translations, exports.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use reqwest::Method;
use serde_json::{Value, json};

use crate::form::{form, label_picture, post_form};
use crate::server::{Reply, Server, shared};

const LINES: &str = concat!(
    r#"{"points":[[0,0],[4,0],[4,1]],"external_id":"first","label":"a","labels":{"age":61}}"#,
    "\n\n",
    r#"{"points":[[0,0],[3,0],[4,2]],"external_id":"second","metadata":{"site":"zrh"}}"#,
    "\n",
);

fn cohort(server: &Server, name: &str, representation: &Value, correspondence: &str) -> String {
    let body = json!({"name": name, "representation": representation, "correspondence": correspondence});
    server.post("/v1/cohorts", &body).expect(201);
    format!("/v1/cohorts/{name}")
}

fn landmarks(points: usize) -> Value {
    json!({"kind": "landmarks", "dimension": 2, "points": points})
}

fn curves() -> Value {
    json!({"kind": "closed_curve", "dimension": 2, "control_points": 16, "generator": {"name": "cubic"}})
}

fn post(server: &Server, path: &str, body: impl Into<Vec<u8>>) -> Reply {
    server.post_bytes(path, "application/octet-stream", body)
}

fn count(server: &Server, cohort: &str) -> Value {
    server.get(cohort).expect(200)["shape_count"].clone()
}

#[test]
fn a_file_is_taken_by_its_name_its_format_or_its_media_type() {
    let server = Server::fresh();
    let path = cohort(&server, "c", &landmarks(3), "landmarks");
    let found = post(&server, &format!("{path}/shapes?name=a.ndjson"), LINES).expect(201);
    assert_eq!((&found["added"], &found["revision"]), (&json!(2), &json!(1)));
    let file = json!({"format": "ndjson", "records": 2, "properties": {}, "left_out": [], "warnings": []});
    assert_eq!(found["file"], file);
    assert_eq!(found["results"][1]["external_id"], "second");
    let shape = server.get(&format!("{path}/shapes/first")).expect(200);
    assert_eq!((&shape["label"], &shape["labels"]), (&json!("a"), &json!({"age": 61, "file": "a"})));
    assert_eq!(shape["control_points"], json!([[0.0, 0.0], [4.0, 0.0], [4.0, 1.0]]));
    let shape = server.get(&format!("{path}/shapes/second")).expect(200);
    assert_eq!(shape["metadata"], json!({"site": "zrh"}));
    // The same again adds nothing; with a prefix they are others.
    let again = post(&server, &format!("{path}/shapes?format=ndjson"), LINES).expect(201);
    assert_eq!((&again["added"], &again["unchanged"], &again["revision"]), (&json!(0), &json!(2), &json!(1)));
    let more = post(&server, &format!("{path}/shapes?format=ndjson&prefix=b-&return=ids"), LINES).expect(201);
    assert_eq!((&more["added"], more["ids"].as_array().unwrap().len()), (&json!(2), 2));
    server.get(&format!("{path}/shapes/b-first")).expect(200);
}

/// A program sends a media type of its own where it knows none of a file.
#[test]
fn a_name_tells_the_format_where_the_media_type_is_of_none() {
    let server = Server::fresh();
    let path = cohort(&server, "c", &landmarks(3), "landmarks");
    let shapes = format!("{path}/shapes");
    let points = r#"{"type":"Feature","id":"f","properties":{},"geometry":{"type":"MultiPoint","coordinates":[[0,0],[4,0],[4,1]]}}"#;
    for (media_type, added) in [("application/x-www-form-urlencoded", 1), ("text/x-nothing", 0)] {
        let found = server.post_bytes(&format!("{shapes}?name=x.geojson"), media_type, points).expect(201);
        assert_eq!((&found["file"]["format"], &found["added"]), (&json!("geojson"), &json!(added)));
        let found = server.post_bytes("/v1/inspect?name=x.geojson", media_type, points).expect(200);
        assert_eq!((&found["format"], &found["records"]), (&json!("geojson"), &json!(1)));
        server.post_bytes(&shapes, media_type, points).expect_problem(415, "unsupported-media-type", &[]);
    }
    // A name of no format does not tell it; the media type of a format is believed before the name; a form is not the file.
    let named = format!("{shapes}?name=x.unknown");
    let unknown = server.post_bytes(&named, "application/x-www-form-urlencoded", "\u{1}\u{2}");
    unknown.expect_problem(422, "invalid-input", &[""]);
    let lines = server.post_bytes("/v1/inspect?name=x.geojson", "application/x-ndjson", LINES).expect(200);
    assert_eq!(lines["format"], "ndjson");
    let form = server.post_bytes(&named, "multipart/form-data; boundary=x", "--x--\r\n");
    form.expect_problem(415, "unsupported-media-type", &[]);
}

#[test]
fn labels_of_an_image_are_shapes_with_their_holes_counted() {
    let server = Server::fresh();
    let path = cohort(&server, "cells", &curves(), "arc_length");
    let shapes = format!("{path}/shapes");
    let found = server.post_bytes(&shapes, "image/png", label_picture()).expect(201);
    let names: Vec<&str> =
        found["results"].as_array().unwrap().iter().filter_map(|r| r["external_id"].as_str()).collect();
    assert_eq!(names, ["3", "7", "7.1"]);
    assert_eq!(found["file"]["left_out"][0]["what"], "holes");
    assert_eq!(found["file"]["left_out"][0]["count"], 1);
    let kept =
        server.post_bytes(&format!("{shapes}?holes=keep&select=3&prefix=k"), "image/png", label_picture());
    let kept = kept.expect(201);
    assert_eq!((&kept["added"], &kept["results"][1]["external_id"]), (&json!(2), &json!("k3.hole1")));
    let hole = server.get(&format!("{shapes}/k3.hole1")).expect(200);
    assert_eq!((&hole["labels"]["hole"], &hole["metadata"]["ring"]["hole"]), (&json!(true), &json!(true)));
    let refused = server.post_bytes(&format!("{shapes}?holes=refuse"), "image/png", label_picture());
    let refused = refused.expect_problem(422, "invalid-input", &[""]);
    assert_eq!(refused["errors"][0]["place"], json!({"item": 0}));
}

#[test]
fn faults_name_their_place_and_nothing_is_stored() {
    let server = Server::fresh();
    let path = cohort(&server, "c", &landmarks(3), "landmarks");
    let shapes = format!("{path}/shapes?format=ndjson");
    // The second line is broken, or not a shape of the cohort.
    let broken = format!("{LINES}{{\"points\":[[0,0],[1]]}}\n");
    let problem = post(&server, &shapes, broken).expect_problem(422, "invalid-input", &[""]);
    assert_eq!(problem["errors"][0]["place"], json!({"line": 4}));
    assert!(problem["errors"][0]["detail"].as_str().unwrap().contains("expected 2 coordinates, got 1"));
    let short = format!("{LINES}{{\"points\":[[0,0],[1,1]]}}\n");
    let problem = post(&server, &shapes, short.clone()).expect_problem(422, "invalid-input", &["/points"]);
    assert_eq!(
        (&problem["errors"][0]["place"], &problem["errors"][0]["index"]),
        (&json!({"line": 4}), &json!(2))
    );
    assert_eq!(count(&server, &path), 0);
    let skipped = post(&server, &format!("{shapes}&on_error=skip"), short).expect(201);
    assert_eq!((&skipped["added"], &skipped["skipped"]), (&json!(2), &json!(1)));
    let missing = "{\"points\":[[0,0],null,[1,1]]}\n";
    post(&server, &shapes, missing).expect_problem(422, "invalid-input", &["/points/1"]);
    let space = "{\"points\":[[0,0,5],[1,0,5],[1,1,5]]}\n";
    let problem = post(&server, &shapes, space).expect_problem(422, "invalid-input", &["/points"]);
    assert!(problem["errors"][0]["detail"].as_str().unwrap().contains("plane=xy"), "{problem}");
    let flat = post(&server, &format!("{shapes}&plane=yz"), space).expect(201);
    let id = flat["results"][0]["id"].as_str().unwrap();
    let stored = server.get(&format!("{path}/shapes/{id}")).expect(200);
    assert_eq!(stored["control_points"], json!([[0.0, 5.0], [0.0, 5.0], [1.0, 5.0]]));
    // Another shape has the name.
    let other =
        "{\"points\":[[0,0],[9,0],[4,2]]}\n{\"points\":[[0,0],[9,0],[4,2]],\"external_id\":\"first\"}\n";
    let problem =
        post(&server, &shapes, other).expect_problem(409, "external-id-conflict", &["/external_id"]);
    assert_eq!(problem["errors"][0]["place"], json!({"line": 2}));
    assert_eq!(count(&server, &path), 3);
    post(&server, &shapes, "").expect_problem(422, "too-few-shapes", &[]);
}

#[test]
fn formats_and_options_that_do_not_exist_are_refused_before_the_file() {
    let server = Server::fresh();
    let path = cohort(&server, "c", &landmarks(3), "landmarks");
    let shapes = format!("{path}/shapes");
    let parameter = |reply: Reply| {
        let problem = reply.expect(400);
        assert_eq!(problem["code"], "invalid-query", "{problem}");
        problem["errors"][0]["parameter"].as_str().unwrap().to_owned()
    };
    assert_eq!(parameter(post(&server, &format!("{shapes}?format=word"), LINES)), "format");
    assert_eq!(parameter(post(&server, &format!("{shapes}?format=ndjson&closed=perhaps"), LINES)), "closed");
    assert_eq!(parameter(post(&server, &format!("{shapes}?format=ndjson&plane=zz"), LINES)), "plane");
    assert_eq!(parameter(post(&server, &format!("{shapes}?format=ndjson&samples=2"), LINES)), "samples");
    assert_eq!(parameter(post(&server, &format!("{shapes}?format=ndjson&format=ndjson"), LINES)), "format");
    assert_eq!(parameter(post(&server, &format!("{shapes}?colour=red"), LINES)), "colour");
    // Options of files say nothing of JSON.
    let json = server.request(Method::POST, &format!("{shapes}?plane=xy")).json(&json!({"shapes": []}));
    assert_eq!(parameter(server.send(json)), "plane");
    assert_eq!(parameter(post(&server, "/v1/convert?to=png", LINES)), "to");
    assert_eq!(parameter(server.get(&format!("{path}/export?points=1"))), "points");
    server.post_bytes(&shapes, "text/x-nothing", LINES).expect_problem(415, "unsupported-media-type", &[]);
    let unknown = post(&server, &shapes, "\u{1}\u{2}").expect_problem(422, "invalid-input", &[""]);
    assert!(unknown["detail"].as_str().unwrap().contains("got one that begins with 01 02"), "{unknown}");
    server.get("/v1/cohorts/nothing/export").expect_problem(404, "not-found", &[]);
    let accept = server.request(Method::GET, &format!("{path}/export")).header("accept", "text/x-nothing");
    server.send(accept).expect_problem(406, "not-acceptable", &[]);
}

#[test]
fn the_formats_are_listed_as_they_are_taken() {
    let server = shared();
    let found = server.get("/v1/formats").expect(200);
    let items = found["items"].as_array().unwrap();
    let one = |id: &str| items.iter().find(|item| item["id"] == id).unwrap();
    assert_eq!(
        *one("geojson"),
        json!({
            "id": "geojson", "name": "GeoJSON", "read": true, "written": true, "kinds": ["curve", "landmarks"],
            "media_types": ["application/geo+json", "application/geo+json-seq"],
            "extensions": ["geojson", "geojsonl", "geojsons"], "options": ["holes", "names", "nuclei", "select", "attributes"],
        })
    );
    assert_eq!((&one("gltf")["read"], &one("gltf")["written"]), (&json!(false), &json!(true)));
    assert_eq!((&one("png")["written"], &one("png")["kinds"]), (&json!(false), &json!(["curve", "mesh"])));
    // Every format that is read is a value of `format`, and every other one is not.
    for item in items {
        let id = item["id"].as_str().unwrap();
        let reply = post(&server, &format!("/v1/inspect?format={id}"), "");
        assert_eq!(reply.status == 400, item["read"] == false, "{id}: {}", reply.text());
    }
}

#[test]
fn an_inspection_counts_what_an_upload_would_take() {
    let server = shared();
    let found = post(&server, "/v1/inspect?name=a.jsonl", LINES).expect(200);
    let group = &found["groups"][0];
    assert_eq!(
        (&group["kind"], &group["records"], &group["points"]),
        (&json!("landmarks"), &json!(2), &json!([3, 3]))
    );
    assert_eq!((&group["lower"], &group["upper"]), (&json!([0.0, 0.0]), &json!([4.0, 2.0])));
    assert_eq!((&found["labels"], &found["attributes"]), (&json!({"a": 1}), &json!({"age": 1})));
    let image = post(&server, "/v1/inspect", label_picture()).expect(200);
    assert_eq!((&image["format"], &image["records"]), (&json!("png"), &json!(3)));
    assert_eq!(image["properties"]["size"], json!([40, 24, 1]));
}

#[test]
fn a_translation_is_the_same_shapes() {
    let server = shared();
    let lines = post(&server, "/v1/convert?to=ndjson", label_picture());
    assert_eq!((lines.status, lines.header("content-type")), (200, Some("application/x-ndjson")));
    let shapes: Vec<Value> = lines.text().lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(shapes.len(), 3);
    assert_eq!((&shapes[0]["external_id"], &shapes[0]["closed"]), (&json!("3"), &json!(true)));
    let again = post(&server, "/v1/convert?to=ndjson&format=ndjson", lines.text());
    assert_eq!(again.text(), lines.text());
    post(&server, "/v1/convert?to=ndjson&format=ndjson", "{").expect_problem(422, "invalid-input", &[""]);
    // More than is kept before the answer begins.
    let many = LINES.repeat(20_000);
    let long = post(&server, "/v1/convert?to=ndjson&format=ndjson", many);
    assert_eq!((long.status, long.text().lines().count()), (200, 40_000));
}

/// A triangle in space with a colour and a thickness at its vertices.
const COLOURED: &str = "ply\nformat ascii 1.0\nelement vertex 3\nproperty double x\nproperty double y\nproperty double z\nproperty double thickness\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0 1.5\n4 0 0 2.5\n4 1 0 3.5\n3 0 1 2\n";

/// A region that is called heart.
const FEATURE: &str = r#"{"type":"Feature","properties":{"name":"heart"},"geometry":{"type":"Polygon","coordinates":[[[0,0],[4,0],[4,1],[0,0]]]}}"#;

/// What an answer says of what is left out: what, how many, and their names.
fn left_out(answer: &Value) -> Vec<(String, u64, Value)> {
    let list = answer["left_out"].as_array().unwrap().iter();
    list.map(|left| {
        (left["what"].as_str().unwrap().to_owned(), left["count"].as_u64().unwrap(), left["names"].clone())
    })
    .collect()
}

#[test]
fn what_is_not_stored_of_a_mesh_is_counted() {
    let server = Server::fresh();
    let path = cohort(&server, "c", &landmarks(3), "landmarks");
    let fields = ("fields of meshes".to_owned(), 1, json!(["thickness"]));
    let found = post(&server, "/v1/inspect?name=a.ply", COLOURED).expect(200);
    assert_eq!(left_out(&found), std::slice::from_ref(&fields));
    let stored = post(&server, &format!("{path}/shapes?name=a.ply&plane=xy&prefix=a"), COLOURED).expect(201);
    let faces = ("faces of meshes whose vertices become landmarks".to_owned(), 1, json!([]));
    assert_eq!(left_out(&stored["file"]), [fields, faces]);
}

#[test]
fn a_file_without_shapes_says_what_it_holds_instead() {
    let server = Server::fresh();
    let path = cohort(&server, "c", &landmarks(3), "landmarks");
    let empty = r#"{"type":"Feature","geometry":null,"properties":{"name":"a"}}"#;
    let problem = post(&server, &format!("{path}/shapes?name=a.geojson"), empty);
    let problem = problem.expect_problem(422, "invalid-input", &[""]);
    assert_eq!(
        problem["errors"][0]["detail"],
        "expected at least one shape, got none: 1 features without geometry"
    );
}

#[test]
fn features_of_one_name_may_be_named_by_their_ids() {
    let server = Server::fresh();
    let path = cohort(&server, "c", &landmarks(3), "landmarks");
    let cell = |id: &str, x: u32| {
        format!(
            r#"{{"type":"Feature","id":"{id}","properties":{{"name":"Cell"}},"geometry":{{"type":"Polygon","coordinates":[[[0,0],[{x},0],[0,3],[0,0]]]}}}}"#
        )
    };
    let file = format!("[{},{}]", cell("1-a", 4), cell("1-b", 5));
    post(&server, &format!("{path}/shapes?name=a.geojson&names=id"), file).expect(201);
    let stored = server.get(&format!("{path}/shapes/a/1-b")).expect(200);
    assert_eq!(stored["metadata"]["name"], "Cell");
}

/// Images of a series 5 mm apart.
fn series(count: usize) -> Value {
    let image = |k: usize| {
        json!({
            "class": "1.2.840.10008.5.1.4.1.1.2", "instance": format!("1.2.3.{k}"), "series": "1.2.6",
            "frame_of_reference": "1.2.4", "position": [-100.0, -100.0, 5.0 * k as f64],
            "orientation": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0], "study": {"instance": "1.2.5"},
        })
    };
    (0..count).map(image).collect::<Vec<_>>().into()
}

#[test]
fn a_structure_set_refers_to_the_series_of_the_form() {
    let server = shared();
    let lines = concat!(
        r#"{"points":[[1.5,2.0,5.0],[9.0,2.0,5.0],[9.0,7.25,5.0]],"closed":true,"external_id":"Heart 1","label":"Heart"}"#,
        "\n",
        r#"{"points":[[1.0,2.0,10.0],[8.0,2.0,10.0],[8.0,7.0,10.0]],"closed":true,"external_id":"Heart 2","label":"Heart"}"#,
        "\n",
    );
    let send = |query: &str, parameters: &Value| {
        let parameters = parameters.to_string();
        let parts: [(&str, &str, &[u8]); 2] = [
            ("parameters", "application/json", parameters.as_bytes()),
            ("file", "application/x-ndjson", lines.as_bytes()),
        ];
        post_form(&server, &format!("/v1/convert?{query}"), form(&parts))
    };
    let file =
        send("to=rtstruct&format=ndjson&write_created=2026-11-26T03:00:00", &json!({"series": series(3)}));
    assert_eq!(
        (file.status, file.header("content-type")),
        (200, Some("application/dicom")),
        "{}",
        file.text()
    );
    let back = post(&server, "/v1/convert?to=ndjson", file.body.clone());
    let shapes: Vec<Value> = back.text().lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let wanted: Vec<Value> = lines.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    for (shape, wanted) in shapes.iter().zip(&wanted) {
        assert_eq!((&shape["points"], &shape["label"]), (&wanted["points"], &wanted["label"]));
        assert_eq!(shape["metadata"]["frame_of_reference"], "1.2.4");
    }
    assert_eq!(shapes.len(), 2);
    // It refers to the images in whose planes its contours lie.
    let holds = |text: &str| file.body.windows(text.len()).any(|bytes| bytes == text.as_bytes());
    assert!(holds("1.2.3.1") && holds("1.2.3.2"));

    send("to=obj&format=ndjson", &json!({"series": series(1)})).expect_problem(400, "invalid-query", &[]);
    let mut other = series(2);
    other[1]["frame_of_reference"] = json!("1.2.40");
    let rtstruct = "to=rtstruct&format=ndjson";
    send(rtstruct, &json!({"series": other})).expect_problem(422, "invalid-input", &["/series"]);
    send(rtstruct, &json!({"series": []})).expect_problem(422, "invalid-input", &["/series"]);
    send(rtstruct, &json!({})).expect_problem(422, "invalid-input", &["/series"]);
    other[1]["position"] = json!([0, "x", 0]);
    send(rtstruct, &json!({"series": other})).expect_problem(422, "invalid-input", &["/series/1/position/1"]);
    // Without a form there is no series.
    let plain = post(&server, "/v1/convert?to=rtstruct&format=ndjson", lines);
    let no_place = |reply: Reply, parameter: &str| {
        let problem = reply.expect_problem(400, "invalid-query", &[]);
        assert!(problem.to_string().contains("POST /v1/convert writes it from a form"), "{problem}");
        assert_eq!(problem["errors"][0]["parameter"], parameter, "{problem}");
    };
    no_place(plain, "to");
    let path = cohort(&server, "c", &landmarks(3), "landmarks");
    for what in ["export", "shapes"] {
        no_place(server.get(&format!("{path}/{what}?format=rtstruct")), "format");
    }
}

/// A name that selects nothing is misspelt: an empty answer would hide it.
#[test]
fn a_translation_without_a_shape_is_refused_as_an_upload_is() {
    let server = Server::fresh();
    let path = cohort(&server, "c", &landmarks(3), "landmarks");
    for body in ["{\"type\":\"FeatureCollection\",\"features\":[]}", FEATURE] {
        let [upload, translation] = [format!("{path}/shapes"), "/v1/convert".to_owned()]
            .map(|path| post(&server, &format!("{path}?format=geojson&select=Hart"), body).expect(422));
        assert_eq!(translation["code"], upload["code"], "{translation}");
        assert_eq!(translation["errors"], upload["errors"], "{translation}");
    }
    let found = post(&server, "/v1/convert?format=geojson&select=heart", FEATURE);
    assert_eq!((found.status, found.text().lines().count()), (200, 1));
}

#[test]
fn a_cohort_goes_out_and_comes_back() {
    let server = Server::fresh();
    let path = cohort(&server, "c", &landmarks(3), "landmarks");
    post(&server, &format!("{path}/shapes?format=ndjson"), LINES).expect(201);
    let file = server.get(&format!("{path}/export?format=ndjson"));
    assert_eq!((file.status, file.header("content-type")), (200, Some("application/x-ndjson")));
    assert_eq!(file.header("content-disposition"), Some("attachment; filename=\"c.ndjson\""));
    let other = cohort(&server, "d", &landmarks(3), "landmarks");
    post(&server, &format!("{other}/shapes?format=ndjson"), file.text()).expect(201);
    for name in ["first", "second"] {
        let [a, b] = [&path, &other].map(|path| server.get(&format!("{path}/shapes/{name}")).expect(200));
        for field in ["label", "labels", "metadata", "control_points", "weight"] {
            assert_eq!(a[field], b[field], "{name} {field}");
        }
    }
    let some = server.get(&format!("{path}/export?label=a"));
    assert_eq!(some.text().lines().count(), 1);
    // Curves go out as points, or as control points.
    let path = cohort(&server, "cells", &curves(), "arc_length");
    server.post_bytes(&format!("{path}/shapes"), "image/png", label_picture()).expect(201);
    for (query, points, closed) in [
        ("", 128, json!(true)),
        ("?points=40", 40, json!(true)),
        ("?content=control_points", 16, Value::Null),
    ] {
        let line = server.get(&format!("{path}/export{query}"));
        let shape: Value = serde_json::from_str(line.text().lines().next().unwrap()).unwrap();
        assert_eq!(
            (shape["points"].as_array().unwrap().len(), &shape["closed"]),
            (points, &closed),
            "{query}"
        );
    }
}

#[test]
fn a_list_of_shapes_is_a_file_where_one_is_asked_for() {
    let server = Server::fresh();
    let path = cohort(&server, "c", &landmarks(3), "landmarks");
    let third = r#"{"points":[[0,0],[5,0],[4,2]],"external_id":"third","label":"a"}"#;
    post(&server, &format!("{path}/shapes?format=ndjson"), format!("{LINES}{third}\n")).expect(201);
    let list = |query: &str, accept: &str| {
        let request = server.request(Method::GET, &format!("{path}/shapes{query}"));
        server.send(if accept.is_empty() { request } else { request.header("accept", accept) })
    };
    // JSON is the default, as `Accept` of programs and browsers leaves it.
    for accept in
        ["", "*/*", "application/*", "application/json", "text/html, */*;q=0.1", "text/csv;q=0.5, */*"]
    {
        let page = list("", accept);
        assert_eq!((page.status, page.header("content-type")), (200, Some("application/json")), "{accept}");
    }
    assert_eq!(list("?format=json", "text/csv").header("content-type"), Some("application/json"));
    for (id, media_type) in [
        ("ndjson", "application/x-ndjson"),
        ("csv", "text/csv"),
        ("arrow", "application/vnd.apache.arrow.stream"),
        ("parquet", "application/vnd.apache.parquet"),
        ("npy", "application/x-npy"),
        ("tps", "application/x-tps"),
    ] {
        let [named, accepted, exported] = [
            list(&format!("?format={id}"), ""),
            list("", &format!("{media_type}, application/json;q=0.5")),
            server.get(&format!("{path}/export?format={id}")),
        ];
        assert_eq!((named.status, named.header("content-type")), (200, Some(media_type)), "{id}");
        assert_eq!(named.body, accepted.body, "{id}");
        assert_eq!(named.body, exported.body, "the same file of all shapes: {id}");
        assert_ne!(named.header("etag"), list("", "").header("etag"), "{id}");
        assert!(named.header("link").is_none(), "{id}");
    }
    // Pages, in an order, until the last one: their shapes come back.
    let other = cohort(&server, "d", &landmarks(3), "landmarks");
    let mut next = Some(format!("{path}/shapes?format=ndjson&limit=1&order=-external_id"));
    let mut names = Vec::new();
    while let Some(at) = next {
        let page = server.get(&at);
        assert_eq!(page.header("cache-control"), Some("no-store"), "{at}");
        let shape: Value = serde_json::from_str(page.text()).unwrap();
        names.push(shape["external_id"].as_str().unwrap().to_owned());
        post(&server, &format!("{other}/shapes?format=ndjson"), page.text()).expect(201);
        let link = page.header("link").map(str::to_owned);
        next = link.map(|link| link[1..link.find('>').unwrap()].to_owned());
    }
    assert_eq!(names, ["third", "second", "first"]);
    for name in names {
        let [a, b] = [&path, &other].map(|path| server.get(&format!("{path}/shapes/{name}")).expect(200));
        for field in ["label", "labels", "metadata", "control_points", "weight"] {
            assert_eq!(a[field], b[field], "{name} {field}");
        }
    }
    assert_eq!(list("?format=ndjson&label=a", "").text().lines().count(), 2);
    let tag = list("", "text/csv").header("etag").unwrap().to_owned();
    let known = server.request(Method::GET, &format!("{path}/shapes")).header("accept", "text/csv");
    assert_eq!(server.send(known.header("if-none-match", tag)).status, 304);

    let refused = |query: &str, wanted: &str| {
        let problem = list(query, "").expect_problem(400, "invalid-query", &[]);
        assert_eq!(problem["errors"][0]["parameter"], wanted, "{problem}");
    };
    refused("?format=csv&fields=id", "fields");
    refused("?format=csv&total=true", "total");
    refused("?points=40", "points");
    refused("?content=points", "content");
    refused("?write_unit=mm", "write_unit");
    refused("?format=png", "format");
    refused("?format=csv&content=fourier", "content");
    refused("?format=csv&cursor=x", "cursor");
    let problem = list("", "image/png").expect_problem(406, "not-acceptable", &[]);
    assert!(problem["detail"].as_str().unwrap().contains("among application/json, "), "{problem}");
}

#[test]
fn closed_curves_go_out_as_fourier_coefficients() {
    let server = Server::fresh();
    let ellipses = json!({"kind": "closed_curve", "dimension": 2, "control_points": 9, "generator": {"name": "trigonometric"}});
    let path = cohort(&server, "ellipses", &ellipses, "arc_length");
    let file = "#CONST 0 0 0 0\n#HARMO 1\na\n  2e0  0e0  0e0  1.5e0\nb\n  3e0  1e0  -5e-1  1e0\n";
    let media_type = "application/x-nef";
    server.post_bytes(&format!("{path}/shapes"), media_type, file.as_bytes().to_vec()).expect(201);
    let export = |query: &str| server.get(&format!("{path}/export?content=fourier&{query}"));
    // What came in goes out again, but for rounding.
    let out = export("format=nef&write_harmonics=1");
    assert_eq!((out.status, out.header("content-type")), (200, Some(media_type)));
    let numbers =
        |text: &str| -> Vec<f64> { text.split_whitespace().filter_map(|word| word.parse().ok()).collect() };
    let (sent, back) = (numbers(file), numbers(out.text()));
    assert_eq!(sent.len(), back.len(), "{}", out.text());
    assert!(sent.iter().zip(&back).all(|(a, b)| (a - b).abs() < 1e-14), "{}", out.text());
    // They are all that this format holds.
    for query in ["export?format=nef&write_harmonics=1", "shapes?format=nef&write_harmonics=1"] {
        assert_eq!(server.get(&format!("{path}/{query}")).text(), out.text(), "{query}");
    }
    // As many harmonics as nine control points tell apart, and what they leave.
    let lines = export("");
    let shape: Value = serde_json::from_str(lines.text().lines().next().unwrap()).unwrap();
    let fourier = &shape["fourier"];
    assert_eq!((fourier["cosine"].as_array().unwrap().len(), &shape["external_id"]), (4, &json!("a")));
    assert_eq!(shape["metadata"]["fourier"]["harmonics"], 4);
    assert!(shape["metadata"]["fourier"]["residual_power"].as_f64().unwrap() < 1e-28, "{shape}");
    // They come back as the same curve.
    let other = cohort(&server, "others", &ellipses, "arc_length");
    let two = export("write_harmonics=1");
    post(&server, &format!("{other}/shapes?format=ndjson"), two.text()).expect(201);
    let [a, b] = [&path, &other].map(|path| server.get(&format!("{path}/shapes/a")).expect(200));
    let points = |shape: &Value| -> Vec<f64> {
        let rows = shape["control_points"].as_array().unwrap();
        rows.iter().flat_map(|row| row.as_array().unwrap().iter().map(|x| x.as_f64().unwrap())).collect()
    };
    assert!(points(&a).iter().zip(points(&b)).all(|(a, b)| (a - b).abs() < 1e-13), "{a} {b}");

    let parameter = |response: Reply, wanted: &str| {
        let problem = response.expect_problem(400, "invalid-query", &[]);
        assert_eq!(problem["errors"][0]["parameter"], wanted, "{problem}");
    };
    parameter(export("write_harmonics=0"), "write_harmonics");
    parameter(export("write_harmonics=1025"), "write_harmonics");
    let huge = "/v1/convert?to=nef&format=nef&write_harmonics=1000000000000";
    parameter(post(&server, huge, file), "write_harmonics");
    let points = cohort(&server, "points", &landmarks(3), "landmarks");
    parameter(server.get(&format!("{points}/export?content=fourier")), "content");
    let refused = export("format=csv").expect_problem(422, "invalid-input", &[""]);
    assert!(refused["detail"].as_str().unwrap().contains("got Fourier coefficients"), "{refused}");
}

#[test]
fn a_file_that_is_sent_again_is_stored_once() {
    let server = Server::fresh();
    let path = cohort(&server, "c", &landmarks(3), "landmarks");
    let send = |body: &'static str| {
        let request = server.request(Method::POST, &format!("{path}/shapes?format=ndjson"));
        let request =
            request.header("idempotency-key", "one").header("content-type", "application/octet-stream");
        server.send(request.body(body))
    };
    let unnamed = "{\"points\":[[0,0],[4,0],[4,1]]}\n";
    let first = send(unnamed);
    assert_eq!((first.expect(201), first.header("idempotency-replayed")), (first.json(), None));
    let second = send(unnamed);
    assert_eq!(second.expect(201), first.json());
    // The second is the former name.
    for name in ["idempotency-replayed", "idempotent-replayed"] {
        assert_eq!((first.header(name), second.header(name)), (None, Some("true")), "{name}");
    }
    assert_eq!(count(&server, &path), 1);
    send(LINES).expect_problem(422, "idempotency-key-reused", &[]);
}

#[test]
fn a_body_that_breaks_off_or_trickles_stores_nothing() {
    let server = Server::fresh();
    let path = cohort(&server, "c", &landmarks(3), "landmarks");
    let address = server.address().strip_prefix("http://").unwrap().to_owned();
    let head = format!(
        "POST {path}/shapes?format=ndjson HTTP/1.1\r\nhost: {address}\r\ncontent-type: application/octet-stream\r\n\
         content-length: 100000\r\n\r\n"
    );
    let connect = || {
        let mut stream = TcpStream::connect(&address).unwrap();
        stream.write_all(head.as_bytes()).unwrap();
        stream.write_all(LINES.as_bytes()).unwrap();
        stream
    };
    drop(connect());
    let (begun, mut stream) = (Instant::now(), connect());
    stream.set_read_timeout(Some(Duration::from_secs(1))).unwrap();
    let mut answer = Vec::new();
    while !answer.starts_with(b"HTTP/1.1 408") {
        assert!(begun.elapsed() < Duration::from_secs(90), "{}", String::from_utf8_lossy(&answer));
        // A byte a second is too slow.
        let _ = stream.write_all(b"\n");
        let mut block = [0; 4096];
        match stream.read(&mut block) {
            Ok(count) => answer.extend_from_slice(&block[..count]),
            Err(error) => assert!(
                matches!(error.kind(), std::io::ErrorKind::WouldBlock | std::io::ErrorKind::TimedOut),
                "{error}"
            ),
        }
    }
    assert!(begun.elapsed() >= Duration::from_secs(25), "{:?}", begun.elapsed());
    assert_eq!(count(&server, &path), 0);
}
