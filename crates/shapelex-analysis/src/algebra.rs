//! The matrix algebra of the transformations that may act on atoms.
//!
//! ```text
//! 𝓑 = span{E_1 … E_b} ⊂ R^{c×c},   I ∈ 𝓑,   A, B ∈ 𝓑 ⇒ AB, Aᵀ ∈ 𝓑,   tr(E_iᵀE_j) = c δ_ij
//! ```
//!
//! The class is closed under products, so that the code of a transformed shape is the transformed code. It is closed under
//! transposition, so that the nearest combination of atoms transforms along with the shape. `uniform_scaling`,
//! `non_uniform_scaling`, `scaled_rotation`, `linear` and their variants with translation are of this kind; shears and
//! reflections are not.
//!
//! Here a shape is an `m × c` matrix `X`, one column per coordinate; the shape transformed by `B` is `X Bᵀ`. Its *normal
//! form* is `X M` with `M = (c · P_𝓑(XᵀX))^{-1/2} ∈ 𝓑`. It has unit norm and is the same for all shapes of a class, up to
//! an orthogonal member of `𝓑`. The columns `X E_iᵀ` of a normal form are orthonormal.

use std::borrow::Cow;

use crate::metric::norm;
use crate::transformation::TransformationClass;
use crate::{AnalysisError, DEGENERATE};
use shapelex_numeric::dense::{Matrix, symmetric_eigen};
use shapelex_numeric::kernels::add_scaled;

/// A class of matrices that is closed under products and transposition.
#[derive(Debug, Clone, PartialEq)]
pub struct Algebra {
    size: usize,
    basis: Vec<Matrix>,
}

/// Difference below which two matrices are equal: the entries of the matrices of a class are small numbers.
const CLOSED: f64 = 1e-9;

impl Algebra {
    /// The scalars: atoms are multiplied by a coefficient, whatever their dimension (`c = 1`).
    pub fn numbers() -> Self {
        Self { size: 1, basis: vec![Matrix::identity(1, 1)] }
    }

    /// The matrices of `class`.
    ///
    /// # Errors
    /// [`AnalysisError::NotAProperClass`] if they are not closed under products and transposition.
    pub fn of(class: &TransformationClass) -> Result<Self, AnalysisError> {
        let size = class.dimension();
        let mut basis: Vec<Matrix> = Vec::new();
        for matrix in class.matrices() {
            let mut rest = matrix / matrix.norm().max(f64::MIN_POSITIVE);
            // Twice, so that the basis is orthonormal to rounding even if the matrices are nearly dependent.
            for _ in 0..2 {
                for known in &basis {
                    rest -= known * known.dot(&rest);
                }
            }
            let norm = rest.norm();
            if norm > CLOSED {
                basis.push(rest / norm);
            }
        }
        let scale = (size as f64).sqrt();
        let algebra = Self { size, basis: basis.into_iter().map(|e| e * scale).collect() };
        let products = || algebra.basis.iter().flat_map(|a| algebra.basis.iter().map(move |b| a * b));
        let closed = algebra.contains(&Matrix::identity(size, size))
            && algebra.basis.iter().all(|e| algebra.contains(&e.transpose()))
            && products().all(|product| algebra.contains(&product));
        if closed {
            return Ok(algebra);
        }
        Err(AnalysisError::NotAProperClass(format!(
            "{} is not closed under products and transposition, so that codes cannot be invariant under it: use \
             uniform_scaling, non_uniform_scaling, scaled_rotation, linear, one of these with translation \
             (similarity, affine), or \"codes\": \"aligned\"",
            class.label()
        )))
    }

    fn contains(&self, matrix: &Matrix) -> bool {
        (self.project(matrix) - matrix).norm() <= CLOSED * matrix.norm()
    }

    /// Size of the matrices, `c`.
    pub fn size(&self) -> usize {
        self.size
    }

    /// Number of real parameters of a member, `b`.
    pub fn parameters(&self) -> usize {
        self.basis.len()
    }

    /// The member `Σ a_i E_i`.
    pub fn member(&self, coefficients: &[f64]) -> Matrix {
        let mut sum = Matrix::zeros(self.size, self.size);
        coefficients.iter().zip(&self.basis).for_each(|(a, e)| sum += e * *a);
        sum
    }

    /// Entries of the members with these coefficients, column by column, one member after the other.
    pub(super) fn entries<'a>(&self, coefficients: &'a [f64]) -> Cow<'a, [f64]> {
        if self.size == 1 {
            return Cow::Borrowed(coefficients);
        }
        let mut entries = vec![0.0; coefficients.len() / self.parameters() * self.size * self.size];
        let members = entries.chunks_exact_mut(self.size * self.size);
        for (member, coefficients) in members.zip(coefficients.chunks_exact(self.parameters())) {
            coefficients.iter().zip(&self.basis).for_each(|(a, e)| add_scaled(member, *a, e.as_slice()));
        }
        Cow::Owned(entries)
    }

    /// Coefficients of the member nearest to `matrix`.
    pub fn coefficients(&self, matrix: &Matrix) -> Vec<f64> {
        self.basis.iter().map(|e| e.dot(matrix) / self.size as f64).collect()
    }

    /// The nearest member, `P_𝓑 M`.
    pub fn project(&self, matrix: &Matrix) -> Matrix {
        self.member(&self.coefficients(matrix))
    }

    /// The symmetric matrix `P_𝓑(XᵀX)` of the shape `x` (`m·c` numbers).
    fn inertia(&self, x: &[f64]) -> Matrix {
        let columns = nalgebra::DMatrixView::from_slice(x, x.len() / self.size, self.size);
        self.project(&columns.tr_mul(&columns))
    }

    /// Brings `x` to its normal form in place and returns the symmetric matrix `M`.
    ///
    /// # Errors
    /// [`AnalysisError::Degenerate`] with index 0 if a relative singular value is below `10⁻¹⁰`.
    pub fn normalise(&self, x: &mut [f64]) -> Result<Matrix, AnalysisError> {
        let c = self.size as f64;
        let inertia = symmetric_eigen(&self.inertia(x));
        let (least, most) = (inertia.eigenvalues.min(), inertia.eigenvalues.max());
        let sigma = if most > 0.0 { (least / most).max(0.0).sqrt() } else { 0.0 };
        if !(sigma >= DEGENERATE) {
            return Err(AnalysisError::Degenerate { index: 0, class: "the given class".into(), sigma });
        }
        let m = function(&inertia, |value| 1.0 / (c * value).sqrt());
        self.multiply(x, &m);
        Ok(m)
    }

    /// Projects the atom `x` to the nearest point of the ball `c · P_𝓑(XᵀX) ≼ I`, in place.
    pub fn to_ball(&self, x: &mut [f64]) {
        if self.parameters() == 1 {
            let norm = norm(x);
            if norm > 1.0 {
                x.iter_mut().for_each(|value| *value /= norm);
            }
            return;
        }
        let c = self.size as f64;
        let inertia = symmetric_eigen(&self.inertia(x));
        if c * inertia.eigenvalues.max() > 1.0 {
            let m = function(&inertia, |value| 1.0 / (c * value).max(1.0).sqrt());
            self.multiply(x, &m);
        }
    }

    /// Moves the atom `x = V R` from inside the ball to `V` on its border, `c · P_𝓑(VᵀV) = I`: a normal form. Returns `R ≼ I`,
    /// symmetric. If `x` is rank-deficient, returns `None` and leaves `x` unchanged.
    pub fn to_border(&self, x: &mut [f64]) -> Option<Matrix> {
        if self.parameters() == 1 {
            let norm = norm(x);
            if !(norm > f64::MIN_POSITIVE.sqrt()) {
                return None;
            }
            x.iter_mut().for_each(|value| *value /= norm);
            return Some(Matrix::identity(self.size, self.size) * norm);
        }
        let c = self.size as f64;
        let inertia = symmetric_eigen(&self.inertia(x));
        let (least, most) = (inertia.eigenvalues.min(), inertia.eigenvalues.max());
        if !(least > f64::MIN_POSITIVE && least >= most * DEGENERATE * DEGENERATE) {
            return None;
        }
        let m = function(&inertia, |value| 1.0 / (c * value).sqrt());
        self.multiply(x, &m);
        Some(function(&inertia, |value| (c * value).sqrt()))
    }

    /// Transforms a shape in place: `X ← X Bᵀ`.
    pub fn act(&self, x: &mut [f64], b: &Matrix) {
        self.multiply(x, &b.transpose());
    }

    /// `X ← X M`, row by row.
    fn multiply(&self, x: &mut [f64], m: &Matrix) {
        let (c, rows) = (self.size, x.len() / self.size);
        let mut point = vec![0.0; c];
        for row in 0..rows {
            for (j, value) in point.iter_mut().enumerate() {
                *value = (0..c).map(|i| x[i * rows + row] * m[(i, j)]).sum();
            }
            point.iter().enumerate().for_each(|(j, value)| x[j * rows + row] = *value);
        }
    }

    /// The orthogonal member `O` that brings `x` nearest to `target`: `O = T (TᵀT)^{-1/2}`, `T = P_𝓑(Yᵀ X)`. The identity if
    /// `T` is rank-deficient.
    pub fn rotation_to(&self, x: &[f64], target: &[f64]) -> Matrix {
        let view = |x| nalgebra::DMatrixView::from_slice(x, x.len() / self.size, self.size);
        let t = self.project(&view(target).tr_mul(&view(x)));
        let gram = symmetric_eigen(&t.tr_mul(&t));
        if !(gram.eigenvalues.min() > CLOSED * CLOSED) {
            return Matrix::identity(self.size, self.size);
        }
        t * function(&gram, |value| 1.0 / value.sqrt())
    }

    /// The columns `vec(X E_iᵀ)` of an atom, one after the other: `m·c × b`.
    pub fn block(&self, x: &[f64]) -> Vec<f64> {
        let mut columns = x.repeat(self.parameters());
        if self.parameters() > 1 {
            columns.chunks_exact_mut(x.len()).zip(&self.basis).for_each(|(column, e)| self.act(column, e));
        }
        columns
    }
}

/// `f(S)` of a symmetric matrix given by its eigenpairs.
fn function(eigen: &nalgebra::SymmetricEigen<f64, nalgebra::Dyn>, f: impl Fn(f64) -> f64) -> Matrix {
    let vectors = &eigen.eigenvectors;
    let scaled =
        Matrix::from_fn(vectors.nrows(), vectors.ncols(), |i, j| vectors[(i, j)] * f(eigen.eigenvalues[j]));
    scaled * vectors.transpose()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transformation::ClassName;

    fn of(name: ClassName, dimension: usize) -> Result<Algebra, AnalysisError> {
        Algebra::of(&TransformationClass::named(name, dimension).unwrap())
    }

    #[test]
    fn closed_classes_are_those_without_shears_and_reflections() {
        use ClassName::*;
        let closed = [UniformScaling, NonUniformScaling, ScaledRotation, Similarity, Linear, Affine];
        let open = [Translation, HorizontalShear, VerticalShearTranslation, ReflectedSimilarity];
        for name in closed {
            assert!(of(name, 2).is_ok(), "{name:?}");
        }
        for name in open {
            assert!(of(name, 2).is_err(), "{name:?}");
        }
        assert_eq!(of(Affine, 3).unwrap().parameters(), 9);
        assert_eq!(of(UniformScaling, 3).unwrap().parameters(), 1);
    }

    #[test]
    fn normal_forms_have_orthonormal_blocks_and_forget_the_member_of_the_class() {
        use ClassName::*;
        for (name, dimension) in
            [(UniformScaling, 2), (NonUniformScaling, 3), (Similarity, 2), (Affine, 2), (Affine, 3)]
        {
            let algebra = of(name, dimension).unwrap();
            let shape: Vec<f64> =
                (0..8 * dimension).map(|i| ((i * i + 3) as f64 * 0.71).sin() + 0.2).collect();
            let coefficients: Vec<f64> =
                (0..algebra.parameters()).map(|i| 1.3 - 0.9 * (i as f64 * 1.7).sin()).collect();
            let mut moved = shape.clone();
            algebra.act(&mut moved, &algebra.member(&coefficients));
            let (mut one, mut other) = (shape.clone(), moved);
            algebra.normalise(&mut one).unwrap();
            algebra.normalise(&mut other).unwrap();
            let turn = algebra.rotation_to(&one, &other);
            algebra.act(&mut one, &turn);
            let difference: f64 = one.iter().zip(&other).map(|(a, b)| (a - b).powi(2)).sum();
            assert!(difference < 1e-24, "{name:?}: {difference:e}");
            let block = Matrix::from_vec(shape.len(), algebra.parameters(), algebra.block(&one));
            let error =
                (block.tr_mul(&block) - Matrix::identity(algebra.parameters(), algebra.parameters())).norm();
            assert!(error < 1e-12, "{name:?}: {error:e}");
        }
    }
}
