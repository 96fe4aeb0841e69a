//! Drawings of completed shapes with their bands.

use super::View;
use crate::dictionary::posterior::predicted::Predicted;
use shapelex_geometry::drawing::colour::{self, Colour};
use shapelex_geometry::drawing::effect::{Connection, Effect, EffectPoint};
use shapelex_geometry::drawing::layer::Layer;
use shapelex_geometry::drawing::layout;
use shapelex_geometry::drawing::legend::Entry;
use shapelex_geometry::drawing::scene::{Drawing, short};
use shapelex_numeric::dense::{Matrix, symmetric_eigen};

/// A completed shape.
#[derive(Debug, Clone)]
pub struct Completed {
    /// Text below the drawing.
    pub caption: String,
    /// Its control points, `d·N` coordinate-major numbers.
    pub control_points: Vec<f64>,
    /// The points that were seen.
    pub seen: Vec<Vec<f64>>,
    /// Places along it, with their covariances.
    pub predicted: Predicted,
    /// Factors of the pointwise and the simultaneous band.
    pub factors: [f64; 2],
    /// Which places were seen.
    pub observed: Vec<bool>,
}

/// Corners of a drawn ellipse.
const CORNERS: usize = 32;
/// Factor of the widths of lines and dots in space.
const SPACE: f64 = 0.5;

/// Completed shapes side by side: in the plane with the regions of hidden places, in space coloured by their size. `unit`: the unit of
/// length.
pub fn draw_completed(view: &View<'_>, title: &str, shapes: &[Completed], unit: Option<&str>) -> Drawing {
    let dimension = view.space.representation().dimension();
    if dimension != 2 {
        return draw_sizes(view, title, shapes, unit);
    }
    let cells = shapes.iter().map(|shape| (shape.caption.clone(), layers(view, shape))).collect();
    let mut legend: Vec<Entry> = Vec::new();
    if let Some(shape) = shapes.first() {
        let sample =
            |colour: Colour, width: f64| view.layer([shape.control_points.as_slice()], colour, width, 1.0);
        legend = Entry::of(&[
            sample(colour::MAIN, 1.5).named("completed shape"),
            sample(colour::PLUS, 1.0).named("region of each hidden place alone"),
            sample(colour::BACK, 1.0).named("regions of all hidden places together"),
        ]);
        legend.push(Entry::Text("dots: what was seen".into()));
    }
    layout::grid(title, cells).with_legend(&legend)
}

fn layers(view: &View<'_>, shape: &Completed) -> Vec<Layer> {
    let Completed { predicted, factors, observed, .. } = shape;
    let count = predicted.covariances.len();
    let hidden: Vec<usize> = (0..count).filter(|&i| !observed.get(i).copied().unwrap_or(false)).collect();
    let regions = |factor: f64, colour: Colour, opacity: f64| {
        let ellipses = hidden.iter().map(|&i| {
            let at = [predicted.points[i], predicted.points[count + i]];
            ellipse(at, &predicted.covariances[i], factor)
        });
        lines(ellipses.collect(), colour, 1.0, opacity)
    };
    let mut layers: Vec<Layer> = Vec::new();
    layers.extend(regions(factors[1], colour::BACK, 0.55));
    layers.extend(regions(factors[0], colour::PLUS, 0.65));
    layers.push(view.layer([shape.control_points.as_slice()], colour::MAIN, 1.5, 1.0));
    let dot = 0.006 * extent(&shape.predicted.points, count);
    let crosses = shape.seen.iter().map(|p| ellipse([p[0], p[1]], &Matrix::identity(2, 2), dot));
    layers.extend(lines(crosses.collect(), colour::PALE, 1.5, 1.0));
    layers
}

/// A layer of closed lines; `None` without lines.
pub(super) fn lines(polygons: Vec<Vec<[f64; 2]>>, colour: Colour, width: f64, opacity: f64) -> Option<Layer> {
    let first = polygons.first()?;
    let corners: Vec<&[f64]> = first.iter().map(|point| point.as_slice()).collect();
    let mut layer = Layer::from_polyline(&corners, true, colour);
    (layer.lines, layer.width, layer.opacity) = (polygons, width, opacity);
    Some(layer)
}

/// `{x : (x − at)ᵀ C⁻¹ (x − at) = factor²}` as a polygon.
pub(super) fn ellipse(at: [f64; 2], covariance: &Matrix, factor: f64) -> Vec<[f64; 2]> {
    let eigen = symmetric_eigen(covariance);
    let axes: Vec<f64> = eigen.eigenvalues.iter().map(|value| factor * value.max(0.0).sqrt()).collect();
    let corner = |k: usize| {
        let (sin, cos) = (std::f64::consts::TAU * k as f64 / CORNERS as f64).sin_cos();
        let v = &eigen.eigenvectors;
        [0, 1].map(|c| at[c] + axes[0] * cos * v[(c, 0)] + axes[1] * sin * v[(c, 1)])
    };
    (0..CORNERS).map(corner).collect()
}

fn extent(points: &[f64], count: usize) -> f64 {
    let of = |c: usize| {
        let coordinate = &points[c * count..(c + 1) * count];
        let (low, high) = coordinate.iter().fold((f64::MAX, f64::MIN), |(l, h), x| (l.min(*x), h.max(*x)));
        high - low
    };
    of(0).max(of(1))
}

/// Shapes in space, coloured by the largest deviation of each place in the simultaneous band.
fn draw_sizes(view: &View<'_>, title: &str, shapes: &[Completed], unit: Option<&str>) -> Drawing {
    let effect = |shape: &Completed| {
        let count = shape.predicted.covariances.len();
        let point = |(i, deviation): (usize, f64)| EffectPoint {
            point: (0..3).map(|c| shape.predicted.points[c * count + i]).collect(),
            length: shape.factors[1] * deviation,
            significant: true,
        };
        Effect {
            points: shape.predicted.deviations().into_iter().enumerate().map(point).collect(),
            connection: Connection::of(view.space, &shape.control_points),
            colours: (colour::EFFECT_NONE, colour::EFFECT_MOST),
        }
    };
    let effects: Vec<Effect> = shapes.iter().map(effect).collect();
    let most = effects.iter().map(Effect::largest).fold(0.0, f64::max);
    let cells = shapes
        .iter()
        .zip(&effects)
        .map(|(shape, effect)| (shape.caption.clone(), effect.layers(most, SPACE)));
    let cells: Vec<_> = cells.collect();
    let length = unit.map_or_else(|| short(most), |unit| format!("{} {unit}", short(most)));
    let meaning =
        format!("completed shape, coloured by the largest deviation of the simultaneous band: 0 to {length}");
    let legend: Vec<Entry> = effects.first().map(|effect| effect.scale(meaning)).into_iter().collect();
    layout::grid(title, cells).with_legend(&legend)
}
