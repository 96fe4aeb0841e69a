//! Drawings of blocks: singular shapes; and of modules: control points in the colours of their modules.

use super::View;
use super::studies::{GROUP_COLOURS, probability};
use crate::alignment::Method;
use crate::blocks::records::{BlocksRecord, LoadingRecord, ModularityRecord, TestedStatistic};
use crate::rows::columns_of;
use shapelex_geometry::capability::domain::Domain;
use shapelex_geometry::drawing::colour::{self, Colour};
use shapelex_geometry::drawing::layer::Layer;
use shapelex_geometry::drawing::layout::{self, Cell};
use shapelex_geometry::drawing::legend::Entry;
use shapelex_geometry::drawing::scene::{Drawing, short};
use shapelex_geometry::representation::ShapeSpace;

/// Standard deviations of the scores at both ends of a singular shape.
const SIGMA: f64 = 2.0;
/// Pairs of blocks whose statistics are told.
const MOST: usize = 12;

/// The first pair of singular shapes of the first two blocks, from low scores in both to high ones. `spaces`: space of the shapes of
/// each block; `None` for parts, whose control points are drawn, and labels.
pub fn draw_blocks(
    spaces: &[Option<&ShapeSpace>],
    method: &Method,
    title: &str,
    record: &BlocksRecord,
) -> Drawing {
    let mut cells = Vec::new();
    let mut legend = Vec::new();
    let component = record.pairs.first().and_then(|pair| pair.components.first());
    for (k, block) in record.blocks.iter().enumerate().take(2) {
        let Some(component) = component else { continue };
        let loading = if k == 0 { &component.first } else { &component.second };
        match (&block.average, &loading.shape) {
            (Some(average), Some(change)) => {
                let space = spaces.get(k).copied().flatten();
                cells.extend(sides(space, method, &block.name, (average, change, loading.deviation)));
            }
            _ => legend.push(Entry::Text(labels(&block.name, loading))),
        }
    }
    if let Some((_, layers)) = cells.first() {
        legend.splice(0..0, Entry::of(layers));
    }
    for pair in record.pairs.iter().take(MOST) {
        let names = format!("{} and {}", pair.first, pair.second);
        legend.push(Entry::Text(format!("{names}: r {}; RV {}", told(&pair.r), told(&pair.rv))));
    }
    if let Some(overall) = &record.overall {
        legend.push(Entry::Text(format!("mean of r over all pairs: {}", told(overall))));
    }
    layout::grid(title, cells).with_legend(&legend)
}

/// Meaning of one side of a direction.
fn end(sigma: f64) -> String {
    let (side, sign) = if sigma < 0.0 { ("low", "−") } else { ("high", "+") };
    format!("{side} scores in both blocks, {sign}{} σ", sigma.abs())
}

/// A statistic in words.
fn told(statistic: &TestedStatistic) -> String {
    let value = format!("{:.3}", statistic.value);
    match (statistic.z, statistic.p) {
        (Some(z), Some(p)) => format!("{value} (Z {z:.2}, p {})", probability(p)),
        _ => value,
    }
}

/// Coefficients of labels in words.
fn labels(block: &str, loading: &LoadingRecord) -> String {
    let of = |(name, value): (&String, &f64)| format!("{name} {value:+.2}");
    let all: Vec<String> = loading.labels.iter().flatten().map(of).collect();
    format!("{block}: {}", all.join(", "))
}

/// Both sides of a direction about an average.
fn sides(
    space: Option<&ShapeSpace>,
    method: &Method,
    name: &str,
    (average, change, deviation): (&[Vec<f64>], &[Vec<f64>], f64),
) -> Vec<Cell> {
    let dimension = average.first().map_or(2, Vec::len);
    let points = ShapeSpace::of_points(dimension, average.len());
    let Some(space) = space.or(points.as_ref().ok()) else { return Vec::new() };
    let (mean, change) = (columns_of(average, dimension), columns_of(change, dimension));
    let at = |sigma: f64| -> Vec<f64> {
        mean.iter().zip(&change).map(|(mean, change)| mean + sigma * deviation * change).collect()
    };
    let (view, [low, high]) = (View::upright(space, method, &mean), [at(-SIGMA), at(SIGMA)]);
    let layer = |shape: &[f64], colour, width| view.layer([shape], colour, width, 1.0);
    let ends = [(&low, colour::MINUS, -SIGMA), (&high, colour::PLUS, SIGMA)];
    if space.domain().is_surface() {
        let cell = |(shape, colour, sigma): (&Vec<f64>, Colour, f64)| {
            (format!("{name}\n{}", end(sigma)), vec![layer(shape, colour, 1.0)])
        };
        return ends.map(cell).into();
    }
    let mut layers = vec![layer(&mean, colour::PALE, 1.0)];
    if space.domain() == Domain::Points {
        layers.push(view.arrows([&low, &high], colour::PALE, 1.5));
    }
    layers.extend(ends.map(|(shape, colour, sigma)| layer(shape, colour, 1.5).named(end(sigma))));
    vec![(name.to_owned(), layers)]
}

/// The average with the control points of each module in its colour.
pub fn draw_modules(
    (space, method): (&ShapeSpace, &Method),
    title: &str,
    record: &ModularityRecord,
) -> Drawing {
    let dimension = space.representation().dimension();
    let average = columns_of(&record.average, dimension);
    let view = View::upright(space, method, &average);
    let turned = view.orientation.turn(&average);
    let size = turned.len() / dimension;
    let mut layers = vec![view.layer([average.as_slice()], colour::PALE, 1.0, 1.0)];
    for (module, colour) in record.modules.iter().zip(GROUP_COLOURS.iter().cycle()) {
        let Ok(points) = ShapeSpace::of_points(dimension, module.points.len()) else { continue };
        let own = (0..dimension).flat_map(|c| module.points.iter().map(move |&k| c * size + k));
        let own: Vec<f64> = own.map(|k| turned[k]).collect();
        layers.push(Layer::of(&points, [own.as_slice()], *colour, 5.0, 1.0).named(module.name.clone()));
    }
    let mut legend = Entry::of(&layers);
    legend.push(Entry::Text(format!(
        "covariance ratio {}: small where modules covary less with each other than within",
        told(&record.ratio)
    )));
    if record.pairs.len() > 1 {
        for pair in record.pairs.iter().take(MOST) {
            legend.push(Entry::Text(format!("{} and {}: {}", pair.first, pair.second, short(pair.value))));
        }
    }
    layout::overlay(title, layers, &legend)
}
