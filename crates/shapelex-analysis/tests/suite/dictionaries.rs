//! Learning dictionaries: descent, reproducibility, invariance, continuation.

use std::collections::BTreeMap;
use std::sync::Mutex;

use rayon::ThreadPoolBuilder;
use shapelex_analysis::accumulate::{PART, ShapeSource, Shapes, ShapesInMemory};
use shapelex_analysis::algebra::Algebra;
use shapelex_analysis::dictionary::learning::{Learning, Learnt, Schedule, Start};
use shapelex_analysis::dictionary::model::{Certificate, Model};
use shapelex_analysis::pass::{CodeGroup, Group};
use shapelex_analysis::sparse::{Coder, Encode, GroupLasso, Lasso, Pursuit, SparseCode};
use shapelex_analysis::transformation::{ClassName, TransformationClass};
use shapelex_analysis::watch::{Unwatched, Watch};
use shapelex_analysis::{AnalysisError, metric};
use shapelex_numeric::dense::Matrix;

/// Points of a contour with a few random harmonics, `2 × 24` numbers, coordinate-major.
const LENGTH: usize = 48;

/// A structureless number in (−1, 1).
fn noise(i: usize) -> f64 {
    let x = (i as f64 * 12.9898 + 4.1414).sin() * 43758.5453;
    2.0 * (x - x.floor()) - 1.0
}

/// `count` contours of three kinds, whitened and centred (discrete metric).
fn contours(count: usize) -> Vec<f64> {
    let n = LENGTH / 2;
    let mut shapes = Vec::new();
    for k in 0..count {
        let kind = 2 + k % 3;
        let amplitude = 0.3 + 0.1 * noise(7 * k);
        let radius = |i: usize| {
            let t = std::f64::consts::TAU * i as f64 / n as f64;
            (t, 1.0 + amplitude * (kind as f64 * t + noise(k)).cos() + 0.02 * noise(100 * k + i))
        };
        let mut points: Vec<f64> = (0..n).map(|i| radius(i).1 * radius(i).0.cos()).collect();
        points.extend((0..n).map(|i| 0.8 * radius(i).1 * radius(i).0.sin()));
        for coordinate in points.chunks_exact_mut(n) {
            let mean = coordinate.iter().sum::<f64>() / n as f64;
            coordinate.iter_mut().for_each(|value| *value -= mean);
        }
        let size = metric::norm(&points);
        shapes.extend(points.iter().map(|value| value / size));
    }
    shapes
}

fn source(shapes: Vec<f64>) -> ShapesInMemory {
    let weights = vec![1.0; shapes.len() / LENGTH];
    ShapesInMemory::prepared(shapes, weights)
}

fn learning(atoms: usize, coder: Coder, algebra: Algebra, schedule: Schedule) -> Learning {
    Learning { atoms, coder, algebra, schedule, seed: 3, max_epochs: 40, tolerance: 0.0 }
}

fn lasso(lambda: f64) -> Coder {
    Coder::Lasso(Lasso::new(lambda, false))
}

fn algebra_of(name: ClassName) -> Algebra {
    Algebra::of(&TransformationClass::named(name, 2).unwrap()).unwrap()
}

fn normalised(algebra: &Algebra, mut shapes: Vec<f64>) -> Vec<f64> {
    for shape in shapes.chunks_exact_mut(LENGTH) {
        algebra.normalise(shape).unwrap();
    }
    shapes
}

fn learn(learning: &Learning, shapes: &[f64]) -> Learnt {
    learning.learn(&source(shapes.to_vec()), None, &Unwatched).unwrap()
}

fn assert_never_rises(history: &[f64], what: &str) {
    for pair in history.windows(2) {
        // The objective is a difference of sums of squares of unit shapes: rounding is of the order of 1e-15 of them.
        assert!(pair[1] <= pair[0] + 1e-13, "{what}: {} after {}", pair[1], pair[0]);
    }
}

/// Every coder and class there is.
fn settings() -> Vec<(&'static str, Coder, Algebra)> {
    let group = |lambda| Coder::GroupLasso(GroupLasso::new(lambda));
    vec![
        ("lasso", lasso(0.05), Algebra::numbers()),
        ("non-negative lasso", Coder::Lasso(Lasso::new(0.02, true)), Algebra::numbers()),
        ("similarity", group(0.05), algebra_of(ClassName::Similarity)),
        ("non-uniform scaling", group(0.05), algebra_of(ClassName::NonUniformScaling)),
        ("affine", group(0.05), algebra_of(ClassName::Affine)),
    ]
}

#[test]
fn the_objective_never_rises() {
    for schedule in [Schedule::Batch, Schedule::Online] {
        for (what, coder, algebra) in settings() {
            let shapes = normalised(&algebra, contours(300));
            let learning = learning(6, coder, algebra, schedule);
            let learnt = learn(&learning, &shapes);
            assert_eq!(learnt.history.len(), 40, "{what}");
            assert_never_rises(&learnt.history, what);
            let (first, last) = (learnt.history[0], learnt.history[39]);
            assert!(last < 0.97 * first, "{what}: {first} only fell to {last}");
            // With their codes in the final atoms the shapes are described at least as well.
            let model = learning.model(&learnt.atoms);
            let certificate = Certificate::new(&model, &source(shapes), &Unwatched).unwrap();
            assert!(certificate.objective <= last + 1e-12, "{what}: {} above {last}", certificate.objective);
        }
    }
}

#[test]
fn pursuits_learn_too() {
    for (what, algebra) in
        [("numbers", Algebra::numbers()), ("similarity", algebra_of(ClassName::Similarity))]
    {
        let shapes = normalised(&algebra, contours(300));
        let learning = learning(6, Coder::Pursuit(Pursuit { nonzeros: 2 }), algebra, Schedule::Batch);
        let learnt = learn(&learning, &shapes);
        let (first, last) = (learnt.history[0], learnt.history[learnt.history.len() - 1]);
        assert!(last < first, "{what}: {first} to {last}");
        let Model::Sparse { coder, atoms, .. } = learning.model(&learnt.atoms) else { panic!("sparse") };
        let codes = coder.codes(&atoms, &shapes).unwrap();
        assert!(codes.iter().all(|code| code.indices.len() <= 2), "{what}");
    }
}

#[test]
fn atoms_are_normal_forms() {
    for (what, coder, algebra) in settings() {
        let shapes = normalised(&algebra, contours(200));
        let learning = learning(6, coder, algebra.clone(), Schedule::Online);
        let learnt = learn(&learning, &shapes);
        for atom in learnt.atoms.as_slice().chunks_exact(LENGTH) {
            let block = Matrix::from_vec(LENGTH, algebra.parameters(), algebra.block(atom));
            let error = (block.tr_mul(&block) - Matrix::identity(block.ncols(), block.ncols())).norm();
            assert!(error < 1e-12, "{what}: {error:e}");
        }
    }
}

#[test]
fn results_have_the_same_bits_on_any_number_of_threads_and_for_any_way_shapes_are_cut() {
    for (what, coder, algebra) in settings() {
        let shapes = normalised(&algebra, contours(700));
        let mut learning = learning(6, coder, algebra, Schedule::Online);
        learning.max_epochs = 3;
        let on = |threads: usize| {
            let pool = ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| learn(&learning, &shapes))
        };
        assert_eq!(on(1), on(3), "{what}");
    }
}

#[test]
fn the_seed_decides() {
    let shapes = contours(200);
    let mut learning = learning(6, lasso(0.05), Algebra::numbers(), Schedule::Online);
    learning.max_epochs = 2;
    let one = learn(&learning, &shapes);
    assert_eq!(one, learn(&learning, &shapes));
    learning.seed = 4;
    assert_ne!(one.atoms, learn(&learning, &shapes).atoms);
}

/// Every shape moved by a member of the class of its own.
fn moved(algebra: &Algebra, shapes: &[f64]) -> Vec<f64> {
    let mut moved = shapes.to_vec();
    for (k, shape) in moved.chunks_exact_mut(LENGTH).enumerate() {
        let coefficients: Vec<f64> = (0..algebra.parameters()).map(|i| noise(31 * k + i)).collect();
        let mut member = algebra.member(&coefficients);
        // Away from singular members, of which no shape comes back.
        for i in 0..2 {
            member[(i, i)] += 2.0 * member[(i, i)].signum();
        }
        algebra.act(shape, &algebra.project(&member));
    }
    moved
}

#[test]
fn invariant_codes_do_not_see_how_shapes_are_moved() {
    let classes =
        [ClassName::UniformScaling, ClassName::Similarity, ClassName::NonUniformScaling, ClassName::Affine];
    for name in classes {
        let algebra = algebra_of(name);
        let shapes = contours(200);
        // To a gap that leaves rounding alone: the default one of 1e-10 is what two codes of one shape may differ by.
        let exact = GroupLasso { tolerance: 1e-14, ..GroupLasso::new(0.05) };
        for coder in [Coder::GroupLasso(exact), Coder::Pursuit(Pursuit { nonzeros: 2 })] {
            let mut learning = learning(5, coder, algebra.clone(), Schedule::Online);
            learning.max_epochs = 10;
            let (one, other) =
                (normalised(&algebra, shapes.clone()), normalised(&algebra, moved(&algebra, &shapes)));
            let (left, right) = (learn(&learning, &one), learn(&learning, &other));
            for (a, b) in left.history.iter().zip(&right.history) {
                assert!((a - b).abs() < 1e-9 * a, "{name:?}: {a} and {b}");
            }
            let codes = |learnt: &Learnt, shapes: &[f64]| {
                coder.codes(&learning.atoms_of(&learnt.atoms), shapes).unwrap()
            };
            let pairs = codes(&left, &one).into_iter().zip(codes(&right, &other));
            for (k, (a, b)) in pairs.enumerate() {
                assert_eq!(a.indices, b.indices, "{name:?}, shape {k}");
                let difference = (a.relative_error - b.relative_error).abs();
                assert!(difference < 1e-9, "{name:?}, shape {k}: {difference:e}");
            }
        }
    }
}

#[test]
fn unused_atoms_are_replaced() {
    // Many shapes are the same: atoms that start as copies are not used twice.
    let mut shapes: Vec<f64> = contours(1).repeat(60);
    shapes.extend(contours(9));
    let learning = learning(5, lasso(0.1), Algebra::numbers(), Schedule::Batch);
    let learnt = learn(&learning, &shapes);
    assert!(learnt.reseeded > 0);
    assert_never_rises(&learnt.history, "with replaced atoms");
    let certificate = Certificate::new(&learning.model(&learnt.atoms), &source(shapes), &Unwatched).unwrap();
    assert!(certificate.usage.iter().all(|usage| *usage > 0.0), "{:?}", certificate.usage);
}

#[test]
fn learning_goes_on_from_statistics_and_atoms() {
    let shapes = contours(600);
    let (old, new) = shapes.split_at(400 * LENGTH);
    let learning = learning(6, lasso(0.05), Algebra::numbers(), Schedule::Online);
    let first = learn(&learning, old);
    let start = || Start { atoms: first.atoms.clone(), statistics: first.statistics.clone() };
    let second = learning.learn(&source(new.to_vec()), Some(start()), &Unwatched).unwrap();
    assert_eq!(second.statistics.weight(), 600.0);
    assert_never_rises(&second.history, "going on");
    let quality = |atoms: &Matrix| {
        Certificate::new(&learning.model(atoms), &source(shapes.clone()), &Unwatched).unwrap().objective
    };
    let (before, after, anew) =
        (quality(&first.atoms), quality(&second.atoms), quality(&learn(&learning, &shapes).atoms));
    assert!(after <= before * 1.001, "the whole set: {before} before, {after} after");
    assert!(after <= anew * 1.05, "{after}, learnt anew {anew}");
}

#[test]
fn statistics_come_back_from_bytes() {
    let learning = learning(4, lasso(0.05), Algebra::numbers(), Schedule::Batch);
    let learnt = learn(&learning, &contours(50));
    let bytes = learnt.statistics.to_bytes();
    let mut restored = learnt.statistics.emptied();
    restored.restore(&bytes).unwrap();
    assert_eq!(restored, learnt.statistics);
    assert_eq!(restored.restore(&bytes[..bytes.len() - 3]), Err(AnalysisError::NotAnAccumulator));
}

#[test]
fn too_few_shapes_and_a_stop_are_errors() {
    let learning = learning(6, lasso(0.05), Algebra::numbers(), Schedule::Online);
    let few = learning.learn(&source(contours(5)), None, &Unwatched);
    assert_eq!(few, Err(AnalysisError::TooFewShapes { found: 5, needed: 6 }));
    struct Stopped;
    impl Watch for Stopped {
        fn stop(&self) -> bool {
            true
        }
    }
    assert_eq!(learning.learn(&source(contours(50)), None, &Stopped), Err(AnalysisError::Interrupted));
}

/// Shapes that are coded part by part, as other processes do: each part anew from its description and its codes of the epoch before.
struct Elsewhere<'a> {
    shapes: &'a ShapesInMemory,
    learning: &'a Learning,
    known: Mutex<BTreeMap<usize, Vec<SparseCode>>>,
}

impl Elsewhere<'_> {
    fn code(&self, group: Group<'_>) -> Result<Vec<u8>, AnalysisError> {
        let (all, mut known) = (self.shapes.all(), self.known.lock().unwrap());
        let mut sums = self.learning.coding(LENGTH);
        let mut first = group.first;
        while first < group.end {
            let end = group.end.min((first / PART + 1) * PART);
            let whitened = all.whitened[first * LENGTH..end * LENGTH].to_vec();
            let part = ShapesInMemory::prepared(whitened, all.weights[first..end].to_vec());
            let before = known.remove(&first).unwrap_or_default();
            assert_eq!(before.len(), if group.epoch > 0 { end - first } else { 0 });
            let (coding, codes) = self.learning.coded(group.atoms, &part, before, &Unwatched)?;
            sums.append(&coding.to_bytes())?;
            known.insert(first, codes);
            first = end;
        }
        Ok(sums.to_bytes())
    }
}

impl ShapeSource for Elsewhere<'_> {
    fn count(&self) -> usize {
        self.shapes.count()
    }

    fn for_each_batch(
        &self,
        visit: &mut dyn FnMut(Shapes<'_>) -> Result<(), AnalysisError>,
    ) -> Result<(), AnalysisError> {
        self.shapes.for_each_batch(visit)
    }

    fn coders(&self) -> Option<CodeGroup<'_>> {
        Some(Box::new(|group: Group<'_>| self.code(group)))
    }
}

#[test]
fn shapes_that_are_coded_elsewhere_give_the_same_bits() {
    let shapes = source(contours(2 * PART + 300));
    for (coder, schedule) in [
        (lasso(0.05), Schedule::Online),
        (lasso(0.05), Schedule::Batch),
        (Coder::Pursuit(Pursuit { nonzeros: 2 }), Schedule::Online),
    ] {
        let learning = Learning { max_epochs: 3, ..learning(6, coder, Algebra::numbers(), schedule) };
        let elsewhere = Elsewhere { shapes: &shapes, learning: &learning, known: Mutex::default() };
        let found = learning.learn(&elsewhere, None, &Unwatched).unwrap();
        assert_eq!(found.history.len(), 3);
        assert_eq!(found, learning.learn(&shapes, None, &Unwatched).unwrap(), "{coder:?}, {schedule:?}");
    }
}
