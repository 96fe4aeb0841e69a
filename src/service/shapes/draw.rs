//! Drawings of shapes.

use crate::geometry::drawing::layer::Layer;
use crate::geometry::drawing::scene::Drawing;
use crate::geometry::drawing::{colour, layout};
use crate::geometry::representation::ShapeSpace;

/// Maximum number of shapes in one drawing: more would hide one another.
pub const MAX_DRAWN: usize = 300;

/// Drawing of shapes in their own position and size; `unit`: their unit of length, if known.
pub fn draw_shapes(space: &ShapeSpace, title: &str, shapes: &[&[f64]], unit: Option<&str>) -> Drawing {
    let opacity = if shapes.len() > 1 { 0.5 } else { 1.0 };
    let colour = if space.domain().is_surface() { colour::BACK } else { colour::MAIN };
    let drawn = shapes.iter().copied().take(MAX_DRAWN);
    layout::draw(title, vec![Layer::of(space, drawn, colour, 2.0, opacity)]).to_scale(unit)
}
