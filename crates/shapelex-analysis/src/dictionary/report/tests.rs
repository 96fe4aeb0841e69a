//! Downdates beside components learnt anew, distances beside those of all pairs, and whole reports.

use rand::rngs::ChaCha12Rng;
use rand::{RngExt, SeedableRng};

use super::measurement::Quantity;
use super::sample::Sample;
use super::{Measurement, ReportCard, ReportOptions, TrainingShapes};
use crate::AnalysisError;
use crate::accumulate::{ShapeSource, ShapesInMemory};
use crate::dictionary::learn::learn;
use crate::dictionary::method::Method;
use crate::dictionary::recipe::Recipe;
use crate::metric::Metric;
use crate::pca::FunctionalPca;
use crate::transformation::{ClassName, Transformation};
use crate::watch::Unwatched;
use shapelex_geometry::capability::place::Place;
use shapelex_geometry::generator::GeneratorKind;
use shapelex_geometry::representation::{Representation, ShapeSpace};

/// Vectors near one of them, with falling variances and unequal weights, up to three of a subject.
fn vectors(count: usize, length: usize, weighted: bool) -> (ShapesInMemory, Vec<usize>) {
    let mut random = ChaCha12Rng::seed_from_u64(count as u64);
    let mut vector = |_: usize| -> Vec<f64> {
        let draw = |i: usize| (i as f64).sin() + 0.3 / (1.0 + i as f64) * random.random_range(-1.0..1.0);
        (0..length).map(draw).collect()
    };
    let whitened = (0..count).flat_map(&mut vector).collect();
    let weight = |k: usize| if weighted { 1.0 + (k % 3) as f64 } else { 1.0 };
    let subjects = (0..count).map(|k| if k < 6 { k / 3 } else { k - 4 }).collect();
    (ShapesInMemory::prepared(whitened, (0..count).map(weight).collect()), subjects)
}

/// Errors of shape `k` by 0, 1, …, `count` components that are learnt anew from all shapes of other subjects.
fn anew(all: &ShapesInMemory, subjects: &[usize], k: usize, centred: bool, count: usize) -> Vec<f64> {
    let length = all.all().whitened.len() / all.count();
    let others: Vec<usize> = (0..all.count()).filter(|&j| subjects[j] != subjects[k]).collect();
    let whitened = others.iter().flat_map(|&j| all.shape(j).iter().copied()).collect();
    let weights = others.iter().map(|&j| all.all().weights[j]).collect();
    let others = ShapesInMemory::prepared(whitened, weights);
    let metric = Metric::of(&ShapeSpace::of_points(2, length / 2).unwrap());
    let y = all.shape(k);
    let pca = FunctionalPca::new(&others, &metric, y, centred, count).unwrap();
    let scores = pca.scores(y);
    let error = |m: usize| {
        let mut some = scores.clone();
        some[m..].fill(0.0);
        let described = pca.reconstruct(&some);
        y.iter().zip(described).map(|(y, d)| (y - d).powi(2)).sum::<f64>().sqrt()
    };
    (0..=count).map(error).collect()
}

/// With more shapes than numbers and with fewer; single shapes and subjects of three.
#[test]
fn leaving_a_subject_out_is_learning_anew() {
    for (count, length) in [(30, 12), (11, 40)] {
        for (centred, weighted) in [(true, false), (true, true), (false, false), (false, true)] {
            let (all, subjects) = vectors(count, length, weighted);
            let sample = Sample::new(&all, all.shape(0), centred, &subjects).unwrap();
            for subject in 0..sample.subjects.len() {
                let others = sample.without(subject, 4).unwrap();
                for &k in &sample.subjects[subject] {
                    let found = others.errors(&sample, k, 4);
                    let wanted = anew(&all, &subjects, k, centred, 4);
                    for (found, wanted) in found.iter().zip(&wanted) {
                        let off = (found - wanted).abs() / wanted;
                        assert!(off < 1e-9, "{count} {centred} {weighted} shape {k}: {found} {wanted}");
                    }
                }
            }
        }
    }
}

/// Shapes that occur as often as they are have the components of all.
#[test]
fn a_resample_of_everything_is_everything() {
    let (all, subjects) = vectors(30, 12, true);
    let sample = Sample::new(&all, all.shape(0), true, &subjects).unwrap();
    let every: Vec<(usize, f64)> = (0..30).map(|k| (k, 1.0)).collect();
    let part = sample.of(&every, 5).unwrap();
    assert!(part.shift.iter().all(|d| d.abs() < 1e-12));
    for i in 0..5 {
        assert!((part.pairs.values[i] / sample.values[i] - 1.0).abs() < 1e-9);
        assert!((part.pairs.vectors[(i, i)].abs() - 1.0).abs() < 1e-9);
    }
    // Their coordinates give the shapes back.
    for k in 0..30 {
        let back = sample.whitened(sample.shape(k));
        let off: f64 = back.iter().zip(all.shape(k)).map(|(a, b)| (a - b).powi(2)).sum();
        assert!(off.sqrt() < 1e-12, "{off}");
    }
}

pub(crate) fn space() -> ShapeSpace {
    let generator = GeneratorKind::Trigonometric {};
    ShapeSpace::new(&Representation::ClosedCurve { dimension: 2, control_points: 12, generator }).unwrap()
}

/// Ovals of unequal size in random poses, which differ in length, bulge and a little noise.
pub(crate) fn ovals(count: usize, noise: f64) -> Vec<f64> {
    let mut random = ChaCha12Rng::seed_from_u64(7);
    let mut oval = |_: usize| -> Vec<f64> {
        let mut draw = || (0..3).map(|_| random.random_range(-1.0..1.0)).sum::<f64>();
        let (length, bulge, size, turn) = (3.0 + 0.3 * draw(), 0.1 * draw(), 5.0 + 0.5 * draw(), draw());
        let points: Vec<[f64; 2]> = (0..12)
            .map(|i| {
                let t = std::f64::consts::TAU * i as f64 / 12.0;
                let (x, y) =
                    (length * t.cos() + noise * draw(), (2.0 + bulge * t.cos()) * t.sin() + noise * draw());
                [size * (x * turn.cos() - y * turn.sin()) + 9.0, size * (x * turn.sin() + y * turn.cos())]
            })
            .collect();
        (0..2).flat_map(|c| points.iter().map(move |p| p[c]).collect::<Vec<f64>>()).collect()
    };
    (0..count).flat_map(&mut oval).collect()
}

fn options() -> ReportOptions {
    let named = |name: &str, measure, values: &[f64]| Measurement {
        name: name.into(),
        measure,
        values: values.to_vec(),
    };
    ReportOptions {
        modes: 6,
        draws: 200,
        resamples: 50,
        seed: 3,
        measurements: vec![
            named("length", Quantity::Distance { between: [Place::One(0.0), Place::One(0.5)] }, &[32.0]),
            named(
                "opening",
                Quantity::Angle { at: [Place::One(0.0), Place::One(0.25), Place::One(0.5)] },
                &[115.0],
            ),
        ],
    }
}

fn report(points: Vec<f64>, subjects: Vec<usize>, robust: bool) -> Result<ReportCard, AnalysisError> {
    let (space, count) = (space(), subjects.len());
    let method = Method::FunctionalPca { components: 6, centre: true };
    let mut recipe =
        Recipe::new(space.representation().clone(), Transformation::Named(ClassName::Similarity), method);
    recipe.estimator = crate::factors::Estimator::robust(robust);
    let shapes = recipe.setting()?.shapes(points.clone(), vec![1.0; count])?;
    let dictionary = learn(&shapes, &recipe, &Unwatched)?.dictionary;
    let training = TrainingShapes { control_points: points, weights: vec![1.0; count], subjects };
    dictionary.report(&space, training, &options(), &Unwatched)
}

#[test]
fn two_ways_to_vary_need_two_modes() {
    let found = report(ovals(60, 0.01), (0..60).collect(), false).unwrap();
    assert_eq!((found.shapes, found.subjects, found.modes.len()), (60, 60, 6));
    let general = |i: usize| found.modes[i].errors.generalisation.value;
    let noise = general(1);
    // Sizes are near 30: noise of 0.01 in two directions, times a size of 5.
    assert!(found.mean_only.generalisation.value > 5.0 * noise, "{found:?}");
    assert!((0.02..0.15).contains(&noise), "{noise}");
    assert!(found.modes[1].compactness.value > 0.98 && found.modes[0].compactness.value < 0.98);
    for pair in found.modes.windows(2) {
        assert!(pair[1].compactness.value >= pair[0].compactness.value);
        assert!(pair[1].errors.specificity.value >= 0.8 * pair[0].errors.specificity.value);
        assert!(pair[1].errors.generalisation.value <= pair[0].errors.generalisation.value * 1.02);
    }
    let stable = |i: usize| found.modes[i].span_angle_deg.unwrap().median;
    // Behind the two, noise of one size has no preferred modes.
    assert!(stable(1) < 5.0 && stable(2) > 2.0 * stable(1), "{} {}", stable(1), stable(2));
    // Curves are nearer as sets than point by point.
    let errors = &found.modes[0].errors;
    assert!(errors.generalisation_to_set.unwrap().value <= errors.generalisation.value);
    // More subjects, less error.
    let curve = &found.learning_curve;
    assert!(curve.len() == 6 && curve[0].generalisation.value > curve[5].generalisation.value);
    let interval = found.modes[0].explained;
    assert!(interval.low.unwrap() < interval.value && interval.value < interval.high.unwrap());
}

#[test]
fn measurements_are_told_in_the_unit_of_the_shapes() {
    let points = ovals(60, 0.01);
    let lengths = points.chunks_exact(24).map(|p| (p[0] - p[6]).hypot(p[12] - p[18]));
    let mean = lengths.sum::<f64>() / 60.0;
    let found = report(points, (0..60).collect(), false).unwrap();
    let length = &found.measurements[0];
    assert!((length.mean - mean).abs() < 1e-9 && (length.of_mean / mean - 1.0).abs() < 0.02, "{length:?}");
    let wanted = &length.wanted[0];
    let rows = wanted.control_points.as_ref().unwrap();
    let between: f64 = (0..2).map(|c| (rows[0][c] - rows[6][c]).powi(2)).sum::<f64>().sqrt();
    assert!((between - 32.0).abs() < 1e-6, "{between}");
    assert!((wanted.distance.unwrap() - 0.5).abs() < 4.0);
    let opening = &found.measurements[1];
    assert_eq!(opening.unit.as_deref(), Some("deg"));
    // A longer oval opens wider: the first mode moves both.
    assert!(length.modes[0].change * opening.modes[0].change > 0.0);
    assert!(opening.modes[0].correlation.unwrap().abs() > 0.9);
}

/// Shapes of one subject are left out together, so that copies do not help.
#[test]
fn copies_of_a_subject_do_not_flatter() {
    let single = ovals(20, 0.1);
    let twice: Vec<f64> = single.chunks_exact(24).flat_map(|shape| [shape, shape].concat()).collect();
    let alone = report(single, (0..20).collect(), false).unwrap();
    let paired = report(twice.clone(), (0..40).map(|k| k / 2).collect(), false).unwrap();
    let unaware = report(twice, (0..40).collect(), false).unwrap();
    let general = |card: &ReportCard| card.modes[5].errors.generalisation.value;
    assert!((general(&paired) / general(&alone) - 1.0).abs() < 1e-9);
    assert!(general(&unaware) < 0.95 * general(&alone), "{} {}", general(&unaware), general(&alone));
}

#[test]
fn a_robust_report_is_about_the_shapes_that_were_learnt_from() {
    let mut points = ovals(40, 0.05);
    // Two triangles among ovals.
    for k in [3, 17] {
        for i in 0..12 {
            let t = std::f64::consts::TAU * (i / 4) as f64 / 3.0 + 0.01 * i as f64;
            (points[k * 24 + i], points[k * 24 + 12 + i]) = (20.0 * t.cos(), 20.0 * t.sin());
        }
    }
    let found = report(points, (0..40).collect(), true).unwrap();
    assert!(found.shapes <= 38 && found.subjects == found.shapes, "{}", found.shapes);
}

#[test]
fn other_shapes_than_those_learnt_from_are_refused() {
    let (space, points) = (space(), ovals(20, 0.1));
    let method = Method::FunctionalPca { components: 3, centre: true };
    let similarity = Transformation::Named(ClassName::Similarity);
    let recipe = Recipe::new(space.representation().clone(), similarity, method);
    let shapes = recipe.setting().unwrap().shapes(points.clone(), vec![1.0; 20]).unwrap();
    let dictionary = learn(&shapes, &recipe, &Unwatched).unwrap().dictionary;
    let ask = |count: usize, subjects: Vec<usize>| {
        let control_points = points[..24 * count].to_vec();
        let training = TrainingShapes { control_points, weights: vec![1.0; count], subjects };
        dictionary.report(&space, training, &options(), &Unwatched)
    };
    let field = |found| match found {
        Err(AnalysisError::Parameter { field, .. }) => field,
        other => panic!("{other:?}"),
    };
    assert_eq!(field(ask(19, (0..19).collect())), "shapes");
    assert_eq!(field(ask(20, (0..20).map(|k| k / 10).collect())), "dictionary");
    assert!(ask(20, (0..20).collect()).is_ok());
}

/// Equal shapes have no modes.
#[test]
fn shapes_that_do_not_vary_are_refused() {
    let one = ovals(1, 0.1);
    let found = report(one.repeat(5), (0..5).collect(), false);
    assert!(matches!(found, Err(AnalysisError::Parameter { field: "dictionary", .. })), "{found:?}");
}
