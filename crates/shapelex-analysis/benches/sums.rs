//! Rates of the sums of outer products behind means and components, beside the matrix product of this machine.
//!
//! `cargo bench -p shapelex-analysis --bench sums`. A rate counts the multiply-adds of one triangle; the bound is the rate
//! of products of square matrices on as many threads, measured before every row.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout)]

use std::hint::black_box;
use std::time::Instant;

use rayon::{ThreadPool, ThreadPoolBuilder};
use shapelex_analysis::accumulate::ShapesInMemory;
use shapelex_analysis::mean::ProjectorSum;
use shapelex_analysis::metric::Metric;
use shapelex_analysis::pca::FunctionalPca;
use shapelex_analysis::transformation::{ClassName, Transformation, TransformationClass};
use shapelex_geometry::representation::{Representation, ShapeSpace};
use shapelex_numeric::dense::{Matrix, multiply};

/// Numbers of all shapes of a row, about; the best of so many runs.
const NUMBERS: usize = 26_000_000;
const RUNS: usize = 5;

fn seconds(mut work: impl FnMut()) -> f64 {
    let timed = |_| {
        let start = Instant::now();
        work();
        start.elapsed().as_secs_f64()
    };
    (0..RUNS).map(timed).fold(f64::MAX, f64::min)
}

/// Multiply-adds per second of products of matrices on all threads of a pool.
fn bound(pool: &ThreadPool) -> f64 {
    const SIZE: usize = 512;
    let a = Matrix::from_fn(SIZE, SIZE, |i, j| ((i * 7 + j * 3) % 11) as f64);
    let products = || {
        pool.broadcast(|_| (0..4).for_each(|_| drop(black_box(multiply(&a, &a)))));
    };
    4.0 * pool.current_num_threads() as f64 * (SIZE as f64).powi(3) / seconds(products)
}

fn shapes(length: usize) -> ShapesInMemory {
    let mut state = 1_u64;
    let mut random = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
    };
    let count = (NUMBERS / length).min(100_000);
    ShapesInMemory::prepared((0..count * length).map(|_| random()).collect(), vec![1.0; count])
}

fn main() {
    let class = TransformationClass::new(&Transformation::Named(ClassName::Similarity), 2).unwrap();
    println!(
        "| 2N | shapes | threads | scatter, G/s | of the bound | projectors, G/s | of the bound | components and scores, s |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    for length in [32, 64, 128, 256, 512, 1024, 2048] {
        let source = shapes(length);
        let count = source.all().weights.len();
        let origin = vec![0.1; length];
        let space = ShapeSpace::new(&Representation::Landmarks { dimension: 2, points: length / 2 }).unwrap();
        let metric = Metric::of(&space);
        for threads in [1, 2] {
            let pool = ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let bound = bound(&pool);
            let work = (count * length * length) as f64 / 2.0;
            let run = |work: &(dyn Fn() + Sync)| seconds(|| pool.install(work));
            let scatter = work / run(&|| drop(black_box(FunctionalPca::scatter(&source, &origin).unwrap())));
            let projectors =
                work / run(&|| drop(black_box(ProjectorSum::of(&source, &class, length).unwrap())));
            let components = run(&|| {
                let pca = FunctionalPca::new(&source, &metric, &origin, true, 20).unwrap();
                black_box(pca.all_scores(&source).unwrap());
            });
            println!(
                "| {length} | {count} | {threads} | {:.1} | {:.0} % | {:.1} | {:.0} % | {components:.3} |",
                scatter / 1e9,
                100.0 * scatter / bound,
                projectors / 1e9,
                100.0 * projectors / bound,
            );
        }
    }
}
