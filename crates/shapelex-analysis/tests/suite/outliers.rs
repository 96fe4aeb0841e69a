//! Outliers of dictionaries whose training shapes have gross errors: they are found wherever they stand, and the alarms of the others
//! stay at their level.

use std::f64::consts::TAU;

use rand::rngs::ChaCha12Rng;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use shapelex_analysis::dictionary::in_use::Dictionary;
use shapelex_analysis::dictionary::learn::learn;
use shapelex_analysis::dictionary::method::Method;
use shapelex_analysis::dictionary::recipe::Recipe;
use shapelex_analysis::transformation::{ClassName, Transformation};
use shapelex_analysis::watch::Unwatched;
use shapelex_geometry::representation::Representation;

const POINTS: usize = 64;
const COMPONENTS: usize = 20;
const QUANTILE: f64 = 0.99;

type Contour = Vec<[f64; 2]>;

/// Standard deviation of the noise of a coordinate.
const NOISE: f64 = 0.004;

/// Contours about one shape: smooth waves, and a little noise of each coordinate.
fn contour(random: &mut ChaCha12Rng) -> Contour {
    let mut normal = || random.sample::<f64, _>(StandardNormal);
    let waves: Vec<[f64; 2]> =
        (2..14).map(|k| [normal(), normal()].map(|x| 0.12 * x / f64::from(k - 1).powf(1.3))).collect();
    let mut noise = || NOISE * normal();
    let at = |i: usize| {
        let t = TAU * i as f64 / POINTS as f64;
        let own: f64 = (2..)
            .zip(&waves)
            .map(|(k, [a, b])| a * (f64::from(k) * t).cos() + b * (f64::from(k) * t).sin())
            .sum();
        let radius = 1.0 + 0.2 * (2.0 * t).cos() + 0.15 * (3.0 * t + 0.4).cos() + own;
        [radius * t.cos() + noise(), radius * t.sin() + noise()]
    };
    (0..POINTS).map(at).collect()
}

#[derive(Debug, Clone, Copy)]
enum Error {
    /// A half wave outwards on a seventh of the contour, half a radius high or more.
    Lobe,
    /// Two points in each other's place.
    Swap,
    /// Ten times the noise of the others. Noise that destroys the shape is another matter: its projections on the mean are short, so that
    /// such shapes form a compact group.
    Noise,
}

const ERRORS: [Error; 3] = [Error::Lobe, Error::Swap, Error::Noise];

fn spoilt(mut contour: Contour, error: Error, random: &mut ChaCha12Rng) -> Contour {
    match error {
        Error::Lobe => {
            let (first, height) = (random.random_range(0..POINTS), random.random_range(0.5..1.0));
            let stretch = POINTS / 7;
            for i in 0..stretch {
                let k = (first + i) % POINTS;
                let t = TAU * k as f64 / POINTS as f64;
                let out = height * (TAU / 2.0 * (i as f64 + 0.5) / stretch as f64).sin();
                contour[k] = [contour[k][0] + out * t.cos(), contour[k][1] + out * t.sin()];
            }
        }
        Error::Swap => {
            let first = random.random_range(0..POINTS);
            contour.swap(first, (first + random.random_range(8..POINTS - 8)) % POINTS);
        }
        Error::Noise => {
            let mut noise = || 10.0 * NOISE * random.sample::<f64, _>(StandardNormal);
            contour.iter_mut().for_each(|point| *point = point.map(|x| x + noise()));
        }
    }
    contour
}

fn numbers(contours: &[Contour]) -> Vec<f64> {
    let columns =
        |contour: &Contour| [0, 1].map(|c| contour.iter().map(|p| p[c]).collect::<Vec<f64>>()).concat();
    contours.iter().flat_map(columns).collect()
}

fn recipe() -> Recipe {
    let representation = Representation::Landmarks { dimension: 2, points: POINTS };
    let similarity = Transformation::Named(ClassName::Similarity);
    Recipe::new(representation, similarity, Method::components(COMPONENTS, true))
}

fn dictionary(contours: &[Contour]) -> Dictionary {
    let recipe = recipe();
    let shapes = recipe.setting().unwrap().shapes(numbers(contours), vec![1.0; contours.len()]).unwrap();
    learn(&shapes, &recipe, &Unwatched).unwrap().dictionary
}

fn flags(dictionary: &Dictionary, contours: &[Contour]) -> Vec<bool> {
    let coded = dictionary.encode(&numbers(contours), &Unwatched).unwrap();
    coded.iter().map(|coded| dictionary.score(coded, QUANTILE).outlier).collect()
}

fn part(flags: &[bool]) -> f64 {
    flags.iter().filter(|flag| **flag).count() as f64 / flags.len() as f64
}

/// `count` contours, the first of them with errors, those like the training shapes that are new, and the number of errors.
fn cohort(count: usize, rate: f64, error: Error, seed: u64) -> (Vec<Contour>, Vec<Contour>, usize) {
    let mut random = ChaCha12Rng::seed_from_u64(seed);
    let wrong = (rate * count as f64).round() as usize;
    let contours = (0..count).map(|k| {
        let contour = contour(&mut random);
        if k < wrong { spoilt(contour, error, &mut random) } else { contour }
    });
    let contours = contours.collect();
    (contours, (0..1000).map(|_| contour(&mut random)).collect(), wrong)
}

/// From 0.5 to 10 % of independent gross errors: all are found, and new shapes without errors give one alarm in a hundred, as without
/// any errors. Of 12 000 new shapes in each row, a rate of 1 % has a standard error of 0.1 points, and as limits from 400 shapes vary by
/// a quarter of a point, their mean over twelve has one of 0.1 points too: five of them are allowed.
#[test]
fn gross_errors_neither_hide_each_other_nor_silence_alarms() {
    for count in [200, 500] {
        let (mut alarms, mut clean) = (Vec::new(), Vec::new());
        for (case, error) in ERRORS.into_iter().enumerate() {
            for (step, rate) in [0.005, 0.02, 0.05, 0.1].into_iter().enumerate() {
                let seed = (10 * case + step) as u64;
                let (contours, new, wrong) = cohort(count, rate, error, seed);
                let dictionary = dictionary(&contours);
                let found = part(&flags(&dictionary, &contours[..wrong]));
                assert!(found >= 0.98, "{error:?}, {rate} of {count}: {found} found");
                alarms.push(part(&flags(&dictionary, &new)));
                let (contours, new, _) = cohort(count, 0.0, error, seed);
                clean.push(part(&flags(&self::dictionary(&contours), &new)));
            }
        }
        for (name, alarms) in [("with", &alarms), ("without", &clean)] {
            let mean = alarms.iter().sum::<f64>() / alarms.len() as f64;
            assert!((mean - 0.01).abs() < 0.005, "{name} errors among {count}: {mean}, {alarms:?}");
        }
    }
}

/// Which shapes are held out and flagged does not depend on where any of them stand: errors first, last, spread, at every hundredth
/// place, or all shapes backwards. Sums in another order differ in their last bits, so that values agree to 1e-7.
#[test]
fn the_order_of_the_shapes_does_not_matter() {
    let (contours, _, wrong) = cohort(1000, 0.01, Error::Noise, 3);
    let orders: [Vec<usize>; 4] = [
        (0..1000).collect(),
        (0..1000).rev().collect(),
        (0..1000).map(|k| (k + 500) % 1000).collect(),
        (0..1000).map(|k| if k % 100 == 0 { k / 100 } else { k - k / 100 + 9 }).collect(),
    ];
    let mut known: Option<(Vec<bool>, Vec<f64>)> = None;
    for order in orders {
        let moved: Vec<Contour> = order.iter().map(|&k| contours[k].clone()).collect();
        let dictionary = dictionary(&moved);
        let mut flagged = vec![false; 1000];
        order.iter().zip(flags(&dictionary, &moved)).for_each(|(&k, flag)| flagged[k] = flag);
        assert!(flagged[..wrong].iter().all(|flag| *flag));
        let novelty = dictionary.content.statistics.held_out.unwrap().novelty;
        let (flags, values) = known.get_or_insert_with(|| (flagged.clone(), novelty.clone()));
        assert_eq!(*flags, flagged);
        assert_eq!(values.len(), novelty.len());
        let away = values.iter().zip(&novelty).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(away < 1e-7, "{away}");
    }
}

/// A class of an eighth of the shapes is compact: it is no error, and its shapes are no outliers.
#[test]
fn a_small_class_is_no_gross_error() {
    let (mut contours, _, _) = cohort(480, 0.0, Error::Lobe, 5);
    let class = contours.len() / 8;
    for contour in &mut contours[..class] {
        for (i, point) in contour.iter_mut().enumerate() {
            let t = TAU * i as f64 / POINTS as f64;
            let out = 0.5 * (5.0 * t).cos();
            *point = [point[0] + out * t.cos(), point[1] + out * t.sin()];
        }
    }
    let dictionary = dictionary(&contours);
    let flags = flags(&dictionary, &contours);
    assert!(part(&flags[..class]) < 0.1 && part(&flags[class..]) < 0.02, "{}", part(&flags[..class]));
}
