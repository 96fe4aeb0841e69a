//! Bytes that a task reads, beside those that are stored: they depend on no other work of the machine.

use serde_json::{Value, json};
use tokio::runtime::Runtime;

use super::bounds::lines;
use super::client::request;
use super::service::Service;
use super::{ALONE, PoisonError, posted};

const SHAPES: usize = 20_000;
const POINTS: usize = 50;
/// Bytes of the control points.
const STORED: f64 = (SHAPES * POINTS * 2 * 8) as f64;

/// Bytes that a request and what it began read, in those of the control points.
fn passes(service: &Service, task: impl FnOnce()) -> Option<f64> {
    let before = service.bytes_read()?;
    task();
    Some((service.bytes_read()? - before) as f64 / STORED)
}

/// Waits for a job.
fn finish(service: &Service, runtime: &Runtime, job: &Value) {
    let path = format!("/v1/jobs/{}", job["id"].as_str().unwrap());
    loop {
        let job = runtime.block_on(service.ask(&request("GET", &path, "json", "")));
        match job["status"].as_str().unwrap() {
            "succeeded" => return,
            "queued" | "running" => std::thread::sleep(std::time::Duration::from_millis(50)),
            other => panic!("{other}: {job}"),
        }
    }
}

#[test]
fn tasks_read_the_store_about_as_often_as_they_must() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let (service, runtime) = (Service::start(), Runtime::new().unwrap());
    let landmarks = json!({"kind": "landmarks", "dimension": 2, "points": POINTS});
    let cohort = json!({"name": "c", "representation": landmarks, "correspondence": "landmarks"});
    posted(&service, &runtime, &cohort, &lines(POINTS, 0, SHAPES), SHAPES);
    let ask = |method: &str, path: &str, body: &str| {
        runtime.block_on(service.ask(&request(method, path, "json", body)))
    };
    // What comes first also reads what was written last.
    ask("GET", "/v1/cohorts/c/mean?transformation=translation", "");
    let mean = |query: &str| {
        let path = format!("/v1/cohorts/c/mean?transformation=similarity{query}");
        passes(&service, || drop(ask("GET", &path, "")))
    };
    let learning = |name: &str, method: Value| {
        let body = json!({"cohort": "c", "name": name, "method": method, "transformation": "similarity"})
            .to_string();
        passes(&service, || finish(&service, &runtime, &ask("POST", "/v1/dictionaries", &body)))
    };
    let Some(all) = mean("") else {
        return println!("SKIPPED: bytes that are read, which this system does not count");
    };
    let scattered = mean("&label=c0").unwrap();
    let components = learning("components", json!({"kind": "functional_pca", "components": 10})).unwrap();
    println!("passes: mean {all:.2}, scattered third {scattered:.2}, components {components:.2}");
    assert!(scattered <= 1.1 * all + 0.2, "{scattered} passes, all shapes {all}");
    assert!(components <= 2.2, "{components} passes");
}
