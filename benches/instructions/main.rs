//! Small runs of the main computations, whose instructions `benches/instructions/run.py` counts.
//!
//! ```text
//! instructions             names of the computations
//! instructions NAME TIMES  prepares one and runs it so many times, on this thread alone
//! ```
#![allow(clippy::unwrap_used, clippy::print_stdout, missing_docs)]

use std::hint::black_box;

use rayon::ThreadPoolBuilder;
use shapelex_server::analysis::accumulate::ShapesInMemory;
use shapelex_server::analysis::alignment::{Alignment, Method, Projector, mean_shape};
use shapelex_server::analysis::correspondence::{Correspondence, Direction, Mirror};
use shapelex_server::analysis::distance::DistanceSpace;
use shapelex_server::analysis::frame::Frame;
use shapelex_server::analysis::matching::Matching;
use shapelex_server::analysis::mean::ProjectorSum;
use shapelex_server::analysis::metric::Metric;
use shapelex_server::analysis::neighbours::NeighbourSearch;
use shapelex_server::analysis::pca::FunctionalPca;
use shapelex_server::analysis::sparse::{Atoms, Encode, Lasso, Pursuit};
use shapelex_server::analysis::transformation::{ClassName, Transformation, TransformationClass};
use shapelex_server::geometry::curve::Curve;
use shapelex_server::geometry::generator::GeneratorKind;
use shapelex_server::geometry::intersection::self_intersects;
use shapelex_server::geometry::measures::CurveMeasures;
use shapelex_server::geometry::representation::{Representation, ShapeSpace};
use shapelex_server::geometry::resample::Contour;
use shapelex_server::geometry::subdivision::control::StartMesh;
use shapelex_server::geometry::subdivision::refinement::{Depth, refine_mesh};
use shapelex_server::geometry::subdivision::{LoopWeights, Scheme};
use shapelex_server::numeric::dense::Matrix;
use shapelex_server::wire::shape::ShapeInput;

type Kernel = Box<dyn Fn() + Sync>;

/// The name of a computation, and what prepares it.
type Named = (&'static str, fn() -> Kernel);

const KERNELS: [Named; 16] = [
    ("scatter of 1000 x 128", || scatter(1000, 128)),
    ("projectors of 1000 x 128", || projectors(1000, 128)),
    ("mean of 100 curves x 64, start points searched, similarity", || mean(ClassName::Similarity)),
    ("mean of 100 curves x 64, start points searched, affine", || mean(ClassName::Affine)),
    ("distances of 64 curves x 64, similarity", || distances(ClassName::Similarity)),
    ("distances of 64 curves x 64, affine", || distances(ClassName::Affine)),
    ("10 nearest of 2000 curves x 32", neighbours),
    ("projection of a curve of 12 points", projection),
    ("lasso of 200 signals, 64 atoms", || codes(64, Lasso::new(0.05, false))),
    ("lasso of 200 signals, 512 atoms", || codes(512, Lasso::new(0.05, false))),
    ("pursuit of 5 of 200 signals, 64 atoms", || codes(64, Pursuit { nonzeros: 5 })),
    ("pursuit of 5 of 200 signals, 512 atoms", || codes(512, Pursuit { nonzeros: 5 })),
    ("measures and self-intersection of a curve of 100 points", measures),
    ("canonical start and 200 points of a contour of 1000", resampling),
    ("octahedron, Loop, level 4", subdivision),
    ("100 lines of 50 points", reading),
];

fn main() {
    // `cargo bench` hands its own flag on.
    let arguments: Vec<String> = std::env::args().skip(1).filter(|word| word != "--bench").collect();
    match arguments.as_slice() {
        [name, times] => {
            // Rayon then has no thread of its own that would look for work.
            let pool = ThreadPoolBuilder::new().num_threads(1).use_current_thread().build().unwrap();
            let kernel = KERNELS.iter().find(|(known, _)| known == name).expect("a known name").1();
            pool.install(|| (0..times.parse().unwrap()).for_each(|_: usize| kernel()));
        }
        _ => KERNELS.iter().for_each(|(name, _)| println!("{name}")),
    }
}

/// Numbers of a linear congruential generator: the same everywhere.
fn random(seed: u64) -> impl FnMut() -> f64 {
    let mut state = seed;
    move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
    }
}

fn numbers(count: usize) -> Vec<f64> {
    let mut random = random(1);
    (0..count).map(|_| random()).collect()
}

fn source(whitened: Vec<f64>, length: usize) -> ShapesInMemory {
    let count = whitened.len() / length;
    ShapesInMemory::prepared(whitened, vec![1.0; count])
}

/// Contours with three bumps, each from a start point of its own, coordinate by coordinate; centred, of unit norm.
fn contours(count: usize, n: usize) -> Vec<f64> {
    let mut random = random(2);
    let mut contour = |_| {
        let bumps: [[f64; 2]; 3] = std::array::from_fn(|_| [0.4 * random(), 6.0 * random()]);
        let start = random();
        let polar = |k: usize| {
            let t = std::f64::consts::TAU * (k as f64 / n as f64 + start);
            let r = 1.0
                + (2..)
                    .zip(&bumps)
                    .map(|(f, [size, phase])| size * (f as f64 * t + phase).cos())
                    .sum::<f64>();
            (r * t.cos(), 0.7 * r * t.sin())
        };
        let points: Vec<(f64, f64)> = (0..n).map(polar).collect();
        let mut shape: Vec<f64> = points.iter().map(|p| p.0).chain(points.iter().map(|p| p.1)).collect();
        for coordinate in shape.chunks_exact_mut(n) {
            let mean = coordinate.iter().sum::<f64>() / n as f64;
            coordinate.iter_mut().for_each(|x| *x -= mean);
        }
        let norm = shape.iter().map(|x| x * x).sum::<f64>().sqrt();
        shape.iter_mut().for_each(|x| *x /= norm);
        shape
    };
    (0..count).flat_map(&mut contour).collect()
}

fn space(n: usize) -> ShapeSpace {
    let generator = GeneratorKind::Trigonometric {};
    ShapeSpace::new(&Representation::ClosedCurve { dimension: 2, control_points: n, generator }).unwrap()
}

fn method(class: ClassName) -> Method {
    Method::new(&Transformation::Named(class), Alignment::Projection, 2).unwrap()
}

fn matching(space: &ShapeSpace) -> Matching {
    Matching::new(space, Correspondence::Cyclic, Direction::Given, Mirror::Forbid)
}

fn scatter(count: usize, length: usize) -> Kernel {
    let (source, origin) = (source(numbers(count * length), length), vec![0.1; length]);
    Box::new(move || drop(black_box(FunctionalPca::scatter(&source, &origin).unwrap())))
}

fn projectors(count: usize, length: usize) -> Kernel {
    let source = source(numbers(count * length), length);
    let class = TransformationClass::new(&Transformation::Named(ClassName::Similarity), 2).unwrap();
    Box::new(move || drop(black_box(ProjectorSum::of(&source, &class, length).unwrap())))
}

fn mean(class: ClassName) -> Kernel {
    let (space, method) = (space(64), method(class));
    let (metric, matching) = (Metric::of(&space), matching(&space));
    let source = source(contours(100, 64), metric.len());
    Box::new(move || {
        drop(black_box(mean_shape(&source, &metric, &method, Frame::Training, &matching).unwrap()))
    })
}

fn distances(class: ClassName) -> Kernel {
    let space = DistanceSpace::new(&method(class), &matching(&space(64))).unwrap();
    let shapes = space.prepare(&contours(64, 64)).unwrap();
    Box::new(move || drop(black_box(space.matrix(&shapes, &|_| true).unwrap())))
}

fn neighbours() -> Kernel {
    let space = DistanceSpace::new(&method(ClassName::Similarity), &matching(&space(32))).unwrap();
    let shapes = contours(2000, 32);
    let (query, shapes) = (space.prepare(&shapes[..64]).unwrap(), space.prepare(&shapes).unwrap());
    Box::new(move || {
        let mut search = NeighbourSearch::new(&space, query.clone(), 10);
        search.offer(&shapes, &|| false).unwrap();
        black_box(search.into_sorted());
    })
}

fn projection() -> Kernel {
    let shapes = contours(2, 12);
    let (metric, method) = (Metric::of(&space(12)), method(ClassName::Similarity));
    Box::new(move || {
        let projector = Projector::new(&metric, &method, shapes[..24].to_vec());
        black_box(projector.project(shapes[24..].to_vec()).unwrap());
    })
}

fn codes(atoms: usize, encoder: impl Encode + Sync + 'static) -> Kernel {
    const SIGNAL: usize = 128;
    const SIGNALS: usize = 200;
    let mut random = random(3);
    let mut matrix = Matrix::from_fn(SIGNAL, atoms, |_, _| random());
    for mut column in matrix.column_iter_mut() {
        column.normalize_mut();
    }
    let mut signals = vec![0.0; SIGNAL * SIGNALS];
    for (k, signal) in signals.chunks_exact_mut(SIGNAL).enumerate() {
        for i in 0..5 {
            let (weight, atom) = (random(), matrix.column((17 * k + 11 * i) % atoms));
            signal.iter_mut().zip(atom.iter()).for_each(|(x, d)| *x += weight * d);
        }
        signal.iter_mut().for_each(|x| *x += 0.02 * random());
    }
    let atoms = Atoms::new(matrix);
    Box::new(move || drop(black_box(encoder.codes(&atoms, &signals).unwrap())))
}

fn measures() -> Kernel {
    let points = Matrix::from_column_slice(100, 2, &contours(1, 100));
    let curve = Curve::of(&space(100), &points).unwrap();
    Box::new(move || {
        black_box(CurveMeasures::of(&curve));
        black_box(self_intersects(&curve));
    })
}

fn resampling() -> Kernel {
    let contour = Contour::closed(Matrix::from_column_slice(1000, 2, &contours(1, 1000))).unwrap();
    Box::new(move || drop(black_box(contour.sample(200, contour.canonical_start()))))
}

fn subdivision() -> Kernel {
    let octahedron = "octahedron".parse::<StartMesh>().unwrap();
    let scheme = Scheme::Loop(LoopWeights::Original);
    Box::new(move || {
        drop(black_box(refine_mesh(scheme, octahedron.mesh(), Depth::Level(4), 10_000, false).unwrap()));
    })
}

fn reading() -> Kernel {
    let numbers = contours(100, 50);
    let line = |shape: &[f64]| {
        let points: Vec<[f64; 2]> = shape[..50].iter().zip(&shape[50..]).map(|(x, y)| [*x, *y]).collect();
        serde_json::json!({"label": "a", "points": points}).to_string()
    };
    let lines: Vec<String> = numbers.chunks_exact(100).map(line).collect();
    Box::new(move || {
        for line in &lines {
            black_box(serde_json::from_str::<ShapeInput>(line).unwrap());
        }
    })
}
