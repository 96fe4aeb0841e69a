//! The rule of one edge: the new point and normal between those at its ends.

use super::direction;
use crate::edge_fault::EdgeFault;
use crate::vector::{cross, dot, minus, norm, plus, scaled};

/// Sum of sines up to which an edge is flat: such small sines have at most four digits, and their ratio has no limit.
const FLAT: f64 = 1e-12;

/// Cosine up to which a normal is parallel to an edge: the direction of `u × n` has at most four digits there.
pub(super) const ALONG: f64 = 1e-12;

/// Length up to which a sum of unit vectors has no direction: as many digits are lost as kept.
const OPPOSITE: f64 = 1e-9;

/// Tolerance for the length of a unit normal; an error of this size propagates to the new point.
const UNIT: f64 = 1e-9;

/// The new point and unit normal between `p0` and `p1` with unit normals `n0` and `n1`: `p` and `n` of the module head.
///
/// `balance`: `κ ≥ 0`. `binormal`: `f`, of any length, used if the normals define none; its component along the edge is
/// ignored. The resulting normal is on the side `f × u`. Swapping both ends and negating `binormal` gives the same bits.
///
/// * Flat edges have `ω₀ = ω₁ = ½`, the limit of every symmetric approach.
/// * If one normal is parallel to the edge, it takes the binormal of the other: `τ₀ = n₀ × f₁` is the limit of the formula.
/// * If both are parallel: `τⱼ = nⱼ × f` with the `binormal`; half a circle if they point away from each other.
///
/// # Errors
/// [`EdgeFault::NoLength`]; [`EdgeFault::NotUnit`]; [`EdgeFault::AlongBoth`] and [`EdgeFault::Opposite`] without `binormal`,
/// or with one parallel to the edge.
pub fn split(
    p0: [f64; 3],
    n0: [f64; 3],
    p1: [f64; 3],
    n1: [f64; 3],
    balance: f64,
    binormal: Option<[f64; 3]>,
) -> Result<([f64; 3], [f64; 3]), EdgeFault> {
    let binormal = binormal.and_then(|binormal| direction(binormal, 0.0)).unwrap_or_default();
    Ok(middle([p0, p1], [n0, n1], balance, |_| binormal)?.oriented())
}

/// Ratio of the sines at both ends up to which an edge keeps a corner: the smaller one doubles in every step, and the corner begins to
/// close when both are alike, here after the 13th step.
const CORNER: f64 = 1.0 / 8192.0;

/// Sine from which a corner is seen: 0.6 degrees.
const SEEN: f64 = 0.01;

/// The end of an edge at which it makes a corner, 0 or 1, with the angle there in radians: the normal at the other end is
/// orthogonal to the edge, that at this end is not.
///
/// ```text
/// sin αⱼ ≤ sin αᵢ/8192:   wᵢ ≈ 0,   p = pᵢ + ¼(pⱼ − pᵢ),   the same angle αᵢ again at pᵢ, step after step
/// ```
///
/// `None` for other edges, edges without length, and a positive `balance`, which rounds the corner off.
pub fn corner(points: [[f64; 3]; 2], normals: [[f64; 3]; 2], balance: f64) -> Option<(usize, f64)> {
    let u = direction(minus(points[1], points[0]), 0.0).filter(|_| balance == 0.0)?;
    let sines = normals.map(|normal| dot(normal, u).abs());
    let end = usize::from(sines[1] > sines[0]);
    let is_corner = sines[end] > SEEN && sines[1 - end] <= CORNER * sines[end];
    is_corner.then(|| (end, sines[end].min(1.0).asin()))
}

/// Result for the middle of an edge: `p`, `t` and `f`.
pub(super) struct Middle {
    point: [f64; 3],
    tangent: [f64; 3],
    binormal: [f64; 3],
}

impl Middle {
    /// The new point and normal, `p` and `n`. Since `f` is orthogonal to `u`, `|f × t| ≥ t·u ≥ 1`.
    pub(super) fn oriented(&self) -> ([f64; 3], [f64; 3]) {
        let normal = cross(self.binormal, self.tangent);
        let length = norm(normal);
        (self.point, normal.map(|x| x / length))
    }
}

/// Computes the middle of an edge. `fallback(u)` is a binormal for normals that define none; zero if there is none. Every sum
/// has two terms, so that swapping the ends gives the same bits.
pub(super) fn middle(
    points: [[f64; 3]; 2],
    normals: [[f64; 3]; 2],
    balance: f64,
    fallback: impl FnOnce([f64; 3]) -> [f64; 3],
) -> Result<Middle, EdgeFault> {
    let e = minus(points[1], points[0]);
    let length = norm(e);
    let u = direction(e, 0.0).ok_or(EdgeFault::NoLength)?;
    if !normals.iter().all(|normal| (norm(*normal) - 1.0).abs() < UNIT) {
        return Err(EdgeFault::NotUnit);
    }
    let ([f0, f1], f) = binormals(u, normals, fallback)?;
    let [w0, w1] = weights(normals.map(|normal| dot(normal, u).abs()), balance);
    // hⱼ τⱼ, with cos αⱼ exact to rounding even if it is nearly zero.
    let bend = |w: f64, normal: [f64; 3], binormal: [f64; 3]| {
        scaled(4.0 * w / (1.0 + norm(cross(u, normal))), cross(normal, binormal))
    };
    let (start, end) = (bend(w0, normals[0], f0), bend(w1, normals[1], f1));
    Ok(Middle {
        point: plus(scaled(0.5, plus(points[0], points[1])), scaled(0.125 * length, minus(start, end))),
        tangent: minus(scaled(1.5, u), scaled(0.25, plus(start, end))),
        binormal: f,
    })
}

/// `[f₀, f₁]` and `f`.
fn binormals(
    u: [f64; 3],
    normals: [[f64; 3]; 2],
    fallback: impl FnOnce([f64; 3]) -> [f64; 3],
) -> Result<([[f64; 3]; 2], [f64; 3]), EdgeFault> {
    let given = || {
        let binormal = fallback(u);
        direction(minus(binormal, scaled(dot(binormal, u), u)), OPPOSITE)
    };
    match normals.map(|normal| direction(cross(u, normal), ALONG)) {
        [Some(f0), Some(f1)] => {
            let f = direction(plus(f0, f1), OPPOSITE).or_else(given).ok_or(EdgeFault::Opposite)?;
            Ok(([f0, f1], f))
        }
        [Some(f), None] | [None, Some(f)] => Ok(([f; 2], f)),
        [None, None] => {
            let f = given().ok_or(EdgeFault::AlongBoth)?;
            Ok(([f; 2], f))
        }
    }
}

/// The weights `[w₀, w₁]`: each is based on the sine at the other end.
fn weights([alpha, beta]: [f64; 2], balance: f64) -> [f64; 2] {
    let sum = alpha + beta;
    if sum <= FLAT {
        return [0.5; 2];
    }
    [beta, alpha].map(|sine| (sine / sum + balance) / (1.0 + 2.0 * balance))
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::super::samples::{EX, EY, Random, at_angle, close, distance, negated, unit};
    use super::*;

    #[test]
    fn new_points_stay_between_the_ends() {
        let mut random = Random(4);
        for i in 0..3000 {
            let [p0, p1] = [random.vector(), random.vector()];
            let u = unit(minus(p1, p0));
            // From arbitrary normals to normals that are parallel or orthogonal to the edge to many digits.
            let small = 10.0_f64.powi(-(i % 14));
            let normal = |along: bool, random: &mut Random| {
                let any = random.unit();
                let axis = if along { u } else { unit(cross(u, any)) };
                unit(plus(axis, scaled(small, any)))
            };
            let normals = [normal(i % 3 == 0, &mut random), normal(i % 5 == 0, &mut random)];
            let balance = [0.0, 0.25, 4.0][i as usize % 3];
            let middle = middle([p0, p1], normals, balance, |u| cross(u, [0.3, 0.5, -0.7])).unwrap();
            let share = dot(minus(middle.point, p0), u) / distance(p0, p1);
            assert!((0.25 - ALONG..=0.75 + ALONG).contains(&share), "{share}");
            let forward = dot(middle.tangent, u);
            // A normal that counts as parallel to the edge may have a tangent that points back by this much.
            assert!((1.0 - 1e-14..=1.5 + ALONG).contains(&forward), "{forward}");
            let (_, n) = middle.oriented();
            assert!((norm(n) - 1.0).abs() < 1e-15, "{n:?}");
        }
    }

    /// Plane edges of length 2 along `x`, with normals that lean away from each other by `α` and `β`.
    fn leaning(alpha: f64, beta: f64) -> [[f64; 3]; 2] {
        [at_angle(TAU / 4.0 + alpha), at_angle(TAU / 4.0 - beta)]
    }

    fn plane_split(alpha: f64, beta: f64, balance: f64) -> ([f64; 3], [f64; 3]) {
        let [n0, n1] = leaning(alpha, beta);
        split([0.0; 3], n0, [2.0, 0.0, 0.0], n1, balance, None).unwrap()
    }

    #[test]
    fn distances_from_the_edge_are_the_closed_form() {
        let mut random = Random(5);
        for _ in 0..300 {
            let [alpha, beta, _] = random.vector().map(|x| 0.78 * (1.0 + x));
            let (a, b) = (1.0 / (1.0 + alpha.cos()), 1.0 / (1.0 + beta.cos()));
            let height = alpha.sin() * beta.sin() / (alpha.sin() + beta.sin());
            let convex = plane_split(alpha, beta, 0.0).0[1];
            assert!((convex - height * (a + b)).abs() < 1e-14, "{alpha} {beta}: {convex}");
            let inflection = plane_split(alpha, -beta, 0.0).0[1];
            assert!((inflection - height * (a - b)).abs() < 1e-14, "{alpha} {beta}: {inflection}");
        }
    }

    #[test]
    fn flat_edges_have_their_midpoint() {
        assert_eq!(split([0.0; 3], EY, [2.0, 0.0, 0.0], EY, 0.0, None), Ok((EX, EY)));
        // By the formula, sines of 3e-13 and 1e-13 would put the point at 3/4 of the edge, or 5/8.
        let (p, n) = plane_split(3e-13, -1e-13, 0.0);
        close(p, EX, 1e-12);
        close(n, EY, 1e-12);
        let (p, _) = plane_split(3e-6, 1e-6, 0.0);
        close(p, [0.75, 7.5e-7, 0.0], 1e-10);
    }

    /// Angle at the corner of the edge after the first point, after twelve steps.
    fn corner(alpha: f64, beta: f64, balance: f64) -> f64 {
        let normals = leaning(alpha, beta);
        let [p0, mut p1] = [[0.0; 3], [2.0, 0.0, 0.0]];
        let mut n1 = normals[1];
        for _ in 0..12 {
            (p1, n1) = split(p0, normals[0], p1, n1, balance, None).unwrap();
        }
        dot(normals[0], unit(minus(p1, p0))).abs().asin().to_degrees()
    }

    #[test]
    fn one_orthogonal_normal_makes_a_corner_without_balance() {
        let alpha = 60.0_f64.to_radians();
        let (p, n) = plane_split(alpha, 0.0, 0.0);
        close(p, [0.5, 0.0, 0.0], 1e-15);
        close(n, EY, 1e-15);
        let angle = corner(alpha, 0.0, 0.0);
        assert!((angle - 60.0).abs() < 1e-9, "{angle}");
        let angle = corner(alpha, 0.0, 0.25);
        assert!((angle - 0.045).abs() < 1e-3, "{angle}");
    }

    #[test]
    fn corners_are_found_at_the_end_with_the_tilted_normal() {
        let at = |alpha: f64, beta: f64, balance: f64| {
            super::corner([[0.0; 3], [2.0, 0.0, 0.0]], leaning(alpha, beta), balance)
        };
        let (end, angle) = at(1.0, 0.0, 0.0).unwrap();
        assert_eq!(end, 0);
        assert!((angle - 1.0).abs() < 1e-12, "{angle}");
        assert_eq!(at(1e-16, 0.5, 0.0).map(|(end, _)| end), Some(1));
        // Seven more steps, and after them it closes.
        assert!(at(1.0, 1e-5, 0.0).is_some() && at(1.0, 1e-3, 0.0).is_none());
        for (alpha, beta, balance) in [(0.0, 0.0, 0.0), (0.005, 0.0, 0.0), (0.4, 0.3, 0.0), (1.0, 0.0, 0.25)]
        {
            assert_eq!(at(alpha, beta, balance), None, "{alpha} {beta} {balance}");
        }
        assert_eq!(super::corner([EX, EX], [EX, EY], 0.0), None);
    }

    #[test]
    fn a_normal_along_the_edge_takes_the_binormal_of_the_other() {
        let at = |lean: f64| plane_split(TAU / 4.0 - lean, 0.5, 0.0);
        let n1 = leaning(0.0, 0.5)[1];
        let (p, n) = split([0.0; 3], negated(EX), [2.0, 0.0, 0.0], n1, 0.0, None).unwrap();
        // The limit of the formula. Beyond the edge, the normal would be on its opposite side.
        for lean in [1e-9, 1e-11] {
            close(at(lean).0, p, 10.0 * lean);
            close(at(lean).1, n, 10.0 * lean);
        }
        let tilted = at_angle(TAU / 2.0 - 5e-13);
        let (q, m) = split([0.0; 3], tilted, [2.0, 0.0, 0.0], n1, 0.0, None).unwrap();
        close(q, p, 1e-12);
        close(m, n, 1e-12);
        let (p, n) = split([0.0; 3], negated(n1), [2.0, 0.0, 0.0], EX, 0.0, None).unwrap();
        let (q, m) = split([2.0, 0.0, 0.0], EX, [0.0; 3], negated(n1), 0.0, None).unwrap();
        assert_eq!((p, n), (q, m));
    }
}
