//! Compute time of the statistics, without HTTP and storage.
//!
//! `cargo bench --bench statistics`. `SHAPELEX_BENCH_CURVES` names an NDJSON file of outlines to use instead of the
//! example cells; the set is filled up to 650 outlines by smooth deformations of the first ones.
#![allow(missing_docs, clippy::unwrap_used)]

use std::hint::black_box;
use std::time::Duration;

use criterion::{Criterion, criterion_group, criterion_main};
use shapelex_server::analysis::accumulate::ShapesInMemory;
use shapelex_server::analysis::alignment::{Alignment, Method, Projector, align_all};
use shapelex_server::analysis::correspondence::{Correspondence, Direction, Mirror};
use shapelex_server::analysis::frame::Frame;
use shapelex_server::analysis::matching::Matching;
use shapelex_server::analysis::metric::Metric;
use shapelex_server::analysis::pca::FunctionalPca;
use shapelex_server::analysis::sparse::{Atoms, Encode, Lasso, Pursuit};
use shapelex_server::analysis::transformation::{ClassName, Transformation};
use shapelex_server::geometry::curve::Curve;
use shapelex_server::geometry::generator::GeneratorKind;
use shapelex_server::geometry::intersection::self_intersects;
use shapelex_server::geometry::measures::CurveMeasures;
use shapelex_server::geometry::representation::{Representation, ShapeSpace};
use shapelex_server::geometry::resample::Contour;
use shapelex_server::numeric::dense::Matrix;
use shapelex_server::wire::shape::ShapeInput;

const OUTLINES: usize = 650;
const POINTS: usize = 200;

fn outlines() -> Vec<Matrix> {
    let example = concat!(env!("CARGO_MANIFEST_DIR"), "/examples/cells/cells.ndjson");
    let path = std::env::var("SHAPELEX_BENCH_CURVES").unwrap_or_else(|_| example.into());
    let text = std::fs::read_to_string(path).unwrap();
    let read: Vec<Matrix> = text
        .lines()
        .map(|line| {
            let shape: ShapeInput = serde_json::from_str(line).unwrap();
            let points = shape.points.unwrap();
            Matrix::from_row_slice(points.len(), 2, points.checked(2).unwrap())
        })
        .collect();
    (0..OUTLINES).map(|k| deformed(&read[k % read.len()], k / read.len())).collect()
}

/// The outline itself, or a smooth deformation of it that is no member of any class.
fn deformed(outline: &Matrix, copy: usize) -> Matrix {
    let size = outline.column(0).max() - outline.column(0).min();
    Matrix::from_fn(outline.nrows(), 2, |k, c| {
        let (x, y) = (outline[(k, 0)] / size, outline[(k, 1)] / size);
        let bend = copy as f64 * 0.02 * ((3.0 + c as f64) * (x + 0.7 * y) + copy as f64).sin();
        outline[(k, c)] + size * bend
    })
}

fn space(n: usize) -> ShapeSpace {
    let generator = GeneratorKind::Trigonometric {};
    ShapeSpace::new(&Representation::ClosedCurve { dimension: 2, control_points: n, generator }).unwrap()
}

fn cells(c: &mut Criterion) {
    let outlines = outlines();
    let space = space(POINTS);
    let metric = Metric::of(&space);
    let resampled: Vec<f64> = outlines
        .iter()
        .flat_map(|points| {
            let polygon = Contour::closed(points.clone()).unwrap();
            polygon.sample(POINTS, polygon.canonical_start()).as_slice().to_vec()
        })
        .collect();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap();
    let mut group = c.benchmark_group("650 outlines x 200 points, two threads");
    group.sample_size(20).measurement_time(Duration::from_secs(10));
    for (correspondence, name) in [
        (Correspondence::Landmarks, "align + mean + 20 modes, points correspond"),
        (Correspondence::Cyclic, "align + mean + 20 modes, start points searched"),
    ] {
        let matching = Matching::new(&space, correspondence, Direction::Given, Mirror::Forbid);
        for class in [ClassName::Similarity, ClassName::Affine] {
            let method = Method::new(&Transformation::Named(class), Alignment::Projection, 2).unwrap();
            group.bench_function(format!("{name}, {}", class.as_str()), |b| {
                b.iter(|| {
                    pool.install(|| {
                        let weights = vec![1.0; OUTLINES];
                        let (mean, aligned) = align_all(
                            &metric,
                            &method,
                            Frame::Training,
                            &matching,
                            resampled.clone(),
                            weights.clone(),
                        )
                        .unwrap();
                        let whitened =
                            aligned.iter().flat_map(|shape| shape.whitened.iter().copied()).collect();
                        let source = ShapesInMemory::prepared(whitened, weights);
                        let pca = FunctionalPca::new(&source, &metric, &mean.whitened, true, 20).unwrap();
                        black_box(pca.all_scores(&source).unwrap())
                    })
                });
            });
        }
    }
    group.bench_function("resample from the canonical start", |b| {
        b.iter(|| {
            for points in &outlines {
                let polygon = Contour::closed(points.clone()).unwrap();
                black_box(polygon.sample(POINTS, polygon.canonical_start()));
            }
        });
    });
    group.finish();
}

fn single(c: &mut Criterion) {
    let mut group = c.benchmark_group("one curve");
    let small = space(12);
    let metric = Metric::of(&small);
    let outline = |n: usize, phase: f64| -> Vec<f64> {
        let angle = |k: usize| std::f64::consts::TAU * k as f64 / n as f64;
        let x = (0..n).map(|k| 2.0 * angle(k).cos() + 0.3 * (2.0 * angle(k) + phase).cos());
        x.chain((0..n).map(|k| angle(k).sin() + 0.2 * (3.0 * angle(k) + phase).sin())).collect()
    };
    for class in [ClassName::Similarity, ClassName::Affine] {
        let method = Method::new(&Transformation::Named(class), Alignment::Projection, 2).unwrap();
        let projector = Projector::new(&metric, &method, outline(12, 0.0));
        group.bench_function(format!("project 12 control points, {}", class.as_str()), |b| {
            b.iter(|| black_box(projector.project(outline(12, 1.0)).unwrap()));
        });
    }
    group.bench_function("prepare a space of 100 control points", |b| b.iter(|| black_box(space(100))));
    let curve = Curve::of(&space(100), &Matrix::from_column_slice(100, 2, &outline(100, 0.5))).unwrap();
    group.bench_function("measure 100 control points", |b| b.iter(|| black_box(CurveMeasures::of(&curve))));
    group.bench_function("self-intersection test, 100 control points", |b| {
        b.iter(|| black_box(self_intersects(&curve)));
    });
    group.finish();
}

/// 10 000 signals of 128 numbers, each near a combination of five of 64 atoms.
fn sparse(c: &mut Criterion) {
    const SHAPE: (usize, usize, usize) = (128, 64, 10_000);
    let (n, atoms, count) = SHAPE;
    // A linear congruential generator: the same numbers everywhere.
    let mut state = 1_u64;
    let mut random = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
    };
    let mut matrix = Matrix::from_fn(n, atoms, |_, _| random());
    for mut column in matrix.column_iter_mut() {
        let norm = column.norm();
        column /= norm;
    }
    let mut signals = vec![0.0; n * count];
    for (k, signal) in signals.chunks_exact_mut(n).enumerate() {
        for i in 0..5 {
            let (weight, atom) = (random(), matrix.column((17 * k + 11 * i) % atoms));
            signal.iter_mut().zip(atom.iter()).for_each(|(x, d)| *x += weight * d);
        }
        signal.iter_mut().for_each(|x| *x += 0.02 * random());
    }
    let atoms = Atoms::new(matrix);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap();
    let mut group = c.benchmark_group("10 000 signals of 128 numbers, 64 atoms, two threads");
    group.sample_size(20).throughput(criterion::Throughput::Elements(count as u64));
    for (name, lasso) in [
        ("lasso", Lasso::new(0.05, false)),
        ("lasso, non-negative", Lasso::new(0.05, true)),
        ("lasso, weak penalty", Lasso::new(0.005, false)),
    ] {
        group.bench_function(name, |b| {
            b.iter(|| pool.install(|| black_box(lasso.codes(&atoms, &signals).unwrap())));
        });
    }
    group.bench_function("pursuit, 5 atoms", |b| {
        b.iter(|| pool.install(|| black_box(Pursuit { nonzeros: 5 }.codes(&atoms, &signals).unwrap())));
    });
    group.finish();
}

criterion_group!(benches, cells, single, sparse);
criterion_main!(benches);
