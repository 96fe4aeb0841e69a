//! Several processes learn one dictionary together, with the bits of a process that is alone.

use serde_json::{Value, json};

use crate::http_dictionaries::{finished, job, submit};
use crate::server::{Server, Setting};

/// Five parts.
const SHAPES: usize = 40_000;

/// Dictionaries that are learnt at most until both processes had a part in one.
const ROUNDS: usize = 8;

/// What a process says that made a part of another one's pass.
const HELPED: &str = "a part of a pass was made for its owner";

/// What the metrics of a process say while it computes for a job.
const MAKES_A_PART: &str = "shapelex_compute_running{lane=\"job\"} 1";

/// What a process says that takes a job.
const BEGINS: &str = "a job begins";

/// What the owner says after a pass.
const SHARED: &str = "a pass was made in parts";

fn lines() -> Vec<Value> {
    let mut state = 11_u64;
    let mut noise = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((state >> 11) as f64 / (1_u64 << 53) as f64) * 0.5
    };
    let triangle = |_| {
        let (a, b, c) = ([noise(), noise()], [2.0 + noise(), noise()], [1.0 + noise(), 1.5 + noise()]);
        json!({"points": [a, b, c]})
    };
    (0..SHAPES).map(triangle).collect()
}

fn with_triangles(setting: Setting) -> Server {
    let server = setting.start();
    let representation = json!({"kind": "landmarks", "dimension": 2, "points": 3});
    let cohort =
        json!({"name": "triangles", "representation": representation, "correspondence": "landmarks"});
    server.post("/v1/cohorts", &cohort).expect(201);
    // In pieces that are no multiple of a part: parts begin and end inside of what was sent together.
    for piece in lines().chunks(3001) {
        server.post_lines("/v1/cohorts/triangles/shapes", piece).expect(201);
    }
    server
}

fn learning() -> Value {
    json!({"name": "triangles", "cohort": "triangles", "transformation": "similarity",
        "method": {"kind": "functional_pca", "components": 2}})
}

/// With a pass for every iteration, so that it takes longer than a process needs to hear of it.
fn long_learning() -> Value {
    let mut learning = learning();
    learning["alignment"] = "procrustes".into();
    learning
}

/// The digest of what is learnt by the embedded service, which is alone.
fn alone(learning: &Value) -> Value {
    let server = with_triangles(Setting::fresh().embedded());
    let done = finished(&server, &submit(&server, learning));
    assert_eq!(done["status"], "succeeded", "{done}");
    assert!(!server.log().contains(SHARED));
    done["result"]["digest"].clone()
}

/// Whether the tests have a database that processes can share; says so when not.
fn is_shared() -> bool {
    let shared = std::env::var("SHAPELEX_TEST_DATABASE_URL").is_ok();
    if !shared {
        println!("skipped: SHAPELEX_TEST_DATABASE_URL is not set, and processes share PostgreSQL alone");
    }
    shared
}

fn count(server: &Server, text: &str) -> usize {
    server.log().matches(text).count()
}

#[test]
fn two_processes_learn_what_one_learns_alone() {
    if !is_shared() {
        return;
    }
    let digest = alone(&learning());
    let first = with_triangles(Setting::fresh());
    let second = first.beside().start();
    let (mut passes, mut helped) = (0, 0);
    for round in 0..ROUNDS {
        let done = finished(&first, &submit(&first, &learning()));
        assert_eq!((&done["status"], &done["result"]["digest"]), (&json!("succeeded"), &digest), "{done}");
        // Mean, frame, scatter, codes.
        passes += 4;
        assert_eq!(count(&first, SHARED) + count(&second, SHARED), passes, "round {round}");
        helped = count(&first, HELPED) + count(&second, HELPED);
        if helped > 0 {
            break;
        }
    }
    // A pass has five parts: neither process made all of them.
    assert!(
        0 < helped && helped < 5 * passes,
        "{helped} parts of {passes} passes were made by the other process"
    );
}

#[test]
fn a_process_that_dies_while_it_helps_leaves_no_trace_in_what_is_learnt() {
    if !is_shared() {
        return;
    }
    let digest = alone(&long_learning());
    let first = with_triangles(Setting::fresh());
    let mut interrupted = 0;
    for _ in 0..ROUNDS {
        let second = first.beside().start();
        let id = submit(&first, &long_learning());
        let is_over = || job(&first, &id)["finished_at"].is_string();
        let makes_a_part = || second.get("/metrics").text().contains(MAKES_A_PART);
        let mut helping = false;
        while !helping && !is_over() {
            helping = makes_a_part();
        }
        // Or it was the one that took the job.
        helping &= count(&second, BEGINS) == 0;
        second.kill();
        // While it dies, the other one may have done the rest.
        helping &= !is_over();
        let done = finished(&first, &id);
        assert_eq!((&done["status"], &done["result"]["digest"]), (&json!("succeeded"), &digest), "{done}");
        interrupted += usize::from(helping);
        if interrupted == 2 {
            return;
        }
    }
    panic!("only {interrupted} of {ROUNDS} kills came while the process helped");
}
