//! Stencils of the linear schemes: new vertices as weighted sums of old ones.
//!
//! A step keeps or moves the old vertices, which keep their indices, and adds one vertex per edge. The stencil of a vertex
//! depends only on its valence, that of an edge on the valences of its two ends.
//!
//! Loop has rules for boundaries: edges of the boundary get their midpoint, and its vertices move to ⅛, ¾, ⅛ along it. The boundary
//! is therefore the cubic B-spline of its vertices, whatever is inside, and two surfaces with one boundary meet there. All
//! edges inside, also those between two vertices of the boundary, keep the rule ⅜, ⅜, ⅛, ⅛.
//!
//! Sources: Badoual, Novara, Romani, Schmitter, Unser, *A non-stationary subdivision scheme for the construction of deformable models
//! with sphere-like topology* (the rules of BLOB, with the weights corrected); Loop, *Smooth subdivision surfaces based on
//! triangles*, 1987; Hoppe and others, *Piecewise smooth surface reconstruction*, 1994 (boundaries); Zorin, Schröder, Sweldens,
//! *Interpolating subdivision for meshes with arbitrary topology*, 1996.

use std::f64::consts::TAU;

use rayon::prelude::*;

use super::{LoopWeights, Scheme};
use crate::GeometryError;
use crate::mesh::Connectivity;
use shapelex_numeric::sparse::SparseRows;

/// The weights of BLOB at one level, `v = v⁽ᵏ⁾`. Two-letter names belong to vertices of valence 4.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BlobWeights {
    /// Weight of a vertex of valence 6 itself; `b` is that of its neighbours.
    pub a: f64,
    /// See `a`.
    pub b: f64,
    /// Edge between two vertices of valence 6: `c` wings, `d` opposite vertices, `e` far vertices, `f` ends.
    pub c: f64,
    /// See `c`.
    pub d: f64,
    /// See `c`.
    pub e: f64,
    /// See `c`.
    pub f: f64,
    /// Weight of a vertex of valence 4 itself; `bb` is that of its neighbours.
    pub aa: f64,
    /// See `aa`.
    pub bb: f64,
    /// Edge between vertices of valence 4 and 6: `dd` opposite vertices, `ee` far vertex and `ff` end on the side of valence 4.
    pub dd: f64,
    /// See `dd`.
    pub ee: f64,
    /// See `dd`.
    pub ff: f64,
    /// Edge between two vertices of valence 4: `g` ends, `h` far vertices on its straight line.
    pub g: f64,
    /// See `g`.
    pub h: f64,
}

impl BlobWeights {
    /// The weights for the level parameter `v > 0`. Every stencil sums to 1, identically in `v`.
    pub fn new(v: f64) -> Self {
        let (w, square) = (v + 1.0, (v + 1.0) * (v + 1.0));
        let cube = square * w;
        let c = (2.0 * v + 1.0) / (16.0 * cube);
        let d = (2.0 * v + 1.0).powi(2) / (8.0 * cube);
        let e = 1.0 / (16.0 * cube);
        let f = (2.0 * v + 1.0) * (4.0 * v * v + 6.0 * v + 3.0) / (16.0 * cube);
        Self {
            a: (4.0 * v * v + 2.0 * v + 1.0) / (4.0 * square),
            b: (2.0 * v + 1.0) / (8.0 * square),
            c,
            d,
            e,
            f,
            aa: (45.0 * v * v + 18.0 * v + 1.0) / (48.0 * square),
            bb: (3.0 * v * v + 78.0 * v + 47.0) / (192.0 * square),
            dd: d + 0.5 * c,
            ee: e + 0.25 * c,
            ff: f + 0.75 * c,
            g: (2.0 * v + 3.0) * (2.0 * v + 1.0) / (8.0 * square),
            h: 1.0 / (8.0 * square),
        }
    }
}

/// `β_n` of Loop: the weight of each neighbour of a vertex of valence `n`.
pub fn loop_beta(weights: LoopWeights, valence: usize) -> f64 {
    let n = valence as f64;
    match weights {
        LoopWeights::Original => (0.625 - (0.375 + 0.25 * (TAU / n).cos()).powi(2)) / n,
        LoopWeights::Simplified if valence == 3 => 3.0 / 16.0,
        LoopWeights::Simplified => 3.0 / (8.0 * n),
    }
}

/// Checks that a scheme has rules for all vertices.
///
/// # Errors
/// [`GeometryError::Valence`] for the first vertex without rules. BLOB has rules for valence 4 and 6 only.
pub fn check_valences(scheme: Scheme, connectivity: &Connectivity) -> Result<(), GeometryError> {
    if !matches!(scheme, Scheme::Blob(_)) {
        return Ok(());
    }
    let vertices = 0..connectivity.vertices() as u32;
    let other =
        vertices.map(|vertex| (vertex, connectivity.valence(vertex))).find(|(_, n)| ![4, 6].contains(n));
    other.map_or(Ok(()), |(vertex, valence)| Err(GeometryError::Valence { vertex, valence }))
}

/// The matrix `S_k` from the vertices of a mesh to those of the mesh split once, where `v` is the parameter of the level. The
/// valences must pass [`check_valences`]. Cost: up to ten entries per vertex.
pub fn step(scheme: Scheme, v: f64, connectivity: &Connectivity) -> SparseRows {
    let (vertices, edges) = (connectivity.vertices(), connectivity.edges().len());
    let mut rows = SparseRows::new(vertices, vertices + edges, 10 * edges + 7 * vertices);
    let rules = Rules { scheme, blob: BlobWeights::new(v), connectivity };
    let (mut rings, mut row) = (Rings::default(), Vec::with_capacity(16));
    let half_edges = connectivity.half_edges();
    for new in 0..vertices + edges {
        row.clear();
        rules.stencil(new, &half_edges, &mut rings, &mut |vertex, weight| row.push((vertex, weight)));
        rows.push(&row);
    }
    rows
}

/// `S_k X`, the new positions, without forming the matrix. The result does not depend on the number of threads.
pub fn refined(scheme: Scheme, v: f64, connectivity: &Connectivity, points: &[[f64; 3]]) -> Vec<[f64; 3]> {
    let rules = Rules { scheme, blob: BlobWeights::new(v), connectivity };
    let half_edges = connectivity.half_edges();
    let place = |rings: &mut Rings, new: usize| {
        let mut sum = [0.0; 3];
        rules.stencil(new, &half_edges, rings, &mut |vertex, weight| {
            let point = points[vertex as usize];
            (0..3).for_each(|c| sum[c] += weight * point[c]);
        });
        sum
    };
    let all = 0..connectivity.vertices() + connectivity.edges().len();
    all.into_par_iter().with_min_len(TOGETHER).map_init(Rings::default, place).collect()
}

/// Minimum number of new vertices per thread: for fewer, handing over the work takes longer than the work.
const TOGETHER: usize = 4096;

/// Neighbours of a vertex, or of both ends of an edge.
type Rings = [Vec<u32>; 2];

struct Rules<'a> {
    scheme: Scheme,
    blob: BlobWeights,
    connectivity: &'a Connectivity,
}

impl Rules<'_> {
    /// Stencil of a new vertex. Moved old vertices come first, then the vertices of the edges.
    fn stencil(
        &self,
        new: usize,
        half_edges: &[[u32; 2]],
        rings: &mut Rings,
        add: &mut impl FnMut(u32, f64),
    ) {
        let Some(edge) = new.checked_sub(self.connectivity.vertices()) else {
            rings[0].clear();
            rings[0].extend(self.connectivity.ring(new as u32));
            if !self.connectivity.is_closed() && self.connectivity.is_on_boundary(new as u32) {
                return self.boundary_vertex(new as u32, &rings[0], add);
            }
            return self.vertex(new as u32, &rings[0], add);
        };
        let (ends, half_edges) = (self.connectivity.edges()[edge], half_edges[edge]);
        match self.scheme {
            Scheme::Loop(_) => self.loop_edge(ends, half_edges, add),
            Scheme::NormalBased { .. } => ends.iter().for_each(|end| add(*end, 0.5)),
            Scheme::Blob(_) => self.blob_edge(ends, self.rings_of(half_edges, rings), add),
            Scheme::Butterfly { tension } => {
                butterfly_edge(tension.get(), ends, self.rings_of(half_edges, rings), add);
            }
        }
    }

    /// The rings of both ends of an edge, each starting at the other end. Their second and last vertices are opposite to the
    /// edge.
    fn rings_of<'a>(&self, half_edges: [u32; 2], rings: &'a mut Rings) -> [&'a [u32]; 2] {
        for (ring, half_edge) in rings.iter_mut().zip(half_edges) {
            ring.clear();
            ring.extend(self.connectivity.ring_from(half_edge));
        }
        [&rings[0], &rings[1]]
    }

    fn vertex(&self, vertex: u32, ring: &[u32], add: &mut impl FnMut(u32, f64)) {
        let [own, other] = match self.scheme {
            Scheme::Blob(_) if ring.len() == 4 => [self.blob.aa, self.blob.bb],
            Scheme::Blob(_) => [self.blob.a, self.blob.b],
            Scheme::Loop(weights) => {
                let beta = loop_beta(weights, ring.len());
                [1.0 - ring.len() as f64 * beta, beta]
            }
            Scheme::Butterfly { .. } | Scheme::NormalBased { .. } => return add(vertex, 1.0),
        };
        add(vertex, own);
        ring.iter().for_each(|neighbour| add(*neighbour, other));
    }

    /// `ring`: the neighbours along the faces, from one edge of the boundary to the other.
    fn boundary_vertex(&self, vertex: u32, ring: &[u32], add: &mut impl FnMut(u32, f64)) {
        match (self.scheme, ring) {
            (Scheme::Loop(_), [before, .., after]) => {
                [(vertex, 0.75), (*before, 0.125), (*after, 0.125)].into_iter().for_each(|(i, w)| add(i, w));
            }
            _ => add(vertex, 1.0),
        }
    }

    /// The ends of an edge, and the corners opposite to it. An edge of the boundary has its one half-edge twice.
    fn loop_edge(&self, ends: [u32; 2], half_edges: [u32; 2], add: &mut impl FnMut(u32, f64)) {
        if half_edges[0] == half_edges[1] {
            return ends.iter().for_each(|end| add(*end, 0.5));
        }
        ends.iter().for_each(|end| add(*end, 0.375));
        half_edges.iter().for_each(|half_edge| add(self.connectivity.opposite(*half_edge), 0.125));
    }

    fn blob_edge(&self, ends: [u32; 2], rings: [&[u32]; 2], add: &mut impl FnMut(u32, f64)) {
        let BlobWeights { c, d, e, f, dd, ee, ff, g, h, .. } = self.blob;
        debug_assert!(rings.iter().all(|ring| [4, 6].contains(&ring.len())), "{rings:?}");
        let irregular = rings.iter().filter(|ring| ring.len() == 4).count();
        for (end, ring) in ends.into_iter().zip(rings) {
            match (irregular, ring.len()) {
                (2, _) => [(end, g), (ring[2], h)].into_iter().for_each(|(i, w)| add(i, w)),
                (_, 4) => [(end, ff), (ring[1], dd), (ring[2], ee)].into_iter().for_each(|(i, w)| add(i, w)),
                _ => {
                    let opposite = if irregular == 0 { d } else { dd };
                    let parts = [(end, f), (ring[1], opposite), (ring[2], c), (ring[3], e), (ring[4], c)];
                    parts.into_iter().for_each(|(i, w)| add(i, w));
                }
            }
        }
    }
}

fn butterfly_edge(w: f64, ends: [u32; 2], rings: [&[u32]; 2], add: &mut impl FnMut(u32, f64)) {
    let irregular = rings.iter().filter(|ring| ring.len() != 6).count();
    if irregular == 0 {
        for (end, ring) in ends.into_iter().zip(rings) {
            let wing = -0.0625 - w;
            let parts =
                [(end, 0.5 - w), (ring[1], 0.125 + 2.0 * w), (ring[2], wing), (ring[3], w), (ring[4], wing)];
            parts.into_iter().filter(|(_, weight)| *weight != 0.0).for_each(|(i, weight)| add(i, weight));
        }
        return;
    }
    // The rule of the irregular end; the mean of both if there are two.
    let share = 1.0 / irregular as f64;
    for (end, ring) in ends.into_iter().zip(rings).filter(|(_, ring)| ring.len() != 6) {
        add(end, 0.75 * share);
        let n = ring.len();
        ring.iter().enumerate().for_each(|(j, vertex)| add(*vertex, share * butterfly_ring(n, j)));
    }
}

/// `s_j` of a vertex of valence `n ≠ 6`, where `j = 0` is the other end of the edge.
fn butterfly_ring(valence: usize, j: usize) -> f64 {
    let turn = TAU * j as f64 / valence as f64;
    match (valence, j) {
        (3, 0) => 5.0 / 12.0,
        (3, _) => -1.0 / 12.0,
        (4, 0) => 0.375,
        (4, 2) => -0.125,
        (4, _) => 0.0,
        _ => (0.25 + turn.cos() + 0.5 * (2.0 * turn).cos()) / valence as f64,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_sum_to_one_at_every_level_and_have_the_limits_of_v_1() {
        for v in [1e-9, 0.1, 0.7, 1.0, 1.3, 40.0, 499.0] {
            let BlobWeights { a, b, c, d, e, f, aa, bb, dd, ee, ff, g, h } = BlobWeights::new(v);
            let sums = [
                a + 6.0 * b,
                2.0 * (f + d + 2.0 * c + e),
                aa + 4.0 * bb,
                ff + f + 2.0 * dd + ee + e + 2.0 * c,
                2.0 * (g + h),
            ];
            for sum in sums {
                assert!((sum - 1.0).abs() < 1e-15, "{sum} at {v}");
            }
        }
        let limit = BlobWeights::new(1.0);
        assert_eq!((limit.a, limit.b, limit.f), (7.0 / 16.0, 3.0 / 32.0, 39.0 / 128.0));
        assert_eq!((limit.dd, limit.ee, limit.ff), (39.0 / 256.0, 7.0 / 512.0, 165.0 / 512.0));
    }

    #[test]
    fn loops_weights_meet_at_the_valences_three_and_six() {
        for weights in [LoopWeights::Original, LoopWeights::Simplified] {
            assert!((loop_beta(weights, 3) - 3.0 / 16.0).abs() < 1e-16);
            assert!((loop_beta(weights, 6) - 1.0 / 16.0).abs() < 1e-16);
        }
    }

    #[test]
    fn weights_of_irregular_butterflies_sum_to_one() {
        for valence in [3, 4, 5, 7, 12] {
            let sum: f64 = (0..valence).map(|j| butterfly_ring(valence, j)).sum();
            assert!((0.75 + sum - 1.0).abs() < 1e-15, "{valence}");
        }
    }
}
