//! What the service refuses, over HTTP: always a problem document with the right status, pointers and index,
//! nothing is stored, and the process lives.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::Duration;

use flate2::Compression;
use flate2::write::GzEncoder;
use reqwest::Method;
use reqwest::header::{ACCEPT, CONTENT_ENCODING, CONTENT_TYPE};
use serde_json::{Value, json};

use crate::server::{Reply, Server, Setting, pointers_of, shared};

const JSON: &str = "application/json";
const NDJSON: &str = "application/x-ndjson";

const REPRESENTATION: &str =
    r#"{"kind":"closed_curve","dimension":2,"control_points":4,"generator":{"name":"trigonometric"}}"#;
const GOOD: &str = r#"{"points":[[2,0],[0,1],[-2,0],[0,-1]]}"#;
const OTHER: &str = r#"{"points":[[3,0],[0,1],[-2,0.5],[0,-1]]}"#;

/// The rows of a quadrilateral.
const QUAD: &str = "[[2,0],[0,1],[-2,0],[0,-1]]";

/// What differs from what was wanted, of many cases: all are reported at once.
#[derive(Default)]
pub(crate) struct Differences(Vec<String>);

impl Differences {
    /// Compares status, code, pointers (in any order) and, where one is wanted, the index of every error.
    pub(crate) fn compare(&mut self, what: &str, reply: &Reply, wanted: &Wanted) {
        let problem = reply.json();
        let mut found = if reply.status < 400 { Vec::new() } else { pointers_of(&problem) };
        let mut pointers = wanted.pointers.clone();
        found.sort();
        // Two faults may be at one place.
        found.dedup();
        pointers.sort();
        let statuses_fit = wanted.statuses.contains(&(reply.status, problem["code"].as_str().unwrap_or("")));
        let index_fits = |error: &Value| {
            wanted.index.is_none_or(|index| error["index"] == index)
                && wanted.line.is_none_or(|line| error["line"] == line)
        };
        let positions_fit = problem["errors"].as_array().is_none_or(|errors| errors.iter().all(index_fits));
        if !(statuses_fit && found == pointers && positions_fit) {
            let Wanted { statuses, index, line, .. } = wanted;
            let text: String = reply.text().chars().take(400).collect();
            self.0.push(format!(
                "{what}:\n  wanted {statuses:?} {pointers:?} index {index:?} line {line:?}\n  found {text}"
            ));
        }
    }
}

impl Drop for Differences {
    fn drop(&mut self) {
        if !std::thread::panicking() {
            assert!(self.0.is_empty(), "{} differences:\n{}", self.0.len(), self.0.join("\n"));
        }
    }
}

/// A refusal as it should be.
pub(crate) struct Wanted {
    statuses: Vec<(u16, &'static str)>,
    pointers: Vec<String>,
    index: Option<u64>,
    line: Option<u64>,
}

impl Wanted {
    pub(crate) fn new(status: u16, code: &'static str, pointers: &[&str]) -> Self {
        let pointers = pointers.iter().map(ToString::to_string).collect();
        Self { statuses: vec![(status, code)], pointers, index: None, line: None }
    }

    pub(crate) fn invalid(pointers: &[&str]) -> Self {
        Self::new(422, "invalid-input", pointers)
    }

    pub(crate) fn below(&self, prefix: &str, index: Option<u64>, line: Option<u64>) -> Self {
        let pointers = self.pointers.iter().map(|pointer| format!("{prefix}{pointer}")).collect();
        Self { statuses: self.statuses.clone(), pointers, index, line }
    }
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::best());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

fn new_cohort(server: &Server, name: &str, correspondence: &str) {
    let representation: Value = serde_json::from_str(REPRESENTATION).unwrap();
    let body = json!({"name": name, "representation": representation, "correspondence": correspondence});
    server.post("/v1/cohorts", &body).expect(201);
}

/// Asserts that a cohort is as it was created.
#[track_caller]
fn assert_untouched(server: &Server, name: &str) {
    let cohort = server.get(&format!("/v1/cohorts/{name}")).expect(200);
    assert_eq!((&cohort["revision"], &cohort["shape_count"]), (&json!(0), &json!(0)), "{cohort}");
    let shapes = server.get(&format!("/v1/cohorts/{name}/shapes")).expect(200);
    assert_eq!(shapes, json!({"items": [], "next": null}));
}

// ---------------------------------------------------------------- shapes

/// Shapes that no route takes, with the pointers relative to the shape.
fn bad_shapes() -> Vec<(String, Wanted)> {
    let mut cases: Vec<(String, Wanted)> = Vec::new();
    let mut add = |text: String, wanted| cases.push((text, wanted));
    let points = |rows: &str| format!(r#"{{"points":{rows}}}"#);
    let with = |field: &str| format!(r#"{{"points":{QUAD},{field}}}"#);

    for token in ["NaN", "Infinity", "-Infinity", "nan", "inf", "+1", "0x1", "01", "1.", "1e999", "-1e999"] {
        let text = points(&format!("[[2,0],[{token},1],[-2,0],[0,-1]]"));
        let at = match token {
            // The digit 0 is a number, what follows is not.
            "0x1" => "/points/1",
            _ => "/points/1/0",
        };
        add(text, Wanted::new(400, "malformed-body", &[at]));
    }
    for rows in ["[[2,0],[0,1e200],[-2,0],[0,-1]]", "[[2,0],[0,-1e101],[-2,0],[0,-1]]"] {
        add(points(rows), Wanted::invalid(&["/points/1/1"]));
    }
    add(points("[[2,0],[0],[-2,0],[0,-1]]"), Wanted::invalid(&["/points/1"]));
    add(points("[[2,0],[],[-2,0,1],[0,-1]]"), Wanted::invalid(&["/points/1", "/points/2"]));
    add(points("[[2,0,0],[0,1,0],[-2,0,0],[0,-1,0]]"), Wanted::invalid(&["/points/0"]));
    add(points("[[2],[0],[-2],[0]]"), Wanted::invalid(&["/points/0"]));
    let junk = r#"[[2,0],[[0],1],{"a":1},null,"x",true,3,[null,"y"],[false,{}]]"#;
    let faults = ["/1/0", "/2", "/3", "/4", "/5", "/6", "/7/0", "/7/1", "/8/0", "/8/1"];
    let faults = faults.map(|pointer| format!("/points{pointer}"));
    add(points(junk), Wanted::invalid(&faults.each_ref().map(String::as_str)));
    for value in ["\"[[0,0]]\"", "{}", "7", "true", "1.5"] {
        add(points(value), Wanted::invalid(&["/points"]));
        add(format!(r#"{{"control_points":{value}}}"#), Wanted::invalid(&["/control_points"]));
    }
    // Null is as good as nothing.
    for nothing in
        ["{}", r#"{"points":null}"#, r#"{"control_points":null,"points":null}"#, r#"{"label":"x"}"#]
    {
        add(nothing.into(), Wanted::invalid(&[""]));
    }
    add(with(&format!(r#""control_points":{QUAD}"#)), Wanted::invalid(&[""]));
    for rows in ["[]", "[[2,0],[0,1],[-2,0]]", "[[2,0],[0,1],[-2,0],[0,-1],[1,-1]]"] {
        add(points(rows), Wanted::invalid(&["/points"]));
        add(format!(r#"{{"control_points":{rows}}}"#), Wanted::invalid(&["/control_points"]));
    }
    for value in ["0", "-1", "-0.0", "1e300", "1e-300", "\"1\"", "[1]", "{}", "true"] {
        add(with(&format!(r#""weight":{value}"#)), Wanted::invalid(&["/weight"]));
    }
    for value in ["NaN", "1e999"] {
        add(with(&format!(r#""weight":{value}"#)), Wanted::new(400, "malformed-body", &["/weight"]));
    }
    let long = "x".repeat(501);
    for field in ["external_id", "subject", "label"] {
        for text in ["", &long, "a\\nb", "\\u0000"] {
            let pointer = format!("/{field}");
            add(with(&format!(r#""{field}":"{text}""#)), Wanted::invalid(&[&pointer]));
        }
        let pointer = format!("/{field}");
        add(with(&format!(r#""{field}":17"#)), Wanted::invalid(&[&pointer]));
    }
    add(
        with(r#""labels":{"a":{"b":1},"c":1,"d/e~f":[1]}"#),
        Wanted::invalid(&["/labels/a", "/labels/d~1e~0f"]),
    );
    for name in ["", " ", &long, "a\\nb", "a\\u202eb", "\\u200b"] {
        add(with(&format!(r#""labels":{{"{name}":1}}"#)), Wanted::invalid(&["/labels"]));
    }
    add(with(r#""labels":["a"]"#), Wanted::invalid(&["/labels"]));
    add(with(r#""labels":"a""#), Wanted::invalid(&["/labels"]));
    let many: Vec<String> = (0..1001).map(|i| format!(r#""k{i}":1"#)).collect();
    add(with(&format!(r#""labels":{{{}}}"#, many.join(","))), Wanted::invalid(&["/labels"]));
    add(with(r#""colour":"red""#), Wanted::invalid(&["/colour"]));
    add(with(r#""closed":false"#), Wanted::invalid(&["/closed"]));
    add(with(r#""closed":"yes""#), Wanted::invalid(&["/closed"]));
    // Twice the same field, also by its alias.
    add(with(&format!(r#""points":{QUAD}"#)), Wanted::invalid(&["/points"]));
    add(with(r#""external_id":"a","external_id":"b""#), Wanted::invalid(&["/external_id"]));
    for text in ["null", "7", "\"x\"", "true", "[]", QUAD] {
        add(text.into(), Wanted::invalid(&[""]));
    }
    // Several faults of one shape.
    add(
        r#"{"points":[[2,0],[0,null],[-2,0],[0,-1e300]],"weight":-1,"label":"","labels":{"a":[]}}"#.into(),
        Wanted::invalid(&["/points/1/1", "/points/3/1", "/weight", "/label", "/labels/a"]),
    );
    cases
}

#[test]
fn bad_shapes_are_refused_by_every_route() {
    let server = Server::fresh();
    new_cohort(&server, "body", "landmarks");
    new_cohort(&server, "stream", "landmarks");
    let mut differences = Differences::default();
    for (bad, wanted) in bad_shapes() {
        let shapes = format!("[{GOOD},{OTHER},{bad}]");
        let named: String = bad.chars().take(80).collect();
        let at_2 = wanted.below("/shapes/2", Some(2), None);
        let settings = format!(r#""representation":{REPRESENTATION},"transformation":"similarity""#);
        let mut post = |path: &str, body: String, wanted: &Wanted| {
            let reply = server.post_bytes(path, JSON, body);
            differences.compare(&format!("{path} {named}"), &reply, wanted);
        };
        for path in ["/v1/mean", "/v1/align", "/v1/pca"] {
            post(path, format!(r#"{{{settings},"shapes":{shapes}}}"#), &at_2);
        }
        post("/v1/project", format!(r#"{{{settings},"reference":{GOOD},"shapes":{shapes}}}"#), &at_2);
        let at_reference = wanted.below("/reference", None, None);
        post("/v1/project", format!(r#"{{{settings},"reference":{bad},"shapes":[{GOOD}]}}"#), &at_reference);
        for path in ["/v1/evaluate", "/v1/measure"] {
            post(path, format!(r#"{{"representation":{REPRESENTATION},"shapes":{shapes}}}"#), &at_2);
        }
        post("/v1/cohorts/body/shapes", format!(r#"{{"shapes":{shapes}}}"#), &at_2);

        let reply = server.post_bytes(
            "/v1/cohorts/stream/shapes",
            NDJSON,
            format!("{GOOD}\n\n{OTHER}\n{bad}\n{GOOD}"),
        );
        // A line that is not JSON is a fault of a line among others.
        let mut of_line = wanted.below("", Some(2), Some(4));
        of_line.statuses.push((422, "invalid-input"));
        differences.compare(&format!("NDJSON {named}"), &reply, &of_line);
    }
    assert_untouched(&server, "body");
    assert_untouched(&server, "stream");
    server.assert_alive();
}

#[test]
fn a_good_shape_is_taken_by_every_route() {
    // What the tests of this file change is wrong because of the change alone.
    let server = Server::fresh();
    new_cohort(&server, "body", "landmarks");
    let settings = format!(r#""representation":{REPRESENTATION},"transformation":"similarity""#);
    let shapes = format!("[{GOOD},{OTHER}]");
    for path in ["/v1/mean", "/v1/align", "/v1/pca"] {
        server.post_bytes(path, JSON, format!(r#"{{{settings},"shapes":{shapes}}}"#)).expect(200);
    }
    let body = format!(r#"{{{settings},"reference":{GOOD},"shapes":{shapes}}}"#);
    server.post_bytes("/v1/project", JSON, body).expect(200);
    for path in ["/v1/evaluate", "/v1/measure"] {
        let body = format!(r#"{{"representation":{REPRESENTATION},"shapes":{shapes}}}"#);
        server.post_bytes(path, JSON, body).expect(200);
    }
    server.post_bytes("/v1/resample", JSON, format!(r#"{{"count":5,"shapes":{shapes}}}"#)).expect(200);
    server.post_bytes("/v1/cohorts/body/shapes", JSON, format!(r#"{{"shapes":{shapes}}}"#)).expect(201);
    // A weight at the bounds, a label of 500 characters.
    let edge =
        format!(r#"{{"points":{QUAD},"weight":1e100,"label":"{}","labels":{{"a":null}}}}"#, "ä".repeat(500));
    server.post_bytes("/v1/cohorts/body/shapes", NDJSON, edge).expect(201);
}

// ---------------------------------------------------------------- sets of shapes

fn statistics(transformation: &str, correspondence: &str, shapes: &[&str]) -> Value {
    let representation: Value = serde_json::from_str(REPRESENTATION).unwrap();
    let shapes: Vec<Value> = shapes.iter().map(|shape| serde_json::from_str(shape).unwrap()).collect();
    json!({"representation": representation, "transformation": transformation,
        "correspondence": correspondence, "shapes": shapes})
}

const POINT: &str = r#"{"points":[[5,7],[5,7],[5,7],[5,7]]}"#;
const ORIGIN: &str = r#"{"points":[[0,0],[0,0],[0,0],[0,0]]}"#;
const LINE: &str = r#"{"points":[[0,0],[1,2],[2,4],[3,6]]}"#;

#[test]
fn degenerate_shapes_are_named() {
    let server = shared();
    let mut differences = Differences::default();
    let cases: [(&str, &str); 10] = [
        ("similarity", POINT),
        ("similarity", ORIGIN),
        ("uniform_scaling_translation", POINT),
        ("translation", POINT),
        ("affine", POINT),
        ("affine", LINE),
        ("affine", r#"{"points":[[0,0.1],[1,0.3],[2,0.5],[3,0.7]]}"#),
        ("linear", LINE),
        ("uniform_scaling", ORIGIN),
        ("non_uniform_scaling_translation", r#"{"points":[[0,3],[1,3],[2,3],[1,3]]}"#),
    ];
    for (class, bad) in cases {
        let wanted = Wanted::new(422, "degenerate-shape", &[""]);
        let body = statistics(class, "landmarks", &[GOOD, bad, OTHER]);
        for path in ["/v1/mean", "/v1/align", "/v1/pca"] {
            let reply = server.post(path, &body);
            differences.compare(
                &format!("{path} {class} {bad}"),
                &reply,
                &wanted.below("/shapes/1", Some(1), None),
            );
        }
        for onto in ["reference", "shape"] {
            let mut body = body.clone();
            body["onto"] = json!(onto);
            body["reference"] = serde_json::from_str(GOOD).unwrap();
            let reply = server.post("/v1/project", &body);
            let what = format!("/v1/project {onto} {class} {bad}");
            differences.compare(&what, &reply, &wanted.below("/shapes/1", Some(1), None));
            body["reference"] = body["shapes"][1].take();
            body["shapes"] = json!([serde_json::from_str::<Value>(GOOD).unwrap()]);
            let reply = server.post("/v1/project", &body);
            differences.compare(
                &format!("{what} as reference"),
                &reply,
                &wanted.below("/reference", None, None),
            );
        }
    }
    for class in ["similarity", "rigid", "translation"] {
        let mut body = statistics(class, "landmarks", &[GOOD, POINT]);
        body["alignment"] = json!("procrustes");
        let wanted = Wanted::new(422, "degenerate-shape", &["/shapes/1"]);
        differences.compare(&format!("Procrustes {class}"), &server.post("/v1/mean", &body), &wanted);
    }
    // A line has a similarity class.
    server.post("/v1/mean", &statistics("similarity", "landmarks", &[GOOD, LINE])).expect(200);
    server.assert_alive();
}

#[test]
fn a_mean_needs_two_shapes() {
    let server = shared();
    for path in ["/v1/mean", "/v1/align", "/v1/pca"] {
        for shapes in [&[][..], &[GOOD]] {
            for class in ["similarity", "affine", "translation"] {
                let reply = server.post(path, &statistics(class, "landmarks", shapes));
                reply.expect_problem(422, "too-few-shapes", &[]);
            }
        }
    }
    let mut body = statistics("similarity", "landmarks", &[]);
    body["reference"] = serde_json::from_str(GOOD).unwrap();
    server.post("/v1/project", &body).expect_problem(422, "too-few-shapes", &[]);
    let representation: Value = serde_json::from_str(REPRESENTATION).unwrap();
    for path in ["/v1/evaluate", "/v1/measure"] {
        let body = json!({"representation": representation, "shapes": []});
        server.post(path, &body).expect_problem(422, "too-few-shapes", &[]);
    }
    server.post("/v1/resample", &json!({"count": 10, "shapes": []})).expect_problem(
        422,
        "too-few-shapes",
        &[],
    );
}

#[test]
fn contours_that_cannot_be_resampled_are_refused() {
    let server = Server::fresh();
    let mut differences = Differences::default();
    let cases: [(&str, &[&str]); 7] = [
        // Too few points are left without the repeated ones.
        (r#"{"points":[[0,0],[0,0],[1,0],[1,0]]}"#, &["/points"]),
        (r#"{"points":[[0,0],[1,0],[1,0],[1,0],[0,0]]}"#, &["/points"]),
        // Closed twice: the last point once more.
        (r#"{"points":[[0,0],[1,1],[0,0],[0,0]]}"#, &["/points"]),
        (r#"{"points":[[0,0],[1,0]]}"#, &["/points"]),
        (r#"{"points":[[0,0],[1,0],[0,0]]}"#, &["/points"]),
        (r#"{"points":[]}"#, &["/points"]),
        (r#"{"points":[[5,7],[5,7],[5,7],[5,7],[5,7]]}"#, &["/points"]),
    ];
    for correspondence in ["arc_length", "cyclic"] {
        new_cohort(&server, correspondence, correspondence);
        for (bad, pointers) in cases {
            let wanted = Wanted::invalid(pointers).below("/shapes/1", Some(1), None);
            let body = statistics("similarity", correspondence, &[GOOD, bad]);
            for path in ["/v1/mean", "/v1/align", "/v1/pca"] {
                differences.compare(
                    &format!("{path} {correspondence} {bad}"),
                    &server.post(path, &body),
                    &wanted,
                );
            }
            let mut either = body.clone();
            either["direction"] = json!("either");
            let reply = server.post("/v1/mean", &either);
            differences.compare(&format!("{correspondence}, either direction {bad}"), &reply, &wanted);
            let path = format!("/v1/cohorts/{correspondence}/shapes");
            let reply = server.post(&path, &json!({"shapes": body["shapes"]}));
            differences.compare(&format!("{path} {bad}"), &reply, &wanted);
            let lines = body["shapes"].as_array().unwrap();
            let wanted = Wanted::invalid(pointers).below("", Some(1), Some(2));
            differences.compare(&format!("NDJSON {bad}"), &server.post_lines(&path, lines), &wanted);
            let reply = server.post("/v1/resample", &json!({"count": 8, "shapes": body["shapes"]}));
            let wanted = Wanted::invalid(pointers).below("/shapes/1", Some(1), None);
            differences.compare(&format!("/v1/resample {bad}"), &reply, &wanted);
        }
        assert_untouched(&server, correspondence);
    }
    server.assert_alive();
}

#[test]
fn a_contour_without_extent_is_not_stored_under_landmarks_either() {
    let server = Server::fresh();
    new_cohort(&server, "points", "landmarks");
    let shapes: Vec<Value> = [GOOD, POINT].iter().map(|shape| serde_json::from_str(shape).unwrap()).collect();
    let reply = server.post("/v1/cohorts/points/shapes", &json!({ "shapes": shapes }));
    assert_eq!(reply.status, 422, "{}", reply.text());
    assert_untouched(&server, "points");
}

// ---------------------------------------------------------------- settings

/// A body with one field replaced, by JSON pointer; the last segment may be new.
fn changed(body: &Value, pointer: &str, value: Value) -> Value {
    let mut body = body.clone();
    let (parent, key) = pointer.rsplit_once('/').unwrap();
    body.pointer_mut(parent).unwrap()[key] = value;
    body
}

#[test]
fn bad_settings_are_refused_with_their_pointers() {
    let server = shared();
    let mut differences = Differences::default();
    let body = statistics("similarity", "landmarks", &[GOOD, OTHER]);
    let mut cases: Vec<(&str, Value, &str)> = Vec::new();
    for value in [json!("simmilarity"), json!(7), json!(null), json!([]), json!({}), json!(""), json!(true)] {
        for field in ["/transformation", "/frame", "/correspondence", "/mirror", "/direction", "/alignment"] {
            // Null is as good as nothing, where nothing need be given.
            if !value.is_null() || field == "/transformation" {
                cases.push((field, value.clone(), field));
            }
        }
        cases.push(("/representation/kind", value.clone(), "/representation/kind"));
        cases.push(("/representation/generator/name", value.clone(), "/representation/generator/name"));
        if !value.is_object() {
            cases.push(("/representation", value.clone(), "/representation"));
            cases.push(("/representation/generator", value.clone(), "/representation/generator"));
        }
        if !value.is_array() {
            cases.push(("/shapes", value.clone(), "/shapes"));
        }
    }
    for value in [json!(0), json!(1), json!(4), json!(-2), json!(2.5), json!("2"), json!(null), json!(1e30)] {
        cases.push(("/representation/dimension", value, "/representation/dimension"));
    }
    for value in
        [json!(0), json!(2), json!(-4), json!(1_000_000_000_u64), json!(1e30), json!("4"), json!(4.5)]
    {
        cases.push(("/representation/control_points", value, "/representation/control_points"));
    }
    for degree in
        [json!(0), json!(6), json!(300), json!(-1), json!(2.5), json!("3"), json!(null), json!(1e30)]
    {
        let generator = json!({"name": "bspline", "degree": degree});
        cases.push(("/representation/generator", generator, "/representation/generator/degree"));
    }
    cases.push(("/representation/generator", json!({"name": "bspline"}), "/representation/generator/degree"));
    cases.push(("/representation/generator", json!({}), "/representation/generator/name"));
    let superfluous = json!({"name": "cubic", "degree": 3});
    cases.push(("/representation/generator", superfluous, "/representation/generator/degree"));
    cases.push(("/representation/extra", json!(1), "/representation/extra"));
    cases.push(("/representation/a~1b", json!(1), "/representation/a~01b"));
    cases.push(("/extra", json!(1), "/extra"));
    let landmarks = json!({"kind": "landmarks", "dimension": 2, "points": 1});
    cases.push(("/representation", landmarks, "/representation/points"));
    let matrices = [
        json!([]),
        json!([[[1, 0], [0, 1]], [[2, 0], [0, 2]]]),
        json!([[[0, 0], [0, 0]]]),
        json!([[[1, 0, 0], [0, 1, 0], [0, 0, 1]]]),
        json!([[[1, 0]]]),
        json!([[[1, 0], [0]]]),
        json!([[]]),
        json!([[[1, 0], [0, 1e200]]]),
        json!([[[1, 0], [0, 0]], [[0, 1], [0, 0]], [[0, 0], [1, 0]], [[0, 0], [0, 1]], [[1, 1], [1, 1]]]),
        json!([[[1, 0], [0, 1]], [[1, 0], [1e-12, 1]]]),
    ];
    for matrices in matrices {
        cases.push(("/transformation", json!({ "matrices": matrices }), "/transformation"));
    }
    let typed = [
        (json!({"matrices": [[[1, 0], [0, "x"]]]}), "/transformation/matrices/0/1/1"),
        (json!({"matrices": [[[1, 0], [0, null]]]}), "/transformation/matrices/0/1/1"),
        (json!({"matrices": 7}), "/transformation/matrices"),
        (json!({"matrices": [[[1, 0], [0, 1]]], "translation": "yes"}), "/transformation/translation"),
        (json!({"matrices": [[[1, 0], [0, 1]]], "rotation": true}), "/transformation/rotation"),
    ];
    for (value, pointer) in typed {
        cases.push(("/transformation", value, pointer));
    }
    for (pointer, value, wanted) in cases {
        for path in ["/v1/mean", "/v1/align", "/v1/pca", "/v1/project"] {
            let mut body = body.clone();
            if path == "/v1/project" {
                body["reference"] = body["shapes"][0].clone();
            }
            let what = format!("{path} with {pointer} = {value}");
            let reply = server.post(path, &changed(&body, pointer, value.clone()));
            differences.compare(&what, &reply, &Wanted::invalid(&[wanted]));
        }
    }
    server.assert_alive();
}

#[test]
fn settings_that_do_not_fit_together_are_refused() {
    let server = shared();
    let mut differences = Differences::default();
    let body = statistics("similarity", "landmarks", &[GOOD, OTHER]);
    let mut compare = |changes: &[(&str, Value)], pointers: &[&str]| {
        let body = changes.iter().fold(body.clone(), |body, (p, value)| changed(&body, p, value.clone()));
        differences.compare(
            &format!("{changes:?}"),
            &server.post("/v1/mean", &body),
            &Wanted::invalid(pointers),
        );
    };
    let space =
        json!({"kind": "closed_curve", "dimension": 3, "control_points": 4, "generator": {"name": "cubic"}});
    let rows = [[1, 0, 0], [0, 2, 0], [0, 0, 3], [1, 1, 1]];
    let shapes = json!([{ "points": rows }, { "points": rows }]);
    for class in ["similarity", "scaled_rotation", "rigid", "horizontal_shear", "reflected_similarity"] {
        let changes = [
            ("/representation", space.clone()),
            ("/shapes", shapes.clone()),
            ("/alignment", json!("projection")),
            ("/transformation", json!(class)),
        ];
        compare(&changes, &["/transformation"]);
    }
    let rigid = [("/alignment", json!("projection")), ("/transformation", json!("rigid"))];
    compare(&rigid, &["/transformation"]);
    for class in ["affine", "linear", "uniform_scaling", "reflected_similarity"] {
        compare(
            &[("/alignment", json!("procrustes")), ("/transformation", json!(class))],
            &["/transformation"],
        );
    }
    let matrices = json!({"matrices": [[[1, 0], [0, 1]]]});
    compare(
        &[("/alignment", json!("procrustes")), ("/transformation", matrices.clone())],
        &["/transformation"],
    );
    compare(&[("/frame", json!("canonical")), ("/transformation", matrices)], &["/frame"]);
    let landmarks = json!({"kind": "landmarks", "dimension": 2, "points": 4});
    for correspondence in ["cyclic", "arc_length"] {
        let changes = [("/representation", landmarks.clone()), ("/correspondence", json!(correspondence))];
        compare(&changes, &["/correspondence"]);
    }
    compare(
        &[("/representation", landmarks), ("/representation/generator", json!({"name": "cubic"}))],
        &["/representation/generator"],
    );
}

#[test]
fn every_bad_field_of_a_request_is_named() {
    let server = shared();
    let mut differences = Differences::default();
    let bad = r#"{"representation":{"kind":"closed_curve","dimension":5,"control_points":1,"generator":{"name":"sinc"},
        "colour":1},"transformation":"twist","frame":"front","correspondence":"none","mirror":"perhaps","direction":3,
        "alignment":"left","shapes":[{"points":[[2,0],[0,1],[-2,0],[0,-1]]},{"points":7}],"extra":1,"more":2}"#;
    let settings = [
        "/representation/generator/name",
        "/representation/colour",
        "/transformation",
        "/frame",
        "/correspondence",
        "/mirror",
        "/direction",
        "/alignment",
        "/extra",
        "/more",
    ];
    // The sizes of a representation and the shapes can only be judged when the rest of it is understood.
    let later = ["/representation/dimension", "/representation/control_points", "/shapes/1/points"];
    let problem = server.post_bytes("/v1/mean", JSON, bad).expect(422);
    let found = pointers_of(&problem);
    for pointer in settings {
        if !found.iter().any(|found| found == pointer) {
            differences.0.push(format!("/v1/mean: {pointer} is not named by {problem}"));
        }
    }
    for pointer in &found {
        if !settings.contains(&pointer.as_str()) && !later.contains(&pointer.as_str()) {
            differences.0.push(format!("/v1/mean: {pointer} is named for nothing"));
        }
    }
    let missing = [
        ("/v1/mean", "{}", &["/representation", "/transformation", "/shapes"][..]),
        ("/v1/pca", r#"{"components":3}"#, &["/representation", "/transformation", "/shapes"]),
        ("/v1/project", "{}", &["/representation", "/transformation", "/shapes", "/reference"]),
        ("/v1/evaluate", "{}", &["/representation", "/shapes"]),
        ("/v1/measure", "{}", &["/representation", "/shapes"]),
        ("/v1/resample", "{}", &["/count", "/shapes"]),
        ("/v1/cohorts", "{}", &["/name", "/representation"]),
    ];
    for (path, body, pointers) in missing {
        differences.compare(path, &server.post_bytes(path, JSON, body), &Wanted::invalid(pointers));
    }
    let representation: Value = serde_json::from_str(REPRESENTATION).unwrap();
    let cohort = json!({"name": "not a name", "length_unit": "", "description": "x".repeat(10_001),
        "representation": changed(&changed(&representation, "/dimension", json!(7)), "/control_points", json!(2))});
    let pointers = [
        "/name",
        "/length_unit",
        "/description",
        "/representation/dimension",
        "/representation/control_points",
    ];
    differences.compare("cohort", &server.post("/v1/cohorts", &cohort), &Wanted::invalid(&pointers));
    let cohort = json!({"name": "", "representation": changed(&representation, "/kind", json!("box")),
        "mirror": "perhaps", "correspondence": 4});
    let pointers = ["/name", "/representation/kind", "/mirror", "/correspondence"];
    differences.compare("cohort", &server.post("/v1/cohorts", &cohort), &Wanted::invalid(&pointers));
}

#[test]
fn bad_fields_of_the_single_routes_are_refused() {
    let server = shared();
    let mut differences = Differences::default();
    let good: Value = serde_json::from_str(GOOD).unwrap();
    let representation: Value = serde_json::from_str(REPRESENTATION).unwrap();
    let evaluate = json!({"representation": representation, "shapes": [good]});
    let mut compare = |path: &str, body: &Value, pointer: &str, value: Value, wanted: &[&str]| {
        let what = format!("{path} with {pointer} = {value}");
        let reply = server.post(path, &changed(body, pointer, value));
        differences.compare(&what, &reply, &Wanted::invalid(wanted));
    };
    for value in
        [json!(0), json!(-1), json!(1.5), json!("9"), json!(1_000_000_000_u64), json!(u64::MAX), json!(1e30)]
    {
        compare("/v1/evaluate", &evaluate, "/samples", value, &["/samples"]);
    }
    for value in [json!(3), json!(-1), json!("1"), json!(u64::MAX)] {
        compare("/v1/evaluate", &evaluate, "/derivatives", value, &["/derivatives"]);
    }
    compare("/v1/evaluate", &evaluate, "/parameters", json!([]), &["/parameters"]);
    compare("/v1/evaluate", &evaluate, "/parameters", json!(0.5), &["/parameters"]);
    compare("/v1/evaluate", &evaluate, "/parameters", json!([0, null]), &["/parameters/1"]);
    let both = changed(&evaluate, "/samples", json!(4));
    compare("/v1/evaluate", &both, "/parameters", json!([0.5]), &["/parameters"]);
    let landmarks = json!({"kind": "landmarks", "dimension": 2, "points": 4});
    for path in ["/v1/evaluate", "/v1/measure"] {
        compare(path, &evaluate, "/representation", landmarks.clone(), &["/representation/kind"]);
        compare(path, &evaluate, "/correspondence", json!("none"), &["/correspondence"]);
        compare(path, &evaluate, "/transformation", json!("affine"), &["/transformation"]);
    }
    compare("/v1/measure", &evaluate, "/length_unit", json!(5), &["/length_unit"]);
    compare("/v1/measure", &evaluate, "/length_unit", json!(""), &["/length_unit"]);
    compare("/v1/measure", &evaluate, "/length_unit", json!("x".repeat(51)), &["/length_unit"]);

    let resample = json!({"count": 10, "shapes": [good]});
    for value in
        [json!(0), json!(2), json!(-1), json!(1.5), json!("9"), json!(1_000_000_000_u64), json!(u64::MAX)]
    {
        compare("/v1/resample", &resample, "/count", value, &["/count"]);
    }
    compare("/v1/resample", &resample, "/start", json!("middle"), &["/start"]);
    compare("/v1/resample", &resample, "/extra", json!(1), &["/extra"]);
    let nothing = json!([good, {}]);
    compare("/v1/resample", &resample, "/shapes", nothing, &["/shapes/1"]);
    let many = json!([{"points": [[0, 0], [1], [1, "x"]]}, {"points": 7}, good]);
    compare(
        "/v1/resample",
        &resample,
        "/shapes",
        many,
        &["/shapes/0/points/1", "/shapes/0/points/2/1", "/shapes/1/points"],
    );

    let pca = statistics("similarity", "landmarks", &[GOOD, OTHER]);
    for value in [json!(0), json!(-1), json!(2.5), json!("x")] {
        compare("/v1/pca", &pca, "/components", value, &["/components"]);
    }
    compare("/v1/pca", &pca, "/centre", json!("yes"), &["/centre"]);
    compare("/v1/pca", &pca, "/tangent", json!("yes"), &["/tangent"]);
    // Shapes that keep their sizes, or are aligned on a part of them, have no unit size.
    compare(
        "/v1/pca",
        &changed(&pca, "/transformation", json!("rigid")),
        "/tangent",
        json!(true),
        &["/tangent"],
    );
    let on_a_part = changed(&pca, "/region", json!([[0.0, 0.5]]));
    compare("/v1/pca", &on_a_part, "/tangent", json!(true), &["/tangent"]);
    compare("/v1/pca", &pca, "/aligned", json!(1), &["/aligned"]);
    // As many as there are.
    for count in [json!(1_000_000_000_000_u64), json!(u64::MAX)] {
        server.post("/v1/pca", &changed(&pca, "/components", count)).expect(200);
    }
    let project = changed(&pca, "/reference", good.clone());
    compare("/v1/project", &project, "/onto", json!("both"), &["/onto"]);
    let mean = statistics("affine", "landmarks", &[GOOD, OTHER]);
    compare("/v1/mean", &mean, "/components", json!(3), &["/components"]);

    let cohort = json!({"name": "fine", "representation": representation});
    let long = "x".repeat(101);
    for name in ["", " ", "a b", "a/b", ".hidden", "coh_x", "naïve", "a\n", "..", &long] {
        compare("/v1/cohorts", &cohort, "/name", json!(name), &["/name"]);
    }
    compare("/v1/cohorts", &cohort, "/name", json!(7), &["/name"]);
    compare("/v1/cohorts", &cohort, "/revision", json!(7), &["/revision"]);
    compare("/v1/cohorts", &cohort, "/representation", json!(7), &["/representation"]);
    compare("/v1/cohorts", &cohort, "/representation/dimension", json!(7), &["/representation/dimension"]);
    assert_eq!(server.get("/v1/cohorts").expect(200)["items"], json!([]), "nothing was created");
    server.assert_alive();
}

// ---------------------------------------------------------------- bodies and headers

#[test]
fn broken_bodies_are_refused() {
    let server = Server::fresh();
    new_cohort(&server, "body", "landmarks");
    let whole = format!(
        r#"{{"representation":{REPRESENTATION},"transformation":"similarity","shapes":[{GOOD},{OTHER}]}}"#
    );
    let cohort = format!(r#"{{"name":"x","representation":{REPRESENTATION}}}"#);
    let shapes = format!(r#"{{"shapes":[{GOOD},{OTHER}]}}"#);
    for (path, good) in [("/v1/mean", whole), ("/v1/cohorts", cohort), ("/v1/cohorts/body/shapes", shapes)] {
        let bytes = good.as_bytes();
        let deep = |open: &str| open.repeat(10_000);
        let mut bodies: Vec<Vec<u8>> = vec![
            Vec::new(),
            b" \n\t".to_vec(),
            b"\x00".to_vec(),
            b"\xff\xfe{\x00}\x00".to_vec(),
            b"{\"name\":\"\xff\"}".to_vec(),
            b"{\"shapes\":[{\"label\":\"\xc3\x28\",\"points\":[]}]}".to_vec(),
            b"{'shapes':[]}".to_vec(),
            b"{\"shapes\":[],}".to_vec(),
            format!("{good} x").into_bytes(),
            format!("{good}{good}").into_bytes(),
            format!("\u{feff}\u{feff}{good}").into_bytes(),
            deep("[").into_bytes(),
            deep("{\"a\":").into_bytes(),
            format!("{{\"representation\":{}", deep("[")).into_bytes(),
            format!("{{\"shapes\":[{{\"metadata\":{}", deep("[")).into_bytes(),
            format!("{{\"shapes\":[{{\"points\":{}{}", deep("["), deep("]")).into_bytes(),
            format!("{{\"transformation\":{}{}", deep("["), deep("]")).into_bytes(),
        ];
        // Truncated everywhere.
        bodies.extend((1..bytes.len()).step_by(7).map(|end| bytes[..end].to_vec()));
        for body in bodies {
            let shown = String::from_utf8_lossy(&body).chars().take(60).collect::<String>();
            let reply = server.post_bytes(path, JSON, body);
            let code = reply.json()["code"].clone();
            // A field of another route is seen before the end of the text.
            let known = [(400, "malformed-body"), (422, "invalid-input")];
            let fits = known.iter().any(|(status, known)| reply.status == *status && code == *known);
            assert!(fits, "{path} {shown}: {}", reply.text());
        }
        let cut = server.post_bytes(path, JSON, &bytes[..bytes.len() - 1]);
        assert_eq!(cut.expect(400)["code"], "malformed-body");
    }
    assert_untouched(&server, "body");
    assert_eq!(server.get("/v1/cohorts").expect(200)["items"].as_array().unwrap().len(), 1);
    server.assert_alive();
}

#[test]
fn a_deep_value_is_refused_wherever_any_value_is_taken() {
    let server = Server::fresh();
    new_cohort(&server, "body", "landmarks");
    for field in ["metadata", "labels", "landmarks", "landmark_index", "points"] {
        let deep = format!("{}{}", "[".repeat(10_000), "]".repeat(10_000));
        let body = format!(r#"{{"shapes":[{{"{field}":{deep},"points":{QUAD}}}]}}"#);
        let reply = server.post_bytes("/v1/cohorts/body/shapes", JSON, body);
        assert!(matches!(reply.status, 400 | 422), "{field}: {}", reply.text());
        let reply = server.post_bytes("/v1/cohorts/body/shapes", NDJSON, format!(r#"{{"{field}":{deep}}}"#));
        assert!(matches!(reply.status, 400 | 422), "{field}: {}", reply.text());
    }
    assert_untouched(&server, "body");
    server.assert_alive();
}

#[test]
fn large_bodies_are_refused_also_when_they_are_packed() {
    let server = Setting::fresh().flags(&["--max-body-bytes", "100000", "--max-line-bytes", "5000"]).start();
    new_cohort(&server, "body", "landmarks");
    let mut shapes = vec![OTHER; 3000];
    shapes.push(GOOD);
    let shapes = shapes.join(",");
    let mean =
        format!(r#"{{"representation":{REPRESENTATION},"transformation":"similarity","shapes":[{shapes}]}}"#);
    let add = format!(r#"{{"shapes":[{shapes}]}}"#);
    let bomb = gzip(format!("{}{mean}", " ".repeat(200 << 20)).as_bytes());
    assert!(bomb.len() < 1 << 20);
    for (path, body) in [("/v1/mean", &mean), ("/v1/cohorts/body/shapes", &add), ("/v1/cohorts", &mean)] {
        let reply = server.post_bytes(path, JSON, body.as_str());
        reply.expect_problem(413, "payload-too-large", &[]);
        for packed in [gzip(body.as_bytes()), bomb.clone()] {
            let request = server.request(Method::POST, path).header(CONTENT_TYPE, JSON);
            let reply = server.send(request.header(CONTENT_ENCODING, "gzip").body(packed));
            reply.expect_problem(413, "payload-too-large", &[]);
        }
    }
    // A body just within the limit is read.
    let small = format!(r#"{{"shapes":[{GOOD}]}}"#);
    let padded = format!("{}{small}", " ".repeat(100_000 - small.len()));
    server.post_bytes("/v1/resample", JSON, format!("{padded} ")).expect_problem(
        413,
        "payload-too-large",
        &[],
    );
    server.post_bytes("/v1/resample", JSON, padded).expect(422);

    // A stream is bounded by its lines.
    let path = "/v1/cohorts/body/shapes";
    let long = format!(r#"{{"label":"{}","points":{QUAD}}}"#, "x".repeat(6000));
    for text in [format!("{GOOD}\n{GOOD}\n{long}\n{GOOD}"), format!("{GOOD}\n{GOOD}\n{long}")] {
        let problem = server.post_bytes(path, NDJSON, text).expect(413);
        assert_eq!(problem["code"], "payload-too-large");
        assert!(problem["detail"].as_str().unwrap().contains("line 3"), "{problem}");
        assert_eq!(problem["errors"][0]["line"], 3, "{problem}");
    }
    let request = server.request(Method::POST, path).header(CONTENT_TYPE, NDJSON);
    let endless = server.send(request.header(CONTENT_ENCODING, "gzip").body(gzip(&vec![b' '; 50 << 20])));
    assert_eq!(endless.status, 413, "{}", endless.text());
    assert_untouched(&server, "body");
    server.assert_alive();
}

#[test]
fn the_refusal_of_a_large_body_reaches_a_client_that_sends_first_and_reads_later() {
    let server = Setting::fresh().flags(&["--max-body-bytes", "100000"]).start();
    let address = server.address().trim_start_matches("http://");
    let body = vec![b' '; 30 << 20];
    for round in 0..20 {
        let mut stream = TcpStream::connect(address).unwrap();
        let head = format!(
            "POST /v1/mean HTTP/1.1\r\nhost: {address}\r\ncontent-type: {JSON}\r\nconnection: close\r\n\
             content-length: {}\r\n\r\n",
            body.len()
        );
        stream.write_all(head.as_bytes()).unwrap();
        let sent = stream.write_all(&body);
        let mut answer = String::new();
        let read = stream.read_to_string(&mut answer);
        assert!(answer.starts_with("HTTP/1.1 413 "), "round {round}: {sent:?}, {read:?}, {answer:?}");
    }
    server.assert_alive();
}

#[test]
fn a_stream_may_be_longer_than_the_largest_body() {
    let server = Setting::fresh().flags(&["--max-body-bytes", "100000"]).start();
    new_cohort(&server, "body", "landmarks");
    let text = format!("{GOOD}\n").repeat(10_000);
    assert_eq!(server.post_bytes("/v1/cohorts/body/shapes", NDJSON, text).expect(201)["added"], 10_000);
}

#[test]
fn broken_encodings_are_refused() {
    let server = Server::fresh();
    new_cohort(&server, "body", "landmarks");
    let body = format!(
        r#"{{"representation":{REPRESENTATION},"transformation":"similarity","shapes":[{GOOD},{OTHER}]}}"#
    );
    let packed = gzip(body.as_bytes());
    let mut flipped = packed.clone();
    let middle = flipped.len() / 2;
    flipped[middle] ^= 0xff;
    let mut trailer = packed.clone();
    let last = trailer.len() - 5;
    trailer[last] ^= 0xff;
    let followed = |after: &[u8]| [&packed[..], after].concat();
    let bodies = [
        b"not gzip".to_vec(),
        packed[..packed.len() / 2].to_vec(),
        flipped,
        trailer,
        packed[..5].to_vec(),
        followed(b"x"),
        followed(body.as_bytes()),
        followed(&packed[..packed.len() - 4]),
    ];
    for (path, media_type) in
        [("/v1/mean", JSON), ("/v1/cohorts/body/shapes", JSON), ("/v1/cohorts/body/shapes", NDJSON)]
    {
        for (i, bytes) in bodies.iter().enumerate() {
            let request = server.request(Method::POST, path).header(CONTENT_TYPE, media_type);
            let reply = server.send(request.header(CONTENT_ENCODING, "gzip").body(bytes.clone()));
            assert_eq!(reply.status, 400, "{path} {media_type} body {i}: {}", reply.text());
        }
        let request = server.request(Method::POST, path).header(CONTENT_TYPE, media_type);
        let reply = server.send(request.header(CONTENT_ENCODING, "br").body("x"));
        reply.expect_problem(415, "unsupported-media-type", &[]);
        assert_eq!(reply.header("accept-encoding"), Some("gzip"));
        let request = server.request(Method::POST, path).header(CONTENT_TYPE, media_type);
        let twice = request.header(CONTENT_ENCODING, "gzip").header(CONTENT_ENCODING, "gzip");
        server.send(twice.body(packed.clone())).expect_problem(415, "unsupported-media-type", &[]);
    }
    assert_untouched(&server, "body");
    server.assert_alive();
}

#[test]
fn other_media_types_methods_routes_and_formats_are_refused() {
    let server = Server::fresh();
    new_cohort(&server, "body", "landmarks");
    let posts = [
        "/v1/project",
        "/v1/mean",
        "/v1/align",
        "/v1/pca",
        "/v1/evaluate",
        "/v1/measure",
        "/v1/resample",
        "/v1/cohorts",
        "/v1/cohorts/body/shapes",
    ];
    for path in posts {
        for media_type in
            ["text/plain", "text/csv", "application/xml", "multipart/form-data; boundary=x", "nonsense"]
        {
            // Files of these types are shapes.
            let takes_files = ["/shapes", "/project", "/measure"].iter().any(|end| path.ends_with(end));
            if takes_files && shapelex_formats::shape::find(media_type).is_some() {
                continue;
            }
            let reply = server.post_bytes(path, media_type, "{}");
            reply.expect_problem(415, "unsupported-media-type", &[]);
        }
        let bare = server.send(server.request(Method::POST, path).body("{}"));
        bare.expect_problem(415, "unsupported-media-type", &[]);
        if !["shapes", "project", "measure"].iter().any(|end| path.ends_with(end)) {
            let reply = server.post_bytes(path, NDJSON, "{}");
            reply.expect_problem(415, "unsupported-media-type", &[]);
        }
        // JSON by other names.
        for media_type in ["application/json; charset=utf-8", "Application/JSON"] {
            assert_eq!(server.post_bytes(path, media_type, "{}").status, 422, "{path} {media_type}");
        }
        for method in [Method::PUT, Method::PATCH, Method::DELETE] {
            if method != Method::PUT && path.ends_with("shapes") {
                continue;
            }
            let reply = server.send(server.request(method.clone(), path));
            reply.expect_problem(405, "method-not-allowed", &[]);
            assert!(reply.header("allow").is_some_and(|allow| allow.contains("POST")), "{method} {path}");
        }
    }
    for path in
        ["/v1/formats", "/v1/generators", "/v1/transformations", "/livez", "/readyz", "/v1/cohorts/body/mean"]
    {
        let reply = server.post(path, &json!({}));
        reply.expect_problem(405, "method-not-allowed", &[]);
        assert!(reply.header("allow").is_some_and(|allow| allow.contains("GET")), "{path}");
    }
    for path in
        ["/v1", "/v1/", "/v2/mean", "/v1/mean/", "/v1/means", "/nothing", "/v1/cohorts/", "/%00", "/%ff"]
    {
        for method in [Method::GET, Method::POST, Method::DELETE] {
            let reply = server.send(server.request(method.clone(), path));
            reply.expect_problem(404, "route-not-found", &[]);
        }
    }
    for path in [
        "/v1/cohorts/none",
        "/v1/cohorts/none/shapes",
        "/v1/cohorts/body/shapes/none",
        "/v1/cohorts/%2e%2e%2f",
    ] {
        server.get(path).expect_problem(404, "not-found", &[]);
    }
    server.get("/v1/cohorts/none/mean?transformation=affine").expect_problem(404, "not-found", &[]);
    server.post("/v1/cohorts/none/shapes", &json!({"shapes": []})).expect_problem(404, "not-found", &[]);
    server.get("/v1/cohorts/%ff").expect_problem(400, "invalid-query", &[]);

    let body = statistics("similarity", "landmarks", &[GOOD, OTHER]);
    for path in ["/v1/mean", "/v1/align", "/v1/pca", "/v1/evaluate"] {
        let reply = server.send(server.request(Method::POST, path).header(ACCEPT, "text/turtle").json(&body));
        reply.expect_problem(406, "not-acceptable", &[]);
        server.post(&format!("{path}?format=ttl"), &body).expect_problem(400, "invalid-query", &[]);
        server.post(&format!("{path}?format="), &body).expect_problem(400, "invalid-query", &[]);
    }
    for path in ["/v1/cohorts/body/mean?transformation=affine", "/v1/cohorts/body/shapes/x?a=b"] {
        let reply = server.send(server.request(Method::GET, path).header(ACCEPT, "text/turtle"));
        assert!(matches!(reply.status, 400 | 406), "{path}: {}", reply.text());
        server.get(&format!("{path}&format=xml")).expect_problem(400, "invalid-query", &[]);
    }
    assert_untouched(&server, "body");
    server.assert_alive();
}

#[test]
fn bad_queries_are_refused() {
    let server = Server::fresh();
    new_cohort(&server, "body", "landmarks");
    let gets = [
        "/v1/cohorts?limit=0",
        "/v1/cohorts?limit=1001",
        "/v1/cohorts?limit=-1",
        "/v1/cohorts?limit=many",
        "/v1/cohorts?limit=1.5",
        "/v1/cohorts?limit=",
        "/v1/cohorts?limit=99999999999999999999999",
        "/v1/cohorts?cursor=nonsense",
        "/v1/cohorts?colour=red",
        "/v1/cohorts?limit=1&limit=2",
        "/v1/cohorts/body?colour=red",
        "/v1/cohorts/body/shapes?limit=0",
        "/v1/cohorts/body/shapes?limit=1001",
        "/v1/cohorts/body/shapes?limit=many",
        "/v1/cohorts/body/shapes?cursor=nonsense",
        "/v1/cohorts/body/shapes?cursor=",
        "/v1/cohorts/body/shapes?cursor=-1-1",
        "/v1/cohorts/body/shapes?cursor=ffffffffffffffffffff-0",
        "/v1/cohorts/body/shapes?colour=red",
        "/v1/cohorts/body/shapes?lable=x",
        "/v1/cohorts/body/shapes?label.gte=a&label.gte=b",
        "/v1/cohorts/body/mean",
        "/v1/cohorts/body/mean?transformation=twist",
        "/v1/cohorts/body/mean?transformation=",
        "/v1/cohorts/body/mean?transformation=affine&frame=front",
        "/v1/cohorts/body/mean?transformation=affine&alignment=left",
        "/v1/cohorts/body/mean?transformation=affine&colour=red",
        "/v1/cohorts/body/mean?transformation=affine&transformation=similarity",
        "/v1/formats?colour=red",
        "/v1/generators?colour=red",
        "/v1/transformations?colour=red",
    ];
    let mut differences = Differences::default();
    for path in gets {
        differences.compare(path, &server.get(path), &Wanted::new(400, "invalid-query", &[]));
    }
    let body = statistics("similarity", "landmarks", &[GOOD, OTHER]);
    let posts = [
        "/v1/mean?colour=red",
        "/v1/mean?fromat=svg",
        "/v1/align?colour=red",
        "/v1/pca?colour=red",
        "/v1/project?colour=red",
        "/v1/pca?format=svg&component=0",
        "/v1/pca?format=svg&component=99",
        "/v1/pca?component=x",
        "/v1/pca?component=-1",
        "/v1/pca?sigma=11",
        "/v1/pca?sigma=-1",
        "/v1/pca?sigma=NaN",
        "/v1/pca?sigma=inf",
        "/v1/pca?sigma=x",
    ];
    for path in posts {
        let mut body = body.clone();
        if path.starts_with("/v1/project") {
            body["reference"] = body["shapes"][0].clone();
        }
        differences.compare(path, &server.post(path, &body), &Wanted::new(400, "invalid-query", &[]));
    }
    for query in ["on_error=ignore", "on_error=", "colour=red", "on_error=skip&on_error=abort"] {
        let path = format!("/v1/cohorts/body/shapes?{query}");
        let reply = server.post(&path, &json!({"shapes": body["shapes"]}));
        differences.compare(&path, &reply, &Wanted::new(400, "invalid-query", &[]));
    }
    // Attributes with any name are asked for without harm.
    for key in [
        "labels.",
        "labels.%22",
        "labels.%22%5D",
        "labels.a.b",
        "labels.%27%3B--",
        "labels.%5C",
        "labels.%00",
    ] {
        let page = server.get(&format!("/v1/cohorts/body/shapes?{key}=1"));
        assert!(matches!(page.status, 200 | 400), "{key}: {}", page.text());
        let mean = server.get(&format!("/v1/cohorts/body/mean?transformation=affine&{key}=1"));
        assert!(matches!(mean.status, 422 | 400), "{key}: {}", mean.text());
    }
    drop(differences);
    assert_untouched(&server, "body");
    server.assert_alive();
}

// ---------------------------------------------------------------- streams

#[test]
fn the_bad_line_of_a_long_stream_is_named_and_nothing_is_stored() {
    let server = Server::fresh();
    new_cohort(&server, "body", "landmarks");
    let path = "/v1/cohorts/body/shapes";
    let mut lines = vec![GOOD; 10_000];
    lines[499] = r#"{"points":[[2,0],[0,1],[-2,"x"],[0,-1]]}"#;
    let problem = server.post_bytes(path, NDJSON, lines.join("\n")).expect(422);
    let wanted = json!([{"pointer": "/points/2/1", "line": 500, "index": 499, "detail": problem["errors"][0]["detail"]}]);
    assert_eq!(problem["errors"], wanted);
    assert_untouched(&server, "body");

    // In a later block of the stream, when good ones were written already.
    lines[499] = GOOD;
    lines[9_999] = r#"{"points":[[2,0],[0,1],[-2,0]"#;
    let reply = server.post_bytes(path, NDJSON, lines.join("\n"));
    assert!(matches!(reply.status, 400 | 422), "{}", reply.text());
    let problem = reply.json();
    let error = &problem["errors"][0];
    assert_eq!((&error["line"], &error["index"]), (&json!(10_000), &json!(9_999)), "{problem}");
    assert_untouched(&server, "body");

    // Not UTF-8.
    let mut bytes = format!("{GOOD}\n").repeat(5).into_bytes();
    bytes.extend(b"{\"label\":\"\xc3\x28\"}\n");
    let problem = server.post_bytes(path, NDJSON, bytes).json();
    assert_eq!(problem["errors"][0]["line"], 6, "{problem}");

    // Two shapes with one id and other content, thousands of lines apart.
    let mut lines: Vec<String> =
        (0..9000).map(|i| format!(r#"{{"external_id":"s{i}","points":{QUAD}}}"#)).collect();
    lines[8500] = r#"{"external_id":"s17","points":[[5,0],[0,1],[-2,0],[0,-1]]}"#.into();
    let problem = server.post_bytes(path, NDJSON, lines.join("\n")).expect(409);
    let error = &problem["errors"][0];
    assert_eq!((&error["line"], &error["index"]), (&json!(8501), &json!(8500)), "{problem}");
    assert_eq!(error["pointer"], "/external_id", "{problem}");
    assert_untouched(&server, "body");

    for nothing in ["", "\n\n  \n", "\r\n"] {
        server.post_bytes(path, NDJSON, nothing).expect_problem(422, "too-few-shapes", &[]);
    }
    server.post(path, &json!({"shapes": []})).expect_problem(422, "too-few-shapes", &[]);
    assert_untouched(&server, "body");
    // After all this the good lines are stored.
    lines[8500] = GOOD.into();
    let answer = server.post_bytes(path, NDJSON, lines.join("\n")).expect(201);
    assert_eq!((&answer["added"], &answer["revision"]), (&json!(9000), &json!(1)));
}

#[test]
fn the_good_shapes_are_stored_when_the_bad_ones_may_be_skipped() {
    let server = Server::fresh();
    new_cohort(&server, "body", "landmarks");
    let mut lines = vec![GOOD; 6000];
    let bad: Vec<usize> = (0..150).map(|i| 40 * i + 3).collect();
    for &line in &bad {
        lines[line] = if line % 3 == 0 {
            "{\"points\":[[1"
        } else {
            r#"{"points":[[1,0],null,[1,1],[0,1]],"weight":1}"#
        };
    }
    let path = "/v1/cohorts/body/shapes?on_error=skip";
    let answer = server.post_bytes(path, NDJSON, lines.join("\n")).expect(201);
    assert_eq!((&answer["added"], &answer["skipped"]), (&json!(5850), &json!(150)));
    let results = answer["results"].as_array().unwrap();
    assert_eq!((results.len(), &answer["unlisted"]), (6000, &json!(0)));
    for (index, result) in results.iter().enumerate() {
        assert_eq!(result["index"], index, "{result}");
        let error = &result["error"]["errors"][0];
        if bad.contains(&index) {
            assert_eq!((&error["index"], &error["line"]), (&json!(index), &json!(index + 1)), "{result}");
        } else {
            assert!(error.is_null() && result["id"].is_string(), "{result}");
        }
    }
    let shapes: Vec<Value> =
        [GOOD, r#"{"points":[[1,0]]}"#, OTHER].iter().map(|s| serde_json::from_str(s).unwrap()).collect();
    let answer = server.post(path, &json!({ "shapes": shapes })).expect(201);
    assert_eq!((&answer["added"], &answer["skipped"]), (&json!(2), &json!(1)));
    assert_eq!(answer["results"][1]["error"]["errors"][0]["pointer"], "/shapes/1/points");
    // Nothing good at all: an answer, and no new revision.
    let answer = server.post_bytes(path, NDJSON, "{}\n{}").expect(201);
    assert_eq!(
        (&answer["added"], &answer["skipped"], &answer["revision"]),
        (&json!(0), &json!(2), &json!(2))
    );
}

#[test]
fn a_stream_that_breaks_off_leaves_nothing_behind() {
    let server = Server::fresh();
    new_cohort(&server, "body", "landmarks");
    let address = server.address().trim_start_matches("http://");
    let lines = format!("{GOOD}\n").repeat(9000);
    for (announced, sent) in
        [(lines.len(), lines.len() - 1000), (lines.len(), 100), (lines.len() + 1, lines.len())]
    {
        let mut stream = TcpStream::connect(address).unwrap();
        let head = format!(
            "POST /v1/cohorts/body/shapes HTTP/1.1\r\nhost: {address}\r\ncontent-type: {NDJSON}\r\n\
             content-length: {announced}\r\n\r\n"
        );
        stream.write_all(head.as_bytes()).unwrap();
        stream.write_all(&lines.as_bytes()[..sent]).unwrap();
        drop(stream);
    }
    // A chunked body whose last chunk never comes.
    let mut stream = TcpStream::connect(address).unwrap();
    let head = format!(
        "POST /v1/cohorts/body/shapes HTTP/1.1\r\nhost: {address}\r\ncontent-type: {NDJSON}\r\n\
         transfer-encoding: chunked\r\n\r\n{:x}\r\n{lines}\r\n",
        lines.len()
    );
    stream.write_all(head.as_bytes()).unwrap();
    drop(stream);
    // The server notices in its own time; nothing may appear at any of them.
    for _ in 0..10 {
        assert_untouched(&server, "body");
        std::thread::sleep(Duration::from_millis(30));
    }
    // The same shapes are then no conflict and no repetition.
    assert_eq!(server.post_bytes("/v1/cohorts/body/shapes", NDJSON, lines).expect(201)["added"], 9000);
    server.assert_alive();
}

// ---------------------------------------------------------------- any body at all

/// A small generator of pseudo-random numbers (splitmix64): the same bodies on every machine.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn below(&mut self, n: usize) -> usize {
        (self.next() % n as u64) as usize
    }

    fn pick<'a, T>(&mut self, items: &'a [T]) -> &'a T {
        &items[self.below(items.len())]
    }
}

fn junk(random: &mut Random) -> Value {
    let numbers =
        [0.0, -0.0, 1.0, -1.0, 0.5, 3.0, 1e-320, 1e-300, 1e-30, 1e30, 1e99, -1e100, 1e154, 1e308, f64::MAX];
    match random.below(16) {
        0 => Value::Null,
        1 => json!(random.below(2) == 0),
        2 => json!(random.next()),
        3 => json!(random.next() as i64),
        4 => json!(random.below(10)),
        5 => json!(""),
        6 => json!("\u{0}\u{202e}é'\"; DROP TABLE shape; --"),
        7 => json!([]),
        8 => json!({}),
        9 => json!([[random.below(5), 1], [0, 1], [2, 3], [4, 1]]),
        10 => json!([[[1, 0], [0, random.below(3)]]]),
        11 => {
            let words = [
                "affine",
                "similarity",
                "rigid",
                "procrustes",
                "cyclic",
                "arc_length",
                "canonical",
                "landmarks",
                "allow",
                "either",
                "cubic",
                "bspline",
                "linear",
                "translation",
                "shape",
            ];
            json!(random.pick(&words))
        }
        12 => json!({"name": "bspline", "degree": random.below(7)}),
        13 => json!({"kind": "landmarks", "dimension": 2 + random.below(2), "points": 4}),
        _ => json!(random.pick(&numbers)),
    }
}

/// Changes one thing at a random place.
fn mutate(value: &mut Value, random: &mut Random) {
    // The deeper, the likelier to stop.
    let descend = random.below(5) > 0;
    match value {
        Value::Object(map) if !map.is_empty() => {
            let keys: Vec<String> = map.keys().cloned().collect();
            let key = random.pick(&keys).clone();
            match random.below(12) {
                0 => drop(map.remove(&key)),
                1 => drop(map.insert(junk_key(random), junk(random))),
                2 => {
                    let copy = map[&key].clone();
                    let other = random.pick(&keys).clone();
                    map.insert(other, copy);
                }
                _ if descend => mutate(map.get_mut(&key).unwrap(), random),
                _ => drop(map.insert(key, junk(random))),
            }
        }
        Value::Array(items) if !items.is_empty() => {
            let i = random.below(items.len());
            match random.below(12) {
                0 => drop(items.remove(i)),
                1 => {
                    let copy = items[i].clone();
                    items.insert(random.below(items.len()), copy);
                }
                2 => items.truncate(i),
                _ if descend => mutate(&mut items[i], random),
                _ => items[i] = junk(random),
            }
        }
        Value::Number(_) if random.below(3) > 0 => {
            let numbers =
                [0.0, 1.0, -1.0, 1e-300, 1e-160, 1e-16, 1.0 + 1e-15, 1e8, 1e16, 1e50, 1e99, 1e100, 1e101];
            *value = json!(random.pick(&numbers));
        }
        other => *other = junk(random),
    }
}

fn junk_key(random: &mut Random) -> String {
    let keys = [
        "extra",
        "weight",
        "mirror",
        "frame",
        "alignment",
        "control_points",
        "components",
        "centre",
        "samples",
        "parameters",
        "derivatives",
        "onto",
        "label",
        "labels",
        "closed",
        "direction",
        "start",
    ];
    (*random.pick(&keys)).to_owned()
}

#[test]
fn no_body_breaks_the_service() {
    let server = Server::fresh();
    new_cohort(&server, "body", "landmarks");
    new_cohort(&server, "contours", "cyclic");
    let quad = |a: f64| json!({"points": [[a, 0], [0, 1], [-2, a / 5.0], [0, -1]], "weight": a});
    let shapes = json!([quad(2.0), quad(3.0), quad(1.0)]);
    let representation: Value = serde_json::from_str(REPRESENTATION).unwrap();
    let statistics = json!({"representation": representation, "transformation": "similarity",
        "correspondence": "landmarks", "direction": "given", "mirror": "forbid", "alignment": "projection",
        "frame": "training", "shapes": shapes});
    let curves = json!({"representation": representation, "correspondence": "cyclic", "shapes": shapes});
    let custom =
        changed(&statistics, "/transformation", json!({"matrices": [[[1, 0], [0, 1]]], "translation": true}));
    let spline = changed(&statistics, "/representation/generator", json!({"name": "bspline", "degree": 3}));
    let bodies = [
        ("/v1/mean", changed(&statistics, "/correspondence", json!("cyclic"))),
        ("/v1/mean?format=svg", statistics.clone()),
        ("/v1/align", changed(&statistics, "/mirror", json!("allow"))),
        ("/v1/align", changed(&statistics, "/alignment", json!("procrustes"))),
        ("/v1/pca", changed(&spline, "/components", json!(3))),
        ("/v1/pca?format=svg&component=1", changed(&spline, "/centre", json!(true))),
        ("/v1/project", changed(&custom, "/reference", quad(1.5))),
        (
            "/v1/project",
            changed(&changed(&statistics, "/reference", quad(1.5)), "/transformation", json!("affine")),
        ),
        ("/v1/evaluate", changed(&curves, "/derivatives", json!(2))),
        ("/v1/evaluate", changed(&curves, "/parameters", json!([0.1, 0.7]))),
        ("/v1/measure", curves.clone()),
        ("/v1/resample", json!({"count": 7, "start": "canonical", "shapes": shapes})),
        ("/v1/cohorts/body/shapes", json!({"shapes": shapes})),
        ("/v1/cohorts/contours/shapes", json!({"shapes": shapes})),
        ("/v1/cohorts", json!({"name": "x", "representation": representation, "length_unit": "mm"})),
    ];
    let mut random = Random(20_260_101);
    let mut taken = 0;
    for round in 0..2000 {
        let (path, good) = &bodies[round % bodies.len()];
        let mut body = good.clone();
        for _ in 0..=random.below(3) {
            mutate(&mut body, &mut random);
        }
        let reply = server.post(path, &body);
        // The client checks form, status below 500, and that no number was lost.
        let text = reply.text();
        assert!(!text.contains("NaN") && !text.contains("Infinity"), "{path} {body}: {text}");
        assert!(matches!(reply.status, 200 | 201 | 400 | 409 | 413 | 422), "{path} {body}: {text}");
        taken += usize::from(reply.status < 300);
    }
    assert!((100..1900).contains(&taken), "{taken} of 2000 bodies were taken");
    // What was stored of it can be read back.
    for cohort in ["body", "contours"] {
        let shapes = server.get(&format!("/v1/cohorts/{cohort}/shapes?limit=1000")).expect(200);
        assert!(!shapes["items"].as_array().unwrap().is_empty());
    }
    server.assert_alive();
}
