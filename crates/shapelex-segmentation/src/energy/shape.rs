//! A shape with its samples, as the terms see it.

use crate::boundary::{Boundary, Differential, Samples};

/// Whether objects are brighter or darker than their surroundings.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Polarity {
    /// Bright objects on dark ground, `s = +1`.
    #[default]
    Bright,
    /// Dark objects, or objects enclosed by a bright wall, `s = −1`.
    Dark,
}

impl Polarity {
    /// `s`.
    pub fn sign(self) -> f64 {
        match self {
            Self::Bright => 1.0,
            Self::Dark => -1.0,
        }
    }
}

/// A shape with its samples.
pub struct Shape<'a, const D: usize> {
    /// The boundary.
    pub boundary: &'a dyn Boundary<D>,
    /// Free points in index coordinates.
    pub rows: &'a [[f64; D]],
    /// Samples of the boundary.
    pub samples: Samples<D>,
    /// The enclosed area or volume.
    pub volume: Differential<D>,
}

impl<'a, const D: usize> Shape<'a, D> {
    /// The shape with these free points.
    pub fn new(boundary: &'a dyn Boundary<D>, rows: &'a [[f64; D]]) -> Self {
        let samples = boundary.sample(rows);
        let volume = boundary.volume(&samples);
        Self { boundary, rows, samples, volume }
    }
}

/// The value of a term where it is not defined: line searches turn back.
pub(super) fn forbidden<const D: usize>(rows: usize) -> Differential<D> {
    Differential { value: f64::INFINITY, ..Differential::zero(rows) }
}
