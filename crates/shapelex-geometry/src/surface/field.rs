//! Vector fields whose flux through surfaces is measured: affine fields and polynomials.
//!
//! ```text
//! F(r) = A r + b        F(r) = Σ_t f_t x^{i_t} y^{j_t} z^{k_t},   i_t + j_t + k_t ≤ 8
//! ```
//!
//! Through a closed surface the flux is the integral of `div F` over the body.

use crate::field_fault::FieldFault;
use crate::vector::dot;

/// Affine vector field `F(r) = A r + b`.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields))]
pub struct AffineField {
    /// Matrix `A`, row by row.
    pub matrix: [[f64; 3]; 3],
    /// Offset `b`.
    pub offset: [f64; 3],
}

/// A term `f x^i y^j z^k` of a polynomial field.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields))]
pub struct FieldTerm {
    /// Powers `i`, `j`, `k` of x, y and z; at most 8 together.
    #[cfg_attr(feature = "schema", schema(example = json!([2, 0, 1])))]
    pub powers: [usize; 3],
    /// The vector `f`.
    #[cfg_attr(feature = "schema", schema(example = json!([1.0, 0.0, 0.0])))]
    pub coefficients: [f64; 3],
}

/// Maximum degree of a polynomial field.
pub const MAX_DEGREE: usize = 8;
/// Maximum number of terms: that of the monomials up to [`MAX_DEGREE`].
pub const MAX_TERMS: usize = 165;

/// A polynomial vector field.
#[derive(Debug, Clone, PartialEq)]
pub struct PolynomialField {
    terms: Vec<FieldTerm>,
    degree: usize,
}

impl PolynomialField {
    /// The sum of `terms`; several may have the same powers.
    ///
    /// # Errors
    /// More than [`MAX_TERMS`] terms; a degree above [`MAX_DEGREE`] or numbers that are not finite, at `{index}/{field}`.
    pub fn new(terms: Vec<FieldTerm>) -> Result<Self, Vec<FieldFault>> {
        if terms.len() > MAX_TERMS {
            let detail = format!("expected at most {MAX_TERMS} terms, got {}", terms.len());
            return Err(vec![FieldFault::new("", detail)]);
        }
        let degree_of =
            |term: &FieldTerm| term.powers.iter().fold(0_usize, |sum, power| sum.saturating_add(*power));
        let faults = terms.iter().enumerate().filter_map(|(index, term)| {
            let degree = degree_of(term);
            if degree > MAX_DEGREE {
                let detail = format!("expected powers that sum to at most {MAX_DEGREE}, got {degree}");
                return Some(FieldFault::new(format!("{index}/powers"), detail));
            }
            let wild = term.coefficients.iter().any(|value| !value.is_finite());
            wild.then(|| FieldFault::new(format!("{index}/coefficients"), "expected finite numbers"))
        });
        let faults: Vec<FieldFault> = faults.collect();
        let degree = terms.iter().map(degree_of).max().unwrap_or(0);
        if faults.is_empty() { Ok(Self { terms, degree }) } else { Err(faults) }
    }

    fn value(&self, point: [f64; 3]) -> [f64; 3] {
        let mut powers = [[1.0; MAX_DEGREE + 1]; 3];
        for (powers, x) in powers.iter_mut().zip(point) {
            for i in 1..=self.degree {
                powers[i] = powers[i - 1] * x;
            }
        }
        let mut value = [0.0; 3];
        for FieldTerm { powers: [i, j, k], coefficients } in &self.terms {
            let monomial = powers[0][*i] * powers[1][*j] * powers[2][*k];
            (0..3).for_each(|c| value[c] += coefficients[c] * monomial);
        }
        value
    }

    /// `F(r + origin)`, a polynomial of the same degree.
    fn about(&self, origin: [f64; 3]) -> Self {
        // Coefficients by powers of x, y and z.
        let side = self.degree + 1;
        let mut sums = vec![[0.0; 3]; side * side * side];
        let expand = |power: usize, x: f64| -> Vec<f64> {
            let mut row = vec![1.0];
            for _ in 0..power {
                // (x + r) times the powers so far.
                let mut next: Vec<f64> = row.iter().map(|value| value * x).collect();
                next.push(0.0);
                row.iter().enumerate().for_each(|(i, value)| next[i + 1] += value);
                row = next;
            }
            row
        };
        for FieldTerm { powers, coefficients } in &self.terms {
            let [x, y, z] = [0, 1, 2].map(|c| expand(powers[c], origin[c]));
            for (i, x) in x.iter().enumerate() {
                for (j, y) in y.iter().enumerate() {
                    for (k, z) in z.iter().enumerate() {
                        let sum = &mut sums[(i * side + j) * side + k];
                        (0..3).for_each(|c| sum[c] += coefficients[c] * x * y * z);
                    }
                }
            }
        }
        let kept = sums.into_iter().enumerate().filter(|(_, sum)| *sum != [0.0; 3]);
        let terms = kept.map(|(place, coefficients)| {
            let powers = [place / side / side, place / side % side, place % side];
            FieldTerm { powers, coefficients }
        });
        Self { terms: terms.collect(), degree: self.degree }
    }
}

/// A vector field of the space.
#[derive(Debug, Clone, PartialEq)]
pub enum VectorField {
    /// `A r + b`.
    Affine(AffineField),
    /// A sum of monomials.
    Polynomial(PolynomialField),
}

impl From<AffineField> for VectorField {
    fn from(field: AffineField) -> Self {
        Self::Affine(field)
    }
}

impl VectorField {
    /// Total degree.
    pub fn degree(&self) -> usize {
        match self {
            Self::Affine(_) => 1,
            Self::Polynomial(field) => field.degree,
        }
    }

    /// Number of terms to evaluate.
    pub fn terms(&self) -> usize {
        match self {
            Self::Affine(_) => 4,
            Self::Polynomial(field) => field.terms.len(),
        }
    }

    /// `F(point)`.
    pub fn value(&self, point: [f64; 3]) -> [f64; 3] {
        match self {
            Self::Affine(field) => [0, 1, 2].map(|c| dot(field.matrix[c], point) + field.offset[c]),
            Self::Polynomial(field) => field.value(point),
        }
    }

    /// The field `r ↦ F(r + origin)`.
    pub fn about(&self, origin: [f64; 3]) -> Self {
        match self {
            Self::Affine(field) => Self::Affine(AffineField { offset: self.value(origin), ..*field }),
            Self::Polynomial(field) => Self::Polynomial(field.about(origin)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moved_fields_have_the_values_of_the_field_there() {
        let term = |powers, x: f64| FieldTerm { powers, coefficients: [x, -2.0 * x, x * x] };
        let terms =
            vec![term([0, 0, 0], 0.5), term([8, 0, 0], 0.25), term([1, 2, 3], -1.0), term([1, 2, 3], 2.0)];
        let field = VectorField::Polynomial(PolynomialField::new(terms).unwrap());
        let moved = field.about([0.5, -0.25, 2.0]);
        let (found, wanted) = (moved.value([0.3, 0.4, -0.6]), field.value([0.8, 0.15, 1.4]));
        assert!((0..3).all(|c| (found[c] - wanted[c]).abs() < 1e-14), "{found:?} {wanted:?}");
        assert_eq!(field.degree(), 8);
    }

    #[test]
    fn wrong_terms_are_named() {
        let term = |powers, value| FieldTerm { powers, coefficients: [value; 3] };
        let faults = PolynomialField::new(vec![
            term([3, 3, 3], 1.0),
            term([0, 1, 0], f64::NAN),
            term([usize::MAX, 1, 0], 1.0),
        ]);
        let faults = faults.unwrap_err();
        let fields: Vec<&str> = faults.iter().map(|fault| fault.field.as_str()).collect();
        assert_eq!(fields, ["0/powers", "1/coefficients", "2/powers"]);
        assert!(faults[0].detail.contains("got 9"), "{}", faults[0].detail);
        assert!(PolynomialField::new(vec![term([0, 0, 0], 1.0); MAX_TERMS + 1]).is_err());
    }
}
