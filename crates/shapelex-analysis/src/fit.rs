//! The best rotation and scale of one shape onto another.

use crate::metric::{dot, norm};
use shapelex_numeric::dense::{Matrix, svd};

/// Freedom of a fit besides the position.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Fit {
    /// `d`.
    pub dimension: usize,
    /// Rotation.
    pub rotates: bool,
    /// Scale.
    pub scaling: Scaling,
}

/// Scale of a fit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
pub enum Scaling {
    /// Shapes keep their sizes.
    None,
    /// The scale that brings the shape nearest to the mean (full Procrustes fit).
    Full,
    /// Unit size (partial Procrustes fit).
    Partial,
}

impl Fit {
    /// `A` of the best fit of the whitened shape `x` to `mean`.
    pub fn matrix(&self, x: &[f64], mean: &[f64]) -> Matrix {
        let d = self.dimension;
        let h = cross_product(mean, x, d);
        let rotation = if self.rotates { nearest_rotation(&h) } else { Matrix::identity(d, d) };
        match self.scaling {
            Scaling::None => rotation,
            Scaling::Full => {
                let correlation = rotation.dot(&h);
                rotation * (correlation / dot(x, x))
            }
            Scaling::Partial => rotation * norm(x).recip(),
        }
    }
}

/// `A x` for every point of the coordinate-major shape `x`.
pub fn transform(matrix: &Matrix, x: &[f64]) -> Vec<f64> {
    let d = matrix.nrows();
    let n = x.len() / d;
    let mut y = vec![0.0; x.len()];
    for c in 0..d {
        for e in 0..d {
            let factor = matrix[(c, e)];
            for k in 0..n {
                y[c * n + k] += factor * x[e * n + k];
            }
        }
    }
    y
}

/// The rotation that maximises `tr(RᵀH)`, `det R = 1`.
pub(crate) fn nearest_rotation(h: &Matrix) -> Matrix {
    let d = h.nrows();
    if d == 2 {
        let (c, s) = (h[(0, 0)] + h[(1, 1)], h[(1, 0)] - h[(0, 1)]);
        let length = f64::hypot(c, s);
        if length == 0.0 {
            return Matrix::identity(2, 2);
        }
        let (c, s) = (c / length, s / length);
        return Matrix::from_row_slice(2, 2, &[c, -s, s, c]);
    }
    // Only entries that are not finite have no decomposition.
    let Some(svd) = svd(h.clone(), true, true) else { return Matrix::identity(d, d) };
    let (u, vt) = (svd.u.expect("asked for"), svd.v_t.expect("asked for"));
    let mut signs = Matrix::identity(d, d);
    let last = svd.singular_values.imin();
    signs[(last, last)] = (&u * &vt).determinant().signum();
    u * signs * vt
}

/// `max tr(RᵀH)` over the matrices `R` that `fit` allows: the score of a placement.
pub(super) fn best_correlation(h: &Matrix, fit: Fit) -> f64 {
    if !fit.rotates {
        h.trace()
    } else if fit.dimension == 2 {
        f64::hypot(h[(0, 0)] + h[(1, 1)], h[(1, 0)] - h[(0, 1)])
    } else {
        nearest_rotation(h).dot(h)
    }
}

/// `H = Σ_n m[n] y[n]ᵀ`, `d × d`.
pub(crate) fn cross_product(m: &[f64], y: &[f64], d: usize) -> Matrix {
    let n = m.len() / d;
    Matrix::from_fn(d, d, |c, e| dot(&m[c * n..(c + 1) * n], &y[e * n..(e + 1) * n]))
}
