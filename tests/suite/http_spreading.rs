//! Several processes learn one dictionary together, with the bits of a process that is alone.

use serde_json::{Value, json};

use crate::http_dictionaries::{finished, job, submit};
use crate::server::{Server, Setting};

/// Five parts.
const SHAPES: usize = 40_000;

/// Processes that are killed at most until two of them died while they helped.
const KILLS: usize = 20;

/// Dictionaries that are learnt at most until a process helps.
const JOBS: usize = 100;

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
        println!("SKIPPED: SHAPELEX_TEST_DATABASE_URL is not set, and processes share PostgreSQL alone");
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
    for round in 0..JOBS {
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
    for _ in 0..KILLS {
        let second = first.beside().start();
        let id = until_it_helps(&first, &second, &digest);
        second.kill();
        // While it died, the other one may have done the rest.
        let helped = !is_over(&first, &id);
        let done = finished(&first, &id);
        assert_eq!((&done["status"], &done["result"]["digest"]), (&json!("succeeded"), &digest), "{done}");
        interrupted += usize::from(helped);
        if interrupted == 2 {
            return;
        }
    }
    panic!("only {interrupted} of {KILLS} kills came while the process helped");
}

fn is_over(server: &Server, id: &str) -> bool {
    job(server, id)["finished_at"].is_string()
}

/// Learns one dictionary after the other until `second` makes a part of one for `first`; the job of that one. A process looks
/// for parts once a second at first, and a job takes less.
fn until_it_helps(first: &Server, second: &Server, digest: &Value) -> String {
    for _ in 0..JOBS {
        let begun = count(second, BEGINS);
        let id = submit(first, &long_learning());
        while !is_over(first, &id) {
            let makes_a_part = second.get("/metrics").text().contains(MAKES_A_PART);
            // Or it was the one that took the job.
            if makes_a_part && count(second, BEGINS) == begun {
                return id;
            }
        }
        let done = finished(first, &id);
        assert_eq!((&done["status"], &done["result"]["digest"]), (&json!("succeeded"), digest), "{done}");
    }
    panic!("none of {JOBS} dictionaries was learnt together");
}
