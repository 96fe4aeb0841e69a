//! The contour energy.
//!
//! ```text
//! E_c = s/(e_σ A₀) ∮ ∂f_σ/∂n dS = s/(e_σ A₀) ∫_Ω Δf_σ,   n outwards
//! ```
//!
//! The minimum for a bright object has the plus sign; the literature often prints the minus sign for every case. Along a
//! straight step the zero of `Δf_σ` is at the step. Along a ridge it is at the inner inflection, `√(σ² + w²/12)` before the
//! crest. The capture range is `2σ` to `3σ`.

use std::sync::Arc;

use super::shape::{Polarity, Shape};
use crate::boundary::Differential;
use crate::field::Integrated;

/// Flux of the gradient of the blurred image through the boundary.
#[derive(Debug, Clone)]
pub struct Contour<const D: usize> {
    /// `Δf_σ`, integrated along x.
    pub laplacian: Arc<Integrated<D>>,
    /// The sign `s`.
    pub polarity: Polarity,
    /// `e_σ A₀`: edge scale times size of the first boundary.
    pub scale: f64,
}

impl<const D: usize> Contour<D> {
    /// Value and gradient.
    pub fn evaluate(&self, shape: &Shape<'_, D>) -> Differential<D> {
        let flux = shape.boundary.integral(&shape.samples, &self.laplacian);
        flux.times(self.polarity.sign() / self.scale)
    }
}
