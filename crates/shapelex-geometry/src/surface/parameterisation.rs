//! Spherical parameterisation: longitude and colatitude on a closed mesh of genus 0.
//!
//! ```text
//! Σ_j w_ij (h_i − h_j) = δ_iS − δ_iN          h grows from the north pole N to the south pole S
//! Σ_j w_ij (φ_i − φ_j ± 2π) = 0               except at the poles; 2π on the edges that cross a path from N to S
//! cos πv = 1 − 2 A(h),   u = φ/2π             A(h): fraction of the area where the first function is smaller
//! ```
//!
//! If the weights `w` are cotangents, `h` and `φ` are the coordinates of a conformal map onto a cylinder. A conformal map onto
//! the sphere would shrink the ends of a long shape to nothing, so the colatitude follows the area instead: on a round sphere
//! nothing changes, and on any other shape every ring of latitude holds its share of the area. Weights that are not positive
//! are raised to a small positive one, so that both functions have extrema at the poles only.
//!
//! Sources: Angenent, Haker, Tannenbaum and Kikinis 1999 (the map by a source and a sink), Brechbühler, Gerig and Kübler 1995
//! (colatitude and longitude as solutions with a jump along a path between the poles).

use std::f64::consts::{PI, TAU};

use crate::GeometryError;
use crate::mesh::{Connectivity, TriangleMesh};
use crate::vector::{cross, dot, minus, norm};
use shapelex_numeric::bounded::{Stop, never};
use shapelex_numeric::dense::{Matrix, leading_eigenpairs};

/// Minimum weight of an edge, relative to the mean.
const MIN_WEIGHT: f64 = 1e-2;
/// Maximum number of iterations for the two systems: meshes of 100 000 vertices take a thousand.
const MAX_ITERATIONS: usize = 20_000;
/// Relative residual of the two systems.
const RESIDUAL: f64 = 1e-12;

/// `u ∈ [0, 1)` and `v ∈ [0, 1]` of every vertex of a closed `mesh` of genus 0.
///
/// `poles` are two vertices. Default: the two that are farthest apart along the longest principal axis of the vertices, with
/// the north pole at the end towards which the dominant coordinate of the axis grows. `u` is 0 at the path between the
/// poles and grows counter-clockwise as seen from outside above the north pole. Cost: two solves by conjugate gradients,
/// some `√vertices` products each.
///
/// # Errors
/// [`GeometryError::Mesh`], [`GeometryError::NotASphere`], [`GeometryError::NoLength`] for a mesh without extent, and
/// [`GeometryError::Poles`] for poles that are equal or neighbours.
pub fn spherical(mesh: &TriangleMesh, poles: Option<[u32; 2]>) -> Result<Vec<[f64; 2]>, GeometryError> {
    spherical_until(mesh, poles, &never)
}

/// As [`spherical`], with cancellation: once `stop` returns true, the result must be discarded.
///
/// # Errors
/// As for [`spherical`].
pub fn spherical_until(
    mesh: &TriangleMesh,
    poles: Option<[u32; 2]>,
    stop: Stop<'_>,
) -> Result<Vec<[f64; 2]>, GeometryError> {
    let connectivity = mesh.connectivity()?;
    let genus = connectivity.genus();
    if genus > 0 {
        return Err(GeometryError::NotASphere { genus });
    }
    let poles = match poles {
        Some(poles) => poles,
        None => farthest(mesh)?,
    };
    let count = mesh.vertices.len();
    let path = path(&connectivity, poles).filter(|path| path.len() > 2);
    let path = path.ok_or(GeometryError::Poles { poles, count })?;
    let graph = Graph { weights: weights(mesh, &connectivity), connectivity: &connectivity, stop };
    let height = graph.height(poles)?;
    let longitude = graph.longitude(poles, &path)?;
    let colatitude = colatitudes(mesh, &height, poles);
    let turn = |phi: f64| {
        let u = (phi / TAU).rem_euclid(1.0);
        if u < 1.0 { u } else { 0.0 }
    };
    Ok(longitude.into_iter().zip(colatitude).map(|(phi, v)| [turn(phi), v]).collect())
}

/// The two vertices at the ends of the longest principal axis.
fn farthest(mesh: &TriangleMesh) -> Result<[u32; 2], GeometryError> {
    let count = mesh.vertices.len() as f64;
    let mean = [0, 1, 2].map(|c| mesh.vertices.iter().map(|vertex| vertex[c]).sum::<f64>() / count);
    let scatter = Matrix::from_fn(3, 3, |i, j| {
        mesh.vertices.iter().map(|vertex| (vertex[i] - mean[i]) * (vertex[j] - mean[j])).sum()
    });
    let axis = leading_eigenpairs(&scatter, 1)?.vectors;
    let sign = axis.iter().fold(0.0, |most: f64, a| if a.abs() > most.abs() { *a } else { most }).signum();
    let along = |vertex: &[f64; 3]| sign * (0..3).map(|c| axis[(c, 0)] * vertex[c]).sum::<f64>();
    let places: Vec<f64> = mesh.vertices.iter().map(along).collect();
    let best = |better: fn(f64, f64) -> bool| {
        (1..places.len()).fold(0, |best, i| if better(places[i], places[best]) { i } else { best })
    };
    let (north, south) = (best(|a, b| a > b), best(|a, b| a < b));
    let extent = places[north] - places[south];
    if !(extent > 0.0) {
        return Err(GeometryError::NoLength { extent });
    }
    Ok([north as u32, south as u32])
}

/// A shortest path from pole to pole, so that only consecutive vertices are neighbours.
fn path(connectivity: &Connectivity, [north, south]: [u32; 2]) -> Option<Vec<u32>> {
    let distances = connectivity.distances(south);
    let mut path = vec![north];
    let mut left = *distances.get(north as usize)?;
    distances.get(south as usize)?;
    while let Some(steps) = left.filter(|steps| *steps > 0) {
        let nearer = |vertex: &u32| distances[*vertex as usize] == Some(steps - 1);
        path.push(connectivity.ring(path[path.len() - 1]).find(nearer)?);
        left = Some(steps - 1);
    }
    Some(path)
}

/// Half the sum of the cotangents opposite to each edge, in the order of the rings; at least [`MIN_WEIGHT`] of their mean.
fn weights(mesh: &TriangleMesh, connectivity: &Connectivity) -> Vec<Vec<f64>> {
    let cotangent = |a: u32, b: u32, at: u32| {
        let [a, b, at] = [a, b, at].map(|vertex| mesh.vertices[vertex as usize]);
        let (p, q) = (minus(a, at), minus(b, at));
        let value = dot(p, q) / norm(cross(p, q));
        if value.is_finite() { value } else { 0.0 }
    };
    let mut weights: Vec<Vec<f64>> = (0..mesh.vertices.len() as u32)
        .map(|vertex| {
            let ring: Vec<u32> = connectivity.ring(vertex).collect();
            let weight = |k: usize| {
                let (before, after) = (ring[(k + ring.len() - 1) % ring.len()], ring[(k + 1) % ring.len()]);
                0.5 * (cotangent(vertex, ring[k], before) + cotangent(vertex, ring[k], after))
            };
            (0..ring.len()).map(weight).collect()
        })
        .collect();
    let all = weights.iter().flatten();
    let mean = all.clone().map(|weight| weight.abs()).sum::<f64>() / all.count() as f64;
    weights.iter_mut().flatten().for_each(|weight| *weight = weight.max(MIN_WEIGHT * mean));
    weights
}

struct Graph<'a> {
    connectivity: &'a Connectivity,
    weights: Vec<Vec<f64>>,
    stop: Stop<'a>,
}

impl Graph<'_> {
    fn count(&self) -> usize {
        self.weights.len()
    }

    fn edges(&self, vertex: usize) -> impl Iterator<Item = (usize, f64)> + '_ {
        let ring = self.connectivity.ring(vertex as u32).map(|neighbour| neighbour as usize);
        ring.zip(self.weights[vertex].iter().copied())
    }

    /// `h`, which is 0 at the north pole.
    fn height(&self, [north, south]: [u32; 2]) -> Result<Vec<f64>, GeometryError> {
        let mut right = vec![0.0; self.count()];
        right[south as usize] = 1.0;
        self.solve(&[north], right)
    }

    /// `φ`, which is 0 at the second vertex of the path.
    fn longitude(&self, poles: [u32; 2], path: &[u32]) -> Result<Vec<f64>, GeometryError> {
        let mut right = vec![0.0; self.count()];
        for step in path.windows(3) {
            let &[before, vertex, after] = step else { continue };
            let ring: Vec<u32> = self.connectivity.ring(vertex).collect();
            let place = |of: u32| ring.iter().position(|neighbour| *neighbour == of);
            let (Some(begin), Some(end)) = (place(before), place(after)) else { continue };
            // Counter-clockwise from the previous to the next vertex of the path: the west side, where the longitude ends.
            let between = (1..ring.len()).map(|k| (begin + k) % ring.len()).take_while(|k| *k != end);
            for k in between {
                if poles.contains(&ring[k]) {
                    continue;
                }
                let jump = self.weights[vertex as usize][k] * TAU;
                right[vertex as usize] -= jump;
                right[ring[k] as usize] += jump;
            }
        }
        self.solve(&[poles[0], poles[1], path[1]], right)
    }

    /// Solves `Σ_j w_ij (x_i − x_j) = right_i` with `x = 0` at the `pinned` vertices, by conjugate gradients with diagonal
    /// scaling. For a longitude, the poles are left out.
    fn solve(&self, pinned: &[u32], mut right: Vec<f64>) -> Result<Vec<f64>, GeometryError> {
        let count = self.count();
        let mut free = vec![true; count];
        pinned.iter().for_each(|vertex| free[*vertex as usize] = false);
        // A single pinned vertex keeps its edges. Of three, two are the poles, whose edges do not count.
        let outside: &[u32] = if pinned.len() > 1 { &pinned[..2] } else { &[] };
        let counts = |vertex: usize| !outside.contains(&(vertex as u32));
        let diagonal: Vec<f64> = (0..count)
            .map(|i| self.edges(i).filter(|(j, _)| counts(*j)).map(|(_, weight)| weight).sum::<f64>())
            .collect();
        let apply = |x: &[f64], y: &mut [f64]| {
            for i in 0..count {
                let around: f64 =
                    self.edges(i).map(|(j, weight)| if free[j] { weight * x[j] } else { 0.0 }).sum();
                y[i] = if free[i] { diagonal[i] * x[i] - around } else { 0.0 };
            }
        };
        (0..count).filter(|i| !free[*i]).for_each(|i| right[i] = 0.0);
        let scaled = |r: &[f64]| -> Vec<f64> { r.iter().zip(&diagonal).map(|(r, d)| r / d).collect() };
        let product = |a: &[f64], b: &[f64]| -> f64 { a.iter().zip(b).map(|(a, b)| a * b).sum() };
        let (mut x, mut r) = (vec![0.0; count], right);
        let mut z = scaled(&r);
        let (mut p, mut rho) = (z.clone(), product(&r, &z));
        let wanted = RESIDUAL * RESIDUAL * rho;
        let mut q = vec![0.0; count];
        let iterations = MAX_ITERATIONS.min(10 * count);
        for _ in 0..iterations {
            if rho <= wanted || (self.stop)() {
                return Ok(x);
            }
            apply(&p, &mut q);
            let step = rho / product(&p, &q);
            for i in 0..count {
                x[i] += step * p[i];
                r[i] -= step * q[i];
            }
            z = scaled(&r);
            let next = product(&r, &z);
            p.iter_mut().zip(&z).for_each(|(p, z)| *p = z + next / rho * *p);
            rho = next;
        }
        Err(GeometryError::NoConvergence { iterations, residual: (rho / wanted).sqrt() * RESIDUAL })
    }
}

/// `v` from the fraction of the area with a smaller height. A third of every face belongs to each of its vertices.
fn colatitudes(mesh: &TriangleMesh, height: &[f64], poles: [u32; 2]) -> Vec<f64> {
    let mut shares = vec![0.0; height.len()];
    for (face, area) in mesh.faces.iter().zip(mesh.face_areas()) {
        face.iter().for_each(|vertex| shares[*vertex as usize] += area / 3.0);
    }
    let mut order: Vec<usize> = (0..height.len()).collect();
    order.sort_by(|a, b| height[*a].total_cmp(&height[*b]).then(a.cmp(b)));
    let total: f64 = shares.iter().sum();
    let (mut before, mut colatitudes) = (0.0, vec![0.0; height.len()]);
    for vertex in order {
        // The middle of the vertex's own share.
        let part = ((before + 0.5 * shares[vertex]) / total).clamp(0.0, 1.0);
        before += shares[vertex];
        colatitudes[vertex] = (1.0 - 2.0 * part).clamp(-1.0, 1.0).acos() / PI;
    }
    colatitudes[poles[0] as usize] = 0.0;
    colatitudes[poles[1] as usize] = 1.0;
    colatitudes
}
