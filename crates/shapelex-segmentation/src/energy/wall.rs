//! The soft wall around a box.
//!
//! ```text
//! E_w = mean over the boundary of Σ_c (max(|x_c − m_c| − f h_c, 0)/h_c)²
//! ```
//!
//! `m` is the middle of the box and `h` are halves of its sides. Within the box scaled by `f` the wall is not felt; beyond it, the
//! energy grows with the square of the distance. It adds the information of a box that an image lacks: that parts farther
//! away belong to others.

use super::shape::Shape;
use crate::boundary::Differential;
use crate::frame::Frame;

/// A box in the frame, beyond which a boundary costs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wall<const D: usize> {
    /// The middle of the box.
    pub middle: [f64; D],
    /// Halves of its sides.
    pub half: [f64; D],
    /// The factor `f` by which the box is scaled.
    pub factor: f64,
    /// The frame of the indices.
    pub frame: Frame<D>,
}

impl<const D: usize> Wall<D> {
    /// The wall around positions in the frame; `None` without positions, or if they have no extent along an axis.
    pub fn around(positions: impl Iterator<Item = [f64; D]>, factor: f64, frame: Frame<D>) -> Option<Self> {
        let (mut lower, mut upper) = ([f64::INFINITY; D], [f64::NEG_INFINITY; D]);
        for position in positions {
            for c in 0..D {
                lower[c] = lower[c].min(position[c]);
                upper[c] = upper[c].max(position[c]);
            }
        }
        let middle = std::array::from_fn(|c| 0.5 * (lower[c] + upper[c]));
        let half: [f64; D] = std::array::from_fn(|c| 0.5 * (upper[c] - lower[c]));
        half.iter().all(|half| *half > 0.0 && half.is_finite()).then_some(Self {
            middle,
            half,
            factor,
            frame,
        })
    }

    /// The cost of a point in index coordinates, and its slope there.
    fn at(&self, point: [f64; D]) -> (f64, [f64; D]) {
        let position = self.frame.to_world(point);
        let (mut value, mut slope) = (0.0, [0.0; D]);
        for c in 0..D {
            let away = (position[c] - self.middle[c]) / self.half[c];
            let beyond = (away.abs() - self.factor).max(0.0);
            value += beyond * beyond;
            slope[c] = 2.0 * beyond * away.signum() / self.half[c];
        }
        (value, self.frame.turn_back(slope))
    }

    /// Value and gradient.
    pub fn evaluate(&self, shape: &Shape<'_, D>) -> Differential<D> {
        shape.boundary.mean(&shape.samples, &|_, point| self.at(point))
    }
}
