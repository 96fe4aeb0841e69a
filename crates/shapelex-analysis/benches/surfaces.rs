//! Compute time of surfaces, without HTTP and storage.
//!
//! `cargo bench --bench surfaces`.
#![allow(missing_docs, clippy::unwrap_used)]

use std::f64::consts::{PI, TAU};
use std::hint::black_box;
use std::time::Duration;

use criterion::{Criterion, criterion_group, criterion_main};
use shapelex_analysis::accumulate::ShapesInMemory;
use shapelex_analysis::alignment::{Alignment, Method, align_all};
use shapelex_analysis::correspondence::{Correspondence, Direction, Mirror};
use shapelex_analysis::frame::Frame;
use shapelex_analysis::matching::Matching;
use shapelex_analysis::metric::Metric;
use shapelex_analysis::pca::FunctionalPca;
use shapelex_analysis::transformation::{ClassName, Transformation};
use shapelex_geometry::representation::{Representation, ShapeSpace};
use shapelex_geometry::surface::Topology;
use shapelex_geometry::surface::measures::SurfaceMeasures;
use shapelex_geometry::surface::seam::Seam;
use shapelex_numeric::dense::Matrix;

const SURFACES: usize = 60;

fn space(topology: Topology, control_points: [usize; 2]) -> ShapeSpace {
    let generators = topology.usual_generators();
    let seam = Seam::Straight;
    ShapeSpace::new(&Representation::Surface { topology, seam, control_points, generators }).unwrap()
}

/// A sphere with bumps that a seed places.
fn potato(space: &ShapeSpace, seed: usize) -> Matrix {
    let s = seed as f64;
    space.surface().unwrap().interpolate_function(|u, v| {
        let ((su, cu), (sv, cv)) = ((TAU * u).sin_cos(), (PI * v).sin_cos());
        let [x, y, z] =
            [(1.0 + 0.2 * (1.3 * s).sin()) * cu * sv, 0.8 * su * sv, (1.5 + 0.1 * (2.1 * s).cos()) * cv];
        let bump = 1.0
            + 0.15 * (s + 2.0 * x).sin() * y
            + 0.1 * (0.7 * s).cos() * x * z
            + 0.02 * (5.0 * x + s * z).sin();
        [bump * x + 0.1 * s, bump * y, bump * z]
    })
}

fn statistics(c: &mut Criterion) {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap();
    let mut group = c.benchmark_group("60 surfaces of 30 x 32 control points, two threads");
    group.sample_size(20).measurement_time(Duration::from_secs(8));
    for topology in [Topology::Sphere, Topology::Torus] {
        let space = space(topology, [30, 32]);
        let metric = Metric::of(&space);
        let shapes: Vec<f64> =
            (0..SURFACES).flat_map(|seed| potato(&space, seed).as_slice().to_vec()).collect();
        let matching = Matching::new(&space, Correspondence::Landmarks, Direction::Given, Mirror::Forbid);
        for (class, alignment) in
            [(ClassName::Affine, Alignment::Projection), (ClassName::Similarity, Alignment::Procrustes)]
        {
            let method = Method::new(&Transformation::Named(class), alignment, 3).unwrap();
            group.bench_function(
                format!("align + mean + 20 modes, {}, {}", topology.name(), class.as_str()),
                |b| {
                    b.iter(|| {
                        pool.install(|| {
                            let weights = vec![1.0; SURFACES];
                            let (mean, aligned) = align_all(
                                &metric,
                                &method,
                                Frame::Training,
                                &matching,
                                shapes.clone(),
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
                },
            );
        }
    }
    group.finish();
}

fn single(c: &mut Criterion) {
    let mut group = c.benchmark_group("one surface");
    let grid: Vec<f64> = (0..200).map(|i| i as f64 / 200.0).collect();
    for control_points in [[12, 12], [30, 32]] {
        let [count_u, count_v] = control_points;
        let space = space(Topology::Sphere, control_points);
        let surface = space.surface().unwrap().surface(&potato(&space, 1));
        group.bench_function(format!("200 x 200 points, {count_u} x {count_v}"), |b| {
            b.iter(|| black_box(surface.points(&grid, &grid)));
        });
        group.bench_function(format!("200 x 200 points with all derivatives, {count_u} x {count_v}"), |b| {
            b.iter(|| black_box(surface.jets(&grid, &grid)));
        });
        group.bench_function(format!("measure {count_u} x {count_v}"), |b| {
            b.iter(|| black_box(SurfaceMeasures::of(&surface)));
        });
        group.bench_function(format!("prepare a space of {count_u} x {count_v}"), |b| {
            b.iter(|| black_box(ShapeSpace::new(space.representation()).unwrap()));
        });
        let metric = Metric::of(&space);
        let shape = potato(&space, 2).as_slice().to_vec();
        group.bench_function(format!("whiten {count_u} x {count_v}"), |b| {
            b.iter(|| {
                let mut shape = shape.clone();
                metric.whiten(&mut shape);
                black_box(shape)
            });
        });
    }
    group.finish();
}

criterion_group!(benches, statistics, single);
criterion_main!(benches);
