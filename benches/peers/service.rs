//! Bounds of the service, and requests to it.
//!
//! ```text
//! lines FILE n first count                          writes shapes of n points as NDJSON
//! parse FILE                                        lines of shapes, parsed by one thread and forgotten
//! store FILE                                        the same shapes, stored by plain statements
//! echo                                              bare axum; says its address and serves until it is killed
//! load ADDRESS METHOD PATH FILE connections seconds the body of FILE, again and again on kept connections
//! ```

use std::time::Duration;

use serde_json::{Value, json};

use super::number;

#[path = "../../tests/rates/bounds.rs"]
mod bounds;
#[path = "../../tests/rates/client.rs"]
mod client;

pub(super) fn lines(words: &[&str]) -> Value {
    let [file, n, first, count] = words else { panic!("arguments") };
    let text = bounds::lines(number(n), number(first), number(count));
    std::fs::write(file, &text).unwrap();
    json!({ "bytes": text.len() })
}

pub(super) fn parse(words: &[&str], repeats: usize) -> Value {
    let [file] = words else { panic!("arguments") };
    let text = std::fs::read_to_string(file).unwrap();
    let seconds: Vec<f64> = (0..repeats).map(|_| bounds::parse_only(&text).1).collect();
    json!({ "seconds": seconds })
}

pub(super) fn store(words: &[&str], repeats: usize) -> Value {
    let [file] = words else { panic!("arguments") };
    let (shapes, _) = bounds::parse_only(&std::fs::read_to_string(file).unwrap());
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let run = |_| {
        let folder = tempfile::tempdir().unwrap();
        runtime.block_on(bounds::store_only(&shapes, &folder.path().join("plain.db")))
    };
    let seconds: Vec<f64> = (0..repeats).map(run).collect();
    json!({ "seconds": seconds })
}

#[allow(clippy::print_stdout)]
pub(super) fn echo() -> Value {
    tokio::runtime::Runtime::new().unwrap().block_on(async {
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
        println!("{}", listener.local_addr().unwrap());
        bounds::echo(listener).await.unwrap();
    });
    Value::Null
}

pub(super) fn load(words: &[&str]) -> Value {
    let [address, method, path, file, connections, seconds] = words else { panic!("arguments") };
    let request = client::request(method, path, "json", &std::fs::read_to_string(file).unwrap());
    let time = Duration::from_secs_f64(number(seconds));
    let answers = client::load(address, &request, number(connections), time).unwrap();
    let latencies = &answers.latencies;
    let at = |q: f64| latencies.get((q * latencies.len() as f64) as usize);
    json!({"rate": answers.rate(), "p50": at(0.5), "p99": at(0.99),
        "refused": answers.refused, "answered": answers.latencies.len(),
        "body": String::from_utf8_lossy(&answers.body)})
}
