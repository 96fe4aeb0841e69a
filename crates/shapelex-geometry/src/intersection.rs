//! Self-intersection test of planar curves.
//!
//! A binary tree over the parameter holds a bounding box and a cone of tangents for every stretch. A stretch whose
//! tangents stay within a half-plane cannot meet itself; two stretches with disjoint boxes cannot meet; two neighbours
//! whose tangents together stay within a half-plane meet only at their common point. The remaining pairs are split down
//! to stretches of `10⁻⁹` of the extent, which are straight up to rounding, and decided by their chords.

use super::curve::Curve;
use super::generator::{GeneratorKind, evaluate_taylor, recentre};
use shapelex_numeric::dense::Matrix;

/// Distance, relative to the extent, below which points touch: far above the rounding error of evaluation.
const TOUCH: f64 = 1e-12;

/// Rounding error of a coordinate, relative to the distance from the origin.
const ROUNDING: f64 = 16.0 * f64::EPSILON;

/// Length of a stretch, as a multiple of the touching distance, below which it counts as a straight chord: it departs from
/// the chord by `(10⁻⁹)²` of the extent, and the next chord but one does not touch it.
const CHORD: f64 = 1e3;

/// Work limit: number of pairs of stretches that are examined before the curve is reported as self-intersecting, in
/// addition to [`PAIRS_PER_HALF`] per half-segment. Only curves with long stretches that (nearly) coincide, which do
/// intersect themselves, come close to it.
const PAIRS: usize = 500_000;
const PAIRS_PER_HALF: usize = 1_000;

/// Part `[a, b] ⊂ [−1, 1]` of a half-segment, with bounds.
#[derive(Debug, Clone, Copy)]
struct Stretch {
    start: f64,
    end: f64,
    low: [f64; 2],
    high: [f64; 2],
    /// Mean direction of the tangents, and the half-angle around it; `π` if unbounded.
    direction: f64,
    spread: f64,
    /// Node of the tree; 0 for a part of a half-segment.
    node: usize,
}

impl Stretch {
    /// Bounds of nothing.
    const EMPTY: Self =
        Self { start: 0.0, end: 0.0, low: [0.0; 2], high: [0.0; 2], direction: 0.0, spread: 0.0, node: 0 };
}

/// Whether the planar `curve` crosses or touches itself. Points that are visited twice, cusps that fold back,
/// stretches traced twice, and coinciding ends of an open curve count; consecutive stretches of a smooth curve do not.
///
/// Cost `O(N log N)` for curves without near-contacts.
pub fn self_intersects(curve: &Curve) -> bool {
    // Products of coordinates overflow long before the curve does; a power of two changes no digits.
    let curve = &curve.scaled(Curve::unit(&[curve]).recip());
    let halves: Vec<[&[f64]; 2]> =
        (0..curve.halves()).map(|half| [curve.polynomial(half, 0), curve.polynomial(half, 1)]).collect();
    let mut search = Search {
        count: halves.len(),
        halves,
        closed: curve.is_closed(),
        pairs: 0,
        touch: 0.0,
        covers: Vec::new(),
    };
    search.covers = search.tree();
    let all = search.covers[1];
    let extent = (0..2).map(|c| all.high[c] - all.low[c]).fold(0.0, f64::max);
    let distance = (0..2).map(|c| all.high[c].abs().max(all.low[c].abs())).fold(0.0, f64::max);
    search.touch = TOUCH * extent + ROUNDING * distance;
    search.within(&all)
}

/// Whether a polygon crosses or touches itself. Points that repeat their neighbour do not count.
pub fn polygon_self_intersects(points: &[[f64; 2]]) -> bool {
    let mut corners = points.to_vec();
    corners.dedup();
    if corners.len() > 1 && corners.first() == corners.last() {
        corners.pop();
    }
    let Ok(hat) = (GeneratorKind::Bspline { degree: 1 }).build(corners.len()) else { return false };
    let corners = Matrix::from_fn(corners.len(), 2, |row, c| corners[row][c]);
    self_intersects(&Curve::closed(&hat.generator, &corners))
}

struct Search<'a> {
    halves: Vec<[&'a [f64]; 2]>,
    count: usize,
    /// Whether the curve is closed.
    closed: bool,
    pairs: usize,
    /// Distance below which points touch.
    touch: f64,
    /// Bounds of the stretches of whole half-segments: those of node `k` are the bounds of `2k` and `2k + 1` together; the
    /// whole curve is node 1.
    covers: Vec<Stretch>,
}

impl Search<'_> {
    /// Bounds of all stretches of the tree, from its leaves, the half-segments. Where a stretch ends before its node, the
    /// bounds are those of an empty one.
    fn tree(&self) -> Vec<Stretch> {
        let mut covers = vec![Stretch::EMPTY; 4 * self.count];
        self.grow(1, 0, self.count, &mut covers);
        covers
    }

    fn grow(&self, node: usize, start: usize, end: usize, covers: &mut [Stretch]) {
        covers[node] = if end - start == 1 {
            Stretch { node, ..self.cover(start as f64, end as f64) }
        } else {
            let middle = self.split(start as f64, end as f64) as usize;
            self.grow(2 * node, start, middle, covers);
            self.grow(2 * node + 1, middle, end, covers);
            Stretch { node, ..join(&covers[2 * node], &covers[2 * node + 1]) }
        };
    }

    /// Both parts of a stretch.
    fn parts(&self, stretch: &Stretch) -> [Stretch; 2] {
        if stretch.node > 0 && stretch.end - stretch.start > 1.0 {
            return [self.covers[2 * stretch.node], self.covers[2 * stretch.node + 1]];
        }
        let middle = self.split(stretch.start, stretch.end);
        [self.cover(stretch.start, middle), self.cover(middle, stretch.end)]
    }

    /// Bounds of the stretch `[start, end]` in units of half-segments.
    fn cover(&self, start: f64, end: f64) -> Stretch {
        let mut whole: Option<Stretch> = None;
        let mut half = start.floor() as usize;
        while (half as f64) < end {
            let a = 2.0 * (start.max(half as f64) - half as f64) - 1.0;
            let b = 2.0 * (end.min(half as f64 + 1.0) - half as f64) - 1.0;
            let piece = self.piece(half, a, b);
            whole = Some(match whole {
                None => piece,
                Some(previous) => join(&previous, &piece),
            });
            half += 1;
        }
        let mut whole = whole.expect("a stretch has positive length");
        (whole.start, whole.end) = (start, end);
        whole
    }

    fn piece(&self, half: usize, a: f64, b: f64) -> Stretch {
        let (middle, radius) = (0.5 * (a + b), 0.5 * (b - a));
        let (mut low, mut high) = ([0.0; 2], [0.0; 2]);
        let (mut slope, mut bend) = ([0.0; 2], [0.0; 2]);
        for c in 0..2 {
            let whole = self.halves[half][c];
            let recentred;
            let local = if radius == 1.0 {
                whole
            } else {
                recentred = recentre(whole, middle, radius);
                &recentred
            };
            let reach: f64 = local[1..].iter().map(|v| v.abs()).sum();
            (low[c], high[c]) = (local[0] - reach, local[0] + reach);
            slope[c] = local.get(1).copied().unwrap_or(0.0);
            bend[c] = local.iter().enumerate().skip(2).map(|(m, v)| m as f64 * v.abs()).sum();
        }
        let length = f64::hypot(slope[0], slope[1]);
        let deviation = f64::hypot(bend[0], bend[1]);
        let spread = if deviation < length { (deviation / length).asin() } else { std::f64::consts::PI };
        Stretch { low, high, direction: slope[1].atan2(slope[0]), spread, ..Stretch::EMPTY }
    }

    fn split(&self, start: f64, end: f64) -> f64 {
        let middle = 0.5 * (start + end);
        if end - start > 1.0 { middle.round() } else { middle }
    }

    fn within(&mut self, stretch: &Stretch) -> bool {
        if stretch.spread < std::f64::consts::FRAC_PI_2 || self.is_chord(stretch) {
            return false;
        }
        let [left, right] = self.parts(stretch);
        self.within(&left) || self.within(&right) || self.between(&left, &right)
    }

    fn between(&mut self, first: &Stretch, second: &Stretch) -> bool {
        self.pairs += 1;
        if self.pairs > PAIRS + PAIRS_PER_HALF * self.count {
            return true;
        }
        let apart = |low: f64, high: f64| high + self.touch < low;
        if (0..2).any(|c| apart(second.low[c], first.high[c]) || apart(first.low[c], second.high[c])) {
            return false;
        }
        let closes = self.closed && first.start == 0.0 && second.end == self.count as f64;
        if (first.end == second.start && join(first, second).spread < std::f64::consts::FRAC_PI_2)
            || (closes && join(second, first).spread < std::f64::consts::FRAC_PI_2)
        {
            return false;
        }
        match (self.is_chord(first), self.is_chord(second)) {
            (true, true) => {
                // Neighbours share a point by construction.
                first.end != second.start && !closes && self.chords_meet(first, second)
            }
            (false, true) => self.split_first(first, second, false),
            (true, false) => self.split_first(second, first, true),
            (false, false) if first.end - first.start >= second.end - second.start => {
                self.split_first(first, second, false)
            }
            (false, false) => self.split_first(second, first, true),
        }
    }

    fn split_first(&mut self, wide: &Stretch, other: &Stretch, swapped: bool) -> bool {
        self.parts(wide)
            .into_iter()
            .any(|part| if swapped { self.between(other, &part) } else { self.between(&part, other) })
    }

    fn is_chord(&self, stretch: &Stretch) -> bool {
        (0..2).all(|c| stretch.high[c] - stretch.low[c] <= CHORD * self.touch)
            || stretch.end - stretch.start < 1e-12
    }

    fn point(&self, position: f64) -> [f64; 2] {
        let half = (position.floor() as usize).min(self.count - 1);
        let s = 2.0 * (position - half as f64) - 1.0;
        [0, 1].map(|c| evaluate_taylor(self.halves[half][c], s, 0))
    }

    /// Whether two chords cross, or an end of one touches the other.
    fn chords_meet(&self, first: &Stretch, second: &Stretch) -> bool {
        let (a, b) = (self.point(first.start), self.point(first.end));
        let (c, d) = (self.point(second.start), self.point(second.end));
        let crossing = side(a, b, c) * side(a, b, d) < 0.0 && side(c, d, a) * side(c, d, b) < 0.0;
        crossing
            || [(c, a, b), (d, a, b), (a, c, d), (b, c, d)]
                .into_iter()
                .any(|(p, from, to)| distance(p, from, to) <= self.touch)
    }
}

/// Twice the signed area of the triangle `p q r`.
fn side(p: [f64; 2], q: [f64; 2], r: [f64; 2]) -> f64 {
    (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])
}

/// Distance of `p` from the segment `from to`.
fn distance(p: [f64; 2], from: [f64; 2], to: [f64; 2]) -> f64 {
    let (edge, arm) = ([0, 1].map(|c| to[c] - from[c]), [0, 1].map(|c| p[c] - from[c]));
    let square = edge[0] * edge[0] + edge[1] * edge[1];
    let along =
        if square > 0.0 { ((arm[0] * edge[0] + arm[1] * edge[1]) / square).clamp(0.0, 1.0) } else { 0.0 };
    f64::hypot(arm[0] - along * edge[0], arm[1] - along * edge[1])
}

/// Joint bounds of two consecutive stretches.
fn join(first: &Stretch, second: &Stretch) -> Stretch {
    let turn = (second.direction - first.direction + std::f64::consts::PI).rem_euclid(std::f64::consts::TAU)
        - std::f64::consts::PI;
    let (low, high) = (-first.spread, first.spread);
    let (low, high) = (low.min(turn - second.spread), high.max(turn + second.spread));
    Stretch {
        start: first.start,
        end: second.end,
        low: [0, 1].map(|c| first.low[c].min(second.low[c])),
        high: [0, 1].map(|c| first.high[c].max(second.high[c])),
        direction: first.direction + 0.5 * (low + high),
        spread: (0.5 * (high - low)).min(std::f64::consts::PI),
        node: 0,
    }
}
