//! What learning a dictionary, or comparing shapes, will cost, before anything runs.

use crate::analysis::alignment::Method as Alignment;
use crate::domain::dictionary::{Codes, Method};
use crate::service::statistics::Setup;

/// Prepared shapes are kept in memory up to this many bytes; more are read from the store in every pass.
pub(crate) const KEPT_BYTES: usize = 1 << 30;

/// The predicted cost of a plan.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, utoipa::ToSchema)]
pub struct Estimate {
    /// Shapes that are learnt from.
    pub shapes: u64,
    /// Multiply-adds, when learning takes all of its passes.
    pub multiply_adds: f64,
    /// Bytes of memory at the peak.
    pub memory_bytes: f64,
    /// Seconds at one thread of an ordinary core, when learning takes all of its passes: an upper bound, good to a
    /// factor of three.
    pub seconds: f64,
}

/// Multiply-adds of a second: measured over whole jobs, in which sparse codes, FFTs and reading take their part.
const RATE: f64 = 1.0e9;

/// Rounds of a search for start points: few cohorts need more.
const ROUNDS: f64 = 10.0;

/// Part of the atoms that a code uses, for the length of a regularisation path.
const USED: f64 = 0.3;

/// Multiply-adds of an eigenproblem, over the cube of its size.
const EIGENPROBLEM: f64 = 10.0;

impl Estimate {
    /// For learning by `method` from `shapes` shapes.
    pub fn new(setup: &Setup, method: &Method, shapes: u64) -> Self {
        let (k, n) = (shapes as f64, setup.metric.len() as f64);
        let d = setup.metric.dimension() as f64;
        let class = class_size(setup);
        let mean = mean_work(setup, k);
        let kept = (8.0 * k * n).min(KEPT_BYTES as f64);
        let (learning, memory) = match method {
            Method::FunctionalPca { components, .. } => {
                let c = *components as f64;
                (k * n * n.min(k) + EIGENPROBLEM * n.min(k).powi(3) + 2.0 * k * n * c, 3.0 * n * n)
            }
            Method::Sparse { atoms, nonzeros, codes, max_epochs, .. } => {
                let block = if *codes == Codes::Invariant { class } else { 1.0 };
                let columns = *atoms as f64 * block;
                let used = nonzeros.map_or(USED * columns, |count| count as f64 * block).min(n);
                let code = n * columns + used * columns * used.sqrt() + used * n;
                let sweep = 2.0 * n * d * columns * *atoms as f64;
                let groups = (k / 128.0).clamp(1.0, 64.0);
                let sums = columns * columns + n * columns;
                (*max_epochs as f64 * (k * code + groups * sweep), (groups + 16.0) * sums)
            }
        };
        let multiply_adds = mean + learning;
        let memory_bytes = kept + 8.0 * (4.0 * n * n + memory);
        Self::of(shapes, multiply_adds, memory_bytes)
    }

    fn of(shapes: u64, multiply_adds: f64, memory_bytes: f64) -> Self {
        Self { shapes, multiply_adds, memory_bytes, seconds: multiply_adds / RATE }
    }

    /// With as many further trainings on nearly all shapes, two at a time.
    pub fn times(self, trainings: usize) -> Self {
        let multiply_adds = self.multiply_adds * (1 + trainings) as f64;
        let memory_bytes = self.memory_bytes * if trainings > 0 { 3.0 } else { 1.0 };
        Self { multiply_adds, memory_bytes, seconds: multiply_adds / RATE, ..self }
    }
    /// For tests of shapes that are aligned to one mean.
    pub fn of_tests(setup: &Setup, work: &TestWork) -> Self {
        let (k, n) = (work.shapes as f64, setup.metric.len() as f64);
        let rows = n + work.samples as f64 * setup.metric.dimension() as f64;
        let draws = work.permutations as f64;
        let products = draws * (work.columns as f64 * k * n.min(k) + work.pair_shapes as f64 * rows);
        let smaller = n.min(k);
        let spans = (1.0 + work.pairs as f64) * (smaller * k * n + EIGENPROBLEM * smaller.powi(3));
        let measures = k * MEASURES * setup.metric.size() as f64;
        let multiply_adds = mean_work(setup, k) + measures + products + spans;
        // The shapes as given, prepared, aligned, in coordinates, at points; sums of projectors; the products.
        let memory = k * (4.0 * n + 3.0 * rows) + 4.0 * n * n + 3.0 * smaller * smaller + 256.0 * (k + rows);
        Self::of(work.shapes as u64, multiply_adds, 8.0 * memory)
    }
}

/// How much a test of shapes looks at.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TestWork {
    /// Shapes.
    pub shapes: usize,
    /// Points along the shape.
    pub samples: usize,
    /// Relabellings.
    pub permutations: usize,
    /// Columns that a relabelling of all shapes takes in a product.
    pub columns: usize,
    /// Pairs of groups.
    pub pairs: usize,
    /// Shapes of all pairs together.
    pub pair_shapes: usize,
}

/// Work for the sizes of a shape, over its control points.
const MEASURES: f64 = 2_000.0;

fn class_size(setup: &Setup) -> f64 {
    match &setup.method {
        Alignment::Projection(class) => class.matrices().len() as f64,
        Alignment::Procrustes(_) => setup.metric.dimension() as f64,
    }
}

/// Multiply-adds of the mean of `k` shapes and of their alignment.
fn mean_work(setup: &Setup, k: f64) -> f64 {
    let (n, points, class) = (setup.metric.len() as f64, setup.metric.size() as f64, class_size(setup));
    let spectrum = if setup.matching.searches() { 4.0 * class * n * points.log2() } else { 0.0 };
    ROUNDS * k * spectrum + k * class * n * n + EIGENPROBLEM * n.powi(3)
}
