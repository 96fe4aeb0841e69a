//! Drawings of results: means, modes and atoms here, comparisons and regressions in [`studies`].

pub mod studies;

use crate::alignment::{AlignedShape, unwhitened};
use crate::dictionary::content::Content;
use crate::dictionary::in_use::Dictionary;
use crate::metric::Metric;
use crate::rows::columns_of;
use shapelex_geometry::capability::domain::Domain;
use shapelex_geometry::drawing::colour;
use shapelex_geometry::drawing::layer::Layer;
use shapelex_geometry::drawing::layout;
use shapelex_geometry::drawing::scene::Drawing;
use shapelex_geometry::representation::ShapeSpace;

/// A mean (control points) of `total` shapes with at most `most` of the aligned shapes behind it.
pub fn draw_mean(
    (space, metric): (&ShapeSpace, &Metric),
    title: &str,
    (mean, total): (&[f64], usize),
    aligned: &[AlignedShape],
    most: usize,
) -> Drawing {
    let behind: Vec<Vec<f64>> =
        aligned.iter().take(most).map(|shape| unwhitened(metric, &shape.whitened)).collect();
    let opacity = (8.0 / (behind.len() as f64 + 1.0)).clamp(0.08, 0.6);
    let name = match behind.len() {
        1 if total == 1 => "1 shape".to_owned(),
        all if all == total => format!("{all} shapes"),
        some => format!("{some} of {total} shapes"),
    };
    let layers = vec![
        Layer::of(space, behind.iter().map(Vec::as_slice), colour::BACK, 1.0, opacity).named(name),
        Layer::of(space, [mean], colour::MAIN, 2.5, 1.0).named("mean"),
    ];
    layout::draw(title, layers)
}

/// A mode: the control points of `mean − sigma·s ξ`, of the mean, and of `mean + sigma·s ξ`.
///
/// Curves are drawn at five steps side by side, each before the mean; surfaces at three. Landmarks are drawn once, with arrows
/// from one side of the mode to the other.
pub fn draw_mode(space: &ShapeSpace, title: &str, sigma: f64, shapes: &[Vec<f64>; 3]) -> Drawing {
    let [minus, mean, plus] = shapes;
    let domain = space.domain();
    if domain == Domain::Points {
        let ends = [minus.as_slice(), plus.as_slice()];
        let name = format!("{} to {}", deviations(-sigma), deviations(sigma));
        let layers = vec![
            Layer::of(space, [mean.as_slice()], colour::MAIN, 1.5, 1.0).named("mean"),
            Layer::arrows(space, ends, colour::PLUS, 2.0).named(name),
        ];
        return layout::draw(title, layers);
    }
    if domain.is_surface() {
        let captions = [-1.0, 0.0, 1.0].map(|side| deviations(side * sigma));
        return layout::grid(
            title,
            surfaces(space, shapes).zip(captions).map(|(s, c)| (c, vec![s])).collect(),
        );
    }
    let cell = |side: f64| {
        let end = if side < 0.0 { minus } else { plus };
        let shape: Vec<f64> = mean.iter().zip(end).map(|(m, e)| m + side.abs() * (e - m)).collect();
        let colour = if side == 0.0 {
            colour::MAIN
        } else if side < 0.0 {
            colour::MINUS
        } else {
            colour::PLUS
        };
        let layers = vec![
            Layer::of(space, [mean.as_slice()], colour::PALE, 1.0, 1.0),
            Layer::of(space, [shape.as_slice()], colour, 2.0, 1.0),
        ];
        (deviations(side * sigma), layers)
    };
    layout::row(title, [-1.0, -0.5, 0.0, 0.5, 1.0].map(cell).into())
}

/// Layers of one surface each.
fn surfaces<'a>(space: &ShapeSpace, shapes: &'a [Vec<f64>]) -> impl Iterator<Item = Layer> + use<'a> {
    let all = Layer::of(space, shapes.iter().map(Vec::as_slice), colour::BACK, 1.0, 1.0);
    all.apart().collect::<Vec<_>>().into_iter()
}

/// A number of standard deviations as text.
fn deviations(sigma: f64) -> String {
    if sigma == 0.0 {
        return "mean".into();
    }
    let sign = if sigma < 0.0 { '−' } else { '+' };
    format!("{sign}{} σ", sigma.abs())
}

/// The atoms of a dictionary, each in its own frame on a common scale. For components of surfaces, which are no surfaces
/// themselves, both sides of the modes.
pub fn draw_atoms(space: &ShapeSpace, title: &str, dictionary: &Dictionary) -> Drawing {
    let content = &dictionary.content;
    if space.domain().is_surface() && !content.method.is_sparse() {
        return layout::grid(title, both_sides(space, dictionary));
    }
    let dimension = space.representation().dimension();
    let cell = |j: usize| {
        let columns = columns_of(&content.atoms[j].control_points, dimension);
        (caption(content, j), vec![Layer::of(space, [columns.as_slice()], colour::MAIN, 1.5, 1.0)])
    };
    layout::grid(title, (0..content.atoms.len()).map(cell).collect())
}

/// Maximum number of components of surfaces in a drawing.
const MAX_MODES: usize = 6;
/// Number of standard deviations of the sides of a mode.
const SIGMA: f64 = 2.0;

/// Both sides of the first modes.
fn both_sides(space: &ShapeSpace, dictionary: &Dictionary) -> Vec<(String, Vec<Layer>)> {
    let modes = (0..dictionary.content.atoms.len().min(MAX_MODES)).filter_map(|j| {
        let [minus, _, plus] = dictionary.mode(j, SIGMA)?.shapes;
        Some((j, [minus, plus]))
    });
    let cells = modes.flat_map(|(j, sides)| {
        let captions =
            [-SIGMA, SIGMA].map(|s| format!("{}, {}", caption(&dictionary.content, j), deviations(s)));
        let cells = captions.into_iter().zip(surfaces(space, &sides));
        cells.map(|(caption, layer)| (caption, vec![layer])).collect::<Vec<_>>()
    });
    cells.collect()
}

/// Number of an atom, and how much it matters.
fn caption(content: &Content, j: usize) -> String {
    let atom = &content.atoms[j];
    match atom.explained {
        Some(part) => format!("{}: {:.1} %", j + 1, 100.0 * part),
        None => format!("{}: used by {:.0} %", j + 1, 100.0 * atom.usage),
    }
}
