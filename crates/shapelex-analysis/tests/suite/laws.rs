//! The laws of the analysis on random input (`analysis.md` calls them invariants): what must hold for every
//! set of shapes, whatever the numbers.

use proptest::prelude::*;
use shapelex_analysis::AnalysisError;
use shapelex_analysis::accumulate::{
    Accumulator, BLOCK, ScatterSum, ShapeSource, Shapes, ShapesInMemory, accumulate,
};
use shapelex_analysis::alignment::{AlignedShape, Alignment, MeanShape, Method, Projector, align_all};
use shapelex_analysis::correspondence::{Correspondence, Direction, Mirror};
use shapelex_analysis::frame::Frame;
use shapelex_analysis::matching::{Matching, Placement};
use shapelex_analysis::mean::{MeanSpace, ProjectorSum};
use shapelex_analysis::metric::{Metric, dot, norm};
use shapelex_analysis::pca::{FunctionalPca, reconstruction_error};
use shapelex_analysis::transformation::{ClassName, Transformation, TransformationClass};
use shapelex_geometry::generator::GeneratorKind;
use shapelex_geometry::representation::{Representation, ShapeSpace};
use shapelex_numeric::dense::Matrix;

/// Classes that are groups (with the zero maps): every member of a shape's subspace spans the same subspace.
const GROUPS: [ClassName; 8] = [
    ClassName::UniformScaling,
    ClassName::UniformScalingTranslation,
    ClassName::NonUniformScalingTranslation,
    ClassName::ScaledRotation,
    ClassName::Similarity,
    ClassName::Linear,
    ClassName::Affine,
    ClassName::HorizontalShearTranslation,
];

const N: usize = 10;

fn prepared(representation: &Representation) -> ShapeSpace {
    ShapeSpace::new(representation).unwrap()
}

fn representation(generator: GeneratorKind, dimension: usize) -> Representation {
    Representation::ClosedCurve { dimension, control_points: N, generator }
}

fn metric(generator: GeneratorKind, dimension: usize) -> Metric {
    Metric::of(&ShapeSpace::new(&representation(generator, dimension)).unwrap())
}

fn generators() -> impl Strategy<Value = GeneratorKind> {
    prop_oneof![
        Just(GeneratorKind::Trigonometric {}),
        Just(GeneratorKind::Cubic {}),
        (1u8..=5).prop_map(|degree| GeneratorKind::Bspline { degree }),
    ]
}

/// Deterministic pseudo-random numbers in [−1, 1] from a seed that proptest shrinks.
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 11) as f64 / (1u64 << 53) as f64) * 2.0 - 1.0
    }
}

/// A set of shapes that are alike: a bean with noise, each in its own pose.
fn beans(seed: u64, count: usize, dimension: usize, noise: f64) -> Vec<Vec<f64>> {
    let mut random = Noise(seed);
    (0..count)
        .map(|_| {
            let mut shape = vec![0.0; dimension * N];
            for k in 0..N {
                let t = std::f64::consts::TAU * k as f64 / N as f64;
                let base = [
                    2.0 * t.cos() + 0.4 * (2.0 * t).cos(),
                    t.sin() + 0.3 * (3.0 * t).sin(),
                    0.8 * (2.0 * t).sin(),
                ];
                for c in 0..dimension {
                    shape[c * N + k] = base[c] + noise * random.next();
                }
            }
            shape
        })
        .collect()
}

/// A random member of the class applied to the shape: well away from singular.
fn moved(shape: &[f64], class: &TransformationClass, random: &mut Noise) -> Vec<f64> {
    let d = class.dimension();
    let matrix = loop {
        let mut matrix = Matrix::zeros(d, d);
        for b in class.matrices() {
            matrix += b * (2.0 * random.next());
        }
        let singular = matrix.singular_values();
        if singular.min() > 0.3 && singular.max() < 4.0 {
            break matrix;
        }
    };
    let mut out = vec![0.0; shape.len()];
    for c in 0..d {
        let shift = if class.translates() { 3.0 * random.next() } else { 0.0 };
        for k in 0..N {
            out[c * N + k] = shift + (0..d).map(|e| matrix[(c, e)] * shape[e * N + k]).sum::<f64>();
        }
    }
    out
}

fn method(name: ClassName, dimension: usize) -> Method {
    Method::new(&Transformation::Named(name), Alignment::Projection, dimension).unwrap()
}

fn landmarks(dimension: usize) -> Matching {
    let representation = representation(GeneratorKind::Cubic {}, dimension);
    Matching::new(&prepared(&representation), Correspondence::Landmarks, Direction::Given, Mirror::Forbid)
}

fn run(
    metric: &Metric,
    name: ClassName,
    frame: Frame,
    shapes: &[Vec<f64>],
) -> (MeanShape, Vec<AlignedShape>) {
    let d = metric.dimension();
    let weights = vec![1.0; shapes.len()];
    align_all(metric, &method(name, d), frame, &landmarks(d), shapes.concat(), weights).unwrap()
}

fn space_of<'a>(
    metric: &Metric,
    class: &'a TransformationClass,
    shapes: &[Vec<f64>],
    weights: Vec<f64>,
) -> MeanSpace<'a> {
    let source = ShapesInMemory::new(metric, class.translates(), shapes.concat(), weights).unwrap();
    MeanSpace::new(ProjectorSum::of(&source, class, metric.len()).unwrap(), 8).unwrap()
}

/// `P` as a matrix: comparable between bases.
fn projector(space: &MeanSpace<'_>) -> Matrix {
    let elements = space.elements();
    &elements * elements.transpose()
}

fn distance(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| (x - y).powi(2)).sum::<f64>().sqrt()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn projectors_are_idempotent_and_self_adjoint(seed in any::<u64>(), generator in generators(), class in 0..GROUPS.len()) {
        let metric = metric(generator, 2);
        let method = method(GROUPS[class], 2);
        let shapes = beans(seed, 3, 2, 0.3);
        let (own, r, s) = (&shapes[0], &shapes[1], &shapes[2]);
        let apply = |x: &[f64]| Projector::new(&metric, &method, x.to_vec()).project(own.clone()).unwrap().control_points;
        let once = apply(r);
        prop_assert!(distance(&apply(&once), &once) < 1e-11);
        prop_assert!(distance(&apply(own), own) < 1e-11);
        if !method.translates() {
            let left = metric.inner(&apply(r), s);
            let right = metric.inner(r, &apply(s));
            prop_assert!((left - right).abs() < 1e-11, "{left} {right}");
        }
    }

    #[test]
    fn the_transformation_makes_the_projection(seed in any::<u64>(), generator in generators(), class in 0..GROUPS.len()) {
        let metric = metric(generator, 2);
        let method = method(GROUPS[class], 2);
        let shapes = beans(seed, 2, 2, 0.3);
        let found = Projector::new(&metric, &method, shapes[0].clone()).project(shapes[1].clone()).unwrap();
        for k in 0..N {
            for c in 0..2 {
                let value = found.offset[c] + (0..2).map(|e| found.matrix[(c, e)] * shapes[1][e * N + k]).sum::<f64>();
                prop_assert!((value - found.control_points[c * N + k]).abs() < 1e-10);
            }
        }
        let difference: Vec<f64> = shapes[0].iter().zip(&found.control_points).map(|(a, b)| a - b).collect();
        prop_assert!((metric.inner(&difference, &difference) - found.squared_distance).abs() < 1e-10);
    }

    #[test]
    fn means_do_not_change_when_every_shape_is_moved_by_its_class(
        seed in any::<u64>(), generator in generators(), class in 0..GROUPS.len()
    ) {
        let name = GROUPS[class];
        let metric = metric(generator, 2);
        let class = TransformationClass::named(name, 2).unwrap();
        let shapes = beans(seed, 6, 2, 0.2);
        let mut random = Noise(seed ^ 77);
        let others: Vec<Vec<f64>> = shapes.iter().map(|shape| moved(shape, &class, &mut random)).collect();
        let (one, other) = (
            space_of(&metric, &class, &shapes, vec![1.0; 6]),
            space_of(&metric, &class, &others, vec![1.0; 6]),
        );
        prop_assert!((projector(&one) - projector(&other)).norm() < 1e-9);
        for (a, b) in one.eigenvalues.iter().zip(&other.eigenvalues) {
            prop_assert!((a - b).abs() < 1e-9, "{a} {b}");
        }
        let (mean, aligned) = run(&metric, name, Frame::Canonical, &shapes);
        let (mean2, aligned2) = run(&metric, name, Frame::Canonical, &others);
        prop_assert!(distance(&mean.whitened, &mean2.whitened) < 1e-9, "{name:?}");
        for (a, b) in aligned.iter().zip(&aligned2) {
            prop_assert!(distance(&a.whitened, &b.whitened) < 1e-9);
        }
    }

    #[test]
    fn structure_changes_nothing(seed in any::<u64>(), generator in generators(), dimension in 2usize..=3) {
        let metric = metric(generator, dimension);
        for name in [ClassName::Linear, ClassName::Affine, ClassName::NonUniformScaling, ClassName::NonUniformScalingTranslation] {
            let structured = TransformationClass::named(name, dimension).unwrap();
            let plain = structured.unstructured();
            let shapes = beans(seed, 5, dimension, 0.2);
            let one = space_of(&metric, &structured, &shapes, vec![1.0; 5]);
            let other = space_of(&metric, &plain, &shapes, vec![1.0; 5]);
            prop_assert!((one.eigenvalues[0] - other.eigenvalues[0]).abs() < 1e-10);
            // non-uniform scaling keeps one function per axis, the plain route the d largest of all
            if matches!(name, ClassName::Linear | ClassName::Affine) {
                prop_assert!((projector(&one) - projector(&other)).norm() < 1e-8);
            }
        }
    }

    #[test]
    fn order_and_split_weights_do_not_matter(seed in any::<u64>(), class in 0..GROUPS.len()) {
        let metric = metric(GeneratorKind::Trigonometric {}, 2);
        let class = TransformationClass::named(GROUPS[class], 2).unwrap();
        let shapes = beans(seed, 7, 2, 0.2);
        let one = space_of(&metric, &class, &shapes, vec![1.0, 2.0, 1.0, 1.0, 1.0, 1.0, 1.0]);
        let mut split = shapes.clone();
        split.reverse();
        split.insert(3, shapes[1].clone());
        let other = space_of(&metric, &class, &split, vec![1.0; 8]);
        prop_assert!((projector(&one) - projector(&other)).norm() < 1e-9);
    }

    #[test]
    fn a_shape_of_the_mean_space_is_aligned_to_itself(seed in any::<u64>(), generator in generators(), class in 0..GROUPS.len()) {
        let metric = metric(generator, 2);
        let shapes = beans(seed, 5, 2, 0.2);
        let (mean, _) = run(&metric, GROUPS[class], Frame::Training, &shapes);
        let method = method(GROUPS[class], 2);
        let found = Projector::new(&metric, &method, mean.control_points.clone()).project(mean.control_points.clone()).unwrap();
        prop_assert!(distance(&found.control_points, &mean.control_points) < 1e-10);
        prop_assert!((found.correlation - 1.0).abs() < 1e-12);
    }

    #[test]
    fn components_are_orthonormal_and_reconstruct(seed in any::<u64>(), generator in generators(), centred in any::<bool>()) {
        let metric = metric(generator, 2);
        let (mean, aligned) = run(&metric, ClassName::Similarity, Frame::Training, &beans(seed, 9, 2, 0.4));
        let whitened: Vec<f64> = aligned.iter().flat_map(|shape| shape.whitened.clone()).collect();
        let source = ShapesInMemory::prepared(whitened, vec![1.0; 9]);
        let pca = FunctionalPca::new(&source, &metric, &mean.whitened, centred, 50).unwrap();
        let count = pca.eigenvalues.len();
        prop_assert_eq!(count, if centred { 8 } else { 9 });
        let gram = pca.eigenshapes.transpose() * &pca.eigenshapes;
        prop_assert!((gram - Matrix::identity(count, count)).norm() < 1e-12);
        prop_assert!((pca.explained.iter().sum::<f64>() - 1.0).abs() < 1e-10);
        for shape in &aligned {
            let error = reconstruction_error(&shape.whitened, &pca.reconstruct(&pca.scores(&shape.whitened)));
            prop_assert!(error < 1e-20, "{error:e}");
        }
        // λ_i is the sum of squared scores
        let scores = pca.all_scores(&source).unwrap();
        for i in 0..count {
            let sum: f64 = scores.iter().map(|s| s[i] * s[i]).sum();
            prop_assert!((sum - pca.eigenvalues[i]).abs() < 1e-11 * pca.eigenvalues[0]);
        }
    }

    #[test]
    fn affine_on_control_points_is_affine_on_the_curve(seed in any::<u64>(), generator in generators()) {
        use shapelex_geometry::curve::Curve;
        let space = ShapeSpace::new(&representation(generator, 2)).unwrap();
        let class = TransformationClass::named(ClassName::Affine, 2).unwrap();
        let shape = &beans(seed, 1, 2, 0.3)[0];
        let mut random = Noise(seed);
        let image = moved(shape, &class, &mut random);
        let method = method(ClassName::Affine, 2);
        let metric = Metric::of(&space);
        let found = Projector::new(&metric, &method, image.clone()).project(shape.clone()).unwrap();
        prop_assert!(found.squared_distance < 1e-18);
        let curve = |points: &[f64]| Curve::of(&space, &Matrix::from_column_slice(N, 2, points)).unwrap();
        let (one, other) = (curve(shape), curve(&image));
        for i in 0..40 {
            let (p, q) = (one.evaluate(i as f64 / 40.0, 0), other.evaluate(i as f64 / 40.0, 0));
            for c in 0..2 {
                let value = found.offset[c] + found.matrix[(c, 0)] * p[0] + found.matrix[(c, 1)] * p[1];
                prop_assert!((value - q[c]).abs() < 1e-9);
            }
        }
    }
}

/// The reference: `Σ z zᴴ / zᴴz` of centred complex landmarks, its leading eigenvector by power iteration.
#[test]
fn the_discrete_similarity_mean_is_kents() {
    let representation = Representation::Landmarks { dimension: 2, points: N };
    let metric = Metric::of(&ShapeSpace::new(&representation).unwrap());
    let shapes = beans(11, 8, 2, 0.5);
    type C = nalgebra::Complex<f64>;
    let z: Vec<Vec<C>> = shapes
        .iter()
        .map(|s| {
            let mut z: Vec<C> = (0..N).map(|k| C::new(s[k], s[N + k])).collect();
            let mean = z.iter().sum::<C>() / N as f64;
            z.iter_mut().for_each(|v| *v -= mean);
            let size = z.iter().map(|v| v.norm_sqr()).sum::<f64>().sqrt();
            z.iter().map(|v| v / size).collect()
        })
        .collect();
    let mut kent = z[0].clone();
    for _ in 0..2000 {
        let mut next = [C::new(0.0, 0.0); N];
        for z in &z {
            let product: C = z.iter().zip(&kent).map(|(a, b)| a.conj() * b).sum();
            next.iter_mut().zip(z).for_each(|(sum, a)| *sum += a * product);
        }
        let size = next.iter().map(|v| v.norm_sqr()).sum::<f64>().sqrt();
        kent = next.iter().map(|v| v / size).collect();
    }
    for (alignment, frame) in
        [(Alignment::Projection, Frame::Training), (Alignment::Procrustes, Frame::Training)]
    {
        let method = Method::new(&Transformation::Named(ClassName::Similarity), alignment, 2).unwrap();
        let matching = Matching::new(
            &prepared(&representation),
            Correspondence::Landmarks,
            Direction::Given,
            Mirror::Forbid,
        );
        let (mean, _) = align_all(&metric, &method, frame, &matching, shapes.concat(), vec![1.0; 8]).unwrap();
        let found: Vec<C> = (0..N).map(|k| C::new(mean.whitened[k], mean.whitened[N + k])).collect();
        let cosine = found.iter().zip(&kent).map(|(a, b)| a.conj() * b).sum::<C>().norm();
        // Procrustes iterates to 1e-10, so its cosine is off by 1e-20
        assert!((cosine - 1.0).abs() < 1e-14, "{alignment:?}: {cosine}");
    }
}

/// Shapes handed out in batches of any number of blocks.
struct Batches<'a>(&'a ShapesInMemory, usize);

impl ShapeSource for Batches<'_> {
    fn count(&self) -> usize {
        self.0.count()
    }

    fn for_each_batch(
        &self,
        visit: &mut dyn FnMut(Shapes<'_>) -> Result<(), AnalysisError>,
    ) -> Result<(), AnalysisError> {
        let all = self.0.all();
        let length = all.whitened.len() / all.weights.len();
        let step = self.1 * BLOCK;
        for first in (0..all.weights.len()).step_by(step) {
            let last = (first + step).min(all.weights.len());
            visit(Shapes {
                first,
                whitened: &all.whitened[first * length..last * length],
                weights: &all.weights[first..last],
            })?;
        }
        Ok(())
    }
}

#[test]
fn streams_and_threads_give_the_same_bits() {
    let metric = metric(GeneratorKind::Trigonometric {}, 2);
    let shapes = beans(5, 5 * BLOCK + 17, 2, 0.3);
    let weights: Vec<f64> = (0..shapes.len()).map(|k| 1.0 + (k % 3) as f64).collect();
    for name in [ClassName::Similarity, ClassName::Affine, ClassName::NonUniformScaling] {
        let class = TransformationClass::named(name, 2).unwrap();
        let source =
            ShapesInMemory::new(&metric, class.translates(), shapes.concat(), weights.clone()).unwrap();
        let sum = |threads: usize, batch: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                ProjectorSum::of(&Batches(&source, batch), &class, metric.len()).unwrap().to_bytes()
            })
        };
        let all = sum(1, 100);
        for (threads, batch) in [(1, 1), (2, 2), (3, 100), (7, 3)] {
            assert!(sum(threads, batch) == all, "{name:?} with {threads} threads, {batch} blocks a batch");
        }
    }
}

#[test]
fn sums_come_back_from_bytes_and_merge() {
    let metric = metric(GeneratorKind::Cubic {}, 2);
    let shapes = beans(6, 40, 2, 0.3);
    let class = TransformationClass::named(ClassName::Affine, 2).unwrap();
    let source = ShapesInMemory::new(&metric, true, shapes.concat(), vec![1.0; 40]).unwrap();
    let all = source.all();
    let length = metric.len();
    let part = |from: usize, to: usize| Shapes {
        first: from,
        whitened: &all.whitened[from * length..to * length],
        weights: &all.weights[from..to],
    };
    let mut first = ProjectorSum::new(&class, length);
    first.update(part(0, 13)).unwrap();
    let mut restored = ProjectorSum::new(&class, length);
    restored.restore(&first.to_bytes()).unwrap();
    let mut second = ProjectorSum::new(&class, length);
    second.update(part(13, 40)).unwrap();
    restored.merge(second);
    let split = MeanSpace::new(restored, 4).unwrap();
    let whole = MeanSpace::new(ProjectorSum::of(&source, &class, length).unwrap(), 4).unwrap();
    assert!((projector(&split) - projector(&whole)).norm() < 1e-11);
    assert_eq!(split.shapes, 40);

    let bytes = first.to_bytes();
    for end in [0, 5, 8, bytes.len() - 1] {
        assert!(ProjectorSum::new(&class, length).restore(&bytes[..end]).is_err(), "{end} bytes");
    }
    let mut huge = bytes.clone();
    huge[..8].copy_from_slice(&u64::MAX.to_le_bytes());
    assert!(ProjectorSum::new(&class, length).restore(&huge).is_err());
}

#[test]
fn primal_and_dual_route_agree() {
    let metric = metric(GeneratorKind::Bspline { degree: 3 }, 2);
    let (mean, aligned) = run(&metric, ClassName::Similarity, Frame::Training, &beans(8, 9, 2, 0.4));
    let whitened: Vec<f64> = aligned.iter().flat_map(|shape| shape.whitened.clone()).collect();
    let few = ShapesInMemory::prepared(whitened.clone(), vec![1.0; 9]);
    // 36 copies are more vectors than coordinates: the same scatter, four times, by the other route
    let copies = ShapesInMemory::prepared(whitened.repeat(4), vec![0.25; 36]);
    let dual = FunctionalPca::new(&few, &metric, &mean.whitened, false, 5).unwrap();
    let primal = FunctionalPca::new(&copies, &metric, &mean.whitened, false, 5).unwrap();
    for i in 0..5 {
        assert!((dual.eigenvalues[i] - primal.eigenvalues[i]).abs() < 1e-12 * dual.eigenvalues[0]);
        let cosine = dual.eigenshapes.column(i).dot(&primal.eigenshapes.column(i));
        assert!((cosine - 1.0).abs() < 1e-8, "component {i}: {cosine}");
    }
    let total: Vec<f64> = (0..2)
        .map(|i| {
            let source = if i == 0 { &few } else { &copies };
            let sum = accumulate(source, || ScatterSum::new(metric.len())).unwrap();
            norm(&sum.mean())
        })
        .collect();
    assert!((total[0] - total[1]).abs() < 1e-13);
}

#[test]
fn a_plain_top_eigenvector_would_collapse() {
    // Why the mean is a space: for `affine` the top eigenvector of Σ P_k is a straight segment.
    let metric = metric(GeneratorKind::Trigonometric {}, 2);
    let shapes = beans(2, 6, 2, 0.3);
    let (mean, _) = run(&metric, ClassName::Affine, Frame::Canonical, &shapes);
    let x = Matrix::from_column_slice(N, 2, &mean.whitened).singular_values();
    assert!(x.min() / x.max() > 0.5, "the mean is a shape: {x}");
}

#[test]
fn cyclic_means_do_not_depend_on_starts_order_or_threads() {
    let representation =
        Representation::ClosedCurve { dimension: 2, control_points: N, generator: GeneratorKind::Cubic {} };
    let space = ShapeSpace::new(&representation).unwrap();
    let metric = Metric::of(&space);
    let shapes = beans(21, 30, 2, 0.15);
    let matching =
        Matching::new(&prepared(&representation), Correspondence::Cyclic, Direction::Given, Mirror::Forbid);
    let class = method(ClassName::Similarity, 2);
    let weights = vec![1.0; shapes.len()];
    let (mean, aligned) =
        align_all(&metric, &class, Frame::Canonical, &matching, shapes.concat(), weights.clone()).unwrap();
    let mut reversed = shapes.clone();
    reversed.reverse();
    let (other, _) =
        align_all(&metric, &class, Frame::Canonical, &matching, reversed.concat(), weights).unwrap();
    assert!(distance(&mean.whitened, &other.whitened) < 1e-9);
    assert!(mean.converged);
    // the shift and the transformation that are answered make the aligned shape
    for (shape, aligned) in shapes.iter().zip(&aligned) {
        let placed = matching.place(shape, aligned.placement);
        let mut control_points = aligned.whitened.clone();
        metric.unwhiten(&mut control_points);
        for k in 0..N {
            for c in 0..2 {
                let value = aligned.offset[c]
                    + (0..2).map(|e| aligned.matrix[(c, e)] * placed[e * N + k]).sum::<f64>();
                assert!((value - control_points[c * N + k]).abs() < 1e-10);
            }
        }
    }
}

#[test]
fn the_search_finds_the_best_of_all_shifts() {
    let representation =
        Representation::ClosedCurve { dimension: 2, control_points: N, generator: GeneratorKind::Cubic {} };
    let metric = Metric::of(&ShapeSpace::new(&representation).unwrap());
    let shapes = beans(4, 2, 2, 0.6);
    let matching =
        Matching::new(&prepared(&representation), Correspondence::Cyclic, Direction::Given, Mirror::Forbid);
    for name in
        [ClassName::Similarity, ClassName::Affine, ClassName::NonUniformScaling, ClassName::UniformScaling]
    {
        let class = TransformationClass::named(name, 2).unwrap();
        let mut x = shapes[0].clone();
        let mut y = shapes[1].clone();
        metric.whiten(&mut x);
        metric.whiten(&mut y);
        let target = MeanSpace::from_shape(&class, &x).unwrap();
        let found = matching
            .best(
                &y,
                &shapelex_analysis::matching::Target::subspace(&target, &matching),
                Placement::default(),
            )
            .unwrap();
        let score = |shift: u32| {
            let placed = matching.place(&y, Placement { shift, ..Placement::default() }).into_owned();
            let other = MeanSpace::from_shape(&class, &placed).unwrap();
            (projector(&target) * projector(&other)).trace()
        };
        let best = (0..N as u32).map(score).fold(f64::MIN, f64::max);
        assert!((score(found.shift) - best).abs() < 1e-11, "{name:?}");
    }
}

#[test]
fn mirror_images_are_matched_only_when_allowed() {
    let representation =
        Representation::ClosedCurve { dimension: 2, control_points: N, generator: GeneratorKind::Cubic {} };
    let metric = Metric::of(&ShapeSpace::new(&representation).unwrap());
    let mut shapes = beans(31, 12, 2, 0.05);
    // an asymmetric outline, every other one mirrored and (as a contour is traced) reversed
    for (i, shape) in shapes.iter_mut().enumerate() {
        let t = |k: usize| std::f64::consts::TAU * k as f64 / N as f64;
        (0..N).for_each(|k| shape[N + k] += 0.5 * (2.0 * t(k) + 1.0).sin());
        if i % 2 == 1 {
            let original = shape.clone();
            for k in 0..N {
                let from = (N - k) % N;
                shape[k] = -original[from];
                shape[N + k] = original[N + from];
            }
        }
    }
    for alignment in [Alignment::Projection, Alignment::Procrustes] {
        let class = Method::new(&Transformation::Named(ClassName::Similarity), alignment, 2).unwrap();
        let worst = |mirror: Mirror| {
            let matching =
                Matching::new(&prepared(&representation), Correspondence::Cyclic, Direction::Given, mirror);
            let (_, aligned) =
                align_all(&metric, &class, Frame::Training, &matching, shapes.concat(), vec![1.0; 12])
                    .unwrap();
            let reflected = aligned.iter().filter(|shape| shape.reflected()).count();
            (aligned.iter().map(|shape| shape.correlation).fold(1.0, f64::min), reflected)
        };
        let (allowed, reflected) = worst(Mirror::Allow);
        assert_eq!(reflected, 6, "{alignment:?}");
        assert!(allowed > 0.99, "{alignment:?}: {allowed}");
        let (forbidden, none) = worst(Mirror::Forbid);
        assert_eq!(none, 0);
        assert!(forbidden < allowed - 0.01, "{alignment:?}: {forbidden} {allowed}");
    }
}

#[test]
fn procrustes_in_space_recovers_rotations() {
    let representation = Representation::Landmarks { dimension: 3, points: N };
    let metric = Metric::of(&ShapeSpace::new(&representation).unwrap());
    let matching = Matching::new(
        &prepared(&representation),
        Correspondence::Landmarks,
        Direction::Given,
        Mirror::Forbid,
    );
    let base = beans(1, 1, 3, 0.3).remove(0);
    let mut random = Noise(3);
    let shapes: Vec<Vec<f64>> = (0..7)
        .map(|_| {
            let raw = Matrix::from_fn(3, 3, |_, _| random.next());
            let mut rotation = raw.qr().q();
            if rotation.determinant() < 0.0 {
                rotation.column_mut(0).neg_mut();
            }
            let (scale, shift) = (1.5 + random.next(), [random.next(), random.next(), random.next()]);
            (0..3)
                .flat_map(|c| (0..N).map(move |k| (c, k)))
                .map(|(c, k)| {
                    shift[c] + scale * (0..3).map(|e| rotation[(c, e)] * base[e * N + k]).sum::<f64>()
                })
                .collect()
        })
        .collect();
    let method =
        Method::new(&Transformation::Named(ClassName::Similarity), Alignment::Procrustes, 3).unwrap();
    let (mean, aligned) =
        align_all(&metric, &method, Frame::Canonical, &matching, shapes.concat(), vec![1.0; 7]).unwrap();
    assert!((norm(&mean.whitened) - 1.0).abs() < 1e-12 && mean.converged);
    for shape in &aligned {
        assert!(shape.residual < 1e-8, "{}", shape.residual);
        assert!(shape.matrix.determinant() > 0.0);
    }
    // principal axes: coordinates are uncorrelated
    let (x, y) = (&mean.whitened[..N], &mean.whitened[N..2 * N]);
    assert!(dot(x, y).abs() < 1e-9);
}

#[test]
fn translation_keeps_size_and_averages() {
    let metric = metric(GeneratorKind::Cubic {}, 2);
    let shapes = beans(9, 4, 2, 0.3);
    let (mean, aligned) = run(&metric, ClassName::Translation, Frame::Training, &shapes);
    let mut average = vec![0.0; 2 * N];
    for shape in &shapes {
        let mut centred = shape.clone();
        metric.centre(&mut centred);
        average.iter_mut().zip(&centred).for_each(|(sum, value)| *sum += value / 4.0);
    }
    assert!(distance(&mean.control_points, &average) < 1e-12);
    assert!(aligned.iter().all(|shape| (shape.matrix[(0, 0)] - 1.0).abs() < 1e-15));
}

#[test]
fn degenerate_shapes_are_named() {
    let metric = metric(GeneratorKind::Trigonometric {}, 2);
    let mut shapes = beans(3, 4, 2, 0.2);
    shapes[2] = (0..2 * N).map(|i| (i % N) as f64 * if i < N { 1.0 } else { 2.0 }).collect();
    let fails = |name: ClassName, shapes: &[Vec<f64>]| {
        let weights = vec![1.0; shapes.len()];
        align_all(&metric, &method(name, 2), Frame::Training, &landmarks(2), shapes.concat(), weights)
            .unwrap_err()
    };
    assert!(matches!(fails(ClassName::Affine, &shapes), AnalysisError::Degenerate { index: 2, .. }));
    shapes[2] = vec![1e6; 2 * N];
    assert!(matches!(fails(ClassName::Similarity, &shapes), AnalysisError::NoExtent { index: 2, .. }));
    assert!(matches!(
        fails(ClassName::Similarity, &shapes[..1]),
        AnalysisError::TooFewShapes { found: 1, needed: 2 }
    ));
}

#[test]
fn sums_take_no_shapes() {
    for name in [ClassName::Similarity, ClassName::Affine, ClassName::NonUniformScaling] {
        let class = TransformationClass::named(name, 2).unwrap();
        let mut sum = ProjectorSum::new(&class, 12);
        sum.update(Shapes { first: 0, whitened: &[], weights: &[] }).unwrap();
        assert!(!sum.exchange(&[]).unwrap(), "there is nothing yet to exchange in");
    }
}
