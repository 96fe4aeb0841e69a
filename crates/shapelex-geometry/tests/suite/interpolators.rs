//! The laws of both families of interpolators, for random lists of poles, and what is refused.

use std::f64::consts::{PI, TAU};

use proptest::prelude::*;
use shapelex_geometry::GeometryError;
use shapelex_geometry::curve::Curve;
use shapelex_geometry::generator::{
    Built, Exact, Family, Generator, GeneratorKind, MAX_POLES, PoleList, Poles, Recipe,
};
use shapelex_numeric::dense::Matrix;

use crate::generators::{largest_jump, magnitude, shifted_sum};
use crate::spaces::interpolator;

const FAMILIES: [Family; 2] = [Family::IntegerShifts, Family::HalfIntegerShifts];

/// The interpolator with the shortest support.
fn recipe(family: Family, poles: Poles) -> Recipe {
    match family {
        Family::HalfIntegerShifts => Recipe::HalfIntegerShifts(poles),
        Family::IntegerShifts => {
            Recipe::IntegerShifts { support: 2 * (poles.order() - 1), poles, weights: Vec::new() }
        }
    }
}

fn build(family: Family, poles: &Poles) -> Built {
    recipe(family, poles.clone()).build().unwrap_or_else(|error| panic!("{family:?}, {poles:?}: {error}"))
}

/// Highest frequency of the random lists: towards π the samples of a wave determine it less and less, and the
/// condition of the interpolation systems grows without bound.
const HIGHEST: f64 = 2.8;

/// Lists of `orders` poles: pairs and quadruples while there is room, then zeros.
fn poles_of(orders: std::ops::RangeInclusive<usize>) -> impl Strategy<Value = Poles> {
    let entry = (0..3_u8, 0.3..HIGHEST, 0.1..2.0);
    (orders, prop::collection::vec(entry, 0..4)).prop_map(|(order, entries)| {
        let mut poles = Poles::default();
        for (kind, omega, real) in entries {
            match (kind, order - poles.order()) {
                (0, 2..) => poles.trigonometric.push(omega),
                (1, 2..) => poles.hyperbolic.push(real),
                (2, 4..) => poles.quadruples.push((real, omega)),
                _ => {}
            }
        }
        Poles { zeros: poles.zeros + order - poles.order(), ..poles }
    })
}

fn family() -> impl Strategy<Value = Family> {
    prop::sample::select(FAMILIES.to_vec())
}

/// What rounding may leave of values that are at most one. In `f64`, five poles of integer shifts lose the condition
/// of their system, up to `5·10⁻¹³`; everything of higher order is built in double-double arithmetic.
const VALUES: f64 = 1e-12;

/// The same for derivatives above the second, relative to their size: no curve offers them, and the Taylor vectors
/// end where only they would notice.
const HIGH_DERIVATIVES: f64 = 1e-9;

/// `max |Σ_k f(k) φ(t − k) − f(t)|` relative to the largest sample that takes part, and to the generator where that
/// is large between the knots, as free weights can make it.
fn reproduction_error(generator: &Generator, f: impl Fn(f64) -> f64, t: f64) -> f64 {
    let reach = generator.support() as f64 / 2.0 + 1.0;
    let largest = [t - reach, t, t + reach].iter().fold(1.0, |m: f64, t| m.max(f(*t).abs()));
    (shifted_sum(generator, t, &f) - f(t)).abs() / (largest * magnitude(generator, 0))
}

/// The product of all poles, in absolute value.
fn product(poles: &Poles) -> f64 {
    let pairs = poles.trigonometric.iter().chain(&poles.hyperbolic).map(|q| q * q);
    let quadruples = poles.quadruples.iter().map(|(a, b)| (a * a + b * b).powi(2));
    pairs.chain(quadruples).product()
}

/// `φ(k) = δ_k`, evenness, `C^{n₀−2}` and no more, partition of unity iff 0 is a pole.
fn assert_shape(built: &Built, t: f64) {
    let (generator, poles) = (&built.generator, &built.poles);
    let what = format!("{poles:?}, condition {:.1e}", built.condition.unwrap());
    for k in -10..=10 {
        let error = generator.evaluate(f64::from(k), 0) - f64::from(k == 0);
        assert!(error.abs() <= VALUES, "{what}: φ({k}) errs by {error:e}");
    }
    for derivative in 0..=poles.order() - 2 {
        let scale = magnitude(generator, derivative);
        let jump = largest_jump(generator, derivative) / scale;
        let allowed = if derivative > 2 { HIGH_DERIVATIVES } else { VALUES };
        assert!(jump <= allowed, "{what}: derivative {derivative} jumps by {jump:e}");
        let sign = if derivative % 2 == 0 { 1.0 } else { -1.0 };
        let odd = generator.evaluate(t, derivative) - sign * generator.evaluate(-t, derivative);
        assert!(odd.abs() <= VALUES * scale, "{what}: derivative {derivative} is not even by {odd:e}");
    }
    assert!(largest_jump(generator, poles.order() - 1) > 1e-3, "{what}: too smooth");
    let deviation = (0..20)
        .map(|i| (shifted_sum(generator, f64::from(i) / 20.0, |_| 1.0) - 1.0).abs())
        .fold(0.0, f64::max);
    if poles.zeros > 0 {
        assert!(deviation <= VALUES, "{what}: sums to one up to {deviation:e}");
    } else {
        // The operator maps 1 to the product of the poles: the deviation of small poles is proportional to it.
        let least = 1e-9 * product(poles).min(1.0);
        assert!(deviation > least, "{what}: sums to one up to {deviation:e}, expected more than {least:e}");
    }
}

/// The null space of `L_α` from its samples: `tᵏ`, `cos`, `sin`, `cosh`, `e^{at} cos bt`.
fn assert_reproduction(built: &Built, t: f64) {
    let (generator, poles) = (&built.generator, &built.poles);
    let check = |name: &str, f: &dyn Fn(f64) -> f64| {
        let error = reproduction_error(generator, f, t);
        let condition = built.condition.unwrap();
        assert!(error <= VALUES, "{poles:?}, condition {condition:.1e}: {name} errs by {error:e}");
    };
    for power in 0..poles.zeros as i32 {
        check("a power", &|t| t.powi(power));
    }
    for &w in &poles.trigonometric {
        check("cos", &|t| (w * t).cos());
        check("sin", &|t| (w * t).sin());
    }
    for &a in &poles.hyperbolic {
        check("cosh", &|t| (a * t).cosh());
        check("sinh", &|t| (a * t).sinh());
    }
    for &(a, b) in &poles.quadruples {
        check("exp cos", &|t| (a * t).exp() * (b * t).cos());
        check("exp sin", &|t| (-a * t).exp() * (b * t).sin());
    }
}

/// `φ̂(ω) = 1` at every frequency that is reproduced:
/// `Σ a₀₀ cos ωm = 1, Σ a₀₁ sin ωm = ω, Σ a₁₁ cos ωm = ω², Σ a₂₂ cos ωm = ω⁴`, and at ω = 0 `Σ m a₀₁ = 1`;
/// `a₀₁` is odd, and `a₀₀` positive.
fn assert_correlations(built: &Built) {
    let (generator, poles) = (&built.generator, &built.poles);
    let reach = generator.support() as isize - 1;
    let sum = |d1, d2, f: &dyn Fn(f64) -> f64| -> f64 {
        (-reach..=reach).map(|m| generator.correlation(d1, d2, m) * f(m as f64)).sum()
    };
    let scale = |d1, d2| -> f64 {
        (-reach..=reach).map(|m| generator.correlation(d1, d2, m).abs()).sum::<f64>().max(1.0)
    };
    let check = |d1, d2, f: &dyn Fn(f64) -> f64, wanted: f64| {
        let error = (sum(d1, d2, f) - wanted).abs() / scale(d1, d2);
        // A product of two values, each of which may err by `VALUES`.
        assert!(error <= 2.0 * VALUES, "{poles:?}: a{d1}{d2} errs by {error:e}");
    };
    for &w in &poles.trigonometric {
        let cosine = |m: f64| (w * m).cos();
        check(0, 0, &cosine, 1.0);
        check(0, 1, &|m| (w * m).sin(), w);
        check(1, 1, &cosine, w.powi(2));
        check(2, 2, &cosine, w.powi(4));
    }
    if poles.zeros > 0 {
        check(0, 0, &|_| 1.0, 1.0);
        check(0, 1, &|m| m / (reach as f64), 1.0 / reach as f64);
        check(1, 1, &|_| 1.0, 0.0);
        check(2, 2, &|_| 1.0, 0.0);
    }
    for m in 0..=reach {
        let even = generator.correlation(0, 1, m) + generator.correlation(0, 1, -m);
        assert!(even.abs() <= VALUES * scale(0, 1), "{poles:?}: a01 is not odd by {even:e}");
    }
    let (low, high) = generator.riesz_bounds_squared();
    assert!(0.1 < low && low <= high, "{poles:?}: Riesz bounds {low}, {high}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(128))]

    #[test]
    fn laws_of_interpolators(family in family(), poles in poles_of(3..=8), t in -1.0..1.0) {
        let built = build(family, &poles);
        prop_assert_eq!(built.generator.support(), 2 * (poles.order() - 1));
        assert_shape(&built, t * poles.order() as f64);
        assert_reproduction(&built, t);
        assert_correlations(&built);
    }

    #[test]
    fn laws_of_long_interpolators(family in family(), poles in poles_of(9..=MAX_POLES), t in -1.0..1.0) {
        let built = build(family, &poles);
        assert_shape(&built, t * poles.order() as f64);
        assert_reproduction(&built, t);
        assert_correlations(&built);
    }

    /// Odd supports, and longer ones with free weights, obey the same laws.
    #[test]
    fn laws_of_other_supports(
        poles in poles_of(3..=5),
        longer in 1_usize..=10,
        weights in prop::collection::vec(-1.0..1.0, 0..4),
        t in -1.0..1.0,
    ) {
        let support = 2 * (poles.order() - 1) + longer;
        let free = support / 2 + 1 - poles.order();
        let weights: Vec<f64> = weights.into_iter().take(free).collect();
        let recipe = Recipe::IntegerShifts { poles: poles.clone(), support, weights: weights.clone() };
        let built = recipe.build().unwrap();
        prop_assert_eq!(built.generator.support(), support);
        prop_assert_eq!(&built.weights.as_ref().unwrap()[..weights.len()], &weights[..]);
        assert_reproduction(&built, t);
        assert_correlations(&built);
        for k in -10..=10 {
            let error = built.generator.evaluate(f64::from(k), 0) - f64::from(k == 0);
            prop_assert!(error.abs() <= VALUES, "φ({k}) errs by {error:e}");
        }
    }

    #[test]
    fn poles_outside_the_strip_are_refused(family in family(), excess in 0.0..5.0, inside in 0.0..3.0) {
        for omega in [PI + excess, -PI - excess, f64::NAN] {
            let mut poles = Poles::trigonometric(1, inside);
            poles.trigonometric.push(omega);
            let refusal = recipe(family, poles).build().unwrap_err();
            prop_assert!(matches!(refusal, GeometryError::Pole { .. }), "{refusal}");
        }
    }
}

/// `(0, ±2πj)` on the whole domain.
fn ellipses(family: Family) -> GeneratorKind {
    interpolator(family, PoleList::from_domain(&[[0.0, 0.0], [0.0, TAU], [0.0, -TAU]]))
}

/// The limit is reached quadratically, and no oscillation sets in: closed trigonometric forms lose `10⁻¹⁸ M⁴`.
#[test]
fn many_control_points_come_near_the_limit() {
    for family in FAMILIES {
        let limit = build(family, &Poles::zeros(3));
        for size in [90_000_usize, 1_000_000] {
            let built = ellipses(family).build(size).unwrap();
            let allowed = 2.0 / (size as f64).powi(2) + 1e-14;
            for i in 0..=4000 {
                let t = -2.0 + f64::from(i) * 1e-3;
                let error = built.generator.evaluate(t, 0) - limit.generator.evaluate(t, 0);
                assert!(error.abs() <= allowed, "{family:?}, M = {size}, t = {t}: {error:e}");
            }
            for k in -2..=2 {
                let error = built.generator.evaluate(f64::from(k), 0) - f64::from(k == 0);
                assert!(error.abs() <= 1e-14, "{family:?}, M = {size}: φ({k}) errs by {error:e}");
            }
        }
    }
}

#[test]
fn many_control_points_reproduce_the_circle() {
    for family in FAMILIES {
        for size in [90_000_usize, 1_000_000] {
            let generator = ellipses(family).build(size).unwrap().generator.clone();
            let omega = TAU / size as f64;
            for i in 0..20_000 {
                // by whole knots and a fraction, so that the parameter has all its digits
                let (knot, fraction) = (((i * 7919) % size) as f64, (i as f64 * 0.618_033_988_749_895) % 1.0);
                let sum = |f: fn(f64) -> f64| shifted_sum(&generator, fraction, |k| f(omega * (knot + k)));
                let angle = omega * (knot + fraction);
                let error = (sum(f64::cos) - angle.cos()).hypot(sum(f64::sin) - angle.sin());
                assert!(error <= 1e-14, "{family:?}, M = {size}, t = {knot} + {fraction}: {error:e}");
            }
        }
    }
}

#[test]
fn a_circle_of_many_control_points_is_a_circle() {
    const SIZE: usize = 90_000;
    let circle = |u: f64| [(TAU * u).cos(), (TAU * u).sin()];
    let points = Matrix::from_fn(SIZE, 2, |k, c| circle(k as f64 / SIZE as f64)[c]);
    for family in FAMILIES {
        let curve = Curve::closed(&ellipses(family).build(SIZE).unwrap().generator, &points);
        for i in 0..10_000 {
            let u = (f64::from(i) * 0.618_033_988_749_895) % 1.0;
            let (found, wanted) = (curve.evaluate(u, 0), circle(u));
            let error = (found[0] - wanted[0]).hypot(found[1] - wanted[1]);
            assert!(error <= 1e-12, "{family:?}, u = {u}: {error:e}");
        }
    }
}

/// The only fault of `kind`.
fn fault(kind: &GeneratorKind) -> (String, String) {
    let mut faults = kind.faults();
    assert_eq!(faults.len(), 1, "{kind:?}: {faults:?}");
    faults.remove(0)
}

/// `tan x = x` at `ω* = 2x`: no interpolator exists, though the shifts of the B-spline are a Riesz basis.
#[test]
fn the_singular_frequency_is_refused_by_name() {
    const SINGULAR: f64 = 8.98681891;
    let list = [[0.0, 0.0], [0.0, SINGULAR], [0.0, -SINGULAR]];
    for family in FAMILIES {
        let (field, detail) = fault(&interpolator(family, PoleList::on_grid(&list)));
        assert_eq!(field, "poles");
        assert!(detail.contains("8.98681891"), "{detail}");
        let refusal = recipe(family, Poles::trigonometric(1, SINGULAR)).build().unwrap_err();
        assert_eq!(refusal, GeometryError::Pole { re: 0.0, im: SINGULAR });
        assert!(refusal.to_string().contains("8.98681891"), "{refusal}");
    }
    // of the domain, the same list is admissible on fine grids
    let kind = interpolator(Family::IntegerShifts, PoleList::from_domain(&list));
    assert_eq!(kind.faults(), []);
    assert_eq!(kind.properties().fewest_control_points, 3);
    assert!(matches!(kind.build(2), Err(GeometryError::Pole { .. })));
    kind.build(3).unwrap();
}

#[test]
fn asymmetric_lists_name_the_missing_partner() {
    for (list, index, pole, missing) in [
        (vec![[0.0, 0.0], [0.0, 1.5], [0.0, 2.0], [0.0, -2.0]], 1, "1.5i", "-1.5i"),
        (vec![[0.0, 0.0], [0.0, 0.0], [0.75, 0.0]], 2, "0.75", "-0.75"),
        (vec![[1.0, 0.5], [-1.0, 0.5], [-1.0, -0.5]], 0, "1+0.5i", "1-0.5i"),
        (vec![[0.0, 1.0], [0.0, -1.0], [0.0, 1.0]], 0, "1i", "-1i"),
    ] {
        for poles in [PoleList::on_grid(&list), PoleList::from_domain(&list)] {
            let field = format!("{}/{index}", poles.field());
            let exponential = GeneratorKind::Exponential { poles: poles.clone() };
            for kind in
                FAMILIES.map(|family| interpolator(family, poles.clone())).iter().chain([&exponential])
            {
                let (found, detail) = fault(kind);
                assert_eq!(found, field, "{detail}");
                assert!(detail.contains(&format!("pole {pole} lacks its partner {missing}:")), "{detail}");
                assert!(matches!(kind.build(9), Err(GeometryError::Unpaired { .. })));
            }
        }
    }
}

#[test]
fn lists_of_a_wrong_length_are_refused() {
    for count in [0, 1, 2, MAX_POLES + 1] {
        let poles = PoleList::on_grid(&vec![[0.0, 0.0]; count]);
        for family in FAMILIES {
            let (field, detail) = fault(&interpolator(family, poles.clone()));
            assert_eq!(field, "poles");
            assert!(detail.contains(&format!("got {count}")), "{detail}");
        }
        let faults = GeneratorKind::Exponential { poles }.faults();
        assert_eq!(faults.is_empty(), count == 2, "{faults:?}");
    }
    for count in 3..=MAX_POLES {
        for family in FAMILIES {
            let kind = interpolator(family, PoleList::on_grid(&vec![[0.0, 0.0]; count]));
            assert_eq!(kind.faults(), []);
            kind.build(9).unwrap();
        }
    }
}

#[test]
fn wrong_supports_and_weights_are_refused() {
    let kind = |family, support, weights: &[f64]| GeneratorKind::Interpolator {
        family,
        poles: PoleList::on_grid(&[[0.0, 0.0]; 4]),
        support,
        weights: weights.iter().map(|&weight| Exact::new(weight)).collect(),
    };
    let integer = Family::IntegerShifts;
    for support in [0, 1, 5, 19, usize::MAX] {
        let (field, detail) = fault(&kind(integer, Some(support), &[]));
        assert_eq!(field, "support");
        assert!(detail.contains(&support.to_string()), "{detail}");
    }
    // ⌊N/2⌋ + 1 − n₀ weights are free
    for (support, free) in [(6, 0), (7, 0), (8, 1), (9, 1), (10, 2), (18, 6)] {
        assert_eq!(kind(integer, Some(support), &vec![0.5; free]).faults(), []);
        let (field, detail) = fault(&kind(integer, Some(support), &vec![0.5; free + 1]));
        assert_eq!(field, "weights");
        assert!(detail.contains(&format!("at most {free} weights")), "{detail}");
    }
    assert_eq!(fault(&kind(integer, Some(8), &[1e9])).0, "weights/0");
    assert_eq!(fault(&kind(integer, Some(8), &[f64::NAN])).0, "weights/0");
    assert_eq!(fault(&kind(Family::HalfIntegerShifts, Some(6), &[])).0, "support");
    assert_eq!(fault(&kind(Family::HalfIntegerShifts, None, &[0.5])).0, "weights");
}
