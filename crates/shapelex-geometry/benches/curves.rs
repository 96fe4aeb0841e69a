//! Compute time of generators and single curves.
//!
//! `cargo bench --bench curves`, one thread.
#![allow(missing_docs, clippy::unwrap_used)]

use std::f64::consts::TAU;
use std::hint::black_box;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use shapelex_geometry::curve::Curve;
use shapelex_geometry::distance::Distances;
use shapelex_geometry::fit::Samples;
use shapelex_geometry::generator::{GeneratorKind, Poles, Recipe};
use shapelex_geometry::measures::CurveMeasures;
use shapelex_geometry::refine::Refinement;
use shapelex_geometry::representation::{Representation, ShapeSpace};
use shapelex_numeric::dense::Matrix;

/// Zeros and harmonics of a curve of 100 control points, `order` poles in all.
fn poles(order: usize) -> Poles {
    let harmonics = (order - 1) / 2;
    let omega = |h: usize| TAU * h as f64 / 100.0;
    Poles {
        zeros: order - 2 * harmonics,
        trigonometric: (1..=harmonics).map(omega).collect(),
        ..Poles::default()
    }
}

fn generators(c: &mut Criterion) {
    let mut group = c.benchmark_group("build a generator");
    for order in [3, 4, 5, 6, 7, 8] {
        let integer =
            Recipe::IntegerShifts { poles: poles(order), support: 2 * (order - 1), weights: vec![] };
        for (name, recipe) in [
            ("B-spline", Recipe::Bspline(poles(order))),
            ("half-integer shifts", Recipe::HalfIntegerShifts(poles(order))),
            ("integer shifts", integer),
        ] {
            group.bench_function(format!("{name}, {order} poles"), |b| {
                b.iter(|| black_box(recipe.build().unwrap()));
            });
        }
    }
    group.finish();
}

fn outline(n: usize) -> Matrix {
    Matrix::from_fn(n, 2, |k, c| {
        let t = TAU * k as f64 / n as f64;
        if c == 0 { 2.0 * t.cos() + 0.3 * (2.0 * t).cos() } else { t.sin() + 0.2 * (3.0 * t).sin() }
    })
}

fn closed(generator: GeneratorKind) -> ShapeSpace {
    ShapeSpace::new(&Representation::ClosedCurve { dimension: 2, control_points: 100, generator }).unwrap()
}

fn curves(c: &mut Criterion) {
    let mut group = c.benchmark_group("planar curve of 100 control points");
    let parameters: Vec<f64> = (0..1_000_000).map(|i| (i as f64 * 0.618_033_988_749_894_9).fract()).collect();
    group.throughput(Throughput::Elements(parameters.len() as u64));
    for (name, kind) in [
        ("trigonometric", GeneratorKind::Trigonometric {}),
        ("cubic", GeneratorKind::Cubic {}),
        ("cubic B-spline", GeneratorKind::Bspline { degree: 3 }),
    ] {
        let space = closed(kind);
        group.bench_function(format!("evaluate at a million unordered parameters, {name}"), |b| {
            b.iter(|| {
                let curve = Curve::of(&space, &outline(100)).unwrap();
                black_box(curve.evaluate_all(&parameters, 0))
            });
        });
    }
    let space = closed(GeneratorKind::Trigonometric {});
    let curve = Curve::of(&space, &outline(100)).unwrap();
    group.bench_function("first derivative at a million parameters, trigonometric", |b| {
        b.iter(|| black_box(curve.evaluate_all(&parameters, 1)));
    });
    group.throughput(Throughput::Elements(1));
    group.bench_function("measures", |b| b.iter(|| black_box(CurveMeasures::of(&curve))));
    let other = Curve::of(&space, &(outline(100) * 1.1)).unwrap();
    group.bench_function("three distances to another", |b| {
        b.iter(|| black_box(Distances::of(&curve, &other)));
    });
    let spline = closed(GeneratorKind::Bspline { degree: 3 });
    group.bench_function("refine ten times, cubic B-spline", |b| {
        let refinement = Refinement::new(&spline, 10).unwrap();
        b.iter(|| black_box(refinement.apply(&outline(100))));
    });
    let points = curve.parameters(1000);
    let contour = Matrix::from_column_slice(1000, 2, &curve.evaluate_all(&points, 0));
    let samples = Samples::new(contour, points, true).unwrap();
    group.bench_function("fit to 1000 points", |b| b.iter(|| black_box(samples.fit(&space).unwrap())));
    let open = Representation::OpenCurve { dimension: 2, intervals: 100, generator: GeneratorKind::Cubic {} };
    group.bench_function("prepare the space of an open curve of 100 intervals", |b| {
        b.iter(|| black_box(ShapeSpace::new(&open).unwrap()));
    });
    group.finish();
}

criterion_group!(benches, generators, curves);
criterion_main!(benches);
