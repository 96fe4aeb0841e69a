//! Compute time of subdivision surfaces, without HTTP and storage.
//!
//! `cargo bench --bench subdivision`.
#![allow(missing_docs, clippy::unwrap_used)]

use std::f64::consts::FRAC_PI_2;
use std::hint::black_box;
use std::time::Duration;

use criterion::{Criterion, criterion_group, criterion_main};
use rayon::prelude::*;
use shapelex_geometry::generator::Exact;
use shapelex_geometry::mesh::TriangleMesh;
use shapelex_geometry::mesh_tree::NearestTriangles;
use shapelex_geometry::raster::{self, Grid};
use shapelex_geometry::representation::{Representation, ShapeSpace};
use shapelex_geometry::subdivision::control::{ControlMesh, StartMesh};
use shapelex_geometry::subdivision::fit::{Fitting, mesh_targets};
use shapelex_geometry::subdivision::refinement::{Depth, refine_mesh};
use shapelex_geometry::subdivision::{Frequency, LoopWeights, Scheme, Subdivision};
use shapelex_numeric::dense::Matrix;

const BLOB: Scheme = Scheme::Blob(Frequency::Real(Exact::new(FRAC_PI_2)));
const LOOP: Scheme = Scheme::Loop(LoopWeights::Original);

fn start(text: &str) -> TriangleMesh {
    text.parse::<StartMesh>().unwrap().mesh()
}

fn subdivision(scheme: Scheme, level: usize, text: &str) -> Subdivision {
    Subdivision { scheme, level, connectivity: ControlMesh::Named(text.parse().unwrap()) }
}

fn single(c: &mut Criterion) {
    let mut group = c.benchmark_group("octahedron to level 8, 262146 vertices");
    group.sample_size(20).measurement_time(Duration::from_secs(8));
    let butterfly = Scheme::Butterfly { tension: Exact::new(0.0) };
    let normal_based = Scheme::NormalBased { balance: Exact::new(0.0) };
    for (name, scheme) in
        [("blob", BLOB), ("loop", LOOP), ("butterfly", butterfly), ("normal_based", normal_based)]
    {
        let octahedron = start("octahedron");
        let mesh = TriangleMesh { normals: Some(octahedron.vertices.clone()), ..octahedron };
        group.bench_function(name, |b| {
            b.iter(|| refine_mesh(scheme, black_box(mesh.clone()), Depth::Level(8), 300_000, false).unwrap());
        });
    }
    group.finish();
}

const SHAPES: usize = 10_000;
/// Numbers at every vertex that go through the levels at once: the coordinates of 16 shapes.
const WIDTH: usize = 48;

fn many(c: &mut Criterion) {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap();
    let mut group = c.benchmark_group("258 control vertices, level 4, 65538 vertices, two threads");
    group.sample_size(10).measurement_time(Duration::from_secs(20));
    for (name, scheme) in [("blob", BLOB), ("loop", LOOP)] {
        let subdivision = subdivision(scheme, 4, "octahedron/3");
        group.bench_function(format!("space, {name}"), |b| {
            b.iter(|| ShapeSpace::new(&Representation::Subdivision(black_box(subdivision.clone()))).unwrap());
        });
        let space = ShapeSpace::new(&Representation::Subdivision(subdivision)).unwrap();
        let basis = space.subdivision().unwrap();
        let operator = basis.operator();
        let rows = 258 * 3 * SHAPES / WIDTH;
        let shapes: Vec<[f64; WIDTH]> =
            (0..rows).map(|i| std::array::from_fn(|c| (0.37 * i as f64 + c as f64).sin())).collect();
        group.bench_function(format!("10000 shapes, {name}"), |b| {
            b.iter(|| {
                let blocks = pool.install(|| {
                    shapes
                        .par_chunks_exact(258)
                        .map_init(Vec::new, |points: &mut Vec<[f64; WIDTH]>, rows| {
                            operator.apply_into(rows, points);
                            // The whole result is made; to look at every number would take as long again.
                            black_box(&points);
                        })
                        .count()
                });
                black_box(blocks)
            });
        });
    }
    group.finish();
}

fn comparing(c: &mut Criterion) {
    let mut group = c.benchmark_group("a mesh of 20480 faces");
    group.sample_size(10);
    let subdivision = subdivision(LOOP, 3, "octahedron/2");
    let space = ShapeSpace::new(&Representation::Subdivision(subdivision.clone())).unwrap();
    let basis = space.subdivision().unwrap();
    let bend = |[x, y, z]: &[f64; 3]| [3.0 * x + 0.4 * z * z, 1.5 * y + 0.2 * x * z, z + 0.5 * x * x];
    let target = start("icosahedron/5");
    let target = TriangleMesh { vertices: target.vertices.iter().map(bend).collect(), ..target };
    let grid = Grid::with_cells([[-3.2, -1.8, -1.1], [3.2, 1.8, 1.6]], 128);
    group.bench_function("rasterised on 128 cells along its side", |b| {
        b.iter(|| raster::from_mesh(black_box(&target), &grid));
    });
    let mask = raster::from_mesh(&target, &grid);
    group.bench_function("overlap with itself, with distances", |b| b.iter(|| raster::overlap(&mask, &mask)));
    let index = NearestTriangles::new(&target.vertices, &target.faces);
    let near: Vec<[f64; 3]> = target.vertices.iter().map(|p| p.map(|x| 1.01 * x)).collect();
    group.bench_function("10242 nearest points", |b| {
        b.iter(|| near.iter().filter_map(|p| index.nearest(*p)).map(|foot| foot.distance).sum::<f64>());
    });
    let fitting = Fitting::new(basis, &subdivision.connectivity, 3);
    let (targets, _) = mesh_targets(&target, None);
    let ellipsoid: Matrix = fitting.ellipsoid(&targets).unwrap().unwrap();
    group.bench_function("fit of 66 control vertices, 20 turns", |b| {
        b.iter(|| fitting.fit(&targets, ellipsoid.clone(), 20).unwrap());
    });
    group.finish();
}

criterion_group!(benches, single, many, comparing);
criterion_main!(benches);
