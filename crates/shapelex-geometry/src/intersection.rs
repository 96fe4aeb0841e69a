//! Self-intersection test of planar curves.
//!
//! A binary tree over the parameter holds a bounding box and a cone of tangents for every stretch. A stretch whose
//! tangents stay within a half-plane cannot meet itself; two stretches with disjoint boxes cannot meet; two neighbours
//! whose tangents together stay within a half-plane meet only at their common point; two stretches meet if each crosses the strip
//! around the chord of the other. The remaining pairs are split down to stretches of `10⁻⁹` of the extent, which are straight up
//! to rounding, and decided by their chords.

use std::cell::Cell;

use super::columns::Columns;
use super::cone::Cone;
use super::curve::Curve;
use super::generator::GeneratorKind;
use super::knot_line::Line;
use super::stretches::{Stretch, Tree, length};
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

/// Whether the planar `curve` crosses or touches itself. Points that are visited twice, cusps that fold back,
/// stretches traced twice, and coinciding ends of an open curve count; consecutive stretches of a smooth curve do not.
///
/// Cost `O(N log N)` for curves without near-contacts.
pub fn self_intersects(curve: &Curve) -> bool {
    // Products of coordinates overflow long before the curve does; a power of two changes no digits.
    crosses_itself(&Columns::of(&curve.scaled(Curve::unit(&[curve]).recip())))
}

/// [`self_intersects`] of the closed curve on a line of knots with these control points.
pub fn closed_self_intersects(line: &Line, control_points: &[[f64; 2]]) -> bool {
    let control_points = Matrix::from_fn(control_points.len(), 2, |row, c| control_points[row][c]);
    self_intersects(&Curve::closed(line.generator(), &control_points))
}

/// [`self_intersects`] of a planar curve with coordinates near 1.
pub(crate) fn crosses_itself(curve: &Columns) -> bool {
    let stretches = Tree::of(curve).stretches;
    let all = stretches[stretches.len() - 1];
    let extent = (0..2).map(|c| all.high[c] - all.low[c]).fold(0.0, f64::max);
    let distance = (0..2).map(|c| all.high[c].abs().max(all.low[c].abs())).fold(0.0, f64::max);
    let touch = TOUCH * extent + ROUNDING * distance;
    let pairs = Cell::new(PAIRS + PAIRS_PER_HALF * curve.halves());
    Search { curve, stretches, pairs, touch }.within(&all)
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
    curve: &'a Columns,
    /// Those of whole half-segments.
    stretches: Vec<Stretch>,
    /// Number of pairs that may still be examined.
    pairs: Cell<usize>,
    /// Distance below which points touch.
    touch: f64,
}

impl Search<'_> {
    /// Whether one of both parts of a stretch is `wanted`.
    fn any_part(&self, stretch: &Stretch, wanted: impl Fn(&Stretch) -> bool) -> bool {
        if let Some(parts) = stretch.parts {
            return parts.iter().any(|part| wanted(&self.stretches[*part]));
        }
        self.divided(stretch).iter().any(wanted)
    }

    /// Both parts of a stretch.
    fn parts(&self, stretch: &Stretch) -> [Stretch; 2] {
        match stretch.parts {
            Some(parts) => parts.map(|part| self.stretches[part]),
            None => self.divided(stretch),
        }
    }

    /// Both halves of a part of a half-segment.
    fn divided(&self, stretch: &Stretch) -> [Stretch; 2] {
        let middle = 0.5 * (stretch.start + stretch.end);
        [self.part(stretch.start, middle), self.part(middle, stretch.end)]
    }

    /// Bounds of a part of a half-segment.
    fn part(&self, start: f64, end: f64) -> Stretch {
        let arc = Arc::new(self.curve, start, end);
        let (reach, bend) = (arc.reach(), arc.bend.map(|bend| 2.0 * bend));
        Stretch {
            start,
            end,
            low: [0, 1].map(|c| arc.middle[c] - reach[c]),
            high: [0, 1].map(|c| arc.middle[c] + reach[c]),
            tangents: Cone::around(arc.slope, length(bend)),
            parts: None,
        }
    }

    fn within(&self, stretch: &Stretch) -> bool {
        if stretch.tangents.is_bounded() || self.is_chord(stretch) {
            return false;
        }
        let [left, right] = self.parts(stretch);
        self.within(&left) || self.within(&right) || self.between(&left, &right)
    }

    fn between(&self, first: &Stretch, second: &Stretch) -> bool {
        let Some(left) = self.pairs.get().checked_sub(1) else { return true };
        self.pairs.set(left);
        let apart = |low: f64, high: f64| high + self.touch < low;
        if (0..2).any(|c| apart(second.low[c], first.high[c]) || apart(first.low[c], second.high[c])) {
            return false;
        }
        let closes = self.curve.is_closed() && first.start == 0.0 && second.end == self.curve.halves() as f64;
        if (first.end == second.start || closes) && first.tangents.and(&second.tangents).is_bounded() {
            return false;
        }
        if first.parts.is_none() && second.parts.is_none() && self.cross(first, second) {
            return true;
        }
        match (self.is_chord(first), self.is_chord(second)) {
            (true, true) => {
                // Neighbours share a point by construction.
                first.end != second.start && !closes && self.chords_meet(first, second)
            }
            (false, true) => self.any_part(first, |part| self.between(part, second)),
            (true, false) => self.any_part(second, |part| self.between(first, part)),
            (false, false) if first.end - first.start >= second.end - second.start => {
                self.any_part(first, |part| self.between(part, second))
            }
            (false, false) => self.any_part(second, |part| self.between(first, part)),
        }
    }

    fn is_chord(&self, stretch: &Stretch) -> bool {
        (0..2).all(|c| stretch.high[c] - stretch.low[c] <= CHORD * self.touch)
            || stretch.end - stretch.start < 1e-12
    }

    fn point(&self, position: f64) -> [f64; 2] {
        let half = (position.floor() as usize).min(self.curve.halves() - 1);
        let s = 2.0 * (position - half as f64) - 1.0;
        [0, 1].map(|c| self.curve.taylor(half, c).rfold(0.0, |sum, value| sum * s + value))
    }

    /// Whether two parts of half-segments certainly cross: each stays within a strip around its chord, and joins both sides of the
    /// strip of the other. In the parallelogram that the strips share, paths that join opposite sides meet.
    fn cross(&self, first: &Stretch, second: &Stretch) -> bool {
        let ends = |stretch: &Stretch| [self.point(stretch.start), self.point(stretch.end)];
        let (from, to) = (ends(first), ends(second));
        let width =
            |stretch: &Stretch| length(Arc::new(self.curve, stretch.start, stretch.end).bend) + self.touch;
        joins_sides(from, to, || width(first)) && joins_sides(to, from, || width(second))
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

/// Part of a half-segment, `r(s) = r_0 + r_1 s + …`, `s ∈ [−1, 1]`.
struct Arc {
    middle: [f64; 2],
    slope: [f64; 2],
    /// Bounds of `½ |r''|`, and so of the distance from the chord.
    bend: [f64; 2],
}

impl Arc {
    /// With `p(m + h s) = p(m) + h p'(m) s + …`, `½ |p''| ≤ Σ k(k−1)/2 |p_k|`.
    fn new(curve: &Columns, start: f64, end: f64) -> Self {
        let half = start.floor();
        let (middle, radius) = (start + end - 2.0 * half - 1.0, end - start);
        let mut arc = Self { middle: [0.0; 2], slope: [0.0; 2], bend: [0.0; 2] };
        for c in 0..2 {
            let (mut value, mut slope, mut bend) = (0.0, 0.0, 0.0);
            for (k, coefficient) in curve.taylor(half as usize, c).enumerate().rev() {
                slope = slope * middle + value;
                value = value * middle + coefficient;
                bend += (k * k.saturating_sub(1) / 2) as f64 * coefficient.abs();
            }
            (arc.middle[c], arc.slope[c], arc.bend[c]) = (value, radius * slope, radius * radius * bend);
        }
        arc
    }

    /// Bounds of the distance from the middle.
    fn reach(&self) -> [f64; 2] {
        [0, 1].map(|c| self.slope[c].abs() + self.bend[c])
    }
}

/// Whether the ends of a chord `to` are on both sides of the chord `from`, farther from its line than `width`.
fn joins_sides(from: [[f64; 2]; 2], to: [[f64; 2]; 2], width: impl Fn() -> f64) -> bool {
    let [left, right] = to.map(|end| side(from[0], from[1], end));
    left * right < 0.0 && {
        let chord = length([from[1][0] - from[0][0], from[1][1] - from[0][1]]);
        left.abs().min(right.abs()) > width() * chord
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
