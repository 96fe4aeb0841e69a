//! The cost of the boundary.
//!
//! ```text
//! E_κ = A(Ω)/A₀
//! ```
//!
//! With the weight `κ`, a piece of the boundary costs more than the contour energy gains where the edge is weaker than
//! `κ e_σ`. Open ends then stay where an edge holds them.

use super::shape::Shape;
use crate::boundary::Differential;

/// Length or area of the boundary, relative to that of the first shape.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BoundaryCost {
    /// `A₀`.
    pub scale: f64,
}

impl BoundaryCost {
    /// Value and gradient.
    pub fn evaluate<const D: usize>(&self, shape: &Shape<'_, D>) -> Differential<D> {
        shape.boundary.measure(&shape.samples).times(1.0 / self.scale)
    }
}
