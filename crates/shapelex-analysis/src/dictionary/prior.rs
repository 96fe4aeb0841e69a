//! The shape prior: the squared distance of a curve from a space of shapes, with its gradient.
//!
//! ```text
//! E(c) = γ ‖r − P r‖² = γ cᵀ Ψ (I − P) c,   ∇E = 2γ Ψ (I − P) c          ∂E/∂c, one number per control coordinate
//! ```
//!
//! `P` projects onto the span of reference shapes transformed by all members of a class (and by translations, if the class
//! has them). The energy is zero for every member of the span; a snake adds it to its image energy.
//!
//! Source: Schmitter 2017, (3.4)–(3.6) and (3.12).

use crate::metric::{Metric, dot};
use crate::transformation::TransformationClass;
use shapelex_numeric::dense::{Matrix, multiply, transpose_multiply};

/// Reference of a shape prior.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
pub enum Reference {
    /// The mean shape under the class.
    #[default]
    Mean,
    /// All combinations of the atoms (and of the mean of the aligned shapes) under the class.
    Atoms,
}

/// A shape prior.
#[derive(Debug, Clone)]
pub struct Prior {
    metric: Metric,
    translates: bool,
    /// Orthonormal basis of the span, whitened.
    basis: Matrix,
    gamma: f64,
}

/// Energy and gradient of the prior at a shape.
#[derive(Debug, Clone, PartialEq)]
pub struct Energy {
    /// `E`, in squared units of length times `γ`.
    pub energy: f64,
    /// `∇E`, in the coordinate-major order of the control points.
    pub gradient: Vec<f64>,
}

/// Minimum fraction of its length that a direction must keep after orthogonalisation; the remainder of a dependent
/// direction is rounding error.
const INDEPENDENT: f64 = 1e-8;

impl Prior {
    /// From the whitened reference `shapes` (centred, if the class translates). Cost `O(n (I J)²)`.
    pub fn new(metric: &Metric, class: &TransformationClass, shapes: &[Vec<f64>], gamma: f64) -> Self {
        let (n, d) = (metric.size(), metric.dimension());
        let mut basis: Vec<Vec<f64>> = Vec::new();
        for shape in shapes {
            for matrix in class.matrices() {
                let mut moved = vec![0.0; shape.len()];
                for c in 0..d {
                    for e in 0..d {
                        let part = moved[c * n..(c + 1) * n].iter_mut().zip(&shape[e * n..(e + 1) * n]);
                        part.for_each(|(sum, value)| *sum += matrix[(c, e)] * value);
                    }
                }
                add_direction(&mut basis, moved);
            }
        }
        let (count, translates) = (basis.len(), class.translates());
        let metric = metric.clone();
        Self { metric, translates, basis: Matrix::from_vec(n * d, count, basis.concat()), gamma }
    }

    /// Energy and gradient at the shape with these control points. Cost `O(n I J)`.
    pub fn energy(&self, control_points: &[f64]) -> Energy {
        let mut residual = control_points.to_vec();
        if self.translates {
            self.metric.centre(&mut residual);
        }
        self.metric.whiten(&mut residual);
        let x = Matrix::from_vec(residual.len(), 1, residual);
        let outside = &x - multiply(&self.basis, &transpose_multiply(&self.basis, &x));
        let energy = self.gamma * dot(outside.as_slice(), outside.as_slice());
        let mut gradient: Vec<f64> = outside.iter().map(|value| 2.0 * self.gamma * value).collect();
        // Ψ (I − P) c with (I − P) c = R⁻¹ (residual)
        self.metric.unwhiten(&mut gradient);
        self.metric.apply(&mut gradient);
        Energy { energy, gradient }
    }
}

/// Adds the component of `direction` outside of the basis, orthonormalised twice.
fn add_direction(basis: &mut Vec<Vec<f64>>, mut direction: Vec<f64>) {
    let length = dot(&direction, &direction).sqrt();
    if basis.len() == direction.len() {
        return;
    }
    for _ in 0..2 {
        for known in basis.iter() {
            let product = dot(known, &direction);
            direction.iter_mut().zip(known).for_each(|(value, k)| *value -= product * k);
        }
    }
    let rest = dot(&direction, &direction).sqrt();
    if rest > INDEPENDENT * length {
        direction.iter_mut().for_each(|value| *value /= rest);
        basis.push(direction);
    }
}
