//! Hessians of a blurred volume, one slice at a time, and their smallest eigenvalues.

use std::f64::consts::TAU;

use shapelex_geometry::vector::{cross, dot};

use crate::field::filter::{across_rows, along_row, gaussian_kernel};
use crate::field::{Image, Value};

/// Orders along x, y, z of the second derivatives `xx, yy, zz, xy, xz, yz`.
const ORDERS: [[usize; 3]; 6] = [[2, 0, 0], [0, 2, 0], [0, 0, 2], [1, 1, 0], [1, 0, 1], [0, 1, 1]];

/// Second derivatives of a volume by separable kernels.
pub(super) struct Hessians<'a, T> {
    image: &'a Image<T>,
    /// Kernels by axis and order.
    kernels: [[Vec<f64>; 3]; 3],
}

impl<'a, T: Value> Hessians<'a, T> {
    /// `sigma`: blur in cells along x, y, z.
    pub(super) fn new(image: &'a Image<T>, sigma: [f64; 3]) -> Self {
        let kernels = sigma.map(|sigma| [0, 1, 2].map(|order| gaussian_kernel(sigma, order)));
        Self { image, kernels }
    }

    /// Calls `visit(j, [xx, yy, zz, xy, xz, yz])` with rows of second derivatives along the axes, for all rows of slice `k`.
    ///
    /// Memory: three slices in double precision. Cost: 15 separable passes.
    pub(super) fn slice(&self, k: usize, mut visit: impl FnMut(usize, [Vec<f64>; 6])) {
        let [_, rows, slices] = self.image.size();
        let across_slices = |order: usize| -> Vec<Vec<f64>> {
            let kernel = &self.kernels[2][order];
            (0..rows).map(|j| across_rows(|z| self.image.row(j, z), k, slices, kernel)).collect()
        };
        let filtered = [0, 1, 2].map(across_slices);
        for j in 0..rows {
            let derivative = |[x, y, z]: [usize; 3]| {
                let row = across_rows(|y| &filtered[z][y], j, rows, &self.kernels[1][y]);
                along_row(&row, &self.kernels[0][x])
            };
            visit(j, ORDERS.map(derivative));
        }
    }
}

/// Smallest eigenvalue and a unit eigenvector of the symmetric matrix `[xx, yy, zz, xy, xz, yz]`; a zero vector for multiples of
/// the identity, which have no direction.
///
/// ```text
/// λ = m + 2 p cos(φ + 2π/3),   m = tr H/3,   B = (H − m I)/p,   p² = tr (H − m I)²/6,   cos 3φ = det B/2
/// ```
///
/// The eigenvector is the largest cross product of two rows of `H − λI`. On sheets, where `λ` is far from the other two,
/// relative errors are some units in the last place; where the smaller two coincide, 10⁻⁸.
pub(super) fn smallest_eigenpair(matrix: [f64; 6]) -> (f64, [f64; 3]) {
    // Entries of at most 1 have no overflow in third powers.
    let size = matrix.iter().fold(0.0_f64, |most, entry| most.max(entry.abs()));
    if size == 0.0 {
        return (0.0, [0.0; 3]);
    }
    let [xx, yy, zz, xy, xz, yz] = matrix.map(|entry| entry / size);
    let mean = (xx + yy + zz) / 3.0;
    let [x, y, z] = [xx, yy, zz].map(|entry| entry - mean);
    let spread = ((x * x + y * y + z * z + 2.0 * (xy * xy + xz * xz + yz * yz)) / 6.0).sqrt();
    if spread == 0.0 {
        return (size * mean, [0.0; 3]);
    }
    let determinant = dot([x, xy, xz], cross([xy, y, yz], [xz, yz, z]));
    let angle = (0.5 * determinant / spread.powi(3)).clamp(-1.0, 1.0).acos() / 3.0;
    let lowest = 2.0 * spread * (angle + TAU / 3.0).cos();
    let rows = [[x - lowest, xy, xz], [xy, y - lowest, yz], [xz, yz, z - lowest]];
    let products = [cross(rows[0], rows[1]), cross(rows[0], rows[2]), cross(rows[1], rows[2])];
    let longer = |a: [f64; 3], b: [f64; 3]| if dot(b, b) > dot(a, a) { b } else { a };
    let direction = longer(longer(products[0], products[1]), products[2]);
    let length = dot(direction, direction).sqrt();
    let unit = if length > 0.0 { direction.map(|entry| entry / length) } else { [0.0; 3] };
    (size * (mean + lowest), unit)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `H = Σ λ_i q_i q_iᵀ` for an orthogonal matrix of rows `q`.
    fn matrix(values: [f64; 3], q: [[f64; 3]; 3]) -> [f64; 6] {
        let entry = |a: usize, b: usize| (0..3).map(|i| values[i] * q[i][a] * q[i][b]).sum();
        [entry(0, 0), entry(1, 1), entry(2, 2), entry(0, 1), entry(0, 2), entry(1, 2)]
    }

    #[test]
    fn smallest_eigenpairs_are_those_of_the_construction() {
        let q = [[2.0, 3.0, 6.0], [3.0, -6.0, 2.0], [6.0, 2.0, -3.0]].map(|row| row.map(|x| x / 7.0));
        // The angle of a double smallest value is known to half of the digits.
        for (values, tolerance) in [
            ([-5.0, 1.0, 2.0], 1e-14),
            ([-5.0, 1.0, 1.0], 1e-14),
            ([1.0, 2.0, 30.0], 1e-13),
            ([1.0, 1.0, 4.0], 3e-8),
            ([-5e200, 1e200, 2e200], 1e-14),
            ([-5e-200, 1e-200, 2e-200], 1e-14),
        ] {
            let (value, vector) = smallest_eigenpair(matrix(values, q));
            let largest = values.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
            assert!((value - values[0]).abs() < tolerance * largest, "{value} for {values:?}");
            // In the space of all eigenvectors of the smallest value.
            let inside: f64 =
                (0..3).filter(|i| values[*i] == values[0]).map(|i| dot(vector, q[i]).powi(2)).sum();
            assert!((inside - 1.0).abs() < tolerance.max(1e-7), "{vector:?} for {values:?}");
        }
        assert_eq!(smallest_eigenpair([2.0, 2.0, 2.0, 0.0, 0.0, 0.0]), (2.0, [0.0; 3]));
        assert_eq!(smallest_eigenpair([0.0; 6]), (0.0, [0.0; 3]));
        assert_eq!(smallest_eigenpair([1.0, -3.0, 2.0, 0.0, 0.0, 0.0]).1.map(f64::abs), [0.0, 1.0, 0.0]);
    }
}
