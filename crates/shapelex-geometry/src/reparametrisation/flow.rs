//! Smooth maps of the sphere to itself, and their derivatives by the coefficients.

use super::harmonics::{Table, count, degree_of};
use crate::rotation::Rotation;
use crate::vector::{cross, dot, norm};

/// Number of steps of a flow.
const STEPS: usize = 4;

/// A map `γ(x) = R_o · flow(R_i x)` of the unit sphere.
#[derive(Debug, Clone, PartialEq)]
pub struct Reparametrisation {
    /// Rotation after the flow: to the parameters of the shape.
    pub outer: Rotation,
    /// Rotation before the flow: from the common parameters.
    pub inner: Rotation,
    degree: usize,
    /// Coefficients of the gradient and of the curl of every harmonic, in radians of root mean square displacement.
    coefficients: Vec<f64>,
}

/// Where a map takes a point, and the derivatives of that point by the coefficients.
#[derive(Debug, Clone, Default)]
pub struct Moved {
    /// The image after the flow, before the outer rotation.
    pub flowed: [f64; 3],
    /// `∂ flowed/∂ a_j` for the wanted coefficients.
    pub by_coefficient: Vec<[f64; 3]>,
}

/// Working memory of a map.
#[derive(Debug)]
pub struct Workspace {
    table: Table,
    fields: Vec<[f64; 3]>,
}

impl Workspace {
    /// For maps of at most this degree.
    pub fn new(degree: usize) -> Self {
        Self { table: Table::new(degree), fields: vec![[0.0; 3]; 2 * count(degree)] }
    }
}

impl Default for Reparametrisation {
    fn default() -> Self {
        Self::rotation(Rotation::NONE)
    }
}

impl Reparametrisation {
    /// A rotation of the parameters.
    pub fn rotation(outer: Rotation) -> Self {
        Self { outer, inner: Rotation::NONE, degree: 0, coefficients: Vec::new() }
    }

    /// Highest degree of its fields; 0 for rotations.
    pub fn degree(&self) -> usize {
        self.degree
    }

    /// Its coefficients: gradient and curl of every harmonic in turn.
    pub fn coefficients(&self) -> &[f64] {
        &self.coefficients
    }

    /// The same map with other coefficients of fields up to `degree`, `2 count(degree)` of them.
    #[must_use]
    pub fn with_coefficients(&self, degree: usize, coefficients: Vec<f64>) -> Self {
        debug_assert_eq!(coefficients.len(), 2 * count(degree));
        Self { degree, coefficients, ..self.clone() }
    }

    /// The same map, its coefficients padded with zeros up to `degree`.
    #[must_use]
    pub fn raised(&self, degree: usize) -> Self {
        let mut coefficients = self.coefficients.clone();
        coefficients.resize(2 * count(degree.max(self.degree)), 0.0);
        Self { degree: degree.max(self.degree), coefficients, ..self.clone() }
    }

    /// Root mean square displacement of its field, in radians.
    pub fn displacement(&self) -> f64 {
        self.coefficients.iter().map(|part| part * part).sum::<f64>().sqrt()
    }

    /// `γ(x)`.
    pub fn apply(&self, x: [f64; 3], work: &mut Workspace) -> [f64; 3] {
        let mut y = self.inner.apply(x);
        if self.degree > 0 {
            for _ in 0..STEPS {
                let velocity = self.fields(y, work);
                y = stepped(y, velocity).0;
            }
        }
        self.outer.apply(y)
    }

    /// The flow of `x`, with derivatives by the coefficients whose indices are `wanted`.
    pub fn jet(&self, x: [f64; 3], wanted: &[usize], work: &mut Workspace, moved: &mut Moved) {
        let mut y = self.inner.apply(x);
        moved.by_coefficient.clear();
        moved.by_coefficient.resize(wanted.len(), [0.0; 3]);
        for _ in 0..STEPS {
            let velocity = self.fields(y, work);
            let slope = self.slope(y, work);
            let (next, length) = stepped(y, velocity);
            for (by, &index) in moved.by_coefficient.iter_mut().zip(wanted) {
                let field = work.fields[index];
                let change = [0, 1, 2].map(|c| by[c] + (dot(slope[c], *by) + field[c]) / STEPS as f64);
                let along = dot(next, change);
                *by = [0, 1, 2].map(|c| (change[c] - along * next[c]) / length);
            }
            y = next;
        }
        moved.flowed = y;
    }

    /// Fills the table and the fields at `y`, and sums the field of the map.
    fn fields(&self, y: [f64; 3], work: &mut Workspace) -> [f64; 3] {
        work.table.fill(y);
        let mut velocity = [0.0; 3];
        for j in 0..count(work.table.degree()) {
            let l = degree_of(j) as f64;
            let scale = (l * (l + 1.0)).sqrt().recip();
            let (gradient, value) = (work.table.gradient(j), work.table.value(j));
            let along = [0, 1, 2].map(|c| scale * (gradient[c] - l * value * y[c]));
            work.fields[2 * j] = along;
            work.fields[2 * j + 1] = cross(y, along);
            if let [a, b] = self.coefficients.get(2 * j..2 * j + 2).unwrap_or(&[]) {
                let round = work.fields[2 * j + 1];
                (0..3).for_each(|c| velocity[c] += a * along[c] + b * round[c]);
            }
        }
        velocity
    }

    /// The derivative of the field in space at `y`, row by row, after [`Self::fields`].
    fn slope(&self, y: [f64; 3], work: &Workspace) -> [[f64; 3]; 3] {
        // ∇Y and its derivative for the gradients, those of Y l for the parts along y, and ∇Y for the curls.
        let (mut radial, mut radial_slope) = (0.0, [0.0; 3]);
        let (mut round, mut bent, mut round_bent) = ([0.0; 3], [0.0; 6], [0.0; 6]);
        for j in 0..self.coefficients.len() / 2 {
            let l = degree_of(j) as f64;
            let scale = (l * (l + 1.0)).sqrt().recip();
            let [a, b] = [scale * self.coefficients[2 * j], scale * self.coefficients[2 * j + 1]];
            if a == 0.0 && b == 0.0 {
                continue;
            }
            let (gradient, second) = (work.table.gradient(j), work.table.second(j));
            radial += a * l * work.table.value(j);
            (0..3).for_each(|c| radial_slope[c] += a * l * gradient[c]);
            (0..3).for_each(|c| round[c] += b * gradient[c]);
            (0..6).for_each(|i| {
                bent[i] += a * second[i];
                round_bent[i] += b * second[i];
            });
        }
        let place = [[0, 1, 2], [1, 3, 4], [2, 4, 5]];
        let mut slope = [[0.0; 3]; 3];
        for e in 0..3 {
            let column = [0, 1, 2].map(|c| round_bent[place[c][e]]);
            let unit = [0, 1, 2].map(|c| f64::from(u8::from(c == e)));
            let (turned, moved) = (cross(y, column), cross(unit, round));
            for c in 0..3 {
                slope[c][e] =
                    bent[place[c][e]] - radial * unit[c] - y[c] * radial_slope[e] + turned[c] + moved[c];
            }
        }
        slope
    }
}

/// One step along a field, back on the sphere, and the length before.
fn stepped(y: [f64; 3], velocity: [f64; 3]) -> ([f64; 3], f64) {
    let reached = [0, 1, 2].map(|c| y[c] + velocity[c] / STEPS as f64);
    let length = norm(reached);
    (reached.map(|part| part / length), length)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn map() -> Reparametrisation {
        let coefficients = (0..2 * count(3)).map(|i| 0.08 * (1.3 * i as f64).sin()).collect();
        Reparametrisation::rotation(Rotation::about([0.3, -0.2, 0.9])).with_coefficients(3, coefficients)
    }

    #[test]
    fn derivatives_by_coefficients_are_those_of_differences() {
        let (map, mut work, mut moved) = (map(), Workspace::new(3), Moved::default());
        let x = Rotation::about([0.4, 1.0, 0.2]).apply([0.0, 0.0, 1.0]);
        let wanted: Vec<usize> = (0..2 * count(3)).collect();
        map.jet(x, &wanted, &mut work, &mut moved);
        let back = map.outer.inverse();
        let direct = back.apply(map.apply(x, &mut work));
        assert!((0..3).all(|c| (direct[c] - moved.flowed[c]).abs() < 1e-12));
        for j in 0..wanted.len() {
            let at = |by: f64, work: &mut Workspace| {
                let mut coefficients = map.coefficients().to_vec();
                coefficients[j] += by;
                back.apply(map.with_coefficients(3, coefficients).apply(x, work))
            };
            let (a, b) = (at(1e-5, &mut work), at(-1e-5, &mut work));
            for c in 0..3 {
                let expected = (a[c] - b[c]) / 2e-5;
                assert!((moved.by_coefficient[j][c] - expected).abs() < 1e-8, "{j} {c}");
            }
        }
    }

    #[test]
    fn fields_have_a_mean_square_of_one() {
        let nodes = super::super::Nodes::new(3);
        let mut work = Workspace::new(3);
        for j in 0..2 * count(3) {
            let mut sum = 0.0;
            for (x, weight) in nodes.points.iter().zip(&nodes.weights) {
                Reparametrisation::default().fields(*x, &mut work);
                sum += weight * dot(work.fields[j], work.fields[j]);
            }
            assert!((sum - 1.0).abs() < 1e-2, "{j} {sum}");
        }
    }
}
