//! The running service over loopback: latency of one projection, speed and memory of streamed cohorts.
//!
//! `cargo bench --bench service` starts the release binary on a free port with a temporary folder.
//! `SHAPELEX_BENCH_SHAPES` sets the size of the large cohort (1 000 000 unless given).
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout)]

use std::fmt::Write;
use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use futures_util::stream;
use serde_json::{Value, json};

struct Service {
    child: Child,
    base: String,
    _folder: tempfile::TempDir,
}

impl Service {
    fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let mut child = Command::new(env!("CARGO_BIN_EXE_shapelex"))
            .args(["serve", "--listen", "127.0.0.1:0", "--no-example", "--log", "warn", "--data-dir"])
            .arg(folder.path())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.as_mut().unwrap()).read_line(&mut line).unwrap();
        let base = line.trim().rsplit(' ').next().unwrap().to_owned();
        Self { child, base, _folder: folder }
    }

    /// Peak resident memory in MiB.
    fn peak_memory(&self) -> f64 {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).unwrap();
        let line = status.lines().find(|line| line.starts_with("VmHWM")).unwrap();
        line.split_whitespace().nth(1).unwrap().parse::<f64>().unwrap() / 1024.0
    }

    /// Processor time taken so far, in seconds.
    fn processor_time(&self) -> f64 {
        /// Ticks per second in `/proc`, the same on all Linux systems.
        const TICKS: f64 = 100.0;
        let text = std::fs::read_to_string(format!("/proc/{}/stat", self.child.id())).unwrap();
        // The name of the process, in parentheses, may contain spaces.
        let fields: Vec<&str> = text.rsplit_once(')').unwrap().1.split_whitespace().collect();
        let (user, system): (f64, f64) = (fields[11].parse().unwrap(), fields[12].parse().unwrap());
        (user + system) / TICKS
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }
}

fn points(n: usize, seed: usize) -> Vec<[f64; 2]> {
    (0..n)
        .map(|k| {
            let t = std::f64::consts::TAU * k as f64 / n as f64;
            let noise = |c: usize| 0.1 * ((seed * 31 + k * 17 + c * 7) as f64 * 0.618_033_988_7).sin();
            [2.0 * t.cos() + 0.3 * (2.0 * t).cos() + noise(0), t.sin() + 0.2 * (3.0 * t).sin() + noise(1)]
        })
        .collect()
}

fn ndjson(n: usize, first: usize, count: usize) -> String {
    let mut text = String::new();
    for k in first..first + count {
        let points = serde_json::to_string(&points(n, k)).unwrap();
        writeln!(text, "{{\"external_id\":\"s{k}\",\"label\":\"c{}\",\"points\":{points}}}", k % 3).unwrap();
    }
    text
}

fn representation(n: usize) -> Value {
    json!({"kind": "closed_curve", "dimension": 2, "control_points": n, "generator": {"name": "trigonometric"}})
}

async fn cohort(client: &reqwest::Client, base: &str, name: &str, n: usize) {
    let body = json!({"name": name, "representation": representation(n)});
    client.post(format!("{base}/v1/cohorts")).json(&body).send().await.unwrap().error_for_status().unwrap();
}

async fn upload(client: &reqwest::Client, base: &str, name: &str, body: reqwest::Body) -> Duration {
    let start = Instant::now();
    let request = client.post(format!("{base}/v1/cohorts/{name}/shapes"));
    let response = request.header("content-type", "application/x-ndjson").body(body).send().await.unwrap();
    response.error_for_status().unwrap().bytes().await.unwrap();
    start.elapsed()
}

async fn latency(client: &reqwest::Client, base: &str) {
    let body = json!({
        "representation": representation(12), "transformation": "similarity",
        "reference": {"points": points(12, 0)}, "shapes": [{"points": points(12, 1)}]
    });
    let mut times = Vec::new();
    for _ in 0..3000 {
        let start = Instant::now();
        let response = client.post(format!("{base}/v1/project")).json(&body).send().await.unwrap();
        response.error_for_status().unwrap().bytes().await.unwrap();
        times.push(start.elapsed());
    }
    times.drain(..200);
    times.sort();
    let at = |q: f64| times[(q * (times.len() - 1) as f64) as usize].as_secs_f64() * 1e3;
    println!(
        "POST /v1/project, one 12-point curve: p50 {:.3} ms, p90 {:.3} ms, p99 {:.3} ms",
        at(0.5),
        at(0.9),
        at(0.99)
    );
}

/// A line of [`ndjson`].
#[derive(serde::Deserialize)]
struct Posted {
    external_id: String,
    label: String,
    points: Vec<[f64; 2]>,
}

/// Seconds in which one thread parses the lines and does nothing else: what ingest on one core cannot fall below.
fn parse_only(text: &str, n: usize) -> f64 {
    let start = Instant::now();
    for line in text.lines() {
        let Posted { external_id, label, points } = serde_json::from_str(line).unwrap();
        assert!(points.len() == n && !external_id.is_empty() && !label.is_empty());
    }
    start.elapsed().as_secs_f64()
}

async fn ingest(client: &reqwest::Client, base: &str, service: &Service) {
    const SHAPES: usize = 100_000;
    let text = ndjson(50, 0, SHAPES);
    let megabytes = text.len() as f64 / 1e6;
    let parsing = parse_only(&text, 50);
    cohort(client, base, "ingest", 50).await;
    let before = service.processor_time();
    let time = upload(client, base, "ingest", text.into()).await.as_secs_f64();
    println!(
        "NDJSON, {SHAPES} shapes of 50 points ({megabytes:.0} MB): {time:.2} s, {:.0} shapes/s, {:.2} s of the processor; \
         one thread that only parses: {:.0} shapes/s",
        SHAPES as f64 / time,
        service.processor_time() - before,
        SHAPES as f64 / parsing
    );
}

async fn large(client: &reqwest::Client, base: &str, service: &Service) {
    let shapes: usize =
        std::env::var("SHAPELEX_BENCH_SHAPES").map_or(1_000_000, |text| text.parse().unwrap());
    const CHUNK: usize = 2000;
    println!("peak memory before: {:.0} MiB", service.peak_memory());
    cohort(client, base, "large", 24).await;
    let chunks = (0..shapes.div_ceil(CHUNK)).map(move |i| {
        let count = CHUNK.min(shapes - i * CHUNK);
        Ok::<_, std::io::Error>(ndjson(24, i * CHUNK, count))
    });
    let time =
        upload(client, base, "large", reqwest::Body::wrap_stream(stream::iter(chunks))).await.as_secs_f64();
    println!(
        "{shapes} shapes of 24 control points streamed in: {time:.1} s (with the client on the same cores)"
    );
    println!("peak memory after the stream: {:.0} MiB", service.peak_memory());
    for class in ["similarity", "affine"] {
        let start = Instant::now();
        let url = format!("{base}/v1/cohorts/large/mean?transformation={class}");
        let mean: Value =
            client.get(url).send().await.unwrap().error_for_status().unwrap().json().await.unwrap();
        assert_eq!(mean["shapes"], shapes);
        println!(
            "its mean ({class}): {:.2} s, peak memory {:.0} MiB",
            start.elapsed().as_secs_f64(),
            service.peak_memory()
        );
    }
}

fn main() {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let client = reqwest::Client::new();
        let service = Service::start();
        latency(&client, &service.base).await;
        large(&client, &service.base, &service).await;
        ingest(&client, &service.base, &service).await;
    });
}
