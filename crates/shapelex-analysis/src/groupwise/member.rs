//! One shape on its way into correspondence: its reparametrisation, its pose, and steps that lower its cost.

use shapelex_geometry::reparametrisation::Reparametrisation;
use shapelex_geometry::reparametrisation::flow::{Moved, Workspace};
use shapelex_geometry::reparametrisation::harmonics::degree_of;
use shapelex_geometry::reparametrisation::spherical::SphericalShape;
use shapelex_geometry::rotation::Rotation;
use shapelex_numeric::dense::{Definite, Matrix, svd, transpose_multiply};

use super::super::AnalysisError;
use super::domain::Domain;
use super::model::Model;
use super::{DEGENERATE, NO_EXTENT};

/// Rotation of a shape in space, row by row.
pub(super) type Pose = [[f64; 3]; 3];

/// A shape with its current parameters and pose.
#[derive(Debug, Clone)]
pub(super) struct Member {
    pub shape: SphericalShape,
    /// Factor that is applied to all points: sizes are compared or not.
    pub scale: f64,
    pub map: Reparametrisation,
    pub pose: Pose,
    /// Coefficients in its current parameters and pose, `3 B`.
    pub coefficients: Vec<f64>,
}

/// Weights of a step.
#[derive(Debug, Clone, Copy)]
pub(super) struct Penalty {
    /// Weight of the squared coefficients, in the squared unit of the shapes.
    pub weight: f64,
}

impl Penalty {
    /// Weight of one coefficient: the square of the Laplacian of its harmonic, relative to that of degree 1.
    pub(super) fn of(self, index: usize) -> f64 {
        let l = degree_of(index / 2) as f64;
        self.weight * (0.5 * l * (l + 1.0)).powi(2)
    }

    /// Sum over all coefficients of a map.
    pub(super) fn total(self, map: &Reparametrisation) -> f64 {
        map.coefficients().iter().enumerate().map(|(i, a)| self.of(i) * a * a).sum()
    }
}

/// Coefficients that a step may change: all up to a degree but the curls of degree 1, which are rotations.
pub(super) fn free(degree: usize) -> Vec<usize> {
    let all = 0..2 * shapelex_geometry::reparametrisation::harmonics::count(degree);
    all.filter(|&i| i >= 6 || i % 2 == 0).collect()
}

/// Shares of a step that are tried.
const SHARES: [f64; 4] = [1.0, 0.5, 0.25, 0.0625];
/// Part of the diagonal of the normal equations that keeps them definite.
const RIDGE: f64 = 1e-6;

pub(super) fn posed(pose: &Pose, x: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|c| (0..3).map(|e| pose[c][e] * x[e]).sum())
}

/// `R P`.
fn turned(rotation: Rotation, pose: &Pose) -> Pose {
    let columns = [0, 1, 2].map(|e| rotation.apply([pose[0][e], pose[1][e], pose[2][e]]));
    [0, 1, 2].map(|c| [0, 1, 2].map(|e| columns[e][c]))
}

impl Member {
    /// A shape with its parameters and in its pose as given.
    ///
    /// # Errors
    /// With index 0: [`AnalysisError::NoExtent`] for a point, [`AnalysisError::Degenerate`] for a line or a flat shape.
    pub(super) fn new(domain: &Domain, shape: SphericalShape) -> Result<Self, AnalysisError> {
        let pose = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let map = Reparametrisation::default();
        let mut member = Self { shape, scale: 1.0, map, pose, coefficients: Vec::new() };
        let points = member.points(domain, &member.map);
        let size = points.iter().flatten().fold(0.0_f64, |most, x| most.max(x.abs()));
        member.refresh(domain);
        let values = Matrix::from_column_slice(Domain::SIZE, 3, &member.coefficients);
        let extents = svd(values, false, false).map(|found| found.singular_values);
        let none = |norm: f64| AnalysisError::NoExtent { index: 0, norm, size };
        let extents =
            extents.filter(|list| list.iter().all(|value| value.is_finite())).ok_or_else(|| none(0.0))?;
        let (most, least) = extents.iter().fold((0.0_f64, f64::INFINITY), |(a, b), x| (a.max(*x), b.min(*x)));
        if !(most > NO_EXTENT * size) {
            return Err(none(most));
        }
        if !(least > DEGENERATE * most) {
            let class = "the correspondence of surfaces: it is flat".into();
            return Err(AnalysisError::Degenerate { index: 0, class, sigma: least / most });
        }
        Ok(member)
    }

    /// Area of the shape with its parameters as given.
    pub(super) fn area(&self, domain: &Domain) -> f64 {
        let normals = domain.nodes.points.iter().map(|x| self.shape.jet(*x).normal(*x));
        let length = |n: [f64; 3]| n.iter().map(|part| part * part).sum::<f64>().sqrt();
        normals.zip(&domain.nodes.weights).map(|(normal, weight)| weight * length(normal)).sum()
    }

    /// Points at the nodes under `map`, as given and scaled.
    pub(super) fn points(&self, domain: &Domain, map: &Reparametrisation) -> Vec<[f64; 3]> {
        let mut work = Workspace::new(map.degree());
        let at = |x: &[f64; 3]| self.shape.point(map.apply(*x, &mut work)).map(|part| part * self.scale);
        domain.nodes.points.iter().map(at).collect()
    }

    /// Coefficients under `map` in `pose`.
    fn coefficients_at(&self, domain: &Domain, map: &Reparametrisation, pose: &Pose) -> Vec<f64> {
        let points = self.points(domain, map);
        let mut values = Matrix::zeros(points.len(), 3);
        for (q, point) in points.iter().enumerate() {
            let at = posed(pose, *point);
            (0..3).for_each(|c| values[(q, c)] = at[c]);
        }
        domain.coefficients(&mut values).as_slice().to_vec()
    }

    /// Brings the coefficients up to date with parameters and pose.
    pub(super) fn refresh(&mut self, domain: &Domain) {
        self.coefficients = self.coefficients_at(domain, &self.map, &self.pose);
    }

    /// Cost under a model.
    pub(super) fn cost(&self, model: &Model, penalty: Penalty) -> f64 {
        model.cost(&self.coefficients) + penalty.total(&self.map)
    }

    /// One Gauss–Newton step of rotation of the parameters, pose and the `wanted` coefficients, shortened until the cost falls.
    /// Returns the cost afterwards, and whether it fell.
    pub(super) fn step(
        &mut self,
        domain: &Domain,
        model: &Model,
        wanted: &[usize],
        penalty: Penalty,
    ) -> (f64, bool) {
        let before = self.cost(model, penalty);
        let jacobian = self.jacobian(domain, wanted);
        let apart: Vec<f64> = self.coefficients.iter().zip(&model.mean).map(|(x, mean)| x - mean).collect();
        let apart = Matrix::from_vec(apart.len(), 1, apart);
        let weighed = model.weigh(&jacobian);
        let mut normal = transpose_multiply(&weighed, &jacobian);
        let mut right = -transpose_multiply(&weighed, &apart);
        for (j, &index) in wanted.iter().enumerate() {
            let weight = penalty.of(index);
            normal[(6 + j, 6 + j)] += weight;
            right[6 + j] -= weight * self.map.coefficients()[index];
        }
        let largest = (0..normal.nrows()).map(|i| normal[(i, i)]).fold(0.0, f64::max);
        for i in 0..normal.nrows() {
            normal[(i, i)] = normal[(i, i)] * (1.0 + RIDGE) + RIDGE * largest;
        }
        let Ok(factor) = Definite::new(&normal) else { return (before, false) };
        let change = factor.solve(&right);
        for share in SHARES {
            let part: Vec<f64> = change.iter().map(|x| share * x).collect();
            let (map, pose, found) = self.moved(domain, wanted, &part);
            let cost = model.cost(&found) + penalty.total(&map);
            if cost < before {
                (self.map, self.pose, self.coefficients) = (map, pose, found);
                return (cost, true);
            }
        }
        (before, false)
    }

    /// Map, pose and coefficients after a change: rotation of the parameters, rotation in space, and the `wanted` coefficients.
    pub(super) fn moved(
        &self,
        domain: &Domain,
        wanted: &[usize],
        change: &[f64],
    ) -> (Reparametrisation, Pose, Vec<f64>) {
        let mut coefficients = self.map.coefficients().to_vec();
        wanted.iter().enumerate().for_each(|(j, &index)| coefficients[index] += change[6 + j]);
        let mut map = self.map.with_coefficients(self.map.degree(), coefficients);
        map.outer = map.outer.after(Rotation::about([change[0], change[1], change[2]]));
        let pose = turned(Rotation::about([change[3], change[4], change[5]]), &self.pose);
        let found = self.coefficients_at(domain, &map, &pose);
        (map, pose, found)
    }

    /// Derivatives of the coefficients, `3 B × (6 + J)`: by rotation of the parameters, rotation in space, and `wanted` coefficients.
    pub(super) fn jacobian(&self, domain: &Domain, wanted: &[usize]) -> Matrix {
        let (count, size, fields) = (Domain::NODES, Domain::SIZE, 3 + wanted.len());
        let (mut work, mut moved) = (Workspace::new(self.map.degree()), Moved::default());
        let mut values = Matrix::zeros(count, 3 * fields);
        for (q, x) in domain.nodes.points.iter().enumerate() {
            self.map.jet(*x, wanted, &mut work, &mut moved);
            let jet = self.shape.jet(self.map.outer.apply(moved.flowed));
            // Rows: pose · slope · outer rotation, times the scale.
            let slope = self.slope(&jet.slope);
            let [a, b, c] = moved.flowed;
            let turns = [[0.0, -c, b], [c, 0.0, -a], [-b, a, 0.0]];
            for (j, change) in turns.iter().chain(&moved.by_coefficient).enumerate() {
                let by = posed(&slope, *change);
                (0..3).for_each(|e| values[(q, 3 * j + e)] = by[e]);
            }
        }
        let found = domain.coefficients(&mut values);
        let mut jacobian = Matrix::zeros(3 * size, 6 + wanted.len());
        for j in 0..fields {
            let column = if j < 3 { j } else { j + 3 };
            for e in 0..3 {
                jacobian.view_mut((e * size, column), (size, 1)).copy_from(&found.column(3 * j + e));
            }
        }
        let part = |e: usize, i: usize| self.coefficients[e * size + i];
        for i in 0..size {
            let [x, y, z] = [part(0, i), part(1, i), part(2, i)];
            for (axis, by) in [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]].iter().enumerate() {
                (0..3).for_each(|e| jacobian[(e * size + i, 3 + axis)] = by[e]);
            }
        }
        jacobian
    }

    /// `scale · pose · slope · outer rotation`.
    fn slope(&self, slope: &[[f64; 3]; 3]) -> [[f64; 3]; 3] {
        let columns = [0, 1, 2].map(|i| {
            let unit = [0, 1, 2].map(|c| f64::from(u8::from(c == i)));
            posed(&self.pose, posed(slope, self.map.outer.apply(unit)))
        });
        [0, 1, 2].map(|c| [0, 1, 2].map(|i| self.scale * columns[i][c]))
    }
}

/// The rotation `R` without reflection that brings `x` nearest to `mean`, and `tr(R Σ w x meanᵀ)`; both are centred.
pub(super) fn nearest_pose(cross: &Matrix) -> Option<(Pose, f64)> {
    let found = svd(cross.clone(), true, true)?;
    let (left, right) = (found.u?, found.v_t?);
    let mut order = [0, 1, 2];
    order.sort_by(|&i, &j| found.singular_values[j].total_cmp(&found.singular_values[i]));
    let sign = (left.determinant() * right.determinant()).signum();
    let signs = [1.0, 1.0, sign];
    let score = (0..3).map(|i| signs[i] * found.singular_values[order[i]]).sum();
    let entry =
        |c: usize, e: usize| (0..3).map(|i| signs[i] * left[(c, order[i])] * right[(order[i], e)]).sum();
    Some(([0, 1, 2].map(|c| [0, 1, 2].map(|e| entry(c, e))), score))
}
