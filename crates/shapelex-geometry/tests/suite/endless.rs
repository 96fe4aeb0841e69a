//! Every measure ends within a counted number of steps, whatever is posted, and a caller who stops is heard.

use std::f64::consts::{PI, TAU};
use std::sync::atomic::{AtomicUsize, Ordering};

use proptest::prelude::*;
use shapelex_geometry::curve::Curve;
use shapelex_geometry::distance::Distances;
use shapelex_geometry::generator::GeneratorKind;
use shapelex_geometry::measures::CurveMeasures;
use shapelex_numeric::bounded::never;
use shapelex_numeric::dense::Matrix;

use crate::spaces::{Noise, closed, open};

/// Steps of the measures of one curve: 20 000 stretches (and an eighth of it for each growth of the tolerance) for each
/// half-segment, coordinate and sign is what they may take; what is not made to be searched takes some hundred.
const STEPS_PER_HALF: usize = 2_000;

/// Control points that made searches endless: collapsed but for some, far off, tiny, huge, straight, folded back.
fn control_points(case: usize, rows: usize, dimension: usize, seed: u64) -> Matrix {
    let mut noise = Noise(seed);
    let unit = [1.0, 1e-158, 1e150, 1e-300, 1e6, 1e-13, 0.0][case % 7];
    let offset = [0.0, 1000.0, 1e6, 1e15, 1e-160][case / 7 % 5];
    let moved = case / 35 % 4;
    Matrix::from_fn(rows, dimension, |row, c| {
        let value = match moved {
            // All at one place but for one.
            0 if row != rows / 2 => 0.0,
            // On a straight line, there and back.
            1 => (row.min(rows - row) as f64) / rows as f64,
            // On a circle.
            2 => (TAU * row as f64 / rows as f64 + PI / 2.0 * c as f64).cos(),
            _ => noise.next(),
        };
        offset + unit * value
    })
}

fn curve(case: usize, seed: u64) -> Curve {
    let kinds = GeneratorKind::catalogue();
    let kind = &kinds[seed as usize % kinds.len()];
    let dimension = 2 + case % 2;
    let space =
        if seed.is_multiple_of(3) { open(kind, 9, dimension) } else { closed(kind, 9, dimension) }.unwrap();
    Curve::of(&space, &control_points(case, space.representation().size(), dimension, seed)).unwrap()
}

/// A point on which the sweep below stops: all numbers are finite, and none took more than its share.
fn assert_measured(what: &str, curve: &Curve) {
    let measures = CurveMeasures::of(curve);
    assert!(measures.steps <= STEPS_PER_HALF * curve.halves(), "{what}: {} steps", measures.steps);
    assert!(measures.length.is_finite() && measures.length >= 0.0, "{what}: {measures:?}");
    assert!(measures.length_error <= 1e-9 * measures.length, "{what}: {measures:?}");
}

/// Stretches that a pair of curves is allowed; 256 for each of its points at least.
const ALLOWED: usize = 50_000;

fn assert_distant(what: &str, r: &Curve, s: &Curve) {
    let found = Distances::unless_stopped(r, s, ALLOWED, &never).unwrap();
    let points = (r.halves() + s.halves()) * 21;
    // Shares are rounded up to 256, tolerances grow by 4 with each eighth of a share after that: some 40 of them lead from
    // rounding past the extent. The searches between starts come in addition.
    let most = 6 * (ALLOWED.max(256 * points) + 256 * 256 * 42);
    assert!(found.stretches <= most, "{what}: {} of {most}", found.stretches);
    let numbers = [found.l2, found.symmetric, found.hausdorff, found.accuracy];
    assert!(numbers.iter().all(|value| value.is_finite() && *value >= 0.0), "{what}: {found:?}");
}

/// All kinds of trouble, one after the other.
#[test]
fn measures_of_every_kind_of_trouble_end() {
    for case in 0..140 {
        assert_measured(&format!("case {case}"), &curve(case, case as u64));
    }
}

#[test]
fn distances_of_every_kind_of_trouble_end() {
    for case in 0..140 {
        let other = (case * 37 + 11) % 140;
        let (r, s) = (curve(case & !1, case as u64), curve(other & !1, other as u64));
        assert_distant(&format!("{case} and {other}"), &r, &s);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn every_measure_ends_within_its_steps(case in 0_usize..140, other in 0_usize..140, seed in any::<u64>()) {
        let (r, s) = (curve(case & !1, seed), curve(other & !1, seed.rotate_left(17)));
        assert_measured("random", &r);
        assert_distant("random", &r, &s);
    }

    /// A power of two changes no digit.
    #[test]
    fn measures_do_not_depend_on_the_unit(seed in any::<u64>(), exponent in -500..300_i32) {
        let unit = f64::from(exponent).exp2();
        let space = closed(&GeneratorKind::Cubic {}, 7, 2).unwrap();
        let points = Noise(seed).matrix(7, 2);
        let [here, there] = [1.0, unit].map(|unit| Curve::of(&space, &(&points * unit)).unwrap());
        let [found, scaled] = [&here, &there].map(CurveMeasures::of);
        prop_assert_eq!(found.length * unit, scaled.length);
        prop_assert_eq!(found.total_curvature, scaled.total_curvature);
        let other = |unit: f64| Curve::of(&space, &(&Noise(seed ^ 1).matrix(7, 2) * unit)).unwrap();
        let (one, two) = (Distances::of(&here, &other(1.0)), Distances::of(&there, &other(unit)));
        prop_assert_eq!((one.symmetric * unit, one.hausdorff * unit), (two.symmetric, two.hausdorff));
    }
}

/// The caller is asked within the loops: what is left after it has said yes is counted.
#[test]
fn a_caller_who_stops_ends_distances_soon() {
    let space = closed(&GeneratorKind::Trigonometric {}, 64, 2).unwrap();
    let circle = |radius: f64| {
        let point = |row: usize, c: usize| radius * (TAU * row as f64 / 64.0 + PI / 2.0 * c as f64).cos();
        Curve::of(&space, &Matrix::from_fn(64, 2, point)).unwrap()
    };
    // All points of the one are equally far from all of the other.
    let (point, circle) = (circle(1e-30), circle(1.0));
    let (asked, most) = (AtomicUsize::new(0), 100);
    let stop = || asked.fetch_add(1, Ordering::Relaxed) >= most;
    assert_eq!(Distances::unless_stopped(&point, &circle, usize::MAX, &stop), None);
    // Once for each of the points that are left, and where searches stand.
    let points = 2 * (point.halves() + circle.halves()) * 21;
    assert!(asked.load(Ordering::Relaxed) < most + points, "{asked:?}");
    assert_eq!(CurveMeasures::unless_stopped(&circle, &|| true), None);
}
