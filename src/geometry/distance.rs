//! Distances of two curves.
//!
//! ```text
//! L₂           (∫₀¹ |r(u) − s(u)|² du)^½                              as functions of the parameter
//! symmetric    (½ ∫ d(r, S)² dℓ_r/L_r + ½ ∫ d(s, R)² dℓ_s/L_s)^½      as sets: root mean square distance
//! Hausdorff    max(sup_u d(r(u), S), sup_u d(s(u), R))                as sets: largest distance
//! ```
//!
//! `d(p, S)` is the distance from a point to the nearest point of a curve, found by bounding boxes of half-segments,
//! then on each that may hold it by branch and bound.

use rayon::prelude::*;

use super::curve::Curve;
use crate::numeric::quadrature::GaussLegendre;

/// The distances of two curves of one dimension, in the unit of their points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Distances {
    /// `L₂` distance as functions of the parameter.
    pub l2: f64,
    /// Root mean square distance to the other curve, over both.
    pub symmetric: f64,
    /// Largest distance to the other curve, over both.
    pub hausdorff: f64,
}

/// Gauss nodes per interval between knots: exact for products of two generators.
const NODES: usize = 12;

/// Starts per half-segment for farthest points.
const STARTS: usize = 8;

impl Distances {
    /// Of two curves. `l2` to rounding, `symmetric` to about 1e-6 relative (its integrand has kinks where the nearest
    /// point jumps), `hausdorff` to about 1e-9 of the extent
    /// from 8 starts per half-segment (a peak narrower than their distance is missed). Cost `O(M_r M_s)` box tests.
    pub fn of(r: &Curve, s: &Curve) -> Self {
        let (to_s, to_r) = (Nearest::new(s), Nearest::new(r));
        let rule = GaussLegendre::new(NODES);
        let mean_square = |from: &Curve, to: &Nearest| {
            let on_half = |half: usize| {
                rule.points().fold((0.0, 0.0), |(sum, length), (node, weight)| {
                    let piece = weight * norm(&point(from, half, node, 1));
                    (sum + piece * to.square(&point(from, half, node, 0)), length + piece)
                })
            };
            // Added in order, so that threads change nothing.
            let halves: Vec<(f64, f64)> = (0..from.halves()).into_par_iter().map(on_half).collect();
            let (sum, length) = halves.iter().fold((0.0, 0.0), |(s, l), half| (s + half.0, l + half.1));
            if length > 0.0 { sum / length } else { to.square(&point(from, 0, 0.0, 0)) }
        };
        let symmetric = (0.5 * (mean_square(r, &to_s) + mean_square(s, &to_r))).sqrt();
        let hausdorff = farthest(r, &to_s).max(farthest(s, &to_r)).sqrt();
        Self { l2: l2(r, s), symmetric, hausdorff }
    }
}

/// `(∫₀¹ |r − s|² du)^½`, exact to rounding: Gauss rules between the knots of both curves.
pub fn l2(r: &Curve, s: &Curve) -> f64 {
    let grid = |curve: &Curve| {
        let n = curve.halves();
        (0..=n).map(move |i| i as f64 / n as f64).collect::<Vec<f64>>()
    };
    let mut breaks = grid(r);
    breaks.extend(grid(s));
    breaks.sort_by(f64::total_cmp);
    let rule = GaussLegendre::new(NODES);
    let (mut a, mut b) = (vec![0.0; r.dimension()], vec![0.0; r.dimension()]);
    let mut sum = 0.0;
    for pair in breaks.windows(2).filter(|pair| pair[1] - pair[0] > f64::EPSILON) {
        let (middle, radius) = (0.5 * (pair[0] + pair[1]), 0.5 * (pair[1] - pair[0]));
        for (node, weight) in rule.points() {
            let u = middle + radius * node;
            r.evaluate_into(u, 0, &mut a);
            s.evaluate_into(u, 0, &mut b);
            sum += weight * radius * a.iter().zip(&b).map(|(x, y)| (x - y).powi(2)).sum::<f64>();
        }
    }
    sum.sqrt()
}

fn point(curve: &Curve, half: usize, s: f64, derivative: usize) -> Vec<f64> {
    (0..curve.dimension()).map(|c| curve.derivative_at(half, c, s, derivative)).collect()
}

fn norm(v: &[f64]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// `sup_u d(r(u), S)²`: the best of equally spaced starts, and the local maxima between them that may be larger still, by
/// the parabola through their neighbours with twice its rise.
fn farthest(r: &Curve, to: &Nearest<'_>) -> f64 {
    let step = 2.0 / STARTS as f64;
    let place = |i: usize| -1.0 + i as f64 * step;
    let value = |half: usize, s: f64| to.square(&point(r, half, s, 0));
    let on_half = |half: usize| -> [f64; STARTS + 1] { std::array::from_fn(|i| value(half, place(i))) };
    let values: Vec<[f64; STARTS + 1]> = (0..r.halves()).into_par_iter().map(on_half).collect();
    let mut best = values.iter().flatten().copied().fold(0.0, f64::max);
    for (half, values) in values.iter().enumerate() {
        for i in 0..=STARTS {
            let (before, after) = (i.saturating_sub(1), (i + 1).min(STARTS));
            let inner = i.clamp(1, STARTS - 1);
            let (left, middle, right) = (values[inner - 1], values[inner], values[inner + 1]);
            let bend = (2.0 * middle - left - right).max(f64::MIN_POSITIVE);
            let rise = middle + (right - left).powi(2) / (8.0 * bend) - values[i];
            let is_maximum = values[i] >= values[before].max(values[after]);
            if is_maximum && values[i] + 2.0 * rise.max(0.0) > best * (1.0 + 1e-12) {
                best = best.max(-golden(|s| -value(half, s), place(before), place(after)).1);
            }
        }
    }
    best
}

/// `(x, f(x))` at a minimum of `f` on `[low, high]`, to half the digits in `x` and all in `f`.
fn golden(f: impl Fn(f64) -> f64, mut low: f64, mut high: f64) -> (f64, f64) {
    const RATIO: f64 = 0.618_033_988_749_894_9;
    let (mut a, mut b) = (high - RATIO * (high - low), low + RATIO * (high - low));
    let (mut fa, mut fb) = (f(a), f(b));
    // 40 steps leave 4·10⁻⁹ of the interval
    for _ in 0..40 {
        if fa <= fb {
            (high, b, fb) = (b, a, fa);
            a = high - RATIO * (high - low);
            fa = f(a);
        } else {
            (low, a, fa) = (a, b, fb);
            b = low + RATIO * (high - low);
            fb = f(b);
        }
    }
    if fa <= fb { (a, fa) } else { (b, fb) }
}

/// A point or vector of up to three coordinates.
type Vector = [f64; 3];

fn combine(a: &Vector, factor: f64, b: &Vector) -> Vector {
    std::array::from_fn(|c| a[c] + factor * b[c])
}

fn dot(a: &Vector, b: &Vector) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn length(a: &Vector) -> f64 {
    dot(a, a).sqrt()
}

/// Nearest points of one curve.
struct Nearest<'a> {
    curve: &'a Curve,
    /// Smallest and largest coordinates of every half-segment.
    boxes: Vec<(Vector, Vector)>,
    /// Bounds of `|d²r/ds²|` on every half-segment.
    bends: Vec<f64>,
}

/// Error of a nearest distance, relative to the diagonal of the box of its half-segment.
const NEAREST: f64 = 1e-11;

/// Stretches of a half-segment after which its points are taken to be almost equally far, as those of a circle are from
/// its centre. Searches that end otherwise need a tenth of it.
const MANY: usize = 200;

impl<'a> Nearest<'a> {
    fn new(curve: &'a Curve) -> Self {
        let halves = 0..curve.halves();
        let sums = |half: usize, first: usize, factor: fn(usize) -> usize| -> Vector {
            let mut sums = [0.0; 3];
            for (c, sum) in sums.iter_mut().enumerate().take(curve.dimension()) {
                let terms = curve.polynomial(half, c).iter().enumerate().skip(first);
                *sum = terms.map(|(m, value)| factor(m) as f64 * value.abs()).sum();
            }
            sums
        };
        let bounds = |half: usize| {
            let mut middle = [0.0; 3];
            (0..curve.dimension()).for_each(|c| middle[c] = curve.polynomial(half, c)[0]);
            let reach = sums(half, 1, |_| 1);
            (combine(&middle, -1.0, &reach), combine(&middle, 1.0, &reach))
        };
        let bend = |half: usize| length(&sums(half, 2, |m| m * (m - 1)));
        Self { curve, boxes: halves.clone().map(bounds).collect(), bends: halves.map(bend).collect() }
    }

    /// `d(p, S)²`.
    fn square(&self, p: &[f64]) -> f64 {
        let mut target = [0.0; 3];
        target[..p.len()].copy_from_slice(p);
        let to_box = |(low, high): &(Vector, Vector)| {
            let outside: Vector =
                std::array::from_fn(|c| (low[c] - target[c]).max(target[c] - high[c]).max(0.0));
            dot(&outside, &outside)
        };
        let (mut nearest, mut least) = (0, f64::MAX);
        for (half, bounds) in self.boxes.iter().enumerate() {
            let bound = to_box(bounds);
            if bound < least {
                (nearest, least) = (half, bound);
            }
        }
        let mut best = self.on_half(nearest, &target, f64::MAX);
        for (half, bounds) in self.boxes.iter().enumerate() {
            if half != nearest && to_box(bounds) < best * best {
                best = self.on_half(half, &target, best);
            }
        }
        best * best
    }

    /// The smaller of `best` and the distance to a half-segment, by branch and bound: on `|s − m| ≤ h` the curve is
    /// within `½ B h²` of its tangent at `m`. Where the squared distance is convex Newton's method ends the search. Where it
    /// hardly changes, no stretch is ruled out by its tangent before it is tiny: then by the squared distance itself.
    fn on_half(&self, half: usize, target: &Vector, mut best: f64) -> f64 {
        let (low, high) = &self.boxes[half];
        let (bend, tolerance) = (self.bends[half], NEAREST * length(&combine(high, -1.0, low)));
        let (mut pending, mut stretches, mut square_bend) = (vec![(0.0, 1.0)], 0, f64::INFINITY);
        while let Some((middle, radius)) = pending.pop() {
            stretches += 1;
            if stretches == MANY {
                square_bend = self.square_bend(half, target);
            }
            let slack = 0.5 * bend * radius * radius;
            let [position, tangent, _] = self.taylor(half, middle);
            let away = combine(&position, -1.0, target);
            let (distance, slope) = (length(&away), length(&tangent));
            let step = if slope > 0.0 { -dot(&away, &tangent) / (slope * slope) } else { 0.0 };
            let step = step.clamp(-radius, radius);
            let on_tangent = length(&combine(&away, step, &tangent));
            let least_square = distance * distance
                - 2.0 * dot(&away, &tangent).abs() * radius
                - 0.5 * square_bend * radius * radius;
            let least = (on_tangent - slack).max(least_square.max(0.0).sqrt());
            if least >= best - tolerance {
                continue;
            }
            // ½ (|r − p|²)'' = |r'|² + (r − p)·r'' > 0 on the whole stretch
            let least_slope = (slope - bend * radius).max(0.0);
            if least_slope * least_slope > (distance + slope * radius + slack) * bend {
                best = best.min(self.newton(half, target, middle + step, middle - radius, middle + radius));
                continue;
            }
            let [there, ..] = self.taylor(half, middle + step);
            best = best.min(length(&combine(&there, -1.0, target)));
            // ends where 2 · slack falls below the tolerance
            if least < best - tolerance {
                let quarter = 0.5 * radius;
                pending.extend([(middle - quarter, quarter), (middle + quarter, quarter)]);
            }
        }
        best
    }

    /// A bound of `|d²/ds² |r − p|²|` on a half-segment: from the coefficients of that polynomial.
    fn square_bend(&self, half: usize, target: &Vector) -> f64 {
        let terms = self.curve.polynomial(half, 0).len();
        let mut square = vec![0.0; 2 * terms];
        for c in 0..self.curve.dimension() {
            let mut away = self.curve.polynomial(half, c).to_vec();
            away[0] -= target[c];
            for (i, a) in away.iter().enumerate() {
                for (j, b) in away.iter().enumerate() {
                    square[i + j] += a * b;
                }
            }
        }
        square.iter().enumerate().skip(2).map(|(m, value)| (m * (m - 1)) as f64 * value.abs()).sum()
    }

    /// The least distance on `[low, high]`, where its square is convex, from `s` on.
    fn newton(&self, half: usize, target: &Vector, mut s: f64, low: f64, high: f64) -> f64 {
        // Four or five steps reach rounding; a limit in case they alternate between two neighbours.
        const STEPS: usize = 12;
        let mut best = f64::MAX;
        for _ in 0..STEPS {
            let [position, tangent, bend] = self.taylor(half, s);
            let away = combine(&position, -1.0, target);
            best = best.min(length(&away));
            let next = s - dot(&away, &tangent) / (dot(&tangent, &tangent) + dot(&away, &bend));
            let next = next.clamp(low, high);
            if (next - s).abs() <= 1e-9 {
                // The square is flat here: what is left in s does not show.
                let [position, ..] = self.taylor(half, next);
                return best.min(length(&combine(&position, -1.0, target)));
            }
            s = next;
        }
        best
    }

    /// `r`, `dr/ds` and `d²r/ds²` on one half-segment.
    fn taylor(&self, half: usize, s: f64) -> [Vector; 3] {
        let [mut r, mut v, mut a] = [[0.0; 3]; 3];
        for c in 0..self.curve.dimension() {
            for coefficient in self.curve.polynomial(half, c).iter().rev() {
                a[c] = a[c] * s + 2.0 * v[c];
                v[c] = v[c] * s + r[c];
                r[c] = r[c] * s + coefficient;
            }
        }
        [r, v, a]
    }
}
