//! Drawings of shapes beside their nearest neighbours.

use super::View;
use crate::alignment::Method;
use shapelex_geometry::drawing::colour;
use shapelex_geometry::drawing::layer::Layer;
use shapelex_geometry::drawing::layout::{self, Cell};
use shapelex_geometry::drawing::scene::Drawing;
use shapelex_geometry::representation::ShapeSpace;

/// A shape and its neighbours, aligned to it: captions and control points.
#[derive(Debug, Clone)]
pub struct Row {
    /// The shape.
    pub query: (String, Vec<f64>),
    /// Its neighbours, nearest first.
    pub neighbours: Vec<(String, Vec<f64>)>,
}

/// Drawing of one row for each shape: the shape, then its neighbours, each before a pale outline of the shape. Rows have a
/// separate scale if the method removes sizes.
pub fn draw_nearest(space: &ShapeSpace, method: &Method, title: &str, rows: &[Row]) -> Drawing {
    let columns = 1 + rows.iter().map(|row| row.neighbours.len()).max().unwrap_or(0);
    let cells = rows.iter().flat_map(|row| {
        let mut cells = cells_of(space, method, row);
        cells.resize_with(columns, || (String::new(), Vec::new()));
        cells
    });
    layout::in_columns(title, cells.collect(), columns)
}

fn cells_of(space: &ShapeSpace, method: &Method, row: &Row) -> Vec<Cell> {
    let (caption, query) = &row.query;
    let view = View::upright(space, method, query);
    let size = query.iter().map(|x| x * x).sum::<f64>().sqrt();
    let factor = if method.keeps_sizes() || !(size > 0.0) { 1.0 } else { 1.0 / size };
    let layer = |shape: &[f64], colour, width: f64| {
        let shape: Vec<f64> = shape.iter().map(|x| factor * x).collect();
        view.layer([shape.as_slice()], colour, width, 1.0)
    };
    let is_surface = space.domain().is_surface();
    let before = |shape: &[f64]| -> Vec<Layer> {
        let neighbour = layer(shape, colour::BACK, 1.75);
        let behind = (!is_surface).then(|| layer(query, colour::PALE, 1.0));
        behind.into_iter().chain([neighbour]).collect()
    };
    let first = (caption.clone(), vec![layer(query, colour::MAIN, 1.75)]);
    let neighbours = row.neighbours.iter().map(|(caption, shape)| (caption.clone(), before(shape)));
    std::iter::once(first).chain(neighbours).collect()
}
