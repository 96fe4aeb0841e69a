//! Least-squares fits, idealised curves and the basis of open curves.

use std::f64::consts::TAU;

use proptest::prelude::*;
use shapelex_geometry::GeometryError;
use shapelex_geometry::curve::Curve;
use shapelex_geometry::fit::{Fit, Samples};
use shapelex_geometry::generator::phantoms;
use shapelex_geometry::generator::{Family, GeneratorKind, PoleList};
use shapelex_geometry::ideal::{IdealCurve, Position};
use shapelex_geometry::open::open_gram;
use shapelex_geometry::representation::{Representation, ShapeSpace};
use shapelex_numeric::dense::Matrix;

use crate::spaces::{Noise, assert_relative, closed, grid, interpolator, open, random_curve, trace};
use crate::vectors::assert_close;

/// Increasing parameters, each up to 0.35 of a step off an even grid; open ones from end to end.
fn uneven(count: usize, closed: bool, seed: u64) -> Vec<f64> {
    let mut noise = Noise(seed);
    let steps = if closed { count } else { count - 1 } as f64;
    let at = |i: usize, noise: f64| match i {
        _ if closed => (i as f64 + 0.5 + 0.35 * noise) / steps,
        0 => 0.0,
        i if i + 1 == count => 1.0,
        i => (i as f64 + 0.35 * noise) / steps,
    };
    (0..count).map(|i| at(i, noise.next())).collect()
}

/// The points of a curve at `parameters`, one a row.
fn points_at(curve: &Curve, parameters: &[f64]) -> Matrix {
    Matrix::from_row_slice(parameters.len(), curve.dimension(), &trace(curve, parameters))
}

fn samples_of(curve: &Curve, parameters: Vec<f64>) -> Samples {
    Samples::new(points_at(curve, &parameters), parameters, curve.is_closed()).unwrap()
}

/// Both kinds of curves with `count` control points or intervals.
fn spaces(kind: &GeneratorKind, count: usize) -> [ShapeSpace; 2] {
    [closed(kind, count, 2).unwrap(), open(kind, count, 3).unwrap()]
}

/// The curve keeps all its digits. Control points lose what the normal equations square: the phantoms of open curves
/// hang on few points near the ends, up to `5·10⁻¹²` for degree 5.
#[test]
fn curves_of_the_space_are_fitted_exactly() {
    for (i, kind) in GeneratorKind::catalogue().iter().enumerate() {
        for (count, more) in [(3, 0), (5, 3), (9, 10), (20, 41)] {
            if count < kind.properties().fewest_intervals {
                continue;
            }
            for space in spaces(kind, count) {
                let size = space.representation().size();
                let more = if space.representation().is_closed() { more } else { more + size };
                let (points, curve) = random_curve(&space, i as u64);
                let parameters = uneven(size + more, curve.is_closed(), count as u64);
                let what = format!("{kind:?}, {count} from {}", parameters.len());
                let fit =
                    samples_of(&curve, parameters).fit(&space).unwrap_or_else(|e| panic!("{what}: {e}"));
                assert_eq!(fit.representation, *space.representation());
                let found = Curve::of(&space, &fit.control_points).unwrap();
                let at = grid(300);
                assert_close(&what, &trace(&found, &at), &trace(&curve, &at), 1e-13);
                assert!(fit.residual <= fit.largest && fit.largest <= 1e-13, "{what}: {}", fit.largest);
                assert_close(&what, fit.control_points.as_slice(), points.as_slice(), 5e-11);
            }
        }
    }
}

/// `w_i` is half the distance of the neighbours, over the whole.
fn weights_of(parameters: &[f64], closed: bool) -> Vec<f64> {
    let count = parameters.len();
    let at = |i: isize| match i {
        -1 if closed => parameters[count - 1] - 1.0,
        i if i as usize == count && closed => parameters[0] + 1.0,
        i => parameters[i.clamp(0, count as isize - 1) as usize],
    };
    let spans: Vec<f64> = (0..count as isize).map(|i| at(i + 1) - at(i - 1)).collect();
    let total: f64 = spans.iter().sum();
    spans.iter().map(|span| span / total).collect()
}

/// The residual is the weighted one, and orthogonal to every basis function: the fit is the minimiser.
#[test]
fn residuals_are_weighted_and_orthogonal() {
    let mut noise = Noise(7);
    for kind in GeneratorKind::catalogue() {
        for space in spaces(&kind, 6) {
            let closed = space.representation().is_closed();
            let (parameters, dimension) = (uneven(40, closed, 11), space.representation().dimension());
            let points = noise.matrix(40, dimension);
            let fit = Samples::new(points.clone(), parameters.clone(), closed).unwrap().fit(&space).unwrap();
            let weights = weights_of(&parameters, closed);
            let curve = Curve::of(&space, &fit.control_points).unwrap();
            let difference = points_at(&curve, &parameters) - points;
            let squares: Vec<f64> = difference.row_iter().map(|row| row.norm_squared()).collect();
            let sum: f64 = squares.iter().zip(&weights).map(|(s, w)| s * w).sum();
            let largest = squares.iter().copied().fold(0.0, f64::max).sqrt();
            assert_close(&format!("{kind:?}"), &[fit.residual, fit.largest], &[sum.sqrt(), largest], 1e-13);
            for k in 0..fit.control_points.nrows() {
                let unit = Matrix::from_fn(fit.control_points.nrows(), 1, |i, _| f64::from(i == k));
                let generator = space.generator().unwrap();
                let basis =
                    if closed { Curve::closed(generator, &unit) } else { Curve::open(generator, &unit) };
                let values = trace(&basis, &parameters);
                let products = (0..dimension)
                    .map(|c| -> f64 { (0..40).map(|i| weights[i] * values[i] * difference[(i, c)]).sum() });
                let products: Vec<f64> = products.collect();
                assert_close(&format!("{kind:?}, φ_{k}"), &products, &vec![0.0; dimension], 1e-12);
            }
        }
    }
}

#[test]
fn points_that_do_not_determine_a_curve_are_refused() {
    for kind in GeneratorKind::catalogue() {
        for space in spaces(&kind, 12) {
            let closed = space.representation().is_closed();
            let (needed, dimension) = (space.representation().size(), space.representation().dimension());
            let zeros = |rows| Matrix::zeros(rows, dimension);
            let few = Samples::new(zeros(needed - 1), uneven(needed - 1, closed, 1), closed).unwrap();
            let refusal = few.fit(&space).unwrap_err();
            assert_eq!(refusal, GeometryError::TooFewPoints { found: needed - 1, needed }, "{kind:?}");
            // all in the first quarter: three segments see at most nine control points
            let crowded: Vec<f64> = uneven(60, true, 1).iter().map(|u| u / 4.0).collect();
            let refusal = Samples::new(zeros(60), crowded, closed).unwrap().fit(&space).unwrap_err();
            assert_eq!(refusal, GeometryError::Undetermined { points: 60, needed }, "{kind:?}");
        }
    }
    let landmarks = ShapeSpace::new(&Representation::Landmarks { dimension: 2, points: 5 }).unwrap();
    let samples = Samples::new(Matrix::zeros(9, 2), uneven(9, true, 1), true).unwrap();
    assert_eq!(samples.fit(&landmarks).unwrap_err(), GeometryError::NotACurve);
}

#[test]
fn parameters_must_increase_within_the_domain() {
    let refusal = |parameters: &[f64], closed| {
        Samples::new(Matrix::zeros(parameters.len(), 2), parameters.to_vec(), closed).map(|_| ())
    };
    let wrong = |index, value| Err(GeometryError::Parameter { index, value });
    assert_eq!(refusal(&[0.0, 0.5, 0.9], true), Ok(()));
    assert_eq!(refusal(&[0.0, 0.5, 1.0], false), Ok(()));
    assert_eq!(refusal(&[0.0, 0.5, 1.0], true), wrong(2, 1.0));
    assert_eq!(refusal(&[-0.1, 0.5], true), wrong(0, -0.1));
    assert_eq!(refusal(&[0.2, 0.2, 0.4], false), wrong(1, 0.2));
    assert_eq!(refusal(&[0.2, 0.4, 0.3], true), wrong(2, 0.3));
    assert_eq!(refusal(&[0.2, 1.5], false), wrong(1, 1.5));
    assert!(matches!(refusal(&[0.2, f64::NAN], false), Err(GeometryError::Parameter { index: 1, .. })));
}

/// A bean, as 400 uneven points of a closed or open curve.
fn bean(closed: bool) -> Samples {
    let parameters = uneven(400, closed, 3);
    let at = |u: f64| {
        let t = TAU * u;
        [2.0 * t.cos() + 0.5 * (2.0 * t).cos() + 0.1 * (5.0 * t).sin(), t.sin() + 0.3 * (3.0 * t).sin()]
    };
    Samples::new(Matrix::from_fn(400, 2, |i, c| at(parameters[i])[c]), parameters, closed).unwrap()
}

fn fit_with(samples: &Samples, representation: &Representation, count: usize) -> Fit {
    samples.fit(&ShapeSpace::new(&representation.with_count(count)).unwrap()).unwrap()
}

/// Within the tolerance, while one less is not; a scan of all sizes finds at most 2 fewer on a smooth contour.
#[test]
fn tolerances_are_reached_with_few_control_points() {
    let kinds =
        [GeneratorKind::Trigonometric {}, GeneratorKind::Cubic {}, GeneratorKind::Bspline { degree: 3 }];
    for (kind, closed_curve) in kinds.iter().flat_map(|kind| [(kind, true), (kind, false)]) {
        let samples = bean(closed_curve);
        let [first, second] = spaces(kind, 5);
        let representation = if closed_curve { first } else { second }.representation().clone();
        for tolerance in [0.3, 0.03, 1e-3, 1e-4] {
            let what = format!("{kind:?}, {tolerance}");
            let fit = samples.fit_within(&representation, tolerance, 200).unwrap();
            let count = fit.representation.count();
            assert!(fit.residual <= tolerance, "{what}: {}", fit.residual);
            let repeated = fit_with(&samples, &representation, count);
            assert_eq!((repeated.residual, repeated.control_points), (fit.residual, fit.control_points));
            let fewest = representation.fewest();
            if count > fewest {
                assert!(fit_with(&samples, &representation, count - 1).residual > tolerance, "{what}");
            }
            let least = (fewest..).find(|&n| fit_with(&samples, &representation, n).residual <= tolerance);
            assert!(least.unwrap() + 2 >= count, "{what}: {count}, the least is {least:?}");
        }
    }
}

#[test]
fn tolerances_out_of_reach_name_the_best_residual() {
    let samples = bean(true);
    let representation = closed(&GeneratorKind::Cubic {}, 5, 2).unwrap().representation().clone();
    match samples.fit_within(&representation, 1e-9, 50).unwrap_err() {
        GeometryError::Tolerance { tolerance, residual, count, most } => {
            assert_eq!((tolerance, count, most), (1e-9, 50, 50));
            assert_eq!(residual, fit_with(&samples, &representation, 50).residual);
        }
        other => panic!("{other}"),
    }
    let noise = Noise(1).matrix(20, 2);
    let few = Samples::new(noise, uneven(20, true, 1), true).unwrap();
    let refusal = few.fit_within(&representation, 1e-6, 10).unwrap_err();
    assert!(matches!(refusal, GeometryError::Tolerance { most: 10, .. }), "{refusal}");
    // as many control points as points interpolate
    assert_eq!(few.fit_within(&representation, 1e-6, 1000).unwrap().representation.count(), 20);
    let two = Samples::new(Matrix::zeros(2, 2), vec![0.1, 0.2], true).unwrap();
    let refusal = two.fit_within(&representation, 1.0, 1000).unwrap_err();
    assert_eq!(refusal, GeometryError::TooFewPoints { found: 2, needed: 3 });
}

/// Every generator that contains a curve: exactly its poles as a B-spline (with one more zero, too), and both families
/// of interpolators, which need three.
fn generators_of(curve: &IdealCurve, position: &Position) -> Vec<GeneratorKind> {
    let poles = curve.domain_poles(position);
    let with_zeros = |fewest: usize| {
        let mut list = poles.clone();
        list.resize(poles.len().max(fewest), [0.0, 0.0]);
        PoleList::from_domain(&list)
    };
    vec![
        GeneratorKind::Exponential { poles: with_zeros(2) },
        GeneratorKind::Exponential { poles: with_zeros(poles.len() + 1) },
        interpolator(Family::IntegerShifts, with_zeros(3)),
        interpolator(Family::HalfIntegerShifts, with_zeros(3)),
    ]
}

fn placed(curve: &IdealCurve, position: &Position, u: f64) -> [f64; 2] {
    let [x, y] = curve.at(u);
    let (s, c) = position.angle.sin_cos();
    [c * x - s * y + position.centre[0], s * x + c * y + position.centre[1]]
}

fn ideal_curves() -> Vec<IdealCurve> {
    let mut curves = IdealCurve::catalogue();
    curves.extend([
        IdealCurve::Circle { radius: 0.01 },
        IdealCurve::Ellipse { semi_axes: [0.5, 3.0] },
        IdealCurve::Line { from: [1.0, -2.0], to: [-0.5, 3.0] },
        IdealCurve::Parabola { focal_length: 1.5, extent: 2.0 },
        IdealCurve::Hyperbola { semi_axes: [2.0, 0.5], extent: 2.0 },
        IdealCurve::Lissajous { amplitudes: [2.0, 1.0], frequencies: [3, 2], phase: 0.7 },
        IdealCurve::Lissajous { amplitudes: [2.0, 1.0], frequencies: [2, 2], phase: 0.7 },
    ]);
    curves
}

/// At 200 parameters, to `10⁻¹²` of the largest coordinate.
fn assert_reproduced(curve: &IdealCurve, position: &Position, space: &ShapeSpace) {
    let what = format!("{curve:?} at {position:?} in {:?}", space.representation());
    assert_eq!(curve.missing(position, space), [], "{what}");
    let points = curve.control_points(position, space);
    let found = Curve::of(space, &points).unwrap();
    let parameters = grid(200);
    let planar = |u: &f64| found.evaluate(*u, 0)[..2].to_vec();
    let wanted: Vec<f64> = parameters.iter().flat_map(|&u| placed(curve, position, u)).collect();
    assert_close(&what, &parameters.iter().flat_map(planar).collect::<Vec<f64>>(), &wanted, 1e-12);
    if found.dimension() == 3 {
        assert!(parameters.iter().all(|&u| found.evaluate(u, 0)[2] == 0.0), "{what}");
    }
}

#[test]
fn idealised_curves_are_reproduced() {
    for curve in ideal_curves() {
        assert_eq!(curve.fault(), None);
        let positions = [Position::default(), Position { centre: [3.0, -1.0], angle: 0.4 }];
        for position in positions {
            for kind in generators_of(&curve, &position) {
                assert_eq!(kind.faults(), [], "{kind:?}");
                let fewest = kind.properties().fewest_intervals.max(3);
                for count in [fewest, fewest + 4, 3 * fewest] {
                    let [on_closed, on_open] = spaces(&kind, count);
                    assert_reproduced(&curve, &position, &on_open);
                    if curve.is_closed() {
                        assert_reproduced(&curve, &position, &on_closed);
                    }
                }
            }
        }
    }
}

#[test]
fn missing_poles_are_named() {
    let space = |kind: &GeneratorKind| closed(kind, 9, 2).unwrap();
    let (here, away) = (Position::default(), Position { centre: [1.0, 0.0], angle: 0.0 });
    let keys = space(&GeneratorKind::Cubic {});
    let trigonometric = space(&GeneratorKind::Trigonometric {});
    let circle = IdealCurve::Circle { radius: 1.0 };
    assert_eq!(circle.missing(&here, &keys), [([0.0, TAU], 1)]);
    assert_eq!(circle.missing(&away, &keys), [([0.0, TAU], 1)]);
    assert_eq!(circle.missing(&away, &trigonometric), []);
    let line = IdealCurve::Line { from: [0.0, 0.0], to: [1.0, 1.0] };
    assert_eq!(line.missing(&away, &trigonometric), [([0.0, 0.0], 2)]);
    assert_eq!(line.missing(&away, &keys), []);
    let parabola = IdealCurve::Parabola { focal_length: 1.0, extent: 1.0 };
    assert_eq!(parabola.missing(&here, &trigonometric), [([0.0, 0.0], 3)]);
    let hyperbola = IdealCurve::Hyperbola { semi_axes: [1.0, 1.0], extent: 1.5 };
    assert_eq!(hyperbola.missing(&here, &keys), [([3.0, 0.0], 1)]);
    let lissajous = IdealCurve::Lissajous { amplitudes: [1.0, 1.0], frequencies: [1, 2], phase: 0.0 };
    assert_eq!(lissajous.missing(&here, &trigonometric), [([0.0, 2.0 * TAU], 1)]);
    let pair = PoleList::from_domain(&[[0.0, TAU], [0.0, -TAU]]);
    let without_zero = space(&GeneratorKind::Exponential { poles: pair });
    assert_eq!(circle.missing(&here, &without_zero), []);
    assert_eq!(circle.missing(&away, &without_zero), [([0.0, 0.0], 1)]);
}

/// Interpolation passes through the points, whether the generator interpolates or not, also where `φ(0) ≠ 1` alone
/// keeps it from doing so: two poles that are not zero.
#[test]
fn curves_pass_through_their_points() {
    let mut kinds = GeneratorKind::catalogue();
    for pair in [[[0.0, TAU], [0.0, -TAU]], [[3.0, 0.0], [-3.0, 0.0]]] {
        kinds.push(GeneratorKind::Exponential { poles: PoleList::from_domain(&pair) });
    }
    for kind in kinds {
        for space in spaces(&kind, 7) {
            let representation = space.representation();
            let points = Noise(5).matrix(representation.point_count(), representation.dimension());
            let curve = Curve::of(&space, &space.interpolate(points.clone()).unwrap()).unwrap();
            let found = curve.sample(points.nrows()).concat();
            assert_close(&format!("{kind:?}"), &found, points.transpose().as_slice(), 1e-12);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Rows away from the ends see whole generators: `M^{2d−1} a_dd[l − k]`. With constants, `1ᵀΦ1 = ∫ 1 = 1`, and
    /// derivatives vanish.
    #[test]
    fn open_grams_are_toeplitz_inside(
        kind in prop::sample::select(GeneratorKind::catalogue()),
        intervals in 3_usize..40,
    ) {
        let generator = kind.build(intervals).unwrap().generator.clone();
        let (support, first) = (generator.support(), phantoms(generator.support()));
        let size = intervals + 1 + 2 * first;
        for d in 0..=1 {
            let gram = open_gram(&generator, intervals, d);
            let scale = (intervals as f64).powi(2 * d as i32 - 1);
            let whole = |row: usize| {
                let k = row as f64 - first as f64;
                k >= support as f64 / 2.0 && k <= intervals as f64 - support as f64 / 2.0
            };
            let mut sum = 0.0;
            for i in 0..size {
                for j in 0..size {
                    sum += gram.get(i, j);
                    if whole(i) || whole(j) {
                        let wanted = generator.correlation(d, d, j as isize - i as isize);
                        assert_close("entry", &[gram.get(i, j) / scale], &[wanted], 1e-14);
                    }
                    let mirrored = gram.get(size - 1 - i, size - 1 - j);
                    assert_close("persymmetric", &[gram.get(i, j) / scale], &[mirrored / scale], 1e-14);
                }
            }
            assert_close("sum", &[sum / scale.max(1.0)], &[if d == 0 { 1.0 } else { 0.0 }], 1e-12);
        }
    }

    /// The prepared operator is the integral: `tr(cᵀΦc) = ∫ |r|²` by the distance to the zero curve.
    #[test]
    fn spaces_have_the_norm_of_their_curves(
        kind in prop::sample::select(GeneratorKind::catalogue()),
        intervals in 3_usize..20,
        seed in any::<u64>(),
    ) {
        prop_assume!(intervals >= kind.properties().fewest_intervals);
        for space in spaces(&kind, intervals) {
            let (points, curve) = random_curve(&space, seed);
            let zero = Curve::of(&space, &(0.0 * &points)).unwrap();
            let mut image = points.clone();
            space.gram().apply(image.as_mut_slice());
            let norm = shapelex_geometry::distance::l2(&curve, &zero);
            assert_relative("norm", points.dot(&image).sqrt(), norm, 1e-12);
        }
    }
}
