//! Normals of polygons and meshes: default ones, and their sides.

use super::direction;
use super::edge::ALONG;
use crate::mesh::TriangleMesh;
use crate::vector::{cross, minus, norm, plus, scaled};

/// Relative size, compared with its terms, up to which the sum for a default normal is zero.
const CANCELLED: f64 = 1e-12;

/// Normals of a plane polygon: those of the circle through each point and its neighbours, to the right of the direction of travel.
///
/// ```text
/// τᵢ ∝ |eᵢ| êᵢ₋₁ + |eᵢ₋₁| êᵢ,   nᵢ = (τ_y, −τ_x, 0),   eᵢ = pᵢ₊₁ − pᵢ
/// ```
///
/// The normals point outwards on counter-clockwise polygons and inwards on clockwise ones;
/// [`refine_polyline`](super::refine_polyline) makes the same points from both. Exact for points of a circle, evenly spaced or not. At an end of an open polygon, the circle goes through
/// the last three points; a single edge has the normal of its direction. The plane is `z = 0`.
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

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::super::samples::radial;
    use super::super::samples::{
        EX, EY, Random, at_angle, close, irregular, negated, octahedron, off_sphere, unit,
    };
    use super::super::{Oriented, refine_polyline};
    use super::*;
    use crate::edge_fault::EdgeFault;

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
            shape = refine_polyline(&shape, true, 0.0, |_| [0.0; 3]).unwrap();
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
        assert_eq!(refine_polyline(&shape, true, 0.0, |_| [0.0; 3]), Err((1, EdgeFault::Opposite)));
        // A cusp: the side changes at vertex 1, but no edge fails.
        let points = vec![[0.0; 3], EX, [0.2, 0.3, 0.0]];
        let cusp = Oriented::new(points, &[EY, EY, [0.3, 0.8, 0.0]]).unwrap();
        assert!(refine_polyline(&cusp, false, 0.0, |_| [0.0; 3]).is_ok());
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
