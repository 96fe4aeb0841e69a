//! Rates of the main computations on one thread, beside what the same machine does at best in the same run.

use std::hint::black_box;
use std::time::Instant;

use rayon::{ThreadPool, ThreadPoolBuilder};
use realfft::num_complex::Complex64;
use shapelex_analysis::accumulate::{ShapesInMemory, prepare};
use shapelex_analysis::alignment::{Alignment, Method, mean_shape};
use shapelex_analysis::correspondence::{Correspondence, Direction, Mirror};
use shapelex_analysis::distance::DistanceSpace;
use shapelex_analysis::frame::Frame;
use shapelex_analysis::matching::Matching;
use shapelex_analysis::mean::ProjectorSum;
use shapelex_analysis::metric::Metric;
use shapelex_analysis::neighbours::NeighbourSearch;
use shapelex_analysis::pca::FunctionalPca;
use shapelex_analysis::sparse::{Atoms, Encode, Lasso, Pursuit};
use shapelex_analysis::transformation::{ClassName, Transformation, TransformationClass};
use shapelex_geometry::generator::GeneratorKind;
use shapelex_geometry::representation::{Representation, ShapeSpace};
use shapelex_numeric::dense::{Matrix, multiply, transpose_multiply_columns};
use shapelex_numeric::fft::ComplexFft;
use shapelex_numeric::kernels::dot_single;

/// Runs of each side; the fastest counts. The sides alternate, so that both meet the same load of the machine.
const RUNS: usize = 7;

/// One run of a computation, and the units of work that it does.
struct Run {
    units: f64,
    run: Box<dyn Fn() + Send + Sync>,
}

impl Run {
    fn new(units: f64, run: impl Fn() + Send + Sync + 'static) -> Self {
        Self { units, run: Box::new(run) }
    }

    /// Units per second.
    fn rate(&self, pool: &ThreadPool) -> f64 {
        let start = Instant::now();
        pool.install(&self.run);
        self.units / start.elapsed().as_secs_f64()
    }
}

/// A computation beside its bound.
pub(crate) struct Row {
    pub(crate) name: &'static str,
    pub(crate) unit: &'static str,
    pub(crate) bound: &'static str,
    /// Fraction of the bound in the profile of tests, on an idle machine.
    pub(crate) usual: f64,
    work: Run,
    limit: Run,
}

impl Row {
    /// Units per second of the computation and of its bound, on one thread.
    pub(crate) fn rates(&self) -> (f64, f64) {
        let pool = ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        let fastest = |(work, limit): (f64, f64), _| {
            (self.work.rate(&pool).max(work), self.limit.rate(&pool).max(limit))
        };
        (0..RUNS).fold((0.0, 0.0), fastest)
    }
}

/// All rows. Preparing their data takes about a second.
pub(crate) fn rows() -> Vec<Row> {
    vec![scatter(), projectors(), distances(), start_points(), neighbours(), lasso(), pursuit()]
}

/// Numbers of a linear congruential generator: the same everywhere.
fn random() -> impl FnMut() -> f64 {
    let mut state = 1_u64;
    move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
    }
}

/// Multiply-adds of products of square matrices.
fn products() -> Run {
    const SIZE: usize = 512;
    let a = Matrix::from_fn(SIZE, SIZE, |i, j| ((i * 7 + j * 3) % 11) as f64);
    Run::new((SIZE as f64).powi(3), move || drop(black_box(multiply(&a, &a))))
}

/// Inverse complex transforms of `n` numbers, in place.
fn transforms(n: usize) -> Run {
    const COUNT: usize = 10_000;
    let mut random = random();
    let signals: Vec<Complex64> = (0..32 * n).map(|_| Complex64::new(random(), random())).collect();
    let fft = ComplexFft::new(n);
    Run::new(COUNT as f64, move || {
        let (mut signal, mut scratch) = (signals[..n].to_vec(), fft.scratch());
        for k in 0..COUNT {
            signal.copy_from_slice(&signals[k % 32 * n..(k % 32 + 1) * n]);
            fft.inverse(&mut signal, &mut scratch);
            black_box(&signal);
        }
    })
}

const LENGTH: usize = 256;
const SHAPES: usize = 20_000;

fn signals(length: usize, count: usize) -> ShapesInMemory {
    let mut random = random();
    ShapesInMemory::prepared((0..count * length).map(|_| random()).collect(), vec![1.0; count])
}

/// Multiply-adds of one triangle of the sums.
fn multiply_adds() -> f64 {
    (SHAPES * LENGTH * LENGTH) as f64 / 2.0
}

fn scatter() -> Row {
    let (source, origin) = (signals(LENGTH, SHAPES), vec![0.1; LENGTH]);
    Row {
        name: "scatter of 20 000 shapes of 256 numbers",
        unit: "multiply-adds",
        bound: "product of matrices of 512 × 512",
        usual: 0.7,
        work: Run::new(multiply_adds(), move || {
            drop(black_box(FunctionalPca::scatter(&source, &origin).unwrap()))
        }),
        limit: products(),
    }
}

fn projectors() -> Row {
    let source = signals(LENGTH, SHAPES);
    let class = TransformationClass::new(&Transformation::Named(ClassName::Similarity), 2).unwrap();
    Row {
        name: "projectors of 20 000 shapes of 256 numbers",
        unit: "multiply-adds",
        bound: "product of matrices of 512 × 512",
        usual: 0.7,
        work: Run::new(multiply_adds(), move || {
            drop(black_box(ProjectorSum::of(&source, &class, LENGTH).unwrap()));
        }),
        limit: products(),
    }
}

/// Control points of contours with three bumps, each from a start point of its own, coordinate by coordinate.
fn contours(count: usize, n: usize) -> Vec<f64> {
    let mut random = random();
    let contour = |_| {
        let (a, b, c, start) = (random(), random(), random(), std::f64::consts::TAU * random());
        let point = move |k: usize| {
            let t = std::f64::consts::TAU * k as f64 / n as f64 + start;
            let r =
                1.0 + 0.3 * a * (2.0 * t).cos() + 0.3 * b * (3.0 * t).sin() + 0.2 * c * (5.0 * t + a).cos();
            [1.3 * r * t.cos(), r * t.sin()]
        };
        (0..2).flat_map(move |c| (0..n).map(move |k| point(k)[c])).collect::<Vec<f64>>()
    };
    (0..count).flat_map(contour).collect()
}

/// Closed curves of `n` control points under similarities, with a search for start points.
struct Curves {
    metric: Metric,
    method: Method,
    matching: Matching,
    whitened: Vec<f64>,
}

fn curves(count: usize, n: usize) -> Curves {
    let generator = GeneratorKind::Trigonometric {};
    let representation = Representation::ClosedCurve { dimension: 2, control_points: n, generator };
    let space = ShapeSpace::new(&representation).unwrap();
    let metric = Metric::of(&space);
    let matching = Matching::new(&space, Correspondence::Cyclic, Direction::Given, Mirror::Forbid);
    let method =
        Method::new(&Transformation::Named(ClassName::Similarity), Alignment::Projection, 2).unwrap();
    let mut whitened = contours(count, n);
    prepare(&metric, method.translates(), 0, &mut whitened).unwrap();
    Curves { metric, method, matching, whitened }
}

fn distances() -> Row {
    const COUNT: usize = 300;
    let Curves { method, matching, whitened, .. } = curves(COUNT, 100);
    let space = DistanceSpace::new(&method, &matching).unwrap();
    let shapes = space.prepare(&whitened).unwrap();
    Row {
        name: "distances of curves of 100 points, start points searched",
        unit: "pairs",
        bound: "one complex transform for each",
        usual: 0.85,
        work: Run::new((COUNT * (COUNT - 1)) as f64 / 2.0, move || {
            drop(black_box(space.matrix(&shapes, &|_| true).unwrap()));
        }),
        limit: transforms(100),
    }
}

fn start_points() -> Row {
    const COUNT: usize = 650;
    let Curves { metric, method, matching, whitened } = curves(COUNT, 200);
    let source = ShapesInMemory::prepared(whitened, vec![1.0; COUNT]);
    let mean = move || mean_shape(&source, &metric, &method, Frame::Training, &matching).unwrap();
    let placements = (COUNT * mean().rounds) as f64;
    Row {
        name: "mean of 650 curves of 200 points, start points searched",
        unit: "placements",
        bound: "one complex transform for each",
        usual: 0.27,
        work: Run::new(placements, move || drop(black_box(mean()))),
        limit: transforms(200),
    }
}

fn neighbours() -> Row {
    const COUNT: usize = 50_000;
    const SIZE: usize = 32;
    let Curves { method, matching, whitened, .. } = curves(COUNT, SIZE);
    let space = DistanceSpace::new(&method, &matching).unwrap();
    let query = space.prepare(&whitened[..2 * SIZE]).unwrap();
    let shapes = space.prepare(&whitened).unwrap();
    let (numbers, one) = (vec![0.5_f32; COUNT * SIZE], [0.25_f32; SIZE]);
    Row {
        name: "12 nearest of 50 000 curves of 32 points",
        unit: "shapes",
        bound: "product of 32 single numbers for each",
        usual: 0.33,
        work: Run::new(COUNT as f64, move || {
            let mut search = NeighbourSearch::new(&space, query.clone(), 12);
            search.offer(&shapes, &|| false).unwrap();
            black_box(search.into_sorted());
        }),
        limit: Run::new(COUNT as f64, move || {
            for numbers in numbers.chunks_exact(SIZE) {
                black_box(dot_single(numbers, &one));
            }
        }),
    }
}

const ATOMS: usize = 64;
const SIGNAL: usize = 128;
const SIGNALS: usize = 4000;

/// Atoms, and signals near combinations of five of them.
fn coded() -> (Matrix, Vec<f64>) {
    let mut random = random();
    let mut atoms = Matrix::from_fn(SIGNAL, ATOMS, |_, _| random());
    for mut column in atoms.column_iter_mut() {
        column.normalize_mut();
    }
    let mut signals = vec![0.0; SIGNAL * SIGNALS];
    for (k, signal) in signals.chunks_exact_mut(SIGNAL).enumerate() {
        for i in 0..5 {
            let (weight, atom) = (random(), atoms.column((17 * k + 11 * i) % ATOMS));
            signal.iter_mut().zip(atom.iter()).for_each(|(x, d)| *x += weight * d);
        }
        signal.iter_mut().for_each(|x| *x += 0.02 * random());
    }
    (atoms, signals)
}

/// Products of all signals with all atoms.
fn correlations() -> Run {
    let (atoms, signals) = coded();
    Run::new(SIGNALS as f64, move || drop(black_box(transpose_multiply_columns(&atoms, &signals))))
}

fn codes(name: &'static str, usual: f64, encoder: impl Encode + Send + Sync + 'static) -> Row {
    let (atoms, signals) = coded();
    let atoms = Atoms::new(atoms);
    Row {
        name,
        unit: "signals",
        bound: "products with all atoms",
        usual,
        work: Run::new(SIGNALS as f64, move || drop(black_box(encoder.codes(&atoms, &signals).unwrap()))),
        limit: correlations(),
    }
}

fn lasso() -> Row {
    codes("lasso of 4000 signals of 128 numbers, 64 atoms", 0.14, Lasso::new(0.05, false))
}

fn pursuit() -> Row {
    codes("pursuit of 5 atoms, of 4000 signals of 128 numbers, 64 atoms", 0.19, Pursuit { nonzeros: 5 })
}
