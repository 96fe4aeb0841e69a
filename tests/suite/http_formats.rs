//! Answers with numbers as tables over HTTP: CSV, Arrow, Parquet, NPY and NPZ.

use std::collections::HashMap;

use arrow_array::cast::AsArray;
use arrow_array::types::Float64Type;
use arrow_array::{Array, RecordBatch};
use arrow_ipc::reader::StreamReader;
use bytes::Bytes;
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use reqwest::Method;
use serde_json::{Value, json};

use crate::http_segment::{PATH, bright, curves, post_files};
use crate::server::{Reply, Server, shared};

/// Rings that differ in more than two ways, with their statistics asked for.
fn request() -> Value {
    let curve = json!({"kind": "closed_curve", "dimension": 2, "control_points": 4, "generator": {"name": "trigonometric"}});
    json!({"representation": curve, "transformation": "similarity", "shapes": rings()})
}

fn rings() -> Vec<Value> {
    let ring = |a: f64, b: f64, c: f64| json!({"points": [[a, 0.0], [0.0, b], [-a, c], [0.0, -b]]});
    [(2.0, 1.0, 0.5), (1.0, 1.5, 0.4), (1.2, 0.7, 0.3), (1.4, 1.1, 0.1), (0.9, 1.3, 0.6)]
        .map(|(a, b, c)| ring(a, b, c))
        .into()
}

fn post_for(server: &Server, path: &str, accept: &str, body: &Value) -> Reply {
    server.send(server.request(Method::POST, path).header("accept", accept).json(body))
}

fn arrow(reply: &Reply) -> RecordBatch {
    let reader = StreamReader::try_new(reply.body.as_slice(), None).unwrap();
    let batches: Vec<RecordBatch> = reader.map(Result::unwrap).collect();
    batches.into_iter().next().unwrap()
}

fn parquet(reply: &Reply) -> RecordBatch {
    let bytes = Bytes::copy_from_slice(&reply.body);
    let reader = ParquetRecordBatchReaderBuilder::try_new(bytes).unwrap().build().unwrap();
    reader.map(Result::unwrap).next().unwrap()
}

fn facts_of_parquet(reply: &Reply) -> HashMap<String, String> {
    let bytes = Bytes::copy_from_slice(&reply.body);
    ParquetRecordBatchReaderBuilder::try_new(bytes).unwrap().schema().metadata().clone()
}

/// The list of a row of a column.
fn list(batch: &RecordBatch, column: &str, row: usize) -> Vec<f64> {
    let lists = batch.column_by_name(column).unwrap().as_list::<i32>();
    lists.value(row).as_primitive::<Float64Type>().values().to_vec()
}

fn numbers(value: &Value) -> Vec<f64> {
    match value {
        Value::Array(items) => items.iter().flat_map(numbers).collect(),
        value => vec![value.as_f64().unwrap()],
    }
}

#[test]
fn statistics_are_tables_with_the_numbers_of_json() {
    let server = shared();
    let body = request();
    let answer = server.post("/v1/pca", &body).expect(200);
    let scores = answer["pca"]["scores"].as_array().unwrap();
    let reply = post_for(&server, "/v1/pca", "application/vnd.apache.arrow.stream", &body);
    assert_eq!(
        (reply.status, reply.header("content-type")),
        (200, Some("application/vnd.apache.arrow.stream"))
    );
    assert_eq!(reply.header("shapelex-table"), Some("pca.scores"));
    let table = arrow(&reply);
    assert_eq!(table.num_rows(), 5);
    for (row, expected) in scores.iter().enumerate() {
        assert_eq!(list(&table, "scores", row), numbers(expected), "row {row}");
    }
    let schema = table.schema();
    let facts = schema.metadata();
    assert_eq!(facts["shapelex.shape_count"], "5");
    assert!(facts["shapelex.tables"].contains("pca.eigenshapes"), "{facts:?}");

    let reply = post_for(&server, "/v1/pca?table=pca.eigenshapes", "application/vnd.apache.parquet", &body);
    let shapes = parquet(&reply);
    let expected = answer["pca"]["eigenshapes"].as_array().unwrap();
    assert_eq!(shapes.num_rows(), expected.len());
    assert_eq!(list(&shapes, "control_points", 1), numbers(&expected[1]["control_points"]));
    assert_eq!(facts_of_parquet(&reply)["shapelex.item_shape.control_points"], "2");

    let reply = server.send(server.request(Method::POST, "/v1/pca?format=csv").json(&body));
    let text = reply.text();
    let lines: Vec<&str> = text.lines().collect();
    assert_eq!(lines.len(), 6);
    assert!(lines[0].starts_with("scores.1,scores.2"), "{}", lines[0]);
    let first: Vec<f64> = lines[1].split(',').map(|field| field.parse().unwrap()).collect();
    assert_eq!(first, numbers(&scores[0]));
}

#[test]
fn objects_and_single_answers_are_tables() {
    let server = shared();
    let arrow_of = |path: &str| server.get(&format!("{path}&format=arrow"));
    let path = "/v1/generators/cubic?control_points=8";
    let (answer, table) = (server.get(path).expect(200), arrow(&arrow_of(path)));
    let condition = table.column_by_name("condition").unwrap().as_primitive::<Float64Type>();
    assert_eq!((table.num_rows(), condition.value(0)), (1, answer["condition"].as_f64().unwrap()));

    let body = json!({"scheme": "loop", "level": 1, "start": "icosahedron"});
    let answer = server.post("/v1/subdivide", &body).expect(200);
    let table = arrow(&post_for(&server, "/v1/subdivide", "application/vnd.apache.arrow.stream", &body));
    assert_eq!(list(&table, "mesh.vertices", 0), numbers(&answer["mesh"]["vertices"]));

    let body = curves(json!({}));
    let answer = post_files(&server, PATH, &body, &[("image", &bright())]).expect(200);
    let reply = post_files(&server, &format!("{PATH}?format=arrow"), &body, &[("image", &bright())]);
    let (results, table) = (answer["results"].as_array().unwrap(), arrow(&reply));
    assert_eq!(table.num_rows(), results.len());
    for (row, result) in results.iter().enumerate() {
        assert_eq!(list(&table, "control_points", row), numbers(&result["control_points"]), "row {row}");
    }
}

#[test]
fn arrays_have_the_numbers_of_json() {
    let server = shared();
    let body = request();
    let answer = server.post("/v1/align", &body).expect(200);
    let reply = post_for(&server, "/v1/align?column=control_points", "application/x-npy", &body);
    assert_eq!(reply.status, 200, "{}", reply.text());
    let bytes: &[u8] = &reply.body;
    assert!(bytes.starts_with(b"\x93NUMPY\x01\x00"));
    let head = usize::from(u16::from_le_bytes([bytes[8], bytes[9]])) + 10;
    let text = String::from_utf8_lossy(&bytes[..head]);
    assert!(text.contains("'shape': (5, 4, 2)"), "{text}");
    let found: Vec<f64> =
        bytes[head..].chunks_exact(8).map(|item| f64::from_le_bytes(item.try_into().unwrap())).collect();
    let expected: Vec<f64> = answer["aligned"]
        .as_array()
        .unwrap()
        .iter()
        .flat_map(|shape| numbers(&shape["control_points"]))
        .collect();
    assert_eq!(found, expected);
    let reply = post_for(&server, "/v1/align", "application/x-npz", &body);
    let bytes: &[u8] = &reply.body;
    assert!(bytes.starts_with(b"PK\x03\x04"));
    assert!(String::from_utf8_lossy(bytes).contains("control_points.npy"));
}

#[test]
fn what_there_is_not_is_refused() {
    let server = shared();
    let body = request();
    let send = |path: &str, accept: &str| post_for(&server, path, accept, &body);
    let problem = send("/v1/pca?table=score", "text/csv").expect_problem(400, "invalid-query", &[]);
    assert!(problem["errors"][0]["detail"].as_str().unwrap_or_default().contains("pca.scores"), "{problem}");
    send("/v1/pca?column=x", "application/x-npy").expect_problem(400, "invalid-query", &[]);
    // Of JSON these are no parameters.
    send("/v1/pca?table=pca.scores", "application/json").expect_problem(400, "invalid-query", &[]);
    send("/v1/measure", "image/png").expect_problem(406, "not-acceptable", &[]);
    // Refusals of the handler stay problem documents.
    let reply = post_for(&server, "/v1/pca", "text/csv", &json!({}));
    assert_eq!((reply.status, reply.header("content-type")), (422, Some("application/problem+json")));
}

#[test]
fn stored_numbers_are_tables_with_their_own_entity_tags() {
    let server = Server::fresh();
    let representation = json!({"kind": "landmarks", "dimension": 2, "points": 4});
    let body = json!({"name": "squares", "representation": representation, "correspondence": "landmarks"});
    server.post("/v1/cohorts", &body).expect(201);
    let mut shapes = rings();
    for (k, shape) in shapes.iter_mut().enumerate() {
        shape["external_id"] = format!("q{k}").into();
        shape["labels"] = json!({"age": 30 + k});
    }
    server.post("/v1/cohorts/squares/shapes", &json!({"shapes": shapes})).expect(201);

    let path = "/v1/cohorts/squares/mean?transformation=similarity";
    let plain = server.get(path);
    let get = |accept: &str, known: &str| {
        let request = server.request(Method::GET, path).header("accept", accept);
        server.send(request.header("if-none-match", known))
    };
    let table = get("application/vnd.apache.arrow.stream", "\"x\"");
    let mean = plain.expect(200);
    assert_eq!(list(&arrow(&table), "mean.control_points", 0), numbers(&mean["mean"]["control_points"]));
    let (tag, plain) = (table.header("etag").unwrap().to_owned(), plain.header("etag").unwrap().to_owned());
    assert_ne!(tag, plain);
    let known = get("application/vnd.apache.arrow.stream", &tag);
    assert_eq!((known.status, known.header("etag")), (304, Some(tag.as_str())));
    assert_eq!(
        get("application/vnd.apache.arrow.stream", &plain).status,
        200,
        "the tag of JSON is that of another file"
    );
    assert_eq!(get("text/csv", &tag).status, 200, "another file");

    let table = server.get("/v1/cohorts/squares/attributes?format=parquet");
    let names = parquet(&table);
    let names = names.column_by_name("name").unwrap().as_string::<i32>();
    assert!((0..names.len()).any(|row| names.value(row) == "labels.age"));
    let table = server.get("/v1/cohorts/squares/table?columns=external_id,labels.age&format=parquet");
    assert_eq!(table.header("content-type"), Some("application/vnd.apache.parquet"));
    let ages = parquet(&table);
    assert_eq!(ages.column_by_name("labels.age").unwrap().as_primitive::<Float64Type>().value(3), 33.0);

    let body = request();
    let distances = server.post("/v1/distances", &body).expect(200);
    let table = arrow(&post_for(&server, "/v1/distances", "application/vnd.apache.arrow.stream", &body));
    let lists = table.column_by_name("distances").unwrap().as_fixed_size_list();
    let row = lists.value(2);
    assert_eq!(row.as_primitive::<Float64Type>().values().to_vec(), numbers(&distances["distances"][2]));
    let query = json!({"ids": ["q1", "q2"], "neighbours": 3});
    let found = server.post("/v1/cohorts/squares/search", &query).expect(200);
    let table = post_for(&server, "/v1/cohorts/squares/search", "text/csv", &query);
    let results = found["results"].as_array().unwrap();
    let count: usize = results.iter().map(|result| result["neighbours"].as_array().unwrap().len()).sum();
    assert_eq!(table.text().lines().count(), 1 + count, "{}", table.text());
}
