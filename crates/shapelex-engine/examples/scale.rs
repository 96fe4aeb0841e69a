//! Measures what docs/scale.md says: time, processor time and memory of mean and components over the number of shapes.
//!
//! ```text
//! cargo run --example scale -- FOLDER POINTS THREADS SHAPES...
//! ```
//!
//! Writes a cohort of so many shapes into the folder (once: it is kept for the next call) and computes mean and 20 components. A
//! line of JSON for each size; the last one has the exponent `b` of `processor time ∝ shapes^b`, by least squares of logarithms.

use std::num::NonZeroUsize;
use std::sync::Arc;
use std::time::Instant;

use serde_json::json;
use shapelex_analysis::correspondence::{Correspondence, Direction, Mirror};
use shapelex_analysis::frame::Frame;
use shapelex_analysis::transformation::{ClassName, Transformation};
use shapelex_engine::EngineError;
use shapelex_engine::cohort::Description;
use shapelex_engine::cohort::manifest::revisions;
use shapelex_engine::cohort::record::{Measures, Record};
use shapelex_engine::cohort::revision::{Revision, Setting};
use shapelex_engine::cohort::writer::Writer;
use shapelex_engine::location::open;
use shapelex_engine::objects::{Objects, Patience};
use shapelex_engine::pass::engine::Engine;
use shapelex_engine::pass::source::AtRest;
use shapelex_engine::statistics::{Request, Statistics};
use shapelex_geometry::representation::Representation;

/// Directions in which the shapes vary.
const DIRECTIONS: usize = 24;

fn description(points: usize, shapes: usize) -> Description {
    Description {
        id: format!("coh_{points}_{shapes}"),
        name: "waves".into(),
        description: None,
        representation: Representation::Landmarks { dimension: 2, points },
        correspondence: Correspondence::Landmarks,
        direction: Direction::Given,
        mirror: Mirror::Forbid,
        length_unit: None,
        revision: 1,
        shape_count: shapes as u64,
        created_at: None,
        updated_at: None,
    }
}

/// An ellipse with waves of random amplitude, turned, scaled and moved.
fn wave(k: usize, table: &[f64], points: usize) -> Record {
    let mut state = (k as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let mut noise = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1_u64 << 53) as f64 * 2.0 - 1.0
    };
    let mut shape = table[..2 * points].to_vec();
    for j in 1..=DIRECTIONS {
        let amplitude = noise() / j as f64;
        let direction = &table[2 * points * j..2 * points * (j + 1)];
        shape.iter_mut().zip(direction).for_each(|(value, wave)| *value += 0.3 * amplitude * wave);
    }
    let (c, s) = (1.0 + 0.3 * noise(), 0.5 * noise());
    let (dx, dy) = (5.0 * noise(), 5.0 * noise());
    for i in 0..points {
        let (x, y) = (shape[i], shape[points + i]);
        (shape[i], shape[points + i]) = (c * x - s * y + dx, s * x + c * y + dy);
    }
    // Of the ellipse without waves.
    let area = Some(std::f64::consts::TAU * (c * c + s * s));
    let measures = Measures { area, ..Measures::default() };
    Record { id: format!("shp_{k:010}"), weight: 1.0, measures, control_points: shape, ..Record::default() }
}

/// The ellipse and the waves.
fn table(points: usize) -> Vec<f64> {
    let angle = |i: usize| i as f64 / points as f64 * std::f64::consts::TAU;
    let mut table: Vec<f64> = (0..points).map(|i| 2.0 * angle(i).cos()).collect();
    table.extend((0..points).map(|i| angle(i).sin()));
    for j in 1..=DIRECTIONS {
        let phase = j as f64 * 0.7;
        table.extend((0..points).map(|i| ((j + 1) as f64 * angle(i) + phase).cos()));
        table.extend((0..points).map(|i| ((j + 1) as f64 * angle(i) - phase).sin()));
    }
    table
}

/// Largest memory of this process so far in MiB.
fn peak_mib() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM"))?;
    line.split_whitespace().nth(1)?.parse::<u64>().ok().map(|kib| kib / 1024)
}

/// Processor time of this process so far in seconds, which other processes on the machine change little.
fn processor_s() -> Option<f64> {
    /// Unit of the times in `/proc`.
    const TICKS_PER_S: f64 = 100.0;
    let stat = std::fs::read_to_string("/proc/self/stat").ok()?;
    // The second field is a name in brackets; user and system time are fields 14 and 15.
    let fields: Vec<&str> = stat.rsplit_once(')')?.1.split_whitespace().collect();
    let ticks = |i: usize| fields.get(i)?.parse::<f64>().ok();
    Some((ticks(11)? + ticks(12)?) / TICKS_PER_S)
}

/// Slope of a line through the logarithms.
fn exponent(times: &[(usize, f64)]) -> f64 {
    let points: Vec<(f64, f64)> = times.iter().map(|(n, seconds)| ((*n as f64).ln(), seconds.ln())).collect();
    let mean = |of: fn(&(f64, f64)) -> f64| points.iter().map(of).sum::<f64>() / points.len() as f64;
    let (x, y) = (mean(|point| point.0), mean(|point| point.1));
    let (mut above, mut below) = (0.0, 0.0);
    for point in &points {
        above += (point.0 - x) * (point.1 - y);
        below += (point.0 - x).powi(2);
    }
    above / below
}

async fn write(objects: &Objects, points: usize, shapes: usize) -> Result<f64, EngineError> {
    let (cohort, table, began) = (description(points, shapes), table(points), Instant::now());
    if revisions(objects, &cohort.id).await?.is_empty() {
        let mut writer = Writer::begin(objects.clone(), cohort, false).await?;
        for k in 0..shapes {
            writer.add(wave(k, &table, points)).await?;
        }
        writer.finish().await?;
    }
    Ok(began.elapsed().as_secs_f64())
}

#[expect(clippy::print_stdout, reason = "a program for the command line")]
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [folder, points, threads, sizes @ ..] = arguments.as_slice() else {
        return Err("expected FOLDER POINTS THREADS SHAPES...".into());
    };
    let (points, threads): (usize, NonZeroUsize) = (points.parse()?, threads.parse()?);
    rayon::ThreadPoolBuilder::new().num_threads(threads.get()).build_global()?;
    let runtime =
        tokio::runtime::Builder::new_multi_thread().worker_threads(threads.get()).enable_all().build()?;
    let objects = Objects::new(open(folder)?, Patience::default());
    let engine = Engine { threads, memory_bytes: 512 << 20, spill: None };
    let request = Request { frame: Frame::Training, components: 20, centred: true, normalise: false };
    let mut times = Vec::new();
    for size in sizes {
        let shapes: usize = size.parse()?;
        let written = runtime.block_on(write(&objects, points, shapes))?;
        let cohort = description(points, shapes).id;
        let revision = Arc::new(runtime.block_on(Revision::open(objects.clone(), &cohort, 1))?);
        let similarity = Transformation::Named(ClassName::Similarity);
        let setting = Arc::new(Setting::new(revision.manifest(), &similarity, None)?);
        let source = AtRest::new(revision, setting.clone(), runtime.handle(), Some(&engine));
        let (began, processor) = (Instant::now(), processor_s());
        let statistics = Statistics::of(&source, &setting, request)?;
        let seconds = began.elapsed().as_secs_f64();
        let processor = processor_s().zip(processor).map(|(after, before)| after - before);
        times.push((shapes, processor.unwrap_or(seconds)));
        let digest = &statistics.digest()[..16];
        let row = json!({"shapes": shapes, "points": points, "threads": threads, "write_s": written, "run_s": seconds,
            "processor_s": processor, "peak_mib": peak_mib(), "digest": digest});
        println!("{row}");
    }
    println!("{}", json!({"exponent": exponent(&times)}));
    Ok(())
}
