//! Rasterisation of shapes to grid cells, and overlap measures of two rasterised shapes.
//!
//! ```text
//! Jaccard  J = |A ∩ B| / |A ∪ B|          Dice  2 |A ∩ B| / (|A| + |B|)
//! Hausdorff  max(max_{a ∈ ∂A} d(a, ∂B), max_{b ∈ ∂B} d(b, ∂A))
//! ```
//!
//! A cell belongs to a mesh if its centre is inside by the even-odd rule: the parity of the crossings on a ray. On meshes
//! that cross themselves this differs from the winding number: regions enclosed twice are outside. A cell belongs to a
//! contour if the winding number about its centre is not zero, so that a contour walked twice is itself; several contours
//! are combined by the even-odd rule, so that a contour within another bounds a hole.
//!
//! # Ties
//! Every comparison is half-open, `lower ≤ centre < upper` in each coordinate. If shapes tile space or the plane, each
//! centre therefore belongs to exactly one of them, even on common faces, edges and vertices. Common sides that lie across
//! an axis may be cut into different triangles; oblique ones must have the same triangles.

use rayon::prelude::*;

use super::mesh::TriangleMesh;
use shapelex_numeric::bounded::{Stop, never};

/// A regular grid of pixel or voxel centres `first + spacing · (i, j, k)`.
///
/// A grid of one layer, `size[2] == 1`, lies in the plane. Its third coordinate is ignored, and its third spacing is
/// 1, so that the product of the spacings is an area.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Grid {
    /// The first centre.
    pub first: [f64; 3],
    /// Distances between neighbouring centres along the axes; positive.
    pub spacing: [f64; 3],
    /// Number of centres along each axis.
    pub size: [usize; 3],
}

/// The grid cells that belong to a shape.
#[derive(Debug, Clone, PartialEq)]
pub struct Mask {
    /// The grid.
    pub grid: Grid,
    /// For every cell, whether it belongs to the shape; the last axis is the fastest.
    pub inside: Vec<bool>,
}

/// Overlap of two masks, and distances between their surfaces.
///
/// The surface of a mask consists of its cells with a neighbour across a face (in the plane, across an edge) that is outside
/// of the mask or beyond the grid. Distances are between centres, in the unit of the spacing; `None` if a mask is empty.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Overlap {
    /// Number of cells in each mask.
    pub cells: [usize; 2],
    /// Number of cells in both masks.
    pub intersection: usize,
    /// Number of cells in at least one mask.
    pub union: usize,
    /// `|A ∩ B| / |A ∪ B|`; 1 if both are empty.
    pub jaccard: f64,
    /// `2 |A ∩ B| / (|A| + |B|)`; 1 if both are empty.
    pub dice: f64,
    /// Largest distance from one surface to the other, over both directions.
    pub hausdorff: Option<f64>,
    /// The larger one of the 95th percentiles of the distances in both directions, with linear interpolation.
    pub hausdorff_95: Option<f64>,
    /// Mean of the distances in both directions together.
    pub mean_surface_distance: Option<f64>,
}

/// Fraction of a cell by which a box may exceed a whole number of cells without getting another cell: the quotient of a
/// length and a fraction of itself is rounded twice.
const WHOLE: f64 = 1e-9;

/// Maximum number of minima on a line that are searched one by one. Most lines meet a surface twice; skipping their
/// envelopes reduces the time for the overlap of two balls to three quarters.
const FEW: usize = 4;

/// Bounding box of points, lower and upper corner; `None` without points.
pub fn bounds<const D: usize>(points: impl IntoIterator<Item = [f64; D]>) -> Option<[[f64; D]; 2]> {
    points.into_iter().map(|point| [point; 2]).reduce(|[lower, upper], [point, _]| {
        [
            std::array::from_fn(|axis| lower[axis].min(point[axis])),
            std::array::from_fn(|axis| upper[axis].max(point[axis])),
        ]
    })
}

impl Grid {
    /// The grid of a given spacing that covers a box and one more cell on every side. Its centre is that of the box, so it
    /// depends on the box and the spacing alone. `D` is 2 or 3.
    ///
    /// Sizes saturate; check [`Grid::count`] before making a mask.
    pub fn around<const D: usize>([lower, upper]: [[f64; D]; 2], spacing: [f64; D]) -> Self {
        const { assert!(D == 2 || D == 3) };
        let mut grid = Self { first: [0.0; 3], spacing: [1.0; 3], size: [1; 3] };
        for axis in 0..D {
            let cells = (upper[axis] - lower[axis]) / spacing[axis];
            let cells = (cells - WHOLE).ceil().max(1.0);
            let middle = 0.5 * lower[axis] + 0.5 * upper[axis];
            grid.first[axis] = middle - 0.5 * spacing[axis] * (cells + 1.0);
            grid.spacing[axis] = spacing[axis];
            grid.size[axis] = (cells as usize).saturating_add(2);
        }
        grid
    }

    /// The grid of square or cubic cells around a box, as in [`Grid::around`], with `cells` along the longest side of the
    /// box. For a box of one point, cells have size 1.
    pub fn with_cells<const D: usize>([lower, upper]: [[f64; D]; 2], cells: usize) -> Self {
        let longest = (0..D).map(|axis| upper[axis] - lower[axis]).fold(0.0, f64::max);
        let spacing = if longest > 0.0 { longest / cells.max(1) as f64 } else { 1.0 };
        Self::around([lower, upper], [spacing; D])
    }

    /// Number of cells; saturates at `usize::MAX`.
    pub fn count(&self) -> usize {
        self.size.iter().fold(1, |count, size| count.saturating_mul(*size))
    }

    /// Volume of a cell; area in the plane.
    pub fn cell_measure(&self) -> f64 {
        self.spacing.iter().product()
    }

    /// Whether the grid has one layer.
    pub fn is_planar(&self) -> bool {
        self.size[2] == 1
    }

    /// Coordinates of the centres along an axis, increasing.
    pub fn centres(&self, axis: usize) -> Vec<f64> {
        (0..self.size[axis]).map(|i| self.first[axis] + self.spacing[axis] * i as f64).collect()
    }

    fn index(&self, [i, j, k]: [usize; 3]) -> usize {
        (i * self.size[1] + j) * self.size[2] + k
    }
}

impl Mask {
    /// Number of cells in the mask.
    pub fn count(&self) -> usize {
        self.inside.iter().filter(|inside| **inside).count()
    }

    /// Volume of the mask; area in the plane.
    pub fn measure(&self) -> f64 {
        self.count() as f64 * self.grid.cell_measure()
    }

    /// Whether a cell of the mask has a neighbour outside of the mask.
    fn is_surface(&self, cell: [usize; 3]) -> bool {
        let size = self.grid.size;
        let strides = [size[1] * size[2], size[2], 1];
        let axes = if self.grid.is_planar() { 2 } else { 3 };
        let at = self.grid.index(cell);
        self.inside[at]
            && (0..axes).any(|axis| {
                let border = cell[axis] == 0 || cell[axis] + 1 == size[axis];
                border || !self.inside[at - strides[axis]] || !self.inside[at + strides[axis]]
            })
    }
}

/// Cells with centres inside a closed mesh, by the even-odd rule on rays along the third axis.
///
/// The corners of the faces must be vertices ([`TriangleMesh::check_faces`]); the orientation of the faces does not
/// matter. If the mesh is not closed, the cells beyond a hole, as seen along the ray, are misclassified.
///
/// Every face marks the cells where rays enter or leave through it, and the result is the sum of the marks modulo 2
/// along the rays. A ray meets the projection of a face between two of its edges. Each edge gives the same crossing to
/// both of its faces, bit for bit, so rounding can neither open a gap nor count an edge twice: on a closed mesh, the
/// number of marks on a ray is always even.
///
/// Cost `O(faces + rows met by the faces + crossings + cells)`.
pub fn from_mesh(mesh: &TriangleMesh, grid: &Grid) -> Mask {
    let [xs, ys, zs] = [0, 1, 2].map(|axis| grid.centres(axis));
    let mut inside = vec![false; grid.count()];
    for face in &mesh.faces {
        let corners = face.map(|vertex| mesh.vertices[vertex as usize]);
        let [from, to] = extent(corners.map(|corner| corner[0]));
        for i in reached(&xs, from)..reached(&xs, to) {
            let Some([p, q]) = chord(corners, xs[i]) else { continue };
            for j in reached(&ys, p[1])..reached(&ys, q[1]) {
                let z = between(p[2], q[2], (ys[j] - p[1]) / (q[1] - p[1]));
                let k = reached(&zs, z);
                if k < zs.len() {
                    inside[grid.index([i, j, k])] ^= true;
                }
            }
        }
    }
    accumulate(&mut inside, zs.len());
    Mask { grid: *grid, inside }
}

/// Cells with centres inside closed polygons in the plane: inside one polygon, the winding number is not zero; inside all of
/// them, the number of polygons about the centre is odd, so that a contour within another bounds a hole. The last point of a
/// polygon is joined to its first.
///
/// `grid` has one layer. Cost `O(edges + crossings + cells)`, and four bytes per cell of the rows of a polygon.
pub fn from_contours(polygons: &[Vec<[f64; 2]>], grid: &Grid) -> Mask {
    debug_assert!(grid.is_planar(), "{grid:?}");
    let [xs, ys] = [0, 1].map(|axis| grid.centres(axis));
    let mut inside = vec![false; grid.count()];
    for polygon in polygons {
        let first = polygon.iter().map(|point| reached(&xs, point[0])).min().unwrap_or(0);
        let turns = windings(polygon, &xs[first..], &ys);
        let rows = inside[first * ys.len()..].chunks_mut(ys.len().max(1));
        for (row, turns) in rows.zip(turns.chunks(ys.len().max(1))) {
            let mut winding = 0;
            for (cell, turn) in row.iter_mut().zip(turns) {
                winding += turn;
                *cell ^= winding != 0;
            }
        }
    }
    Mask { grid: *grid, inside }
}

/// Changes of the winding number of a polygon along the rows `xs`, up to the last row that it crosses: the number of its
/// edges between a centre and the one before, counted by direction.
fn windings(polygon: &[[f64; 2]], xs: &[f64], ys: &[f64]) -> Vec<i32> {
    let rows = polygon.iter().map(|point| reached(xs, point[0])).max().unwrap_or(0);
    let mut turns = vec![0; rows * ys.len()];
    let next = polygon.iter().cycle().skip(1);
    for (a, b) in polygon.iter().zip(next) {
        let turn = if a[0] < b[0] { 1 } else { -1 };
        let rows = reached(xs, a[0].min(b[0]))..reached(xs, a[0].max(b[0]));
        for (i, [_, y]) in rows.filter_map(|i| Some((i, cut(*a, *b, xs[i])?))) {
            let j = reached(ys, y);
            if j < ys.len() {
                turns[i * ys.len() + j] += turn;
            }
        }
    }
    turns
}

/// Minimum and maximum of three numbers.
fn extent([a, b, c]: [f64; 3]) -> [f64; 2] {
    [a.min(b).min(c), a.max(b).max(c)]
}

/// Position of the first centre that is not less than `value`; the number of centres if all are. It compares with the
/// centres themselves, so the result does not depend on the rounding or overflow of a quotient.
fn reached(centres: &[f64], value: f64) -> usize {
    centres.partition_point(|centre| *centre < value)
}

/// `a + (b − a) t`.
fn between(a: f64, b: f64, t: f64) -> f64 {
    a + (b - a) * t
}

/// Point of an edge with first coordinate `x`; the lower end is included, the upper end is not. The edge always runs from its
/// lower to its upper end, so both of its faces get the same bits.
fn cut<const D: usize>(a: [f64; D], b: [f64; D], x: f64) -> Option<[f64; D]> {
    let (a, b) = if a[0] <= b[0] { (a, b) } else { (b, a) };
    let t = (x - a[0]) / (b[0] - a[0]);
    (a[0] <= x && x < b[0]).then(|| std::array::from_fn(|axis| between(a[axis], b[axis], t)))
}

/// Segment in which a triangle meets the plane of first coordinate `x`, ordered by the second coordinate. With half-open
/// edges, either two edges are cut or none.
fn chord([a, b, c]: [[f64; 3]; 3], x: f64) -> Option<[[f64; 3]; 2]> {
    let mut cuts = [(a, b), (b, c), (c, a)].into_iter().filter_map(|(from, to)| cut(from, to, x));
    let (p, q) = (cuts.next()?, cuts.next()?);
    Some(if p[1] <= q[1] { [p, q] } else { [q, p] })
}

/// Running sums modulo 2 along rays of `length` cells.
fn accumulate(marks: &mut [bool], length: usize) {
    for ray in marks.chunks_mut(length.max(1)) {
        let mut parity = false;
        for cell in ray {
            parity ^= *cell;
            *cell = parity;
        }
    }
}

/// Overlap of two masks of one grid.
///
/// Distances come from an exact distance transform of each surface, read at the cells of the other, within the
/// bounding box of both masks. Cost `O(cells)`, and 10 bytes per cell of that box. The result does not depend on the
/// number of threads.
pub fn overlap(a: &Mask, b: &Mask) -> Overlap {
    compared(a, b, &never)
}

/// As [`overlap`], with cancellation: `stop` is checked at every line of cells.
pub fn overlap_unless_stopped(a: &Mask, b: &Mask, stop: Stop<'_>) -> Option<Overlap> {
    let overlap = compared(a, b, stop);
    (!stop()).then_some(overlap)
}

fn compared(a: &Mask, b: &Mask, stop: Stop<'_>) -> Overlap {
    debug_assert_eq!(a.grid, b.grid);
    let cells = [a.count(), b.count()];
    let intersection = a.inside.iter().zip(&b.inside).filter(|(a, b)| **a && **b).count();
    let union = cells[0] + cells[1] - intersection;
    let ratio = |part: usize, whole: usize| if whole == 0 { 1.0 } else { part as f64 / whole as f64 };
    let mut distances = surface_distances(a, b, stop);
    let pooled = || distances.iter().flatten().copied();
    let (hausdorff, mean_surface_distance) = (pooled().reduce(f64::max), mean(pooled()));
    let percentiles = distances.iter_mut().filter_map(|directed| percentile(directed, 0.95));
    Overlap {
        cells,
        intersection,
        union,
        jaccard: ratio(intersection, union),
        dice: ratio(2 * intersection, cells[0] + cells[1]),
        hausdorff,
        hausdorff_95: percentiles.reduce(f64::max),
        mean_surface_distance,
    }
}

fn mean(values: impl Iterator<Item = f64> + Clone) -> Option<f64> {
    let count = values.clone().count();
    (count > 0).then(|| values.sum::<f64>() / count as f64)
}

/// Value at position `part · (n − 1)` of the sorted values, with linear interpolation. Reorders them. Cost `O(n)`.
fn percentile(values: &mut [f64], part: f64) -> Option<f64> {
    let position = part * values.len().checked_sub(1)? as f64;
    let below = position as usize;
    let (_, &mut value, above) = values.select_nth_unstable_by(below, f64::total_cmp);
    let next = above.iter().copied().reduce(f64::min).unwrap_or(value);
    Some(between(value, next, position - below as f64))
}

/// Distances from the surface cells of `a` to the surface of `b`, and from `b` to `a`; empty if one surface is empty.
fn surface_distances(a: &Mask, b: &Mask, stop: Stop<'_>) -> [Vec<f64>; 2] {
    let Some(window) = Window::around(a, b) else { return [Vec::new(), Vec::new()] };
    let [of_a, of_b] = [a, b].map(|mask| window.surface(mask));
    if [&of_a, &of_b].into_iter().any(|surface| !surface.contains(&true)) {
        return [Vec::new(), Vec::new()];
    }
    [window.distances(&of_a, &of_b, stop), window.distances(&of_b, &of_a, stop)]
}

/// A box of cells.
struct Window {
    first: [usize; 3],
    size: [usize; 3],
    spacing: [f64; 3],
}

impl Window {
    /// Bounding box of the cells of two masks; `None` if both are empty.
    fn around(a: &Mask, b: &Mask) -> Option<Self> {
        let [rows, columns, length] = a.grid.size;
        let (mut first, mut last) = ([usize::MAX; 3], [0; 3]);
        for row in 0..rows * columns {
            let ray = row * length..(row + 1) * length;
            let mut ray = a.inside[ray.clone()].iter().zip(&b.inside[ray]).map(|(a, b)| *a || *b);
            let Some(from) = ray.position(|inside| inside) else { continue };
            let to = ray.rposition(|inside| inside).map_or(from, |beyond| from + 1 + beyond);
            let (i, j) = (row / columns, row % columns);
            first = std::array::from_fn(|axis| first[axis].min([i, j, from][axis]));
            last = std::array::from_fn(|axis| last[axis].max([i, j, to][axis]));
        }
        let size = |axis: usize| last[axis] - first[axis] + 1;
        (first[0] < usize::MAX).then(|| Self {
            first,
            size: std::array::from_fn(size),
            spacing: a.grid.spacing,
        })
    }

    /// The surface cells of a mask that lies within the window.
    fn surface(&self, mask: &Mask) -> Vec<bool> {
        let ([i, j, k], [rows, columns, length]) = (self.first, self.size);
        let ray = |row: usize| {
            let (i, j) = (i + row / columns, j + row % columns);
            (k..k + length).map(move |k| mask.is_surface([i, j, k]))
        };
        (0..rows * columns).into_par_iter().flat_map_iter(ray).collect()
    }

    /// Distances from the cells in `from` to the nearest cell in `to`, which must not be empty.
    ///
    /// ```text
    /// D²(i, j, k) = min_{i'} s₀²(i − i')² + min_{j'} s₁²(j − j')² + min_{k'} s₂²(k − k')² + 0 if (i', j', k') ∈ to, else ∞
    /// ```
    ///
    /// Exact Euclidean distance transform, one axis after the other, `O(cells)`. The last step is only done for the cells
    /// in `from`.
    ///
    /// # Source
    /// Felzenszwalb, Huttenlocher 2012, Distance transforms of sampled functions, sections 2 and 2.1.
    fn distances(&self, from: &[bool], to: &[bool], stop: Stop<'_>) -> Vec<f64> {
        let [rows, columns, length] = self.size;
        let slab = columns * length;
        // In units of the largest spacing, squares cannot overflow.
        let unit = self.spacing.into_iter().fold(0.0, f64::max);
        let weights = self.spacing.map(|spacing| (spacing / unit).powi(2).max(f64::MIN_POSITIVE));
        let mut field: Vec<f64> = to.iter().map(|to| if *to { 0.0 } else { f64::INFINITY }).collect();
        field.par_chunks_mut(slab).for_each_init(Envelope::default, |envelope, slab| {
            // The incomplete result is discarded.
            if stop() {
                return;
            }
            slab.chunks_mut(length).for_each(|line| envelope.lower(line, weights[2]));
            let mut line = vec![0.0; columns];
            for k in 0..length {
                (0..columns).for_each(|j| line[j] = slab[j * length + k]);
                envelope.lower(&mut line, weights[1]);
                (0..columns).for_each(|j| slab[j * length + k] = line[j]);
            }
        });
        let on_line = |envelope: &mut Envelope, at: usize| -> Vec<f64> {
            let asked: Vec<usize> = (0..rows).filter(|i| from[i * slab + at]).collect();
            if asked.is_empty() || stop() {
                return Vec::new();
            }
            let mut line: Vec<f64> = (0..rows).map(|i| field[i * slab + at]).collect();
            let squares: Vec<f64> = if asked.len() <= FEW {
                asked.into_iter().map(|i| lowest(&line, i, weights[0])).collect()
            } else {
                envelope.lower(&mut line, weights[0]);
                asked.into_iter().map(|i| line[i]).collect()
            };
            squares.into_iter().map(|square| unit * square.sqrt()).collect()
        };
        // Collected in the order of the lines, so that the result does not depend on threads.
        (0..slab).into_par_iter().map_init(Envelope::default, on_line).flatten_iter().collect()
    }
}

/// `min_q f(q) + weight · (p − q)²`, from the nearest `q` outwards until the weight alone is larger.
fn lowest(line: &[f64], p: usize, weight: f64) -> f64 {
    let mut least = line[p];
    for distance in 1..line.len() {
        let added = weight * (distance as f64).powi(2);
        if added >= least {
            break;
        }
        let [below, above] = [p.checked_sub(distance), p.checked_add(distance)];
        for height in [below, above].into_iter().flatten().filter_map(|q| line.get(q)) {
            least = least.min(height + added);
        }
    }
    least
}

/// The lower envelope of parabolas of one width. It is reused between lines to save allocations.
#[derive(Default)]
struct Envelope {
    parabolas: Vec<Parabola>,
}

/// `height + weight · (x − apex)²`, the lowest parabola from `from` to the start of the next one.
struct Parabola {
    apex: f64,
    height: f64,
    from: f64,
}

impl Envelope {
    /// Replaces `f` by `min_q f(q) + weight · (p − q)²`, in place. Cost: each parabola is added once and removed at most
    /// once.
    fn lower(&mut self, line: &mut [f64], weight: f64) {
        self.parabolas.clear();
        for (q, height) in line.iter().copied().enumerate().filter(|(_, height)| height.is_finite()) {
            self.add(q as f64, height, weight);
        }
        let mut pieces = self.parabolas.iter().peekable();
        let Some(mut piece) = pieces.next() else { return };
        for (p, value) in line.iter_mut().enumerate() {
            let x = p as f64;
            while let Some(next) = pieces.next_if(|next| next.from <= x) {
                piece = next;
            }
            *value = piece.height + weight * (x - piece.apex).powi(2);
        }
    }

    /// Adds a parabola to the right of all others.
    fn add(&mut self, apex: f64, height: f64, weight: f64) {
        let mut from = f64::NEG_INFINITY;
        while let Some(last) = self.parabolas.last() {
            // h + w(x − q)² = h' + w(x − q')²  ⟺  x = (q + q')/2 + (h' − h)/2 / (w(q' − q))
            let middle = 0.5 * (last.apex + apex);
            let (rise, slope) = (0.5 * (height - last.height), weight * (apex - last.apex));
            if rise > slope * (last.from - middle) {
                from = middle + rise / slope;
                break;
            }
            self.parabolas.pop();
        }
        self.parabolas.push(Parabola { apex, height, from });
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;
    use crate::vector::{cross, dot, minus, norm};

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
        let corner =
            |v: usize| [0, 1, 2].map(|axis| if v >> axis & 1 == 0 { lower[axis] } else { upper[axis] });
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

    #[test]
    fn grids_have_the_middle_of_the_box_and_a_margin_of_one_cell() {
        let grid = Grid::around([[0.0, -1.0, 2.0], [1.0, 1.0, 2.5]], [0.25, 0.5, 1.0]);
        assert_eq!(grid.size, [6, 6, 3]);
        assert_eq!(grid.first, [-0.125, -1.25, 1.25]);
        assert_eq!((grid.count(), grid.cell_measure(), grid.is_planar()), (108, 0.125, false));
        for cells in 1..200 {
            let grid = Grid::with_cells([[0.1, 0.2], [0.8, 0.3]], cells);
            assert_eq!(grid.size[0], cells + 2);
            assert!(grid.is_planar() && (grid.cell_measure() * (cells * cells) as f64 - 0.49).abs() < 1e-12);
        }
        assert_eq!(Grid::with_cells([[3.0; 3]; 2], 50).size, [3; 3]);
        assert_eq!(Grid::around([[-1e100; 3], [1e100; 3]], [1e-100; 3]).count(), usize::MAX);
        assert_eq!(bounds([[1.0, 5.0], [2.0, -3.0]]), Some([[1.0, -3.0], [2.0, 5.0]]));
        assert_eq!(bounds::<3>([]), None);
    }

    #[test]
    fn shifted_cubes_have_their_exact_jaccard_index_at_aligned_spacings() {
        for cells in [4, 8, 20] {
            let spacing = 1.0 / f64::from(cells);
            let grid = Grid::around([[0.0; 3], [1.25; 3]], [spacing; 3]);
            let a = from_mesh(&cuboid([0.0; 3], [1.0; 3], false), &grid);
            let b = from_mesh(&cuboid([0.25; 3], [1.25; 3], true), &grid);
            let found = overlap(&a, &b);
            let common = 0.75_f64.powi(3);
            assert!((found.jaccard - common / (2.0 - common)).abs() < 1e-15, "{found:?}");
            assert!((found.dice - common).abs() < 1e-15, "{found:?}");
            assert!((a.measure() - 1.0).abs() < 1e-12 && found.cells == [(cells as usize).pow(3); 2]);
            // The corner cells are the farthest.
            assert!((found.hausdorff.unwrap() - 0.25 * 3.0_f64.sqrt()).abs() < 1e-12, "{found:?}");
        }
    }

    /// Lens of two balls: π (4R + d)(2R − d)² / 12.
    #[test]
    fn spheres_have_nearly_the_jaccard_index_of_their_lens() {
        let (radius, distance) = (0.45, 0.2);
        let [a, b] = [[0.0; 3], [distance, 0.0, 0.0]].map(|centre| sphere(120, radius, centre));
        let ball = 4.0 / 3.0 * PI * radius.powi(3);
        let lens = PI * (4.0 * radius + distance) * (2.0 * radius - distance).powi(2) / 12.0;
        let exact = lens / (2.0 * ball - lens);
        for (cells, tolerance) in [(32_u32, 1e-3), (64, 5e-4)] {
            let spacing = 1.0 / f64::from(cells);
            // The centre of the first sphere is a corner of cells.
            let size = [cells as usize * 2; 3];
            let grid = Grid { first: [0.5 * spacing - 1.0; 3], spacing: [spacing; 3], size };
            let found = overlap(&from_mesh(&a, &grid), &from_mesh(&b, &grid));
            assert!((found.jaccard - exact).abs() < tolerance, "{} for {exact}", found.jaccard);
            assert!((found.hausdorff.unwrap() - distance).abs() < 2.0 * spacing, "{found:?}");
        }
    }

    #[test]
    fn parity_is_the_winding_number_of_a_mesh_that_does_not_cross_itself() {
        let wavy = torus(40, 24, |s, t| {
            let tube = 0.4 + 0.1 * (3.0 * s).sin() + 0.05 * (2.0 * t + s).cos();
            let ring = 1.0 + tube * t.cos();
            [ring * s.cos(), 0.8 * ring * s.sin() + 0.1, tube * t.sin() + 0.3 * (2.0 * s).cos()]
        });
        assert_eq!(wavy.connectivity().unwrap().genus(), 1);
        let grid = Grid { first: [-1.6, -1.31, -0.8], spacing: [0.161, 0.139, 0.0813], size: [20, 20, 20] };
        let mask = from_mesh(&wavy, &grid);
        for (at, &inside) in mask.inside.iter().enumerate() {
            let turns = winding(&wavy, centre(&grid, at)).abs();
            assert_eq!(inside, turns > 0.5, "{turns} at {:?}", centre(&grid, at));
        }
        assert!(mask.count() > 1000);
    }

    /// Boxes with corners, edges and sides on cell centres, cut differently.
    #[test]
    fn boxes_that_tile_share_out_the_centres() {
        let grid = Grid { first: [-1.0; 3], spacing: [0.5; 3], size: [9, 8, 7] };
        let boxes = [
            cuboid([0.0; 3], [1.0; 3], false),
            cuboid([1.0, 0.0, 0.0], [2.0, 1.0, 1.0], true),
            cuboid([0.0, 1.0, 0.0], [2.0, 1.5, 1.0], false),
            cuboid([0.0, 0.0, 1.0], [2.0, 1.5, 1.5], true),
        ];
        let masks = boxes.map(|cuboid| from_mesh(&cuboid, &grid));
        assert_eq!(masks.each_ref().map(Mask::count), [8, 8, 8, 12]);
        assert_eq!(overlap(&masks[0], &masks[1]).intersection, 0);
        let whole = from_mesh(&cuboid([0.0; 3], [2.0, 1.5, 1.5], false), &grid);
        for at in 0..grid.count() {
            let owners = masks.iter().filter(|mask| mask.inside[at]).count();
            assert_eq!(owners, usize::from(whole.inside[at]), "{:?}", centre(&grid, at));
        }
    }

    /// The six tetrahedra along the diagonal of a cube, straight and with moved corners.
    #[test]
    fn tetrahedra_that_tile_share_out_the_centres() {
        let mut state = 7;
        for trial in 0..20 {
            let shift: [[f64; 3]; 8] = std::array::from_fn(|_| [0; 3].map(|_| 0.3 * uniform(&mut state)));
            let scale = if trial == 0 { 0.0 } else { 1.0 };
            let mut solid = cuboid([0.0; 3], [1.0; 3], false);
            let moved =
                |(vertex, shift): ([f64; 3], [f64; 3])| [0, 1, 2].map(|c| vertex[c] + scale * shift[c]);
            solid.vertices = solid.vertices.iter().copied().zip(shift).map(moved).collect();
            let orders = [[1, 2, 4], [1, 4, 2], [2, 1, 4], [2, 4, 1], [4, 1, 2], [4, 2, 1]];
            let grid = Grid { first: [-0.25; 3], spacing: [0.125; 3], size: [14; 3] };
            let masks = orders.map(|[first, second, _]| {
                let [a, b, c, d] = [0, first, first + second, 7];
                let faces = vec![[a, b, c], [d, b, a], [a, c, d], [c, b, d]];
                from_mesh(&mesh(solid.vertices.clone(), faces), &grid)
            });
            // Hull faces that match the tetrahedra: the diagonals from the smallest to the largest corner.
            let hull = orders.iter().flat_map(|[x, y, _]| [[0, *x, x + y], [7, *x, x + y]]).collect();
            let whole = from_mesh(&mesh(solid.vertices, hull), &grid);
            assert!(trial > 0 || whole.count() == 512);
            for at in 0..grid.count() {
                let owners = masks.iter().filter(|mask| mask.inside[at]).count();
                assert_eq!(owners, usize::from(whole.inside[at]), "{:?} of trial {trial}", centre(&grid, at));
            }
        }
    }

    #[test]
    fn what_is_enclosed_twice_is_outside() {
        let [mut twice, other] =
            [[0.0; 3], [0.5; 3]].map(|lower| cuboid(lower, lower.map(|x| x + 1.0), false));
        twice.faces.extend(other.faces.iter().map(|face| face.map(|vertex| vertex + 8)));
        twice.vertices.extend(other.vertices);
        let grid = Grid::around([[0.0; 3], [1.5; 3]], [0.25; 3]);
        assert_eq!(from_mesh(&twice, &grid).count(), 2 * (64 - 8));
    }

    #[test]
    fn huge_coordinates_and_tiny_spacings_do_no_harm() {
        let grid = Grid { first: [0.1; 3], spacing: [1e-90, 1e-9, 0.25], size: [4, 5, 6] };
        let huge = from_mesh(&cuboid([-1e100; 3], [1e100; 3], false), &grid);
        assert_eq!(huge.count(), grid.count());
        assert_eq!(from_mesh(&cuboid([-1e100; 3], [-9e99; 3], true), &grid).count(), 0);
        assert_eq!(from_mesh(&cuboid([9e99; 3], [1e100; 3], true), &grid).count(), 0);
        assert_eq!(overlap(&huge, &huge).hausdorff, Some(0.0));
        let one = |at: usize| Mask { grid, inside: (0..grid.count()).map(|i| i == at).collect() };
        let far = overlap(&one(0), &one(grid.count() - 1)).hausdorff.unwrap();
        assert!((far - 1.25).abs() < 1e-12, "{far}");
        let nowhere = mesh(vec![[f64::NAN; 3], [f64::INFINITY; 3], [0.0; 3]], vec![[0, 1, 2], [2, 1, 0]]);
        assert_eq!(from_mesh(&nowhere, &grid).inside.len(), grid.count());
        let none = Grid { size: [0, 3, 0], ..grid };
        assert_eq!(from_mesh(&cuboid([0.0; 3], [1.0; 3], false), &none).count(), 0);
    }

    /// A star with a hole, compared with crossings on rays along the other axis.
    #[test]
    fn contours_are_filled_as_a_point_in_polygon_test_does() {
        let mut state = 3;
        let ring = |count: u32, radius: f64, state: &mut u64| -> Vec<[f64; 2]> {
            let point = |i: u32| {
                let (angle, r) =
                    (2.0 * PI * f64::from(i) / f64::from(count), radius * (0.5 + uniform(state)));
                [2.0 * r * angle.cos(), r * angle.sin()]
            };
            (0..count).map(point).collect()
        };
        let polygons = [ring(41, 1.0, &mut state), ring(9, 0.3, &mut state)];
        let grid = Grid::with_cells(bounds(polygons.iter().flatten().copied()).unwrap(), 150);
        let mask = from_contours(&polygons, &grid);
        for at in 0..grid.count() {
            let [x, y, _] = centre(&grid, at);
            let crossed = |a: &[f64; 2], b: &[f64; 2]| {
                (a[1] > y) != (b[1] > y) && x < (b[0] - a[0]) * (y - a[1]) / (b[1] - a[1]) + a[0]
            };
            let crossings = |polygon: &Vec<[f64; 2]>| {
                (0..polygon.len())
                    .filter(|i| crossed(&polygon[*i], &polygon[(i + 1) % polygon.len()]))
                    .count()
            };
            assert_eq!(mask.inside[at], polygons.iter().map(crossings).sum::<usize>() % 2 == 1, "{x} {y}");
        }
        let area = |polygon: &Vec<[f64; 2]>| {
            let cross = |i: usize| {
                let (a, b) = (polygon[i], polygon[(i + 1) % polygon.len()]);
                0.5 * (a[0] * b[1] - a[1] * b[0])
            };
            (0..polygon.len()).map(cross).sum::<f64>()
        };
        let exact = area(&polygons[0]) - area(&polygons[1]);
        assert!((mask.measure() - exact).abs() < 0.01 * exact, "{} for {exact}", mask.measure());
        assert_eq!(from_contours(&[vec![], vec![[0.0; 2]]], &grid).count(), 0);
    }

    #[test]
    fn squares_that_tile_share_out_the_centres() {
        let grid = Grid { first: [0.0; 3], spacing: [0.5, 0.25, 1.0], size: [6, 9, 1] };
        let square = |x: f64, y: f64| vec![vec![[x, y], [x + 1.0, y], [x + 1.0, y + 1.0], [x, y + 1.0]]];
        let masks = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)].map(|(x, y)| from_contours(&square(x, y), &grid));
        assert_eq!(masks.each_ref().map(Mask::count), [8; 3]);
        assert_eq!(overlap(&masks[0], &masks[1]).intersection, 0);
        assert_eq!(overlap(&masks[0], &masks[2]).intersection, 0);
        assert_eq!(masks[0].measure(), 1.0);
        // In the plane, the inner cells of a 2 × 4 block of pixels are on its border too; those of a 4 × 4 block are not.
        let block = Mask { grid, inside: (0..54).map(|at| at / 9 < 4 && at % 9 < 4).collect() };
        let border = (0..54).filter(|at| block.is_surface([at / 9, at % 9, 0])).count();
        assert_eq!(border, 12);
    }

    #[test]
    fn contours_that_cross_themselves_are_filled_by_their_winding_number() {
        let grid = Grid { first: [0.5, 0.5, 0.0], spacing: [1.0; 3], size: [12, 10, 1] };
        let square =
            |[x, y]: [f64; 2], side: f64| vec![[x, y], [x + side, y], [x + side, y + side], [x, y + side]];
        let backwards = |mut polygon: Vec<[f64; 2]>| {
            polygon.reverse();
            polygon
        };
        let count = |polygons: &[Vec<[f64; 2]>]| from_contours(polygons, &grid).count();
        let outer = square([1.0, 1.0], 8.0);
        let inner = square([1.0, 1.0], 4.0);
        let once = from_contours(std::slice::from_ref(&outer), &grid);
        assert_eq!(once.count(), 64);
        // Walked twice, and twice with a part walked a third time, it is itself; there and back again it is nothing.
        assert_eq!(from_contours(&[[outer.clone(), outer.clone()].concat()], &grid), once);
        assert_eq!(from_contours(&[[outer.clone(), inner.clone()].concat()], &grid), once);
        assert_eq!(count(&[[outer.clone(), backwards(outer.clone())].concat()]), 0);
        // A part that is walked backwards cancels.
        let hollow = [outer.clone(), vec![[1.0, 1.0]], backwards(inner.clone())].concat();
        assert_eq!(count(&[hollow]), 64 - 16);
        // Both lobes of an eight count.
        assert_eq!(
            count(&[vec![
                [0.0, 0.0],
                [4.0, 0.0],
                [4.0, 4.0],
                [8.0, 4.0],
                [8.0, 8.0],
                [4.0, 8.0],
                [4.0, 4.0],
                [0.0, 4.0]
            ]]),
            32
        );
        // Between contours parity decides, whatever their directions.
        for hole in [inner.clone(), backwards(inner)] {
            assert_eq!(count(&[outer.clone(), hole.clone()]), 64 - 16);
            assert_eq!(count(&[hole.clone(), outer.clone(), hole]), 64);
        }
    }

    /// All pairs of surface cells, in both directions.
    fn brute_distances(a: &Mask, b: &Mask) -> [Vec<f64>; 2] {
        let surface = |mask: &Mask| -> Vec<[f64; 3]> {
            let [_, columns, length] = mask.grid.size;
            let cell = |at: usize| [at / length / columns, at / length % columns, at % length];
            (0..mask.grid.count())
                .filter(|at| mask.is_surface(cell(*at)))
                .map(|at| centre(&mask.grid, at))
                .collect()
        };
        let to_nearest = |from: &[[f64; 3]], to: &[[f64; 3]]| -> Vec<f64> {
            let nearest = |p: &[f64; 3]| to.iter().map(|q| norm(minus(*p, *q))).fold(f64::INFINITY, f64::min);
            from.iter().map(nearest).collect()
        };
        let (of_a, of_b) = (surface(a), surface(b));
        [to_nearest(&of_a, &of_b), to_nearest(&of_b, &of_a)]
    }

    #[test]
    fn surface_distances_are_those_of_all_pairs() {
        let mut state = 11;
        for trial in 0..60 {
            let density = [0.02, 0.3, 0.9][trial % 3];
            let layers = if trial % 4 == 0 { 1 } else { 6 };
            let grid = Grid { first: [0.5, -1.0, 0.0], spacing: [0.7, 0.2, 1.9], size: [9, 12, layers] };
            let [a, b] = [0, 1].map(|_| Mask {
                grid,
                inside: (0..grid.count()).map(|_| uniform(&mut state) < density).collect(),
            });
            let found = overlap(&a, &b);
            if found.cells.contains(&0) {
                assert_eq!(found.hausdorff, None);
                continue;
            }
            let directed = brute_distances(&a, &b).map(|mut distances| {
                distances.sort_by(f64::total_cmp);
                distances
            });
            let mut expected = directed.concat();
            let mean = expected.iter().sum::<f64>() / expected.len() as f64;
            expected.sort_by(f64::total_cmp);
            let [percentile, other] = directed.map(|sorted| {
                let position = 0.95 * (sorted.len() - 1) as f64;
                let (below, above) = (sorted[position.floor() as usize], sorted[position.ceil() as usize]);
                below + (above - below) * position.fract()
            });
            let percentile = percentile.max(other);
            let close = |found: Option<f64>, expected: f64| (found.unwrap() - expected).abs() < 1e-12;
            assert!(close(found.hausdorff, expected[expected.len() - 1]), "{found:?} in trial {trial}");
            assert!(close(found.hausdorff_95, percentile), "{found:?} for {percentile} in trial {trial}");
            assert!(close(found.mean_surface_distance, mean), "{found:?} for {mean} in trial {trial}");
            assert_eq!(overlap(&b, &a).hausdorff, found.hausdorff);
        }
    }

    #[test]
    fn shifted_boxes_are_their_shift_apart() {
        let grid = Grid { first: [0.0; 3], spacing: [0.5, 0.25, 2.0], size: [20, 30, 10] };
        let block = |[i, j, k]: [usize; 3]| {
            let holds = |at: usize| {
                let (x, y, z) = (at / 300, at / 10 % 30, at % 10);
                (i..i + 8).contains(&x) && (j..j + 10).contains(&y) && (k..k + 5).contains(&z)
            };
            Mask { grid, inside: (0..grid.count()).map(holds).collect() }
        };
        let found = overlap(&block([2, 3, 1]), &block([5, 3, 3]));
        // 3 cells of 0.5 and 2 of 2.
        assert!((found.hausdorff.unwrap() - 1.5_f64.hypot(4.0)).abs() < 1e-14, "{found:?}");
        assert_eq!((found.cells, found.intersection), ([400, 400], 5 * 10 * 3));
        assert!(found.hausdorff_95 <= found.hausdorff && found.mean_surface_distance < found.hausdorff_95);
        let same = overlap(&block([2, 3, 1]), &block([2, 3, 1]));
        assert_eq!((same.jaccard, same.dice, same.hausdorff_95), (1.0, 1.0, Some(0.0)));
    }

    #[test]
    fn empty_masks_are_equal_and_have_no_surface() {
        let grid = Grid { first: [0.0; 3], spacing: [1.0; 3], size: [3; 3] };
        let [empty, full] = [false, true].map(|inside| Mask { grid, inside: vec![inside; 27] });
        let both = overlap(&empty, &empty);
        assert_eq!((both.jaccard, both.dice, both.union, both.hausdorff), (1.0, 1.0, 0, None));
        let one = overlap(&empty, &full);
        assert_eq!((one.jaccard, one.dice, one.cells, one.union), (0.0, 0.0, [0, 27], 27));
        assert_eq!((one.hausdorff, one.hausdorff_95, one.mean_surface_distance), (None, None, None));
    }
}
