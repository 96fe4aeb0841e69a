//! Tests of masks: their helpers.

use std::f64::consts::PI;

use super::*;
use crate::mesh::TriangleMesh;
use crate::vector::{bounds, cross, dot, minus, norm};

mod contours;
mod distances;
mod meshes;

/// Deterministic uniform numbers in [0, 1) (splitmix64).
fn uniform(state: &mut u64) -> f64 {
    *state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let z = (*state ^ (*state >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
}

fn mesh(vertices: Vec<[f64; 3]>, faces: Vec<[u32; 3]>) -> TriangleMesh {
    TriangleMesh { vertices, normals: None, faces }
}

/// A box; `flip` selects the other diagonals of its sides.
fn cuboid(lower: [f64; 3], upper: [f64; 3], flip: bool) -> TriangleMesh {
    let corner = |v: usize| [0, 1, 2].map(|axis| if v >> axis & 1 == 0 { lower[axis] } else { upper[axis] });
    let sides = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    let halves = |[a, b, c, d]: [u32; 4]| {
        if flip { [[b, c, d], [b, d, a]] } else { [[a, b, c], [a, c, d]] }
    };
    mesh((0..8).map(corner).collect(), sides.into_iter().flat_map(halves).collect())
}

/// A grid of `rows × columns` quadrilaterals that closes in both directions.
fn torus(rows: u32, columns: u32, point: impl Fn(f64, f64) -> [f64; 3]) -> TriangleMesh {
    let angle = |i: u32, n: u32| 2.0 * PI * f64::from(i) / f64::from(n);
    let cells = (0..rows).flat_map(|i| (0..columns).map(move |j| (i, j)));
    let vertex = |i: u32, j: u32| i % rows * columns + j % columns;
    let halves = |(i, j): (u32, u32)| {
        let [a, b, c, d] = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)].map(|(i, j)| vertex(i, j));
        [[a, b, c], [a, c, d]]
    };
    mesh(
        cells.clone().map(|(i, j)| point(angle(i, rows), angle(j, columns))).collect(),
        cells.flat_map(halves).collect(),
    )
}

/// A sphere of meridians and parallels; the faces at the poles have two corners in one place.
fn sphere(count: u32, radius: f64, centre: [f64; 3]) -> TriangleMesh {
    let ring = 2 * count;
    let point = |i: u32, j: u32| {
        let (s, t) = (PI * f64::from(i) / f64::from(count), PI * f64::from(j) / f64::from(count));
        let unit = [s.sin() * t.cos(), s.sin() * t.sin(), s.cos()];
        [0, 1, 2].map(|axis| centre[axis] + radius * unit[axis])
    };
    let vertex = |i: u32, j: u32| i * ring + j % ring;
    let cells = (0..count).flat_map(|i| (0..ring).map(move |j| (i, j)));
    let halves = |(i, j): (u32, u32)| {
        let [a, b, c, d] = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)].map(|(i, j)| vertex(i, j));
        [[a, b, c], [a, c, d]]
    };
    let rows = (0..=count).flat_map(|i| (0..ring).map(move |j| (i, j)));
    mesh(rows.map(|(i, j)| point(i, j)).collect(), cells.flat_map(halves).collect())
}

/// Winding number of a closed mesh about a point: the sum of the solid angles, van Oosterom and Strackee 1983.
fn winding(mesh: &TriangleMesh, point: [f64; 3]) -> f64 {
    let angle = |face: &[u32; 3]| {
        let [a, b, c] = face.map(|vertex| minus(mesh.vertices[vertex as usize], point));
        let (x, y, z) = (norm(a), norm(b), norm(c));
        let below = x * y * z + dot(a, b) * z + dot(b, c) * x + dot(c, a) * y;
        2.0 * dot(a, cross(b, c)).atan2(below)
    };
    mesh.faces.iter().map(angle).sum::<f64>() / (4.0 * PI)
}

fn centre(grid: &Grid, at: usize) -> [f64; 3] {
    let [_, columns, length] = grid.size;
    let cell = [at / length / columns, at / length % columns, at % length];
    [0, 1, 2].map(|axis| grid.first[axis] + grid.spacing[axis] * cell[axis] as f64)
}
