//! Label images over HTTP: what is recognised, left out, filled and counted on every route; attributes of cells; bytes that browsers and
//! instruments send.

use std::io::Write;

use serde_json::{Value, json};
use shapelex_formats::image::write::{nifti_u8, png_u8};
use shapelex_formats::image::{Grid, LengthUnit};

use crate::form::{label_picture, post_image};
use crate::server::{Reply, Server, shared};

fn picture(size: [usize; 2], value: impl Fn(usize, usize) -> u8) -> Vec<u8> {
    let grid = Grid::along_axes([size[0], size[1], 1], [1.0; 3], [LengthUnit::Unknown; 3]).unwrap();
    let values: Vec<u8> = (0..grid.cells()).map(|at| value(at % size[0], at / size[0])).collect();
    png_u8(&grid, &values).unwrap()
}

/// Noise of 200 grey values around a bright disc.
fn photograph() -> Vec<u8> {
    picture([60, 50], |x, y| {
        let noise = (x * 7919 + y * 104_729 + x * y * 31) % 97;
        let bright = (x as i64 - 30).pow(2) + (y as i64 - 25).pow(2) < 200;
        (noise + if bright { 120 } else { 20 }) as u8
    })
}

fn cohort(server: &Server, name: &str, representation: &Value, correspondence: &str) -> String {
    let body = json!({"name": name, "representation": representation, "correspondence": correspondence});
    server.post("/v1/cohorts", &body).expect(201);
    format!("/v1/cohorts/{name}/shapes")
}

fn curves() -> Value {
    json!({"kind": "closed_curve", "dimension": 2, "control_points": 12, "generator": {"name": "cubic"}})
}

fn landmarks(points: usize, dimension: usize) -> Value {
    json!({"kind": "landmarks", "dimension": dimension, "points": points})
}

fn names(answer: &Value) -> Vec<&str> {
    let results = answer["results"].as_array().unwrap();
    results.iter().filter_map(|result| result["external_id"].as_str()).collect()
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

/// A grey picture makes thousands of crumbs where an outline is expected: no route takes it without being told.
#[test]
fn a_photograph_is_refused_with_a_way_out() {
    let server = Server::fresh();
    let shapes = cohort(&server, "cells", &curves(), "arc_length");
    let refused = |reply: Reply, pointer: &str, way_out: bool| {
        let problem = reply.expect_problem(422, "invalid-input", &[pointer]);
        let detail = problem["errors"][0]["detail"].as_str().unwrap();
        assert!(detail.starts_with("expected a label image"), "{detail}");
        assert_eq!(detail.contains("photograph=read") && detail.contains("/v1/segment"), way_out, "{detail}");
    };
    let post = |path: &str| server.post_bytes(path, "image/png", photograph());
    refused(post(&shapes), "", true);
    refused(post("/v1/inspect"), "", true);
    refused(post("/v1/convert?to=ndjson"), "", true);
    let contours = |parameters: Value| post_image(&server, "/v1/contours", &parameters, &photograph());
    refused(contours(json!({})), "/image", true);
    let read = post("/v1/inspect?photograph=read&least_cells=1").expect(200);
    assert!(read["records"].as_u64().unwrap() > 1000, "{read}");
    let read = contours(json!({"photograph": "read"})).expect(200);
    assert!(read["results"].as_array().unwrap().len() > 1000);
    assert_eq!(server.get("/v1/cohorts/cells").expect(200)["shape_count"], 0);
    // One grey value is no photograph.
    contours(json!({"labels": [20]})).expect(200);
}

#[test]
fn specks_are_counted_and_objects_cut_by_the_edge_too() {
    let server = Server::fresh();
    let shapes = cohort(&server, "cells", &curves(), "arc_length");
    // Two objects of label 1, the second one cut by the edge, and specks of 4 and 1 cells.
    let image = picture([30, 20], |x, y| match (x, y) {
        (2..=9, 2..=9) | (20..=29, 5..=12) | (12..=13, 15..=16) => 1,
        (25, 17) => 2,
        _ => 0,
    });
    let post = |query: &str| server.post_bytes(&format!("{shapes}?{query}"), "image/png", image.clone());
    let found = post("").expect(201);
    // The largest one has the name of the label.
    assert_eq!(names(&found), ["1.1", "1"]);
    let file = &found["file"];
    assert_eq!(file["left_out"][0]["what"], "components of fewer than 5 cells");
    assert_eq!((&file["left_out"][0]["count"], &file["properties"]["cut_by_edge"]), (&json!(2), &json!(1)));
    let largest = post("largest=true&prefix=a").expect(201);
    assert_eq!((names(&largest), &largest["file"]["left_out"][0]["count"]), (vec!["a1"], &json!(3)));
    let all = post("least_cells=1&prefix=b").expect(201);
    assert_eq!((all["added"].as_u64(), &all["file"]["left_out"]), (Some(4), &json!([])));
    for (query, parameter) in
        [("blur=-1", "blur"), ("largest=perhaps", "largest"), ("least_cells=-1", "least_cells")]
    {
        let problem = post(query).expect(400);
        assert_eq!(problem["errors"][0]["parameter"], parameter, "{problem}");
    }
    let smooth = post("blur=1&prefix=c").expect(201);
    assert_eq!(smooth["added"], 2);
    // The route that stores nothing keeps what it is asked for.
    let contours = |parameters: Value| post_image(&server, "/v1/contours", &parameters, &image).expect(200);
    let found = contours(json!({}));
    assert_eq!((found["results"].as_array().unwrap().len(), &found["cut_by_edge"]), (4, &json!(1)));
    let largest = contours(json!({"largest": true, "least_cells": 5}));
    assert_eq!(largest["results"].as_array().unwrap().len(), 1);
    assert_eq!(
        (&largest["left_out"], &largest["warnings"]),
        (&json!({"components": 3, "cells": 69}), &json!([]))
    );
}

/// A ring of an organ cannot be a sphere; the refusal names the option that makes it one.
#[test]
fn handles_of_a_volume_are_filled_on_demand() {
    let server = Server::fresh();
    let spheres = json!({"kind": "surface", "topology": "sphere", "control_points": [6, 5],
        "generators": [{"name": "trigonometric"}, {"name": "trigonometric"}]});
    let shapes = cohort(&server, "organs", &spheres, "landmarks");
    let size = [14, 12, 9];
    let ring = |at: usize| {
        let (x, y, z) = (at % 14, at / 14 % 12, at / 168);
        let inside = (2..12).contains(&x) && (2..10).contains(&y) && (2..7).contains(&z);
        u8::from(inside && !((6..8).contains(&x) && (5..7).contains(&y)))
    };
    let grid = Grid::along_axes(size, [1.0, 1.0, 1.5], [LengthUnit::Millimetre; 3]).unwrap();
    let values: Vec<u8> = (0..grid.cells()).map(ring).collect();
    let file = nifti_u8(&grid, &values).unwrap();
    let post =
        |query: &str| server.post_bytes(&format!("{shapes}?{query}"), "application/x-nifti", file.clone());
    let problem = post("").expect(422);
    let detail = problem["errors"][0]["detail"].as_str().unwrap();
    assert!(detail.contains("got one with 1 handles") && detail.contains("option fill"), "{detail}");
    let found = post("fill=true").expect(201);
    assert_eq!((&found["added"], names(&found)), (&json!(1), vec!["1"]));
    assert_eq!(found["file"]["warnings"][0], "1 components had handles, which are filled");
    let solid = |fill: bool| {
        let found = post_image(&server, "/v1/contours", &json!({"fill": fill}), &file).expect(200);
        (found["results"][0]["genus"].clone(), found["results"][0]["cells"].clone())
    };
    assert_eq!((solid(false), solid(true)), ((json!(1), json!(380)), (json!(0), json!(380))));
}

/// The numbers that programs of microscopy measure of a cell are more than a hundred.
#[test]
fn cells_keep_hundreds_of_measurements_or_those_that_are_asked_for() {
    let server = Server::fresh();
    let shapes = cohort(&server, "cells", &curves(), "arc_length");
    let cell = |count: usize| {
        let measurements: serde_json::Map<String, Value> = (0..count)
            .map(|k| (format!("{}: {k}", if k < 10 { "Nucleus" } else { "Cell" }), json!(k)))
            .collect();
        json!({"type": "Feature", "id": format!("cell-{count}"), "geometry": {"type": "Polygon", "coordinates":
            [[[0, 0], [9, 0], [9, 4], [0, 5], [0, 0]]]},
            "properties": {"objectType": "detection", "measurements": measurements}})
        .to_string()
    };
    let post = |query: &str, count| {
        server.post_bytes(&format!("{shapes}?{query}"), "application/geo+json", cell(count))
    };
    post("", 126).expect(201);
    let stored = server.get(&format!("{shapes}/cell-126")).expect(200);
    assert_eq!(stored["labels"].as_object().unwrap().len(), 126);
    let problem = post("", 1001).expect_problem(422, "invalid-input", &["/labels"]);
    let detail = problem["errors"][0]["detail"].as_str().unwrap();
    assert!(detail.starts_with("expected at most 1000 entries, got 1001: the option attributes"), "{detail}");
    let found = post("attributes=nucleus*", 1001).expect(201);
    let left_out = &found["file"]["left_out"][0];
    assert_eq!(
        (&left_out["what"], &left_out["count"]),
        (&json!("attributes that are not selected"), &json!(991))
    );
    let stored = server.get(&format!("{shapes}/cell-1001")).expect(200);
    assert_eq!(stored["labels"].as_object().unwrap().len(), 10);
    let inspected =
        server.post_bytes("/v1/inspect?attributes=none", "application/geo+json", cell(5)).expect(200);
    assert_eq!(inspected["attributes"], json!({}));
    server.post_bytes("/v1/inspect?attributes=a", "application/x-tps", "LM=1\n0 0\n").expect(400);
}

#[test]
fn a_byte_order_mark_is_no_part_of_a_document() {
    let server = Server::fresh();
    let marked = |text: String| format!("\u{feff}{text}");
    let body = json!({"name": "c", "representation": landmarks(3, 2), "correspondence": "landmarks"});
    server.post_bytes("/v1/cohorts", "application/json", marked(body.to_string())).expect(201);
    let shapes = "/v1/cohorts/c/shapes";
    let line = |name: &str| json!({"points": [[0, 0], [4, 0], [4, 1]], "external_id": name}).to_string();
    server
        .post_bytes(shapes, "application/x-ndjson", marked(format!("{}\n{}\n", line("a"), line("b"))))
        .expect(201);
    let list = format!("{{\"shapes\": [{}]}}", line("c"));
    server.post_bytes(shapes, "application/json", marked(list)).expect(201);
    assert_eq!(server.get("/v1/cohorts/c").expect(200)["shape_count"], 3);
    let document = json!({"representation": curves(), "correspondence": "arc_length", "shapes": [{"points": [[0, 0], [4, 0], [4, 1]]}]});
    server.post_bytes("/v1/measure", "application/json", marked(document.to_string())).expect(200);
    let parameters = marked("{}".into());
    let parts: [(&str, &str, &[u8]); 2] =
        [("parameters", "application/json", parameters.as_bytes()), ("image", "image/png", &label_picture())];
    crate::form::post_form(&server, "/v1/contours", crate::form::form(&parts)).expect(200);
}

/// Browsers send this type for every file that ends in `.gz`.
#[test]
fn what_gzip_compresses_tells_the_format() {
    let server = Server::fresh();
    let shapes = cohort(&server, "c", &landmarks(2, 2), "landmarks");
    let line = r#"{"points":[[0,0],[4,1]],"external_id":"a"}"#;
    let tps = "LM=2\n0 0\n4 1\nID=b\n";
    for media_type in ["application/gzip", "application/x-gzip"] {
        for (query, text, format) in [("", line, "ndjson"), ("?name=x.tps.gz", tps, "tps")] {
            let found =
                server.post_bytes(&format!("{shapes}{query}"), media_type, gzip(text.as_bytes())).expect(201);
            assert_eq!(found["file"]["format"], format);
        }
        let grid = Grid::along_axes([6, 5, 4], [1.0; 3], [LengthUnit::Millimetre; 3]).unwrap();
        let cells: Vec<u8> = (0..120).map(|at| u8::from(at % 6 > 1)).collect();
        let volume = gzip(&nifti_u8(&grid, &cells).unwrap());
        let found = server.post_bytes("/v1/inspect", media_type, volume).expect(200);
        assert_eq!((&found["records"], &found["properties"]["cut_by_edge"]), (&json!(1), &json!(1)));
    }
}

#[test]
fn equal_faults_of_a_file_are_one_with_their_number() {
    let server = Server::fresh();
    let shapes = cohort(&server, "c", &landmarks(2, 2), "landmarks");
    let mut lines = "{\"points\":[[0,0,1],[4,1,1]]}\n".repeat(177);
    lines.push_str("{\"points\":[[0,0],[4,1],[2,2]]}\n");
    let problem = server.post_bytes(&format!("{shapes}?format=ndjson"), "application/octet-stream", lines);
    let problem = problem.expect_problem(422, "invalid-input", &["/points", "/points"]);
    let first = &problem["errors"][0];
    assert!(first["detail"].as_str().unwrap().contains("plane=xy"), "{first}");
    assert_eq!(
        (&first["count"], &first["place"], &first["index"]),
        (&json!(177), &json!({"line": 1}), &json!(0))
    );
    assert_eq!(first["more"], json!([{"line": 2}, {"line": 3}, {"line": 4}, {"line": 5}]));
    assert_eq!(problem["errors"][1].get("count"), None);
    assert!(problem["detail"].as_str().unwrap().starts_with("178 errors"), "{problem}");
}

#[test]
fn landmarks_of_other_programs_are_named_points() {
    let server = shared();
    let list = r#"[{"id": "nose", "coordinates": [1, 2, 3]}, {"id": "chin", "coordinates": [4, 5, 6]}]"#;
    let found = server.post_bytes("/v1/inspect?name=x.json", "application/octet-stream", list).expect(200);
    assert_eq!((&found["format"], &found["groups"][0]["points"]), (&json!("scalismo"), &json!([2, 2])));
    let table = "# landmarks\nnose,1,2,3\nchin,4,5,6\n";
    let found = server.post_bytes("/v1/convert?to=ndjson", "text/csv", table);
    let line: Value = serde_json::from_str(found.text().trim()).unwrap();
    assert_eq!(line["metadata"]["landmark_names"], json!(["nose", "chin"]));
    let german = "id;x1;y1;x2;y2\na;495,0;1,5;2;3\n";
    let found = server.post_bytes("/v1/convert?to=ndjson", "text/csv", german);
    let line: Value = serde_json::from_str(found.text().trim()).unwrap();
    assert_eq!(line["points"], json!([[495.0, 1.5], [2.0, 3.0]]));
}
