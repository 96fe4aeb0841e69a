//! Distances of two curves.
//!
//! ```text
//! L₂           (∫₀¹ |r(u) − s(u)|² du)^½                              as functions of the parameter
//! symmetric    (½ ∫ d(r, S)² dℓ_r/L_r + ½ ∫ d(s, R)² dℓ_s/L_s)^½      as sets: root mean square distance
//! Hausdorff    max(sup_u d(r(u), S), sup_u d(s(u), R))                as sets: largest distance
//! ```
//!
//! `d(p, S)` is the distance from a point to the nearest point of a curve. It is found by bounding boxes of half-segments,
//! then by branch and bound on each candidate. The curves are first scaled to numbers near 1, by a power of two.
//!
//! Every search ends: its tolerance is never below rounding, and it grows once a share of steps is spent. This happens for
//! points that are almost equally far from long stretches of a curve, such as the centre of a circle. The largest tolerance
//! that was needed is reported.

use rayon::prelude::*;

use super::curve::Curve;
use shapelex_numeric::bounded::{Patience, Stop, never};
use shapelex_numeric::quadrature::GaussLegendre;

/// Distances between two curves of equal dimension, in the unit of their points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Distances {
    /// `L₂` distance as functions of the parameter.
    pub l2: f64,
    /// Root mean square distance to the other curve, over both directions.
    pub symmetric: f64,
    /// Largest distance to the other curve, over both directions.
    pub hausdorff: f64,
    /// Maximum error: by how much a nearest point may be too far, and a farthest one too near.
    pub accuracy: f64,
    /// Number of stretches of the curves that were examined: the cost beyond the box tests.
    pub stretches: usize,
}

/// Gauss nodes per interval between knots: exact for products of two generators.
const NODES: usize = 12;

/// Gauss nodes of a whole curve in [`symmetric`], with at least [`FEWEST`] and at most [`NODES`] per half-segment.
const SPREAD: usize = 600;

/// Fewest Gauss nodes per half-segment.
const FEWEST: usize = 3;

/// Start points per half-segment in the search for farthest points.
const STARTS: usize = 8;

/// Total number of stretches that the distances of two curves may examine before the accuracy is reduced: about a second
/// on one thread. Except for adversarial curves, some thirty per point suffice, a hundredth of this.
pub const STRETCHES: usize = 2_000_000;

/// Minimum and maximum number of stretches for one point at its own tolerance.
const SHARE: [usize; 2] = [256, 20_000];

impl Distances {
    /// Distances of two curves. `l2` is exact to rounding, `symmetric` to about 1e-6 relative (its integrand has kinks where the
    /// nearest point jumps), `hausdorff` to about 1e-9 of the extent from 8 start points per half-segment (a peak narrower than
    /// their distance is missed). Cost: `O(M_r M_s)` box tests.
    pub fn of(r: &Curve, s: &Curve) -> Self {
        Self::in_range(r, s, STRETCHES, &never)
    }

    /// As [`Self::of`] within about `stretches` steps, with cancellation; `None` if `stop` returns true.
    pub fn unless_stopped(r: &Curve, s: &Curve, stretches: usize, stop: Stop<'_>) -> Option<Self> {
        let distances = Self::in_range(r, s, stretches, stop);
        (!stop()).then_some(distances)
    }

    fn in_range(r: &Curve, s: &Curve, stretches: usize, stop: Stop<'_>) -> Self {
        let unit = Curve::unit(&[r, s]);
        let [r, s] = [r, s].map(|curve| curve.scaled(unit.recip()));
        let points = (r.halves() + s.halves()) * (NODES + STARTS + 1);
        let share = (stretches / points).clamp(SHARE[0], SHARE[1]);
        let [to_s, to_r] = [&s, &r].map(|curve| Nearest::new(curve, share, stop));
        let there = [mean_square(&r, &to_s, NODES), mean_square(&s, &to_r, NODES)];
        let farthest = [farthest(&r, &to_s), farthest(&s, &to_r)];
        let accuracy = there.iter().chain(&farthest).map(|found| found.accuracy).fold(0.0, f64::max);
        Self {
            l2: unit * l2(&r, &s),
            symmetric: unit * (0.5 * (there[0].square + there[1].square)).sqrt(),
            hausdorff: unit * farthest[0].square.max(farthest[1].square).sqrt(),
            accuracy: unit * accuracy,
            stretches: there.iter().chain(&farthest).map(|found| found.stretches).sum(),
        }
    }
}

/// Root mean square distance of two curves as sets of points, over both directions, in the unit of their points:
/// [`Distances::symmetric`] alone, with fewer quadrature nodes: to about 1e-4 relative for outlines near each other, to 1e-2 for curves that
/// cross each other everywhere. Cost: `O(M_r M_s)` box tests.
pub fn symmetric(r: &Curve, s: &Curve) -> f64 {
    let unit = Curve::unit(&[r, s]);
    let [r, s] = [r, s].map(|curve| curve.scaled(unit.recip()));
    let [to_s, to_r] = [&s, &r].map(|curve| Nearest::new(curve, SHARE[0], &never));
    let nodes = |curve: &Curve| symmetric_nodes(curve.halves());
    let squares =
        [mean_square(&r, &to_s, nodes(&r)), mean_square(&s, &to_r, nodes(&s))].map(|found| found.square);
    unit * (0.5 * (squares[0] + squares[1])).sqrt()
}

/// Gauss nodes per half-segment of [`symmetric`] for a curve of so many.
pub(crate) fn symmetric_nodes(halves: usize) -> usize {
    SPREAD.div_ceil(halves).clamp(FEWEST, NODES)
}

/// A squared distance, with the possible error of the distance.
#[derive(Debug, Clone, Copy, Default)]
struct Found {
    square: f64,
    accuracy: f64,
    stretches: usize,
}

impl Found {
    /// The same square, with the error and cost of another search included.
    fn after(self, other: Self) -> Self {
        let accuracy = self.accuracy.max(other.accuracy);
        Self { accuracy, stretches: self.stretches + other.stretches, ..self }
    }
}

/// `∫ d(r, S)² dℓ / L`, by `nodes` Gauss nodes per half-segment.
fn mean_square(from: &Curve, to: &Nearest<'_>, nodes: usize) -> Found {
    let rule = GaussLegendre::new(nodes);
    let on_half = |half: usize| {
        rule.points().fold((Found::default(), 0.0), |(sum, total), (node, weight)| {
            let [position, tangent, _] = taylor(from, half, node);
            let piece = weight * length(&tangent);
            let found = to.square(&position);
            let square = sum.square + piece * found.square;
            (Found { square, ..sum }.after(found), total + piece)
        })
    };
    // Summed in order, so that the result does not depend on threads.
    let halves: Vec<(Found, f64)> = (0..from.halves()).into_par_iter().map(on_half).collect();
    let (sum, length) = halves.into_iter().fold((Found::default(), 0.0), |(sum, length), (half, piece)| {
        (Found { square: sum.square + half.square, ..sum }.after(half), length + piece)
    });
    if length > 0.0 {
        Found { square: sum.square / length, ..sum }
    } else {
        let [position, ..] = taylor(from, 0, 0.0);
        to.square(&position).after(sum)
    }
}

/// `r`, `dr/ds` and `d²r/ds²` on one half-segment.
fn taylor(curve: &Curve, half: usize, s: f64) -> [Vector; 3] {
    let [mut r, mut v, mut a] = [[0.0; 3]; 3];
    for c in 0..curve.dimension() {
        for coefficient in curve.polynomial(half, c).iter().rev() {
            a[c] = a[c] * s + 2.0 * v[c];
            v[c] = v[c] * s + r[c];
            r[c] = r[c] * s + coefficient;
        }
    }
    [r, v, a]
}

/// `(∫₀¹ |r − s|² du)^½`, exact to rounding, by Gauss rules between the knots of both curves.
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

/// Maximum number of local maxima between start points that are refined: those that may exceed the best so far, in order.
/// Distances that are not almost constant have some ten.
const MAXIMA: usize = 256;

/// `sup_u d(r(u), S)²`: the maximum over equally spaced start points, and over the local maxima between them that may be
/// larger, judged by the parabola through their neighbours with twice its rise.
fn farthest(r: &Curve, to: &Nearest<'_>) -> Found {
    let step = 2.0 / STARTS as f64;
    let place = |i: usize| -1.0 + i as f64 * step;
    let value = |half: usize, s: f64| to.square(&taylor(r, half, s)[0]);
    let on_half = |half: usize| -> [Found; STARTS + 1] { std::array::from_fn(|i| value(half, place(i))) };
    let found: Vec<[Found; STARTS + 1]> = (0..r.halves()).into_par_iter().map(on_half).collect();
    let larger =
        |best: Found, next: Found| Found { square: best.square.max(next.square), ..best }.after(next);
    let mut best = found.iter().flatten().fold(Found::default(), |best, next| larger(best, *next));
    let mut searches = 0;
    for (half, found) in found.iter().enumerate() {
        let values = found.map(|found| found.square);
        for i in 0..=STARTS {
            if !may_be_larger(&values, i, best.square) {
                continue;
            }
            searches += 1;
            if searches > MAXIMA {
                // The distance changes by at most the length that the curve moves.
                let slope = length(&sums(r, half, 1, |m| m));
                best.accuracy = best.accuracy.max(values[i].sqrt() + slope * step - best.square.sqrt());
                continue;
            }
            let (before, after) = (i.saturating_sub(1), (i + 1).min(STARTS));
            let looked_at = std::cell::Cell::new(Found::default());
            let height = |s: f64| {
                let found = value(half, s);
                looked_at.set(looked_at.get().after(found));
                -found.square
            };
            let square = -golden(height, place(before), place(after)).1;
            best = larger(best, Found { square, ..looked_at.get() });
        }
    }
    best
}

/// Whether there may be a maximum above `best` near start point `i`.
fn may_be_larger(values: &[f64; STARTS + 1], i: usize, best: f64) -> bool {
    let (before, after) = (i.saturating_sub(1), (i + 1).min(STARTS));
    let inner = i.clamp(1, STARTS - 1);
    let (left, middle, right) = (values[inner - 1], values[inner], values[inner + 1]);
    let bend = (2.0 * middle - left - right).max(f64::MIN_POSITIVE);
    let rise = middle + (right - left).powi(2) / (8.0 * bend) - values[i];
    let is_maximum = values[i] >= values[before].max(values[after]);
    is_maximum && values[i] + 2.0 * rise.max(0.0) > best * (1.0 + 1e-12)
}

/// `(x, f(x))` at a minimum of `f` on `[low, high]`, with half of the digits in `x` and all in `f`.
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

/// Minimum and maximum coordinates.
type Bounds = (Vector, Vector);

/// Nearest-point search on one curve.
struct Nearest<'a> {
    curve: &'a Curve,
    /// Bounding box of every half-segment.
    boxes: Vec<Bounds>,
    /// Bounding box of every [`BLOCK`] half-segments.
    blocks: Vec<Bounds>,
    /// Bounds of `|d²r/ds²|` on every half-segment.
    bends: Vec<f64>,
    /// Maximum number of stretches for one point at its own tolerance.
    share: usize,
    stop: Stop<'a>,
}

/// Number of half-segments that are excluded together.
const BLOCK: usize = 16;

/// State of one nearest-point search.
struct Search<'a> {
    patience: Patience<'a>,
    best: f64,
    accuracy: f64,
    /// Stretches of the present half-segment that may be nearer, each its middle and radius.
    pending: Vec<(f64, f64)>,
}

/// Error of a nearest distance, relative to the diagonal of the box of its half-segment.
const NEAREST: f64 = 1e-11;

/// Rounding error of evaluation and difference, relative to the largest coordinate of curve and point.
const ROUNDING: f64 = 16.0 * f64::EPSILON;

/// Number of stretches of a half-segment from which its points count as almost equally far, as those of a circle from its
/// centre. Other searches need a tenth of it.
const MANY: usize = 200;

/// `Σ_m factor(m) |c[m]|` for every coordinate of a half-segment, from term `first` on.
fn sums(curve: &Curve, half: usize, first: usize, factor: fn(usize) -> usize) -> Vector {
    let mut sums = [0.0; 3];
    for (c, sum) in sums.iter_mut().enumerate().take(curve.dimension()) {
        let terms = curve.polynomial(half, c).iter().enumerate().skip(first);
        *sum = terms.map(|(m, value)| factor(m) as f64 * value.abs()).sum();
    }
    sums
}

/// Squared distance from a point to a box.
fn square_to_box((low, high): &Bounds, target: &Vector) -> f64 {
    let outside: Vector = std::array::from_fn(|c| (low[c] - target[c]).max(target[c] - high[c]).max(0.0));
    dot(&outside, &outside)
}

fn largest(a: &Vector) -> f64 {
    a.iter().fold(0.0, |most, value| most.max(value.abs()))
}

impl<'a> Nearest<'a> {
    fn new(curve: &'a Curve, share: usize, stop: Stop<'a>) -> Self {
        let halves = 0..curve.halves();
        let bounds = |half: usize| {
            let mut middle = [0.0; 3];
            (0..curve.dimension()).for_each(|c| middle[c] = curve.polynomial(half, c)[0]);
            let reach = sums(curve, half, 1, |_| 1);
            (combine(&middle, -1.0, &reach), combine(&middle, 1.0, &reach))
        };
        let boxes: Vec<Bounds> = halves.clone().map(bounds).collect();
        let around = |boxes: &[Bounds]| {
            let corner = |pick: fn(&Bounds) -> &Vector, better: fn(f64, f64) -> f64| {
                let first = *pick(&boxes[0]);
                boxes.iter().fold(first, |a, b| std::array::from_fn(|c| better(a[c], pick(b)[c])))
            };
            (corner(|bounds| &bounds.0, f64::min), corner(|bounds| &bounds.1, f64::max))
        };
        let blocks = boxes.chunks(BLOCK).map(around).collect();
        let bends = halves.map(|half| length(&sums(curve, half, 2, |m| m * (m - 1)))).collect();
        Self { curve, boxes, blocks, bends, share, stop }
    }

    /// `d(p, S)²`.
    fn square(&self, target: &Vector) -> Found {
        if (self.stop)() {
            return Found::default();
        }
        let patience = Patience::new(self.share, self.stop);
        let mut search = Search { patience, best: f64::MAX, accuracy: 0.0, pending: Vec::new() };
        let first = self.nearest_box(target);
        self.on_half(first, target, &mut search);
        for (block, bounds) in self.blocks.iter().enumerate() {
            if square_to_box(bounds, target) >= search.best * search.best {
                continue;
            }
            for half in self.halves_of(block).filter(|&half| half != first) {
                if square_to_box(&self.boxes[half], target) < search.best * search.best {
                    self.on_half(half, target, &mut search);
                }
            }
        }
        let stretches = search.patience.steps();
        Found { square: search.best * search.best, accuracy: search.accuracy, stretches }
    }

    fn halves_of(&self, block: usize) -> std::ops::Range<usize> {
        block * BLOCK..self.boxes.len().min((block + 1) * BLOCK)
    }

    /// The half-segment with the nearest box; the first one in a tie.
    fn nearest_box(&self, target: &Vector) -> usize {
        let (mut nearest, mut least) = (0, f64::MAX);
        for (block, bounds) in self.blocks.iter().enumerate() {
            if square_to_box(bounds, target) >= least {
                continue;
            }
            for half in self.halves_of(block) {
                let bound = square_to_box(&self.boxes[half], target);
                if bound < least {
                    (nearest, least) = (half, bound);
                }
            }
        }
        nearest
    }

    /// Tolerance of a search on a half-segment, never below rounding.
    fn tolerance(&self, half: usize, target: &Vector) -> f64 {
        let (low, high) = &self.boxes[half];
        let most = largest(low).max(largest(high)).max(largest(target));
        let wanted = NEAREST * length(&combine(high, -1.0, low));
        wanted.max(ROUNDING * most).max(f64::MIN_POSITIVE)
    }

    /// Minimum of the best distance so far and the distance to a half-segment, by branch and bound: on `|s − m| ≤ h` the curve
    /// is within `½ B h²` of its tangent at `m`. Where the squared distance is convex, Newton's method completes the search.
    /// Where it hardly changes, the tangent excludes only tiny stretches, so the squared distance itself is bounded instead.
    fn on_half(&self, half: usize, target: &Vector, search: &mut Search<'_>) {
        let (bend, own) = (self.bends[half], self.tolerance(half, target));
        let (mut stretches, mut square_bend) = (0, f64::INFINITY);
        search.pending.push((0.0, 1.0));
        while let Some((middle, radius)) = search.pending.pop() {
            search.patience.step();
            let tolerance = own * search.patience.factor();
            stretches += 1;
            if stretches == MANY {
                square_bend = self.square_bend(half, target);
            }
            let slack = 0.5 * bend * radius * radius;
            let [position, tangent, _] = taylor(self.curve, half, middle);
            let away = combine(&position, -1.0, target);
            let (distance, slope) = (length(&away), length(&tangent));
            let step = if slope > 0.0 { -dot(&away, &tangent) / (slope * slope) } else { 0.0 };
            let step = step.clamp(-radius, radius);
            let on_tangent = length(&combine(&away, step, &tangent));
            let least_square = distance * distance
                - 2.0 * dot(&away, &tangent).abs() * radius
                - 0.5 * square_bend * radius * radius;
            let least = (on_tangent - slack).max(least_square.max(0.0).sqrt());
            if least >= search.best - tolerance {
                continue;
            }
            // ½ (|r − p|²)'' = |r'|² + (r − p)·r'' > 0 on the whole stretch
            let least_slope = (slope - bend * radius).max(0.0);
            if least_slope * least_slope > (distance + slope * radius + slack) * bend {
                let found = self.newton(half, target, middle + step, middle - radius, middle + radius);
                search.best = search.best.min(found);
                continue;
            }
            let [there, ..] = taylor(self.curve, half, middle + step);
            search.best = search.best.min(length(&combine(&there, -1.0, target)));
            // Ends where 2 · slack falls below the tolerance.
            if least < search.best - tolerance {
                let quarter = 0.5 * radius;
                search.pending.extend([(middle - quarter, quarter), (middle + quarter, quarter)]);
            }
        }
        search.accuracy = search.accuracy.max(own * search.patience.factor());
    }

    /// An upper bound of `|d²/ds² |r − p|²|` on a half-segment, from the coefficients of that polynomial.
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

    /// The minimum distance on `[low, high]`, where its square is convex, by Newton's method from `s`.
    fn newton(&self, half: usize, target: &Vector, mut s: f64, low: f64, high: f64) -> f64 {
        // Four or five steps reach rounding. The limit is for steps that alternate between two neighbouring numbers.
        const STEPS: usize = 12;
        let mut best = f64::MAX;
        for _ in 0..STEPS {
            let [position, tangent, bend] = taylor(self.curve, half, s);
            let away = combine(&position, -1.0, target);
            best = best.min(length(&away));
            let next = s - dot(&away, &tangent) / (dot(&tangent, &tangent) + dot(&away, &bend));
            let next = next.clamp(low, high);
            if (next - s).abs() <= 1e-6 {
                // The error of `next` is of the order of the square of this step, and the squared distance is flat there.
                let [position, ..] = taylor(self.curve, half, next);
                return best.min(length(&combine(&position, -1.0, target)));
            }
            s = next;
        }
        best
    }
}
