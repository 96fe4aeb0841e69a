//! Robust means: what they leave out, and the laws they share with plain ones.

use std::f64::consts::TAU;

use shapelex_analysis::AnalysisError;
use shapelex_analysis::accumulate::ShapesInMemory;
use shapelex_analysis::alignment::{Alignment, MeanShape, mean_shape};
use shapelex_analysis::correspondence::{Correspondence, Direction, Mirror};
use shapelex_analysis::dictionary::learn::learn;
use shapelex_analysis::dictionary::method::Method as Learning;
use shapelex_analysis::dictionary::recipe::{Recipe, Setting};
use shapelex_analysis::factors::Estimator;
use shapelex_analysis::frame::Frame;
use shapelex_analysis::matching::Matching;
use shapelex_analysis::partial_sums::Measured;
use shapelex_analysis::robust::{align_all_by, mean_by, point_weights};
use shapelex_analysis::transformation::{ClassName, Transformation};
use shapelex_analysis::watch::Unwatched;
use shapelex_geometry::generator::GeneratorKind;
use shapelex_geometry::representation::Representation;

const POINTS: usize = 24;

const CLASSES: [(ClassName, Alignment); 6] = [
    (ClassName::Similarity, Alignment::Projection),
    (ClassName::Affine, Alignment::Projection),
    (ClassName::NonUniformScalingTranslation, Alignment::Projection),
    (ClassName::HorizontalShearTranslation, Alignment::Projection),
    (ClassName::Similarity, Alignment::Procrustes),
    (ClassName::Rigid, Alignment::Procrustes),
];

/// Deterministic pseudo-random numbers in [−1, 1].
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 11) as f64 / (1u64 << 53) as f64) * 2.0 - 1.0
    }

    /// Nearly normal, with deviation one.
    fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.next()).sum::<f64>() / 2.0
    }
}

/// Radius of a wing-like contour with three modes, in its own coordinates.
fn shape(random: &mut Noise) -> Vec<f64> {
    let modes = [0.06 * random.normal(), 0.04 * random.normal(), 0.02 * random.normal()];
    // A mirror image differs in 4u, where the shapes hardly vary.
    let radius = |u: f64| {
        1.0 + 0.35 * (2.0 * u).cos()
            + 0.15 * (3.0 * u + 0.7).cos()
            + 0.1 * (4.0 * u + 0.9).cos()
            + modes[0] * (3.0 * u).sin()
            + modes[1] * (4.0 * u).cos()
            + modes[2] * (5.0 * u + 1.0).sin()
    };
    contour(radius, random)
}

/// Another organ: a star.
fn star(random: &mut Noise) -> Vec<f64> {
    let phase = 0.2 * random.next();
    contour(|u| 1.0 + 0.5 * (5.0 * u + phase).cos(), random)
}

fn contour(radius: impl Fn(f64) -> f64, random: &mut Noise) -> Vec<f64> {
    let mut values = vec![0.0; 2 * POINTS];
    for i in 0..POINTS {
        let u = TAU * i as f64 / POINTS as f64;
        let r = radius(u) + 0.004 * random.normal();
        (values[i], values[POINTS + i]) = (r * u.cos(), r * u.sin());
    }
    values
}

fn mirrored(shape: &[f64]) -> Vec<f64> {
    let mut out = vec![0.0; shape.len()];
    for i in 0..POINTS {
        let from = (POINTS - i) % POINTS;
        (out[i], out[POINTS + i]) = (-shape[from], shape[POINTS + from]);
    }
    out
}

/// `matrix · shape + shift`.
fn moved(shape: &[f64], [a, b, c, d]: [f64; 4], shift: f64) -> Vec<f64> {
    let (x, y) = shape.split_at(POINTS);
    let first = x.iter().zip(y).map(|(x, y)| a * x + b * y + shift);
    let second = x.iter().zip(y).map(|(x, y)| c * x + d * y - shift);
    first.chain(second).collect()
}

fn right(count: usize, seed: u64) -> Vec<Vec<f64>> {
    let mut random = Noise(seed);
    (0..count).map(|_| shape(&mut random)).collect()
}

/// Wrong shapes: stars, mirror images, and leaks in turn.
fn wrong(count: usize, seed: u64) -> Vec<Vec<f64>> {
    let mut random = Noise(seed);
    let one = |k: usize| match k % 3 {
        0 => star(&mut random),
        1 => mirrored(&shape(&mut random)),
        _ => {
            let mut leaked = shape(&mut random);
            for i in 0..4 {
                let place = (5 * k + i) % POINTS;
                leaked[place] *= 2.5;
                leaked[POINTS + place] *= 2.5;
            }
            leaked
        }
    };
    (0..count).map(one).collect()
}

fn recipe(name: ClassName, alignment: Alignment, estimator: Estimator, method: Learning) -> Recipe {
    let generator = GeneratorKind::Bspline { degree: 3 };
    let representation = Representation::ClosedCurve { dimension: 2, control_points: POINTS, generator };
    Recipe { alignment, estimator, ..Recipe::new(representation, Transformation::Named(name), method) }
}

fn setting(name: ClassName, alignment: Alignment) -> Setting {
    recipe(name, alignment, Estimator::Plain, Learning::components(3, true)).setting().unwrap()
}

fn mean(setting: &Setting, shapes: &[Vec<f64>], weights: Vec<f64>, robust: bool) -> MeanShape {
    tried(setting, shapes, weights, robust).unwrap()
}

fn tried(
    setting: &Setting,
    shapes: &[Vec<f64>],
    weights: Vec<f64>,
    robust: bool,
) -> Result<MeanShape, AnalysisError> {
    let Setting { metric, method, matching, .. } = setting;
    let source = setting.shapes(shapes.concat(), weights)?;
    mean_by(Estimator::robust(robust), &source, metric, method, Frame::Training, matching)
}

fn distance(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

fn ones(shapes: &[Vec<f64>]) -> Vec<f64> {
    vec![1.0; shapes.len()]
}

#[test]
fn a_third_of_wrong_shapes_is_left_out_under_every_class() {
    let (right, wrong) = (right(70, 1), wrong(30, 2));
    let all = [right.clone(), wrong].concat();
    for (name, alignment) in CLASSES {
        let setting = setting(name, alignment);
        let wanted = mean(&setting, &right, ones(&right), false);
        let plain = mean(&setting, &all, ones(&all), false);
        let robust = mean(&setting, &all, ones(&all), true);
        let factors = robust.robust.as_ref().unwrap();
        let size = wanted.whitened.iter().map(|v| v * v).sum::<f64>().sqrt();
        let off = |mean: &MeanShape| distance(&mean.whitened, &wanted.whitened) / size;
        assert!(off(&plain) > 0.02, "{name:?}: the plain mean moves {:.4}", off(&plain));
        assert!(off(&robust) < 0.01, "{name:?} {alignment:?}: the robust mean moves {:.4}", off(&robust));
        let kept: f64 = factors.factors[70..].iter().sum();
        // Under affine maps a mirror image is like the shape.
        let mirrors = if name == ClassName::Affine { 10.0 } else { 0.0 };
        assert!(kept <= mirrors + 1.0, "{name:?} {alignment:?}: {kept} of the wrong shapes are kept");
        assert!(factors.factors[..70].iter().sum::<f64>() > 65.0, "{name:?}: {:?}", factors.summary());
        assert_eq!(
            factors.rejected() + factors.reduced(),
            factors.factors.iter().filter(|f| **f < 1.0).count()
        );
    }
}

/// Shapes that vary widely, and shapes that agree with each other, no farther from the mean than those.
#[test]
fn a_tight_group_within_a_wide_set_is_left_out() {
    let mut random = Noise(21);
    let mut with_modes = |deviation: f64, shift: f64| {
        let [a, b, c] = [0.12, 0.1, 0.08].map(|size| size * (deviation * random.normal() + shift));
        let radius = |u: f64| {
            1.0 + 0.35 * (2.0 * u).cos()
                + 0.15 * (3.0 * u + 0.7).cos()
                + a * (3.0 * u).sin()
                + b * (4.0 * u).cos()
                + c * (5.0 * u + 1.0).sin()
        };
        contour(radius, &mut random)
    };
    let right: Vec<Vec<f64>> = (0..140).map(|_| with_modes(1.0, 0.0)).collect();
    let wrong: Vec<Vec<f64>> = (0..60).map(|_| with_modes(0.1, 1.8)).collect();
    let all = [right.clone(), wrong].concat();
    for (name, alignment) in CLASSES {
        let setting = setting(name, alignment);
        let factors = mean(&setting, &all, ones(&all), true).robust.unwrap().factors;
        let kept: [f64; 2] = [factors[..140].iter().sum(), factors[140..].iter().sum()];
        assert!(kept[0] > 125.0 && kept[1] < 2.0, "{name:?} {alignment:?}: {kept:?} of 140 right, 60 wrong");
        // Horizontal shears lose those without wrong ones as well.
        let alone = mean(&setting, &right, ones(&right), true).robust.unwrap();
        assert!(alone.effective > 130.0, "{name:?} {alignment:?}: worth {:.1}", alone.effective);
    }
}

/// A contour that is nearly its own mirror image: how asymmetric it is varies as much as the asymmetry that all have.
fn nearly_symmetric(random: &mut Noise) -> Vec<f64> {
    let modes = [0.08 * random.normal(), 0.05 * random.normal(), 0.03 * random.normal()];
    let asymmetry = 0.04 + 0.02 * random.normal();
    let radius = |u: f64| {
        1.0 + (0.35 + modes[0]) * (2.0 * u).cos()
            + (0.1 + modes[1]) * (3.0 * u).cos()
            + modes[2] * (4.0 * u).cos()
            + asymmetry * (3.0 * u).sin()
    };
    contour(radius, random)
}

#[test]
fn mirror_images_of_nearly_symmetric_shapes_are_left_out() {
    let mut random = Noise(31);
    let right: Vec<Vec<f64>> = (0..140).map(|_| nearly_symmetric(&mut random)).collect();
    let wrong: Vec<Vec<f64>> = (0..60).map(|_| mirrored(&nearly_symmetric(&mut random))).collect();
    let all = [right.clone(), wrong].concat();
    for (name, alignment) in [CLASSES[0], CLASSES[4], CLASSES[5]] {
        let setting = setting(name, alignment);
        let factors = mean(&setting, &all, ones(&all), true).robust.unwrap().factors;
        let kept: [f64; 2] = [factors[..140].iter().sum(), factors[140..].iter().sum()];
        // At four standard deviations one in 44 is on the other side.
        assert!(
            kept[0] > 128.0 && kept[1] < 6.0,
            "{name:?} {alignment:?}: {kept:?} of 140 right, 60 mirrored"
        );
        let alone = mean(&setting, &right, ones(&right), true).robust.unwrap();
        assert!(alone.effective > 138.0, "{name:?} {alignment:?}: worth {:.1}", alone.effective);
        let backwards: Vec<Vec<f64>> = all.iter().rev().cloned().collect();
        let reversed = mean(&setting, &backwards, ones(&all), true).robust.unwrap().factors;
        let off = factors.iter().rev().zip(&reversed).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(off < 1e-6, "{name:?} {alignment:?}: factors differ by {off:e} in reverse order");
    }
}

#[test]
fn right_shapes_keep_their_weights() {
    let right = right(200, 3);
    for (name, alignment) in CLASSES {
        let setting = setting(name, alignment);
        let robust = mean(&setting, &right, ones(&right), true).robust.unwrap();
        assert!(robust.effective > 0.99 * 200.0, "{name:?} {alignment:?}: worth {:.1}", robust.effective);
    }
}

#[test]
fn neither_order_nor_poses_nor_copies_matter() {
    let all = [right(50, 4), wrong(20, 5)].concat();
    for (name, alignment) in CLASSES {
        let setting = setting(name, alignment);
        let first = mean(&setting, &all, ones(&all), true);
        let factors = first.robust.unwrap().factors;
        let same = |found: &[f64], what: &str| {
            let off = factors.iter().zip(found).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(off < 1e-7, "{name:?} {alignment:?}, {what}: factors differ by {off:e}");
        };
        let reversed: Vec<Vec<f64>> = all.iter().rev().cloned().collect();
        let found = mean(&setting, &reversed, ones(&all), true);
        same(&found.robust.unwrap().factors.into_iter().rev().collect::<Vec<_>>(), "in reverse order");
        assert!(distance(&found.whitened, &first.whitened) < 1e-9, "{name:?} {alignment:?}");
        // Each shape by its own member of the class.
        let member = |k: usize| {
            let (size, angle) = (1.0 + 0.02 * k as f64, 0.9 * k as f64);
            match name {
                ClassName::Affine => [size, 0.2 * angle.sin(), -0.1, 1.0 + 0.3 * angle.cos()],
                ClassName::NonUniformScalingTranslation => [size, 0.0, 0.0, 2.0 + angle.sin()],
                ClassName::HorizontalShearTranslation => [size, 0.5 * angle.sin(), 0.0, size],
                ClassName::Rigid => [angle.cos(), -angle.sin(), angle.sin(), angle.cos()],
                _ => [size * angle.cos(), -size * angle.sin(), size * angle.sin(), size * angle.cos()],
            }
        };
        let posed: Vec<Vec<f64>> =
            all.iter().enumerate().map(|(k, x)| moved(x, member(k), k as f64)).collect();
        let found = mean(&setting, &posed, ones(&all), true);
        same(&found.robust.unwrap().factors, "each in its own pose");
        // A copy of a shape, and the shape with twice the weight.
        let copied = [all.clone(), vec![all[3].clone()]].concat();
        let copied = mean(&setting, &copied, vec![1.0; 71], true);
        let mut weights = ones(&all);
        weights[3] = 2.0;
        let heavy = mean(&setting, &all, weights, true);
        let of = |mean: &MeanShape| mean.robust.as_ref().unwrap().factors[..70].to_vec();
        let off = of(&copied).iter().zip(of(&heavy)).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(off < 1e-7, "{name:?} {alignment:?}: a copy differs from a weight by {off:e}");
        assert!(distance(&copied.whitened, &heavy.whitened) < 1e-8, "{name:?} {alignment:?}");
    }
}

#[test]
fn the_bits_are_the_same_on_any_number_of_threads_and_without_robust() {
    let all = [right(300, 6), wrong(100, 7)].concat();
    for (name, alignment) in CLASSES {
        let setting = setting(name, alignment);
        let of = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let found = pool.install(|| mean(&setting, &all, ones(&all), true));
            (found.whitened, found.robust.unwrap())
        };
        let one = of(1);
        assert_eq!(of(2), one, "{name:?} {alignment:?}");
        assert_eq!(of(8), one, "{name:?} {alignment:?}");
        let Setting { metric, method, matching, .. } = &setting;
        let source = setting.shapes(all.concat(), ones(&all)).unwrap();
        let plain = mean_shape(&source, metric, method, Frame::Training, matching).unwrap();
        let found = mean(&setting, &all, ones(&all), false);
        assert_eq!((found.whitened, found.robust), (plain.whitened, None));
    }
}

/// Start points are searched against the robust mean: those of the wrong shapes do not matter.
#[test]
fn start_points_are_those_on_the_robust_mean() {
    let rotated = |shape: &[f64], by: usize| -> Vec<f64> {
        shape.chunks_exact(POINTS).flat_map(|c| [&c[by..], &c[..by]].concat()).collect()
    };
    let right: Vec<Vec<f64>> =
        right(40, 8).iter().enumerate().map(|(k, x)| rotated(x, 7 * k % POINTS)).collect();
    let all = [right.clone(), wrong(16, 9)].concat();
    for (name, alignment) in [CLASSES[0], CLASSES[4]] {
        let Setting { space, metric, method, .. } = setting(name, alignment);
        let (correspondence, direction) = (Correspondence::Cyclic, Direction::Either);
        let matching = Matching::new(&space, correspondence, direction, Mirror::Forbid);
        let of = |shapes: &[Vec<f64>], robust| {
            let source = ShapesInMemory::new(&metric, true, shapes.concat(), ones(shapes)).unwrap();
            mean_by(Estimator::robust(robust), &source, &metric, &method, Frame::Training, &matching).unwrap()
        };
        let (wanted, found) = (of(&right, false), of(&all, true));
        assert!(found.converged, "{name:?} {alignment:?}");
        let shift = |mean: &MeanShape, k: usize| mean.placements[k].shift as usize;
        let turn = (shift(&found, 0) + POINTS - shift(&wanted, 0)) % POINTS;
        let other = (0..40).filter(|&k| (shift(&wanted, k) + turn) % POINTS != shift(&found, k)).count();
        assert!(other <= 2, "{name:?} {alignment:?}: {other} of 40 start elsewhere");
        let rejected = found.robust.unwrap().factors[40..].iter().filter(|f| **f < 0.5).count();
        assert!(rejected >= 14, "{name:?}: {rejected} of 16");
    }
}

#[test]
fn sets_without_a_majority_are_refused() {
    let setting = setting(ClassName::Similarity, Alignment::Projection);
    let few = right(4, 10);
    let refused = tried(&setting, &few, ones(&few), true);
    assert!(matches!(refused, Err(AnalysisError::TooFewShapes { found: 4, needed: 5 })), "{refused:?}");
    let shapes = right(9, 11);
    let mut weights = vec![1e-9; 9];
    weights[2] = 1.0;
    match tried(&setting, &shapes, weights, true) {
        Err(AnalysisError::Parameter { field: "robust", detail }) => {
            assert!(detail.starts_with("expected ") && detail.contains("got 1.00"), "{detail}");
        }
        other => panic!("{other:?}"),
    }
    // Equal shapes are all right.
    let equal = vec![few[0].clone(); 6];
    let found = mean(&setting, &equal, vec![1.0; 6], true);
    assert!(found.robust.unwrap().factors.iter().all(|factor| *factor == 1.0));
    assert!(found.whitened.iter().all(|value| value.is_finite()));
    // Five are the fewest.
    let found = mean(&setting, &right(5, 12), vec![1.0; 5], true);
    assert!(found.whitened.iter().all(|value| value.is_finite()));
}

/// A stretch of two of 24 control points is displaced: it has the smallest weights.
#[test]
fn damage_is_found_at_its_place() {
    for (name, alignment) in CLASSES {
        let setting = setting(name, alignment);
        let mut shapes = right(120, 13);
        let places = |k: usize| [(5 * k) % POINTS, (5 * k + 1) % POINTS];
        for (k, shape) in shapes.iter_mut().enumerate().filter(|(k, _)| k % 6 == 0) {
            for place in places(k) {
                shape[place] *= 1.3;
                shape[POINTS + place] *= 1.3;
            }
        }
        let Setting { metric, method, matching, .. } = &setting;
        let measured = Measured { metric, method, matching };
        let (mean, aligned) = align_all_by(
            Estimator::Robust,
            measured,
            Frame::Training,
            shapes.concat(),
            ones(&shapes),
            &|| false,
        )
        .unwrap();
        let whitened: Vec<f64> = aligned.iter().flat_map(|shape| shape.whitened.clone()).collect();
        let weights = point_weights(measured, &whitened, &mean.robust.unwrap().factors).unwrap();
        assert!(weights.iter().flatten().all(|v| (0.0..=1.0).contains(v)));
        let (mut below, mut pairs) = (0, 0);
        for k in (0..120).step_by(6) {
            let damaged = places(k);
            for place in damaged {
                for other in (0..POINTS).filter(|other| !damaged.contains(other)) {
                    below += usize::from(weights[k][place] < weights[k][other]);
                    pairs += 1;
                }
            }
        }
        let area = below as f64 / pairs as f64;
        // The goal is 0.98.
        assert!(area > 0.99, "{name:?} {alignment:?}: area under the curve {area:.4}");
        let elsewhere: f64 = (0..120).filter(|k| k % 6 != 0).flat_map(|k| &weights[k]).sum();
        assert!(elsewhere > 0.85 * (100 * POINTS) as f64, "{name:?}: {elsewhere}");
    }
}

#[test]
fn a_robust_dictionary_does_not_see_what_it_leaves_out() {
    let right = right(60, 14);
    let all = [right.clone(), wrong(20, 15)].concat();
    for method in [Learning::components(3, true), Learning::sparse(4, 0.05)] {
        let of = |shapes: &[Vec<f64>], estimator| {
            let recipe = recipe(ClassName::Similarity, Alignment::Projection, estimator, method.clone());
            let source = recipe.setting().unwrap().shapes(shapes.concat(), ones(shapes)).unwrap();
            let content = learn(&source, &recipe, &Unwatched).unwrap().dictionary.content;
            assert_eq!(Recipe::of(&content), recipe);
            assert_eq!(content.faults(), Vec::new());
            content
        };
        let robust = of(&all, Estimator::Robust);
        let summary = robust.robust.unwrap();
        assert_eq!(robust.statistics.shapes, 80 - summary.rejected);
        assert!((18..=24).contains(&summary.rejected), "{summary:?}");
        let (plain, wanted) = (of(&all, Estimator::Plain), of(&right, Estimator::Plain));
        assert_eq!(plain.robust, None);
        let error = |content: &shapelex_analysis::dictionary::content::Content| {
            content.statistics.reconstruction_error
        };
        assert!(error(&robust) < 1.5 * error(&wanted), "{} for {}", error(&robust), error(&wanted));
        assert!(error(&plain) > 2.0 * error(&robust), "{} for {}", error(&plain), error(&robust));
    }
}
