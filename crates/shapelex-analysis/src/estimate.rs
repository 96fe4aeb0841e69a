//! Predicted cost of learning a dictionary or testing shapes, before anything runs.

use crate::accumulate::KEPT_BYTES;
use crate::alignment::Method as Alignment;
use crate::dictionary::method::Method;
use crate::dictionary::posterior::calibration::calibration_work;
use crate::dictionary::report::{ReportOptions, report_bytes, report_work};
use crate::dictionary::work::{EIGENPROBLEM, PRODUCT, Size};
use crate::elastic::space::ElasticSpace;
use crate::groupwise::{self, GroupwiseOptions};
use crate::partial_sums::Measured;
use crate::robust;
use crate::sliding::SlidingCriterion;
use crate::watch::Phase;
use shapelex_geometry::reparametrisation::Spherical;
use shapelex_geometry::representation::ShapeSpace;

/// Predicted cost of a job.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Estimate {
    /// Number of shapes used.
    #[cfg_attr(feature = "serde", serde(rename = "shape_count"))]
    pub shapes: u64,
    /// Number of multiply-adds if learning runs all of its passes.
    pub multiply_adds: f64,
    /// Peak memory in bytes.
    pub memory_bytes: f64,
    /// Seconds of processor time if learning runs all of its passes, to a factor of 1.5 on the machine where the constants were
    /// measured. Two threads take about half of them.
    pub seconds: f64,
}

/// Multiply-adds per second, measured over whole jobs, including sparse coding, FFTs and reading.
const RATE: f64 = 1.0e9;

/// Rounds of a search for start points among `k` shapes, as if each took the time of a transform in the cache: measured, the
/// time per shape grows with the root of their number, since more shapes need more rounds and their spectra more memory, until the
/// search takes stages.
fn rounds(k: f64) -> f64 {
    (k.sqrt() / 10.0).clamp(5.0, 15.0)
}

/// Rounds of a search under the class: those of classes without complex spectra and of Procrustes fits are counted in their own
/// time. Few shapes settle soon; sets of different objects, such as MPEG-7, take up to four times as many.
fn search_rounds(measured: Measured<'_>, k: f64) -> f64 {
    match measured.method {
        _ if measured.matching.moves() => MOVING_ROUNDS,
        Alignment::Projection(class) if class.is_complex() => rounds(k),
        Alignment::Projection(_) => (k.sqrt() / 5.0).clamp(2.0, 5.0),
        Alignment::Procrustes(_) => (k.sqrt() / 10.0).clamp(1.0, 6.0),
    }
}

/// Multiply-adds of a round for each number of a spectrum and its logarithm: products of spectra of similarities in the plane;
/// other classes solve a small problem for every start point; Procrustes fits repeat it.
const COMPLEX_ROUND: f64 = 1.8;
const ROUND: f64 = 15.0;
const FITTED_ROUND: f64 = 100.0;

/// Multiply-adds in whose time a job of any size is stored, run and answered.
const JOB: f64 = 2.2e7;

/// Work of a training that holds out a part of the shapes, divided by that of the first one: they are in memory, and few settle soon.
const HELD_OUT: f64 = 0.4;

/// Multiply-adds in whose time a number of a moved surface is computed, moved surfaces of a shape in a round, and rounds: measured on
/// hippocampi of 8 × 6 and 16 × 9 control points, 55 to 89 under similarities.
const MOTION: f64 = 200.0;
const MOVED: f64 = 150.0;
const MOVING_ROUNDS: f64 = 80.0;

/// Passes of a search for each of these rounds, and the others of its mean: reading, sums of projectors, the frame.
const PASSES_OF_ROUND: f64 = 3.0;
const OTHER_PASSES: f64 = 7.0;

/// Iterations of a Procrustes mean.
const ITERATIONS: f64 = 10.0;

/// Multiply-adds of an iteration of a Procrustes mean for each number.
const ITERATION: f64 = 8.0;

/// Multiply-adds in whose time a node of a refitted surface is mapped, and its points and normals are computed.
const REFIT: f64 = 5e3;

/// Multiply-adds in whose time a number is read from the store.
pub const READING: f64 = 25.0;

/// Multiply-adds in whose time a number is read in all passes of learning, prepared, aligned and certified.
const HANDLING: f64 = 110.0;

/// Rounds in which placements and factors of a robust mean alternate, where start points are searched.
const ROBUST_ROUNDS: f64 = 3.0;

/// Multiply-adds of a robust mean of `k` shapes besides those of a plain one: its passes, three more sums of projectors, and the
/// scatters of the spatial signs, with and without a group of wrong shapes.
fn robust_work(measured: Measured<'_>, k: f64) -> f64 {
    let n = measured.metric.len() as f64;
    let passes = robust::PASSES - 2 + robust::PASSES_WITHOUT_GROUPS;
    let reading = passes as f64 * READING * k * n;
    let of_projectors = order(n, class_size(measured) * k);
    let sums = PRODUCT * k * (3.0 * class_size(measured) + 2.0) * n * of_projectors
        + 5.0 * EIGENPROBLEM * of_projectors.powi(3);
    let search = if measured.matching.searches() {
        ROUND * k * class_size(measured) * n * (measured.metric.size() as f64).log2()
    } else {
        0.0
    };
    robust_rounds(measured) * (reading + sums + search)
}

fn robust_rounds(measured: Measured<'_>) -> f64 {
    if measured.matching.searches() { ROBUST_ROUNDS } else { 1.0 }
}

impl Stage {
    /// The stage of a robust mean of `shapes` shapes, given that of a plain one.
    #[must_use]
    pub fn robust(self, measured: Measured<'_>, shapes: usize) -> Self {
        let multiply_adds = self.multiply_adds + robust_work(measured, shapes as f64);
        let passes = self.passes + robust_rounds(measured) * (robust::PASSES - 2) as f64;
        Self { multiply_adds, passes, ..self }
    }
}

/// A part of a job, as measured by its progress.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stage {
    /// Phase of learning.
    pub phase: Phase,
    /// Predicted multiply-adds.
    pub multiply_adds: f64,
    /// Usual number of passes over the shapes, which [`Watch::worked`](crate::watch::Watch::worked) counts.
    pub passes: f64,
}

/// Trainings of a job besides the one of its dictionary.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Trainings {
    /// To hold out shapes.
    pub held_out: usize,
    /// To validate a classifier.
    pub validation: usize,
}

/// Stages of learning by `method` from `shapes` shapes: mean, learning, certificate, held-out shapes, validation. A mean that
/// is `known` takes nothing.
pub fn stages(
    measured: Measured<'_>,
    method: &Method,
    shapes: usize,
    known: bool,
    trainings: Trainings,
) -> Vec<Stage> {
    let (k, n) = (shapes as f64, measured.metric.len() as f64);
    let dimension = measured.metric.dimension() as f64;
    let reading = READING * k * n;
    let aligning = PRODUCT * k * class_size(measured) * n * order(n, class_size(measured) * k) + reading;
    let mean = mean_work(measured, k) + reading;
    let size = Size { shapes: k, length: n, dimension, class: class_size(measured) };
    let learn = method.cost(size).multiply_adds + aligning;
    let epochs = if method.is_sparse() { 1.0 + method.max_epochs() as f64 } else { 1.0 };
    let (passes, training) = (mean_passes(measured, k), mean + learn);
    let anew = |phase, count: usize| {
        let count = count as f64;
        Stage { phase, multiply_adds: count * training, passes: count * (passes + epochs) }
    };
    let held_out = anew(Phase::HoldOut, trainings.held_out);
    vec![
        Stage { phase: Phase::Mean, multiply_adds: if known { 0.0 } else { mean }, passes },
        Stage { phase: Phase::Learn, multiply_adds: learn, passes: epochs },
        Stage { phase: Phase::Certify, multiply_adds: aligning + learn / epochs, passes: 1.0 },
        Stage {
            multiply_adds: held_out.multiply_adds + reading + EIGENPROBLEM * order(n, k).powi(3),
            ..held_out
        },
        anew(Phase::Validate, trainings.validation),
    ]
}

/// The stage of a test in which its shapes are read, measured and aligned.
pub fn alignment_stage(measured: Measured<'_>, shapes: usize) -> Stage {
    let k = shapes as f64;
    let multiply_adds = mean_work(measured, k) + k * MEASURES * measured.metric.size() as f64;
    Stage { phase: Phase::Mean, multiply_adds, passes: mean_passes(measured, k) + 2.0 }
}

/// Multiply-adds of the mean of `shapes` shapes that are read in each of its passes, and the numbers that it keeps.
pub(crate) fn mean_cost(measured: Measured<'_>, shapes: usize) -> (f64, f64) {
    let (k, n) = (shapes as f64, measured.metric.len() as f64);
    let work = mean_work(measured, k) + mean_passes(measured, k) * READING * k * n;
    // Placements and spectra of a search are those of the mean of a store.
    let placements = if measured.matching.searches() { 4.0 * k } else { k };
    (work, 4.0 * n * order(n, class_size(measured) * k) + placements)
}

/// Usual number of passes for a mean of `k` shapes.
fn mean_passes(measured: Measured<'_>, k: f64) -> f64 {
    let iterations = match measured.method {
        Alignment::Projection(_) => 1.0,
        Alignment::Procrustes(_) => ITERATIONS,
    };
    if !measured.matching.searches() {
        return iterations + 1.0;
    }
    let rounds = if measured.matching.moves() { MOVING_ROUNDS } else { rounds(k) };
    PASSES_OF_ROUND * rounds * iterations.sqrt() + OTHER_PASSES
}

impl Estimate {
    /// Cost of learning by `method` from `shapes` shapes.
    pub fn new(measured: Measured<'_>, method: &Method, shapes: u64) -> Self {
        let (k, n) = (shapes as f64, measured.metric.len() as f64);
        let dimension = measured.metric.dimension() as f64;
        let cost = method.cost(Size { shapes: k, length: n, dimension, class: class_size(measured) });
        let kept = (8.0 * k * n).min(KEPT_BYTES as f64);
        let multiply_adds = mean_work(measured, k) + cost.multiply_adds + HANDLING * k * n;
        let sums = 4.0 * n * order(n, class_size(measured) * k);
        let memory_bytes = kept + 8.0 * (sums + cost.numbers);
        Self::of(shapes, multiply_adds, memory_bytes)
    }

    pub(crate) fn of(shapes: u64, multiply_adds: f64, memory_bytes: f64) -> Self {
        Self { shapes, multiply_adds, memory_bytes, seconds: multiply_adds / RATE }
    }

    /// Adds the work of a linear model besides the permutations of its columns: a design, its basis, and the sums of squares of each term
    /// for each permutation.
    #[must_use]
    pub fn with_design(self, columns: usize, terms: usize, permutations: usize) -> Self {
        let (shapes, columns) = (self.shapes as f64, columns as f64);
        let multiply_adds = self.multiply_adds + 4.0 * shapes * columns * columns;
        let sums = permutations as f64 * (24.0 + 48.0 * terms as f64);
        let memory_bytes = self.memory_bytes + 8.0 * 4.0 * shapes * columns + sums;
        Self { multiply_adds, memory_bytes, seconds: multiply_adds / RATE, ..self }
    }

    /// Adds the work of vectors of a model for exchanged or redrawn residuals: lists of the statistics, copies of the residuals, and for each
    /// thread the weights of a draw.
    #[must_use]
    pub fn with_resampling(self, work: Resampling) -> Self {
        let [length, functions, statistics, draws] =
            [work.length, work.functions, work.statistics, work.draws].map(|count| count as f64);
        let shapes = self.shapes as f64;
        let multiply_adds = self.multiply_adds + (4.0 + draws) * shapes * (length * functions + 10.0);
        let lists = 2.0 * draws * (statistics + 3.0);
        let copies = 3.0 * shapes * length + 16.0 * (shapes + length) * functions;
        let memory_bytes = self.memory_bytes + 8.0 * (lists + copies);
        Self { multiply_adds, memory_bytes, seconds: multiply_adds / RATE, ..self }
    }

    /// Adds multiply-adds and bytes.
    #[must_use]
    pub fn with_work(self, multiply_adds: f64, bytes: f64) -> Self {
        let multiply_adds = self.multiply_adds + multiply_adds;
        let memory_bytes = self.memory_bytes + bytes;
        Self { multiply_adds, memory_bytes, seconds: multiply_adds / RATE, ..self }
    }

    /// Adds the work of covariances of blocks of so many numbers, pair by pair and for each permutation.
    #[must_use]
    pub fn with_blocks(self, lengths: &[usize], permutations: usize) -> Self {
        let (shapes, draws) = (self.shapes as f64, 1.0 + permutations as f64);
        let (mut work, mut memory, pairs) = (0.0, 0.0, lengths.len() * lengths.len().saturating_sub(1) / 2);
        for (i, &length) in lengths.iter().enumerate() {
            let (n, rank) = (length as f64, shapes.min(length as f64));
            work += shapes * n * rank + EIGENPROBLEM * rank.powi(3);
            memory += 3.0 * shapes * n + 3.0 * rank * rank + 6.0 * shapes * rank;
            for &other in &lengths[..i] {
                let other = shapes.min(other as f64);
                work += draws * (shapes * rank * other + EIGENPROBLEM * rank.min(other).powi(3));
                memory += 6.0 * rank * other;
            }
        }
        let multiply_adds = self.multiply_adds + work;
        let memory_bytes = self.memory_bytes + 8.0 * (memory + draws * (6.0 + 2.0 * pairs as f64));
        Self { multiply_adds, memory_bytes, seconds: multiply_adds / RATE, ..self }
    }

    /// Adds the work of the covariances of every two of `points` points, and of the sums over them for each permutation.
    #[must_use]
    pub fn with_points(self, points: usize, dimension: usize, permutations: usize) -> Self {
        let (shapes, table) = (self.shapes as f64, (points as f64).powi(2));
        let numbers = (points * dimension) as f64;
        let multiply_adds = self.multiply_adds + shapes * numbers * numbers + permutations as f64 * table;
        let memory_bytes = self.memory_bytes + 8.0 * (table + 3.0 * shapes * numbers + permutations as f64);
        Self { multiply_adds, memory_bytes, seconds: multiply_adds / RATE, ..self }
    }

    /// The cost of both.
    #[must_use]
    pub fn and(self, other: Self) -> Self {
        let multiply_adds = self.multiply_adds + other.multiply_adds;
        let memory_bytes = self.memory_bytes + other.memory_bytes;
        Self { multiply_adds, memory_bytes, seconds: multiply_adds / RATE, ..self }
    }

    /// Adds the work of a robust mean beyond a plain one.
    #[must_use]
    pub fn robust(self, measured: Measured<'_>) -> Self {
        let multiply_adds = self.multiply_adds + robust_work(measured, self.shapes as f64);
        let shapes = usize::try_from(self.shapes).unwrap_or(usize::MAX);
        let memory_bytes = self.memory_bytes + robust::bytes(shapes) as f64;
        Self { multiply_adds, memory_bytes, seconds: multiply_adds / RATE, ..self }
    }

    /// Adds further trainings, each on nearly all shapes and two at a time, and the further work of a job.
    pub fn with(self, Trainings { held_out, validation }: Trainings) -> Self {
        let trainings = 1.0 + HELD_OUT * held_out as f64 + validation as f64;
        let multiply_adds = JOB + self.multiply_adds * trainings;
        let memory_bytes = self.memory_bytes * if held_out + validation > 0 { 3.0 } else { 1.0 };
        Self { multiply_adds, memory_bytes, seconds: multiply_adds / RATE, ..self }
    }

    /// Cost of the report card of a dictionary of `space` that was learnt from `shapes` shapes of `subjects` subjects.
    pub fn for_report(
        space: &ShapeSpace,
        measured: Measured<'_>,
        shapes: usize,
        subjects: usize,
        options: &ReportOptions,
    ) -> Self {
        let (length, k) = (measured.metric.len(), shapes as f64);
        let n = length as f64;
        let work = aligning_work(measured, k) + report_work(space, shapes, subjects, options);
        Self::of(shapes as u64, work, report_bytes(length, shapes, options) + 8.0 * k * n)
    }

    /// Cost of learning the factors of the bands of a dictionary from its training shapes. `unknowns`: number of scores and of unknowns
    /// of the pose.
    pub fn for_calibration(measured: Measured<'_>, shapes: usize, subjects: usize, unknowns: usize) -> Self {
        let (length, k) = (measured.metric.len(), shapes as f64);
        let n = length as f64;
        let work = aligning_work(measured, k) + calibration_work(measured.metric, shapes, subjects, unknowns);
        let rank = n.min(k);
        Self::of(shapes as u64, work, 8.0 * (5.0 * k * n + 3.0 * n * rank + k * rank + 8.0 * rank * rank))
    }

    /// Cost of bringing `shapes` shapes on a sphere into groupwise correspondence.
    pub fn for_correspondence(spherical: &Spherical, shapes: usize, options: &GroupwiseOptions) -> Self {
        let (k, rows) = (shapes as f64, spherical.size());
        let refit = REFIT * spherical.nodes() as f64;
        let reading = READING * 3.0 * rows as f64;
        let work =
            k * (groupwise::shape_work(options) + refit + reading) + groupwise::model_work(shapes, options);
        Self::of(shapes as u64, work, groupwise::bytes(shapes, rows, options))
    }

    /// Cost of an elastic correspondence of `shapes` curves of `space` from `starts` starts, with new ones of `size` control points.
    pub fn for_elastic(space: &ElasticSpace, shapes: usize, starts: usize, size: usize) -> Self {
        /// Seconds in which a point of a refitted curve is found.
        const POINT: f64 = 1e-6;
        let (k, points) = (shapes as f64, space.settings().points);
        let refits = k * POINT * 6.0 * (points + size) as f64;
        let matrix = if starts > 1 { 0.5 * k * k * space.seconds() } else { 0.0 };
        let seconds = starts as f64 * space.mean_seconds(shapes) + matrix + refits;
        // Prepared curves as given and laid, paths and averages; shapes as given, aligned, and made.
        let of_shape = 2.0 * space.bytes() as f64 + 8.0 * (10 * points + 12 * size) as f64;
        let distances = if starts > 1 { 8.0 * k * k } else { 0.0 };
        Self::of(shapes as u64, seconds * RATE, k * of_shape + distances)
    }

    /// Cost of the sliding of points along `shapes` curves, divided into `points` segments, with new curves of `size` control points.
    pub fn for_sliding(shapes: usize, (points, criterion): (usize, SlidingCriterion), size: usize) -> Self {
        /// Rounds, and seconds in which a point is found, and a number of a product.
        const ROUNDS: f64 = 60.0;
        const POINT: f64 = 1.5e-6;
        let (k, m) = (shapes as f64, points as f64);
        let systems = match criterion {
            SlidingCriterion::BendingEnergy => (1.0 + k / 3.0) * m.powi(3) + 3.0 * k * m * m,
            SlidingCriterion::Procrustes => 0.0,
        };
        let seconds = ROUNDS * (k * m * POINT + systems / RATE) + k * POINT * 6.0 * (m + size as f64);
        // Curves and their shapes, points, directions, the numbers of the acceleration.
        Self::of(shapes as u64, seconds * RATE, 8.0 * k * (40.0 * m + 40.0 * size as f64) + 40.0 * m * m)
    }

    /// Cost of tests of shapes aligned to one mean.
    pub fn for_tests(measured: Measured<'_>, work: &TestWork) -> Self {
        let (k, n) = (work.shapes as f64, measured.metric.len() as f64);
        let rows = n + work.samples as f64 * measured.metric.dimension() as f64;
        let draws = work.permutations as f64;
        // Signs of deviations take two products more of a pair's coordinates.
        let pairs = work.pair_shapes as f64 * (rows + 2.0 * n.min(k));
        let products = draws * (work.columns as f64 * k * n.min(k) + pairs);
        let smaller = n.min(k);
        let spans = (1.0 + work.pairs as f64) * (smaller * k * n + EIGENPROBLEM * smaller.powi(3));
        let measures = k * MEASURES * measured.metric.size() as f64;
        let multiply_adds = mean_work(measured, k) + measures + products + spans;
        // Shapes as given, prepared, aligned, in coordinates and at points; sums of projectors; the products.
        let sums = 4.0 * n * order(n, class_size(measured) * k);
        let memory = k * (4.0 * n + 3.0 * rows) + sums + 3.0 * smaller * smaller + 256.0 * (k + rows);
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

/// Statistics of vectors that are linear in the shapes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Resampling {
    /// Number of numbers of a vector.
    pub length: usize,
    /// Number of vectors.
    pub functions: usize,
    /// Number of statistics of each draw.
    pub statistics: usize,
    /// Number of draws.
    pub draws: usize,
}

/// Multiply-adds for measuring the sizes of a shape, per control point.
const MEASURES: f64 = 2_000.0;

/// Size of the matrix whose eigenpairs are those of the sum of outer products of `vectors` vectors of `n` numbers: the vectors are kept
/// while they are fewer than half of the numbers ([`OuterProductSum`](crate::accumulate::OuterProductSum)).
fn order(n: f64, vectors: f64) -> f64 {
    if 2.0 * vectors < n { vectors } else { n }
}

fn class_size(measured: Measured<'_>) -> f64 {
    match measured.method {
        Alignment::Projection(class) => class.matrices().len() as f64,
        Alignment::Procrustes(_) => measured.metric.dimension() as f64,
    }
}

/// Multiply-adds for reading `k` shapes and placing them on a known mean.
fn aligning_work(measured: Measured<'_>, k: f64) -> f64 {
    let n = measured.metric.len() as f64;
    let search = match measured.matching.searches() {
        true => mean_work(measured, k) / search_rounds(measured, k),
        false => 0.0,
    };
    PRODUCT * k * class_size(measured) * n * order(n, class_size(measured) * k)
        + 2.0 * READING * k * n
        + search
}

/// Multiply-adds for the mean of `k` shapes and their alignment to it.
fn mean_work(measured: Measured<'_>, k: f64) -> f64 {
    let (n, points, class) =
        (measured.metric.len() as f64, measured.metric.size() as f64, class_size(measured));
    let round = match measured.method {
        Alignment::Projection(class) if class.is_complex() => COMPLEX_ROUND,
        Alignment::Projection(_) => ROUND,
        Alignment::Procrustes(_) => FITTED_ROUND,
    };
    let search = if measured.matching.moves() {
        MOTION * MOVED * MOVING_ROUNDS * k * n
    } else if measured.matching.searches() {
        k * round * search_rounds(measured, k) * class * n * points.log2()
    } else {
        0.0
    };
    let iterations = match measured.method {
        Alignment::Projection(_) => 0.0,
        Alignment::Procrustes(_) => ITERATIONS * ITERATION * k * n,
    };
    let sum = order(n, class * k);
    search + iterations + PRODUCT * k * class * n * sum + EIGENPROBLEM * sum.powi(3)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dictionary::recipe::{Recipe, Setting};
    use crate::transformation::{ClassName, Transformation};
    use shapelex_geometry::representation::Representation;

    fn setting(points: usize, class: ClassName, alignment: crate::alignment::Alignment) -> Setting {
        let representation = Representation::Landmarks { dimension: 3, points };
        let recipe = Recipe::new(representation, Transformation::Named(class), Method::components(10, true));
        Recipe { alignment, ..recipe }.setting().unwrap()
    }

    /// Dense correspondences: 30 shapes of 2048 landmarks in space took 0.1 s and 20 MB, and were predicted to take 232 s and 2.1 GB.
    #[test]
    fn few_shapes_of_many_points_are_cheap() {
        let projection = (ClassName::Affine, crate::alignment::Alignment::Projection);
        let procrustes = (ClassName::Similarity, crate::alignment::Alignment::Procrustes);
        // The bases of affine subspaces are three times the shapes.
        for ((class, alignment), least) in [(projection, 8e7), (procrustes, 4e7)] {
            for (shapes, points, seconds, bytes) in [(30, 2048, 0.3, least), (20, 20_000, 1.0, 5e8)] {
                let setting = setting(points, class, alignment);
                let measured = setting.measured();
                let method = Method::components(10, true);
                let found = Estimate::new(measured, &method, shapes).with(Trainings::default());
                assert!(found.seconds < seconds && found.memory_bytes < bytes, "{points} points: {found:?}");
                let all = stages(measured, &method, shapes as usize, false, Trainings::default());
                let work: f64 = all.iter().map(|stage| stage.multiply_adds).sum();
                assert!(work < seconds * RATE, "{points} points: {all:?}");
            }
        }
    }

    /// The sums are matrices of the smaller of shapes and coordinates: no jump where the one overtakes the other by more than the
    /// change from vectors to a matrix, and never more than with very many shapes.
    #[test]
    fn predictions_grow_with_the_shapes() {
        let setting = setting(200, ClassName::Affine, crate::alignment::Alignment::Projection);
        let method = Method::components(10, true);
        let of = |shapes: u64| Estimate::new(setting.measured(), &method, shapes);
        let counts = [5, 20, 50, 75, 99, 100, 150, 299, 300, 301, 1000, 100_000];
        let all: Vec<Estimate> = counts.into_iter().map(of).collect();
        assert!(all.is_sorted_by(|a, b| a.seconds < b.seconds && a.memory_bytes < b.memory_bytes), "{all:?}");
    }
}
