//! Drawings of shapes.

use crate::geometry::capability::domain::Domain;
use crate::geometry::drawing::layer::{Layer, MAX_SURFACES};
use crate::geometry::drawing::scene::Drawing;
use crate::geometry::drawing::{colour, layout};
use crate::geometry::representation::ShapeSpace;

/// Maximum number of shapes in one drawing: more would hide one another.
pub const MAX_DRAWN: usize = 300;

/// Contact sheet of shapes, given with their names, in rows of `columns`; `unit`: their unit of length, if known.
pub fn draw_sheet(
    space: &ShapeSpace,
    title: &str,
    shapes: &[(String, Vec<f64>)],
    columns: usize,
    unit: Option<&str>,
) -> Drawing {
    let colour = if space.domain().is_surface() { colour::BACK } else { colour::MAIN };
    let points = shapes.iter().map(|(_, shape)| shape.as_slice());
    let mut layer = Layer::of(space, points, colour, 1.5, 1.0);
    layer.titles = shapes.iter().map(|(name, _)| name.clone()).collect();
    layout::sheet(title, layer, columns, unit)
}

/// Maximum number of shapes of a contact sheet: surfaces take more of a file than curves.
pub fn most_of_a_sheet(domain: Domain) -> usize {
    if domain.is_surface() { MAX_SURFACES } else { usize::MAX }
}

/// Drawing of shapes in their own position and size; `unit`: their unit of length, if known.
pub fn draw_shapes(space: &ShapeSpace, title: &str, shapes: &[&[f64]], unit: Option<&str>) -> Drawing {
    let opacity = if shapes.len() > 1 { 0.5 } else { 1.0 };
    let colour = if space.domain().is_surface() { colour::BACK } else { colour::MAIN };
    let drawn = shapes.iter().copied().take(MAX_DRAWN);
    layout::draw(title, vec![Layer::of(space, drawn, colour, 2.0, opacity)]).to_scale(unit)
}
