//! The attraction to the first shape.
//!
//! ```text
//! E_h = mean over the boundary of Σ_c ((x_c − x⁰_c)/h_c)²
//! ```
//!
//! `x⁰` is the point of the first shape with the same parameters, and `h` are halves of the sides of the box around it. At an edge,
//! a contour of the blur `σ` is held about `h²/2σ²` times as strongly by the image, so that a weight of 1 moves it by a small part of
//! a cell; where the image says nothing, the shape stays where it began.

use super::shape::Shape;
use super::wall::Wall;
use crate::boundary::Differential;

/// Mean square distance from the first shape, relative to its box.
#[derive(Debug, Clone)]
pub struct Hold<const D: usize> {
    /// The free points of the first shape.
    pub start: Vec<[f64; D]>,
    /// Its box.
    pub wall: Wall<D>,
}

impl<const D: usize> Hold<D> {
    /// Value and gradient. The samples of the first shape are those of the same boundary.
    pub fn evaluate(&self, shape: &Shape<'_, D>) -> Differential<D> {
        let samples = shape.boundary.sample(&self.start);
        let points = if samples.vertices.is_empty() { samples.points } else { samples.vertices };
        let frame = &self.wall.frame;
        shape.boundary.mean(&shape.samples, &|s, point| {
            let (position, first) = (frame.to_world(point), frame.to_world(points[s]));
            let away: [f64; D] = std::array::from_fn(|c| (position[c] - first[c]) / self.wall.half[c]);
            let slope = std::array::from_fn(|c| 2.0 * away[c] / self.wall.half[c]);
            (away.iter().map(|x| x * x).sum(), frame.turn_back(slope))
        })
    }
}
