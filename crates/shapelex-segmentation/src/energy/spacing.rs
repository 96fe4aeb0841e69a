//! The spacing energy: the relative variance of squared speeds, or of squared areas of triangles.
//!
//! It is zero for evenly parameterised shapes and does not depend on their size. Without it, shapes fold: image energies count
//! regions as often as they are enclosed, and are unbounded below.
//!
//! Source: the idea of Jacob, Blu and Unser, *Efficient energies and algorithms for parametric snakes*, made scale invariant.

use super::shape::Shape;
use crate::boundary::Differential;

/// Unevenness of the parameterisation.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Spacing {}

impl Spacing {
    /// Value and gradient.
    pub fn evaluate<const D: usize>(&self, shape: &Shape<'_, D>) -> Differential<D> {
        shape.boundary.spacing(&shape.samples)
    }
}
