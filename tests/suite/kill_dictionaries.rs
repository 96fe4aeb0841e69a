//! `kill -9` while a dictionary is learnt: the job goes on after the start, and ends with the same dictionary.

use std::time::{Duration, Instant};

use serde_json::{Value, json};

use crate::http_dictionaries::{PATIENCE, dictionary, finished, job, job_when, listed, submit};
use crate::server::{Server, Setting};

const ROUNDS: usize = 20;

/// Kills that one job is given: after five attempts it is given up, and the last one shall succeed.
const KILLS_OF_A_JOB: usize = 4;

/// Learning that takes a second or two.
fn learning(name: &str) -> Value {
    json!({"name": name, "cohort": "example-cells", "transformation": "similarity",
        "method": {"kind": "sparse", "atoms": 30, "lambda": 0.02, "max_epochs": 150, "tolerance": 0.0}})
}

/// Every dictionary that is listed is whole, and belongs to a job that has succeeded.
fn assert_nothing_is_partial(server: &Server, jobs: &[String], digest: &Value) {
    let succeeded = || jobs.iter().filter(|id| job(server, id)["status"] == "succeeded").count();
    let before = succeeded();
    let found = listed(server, "?name=killed");
    let after = succeeded();
    assert!((before..=after).contains(&found.len()), "{before} to {after} jobs succeeded: {found:?}");
    for entry in &found {
        let whole = dictionary(server, entry["id"].as_str().unwrap());
        assert_eq!((&whole["provenance"]["digest"], &whole["statistics"]["shapes"]), (digest, &json!(120)));
    }
}

/// The job when that part of it is done, however fast the machine is.
fn when_it_has_come(server: &Server, id: &str, part: f64) -> Value {
    let start = Instant::now();
    loop {
        let found = job(server, id);
        if found["progress"].as_f64().unwrap() >= part || found["status"] == "succeeded" {
            return found;
        }
        assert!(start.elapsed() < PATIENCE, "{part} is not reached: {found}");
        std::thread::sleep(Duration::from_millis(2));
    }
}

#[test]
fn a_job_that_is_killed_again_and_again_learns_the_same_dictionary() {
    let mut server = Setting::fresh().embedded().with_example().start();
    let undisturbed = finished(&server, &submit(&server, &learning("undisturbed")));
    let digest = &undisturbed["result"]["digest"];
    assert_eq!(undisturbed["status"], "succeeded", "{undisturbed}");

    let mut jobs: Vec<String> = Vec::new();
    let (mut kills, mut interrupted) = (KILLS_OF_A_JOB, 0);
    for round in 0..ROUNDS {
        if kills == KILLS_OF_A_JOB || job(&server, &jobs[jobs.len() - 1])["status"] == "succeeded" {
            if let Some(last) = jobs.last() {
                finished(&server, last);
            }
            jobs.push(submit(&server, &learning("killed")));
            kills = 0;
        }
        let id = jobs[jobs.len() - 1].clone();
        // At moments without a pattern, from before the start until about the end.
        let part = (0.618_034 * round as f64).fract();
        let attempts = when_it_has_come(&server, &id, part)["attempt"].as_u64().unwrap();
        server = server.kill().start();
        kills += 1;
        let resumed = job_when(&server, &id, &["running", "succeeded"]);
        interrupted += u64::from(resumed["attempt"].as_u64().unwrap() > attempts);
        assert_nothing_is_partial(&server, &jobs, digest);
    }
    // Some kills came before the claim or after the end; the others are what this is about.
    assert!(interrupted >= 10, "only {interrupted} kills interrupted a job");
    for id in &jobs {
        let done = finished(&server, id);
        assert_eq!((&done["status"], &done["result"]["digest"]), (&json!("succeeded"), digest), "{done}");
    }
    assert_eq!(listed(&server, "?name=killed").len(), jobs.len());
    assert_nothing_is_partial(&server, &jobs, digest);
}
