//! The main paths of the service do not fall far behind what this machine can do.
//!
//! Each is measured beside a bound, in the same run and the same profile. `make test-all` runs this file alone, because other work
//! on the machine disturbs it. `benches/peers` uses the same bounds in the release profile.
#![allow(clippy::unwrap_used, clippy::print_stdout, missing_docs)]

use std::fmt::Write;
use std::hint::black_box;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use bounds::{Posted, echo, lines, parse_only, points, store_only};
use client::{load, request};
use serde_json::{Value, json};
use service::Service;
use shapelex_server::analysis::correspondence::{Correspondence, Direction, Mirror};
use shapelex_server::domain::cohort::{Cohort, CohortSpec};
use shapelex_server::domain::id;
use shapelex_server::domain::shape::{NewShape, ShapeAttributes, ShapeMeasures};
use shapelex_server::geometry::generator::GeneratorKind;
use shapelex_server::geometry::representation::{Representation, ShapeSpace};
use shapelex_server::geometry::size::Sizes;
use shapelex_server::numeric::bounded::never;
use shapelex_server::store::{ShapeRow, Store};
use tokio::net::TcpListener;
use tokio::runtime::Runtime;

mod bounds;
mod bytes;
mod client;
mod service;

/// Held by the test that runs: the others would disturb it.
static ALONE: Mutex<()> = Mutex::new(());

/// Part of the usual fraction of the bound below which a rate is a defect.
const LEAST: f64 = 0.5;

/// Runs of each side; the fastest counts. The sides alternate, so that both meet the same load of the machine.
const RUNS: usize = 5;

/// A path beside its bound, in units a second.
struct Row {
    name: &'static str,
    /// Fraction of the bound in the profile of tests; those of curves are estimates that no run has confirmed yet.
    usual: f64,
    work: f64,
    limit: f64,
}

impl Row {
    fn fraction(&self) -> f64 {
        self.work / self.limit
    }
}

#[test]
fn rates_are_at_least_half_of_the_usual() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let (service, runtime) = (Service::start(), Runtime::new().unwrap());
    let mut slow = Vec::new();
    for row in [
        landmarks(&service, &runtime),
        curves(&service, &runtime),
        surfaces(&service, &runtime),
        measuring(),
        storing(&runtime),
        project(&service, &runtime),
    ] {
        let Row { name, work, limit, usual } = row;
        let (fraction, least) = (row.fraction(), LEAST * usual);
        let text = format!(
            "{name}: {work:.0} a second, {fraction:.3} of {limit:.0}; expected at least {least:.3}, usually {usual:.2}"
        );
        println!("{text}");
        if !(fraction >= least) {
            slow.push(text);
        }
    }
    assert!(slow.is_empty(), "{}", slow.join("\n"));
}

fn representation(n: usize) -> Value {
    json!({"kind": "closed_curve", "dimension": 2, "control_points": n, "generator": {"name": "trigonometric"}})
}

/// The fastest of the runs of both sides, in units a second.
fn fastest(runs: impl Iterator<Item = (f64, f64)>) -> (f64, f64) {
    runs.fold((0.0, 0.0), |(work, limit), run| (run.0.max(work), run.1.max(limit)))
}

/// Seconds in which a new cohort takes the lines of so many shapes.
fn posted(service: &Service, runtime: &Runtime, cohort: &Value, text: &str, shapes: usize) -> f64 {
    runtime.block_on(service.ask(&request("POST", "/v1/cohorts", "json", &cohort.to_string())));
    let path = format!("/v1/cohorts/{}/shapes", cohort["name"].as_str().unwrap());
    let posted = request("POST", &path, "x-ndjson", text);
    let start = Instant::now();
    let answer = runtime.block_on(service.ask(&posted));
    let seconds = start.elapsed().as_secs_f64();
    assert_eq!(answer["added"], shapes, "{answer}");
    seconds
}

/// Curves of 50 points are measured when they arrive: length, area and crossings on one thread, beside parsing their lines.
fn measuring() -> Row {
    const SHAPES: usize = 2000;
    const POINTS: usize = 50;
    let generator = GeneratorKind::Trigonometric {};
    let curves = Representation::ClosedCurve { dimension: 2, control_points: POINTS, generator };
    let space = ShapeSpace::new(&curves).unwrap();
    let text = lines(POINTS, 0, SHAPES);
    let run = |_| {
        let (shapes, parsing) = parse_only(&text);
        let columns: Vec<Vec<f64>> = shapes.iter().map(columns).collect();
        let start = Instant::now();
        for column in &columns {
            black_box(Sizes::with_crossings(&space, column, &never));
        }
        (SHAPES as f64 / start.elapsed().as_secs_f64(), SHAPES as f64 / parsing)
    };
    let (work, limit) = fastest((0..RUNS).map(run));
    Row { name: "measures of curves, beside parsing their lines", usual: 0.4, work, limit }
}

/// Lines of curves, which are measured.
fn curves(service: &Service, runtime: &Runtime) -> Row {
    let curves = |points| json!({"representation": representation(points), "correspondence": "landmarks"});
    let name = "NDJSON of curves into SQLite, beside the slower of parsing and storing";
    Row { name, usual: 0.25, ..upload(service, runtime, "curves", curves) }
}

/// Lines of landmarks, whose measures take no time.
fn landmarks(service: &Service, runtime: &Runtime) -> Row {
    let landmarks = |points| {
        let representation = json!({"kind": "landmarks", "dimension": 2, "points": points});
        json!({"representation": representation, "correspondence": "landmarks"})
    };
    let name = "NDJSON into SQLite, beside the slower of parsing and storing";
    Row { name, usual: 0.3, ..upload(service, runtime, "landmarks", landmarks) }
}

/// Tori of 16 × 16 control points, whose area and volume are computed, beside landmarks of the same numbers.
fn surfaces(service: &Service, runtime: &Runtime) -> Row {
    const SHAPES: usize = 500;
    const SIDE: usize = 16;
    let [grids, landmarks] = tori(SIDE, SHAPES);
    let cohort = |representation: Value, name: String| json!({"name": name, "representation": representation, "correspondence": "landmarks"});
    let torus = json!({"kind": "surface", "topology": "torus", "control_points": [SIDE, SIDE]});
    let points = json!({"kind": "landmarks", "dimension": 3, "points": SIDE * SIDE});
    let rate = |representation: &Value, name: String, text: &str| {
        SHAPES as f64 / posted(service, runtime, &cohort(representation.clone(), name), text, SHAPES)
    };
    let run = |k| (rate(&torus, format!("tori{k}"), &grids), rate(&points, format!("beside{k}"), &landmarks));
    let (work, limit) = fastest((0..RUNS).map(run));
    Row { name: "NDJSON of tori into SQLite, beside landmarks of the same numbers", usual: 0.8, work, limit }
}

/// Tori of `side × side` points as NDJSON: as grids, and as landmarks.
fn tori(side: usize, count: usize) -> [String; 2] {
    let angle = |k: usize| std::f64::consts::TAU * k as f64 / side as f64;
    let point = |seed: usize, k: usize, l: usize| {
        let noise = |c: usize| 0.02 * ((seed * 31 + k * 17 + l * 13 + c * 7) as f64 * 0.618_033_988_7).sin();
        let ((su, cu), (sv, cv)) = (angle(k).sin_cos(), angle(l).sin_cos());
        let ring = 2.0 + 0.7 * cv;
        [ring * cu + noise(0), ring * su + noise(1), 0.7 * sv + noise(2)]
    };
    let [mut grids, mut landmarks] = [String::new(), String::new()];
    for seed in 0..count {
        let row = |k: usize| (0..side).map(|l| point(seed, k, l)).collect::<Vec<_>>();
        let rows: Vec<_> = (0..side).map(row).collect();
        writeln!(grids, "{}", serde_json::json!({"points": rows})).unwrap();
        writeln!(landmarks, "{}", serde_json::json!({"points": rows.concat()})).unwrap();
    }
    [grids, landmarks]
}

/// Lines of shapes into the store, beside the slower of parsing them and of storing them by plain statements.
fn upload(service: &Service, runtime: &Runtime, kind: &str, cohort: impl Fn(usize) -> Value) -> Row {
    const SHAPES: usize = 5000;
    const POINTS: usize = 50;
    let text = lines(POINTS, 0, SHAPES);
    let folder = tempfile::tempdir().unwrap();
    let run = |k| {
        let name = format!("{kind}{k}");
        let mut cohort = cohort(POINTS);
        cohort["name"] = json!(name);
        let work = posted(service, runtime, &cohort, &text, SHAPES);
        let (shapes, parsing) = parse_only(&text);
        let storing = runtime.block_on(store_only(&shapes, &folder.path().join(name)));
        (SHAPES as f64 / work, SHAPES as f64 / parsing.max(storing))
    };
    let (work, limit) = fastest((0..RUNS).map(run));
    Row { name: "", usual: 1.0, work, limit }
}

/// Shapes that are ready into the store, beside plain statements. The program is not optimised in this profile, and SQLite is:
/// alone, statements that cost too much show.
fn storing(runtime: &Runtime) -> Row {
    const SHAPES: usize = 5000;
    const POINTS: usize = 20;
    /// Shapes of a transaction, as an upload has them.
    const TOGETHER: usize = 4096;
    let (shapes, _) = parse_only(&lines(POINTS, 0, SHAPES));
    let folder = tempfile::tempdir().unwrap();
    let store = runtime.block_on(Store::open(&folder.path().join("store"))).unwrap();
    let run = |k| {
        let cohort = cohort(&format!("run{k}"), POINTS);
        runtime.block_on(store.create_cohort(&cohort, None)).unwrap();
        let mut rows: Vec<ShapeRow> = shapes.iter().map(row).collect();
        let start = Instant::now();
        runtime.block_on(async {
            let mut upload = store.begin_upload(&cohort);
            while !rows.is_empty() {
                let rest = rows.split_off(TOGETHER.min(rows.len()));
                upload.add(rows).await.unwrap();
                rows = rest;
            }
            upload.commit(1).await.unwrap();
        });
        let work = start.elapsed().as_secs_f64();
        let plain = runtime.block_on(store_only(&shapes, &folder.path().join(format!("plain{k}"))));
        (SHAPES as f64 / work, SHAPES as f64 / plain)
    };
    let (work, limit) = fastest((0..RUNS).map(run));
    Row { name: "shapes into the store, beside plain statements", usual: 1.05, work, limit }
}

fn cohort(name: &str, points: usize) -> Cohort {
    let spec = CohortSpec {
        name: name.into(),
        description: None,
        representation: Representation::Landmarks { dimension: 2, points },
        correspondence: Correspondence::Landmarks,
        direction: Direction::Given,
        mirror: Mirror::Forbid,
        length_unit: None,
    };
    Cohort {
        id: id::new_id(id::COHORT),
        spec,
        revision: 0,
        shapes: 0,
        created_at_ms: 0,
        updated_at_ms: 0,
        former_rules: Vec::new(),
    }
}

/// The coordinates of a shape, one after the other.
fn columns(shape: &Posted) -> Vec<f64> {
    (0..2).flat_map(|c| shape.points.iter().map(move |point| point[c])).collect()
}

fn row(shape: &Posted) -> ShapeRow {
    let attributes = ShapeAttributes {
        external_id: Some(shape.external_id.clone()),
        label: Some(shape.label.clone()),
        weight: 1.0,
        ..ShapeAttributes::default()
    };
    let control_points = columns(shape);
    let measures = ShapeMeasures::default();
    NewShape { id: id::new_id(id::SHAPE), attributes, measures, control_points }.into()
}

/// `POST /v1/project` of one contour on eight connections, beside bare axum that echoes the same JSON.
fn project(service: &Service, runtime: &Runtime) -> Row {
    const CONNECTIONS: usize = 8;
    const TIME: Duration = Duration::from_millis(500);
    let contour = |seed| json!({"points": points(12, seed)});
    let body = json!({"representation": representation(12), "transformation": "similarity",
        "reference": contour(0), "shapes": [contour(1)]});
    let posted = request("POST", "/v1/project", "json", &body.to_string());
    let listener = runtime.block_on(TcpListener::bind("127.0.0.1:0")).unwrap();
    let beside = listener.local_addr().unwrap().to_string();
    runtime.spawn(echo(listener));
    let rate = |address: &str| {
        let answers = load(address, &posted, CONNECTIONS, TIME).unwrap();
        assert_eq!(answers.refused, 0, "{}", String::from_utf8_lossy(&answers.body));
        answers.rate()
    };
    let (work, limit) = fastest((0..RUNS).map(|_| (rate(&service.address), rate(&beside))));
    Row {
        name: "POST /v1/project on eight connections, beside an echo of the body",
        usual: 0.25,
        work,
        limit,
    }
}
