//! Limit positions and normals of the vertices of a level.
//!
//! One step maps the surroundings of a vertex to the surroundings of the same vertex at the next level, by a matrix that
//! depends only on its valence. Its action on constants gives the limit position; its action on the first harmonic around the
//! vertex gives the two tangents.
//!
//! * Loop, with `χ = 1/(n + 3/(8β_n))`: `p_∞ = (1 − nχ) p + χ Σ r_j`, tangents `Σ cos(2πj/n) r_j` and `Σ sin(2πj/n) r_j`.
//! * Loop at a vertex of the boundary, with the `k` faces between its neighbours `r_0 … r_k` and `θ = π/k`: `p_∞ = ⅔ p + ⅙ (r_0 + r_k)`,
//!   tangents `r_0 − r_k` along the boundary and `Σ sin(jθ) r_j + c (r_0 + r_k) + d p` across it, `c = (sin θ − cot θ/2)/(1 + 2 cos θ)`,
//!   `d = −cot θ/2 − 2c`; `r_0 + r_1 − 2p` for `k = 1`. The second one belongs to the eigenvalue `⅜ + ¼ cos θ`. From six faces on, the
//!   one of two waves, `⅜ + ¼ cos 2θ`, is as large as the ½ of the tangent along the boundary: the limit need not be smooth there, and
//!   has no normal.
//! * BLOB changes from level to level: its functionals are those of `v = 1`, carried back through all levels.
//! * The butterfly keeps its vertices. Its limit is C¹, but its tangents involve two rings: normals are not given.

use std::f64::consts::{PI, TAU};

use super::stencil::{BlobWeights, loop_beta, refined};
use super::{LoopWeights, Scheme};
use crate::mesh::Connectivity;
use crate::vector::{cross, minus, norm};

/// Limit positions and normals of the vertices of a level.
#[derive(Debug, Clone, PartialEq)]
pub struct Limit {
    /// Limit positions.
    pub points: Vec<[f64; 3]>,
    /// Outward unit normals, zero where the tangents do not span a plane, as at vertices of the boundary with six faces and more;
    /// `None` for the butterfly.
    pub normals: Option<Vec<[f64; 3]>>,
}

/// The limit of `points` at the vertices of a level with parameter `v`, under a linear scheme. Cost: linear in the number of
/// vertices; for BLOB, that of one more step.
pub fn limit(scheme: Scheme, v: f64, connectivity: &Connectivity, points: &[[f64; 3]]) -> Limit {
    match scheme {
        Scheme::Blob(_) => blob(scheme, v, connectivity, points),
        Scheme::Loop(weights) => loop_limit(weights, connectivity, points),
        Scheme::Butterfly { .. } | Scheme::NormalBased { .. } => {
            Limit { points: points.to_vec(), normals: None }
        }
    }
}

/// Sums over neighbours in the two phases of the first harmonic.
#[derive(Default)]
struct Tangents([[f64; 3]; 2]);

impl Tangents {
    fn add(&mut self, weight: f64, angle: f64, point: [f64; 3]) {
        let (sine, cosine) = angle.sin_cos();
        for (tangent, part) in self.0.iter_mut().zip([cosine, sine]) {
            (0..3).for_each(|c| tangent[c] += weight * part * point[c]);
        }
    }

    fn normal(&self) -> [f64; 3] {
        let [first, second] = self.0;
        // Scaled, so that very small and very large shapes have normals too.
        let size = norm(first).max(norm(second));
        let normal = cross(first.map(|x| x / size), second.map(|x| x / size));
        let length = norm(normal);
        if length > 0.0 { normal.map(|x| x / length) } else { [0.0; 3] }
    }
}

fn loop_limit(weights: LoopWeights, connectivity: &Connectivity, points: &[[f64; 3]]) -> Limit {
    let at = |vertex: u32| points[vertex as usize];
    let of_vertex = |vertex: u32| {
        if !connectivity.is_closed() && connectivity.is_on_boundary(vertex) {
            return loop_boundary(at(vertex), &connectivity.ring(vertex).map(at).collect::<Vec<_>>());
        }
        let valence = connectivity.valence(vertex);
        let chi = 1.0 / (valence as f64 + 3.0 / (8.0 * loop_beta(weights, valence)));
        let mut point = at(vertex).map(|x| (1.0 - valence as f64 * chi) * x);
        let mut tangents = Tangents::default();
        for (j, neighbour) in connectivity.ring(vertex).enumerate() {
            (0..3).for_each(|c| point[c] += chi * at(neighbour)[c]);
            tangents.add(1.0, TAU * j as f64 / valence as f64, at(neighbour));
        }
        (point, tangents.normal())
    };
    let (points, normals) = (0..points.len() as u32).map(of_vertex).unzip();
    Limit { points, normals: Some(normals) }
}

/// Largest number of faces at a vertex of the boundary where the limit of Loop has a tangent plane.
const SMOOTH_FACES: usize = 5;

/// Limit position and normal of Loop at a vertex `p` of the boundary with the neighbours `ring`.
fn loop_boundary(p: [f64; 3], ring: &[[f64; 3]]) -> ([f64; 3], [f64; 3]) {
    let [Some(first), Some(last)] = [ring.first(), ring.last()] else { return (p, [0.0; 3]) };
    let point = [0, 1, 2].map(|c| (4.0 * p[c] + first[c] + last[c]) / 6.0);
    let faces = ring.len() - 1;
    if faces > SMOOTH_FACES {
        return (point, [0.0; 3]);
    }
    let theta = PI / faces as f64;
    let mut across = [0.0; 3];
    if faces == 1 {
        across = [0, 1, 2].map(|c| first[c] + last[c] - 2.0 * p[c]);
    } else {
        let cotangent = 1.0 / (0.5 * theta).tan();
        let end = (theta.sin() - cotangent) / (1.0 + 2.0 * theta.cos());
        let own = -cotangent - 2.0 * end;
        for (j, neighbour) in ring.iter().enumerate() {
            let inner = if j == 0 || j == faces { end } else { (j as f64 * theta).sin() };
            (0..3).for_each(|c| across[c] += inner * neighbour[c]);
        }
        (0..3).for_each(|c| across[c] += own * p[c]);
    }
    (point, Tangents([minus(*first, *last), across]).normal())
}

/// A functional on the surroundings of a vertex: weights of the vertex, its neighbours, the vertices behind them in the same
/// direction, and those between two directions.
type Functional = [f64; 4];

/// Action of a step on the surroundings of a vertex of valence 4 or 6 with the values of a wave of the given `harmonic` around
/// it: `(p, r, s, t)` stand for the values `p`, `r cos jθ`, `s cos jθ` and `t cos (j + ½)θ`, `θ = 2π harmonic/n`.
fn surroundings(valence: usize, harmonic: f64, weights: &BlobWeights) -> [Functional; 4] {
    let BlobWeights { a, b, c, d, e, f, aa, bb, dd, ee, ff, .. } = *weights;
    let theta = TAU * harmonic / valence as f64;
    let around = |steps: f64| 2.0 * (steps * theta).cos();
    let half = around(0.5);
    // A wave around the vertex vanishes at the vertex.
    let constant = if harmonic == 0.0 { 1.0 } else { 0.0 };
    let (own, ring) = if valence == 4 { (aa, bb) } else { (a, b) };
    let neighbour = if valence == 4 {
        [ff * constant, f + dd * around(1.0) + 0.5 * ee * around(2.0), e, c * half]
    } else {
        let far = 0.5 * e * around(3.0);
        [f * constant, f + d * around(1.0) + c * around(2.0) + far, e, c * half]
    };
    [
        [own * constant, valence as f64 * ring * constant, 0.0, 0.0],
        neighbour,
        [b * constant, a + b * around(1.0), b, b * half],
        [d * constant, f * half + c * around(1.5), c * half, d + e * around(1.0)],
    ]
}

/// Number of levels after which `v` is 1 to the last bit.
const LEVELS: usize = 60;

/// The functional of a harmonic at a level with parameter `v`, carried back from the level at which it no longer changes.
fn functional(valence: usize, harmonic: f64, v: f64) -> Functional {
    let later: Vec<f64> =
        std::iter::successors(Some(v), |v| Some((0.5 * (1.0 + v)).sqrt())).take(LEVELS).collect();
    let mut functional = [0.0, 1.0, 0.0, 0.0];
    for v in later.into_iter().rev() {
        let step = surroundings(valence, harmonic, &BlobWeights::new(v));
        functional = [0, 1, 2, 3].map(|j| (0..4).map(|i| functional[i] * step[i][j]).sum());
        // Constants are preserved; for tangents only the direction matters.
        let size: f64 = if harmonic == 0.0 { functional.iter().sum() } else { functional[1] };
        functional = functional.map(|value| value / size);
    }
    functional
}

fn blob(scheme: Scheme, v: f64, connectivity: &Connectivity, points: &[[f64; 3]]) -> Limit {
    // After one more step, all neighbours of the vertices are regular.
    let (finer, next) = (connectivity.split(), (0.5 * (1.0 + v)).sqrt());
    let finer_points = refined(scheme, v, connectivity, points);
    let at = |vertex: u32| finer_points[vertex as usize];
    let functionals = [4, 6].map(|valence| [0.0, 1.0].map(|harmonic| functional(valence, harmonic, next)));
    let of_vertex = |vertex: u32| {
        let valence = finer.valence(vertex);
        let [position, tangent] = functionals[usize::from(valence == 6)];
        let mut point = at(vertex).map(|x| position[0] * x);
        let mut tangents = Tangents::default();
        for (j, out) in finer.around(vertex).enumerate() {
            let angle = TAU * j as f64 / valence as f64;
            // The ring of a neighbour, from the vertex on: the neighbour before, between, behind, between, the neighbour after.
            let mut ring = finer.ring_from(finer.twin(out)).skip(3);
            let neighbours = [Some(finer.end(out)), ring.next(), ring.next()];
            for (kind, neighbour) in neighbours.into_iter().enumerate() {
                let Some(neighbour) = neighbour.map(at) else { continue };
                let share = position[kind + 1] / valence as f64;
                (0..3).for_each(|c| point[c] += share * neighbour[c]);
                let angle = if kind == 2 { angle + PI / valence as f64 } else { angle };
                tangents.add(tangent[kind + 1], angle, neighbour);
            }
        }
        (point, tangents.normal())
    };
    let (points, normals) = (0..points.len() as u32).map(of_vertex).unzip();
    Limit { points, normals: Some(normals) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Both masks at `v = 1`, as fractions.
    #[test]
    fn limit_masks_of_the_stationary_step() {
        let near = |valence: usize, wanted: [f64; 4]| {
            let found = functional(valence, 0.0, 1.0);
            let n = valence as f64;
            let found = [found[0], found[1] / n, found[2] / n, found[3] / n];
            for (a, b) in found.into_iter().zip(wanted) {
                assert!((a - b).abs() < 1e-15, "{found:?}");
            }
        };
        near(6, [12.0 / 35.0, 43.0 / 420.0, 1.0 / 840.0, 1.0 / 168.0]);
        near(4, [21897.0, 11008.0, 128.0, 640.0].map(|x| x / 69001.0));
    }

    #[test]
    fn tangents_of_the_regular_vertex_are_those_of_the_box_spline() {
        let [_, ring, behind, between] = functional(6, 1.0, 1.0);
        assert_eq!(ring, 1.0);
        assert!((behind - 1.0 / 31.0).abs() < 1e-15, "{behind}");
        assert!((between - 7.0 / (31.0 * 3.0_f64.sqrt())).abs() < 1e-15, "{between}");
    }
}
