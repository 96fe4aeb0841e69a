//! Distance matrices and searches: compute time, the running service over loopback, and how well neighbours tell classes.
//!
//! `cargo bench --bench retrieval`. `SHAPELEX_BENCH_CURVES` names an NDJSON file of labelled outlines to use instead of the
//! example cells.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout)]

use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use shapelex_server::analysis::accumulate::prepare;
use shapelex_server::analysis::alignment::{Alignment, Method};
use shapelex_server::analysis::correspondence::{Correspondence, Direction, Mirror};
use shapelex_server::analysis::distance::DistanceSpace;
use shapelex_server::analysis::matching::Matching;
use shapelex_server::analysis::metric::Metric;
use shapelex_server::analysis::transformation::{ClassName, Transformation};
use shapelex_server::geometry::generator::GeneratorKind;
use shapelex_server::geometry::representation::{Representation, ShapeSpace};
use shapelex_server::geometry::resample::Contour;
use shapelex_server::numeric::dense::Matrix;
use shapelex_server::wire::shape::ShapeInput;

/// Repetitions of a measurement of the matrix.
const RUNS: usize = 7;

fn curves() -> String {
    let example = concat!(env!("CARGO_MANIFEST_DIR"), "/examples/cells/cells.ndjson");
    std::fs::read_to_string(std::env::var("SHAPELEX_BENCH_CURVES").unwrap_or_else(|_| example.into()))
        .unwrap()
}

fn median(mut times: Vec<Duration>) -> f64 {
    times.sort();
    times[times.len() / 2].as_secs_f64()
}

/// Times of the matrix in memory: preparation (whitening, bases, spectra) and all pairs, two threads.
fn matrices(text: &str) {
    let outlines: Vec<Matrix> = text
        .lines()
        .map(|line| {
            let points = serde_json::from_str::<ShapeInput>(line).unwrap().points.unwrap();
            Matrix::from_row_slice(points.len(), 2, points.checked(2).unwrap())
        })
        .collect();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap();
    println!("matrix of {} outlines, two threads, preparation included, median of {RUNS}", outlines.len());
    for n in [100, 128, 200] {
        let generator = GeneratorKind::Trigonometric {};
        let representation = Representation::ClosedCurve { dimension: 2, control_points: n, generator };
        let space = ShapeSpace::new(&representation).unwrap();
        let metric = Metric::of(&space);
        let sample = |points: &Matrix| {
            let contour = Contour::closed(points.clone()).unwrap();
            contour.sample(n, contour.canonical_start()).as_slice().to_vec()
        };
        let control_points: Vec<f64> = outlines.iter().flat_map(sample).collect();
        for (class, correspondence, mirror) in [
            (ClassName::Similarity, Correspondence::Cyclic, Mirror::Forbid),
            (ClassName::Similarity, Correspondence::Cyclic, Mirror::Allow),
            (ClassName::Affine, Correspondence::Cyclic, Mirror::Forbid),
            (ClassName::Similarity, Correspondence::ArcLength, Mirror::Forbid),
        ] {
            let method = Method::new(&Transformation::Named(class), Alignment::Projection, 2).unwrap();
            let matching = Matching::new(&space, correspondence, Direction::Either, mirror);
            let distances = DistanceSpace::new(&method, &matching).unwrap();
            let run = |_| {
                let start = Instant::now();
                pool.install(|| {
                    let mut whitened = control_points.clone();
                    prepare(&metric, true, 0, &mut whitened).unwrap();
                    let prepared = distances.prepare(&whitened).unwrap();
                    std::hint::black_box(distances.matrix(&prepared, &|_| true).unwrap());
                });
                start.elapsed()
            };
            let time = median((0..RUNS).map(run).collect());
            println!(
                "  {n} points, {}, {correspondence:?}, mirror {mirror:?}: {:.3} s",
                class.as_str(),
                time
            );
        }
    }
}

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
}

impl Drop for Service {
    fn drop(&mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }
}

async fn post(client: &reqwest::Client, url: String, body: &Value) -> bytes::Bytes {
    let response = client.post(url).header("prefer", "wait=60").json(body).send().await.unwrap();
    response.error_for_status().unwrap().bytes().await.unwrap()
}

/// A cohort of all outlines, resampled by the service.
async fn cohort(client: &reqwest::Client, base: &str, name: &str, generator: &Value, n: usize, text: &str) {
    let representation =
        json!({"kind": "closed_curve", "dimension": 2, "control_points": n, "generator": generator});
    let body = json!({"name": name, "representation": representation, "correspondence": "cyclic",
        "direction": "either"});
    post(client, format!("{base}/v1/cohorts"), &body).await;
    let request = client.post(format!("{base}/v1/cohorts/{name}/shapes"));
    let request = request.header("content-type", "application/x-ndjson").body(text.to_owned());
    request.send().await.unwrap().error_for_status().unwrap();
}

/// Leave-one-out accuracy of the nearest neighbour, and the part of the class among the nearest `2 · class size` shapes, the
/// shape itself counted, as the bull's-eye test does.
fn accuracy(answer: &Value) -> (f64, f64) {
    let labels = answer["labels"].as_array().unwrap();
    let count = labels.len();
    let (mut nearest, mut bulls_eye) = (0, 0.0);
    for (i, row) in answer["distances"].as_array().unwrap().iter().enumerate() {
        let distance = |j: usize| row[j].as_f64().unwrap();
        let mut order: Vec<usize> = (0..count).collect();
        order.sort_by(|&a, &b| distance(a).total_cmp(&distance(b)));
        let first = order.iter().find(|&&j| j != i).unwrap();
        nearest += usize::from(labels[*first] == labels[i]);
        let class = labels.iter().filter(|label| **label == labels[i]).count();
        let found = order.iter().take(2 * class).filter(|&&j| labels[j] == labels[i]).count();
        bulls_eye += found as f64 / class as f64;
    }
    (nearest as f64 / count as f64, bulls_eye / count as f64)
}

async fn accuracies(client: &reqwest::Client, base: &str, text: &str) {
    println!("through POST /v1/distances: nearest neighbour, bull's-eye");
    for (name, generator) in [
        ("trigonometric", json!({"name": "trigonometric"})),
        ("cubic", json!({"name": "cubic"})),
        ("linear", json!({"name": "bspline", "degree": 1})),
    ] {
        for n in [64, 100, 128, 200] {
            let cohort_name = format!("{name}-{n}");
            cohort(client, base, &cohort_name, &generator, n, text).await;
            for (transformation, mirror) in
                [("similarity", "forbid"), ("similarity", "allow"), ("affine", "allow")]
            {
                let body = json!({"cohort": cohort_name, "transformation": transformation, "mirror": mirror});
                let start = Instant::now();
                let answer = post(client, format!("{base}/v1/distances"), &body).await;
                let time = start.elapsed().as_secs_f64();
                let (nearest, bulls_eye) = accuracy(&serde_json::from_slice(&answer).unwrap());
                println!(
                    "  {name}, {n} points, {transformation}, mirror {mirror}: {nearest:.4}, {bulls_eye:.4}; {time:.2} s, \
                     {:.1} MB of JSON",
                    answer.len() as f64 / 1e6
                );
            }
        }
    }
}

/// Latency of searches of one posted outline each.
async fn searches(client: &reqwest::Client, base: &str, text: &str) {
    cohort(client, base, "searched", &json!({"name": "trigonometric"}), 100, text).await;
    let outlines: Vec<Value> = text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    for mirror in ["forbid", "allow"] {
        let mut times = Vec::new();
        for k in 0..600 {
            let outline = &outlines[k * 7 % outlines.len()];
            let body = json!({"shapes": [{"points": outline["points"]}], "neighbours": 10, "mirror": mirror});
            let start = Instant::now();
            let answer = post(client, format!("{base}/v1/cohorts/searched/search"), &body).await;
            times.push(start.elapsed());
            let answer: Value = serde_json::from_slice(&answer).unwrap();
            assert_eq!(answer["results"][0]["neighbours"].as_array().unwrap().len(), 10);
        }
        times.drain(..50);
        times.sort();
        let at = |q: f64| times[(q * (times.len() - 1) as f64) as usize].as_secs_f64() * 1e3;
        println!(
            "search of one outline among {} of 100 points, mirror {mirror}: p50 {:.2} ms, p95 {:.2} ms, p99 {:.2} ms",
            outlines.len(),
            at(0.5),
            at(0.95),
            at(0.99)
        );
    }
}

fn main() {
    let text = curves();
    matrices(&text);
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let client = reqwest::Client::new();
        let service = Service::start();
        searches(&client, &service.base, &text).await;
        accuracies(&client, &service.base, &text).await;
    });
}
