//! Cells inside closed meshes and polygons, by the winding number.

use super::grid::{Grid, Mask};
use crate::mesh::TriangleMesh;

/// Cells about whose centres a closed mesh winds: the winding number, summed along rays of the third axis, is not zero.
///
/// The corners of the faces must be vertices ([`TriangleMesh::check_faces`]). All faces may be turned round, but faces of
/// neighbours must fit ([`TriangleMesh::connectivity`]). If the mesh is not closed, the cells beyond a hole, as seen along the
/// ray, are misclassified.
///
/// Every face marks the cells where rays enter (+1) or leave (−1) through it; the winding number is the sum of the marks along
/// the ray. A ray meets the projection of a face between two of its edges, and the direction in which the edges run says whether
/// it enters. Each edge gives the same crossing to both of its faces, bit for bit, so rounding can neither open a gap nor count
/// an edge twice: on a closed mesh, the sum of the marks on a ray is always zero.
///
/// Cost `O(F log F + rows met by the F faces + crossings + cells)`. Memory: besides the mask 4 bytes per cell of one layer
/// across the first axis and 24 bytes per face.
pub fn from_mesh(mesh: &TriangleMesh, grid: &Grid) -> Mask {
    let [xs, ys, zs] = [0, 1, 2].map(|axis| grid.centres(axis));
    let mut inside = vec![false; grid.count()];
    let corners = |face: u32| mesh.faces[face as usize].map(|vertex| mesh.vertices[vertex as usize]);
    let layers_of = |face: u32| {
        let [from, to] = extent(corners(face).map(|corner| corner[0]));
        (reached(&xs, from), reached(&xs, to), face)
    };
    // The faces that meet a layer, as first layer, layer after the last one, and face.
    let mut coming: Vec<(usize, usize, u32)> =
        (0..mesh.faces.len() as u32).map(layers_of).filter(|(from, to, _)| from < to).collect();
    coming.sort_unstable_by_key(|(from, ..)| std::cmp::Reverse(*from));
    let mut met: Vec<(usize, u32)> = Vec::new();
    let mut turns = vec![0; ys.len() * zs.len()];
    for (i, layer) in inside.chunks_mut(turns.len().max(1)).enumerate() {
        met.retain(|(to, _)| *to > i);
        met.extend(std::iter::from_fn(|| coming.pop_if(|(from, ..)| *from <= i)).map(|(_, to, f)| (to, f)));
        turns.fill(0);
        for (_, face) in &met {
            mark(corners(*face), xs[i], [&ys, &zs], &mut turns);
        }
        accumulate(&turns, layer, zs.len());
    }
    Mask { grid: *grid, inside }
}

/// Marks the cells of the layer at `x` where rays along the third axis enter or leave through a triangle.
fn mark(corners: [[f64; 3]; 3], x: f64, [ys, zs]: [&[f64]; 2], turns: &mut [i32]) {
    let Some(([p, q], turn)) = chord(corners, x) else { return };
    for j in reached(ys, p[1])..reached(ys, q[1]) {
        let z = between(p[2], q[2], (ys[j] - p[1]) / (q[1] - p[1]));
        let k = reached(zs, z);
        if k < zs.len() {
            turns[j * zs.len() + k] += turn;
        }
    }
}

/// Cells in the plane about whose centres closed polygons wind: the sum of their winding numbers is not zero. The last point of
/// a polygon is joined to its first.
///
/// Outlines that overlap are united if they run in the same direction. A hole runs in the direction opposite to that of the
/// outline around it.
///
/// `grid` has one layer. Cost `O(edges + crossings + cells)`. Memory: besides the mask four bytes per cell.
pub fn from_contours(polygons: &[Vec<[f64; 2]>], grid: &Grid) -> Mask {
    debug_assert!(grid.is_planar(), "{grid:?}");
    let [xs, ys] = [0, 1].map(|axis| grid.centres(axis));
    let mut inside = vec![false; grid.count()];
    let mut turns = vec![0; xs.len() * ys.len()];
    let edges = polygons.iter().flat_map(|polygon| polygon.iter().zip(polygon.iter().cycle().skip(1)));
    for (a, b) in edges {
        let turn = if a[0] < b[0] { 1 } else { -1 };
        let rows = reached(&xs, a[0].min(b[0]))..reached(&xs, a[0].max(b[0]));
        for (i, [_, y]) in rows.filter_map(|i| Some((i, cut(*a, *b, xs[i])?))) {
            let j = reached(&ys, y);
            if j < ys.len() {
                turns[i * ys.len() + j] += turn;
            }
        }
    }
    accumulate(&turns, &mut inside, ys.len());
    Mask { grid: *grid, inside }
}

/// Minimum and maximum of three numbers.
fn extent([a, b, c]: [f64; 3]) -> [f64; 2] {
    [a.min(b).min(c), a.max(b).max(c)]
}

/// Position of the first centre that is not less than `value`; the number of centres if all are. It compares with the
/// centres themselves, so the result does not depend on the rounding or overflow of a quotient.
pub(super) fn reached(centres: &[f64], value: f64) -> usize {
    centres.partition_point(|centre| *centre < value)
}

/// `a + (b − a) t`.
pub(super) fn between(a: f64, b: f64, t: f64) -> f64 {
    a + (b - a) * t
}

/// Point of an edge with first coordinate `x`; the lower end is included, the upper end is not. The edge always runs from its
/// lower to its upper end, so both of its faces get the same bits.
fn cut<const D: usize>(a: [f64; D], b: [f64; D], x: f64) -> Option<[f64; D]> {
    let (a, b) = if a[0] <= b[0] { (a, b) } else { (b, a) };
    let t = (x - a[0]) / (b[0] - a[0]);
    (a[0] <= x && x < b[0]).then(|| std::array::from_fn(|axis| between(a[axis], b[axis], t)))
}

/// Segment in which a triangle meets the plane of first coordinate `x`, ordered by the second coordinate, and −1 if the triangle
/// runs counter-clockwise in the plane of the first two coordinates, so that rays leave there, else 1. With half-open edges, two
/// edges are cut, one running up and one down, or none.
fn chord([a, b, c]: [[f64; 3]; 3], x: f64) -> Option<([[f64; 3]; 2], i32)> {
    let edges = [(a, b), (b, c), (c, a)].into_iter();
    let mut cuts = edges.filter_map(|(from, to)| Some((cut(from, to, x)?, from[0] < to[0])));
    let ((p, p_runs_up), (q, _)) = (cuts.next()?, cuts.next()?);
    let turn = if p_runs_up == (p[1] <= q[1]) { -1 } else { 1 };
    Some((if p[1] <= q[1] { [p, q] } else { [q, p] }, turn))
}

/// Where the running sums along rays of `length` cells are not zero.
pub(super) fn accumulate(turns: &[i32], inside: &mut [bool], length: usize) {
    for (ray, turns) in inside.chunks_mut(length.max(1)).zip(turns.chunks(length.max(1))) {
        let mut winding = 0;
        for (cell, turn) in ray.iter_mut().zip(turns) {
            winding += turn;
            *cell = winding != 0;
        }
    }
}
