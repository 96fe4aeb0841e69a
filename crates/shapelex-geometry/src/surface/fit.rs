//! Least-squares fits of surfaces to points with parameters.
//!
//! ```text
//! min_c Σ_i w_i |σ_c(u_i, v_i) − p_i|²,   Σ w_i = 1
//! ```
//!
//! The normal equations are solved for all rows at once. Points of a surface of the space, at their parameters, reproduce
//! its rows.

use std::f64::consts::{PI, TAU};

use super::basis::SurfaceBasis;
use crate::GeometryError;
use crate::mesh::TriangleMesh;
use crate::vector::{far_origin, minus, norm};
use shapelex_numeric::dense::{Definite, Matrix};

/// A fitted surface.
#[derive(Debug, Clone)]
pub struct SurfaceFit {
    /// Rows of the surface, `N × 3`.
    pub rows: Matrix,
    /// Root mean square residual, `√(Σ w_i |σ(u_i, v_i) − p_i|²)`.
    pub residual: f64,
    /// Mean residual, `Σ w_i |σ(u_i, v_i) − p_i|`.
    pub mean: f64,
    /// Largest residual, `max_i |σ(u_i, v_i) − p_i|`.
    pub largest: f64,
}

/// A point with its parameters and weight.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfaceSample {
    /// Parameters `u` and `v`.
    pub parameters: [f64; 2],
    /// Target position.
    pub point: [f64; 3],
    /// Weight in the sum; non-negative.
    pub weight: f64,
}

/// Maximum ratio of the squared `L₂` norm of a surface to that of its samples. Beyond it the fit is ill-posed: the surface is
/// hardly determined between the points and would run away there.
const MAX_UNSEEN: f64 = 1e4;

/// Fits a surface of `basis`. Cost: `N³/3` for the equations, and 256 products per point.
///
/// # Errors
/// [`GeometryError::Undetermined`] if the points are too few or leave gaps.
pub fn fit(basis: &SurfaceBasis, samples: &[SurfaceSample]) -> Result<SurfaceFit, GeometryError> {
    let points: Vec<[f64; 3]> = samples.iter().map(|sample| sample.point).collect();
    let origin = far_origin(points.iter()).filter(|_| basis.reproduces_constants());
    let Some(origin) = origin else { return fit_near(basis, samples) };
    let about = |sample: &SurfaceSample| SurfaceSample { point: minus(sample.point, origin), ..*sample };
    let mut found = fit_near(basis, &samples.iter().map(about).collect::<Vec<_>>())?;
    basis.translate(&mut found.rows, origin);
    Ok(found)
}

fn fit_near(basis: &SurfaceBasis, samples: &[SurfaceSample]) -> Result<SurfaceFit, GeometryError> {
    let size = basis.gram().size();
    let undetermined = GeometryError::Undetermined { points: samples.len(), needed: size };
    let total: f64 = samples.iter().map(|sample| sample.weight).sum();
    if samples.len() < size || !(total > 0.0) {
        return Err(undetermined);
    }
    let place = |sample: &SurfaceSample| merged(basis.weights(sample.parameters[0], sample.parameters[1]));
    let (mut normal, mut right) = (Matrix::zeros(size, size), Matrix::zeros(size, 3));
    for sample in samples {
        let (share, place) = (sample.weight / total, place(sample));
        for (position, &(i, a)) in place.iter().enumerate() {
            (0..3).for_each(|c| right[(i, c)] += share * a * sample.point[c]);
            // Rows ascend, so this is the lower triangle.
            for &(j, b) in &place[position..] {
                normal[(j, i)] += share * a * b;
            }
        }
    }
    let factored = Definite::new(&normal).ok().filter(|normal| most_unseen(basis, normal) < MAX_UNSEEN);
    let rows = factored.ok_or(undetermined)?.solve(&right);
    let (mut squares, mut mean, mut largest) = (0.0, 0.0, 0.0_f64);
    for sample in samples {
        let place = place(sample);
        let value = [0, 1, 2].map(|c| place.iter().map(|(i, a)| a * rows[(*i, c)]).sum());
        let apart = norm(minus(value, sample.point));
        squares += sample.weight / total * apart.powi(2);
        mean += sample.weight / total * apart;
        largest = largest.max(apart);
    }
    Ok(SurfaceFit { rows, residual: squares.sqrt(), mean, largest })
}

/// Number of steps of the power iteration of [`most_unseen`], which needs the order of magnitude only.
const STEPS: usize = 12;

/// `max_x ⟨x, Φx⟩/⟨x, Sx⟩` for the normal matrix `S`: the largest ratio of the squared `L₂` norm to that at the points.
fn most_unseen(basis: &SurfaceBasis, normal: &Definite) -> f64 {
    // Waves of all lengths, so that the start is not orthogonal to directions that the points leave undetermined.
    let mut x = Matrix::from_fn(basis.gram().size(), 1, |i, _| (1.7 * (i * i) as f64).sin());
    let mut ratio = 0.0;
    for _ in 0..STEPS {
        basis.gram().apply(x.as_mut_slice());
        let image = normal.solve(&x);
        ratio = image.norm();
        x = image / ratio;
        if !(ratio.is_finite() && ratio > 0.0) {
            return f64::INFINITY;
        }
    }
    ratio
}

/// Minimum and maximum number of parts of a triangle along its edges.
const PARTS: [usize; 2] = [2, 64];
/// Approximate maximum number of samples of a mesh: the triangles of larger meshes are small enough undivided.
const MAX_SAMPLES: usize = 1_000_000;

/// Samples on the faces of a mesh, two per knot interval along an edge, with the index of their face and weighted by the area
/// they represent. The fit thus covers the whole mesh, not its vertices alone, and does not run away between them.
///
/// `parameters` are those of the vertices. Within a triangle they are interpolated linearly; on spheres, along the directions
/// from the centre.
pub fn mesh_samples(
    basis: &SurfaceBasis,
    mesh: &TriangleMesh,
    parameters: &[[f64; 2]],
) -> Vec<(usize, SurfaceSample)> {
    let most = ((MAX_SAMPLES / mesh.faces.len().max(1)).isqrt()).clamp(1, PARTS[1]);
    let mut samples = Vec::new();
    for (index, (face, area)) in mesh.faces.iter().zip(mesh.face_areas()).enumerate() {
        let at = |vertex: u32| parameters[vertex as usize];
        let corners = unwrapped(basis, face.map(at));
        let parts = parts(basis, &corners).clamp(PARTS[0].min(most), most);
        let weight = area / (parts * parts) as f64;
        for shares in centroids(parts) {
            let mix = |i: usize, c: usize| shares[i] * mesh.vertices[face[i] as usize][c];
            let point = [0, 1, 2].map(|c| (0..3).map(|i| mix(i, c)).sum());
            samples
                .push((index, SurfaceSample { parameters: between(basis, &corners, shares), point, weight }));
        }
    }
    samples
}

/// Barycentric coordinates of the centroids of `parts²` equal parts of a triangle.
pub fn centroids(parts: usize) -> impl Iterator<Item = [f64; 3]> {
    let at = move |i: usize, j: usize, third: f64| {
        let [a, b] = [i, j].map(|k| (k as f64 + third) / parts as f64);
        [a, b, 1.0 - a - b]
    };
    let upright = (0..parts).flat_map(move |i| (0..parts - i).map(move |j| at(i, j, 1.0 / 3.0)));
    let reversed =
        (0..parts).flat_map(move |i| (0..(parts - i).saturating_sub(1)).map(move |j| at(i, j, 2.0 / 3.0)));
    upright.chain(reversed)
}

/// The corners of a triangle, moved next to its first one across the ends of closed directions and through a seam.
fn unwrapped(basis: &SurfaceBasis, mut corners: [[f64; 2]; 3]) -> [[f64; 2]; 3] {
    let closed = basis.extent().topology.closed();
    let [u, v] = corners[0];
    for corner in &mut corners[1..] {
        let turns = if closed[0] { (u - corner[0]).round() } else { 0.0 };
        corner[0] += turns;
        if turns != 0.0 {
            corner[1] = basis.seam().beyond(corner[1]);
        }
        if closed[1] {
            corner[1] += (v - corner[1]).round();
        }
    }
    corners
}

/// Number of parts into which an edge is divided.
fn parts(basis: &SurfaceBasis, corners: &[[f64; 2]; 3]) -> usize {
    let spread = |i: usize| {
        let values = corners.map(|corner| corner[i]);
        let most =
            values.iter().fold(f64::MIN, |m, x| m.max(*x)) - values.iter().fold(f64::MAX, |m, x| m.min(*x));
        2.0 * most * basis.extent().intervals[i] as f64
    };
    spread(0).max(spread(1)).ceil() as usize
}

/// Interpolates the parameters of corners that are [`unwrapped`].
fn between(basis: &SurfaceBasis, corners: &[[f64; 2]; 3], shares: [f64; 3]) -> [f64; 2] {
    if basis.extent().topology.has_poles() {
        let directions = corners.map(spherical_direction);
        return spherical_parameters([0, 1, 2].map(|c| (0..3).map(|i| shares[i] * directions[i][c]).sum()));
    }
    let mix = |c: usize| (0..3).map(|i| shares[i] * corners[i][c]).sum::<f64>();
    let (mut u, mut v) = (mix(0), mix(1));
    let [round_u, round_v] = basis.extent().topology.closed();
    if round_u && !(0.0..1.0).contains(&u) {
        u = u.rem_euclid(1.0).min(1.0_f64.next_down());
        v = basis.seam().beyond(v);
    }
    if round_v {
        v = v.rem_euclid(1.0);
    }
    [u, v]
}

/// Sorts by row and merges repeated rows.
fn merged(mut weights: Vec<(usize, f64)>) -> Vec<(usize, f64)> {
    weights.sort_unstable_by_key(|(row, _)| *row);
    weights.dedup_by(|next, kept| {
        let same = next.0 == kept.0;
        if same {
            kept.1 += next.1;
        }
        same
    });
    weights
}

/// Point of the unit sphere at longitude `u` in whole turns and colatitude `v` in half turns.
pub fn spherical_direction([u, v]: [f64; 2]) -> [f64; 3] {
    let ((su, cu), (sv, cv)) = ((TAU * u).sin_cos(), (PI * v).sin_cos());
    [sv * cu, sv * su, cv]
}

/// Parameters on a sphere for the direction of `point` from its centre: longitude `u ∈ [0, 1)`, from the x axis towards y, and
/// colatitude `v ∈ [0, 1]`, from the z axis.
pub fn spherical_parameters([x, y, z]: [f64; 3]) -> [f64; 2] {
    let u = y.atan2(x) / TAU;
    // A value that rounds up to a whole turn becomes 0.
    let u = if u < 0.0 { (u + 1.0) % 1.0 } else { u };
    [u, x.hypot(y).atan2(z) / PI]
}
