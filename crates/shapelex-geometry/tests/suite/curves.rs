//! Curves against stored vectors, exact shapes, covariance laws and brute force.

use std::f64::consts::{PI, TAU};
use std::path::PathBuf;
use std::time::Instant;

use proptest::prelude::*;
use serde_json::Value;
use shapelex_geometry::curve::Curve;
use shapelex_geometry::generator::phantoms;
use shapelex_geometry::generator::{Family, Generator, GeneratorKind, PoleList};
use shapelex_geometry::intersection::self_intersects;
use shapelex_geometry::knot_line::gram_row;
use shapelex_geometry::measures::{CurveMeasures, Orientation, signed_area};
use shapelex_geometry::open::open_gram;
use shapelex_geometry::representation::{Representation, ShapeSpace};
use shapelex_geometry::resample::{Contour, rotate_start};
use shapelex_numeric::dense::Matrix;
use shapelex_numeric::operator::SymmetricOperator;
use shapelex_numeric::quadrature::GaussLegendre;

use crate::generators::generator_of;
use crate::spaces::{assert_relative, closed, interpolator, open};
use crate::vectors::{self, assert_close, list, load, matrix, number, numbers, text};

const TRIGONOMETRIC: GeneratorKind = GeneratorKind::Trigonometric {};

fn curve(kind: &GeneratorKind, points: &Matrix) -> Curve {
    Curve::closed(&kind.build(points.nrows()).unwrap().generator, points)
}

fn space(generator: &GeneratorKind, points: &Matrix) -> ShapeSpace {
    let generator = generator.clone();
    let (control_points, dimension) = points.shape();
    ShapeSpace::new(&Representation::ClosedCurve { dimension, control_points, generator }).unwrap()
}

/// `f(2πk/n)`, one row each.
fn points(n: usize, f: impl Fn(f64) -> [f64; 2]) -> Matrix {
    let rows: Vec<[f64; 2]> = (0..n).map(|k| f(TAU * k as f64 / n as f64)).collect();
    Matrix::from_fn(n, 2, |k, c| rows[k][c])
}

fn ellipse(n: usize, a: f64, b: f64, start: f64) -> Matrix {
    points(n, |t| [a * (t + start).cos(), b * (t + start).sin()])
}

/// `c ↦ c Aᵀ + b`.
fn map(points: &Matrix, a: [[f64; 2]; 2], b: [f64; 2]) -> Matrix {
    Matrix::from_fn(points.nrows(), 2, |k, c| a[c][0] * points[(k, 0)] + a[c][1] * points[(k, 1)] + b[c])
}

fn similarity(scale: f64, angle: f64) -> [[f64; 2]; 2] {
    let (s, c) = angle.sin_cos();
    [[scale * c, -scale * s], [scale * s, scale * c]]
}

fn reversed(points: &Matrix) -> Matrix {
    let (n, d) = points.shape();
    Matrix::from_fn(n, d, |k, c| points[((n - k) % n, c)])
}

/// `tr(cᵀ Φ c)`.
fn quadratic_form(operator: &dyn SymmetricOperator, points: &Matrix) -> f64 {
    let mut image = points.clone();
    operator.apply(image.as_mut_slice());
    points.dot(&image)
}

/// The same for the circulant of `row`, which need not be definite.
fn circulant_form(row: &[f64], points: &Matrix) -> f64 {
    let n = points.nrows();
    let pairs = (0..n).flat_map(|k| (0..n).map(move |l| (k, l)));
    pairs.map(|(k, l)| row[(l + n - k) % n] * points.row(k).dot(&points.row(l))).sum()
}

fn assert_rows(id: &str, curve: &Curve, rows: &Value) {
    for row in list(rows) {
        let u = number(&row[0]);
        for derivative in 0..=2 {
            let found = curve.evaluate(u, derivative);
            let wanted = numbers(&row[derivative + 1]);
            for (f, w) in found.iter().zip(&wanted) {
                let error = (f - w).abs() / w.abs().max(1.0);
                assert!(error <= 1e-12, "{id}, u = {u}, derivative {derivative}: {f} for {w}");
            }
        }
    }
}

/// `½ ∫ x dy − y dx` and `∫ x²/2 dy` of any planar curve, by Gauss' rule on every half-segment.
fn line_integrals(curve: &Curve) -> [f64; 2] {
    let rule = GaussLegendre::new(16);
    let at = |half, s, c, d| curve.derivative_at(half, c, s, d);
    let integral = |f: &dyn Fn(usize, f64) -> f64| -> f64 {
        0.25 * (0..curve.halves()).map(|half| rule.integrate(-1.0, 1.0, |s| f(half, s))).sum::<f64>()
    };
    [
        0.5 * integral(&|h, s| at(h, s, 0, 0) * at(h, s, 1, 1) - at(h, s, 1, 0) * at(h, s, 0, 1)),
        0.5 * integral(&|h, s| at(h, s, 0, 0).powi(2) * at(h, s, 1, 1)),
    ]
}

/// `tr(cᵀ Φ_d c)` of the `d`-th derivatives, `Φ_d` circulant or banded.
fn derivative_form(generator: &Generator, curve: &Curve, control_points: &Matrix, d: usize) -> f64 {
    let n = control_points.nrows();
    if curve.is_closed() {
        return circulant_form(&gram_row(generator, n, d, d), control_points);
    }
    let gram = open_gram(generator, curve.segments(), d);
    let pairs = (0..n).flat_map(|k| (0..n).map(move |l| (k, l)));
    pairs.map(|(k, l)| gram.get(k, l) * control_points.row(k).dot(&control_points.row(l))).sum()
}

fn assert_functionals(id: &str, generator: &Generator, curve: &Curve, control_points: &Matrix, case: &Value) {
    let wanted = &case["functionals"];
    let check = |name: &str, found: f64, tolerance: f64| match wanted.get(name) {
        Some(value) => assert_relative(&format!("{id} {name}"), found, number(value), tolerance),
        // corners have no second derivative, space curves no area
        None => assert!(name == "d2" && curve.smoothness() == 0 || curve.dimension() == 3, "{id} {name}"),
    };
    let measures = CurveMeasures::of(curve);
    check("length", measures.length, 1e-10);
    check("l2", derivative_form(generator, curve, control_points, 0), 1e-12);
    check("d1", derivative_form(generator, curve, control_points, 1), 1e-12);
    check("d1", measures.stretching_energy, 1e-12);
    if let Some(energy) = measures.bending_energy {
        check("d2", derivative_form(generator, curve, control_points, 2), 1e-12);
        check("d2", energy, 1e-12);
    } else {
        assert_eq!(wanted.get("d2"), None, "{id}");
    }
    if curve.dimension() == 2 {
        let [area, moment] = line_integrals(curve);
        check("half_int_x_dy_minus_y_dx", area, 1e-12);
        check("int_x2_dy_over_2", moment, 1e-12);
        // the area between the curve and its first point, and the triangle with the origin
        let (first, last) = (curve.evaluate(0.0, 0), curve.evaluate(1.0, 0));
        let triangle = 0.5 * (first[0] * last[1] - first[1] * last[0]);
        let swept = signed_area(curve) + triangle;
        check("half_int_x_dy_minus_y_dx", swept, 1e-12);
    }
    assert_eq!(measures.enclosed.is_some(), curve.is_closed() && curve.dimension() == 2, "{id}");
    if let Some(enclosed) = measures.enclosed {
        check("half_int_x_dy_minus_y_dx", enclosed.signed_area, 1e-12);
        let moment = enclosed.signed_area * enclosed.centroid.unwrap()[0];
        check("int_x2_dy_over_2", moment, 1e-12);
    }
}

#[test]
fn curves_equal_the_vectors() {
    let document = load("generators/curves.json");
    let mut counts = [0, 0];
    for case in vectors::cases(&document) {
        let (id, generator) = (text(&case["id"]), generator_of(case));
        let (control_points, closed) = (matrix(&case["control_points"]), case["closed"] == true);
        let curve = if closed {
            Curve::closed(&generator, &control_points)
        } else {
            assert_eq!(case["first_index"], -(phantoms(generator.support()) as i64), "{id}");
            Curve::open(&generator, &control_points)
        };
        assert_eq!(curve.segments() as u64, case["M"].as_u64().unwrap(), "{id}");
        assert_rows(id, &curve, &case["rows"]);
        assert_functionals(id, &generator, &curve, &control_points, case);
        counts[usize::from(closed)] += 1;
    }
    assert_eq!(counts, [6, 7]);
}

/// The prepared spaces give the same norm as the stored `∫ r·r`.
#[test]
fn the_space_has_the_norm_of_the_vectors() {
    let document = load("generators/curves.json");
    let kinds = [
        ("phi_M8_closed_M8_2D", TRIGONOMETRIC),
        ("phi_M3_closed_M3_2D", TRIGONOMETRIC),
        ("keys_closed_M7_3D", GeneratorKind::Cubic {}),
        ("cubic_closed_M9_2D", GeneratorKind::Bspline { degree: 3 }),
        ("linear_closed_M6_2D", GeneratorKind::Bspline { degree: 1 }),
    ];
    for (id, kind) in kinds {
        let case = vectors::cases(&document).iter().find(|case| case["id"] == id);
        let case = case.unwrap();
        let control_points = matrix(&case["control_points"]);
        let space = space(&kind, &control_points);
        let norm = quadratic_form(space.gram().as_ref(), &control_points);
        assert_relative(id, norm, number(&case["functionals"]["l2"]), 1e-12);
        let curve = Curve::of(&space, &control_points).unwrap();
        assert_rows(id, &curve, &case["rows"]);
    }
}

/// The space of a stored fit, its points, and the control points wanted.
fn fit_of(fit: &Value) -> (ShapeSpace, Matrix, Matrix) {
    let poles = PoleList::on_grid(&vectors::poles(&fit["poles"]).list());
    let points = matrix(&fit["points"]);
    let space = match text(&fit["type"]) {
        "prefilter_closed" => closed(&GeneratorKind::Exponential { poles }, points.nrows(), 2),
        "prefilter_open_not_a_knot" => open(&GeneratorKind::Exponential { poles }, points.nrows() - 1, 2),
        _ => open(&interpolator(Family::IntegerShifts, poles), points.nrows() - 1, 2),
    };
    let space = space.unwrap();
    if let Some(first) = fit.get("first_index") {
        assert_eq!(*first, -(phantoms(space.generator().unwrap().support()) as i64));
    }
    (space, points, matrix(&fit["control_points"]))
}

/// Pre-filters of closed and open curves (not-a-knot), and points beyond the ends by annihilation.
#[test]
fn interpolations_equal_the_vectors() {
    let document = load("generators/curves.json");
    let mut count = 0;
    for fit in list(&document["fits"]).iter().filter(|fit| fit["type"] != "resample_arclength") {
        let (space, points, wanted) = fit_of(fit);
        let what = format!("{} of {}", text(&fit["type"]), text(&fit["generator"]));
        let found = space.interpolate(points.clone()).unwrap();
        assert_eq!(found.shape(), wanted.shape(), "{what}");
        assert_close(&what, found.as_slice(), wanted.as_slice(), 1e-12);
        let curve = Curve::of(&space, &found).unwrap();
        let samples = curve.sample(points.nrows()).concat();
        assert_close(&what, &samples, points.transpose().as_slice(), 1e-13);
        count += 1;
    }
    assert_eq!(count, 9);
}

/// Named generators are the general ones with their poles.
#[test]
fn named_generators_extend_like_the_general_ones() {
    let points = Matrix::from_fn(7, 2, |k, c| ((3 * k + c) as f64 * 0.7).sin());
    let zeros = |n| PoleList::on_grid(&vec![[0.0, 0.0]; n]);
    for (name, general) in [
        (GeneratorKind::Cubic {}, interpolator(Family::IntegerShifts, zeros(3))),
        (GeneratorKind::Bspline { degree: 3 }, GeneratorKind::Exponential { poles: zeros(4) }),
    ] {
        let found = open(&name, 6, 2).unwrap().interpolate(points.clone());
        assert_eq!(found, open(&general, 6, 2).unwrap().interpolate(points.clone()));
    }
}

#[test]
fn open_resampling_equals_the_vectors() {
    let document = load("generators/curves.json");
    let mut count = 0;
    for fit in list(&document["fits"]) {
        if fit["type"] != "resample_arclength" || fit["closed"] == true {
            continue;
        }
        let contour = Contour::open(matrix(&fit["points"])).unwrap();
        let wanted = matrix(&fit["result"]);
        assert_eq!(wanted.nrows() as u64, fit["N"].as_u64().unwrap());
        for start in [0.0, 0.3] {
            let found = contour.sample(wanted.nrows(), start);
            assert_close("resampled", found.as_slice(), wanted.as_slice(), 1e-12);
        }
        count += 1;
    }
    assert_eq!(count, 1);
}

#[test]
fn closed_resampling_equals_the_vectors() {
    let document = load("generators/curves.json");
    let mut repeated = 0;
    for fit in list(&document["fits"]) {
        if fit["type"] != "resample_arclength" || fit["closed"] != true {
            continue;
        }
        let contour = Contour::closed(matrix(&fit["points"])).unwrap();
        let found = contour.sample(fit["N"].as_u64().unwrap() as usize, 0.0);
        let wanted = matrix(&fit["result"]);
        assert_close("resampled", found.as_slice(), wanted.as_slice(), 1e-12);
        repeated += contour.repeated_points();
    }
    assert_eq!(repeated, 1);
}

#[test]
fn samples_at_the_knots_are_the_points() {
    let samples = points(11, |t| [2.0 * t.cos() + 0.3 * (3.0 * t).sin(), t.sin() + 7.0]);
    for kind in GeneratorKind::catalogue() {
        let space = space(&kind, &samples);
        let curve = Curve::of(&space, &space.interpolate(samples.clone()).unwrap()).unwrap();
        let found: Vec<f64> = curve.sample(11).concat();
        let transposed = samples.transpose();
        assert_close(&format!("{kind:?}"), &found, transposed.as_slice(), 1e-13);
    }
}

#[test]
fn circles_and_ellipses_are_exact() {
    for (n, start) in [(3, 0.0), (3, 0.4), (4, 1.1), (5, 2.0), (8, 0.3), (57, 0.1)] {
        let what = format!("{n} points from {start}");
        for (a, b, area, perimeter) in [(1.0, 1.0, PI, TAU), (2.0, 1.0, 2.0 * PI, 9.688448220547675)] {
            let shape = ellipse(n, a, b, start);
            let measures = CurveMeasures::of(&curve(&TRIGONOMETRIC, &shape));
            let enclosed = measures.enclosed.clone().unwrap();
            assert_close(&what, &[enclosed.signed_area], &[area], 1e-13);
            assert_relative(&what, measures.length, perimeter, 1e-10);
            let norm = quadratic_form(space(&TRIGONOMETRIC, &shape).gram().as_ref(), &shape);
            assert_close(&what, &[norm], &[0.5 * (a * a + b * b)], 1e-13);
            assert_close(&what, &enclosed.centroid.unwrap(), &[0.0; 2], 1e-13);
            assert_close(&what, &measures.mean_position, &[0.0; 2], 1e-13);
            let (low, high) = measures.bounding_box;
            assert_close(&what, &low, &[-a, -b], 1e-13);
            assert_close(&what, &high, &[a, b], 1e-13);
            assert_eq!(enclosed.orientation, Orientation::CounterClockwise);
            assert!(!self_intersects(&curve(&TRIGONOMETRIC, &shape)), "{what}");
        }
    }
}

#[test]
fn orientation_follows_the_traversal() {
    let shape = ellipse(9, 2.0, 1.0, 0.2);
    let enclosed = |shape: &Matrix| CurveMeasures::of(&curve(&TRIGONOMETRIC, shape)).enclosed.unwrap();
    let (forward, backward) = (enclosed(&shape), enclosed(&reversed(&shape)));
    assert_eq!(forward.orientation, Orientation::CounterClockwise);
    assert_eq!(backward.orientation, Orientation::Clockwise);
    let sum = forward.signed_area + backward.signed_area;
    assert_close("area of the reversed", &[sum], &[0.0], 1e-13);
    let eight = enclosed(&figure_eight(24));
    assert_eq!(eight.orientation, Orientation::None);
    assert_eq!(eight.centroid, None);
    let space_curve = ellipse(9, 2.0, 1.0, 0.2).insert_column(2, 0.5);
    let measures = CurveMeasures::of(&curve(&TRIGONOMETRIC, &space_curve));
    assert_eq!(measures.enclosed, None);
    let flat = CurveMeasures::of(&curve(&TRIGONOMETRIC, &shape)).length;
    assert_relative("in space", measures.length, flat, 1e-10);
}

/// Coordinates of the points and of the offset are multiples of 2⁻¹⁰: moving them is exact, so the
/// measures may differ only by what evaluation loses, `offset · ε` in a position.
#[test]
fn measures_survive_a_large_offset() {
    let grid = |v: f64| (v * 1024.0).round() / 1024.0;
    let shape =
        points(16, |t| [grid(2.0 * t.cos() + 0.3 * (2.0 * t).cos()), grid(t.sin() + 0.2 * (3.0 * t).cos())]);
    for kind in GeneratorKind::catalogue() {
        let here = CurveMeasures::of(&curve(&kind, &shape));
        let offset = [1048576.0, -524288.0];
        let moved = map(&shape, [[1.0, 0.0], [0.0, 1.0]], offset);
        let there = CurveMeasures::of(&curve(&kind, &moved));
        let what = format!("{kind:?} far away");
        let (inside, moved_inside) = (here.enclosed.unwrap(), there.enclosed.unwrap());
        assert_eq!(moved_inside.orientation, inside.orientation, "{what}");
        let relative = |v: &[f64]| vec![v[0] - offset[0], v[1] - offset[1]];
        assert_close(
            &what,
            &[moved_inside.signed_area, there.length],
            &[inside.signed_area, here.length],
            1e-8,
        );
        assert_close(&what, &relative(&moved_inside.centroid.unwrap()), &inside.centroid.unwrap(), 1e-8);
        assert_close(&what, &relative(&there.mean_position), &here.mean_position, 1e-8);
        assert_close(&what, &relative(&there.bounding_box.0), &here.bounding_box.0, 1e-8);
        assert_close(&what, &relative(&there.bounding_box.1), &here.bounding_box.1, 1e-8);
        assert!(!self_intersects(&curve(&kind, &moved)), "{what}");
    }
}

fn kind() -> impl Strategy<Value = GeneratorKind> {
    prop::sample::select(GeneratorKind::catalogue())
}

fn any_points(sizes: std::ops::Range<usize>) -> impl Strategy<Value = Matrix> {
    prop::collection::vec((-1.0..1.0, -1.0..1.0), sizes).prop_map(|rows| {
        let flat: Vec<f64> = rows.iter().flat_map(|&(x, y)| [x, y]).collect();
        Matrix::from_row_slice(rows.len(), 2, &flat)
    })
}

/// `r(θ) = 1 + Σ_k a_k cos(kθ + φ_k)` with `Σ|a_k| < 0.7`.
fn star(n: usize) -> impl Strategy<Value = Matrix> {
    let harmonic = (-1.0..1.0, 0.0..TAU);
    (prop::collection::vec(harmonic, 4), 0.0..0.7).prop_map(move |(harmonics, amount)| {
        let total: f64 = harmonics.iter().map(|(a, _): &(f64, f64)| a.abs()).sum();
        points(n, |t| {
            let sum: f64 = harmonics
                .iter()
                .enumerate()
                .map(|(k, (a, phase))| a / total * ((k + 2) as f64 * t + phase).cos())
                .sum();
            let radius = 1.0 + amount * sum;
            [radius * t.cos(), radius * t.sin()]
        })
    })
}

/// Whether the angle of the curve about the origin increases throughout.
fn is_star_shaped(curve: &Curve) -> bool {
    (0..20 * curve.halves()).all(|i| {
        let u = i as f64 / (20 * curve.halves()) as f64;
        let (r, d) = (curve.evaluate(u, 0), curve.evaluate(u, 1));
        r[0] * d[1] - r[1] * d[0] > 1e-3
    })
}

proptest! {
    #[test]
    fn measures_are_affinely_covariant(
        shape in any_points(3..12),
        kind in kind(),
        a in prop::array::uniform4(-2.0..2.0),
        b in prop::array::uniform2(-5.0..5.0),
    ) {
        let here = CurveMeasures::of(&curve(&kind, &shape));
        let a = [[a[0], a[1]], [a[2], a[3]]];
        let there = CurveMeasures::of(&curve(&kind, &map(&shape, a, b)));
        let det = a[0][0] * a[1][1] - a[0][1] * a[1][0];
        let area = here.enclosed.clone().unwrap().signed_area;
        assert_close("area", &[there.enclosed.clone().unwrap().signed_area], &[det * area], 1e-12);
        let image = |p: &[f64]| [0, 1].map(|c| a[c][0] * p[0] + a[c][1] * p[1] + b[c]);
        let mean = image(&here.mean_position);
        assert_close("mean position", &there.mean_position, &mean, 1e-12);
        if det.abs() > 0.1 && area.abs() > 0.01 {
            let wanted = image(&here.enclosed.clone().unwrap().centroid.unwrap());
            assert_close("centroid", &there.enclosed.unwrap().centroid.unwrap(), &wanted, 1e-10);
        }
    }

    #[test]
    fn bounding_boxes_are_tight(shape in any_points(3..12), kind in kind()) {
        let curve = curve(&kind, &shape);
        let (low, high) = CurveMeasures::of(&curve).bounding_box;
        let samples = curve.sample(400 * shape.nrows());
        for c in 0..2 {
            let (mut least, mut most) = (f64::MAX, f64::MIN);
            for point in &samples {
                least = least.min(point[c]);
                most = most.max(point[c]);
            }
            prop_assert!(low[c] <= least + 1e-12 && most <= high[c] + 1e-12);
            prop_assert!(least - low[c] < 1e-3 && high[c] - most < 1e-3);
        }
    }

    #[test]
    fn perimeter_equals_a_fine_polygon(shape in any_points(3..12), kind in kind()) {
        let curve = curve(&kind, &shape);
        let chords = |count: usize| -> f64 {
            let samples = curve.sample(count);
            (0..count)
                .map(|i| {
                    let (p, q) = (&samples[i], &samples[(i + 1) % count]);
                    f64::hypot(q[0] - p[0], q[1] - p[1])
                })
                .sum()
        };
        let found = CurveMeasures::of(&curve).length;
        let fine = chords(400 * shape.nrows());
        prop_assert!(fine <= found * (1.0 + 1e-12), "{fine} is longer than {found}");
        prop_assert!(found - fine < 1e-3 * found, "{found}, polygon {fine}");
    }

    #[test]
    fn star_shapes_are_simple(shape in star(60), angle in 0.0..TAU, kind in kind()) {
        let here = curve(&kind, &shape);
        prop_assume!(is_star_shaped(&here));
        let moved = map(&shape, similarity(3.0, angle), [40.0, -7.0]);
        prop_assert!(!self_intersects(&here));
        prop_assert!(!self_intersects(&curve(&kind, &moved)));
    }

    #[test]
    fn verdict_ignores_placement_start_and_direction(
        shape in any_points(3..10),
        kind in kind(),
        angle in 0.0..TAU,
        scale in 1e-3..1e3,
        start in 0_usize..10,
    ) {
        let verdict = self_intersects(&curve(&kind, &shape));
        let moved = map(&shape, similarity(scale, angle), [3.0 * scale, -scale]);
        let turned = rotate_start(&shape, start % shape.nrows());
        for (what, copy) in [("moved", moved), ("turned", turned), ("reversed", reversed(&shape))] {
            prop_assert_eq!(self_intersects(&curve(&kind, &copy)), verdict, "{}", what);
        }
    }
}

fn figure_eight(n: usize) -> Matrix {
    points(n, |t| [t.sin(), t.sin() * t.cos()])
}

/// Two lobes joined by a waist of height `2 gap`; tangent to itself at the origin when `gap = 0`.
fn pinched(gap: f64) -> Matrix {
    let mut shape = points(40, |t| [2.0 * t.cos(), t.sin() * (t.cos().powi(2) + gap)]);
    for (row, y) in [(10, gap), (30, -gap)] {
        shape[(row, 0)] = 0.0;
        shape[(row, 1)] = y;
    }
    shape
}

/// A thick ring with a slit: a circle of angles and radii, seen in polar coordinates. Its ends come as
/// close as `3 sin(gap)`, and overlap for a negative gap.
fn slit_ring(gap: f64) -> Matrix {
    points(120, |t| {
        let (angle, radius) = (PI + (PI - gap) * t.cos(), 1.5 + 0.5 * t.sin());
        [radius * angle.cos(), radius * angle.sin()]
    })
}

/// A U of two straight arms.
fn horseshoe(gap: f64) -> Matrix {
    let half = 0.5 * gap;
    let rows = [
        [-1.0, 3.0],
        [-1.0, -1.0],
        [1.0, -1.0],
        [1.0, 3.0],
        [half, 3.0],
        [half, 0.0],
        [-half, 0.0],
        [-half, 3.0],
    ];
    Matrix::from_fn(8, 2, |k, c| rows[k][c])
}

/// In several positions, so that no verdict hangs on the axes.
fn assert_verdict(what: &str, kind: &GeneratorKind, shape: &Matrix, wanted: bool) {
    for angle in [0.0, 0.5, 1.0, 2.2] {
        let moved = map(shape, similarity(7.0, angle), [0.0, 0.0]);
        assert_eq!(self_intersects(&curve(kind, &moved)), wanted, "{what} turned by {angle}, {kind:?}");
    }
}

#[test]
fn shapes_that_meet_themselves() {
    for kind in GeneratorKind::catalogue() {
        for n in [12, 24, 25, 100] {
            assert_verdict("figure eight", &kind, &figure_eight(n), true);
        }
        let twice = points(24, |t| [2.0 * (2.0 * t).cos(), (2.0 * t).sin()]);
        assert_verdict("traced twice", &kind, &twice, true);
        let there_and_back = points(16, |t| [t.cos(), 0.3 * t.cos()]);
        assert_verdict("there and back", &kind, &there_and_back, true);
        assert_verdict("overlapping ring", &kind, &slit_ring(-0.1), true);
    }
    assert_verdict("pinched", &TRIGONOMETRIC, &pinched(0.0), true);
    assert_verdict("pinched", &GeneratorKind::Cubic {}, &pinched(0.0), true);
    assert_verdict("overlapping", &TRIGONOMETRIC, &pinched(-1e-3), true);
    let linear = GeneratorKind::Bspline { degree: 1 };
    assert_verdict("touching arms", &linear, &horseshoe(0.0), true);
    assert_verdict("crossed arms", &linear, &horseshoe(-0.1), true);
}

#[test]
fn shapes_that_only_come_close() {
    for kind in GeneratorKind::catalogue() {
        for gap in [0.3, 0.01, 1e-3] {
            assert_verdict(&format!("slit {gap}"), &kind, &slit_ring(gap), false);
        }
    }
    for gap in [1e-2, 1e-4, 1e-6] {
        let what = format!("waist {gap}");
        assert_verdict(&what, &TRIGONOMETRIC, &pinched(gap), false);
        assert_verdict(&what, &GeneratorKind::Cubic {}, &pinched(gap), false);
    }
    let square = Matrix::from_row_slice(4, 2, &[0., 0., 1., 0., 1., 1., 0., 1.]);
    let spike = Matrix::from_row_slice(5, 2, &[0., 0., 1., 0., 1., 1., 0.99, 3., 0., 1.]);
    for polygon in [square, spike, horseshoe(0.1), horseshoe(1e-4)] {
        assert_verdict("polygon", &GeneratorKind::Bspline { degree: 1 }, &polygon, false);
    }
}

/// Whether two edges of the closed polygon cross; a sweep over boxes sorted by their left side.
fn polygon_crosses(samples: &[Vec<f64>]) -> bool {
    let n = samples.len();
    let edge = |i: usize| (&samples[i], &samples[(i + 1) % n]);
    let mut order: Vec<usize> = (0..n).collect();
    let left = |i: usize| edge(i).0[0].min(edge(i).1[0]);
    order.sort_by(|&i, &j| left(i).total_cmp(&left(j)));
    let side =
        |p: &[f64], q: &[f64], r: &[f64]| (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]);
    (0..n).any(|position| {
        let i = order[position];
        let (a, b) = edge(i);
        let right = a[0].max(b[0]);
        order[position + 1..]
            .iter()
            .take_while(|&&j| left(j) <= right)
            .filter(|&&j| (i + 1) % n != j && (j + 1) % n != i)
            .any(|&j| {
                let (c, d) = edge(j);
                side(a, b, c) * side(a, b, d) < 0.0 && side(c, d, a) * side(c, d, b) < 0.0
            })
    })
}

/// Random curves, most with loops: the polygon of 500 samples a segment may miss a loop that is
/// smaller than its edges, so a few disagreements are allowed one way, none the other.
#[test]
fn verdict_equals_brute_force() {
    let mut state = 12345_u64;
    let mut uniform = || {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (state >> 11) as f64 / (1u64 << 53) as f64
    };
    let (mut crossing, mut missed) = (0, 0);
    for i in 0..300 {
        let n = 3 + i % 8;
        // Around a circle with noise: about half of the curves are simple.
        let shape = points(n, |t| [t.cos(), t.sin()]);
        let shape = shape.map(|v| v + 1.2 * (uniform() - 0.5));
        let curve = curve(&TRIGONOMETRIC, &shape);
        let (found, brute) = (self_intersects(&curve), polygon_crosses(&curve.sample(500 * n)));
        assert!(found || !brute, "missed a crossing of {shape}");
        crossing += usize::from(brute);
        missed += usize::from(found && !brute);
    }
    assert!((60..=240).contains(&crossing), "{crossing} of 300 cross");
    assert!(missed <= 2, "{missed} of 300 only found by the curve");
}

/// Outlines of cells, where the data lie beside the crate.
fn cell_outlines() -> Vec<Matrix> {
    let file = PathBuf::from(env!("CARGO_MANIFEST_DIR"))
        .join("../../../shared/data/curves-osteosarcoma-cells/curves.ndjson");
    let Ok(text) = std::fs::read_to_string(file) else {
        println!("SKIPPED: the outlines of cells are not beside the project");
        return Vec::new();
    };
    text.lines()
        .map(|line| {
            let record: Value = serde_json::from_str(line).unwrap();
            let mut rows: Vec<Vec<f64>> = list(&record["points"]).iter().map(numbers).collect();
            rows.dedup();
            let contour = Matrix::from_fn(rows.len(), 2, |i, c| rows[i][c]);
            Contour::closed(contour).unwrap().sample(100, 0.0)
        })
        .collect()
}

#[test]
fn cell_outlines_agree_with_brute_force() {
    let outlines = cell_outlines();
    let curves: Vec<Curve> = outlines.iter().map(|o| curve(&TRIGONOMETRIC, o)).collect();
    let begin = Instant::now();
    let found: Vec<bool> = curves.iter().map(self_intersects).collect();
    let elapsed = begin.elapsed();
    let brute = curves.iter().map(|c| polygon_crosses(&c.sample(2000)));
    let differ: Vec<usize> = brute
        .zip(&found)
        .enumerate()
        .filter_map(|(i, (brute, found))| (brute != *found).then_some(i))
        .collect();
    let crossing = found.iter().filter(|&&f| f).count();
    eprintln!(
        "{crossing} of {} outlines cross themselves, {elapsed:.1?}; brute force differs for {differ:?}",
        curves.len()
    );
    assert!(100 * differ.len() <= curves.len(), "{differ:?}");
}
