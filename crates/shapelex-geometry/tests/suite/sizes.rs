//! Lengths, areas and crossings of shapes that arrive, against curves and integrals of a higher order.

use std::path::PathBuf;

use proptest::prelude::*;
use serde_json::Value;
use shapelex_geometry::curve::Curve;
use shapelex_geometry::generator::GeneratorKind;
use shapelex_geometry::intersection::self_intersects;
use shapelex_geometry::measures::CurveMeasures;
use shapelex_geometry::representation::ShapeSpace;
use shapelex_geometry::resample::Contour;
use shapelex_geometry::size::Sizes;
use shapelex_numeric::bounded::never;
use shapelex_numeric::dense::Matrix;
use shapelex_numeric::quadrature::{GaussLegendre, Panels};

use crate::spaces::{closed, open};
use crate::vectors::{list, numbers};

/// Lengths are promised to a relative accuracy of `10⁻¹⁰`.
const LENGTH: f64 = 1e-10;

/// Rounding of sums over a curve, relative to its length.
const ROUNDING: f64 = 1e-13;

/// Length by a rule of 12 nodes on parts that are halved until two levels agree to `10⁻¹⁴` of the mean length of a half-segment.
/// Half-segments are first divided where the speed is smallest: no node sees a dip between the last one and the end of a part.
fn adaptive_length(curve: &Curve) -> f64 {
    let rule = GaussLegendre::new(12);
    let speed = |half: usize, s: f64| {
        let squares = (0..curve.dimension()).map(|c| curve.derivative_at(half, c, s, 1).powi(2));
        squares.sum::<f64>().sqrt()
    };
    let rough: f64 = (0..curve.halves()).map(|half| rule.integrate(-1.0, 1.0, |s| speed(half, s))).sum();
    let tolerance = 1e-14 * rough / curve.halves() as f64;
    let mut panels = Panels::new(1 << 20, &never);
    let mut length = 0.0;
    for half in 0..curve.halves() {
        let speed = |s| speed(half, s);
        let ends = [vec![-1.0], minima(&speed), vec![1.0]].concat();
        for part in ends.windows(2) {
            length += rule.integrate_adaptive((part[0], part[1]), tolerance, &speed, &mut panels);
        }
    }
    // A quarter of a segment for every unit of s.
    0.25 * length
}

/// Local minima between −1 and 1 of a function that has one minimum in two parts of 1/16.
fn minima(f: &impl Fn(f64) -> f64) -> Vec<f64> {
    let at = |i: i32| (f64::from(i) / 16.0).clamp(-1.0, 1.0);
    let is_lowest = |i: &i32| f(at(*i)) <= f(at(i - 1)) && f(at(*i)) <= f(at(i + 1));
    let narrow = |(from, to): (f64, f64), _| {
        let [left, right] = [0.382, 0.618].map(|x| from + x * (to - from));
        if f(left) < f(right) { (from, right) } else { (left, to) }
    };
    (-16..=16).filter(is_lowest).map(|i| (0..40).fold((at(i - 1), at(i + 1)), narrow).0).collect()
}

fn assert_sizes(what: &str, space: &ShapeSpace, points: &Matrix) -> bool {
    let curve = Curve::of(space, points).unwrap();
    let (sizes, crosses) = Sizes::with_crossings(space, points.as_slice(), &never);
    assert_eq!(sizes, Sizes::of(space, points.as_slice(), &never), "{what}");
    let (length, expected) = (sizes.length.unwrap(), adaptive_length(&curve));
    assert!((length - expected).abs() <= LENGTH * expected, "{what}: length {length}, expected {expected}");
    let measures = CurveMeasures::of(&curve);
    assert!((length - measures.length).abs() <= ROUNDING * length, "{what}: {length}, {}", measures.length);
    let area = measures.enclosed.map_or(0.0, |enclosed| enclosed.signed_area.abs());
    let found = sizes.area.unwrap();
    assert!((found - area).abs() <= ROUNDING * length * length, "{what}: area {found}, expected {area}");
    let planar = curve.dimension() == 2;
    assert_eq!(crosses, planar.then(|| self_intersects(&curve)), "{what}");
    crosses == Some(true)
}

/// A number that looks random, within ±½.
fn noise(k: usize) -> f64 {
    (k as f64 * 0.618_033_988_749_894_9).fract() - 0.5
}

/// Few segments, fewer than the support; a last group that is full, and one that is not; noise that makes cusps and loops.
#[test]
fn sizes_are_those_of_the_curve() {
    for kind in GeneratorKind::catalogue() {
        for (dimension, amount) in [(2, 0.0), (2, 0.3), (2, 2.0), (3, 0.3)] {
            for count in [3, 7, 8, 9, 50] {
                let properties = kind.properties();
                let closed = closed(&kind, count.max(properties.fewest_control_points), dimension);
                let open = open(&kind, count.max(properties.fewest_intervals), dimension);
                for space in [closed, open].map(Result::unwrap) {
                    let rows = space.representation().size();
                    let circle = |k: usize, c: usize| {
                        (std::f64::consts::TAU * (k as f64 / count as f64 - c as f64 / 4.0)).cos()
                    };
                    let points = Matrix::from_fn(rows, dimension, |k, c| {
                        circle(k, c) + amount * noise(17 * k + 7 * c)
                    });
                    let what = format!("{kind:?}, {count} in {dimension}D, noise {amount}, {rows} rows");
                    assert_sizes(&what, &space, &points);
                }
            }
        }
    }
}

/// A slope that vanishes, or nearly so, where segments meet and within one: no node is near.
#[test]
fn lengths_of_curves_with_narrow_dips_of_speed_are_accurate() {
    let kind = GeneratorKind::Cubic {};
    let space = closed(&kind, 12, 2).unwrap();
    for tip in [0.0, 1e-12, 1e-9, 1e-6, 1e-4, 1e-3, 1e-2] {
        for shift in [0.0, 0.1, 0.25, 0.77] {
            let corner = |k: usize, c: usize| {
                let t = (k as f64 + shift) / 12.0 * std::f64::consts::TAU;
                if c == 0 { t.cos().powi(3) } else { tip * t.cos() + t.sin().powi(3) }
            };
            let points = Matrix::from_fn(12, 2, corner);
            assert_sizes(&format!("tip {tip}, shift {shift}"), &space, &points);
        }
    }
}

/// A cusp at a chosen place, which reaches from the middle of a half-segment to its end, where no node sees it.
#[test]
fn lengths_of_curves_with_cusps_near_the_ends_of_segments_are_accurate() {
    for kind in [GeneratorKind::Trigonometric {}, GeneratorKind::Bspline { degree: 3 }] {
        let space = closed(&kind, 11, 2).unwrap();
        let unit = |k: usize| Matrix::from_fn(11, 2, |i, _| if i == k { 1.0 } else { 0.0 });
        for step in 0..220 {
            let (half, s) = (step % 22, 1.0 - 0.5_f64.powi(step as i32 / 22));
            let slope = |points: &Matrix, c| Curve::of(&space, points).unwrap().derivative_at(half, c, s, 1);
            let steepness = |k: &usize| slope(&unit(*k), 0).abs();
            let moved = (0..11).max_by(|a, b| steepness(a).total_cmp(&steepness(b))).unwrap();
            let mut points = Matrix::from_fn(11, 2, |k, c| noise(31 * step + 17 * k + 7 * c));
            let cusp = [0, 1].map(|c| slope(&points, c) / slope(&unit(moved), c));
            (0..2).for_each(|c| points[(moved, c)] -= cusp[c]);
            assert_sizes(&format!("{kind:?}, cusp in {half} at {s}"), &space, &points);
        }
    }
}

proptest! {
    #[test]
    fn lengths_of_random_curves_are_accurate(values in prop::collection::vec(-1.0..1.0, 2 * 11)) {
        for kind in [GeneratorKind::Trigonometric {}, GeneratorKind::Bspline { degree: 3 }] {
            let points = Matrix::from_column_slice(11, 2, &values);
            assert_sizes(&format!("{kind:?}"), &closed(&kind, 11, 2).unwrap(), &points);
        }
    }
}

/// Squares of coordinates leave the range of numbers; sizes do not, except where they are as large.
#[test]
fn sizes_do_not_depend_on_the_unit() {
    let space = closed(&GeneratorKind::Trigonometric {}, 9, 2).unwrap();
    let points = Matrix::from_fn(9, 2, |k, c| noise(5 * k + 3 * c) + [3.0, 1.0][c]);
    let (here, crosses) = Sizes::with_crossings(&space, points.as_slice(), &never);
    for exponent in [-400, -300, 300, 450] {
        let unit = 2.0_f64.powi(exponent);
        let (there, also) = Sizes::with_crossings(&space, (&points * unit).as_slice(), &never);
        assert_eq!(there.length.unwrap(), here.length.unwrap() * unit, "2^{exponent}");
        assert_eq!(there.area.unwrap(), here.area.unwrap() * unit * unit, "2^{exponent}");
        assert_eq!(also, crosses, "2^{exponent}");
    }
    let nothing = Sizes::with_crossings(&space, &[0.0; 18], &never);
    assert_eq!((nothing.0.length, nothing.0.area), (Some(0.0), Some(0.0)));
}

/// Generators of [`CROSSING`].
const GENERATORS: [GeneratorKind; 3] = [
    GeneratorKind::Trigonometric {},
    GeneratorKind::Bspline { degree: 1 },
    GeneratorKind::Bspline { degree: 3 },
];

/// Contours of data sets, and which of them cross themselves at 50 control points of every generator. Found by a search over the
/// exact bounds of all parts of half-segments down to chords, without the test of strips: the version of commit 246ea47.
const CROSSING: [(&str, usize, [&[usize]; 3]); 14] = [
    ("apodemus-mandibles", 30, [&[], &[], &[]]),
    ("charred-grains", 230, [&[], &[], &[]]),
    ("hands", 40, [&[5], &[], &[]]),
    ("hearts", 168, [&[], &[], &[]]),
    ("molars", 249, [&[], &[], &[]]),
    ("mosquito-wings", 90, [&[], &[], &[]]),
    ("mouse-molars", 30, [&[], &[], &[]]),
    ("mouse-vertebrae", 53, [&[2, 5, 9], &[5, 9], &[5, 9]]),
    ("mpeg7", 910, [&[102, 500, 777, 832, 834, 836], &[426, 836, 837], &[]]),
    ("north-sea-fish", 218, [&[], &[], &[]]),
    ("olive-stones", 210, [&[], &[], &[]]),
    (
        "osteosarcoma-cells",
        454,
        [
            &[
                19, 43, 50, 64, 95, 105, 127, 136, 139, 197, 204, 209, 216, 220, 226, 234, 243, 249, 260,
                283, 285, 294, 298, 301, 302, 305, 320, 324, 333, 337, 338, 342, 365, 417, 424, 425, 432,
                436,
            ],
            &[43, 50, 105, 139, 220, 234, 260, 305, 338],
            &[50, 105, 139, 234, 338],
        ],
    ),
    ("otoliths", 113, [&[72], &[], &[]]),
    ("trilobite-heads", 50, [&[], &[], &[]]),
];

/// Contours of a data set in a folder beside the checkout; `None` without it.
fn contours(set: &str) -> Option<Vec<Matrix>> {
    let file = PathBuf::from(env!("CARGO_MANIFEST_DIR"))
        .join(format!("../../../shared/data/curves-{set}/curves.ndjson"));
    let text = std::fs::read_to_string(file).ok()?;
    let contour = |line: &str| {
        let record: Value = serde_json::from_str(line).unwrap();
        let mut rows: Vec<Vec<f64>> = list(&record["points"]).iter().map(numbers).collect();
        rows.dedup();
        Contour::closed(Matrix::from_fn(rows.len(), 2, |i, c| rows[i][c])).unwrap().sample(50, 0.0)
    };
    Some(text.lines().map(contour).collect())
}

#[test]
fn contours_of_data_sets_have_the_same_lengths_and_crossings() {
    for (set, count, crossing) in CROSSING {
        let Some(contours) = contours(set) else {
            println!("SKIPPED: there is no data set {set}");
            continue;
        };
        assert_eq!(contours.len(), count, "{set}");
        for (kind, expected) in GENERATORS.iter().zip(crossing) {
            let space = closed(kind, 50, 2).unwrap();
            let crosses = |i: &usize| assert_sizes(&format!("{set} {i}, {kind:?}"), &space, &contours[*i]);
            let found: Vec<usize> = (0..count).filter(crosses).collect();
            assert_eq!(found, expected, "{set}, {kind:?}");
        }
    }
}
