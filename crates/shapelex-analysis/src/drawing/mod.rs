//! Drawings of results: means, modes and atoms here; [`studies`] — comparisons and regressions; [`report`] — report cards;
//! [`blocks`], [`symmetry`] — blocks, modules and symmetry; [`completed`] — completed shapes with bands; [`coded`] — shapes beside their
//! reconstructions by a dictionary; [`nearest`] — shapes beside their neighbours; [`drift`] — new shapes against old ones;
//! [`warps`] — thin-plate splines; [`elastic`] — elastic matches.

pub mod blocks;
pub mod coded;
pub mod completed;
pub mod drift;
pub mod elastic;
pub mod models;
pub mod morphospace;
pub mod nearest;
pub mod repeatability;
pub mod report;
pub mod studies;
pub mod symmetry;
pub mod warps;

use crate::alignment::{AlignedShape, Method, unwhitened};
use crate::dictionary::content::Content;
use crate::dictionary::in_use::Dictionary;
use crate::metric::Metric;
use crate::rows::columns_of;
use shapelex_geometry::capability::domain::Domain;
use shapelex_geometry::drawing::colour::{self, Colour};
use shapelex_geometry::drawing::layer::Layer;
use shapelex_geometry::drawing::layout;
use shapelex_geometry::drawing::legend::Entry;
use shapelex_geometry::drawing::orientation::Orientation;
use shapelex_geometry::drawing::scene::Drawing;
use shapelex_geometry::representation::ShapeSpace;

/// Shapes of a space in the orientation in which they are drawn.
#[derive(Debug)]
pub struct View<'a> {
    space: &'a ShapeSpace,
    orientation: Orientation,
}

impl<'a> View<'a> {
    /// Shapes as they are.
    pub fn as_given(space: &'a ShapeSpace) -> Self {
        Self { space, orientation: Orientation::as_given() }
    }

    /// Shapes turned as the reference, given by control points, is to stand upright. Under a method that removes no rotations
    /// the orientation of shapes means something, and stays.
    pub fn upright(space: &'a ShapeSpace, method: &Method, reference: &[f64]) -> Self {
        match method.rotates() {
            true => Self { space, orientation: Orientation::upright(space, reference) },
            false => Self::as_given(space),
        }
    }

    fn layer<'b>(
        &self,
        shapes: impl IntoIterator<Item = &'b [f64]>,
        colour: Colour,
        width: f64,
        opacity: f64,
    ) -> Layer {
        let turned: Vec<Vec<f64>> = shapes.into_iter().map(|shape| self.orientation.turn(shape)).collect();
        Layer::of(self.space, turned.iter().map(Vec::as_slice), colour, width, opacity)
    }

    fn arrows(&self, ends: [&[f64]; 2], colour: Colour, width: f64) -> Layer {
        let [from, to] = ends.map(|shape| self.orientation.turn(shape));
        Layer::arrows(self.space, [&from, &to], colour, width)
    }
}

/// A mean (control points) of `total` shapes with at most `most` of the aligned shapes behind it.
pub fn draw_mean(
    view: &View<'_>,
    metric: &Metric,
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
        view.layer(behind.iter().map(Vec::as_slice), colour::BACK, 1.0, opacity).named(name),
        view.layer([mean], colour::MAIN, 2.5, 1.0).named("mean"),
    ];
    layout::draw(title, layers)
}

/// A mode: the control points of `mean − sigma·s ξ`, of the mean, and of `mean + sigma·s ξ`.
///
/// Curves are drawn at five steps side by side, each before the mean; surfaces at three. Landmarks are drawn once, with arrows
/// from one side of the mode to the other.
pub fn draw_mode(view: &View<'_>, title: &str, sigma: f64, shapes: &[Vec<f64>; 3]) -> Drawing {
    let [minus, mean, plus] = shapes;
    let domain = view.space.domain();
    if domain == Domain::Points {
        let ends = [minus.as_slice(), plus.as_slice()];
        let name = format!("{} to {}", deviations(-sigma), deviations(sigma));
        let layers = vec![
            view.layer([mean.as_slice()], colour::MAIN, 1.5, 1.0).named("mean"),
            view.arrows(ends, colour::PLUS, 2.0).named(name),
        ];
        return layout::draw(title, layers);
    }
    if domain.is_surface() {
        let captions = [-1.0, 0.0, 1.0].map(|side| deviations(side * sigma));
        return layout::grid(
            title,
            surfaces(view, shapes).zip(captions).map(|(s, c)| (c, vec![s])).collect(),
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
            view.layer([mean.as_slice()], colour::PALE, 1.0, 1.0),
            view.layer([shape.as_slice()], colour, 2.0, 1.0),
        ];
        (deviations(side * sigma), layers)
    };
    layout::row(title, [-1.0, -0.5, 0.0, 0.5, 1.0].map(cell).into())
}

/// Title of a mode that explains a part of the variance, or of the energy of shapes that were not centred.
pub fn mode_title(component: usize, explained: f64, centred: bool) -> String {
    let of = if centred { "the variation" } else { "the energy" };
    format!("mode {component}: {:.1} % of {of}; σ is the standard deviation", 100.0 * explained)
}

/// Layers of one surface each.
fn surfaces<'a>(view: &View<'_>, shapes: &'a [Vec<f64>]) -> impl Iterator<Item = Layer> + use<'a> {
    let all = view.layer(shapes.iter().map(Vec::as_slice), colour::BACK, 1.0, 1.0);
    all.apart().collect::<Vec<_>>().into_iter()
}

/// A number of standard deviations as text.
fn deviations(sigma: f64) -> String {
    if sigma == 0.0 {
        return "0 σ".into();
    }
    let sign = if sigma < 0.0 { '−' } else { '+' };
    format!("{sign}{} σ", sigma.abs())
}

/// The atoms of a dictionary, each in its own frame on a common scale. For components of surfaces, and of curves about a mean,
/// which are not such shapes themselves, both sides of the modes.
pub fn draw_atoms(view: &View<'_>, name: &str, dictionary: &Dictionary) -> Drawing {
    let content = &dictionary.content;
    let title = match content.method.is_sparse() {
        true => format!("atoms of {name}, and how many shapes use them"),
        false if dictionary.is_centred() => format!("components of {name}, and their part of the variation"),
        false => format!("components of {name}, and their part of the energy"),
    };
    if content.atoms.is_empty() {
        // Shapes that do not vary have a mean, and nothing besides.
        let mean = mean_of(dictionary);
        return layout::draw(
            &title,
            vec![view.layer([mean.as_slice()], colour::MAIN, 1.5, 1.0).named("mean")],
        );
    }
    if view.space.domain().is_surface() && !content.method.is_sparse() {
        let cells = both_sides(view, dictionary);
        let columns = cells.len().min(SIDES_IN_A_ROW);
        return layout::in_columns(&title, cells, columns);
    }
    if dictionary.is_centred() && view.space.domain() != Domain::Points {
        return draw_components(view, &title, dictionary);
    }
    let cell = |j: usize| {
        let atom = dictionary.atom(j);
        (caption(content, j), vec![view.layer([atom.as_slice()], colour::MAIN, 1.5, 1.0)])
    };
    layout::grid(&title, (0..content.atoms.len()).map(cell).collect())
}

/// Both sides of the modes of curves before their mean: components about a mean are differences, not curves.
fn draw_components(view: &View<'_>, title: &str, dictionary: &Dictionary) -> Drawing {
    let sides = [("mean", colour::PALE), ("−2 σ", colour::MINUS), ("+2 σ", colour::PLUS)];
    let layer = |shape: &[f64], colour| view.layer([shape], colour, 1.5, 1.0);
    let cell = |j: usize| {
        let [minus, mean, plus] = dictionary.mode(j, SIGMA)?.shapes;
        let shapes = [mean, minus, plus].into_iter().zip(sides);
        let layers = shapes.map(|(shape, (_, colour))| layer(&shape, colour));
        Some((caption(&dictionary.content, j), layers.collect::<Vec<_>>()))
    };
    let cells: Vec<_> = (0..dictionary.content.atoms.len()).filter_map(cell).collect();
    let mean = mean_of(dictionary);
    let samples = sides.map(|(name, colour)| layer(&mean, colour).named(name));
    layout::grid(title, cells).with_legend(&Entry::of(&samples))
}

/// The view of a dictionary: its mean upright.
pub fn view_of<'a>(space: &'a ShapeSpace, dictionary: &Dictionary) -> View<'a> {
    View::upright(space, &dictionary.preparation.method, &mean_of(dictionary))
}

/// Control points of the mean, coordinate-major.
fn mean_of(dictionary: &Dictionary) -> Vec<f64> {
    columns_of(&dictionary.content.mean.control_points, dictionary.metric().dimension())
}

/// Maximum number of components of surfaces in a drawing.
const MAX_MODES: usize = 6;
/// Maximum number of surfaces per row: even, so that both sides of a mode are beside each other.
const SIDES_IN_A_ROW: usize = 4;
/// Number of standard deviations of the sides of a mode.
const SIGMA: f64 = 2.0;

/// Both sides of the first modes.
fn both_sides(view: &View<'_>, dictionary: &Dictionary) -> Vec<(String, Vec<Layer>)> {
    let modes = (0..dictionary.content.atoms.len().min(MAX_MODES)).filter_map(|j| {
        let [minus, _, plus] = dictionary.mode(j, SIGMA)?.shapes;
        Some((j, [minus, plus]))
    });
    let cells = modes.flat_map(|(j, sides)| {
        let captions =
            [-SIGMA, SIGMA].map(|s| format!("{}, {}", caption(&dictionary.content, j), deviations(s)));
        let cells = captions.into_iter().zip(surfaces(view, &sides));
        cells.map(|(caption, layer)| (caption, vec![layer])).collect::<Vec<_>>()
    });
    cells.collect()
}

/// Number of an atom, and how much it matters.
fn caption(content: &Content, j: usize) -> String {
    let atom = &content.atoms[j];
    match atom.explained {
        Some(part) => format!("{}: {:.1} %", j + 1, 100.0 * part),
        None => format!("{}: {:.0} %", j + 1, 100.0 * atom.usage),
    }
}
