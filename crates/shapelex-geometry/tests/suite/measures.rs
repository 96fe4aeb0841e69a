//! Distances, turning, moments, energies and frames of curves against closed forms and fine sums.

use std::f64::consts::{PI, TAU};
use std::time::{Duration, Instant};

use proptest::prelude::*;
use shapelex_geometry::curve::Curve;
use shapelex_geometry::distance::{Distances, l2, symmetric};
use shapelex_geometry::frame::Frame;
use shapelex_geometry::generator::{GeneratorKind, PoleList};
use shapelex_geometry::measures::CurveMeasures;
use shapelex_geometry::total_curvature::Turning;
use shapelex_numeric::bounded::never;
use shapelex_numeric::dense::Matrix;

use crate::spaces::{assert_relative, closed, open, random_curve};
use crate::vectors::assert_close;

const TRIGONOMETRIC: GeneratorKind = GeneratorKind::Trigonometric {};

/// The closed curve through `f(2πk/n)`.
fn closed_through<const D: usize>(kind: &GeneratorKind, n: usize, f: impl Fn(f64) -> [f64; D]) -> Curve {
    let space = closed(kind, n, D).unwrap();
    let points = Matrix::from_fn(n, D, |k, c| f(TAU * k as f64 / n as f64)[c]);
    Curve::of(&space, &space.interpolate(points).unwrap()).unwrap()
}

/// The open curve through `f(k/m)`.
fn open_through<const D: usize>(kind: &GeneratorKind, m: usize, f: impl Fn(f64) -> [f64; D]) -> Curve {
    let space = open(kind, m, D).unwrap();
    let points = Matrix::from_fn(m + 1, D, |k, c| f(k as f64 / m as f64)[c]);
    Curve::of(&space, &space.interpolate(points).unwrap()).unwrap()
}

fn ellipse(n: usize, a: f64, b: f64, centre: [f64; 2], angle: f64) -> Curve {
    let (s, c) = angle.sin_cos();
    closed_through(&TRIGONOMETRIC, n, |t| {
        let (x, y) = (a * t.cos(), b * t.sin());
        [c * x - s * y + centre[0], s * x + c * y + centre[1]]
    })
}

fn circle(n: usize, radius: f64, centre: [f64; 2]) -> Curve {
    ellipse(n, radius, radius, centre, 0.0)
}

/// Nearest distances are found to `10⁻¹¹` of a half-segment's box, here about 2 wide; `l2` errs by rounding alone.
#[test]
fn concentric_circles_are_as_far_as_their_radii() {
    for (n, m) in [(3, 3), (5, 8), (12, 7)] {
        let found = Distances::of(&circle(n, 1.0, [0.3, 0.2]), &circle(m, 2.0, [0.3, 0.2]));
        let what = format!("{n} and {m}: {found:?}");
        assert_close(&what, &[found.l2], &[1.0], 1e-13);
        assert_close(&what, &[found.symmetric, found.hausdorff], &[1.0, 1.0], 2e-11);
    }
}

#[test]
fn a_moved_circle_is_as_far_as_it_moved() {
    let (here, there) = (circle(6, 1.0, [0.0, 0.0]), circle(6, 1.0, [0.3, -0.4]));
    let found = Distances::of(&here, &there);
    assert_close("l2", &[found.l2], &[0.5], 1e-13);
    assert_close("Hausdorff", &[found.hausdorff], &[0.5], 2e-11);
    // (| |p − c| − 1 |)² in the mean over the unit circle
    let mean = (0..100_000)
        .map(|i| TAU * f64::from(i) / 100_000.0)
        .map(|t| (f64::hypot(t.cos() - 0.5, t.sin()) - 1.0).powi(2))
        .sum::<f64>()
        / 100_000.0;
    assert_relative("symmetric", found.symmetric, mean.sqrt(), 1e-6);
}

/// From the centre all points of a circle are equally far: no part of it can be ruled out by a nearer one.
#[test]
fn the_centre_of_a_circle_has_a_nearest_point_soon() {
    let (circle, begin) = (ellipse(4, 1.0, 1.0, [0.0, 0.0], 0.0), Instant::now());
    // There and back between the centre and 0.6.
    let segment = ellipse(8, 0.3, 0.0, [0.3, 0.0], 0.0);
    let found = Distances::of(&segment, &circle);
    assert_close("Hausdorff", &[found.hausdorff], &[1.0], 2e-11);
    // 10⁶ stretches were looked at for each of a hundred points: a minute; now it is a thousandth of a second.
    assert!(begin.elapsed() < Duration::from_secs(5), "{:?}", begin.elapsed());
}

/// The parameter distance is exact across sizes: `∫ |(a − a') cos, (b − b') sin|² = ½ ((a − a')² + (b − b')²)`.
#[test]
fn l2_does_not_depend_on_the_sizes() {
    for (n, m) in [(3, 3), (5, 8), (30, 7)] {
        let (r, s) = (ellipse(n, 2.0, 1.0, [0.0; 2], 0.0), ellipse(m, 1.5, 1.25, [0.0; 2], 0.0));
        assert_close("ellipses", &[l2(&r, &s)], &[(0.5_f64 * (0.25 + 0.0625)).sqrt()], 1e-14);
        let same = ellipse(m, 2.0, 1.0, [0.0; 2], 0.0);
        assert!(l2(&r, &same) <= 1e-14, "{}", l2(&r, &same));
    }
}

/// To `10⁻¹¹` of a half-segment's box; random control points make sharp bends and crossings.
#[test]
fn identical_curves_have_no_distance() {
    for kind in GeneratorKind::catalogue() {
        for space in [closed(&kind, 9, 2).unwrap(), open(&kind, 9, 3).unwrap()] {
            let (_, curve) = random_curve(&space, 3);
            let found = Distances::of(&curve, &curve);
            assert_eq!(found.l2, 0.0, "{kind:?}");
            assert!(found.symmetric <= 2e-11 && found.hausdorff <= 2e-11, "{kind:?}: {found:?}");
        }
    }
}

/// Distances of two samples of 4000 points, from all of them.
fn brute_force(r: &Curve, s: &Curve) -> [f64; 2] {
    let (a, b) = (r.sample(4000), s.sample(4000));
    let square = |p: &[f64], q: &[f64]| (p[0] - q[0]).powi(2) + (p[1] - q[1]).powi(2);
    let one_way = |from: &Curve, a: &[Vec<f64>], b: &[Vec<f64>]| {
        let speeds = from.parameters(4000).into_iter().map(|u| {
            let v = from.evaluate(u, 1);
            v[0].hypot(v[1])
        });
        let (mut sum, mut length, mut largest) = (0.0, 0.0, 0.0_f64);
        for (p, speed) in a.iter().zip(speeds) {
            let nearest = b.iter().map(|q| square(p, q)).fold(f64::MAX, f64::min);
            (sum, length, largest) = (sum + speed * nearest, length + speed, largest.max(nearest));
        }
        (sum / length, largest)
    };
    let (there, back) = (one_way(r, &a, &b), one_way(s, &b, &a));
    [(0.5 * (there.0 + back.0)).sqrt(), there.1.max(back.1).sqrt()]
}

/// Steps of the samples are about `3·10⁻³`: their nearest points are too far by its square at most, the trapezoidal
/// mean of an open curve errs by half a step at the ends.
#[test]
fn distances_equal_brute_force() {
    for (i, kind) in GeneratorKind::catalogue().iter().enumerate() {
        let seed = i as u64;
        let (_, r) = random_curve(&closed(kind, 6, 2).unwrap(), seed);
        let (_, s) = random_curve(&closed(&TRIGONOMETRIC, 5, 2).unwrap(), seed + 100);
        let found = Distances::of(&r, &s);
        let wanted = brute_force(&r, &s);
        assert_close(&format!("{kind:?}"), &[found.symmetric, found.hausdorff], &wanted, 1e-3);
        let swapped = Distances::of(&s, &r);
        assert_close(
            &format!("{kind:?} swapped"),
            &[swapped.l2, swapped.symmetric, swapped.hausdorff],
            &[found.l2, found.symmetric, found.hausdorff],
            1e-14,
        );
    }
}

/// Fewer quadrature nodes than those of [`Distances`], about as many for a whole curve of any length: outlines near each other to 1e-4.
/// Random curves cross each other and themselves everywhere, so that their nearest points jump between most nodes.
#[test]
fn the_symmetric_distance_alone_is_that_of_all_distances() {
    let outline = |kind: &GeneratorKind, count: usize, phase: f64| {
        closed_through(kind, count, |t| {
            let radius =
                10.0 + (3.0 * t + phase).cos() + 0.5 * (7.0 * t).sin() + 0.3 * (11.0 * t - phase).cos();
            [radius * t.cos(), 0.7 * radius * t.sin()]
        })
    };
    for (seed, count) in [(1, 8), (2, 20), (3, 50), (4, 100), (5, 150)] {
        for kind in [TRIGONOMETRIC, GeneratorKind::Cubic {}] {
            let random = |seed| random_curve(&closed(&kind, count, 2).unwrap(), seed).1;
            let outlines = [outline(&kind, count, 0.0), outline(&kind, count, seed as f64)];
            for (tolerance, [r, s]) in [(1e-4, outlines), (2e-2, [random(seed), random(seed + 100)])] {
                let (all, alone) = (Distances::of(&r, &s).symmetric, symmetric(&r, &s));
                assert_relative(&format!("{kind:?} of {count} points"), alone, all, tolerance);
            }
        }
    }
}

fn turning(curve: &Curve) -> [f64; 2] {
    let turning = Turning::of(curve, &never).unwrap();
    [turning.total, turning.signed]
}

#[test]
fn convex_curves_turn_once() {
    for n in [3, 5, 20] {
        assert_close("circle", &turning(&circle(n, 3.0, [1.0, 2.0])), &[TAU, TAU], 1e-13);
        assert_close("ellipse", &turning(&ellipse(n, 5.0, 1.0, [0.0; 2], 0.3)), &[TAU, TAU], 1e-13);
        let backwards = closed_through(&TRIGONOMETRIC, n, |t| [t.cos(), -t.sin()]);
        assert_close("backwards", &turning(&backwards), &[TAU, -TAU], 1e-13);
    }
    let twice = closed_through(&GeneratorKind::Cubic {}, 40, |t| [(2.0 * t).cos(), (2.0 * t).sin()]);
    assert_close("twice", &turning(&twice), &[2.0 * TAU, 2.0 * TAU], 1e-12);
}

/// `Σ |Δθ|` and `Σ Δθ` over fine steps, off by the square of a step: `steps` a multiple of the half-segments, so that
/// no step cuts the corner that a jump of the curvature makes in the curve of tangents.
fn fine_turning(curve: &Curve, steps: usize) -> [f64; 2] {
    let tangent = |i: usize| curve.evaluate(i as f64 / steps as f64, 1);
    let mut sums = [0.0, 0.0];
    let mut before = tangent(0);
    for i in 1..=steps {
        let after = tangent(i);
        let dot: f64 = before.iter().zip(&after).map(|(a, b)| a * b).sum();
        let angle = shapelex_geometry::frame::cross(&before, &after).atan2(dot);
        sums[0] += angle.abs();
        sums[1] += angle;
        before = after;
    }
    sums
}

#[test]
fn wavy_curves_turn_like_their_tangents() {
    let wavy = |t: f64| {
        let r = 1.0 + 0.3 * (5.0 * t).cos();
        [r * t.cos(), r * t.sin()]
    };
    for kind in GeneratorKind::catalogue() {
        if kind == (GeneratorKind::Bspline { degree: 1 }) {
            continue;
        }
        let curve = closed_through(&kind, 40, wavy);
        let [total, signed] = turning(&curve);
        let fine = fine_turning(&curve, 400_000);
        assert_close(&format!("{kind:?}"), &[total], &[fine[0]], 1e-7);
        assert_close(&format!("{kind:?}"), &[signed], &[TAU], 1e-12);
        assert!(total > 1.5 * TAU);
        let eight = closed_through(&kind, 24, |t| [t.sin(), t.sin() * t.cos()]);
        assert_close(&format!("{kind:?} eight"), &[turning(&eight)[1]], &[0.0], 1e-12);
        let measures = CurveMeasures::of(&curve);
        assert_eq!((measures.total_curvature, measures.turning), (Some(total), Some(signed)));
    }
}

/// The helix `(cos t, sin t, ct)` of one turn turns by `2π/√(1 + c²)`.
#[test]
fn space_curves_turn_without_sign() {
    let list = [[0.0, 0.0], [0.0, 0.0], [0.0, TAU], [0.0, -TAU]];
    let kind = GeneratorKind::Exponential { poles: PoleList::from_domain(&list) };
    let helix = open_through(&kind, 7, |u| [(TAU * u).cos(), (TAU * u).sin(), 0.5 * TAU * u]);
    assert_close("helix", &turning(&helix), &[TAU / 1.25_f64.sqrt(), 0.0], 1e-12);
    assert_relative("helix", CurveMeasures::of(&helix).length, TAU * 1.25_f64.sqrt(), 1e-12);
    let knot = |t: f64| {
        let r = 2.0 + (3.0 * t).cos();
        [r * (2.0 * t).cos(), r * (2.0 * t).sin(), (3.0 * t).sin()]
    };
    for kind in [TRIGONOMETRIC, GeneratorKind::Bspline { degree: 4 }] {
        let curve = closed_through(&kind, 60, knot);
        let fine = fine_turning(&curve, 240_000);
        let found = turning(&curve);
        assert_close("trefoil", &found, &[fine[0], 0.0], 1e-8);
        assert_eq!(CurveMeasures::of(&curve).turning, None);
    }
}

/// A plane curve turns as much in space, where inflections are kinks of the curvature.
#[test]
fn plane_curves_turn_alike_in_space() {
    let wave = |u: f64| [u, 0.1 * (TAU * u).sin() + 0.02 * (9.0 * u).cos()];
    for kind in [GeneratorKind::Cubic {}, GeneratorKind::Bspline { degree: 3 }] {
        let flat = turning(&open_through(&kind, 17, wave));
        let tilted = open_through(&kind, 17, |u| {
            let [x, y] = wave(u);
            [x, 0.6 * y, 0.8 * y]
        });
        let found = turning(&tilted);
        assert_close("tilted", &found, &[flat[0], 0.0], 1e-10);
    }
}

#[test]
fn straight_lines_do_not_turn() {
    let along = |u: f64| [1.0 + 2.0 * u + u * u, 3.0 - 0.6 * (2.0 * u + u * u)];
    for kind in [GeneratorKind::Cubic {}, GeneratorKind::Bspline { degree: 3 }] {
        let line = open_through(&kind, 9, along);
        assert_close("line", &turning(&line), &[0.0, 0.0], 1e-12);
        assert_relative("line", CurveMeasures::of(&line).length, 3.0 * 1.36_f64.sqrt(), 1e-12);
    }
}

/// `(t², t³)` stops and returns at `t = 0`: inside a piece, and at a knot.
fn cusp(at: f64) -> Curve {
    open_through(&GeneratorKind::Bspline { degree: 3 }, 5, |u| [(u - at).powi(2), (u - at).powi(3)])
}

#[test]
fn corners_and_cusps_have_no_turning() {
    for at in [0.33, 0.4, 0.5] {
        assert_eq!(Turning::of(&cusp(at), &never), None, "{at}");
        let measures = CurveMeasures::of(&cusp(at));
        assert_eq!((measures.total_curvature, measures.turning), (None, None));
    }
    let polygon = closed_through(&GeneratorKind::Bspline { degree: 1 }, 5, |t| [t.cos(), t.sin()]);
    assert_eq!(Turning::of(&polygon, &never), None);
    assert_eq!(CurveMeasures::of(&polygon).bending_energy, None);
}

/// `∬ (x, y)ᵀ(x, y) = (πab/4) R diag(a², b²) Rᵀ` about the centre, whatever the direction.
#[test]
fn second_moments_of_an_ellipse() {
    let (a, b) = (2.0, 0.7);
    for (angle, sign) in [(0.0, 1.0), (0.6, 1.0), (2.0, -1.0)] {
        let (s, c) = f64::sin_cos(angle);
        let curve = ellipse(9, a, sign * b, [30.0, -7.0], angle);
        let enclosed = CurveMeasures::of(&curve).enclosed.unwrap();
        assert_close("area", &[enclosed.signed_area], &[sign * PI * a * b], 1e-13);
        let (xx, yy) = (0.25 * PI * a.powi(3) * b, 0.25 * PI * a * b.powi(3));
        let wanted = [c * c * xx + s * s * yy, c * s * (xx - yy), s * s * xx + c * c * yy];
        let [[fxx, fxy], [fyx, fyy]] = enclosed.second_moments.unwrap();
        assert_eq!(fxy, fyx);
        assert_close("moments", &[fxx, fxy, fyy], &wanted, 1e-12);
    }
    let eight = closed_through(&TRIGONOMETRIC, 24, |t| [t.sin(), t.sin() * t.cos()]);
    assert_eq!(CurveMeasures::of(&eight).enclosed.unwrap().second_moments, None);
}

/// `∫ |r'|² = (2πR)²`, `∫ |r''|² = (2π)⁴R²`.
#[test]
fn energies_of_a_circle() {
    for n in [3, 5, 50] {
        let measures = CurveMeasures::of(&circle(n, 1.5, [4.0, 4.0]));
        assert_relative("stretching", measures.stretching_energy, (TAU * 1.5).powi(2), 1e-12);
        assert_relative("bending", measures.bending_energy.unwrap(), TAU.powi(4) * 2.25, 1e-12);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    /// `S ↦ |det A| A S Aᵀ` for `r ↦ A r + b`.
    #[test]
    fn second_moments_are_covariant(
        seed in any::<u64>(),
        kind in prop::sample::select(GeneratorKind::catalogue()),
        a in prop::array::uniform4(-2.0..2.0),
        b in prop::array::uniform2(-5.0..5.0),
    ) {
        let space = closed(&kind, 7, 2).unwrap();
        let (points, curve) = random_curve(&space, seed);
        let a = Matrix::from_row_slice(2, 2, &a);
        prop_assume!(a.determinant().abs() > 0.1);
        let image = &points * a.transpose();
        let image = Matrix::from_fn(7, 2, |k, c| image[(k, c)] + b[c]);
        let of = |curve: &Curve| CurveMeasures::of(curve).enclosed.unwrap();
        let here = of(&curve);
        // about the centroid, which a small area moves far away
        prop_assume!(here.signed_area.abs() > 0.2);
        let matrix = |m: [[f64; 2]; 2]| Matrix::from_fn(2, 2, |i, j| m[i][j]);
        let wanted = &a * matrix(here.second_moments.unwrap()) * a.transpose() * a.determinant().abs();
        let found = matrix(of(&Curve::of(&space, &image).unwrap()).second_moments.unwrap());
        assert_close("moments", found.as_slice(), wanted.as_slice(), 1e-11);
    }

    /// On a circle the curvature is `1/R`, and the normal of a counter-clockwise one points to the centre.
    #[test]
    fn frames_of_a_circle(n in 3_usize..40, radius in 0.01..100.0, u in 0.0..1.0) {
        let frame = Frame::at(&circle(n, radius, [1.0, 2.0]), u);
        let (s, c) = (TAU * u).sin_cos();
        assert_close("tangent", &frame.tangent.unwrap(), &[-s, c], 1e-11);
        assert_close("normal", &frame.normal.unwrap(), &[-c, -s], 1e-11);
        assert_close("curvature", &[radius * frame.curvature.unwrap()], &[1.0], 1e-11);
        let clockwise = closed_through(&TRIGONOMETRIC, n, |t| [radius * t.cos(), -radius * t.sin()]);
        let frame = Frame::at(&clockwise, u);
        assert_close("clockwise", &[radius * frame.curvature.unwrap()], &[-1.0], 1e-11);
        assert_close("clockwise", &frame.normal.unwrap(), &[c, -s], 1e-11);
    }

    /// A tilted circle in space: the normal points to its centre, the curvature has no sign.
    #[test]
    fn frames_in_space(n in 3_usize..40, radius in 0.01..100.0, u in 0.0..1.0, tilt in 0.0..3.0) {
        let (s, c) = f64::sin_cos(tilt);
        let curve = closed_through(&TRIGONOMETRIC, n, |t| {
            [radius * t.cos(), radius * c * t.sin() + 1.0, radius * s * t.sin()]
        });
        let frame = Frame::at(&curve, u);
        let (sine, cosine) = (TAU * u).sin_cos();
        assert_close("tangent", &frame.tangent.unwrap(), &[-sine, c * cosine, s * cosine], 1e-11);
        assert_close("normal", &frame.normal.unwrap(), &[-cosine, -c * sine, -s * sine], 1e-11);
        assert_close("curvature", &[radius * frame.curvature.unwrap()], &[1.0], 1e-11);
    }
}

#[test]
fn frames_where_a_curve_stops_or_is_straight() {
    for at in [0.33, 0.4] {
        assert_eq!(Frame::at(&cusp(at), at), Frame::default(), "{at}");
        assert!(Frame::at(&cusp(at), 0.9).curvature.is_some());
    }
    let point = closed_through(&TRIGONOMETRIC, 5, |_| [1.0, 2.0]);
    assert_eq!(Frame::at(&point, 0.3), Frame::default());
    let line = open_through(&GeneratorKind::Cubic {}, 5, |u| [u, 2.0 * u, -2.0 * u]);
    let frame = Frame::at(&line, 0.37);
    assert_close("tangent", &frame.tangent.unwrap(), &[1.0 / 3.0, 2.0 / 3.0, -2.0 / 3.0], 1e-13);
    assert_eq!(frame.normal, None);
    assert_close("curvature", &[frame.curvature.unwrap()], &[0.0], 1e-12);
}
