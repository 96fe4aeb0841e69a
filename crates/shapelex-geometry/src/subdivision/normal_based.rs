//! Interpolating subdivision of points with normals: every edge gets a new point and normal between those at its ends.
//!
//! ```text
//! u = (p₁ − p₀)/L,   L = |p₁ − p₀|,   sin αⱼ = |nⱼ·u|,   cos αⱼ = |u × nⱼ|
//! fⱼ = (u × nⱼ)/cos αⱼ,   f ∝ f₀ + f₁,   τⱼ = nⱼ × fⱼ                (binormals, tangents)
//! wⱼ = (ωⱼ + κ)/(1 + 2κ),   ω₀ = sin α₁/(sin α₀ + sin α₁),   ω₁ = 1 − ω₀,   hⱼ = 4wⱼ/(1 + cos αⱼ)
//! p = ½(p₀ + p₁) + ⅛L (h₀τ₀ − h₁τ₁),   t = 3/2 u − ¼(h₀τ₀ + h₁τ₁),   n ∝ f × t
//! ```
//!
//! `p` and `t` are the midpoint, and the direction there, of the cubic segment with the end tangents `L h₀τ₀` and `L h₁τ₁`. Old
//! points and normals do not change. Points of a circle or a sphere with radial normals give further such points, exactly. A
//! step commutes with similarities, including reflections, and with a change of sign of all normals.
//!
//! `u·t` is in `[1, 3/2]`, and the foot of `p` is between 1/4 and 3/4 of the edge. Limits in the plane have
//! continuous tangents, except for edges with exactly one normal orthogonal to them: these get `p` at a quarter of the edge,
//! step after step, and a corner at the other end, unless the balance `κ` is positive. Limits of meshes are smooth for
//! spheres; others have creases that show after three or four steps. Limits in space have continuous normals, not tangents.
//!
//! Source: *Normal-based interpolating subdivision for the geometric representation of deformable models*. Its factors
//! `L cos αⱼ` and `1/cos αⱼ` cancel, and its `sin α = √(1 − cos² α)` loses all digits where an edge is nearly flat; here
//! the sines are computed from the normals.

use crate::mesh::TriangleMesh;
use crate::vector::{cross, dot, minus, norm};

/// Points with unit normals.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Oriented {
    /// Positions of the points.
    pub points: Vec<[f64; 3]>,
    /// Unit normals, one per point.
    pub normals: Vec<[f64; 3]>,
}

/// Reason why an edge cannot be split.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum EdgeFault {
    /// The ends of the edge coincide.
    #[error("its ends coincide")]
    NoLength,
    /// A normal at one end is not a unit vector.
    #[error("a normal at its ends is not of unit length")]
    NotUnit,
    /// Both normals are parallel to the edge, so the plane in which it bends is undefined.
    #[error("the normals at both ends are parallel to it")]
    AlongBoth,
    /// The normals are on opposite sides of the edge.
    #[error("the normals at its ends are on opposite sides of it")]
    Opposite,
}

/// Sum of sines up to which an edge is flat: such small sines have at most four digits, and their ratio has no limit.
const FLAT: f64 = 1e-12;

/// Cosine up to which a normal is parallel to an edge: the direction of `u × n` has at most four digits there.
const ALONG: f64 = 1e-12;

/// Length up to which a sum of unit vectors has no direction: as many digits are lost as kept.
const OPPOSITE: f64 = 1e-9;

/// Tolerance for the length of a unit normal; an error of this size propagates to the new point.
const UNIT: f64 = 1e-9;

/// Relative size, compared with its terms, up to which the sum for a default normal is zero.
const CANCELLED: f64 = 1e-12;

impl Oriented {
    /// Points with normals of any length, which are normalised.
    ///
    /// # Errors
    /// The first position where the point or the normal is missing, or the normal is zero or not finite.
    pub fn new(points: Vec<[f64; 3]>, normals: &[[f64; 3]]) -> Result<Self, usize> {
        let units: Vec<[f64; 3]> = normals.iter().map_while(|normal| direction(*normal, 0.0)).collect();
        if units.len() == normals.len() && units.len() == points.len() {
            Ok(Self { points, normals: units })
        } else {
            Err(units.len().min(points.len()))
        }
    }

    fn push(&mut self, (point, normal): ([f64; 3], [f64; 3])) {
        self.points.push(point);
        self.normals.push(normal);
    }

    fn with_capacity(count: usize) -> Self {
        Self { points: Vec::with_capacity(count), normals: Vec::with_capacity(count) }
    }
}

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

/// One step on a polyline: point `2i` is the old point `i`, and `2i + 1` is the new one between `i` and `i + 1`. The last edge
/// of a closed polyline ends at 0. `n` points become `2n`, or `2n − 1` if open. `balance`: `κ ≥ 0`.
///
/// # Errors
/// The first edge that cannot be split, with the reason.
pub fn refine_polyline(shape: &Oriented, closed: bool, balance: f64) -> Result<Oriented, (usize, EdgeFault)> {
    let count = shape.points.len();
    let edges = if closed { count } else { count.saturating_sub(1) };
    let mut refined = Oriented::with_capacity(count + edges);
    for i in 0..count {
        refined.push((shape.points[i], shape.normals[i]));
        if i < edges {
            let [points, normals] = ends(shape, [i, (i + 1) % count]);
            let middle = middle(points, normals, balance, |_| [0.0; 3]).map_err(|fault| (i, fault))?;
            refined.push(middle.oriented());
        }
    }
    Ok(refined)
}

/// One step on the edges of a mesh: the old vertices, then one new vertex per edge, in the order of `edges`.
///
/// `sides(e)`: sum `N₁ + N₂` of the unit normals of the faces at edge `e`. It is called where the normals at the ends define no
/// binormal, which then is `f ∝ u × (N₁ + N₂)`. `balance`: `κ ≥ 0`. The ends of the edges must be vertices.
///
/// # Errors
/// The first edge that cannot be split even with the normals of its faces, with the reason.
pub fn refine_edges(
    shape: &Oriented,
    edges: &[[u32; 2]],
    sides: impl Fn(usize) -> [f64; 3],
    balance: f64,
) -> Result<Oriented, (usize, EdgeFault)> {
    let mut refined = Oriented::with_capacity(shape.points.len() + edges.len());
    refined.points.extend_from_slice(&shape.points);
    refined.normals.extend_from_slice(&shape.normals);
    for (e, edge) in edges.iter().enumerate() {
        let [points, normals] = ends(shape, edge.map(|vertex| vertex as usize));
        let middle = middle(points, normals, balance, |u| cross(u, sides(e))).map_err(|fault| (e, fault))?;
        refined.push(middle.oriented());
    }
    Ok(refined)
}

/// Normals of a plane polygon: those of the circle through each point and its neighbours, to the right of the direction of travel.
///
/// ```text
/// τᵢ ∝ |eᵢ| êᵢ₋₁ + |eᵢ₋₁| êᵢ,   nᵢ = (τ_y, −τ_x, 0),   eᵢ = pᵢ₊₁ − pᵢ
/// ```
///
/// The normals point outwards on counter-clockwise polygons and inwards on clockwise ones; [`refine_polyline`] makes the same
/// points from both. Exact for points of a circle, evenly spaced or not. At an end of an open polygon, the circle goes through
/// the last three points; a single edge has the normal of its own direction. The plane is `z = 0`.
///
/// Zero where the normal is undefined: two of the three points coincide, or there are fewer than three.
pub fn circle_normals(points: &[[f64; 3]], closed: bool) -> Vec<[f64; 3]> {
    let count = points.len();
    let normal = |i: usize| {
        let [before, after] = match (closed, count) {
            (false, 2) => return right_of(minus(points[1], points[0]), 0.0),
            (_, 0..3) => return [0.0; 3],
            // Three points follow one another on their circle wherever one begins.
            (false, _) if i == 0 => [2, 1],
            (false, _) if i + 1 == count => [i - 1, i - 2],
            _ => [(i + count - 1) % count, (i + 1) % count],
        };
        right_of(circle_tangent(points[before], points[i], points[after]), CANCELLED)
    };
    (0..count).map(normal).collect()
}

/// Vertex normals of a mesh that are exact for meshes inscribed in a sphere; outwards if faces are counter-clockwise as seen
/// from outside.
///
/// ```text
/// Nᵢ ∝ Σ (a × b)/(|a|²|b|²),   a = pⱼ − pᵢ,   b = pₗ − pᵢ      over the faces (i, j, l) at i
/// ```
///
/// Zero where the normal is undefined: the vertex has no face, or its faces cancel. Corners of faces with an edge of length
/// zero at the vertex are ignored. The corners of faces must be vertices. Cost: one pass over the faces.
///
/// # Source
/// N. Max, *Weights for computing vertex normals from facet normals*.
pub fn sphere_normals(mesh: &TriangleMesh) -> Vec<[f64; 3]> {
    let mut sums = vec![([0.0; 3], 0.0); mesh.vertices.len()];
    for &[a, b, c] in &mesh.faces {
        for [i, j, l] in [[a, b, c], [b, c, a], [c, a, b]] {
            let [i, j, l] = [i, j, l].map(|vertex| vertex as usize);
            let from = |k: usize| inverse(minus(mesh.vertices[k], mesh.vertices[i]));
            let term = cross(from(j), from(l));
            let (sum, size) = &mut sums[i];
            *sum = plus(*sum, term);
            *size += norm(term);
        }
    }
    sums.into_iter().map(|(sum, size)| direction(sum, CANCELLED * size).unwrap_or_default()).collect()
}

/// The first vertex of a plane polygon whose normal lies on the other side of an edge than the majority of normals. `None` if
/// all lie on one side. Normals parallel to an edge, and edges of length zero, have no side.
///
/// If the side changes only at a vertex, from edge to edge, no edge fails, but the curve has a cusp there.
pub fn inconsistent(points: &[[f64; 3]], normals: &[[f64; 3]], closed: bool) -> Option<usize> {
    let count = points.len();
    let edges = if closed { count } else { count.saturating_sub(1) };
    let side = |i: usize, end: usize| {
        let e = minus(points[(i + 1) % count], points[i]);
        let sine = cross(e, normals[end])[2];
        if sine.abs() > ALONG * norm(e) { sine.signum() } else { 0.0 }
    };
    let sides: Vec<(usize, f64)> =
        (0..edges).flat_map(|i| [i, (i + 1) % count].map(|end| (end, side(i, end)))).collect();
    let surplus: f64 = sides.iter().map(|(_, side)| side).sum();
    // In a tie, the first normal decides.
    let first = || sides.iter().map(|(_, side)| *side).find(|side| *side != 0.0);
    let most = if surplus != 0.0 { surplus.signum() } else { first()? };
    sides.iter().find(|(_, side)| side * most < 0.0).map(|(end, _)| *end)
}

/// Result for the middle of an edge: `p`, `t` and `f`.
struct Middle {
    point: [f64; 3],
    tangent: [f64; 3],
    binormal: [f64; 3],
}

impl Middle {
    /// The new point and normal, `p` and `n`. Since `f` is orthogonal to `u`, `|f × t| ≥ t·u ≥ 1`.
    fn oriented(&self) -> ([f64; 3], [f64; 3]) {
        let normal = cross(self.binormal, self.tangent);
        let length = norm(normal);
        (self.point, normal.map(|x| x / length))
    }
}

/// Computes the middle of an edge. `fallback(u)` is a binormal for normals that define none; zero if there is none. Every sum
/// has two terms, so that swapping the ends gives the same bits.
fn middle(
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

/// Points and normals at the ends of an edge.
fn ends(shape: &Oriented, edge: [usize; 2]) -> [[[f64; 3]; 2]; 2] {
    [edge.map(|i| shape.points[i]), edge.map(|i| shape.normals[i])]
}

/// Tangent at `p` of the circle from `before` through `p` to `after`, of length at most 1.
fn circle_tangent(before: [f64; 3], p: [f64; 3], after: [f64; 3]) -> [f64; 3] {
    let (e, d) = (minus(p, before), minus(after, p));
    let (length, next) = (norm(e), norm(d));
    let part = |share: f64, along: [f64; 3]| scaled(share / (length + next), along);
    match (direction(e, 0.0), direction(d, 0.0)) {
        (Some(e), Some(d)) => plus(part(next, e), part(length, d)),
        _ => [0.0; 3],
    }
}

/// Unit normal to the right of a direction in the plane; zero if the direction is not longer than `least`.
fn right_of(tangent: [f64; 3], least: f64) -> [f64; 3] {
    direction([tangent[1], -tangent[0], 0.0], least).unwrap_or_default()
}

/// `v/|v|²`; zero for the zero vector.
fn inverse(v: [f64; 3]) -> [f64; 3] {
    let length = norm(v);
    direction(v, 0.0).map_or([0.0; 3], |unit| unit.map(|x| x / length))
}

/// `v/|v|` if `|v|` is finite and larger than `least`.
fn direction(v: [f64; 3], least: f64) -> Option<[f64; 3]> {
    let length = norm(v);
    (length > least && length.is_finite()).then(|| v.map(|x| x / length))
}

fn plus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

fn scaled(factor: f64, v: [f64; 3]) -> [f64; 3] {
    v.map(|x| factor * x)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;
    use std::f64::consts::TAU;

    use super::*;

    const EX: [f64; 3] = [1.0, 0.0, 0.0];
    const EY: [f64; 3] = [0.0, 1.0, 0.0];
    const EZ: [f64; 3] = [0.0, 0.0, 1.0];

    /// Deterministic numbers in `(−1, 1)`.
    struct Random(u64);

    impl Random {
        fn number(&mut self) -> f64 {
            self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (self.0 >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
        }

        fn vector(&mut self) -> [f64; 3] {
            [self.number(), self.number(), self.number()]
        }

        fn unit(&mut self) -> [f64; 3] {
            unit(self.vector())
        }
    }

    fn unit(v: [f64; 3]) -> [f64; 3] {
        direction(v, 0.0).unwrap()
    }

    fn negated(v: [f64; 3]) -> [f64; 3] {
        v.map(|x| -x)
    }

    /// Unit vector in the plane at an angle to the `x` axis.
    fn at_angle(angle: f64) -> [f64; 3] {
        [angle.cos(), angle.sin(), 0.0]
    }

    fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
        norm(minus(a, b))
    }

    fn close(found: [f64; 3], wanted: [f64; 3], tolerance: f64) {
        assert!(distance(found, wanted) <= tolerance, "{found:?}, wanted {wanted:?} to {tolerance:e}");
    }

    /// Largest distances of points from the unit sphere, and of normals from the radial ones.
    fn off_sphere(shape: &Oriented) -> (f64, f64) {
        let position = shape.points.iter().map(|p| (norm(*p) - 1.0).abs()).fold(0.0, f64::max);
        let pairs = shape.points.iter().zip(&shape.normals);
        (position, pairs.map(|(p, n)| distance(unit(*p), *n)).fold(0.0, f64::max))
    }

    /// Points of the unit sphere with radial normals.
    fn radial(points: Vec<[f64; 3]>) -> Oriented {
        Oriented::new(points.clone(), &points).unwrap()
    }

    fn octahedron() -> TriangleMesh {
        let faces =
            vec![[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]];
        let vertices = vec![EX, negated(EX), EY, negated(EY), EZ, negated(EZ)];
        TriangleMesh { vertices, normals: None, faces }
    }

    /// Edges in the order of their ends, and the four parts of every face.
    fn parts(faces: &[[u32; 3]], vertices: usize) -> (Vec<[u32; 2]>, Vec<[u32; 3]>) {
        let edge = |a: u32, b: u32| [a.min(b), a.max(b)];
        let all = faces.iter().flat_map(|&[a, b, c]| [edge(a, b), edge(b, c), edge(c, a)]);
        let mut numbers: BTreeMap<[u32; 2], u32> = all.map(|edge| (edge, 0)).collect();
        numbers.values_mut().zip(vertices as u32..).for_each(|(number, next)| *number = next);
        let split = |&[a, b, c]: &[u32; 3]| {
            let [ab, bc, ca] = [numbers[&edge(a, b)], numbers[&edge(b, c)], numbers[&edge(c, a)]];
            [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
        };
        let faces = faces.iter().flat_map(split).collect();
        (numbers.into_keys().collect(), faces)
    }

    fn refine_mesh(shape: &Oriented, faces: &mut Vec<[u32; 3]>, balance: f64) -> Oriented {
        let (edges, finer) = parts(faces, shape.points.len());
        *faces = finer;
        refine_edges(shape, &edges, |_| [0.0; 3], balance).unwrap()
    }

    /// A perturbed octahedron with normals that are not quite radial.
    fn irregular(random: &mut Random) -> Oriented {
        let vary = |p: [f64; 3], random: &mut Random| plus(p, scaled(0.3, random.vector()));
        let points: Vec<[f64; 3]> = octahedron().vertices.iter().map(|p| vary(*p, random)).collect();
        let normals: Vec<[f64; 3]> = points.iter().map(|p| vary(*p, random)).collect();
        Oriented::new(points, &normals).unwrap()
    }

    #[test]
    fn circles_stay_circles() {
        for (n, balance) in [(3, 0.0), (4, 0.0), (7, 0.3)] {
            let mut shape = radial((0..n).map(|i| at_angle(0.2 + TAU * i as f64 / n as f64)).collect());
            for level in 1..=10 {
                let finer = refine_polyline(&shape, true, balance).unwrap();
                assert_eq!(finer.points.len(), 2 * shape.points.len());
                assert!(finer.points.iter().step_by(2).eq(&shape.points));
                assert!(finer.normals.iter().step_by(2).eq(&shape.normals));
                shape = finer;
                let (position, normal) = off_sphere(&shape);
                assert!(position < 1e-15, "{n} points, level {level}: {position:e}");
                // The direction of an edge of length L is accurate to ε/L.
                let tolerance = 1e-15 * f64::from(1 << level);
                assert!(normal < tolerance, "{n} points, level {level}: {normal:e}");
            }
        }
    }

    #[test]
    fn spheres_stay_spheres() {
        let octahedron = octahedron();
        let (mut shape, mut faces) = (radial(octahedron.vertices), octahedron.faces);
        for level in 1..=6 {
            let finer = refine_mesh(&shape, &mut faces, 0.0);
            assert_eq!(finer.points.len(), 4_usize.pow(level + 1) + 2);
            assert_eq!(finer.points[..shape.points.len()], shape.points);
            assert_eq!(finer.normals[..shape.points.len()], shape.normals);
            shape = finer;
            let (position, normal) = off_sphere(&shape);
            assert!(position < 1e-15, "level {level}: {position:e}");
            assert!(normal < 1e-15 * f64::from(1 << level), "level {level}: {normal:e}");
        }
    }

    #[test]
    fn similarities_commute_with_steps() {
        let mut random = Random(1);
        for (scale, mirror) in [(1.0, 1.0), (1.0, -1.0), (37.0, 1.0), (37.0, -1.0), (0.01, -1.0)] {
            let a = random.unit();
            let b = unit(cross(a, random.unit()));
            let rows = [a, b, scaled(mirror, cross(a, b))];
            let shift = random.vector();
            let turned = |v: [f64; 3]| rows.map(|row| dot(row, v));
            let moved = |shape: &Oriented| Oriented {
                points: shape.points.iter().map(|p| plus(scaled(scale, turned(*p)), shift)).collect(),
                normals: shape.normals.iter().map(|n| turned(*n)).collect(),
            };
            let mut shape = irregular(&mut random);
            let (mut image, mut faces) = (moved(&shape), octahedron().faces);
            for _ in 0..3 {
                let mut same = faces.clone();
                image = refine_mesh(&image, &mut same, 0.1);
                shape = refine_mesh(&shape, &mut faces, 0.1);
            }
            let wanted = moved(&shape);
            // Coordinates are rounded to ε |shift|, which is ε |shift|/scale relative to the shape.
            let relative = 1e-13 * (1.0 + 1.0 / scale);
            for i in 0..wanted.points.len() {
                close(image.points[i], wanted.points[i], relative * scale);
                close(image.normals[i], wanted.normals[i], 30.0 * relative);
            }
        }
    }

    #[test]
    fn opposite_normals_make_the_same_points() {
        let mut random = Random(2);
        let shape = irregular(&mut random);
        let opposite = |shape: &Oriented| Oriented {
            points: shape.points.clone(),
            normals: shape.normals.iter().map(|n| negated(*n)).collect(),
        };
        let (mut faces, mut same) = (octahedron().faces, octahedron().faces);
        let flipped = refine_mesh(&opposite(&shape), &mut faces, 0.0);
        assert_eq!(flipped, opposite(&refine_mesh(&shape, &mut same, 0.0)));
    }

    #[test]
    fn the_way_along_an_edge_does_not_matter() {
        let mut random = Random(3);
        let reversed = |shape: &Oriented| Oriented {
            points: shape.points.iter().rev().copied().collect(),
            normals: shape.normals.iter().rev().copied().collect(),
        };
        let mut shape = irregular(&mut random);
        shape.points.truncate(5);
        shape.normals.truncate(5);
        let refined = refine_polyline(&shape, false, 0.2).unwrap();
        assert_eq!(refined.points.len(), 9);
        assert_eq!(refine_polyline(&reversed(&shape), false, 0.2).unwrap(), reversed(&refined));
        let (p0, p1) = (random.vector(), random.vector());
        let n = unit(minus(p1, p0));
        let there = split(p0, negated(n), p1, n, 0.0, Some(EZ)).unwrap();
        assert_eq!(split(p1, n, p0, negated(n), 0.0, Some(negated(EZ))), Ok(there));
    }

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
    fn convex_edges_make_convex_edges() {
        let mut random = Random(6);
        for _ in 0..100 {
            let [alpha, beta, _] = random.vector().map(|x| 0.75 * (1.0 + x) + 1e-3);
            let normals = leaning(alpha, beta).to_vec();
            let mut shape = Oriented { points: vec![[0.0; 3], [2.0, 0.0, 0.0]], normals };
            for _ in 0..6 {
                shape = refine_polyline(&shape, false, 0.0).unwrap();
            }
            for i in 1..shape.points.len() {
                let e = minus(shape.points[i], shape.points[i - 1]);
                let (before, after) = (dot(e, shape.normals[i - 1]), dot(e, shape.normals[i]));
                assert!(before < 1e-16 && after > -1e-16, "{alpha} {beta}: {before:e}, {after:e}");
            }
        }
    }

    #[test]
    fn edges_without_length_are_refused() {
        assert_eq!(split(EX, EY, EX, EY, 0.0, Some(EZ)), Err(EdgeFault::NoLength));
        assert_eq!(split(EX, EY, [f64::NAN; 3], EY, 0.0, Some(EZ)), Err(EdgeFault::NoLength));
        let shape = Oriented { points: vec![EX, EY, EY], normals: vec![EY; 3] };
        assert_eq!(refine_polyline(&shape, true, 0.0), Err((1, EdgeFault::NoLength)));
        let shape = Oriented { points: vec![EX], normals: vec![EY] };
        assert_eq!(refine_polyline(&shape, true, 0.0), Err((0, EdgeFault::NoLength)));
        assert_eq!(refine_polyline(&shape, false, 0.0).as_ref(), Ok(&shape));
        assert_eq!(refine_polyline(&Oriented::default(), true, 0.0), Ok(Oriented::default()));
        // Very short and very long edges are valid.
        let wanted = split([0.0; 3], EY, EX, EX, 0.0, None).unwrap().0;
        for size in [1e-160, 1e160] {
            let (p, n) = split([0.0; 3], EY, scaled(size, EX), EX, 0.0, None).unwrap();
            close(scaled(1.0 / size, p), wanted, 1e-15);
            assert!((norm(n) - 1.0).abs() < 1e-15);
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

    #[test]
    fn both_normals_along_the_edge_need_a_binormal() {
        let split = |binormal| split([0.0; 3], negated(EX), [2.0, 0.0, 0.0], EX, 0.0, binormal);
        assert_eq!(split(None), Err(EdgeFault::AlongBoth));
        assert_eq!(split(Some([5.0, 0.0, 0.0])), Err(EdgeFault::AlongBoth));
        assert_eq!(split(Some([0.0; 3])), Err(EdgeFault::AlongBoth));
        // The top of the half circle, whatever the component of the binormal along the edge.
        for binormal in [EZ, [7.0, 0.0, 1e-3], [0.0, 0.0, 1e-200]] {
            let (p, n) = split(Some(binormal)).unwrap();
            close(p, [1.0, 1.0, 0.0], 1e-15);
            close(n, EY, 1e-15);
        }
        let points = vec![[0.0; 3], [2.0, 0.0, 0.0]];
        let shape = Oriented { points, normals: vec![negated(EX), EX] };
        let up = refine_edges(&shape, &[[0, 1]], |_| scaled(1.4, EY), 0.0).unwrap();
        close(up.points[2], [1.0, 1.0, 0.0], 1e-15);
        close(up.normals[2], EY, 1e-15);
        let nothing = refine_edges(&shape, &[[0, 1]], |_| [1e-16; 3], 0.0);
        assert_eq!(nothing, Err((0, EdgeFault::AlongBoth)));
    }

    #[test]
    fn normals_on_opposite_sides_need_a_binormal() {
        let [n0, n1] = [at_angle(TAU / 3.0), negated(at_angle(TAU / 5.0))];
        let shape = Oriented { points: vec![[0.0; 3], [2.0, 0.0, 0.0]], normals: vec![n0, n1] };
        assert_eq!(refine_polyline(&shape, false, 0.0), Err((0, EdgeFault::Opposite)));
        // The faces decide: the normal is in the plane of the edge and their sum.
        let sides = [0.0, 0.6, 0.8];
        let refined = refine_edges(&shape, &[[0, 1]], |_| sides, 0.0).unwrap();
        let n = refined.normals[2];
        assert!(dot(n, sides) > 0.0 && dot(n, cross(EX, sides)).abs() < 1e-15, "{n:?}");
        let given = split([0.0; 3], n0, [2.0, 0.0, 0.0], n1, 0.0, Some(cross(EX, sides))).unwrap();
        close(given.0, refined.points[2], 1e-15);
        close(given.1, n, 1e-15);
    }

    #[test]
    fn normals_are_unit_vectors() {
        for wrong in [[0.0; 3], [0.0, 2.0, 0.0], [f64::NAN; 3], [f64::INFINITY, 0.0, 0.0]] {
            assert_eq!(split([0.0; 3], EY, EX, wrong, 0.0, Some(EZ)), Err(EdgeFault::NotUnit));
        }
        let points = vec![EX, EY, EZ];
        let made = Oriented::new(points.clone(), &[scaled(1e-200, EX), scaled(1e200, EY), EZ]).unwrap();
        assert_eq!(made, Oriented { points: points.clone(), normals: points.clone() });
        assert_eq!(Oriented::new(points.clone(), &[EX, [0.0; 3], EZ]), Err(1));
        assert_eq!(Oriented::new(points.clone(), &[EX, EY, [f64::NAN; 3]]), Err(2));
        assert_eq!(Oriented::new(points.clone(), &[EX, EY]), Err(2));
        assert_eq!(Oriented::new(points, &[EX; 4]), Err(3));
    }

    #[test]
    fn circle_normals_are_radial_on_circles() {
        let angles = [0.0, 0.4, 1.5, 2.0, 3.9, 5.0];
        let points: Vec<[f64; 3]> = angles.iter().map(|angle| at_angle(*angle)).collect();
        let reversed: Vec<[f64; 3]> = points.iter().rev().copied().collect();
        for closed in [true, false] {
            for (i, normal) in circle_normals(&points, closed).into_iter().enumerate() {
                close(normal, points[i], 1e-15);
            }
            // Clockwise: inwards.
            for (i, normal) in circle_normals(&reversed, closed).into_iter().enumerate() {
                close(normal, negated(reversed[i]), 1e-15);
            }
        }
        let mut shape = radial(points);
        for _ in 0..6 {
            shape = refine_polyline(&shape, true, 0.0).unwrap();
        }
        let (position, normal) = off_sphere(&shape);
        assert!(position < 2e-15 && normal < 1e-13, "{position:e} {normal:e}");
    }

    #[test]
    fn circle_normals_of_lines_are_theirs() {
        let line = [[0.0; 3], [1.0, 2.0, 0.0], [1.5, 3.0, 0.0], [4.0, 8.0, 0.0]];
        let wanted = unit([2.0, -1.0, 0.0]);
        for count in 2..=4 {
            circle_normals(&line[..count], false).iter().for_each(|normal| close(*normal, wanted, 1e-15));
        }
        assert_eq!(circle_normals(&line[..1], false), [[0.0; 3]]);
        assert_eq!(circle_normals(&line[..2], true), [[0.0; 3]; 2]);
        assert_eq!(circle_normals(&[], true), [[0.0; 3]; 0]);
        // Back along the same edge, and a repeated point.
        assert_eq!(circle_normals(&[line[0], line[1], line[0]], false)[1], [0.0; 3]);
        assert_eq!(circle_normals(&[line[0], line[1], line[1], line[2]], false)[1], [0.0; 3]);
    }

    #[test]
    fn sphere_normals_are_radial_on_spheres() {
        let mut random = Random(7);
        let mut mesh = octahedron();
        mesh.vertices = irregular(&mut random).points.into_iter().map(unit).collect();
        let centre = [3.0, -1.0, 2.0];
        for size in [1.0, 1e-100, 1e100] {
            let vertices = mesh.vertices.iter().map(|p| scaled(size, *p)).collect();
            let sized = TriangleMesh { vertices, ..mesh.clone() };
            for (normal, radius) in sphere_normals(&sized).into_iter().zip(&mesh.vertices) {
                close(normal, *radius, 1e-14);
            }
        }
        let vertices = mesh.vertices.iter().map(|p| plus(scaled(2.0, *p), centre)).collect();
        let mut elsewhere = TriangleMesh { vertices, ..mesh.clone() };
        // A vertex without faces, and a vertex of a face without area.
        elsewhere.vertices.push(centre);
        elsewhere.vertices.push(elsewhere.vertices[0]);
        elsewhere.faces.push([0, 7, 7]);
        let normals = sphere_normals(&elsewhere);
        (0..6).for_each(|i| close(normals[i], mesh.vertices[i], 1e-13));
        assert_eq!(normals[6..], [[0.0; 3]; 2]);
        let sheet = TriangleMesh {
            vertices: mesh.vertices[..3].to_vec(),
            faces: vec![[0, 1, 2], [0, 2, 1]],
            normals: None,
        };
        assert_eq!(sphere_normals(&sheet), [[0.0; 3]; 3]);
    }

    #[test]
    fn a_normal_on_the_other_side_is_found() {
        let points: Vec<[f64; 3]> = (0..6).map(|i| at_angle(TAU * f64::from(i) / 6.0)).collect();
        let mut normals = points.clone();
        assert_eq!(inconsistent(&points, &normals, true), None);
        for wrong in 0..6 {
            let mut normals = normals.clone();
            normals[wrong] = negated(normals[wrong]);
            assert_eq!(inconsistent(&points, &normals, true), Some(wrong));
            assert_eq!(inconsistent(&points, &normals, false), Some(wrong));
        }
        // More than the range of ±½(π − 60°) about the bisector.
        normals[2] = at_angle(TAU / 3.0 + 1.1);
        let shape = Oriented { points: points.clone(), normals: normals.clone() };
        assert_eq!(inconsistent(&points, &normals, true), Some(2));
        assert_eq!(refine_polyline(&shape, true, 0.0), Err((1, EdgeFault::Opposite)));
        // A cusp: the side changes at vertex 1, but no edge fails.
        let points = vec![[0.0; 3], EX, [0.2, 0.3, 0.0]];
        let cusp = Oriented::new(points, &[EY, EY, [0.3, 0.8, 0.0]]).unwrap();
        assert!(refine_polyline(&cusp, false, 0.0).is_ok());
        assert_eq!(inconsistent(&cusp.points, &cusp.normals, false), Some(1));
        // A normal parallel to an edge is on neither side.
        let points = [EX, EY];
        let along = [unit(minus(points[0], points[1])), points[1]];
        assert_eq!(inconsistent(&points[..2], &along, false), None);
        assert_eq!(inconsistent(&[], &[], true), None);
        // One on each side: the first decides.
        assert_eq!(inconsistent(&[[0.0; 3], EX], &[EY, negated(EY)], false), Some(1));
    }
}
