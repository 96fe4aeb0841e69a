//! Steps of the scheme on polylines and on the edges of meshes.

use super::Oriented;
use super::edge::{corner, middle};
use crate::edge_fault::EdgeFault;
use crate::vector::cross;

/// One step on a polyline: point `2i` is the old point `i`, and `2i + 1` is the new one between `i` and `i + 1`. The last edge
/// of a closed polyline ends at 0. `n` points become `2n`, or `2n − 1` if open. `balance`: `κ ≥ 0`.
///
/// `binormals(i)`: binormal `f` of edge `i`, of any length, called where the normals at its ends define none; zero if there is none.
///
/// # Errors
/// The first edge that cannot be split, with the reason.
pub fn refine_polyline(
    shape: &Oriented,
    closed: bool,
    balance: f64,
    binormals: impl Fn(usize) -> [f64; 3],
) -> Result<Oriented, (usize, EdgeFault)> {
    let count = shape.points.len();
    let edges = if closed { count } else { count.saturating_sub(1) };
    let mut refined = Oriented::with_capacity(count + edges);
    for i in 0..count {
        refined.push((shape.points[i], shape.normals[i]));
        if i < edges {
            let [points, normals] = ends(shape, [i, (i + 1) % count]);
            let middle = middle(points, normals, balance, |_| binormals(i)).map_err(|fault| (i, fault))?;
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

/// The corners that edges make: the number of edges with one, and the first with its angle in radians: see [`corner`].
pub fn corners(
    shape: &Oriented,
    edges: impl Iterator<Item = [usize; 2]>,
    balance: f64,
) -> Option<(usize, usize, f64)> {
    let mut found: Option<(usize, usize, f64)> = None;
    for edge in edges {
        let [points, normals] = ends(shape, edge);
        if let Some((end, angle)) = corner(points, normals, balance) {
            found = Some(found.map_or((1, edge[end], angle), |(count, at, first)| (count + 1, at, first)));
        }
    }
    found
}

/// Points and normals at the ends of an edge.
fn ends(shape: &Oriented, edge: [usize; 2]) -> [[[f64; 3]; 2]; 2] {
    [edge.map(|i| shape.points[i]), edge.map(|i| shape.normals[i])]
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;
    use std::f64::consts::TAU;

    use super::super::edge::split;
    use super::super::samples::{
        EX, EY, EZ, Random, at_angle, close, irregular, negated, octahedron, off_sphere, radial, unit,
    };
    use super::*;
    use crate::vector::{dot, minus, norm, plus, scaled};

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

    #[test]
    fn circles_stay_circles() {
        for (n, balance) in [(3, 0.0), (4, 0.0), (7, 0.3)] {
            let mut shape = radial((0..n).map(|i| at_angle(0.2 + TAU * i as f64 / n as f64)).collect());
            for level in 1..=10 {
                let finer = refine_polyline(&shape, true, balance, |_| [0.0; 3]).unwrap();
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
        let refined = refine_polyline(&shape, false, 0.2, |_| [0.0; 3]).unwrap();
        assert_eq!(refined.points.len(), 9);
        assert_eq!(refine_polyline(&reversed(&shape), false, 0.2, |_| [0.0; 3]).unwrap(), reversed(&refined));
        let (p0, p1) = (random.vector(), random.vector());
        let n = unit(minus(p1, p0));
        let there = split(p0, negated(n), p1, n, 0.0, Some(EZ)).unwrap();
        assert_eq!(split(p1, n, p0, negated(n), 0.0, Some(negated(EZ))), Ok(there));
    }

    #[test]
    fn convex_edges_make_convex_edges() {
        let mut random = Random(6);
        for _ in 0..100 {
            let [alpha, beta, _] = random.vector().map(|x| 0.75 * (1.0 + x) + 1e-3);
            let normals = vec![at_angle(TAU / 4.0 + alpha), at_angle(TAU / 4.0 - beta)];
            let mut shape = Oriented { points: vec![[0.0; 3], [2.0, 0.0, 0.0]], normals };
            for _ in 0..6 {
                shape = refine_polyline(&shape, false, 0.0, |_| [0.0; 3]).unwrap();
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
        assert_eq!(refine_polyline(&shape, true, 0.0, |_| [0.0; 3]), Err((1, EdgeFault::NoLength)));
        let shape = Oriented { points: vec![EX], normals: vec![EY] };
        assert_eq!(refine_polyline(&shape, true, 0.0, |_| [0.0; 3]), Err((0, EdgeFault::NoLength)));
        assert_eq!(refine_polyline(&shape, false, 0.0, |_| [0.0; 3]).as_ref(), Ok(&shape));
        assert_eq!(refine_polyline(&Oriented::default(), true, 0.0, |_| [0.0; 3]), Ok(Oriented::default()));
        // Very short and very long edges are valid.
        let wanted = split([0.0; 3], EY, EX, EX, 0.0, None).unwrap().0;
        for size in [1e-160, 1e160] {
            let (p, n) = split([0.0; 3], EY, scaled(size, EX), EX, 0.0, None).unwrap();
            close(scaled(1.0 / size, p), wanted, 1e-15);
            assert!((norm(n) - 1.0).abs() < 1e-15);
        }
    }

    #[test]
    fn two_points_with_binormals_make_a_circle() {
        // 2.2 of the source needs a binormal for two points: both normals are along both edges.
        let points = vec![negated(EX), EX];
        let mut shape = radial(points);
        let fault = refine_polyline(&shape, true, 0.0, |_| [0.0; 3]);
        assert_eq!(fault, Err((0, EdgeFault::AlongBoth)));
        // Counter-clockwise about z; the binormals of the parts are those of the halves, and no longer needed.
        for level in 1..=8 {
            shape = refine_polyline(&shape, true, 0.0, |_| scaled(-3.0, EZ)).unwrap();
            let (position, normal) = off_sphere(&shape);
            assert!(position < 1e-15 && normal < 1e-13, "level {level}: {position:e} {normal:e}");
        }
        assert!(shape.points[128 / 2][1] < 0.0 && shape.points.len() == 512);
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
        assert_eq!(refine_polyline(&shape, false, 0.0, |_| [0.0; 3]), Err((0, EdgeFault::Opposite)));
        // The faces decide: the normal is in the plane of the edge and their sum.
        let sides = [0.0, 0.6, 0.8];
        let refined = refine_edges(&shape, &[[0, 1]], |_| sides, 0.0).unwrap();
        let n = refined.normals[2];
        assert!(dot(n, sides) > 0.0 && dot(n, cross(EX, sides)).abs() < 1e-15, "{n:?}");
        let given = split([0.0; 3], n0, [2.0, 0.0, 0.0], n1, 0.0, Some(cross(EX, sides))).unwrap();
        close(given.0, refined.points[2], 1e-15);
        close(given.1, n, 1e-15);
    }
}
