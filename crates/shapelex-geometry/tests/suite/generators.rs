//! Generators against stored vectors, an independent closed form, and the laws of their families.

use std::f64::consts::{PI, TAU};

use proptest::prelude::*;
use serde_json::Value;
use shapelex_geometry::GeometryError;
use shapelex_geometry::generator::bspline::{exponential_bspline, normalised_bspline};
use shapelex_geometry::generator::{Generator, GeneratorKind, Poles, Recipe, evaluate_taylor};
use shapelex_geometry::knot_line::gram_row;
use shapelex_geometry::open::open_gram;
use shapelex_numeric::circulant::Circulant;
use shapelex_numeric::quadrature::GaussLegendre;

use crate::spaces::{closed, open};
use crate::vectors::{self, assert_close, list, load, number, numbers, text};

/// The recipe of a stored case; weights that it prescribes are keyed by the order of their B-spline.
pub(crate) fn recipe_of(case: &Value) -> Recipe {
    let poles = vectors::poles(&case["poles"]);
    match text(&case["family"]) {
        "bspline" => Recipe::Bspline(poles),
        "6.3" => Recipe::HalfIntegerShifts(poles),
        "6.2" => {
            let fixed = case.get("fixed").and_then(Value::as_object);
            let weights = (poles.order()..).map_while(|n| Some(number(fixed?.get(&n.to_string())?)));
            Recipe::IntegerShifts {
                support: case["support"].as_u64().unwrap() as usize,
                weights: weights.collect(),
                poles,
            }
        }
        family => panic!("unknown family {family}"),
    }
}

/// The generator of a stored case.
pub(crate) fn generator_of(case: &Value) -> Generator {
    recipe_of(case).build().unwrap().generator.as_ref().clone()
}

/// The entries of an object with number keys, by increasing key.
fn by_number(object: &Value) -> Vec<f64> {
    let mut entries: Vec<(usize, f64)> = object
        .as_object()
        .unwrap()
        .iter()
        .map(|(key, value)| (key.parse().unwrap(), number(value)))
        .collect();
    entries.sort_by_key(|entry| entry.0);
    entries.into_iter().map(|entry| entry.1).collect()
}

/// Rows `[t, value, d1, d2]`, each column with its own tolerance.
fn assert_samples(case: &Value, generator: &Generator, tolerances: [f64; 3]) {
    let rows: Vec<Vec<f64>> = list(&case["samples"]).iter().map(numbers).collect();
    for (derivative, tolerance) in tolerances.into_iter().enumerate() {
        let found: Vec<f64> = rows.iter().map(|row| generator.evaluate(row[0], derivative)).collect();
        let wanted: Vec<f64> = rows.iter().map(|row| row[derivative + 1]).collect();
        let what = format!("{} derivative {derivative}", text(&case["id"]));
        assert_close(&what, &found, &wanted, tolerance);
    }
}

#[test]
fn bsplines_equal_the_vectors() {
    let document = load("generators/bsplines.json");
    for case in vectors::cases(&document) {
        let id = text(&case["id"]);
        let poles = vectors::poles(&case["poles"]);
        assert_eq!(poles.order() as u64, case["order"].as_u64().unwrap(), "{id}");
        let one = |what: &str, found: f64, wanted: &Value| {
            assert_close(&format!("{id} {what}"), &[found], &[number(wanted)], 1e-14);
        };
        one("integral", poles.integral(), &case["integral"]);
        let polynomial = poles.characteristic_polynomial();
        assert_close(id, &polynomial, &numbers(&case["charpoly"]), 1e-14);
        assert_close(id, &poles.annihilator(), &numbers(&case["delta"]), 1e-14);
        let generator = exponential_bspline(&poles).unwrap();
        assert_eq!(generator.support(), poles.order());
        assert_samples(case, &generator, [1e-13; 3]);
    }
}

/// Samples to the tolerances of the vectors; weights lose the condition number of their system.
#[test]
fn interpolators_equal_the_vectors() {
    let document = load("generators/interpolators.json");
    for case in vectors::cases(&document) {
        let id = text(&case["id"]);
        let built = recipe_of(case).build().unwrap();
        assert_eq!(built.poles.order() as u64, case["n0"].as_u64().unwrap(), "{id}");
        assert_eq!(built.generator.support() as u64, case["support"].as_u64().unwrap(), "{id}");
        assert_eq!(built.generator.smoothness(), built.poles.order() - 2, "{id}");
        let integer_shifts = case["family"] == "6.2";
        let tolerances = match built.poles.order() {
            5 if integer_shifts => [2e-13, 2e-12, 2e-12],
            _ => [1e-13, 1e-12, 1e-12],
        };
        assert_samples(case, &built.generator, tolerances);
        let tolerance = f64::EPSILON * built.condition.unwrap().max(16.0);
        assert_close(id, built.weights.as_ref().unwrap(), &by_number(&case["lambda"]), tolerance);
    }
}

/// `∫ φ(t) φ'(t − m₁) φ(t − m₂) dt` by Gauss' rule on every piece.
fn triple_product(generator: &Generator, m1: isize, m2: isize) -> f64 {
    let rule = GaussLegendre::new(16);
    let pieces = 2 * generator.support() as isize;
    let inside = |p: &isize| [p - 2 * m1, p - 2 * m2].iter().all(|q| (0..pieces).contains(q));
    let integral = |p: isize| {
        let at = |q: isize, s: f64, d: usize| evaluate_taylor(generator.piece(q as usize), s, d);
        rule.integrate(-1.0, 1.0, |s| at(p, s, 0) * at(p - 2 * m1, s, 1) * at(p - 2 * m2, s, 0))
    };
    0.25 * (0..pieces).filter(inside).map(integral).sum::<f64>()
}

fn assert_triple_products(case: &Value, generator: &Generator) {
    let Some(table) = case.get("t010") else {
        // stored for short supports
        assert!(generator.support() > 4, "{}", case["id"]);
        return;
    };
    let (mut found, mut wanted) = (Vec::new(), Vec::new());
    for (key, value) in table.as_object().unwrap() {
        let (m1, m2) = key.split_once(',').unwrap();
        found.push(triple_product(generator, m1.parse().unwrap(), m2.parse().unwrap()));
        wanted.push(number(value));
    }
    assert_close(&format!("{} t010", case["id"]), &found, &wanted, 2e-13);
}

/// The Gram matrices of open curves, every entry above the diagonal.
fn assert_open_gram(case: &Value, generator: &Generator) {
    let stored = &case["gram_open"];
    let intervals = stored["M"].as_u64().unwrap() as usize;
    let first = (generator.support() as i64 + 1) / 2 - 1;
    assert_eq!(stored["first_index"], -first, "{}", case["id"]);
    for (derivative, name) in [(0, "upper"), (1, "upper_d1")] {
        let Some(rows) = stored.get(name) else {
            assert_eq!(derivative, 1);
            continue;
        };
        let gram = open_gram(generator, intervals, derivative);
        let wanted: Vec<f64> = list(rows).iter().flat_map(numbers).collect();
        let size = intervals + 1 + 2 * first as usize;
        let found: Vec<f64> =
            (0..size).flat_map(|i| (i..size).map(move |j| (i, j))).map(|(i, j)| gram.get(i, j)).collect();
        assert_close(&format!("{} {name}", case["id"]), &found, &wanted, 1e-13);
    }
}

fn assert_correlations(case: &Value, generator: &Generator) {
    let id = text(&case["id"]);
    for (name, d1, d2) in [("a00", 0, 0), ("a11", 1, 1), ("a22", 2, 2), ("a01", 0, 1)] {
        let Some(row) = case.get(name) else {
            assert_eq!((id, name), ("linear", "a22"));
            continue;
        };
        let parity = if d1 == d2 { 1.0 } else { -1.0 };
        let wanted = numbers(row);
        let at = |sign: isize| -> Vec<f64> {
            (0..wanted.len() as isize).map(|m| generator.correlation(d1, d2, sign * m)).collect()
        };
        assert_close(&format!("{id} {name}"), &at(1), &wanted, 2e-13);
        let mirrored: Vec<f64> = wanted.iter().map(|v| parity * v).collect();
        assert_close(&format!("{id} {name} at −m"), &at(-1), &mirrored, 2e-13);
    }
}

#[test]
fn inner_products_equal_the_vectors() {
    let document = load("generators/products.json");
    for case in vectors::cases(&document) {
        let (id, generator) = (text(&case["id"]), generator_of(case));
        assert_correlations(case, &generator);
        assert_triple_products(case, &generator);
        assert_open_gram(case, &generator);
        for (size, row) in case["gram_periodic"].as_object().unwrap() {
            let found = gram_row(&generator, size.parse().unwrap(), 0, 0);
            assert_close(&format!("{id} Φ, M = {size}"), &found, &numbers(row), 1e-13);
        }
        // The stored grid of [0, π] has 2001 points: these are the eigenvalues of size 4000.
        let operator = Circulant::new(&gram_row(&generator, 4000, 0, 0)).unwrap();
        let values = operator.eigenvalues().iter().map(|value| 4000.0 * value);
        let (low, high) = values.fold((f64::MAX, f64::MIN), |(a, b), v| (a.min(v), b.max(v)));
        let wanted = numbers(&case["riesz_sq"]);
        assert_close(&format!("{id} Riesz"), &[low, high], &wanted, 1e-11);
        // its own grid is twice as fine: extremes between the points of the other one may be larger by their bend
        let bounds = generator.riesz_bounds_squared();
        assert!(bounds.0 <= low + 1e-14 && high <= bounds.1 + 1e-14, "{id} Riesz {bounds:?}");
        assert_close(&format!("{id} Riesz"), &[bounds.0, bounds.1], &wanted, 1e-5);
    }
}

/// `φ_M` and `φ_M'` by truncated powers, free of cancellation for every `M ≥ 3`.
///
/// ```text
/// x = 2 − |t|,  R₃(x) = ½ x₊² sinc²(ωx/2),  R₄(x) = x₊³ c₃(ω²x²),  R₃' = x₊ sinc(ωx),  R₄' = R₃
/// φ = λ₄ [R₄(x) − 2(1 + cos ω) R₄(x − 1)] + λ₃ [R₃(x) − 2 cos ω R₃(x − 1)]
/// ```
struct ClosedForm {
    omega: f64,
    lambda3: f64,
    lambda4: f64,
}

impl ClosedForm {
    fn new(size: usize) -> Self {
        let omega = TAU / size as f64;
        let (s3, sinc2) = (c3(omega * omega), sinc(omega / 2.0).powi(2));
        let lambda4 = 1.0 / (sinc2 - 4.0 * s3);
        Self { omega, lambda3: -2.0 * lambda4 * s3 / sinc2, lambda4 }
    }

    fn r3(&self, x: f64) -> f64 {
        0.5 * x.max(0.0).powi(2) * sinc(0.5 * self.omega * x).powi(2)
    }

    fn r4(&self, x: f64) -> f64 {
        x.max(0.0).powi(3) * c3((self.omega * x).powi(2))
    }

    fn value(&self, t: f64) -> f64 {
        let (x, c) = (2.0 - t.abs(), self.omega.cos());
        self.lambda4 * (self.r4(x) - 2.0 * (1.0 + c) * self.r4(x - 1.0))
            + self.lambda3 * (self.r3(x) - 2.0 * c * self.r3(x - 1.0))
    }

    fn slope(&self, t: f64) -> f64 {
        let (x, c) = (2.0 - t.abs(), self.omega.cos());
        let r3_slope = |x: f64| x.max(0.0) * sinc(self.omega * x);
        let in_x = self.lambda4 * (self.r3(x) - 2.0 * (1.0 + c) * self.r3(x - 1.0))
            + self.lambda3 * (r3_slope(x) - 2.0 * c * r3_slope(x - 1.0));
        -t.signum() * in_x
    }
}

fn sinc(x: f64) -> f64 {
    if x == 0.0 { 1.0 } else { x.sin() / x }
}

/// `c₃(y) = Σ (−y)ⁿ/(2n+3)! = (√y − sin √y)/y^{3/2}`, the series by Horner's rule.
fn c3(y: f64) -> f64 {
    if y >= 4.0 {
        let root = y.sqrt();
        return (root - root.sin()) / (y * root);
    }
    let nested = (1..13).rev().fold(1.0, |sum, n| {
        let k = 2.0 * n as f64 + 2.0;
        1.0 - y / (k * (k + 1.0)) * sum
    });
    nested / 6.0
}

#[test]
fn trigonometric_equals_the_closed_form_at_any_size() {
    for size in [3, 4, 5, 10, 100, 1_000, 30_000, 1_000_000] {
        let generator = GeneratorKind::Trigonometric {}.build(size).unwrap().generator.clone();
        let closed = ClosedForm::new(size);
        for i in 0..=4600 {
            let t = -2.3 + i as f64 * 1e-3 + 1e-4;
            let pair = [generator.evaluate(t, 0), generator.evaluate(t, 1)];
            let what = format!("M = {size}, t = {t}");
            assert_close(&what, &pair, &[closed.value(t), closed.slope(t)], 1e-13);
            assert_close(&what, &[shifted_sum(&generator, t, |_| 1.0)], &[1.0], 1e-13);
        }
        // φ'(1) = −(π/M)/sin(2π/M),  φ(3/2) = −1/(8c(1 + c)),  c = cos(π/M)
        let half = PI / size as f64;
        let c = half.cos();
        let found = [generator.evaluate(1.0, 1), generator.evaluate(1.5, 0), generator.evaluate(0.5, 0)];
        let tail = -1.0 / (8.0 * c * (1.0 + c));
        let wanted = [-half / (2.0 * half).sin(), tail, 0.5 - tail];
        assert_close(&format!("M = {size}"), &found, &wanted, 1e-13);
    }
}

#[test]
fn trigonometric_tends_to_keys_quadratically() {
    let keys = GeneratorKind::Cubic {}.build(3).unwrap().generator.clone();
    for size in [1_000_usize, 10_000, 100_000, 1_000_000] {
        let generator = GeneratorKind::Trigonometric {}.build(size).unwrap().generator.clone();
        let largest = (0..=4000)
            .map(|i| i as f64 * 5e-4)
            .map(|t| (generator.evaluate(t, 0) - keys.evaluate(t, 0)).abs())
            .fold(0.0, f64::max);
        let rate = (size as f64).powi(2) * largest;
        assert!((rate - 0.5367).abs() <= 1e-3, "M = {size}: {rate}");
    }
}

#[test]
fn keys_is_its_polynomial() {
    let keys = GeneratorKind::Cubic {}.build(3).unwrap().generator.clone();
    for i in -250..=250 {
        let t = i as f64 * 0.01;
        let a: f64 = t.abs();
        let wanted = if a <= 1.0 {
            1.0 - 2.5 * a * a + 1.5 * a.powi(3)
        } else if a <= 2.0 {
            -0.5 * (a - 2.0).powi(2) * (a - 1.0)
        } else {
            0.0
        };
        assert_close(&format!("t = {t}"), &[keys.evaluate(t, 0)], &[wanted], 1e-14);
    }
}

/// `Σ_k f(k) φ(t − k)`.
pub(crate) fn shifted_sum(generator: &Generator, t: f64, f: impl Fn(f64) -> f64) -> f64 {
    let reach = generator.support() as f64 / 2.0;
    ((t - reach).floor() as i64..=(t + reach).ceil() as i64)
        .map(|k| f(k as f64) * generator.evaluate(t - k as f64, 0))
        .sum()
}

/// Jump of a derivative at the left end of piece `p`; `p = 2N` is the right end of the support.
fn jump(generator: &Generator, p: usize, derivative: usize) -> f64 {
    let right =
        if p < 2 * generator.support() { evaluate_taylor(generator.piece(p), -1.0, derivative) } else { 0.0 };
    let left = if p > 0 { evaluate_taylor(generator.piece(p - 1), 1.0, derivative) } else { 0.0 };
    right - left
}

pub(crate) fn largest_jump(generator: &Generator, derivative: usize) -> f64 {
    (0..=2 * generator.support()).map(|p| jump(generator, p, derivative).abs()).fold(0.0, f64::max)
}

/// Size of a derivative, at least 1.
pub(crate) fn magnitude(generator: &Generator, derivative: usize) -> f64 {
    (0..2 * generator.support())
        .map(|p| evaluate_taylor(generator.piece(p), 0.0, derivative).abs())
        .fold(1.0, f64::max)
}

fn kind() -> impl Strategy<Value = GeneratorKind> {
    prop::sample::select(GeneratorKind::catalogue())
}

fn admissible_poles() -> impl Strategy<Value = Poles> {
    (
        1_usize..4,
        prop::collection::vec(0.0..3.1, 0..3),
        prop::collection::vec(0.0..3.0, 0..2),
        prop::collection::vec((0.1..2.0, 0.0..3.0), 0..2),
    )
        .prop_map(|(zeros, trigonometric, hyperbolic, quadruples)| Poles {
            zeros,
            trigonometric,
            hyperbolic,
            quadruples,
        })
        .prop_filter("at most seven poles", |poles| (2..=7).contains(&poles.order()))
}

proptest! {
    #[test]
    fn laws_of_the_catalogue(kind in kind(), size in 3_usize..=2000, t in -3.5..3.5) {
        let generator = kind.build(size).unwrap().generator.clone();
        let properties = kind.properties();
        prop_assert_eq!(generator.support(), properties.support);
        for derivative in 0..=properties.smoothness {
            let sign = if derivative % 2 == 0 { 1.0 } else { -1.0 };
            let scale = magnitude(&generator, derivative);
            let odd = generator.evaluate(t, derivative) - sign * generator.evaluate(-t, derivative);
            prop_assert!(odd.abs() <= 1e-13 * scale, "{kind:?}: not even by {odd:e} at {t}");
            let jump = largest_jump(&generator, derivative);
            prop_assert!(jump <= 1e-13 * scale, "{kind:?}: derivative {derivative} jumps by {jump:e}");
        }
        prop_assert!(largest_jump(&generator, properties.smoothness + 1) > 0.1);
        if t.abs() >= properties.support as f64 / 2.0 {
            prop_assert_eq!(generator.evaluate(t, 0), 0.0);
        }
        let sum = shifted_sum(&generator, t, |_| 1.0);
        prop_assert!((sum - 1.0).abs() <= 1e-13, "{kind:?}: partition of unity {sum}");
        let central = (0..4).map(|k| generator.evaluate(k as f64, 0) - f64::from(k == 0));
        let deviation = central.fold(0.0, |m: f64, v| m.max(v.abs()));
        prop_assert_eq!(deviation <= 1e-13, properties.interpolating, "{:?}: {}", kind, deviation);
    }

    #[test]
    fn trigonometric_reproduces_the_circle(size in 3_usize..=2000, t in -50.0..50.0) {
        let generator = GeneratorKind::Trigonometric {}.build(size).unwrap().generator.clone();
        let omega = TAU / size as f64;
        let cosine = shifted_sum(&generator, t, |k| (omega * k).cos());
        let sine = shifted_sum(&generator, t, |k| (omega * k).sin());
        prop_assert!((cosine - (omega * t).cos()).abs() <= 1e-13, "{cosine}");
        prop_assert!((sine - (omega * t).sin()).abs() <= 1e-13, "{sine}");
    }

    #[test]
    fn polynomials_are_reproduced(degree in 1_u8..=5, t in -3.0..3.0) {
        let keys = GeneratorKind::Cubic {}.build(3).unwrap().generator.clone();
        for power in 1..=2 {
            let sum = shifted_sum(&keys, t, |k| k.powi(power));
            prop_assert!((sum - t.powi(power)).abs() <= 2e-13, "Keys, {power}: {sum}");
        }
        // The second moment of a B-spline is (degree + 1)/12.
        let spline = GeneratorKind::Bspline { degree }.build(3).unwrap().generator.clone();
        let linear = shifted_sum(&spline, t, |k| k);
        prop_assert!((linear - t).abs() <= 2e-13, "degree {degree}: {linear}");
        if degree >= 2 {
            let square = shifted_sum(&spline, t, |k| k * k);
            let wanted = t * t + f64::from(degree + 1) / 12.0;
            prop_assert!((square - wanted).abs() <= 4e-13, "degree {degree}: {square} for {wanted}");
        }
    }

    /// φ̂(ω) = 1 at its pole: Σ a₀₀ cos ωm = 1, Σ a₀₁ sin ωm = ω, Σ a₁₁ cos ωm = ω², Σ a₂₂ cos ωm = ω⁴.
    #[test]
    fn correlations_know_the_pole(size in 3_usize..=2000) {
        let generator = GeneratorKind::Trigonometric {}.build(size).unwrap().generator.clone();
        let omega = TAU / size as f64;
        let sum = |d1, d2, f: &dyn Fn(f64) -> f64| -> f64 {
            (-3..=3).map(|m| generator.correlation(d1, d2, m) * f(m as f64)).sum()
        };
        let cosine = |m: f64| (omega * m).cos();
        let found = [
            sum(0, 0, &cosine),
            sum(0, 0, &|_| 1.0),
            sum(0, 1, &|m| (omega * m).sin()),
            sum(0, 1, &|m| m),
            sum(1, 1, &cosine),
            sum(1, 1, &|_| 1.0),
        ];
        assert_close("Σ a", &found, &[1.0, 1.0, omega, 1.0, omega.powi(2), 0.0], 2e-13);
        let largest = generator.correlation(2, 2, 0);
        let bend = [sum(2, 2, &cosine) / largest, sum(2, 2, &|_| 1.0) / largest];
        assert_close("Σ a₂₂", &bend, &[omega.powi(4) / largest, 0.0], 2e-13);
    }

    /// Order N: C^{N−2}, even, integral one after normalisation, partition of unity with a zero pole.
    #[test]
    fn laws_of_bsplines(poles in admissible_poles(), t in 0.0..1.0) {
        let generator = normalised_bspline(&poles).unwrap();
        for derivative in 0..=poles.order() - 2 {
            let jump = largest_jump(&generator, derivative);
            let scale = magnitude(&generator, derivative);
            prop_assert!(jump <= 1e-12 * scale, "derivative {derivative} of {poles:?} jumps by {jump:e}");
        }
        let sum = shifted_sum(&generator, t, |_| 1.0);
        prop_assert!((sum - 1.0).abs() <= 1e-13, "{poles:?}: {sum}");
        let odd = generator.evaluate(t, 0) - generator.evaluate(-t, 0);
        prop_assert!(odd.abs() <= 1e-13);
    }

    #[test]
    fn poles_outside_the_strip_are_refused(excess in 0.0..5.0, inside in 0.0..3.0) {
        for omega in [PI + excess, -PI - excess, f64::NAN] {
            let mut poles = Poles::trigonometric(1, inside);
            poles.trigonometric.push(omega);
            let refused = matches!(exponential_bspline(&poles), Err(GeometryError::Pole { .. }));
            prop_assert!(refused, "{poles:?}");
        }
    }
}

#[test]
fn too_few_points_and_empty_lists_are_refused() {
    for kind in GeneratorKind::catalogue() {
        for found in 0..3 {
            let refusal = GeometryError::TooFewPoints { found, needed: 3 };
            assert_eq!(closed(&kind, found, 2).unwrap_err(), refusal, "{kind:?}");
        }
        closed(&kind, 3, 2).unwrap();
        let needed = kind.properties().fewest_intervals;
        for found in 0..needed {
            let refusal = GeometryError::TooFewPoints { found, needed };
            assert_eq!(open(&kind, found, 2).unwrap_err(), refusal, "{kind:?}");
        }
        open(&kind, needed, 2).unwrap();
    }
    assert!(exponential_bspline(&Poles::default()).is_err());
}
