//! The local contrast energy.
//!
//! ```text
//! E_l = −s (2 I(c) − I(c_λ))/(con · Vol(c)),   c_λ = c̄ + λ (c − c̄),   λ = 2^{1/d}
//! ```
//!
//! This is `−s (mean inside − mean in the shell)/con`: the shell between `Ω` and its dilation `Ω_λ` has the volume of `Ω`.

use std::sync::Arc;

use super::shape::{Polarity, Shape, forbidden};
use crate::boundary::Differential;
use crate::field::Integrated;

/// Mean inside of the shape against the mean in a shell around it.
#[derive(Debug, Clone)]
pub struct LocalContrast<const D: usize> {
    /// `f_σ`, integrated along x.
    pub image: Arc<Integrated<D>>,
    /// The sign `s`.
    pub polarity: Polarity,
    /// `con`, the range of the image.
    pub contrast: f64,
    /// Weights of the free points in the centre `c̄`; their sum is 1.
    pub centre: Arc<[f64]>,
}

impl<const D: usize> LocalContrast<D> {
    /// Value and gradient; infinite for shapes without volume.
    ///
    /// ```text
    /// ∂E = −s [(2 ∂I − λ ∂I_λ − (1 − λ) w ⊗ Σ ∂I_λ)/Vol − (2 I − I_λ)/Vol² ∂Vol]/con
    /// ```
    pub fn evaluate(&self, shape: &Shape<'_, D>) -> Differential<D> {
        let volume = &shape.volume;
        if !(volume.value > 0.0) {
            return forbidden(shape.rows.len());
        }
        let lambda = 2.0_f64.powf(1.0 / D as f64);
        let weighted = |c: usize| -> f64 { self.centre.iter().zip(shape.rows).map(|(w, p)| w * p[c]).sum() };
        let centre: [f64; D] = std::array::from_fn(weighted);
        let dilate = |p: &[f64; D]| std::array::from_fn(|c| centre[c] + lambda * (p[c] - centre[c]));
        let dilated: Vec<[f64; D]> = shape.rows.iter().map(dilate).collect();
        let inside = shape.boundary.integral(&shape.samples, &self.image);
        let around = shape.boundary.integral(&shape.boundary.sample(&dilated), &self.image);
        let factor = -self.polarity.sign() / (self.contrast * volume.value);
        let excess = 2.0 * inside.value - around.value;
        let mut energy = inside.times(2.0 * factor);
        energy.value = factor * excess;
        energy.add_gradient(-lambda * factor, &around.gradient);
        energy.add_gradient(-factor * excess / volume.value, &volume.gradient);
        let total: [f64; D] = std::array::from_fn(|c| around.gradient.iter().map(|slope| slope[c]).sum());
        for (slope, weight) in energy.gradient.iter_mut().zip(self.centre.iter()) {
            (0..D).for_each(|c| slope[c] -= factor * (1.0 - lambda) * weight * total[c]);
        }
        energy
    }
}
