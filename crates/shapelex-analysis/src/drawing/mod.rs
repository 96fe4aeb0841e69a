//! Drawings of results as SVG: means, modes and atoms here, comparisons and regressions in [`studies`].

pub mod studies;

use crate::alignment::{AlignedShape, unwhitened};
use crate::dictionary::content::Content;
use crate::metric::Metric;
use crate::rows::columns_of;
use shapelex_geometry::drawing::svg::{self, Layer, colour};
use shapelex_geometry::representation::ShapeSpace;

/// A mean (control points) with at most `most` aligned shapes behind it.
pub fn draw_mean(
    (space, metric): (&ShapeSpace, &Metric),
    title: &str,
    mean: &[f64],
    aligned: &[AlignedShape],
    most: usize,
) -> String {
    let behind: Vec<Vec<f64>> =
        aligned.iter().take(most).map(|shape| unwhitened(metric, &shape.whitened)).collect();
    let opacity = (8.0 / (behind.len() as f64 + 1.0)).clamp(0.08, 0.6);
    let layers = [
        Layer::of(space, behind.iter().map(Vec::as_slice), colour::BACK, 1.0, opacity)
            .named(format!("{} aligned shapes", behind.len())),
        Layer::of(space, [mean], colour::MAIN, 2.5, 1.0).named("mean"),
    ];
    svg::draw(title, &layers)
}

/// A mode: the control points of `mean − sigma·s ξ`, of the mean, and of `mean + sigma·s ξ`.
pub fn draw_mode(space: &ShapeSpace, title: &str, sigma: f64, [minus, mean, plus]: &[Vec<f64>; 3]) -> String {
    let layer = |shape: &[f64], colour, width| Layer::of(space, [shape], colour, width, 1.0);
    let layers = [
        layer(minus, colour::MINUS, 2.0).named(format!("−{sigma} σ")),
        layer(plus, colour::PLUS, 2.0).named(format!("+{sigma} σ")),
        layer(mean, colour::MAIN, 2.5).named("mean"),
    ];
    svg::draw(title, &layers)
}

/// The atoms of a dictionary, each in its own frame on a common scale.
pub fn draw_atoms(space: &ShapeSpace, title: &str, content: &Content) -> String {
    let dimension = space.representation().dimension();
    let cells: Vec<(String, Vec<Layer>)> = content
        .atoms
        .iter()
        .enumerate()
        .map(|(j, atom)| {
            let columns = columns_of(&atom.control_points, dimension);
            let layer = Layer::of(space, [columns.as_slice()], colour::MAIN, 1.5, 1.0);
            let caption = match atom.explained {
                Some(part) => format!("{}: {:.1} %", j + 1, 100.0 * part),
                None => format!("{}: used by {:.0} %", j + 1, 100.0 * atom.usage),
            };
            (caption, vec![layer])
        })
        .collect();
    svg::grid(title, &cells)
}
