//! Least-squares fits of control vertices to triangle meshes and point clouds.
//!
//! ```text
//! min_C Σ_i w_i |σ_C(x_i) − q_i|²,   x_i the point of the surface nearest to q_i
//! ```
//!
//! Nearest points and control vertices are updated alternately from a start; every round lowers the sum. A term
//! `ε ‖C − C_before‖²` in `L₂`, which vanishes at convergence, keeps the parts that the points do not determine in place.

use super::basis::SubdivisionBasis;
use super::control::ControlMesh;
use crate::GeometryError;
use crate::mesh::TriangleMesh;
use crate::mesh_tree::{Foot, NearestTriangles};
use crate::vector::{bounds, minus, norm};
use shapelex_numeric::bounded::{Allowance, Stop, never};
use shapelex_numeric::dense::{Definite, Matrix, leading_eigenpairs};
use shapelex_numeric::operator::SymmetricOperator;
use shapelex_numeric::sparse::SparseRows;

/// A point to be fitted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Target {
    /// Position of the point.
    pub point: [f64; 3],
    /// Weight in the sum; non-negative.
    pub weight: f64,
}

/// A fitted surface.
#[derive(Debug, Clone)]
pub struct SubdivisionFit {
    /// Control vertices, `N × 3`.
    pub rows: Matrix,
    /// `√(Σ w_i d_i²)` for the distances `d_i` from the surface, with `Σ w_i = 1`.
    pub residual: f64,
    /// Largest distance from the surface.
    pub largest: f64,
}

/// Weight of the previous control vertices: below their determination by the points, above rounding.
const PROXIMITY: f64 = 1e-6;

/// Prepared fits of surfaces of one basis.
#[derive(Debug)]
pub struct Fitting<'a> {
    basis: &'a SubdivisionBasis,
    operator: SparseRows,
    /// Control vertices of a sphere-like surface, and the mesh on the unit sphere with the vertices of its level.
    sphere: Option<(Matrix, TriangleMesh)>,
}

impl<'a> Fitting<'a> {
    /// Prepares fits of surfaces of `basis`, with its control mesh and level. Cost: that of [`SubdivisionBasis::operator`].
    pub fn new(basis: &'a SubdivisionBasis, control: &ControlMesh, level: usize) -> Self {
        let sphere = match control {
            ControlMesh::Named(start) => control.sphere().map(|mesh| {
                let rows = Matrix::from_fn(mesh.vertices.len(), 3, |i, c| mesh.vertices[i][c]);
                (rows, super::control::StartMesh { splits: start.splits + level, ..*start }.mesh())
            }),
            ControlMesh::Faces(_) => None,
        };
        Self { basis, operator: basis.operator(), sphere }
    }

    /// Positions of the vertices of the level, for control vertices `N × 3`.
    pub fn points(&self, rows: &Matrix) -> Vec<[f64; 3]> {
        self.basis.points(rows)
    }

    /// Whether the control mesh provides a start.
    pub fn has_start(&self) -> bool {
        self.sphere.is_some()
    }

    /// Control vertices of the ellipsoid with the mean and the second moments of the targets; `None` if the control mesh is not
    /// named after a sphere-like body.
    ///
    /// # Errors
    /// [`GeometryError::NoLength`] if all targets coincide.
    pub fn ellipsoid(&self, targets: &[Target]) -> Result<Option<Matrix>, GeometryError> {
        let Some((sphere, _)) = &self.sphere else { return Ok(None) };
        let of_sphere: Vec<Target> =
            self.basis.points(sphere).into_iter().map(|point| Target { point, weight: 1.0 }).collect();
        let (centre, scatter) = moments(&of_sphere);
        let size = (scatter.trace() / 3.0).sqrt();
        let (mean, scatter) = moments(targets);
        let extent = scatter.trace().sqrt();
        if !(extent > 0.0) {
            return Err(GeometryError::NoLength { extent });
        }
        let axes = leading_eigenpairs(&scatter, 3)?;
        let thinnest = 1e-3 * extent;
        let root = |i: usize, j: usize| -> f64 {
            (0..3)
                .map(|k| {
                    let length = axes.values[k].max(0.0).sqrt().max(thinnest) / size;
                    axes.vectors[(i, k)] * length * axes.vectors[(j, k)]
                })
                .sum()
        };
        let map = Matrix::from_fn(3, 3, root);
        let place = |i: usize, c: usize| {
            mean[c] + (0..3).map(|j| map[(c, j)] * (sphere[(i, j)] - centre[j])).sum::<f64>()
        };
        Ok(Some(Matrix::from_fn(sphere.nrows(), 3, place)))
    }

    /// A start for the fit: one solve with the targets assigned to given directions from the centre of a sphere. `None` if the
    /// control mesh is not named after a sphere-like body.
    ///
    /// # Errors
    /// As for [`Self::ellipsoid`].
    pub fn at_directions(
        &self,
        targets: &[Target],
        directions: &[[f64; 3]],
    ) -> Result<Option<Matrix>, GeometryError> {
        let Some((_, sphere)) = &self.sphere else { return Ok(None) };
        let Some(start) = self.ellipsoid(targets)? else { return Ok(None) };
        let index = NearestTriangles::new(&sphere.vertices, &sphere.faces);
        let feet: Vec<Foot> = directions.iter().filter_map(|direction| index.nearest(*direction)).collect();
        self.solve(targets, &feet, &start).map(Some)
    }

    /// Fits from `start` in `turns` rounds. Cost per round: a search and `750` products per target, and `N³/3`.
    ///
    /// # Errors
    /// An error of the normal equations if they have no solution.
    pub fn fit(
        &self,
        targets: &[Target],
        start: Matrix,
        turns: usize,
    ) -> Result<SubdivisionFit, GeometryError> {
        self.fit_until(targets, start, turns, &never)
    }

    /// As [`Self::fit`], with cancellation: `stop` is checked at every round and within the search; the current result is returned.
    ///
    /// # Errors
    /// As for [`Self::fit`].
    pub fn fit_until(
        &self,
        targets: &[Target],
        start: Matrix,
        turns: usize,
        stop: Stop<'_>,
    ) -> Result<SubdivisionFit, GeometryError> {
        let mut rows = start;
        for _ in 0..turns {
            let feet = self.feet(targets, &rows, stop);
            if stop() {
                break;
            }
            rows = self.solve(targets, &feet, &rows)?;
        }
        let feet = self.feet(targets, &rows, stop);
        let total: f64 = targets.iter().map(|target| target.weight).sum();
        let squares: f64 =
            targets.iter().zip(&feet).map(|(target, foot)| target.weight * foot.distance.powi(2)).sum();
        let largest = feet.iter().map(|foot| foot.distance).fold(0.0, f64::max);
        Ok(SubdivisionFit { rows, residual: (squares / total).sqrt(), largest })
    }

    /// The points of the surface nearest to the targets.
    fn feet(&self, targets: &[Target], rows: &Matrix, stop: Stop<'_>) -> Vec<Foot> {
        let points = self.basis.points(rows);
        let index = NearestTriangles::new(&points, self.basis.finest().faces());
        let mut allowed = Allowance::new(targets.len(), stop);
        let asked = targets.iter().take_while(|_| allowed.take());
        asked.filter_map(|target| index.nearest(target.point)).collect()
    }

    /// The control vertices for which the surface points `feet` are closest to the targets.
    fn solve(&self, targets: &[Target], feet: &[Foot], before: &Matrix) -> Result<Matrix, GeometryError> {
        let size = before.nrows();
        let total: f64 = targets.iter().map(|target| target.weight).sum();
        let mut normal = self.basis.gram().matrix() * PROXIMITY;
        let mut right = before.clone();
        self.basis.gram().apply(right.as_mut_slice());
        right *= PROXIMITY;
        let mut row = vec![0.0; size];
        let mut met: Vec<usize> = Vec::new();
        for (target, foot) in targets.iter().zip(feet) {
            let share = target.weight / total;
            for (corner, part) in self.basis.finest().faces()[foot.face].into_iter().zip(foot.weights) {
                for &(i, value) in self.operator.row(corner as usize) {
                    met.push(i as usize);
                    row[i as usize] += part * value;
                }
            }
            met.sort_unstable();
            met.dedup();
            for (k, &j) in met.iter().enumerate() {
                let factor = share * row[j];
                (0..3).for_each(|c| right[(j, c)] += factor * target.point[c]);
                // Columns ascend, so this is the lower triangle.
                let column = &mut normal.as_mut_slice()[j * size..][..size];
                met[k..].iter().for_each(|&i| column[i] += factor * row[i]);
            }
            met.drain(..).for_each(|i| row[i] = 0.0);
        }
        Ok(Definite::new(&normal)?.solve(&right))
    }
}

/// Weighted mean, and second moments about it.
fn moments(targets: &[Target]) -> ([f64; 3], Matrix) {
    let total: f64 = targets.iter().map(|target| target.weight).sum();
    let weighted = |of: &dyn Fn(&Target) -> f64| -> f64 {
        targets.iter().map(|target| target.weight * of(target)).sum::<f64>() / total
    };
    let mean = [0, 1, 2].map(|c| weighted(&|target| target.point[c]));
    let scatter = Matrix::from_fn(3, 3, |i, j| {
        weighted(&|target| (target.point[i] - mean[i]) * (target.point[j] - mean[j]))
    });
    (mean, scatter)
}

/// Minimum number of targets for a mesh: if it has fewer faces, they are divided.
const MIN_TARGETS: usize = 20_000;
/// Maximum number of parts per edge of a face.
const MAX_PARTS: usize = 16;

/// Targets on the faces of a mesh, weighted by the area they represent, with directions interpolated from the corners.
pub fn mesh_targets(mesh: &TriangleMesh, directions: Option<&[[f64; 3]]>) -> (Vec<Target>, Vec<[f64; 3]>) {
    let parts = MIN_TARGETS.div_ceil(mesh.faces.len().max(1)).isqrt().clamp(1, MAX_PARTS);
    let (mut targets, mut mixed) = (Vec::new(), Vec::new());
    for (face, area) in mesh.faces.iter().zip(mesh.face_areas()) {
        let mix = |list: &[[f64; 3]], shares: [f64; 3]| {
            [0, 1, 2].map(|c| (0..3).map(|i| shares[i] * list[face[i] as usize][c]).sum::<f64>())
        };
        for shares in crate::surface::fit::centroids(parts) {
            let weight = area / (parts * parts) as f64;
            targets.push(Target { point: mix(&mesh.vertices, shares), weight });
            if let Some(directions) = directions {
                let direction = mix(directions, shares);
                let length = norm(direction);
                mixed.push(if length > 0.0 { direction.map(|x| x / length) } else { direction });
            }
        }
    }
    (targets, mixed)
}

/// Largest distance of the vertices of a fitted surface from the bounding box of the targets, relative to its diagonal: a
/// measure of how far the surface departs where there are no points.
pub fn overshoot(points: &[[f64; 3]], targets: &[Target]) -> f64 {
    let Some([low, high]) = bounds(targets.iter().map(|target| target.point)) else { return 0.0 };
    let beyond =
        |point: &[f64; 3]| norm([0, 1, 2].map(|c| (low[c] - point[c]).max(point[c] - high[c]).max(0.0)));
    points.iter().map(beyond).fold(0.0, f64::max) / norm(minus(high, low))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::subdivision::{LoopWeights, Scheme, Subdivision};

    /// A bean: it has no symmetry that could hide an error.
    fn bean(point: &[f64; 3]) -> [f64; 3] {
        let [x, y, z] = *point;
        [3.0 * x + 0.4 * z * z, 1.5 * y + 0.2 * x * z, z + 0.5 * x * x]
    }

    #[test]
    fn points_of_a_surface_of_the_space_are_met() {
        let connectivity = ControlMesh::Named("octahedron/1".parse().unwrap());
        let subdivision = Subdivision { scheme: Scheme::Loop(LoopWeights::Original), level: 3, connectivity };
        let basis = SubdivisionBasis::new(&subdivision).unwrap();
        let control = subdivision.connectivity.sphere().unwrap();
        let rows = Matrix::from_fn(18, 3, |i, c| bean(&control.vertices[i])[c]);
        let mesh = basis.mesh(&rows);
        let fitting = Fitting::new(&basis, &subdivision.connectivity, 3);
        let (targets, _) = mesh_targets(&mesh, None);
        let start = fitting.ellipsoid(&targets).unwrap().unwrap();
        // Every round lowers the sum; the ellipsoid leaves a 40th of the length.
        let residuals = [0, 1, 2, 4, 8, 16, 32]
            .map(|turns| fitting.fit(&targets, start.clone(), turns).unwrap().residual);
        assert!(residuals.is_sorted_by(|before, after| before > after), "{residuals:?}");
        assert!(residuals[6] < 1e-3 * 6.0, "{residuals:?}");
        // With given surface points, one round finds the control vertices.
        let directions: Vec<[f64; 3]> = fitting.sphere.as_ref().unwrap().1.vertices.clone();
        let at_vertices: Vec<Target> =
            mesh.vertices.iter().map(|&point| Target { point, weight: 1.0 }).collect();
        let found = fitting.at_directions(&at_vertices, &directions).unwrap().unwrap();
        assert!((found - rows).amax() < 1e-4);
        assert!(overshoot(&mesh.vertices, &targets) < 1e-2);
    }
}
