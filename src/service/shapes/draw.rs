//! Drawings of shapes.

use crate::geometry::drawing::svg::{self, Layer, colour};
use crate::geometry::representation::ShapeSpace;

/// Maximum number of shapes in one drawing: more would hide one another.
pub const MAX_DRAWN: usize = 300;

/// Drawing of shapes in their own position.
pub fn draw_shapes(space: &ShapeSpace, title: &str, shapes: &[&[f64]]) -> String {
    let opacity = if shapes.len() > 1 { 0.5 } else { 1.0 };
    svg::draw(title, &[Layer::of(space, shapes.iter().copied().take(MAX_DRAWN), colour::MAIN, 2.0, opacity)])
}
