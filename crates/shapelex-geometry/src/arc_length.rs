//! Length of a curve: a Gauss rule on every half-segment, and on parts of those where it does not converge fast enough.
//!
//! ```text
//! ∫_{−1}^{1} |r'(s)| ds ≈ Σ_i w_i |r'(s_i)|,  12 nodes        a_k = (2k + 1) Σ_i w_i P_k(s_i) |r'(s_i)|,  k = 8 … 11
//! ```
//!
//! The Legendre coefficients `a_k` of the speed decrease as `ρ⁻ᵏ` and the error of the rule as `ρ⁻²⁴`, where `ρ` belongs to the
//! nearest complex zero of `|r'|²`. With `a = max(|a_10|, |a_11|)` and `b = max(|a_8|, |a_9|)`, two estimates of `ρ⁻¹⁰` are `a`
//! relative to the integral, and `(a/b)⁵`; a times the larger one bounds the error with a margin of `ρ⁴`. The second one is 1 where
//! a dip that is narrower than the distance of the nodes makes the coefficients equal.
//!
//! No node sees a dip between the last node and the end of the half-segment, but the ends do. With `e` the difference between the
//! speed at an end and the interpolation polynomial there, twice the larger one, `e ≈ 2 ρ⁻¹²` for a smooth speed, so `e²` relative
//! to the integral is of the order of the error. A dip `κ |s − x|` at the distance `δ` from the end has the error `κ δ²` and
//! `e = 4 κ δ`: [`MARGIN`] times this estimate bounds it for `κ` from 1/512 of the mean speed on.

use std::sync::LazyLock;

use super::columns::{Columns, LANES, Lanes, place};
use shapelex_numeric::bounded::{Allowance, Stop};
use shapelex_numeric::lanes::vectorised;
use shapelex_numeric::quadrature::GaussLegendre;

/// Nodes of the rule, exact for degree 23.
const NODES: usize = 12;
/// Pairs of nodes `±s`.
const PAIRS: usize = NODES / 2;

/// The first of the Legendre coefficients that show how fast they decrease.
const FIRST: usize = NODES - 4;

/// Factor of the error that differences at the ends show.
const MARGIN: f64 = 64.0;

/// Error of a half-segment, as a fraction of the mean length of one, up to which it is not divided.
const TOLERANCE: f64 = 1e-11;

/// Relative rounding error of a sum of some twenty terms of one sign: more accuracy is not asked for.
const ROUNDING: f64 = 4.0 * f64::EPSILON;

/// Maximum number of bisections of a half-segment: its parts are then rounding errors of the first.
const MAX_LEVELS: u32 = 40;

/// Maximum number of panels that are bisected in a curve, besides those per half-segment. A cusp takes 40.
const PANELS: usize = 4096;
/// Panels per half-segment.
const PANELS_PER_HALF: usize = 64;

/// Nodes, weights, and the weights of the Legendre coefficients. The first half of the nodes is positive; the others mirror it, so
/// that a polynomial takes the sum of its even and its odd part at the one, and their difference at the other.
struct Rule {
    nodes: [f64; NODES],
    weights: [f64; NODES],
    last: [[f64; NODES]; 4],
    /// Values at `s = 1` of the polynomials that interpolate at the nodes.
    end: [f64; NODES],
}

static RULE: LazyLock<Rule> = LazyLock::new(|| {
    let mut rule =
        Rule { nodes: [0.0; NODES], weights: [0.0; NODES], last: [[0.0; NODES]; 4], end: [0.0; NODES] };
    for (i, (node, weight)) in GaussLegendre::new(NODES).points().take(PAIRS).enumerate() {
        for (i, node) in [(i, node), (i + PAIRS, -node)] {
            (rule.nodes[i], rule.weights[i]) = (node, weight);
            for (k, last) in (FIRST..).zip(&mut rule.last) {
                last[i] = (2 * k + 1) as f64 * weight * legendre(k, node);
            }
            rule.end[i] = (0..NODES).map(|k| (k as f64 + 0.5) * weight * legendre(k, node)).sum();
        }
    }
    rule
});

/// `P_n(x)` by the three-term recurrence.
fn legendre(n: usize, x: f64) -> f64 {
    if n == 0 {
        return 1.0;
    }
    let step = |(before, last): (f64, f64), k: usize| {
        let k = k as f64;
        (last, ((2.0 * k - 1.0) * x * last - (k - 1.0) * before) / k)
    };
    (2..=n).fold((1.0, x), step).1
}

/// Length of a curve.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ArcLength {
    /// The length, to a relative accuracy of `10⁻¹⁰`.
    pub(crate) length: f64,
    /// Sum of the estimated errors of panels that missed their tolerance.
    pub(crate) missed: f64,
    /// Number of panels that were bisected.
    pub(crate) halved: usize,
}

/// Integral over a panel, with Legendre coefficients of the speed.
#[derive(Debug, Clone, Copy)]
struct Panel {
    value: f64,
    /// `max(|a_8|, |a_9|)`
    before: f64,
    /// `max(|a_10|, |a_11|)`
    last: f64,
    /// `2 max |e(±1)|`, with `e` the speed less the polynomial that interpolates it at the nodes.
    ends: f64,
}

impl Panel {
    /// Estimate of the error of the integral.
    fn error(self) -> f64 {
        let ratio = if self.last < self.before { self.last / self.before } else { 1.0 };
        let seen = self.last * (self.last / self.value).max(ratio.powi(5));
        let beyond = MARGIN * self.ends * (self.ends / self.value);
        if self.value > 0.0 { seen.max(beyond) } else { 0.0 }
    }

    fn is_within(self, tolerance: f64) -> bool {
        !(self.error() > tolerance.max(ROUNDING * self.value))
    }
}

impl ArcLength {
    /// Length of `curve`, whose coordinates are near 1; a bound of the number of panels or `stop` end it early. Cost:
    /// `O(M d n)`, more where tangents turn fast.
    pub(crate) fn of(curve: &Columns, stop: Stop<'_>) -> Self {
        let blocks: Vec<[Lanes; 4]> = if curve.terms() <= 2 { chords(curve) } else { integrals(curve) };
        let panel = |half: usize| {
            let (block, lane) = place(half);
            let [value, before, last, ends] = blocks[block].map(|lanes| lanes[lane]);
            Panel { value, before, last, ends }
        };
        let halves = curve.halves();
        let rough: f64 = (0..halves).map(|half| panel(half).value).sum();
        let tolerance = TOLERANCE * rough / halves as f64;
        let mut division = Division {
            polynomial: Vec::new(),
            terms: curve.terms(),
            allowance: Allowance::new(PANELS + PANELS_PER_HALF * halves, stop),
            missed: 0.0,
        };
        let mut length = 0.0;
        for half in 0..halves {
            let panel = panel(half);
            length += if panel.is_within(tolerance) {
                panel.value
            } else {
                division.polynomial.clear();
                division.polynomial.extend((0..curve.dimension()).flat_map(|c| curve.taylor(half, c)));
                division.divide((0.0, 1.0), panel, tolerance, MAX_LEVELS)
            };
        }
        Self { length, missed: division.missed, halved: division.allowance.taken() }
    }
}

/// Lengths of straight half-segments, which have constant speed.
fn chords(curve: &Columns) -> Vec<[Lanes; 4]> {
    let chord = |block: &[Lanes]| {
        let mut squares = [0.0; LANES];
        for slope in block.chunks_exact(curve.terms()).filter_map(|polynomial| polynomial.get(1)) {
            (0..LANES).for_each(|lane| squares[lane] += slope[lane] * slope[lane]);
        }
        [squares.map(|square| 2.0 * square.sqrt()), [0.0; LANES], [0.0; LANES], [0.0; LANES]]
    };
    curve.blocks().map(chord).collect()
}

/// Integral and coefficients of every half-segment, block by block.
fn integrals(curve: &Columns) -> Vec<[Lanes; 4]> {
    let (rule, terms) = (&*RULE, curve.terms());
    let mut slopes = vec![[0.0; LANES]; curve.dimension() * (terms - 1)];
    let mut integrals = vec![[[0.0; LANES]; 4]; curve.blocks().len()];
    vectorised(
        #[inline(always)]
        || {
            for (found, block) in integrals.iter_mut().zip(curve.blocks()) {
                differentiate(block, terms, &mut slopes);
                *found = integral(rule, &slopes, terms - 1);
            }
        },
    );
    integrals
}

/// Coefficients of the derivatives in `s`.
#[inline(always)]
fn differentiate(block: &[Lanes], terms: usize, slopes: &mut [Lanes]) {
    for (polynomial, slope) in block.chunks_exact(terms).zip(slopes.chunks_exact_mut(terms - 1)) {
        for m in 1..terms {
            for lane in 0..LANES {
                slope[m - 1][lane] = m as f64 * polynomial[m][lane];
            }
        }
    }
}

/// Integral and coefficients of the half-segments of one block from their `slopes`, `terms` for every coordinate.
#[inline(always)]
fn integral(rule: &Rule, slopes: &[Lanes], terms: usize) -> [Lanes; 4] {
    let (mut value, mut last) = ([0.0; LANES], [[0.0; LANES]; 4]);
    let mut ends = speeds(1.0, slopes, terms);
    for i in 0..PAIRS {
        let speeds = speeds(rule.nodes[i], slopes, terms);
        let (mut sum, mut difference) = ([0.0; LANES], [0.0; LANES]);
        for lane in 0..LANES {
            sum[lane] = speeds[0][lane] + speeds[1][lane];
            difference[lane] = speeds[0][lane] - speeds[1][lane];
        }
        add(&mut value, rule.weights[i], &sum);
        // Even Legendre polynomials are even functions.
        for (k, last) in last.iter_mut().enumerate() {
            add(last, rule.last[k][i], if k % 2 == 0 { &sum } else { &difference });
        }
        for (end, [near, far]) in ends.iter_mut().zip([[0, 1], [1, 0]]) {
            add(end, -rule.end[i], &speeds[near]);
            add(end, -rule.end[i + PAIRS], &speeds[far]);
        }
    }
    let ends = larger(&ends[0], &ends[1]).map(|end| 2.0 * end);
    [value, larger(&last[0], &last[1]), larger(&last[2], &last[3]), ends]
}

/// `|r'|` at `s` and at `−s`.
#[inline(always)]
fn speeds(s: f64, slopes: &[Lanes], terms: usize) -> [Lanes; 2] {
    let square = s * s;
    let mut squares = [[0.0; LANES]; 2];
    for slope in slopes.chunks_exact(terms) {
        let (even, odd) = (every_second(slope, 0, square), every_second(slope, 1, square));
        for lane in 0..LANES {
            let (even, odd) = (even[lane], s * odd[lane]);
            squares[0][lane] += (even + odd) * (even + odd);
            squares[1][lane] += (even - odd) * (even - odd);
        }
    }
    for lane in 0..LANES {
        squares[0][lane] = squares[0][lane].sqrt();
        squares[1][lane] = squares[1][lane].sqrt();
    }
    squares
}

/// `Σ c[first + 2m] xᵐ`
#[inline(always)]
fn every_second(coefficients: &[Lanes], first: usize, x: f64) -> Lanes {
    let mut sum = [0.0; LANES];
    for m in (0..coefficients.len().saturating_sub(first).div_ceil(2)).rev() {
        let column = &coefficients[first + 2 * m];
        for lane in 0..LANES {
            sum[lane] = sum[lane] * x + column[lane];
        }
    }
    sum
}

#[inline(always)]
fn add(sum: &mut Lanes, weight: f64, values: &Lanes) {
    for lane in 0..LANES {
        sum[lane] += weight * values[lane];
    }
}

#[inline(always)]
fn larger(a: &Lanes, b: &Lanes) -> Lanes {
    let mut larger = [0.0; LANES];
    for lane in 0..LANES {
        larger[lane] = if a[lane].abs() > b[lane].abs() { a[lane].abs() } else { b[lane].abs() };
    }
    larger
}

/// Bisection of one half-segment after the other.
struct Division<'a> {
    /// Of the half-segment, coordinate by coordinate.
    polynomial: Vec<f64>,
    terms: usize,
    allowance: Allowance<'a>,
    missed: f64,
}

impl Division<'_> {
    /// Integral over the part of `radius` around `middle`, whose own panel missed its tolerance.
    fn divide(&mut self, (middle, radius): (f64, f64), whole: Panel, tolerance: f64, levels: u32) -> f64 {
        if levels == 0 || !self.allowance.take() {
            self.missed += whole.error();
            return whole.value;
        }
        let (quarter, half) = (0.5 * radius, 0.5 * tolerance);
        let mut over = |middle: f64| {
            let panel = self.panel(middle, quarter);
            if panel.is_within(half) {
                panel.value
            } else {
                self.divide((middle, quarter), panel, half, levels - 1)
            }
        };
        over(middle - quarter) + over(middle + quarter)
    }

    fn panel(&self, middle: f64, radius: f64) -> Panel {
        vectorised(
            #[inline(always)]
            || self.panel_at(middle, radius),
        )
    }

    /// The rule on one panel, all nodes at once.
    #[inline(always)]
    fn panel_at(&self, middle: f64, radius: f64) -> Panel {
        let rule = &*RULE;
        let speeds = self.speeds(rule.nodes.map(|node| middle + radius * node));
        let integral = |weights: &[f64; NODES]| -> f64 { radius * dot(weights, &speeds) };
        let [a, b, c, d] = [0, 1, 2, 3].map(|k| integral(&rule.last[k]).abs());
        let ends = self.speeds([middle + radius, middle - radius]);
        let mut mirrored = rule.end;
        mirrored.rotate_left(PAIRS);
        let ends = [ends[0] - dot(&rule.end, &speeds), ends[1] - dot(&mirrored, &speeds)];
        Panel {
            value: integral(&rule.weights),
            before: a.max(b),
            last: c.max(d),
            ends: 2.0 * radius * ends[0].abs().max(ends[1].abs()),
        }
    }

    /// `|r'|` at some parameters of the half-segment.
    #[inline(always)]
    fn speeds<const N: usize>(&self, parameters: [f64; N]) -> [f64; N] {
        let mut squares = [0.0; N];
        for polynomial in self.polynomial.chunks_exact(self.terms) {
            let mut slope = [0.0; N];
            for (m, coefficient) in polynomial.iter().enumerate().skip(1).rev() {
                let coefficient = m as f64 * coefficient;
                (0..N).for_each(|i| slope[i] = slope[i] * parameters[i] + coefficient);
            }
            (0..N).for_each(|i| squares[i] += slope[i] * slope[i]);
        }
        squares.map(f64::sqrt)
    }
}

/// Dot product in four sums that do not wait for each other.
#[inline(always)]
fn dot(weights: &[f64; NODES], values: &[f64; NODES]) -> f64 {
    let mut sums = [0.0; 4];
    for (weights, values) in weights.as_chunks::<4>().0.iter().zip(values.as_chunks::<4>().0) {
        for lane in 0..4 {
            sums[lane] += weights[lane] * values[lane];
        }
    }
    (sums[0] + sums[1]) + (sums[2] + sums[3])
}
