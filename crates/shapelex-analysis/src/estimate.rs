//! Predicted cost of learning a dictionary or testing shapes, before anything runs.

use crate::accumulate::KEPT_BYTES;
use crate::alignment::Method as Alignment;
use crate::dictionary::method::Method;
use crate::dictionary::work::{EIGENPROBLEM, Size};
use crate::partial_sums::Measured;

/// Predicted cost of a job.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Estimate {
    /// Number of shapes used.
    pub shapes: u64,
    /// Number of multiply-adds if learning runs all of its passes.
    pub multiply_adds: f64,
    /// Peak memory in bytes.
    pub memory_bytes: f64,
    /// Seconds on one thread of an ordinary core if learning runs all of its passes: an upper bound, accurate to a
    /// factor of three.
    pub seconds: f64,
}

/// Multiply-adds per second, measured over whole jobs, including sparse coding, FFTs and reading.
const RATE: f64 = 1.0e9;

/// Rounds of a search for start points; few cohorts need more.
const ROUNDS: f64 = 10.0;

impl Estimate {
    /// Cost of learning by `method` from `shapes` shapes.
    pub fn new(measured: Measured<'_>, method: &Method, shapes: u64) -> Self {
        let (k, n) = (shapes as f64, measured.metric.len() as f64);
        let dimension = measured.metric.dimension() as f64;
        let cost = method.cost(Size { shapes: k, length: n, dimension, class: class_size(measured) });
        let kept = (8.0 * k * n).min(KEPT_BYTES as f64);
        let multiply_adds = mean_work(measured, k) + cost.multiply_adds;
        let memory_bytes = kept + 8.0 * (4.0 * n * n + cost.numbers);
        Self::of(shapes, multiply_adds, memory_bytes)
    }

    fn of(shapes: u64, multiply_adds: f64, memory_bytes: f64) -> Self {
        Self { shapes, multiply_adds, memory_bytes, seconds: multiply_adds / RATE }
    }

    /// Adds further trainings, each on nearly all shapes and two at a time.
    pub fn times(self, trainings: usize) -> Self {
        let multiply_adds = self.multiply_adds * (1 + trainings) as f64;
        let memory_bytes = self.memory_bytes * if trainings > 0 { 3.0 } else { 1.0 };
        Self { multiply_adds, memory_bytes, seconds: multiply_adds / RATE, ..self }
    }

    /// Cost of tests of shapes aligned to one mean.
    pub fn for_tests(measured: Measured<'_>, work: &TestWork) -> Self {
        let (k, n) = (work.shapes as f64, measured.metric.len() as f64);
        let rows = n + work.samples as f64 * measured.metric.dimension() as f64;
        let draws = work.permutations as f64;
        let products = draws * (work.columns as f64 * k * n.min(k) + work.pair_shapes as f64 * rows);
        let smaller = n.min(k);
        let spans = (1.0 + work.pairs as f64) * (smaller * k * n + EIGENPROBLEM * smaller.powi(3));
        let measures = k * MEASURES * measured.metric.size() as f64;
        let multiply_adds = mean_work(measured, k) + measures + products + spans;
        // Shapes as given, prepared, aligned, in coordinates and at points; sums of projectors; the products.
        let memory = k * (4.0 * n + 3.0 * rows) + 4.0 * n * n + 3.0 * smaller * smaller + 256.0 * (k + rows);
        Self::of(work.shapes as u64, multiply_adds, 8.0 * memory)
    }
}

/// Size of a test of shapes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TestWork {
    /// Number of shapes.
    pub shapes: usize,
    /// Number of points along each shape.
    pub samples: usize,
    /// Number of permutations of the group labels.
    pub permutations: usize,
    /// Number of columns that a permutation of all shapes contributes to a matrix product.
    pub columns: usize,
    /// Number of pairs of groups.
    pub pairs: usize,
    /// Number of shapes summed over all pairs.
    pub pair_shapes: usize,
}

/// Multiply-adds for measuring the sizes of a shape, per control point.
const MEASURES: f64 = 2_000.0;

fn class_size(measured: Measured<'_>) -> f64 {
    match measured.method {
        Alignment::Projection(class) => class.matrices().len() as f64,
        Alignment::Procrustes(_) => measured.metric.dimension() as f64,
    }
}

/// Multiply-adds for the mean of `k` shapes and their alignment to it.
fn mean_work(measured: Measured<'_>, k: f64) -> f64 {
    let (n, points, class) =
        (measured.metric.len() as f64, measured.metric.size() as f64, class_size(measured));
    let spectrum = if measured.matching.searches() { 4.0 * class * n * points.log2() } else { 0.0 };
    ROUNDS * k * spectrum + k * class * n * n + EIGENPROBLEM * n.powi(3)
}
