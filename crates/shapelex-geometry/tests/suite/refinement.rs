//! Refinement: stored filters and sequences, the refined curve as the same function, and a published circle.

use std::f64::consts::TAU;

use proptest::prelude::*;
use serde_json::Value;
use shapelex_geometry::capability::refine::Resizing;
use shapelex_geometry::curve::Curve;
use shapelex_geometry::generator::refinement::{FineFilter, prefilter, two_scale_filter};
use shapelex_geometry::generator::{Family, GeneratorKind, PoleList, Poles, Recipe};
use shapelex_geometry::refine::Refinement;
use shapelex_geometry::representation::{Representation, ShapeSpace};
use shapelex_geometry::surface::Topology;
use shapelex_geometry::surface::seam::Seam;
use shapelex_numeric::dense::Matrix;

use crate::spaces::{closed, interpolator, open, random_curve};
use crate::vectors::{self, assert_close, load, matrix, number, numbers, text};

pub(crate) fn half_integer_shifts(poles: PoleList) -> GeneratorKind {
    interpolator(Family::HalfIntegerShifts, poles)
}

/// A stored case: its poles, and the weights of its interpolator.
fn case_parts(case: &Value) -> (Poles, Vec<f64>) {
    let poles = vectors::poles(&case["poles"]);
    assert_eq!(poles.order() as u64, case["n0"].as_u64().unwrap());
    let built = Recipe::HalfIntegerShifts(poles.clone()).build().unwrap();
    (poles, built.weights.unwrap())
}

/// The entries of an object by their number keys.
fn keyed(object: &Value) -> impl Iterator<Item = (usize, &Value)> {
    object.as_object().unwrap().iter().map(|(key, value)| (key.parse().unwrap(), value))
}

#[test]
fn filters_equal_the_vectors() {
    let document = load("generators/refinement.json");
    for case in vectors::cases(&document) {
        let id = text(&case["id"]);
        let (poles, weights) = case_parts(case);
        assert_close(id, &weights, &numbers(&case["lambda"]), 1e-13);
        for (factor, wanted) in keyed(&case["h"]) {
            assert_close(&format!("{id} h"), &two_scale_filter(&poles, factor), &numbers(wanted), 1e-13);
        }
        for (factor, wanted) in keyed(&case["g"]) {
            let found = prefilter(&poles, &weights, factor);
            assert_close(&format!("{id} g"), &found, &numbers(wanted), 1e-13);
        }
        for (factor, wanted) in keyed(&case["integrals"]) {
            let found = poles.refined(factor as f64).integral();
            assert_close(&format!("{id} ∫"), &[found], &[number(wanted)], 1e-13);
        }
    }
}

/// `Σ_k c[k] f[l − m k]`, modulo `rows`.
fn upsampled(coarse: &Matrix, filter: &[f64], factor: usize, rows: usize) -> Matrix {
    let mut fine = Matrix::zeros(rows, coarse.ncols());
    for (k, row) in coarse.row_iter().enumerate() {
        for (i, tap) in filter.iter().enumerate() {
            let mut target = fine.row_mut((factor * k + i) % rows);
            target += *tap * row;
        }
    }
    fine
}

fn size_of(value: &Value) -> usize {
    value.as_u64().unwrap() as usize
}

/// Row `l` of the raw causal sequence is `∫β` times row `l + first` of the centred normalised one.
fn assert_shifted(what: &str, found: &Matrix, raw: &Matrix, integral: f64, first: isize) {
    let rows = found.nrows() as isize;
    assert_eq!(found.shape(), raw.shape(), "{what}");
    let moved = Matrix::from_fn(raw.nrows(), raw.ncols(), |l, c| {
        found[((l as isize + first).rem_euclid(rows) as usize, c)] / integral
    });
    assert_close(what, moved.as_slice(), raw.as_slice(), 1e-13);
}

#[test]
fn periodic_sequences_equal_the_vectors() {
    let document = load("generators/refinement.json");
    for case in vectors::cases(&document) {
        let (id, stored) = (text(&case["id"]), &case["periodic"]);
        let (poles, weights) = case_parts(case);
        let (size, m0, m) = (size_of(&stored["M"]), size_of(&stored["m0"]), size_of(&stored["m"]));
        let (c, c0, c1) = (matrix(&stored["c"]), matrix(&stored["c0"]), matrix(&stored["c1"]));
        let fine = poles.refined(m0 as f64);
        let first = upsampled(&c, &prefilter(&poles, &weights, m0), m0, m0 * size);
        assert_close(&format!("{id} c0"), first.as_slice(), c0.as_slice(), 1e-13);
        let second = upsampled(&c0, &two_scale_filter(&fine, m), m, m * m0 * size);
        assert_close(&format!("{id} c1"), second.as_slice(), c1.as_slice(), 1e-13);

        let kind = half_integer_shifts(PoleList::on_grid(&poles.list()));
        let coarse = Refinement::new(&closed(&kind, size, 2).unwrap(), m0).unwrap();
        let start = filter_of(&kind, size, m0).first;
        let found = coarse.apply(&c);
        assert_shifted(&format!("{id} refined"), &found, &c0, fine.integral(), start);
        let next = Refinement::new(coarse.space(), m).unwrap();
        let kind = coarse.representation().generator().unwrap();
        let start = m as isize * start + filter_of(kind, m0 * size, m).first;
        let integral = poles.refined((m0 * m) as f64).integral();
        assert_shifted(&format!("{id} refined twice"), &next.apply(&found), &c1, integral, start);
    }
}

/// The filter of a kind that has one.
fn filter_of(kind: &GeneratorKind, intervals: usize, factor: usize) -> FineFilter {
    let recipe = kind.recipe(intervals).unwrap();
    FineFilter::new(&recipe, kind.build(intervals).unwrap().as_ref(), factor).unwrap()
}

#[test]
fn finite_sequences_equal_the_vectors() {
    let document = load("generators/refinement.json");
    for case in vectors::cases(&document) {
        let (id, stored) = (text(&case["id"]), &case["finite"]);
        let (poles, weights) = case_parts(case);
        let (m0, c, wanted) = (size_of(&stored["m0"]), matrix(&stored["c"]), matrix(&stored["c0"]));
        let first = stored["first_index"].as_i64().unwrap();
        assert_eq!(stored["first_index_out"].as_i64().unwrap(), m0 as i64 * first);
        let filter = prefilter(&poles, &weights, m0);
        let rows = m0 * (c.nrows() - 1) + filter.len();
        let found = upsampled(&c, &filter, m0, rows);
        assert_close(id, found.as_slice(), wanted.as_slice(), 1e-13);
        let kind = half_integer_shifts(PoleList::on_grid(&poles.list()));
        let integral = poles.refined(m0 as f64).integral();
        let taps: Vec<f64> = filter_of(&kind, 6, m0).taps.iter().map(|tap| tap / integral).collect();
        assert_close(&format!("{id} taps"), &taps, &filter, 1e-13);
    }
}

/// Generators with a two-scale relation; the last has no pole 0.
pub(crate) fn refinable() -> Vec<GeneratorKind> {
    let pair = |a: f64, b: f64| vec![[a, b], [-a, -b]];
    let list = |zeros: usize, pairs: &[[f64; 2]]| {
        let pairs = pairs.iter().flat_map(|&[a, b]| pair(a, b));
        PoleList::from_domain(&std::iter::repeat_n([0.0, 0.0], zeros).chain(pairs).collect::<Vec<_>>())
    };
    let quadruple = [[0.0, 0.0], [1.0, 2.0], [1.0, -2.0], [-1.0, 2.0], [-1.0, -2.0]];
    let lists = [
        list(3, &[]),
        list(1, &[[0.0, TAU]]),
        list(2, &[[0.0, TAU]]),
        list(1, &[[0.0, TAU], [3.0, 0.0]]),
        PoleList::from_domain(&quadruple),
        list(0, &[[0.0, TAU], [0.0, 2.0 * TAU]]),
    ];
    let splines = (1..=5).map(|degree| GeneratorKind::Bspline { degree });
    let others = lists
        .into_iter()
        .flat_map(|poles| [GeneratorKind::Exponential { poles: poles.clone() }, half_integer_shifts(poles)]);
    splines.chain(others).collect()
}

/// Whether a curve is refined as the same function: half-integer shifts by even factors.
pub(crate) fn is_exact(kind: &GeneratorKind, factor: usize) -> bool {
    refinable().contains(kind) && (factor.is_multiple_of(2) || !kind.needs_even_factors())
}

/// `r(u) = r_fine(u + δ)` when exact, and `r = r_fine` at the fine knots otherwise.
fn assert_refined(space: &ShapeSpace, factor: usize, seed: u64, parameters: &[f64]) {
    let what = format!("{:?} by {factor}", space.representation());
    let refinement = Refinement::new(space, factor).unwrap();
    let (points, curve) = random_curve(space, seed);
    let fine = Curve::of(refinement.space(), &refinement.apply(&points)).unwrap();
    assert_eq!(fine.segments(), factor * curve.segments(), "{what}");
    let kind = space.representation().generator().unwrap();
    let wanted = is_exact(kind, factor);
    assert_eq!(refinement.is_exact(), wanted, "{what}");
    let shift = refinement.parameter_shift();
    let knots: Vec<f64> = (0..=fine.segments()).map(|k| k as f64 / fine.segments() as f64).collect();
    for &u in if wanted { parameters } else { &knots } {
        // Control points are random in [−1, 1]; values are sums of at most ten of them.
        assert_close(&format!("{what}, u = {u}"), &fine.evaluate(u + shift, 0), &curve.evaluate(u, 0), 1e-12);
    }
    assert!((wanted && curve.is_closed()) || shift == 0.0);
    let order = space.line().expect("a curve").poles().order();
    let between = wanted && !(order * (factor - 1)).is_multiple_of(2);
    let fine = refinement.representation().generator().unwrap();
    assert_eq!(fine.is_shifted(), between && !curve.is_closed(), "{what}");
    assert_eq!(refinement.space().gram().size(), refinement.representation().size(), "{what}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn refined_curves_are_the_same(
        kind in prop::sample::select(refinable()),
        factor in prop::sample::select(vec![2_usize, 3, 4, 6]),
        size in 6_usize..12,
        seed in any::<u64>(),
        parameters in prop::collection::vec(0.0..1.0, 50),
    ) {
        assert_refined(&closed(&kind, size, 2).unwrap(), factor, seed, &parameters);
        assert_refined(&open(&kind, size, 3).unwrap(), factor, seed, &parameters);
    }

    #[test]
    fn polyphase_sums_are_one(
        kind in prop::sample::select(refinable()),
        factor in prop::sample::select(vec![2_usize, 3, 4, 6]),
        size in 6_usize..100,
    ) {
        prop_assume!(factor % 2 == 0 || !kind.needs_even_factors());
        prop_assume!(kind.properties().partition_of_unity);
        let filter = filter_of(&kind, size, factor);
        for phase in 0..factor {
            let sum: f64 = filter.taps.iter().skip(phase).step_by(factor).sum();
            prop_assert!((sum - 1.0).abs() <= 1e-13, "{kind:?} by {factor}: {sum}");
        }
        let reversed: Vec<f64> = filter.taps.iter().rev().copied().collect();
        assert_close("symmetry", &filter.taps, &reversed, 1e-14);
    }
}

/// The circle of three control points: normalised coefficients at radius `1/cos(π/n)`, at exact angles.
#[test]
fn the_published_circle_is_refined() {
    let kind = half_integer_shifts(PoleList::from_domain(&[[0.0, 0.0], [0.0, TAU], [0.0, -TAU]]));
    let mut space = closed(&kind, 3, 2).unwrap();
    let on_circle = |angle: f64| [angle.cos(), angle.sin()];
    let mut points = Matrix::from_fn(3, 2, |k, c| on_circle(TAU * k as f64 / 3.0)[c]);
    let mut shift = 0.0;
    let published = [
        (2, 6, 1.547005e-1),
        (2, 12, 3.527618e-2),
        (2, 24, 8.628961e-3),
        (4, 96, 5.356993e-4),
        (4, 384, 3.346720e-5),
    ];
    for (factor, count, excess) in published {
        let refinement = Refinement::new(&space, factor).unwrap();
        assert!(refinement.is_exact());
        points = refinement.apply(&points);
        shift += refinement.parameter_shift();
        space = refinement.space().clone();
        assert_eq!(points.nrows(), count);
        let radius = 1.0 / (TAU / 2.0 / count as f64).cos();
        // the table has seven digits
        assert!((radius - 1.0 - excess).abs() <= 5e-7 * excess, "{count}: {radius}");
        for (l, point) in points.row_iter().enumerate() {
            let angle = TAU * (l as f64 / count as f64 - shift);
            let wanted = on_circle(angle).map(|v| radius * v);
            assert_close(&format!("{count}, {l}"), &[point[0], point[1]], &wanted, 1e-14);
        }
    }
}

/// Generators without a two-scale relation are sampled, and say so; what they reproduce stays as it is.
#[test]
fn other_generators_are_sampled() {
    let integer =
        interpolator(Family::IntegerShifts, PoleList::from_domain(&[[0.0, 0.0], [0.0, TAU], [0.0, -TAU]]));
    for kind in [GeneratorKind::Trigonometric {}, integer, GeneratorKind::Cubic {}] {
        let circle = Matrix::from_fn(7, 2, |k, c| (TAU * (k as f64 / 7.0 - 0.25 * c as f64)).cos());
        for factor in [2, 3] {
            let space = closed(&kind, 7, 2).unwrap();
            let refinement = Refinement::new(&space, factor).unwrap();
            assert!(!refinement.is_exact() && refinement.parameter_shift() == 0.0);
            let representation = refinement.representation();
            assert_eq!(representation.count(), 7 * factor);
            assert_eq!(representation.generator(), Some(&kind));
            let (coarse, fine) = (
                Curve::of(&space, &circle).unwrap(),
                Curve::of(refinement.space(), &refinement.apply(&circle)).unwrap(),
            );
            let differ = (0..100)
                .map(|i| f64::from(i) / 100.0)
                .map(|u| (coarse.evaluate(u, 0)[0] - fine.evaluate(u, 0)[0]).abs())
                .fold(0.0, f64::max);
            let reproduces = kind != GeneratorKind::Cubic {};
            assert_eq!(differ <= 1e-14, reproduces, "{kind:?} by {factor}: {differ:e}");
            assert_refined(&space, factor, 5, &[]);
        }
    }
}

/// Surfaces of a topology.
pub(crate) fn surfaces(
    topology: Topology,
    seam: Seam,
    control_points: [usize; 2],
    generators: [GeneratorKind; 2],
) -> Result<ShapeSpace, shapelex_geometry::GeometryError> {
    ShapeSpace::new(&Representation::Surface { topology, seam, control_points, generators })
}

/// `σ(u, v) = σ_fine(u + δ_u, v + δ_v)` for random rows, if the refinement says that it is exact; else the same at the fine knots.
/// Returns whether it is.
fn assert_same_surface(coarse: &ShapeSpace, factors: [usize; 2], seed: u64, places: &[[f64; 2]]) -> bool {
    let what = format!("{:?} by {factors:?}", coarse.representation());
    let basis = coarse.surface().unwrap();
    let intervals = [0, 1].map(|i| factors[i] * basis.extent().intervals[i]);
    let fine = ShapeSpace::new(&coarse.resized(intervals).unwrap()).unwrap();
    let resizing = Resizing::new(coarse, &fine).unwrap();
    let rows = crate::spaces::Noise(seed).matrix(coarse.representation().size(), 3);
    let resized = resizing.apply(&rows);
    let (before, after) = (basis.surface(&rows), fine.surface().unwrap().surface(&resized.control_points));
    let (shifts, exact) = (resizing.shifts(), resized.change.is_none());
    let knots: Vec<[f64; 2]> =
        (0..intervals[0]).map(|k| [k as f64 / intervals[0] as f64, 1.0 / intervals[1] as f64]).collect();
    for &[u, v] in if exact { places } else { &knots } {
        let moved = [u + shifts[0], v + shifts[1]];
        // Twisted, the parameter beyond the seam is one before it.
        if basis.seam() != Seam::Straight && moved[0] >= 1.0 {
            continue;
        }
        let [p, q] = [before.point(u, v), after.point(moved[0], moved[1])];
        assert_close(&format!("{what} at {u}, {v}"), &q, &p, 2e-12);
    }
    assert!(exact || shifts == [0.0; 2], "{what}");
    exact
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]

    /// The two-scale relation of both directions changes no point of a torus, a cylinder or a plane.
    #[test]
    fn refined_surfaces_are_the_same(
        kinds in prop::array::uniform2(prop::sample::select(refinable())),
        factors in prop::array::uniform2(prop::sample::select(vec![1_usize, 2, 3, 4])),
        topology in prop::sample::select(vec![Topology::Torus, Topology::Cylinder, Topology::Plane]),
        seed in any::<u64>(),
        places in prop::collection::vec(prop::array::uniform2(0.0..1.0), 20),
    ) {
        let space = surfaces(topology, Seam::Straight, [7, 6], kinds.clone()).unwrap();
        let wanted = (0..2).all(|i| factors[i] == 1 || is_exact(&kinds[i], factors[i]));
        prop_assert_eq!(assert_same_surface(&space, factors, seed, &places), wanted);
    }

    /// Nor of a twisted torus.
    #[test]
    fn refined_twisted_tori_are_the_same(
        kinds in prop::array::uniform2(prop::sample::select(refinable())),
        factors in prop::array::uniform2(prop::sample::select(vec![1_usize, 2, 4])),
        seam in prop::sample::select(vec![Seam::Reflected, Seam::HalfTurn]),
        seed in any::<u64>(),
        places in prop::collection::vec(prop::array::uniform2(0.0..1.0), 20),
    ) {
        let space = surfaces(Topology::Torus, seam, [7, 6], kinds.clone()).unwrap();
        let order = space.surface().unwrap().lines()[1].poles().order();
        let reversed = seam == Seam::Reflected && factors[1] > 1 && (order * (factors[1] - 1)) % 2 == 1;
        prop_assert_eq!(assert_same_surface(&space, factors, seed, &places), !reversed);
    }

    /// Spheres stay the same, poles and tangents included, where `cos 2πu` is reproduced along `u`.
    #[test]
    fn refined_spheres_are_the_same(
        around in prop::sample::select(vec![0_usize, 1, 2]),
        along in prop::sample::select(vec![0_usize, 1, 2]),
        factors in prop::array::uniform2(prop::sample::select(vec![1_usize, 2, 3, 4])),
        seed in any::<u64>(),
        places in prop::collection::vec(prop::array::uniform2(0.0..1.0), 20),
    ) {
        let circle = PoleList::from_domain(&[[0.0, 0.0], [0.0, TAU], [0.0, -TAU]]);
        let spline = |degree: u8| GeneratorKind::Bspline { degree };
        let exponential = GeneratorKind::Exponential { poles: circle.clone() };
        let kinds = [exponential, half_integer_shifts(circle), spline(3)];
        let zeros = half_integer_shifts(PoleList::from_domain(&[[0.0, 0.0]; 3]));
        let spline = [spline(2), spline(3), zeros];
        let kinds = [kinds[around].clone(), spline[along].clone()];
        let even = factors[0] % 2 == 0;
        let sharp = surfaces(Topology::SharpSphere, Seam::Straight, [7, 6], kinds.clone()).unwrap();
        let space = surfaces(Topology::Sphere, Seam::Straight, [7, 6], kinds).unwrap();
        let along_u = factors[0] == 1 || around == 0 || (around == 1 && even);
        let along_v = along != 2 || factors[1] == 1 || factors[1] % 2 == 0;
        prop_assert_eq!(assert_same_surface(&space, factors, seed, &places), along_u && along_v);
        // No tangent planes at the poles, no condition on cos 2πu.
        let along_u = along_u || around == 2;
        prop_assert_eq!(assert_same_surface(&sharp, factors, seed, &places), along_u && along_v);
    }
}

/// Generators whose refinement is shifted by half an interval along open directions: odd lists of poles, split evenly.
fn between_knots() -> Vec<GeneratorKind> {
    let odd = |kind: &GeneratorKind| kind.properties().smoothness % 2 == 1;
    let kinds: Vec<GeneratorKind> = refinable().into_iter().filter(odd).collect();
    assert!(kinds.len() >= 8, "{}", kinds.len());
    kinds
}

/// `⟨r, r⟩` of the Gram operator, and the square of its root; both are the squared norm.
fn squared_norms(space: &ShapeSpace, rows: &Matrix) -> [f64; 2] {
    let (mut applied, mut whitened) = (rows.clone(), rows.clone());
    space.gram().apply(applied.as_mut_slice());
    space.gram().whiten(whitened.as_mut_slice());
    let norm = rows.dot(&applied);
    space.gram().solve(applied.as_mut_slice());
    space.gram().unwhiten(whitened.as_mut_slice());
    let largest = rows.amax();
    assert!((applied - rows).amax() <= 1e-9 * largest && (&whitened - rows).amax() <= 1e-9 * largest);
    let mut whitened = rows.clone();
    space.gram().whiten(whitened.as_mut_slice());
    [norm, whitened.norm_squared()]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    /// Open curves split evenly have the norm of the coarse curve, can be refined again by any factor, and interpolate.
    #[test]
    fn shifted_splines_are_curves_as_others(
        kind in prop::sample::select(between_knots()),
        factors in prop::array::uniform2(prop::sample::select(vec![2_usize, 4, 3])),
        size in 6_usize..12,
        seed in any::<u64>(),
        parameters in prop::collection::vec(0.0..1.0, 30),
    ) {
        prop_assume!(factors[0] % 2 == 0);
        let space = open(&kind, size, 2).unwrap();
        let (points, curve) = random_curve(&space, seed);
        let once = Refinement::new(&space, factors[0]).unwrap();
        let fine = once.apply(&points);
        let [norm, root] = squared_norms(once.space(), &fine);
        let [wanted, _] = squared_norms(&space, &points);
        prop_assert!((norm - wanted).abs() <= 1e-12 * wanted && (root - wanted).abs() <= 1e-11 * wanted);
        // The shifts are again combinations of shifts, by odd and by even factors.
        let twice = Refinement::new(once.space(), factors[1]).unwrap();
        prop_assert!(twice.is_exact());
        let finer = Curve::of(twice.space(), &twice.apply(&fine)).unwrap();
        // What is reproduced is interpolated: a curve through its own values at the knots has these values, and constants stay.
        let line = once.space().line().unwrap();
        let values = Matrix::from_fn(line.intervals() + 1, 2, |k, c| curve.evaluate(k as f64 / line.intervals() as f64, 0)[c]);
        let through = Curve::of(once.space(), &line.interpolate(values.clone())).unwrap();
        let backwards = Matrix::from_fn(values.nrows(), 2, |k, c| values[(values.nrows() - 1 - k, c)]);
        let turned = Curve::of(once.space(), &line.interpolate(backwards)).unwrap();
        for &u in &parameters {
            assert_close("twice", &finer.evaluate(u, 0), &curve.evaluate(u, 0), 1e-12);
            assert_close("turned", &turned.evaluate(1.0 - u, 0), &through.evaluate(u, 0), 1e-9);
        }
        for k in 0..=line.intervals() {
            let u = k as f64 / line.intervals() as f64;
            assert_close("knot", &through.evaluate(u, 0), &curve.evaluate(u, 0), 1e-9);
        }
        if line.reproduces_constants() {
            let ones = line.interpolate(Matrix::from_element(values.nrows(), 2, 1.0));
            prop_assert!((ones.add_scalar(-1.0)).amax() <= 1e-9, "{}", ones);
        }
    }

    /// Surfaces split evenly along meridians and other open directions have the norm of the coarse surface, and can be refined again.
    #[test]
    fn shifted_splines_are_surfaces_as_others(
        topology in prop::sample::select(vec![Topology::Sphere, Topology::SharpSphere, Topology::Cylinder, Topology::Plane]),
        along in prop::sample::select(vec![0_usize, 1]),
        factor in prop::sample::select(vec![2_usize, 3]),
        seed in any::<u64>(),
        places in prop::collection::vec(prop::array::uniform2(0.0..1.0), 20),
    ) {
        let circle = PoleList::from_domain(&[[0.0, 0.0], [0.0, TAU], [0.0, -TAU]]);
        let half = PoleList::from_domain(&[[0.0, 0.0], [0.0, TAU / 2.0], [0.0, -TAU / 2.0]]);
        let around = GeneratorKind::Exponential { poles: circle };
        let meridian = if topology.has_poles() { half_integer_shifts(half).of_meridian() } else { half_integer_shifts(half) };
        let kinds = [around, [meridian, GeneratorKind::Bspline { degree: 2 }][along].clone()];
        let space = surfaces(topology, Seam::Straight, [7, 6], kinds).unwrap();
        let rows = crate::spaces::Noise(seed).matrix(space.representation().size(), 3);
        let fine = ShapeSpace::new(&space.resized([7, 12]).unwrap()).unwrap();
        let resized = Resizing::new(&space, &fine).unwrap().apply(&rows);
        prop_assert!(resized.change.is_none());
        let Representation::Surface { generators, .. } = fine.representation() else { unreachable!() };
        prop_assert!(generators[1].is_shifted());
        prop_assert_eq!(resized.control_points.nrows(), fine.representation().size());
        let [norm, root] = squared_norms(&fine, &resized.control_points);
        let [wanted, _] = squared_norms(&space, &rows);
        prop_assert!((norm - wanted).abs() <= 1e-12 * wanted && (root - wanted).abs() <= 1e-11 * wanted, "{norm} {root} {wanted}");
        prop_assert!(assert_same_surface(&fine, [1, factor], seed, &places));
        // The net is that of the surface, and a constant is interpolated.
        let basis = fine.surface().unwrap();
        for &[u, v] in &places {
            let sum = basis.weights(u, v).into_iter().map(|(row, weight)| weight * resized.control_points[(row, 0)]).sum::<f64>();
            assert_close("weights", &[sum], &[basis.surface(&resized.control_points).point(u, v)[0]], 1e-12);
        }
        let ones = basis.interpolate_function(|_, _| [1.0; 3]);
        prop_assert!(ones.add_scalar(-1.0).amax() <= 1e-9);
    }
}

/// Closed directions have no use for a shift, and an even number of poles has its knots at the integers.
#[test]
fn shifted_splines_are_for_open_directions_and_odd_orders() {
    let poles = |order: usize| PoleList::on_grid(&vec![[0.0; 2]; order]);
    for order in [2, 3, 4, 5, 9, 10] {
        let kind = GeneratorKind::ShiftedExponential { poles: poles(order) };
        assert_eq!(kind.faults().is_empty(), order % 2 == 1 && order > 2, "{order}");
    }
    let kind = GeneratorKind::ShiftedExponential { poles: poles(3) };
    let circle = GeneratorKind::Trigonometric {};
    assert!(surfaces(Topology::Torus, Seam::Straight, [7, 6], [circle.clone(), kind.clone()]).is_err());
    assert!(surfaces(Topology::Cylinder, Seam::Straight, [7, 6], [circle, kind.clone()]).is_ok());
    assert!(closed(&kind, 7, 2).is_err());
    assert_eq!(open(&kind, 7, 2).unwrap().representation().size(), 9);
}
