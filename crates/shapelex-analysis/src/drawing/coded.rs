//! Drawings of shapes beside their reconstructions by a dictionary.

use super::View;
use shapelex_geometry::drawing::colour;
use shapelex_geometry::drawing::effect::{Connection, Effect, EffectPoint};
use shapelex_geometry::drawing::layout;
use shapelex_geometry::drawing::legend::Entry;
use shapelex_geometry::drawing::scene::{Drawing, short};
use shapelex_geometry::sampling::Places;
use shapelex_numeric::dense::Matrix;

/// A shape and its reconstruction: control points in one pose.
#[derive(Debug, Clone)]
pub struct Pair {
    /// Text below the drawing.
    pub caption: String,
    /// The shape and its reconstruction.
    pub shapes: [Vec<f64>; 2],
}

/// Number of places on a curve at which the distance is shown.
const PLACES: usize = 256;
/// Factor of the widths of lines.
const SCALE: f64 = 0.6;

/// Drawing of shapes side by side, coloured by the distance to their reconstructions, which are in front of them. `unit`: the
/// unit of length, if the shapes have their sizes.
pub fn draw_pairs(view: &View<'_>, title: &str, pairs: &[Pair], unit: Option<&str>) -> Drawing {
    let effects: Vec<Effect> = pairs.iter().map(|pair| residual(view, &pair.shapes)).collect();
    let most = effects.iter().map(Effect::largest).fold(0.0, f64::max);
    let is_surface = view.space.domain().is_surface();
    let reconstruction = |pair: &Pair| view.layer([pair.shapes[1].as_slice()], colour::MAIN, 1.25, 1.0);
    let cell = |(pair, effect): (&Pair, &Effect)| {
        let mut layers = effect.layers(most, SCALE);
        // A surface would hide the other.
        layers.extend((!is_surface).then(|| reconstruction(pair)));
        (pair.caption.clone(), layers)
    };
    let cells = pairs.iter().zip(&effects).map(cell).collect();
    let length = unit.map_or_else(|| short(most), |unit| format!("{} {unit}", short(most)));
    let meaning = format!("shape, coloured by the distance to its reconstruction: 0 to {length}");
    let mut legend: Vec<Entry> = effects.first().map(|effect| effect.scale(meaning)).into_iter().collect();
    if let Some(pair) = pairs.first().filter(|_| !is_surface) {
        legend.extend(Entry::of(&[reconstruction(pair).named("reconstruction")]));
    }
    layout::grid(title, cells).with_legend(&legend)
}

/// Drawing of shapes side by side.
pub fn draw_side_by_side(view: &View<'_>, title: &str, shapes: &[(String, Vec<f64>)]) -> Drawing {
    let colour = if view.space.domain().is_surface() { colour::BACK } else { colour::MAIN };
    let cell = |(caption, shape): &(String, Vec<f64>)| {
        (caption.clone(), vec![view.layer([shape.as_slice()], colour, 1.5, 1.0)])
    };
    layout::grid(title, shapes.iter().map(cell).collect())
}

/// The distance between two shapes as an effect along the first.
fn residual(view: &View<'_>, shapes: &[Vec<f64>; 2]) -> Effect {
    let space = view.space;
    let places = Places::along(space, PLACES);
    let d = space.representation().dimension();
    let [shape, other] = shapes.each_ref().map(|shape| {
        let turned = view.orientation.turn(shape);
        let points = places.points(space, &Matrix::from_column_slice(turned.len() / d, d, &turned));
        let count = places.count();
        (0..count).map(|k| (0..d).map(|c| points[c * count + k]).collect()).collect::<Vec<Vec<f64>>>()
    });
    let point = |(point, other): (Vec<f64>, Vec<f64>)| {
        let length = point.iter().zip(&other).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
        EffectPoint { point, length, significant: true }
    };
    Effect {
        points: shape.into_iter().zip(other).map(point).collect(),
        connection: Connection::of(space, &view.orientation.turn(&shapes[0])),
        colours: (colour::EFFECT_NONE, colour::EFFECT_MOST),
    }
}
