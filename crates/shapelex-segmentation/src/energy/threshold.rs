//! The threshold energy.
//!
//! ```text
//! E_t = (θ Vol(Ω) − ∫_Ω g)/V₀,   g = clamp(f_σ/level, 0, 1)
//! ```
//!
//! `θ Vol` is a separate term: integrated as part of a field that is zero outside of the image, the exterior would cost
//! nothing.

use std::sync::Arc;

use super::shape::Shape;
use crate::boundary::Differential;
use crate::field::Integrated;

/// Volume that is darker than a fraction of a level.
#[derive(Debug, Clone)]
pub struct Threshold<const D: usize> {
    /// `g`, integrated along x.
    pub saturated: Arc<Integrated<D>>,
    /// `θ`.
    pub theta: f64,
    /// `V₀`, the volume of the first shape.
    pub scale: f64,
}

impl<const D: usize> Threshold<D> {
    /// Value and gradient.
    pub fn evaluate(&self, shape: &Shape<'_, D>) -> Differential<D> {
        let inside = shape.boundary.integral(&shape.samples, &self.saturated);
        let mut energy = inside.times(-1.0 / self.scale);
        energy.value += self.theta * shape.volume.value / self.scale;
        energy.add_gradient(self.theta / self.scale, &shape.volume.gradient);
        energy
    }
}
