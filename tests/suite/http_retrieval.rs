//! Searches and distance matrices over HTTP against the real program.

use reqwest::Method;
use reqwest::header::ACCEPT;
use serde_json::{Value, json};

use crate::http_bad_input::{Differences, Wanted};
use crate::http_contract::cells;
use crate::http_dictionaries::{finished, job_when, submit};
use crate::server::{Reply, Server, Setting, flat};

const CELLS: &str = "/v1/cohorts/example-cells/search";
/// Shapes of the example cohort.
const COUNT: usize = 120;
/// Distances of equal shapes are rounding of this size.
const ROOT: f64 = 1e-7;

fn example() -> Server {
    Setting::fresh().with_example().start()
}

/// A server on which every matrix of a cohort is a job.
fn example_with_jobs() -> Server {
    Setting::fresh().with_example().flags(&["--max-matrix-operations", "1"]).start()
}

#[track_caller]
fn search(server: &Server, body: &Value) -> Vec<Vec<Value>> {
    let answer = server.post(CELLS, body).expect(200);
    let results = answer["results"].as_array().unwrap().iter();
    results.map(|result| result["neighbours"].as_array().unwrap().clone()).collect()
}

fn of_cells(transformation: &str) -> Value {
    json!({"cohort": "example-cells", "transformation": transformation})
}

fn matrix_in(server: &Server, format: &str, body: &Value) -> Reply {
    let path = format!("/v1/distances?format={format}");
    server.send(server.request(Method::POST, &path).header("prefer", "wait=50").json(body))
}

/// The numbers of an NPY file of a square matrix, whose header is checked.
#[track_caller]
fn npy(reply: &Reply, size: usize) -> Vec<f64> {
    assert_eq!(reply.status, 200, "{}", String::from_utf8_lossy(&reply.body));
    assert_eq!(reply.header("content-type"), Some("application/x-npy"));
    let bytes = &reply.body;
    assert_eq!(&bytes[..8], b"\x93NUMPY\x01\x00");
    let start = 10 + usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
    let head = std::str::from_utf8(&bytes[10..start]).unwrap();
    assert!(head.contains(&format!("'shape': ({size}, {size})")) && head.contains("'<f8'"), "{head}");
    bytes[start..].as_chunks().0.iter().map(|number| f64::from_le_bytes(*number)).collect()
}

fn distances_of(neighbours: &[Value]) -> Vec<f64> {
    neighbours.iter().map(|neighbour| neighbour["distance"].as_f64().unwrap()).collect()
}

#[test]
fn a_posted_shape_finds_itself_and_a_stored_one_the_others() {
    let server = example();
    let cells = cells();
    let cell = &cells[17];
    let posted = search(&server, &json!({"shapes": [{"points": cell["points"]}], "neighbours": 5}));
    assert_eq!(posted.len(), 1);
    let first = &posted[0][0];
    assert_eq!((&first["external_id"], &first["label"]), (&cell["external_id"], &cell["label"]));
    assert_eq!(first["labels"], cell["labels"]);
    assert!(first["distance"].as_f64().unwrap() < ROOT, "{first}");
    assert_eq!(
        (&first["start"], &first["reversed"], &first["mirrored"]),
        (&json!(0), &json!(false), &json!(false))
    );
    assert_eq!(posted[0].len(), 5);
    assert!(distances_of(&posted[0]).is_sorted());

    let id = first["id"].as_str().unwrap();
    let stored = search(&server, &json!({"ids": [cell["external_id"], id], "neighbours": 4}));
    assert_eq!(stored[0], stored[1], "by its external id or its id");
    assert_eq!(stored[0], posted[0][1..], "itself is left out");
    let all = search(&server, &json!({"ids": [id], "neighbours": 1000}));
    assert_eq!(all[0].len(), COUNT - 1);
    assert_eq!(search(&server, &json!({"ids": [id]}))[0], all[0][..10]);

    let filter = json!({"label": "dunn/control"});
    let labelled = search(&server, &json!({"ids": [id], "neighbours": 1000, "filter": filter}));
    let wanted: Vec<Value> = all[0].iter().filter(|n| n["label"] == "dunn/control").cloned().collect();
    assert!(!wanted.is_empty() && wanted.len() < COUNT - 1);
    assert_eq!(labelled[0], wanted);
    let by_attribute = json!({"labels": {"cell_line": "dunn", "treatment": "control"}});
    assert_eq!(search(&server, &json!({"ids": [id], "neighbours": 1000, "filter": by_attribute}))[0], wanted);
}

#[test]
fn a_search_gives_the_rows_of_the_matrix() {
    let server = example();
    for (transformation, alignment, mirror) in [
        ("similarity", "projection", "forbid"),
        ("affine", "projection", "allow"),
        ("rigid", "procrustes", "allow"),
        ("translation", "projection", "forbid"),
    ] {
        let body = json!({"cohort": "example-cells", "transformation": transformation, "alignment": alignment,
            "mirror": mirror});
        let matrix = server.post("/v1/distances", &body).expect(200);
        let ids = matrix["ids"].as_array().unwrap();
        assert_eq!((ids.len(), matrix["labels"].as_array().unwrap().len()), (COUNT, COUNT));
        assert_eq!(
            matrix["cohort_revision"],
            server.get("/v1/cohorts/example-cells").expect(200)["revision"]
        );
        let wanted = &matrix["distances"][3];
        let neighbours = search(
            &server,
            &json!({"ids": [ids[3]], "neighbours": 1000, "transformation": transformation, "alignment": alignment,
                "mirror": mirror}),
        );
        for neighbour in &neighbours[0] {
            let column = ids.iter().position(|id| *id == neighbour["external_id"]).unwrap();
            let (found, wanted) = (neighbour["distance"].as_f64().unwrap(), wanted[column].as_f64().unwrap());
            assert!(
                (found - wanted).abs() <= ROOT * (1.0 + wanted),
                "{transformation}: {found} for {wanted}"
            );
        }
        let mirrored = neighbours[0].iter().filter(|neighbour| neighbour["mirrored"] == true).count();
        assert_eq!(mirrored > 0, mirror == "allow", "{transformation}");
    }
}

#[test]
fn posted_and_stored_shapes_have_the_same_matrix_in_every_format() {
    let server = example();
    let cells: Vec<Value> = cells().into_iter().take(40).collect();
    let ids: Vec<Value> = cells.iter().map(|cell| cell["external_id"].clone()).collect();
    let cohort = server.get("/v1/cohorts/example-cells").expect(200);
    let shapes: Vec<Value> = cells
        .iter()
        .map(|cell| json!({"external_id": cell["external_id"], "label": cell["label"], "points": cell["points"]}))
        .collect();
    let posted = json!({"shapes": shapes, "representation": cohort["representation"],
        "correspondence": cohort["correspondence"], "direction": cohort["direction"], "transformation": "similarity"});
    let stored = json!({"cohort": "example-cells", "ids": ids, "transformation": "similarity"});
    let (posted, answer) = (
        server.post("/v1/distances", &posted).expect(200),
        server.post("/v1/distances", &stored).expect(200),
    );
    for field in ["ids", "labels", "distances"] {
        assert_eq!(posted[field], answer[field], "{field}");
    }
    assert_eq!(answer["ids"], Value::from(ids.clone()));
    let numbers = flat(&answer["distances"]);
    for i in 0..40 {
        assert_eq!(numbers[i * 41], 0.0);
        assert!((0..i).all(|j| numbers[i * 40 + j] == numbers[j * 40 + i]));
    }
    assert_eq!(npy(&matrix_in(&server, "npy", &stored), 40), numbers);

    let csv = matrix_in(&server, "csv", &stored);
    assert_eq!(csv.header("content-type"), Some("text/csv"));
    let mut lines = csv.text().lines();
    let names: Vec<&str> = lines.next().unwrap().split(',').collect();
    assert_eq!(json!(names), answer["ids"]);
    let read: Vec<f64> = lines.flat_map(|line| line.split(',').map(|n| n.parse::<f64>().unwrap())).collect();
    assert_eq!(read, numbers);

    let by_accept = |media_type: &str| {
        server.send(server.request(Method::POST, "/v1/distances").header(ACCEPT, media_type).json(&stored))
    };
    assert_eq!(by_accept("text/csv").body, csv.body);
    assert_eq!(npy(&by_accept("application/octet-stream"), 40), numbers);
    assert_eq!(by_accept("application/json;q=0.9, */*;q=0.1").json(), answer);
    by_accept("image/svg+xml").expect_problem(406, "not-acceptable", &[]);
    matrix_in(&server, "svg", &stored).expect_problem(400, "invalid-query", &[]);
}

#[test]
fn a_large_matrix_is_a_job_whose_output_is_kept() {
    let at_once = example();
    let wanted = matrix_in(&at_once, "npy", &of_cells("affine")).body;
    let server = example_with_jobs();
    let reply = server.post("/v1/distances", &of_cells("affine"));
    let job = reply.expect(202);
    assert_eq!(job["kind"], "distances");
    let id = job["id"].as_str().unwrap();
    assert_eq!(reply.header("location"), Some(format!("/v1/jobs/{id}").as_str()));
    let done = finished(&server, id);
    assert_eq!(
        (&done["status"], &done["result"]["shape_count"]),
        (&json!("succeeded"), &json!(COUNT)),
        "{done}"
    );
    let path = done["result"]["output"].as_str().unwrap().to_owned();
    assert_eq!(path, format!("/v1/jobs/{id}/output"));
    assert_eq!(server.get(&format!("{path}?format=npy")).body, wanted, "the same bits as at once");
    let json = server.get(&path).expect(200);
    assert_eq!(json["cohort_revision"], done["result"]["cohort_revision"]);
    assert_eq!(flat(&json["distances"]), npy(&server.get(&format!("{path}?format=npy")), COUNT));
    // Waiting brings the matrix itself.
    assert_eq!(matrix_in(&server, "npy", &of_cells("affine")).body, wanted);

    server.get("/v1/jobs/job_none/output").expect_problem(404, "not-found", &[]);
    server.get(&format!("{path}?colour=red")).expect_problem(400, "invalid-query", &[]);
    server.get(&format!("{path}?format=svg")).expect_problem(400, "invalid-query", &[]);

    let server = server.kill().start();
    assert_eq!(server.get(&format!("{path}?format=npy")).body, wanted, "after a kill");
}

#[test]
fn a_job_whose_cohort_is_deleted_fails_and_has_no_output() {
    // Without the slot for short jobs, the second job waits for the first.
    let server = Setting::fresh()
        .with_example()
        .flags(&["--max-matrix-operations", "1", "--short-job-seconds", "0"])
        .start();
    let endless = json!({"name": "busy", "cohort": "example-cells", "transformation": "similarity",
        "method": {"kind": "sparse", "atoms": 60, "lambda": 0.01, "max_epochs": 10_000, "tolerance": 0.0}});
    let busy = submit(&server, &endless);
    job_when(&server, &busy, &["running"]);
    let waiting = server.post("/v1/distances", &of_cells("similarity")).expect(202);
    let waiting = waiting["id"].as_str().unwrap();
    assert_eq!(server.delete("/v1/cohorts/example-cells").status, 204);
    let cancelled = server.send(server.request(Method::POST, &format!("/v1/jobs/{busy}/cancel")));
    // Learning may have met the deletion first.
    assert!([200, 409].contains(&cancelled.status), "{}", cancelled.text());
    let failed = finished(&server, waiting);
    assert_eq!(
        (&failed["status"], &failed["problem"]["code"]),
        (&json!("failed"), &json!("not-found")),
        "{failed}"
    );
    server.get(&format!("/v1/jobs/{waiting}/output")).expect_problem(404, "not-found", &[]);
    server.assert_alive();
}

#[test]
fn what_cannot_be_searched_is_refused() {
    let server = example();
    let triangle = json!({"points": [[0, 0], [4, 0], [1, 3]]});
    let cases = [
        (json!({"shapes": [triangle], "neighbours": 0}), Wanted::invalid(&["/neighbours"])),
        (json!({"shapes": [triangle], "neighbours": 1001}), Wanted::invalid(&["/neighbours"])),
        (json!({"shapes": [triangle], "neighbours": -1}), Wanted::invalid(&["/neighbours"])),
        (
            json!({"neighbours": 0, "colour": 1, "mirror": "maybe", "filter": {"size": 3}}),
            Wanted::invalid(&["", "/neighbours", "/colour", "/mirror", "/filter/size"]),
        ),
        (json!({}), Wanted::invalid(&[""])),
        (json!({"shapes": [triangle], "ids": ["cell0004"]}), Wanted::invalid(&[""])),
        (json!({"shapes": []}), Wanted::invalid(&["/shapes"])),
        (json!({"ids": []}), Wanted::invalid(&["/ids"])),
        (json!({"ids": ["cell0004", "nobody", "noone"]}), Wanted::invalid(&["/ids/1", "/ids/2"])),
        (
            json!({"shapes": [triangle, {"points": [[0, 0, 0], [4, 0, 1], [1, 3, 2]]}]}),
            Wanted::invalid(&["/shapes/1/points/0"]),
        ),
        (
            json!({"shapes": [triangle, {"points": [[0, 0], [4, "x"], [1, 3]]}, {"points": [[1, 1], [1, 1], [1, 1]]}]}),
            Wanted::invalid(&["/shapes/1/points/1/1", "/shapes/2/points"]),
        ),
        (json!({"shapes": [triangle], "filter": {"label": "nobody has it"}}), Wanted::invalid(&["/filter"])),
        (
            json!({"shapes": [triangle], "transformation": "rigid", "alignment": "projection"}),
            Wanted::invalid(&["/transformation"]),
        ),
        (
            json!({"shapes": [triangle], "transformation": "affine", "alignment": "procrustes"}),
            Wanted::invalid(&["/transformation"]),
        ),
        (json!({"shapes": [triangle], "transformation": "sideways"}), Wanted::invalid(&["/transformation"])),
        (
            json!({"shapes": [triangle], "mirror": "allow", "transformation":
            {"matrices": [[[1, 1], [0, 1]]], "translation": true}}),
            Wanted::invalid(&["/transformation"]),
        ),
    ];
    let mut differences = Differences::default();
    for (body, wanted) in &cases {
        differences.compare(&body.to_string(), &server.post(CELLS, body), wanted);
    }
    drop(differences);
    let nan =
        server.post_bytes(CELLS, "application/json", r#"{"shapes":[{"points":[[0,0],[NaN,1],[1,3]]}]}"#);
    assert_eq!((nan.status, &nan.json()["code"]), (400, &json!("malformed-body")));
    let huge =
        server.post_bytes(CELLS, "application/json", r#"{"shapes":[{"points":[[0,0],[1e999,1],[1,3]]}]}"#);
    assert_eq!((huge.status, &huge.json()["code"]), (400, &json!("malformed-body")));
    server.post("/v1/cohorts/none/search", &json!({"ids": ["a"]})).expect_problem(404, "not-found", &[]);
    server.assert_alive();
}

#[test]
fn what_has_no_distances_is_refused() {
    let server = example();
    let triangle = json!({"points": [[0, 0], [4, 0], [1, 3]]});
    let landmarks = json!({"kind": "landmarks", "dimension": 2, "points": 3});
    let posted = |shapes: Value, transformation: &str| {
        json!({"shapes": shapes, "representation": landmarks,
        "transformation": transformation})
    };
    let cases = [
        (json!({}), Wanted::invalid(&["", "/transformation"])),
        (json!({"shapes": [triangle], "transformation": "affine"}), Wanted::invalid(&["/representation"])),
        (
            json!({"shapes": [triangle], "cohort": "example-cells", "transformation": "affine"}),
            Wanted::invalid(&[""]),
        ),
        (
            json!({"cohort": "example-cells", "representation": landmarks, "direction": "given", "ids": ["cell0004"],
            "filter": {}, "transformation": "affine"}),
            Wanted::invalid(&["/representation", "/direction", "/ids"]),
        ),
        (
            json!({"shapes": [triangle], "representation": landmarks, "filter": {}, "transformation": "affine"}),
            Wanted::invalid(&["/filter"]),
        ),
        (
            json!({"cohort": "example-cells", "ids": ["cell0004", "nobody"], "transformation": "similarity"}),
            Wanted::invalid(&["/ids/1"]),
        ),
        (
            json!({"cohort": "example-cells", "ids": ["cell0004", "cell0010", "cell0004"], "transformation": "similarity"}),
            Wanted::invalid(&["/ids/2"]),
        ),
        (
            json!({"cohort": "example-cells", "filter": {"label": "none"}, "transformation": "similarity"}),
            Wanted::invalid(&["/filter"]),
        ),
        (
            json!({"cohort": "example-cells", "transformation": "rigid", "alignment": "projection"}),
            Wanted::invalid(&["/transformation"]),
        ),
        (posted(json!([]), "affine"), Wanted::new(422, "too-few-shapes", &[])),
        (
            posted(json!([triangle, {"points": [[0, 0], [1, 1]]}]), "affine"),
            Wanted::invalid(&["/shapes/1/points"]),
        ),
        (
            posted(json!([triangle, {"points": [[0, 0], [1, 1], [2, 2]]}]), "affine"),
            Wanted::new(422, "degenerate-shape", &["/shapes/1"]),
        ),
    ];
    let mut differences = Differences::default();
    for (body, wanted) in &cases {
        differences.compare(&body.to_string(), &server.post("/v1/distances", body), wanted);
    }
    drop(differences);
    let missing = json!({"cohort": "none", "transformation": "affine"});
    server.post("/v1/distances", &missing).expect_problem(404, "not-found", &["/cohort"]);
    // A single shape has a matrix of one number.
    let one = server.post("/v1/distances", &posted(json!([triangle]), "similarity")).expect(200);
    assert_eq!((&one["ids"], &one["distances"]), (&json!(["0"]), &json!([[0.0]])));
    server.assert_alive();
}

#[test]
fn a_degenerate_shape_of_a_cohort_is_named() {
    let server = Server::fresh();
    let cohort =
        json!({"name": "flat", "representation": {"kind": "landmarks", "dimension": 2, "points": 3}});
    server.post("/v1/cohorts", &cohort).expect(201);
    let shapes = json!({"shapes": [{"external_id": "a", "points": [[0, 0], [4, 0], [1, 3]]},
        {"external_id": "line", "points": [[0, 0], [1, 1], [3, 3]]}]});
    let ids = server.post("/v1/cohorts/flat/shapes?return=ids", &shapes).expect(201)["ids"].clone();
    let bodies = [
        ("/v1/cohorts/flat/search", json!({"ids": ["a"], "transformation": "affine"})),
        ("/v1/distances", json!({"cohort": "flat", "transformation": "affine"})),
    ];
    for (path, body) in bodies {
        let problem = server.post(path, &body).expect_problem(422, "degenerate-shape", &[""]);
        assert_eq!(problem["errors"][0]["index"], 1);
        let detail = problem["errors"][0]["detail"].as_str().unwrap();
        assert!(detail.contains(ids[1].as_str().unwrap()) && detail.contains("'flat'"), "{detail}");
    }
    let asked = json!({"ids": ["line"], "transformation": "affine"});
    server.post("/v1/cohorts/flat/search", &asked).expect_problem(422, "degenerate-shape", &["/ids/0"]);
    let asked = json!({"cohort": "flat", "ids": ["a", "line"], "transformation": "affine"});
    server.post("/v1/distances", &asked).expect_problem(422, "degenerate-shape", &["/ids/1"]);
    // Under a class that does not see it, it is a shape like others; in a cohort without shapes there are no neighbours.
    let found = server.post("/v1/cohorts/flat/search", &json!({"ids": ["a"]})).expect(200);
    assert_eq!(found["results"][0]["neighbours"][0]["external_id"], "line");
    server
        .post("/v1/cohorts", &json!({"name": "empty", "representation": cohort["representation"]}))
        .expect(201);
    let asked = json!({"shapes": [{"points": [[0, 0], [4, 0], [1, 3]]}]});
    let found = server.post("/v1/cohorts/empty/search", &asked).expect(200);
    assert_eq!(found["results"], json!([{"neighbours": []}]));
    let asked = json!({"cohort": "empty", "transformation": "similarity"});
    server.post("/v1/distances", &asked).expect_problem(422, "too-few-shapes", &[]);
}

#[test]
fn sizes_are_refused_before_anything_is_computed() {
    let limits = ["--max-matrix-bytes", "1000", "--max-search-operations", "100000", "--max-shapes", "200"];
    let server = Setting::fresh().with_example().flags(&limits).start();
    let refusal = server.post("/v1/distances", &of_cells("similarity"));
    let problem = refusal.expect_problem(422, "invalid-input", &["/cohort"]);
    let detail = problem["detail"].as_str().unwrap();
    assert!(
        detail.contains("120 shapes") && detail.contains("115200") && detail.contains("1000"),
        "{detail}"
    );
    let filtered = json!({"cohort": "example-cells", "filter": {"labels": {"cell_line": "dunn"}},
        "transformation": "similarity"});
    server.post("/v1/distances", &filtered).expect_problem(422, "invalid-input", &["/filter"]);
    let cells: Vec<Value> = cells().into_iter().take(20).collect();
    let shapes: Vec<Value> = cells.iter().map(|cell| json!({"points": cell["points"]})).collect();
    let representation = json!({"kind": "closed_curve", "dimension": 2, "control_points": 32,
        "generator": {"name": "trigonometric"}});
    let posted = json!({"shapes": shapes, "representation": representation, "correspondence": "cyclic",
        "transformation": "similarity"});
    server.post("/v1/distances", &posted).expect_problem(422, "invalid-input", &["/shapes"]);
    let costly = json!({"ids": ["cell0004"], "neighbours": 1});
    server.post(CELLS, &costly).expect_problem(422, "invalid-input", &[""]);
    let repeated = ["cell0004"; 30];
    let many = json!({"ids": repeated, "neighbours": 10});
    server.post(CELLS, &many).expect_problem(422, "invalid-input", &["/neighbours"]);
    assert_eq!(server.get("/v1/jobs").expect(200)["items"], json!([]));

    let jobs = example_with_jobs();
    let problem = jobs.post("/v1/distances", &posted).expect_problem(422, "invalid-input", &["/shapes"]);
    assert!(problem["detail"].as_str().unwrap().contains("cohort"), "{problem}");
}

/// A representation of every kind, with its number of control points.
fn kinds() -> Vec<(Value, usize)> {
    let cubic = json!({"name": "cubic"});
    let spline = json!({"name": "bspline", "degree": 3});
    let surface = |topology: &str| json!({"kind": "surface", "topology": topology, "control_points": [5, 4]});
    vec![
        (json!({"kind": "landmarks", "dimension": 2, "points": 7}), 7),
        (json!({"kind": "landmarks", "dimension": 3, "points": 7}), 7),
        (json!({"kind": "closed_curve", "dimension": 2, "control_points": 12, "generator": cubic}), 12),
        (json!({"kind": "closed_curve", "dimension": 3, "control_points": 12, "generator": spline}), 12),
        (json!({"kind": "open_curve", "dimension": 2, "intervals": 8, "generator": spline}), 11),
        (surface("sphere"), 21),
        (surface("sharp_sphere"), 27),
        (surface("cylinder"), 35),
        (surface("torus"), 20),
        (surface("plane"), 56),
        (json!({"kind": "subdivision", "scheme": "loop", "level": 2, "connectivity": "octahedron"}), 6),
    ]
}

/// Control points without a pattern, whose last coordinate is `thin` times as large.
fn scattered(seed: usize, count: usize, dimension: usize, thin: f64) -> Value {
    let number = |k: usize, c: usize| {
        let value = (1.0 + (seed * 37 + k * 11 + c * 5) as f64).sin() * 1e3;
        (value - value.floor()) * if c + 1 == dimension { thin } else { 1.0 }
    };
    let row = |k: usize| (0..dimension).map(|c| number(k, c)).collect::<Vec<f64>>();
    json!({"control_points": (0..count).map(row).collect::<Vec<_>>()})
}

#[test]
fn identical_shapes_have_the_distance_zero_whatever_they_are() {
    let server = Server::fresh();
    let mut compared = 0;
    for (representation, count) in kinds() {
        let dimension = representation["dimension"].as_u64().unwrap_or(3) as usize;
        let cyclic = representation["kind"] == "closed_curve";
        let correspondences: &[&str] = if cyclic { &["landmarks", "cyclic"] } else { &["landmarks"] };
        for (&correspondence, thin) in correspondences.iter().flat_map(|name| [(name, 1.0), (name, 1e-7)]) {
            let shape = |seed: usize| scattered(seed, count, dimension, thin);
            // Copies at other places of a batch.
            let shapes: Vec<Value> = [0, 1, 2, 0, 3, 4, 5, 0].map(shape).into();
            let name = format!("c{compared}");
            let cohort =
                json!({"name": name, "representation": representation, "correspondence": correspondence});
            server.post("/v1/cohorts", &cohort).expect(201);
            server.post(&format!("/v1/cohorts/{name}/shapes"), &json!({"shapes": shapes})).expect(201);
            for (transformation, alignment) in [
                ("similarity", "projection"),
                ("similarity", "procrustes"),
                ("similarity", "partial_procrustes"),
                ("rigid", "procrustes"),
                ("translation", "projection"),
                ("affine", "projection"),
                ("non_uniform_scaling_translation", "projection"),
            ] {
                // Similarities of space do not form a linear class.
                if dimension == 3 && (transformation, alignment) == ("similarity", "projection") {
                    continue;
                }
                let what =
                    format!("{representation}, {correspondence}, {thin}, {transformation}, {alignment}");
                let asked = json!({"representation": representation, "correspondence": correspondence, "shapes": shapes,
                    "transformation": transformation, "alignment": alignment});
                let answer = server.post("/v1/distances", &asked).expect(200);
                let stored =
                    json!({"cohort": name, "transformation": transformation, "alignment": alignment});
                let stored = server.post("/v1/distances", &stored).expect(200);
                for matrix in [&answer["distances"], &stored["distances"]] {
                    for (i, j) in [(0, 3), (0, 7), (3, 7), (7, 0)] {
                        assert_eq!(matrix[i][j].as_f64(), Some(0.0), "{what}");
                    }
                    assert!(matrix[0][1].as_f64().unwrap() > 0.0, "{what}");
                }
                let asked = json!({"shapes": [shapes[0]], "neighbours": 4, "transformation": transformation, "alignment": alignment});
                let found = server.post(&format!("/v1/cohorts/{name}/search"), &asked).expect(200);
                let found = distances_of(found["results"][0]["neighbours"].as_array().unwrap());
                assert_eq!(found[..3], [0.0; 3], "{what}");
                assert!(found[3] > 0.0, "{what}");
            }
            compared += 1;
        }
    }
    assert_eq!(compared, 26);
}

#[test]
fn lengths_are_right_for_very_large_and_very_small_shapes() {
    let server = Server::fresh();
    let triangles = [[[0.0, 0.0], [4.0, 0.0], [1.0, 3.0]], [[0.0, 0.0], [5.0, 1.0], [2.0, 2.0]]];
    let length = |factor: f64, transformation: &str| {
        let scaled = |shape: &[[f64; 2]; 3]| json!({"points": shape.map(|point| point.map(|x| factor * x))});
        let shapes: Vec<Value> = triangles.iter().map(scaled).collect();
        let asked = json!({"representation": {"kind": "landmarks", "dimension": 2, "points": 3}, "shapes": shapes,
            "transformation": transformation});
        server.post("/v1/distances", &asked).expect(200)["distances"][0][1].as_f64().unwrap()
    };
    for transformation in ["rigid", "translation"] {
        let wanted = length(1.0, transformation);
        assert!(wanted > 0.1, "{wanted}");
        for factor in [1e-98, 1e-80, 1e-30, 1e30, 1e78, 1e99] {
            let found = length(factor, transformation) / factor;
            assert!(
                (found - wanted).abs() <= 1e-12 * wanted,
                "{transformation} {factor:e}: {found} for {wanted}"
            );
        }
    }
}
