//! Triangles of a polygon in the plane, without new points.

use crate::shape::record::Points;

/// Triangles of a polygon by cutting off ears, or `None` if it has no ear left, as happens where it crosses itself.
///
/// All points become corners, also those in the middle of a straight side, so that what is joined to the sides stays closed: n − 2
/// triangles, of which those of straight sides have no area. The polygon may run in either direction; the triangles run in its own.
/// Cost: at most n² tests of n points, in practice n² in all.
///
/// # Source
/// Meisters 1975, *Polygons have ears*.
pub(super) fn triangles(polygon: &Points) -> Option<Vec<[u32; 3]>> {
    let points: Vec<[f64; 2]> = polygon.rows().map(|row| [row[0], row[1]]).collect();
    let sign = signed_area(&points).signum();
    let mut left: Vec<usize> = (0..points.len()).collect();
    let mut triangles = Vec::with_capacity(points.len().saturating_sub(2));
    let mut at = 0;
    while left.len() > 3 {
        let count = left.len();
        let found = (0..count).map(|k| (at + k) % count).find(|k| is_ear(&points, &left, *k, sign));
        // What is left is straight, or has doubled points: cut where there is no area.
        let flat = || (0..count).map(|k| (at + k) % count).find(|k| turn(&points, corner(&left, *k)) == 0.0);
        let k = found.or_else(flat)?;
        triangles.push(corner(&left, k).map(|corner| u32::try_from(corner).unwrap_or(u32::MAX)));
        left.remove(k);
        // The next corner but one: ears one beside the other would make a fan of thin triangles.
        at = (k + 1) % left.len();
    }
    let last = <[usize; 3]>::try_from(left).ok()?;
    if sign * turn(&points, last) < 0.0 {
        return None;
    }
    triangles.push(last.map(|corner| u32::try_from(corner).unwrap_or(u32::MAX)));
    Some(triangles)
}

/// `½ Σ (xᵢ − x₀)(yᵢ₊₁ − y₀) − (xᵢ₊₁ − x₀)(yᵢ − y₀)`, positive if counter-clockwise.
pub(super) fn signed_area(points: &[[f64; 2]]) -> f64 {
    let Some([x, y]) = points.first() else { return 0.0 };
    let pairs = points.iter().zip(points.iter().skip(1));
    pairs.map(|(a, b)| 0.5 * ((a[0] - x) * (b[1] - y) - (b[0] - x) * (a[1] - y))).sum()
}

/// A corner with its neighbours.
fn corner(left: &[usize], k: usize) -> [usize; 3] {
    let count = left.len();
    [left[(k + count - 1) % count], left[k], left[(k + 1) % count]]
}

/// Twice the area of a triangle, positive if counter-clockwise.
fn turn(points: &[[f64; 2]], [a, b, c]: [usize; 3]) -> f64 {
    let [a, b, c] = [points[a], points[b], points[c]];
    (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
}

/// Whether the polygon turns inwards at a corner, and no other point is within the triangle or on the side that is cut.
fn is_ear(points: &[[f64; 2]], left: &[usize], k: usize, sign: f64) -> bool {
    let [a, b, c] = corner(left, k);
    if !(sign * turn(points, [a, b, c]) > 0.0) {
        return false;
    }
    left.iter().filter(|p| ![a, b, c].contains(p)).all(|p| {
        let same = [a, b, c].iter().any(|corner| points[*corner] == points[*p]);
        same || [[a, b, *p], [b, c, *p], [c, a, *p]].iter().any(|side| sign * turn(points, *side) < 0.0)
    })
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

    #[test]
    fn a_crossing_polygon_is_refused() {
        let crossing = [[0.0, 0.0], [4.0, 4.0], [4.0, 0.0], [0.0, 3.0]];
        assert_eq!(triangles(&Points::from_rows(2, crossing.concat())), None);
    }
}
