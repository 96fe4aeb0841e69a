//! The two-class energy, in the form of Chan and Vese.
//!
//! ```text
//! E = −(S²/V + S²/(V_T − V))/(V_T var f),   S = ∫_Ω (f − mean f),   V = Vol(Ω),   −1 ≤ E ≤ 0
//! ```
//!
//! `V_T` is the volume of the image. For images with one object, bright or dark.

use std::sync::Arc;

use super::shape::{Shape, forbidden};
use crate::boundary::Differential;
use crate::field::Integrated;

/// Variance that is explained by the means inside and outside.
#[derive(Debug, Clone)]
pub struct TwoClass<const D: usize> {
    /// `f_σ − mean f_σ`, integrated along x.
    pub centred: Arc<Integrated<D>>,
    /// `V_T`, the volume of the image in units of length.
    pub total: f64,
    /// `var f_σ`.
    pub variance: f64,
}

impl<const D: usize> TwoClass<D> {
    /// Slope of the term in `∫_Ω f₀`.
    pub(super) fn factor(&self, shape: &Shape<'_, D>) -> f64 {
        let (inside, volume) = (shape.boundary.integral(&shape.samples, &self.centred).value, &shape.volume);
        -2.0 * inside * (1.0 / volume.value + 1.0 / (self.total - volume.value))
            / (self.total * self.variance)
    }

    /// Value and gradient; infinite for shapes without volume, or with more than the image.
    ///
    /// ```text
    /// ∂E = −(2 (μ_i − μ_o) ∂S − (μ_i² − μ_o²) ∂V)/(V_T var f),   μ_i = S/V,   μ_o = −S/(V_T − V)
    /// ```
    pub fn evaluate(&self, shape: &Shape<'_, D>) -> Differential<D> {
        let volume = &shape.volume;
        if !(volume.value > 0.0 && volume.value < self.total) {
            return forbidden(shape.rows.len());
        }
        let inside = shape.boundary.integral(&shape.samples, &self.centred);
        let [mean_inside, mean_outside] =
            [inside.value / volume.value, -inside.value / (self.total - volume.value)];
        let factor = -1.0 / (self.total * self.variance);
        let value = factor * inside.value * (mean_inside - mean_outside);
        let mut energy = inside.times(2.0 * factor * (mean_inside - mean_outside));
        energy.value = value;
        energy.add_gradient(-factor * (mean_inside.powi(2) - mean_outside.powi(2)), &volume.gradient);
        energy
    }
}
