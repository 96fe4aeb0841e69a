//! Drawings of thin-plate splines: deformed grids, arrows, and wireframes of landmarks.

use crate::thin_plate::lattice::Lattice;
use crate::thin_plate::warp::Warp;
use shapelex_geometry::drawing::colour::{self, Colour};
use shapelex_geometry::drawing::layer::{Layer, Mark};
use shapelex_geometry::drawing::layout;
use shapelex_geometry::drawing::legend::Entry;
use shapelex_geometry::drawing::scene::{Drawing, short};
use shapelex_numeric::dense::Matrix;

/// View of a warp.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
pub enum WarpView {
    /// A deformed grid below the target; of landmarks in space, grids in two planes through their mean.
    #[default]
    Grid,
    /// Arrows from the reference to the target.
    Arrows,
    /// Both sets of landmarks with their links.
    Wireframe,
}

/// A warp with what is drawn of it.
#[derive(Debug)]
pub struct WarpFigure<'a> {
    /// The map.
    pub warp: &'a Warp<'a>,
    /// Landmarks before, `p × d`.
    pub reference: &'a Matrix,
    /// Landmarks after.
    pub target: &'a Matrix,
    /// The grid.
    pub lattice: &'a Lattice,
    /// Pairs of landmarks between which lines are drawn.
    pub links: &'a [[usize; 2]],
    /// Whether landmarks have numbers, from 0.
    pub numbers: bool,
}

/// Pieces of a line of a grid for each cell.
pub const PARTS: usize = 4;

/// Draws a warp. `folds`: nodes of the grid at which it folds.
pub fn draw_warp(view: WarpView, figure: &WarpFigure<'_>, folds: usize) -> Drawing {
    let energy = short(figure.warp.bending_energy());
    let mut legend = vec![Entry::Text(format!("bending energy {energy}"))];
    if folds > 0 {
        legend.push(Entry::Text(format!("the map folds at {folds} nodes of the grid")));
    }
    let d = figure.reference.ncols();
    let title = format!("thin-plate spline of {} landmarks", figure.reference.nrows());
    if view == WarpView::Grid && d == 3 {
        let planes = [("x, y", [0, 1]), ("x, z", [0, 2])];
        let cells = planes.map(|(name, axes)| (name.to_owned(), figure.grid(axes)));
        return layout::grid(&title, cells.into()).with_legend(&legend);
    }
    let layers = match view {
        WarpView::Grid => figure.grid([0, 1]),
        WarpView::Arrows => figure.arrows(),
        WarpView::Wireframe => figure.wireframe(),
    };
    let samples = Entry::of(&layers);
    layout::overlay(&title, layers, &samples).with_legend(&legend)
}

impl WarpFigure<'_> {
    /// The deformed grid in the plane of two axes, with the target in front.
    fn grid(&self, axes: [usize; 2]) -> Vec<Layer> {
        let centre: Vec<f64> = self.reference.column_iter().map(|column| column.mean()).collect();
        let lines = self.lattice.lines(axes, &centre, PARTS);
        let images: Vec<Matrix> =
            lines.iter().map(|line| self.warp.warped(line).select_columns(&axes)).collect();
        let target = self.target.select_columns(&axes);
        let mut layers = vec![polylines(&images, colour::BACK, 0.8)];
        layers.extend(self.links(&target, colour::MAIN));
        layers.push(dots(&target, colour::MAIN).named("target"));
        layers.extend(self.words(&target));
        layers
    }

    fn arrows(&self) -> Vec<Layer> {
        let ends = |k: usize| Matrix::from_rows(&[self.reference.row(k), self.target.row(k)]);
        let ends: Vec<Matrix> = (0..self.reference.nrows()).map(ends).collect();
        let mut layers: Vec<Layer> = self.links(self.reference, colour::PALE).into_iter().collect();
        layers.push(dots(self.reference, colour::MAIN).named("reference"));
        let arrows = Layer { mark: Mark::Arrows, ..polylines(&ends, colour::PLUS, 2.0) };
        layers.push(arrows.named("to the target"));
        layers.extend(self.words(self.reference));
        layers
    }

    fn wireframe(&self) -> Vec<Layer> {
        let mut layers: Vec<Layer> = self.links(self.reference, colour::PALE).into_iter().collect();
        layers.push(dots(self.reference, colour::PALE).named("reference"));
        layers.extend(self.links(self.target, colour::MAIN));
        layers.push(dots(self.target, colour::MAIN).named("target"));
        layers.extend(self.words(self.target));
        layers
    }

    /// Lines between linked landmarks, if there are any.
    fn links(&self, points: &Matrix, colour: Colour) -> Option<Layer> {
        let lines: Vec<Matrix> = self.links.iter().map(|link| points.select_rows(link)).collect();
        (!lines.is_empty()).then(|| polylines(&lines, colour, 1.5))
    }

    /// The numbers of the landmarks.
    fn words(&self, points: &Matrix) -> Option<Layer> {
        let rows = rows(points);
        let places: Vec<&[f64]> = rows.iter().map(Vec::as_slice).collect();
        let words = (0..rows.len()).map(|k| k.to_string()).collect();
        self.numbers.then(|| Layer::words(&places, words, colour::MAIN))
    }
}

fn rows(points: &Matrix) -> Vec<Vec<f64>> {
    points.row_iter().map(|row| row.iter().copied().collect()).collect()
}

/// An open line through points, one per row.
fn polyline(points: &Matrix, colour: Colour) -> Layer {
    let rows = rows(points);
    let points: Vec<&[f64]> = rows.iter().map(Vec::as_slice).collect();
    Layer::from_polyline(&points, false, colour)
}

fn dots(points: &Matrix, colour: Colour) -> Layer {
    Layer { mark: Mark::Dots, width: 1.5, ..polyline(points, colour) }
}

/// Open lines through the rows of matrices.
fn polylines(lines: &[Matrix], colour: Colour, width: f64) -> Layer {
    let lines = lines.iter().flat_map(|line| polyline(line, colour).lines).collect();
    Layer { lines, width, ..Layer::from_polyline(&[], false, colour) }
}
