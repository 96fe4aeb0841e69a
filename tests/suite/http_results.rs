//! Answers about many shapes: one entry for each input, shapes without an answer, and lines in place of documents.

use reqwest::Method;
use reqwest::header::{ACCEPT, CONTENT_TYPE};
use serde_json::{Value, json};

use crate::server::{Reply, Server, Setting, pointers_of, shared};

const NDJSON: &str = "application/x-ndjson";
const POINTS: usize = 8;

/// Landmarks around an ellipse, other ones for every `k`.
fn ellipse(k: usize) -> Vec<[f64; 2]> {
    let point = |i: usize| {
        let (sin, cos) = (std::f64::consts::TAU * i as f64 / POINTS as f64).sin_cos();
        let noise = |n: usize| 0.05 * ((7 * k + 3 * i + n) as f64).sin();
        [2.0 * cos + noise(0), sin + noise(5)]
    };
    (0..POINTS).map(point).collect()
}

fn landmarks() -> Value {
    json!({"kind": "landmarks", "dimension": 2, "points": POINTS})
}

fn contour() -> Value {
    json!({"kind": "closed_curve", "dimension": 2, "control_points": POINTS, "generator": {"name": "trigonometric"}})
}

/// A service with the cohort `ellipses` and a dictionary `modes` with two classes.
fn with_dictionary() -> Server {
    let server = Setting::fresh().start();
    server.post("/v1/cohorts", &json!({"name": "ellipses", "representation": landmarks()})).expect(201);
    let shape = |k: usize| {
        let label = if k.is_multiple_of(2) { "even" } else { "odd" };
        json!({"points": ellipse(k), "external_id": format!("e{k}"), "label": label})
    };
    let shapes: Vec<Value> = (0..24).map(shape).collect();
    server.post("/v1/cohorts/ellipses/shapes", &json!({ "shapes": shapes })).expect(201);
    let body = json!({"name": "modes", "cohort": "ellipses", "transformation": "similarity",
        "method": {"kind": "functional_pca", "components": 3, "centre": true},
        "classifier": {"kind": "discriminant", "attribute": "label", "repeats": 1}});
    let learn = server.request(Method::POST, "/v1/dictionaries").header("prefer", "wait=50").json(&body);
    server.send(learn).expect(201);
    server
}

/// Three good shapes among four that have no answer: unreadable, of another width, too few points, a single point.
fn mixed() -> Vec<Value> {
    vec![
        json!({"points": ellipse(30), "external_id": "first"}),
        json!({"points": "none", "external_id": "text"}),
        json!({"points": ellipse(31)}),
        json!({"points": vec![[1.0, 2.0, 3.0]; POINTS], "external_id": "space"}),
        json!({"points": [[0, 0]]}),
        json!({"points": vec![[5.0, 7.0]; POINTS], "external_id": "dot"}),
        json!({"points": ellipse(32), "external_id": "last"}),
    ]
}

const GOOD: [usize; 3] = [0, 2, 6];

/// Checks that `found` has one entry for each of the shapes, with those of `wanted` for the good ones.
fn check_entries(what: &str, found: &Value, shapes: &[Value], wanted: &Value, dot: Option<&str>) {
    let entries = found["results"].as_array().unwrap();
    assert_eq!(entries.len(), shapes.len(), "{what}: {found}");
    let mut wanted = wanted["results"].as_array().unwrap().iter();
    for (index, (entry, shape)) in entries.iter().zip(shapes).enumerate() {
        assert_eq!(entry["index"], index, "{what}");
        assert_eq!(entry["external_id"], shape["external_id"], "{what}: {entry}");
        if GOOD.contains(&index) || (dot.is_none() && index == 5) {
            let mut expected = wanted.next().unwrap().clone();
            expected["index"] = json!(index);
            assert_eq!(entry, &expected, "{what}");
            continue;
        }
        let code = if index == 5 { dot.unwrap() } else { "invalid-input" };
        assert_eq!(entry["error"]["code"], code, "{what}: {entry}");
        assert!(!entry["error"]["detail"].as_str().unwrap().is_empty(), "{what}: {entry}");
        for fault in entry["error"]["errors"].as_array().unwrap() {
            assert_eq!(fault["index"], index, "{what}: {fault}");
            let pointer = fault["pointer"].as_str().unwrap();
            assert!(pointer.starts_with(&format!("/shapes/{index}")), "{what}: {fault}");
        }
        let fields = entry.as_object().unwrap().keys().filter(|name| *name != "external_id").count();
        assert_eq!(fields, 2, "{what}: no answer beside an error: {entry}");
    }
}

#[test]
fn a_bad_shape_leaves_the_answers_of_a_dictionary() {
    let server = with_dictionary();
    let shapes = mixed();
    for (what, dot) in [
        ("encode", Some("degenerate-shape")),
        ("reconstruct", Some("degenerate-shape")),
        ("score", Some("degenerate-shape")),
        ("classify", Some("degenerate-shape")),
        ("assess", Some("degenerate-shape")),
        ("prior", None),
    ] {
        let path = format!("/v1/dictionaries/modes/{what}");
        let good: Vec<&Value> = shapes
            .iter()
            .enumerate()
            .filter(|(index, _)| GOOD.contains(index) || (dot.is_none() && *index == 5))
            .map(|(_, shape)| shape)
            .collect();
        let wanted = server.post(&path, &json!({ "shapes": good })).expect(200);
        let found = server.post(&format!("{path}?on_error=skip"), &json!({ "shapes": shapes })).expect(200);
        assert_eq!(found["dictionary"], wanted["dictionary"], "{what}");
        check_entries(what, &found, &shapes, &wanted, dot);
        // Without it, the request is refused, with all that is wrong.
        for query in ["", "?on_error=abort"] {
            let problem = server.post(&format!("{path}{query}"), &json!({ "shapes": shapes })).expect(422);
            let named = ["/shapes/1", "/shapes/3", "/shapes/4"];
            for (pointer, start) in pointers_of(&problem).iter().zip(named) {
                assert!(pointer.starts_with(start), "{what}: {problem}");
            }
        }
        if dot.is_some() {
            let problem = server.post(&path, &json!({"shapes": [good[0], shapes[5]]}));
            let problem = problem.expect_problem(422, "degenerate-shape", &["/shapes/1"]);
            assert_eq!(problem["errors"][0]["index"], 1);
        }
    }
}

#[test]
fn stored_shapes_are_named_and_missing_ones_have_errors() {
    let server = with_dictionary();
    let body = json!({"cohort": "ellipses", "ids": ["e3", "nobody", "e5"]});
    let path = "/v1/dictionaries/modes/score";
    server.post(path, &body).expect_problem(422, "invalid-input", &["/ids/1"]);
    let found = server.post(&format!("{path}?on_error=skip"), &body).expect(200);
    let wanted = server.post(path, &json!({"cohort": "ellipses", "ids": ["e3", "e5"]})).expect(200);
    for (place, index) in [(0, 0), (1, 2)] {
        let mut expected = wanted["results"][place].clone();
        expected["index"] = json!(index);
        assert_eq!(found["results"][index], expected);
        assert!(expected["id"].as_str().unwrap().starts_with("shp_"), "{expected}");
    }
    let error = &found["results"][1]["error"];
    assert_eq!(error["errors"][0]["pointer"], "/ids/1", "{error}");
    assert!(error["detail"].as_str().unwrap().contains("'nobody' not found"), "{error}");
}

#[test]
fn codes_that_do_not_fit_have_errors() {
    let server = with_dictionary();
    let good = json!({"indices": [0, 2], "values": [0.5, -1.0]});
    let body = json!({"codes": [good, {"indices": [0, 99], "values": [1.0, 1.0]}, good]});
    let path = "/v1/dictionaries/modes/reconstruct";
    server.post(path, &body).expect(422);
    let found = server.post(&format!("{path}?on_error=skip"), &body).expect(200);
    assert_eq!(found["results"][0]["control_points"], found["results"][2]["control_points"]);
    let fault = &found["results"][1]["error"]["errors"][0];
    assert!(fault["pointer"].as_str().unwrap().starts_with("/codes/1/indices"), "{found}");
}

/// Requests about posted shapes without a dictionary, as path and settings.
fn stateless() -> [(&'static str, Value, Option<&'static str>); 3] {
    let reference = json!({"points": ellipse(40)});
    [
        (
            "project",
            json!({"representation": contour(), "transformation": "similarity", "reference": reference}),
            Some("degenerate-shape"),
        ),
        ("measure", json!({"representation": contour(), "length_unit": "mm"}), None),
        (
            "fit",
            json!({"representation": {"kind": "closed_curve", "dimension": 2, "control_points": 5,
                "generator": {"name": "trigonometric"}}}),
            Some("invalid-input"),
        ),
    ]
}

fn with_shapes(settings: &Value, shapes: &[Value]) -> Value {
    let mut body = settings.clone();
    body["shapes"] = json!(shapes);
    body
}

#[test]
fn a_bad_shape_leaves_projections_measures_and_fits() {
    let server = shared();
    let shapes = mixed();
    for (what, settings, dot) in stateless() {
        let path = format!("/v1/{what}");
        let good: Vec<Value> = (0..shapes.len())
            .filter(|index| GOOD.contains(index) || (dot.is_none() && *index == 5))
            .map(|index| shapes[index].clone())
            .collect();
        let wanted = server.post(&path, &with_shapes(&settings, &good)).expect(200);
        let skipping = format!("{path}?on_error=skip");
        let found = server.post(&skipping, &with_shapes(&settings, &shapes)).expect(200);
        check_entries(what, &found, &shapes, &wanted, dot);
        server.post(&path, &with_shapes(&settings, &shapes)).expect(422);
        // Settings that are wrong, and too few shapes, are refused in any case.
        let mut wrong = with_shapes(&settings, &shapes);
        wrong["representation"]["dimension"] = json!(7);
        server.post(&skipping, &wrong).expect(422);
        server.post(&skipping, &with_shapes(&settings, &[])).expect_problem(422, "too-few-shapes", &[]);
    }
    let (_, settings, _) = &stateless()[1];
    assert_eq!(
        server.post("/v1/measure", &with_shapes(settings, &mixed()[..1])).expect(200)["length_unit"],
        "mm"
    );
}

#[test]
fn surfaces_and_meshes_without_an_answer_have_errors_too() {
    let server = shared();
    let representation =
        json!({"kind": "subdivision", "scheme": "loop", "connectivity": "octahedron", "level": 2});
    let octahedron = [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]];
    let body = json!({"representation": representation, "shapes": [{"points": octahedron}, {"points": [[1, 0, 0]]}]});
    let found = server.post("/v1/measure?on_error=skip", &body).expect(200);
    assert!(found["results"][0]["volume"].as_f64().unwrap() > 0.1, "{found}");
    assert_eq!(found["results"][1]["error"]["code"], "invalid-input", "{found}");
    let faces = [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]];
    let mesh = json!({"vertices": octahedron, "faces": faces});
    let open = json!({"vertices": octahedron, "faces": faces[..3]});
    let body = json!({"representation": {"kind": "surface", "topology": "sphere", "control_points": [3, 3]},
        "meshes": [open, mesh]});
    server.post("/v1/fit", &body).expect(422);
    let found = server.post("/v1/fit?on_error=skip", &body).expect(200);
    let pointer = &found["results"][0]["error"]["errors"][0]["pointer"];
    assert!(pointer.as_str().unwrap().starts_with("/meshes/0"), "{found}");
    assert!(found["results"][1]["residual"].is_number(), "{found}");
}

// ---------------------------------------------------------------- lines

/// Sends shapes as lines, and asks for `accept`.
fn send_lines(server: &Server, target: &str, lines: &str, accept: &str) -> Reply {
    let request = server.request(Method::POST, target).header(CONTENT_TYPE, NDJSON).header(ACCEPT, accept);
    server.send(request.body(lines.to_owned()))
}

fn as_lines(shapes: &[Value]) -> String {
    shapes.iter().map(|shape| format!("{shape}\n")).collect()
}

/// Values of the lines of an answer.
fn lines_of(reply: &Reply) -> Vec<Value> {
    assert_eq!((reply.status, reply.header("content-type")), (200, Some(NDJSON)), "{}", reply.text());
    reply.text().lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// Settings as parameters of a query, in the form of URLs.
fn query_of(settings: &Value) -> String {
    let encoded = |value: &Value| {
        let text = value.as_str().map_or_else(|| value.to_string(), str::to_owned);
        text.bytes().map(|byte| format!("%{byte:02X}")).collect::<String>()
    };
    let pairs = settings.as_object().unwrap().iter();
    pairs.map(|(name, value)| format!("&{name}={}", encoded(value))).collect()
}

#[test]
fn lines_are_answered_as_documents_are() {
    let server = with_dictionary();
    let shapes = mixed();
    let dictionary = |what: &str, settings: Value| (format!("/v1/dictionaries/modes/{what}"), settings);
    let mut cases = vec![
        dictionary("encode", json!({})),
        dictionary("score", json!({"quantile": 0.9})),
        dictionary("classify", json!({"quantile": 0.9})),
        dictionary("assess", json!({"samples": 4, "quantile": 0.95})),
        dictionary("reconstruct", json!({"pose": "model"})),
        dictionary("prior", json!({"gamma": 0.5, "reference": "mean"})),
    ];
    cases.extend(stateless().map(|(what, settings, _)| (format!("/v1/{what}"), settings)));
    for (path, settings) in cases {
        let document =
            server.post(&format!("{path}?on_error=skip"), &with_shapes(&settings, &shapes)).expect(200);
        let target = format!("{path}?on_error=skip{}", query_of(&settings));
        let mut common = document.clone();
        let wanted = common.as_object_mut().unwrap().remove("results").unwrap();
        // Lines to a document: only the places of faults differ.
        let found = send_lines(&server, &target, &as_lines(&shapes), "application/json").expect(200);
        for (entry, wanted) in found["results"].as_array().unwrap().iter().zip(wanted.as_array().unwrap()) {
            if wanted.get("error").is_none() {
                assert_eq!(entry, wanted, "{path}");
                continue;
            }
            let index = entry["index"].as_u64().unwrap();
            for fault in entry["error"]["errors"].as_array().unwrap() {
                assert_eq!(fault["line"], index + 1, "{path}: {fault}");
                assert!(!fault["pointer"].as_str().unwrap().contains("shapes"), "{path}: {fault}");
            }
        }
        // A document to lines: each has its entry and what is common to all.
        let body = with_shapes(&settings, &shapes);
        let request = server.request(Method::POST, &format!("{path}?on_error=skip")).header(ACCEPT, NDJSON);
        let lines = lines_of(&server.send(request.json(&body)));
        for (line, wanted) in lines.iter().zip(wanted.as_array().unwrap()) {
            let mut wanted = wanted.clone();
            wanted.as_object_mut().unwrap().extend(common.as_object().unwrap().clone());
            assert_eq!(line, &wanted, "{path}");
        }
        assert_eq!(lines.len(), shapes.len(), "{path}");
        assert_eq!(lines_of(&send_lines(&server, &target, &as_lines(&shapes), NDJSON)).len(), shapes.len());
    }
}

#[test]
fn faults_of_lines_are_at_their_lines() {
    let server = with_dictionary();
    let good = json!({"points": ellipse(50), "external_id": "a"}).to_string();
    let text = format!("\n{good}\r\n{{\"points\": [[1\n\n{{\"points\": [[0, 0], [1, \"x\"]]}}\n{good}");
    let path = "/v1/dictionaries/modes/assess";
    let problem =
        send_lines(&server, path, &text, "*/*").expect_problem(422, "invalid-input", &["", "/points/1/1"]);
    let places: Vec<_> =
        problem["errors"].as_array().unwrap().iter().map(|e| (&e["index"], &e["line"])).collect();
    assert_eq!(places, [(&json!(1), &json!(3)), (&json!(2), &json!(5))]);
    let lines = lines_of(&send_lines(&server, &format!("{path}?on_error=skip"), &text, NDJSON));
    assert_eq!(lines.len(), 4);
    assert!(lines[1]["error"]["detail"].as_str().unwrap().contains("not valid JSON"), "{}", lines[1]);
    assert_eq!(lines[2]["error"]["errors"][0]["pointer"], "/points/1/1");
    assert_eq!(lines[0]["code"], lines[3]["code"]);
    for (line, index) in lines.iter().zip(0..) {
        assert_eq!(line["index"], index);
        assert_eq!(
            (&line["dictionary"]["name"], &line["dictionary"]["version"]),
            (&json!("modes"), &json!(1))
        );
    }
    // A shape that only the computation finds to be bad.
    let dot = json!({"points": vec![[5.0, 7.0]; POINTS]}).to_string();
    let problem = send_lines(&server, path, &format!("{good}\n\n{dot}"), "*/*");
    let problem = problem.expect_problem(422, "degenerate-shape", &[""]);
    assert_eq!((&problem["errors"][0]["line"], &problem["errors"][0]["index"]), (&json!(3), &json!(1)));
}

#[test]
fn settings_in_the_query_are_refused_by_name() {
    let server = with_dictionary();
    let line = json!({"points": ellipse(50)}).to_string();
    let path = "/v1/dictionaries/modes/score";
    for (query, name, said) in [
        ("quantile=2", "quantile", "below 1"),
        ("quantile=high", "quantile", "expected a number"),
        ("colour=red", "colour", "expected one of the fields"),
        ("quantile=0.9&quantile=0.8", "quantile", "once"),
        ("shapes=[]", "shapes", "expected a parameter of this route"),
        ("on_error=stop", "on_error", "expected \"abort\" or \"skip\""),
        ("on_error=skip&on_error=skip", "on_error", "expected a parameter of this route"),
    ] {
        let reply = send_lines(&server, &format!("{path}?{query}"), &line, "*/*");
        assert!([400, 422].contains(&reply.status), "{query}: {}", reply.text());
        let fault = reply.json()["errors"][0].clone();
        assert_eq!(fault["parameter"], name, "{query}: {fault}");
        assert!(fault["detail"].as_str().unwrap().contains(said), "{query}: {fault}");
    }
    let representation = json!({"kind": "closed_curve", "dimension": 2, "control_points": 1,
        "generator": {"name": "trigonometric"}});
    let target = format!("/v1/measure?{}", &query_of(&json!({"representation": representation}))[1..]);
    let fault = send_lines(&server, &target, &line, "*/*").expect(422)["errors"][0].clone();
    assert_eq!(fault["parameter"], "representation", "{fault}");
    assert!(fault["detail"].as_str().unwrap().starts_with("/control_points: "), "{fault}");
    // A document has its settings in itself.
    let reply = server.post(&format!("{path}?quantile=0.9"), &json!({"shapes": [{"points": ellipse(50)}]}));
    assert_eq!(reply.expect(400)["errors"][0]["parameter"], "quantile");
    // Either shapes or ids; at least one shape; one of the two formats.
    send_lines(&server, &format!("{path}?cohort=ellipses&ids=[\"e1\"]"), &line, "*/*").expect(422);
    send_lines(&server, path, " \n\n", "*/*").expect_problem(422, "too-few-shapes", &[]);
    send_lines(&server, path, &line, "text/turtle").expect_problem(406, "not-acceptable", &[]);
    server.post_bytes(path, "application/xml", line).expect_problem(415, "unsupported-media-type", &[]);
}

#[test]
fn lines_have_the_limits_of_documents() {
    let server = Setting::fresh().flags(&["--max-shapes", "5"]).start();
    let settings = json!({"representation": contour()});
    let line = format!("{}\n", json!({"points": ellipse(1)}));
    let target = format!("/v1/measure?{}", &query_of(&settings)[1..]);
    send_lines(&server, &target, &line.repeat(5), "*/*").expect(200);
    let problem = send_lines(&server, &format!("{target}&on_error=skip"), &line.repeat(9), "*/*").expect(422);
    assert!(problem["detail"].as_str().unwrap().contains("at most 5 shapes, got 9"), "{problem}");
}

// ---------------------------------------------------------------- adding shapes

#[test]
fn added_shapes_are_matched_to_the_input() {
    let server = Server::fresh();
    server.post("/v1/cohorts", &json!({"name": "c", "representation": landmarks()})).expect(201);
    let shape = |k: usize| {
        let points = if k.is_multiple_of(2) { json!([[0, 0], [k, 0]]) } else { json!(ellipse(k)) };
        json!({"external_id": format!("s{k}"), "points": points})
    };
    let shapes: Vec<Value> = (0..300).map(shape).collect();
    let path = "/v1/cohorts/c/shapes?on_error=skip";
    let check = |answer: &Value, prefix: &dyn Fn(usize) -> (String, Option<usize>)| {
        let results = answer["results"].as_array().unwrap();
        assert_eq!((results.len(), &answer["skipped"], &answer["unlisted"]), (300, &json!(150), &json!(0)));
        for (index, result) in results.iter().enumerate() {
            assert_eq!(
                (&result["index"], &result["external_id"]),
                (&json!(index), &json!(format!("s{index}")))
            );
            if index.is_multiple_of(2) {
                let fault = &result["error"]["errors"][0];
                let (pointer, line) = prefix(index);
                assert_eq!(fault["pointer"], pointer, "{result}");
                assert_eq!(fault["line"], json!(line), "{result}");
                assert!(result.get("id").is_none(), "{result}");
            } else {
                let stored = server.get(&format!("/v1/cohorts/c/shapes/s{index}")).expect(200);
                assert!(result["id"] == stored["id"] && result.get("error").is_none(), "{result}");
            }
        }
    };
    let answer = server.post(path, &json!({ "shapes": shapes })).expect(201);
    check(&answer, &|index| (format!("/shapes/{index}/points"), None));
    let lines = as_lines(&shapes);
    let answer = server.post_bytes(path, NDJSON, lines.clone()).expect(201);
    assert_eq!(answer["added"], 0);
    check(&answer, &|index| ("/points".into(), Some(index + 1)));
    // Less is returned on request, but never less than the shapes that were not stored.
    let ids = server.post_bytes(&format!("{path}&return=ids"), NDJSON, lines.clone()).expect(201);
    assert_eq!(ids["results"].as_array().unwrap().len(), 150);
    for (index, id) in ids["ids"].as_array().unwrap().iter().enumerate() {
        assert_eq!(*id, answer["results"][index].get("id").cloned().unwrap_or_default(), "{index}");
    }
    let none = server.post_bytes(&format!("{path}&return=none"), NDJSON, lines).expect(201);
    assert!(none.get("ids").is_none());
    let refused: Vec<&Value> =
        none["results"].as_array().unwrap().iter().map(|entry| &entry["index"]).collect();
    assert_eq!(refused, (0..300).step_by(2).map(|i| json!(i)).collect::<Vec<_>>().iter().collect::<Vec<_>>());
    let good: Vec<&Value> = shapes.iter().skip(1).step_by(2).collect();
    let answer = server.post("/v1/cohorts/c/shapes", &json!({ "shapes": good })).expect(201);
    assert_eq!(answer["results"].as_array().unwrap().len(), 150);
    assert_eq!(answer["results"][1]["external_id"], "s3");
    server.post("/v1/cohorts/c/shapes?return=all", &json!({ "shapes": good })).expect(400);
}

#[test]
fn a_long_stream_is_answered_in_bounded_length_and_names_every_bad_line() {
    let server = Server::fresh();
    let representation = json!({"kind": "landmarks", "dimension": 2, "points": 2});
    server.post("/v1/cohorts", &json!({"name": "long", "representation": representation})).expect(201);
    let bad = |index: usize| index == 7 || index == 100_500;
    let line = |index: usize| {
        if bad(index) { "[]\n".into() } else { format!("{{\"points\":[[0,0],[1,{index}]]}}\n") }
    };
    let text: String = (0..101_000).map(line).collect();
    let answer = server.post_bytes("/v1/cohorts/long/shapes?on_error=skip", NDJSON, text).expect(201);
    assert_eq!((&answer["added"], &answer["skipped"]), (&json!(100_998), &json!(2)));
    let results = answer["results"].as_array().unwrap();
    assert_eq!((results.len(), &answer["unlisted"]), (100_001, &json!(999)));
    assert_eq!(answer.get("left_out"), None, "what a file holds beside its shapes, and nothing else");
    assert_eq!(results[7]["error"]["errors"][0]["line"], 8, "{}", results[7]);
    assert_eq!(results[100_000]["error"]["errors"][0]["line"], 100_501, "{}", results[100_000]);
    assert!(results[99_999]["id"].is_string());
}
