//! The leading eigenvector of an operator that is known by its products with vectors.

use super::dense::{Eigenpairs, Matrix, SUBSPACE_RESIDUAL, full_eigenpairs};
use super::kernels::{add_scaled, dot, largest_magnitude};

/// Most products of [`leading_vector`]: twice those that a space takes whose eigenvalues fall by a tenth behind the first.
const VECTOR_STEPS: usize = 96;

/// Leading eigenvector of unit length of a symmetric positive semi-definite operator, by Lanczos' iteration with full
/// orthogonalisation from `near`: the projection of `near` if the eigenvalue is multiple.
/// `None` if the relative residual stays above `10⁻¹¹`, as in [`iterate_subspace`](super::dense::iterate_subspace), whose single column this is in fewer products, and
/// once `apply` returns `None`.
///
/// Cost: `k` products, and `2 k² n` multiply-adds.
///
/// Source: Golub and Van Loan, *Matrix Computations*, 4th edition, section 10.1.
pub fn leading_vector(apply: impl Fn(&[f64]) -> Option<Vec<f64>>, near: &[f64]) -> Option<Vec<f64>> {
    let n = near.len();
    let mut basis: Vec<f64> = Vec::new();
    let (mut diagonal, mut below) = (Vec::new(), Vec::new());
    let mut next = near.to_vec();
    unit(&mut next)?;
    for step in 1..=VECTOR_STEPS.min(n) {
        let mut image = apply(&next)?;
        diagonal.push(dot(&next, &image));
        basis.extend_from_slice(&next);
        // The second time takes out parts of the basis left by cancellation.
        for _ in 0..2 {
            for column in basis.chunks_exact(n) {
                let inside = dot(column, &image);
                add_scaled(&mut image, -inside, column);
            }
        }
        let length = unit(&mut image);
        let (value, y) = leading_of_tridiagonal(&diagonal, &below)?;
        let residual = length.unwrap_or(0.0) * y[step - 1].abs();
        if residual <= SUBSPACE_RESIDUAL * value {
            let mut vector = vec![0.0; n];
            basis.chunks_exact(n).zip(&y).for_each(|(column, y)| add_scaled(&mut vector, *y, column));
            return Some(vector);
        }
        below.push(length?);
        next = image;
    }
    None
}

/// Scales to unit length and returns the length before; `None` for zero, subnormal numbers and those that are not finite.
fn unit(x: &mut [f64]) -> Option<f64> {
    let largest = largest_magnitude(x);
    largest.is_normal().then(|| x.iter_mut().for_each(|x| *x /= largest))?;
    let length = dot(x, x).sqrt();
    x.iter_mut().for_each(|x| *x /= length);
    Some(largest * length)
}

/// Largest eigenvalue of a symmetric tridiagonal matrix, with its eigenvector of unit length.
fn leading_of_tridiagonal(diagonal: &[f64], below: &[f64]) -> Option<(f64, Vec<f64>)> {
    let m = diagonal.len();
    let mut t = Matrix::zeros(m, m);
    diagonal.iter().enumerate().for_each(|(i, value)| t[(i, i)] = *value);
    below.iter().enumerate().for_each(|(i, value)| t[(i + 1, i)] = *value);
    let Eigenpairs { values, vectors } = full_eigenpairs(&t, 1).ok()?;
    Some((*values.first()?, vectors.as_slice().to_vec()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dense::multiply;
    use crate::dense::tests::covariance;

    #[test]
    fn the_leading_vector_is_that_of_the_full_solver() {
        for (n, spectrum) in [
            (150, (|i| 1.0 / (1.0 + i as f64).powi(2)) as fn(usize) -> f64),
            (200, |i| 1.0 / (1.0 + 0.1 * i as f64)),
            (60, |i| if i == 0 { 1e-200 } else { 0.0 }),
        ] {
            let s = covariance(n, spectrum);
            let full = full_eigenpairs(&s, 1).unwrap().vectors;
            let apply =
                |x: &[f64]| Some(multiply(&s, &Matrix::from_column_slice(n, 1, x)).as_slice().to_vec());
            let start: Vec<f64> = (0..n).map(|i| 1.0 + (i as f64).sin()).collect();
            let found = leading_vector(apply, &start).unwrap();
            let cosine = dot(&found, full.as_slice());
            assert!((1.0 - cosine.abs()).abs() < 1e-14, "n = {n}: {cosine}");
            assert!((dot(&found, &found) - 1.0).abs() < 1e-13);
        }
        // Of an eigenvalue that is double, the vector nearest to the start.
        let double =
            |x: &[f64]| Some(x.iter().enumerate().map(|(i, x)| if i < 2 { *x } else { 0.3 * x }).collect());
        let found = leading_vector(double, &[0.6, 0.8, 1.0, -2.0]).unwrap();
        assert!((found[0] - 0.6).abs() < 1e-10 && (found[1] - 0.8).abs() < 1e-10, "{found:?}");
        assert_eq!(leading_vector(double, &[0.0; 4]), None);
        assert_eq!(leading_vector(|_| None, &[1.0; 4]), None);
        assert_eq!(leading_vector(|x: &[f64]| Some(vec![f64::NAN; x.len()]), &[1.0; 4]), None);
    }
}
