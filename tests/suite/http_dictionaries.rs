//! Dictionaries over HTTP against the real program: learnt as jobs, kept in versions, used, exported and imported.

use std::f64::consts::TAU;
use std::time::{Duration, Instant};

use reqwest::Method;
use reqwest::header::IF_NONE_MATCH;
use serde_json::value::RawValue;
use serde_json::{Value, json};
use shapelex_server::analysis::dictionary::content::Content;

use crate::http_bad_input::{Differences, Wanted};
use crate::http_contract::cells;
use crate::server::{Reply, Server, Setting, assert_close, flat};

const JSON: &str = "application/json";

/// Landmarks of a shape.
const POINTS: usize = 9;
/// Penalty of the lasso.
const LAMBDA: f64 = 0.05;
/// Long enough for a slow machine, shorter than the patience of the client.
pub(crate) const PATIENCE: Duration = Duration::from_secs(150);

type Rows = Vec<[f64; 2]>;

// ---------------------------------------------------------------- what is learnt from

/// Landmarks on a blob of its own form, size, direction and place.
fn blob(k: usize) -> Rows {
    let s = k as f64;
    let radius =
        |t: f64| 2.0 + 0.4 * (2.0 * t + 1.3 * s).cos() + 0.3 * (3.0 * t + s * s).sin() + 0.1 * (t * s).cos();
    let (size, turn) = (1.0 + 0.2 * (s % 7.0), 0.9 * s);
    let point = |i: usize| {
        let t = TAU * i as f64 / POINTS as f64;
        let (r, angle) = (size * radius(t), t + turn);
        [3.0 * s + r * angle.cos(), r * angle.sin() - s]
    };
    (0..POINTS).map(point).collect()
}

/// Shapes with the ids `0`, `1`, ….
fn blobs(which: impl IntoIterator<Item = usize>) -> Vec<Value> {
    which.into_iter().map(|k| json!({"external_id": k.to_string(), "points": blob(k)})).collect()
}

/// The shapes as they stand in questions: without ids.
fn posted(which: impl IntoIterator<Item = usize>) -> Vec<Value> {
    which.into_iter().map(|k| json!({"points": blob(k)})).collect()
}

fn new_cohort(server: &Server, name: &str, shapes: &[Value]) {
    let representation = json!({"kind": "landmarks", "dimension": 2, "points": POINTS});
    let cohort = json!({"name": name, "representation": representation, "correspondence": "landmarks"});
    server.post("/v1/cohorts", &cohort).expect(201);
    add_shapes(server, name, shapes);
}

fn add_shapes(server: &Server, cohort: &str, shapes: &[Value]) {
    server.post(&format!("/v1/cohorts/{cohort}/shapes"), &json!({ "shapes": shapes })).expect(201);
}

/// Ids of the example cohort, and its shapes as they stand in questions.
fn example() -> (Vec<Value>, Vec<Value>) {
    cells().iter().map(|cell| (cell["external_id"].clone(), json!({"points": cell["points"]}))).unzip()
}

// ---------------------------------------------------------------- what is asked

fn request(name: &str, cohort: &str, method: &Value) -> Value {
    json!({"name": name, "cohort": cohort, "transformation": "similarity", "method": method})
}

fn components(count: usize, centre: bool) -> Value {
    json!({"kind": "functional_pca", "components": count, "centre": centre})
}

fn lasso(atoms: usize, codes: &str) -> Value {
    json!({"kind": "sparse", "atoms": atoms, "lambda": LAMBDA, "codes": codes, "max_epochs": 10})
}

fn pursuit(atoms: usize, codes: &str) -> Value {
    json!({"kind": "sparse", "atoms": atoms, "nonzeros": 2, "codes": codes, "max_epochs": 10})
}

/// Learning that goes on until it is stopped, for as long as a test can take.
fn endless() -> Value {
    json!({"kind": "sparse", "atoms": 60, "lambda": 0.01, "max_epochs": 10_000, "tolerance": 0.0})
}

/// Learns and waits for the answer.
fn learnt(server: &Server, body: &Value) -> Reply {
    server.send(server.request(Method::POST, "/v1/dictionaries").header("prefer", "wait=50").json(body))
}

/// Learns the first dictionary of a test, or the next one; the dictionary.
#[track_caller]
fn learn(server: &Server, name: &str, cohort: &str, method: &Value) -> Value {
    learnt(server, &request(name, cohort, method)).expect(201)
}

/// Submits a job; its id.
#[track_caller]
pub(crate) fn submit(server: &Server, body: &Value) -> String {
    let reply = server.post("/v1/dictionaries", body);
    let job = reply.expect(202);
    let id = job["id"].as_str().unwrap();
    assert_eq!(reply.header("location"), Some(format!("/v1/jobs/{id}").as_str()));
    id.to_owned()
}

pub(crate) fn job(server: &Server, id: &str) -> Value {
    server.get(&format!("/v1/jobs/{id}")).expect(200)
}

/// Waits until the job is in one of these states.
#[track_caller]
pub(crate) fn job_when(server: &Server, id: &str, states: &[&str]) -> Value {
    let start = Instant::now();
    loop {
        let found = job(server, id);
        if states.contains(&found["status"].as_str().unwrap()) {
            return found;
        }
        assert!(start.elapsed() < PATIENCE, "no {states:?}: {found}");
        std::thread::sleep(Duration::from_millis(10));
    }
}

/// The job when it is finished.
#[track_caller]
pub(crate) fn finished(server: &Server, id: &str) -> Value {
    job_when(server, id, &["succeeded", "failed", "cancelled"])
}

pub(crate) fn dictionary(server: &Server, key: &str) -> Value {
    server.get(&format!("/v1/dictionaries/{key}")).expect(200)
}

/// Entries of the list for a query.
#[track_caller]
pub(crate) fn listed(server: &Server, query: &str) -> Vec<Value> {
    server.get(&format!("/v1/dictionaries{query}")).expect(200)["items"].as_array().unwrap().clone()
}

#[track_caller]
fn ask(server: &Server, key: &str, what: &str, body: &Value) -> Value {
    server.post(&format!("/v1/dictionaries/{key}/{what}"), body).expect(200)
}

#[track_caller]
fn encode(server: &Server, key: &str, shapes: &[Value]) -> Vec<Value> {
    let mut answer = ask(server, key, "encode", &json!({ "shapes": shapes }));
    let results = answer["results"].as_array_mut().unwrap();
    for (index, result) in results.iter_mut().enumerate() {
        assert_eq!(result.as_object_mut().unwrap().remove("index"), Some(json!(index)));
    }
    std::mem::take(results)
}

// ---------------------------------------------------------------- arithmetic of landmarks

fn rows(points: &Value) -> Rows {
    flat(points).chunks_exact(2).map(|row| [row[0], row[1]]).collect()
}

/// `Σ ⟨aᵢ, bᵢ⟩/N`: the product of landmarks.
fn inner(a: &[[f64; 2]], b: &[[f64; 2]]) -> f64 {
    a.iter().zip(b).map(|(p, q)| p[0] * q[0] + p[1] * q[1]).sum::<f64>() / a.len() as f64
}

fn squared_distance(a: &[[f64; 2]], b: &[[f64; 2]]) -> f64 {
    let difference: Rows = a.iter().zip(b).map(|(p, q)| [p[0] - q[0], p[1] - q[1]]).collect();
    inner(&difference, &difference)
}

/// `A r + b`.
fn moved(points: &[[f64; 2]], matrix: &[[f64; 2]], offset: [f64; 2]) -> Rows {
    let row = |p: &[f64; 2], c: usize| matrix[c][0] * p[0] + matrix[c][1] * p[1] + offset[c];
    points.iter().map(|p| [row(p, 0), row(p, 1)]).collect()
}

/// The shape `points` in the pose that a code answers.
fn posed(points: &[[f64; 2]], code: &Value) -> Rows {
    let transformation = &code["transformation"];
    let offset = flat(&transformation["offset"]);
    moved(points, &rows(&transformation["matrix"]), [offset[0], offset[1]])
}

/// Rotation by `angle` and scaling by `size`.
fn turn(angle: f64, size: f64) -> Rows {
    let (sin, cos) = angle.sin_cos();
    vec![[size * cos, -size * sin], [size * sin, size * cos]]
}

/// The control points of all atoms.
fn atoms_of(dictionary: &Value) -> Vec<Rows> {
    dictionary["atoms"].as_array().unwrap().iter().map(|atom| rows(&atom["control_points"])).collect()
}

/// `Σ vⱼ dⱼ` over the atoms of a code, each moved by its matrix when the code has matrices.
fn combined(atoms: &[Rows], code: &Value) -> Rows {
    let mut sum = vec![[0.0; 2]; atoms[0].len()];
    for (i, index) in code["indices"].as_array().unwrap().iter().enumerate() {
        let value = code["values"][i].as_f64().unwrap();
        let matrix = code["matrices"].get(i).map_or(vec![[value, 0.0], [0.0, value]], rows);
        let atom = moved(&atoms[usize::try_from(index.as_u64().unwrap()).unwrap()], &matrix, [0.0; 2]);
        sum.iter_mut().zip(&atom).for_each(|(s, p)| (0..2).for_each(|c| s[c] += p[c]));
    }
    sum
}

#[track_caller]
fn assert_near(found: f64, wanted: f64, tolerance: f64, what: &str) {
    assert!((found - wanted).abs() <= tolerance, "{what}: {found} for {wanted}");
}

// ---------------------------------------------------------------- learning

#[test]
fn a_dictionary_is_learnt_by_a_job_that_tells_where_it_is() {
    let server = Setting::fresh().with_example().start();
    for (name, method) in
        [("modes", components(6, true)), ("aligned", lasso(6, "aligned")), ("free", lasso(4, "invariant"))]
    {
        let id = submit(&server, &request(name, "example-cells", &method));
        let done = finished(&server, &id);
        assert_eq!((&done["status"], &done["progress"]), (&json!("succeeded"), &json!(1.0)), "{done}");
        assert_eq!((&done["kind"], &done["problem"]), (&json!("learn_dictionary"), &Value::Null));
        let found = dictionary(&server, done["result"]["dictionary"].as_str().unwrap());
        assert_eq!(found["id"], done["result"]["dictionary"]);
        assert_eq!(found["provenance"]["digest"], done["result"]["digest"]);
        assert_eq!((&found["name"], &done["result"]["name"]), (&json!(name), &json!(name)));
        assert_eq!((&found["version"], &found["cohort_name"]), (&json!(1), &json!("example-cells")));
        assert_eq!((&found["transformation"], &found["frame"]), (&json!("similarity"), &json!("training")));
        for (field, value) in method.as_object().unwrap() {
            assert_eq!(&found["method"][field], value, "{name}: {field}");
        }
        let statistics = &found["statistics"];
        assert_eq!((&statistics["shapes"], &statistics["weight"]), (&json!(120), &json!(120.0)));
        let wanted = method["atoms"].as_u64().or(method["components"].as_u64());
        assert_eq!(found["atoms"].as_array().map(|atoms| atoms.len() as u64), wanted);
        let history = flat(&statistics["history"]);
        // Rounding of a mean of squares of unit shapes.
        assert!(history.windows(2).all(|pair| pair[1] <= pair[0] + 1e-13), "{name}: {history:?}");
        assert_eq!(history.is_empty(), name == "modes");
        assert_eq!(flat(&statistics["residuals"]).len(), 120);
    }
}

#[test]
fn who_waits_is_answered_the_dictionary_and_learning_again_makes_the_same_one() {
    let server = Server::fresh();
    new_cohort(&server, "blobs", &blobs(0..30));
    for (name, method) in [("modes", components(3, true)), ("atoms", lasso(4, "aligned"))] {
        let body = request(name, "blobs", &method);
        let reply = learnt(&server, &body);
        let first = reply.expect(201);
        let id = first["id"].as_str().unwrap();
        assert_eq!(reply.header("location"), Some(format!("/v1/dictionaries/{id}").as_str()));
        assert_eq!(dictionary(&server, id), first);

        let second = learnt(&server, &body).expect(201);
        assert_eq!((&first["version"], &second["version"]), (&json!(1), &json!(2)));
        assert_ne!(second["id"], first["id"]);
        assert_eq!(second["provenance"]["digest"], first["provenance"]["digest"]);
        assert_eq!(second["provenance"]["shapes_digest"], first["provenance"]["shapes_digest"]);
        for field in ["atoms", "mean", "statistics"] {
            assert_eq!(second[field], first[field], "{field}");
        }
        assert_eq!(dictionary(&server, name), second, "a name stands for the latest version");
        assert_eq!(dictionary(&server, &format!("{name}@1")), first);
        assert_eq!(dictionary(&server, &format!("{name}@2")), second);
    }
    let shuffled: Vec<Value> = blobs((0..30).rev());
    new_cohort(&server, "other", &shuffled[..29]);
    let other = learn(&server, "modes", "other", &components(3, true));
    assert_ne!(other["provenance"]["digest"], dictionary(&server, "modes@1")["provenance"]["digest"]);
}

/// A pipeline that learns every night makes a version only when there is something new.
#[test]
fn what_has_not_changed_is_not_learnt_again() {
    let server = Server::fresh();
    new_cohort(&server, "blobs", &blobs(0..12));
    let mut body = request("modes", "blobs", &components(2, true));
    body["only_if_changed"] = json!(true);
    let newest = || dictionary(&server, "modes");
    let learns = |body: &Value, version: u64| {
        let made = learnt(&server, body).expect(201);
        assert_eq!(made["version"], version, "{body}");
        made
    };
    let keeps = |body: &Value| assert_eq!(learnt(&server, body).expect(200), newest(), "{body}");
    learns(&body, 1);
    keeps(&body);
    assert_eq!(server.post("/v1/dictionaries", &body).expect(200)["version"], 1, "without waiting");
    // Other shapes of the cohort do not matter, those of the filter do.
    let mut some = body.clone();
    (some["name"], some["filter"]) = (json!("some"), json!({"label": "b"}));
    let labelled = |k: usize| json!({"external_id": format!("b{k}"), "label": "b", "points": blob(k)});
    add_shapes(&server, "blobs", &(20..26).map(labelled).collect::<Vec<_>>());
    let first = learnt(&server, &some).expect(201);
    learns(&body, 2);
    add_shapes(&server, "blobs", &blobs([30]));
    assert_eq!(learnt(&server, &some).expect(200), first);
    learns(&body, 3);
    keeps(&body);
    // Nor does a plain request stop to make versions, nor do other parameters count as the same.
    let mut other = body.clone();
    other["method"] = components(3, true);
    learns(&other, 4);
    learns(&body, 5);
    learns(&request("modes", "blobs", &components(2, true)), 6);
    keeps(&body);
    // Shapes that are gone or corrected, and versions that are continued.
    assert_eq!(server.delete("/v1/cohorts/blobs/shapes/30").status, 204);
    learns(&body, 7);
    let further =
        json!({"name": "modes", "cohort": "blobs", "continue_from": "modes", "only_if_changed": true});
    keeps(&further);
    add_shapes(&server, "blobs", &blobs([31]));
    learns(&further, 8);
    let path = "/v1/cohorts/blobs/shapes/3";
    server.send(server.request(Method::PATCH, path).json(&json!({"weight": 2}))).expect(200);
    learns(&body, 9);
    let subject = json!({"subject": "anna"});
    server.send(server.request(Method::PATCH, path).json(&subject)).expect(200);
    learns(&body, 10);
    server.delete("/v1/subjects/anna").expect(200);
    learns(&body, 11);
    keeps(&body);
}

#[test]
fn a_version_has_a_tag_that_never_changes() {
    let server = Server::fresh();
    new_cohort(&server, "blobs", &blobs(0..10));
    let first = learn(&server, "modes", "blobs", &components(2, false));
    let get = |key: &str, tag: &str| {
        let path = format!("/v1/dictionaries/{key}");
        server.send(server.request(Method::GET, &path).header(IF_NONE_MATCH, tag))
    };
    let reply = server.get("/v1/dictionaries/modes");
    let tag = reply.header("etag").unwrap().to_owned();
    for key in ["modes", "modes@1", first["id"].as_str().unwrap()] {
        let unchanged = get(key, &tag);
        assert_eq!((unchanged.status, unchanged.body.len()), (304, 0), "{key}");
        assert_eq!(unchanged.header("etag"), Some(tag.as_str()));
    }
    learn(&server, "modes", "blobs", &components(2, false));
    assert_eq!(get("modes", &tag).status, 200, "the name stands for another version now");
    assert_eq!(get("modes@1", &tag).status, 304);
}

#[test]
fn dictionaries_are_listed_in_pages_by_name_and_by_cohort() {
    let server = Server::fresh();
    new_cohort(&server, "a", &blobs(0..8));
    new_cohort(&server, "b", &blobs(4..14));
    let all: Vec<Value> = [("x", "a"), ("y", "b"), ("x", "b")]
        .map(|(name, cohort)| learn(&server, name, cohort, &components(2, true)))
        .into();
    let ids =
        |query: &str| -> Vec<Value> { listed(&server, query).iter().map(|e| e["id"].clone()).collect() };
    let of = |which: &[usize]| -> Vec<Value> { which.iter().map(|&k| all[k]["id"].clone()).collect() };
    assert_eq!(ids(""), of(&[0, 1, 2]));
    assert_eq!(ids("?name=x"), of(&[0, 2]));
    assert_eq!(ids("?cohort=b"), of(&[1, 2]));
    assert_eq!(ids(&format!("?cohort={}", all[0]["cohort"].as_str().unwrap())), of(&[0]));
    assert_eq!(ids("?cohort=b&name=x"), of(&[2]));
    assert_eq!(ids("?name=nothing"), of(&[]));
    assert_eq!(ids("?cohort=nothing"), of(&[]));
    let page = server.get("/v1/dictionaries?limit=2").expect(200);
    assert_eq!((page["items"].as_array().unwrap().len(), &page["next"]), (2, &all[1]["id"]));
    let rest = server.get(&format!("/v1/dictionaries?limit=2&cursor={}", all[1]["id"].as_str().unwrap()));
    let rest = rest.expect(200);
    assert_eq!((&rest["items"][0]["id"], &rest["next"]), (&all[2]["id"], &Value::Null));
    for query in ["limit=0", "limit=1001", "limit=x", "cursor=job_1", "colour=red"] {
        server.get(&format!("/v1/dictionaries?{query}")).expect_problem(400, "invalid-query", &[]);
    }
    for (entry, full) in listed(&server, "").iter().zip(&all) {
        for field in
            ["name", "version", "cohort", "cohort_revision", "method", "provenance", "representation"]
        {
            assert_eq!(entry[field], full[field], "{field}");
        }
        assert_eq!(entry["shape_count"], full["statistics"]["shapes"]);
        for field in ["objective", "reconstruction_error"] {
            assert_eq!(entry[field], full["statistics"][field], "{field}");
        }
        assert_eq!(entry["atoms"], full["atoms"].as_array().unwrap().len());
    }
}

#[test]
fn versions_and_whole_names_are_deleted_and_numbers_are_not_used_again() {
    let server = Server::fresh();
    new_cohort(&server, "blobs", &blobs(0..8));
    let learn = || learn(&server, "modes", "blobs", &components(2, true));
    let versions = [learn(), learn(), learn()];
    let gone = |key: &str| {
        server.get(&format!("/v1/dictionaries/{key}")).expect_problem(404, "not-found", &[]);
        server.delete(&format!("/v1/dictionaries/{key}")).expect_problem(404, "not-found", &[]);
        let body = json!({"shapes": posted([1])});
        server.post(&format!("/v1/dictionaries/{key}/encode"), &body).expect_problem(404, "not-found", &[]);
    };
    // Used before it is deleted: what is kept ready must go, too.
    encode(&server, "modes@1", &posted([1]));
    assert_eq!(server.delete("/v1/dictionaries/modes@1").status, 204);
    gone("modes@1");
    gone(versions[0]["id"].as_str().unwrap());
    let last = versions[2]["id"].as_str().unwrap();
    assert_eq!(server.delete(&format!("/v1/dictionaries/{last}")).status, 204);
    gone("modes@3");
    assert_eq!(dictionary(&server, "modes"), versions[1]);
    assert_eq!(learn()["version"], 4);
    assert_eq!(server.delete("/v1/dictionaries/modes").status, 204);
    for key in ["modes", "modes@2", "modes@4", "modes@0", "modes@x", "modes@"] {
        gone(key);
    }
    assert_eq!(listed(&server, ""), Vec::<Value>::new());
    assert_eq!(learn()["version"], 5);
}

#[test]
fn a_dry_run_tells_the_cost_and_leaves_nothing() {
    let server = Setting::fresh().with_example().start();
    for method in [components(10, false), lasso(20, "invariant"), endless()] {
        let mut body = request("modes", "example-cells", &method);
        body["dry_run"] = json!(true);
        let answer = server.post("/v1/dictionaries", &body).expect(200);
        let estimate = &answer["estimate"];
        assert_eq!(estimate["shape_count"], 120);
        for field in ["multiply_adds", "memory_bytes", "seconds"] {
            assert!(estimate[field].as_f64().unwrap() > 0.0, "{answer}");
        }
        assert_eq!(answer["method"]["kind"], method["kind"]);
        assert_eq!(
            answer["cohort_revision"],
            server.get("/v1/cohorts/example-cells").expect(200)["revision"]
        );
    }
    assert_eq!(server.get("/v1/jobs").expect(200)["items"], json!([]));
    assert_eq!(listed(&server, ""), Vec::<Value>::new());
    server.get("/v1/dictionaries/modes").expect_problem(404, "not-found", &[]);
}

#[test]
fn only_the_shapes_of_the_filter_are_learnt_from() {
    let server = Setting::fresh().with_example().start();
    let mut body = request("control", "example-cells", &components(3, true));
    body["filter"] = json!({"labels": {"treatment": "control"}});
    let found = learnt(&server, &body).expect(201);
    let wanted = cells().iter().filter(|cell| cell["labels"]["treatment"] == "control").count();
    assert!(wanted < 120);
    assert_eq!(found["statistics"]["shapes"], wanted);
    assert_eq!(found["provenance"]["filter"], body["filter"]);
}

// ---------------------------------------------------------------- codes

#[test]
fn stored_and_posted_shapes_have_the_same_codes_in_their_order() {
    let server = Setting::fresh().with_example().start();
    let (ids, shapes) = example();
    let which = [77, 3, 119, 0, 3, 42];
    let (some_ids, some): (Vec<Value>, Vec<Value>) =
        which.map(|k| (ids[k].clone(), shapes[k].clone())).into_iter().unzip();
    for (name, method) in
        [("modes", components(6, true)), ("aligned", lasso(6, "aligned")), ("free", pursuit(4, "invariant"))]
    {
        learn(&server, name, "example-cells", &method);
        let codes = encode(&server, name, &some);
        let stored = ask(&server, name, "encode", &json!({"cohort": "example-cells", "ids": some_ids}));
        for (stored, code) in stored["results"].as_array().unwrap().iter().zip(&codes) {
            assert!(stored["id"].is_string() && stored["external_id"].is_string(), "{stored}");
            assert_eq!(stored["values"], code["values"], "{name}");
        }
        assert_eq!(codes[1], codes[4], "{name}: the same shape twice");
        let batch: Vec<Value> = (0..1000).map(|k| shapes[k % 120].clone()).collect();
        let batch = encode(&server, name, &batch);
        assert_eq!(batch.len(), 1000);
        for (code, k) in codes.iter().zip(which) {
            for place in [k, k + 120, k + 840] {
                assert_eq!(batch[place]["indices"], code["indices"], "{name}: {place}");
                // Sums over a batch may be made in another order.
                assert_close(&batch[place]["values"], &code["values"], 1e-9, name);
            }
        }
        assert_ne!(batch[0], batch[1]);
    }
}

#[test]
fn codes_of_the_lasso_are_as_near_to_the_minimum_as_they_say() {
    let server = Server::fresh();
    new_cohort(&server, "blobs", &blobs(0..40));
    let found = learn(&server, "atoms", "blobs", &lasso(6, "aligned"));
    let atoms = atoms_of(&found);
    for atom in &atoms {
        assert_near(inner(atom, atom), 1.0, 1e-12, "norm of an atom");
    }
    let codes = encode(&server, "atoms", &posted(0..40));
    for (k, code) in codes.iter().enumerate() {
        let y = posed(&blob(k), code);
        assert_near(inner(&y, &y), 1.0, 1e-12, "norm of a shape");
        let fitted = combined(&atoms, code);
        let rest: Rows = y.iter().zip(&fitted).map(|(p, q)| [p[0] - q[0], p[1] - q[1]]).collect();
        let (values, error) = (flat(&code["values"]), inner(&rest, &rest));
        let primal = 0.5 * error + LAMBDA * values.iter().map(|value| value.abs()).sum::<f64>();
        assert_near(code["objective"].as_f64().unwrap(), primal, 1e-12, "objective");
        assert_near(code["relative_error"].as_f64().unwrap(), error.sqrt(), 1e-12, "relative error");
        // The residual, made feasible, is a point of the dual problem.
        let most = atoms.iter().map(|atom| inner(atom, &rest).abs()).fold(LAMBDA, f64::max);
        let feasible: Rows = rest.iter().map(|p| p.map(|value| value * LAMBDA / most)).collect();
        let dual = 0.5 * inner(&y, &y) - 0.5 * squared_distance(&y, &feasible);
        // Ten digits of the objective, which is below a half.
        assert!((-1e-12..1e-10).contains(&(primal - dual)), "shape {k}: {}", primal - dual);
        assert!((0.0..1e-10).contains(&code["duality_gap"].as_f64().unwrap()), "{code}");
        assert_eq!(code["parameters"], values.len());
    }
    // The statistics of the dictionary are those of these codes.
    let mean = codes.iter().map(|code| code["objective"].as_f64().unwrap()).sum::<f64>() / 40.0;
    assert_near(found["statistics"]["objective"].as_f64().unwrap(), mean, 1e-10, "mean objective");
    for (j, atom) in found["atoms"].as_array().unwrap().iter().enumerate() {
        let uses =
            codes.iter().filter(|code| code["indices"].as_array().unwrap().contains(&json!(j))).count();
        assert_near(atom["usage"].as_f64().unwrap(), uses as f64 / 40.0, 1e-12, "usage");
    }
}

#[test]
fn codes_that_must_not_be_negative_are_not() {
    let server = Server::fresh();
    new_cohort(&server, "blobs", &blobs(0..40));
    let mut method = lasso(6, "aligned");
    method["nonnegative"] = json!(true);
    learn(&server, "parts", "blobs", &method);
    let codes = encode(&server, "parts", &posted(0..40));
    assert!(codes.iter().all(|code| flat(&code["values"]).iter().all(|value| *value > 0.0)), "{codes:?}");
    assert!(codes.iter().any(|code| !flat(&code["values"]).is_empty()));
}

#[test]
fn invariant_codes_do_not_see_how_each_shape_is_moved() {
    let server = Setting::fresh().with_example().start();
    let (_, shapes) = example();
    let moved: Vec<Value> = shapes
        .iter()
        .enumerate()
        .map(|(k, shape)| {
            let s = k as f64;
            let matrix = turn(1.1 * s, 0.3 + 0.05 * s);
            json!({"points": moved(&rows(&shape["points"]), &matrix, [40.0 * s, -30.0 * s])})
        })
        .collect();
    for (name, method) in [("free", lasso(5, "invariant")), ("few", pursuit(5, "invariant"))] {
        learn(&server, name, "example-cells", &method);
        let pairs = encode(&server, name, &shapes).into_iter().zip(encode(&server, name, &moved));
        for (k, (here, there)) in pairs.enumerate() {
            assert_eq!(here["indices"], there["indices"], "{name}: shape {k}");
            for field in ["values", "objective", "relative_error"] {
                assert_close(&there[field], &here[field], 1e-8, &format!("{name}: {field} of shape {k}"));
            }
            assert_ne!(here["matrices"], there["matrices"], "they follow the shape");
            assert_eq!(here["parameters"], 2 * here["indices"].as_array().unwrap().len());
        }
    }
}

// ---------------------------------------------------------------- reconstructions

#[test]
fn shapes_and_their_codes_have_the_same_reconstruction() {
    let server = Setting::fresh().with_example().start();
    let (_, shapes) = example();
    let shapes = &shapes[..12];
    for (name, method, pose) in [
        ("modes", components(6, true), "model"),
        ("aligned", lasso(6, "aligned"), "model"),
        ("free", lasso(4, "invariant"), "input"),
    ] {
        learn(&server, name, "example-cells", &method);
        let question = json!({"shapes": shapes, "pose": pose, "samples": 17});
        let of_shapes = ask(&server, name, "reconstruct", &question);
        let codes: Vec<Value> = encode(&server, name, shapes)
            .iter()
            .map(|code| match pose {
                "model" => json!({"indices": code["indices"], "values": code["values"]}),
                _ => json!({"indices": code["indices"], "matrices": code["matrices"], "offset": code["offset"]}),
            })
            .collect();
        let of_codes = ask(&server, name, "reconstruct", &json!({ "codes": codes }));
        for k in 0..shapes.len() {
            let (of_shape, of_code) = (&of_shapes["results"][k], &of_codes["results"][k]);
            assert_close(&of_code["control_points"], &of_shape["control_points"], 1e-10, name);
            assert_eq!((&of_code["relative_error"], &of_code["residual"]), (&Value::Null, &Value::Null));
            assert_eq!(of_shape["residual"].as_array().unwrap().len(), 17);
        }
        let default = ask(&server, name, "reconstruct", &json!({"shapes": shapes[..1]}));
        assert_eq!(default["results"][0]["residual"].as_array().unwrap().len(), 100);
    }
}

#[test]
fn reconstructions_of_landmarks_are_the_sums_of_their_codes() {
    let server = Server::fresh();
    new_cohort(&server, "blobs", &blobs(0..40));
    for (name, method) in [
        ("modes", components(3, false)),
        ("aligned", pursuit(6, "aligned")),
        ("free", pursuit(4, "invariant")),
        ("penalty", lasso(6, "aligned")),
    ] {
        let atoms = atoms_of(&learn(&server, name, "blobs", &method));
        let codes = encode(&server, name, &posted(0..10));
        let input = ask(&server, name, "reconstruct", &json!({"shapes": posted(0..10)}));
        for (k, code) in codes.iter().enumerate() {
            let answer = &input["results"][k];
            let mut sum = combined(&atoms, code);
            if name == "free" {
                // Matrices put the atoms where the shape is.
                let offset = flat(&code["offset"]);
                sum.iter_mut().for_each(|p| (0..2).for_each(|c| p[c] += offset[c]));
                assert_close(&answer["control_points"], &json!(sum), 1e-10, name);
            } else {
                let back = posed(&rows(&answer["control_points"]), code);
                assert_close(&json!(back), &json!(sum), 1e-10, name);
                let y = posed(&blob(k), code);
                let wanted = squared_distance(&y, &sum) / (inner(&y, &y) * inner(&sum, &sum)).sqrt();
                assert_near(answer["relative_error"].as_f64().unwrap(), wanted, 1e-12, name);
                let relative = (squared_distance(&y, &sum) / inner(&y, &y)).sqrt();
                assert_near(code["relative_error"].as_f64().unwrap(), relative, 1e-12, name);
            }
            let residual: Vec<f64> = blob(k)
                .iter()
                .zip(rows(&answer["control_points"]))
                .map(|(p, q)| (p[0] - q[0]).hypot(p[1] - q[1]))
                .collect();
            assert_close(&answer["residual"], &json!(residual), 1e-10, name);
        }
    }
}

#[test]
fn all_components_of_the_shapes_give_the_shapes_back() {
    let server = Server::fresh();
    new_cohort(&server, "blobs", &blobs(0..6));
    let found = learn(&server, "all", "blobs", &components(100, true));
    assert_eq!(found["atoms"].as_array().unwrap().len(), 5, "the rank of six shapes about their mean");
    assert!(found["statistics"]["reconstruction_error"].as_f64().unwrap() < 1e-24);
    let answer = ask(&server, "all", "reconstruct", &json!({"shapes": posted(0..6)}));
    for k in 0..6 {
        let shape = &answer["results"][k];
        assert_close(&shape["control_points"], &json!(blob(k)), 1e-11, "control points");
        assert!(shape["relative_error"].as_f64().unwrap() < 1e-24, "{shape}");
        assert!(flat(&shape["residual"]).iter().all(|distance| *distance < 1e-10), "{shape}");
    }
    // One that is new is not in their span.
    let other = ask(&server, "all", "reconstruct", &json!({"shapes": posted([17])}));
    assert!(other["results"][0]["relative_error"].as_f64().unwrap() > 1e-6);
}

// ---------------------------------------------------------------- scores, priors, samples

#[test]
fn scores_of_the_training_shapes_spread_as_the_statistics_say() {
    let server = Setting::fresh().with_example().start();
    let (ids, shapes) = example();
    let found = learn(&server, "modes", "example-cells", &components(4, true));
    let question = json!({"cohort": "example-cells", "ids": ids, "quantile": 0.9});
    let answer = ask(&server, "modes", "score", &question);
    let scores: Vec<Vec<f64>> =
        answer["results"].as_array().unwrap().iter().map(|score| flat(&score["scores"])).collect();
    let (count, first) = (scores.len() as f64, found["atoms"][0]["eigenvalue"].as_f64().unwrap());
    assert_eq!(scores.len(), 120);
    for i in 0..4 {
        let mean = scores.iter().map(|s| s[i]).sum::<f64>() / count;
        assert_near(mean, 0.0, 1e-12 * first.sqrt(), "mean score");
        for j in 0..4 {
            let product = scores.iter().map(|s| s[i] * s[j]).sum::<f64>();
            let covariance = found["statistics"]["scores"]["covariance"][i][j].as_f64().unwrap();
            assert_near(product / (count - 1.0), covariance, 1e-10 * first, "covariance");
            let eigenvalue = if i == j { found["atoms"][i]["eigenvalue"].as_f64().unwrap() } else { 0.0 };
            assert_near(product, eigenvalue, 1e-10 * first, "eigenvalue");
        }
    }
    let field = |name: &str| -> Vec<f64> {
        let results = answer["results"].as_array().unwrap().iter();
        results.map(|result| result["novelty"][name].as_f64().unwrap()).collect()
    };
    // Σ (s − s̄)ᵀ C⁻¹ (s − s̄) = (K − 1) tr(C⁻¹ C).
    let distances = field("t_squared");
    assert_near(distances.iter().sum(), 4.0 * (count - 1.0), 1e-8, "sum of T²");
    let mut sorted = distances.clone();
    sorted.sort_by(f64::total_cmp);
    assert_close(&found["statistics"]["scores"]["t_squared"], &json!(sorted), 1e-9, "T²");
    let mut residuals = field("squared_prediction_error");
    residuals.sort_by(f64::total_cmp);
    assert_close(&found["statistics"]["residuals"], &json!(residuals), 1e-9, "residuals");
    // Held out, shapes are described worse.
    let held_out = &found["statistics"]["held_out"];
    let sum = |values: &Value| values.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).sum::<f64>();
    assert!(sum(&held_out["residuals"]["values"]) > sum(&found["statistics"]["residuals"]));
    for rank in field("t_squared_rank").into_iter().chain(field("squared_prediction_error_rank")) {
        assert!((0.0..=1.0).contains(&rank), "{rank}");
    }
    // Of new shapes twelve of 120 would be beyond the limit of both measures. Those learnt from have smaller residuals, but
    // a component that one of them has made gives it a larger T² than it had when it was held out.
    let is_outlier = |result: &&Value| result["novelty"]["is_outlier"] == true;
    let outliers = answer["results"].as_array().unwrap().iter().filter(is_outlier).count();
    assert!((4..=20).contains(&outliers), "{outliers}");
    let median = distances.iter().position(|distance| *distance == sorted[20]).unwrap();
    let star: Rows = (0..100)
        .map(|i| {
            let t = TAU * f64::from(i) / 100.0;
            let r = 50.0 * (1.0 + 0.8 * (8.0 * t).cos());
            [r * t.cos(), r * t.sin()]
        })
        .collect();
    // One of the 120 cells is as far from what the others say about it.
    let question = json!({"shapes": [{"points": star}, shapes[median]], "quantile": 0.9});
    let answer = ask(&server, "modes", "score", &question);
    assert_eq!(answer["results"][0]["novelty"]["is_outlier"], true, "{answer}");
    assert!(
        answer["results"][0]["novelty"]["squared_prediction_error_rank"].as_f64().unwrap() > 0.98,
        "{answer}"
    );
    let near = answer["results"][1]["novelty"]["t_squared_rank"].as_f64().unwrap();
    assert!((0.1..0.3).contains(&near), "{near}");

    // Sparse dictionaries have no scores, but errors.
    learn(&server, "atoms", "example-cells", &lasso(4, "aligned"));
    let answer = ask(&server, "atoms", "score", &question);
    assert_eq!(answer["results"][0]["scores"], Value::Null);
    for field in ["t_squared", "t_squared_rank"] {
        assert_eq!(answer["results"][0]["novelty"][field], Value::Null);
    }
    assert_eq!(answer["results"][0]["novelty"]["is_outlier"], true, "{answer}");
}

#[test]
fn weights_count_in_components_and_in_their_spread() {
    let server = Server::fresh();
    let weight = |k: usize| [1.0, 0.25, 3.0][k % 3];
    let shapes = (0..20).map(|k| json!({"points": blob(k), "weight": weight(k)}));
    new_cohort(&server, "blobs", &shapes.collect::<Vec<_>>());
    let found = learn(&server, "modes", "blobs", &components(3, true));
    let scores: Vec<Vec<f64>> =
        encode(&server, "modes", &posted(0..20)).iter().map(|code| flat(&code["values"])).collect();
    let sum = |term: &dyn Fn(usize) -> f64| (0..20).map(|k| weight(k) * term(k)).sum::<f64>();
    let total = sum(&|_| 1.0);
    assert_eq!(found["statistics"]["weight"], total);
    let first = found["atoms"][0]["eigenvalue"].as_f64().unwrap();
    for i in 0..3 {
        assert_near(sum(&|k| scores[k][i]), 0.0, 1e-12 * first.sqrt(), "weighted mean score");
        for j in 0..3 {
            let product = sum(&|k| scores[k][i] * scores[k][j]);
            let eigenvalue = if i == j { found["atoms"][i]["eigenvalue"].as_f64().unwrap() } else { 0.0 };
            assert_near(product, eigenvalue, 1e-11 * first, "eigenvalue");
            let covariance = found["statistics"]["scores"]["covariance"][i][j].as_f64().unwrap();
            assert_near(product / (total - total / 20.0), covariance, 1e-11 * first, "covariance");
        }
    }
}

#[test]
fn the_gradient_of_a_prior_is_the_difference_of_its_energies() {
    let server = Setting::fresh().with_example().start();
    let (_, shapes) = example();
    learn(&server, "modes", "example-cells", &components(4, true));
    learn(&server, "atoms", "example-cells", &lasso(4, "aligned"));
    let points = rows(&shapes[5]["points"]);
    let mut probes = vec![json!({"control_points": points})];
    for k in 0..points.len() {
        for (c, step) in [(0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0)] {
            let mut probe = points.clone();
            probe[k][c] += step;
            probes.push(json!({"control_points": probe}));
        }
    }
    for (name, reference) in [("modes", "mean"), ("modes", "atoms"), ("atoms", "mean"), ("atoms", "atoms")] {
        let prior = |gamma: f64| {
            let question = json!({"shapes": probes, "reference": reference, "gamma": gamma});
            ask(&server, name, "prior", &question)["results"].as_array().unwrap().clone()
        };
        let priors = prior(0.5);
        let energies: Vec<f64> = priors.iter().map(|prior| prior["energy"].as_f64().unwrap()).collect();
        assert!(energies[0] > 0.0, "{name} {reference}");
        // The energy is quadratic: central differences are exact but for rounding, at any step.
        let differences: Vec<f64> =
            energies[1..].chunks_exact(2).map(|pair| (pair[0] - pair[1]) / 2.0).collect();
        let gradient = flat(&priors[0]["gradient"]);
        let most = gradient.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
        assert!(most > 0.0);
        for (found, wanted) in gradient.iter().zip(&differences) {
            assert_near(*found, *wanted, 1e-8 * most, &format!("{name} {reference}"));
        }
        assert_near(prior(2.0)[0]["energy"].as_f64().unwrap() / energies[0], 4.0, 1e-12, "gamma");
    }
}

#[test]
fn the_energy_of_a_prior_is_the_squared_distance_from_the_class_of_the_mean() {
    let server = Server::fresh();
    new_cohort(&server, "blobs", &blobs(0..20));
    let found = learn(&server, "modes", "blobs", &components(3, true));
    let mean = rows(&found["mean"]["control_points"]);
    let placed = json!({"points": moved(&mean, &turn(2.0, 3.0), [4.0, -7.0])});
    let shapes = [vec![placed], posted(0..5)].concat();
    let answer = ask(&server, "modes", "prior", &json!({ "shapes": shapes }));
    let energy = |k: usize| answer["results"][k]["energy"].as_f64().unwrap();
    assert!(energy(0) < 1e-26, "a member of the class: {}", energy(0));
    for k in 0..5 {
        let points = blob(k);
        let centroid = [0, 1].map(|c| points.iter().map(|p| p[c]).sum::<f64>() / POINTS as f64);
        let centred = moved(&points, &turn(0.0, 1.0), centroid.map(|value| -value));
        // The class of the mean is spanned by it and by it turned a quarter.
        let quarter = moved(&mean, &turn(TAU / 4.0, 1.0), [0.0; 2]);
        let inside = inner(&mean, &centred).powi(2) + inner(&quarter, &centred).powi(2);
        let wanted = inner(&centred, &centred) - inside / inner(&mean, &mean);
        assert_near(energy(k + 1), wanted, 1e-11 * inner(&centred, &centred), "energy");
    }
}

#[test]
fn the_seed_of_a_sample_decides() {
    let server = Setting::fresh().with_example().start();
    let found = learn(&server, "modes", "example-cells", &components(3, false));
    let draw = |body: Value| server.post("/v1/dictionaries/modes/sample", &body);
    let first = draw(json!({"count": 5, "seed": 7}));
    assert_eq!(first.expect(200)["shapes"].as_array().unwrap().len(), 5);
    assert_eq!(draw(json!({"count": 5, "seed": 7})).body, first.body);
    assert_ne!(draw(json!({"count": 5, "seed": 8})).body, first.body);
    // Fewer shapes are the first of more.
    assert_eq!(draw(json!({"count": 2, "seed": 7})).json()["shapes"][1], first.json()["shapes"][1]);
    let still = draw(json!({"sigma": 0.0, "seed": 3})).expect(200);
    let statistics = &found["statistics"]["scores"];
    assert_close(&still["shapes"][0]["scores"], &statistics["mean"], 1e-14, "no deviation");

    let many = draw(json!({"count": 4000, "seed": 1})).expect(200);
    let scores: Vec<Vec<f64>> =
        many["shapes"].as_array().unwrap().iter().map(|shape| flat(&shape["scores"])).collect();
    for i in 0..3 {
        let mean = statistics["mean"][i].as_f64().unwrap();
        let variance = statistics["covariance"][i][i].as_f64().unwrap();
        let found = scores.iter().map(|s| (s[i] - mean).powi(2)).sum::<f64>() / 4000.0;
        // The standard deviation of the ratio is √(2/4000) = 0.022.
        assert_near(found / variance, 1.0, 0.1, "variance");
    }
    // A drawn shape has the scores it was drawn with.
    let shape = &many["shapes"][0];
    let code = json!({"indices": [0, 1, 2], "values": shape["scores"]});
    let back = ask(&server, "modes", "reconstruct", &json!({"codes": [code]}));
    assert_close(&back["results"][0]["control_points"], &shape["control_points"], 1e-12, "shape");
}

// ---------------------------------------------------------------- pictures

#[test]
fn atoms_and_modes_are_shown_as_numbers_and_as_pictures() {
    let server = Setting::fresh().with_example().start();
    let found = learn(&server, "modes", "example-cells", &components(3, true));
    learn(&server, "atoms", "example-cells", &lasso(5, "invariant"));
    let read = |key: &str, what: &str| server.get(&format!("/v1/dictionaries/{key}/{what}"));
    assert_eq!(read("modes", "atoms").expect(200)["atoms"], found["atoms"]);
    for (key, count) in [("modes", 3), ("atoms", 5)] {
        let reply = read(key, "atoms?format=svg");
        let svg = reply.expect_svg();
        assert!(svg.matches("<path").count() >= count, "{svg}");
    }
    read("modes", "modes?component=2&sigma=1.5&format=svg").expect_svg();
    for component in 1..=3 {
        let mode = read("modes", &format!("modes?component={component}&sigma=1.5")).expect(200);
        let atom = &found["atoms"][component - 1];
        let variance = &found["statistics"]["scores"]["covariance"][component - 1][component - 1];
        let deviation = mode["deviation"].as_f64().unwrap();
        assert_near(deviation.powi(2), variance.as_f64().unwrap(), 1e-12, "deviation");
        assert_eq!(mode["explained"], atom["explained"]);
        let side = |name: &str| flat(&mode[name]["control_points"]);
        let (minus, mean, plus) = (side("minus"), side("mean"), side("plus"));
        assert_close(&json!(mean), &found["centre"], 1e-12, "the mean");
        for (i, value) in flat(&atom["control_points"]).iter().enumerate() {
            let step = 1.5 * deviation * value;
            assert_near(plus[i] - mean[i], step, 1e-12, "plus");
            assert_near(mean[i] - minus[i], step, 1e-12, "minus");
        }
    }
    let default = read("modes", "modes").expect(200);
    assert_eq!((&default["component"], &default["sigma"]), (&json!(1), &json!(2.0)));
}

// ---------------------------------------------------------------- files

/// The digest of a file as `docs/dictionaries.md` says: of the text of its content, byte for byte.
fn digest_of_text(file: &str) -> String {
    #[derive(serde::Deserialize)]
    struct File<'a> {
        #[serde(borrow)]
        content: &'a RawValue,
    }
    let file: File<'_> = serde_json::from_str(file).unwrap();
    blake3::hash(file.content.get().as_bytes()).to_hex().to_string()
}

fn import(server: &Server, file: &Value) -> Reply {
    server.post("/v1/dictionaries/import", file)
}

fn export(server: &Server, key: &str) -> Value {
    server.get(&format!("/v1/dictionaries/{key}/export")).expect(200)
}

#[test]
fn an_exported_dictionary_is_the_same_elsewhere() {
    let (here, there) = (Setting::fresh().with_example().start(), Server::fresh());
    let (_, shapes) = example();
    for (name, method) in
        [("modes", components(4, true)), ("aligned", lasso(6, "aligned")), ("free", lasso(4, "invariant"))]
    {
        let original = learn(&here, name, "example-cells", &method);
        let reply = here.get(&format!("/v1/dictionaries/{name}/export"));
        let file = reply.expect(200);
        let disposition = format!("attachment; filename=\"{name}-1.json\"");
        assert_eq!(reply.header("content-disposition"), Some(disposition.as_str()));
        assert_eq!(file["digest"], original["provenance"]["digest"]);
        assert_eq!(file["digest"], digest_of_text(reply.text()));

        let imported = there.post_bytes("/v1/dictionaries/import", JSON, reply.body.clone());
        let copy = imported.expect(201);
        let location = format!("/v1/dictionaries/{}", copy["id"].as_str().unwrap());
        assert_eq!(imported.header("location"), Some(location.as_str()));
        assert_eq!(there.get(&location).expect(200), copy);
        assert_eq!((&copy["name"], &copy["version"]), (&json!(name), &json!(1)));
        assert_eq!(copy["provenance"]["digest"], file["digest"]);
        assert_eq!(encode(&there, name, &shapes), encode(&here, name, &shapes), "{name}");
        let again = there.get(&format!("/v1/dictionaries/{name}/export"));
        assert_eq!(again.body, reply.body, "{name}: exported again");

        assert_eq!(import(&there, &file).expect(201)["version"], 2);
        let renamed = there.post("/v1/dictionaries/import?name=other", &file).expect(201);
        assert_eq!(renamed["name"], "other");
    }
    // There are no sums to go on from, and no cohort.
    let cohort = dictionary(&here, "modes")["cohort"].clone();
    let body = json!({"name": "modes", "cohort": cohort, "continue_from": "modes"});
    there.post("/v1/dictionaries", &body).expect_problem(404, "not-found", &["/cohort"]);
    import(&here, &export(&here, "modes")).expect(201);
    here.post("/v1/dictionaries", &body).expect_problem(422, "invalid-input", &["/continue_from"]);
}

/// Earlier versions named the generator `cubic` after Keys; their files keep their digests.
#[test]
fn a_file_with_the_former_name_of_a_generator_is_imported_and_exported_unchanged() {
    let (here, there) = (Server::fresh(), Server::fresh());
    let representation = json!({"kind": "closed_curve", "dimension": 2, "control_points": POINTS, "generator": {"name": "cubic"}});
    let cohort = json!({"name": "cubic", "correspondence": "landmarks", "representation": representation});
    here.post("/v1/cohorts", &cohort).expect(201);
    let shapes = posted(0..9);
    add_shapes(&here, "cubic", &shapes);
    learn(&here, "modes", "cubic", &components(4, true));
    let present = here.get("/v1/dictionaries/modes/export").text().to_owned();
    let (name, former_name) = (r#"{"name":"cubic"}"#, r#"{"name":"keys"}"#);
    assert!(present.contains(name), "{present}");
    let former = present.replace(name, former_name);
    let former = former.replace(&digest_of_text(&present), &digest_of_text(&former));
    let copy = there.post_bytes("/v1/dictionaries/import", JSON, former.clone().into_bytes()).expect(201);
    assert_eq!(copy["representation"]["generator"], json!({"name": "cubic"}));
    assert_eq!(copy["provenance"]["digest"], digest_of_text(&former));
    assert_eq!(there.get("/v1/dictionaries/modes/export").text(), former);
    assert_eq!(encode(&there, "modes", &shapes), encode(&here, "modes", &shapes));
}

#[test]
fn whatever_is_learnt_can_be_imported_and_used() {
    let (here, there) = (Server::fresh(), Server::fresh());
    new_cohort(&here, "blobs", &blobs(0..20));
    // More atoms than there are different shapes, and no variation at all.
    new_cohort(&here, "copies", &posted((0..20).map(|k| k % 3)));
    new_cohort(&here, "still", &posted([4; 12]));
    let option = |mut method: Value, field: &str, value: Value| {
        method[field] = value;
        method
    };
    let cases = [
        ("affine", "projection", lasso(4, "invariant")),
        ("non_uniform_scaling_translation", "projection", pursuit(4, "invariant")),
        ("uniform_scaling", "projection", lasso(4, "invariant")),
        ("affine", "projection", option(lasso(4, "aligned"), "nonnegative", json!(true))),
        ("translation", "projection", option(lasso(4, "aligned"), "normalise", json!(false))),
        (
            "horizontal_shear_translation",
            "projection",
            option(pursuit(4, "aligned"), "schedule", json!("batch")),
        ),
        ("rigid", "procrustes", components(20, true)),
        ("similarity", "procrustes", lasso(4, "aligned")),
        ("reflected_similarity", "projection", components(20, false)),
    ];
    for (k, (class, alignment, method)) in cases.iter().enumerate() {
        for cohort in ["blobs", "copies", "still"] {
            let name = format!("{cohort}-{k}");
            let mut body = request(&name, cohort, method);
            (body["transformation"], body["alignment"]) = (json!(class), json!(alignment));
            let found = learnt(&here, &body).expect(201);
            let copy = import(&there, &export(&here, &name)).expect(201);
            assert_eq!(copy["provenance"]["digest"], found["provenance"]["digest"], "{name}");
            let shapes = posted(0..4);
            assert_eq!(encode(&there, &name, &shapes), encode(&here, &name, &shapes), "{name}");
            for what in ["reconstruct", "score"] {
                ask(&there, &name, what, &json!({ "shapes": shapes }));
            }
            there.get(&format!("/v1/dictionaries/{name}/atoms?format=svg")).expect_svg();
        }
    }
}

#[test]
fn shapes_that_are_all_the_same_have_no_components() {
    let server = Server::fresh();
    new_cohort(&server, "still", &posted([4; 12]));
    let found = learn(&server, "still", "still", &components(5, true));
    assert_eq!(found["atoms"], json!([]));
    assert_eq!(found["statistics"]["scores"]["covariance"], json!([]));
    assert!(found["statistics"]["reconstruction_error"].as_f64().unwrap() < 1e-24);
    let shapes = posted([4, 5]);
    let codes = encode(&server, "still", &shapes);
    assert_eq!((&codes[1]["indices"], &codes[1]["values"]), (&json!([]), &json!([])));
    let answer = ask(&server, "still", "score", &json!({ "shapes": shapes }));
    let novelty = &answer["results"][1]["novelty"];
    assert_eq!((&novelty["t_squared"], &novelty["is_outlier"]), (&json!(0.0), &json!(true)));
    let drawn = ask(&server, "still", "sample", &json!({"count": 3}));
    assert_close(&drawn["shapes"][2]["control_points"], &found["centre"], 1e-14, "the mean");
    server.get("/v1/dictionaries/still/modes").expect_problem(400, "invalid-query", &[]);
    server.get("/v1/dictionaries/still/atoms?format=svg").expect_svg();
    import(&server, &export(&server, "still")).expect(201);
}

// ---------------------------------------------------------------- going on

/// Goes on from a version, under the name `next`.
fn continued(server: &Server, cohort: &str, version: &str) -> Reply {
    learnt(server, &json!({"name": "next", "cohort": cohort, "continue_from": version}))
}

#[test]
fn components_go_on_with_the_shapes_that_came_since() {
    let server = Server::fresh();
    for centre in [true, false] {
        let cohort = format!("blobs-{centre}");
        new_cohort(&server, &cohort, &blobs(0..20));
        let first = learn(&server, &cohort, &cohort, &components(3, centre));
        add_shapes(&server, &cohort, &blobs(20..27));
        // In the pose of the first version, whose mean stays.
        let codes = encode(&server, &cohort, &posted(0..27));
        let aligned: Vec<Rows> = codes.iter().enumerate().map(|(k, code)| posed(&blob(k), code)).collect();

        let second = continued(&server, &cohort, &cohort).expect(201);
        assert_eq!(second["provenance"]["continued_from"], first["id"]);
        assert_eq!(first["provenance"]["continued_from"], Value::Null);
        assert_eq!((&second["name"], &second["method"]), (&json!("next"), &first["method"]));
        assert_eq!(second["mean"], first["mean"]);
        assert_ne!(second["provenance"]["digest"], first["provenance"]["digest"]);
        let statistics = &second["statistics"];
        assert_eq!((&statistics["shapes"], &statistics["weight"]), (&json!(27), &json!(27.0)));

        let average: Rows = (0..POINTS)
            .map(|i| [0, 1].map(|c| aligned.iter().map(|shape| shape[i][c]).sum::<f64>() / 27.0))
            .collect();
        assert_close(&second["centre"], &json!(average), 1e-12, "centre");
        let origin = if centre { average } else { vec![[0.0; 2]; POINTS] };
        let total: f64 = aligned.iter().map(|shape| squared_distance(shape, &origin)).sum();
        assert_near(statistics["total"].as_f64().unwrap() / total, 1.0, 1e-11, "total");
        for atom in second["atoms"].as_array().unwrap() {
            let xi = rows(&atom["control_points"]);
            let scores = aligned.iter().map(|shape| inner(shape, &xi) - inner(&origin, &xi));
            let energy: f64 = scores.map(|score| score * score).sum();
            assert_near(energy / total, atom["explained"].as_f64().unwrap(), 1e-11, "explained");
        }
    }
}

#[test]
fn atoms_go_on_with_the_shapes_that_came_since() {
    let server = Server::fresh();
    for (name, method) in [("aligned", lasso(5, "aligned")), ("free", lasso(4, "invariant"))] {
        new_cohort(&server, name, &blobs(0..30));
        let first = learn(&server, name, name, &method);
        add_shapes(&server, name, &blobs(30..45));
        let before = encode(&server, name, &posted(0..45));
        let second = continued(&server, name, name).expect(201);
        assert_eq!(second["provenance"]["continued_from"], first["id"]);
        assert_eq!(second["statistics"]["shapes"], 45);
        assert_eq!(second["mean"], first["mean"]);
        assert_ne!(second["atoms"], first["atoms"]);
        let mean = |codes: &[Value]| {
            codes.iter().map(|code| code["objective"].as_f64().unwrap()).sum::<f64>() / 45.0
        };
        let after = mean(&encode(&server, "next", &posted(0..45)));
        assert_near(second["statistics"]["objective"].as_f64().unwrap(), after, 1e-10, name);
        assert!(after <= mean(&before), "{name}: {after} after {}", mean(&before));
    }
}

#[test]
fn learning_goes_on_only_where_sums_say_what_was_learnt() {
    let server = Server::fresh();
    new_cohort(&server, "blobs", &blobs(0..20));
    new_cohort(&server, "other", &blobs(0..20));
    learn(&server, "modes", "blobs", &components(3, true));
    continued(&server, "blobs", "modes").expect_problem(422, "too-few-shapes", &[]);
    continued(&server, "other", "modes").expect_problem(422, "invalid-input", &["/continue_from"]);
    continued(&server, "blobs", "modes@7").expect_problem(404, "not-found", &["/continue_from"]);
    add_shapes(&server, "blobs", &blobs(20..22));
    let parameters = json!({"filter": {}, "transformation": "affine", "alignment": "projection",
        "frame": "training", "mirror": "forbid", "method": components(3, true)});
    for (field, value) in parameters.as_object().unwrap() {
        let body = json!({"name": "modes", "cohort": "blobs", "continue_from": "modes", field: value});
        let pointer = format!("/{field}");
        server.post("/v1/dictionaries", &body).expect_problem(422, "invalid-input", &[&pointer]);
    }
    assert_eq!(server.delete("/v1/cohorts/blobs/shapes/3").status, 204);
    continued(&server, "blobs", "modes").expect_problem(422, "invalid-input", &["/continue_from"]);
    assert_eq!(listed(&server, "").len(), 1);
}

// ---------------------------------------------------------------- what is refused

/// `body` with `value` at the pointer, which may be new; none takes it away.
fn with(body: &Value, pointer: &str, value: Option<Value>) -> Value {
    let mut body = body.clone();
    let (parent, field) = pointer.rsplit_once('/').unwrap();
    match (body.pointer_mut(parent).unwrap(), value) {
        (Value::Object(map), Some(value)) => drop(map.insert(field.into(), value)),
        (Value::Object(map), None) => drop(map.remove(field).unwrap()),
        (Value::Array(items), Some(value)) => items[field.parse::<usize>().unwrap()] = value,
        (Value::Array(items), None) => drop(items.remove(field.parse().unwrap())),
        (other, _) => panic!("{other} has no fields"),
    }
    body
}

/// Rows of points that are all the same.
fn all_at(point: &[f64]) -> Value {
    json!(vec![point; POINTS])
}

/// Requests to learn that are refused, changed at a pointer, and the pointers that are told.
fn bad_requests() -> Vec<(Value, &'static str, Option<Value>, Vec<&'static str>)> {
    let modes = request("never", "blobs", &components(3, true));
    let atoms = request("never", "blobs", &lasso(4, "aligned"));
    let few = request("never", "blobs", &pursuit(4, "aligned"));
    let free = request("never", "blobs", &lasso(4, "invariant"));
    let mut cases = Vec::new();
    let mut add = |body: &Value, pointer, values: &[Value], told: &[&'static str]| {
        for value in values {
            cases.push((body.clone(), pointer, Some(value.clone()), told.to_vec()));
        }
    };
    add(&atoms, "/method/lambda", &[json!(0), json!(-0.0), json!(-1), json!(1e200)], &["/method/lambda"]);
    add(&atoms, "/method/lambda", &[json!("1"), json!([1]), json!({})], &["/method/lambda"]);
    // Neither, and both.
    add(&atoms, "/method/lambda", &[Value::Null], &["/method/lambda"]);
    add(&atoms, "/method/nonzeros", &[json!(2)], &["/method/nonzeros"]);
    add(&few, "/method/nonzeros", &[json!(0), json!(5), json!(1_u64 << 40)], &["/method/nonzeros"]);
    add(&few, "/method/nonzeros", &[json!(-1), json!(1.5)], &["/method/nonzeros"]);
    add(&atoms, "/method/atoms", &[json!(0), json!(21), json!(1025), json!(1_u64 << 60)], &["/method/atoms"]);
    add(&atoms, "/method/atoms", &[json!(-1), json!(2.5), Value::Null], &["/method/atoms"]);
    add(&atoms, "/method/max_epochs", &[json!(0), json!(10_001)], &["/method/max_epochs"]);
    add(&atoms, "/method/tolerance", &[json!(-1e-9), json!(1)], &["/method/tolerance"]);
    add(&atoms, "/method/seed", &[json!(-1), json!(0.5)], &["/method/seed"]);
    add(&atoms, "/method/schedule", &[json!("often")], &["/method/schedule"]);
    add(&atoms, "/method/colour", &[json!("red")], &["/method/colour"]);
    add(&modes, "/method/components", &[json!(0), json!(1025)], &["/method/components"]);
    add(&modes, "/method/kind", &[json!("magic"), Value::Null], &["/method/kind"]);
    add(&modes, "/method", &[json!("functional_pca"), json!([]), Value::Null], &["/method"]);
    add(&few, "/method/nonnegative", &[json!(true)], &["/method/nonnegative"]);
    add(&free, "/method/nonnegative", &[json!(true)], &["/method/nonnegative"]);
    add(&free, "/method/normalise", &[json!(false)], &["/method/normalise"]);
    let not_closed =
        ["translation", "horizontal_shear", "vertical_shear_translation", "reflected_similarity"];
    add(&free, "/transformation", &not_closed.map(Value::from), &["/method/codes"]);
    let shears = json!({"matrices": [[[1, 0], [0, 1]], [[0, 1], [0, 0]]], "translation": true});
    add(&free, "/transformation", &[shears], &["/method/codes"]);
    add(&free, "/alignment", &[json!("procrustes")], &["/method/codes"]);
    add(
        &modes,
        "/transformation",
        &[json!("magic"), json!(7), json!({"matrices": []})],
        &["/transformation"],
    );
    // Rigid motions are no linear class.
    let mut projected = modes.clone();
    projected["alignment"] = json!("projection");
    add(&projected, "/transformation", &[json!("rigid")], &["/transformation"]);
    add(&modes, "/alignment", &[json!("magic")], &["/alignment"]);
    add(&modes, "/frame", &[json!("magic"), json!(1)], &["/frame"]);
    add(&modes, "/mirror", &[json!("magic")], &["/mirror"]);
    let names = ["", "a/b", "a b", "a@1", ".a", "dic_1", "ä", &"x".repeat(101)].map(Value::from);
    add(&modes, "/name", &names, &["/name"]);
    add(&modes, "/name", &[json!(7), json!(["a"])], &["/name"]);
    add(&modes, "/cohort", &[json!(7)], &["/cohort"]);
    add(&modes, "/filter", &[json!("all"), json!(7)], &["/filter"]);
    add(&modes, "/filter", &[json!({"colour": "red"})], &["/filter/colour"]);
    add(&modes, "/dry_run", &[json!("yes")], &["/dry_run"]);
    add(&modes, "/colour", &[json!("red")], &["/colour"]);
    for field in ["/name", "/cohort", "/transformation", "/method"] {
        cases.push((modes.clone(), field, None, vec![field]));
    }
    cases
}

#[test]
fn what_cannot_be_learnt_is_refused_before_there_is_a_job() {
    let server = Server::fresh();
    new_cohort(&server, "blobs", &blobs(0..20));
    let mut differences = Differences::default();
    for (body, pointer, value, told) in bad_requests() {
        let what = format!("{pointer} {value:?}");
        let reply = server.post("/v1/dictionaries", &with(&body, pointer, value));
        differences.compare(&what, &reply, &Wanted::invalid(&told));
    }
    let modes = request("never", "blobs", &components(3, true));
    let refused: [(&str, Value, Wanted); 3] = [
        ("/cohort", json!("nothing"), Wanted::new(404, "not-found", &["/cohort"])),
        ("/filter", json!({"label": "nothing"}), Wanted::new(422, "invalid-input", &["/filter/label"])),
        ("/filter", json!({"labels": {"a": "b"}}), Wanted::new(422, "invalid-input", &["/filter/labels/a"])),
    ];
    for (pointer, value, wanted) in refused {
        let reply = server.post("/v1/dictionaries", &with(&modes, pointer, Some(value.clone())));
        differences.compare(&format!("{pointer} {value}"), &reply, &wanted);
    }
    // Everything that is wrong is told at once.
    let mut bad = request("a b", "blobs", &json!({"kind": "sparse", "atoms": 0, "max_epochs": 0}));
    let told = ["/name", "/method/atoms", "/method/lambda", "/method/max_epochs"];
    differences.compare("all", &server.post("/v1/dictionaries", &bad), &Wanted::invalid(&told));
    bad["dry_run"] = json!(true);
    differences.compare("a dry run", &server.post("/v1/dictionaries", &bad), &Wanted::invalid(&told));

    let text = request("never", "blobs", &lasso(4, "aligned")).to_string();
    for number in ["NaN", "1e999", "-Infinity", "0x1", "1."] {
        let reply = server.post_bytes("/v1/dictionaries", JSON, text.replace(&LAMBDA.to_string(), number));
        assert_eq!((reply.status, &reply.json()["code"]), (400, &json!("malformed-body")), "{number}");
    }
    for body in ["", "{", "[]", "null", "7"] {
        let reply = server.post_bytes("/v1/dictionaries", JSON, body);
        assert!((400..=422).contains(&reply.status), "{body}: {}", reply.text());
    }
    drop(differences);
    assert_eq!(server.get("/v1/jobs").expect(200)["items"], json!([]));
    assert_eq!(listed(&server, ""), Vec::<Value>::new());
    server.assert_alive();
}

#[test]
fn more_memory_than_jobs_are_given_is_refused() {
    let server = Setting::fresh().flags(&["--max-job-bytes", "50000", "--max-atoms", "8"]).start();
    new_cohort(&server, "blobs", &blobs(0..20));
    let ask = |method: &Value| server.post("/v1/dictionaries", &request("never", "blobs", method));
    ask(&lasso(9, "aligned")).expect_problem(422, "invalid-input", &["/method/atoms"]);
    ask(&components(9, true)).expect_problem(422, "invalid-input", &["/method/components"]);
    ask(&lasso(8, "invariant")).expect_problem(422, "invalid-input", &["/method"]);
    let id = submit(&server, &request("small", "blobs", &components(8, true)));
    assert_eq!(finished(&server, &id)["status"], "succeeded");
}

#[test]
fn shapes_that_cannot_be_learnt_from_fail_the_job_by_name() {
    let server = Server::fresh();
    let line: Rows = (0..POINTS).map(|i| [i as f64, 2.0 * i as f64]).collect();
    new_cohort(
        &server,
        "blobs",
        &[blobs(0..5), vec![json!({"external_id": "line", "points": line})]].concat(),
    );
    let id = server.get("/v1/cohorts/blobs/shapes/line").expect(200)["id"].clone();
    for method in [components(2, true), lasso(3, "invariant")] {
        let mut body = request("never", "blobs", &method);
        body["transformation"] = json!("affine");
        let failed = finished(&server, &submit(&server, &body));
        assert_eq!((&failed["status"], &failed["result"]), (&json!("failed"), &Value::Null));
        let problem = &failed["problem"];
        assert_eq!(
            (&problem["status"], &problem["code"]),
            (&json!(422), &json!("degenerate-shape")),
            "{problem}"
        );
        assert!(problem["detail"].as_str().unwrap().contains(id.as_str().unwrap()), "{problem}");
        // Who waits is told the same.
        let told = learnt(&server, &body).expect_problem(422, "degenerate-shape", &[""]);
        assert_eq!((&told["detail"], &told["errors"]), (&problem["detail"], &problem["errors"]));
    }
    let mean = server.get("/v1/cohorts/blobs/mean?transformation=affine");
    let problem = mean.expect_problem(422, "degenerate-shape", &[""]);
    assert!(problem["detail"].as_str().unwrap().contains(id.as_str().unwrap()), "{problem}");
    assert_eq!(listed(&server, ""), Vec::<Value>::new());
}

/// A server with the components `modes` and the sparse atoms `aligned` and `free` of the cohort `blobs`.
fn with_dictionaries() -> Server {
    let server = Server::fresh();
    new_cohort(&server, "blobs", &blobs(0..20));
    learn(&server, "modes", "blobs", &components(3, true));
    learn(&server, "aligned", "blobs", &lasso(4, "aligned"));
    learn(&server, "free", "blobs", &lasso(4, "invariant"));
    server
}

/// The question `what` with a good shape, `shape`, and a good shape.
fn asked_with(shape: &str) -> String {
    format!(r#"{{"shapes":[{{"points":{0}}},{shape},{{"points":{0}}}]}}"#, json!(blob(1)))
}

#[test]
fn bad_shapes_are_named_whatever_is_asked_about_them() {
    let server = with_dictionaries();
    let mut differences = Differences::default();
    let points = |change: &dyn Fn(&mut Value)| {
        let mut points = json!(blob(2));
        change(&mut points);
        json!({ "points": points }).to_string()
    };
    let text = points(&|_| {});
    let number = blob(2)[1][0].to_string();
    let malformed = || Wanted::new(400, "malformed-body", &["/points/1/0"]);
    let cases: Vec<(String, Wanted)> = vec![
        (text.replace(&number, "NaN"), malformed()),
        (text.replace(&number, "1e999"), malformed()),
        (points(&|p| p[1][1] = json!(1e200)), Wanted::invalid(&["/points/1/1"])),
        (points(&|p| p[1][1] = Value::Null), Wanted::invalid(&["/points/1/1"])),
        (points(&|p| p[1] = json!([1, 2, 3])), Wanted::invalid(&["/points/1"])),
        (points(&|p| *p = all_at(&[1.0, 2.0, 3.0])), Wanted::invalid(&["/points/0"])),
        (points(&|p| *p = json!([[0, 1], [2, 3]])), Wanted::invalid(&["/points"])),
        (points(&|p| *p = json!([])), Wanted::invalid(&["/points"])),
        ("{}".into(), Wanted::invalid(&[""])),
        ("7".into(), Wanted::invalid(&[""])),
    ];
    for (shape, wanted) in cases {
        let wanted = wanted.below("/shapes/1", Some(1), None);
        for key in ["modes", "aligned", "free"] {
            for what in ["encode", "reconstruct", "score", "prior"] {
                let path = format!("/v1/dictionaries/{key}/{what}");
                let reply = server.post_bytes(&path, JSON, asked_with(&shape));
                differences.compare(&format!("{path} {shape:.80}"), &reply, &wanted);
            }
        }
    }
    // A point has no direction and no size; a prior measures only how far it is away.
    let dot = json!({"points": all_at(&[5.0, 7.0])}).to_string();
    let wanted = Wanted::new(422, "degenerate-shape", &[""]).below("/shapes/1", Some(1), None);
    for key in ["modes", "aligned", "free"] {
        for what in ["encode", "reconstruct", "score"] {
            let path = format!("/v1/dictionaries/{key}/{what}");
            differences.compare(&path, &server.post_bytes(&path, JSON, asked_with(&dot)), &wanted);
        }
        let prior =
            server.post_bytes(&format!("/v1/dictionaries/{key}/prior"), JSON, asked_with(&dot)).expect(200);
        assert!(prior["results"][1]["energy"].as_f64().unwrap() < 1e-26, "{prior}");
    }
    server.assert_alive();
}

#[test]
fn questions_that_make_no_sense_are_refused() {
    let server = with_dictionaries();
    let space = json!({"kind": "landmarks", "dimension": 3, "points": POINTS});
    server.post("/v1/cohorts", &json!({"name": "space", "representation": space})).expect(201);
    let cyclic = json!({"kind": "closed_curve", "dimension": 2, "control_points": POINTS,
        "generator": {"name": "trigonometric"}});
    server.post("/v1/cohorts", &json!({"name": "curves", "representation": cyclic})).expect(201);
    let mut differences = Differences::default();
    let good = json!({"shapes": posted(0..2)});
    let stored = json!({"cohort": "blobs", "ids": ["0", "1"]});
    let not_found = || Wanted::new(404, "not-found", &[]);
    let invalid = |pointer: &str| Wanted::invalid(&[pointer]);
    for key in ["modes", "aligned", "free"] {
        for what in ["encode", "reconstruct", "score", "prior"] {
            let mut check = |body: &Value, wanted: &Wanted| {
                let reply = server.post(&format!("/v1/dictionaries/{key}/{what}"), body);
                differences.compare(&format!("{key} {what} {body}"), &reply, wanted);
            };
            let unknown = Wanted::invalid(&["/1", "/2"]).below("/ids", None, None);
            check(&with(&stored, "/ids", Some(json!(["0", "x", "shp_y", "1"]))), &unknown);
            check(
                &with(&stored, "/cohort", Some(json!("nothing"))),
                &Wanted::new(404, "not-found", &["/cohort"]),
            );
            check(&with(&stored, "/cohort", Some(json!("space"))), &invalid("/cohort"));
            check(&with(&stored, "/cohort", Some(json!("curves"))), &invalid("/cohort"));
            check(&with(&stored, "/ids", Some(json!([]))), &Wanted::new(422, "too-few-shapes", &[]));
            check(&with(&stored, "/ids", Some(json!("0"))), &invalid("/ids"));
            check(&with(&stored, "/ids", Some(json!([0]))), &invalid("/ids/0"));
            check(&with(&stored, "/shapes", Some(good["shapes"].clone())), &invalid(""));
            check(&with(&stored, "/cohort", None), &invalid(""));
            check(&with(&stored, "/ids", None), &invalid(""));
            check(&json!({}), &invalid(""));
            check(&json!({"shapes": []}), &Wanted::new(422, "too-few-shapes", &[]));
            check(&json!({"shapes": 7}), &invalid("/shapes"));
            check(&with(&good, "/colour", Some(json!("red"))), &invalid("/colour"));
        }
    }
    let mut check = |path: &str, body: &Value, field: &str, values: &[Value]| {
        for value in values {
            let reply =
                server.post(&format!("/v1/dictionaries/{path}"), &with(body, field, Some(value.clone())));
            differences.compare(&format!("{path} {field} {value}"), &reply, &Wanted::invalid(&[field]));
        }
    };
    check("modes/reconstruct", &good, "/pose", &[json!("magic"), json!(1)]);
    check("modes/reconstruct", &good, "/samples", &[json!(-1), json!(1.5), json!(1_u64 << 50)]);
    check("modes/score", &good, "/quantile", &[json!(0.49), json!(1), json!(-1), json!("0.9")]);
    check("modes/prior", &good, "/gamma", &[json!(0), json!(-1), json!(1e101), json!("1")]);
    check("modes/prior", &good, "/reference", &[json!("magic"), json!(1)]);
    let draw = json!({"count": 1});
    check("modes/sample", &draw, "/count", &[json!(0), json!(-1), json!(1.5), json!(1_u64 << 40)]);
    check("modes/sample", &draw, "/sigma", &[json!(-1), json!(1.1e6), json!("1")]);
    check("modes/sample", &draw, "/seed", &[json!(-1), json!(0.5)]);
    check("modes/sample", &draw, "/colour", &[json!("red")]);
    for number in ["NaN", "1e999", "-Infinity"] {
        let cases = [("modes/sample", "sigma"), ("modes/score", "quantile"), ("modes/prior", "gamma")];
        for (path, field) in cases {
            let body = format!(r#"{{"{field}":{number}}}"#);
            let reply = server.post_bytes(&format!("/v1/dictionaries/{path}"), JSON, body);
            let wanted = Wanted::new(400, "malformed-body", &[&format!("/{field}")]);
            differences.compare(&format!("{path} {field} {number}"), &reply, &wanted);
        }
    }
    // A sparse dictionary does not say how shapes spread.
    for key in ["aligned", "free"] {
        let reply = server.post(&format!("/v1/dictionaries/{key}/sample"), &draw);
        differences.compare(&format!("{key} sample"), &reply, &invalid(""));
        let mode = server.get(&format!("/v1/dictionaries/{key}/modes"));
        differences.compare(&format!("{key} modes"), &mode, &Wanted::new(400, "invalid-query", &[]));
    }
    let queries = [
        "component=0",
        "component=4",
        "component=-1",
        "component=x",
        "sigma=NaN",
        "sigma=inf",
        "sigma=1e7",
        "sigma=-1e7",
        "sigma=x",
        "colour=red",
    ];
    for query in queries {
        let reply = server.get(&format!("/v1/dictionaries/modes/modes?{query}"));
        differences.compare(query, &reply, &Wanted::new(400, "invalid-query", &[]));
    }
    assert_eq!(server.get("/v1/dictionaries/modes/modes?sigma=-1").expect(200)["sigma"], -1.0);
    // Procrustes fits have no projector.
    let mut body = request("turned", "blobs", &components(2, true));
    body["alignment"] = json!("procrustes");
    learnt(&server, &body).expect(201);
    differences.compare(
        "no projector",
        &server.post("/v1/dictionaries/turned/prior", &good),
        &invalid("/reference"),
    );
    for what in ["encode", "reconstruct", "score", "prior", "sample"] {
        let reply = server.post(&format!("/v1/dictionaries/nothing/{what}"), &good);
        differences.compare(what, &reply, &not_found());
    }
    for what in ["", "/atoms", "/modes", "/export"] {
        let reply = server.get(&format!("/v1/dictionaries/nothing{what}"));
        differences.compare(what, &reply, &not_found());
    }
    server.assert_alive();
}

#[test]
fn codes_that_do_not_fit_are_refused() {
    let server = with_dictionaries();
    let mut differences = Differences::default();
    let good = json!({"indices": [2, 0], "values": [1.0, -0.5]});
    let unit = json!([[1, 0], [0, 1]]);
    let moved = json!({"indices": [2, 0], "matrices": [unit, unit], "offset": [3, 4]});
    for (key, code) in [("modes", &good), ("aligned", &good), ("free", &moved)] {
        ask(&server, key, "reconstruct", &json!({ "codes": [code] }));
        let mut check = |pointer: &str, value: Option<Value>, told: &[&str]| {
            let what = format!("{key} {pointer} {value:?}");
            let body = json!({"codes": [code, with(code, pointer, value)]});
            let reply = server.post(&format!("/v1/dictionaries/{key}/reconstruct"), &body);
            differences.compare(&what, &reply, &Wanted::invalid(told).below("/codes/1", Some(1), None));
        };
        check("/indices/1", Some(json!(4)), &["/indices/1"]);
        check("/indices/1", Some(json!(1_u64 << 60)), &["/indices/1"]);
        check("/indices/1", Some(json!(2)), &["/indices/1"]);
        if key == "free" {
            check("/matrices", None, &["/matrices"]);
            check("/matrices/0", None, &["/matrices"]);
            check("/matrices/0/0", None, &["/matrices"]);
            check("/matrices/1/1", Some(json!([1, 2, 3])), &["/matrices"]);
            check("/matrices/0/0/0", Some(json!(1e200)), &["/matrices"]);
            check("/values", Some(json!([1, 2])), &["/matrices"]);
            check("/offset", Some(json!([1])), &["/offset"]);
            check("/offset/0", Some(json!(-1e101)), &["/offset"]);
        } else {
            check("/values", None, &["/values"]);
            check("/values/1", None, &["/values"]);
            check("/values/1", Some(json!(1e200)), &["/values"]);
            check("/matrices", Some(moved["matrices"].clone()), &["/values"]);
            check("/offset", Some(json!([0, 0])), &["/values"]);
        }
        let mut refused = |body: &Value, told: &[&str]| {
            let reply = server.post(&format!("/v1/dictionaries/{key}/reconstruct"), body);
            differences.compare(&format!("{key} {body}"), &reply, &Wanted::invalid(told));
        };
        refused(&json!({"codes": []}), &["/codes"]);
        refused(&json!({"codes": 7}), &["/codes"]);
        refused(&json!({"codes": [code], "pose": "input"}), &["/codes"]);
        refused(&json!({"codes": [code], "shapes": posted(0..1)}), &["/codes"]);
        refused(&json!({"codes": [code, {"values": [1]}]}), &["/codes/1"]);
        refused(&json!({"codes": [code, with(code, "/colour", Some(json!(1)))]}), &["/codes/1/colour"]);
        refused(&json!({"codes": [with(code, "/indices/0", Some(json!(-1)))]}), &["/codes/0/indices/0"]);
    }
}

/// The file with `value` at a pointer into its content, and with the digest that belongs to it.
fn resealed(file: &Value, pointer: &str, value: Option<Value>) -> Value {
    let mut file = with(file, &format!("/content{pointer}"), value);
    let content: Content = serde_json::from_value(file["content"].clone()).unwrap();
    file["digest"] = json!(blake3::hash(&serde_json::to_vec(&content).unwrap()).to_hex().as_str());
    file
}

#[test]
fn a_file_that_was_changed_or_is_none_is_not_imported() {
    let server = with_dictionaries();
    let file = export(&server, "modes");
    let before = listed(&server, "");
    let mut differences = Differences::default();
    let mut check = |what: &str, file: &Value, told: &[&str]| {
        differences.compare(what, &import(&server, file), &Wanted::invalid(told));
    };
    let pointer = "/content/atoms/1/control_points/3/0";
    let digit = file.pointer(pointer).unwrap().as_f64().unwrap();
    check("the last digit", &with(&file, pointer, Some(json!(digit.next_up()))), &["/digest"]);
    check("a parameter", &with(&file, "/content/method/centre", Some(json!(false))), &["/digest"]);
    check("the digest", &with(&file, "/digest", Some(json!("0"))), &["/digest"]);
    check("the version", &with(&file, "/format_version", Some(json!(5))), &["/format"]);
    check("the format", &with(&file, "/format", Some(json!("other"))), &["/format"]);
    check("the name", &with(&file, "/name", Some(json!("a b"))), &["/name"]);
    check("a field", &with(&file, "/colour", Some(json!(1))), &["/colour"]);
    check("a field inside", &with(&file, "/content/colour", Some(json!(1))), &["/content/colour"]);
    check("a lost number", &with(&file, pointer, Some(Value::Null)), &[pointer]);
    check("a text", &with(&file, "/content/atoms", Some(json!("all"))), &["/content/atoms"]);
    check("no content", &with(&file, "/content", None), &[""]);
    for (what, garbage) in
        [("object", json!({})), ("list", json!([])), ("text", json!("x")), ("null", Value::Null)]
    {
        check(what, &garbage, &[""]);
    }
    for body in ["", "garbage", "{\"format\":", "\u{1}\u{2}"] {
        let reply = server.post_bytes("/v1/dictionaries/import", JSON, body);
        assert_eq!((reply.status, &reply.json()["code"]), (400, &json!("malformed-body")), "{body}");
    }
    let text = file.to_string().replace(&digit.to_string(), "NaN");
    assert_eq!(server.post_bytes("/v1/dictionaries/import", JSON, text).status, 400);
    server.post("/v1/dictionaries/import?name=a%20b", &file).expect_problem(422, "invalid-input", &["/name"]);
    server.post("/v1/dictionaries/import?colour=red", &file).expect_problem(400, "invalid-query", &[]);
    assert_eq!(listed(&server, ""), before);
    // What the tests change is wrong because of the change alone.
    import(&server, &resealed(&file, "/method/components", Some(json!(3)))).expect(201);
}

#[test]
fn a_file_whose_parts_do_not_fit_together_is_not_imported() {
    let server = with_dictionaries();
    let before = listed(&server, "");
    let (modes, aligned, free) =
        (export(&server, "modes"), export(&server, "aligned"), export(&server, "free"));
    let mut differences = Differences::default();
    let mut check = |file: &Value, pointer: &str, value: Option<Value>, told: &str| {
        let what = format!("{pointer} {}", value.as_ref().map_or("gone".into(), ToString::to_string));
        let file = resealed(file, pointer, value);
        let told = format!("/content{told}");
        differences.compare(&what, &import(&server, &file), &Wanted::invalid(&[&told]));
    };
    for file in [&modes, &aligned, &free] {
        let points = "/atoms/1/control_points";
        check(file, &format!("{points}/0"), None, points);
        check(file, &format!("{points}/0"), Some(json!([1.0, 2.0, 3.0])), points);
        check(file, points, Some(json!([])), points);
        check(file, "/mean/control_points/0", None, "/mean/control_points");
        check(file, "/statistics/residuals", Some(json!([])), "/statistics/residuals");
        check(file, "/statistics/residuals", Some(json!([2.0, 1.0])), "/statistics/residuals");
        check(file, "/representation/points", Some(json!(1)), "/representation/points");
        check(file, "/representation/points", Some(json!(1_u64 << 50)), "/representation/points");
        check(file, "/representation/dimension", Some(json!(4)), "/representation/dimension");
        // Numbers that learning never makes: nothing can be computed with them.
        check(file, points, Some(all_at(&[0.0, 0.0])), points);
        check(file, points, Some(all_at(&[1e300, 0.0])), points);
        check(file, "/mean/control_points", Some(all_at(&[0.0, 0.0])), "/mean/control_points");
        check(file, "/mean/control_points", Some(all_at(&[1e300, 0.0])), "/mean/control_points");
    }
    check(&modes, "/centre", Some(Value::Null), "/centre");
    check(&modes, "/centre/0", None, "/centre");
    check(&modes, "/centre/0/0", Some(json!(1e300)), "/centre");
    check(&modes, "/atoms/0/eigenvalue", None, "/atoms");
    check(&modes, "/atoms/0/eigenvalue", Some(json!(0.0)), "/atoms");
    check(&modes, "/statistics/scores", None, "/statistics/scores");
    check(&modes, "/statistics/scores/mean/0", None, "/statistics/scores");
    check(&modes, "/statistics/scores/covariance/0/0", None, "/statistics/scores");
    check(&modes, "/statistics/scores/covariance/0/0", Some(json!(1e300)), "/statistics/scores");
    check(&modes, "/statistics/scores/covariance/0/0", Some(json!(-1.0)), "/statistics/scores");
    check(&modes, "/statistics/scores/t_squared", Some(json!([2.0, 1.0])), "/statistics/scores/t_squared");
    check(&modes, "/method/components", Some(json!(0)), "/method/components");
    for file in [&aligned, &free] {
        check(file, "/atoms/3", None, "/atoms");
        check(file, "/atoms", Some(json!([])), "/atoms");
        check(file, "/method/lambda", Some(json!(0.0)), "/method/lambda");
        check(file, "/method/nonzeros", Some(json!(2)), "/method/nonzeros");
        check(file, "/method/max_epochs", Some(json!(0)), "/method/max_epochs");
    }
    check(&free, "/transformation", Some(json!("horizontal_shear")), "/method/codes");
    check(&modes, "/transformation", Some(json!("rigid")), "/transformation");
    drop(differences);
    assert_eq!(listed(&server, ""), before);
    server.assert_alive();
}

// ---------------------------------------------------------------- jobs that come to nothing

#[test]
fn a_cancelled_job_leaves_no_dictionary() {
    let server = Setting::fresh().flags(&["--short-job-seconds", "0"]).with_example().start();
    let running = submit(&server, &request("running", "example-cells", &endless()));
    let waiting = submit(&server, &request("waiting", "example-cells", &components(3, true)));
    job_when(&server, &running, &["running"]);
    assert_eq!(job(&server, &waiting)["status"], "queued", "there is one place");
    for (id, name) in [(&waiting, "waiting"), (&running, "running")] {
        let cancelled = server.post(&format!("/v1/jobs/{id}/cancel"), &json!({})).expect(200);
        assert_eq!((&cancelled["status"], &cancelled["result"]), (&json!("cancelled"), &Value::Null));
        assert_eq!(job(&server, id), cancelled);
        server.get(&format!("/v1/dictionaries/{name}")).expect_problem(404, "not-found", &[]);
    }
    // The place is free, the names are, and what was cancelled stays so.
    let next = learn(&server, "running", "example-cells", &components(3, true));
    assert_eq!(next["version"], 1);
    assert_eq!(listed(&server, "").len(), 1);
    for id in [&waiting, &running] {
        assert_eq!(job(&server, id)["status"], "cancelled");
    }
}

#[test]
fn a_cohort_that_is_deleted_meanwhile_fails_its_jobs() {
    let server = Setting::fresh().with_example().start();
    let long = json!({"kind": "sparse", "atoms": 30, "lambda": 0.02, "max_epochs": 2000, "tolerance": 0.0});
    let running = submit(&server, &request("cells", "example-cells", &long));
    let under_way = |found: &Value| found["phase"] == "learn";
    let start = Instant::now();
    while !under_way(&job_when(&server, &running, &["running"])) {
        assert!(start.elapsed() < PATIENCE);
    }
    let waiting = submit(&server, &request("cells", "example-cells", &components(3, true)));
    assert_eq!(server.delete("/v1/cohorts/example-cells").status, 204);
    for id in [&running, &waiting] {
        let failed = finished(&server, id);
        assert_eq!((&failed["status"], &failed["result"]), (&json!("failed"), &Value::Null), "{failed}");
        assert_eq!(
            (&failed["problem"]["status"], &failed["problem"]["code"]),
            (&json!(404), &json!("not-found"))
        );
        assert!(failed["problem"]["detail"].as_str().unwrap().contains("cohort"), "{failed}");
    }
    assert_eq!(listed(&server, ""), Vec::<Value>::new());
    server.get("/v1/dictionaries/cells").expect_problem(404, "not-found", &[]);
    // Both names can be used again.
    new_cohort(&server, "example-cells", &blobs(0..10));
    assert_eq!(learn(&server, "cells", "example-cells", &components(2, true))["version"], 1);
}

#[test]
fn a_dictionary_outlives_its_cohort() {
    let server = Server::fresh();
    new_cohort(&server, "blobs", &blobs(0..10));
    let found = learn(&server, "modes", "blobs", &components(2, true));
    let codes = encode(&server, "modes", &posted(0..4));
    assert_eq!(server.delete("/v1/cohorts/blobs").status, 204);
    assert_eq!(dictionary(&server, "modes"), found);
    assert_eq!(encode(&server, "modes", &posted(0..4)), codes);
    let cohort = found["cohort"].as_str().unwrap();
    assert_eq!(listed(&server, &format!("?cohort={cohort}")).len(), 1);
    assert_eq!(listed(&server, "?cohort=blobs").len(), 0);
}
