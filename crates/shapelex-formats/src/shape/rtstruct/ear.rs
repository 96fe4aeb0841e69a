//! Triangles of a polygon in the plane, without new points.

use crate::shape::record::Points;

/// Triangles of a polygon by cutting off ears, or `None` if it has no ear left, as happens where it crosses itself.
///
/// All points become corners, also those in the middle of a straight side, so that a surface joined to the sides stays closed: n − 2
/// triangles, of which those of straight sides have no area. The polygon may run in either direction; the triangles run in its own.
/// Cost: less than 4 n² tests of a corner against a point. The n corners and the two that each cut changes pass each point at most
/// once, 3 n² in all; the n² / 2 looks at a corner test again the one point that they stopped at.
///
/// # Source
/// Meisters 1975, *Polygons have ears*.
pub(super) fn triangles(polygon: &Points) -> Option<Vec<[u32; 3]>> {
    let points: Vec<[f64; 2]> = polygon.rows().map(|row| [row[0], row[1]]).collect();
    Corners::new(&points).cut()
}

/// The corners of a polygon that are left, linked to a ring.
struct Corners<'a> {
    points: &'a [[f64; 2]],
    /// Direction of the polygon: 1 if counter-clockwise, else −1.
    sign: f64,
    previous: Vec<usize>,
    next: Vec<usize>,
    is_left: Vec<bool>,
    /// For each corner, how many of the first points are known not to keep it from being an ear. As points are only taken away, this
    /// holds until a neighbour of the corner is.
    passed: Vec<usize>,
    /// Number of tests of a corner against a point.
    tests: usize,
}

impl<'a> Corners<'a> {
    fn new(points: &'a [[f64; 2]]) -> Self {
        let count = points.len();
        let last = count.saturating_sub(1);
        Self {
            points,
            sign: signed_area(points).signum(),
            previous: (0..count).map(|k| k.checked_sub(1).unwrap_or(last)).collect(),
            next: (0..count).map(|k| if k == last { 0 } else { k + 1 }).collect(),
            is_left: vec![true; count],
            passed: vec![0; count],
            tests: 0,
        }
    }

    fn cut(&mut self) -> Option<Vec<[u32; 3]>> {
        let index = |corner: usize| u32::try_from(corner).unwrap_or(u32::MAX);
        let mut triangles = Vec::with_capacity(self.points.len().saturating_sub(2));
        let mut at = 0;
        for left in (4..=self.points.len()).rev() {
            // Without an ear, the rest is straight, or has doubled points: cut where there is no area.
            let k = self
                .find(at, left, Self::is_ear)
                .or_else(|| self.find(at, left, |it, k| it.turn(k) == 0.0))?;
            triangles.push(self.corner(k).map(index));
            // The next corner but one: ears one beside the other would make a fan of thin triangles.
            at = self.next[self.next[k]];
            self.remove(k);
        }
        let last: Vec<usize> = (0..self.points.len()).filter(|k| self.is_left[*k]).collect();
        let last = <[usize; 3]>::try_from(last).ok()?;
        if self.sign * turn(self.points, last) < 0.0 {
            return None;
        }
        triangles.push(last.map(index));
        Some(triangles)
    }

    /// A corner with its neighbours.
    fn corner(&self, k: usize) -> [usize; 3] {
        [self.previous[k], k, self.next[k]]
    }

    fn turn(&self, k: usize) -> f64 {
        turn(self.points, self.corner(k))
    }

    /// The first of the corners from `at` on, all around, that is wanted.
    fn find(&mut self, at: usize, left: usize, wanted: impl Fn(&mut Self, usize) -> bool) -> Option<usize> {
        let mut k = at;
        for _ in 0..left {
            if wanted(self, k) {
                return Some(k);
            }
            k = self.next[k];
        }
        None
    }

    fn remove(&mut self, k: usize) {
        let [before, _, after] = self.corner(k);
        self.next[before] = after;
        self.previous[after] = before;
        self.is_left[k] = false;
        self.passed[before] = 0;
        self.passed[after] = 0;
    }

    /// Whether the polygon turns inwards at a corner, and no other point is within the triangle or on the side that is cut.
    fn is_ear(&mut self, k: usize) -> bool {
        if !(self.sign * self.turn(k) > 0.0) {
            return false;
        }
        while self.passed[k] < self.points.len() {
            let p = self.passed[k];
            if self.is_left[p] && !self.is_clear(self.corner(k), p) {
                return false;
            }
            self.passed[k] += 1;
        }
        true
    }

    /// Whether a point is a corner of a triangle, or at the same place as one, or outside.
    fn is_clear(&mut self, [a, b, c]: [usize; 3], p: usize) -> bool {
        self.tests += 1;
        let same = [a, b, c].iter().any(|corner| self.points[*corner] == self.points[p]);
        same || [[a, b, p], [b, c, p], [c, a, p]]
            .iter()
            .any(|side| self.sign * turn(self.points, *side) < 0.0)
    }
}

/// `½ Σ (xᵢ − x₀)(yᵢ₊₁ − y₀) − (xᵢ₊₁ − x₀)(yᵢ − y₀)`, positive if counter-clockwise.
pub(super) fn signed_area(points: &[[f64; 2]]) -> f64 {
    let Some([x, y]) = points.first() else { return 0.0 };
    let pairs = points.iter().zip(points.iter().skip(1));
    pairs.map(|(a, b)| 0.5 * ((a[0] - x) * (b[1] - y) - (b[0] - x) * (a[1] - y))).sum()
}

/// Twice the area of a triangle, positive if counter-clockwise.
fn turn(points: &[[f64; 2]], [a, b, c]: [usize; 3]) -> f64 {
    let [a, b, c] = [points[a], points[b], points[c]];
    (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn area(points: &[[f64; 2]], triangles: &[[u32; 3]]) -> f64 {
        triangles.iter().map(|t| 0.5 * turn(points, t.map(|k| k as usize))).sum()
    }

    fn check(points: &[[f64; 2]]) {
        let polygon = Points::from_rows(2, points.concat());
        let triangles = triangles(&polygon).expect("a simple polygon");
        assert_eq!(triangles.len(), points.len() - 2);
        let (found, expected) = (area(points, &triangles), signed_area(points));
        assert!((found - expected).abs() <= 1e-12 * expected.abs(), "{found} {expected}");
        let least =
            triangles.iter().map(|t| expected.signum() * area(points, &[*t])).fold(f64::INFINITY, f64::min);
        assert!(least >= 0.0, "{least}");
    }

    #[test]
    fn polygons_are_covered_once() {
        check(&[[0.0, 0.0], [4.0, 0.0], [4.0, 1.0]]);
        check(&[[0.0, 0.0], [2.0, 0.0], [4.0, 0.0], [4.0, 3.0], [2.0, 3.0], [0.0, 3.0]]);
        check(&[[0.0, 0.0], [0.0, 3.0], [4.0, 3.0], [4.0, 2.0], [1.0, 2.0], [1.0, 0.0]]);
        // A star, and a comb with straight sides.
        let star: Vec<[f64; 2]> = (0..60)
            .map(|k| (f64::from(k) / 60.0 * std::f64::consts::TAU, if k % 2 == 0 { 5.0 } else { 1.0 }))
            .map(|(angle, radius)| [radius * angle.cos(), radius * angle.sin()])
            .collect();
        check(&star);
        let mut comb = vec![[0.0, -1.0], [20.0, -1.0]];
        comb.extend((0..=20).rev().map(|k| [f64::from(k), if k % 2 == 0 { 0.0 } else { 5.0 }]));
        check(&comb);
    }

    /// A thin strip from left to right and back, whose walls turn up and down at each point.
    fn strip(half: u32) -> Vec<[f64; 2]> {
        let wall =
            |k: u32, below: f64| [f64::from(k), if k.is_multiple_of(2) { 10.0 } else { -10.0 } - below];
        let upper = (0..half).rev().map(|k| wall(k, 0.0));
        (0..half).map(|k| wall(k, 0.4)).chain(upper).collect()
    }

    #[test]
    fn tests_grow_with_the_square_of_the_points() {
        for half in [32, 256] {
            let points = strip(half);
            check(&points);
            let mut corners = Corners::new(&points);
            // Almost every corner has another one in its triangle, so most ears are at the two ends.
            let first = (0..points.len()).filter(|k| corners.is_ear(*k)).count();
            assert!(first <= 4, "{first}");
            corners.cut().expect("a simple polygon");
            let most = 4 * points.len() * points.len();
            assert!(corners.tests < most, "{} {most}", corners.tests);
        }
    }

    #[test]
    fn a_corner_becomes_an_ear_when_what_is_in_its_triangle_is_taken_away() {
        let points = [[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [1.0, 1.0], [0.0, 4.0]];
        check(&points);
        let mut corners = Corners::new(&points);
        assert!(!corners.is_ear(0));
        let tests = corners.tests;
        corners.remove(3);
        assert!(corners.is_ear(0));
        // The points that did not matter before are not tested again.
        assert!(corners.tests - tests <= 2, "{}", corners.tests);
    }

    #[test]
    fn a_crossing_polygon_is_refused() {
        let crossing = [[0.0, 0.0], [4.0, 4.0], [4.0, 0.0], [0.0, 3.0]];
        assert_eq!(triangles(&Points::from_rows(2, crossing.concat())), None);
    }
}
