//! Drawings of symmetry: where the sides differ, along the average, with the axis; and axes of a curve.

use super::View;
use super::studies::{GROUP_COLOURS, probability};
use crate::alignment::Method;
use crate::metric::Metric;
use crate::rows::columns_of;
use crate::symmetry::records::{AsymmetryPoint, CurvePlaneRecord, SymmetryRecord, SymmetryTerm};
use shapelex_geometry::drawing::colour::{self, Colour};
use shapelex_geometry::drawing::effect::{Connection, Effect, EffectPoint};
use shapelex_geometry::drawing::layer::Layer;
use shapelex_geometry::drawing::layout;
use shapelex_geometry::drawing::legend::Entry;
use shapelex_geometry::drawing::scene::{Drawing, short};
use shapelex_geometry::representation::ShapeSpace;

/// Length of an axis beyond the farthest point.
const BEYOND: f64 = 1.1;

/// Directional and fluctuating asymmetry along the average, side by side on separate scales, over the table.
pub fn draw_symmetry(
    (space, metric, method): (&ShapeSpace, &Metric, &Method),
    title: &str,
    record: &SymmetryRecord,
) -> Drawing {
    let average = columns_of(&record.average, metric.dimension());
    let view = View::upright(space, method, &average);
    let turned = view.orientation.turn(&average);
    let normal = record.plane.as_ref().filter(|plane| plane.axis_degrees.is_some());
    let axis = normal.map(|plane| {
        let centre = metric.centroid(&turned);
        axis(&turned, &centre, &view.orientation.turn(&plane.normal), colour::PALE)
    });
    let of = |length: &dyn Fn(&AsymmetryPoint) -> f64| record.map.iter().map(length).collect::<Vec<f64>>();
    let kinds =
        [("directional", of(&|point| point.directional)), ("fluctuating", of(&|point| point.fluctuating))];
    let mut legend = Vec::new();
    let cells = kinds.map(|(name, lengths)| {
        let points = record.map.iter().zip(lengths).map(|(point, length)| EffectPoint {
            point: view.orientation.turn(&point.point),
            length,
            significant: false,
        });
        let effect = Effect {
            points: points.collect(),
            connection: Connection::of(space, &turned),
            colours: (colour::EFFECT_NONE, colour::EFFECT_MOST),
        };
        let largest = effect.largest();
        legend.push(effect.scale(format!("{name} asymmetry: 0 to {}", short(largest))));
        let mut layers: Vec<Layer> = axis.iter().cloned().collect();
        layers.extend(effect.layers(largest, 1.0));
        (format!("{name} asymmetry"), layers)
    });
    legend.extend(record.table.terms.iter().map(|term| Entry::Text(line(term))));
    layout::grid(title, cells.into()).with_legend(&legend)
}

/// A row of the table in words.
fn line(term: &SymmetryTerm) -> String {
    let row = &term.row;
    let name = match row.term.as_str() {
        "side" => "side (directional)",
        "individual:side" => "individual × side (fluctuating)",
        other => other,
    };
    let mut line = format!("{name}: df {}, R² {:.3}", row.degrees, row.r_squared);
    if let Some(f) = row.f {
        line += &format!(", F {}", short(f));
    }
    if let (Some(z), Some(p)) = (row.z, row.p) {
        line += &format!(", Z {z:.2}, p {}", probability(p));
    }
    line
}

/// A line through `centre` across all points of a planar shape (coordinate-major), at a right angle to `normal`.
fn axis(points: &[f64], centre: &[f64], normal: &[f64], colour: Colour) -> Layer {
    let (x, y) = points.split_at(points.len() / 2);
    let farthest = x.iter().zip(y).map(|(x, y)| (x - centre[0]).hypot(y - centre[1])).fold(0.0, f64::max);
    let reach = BEYOND * farthest;
    let at = |side: f64| [centre[0] - side * reach * normal[1], centre[1] + side * reach * normal[0]];
    Layer::from_polyline(&[&at(-1.0), &at(1.0)], false, colour)
}

/// A closed curve (points, coordinate-major) with its planes, the best one first; in space the curve alone.
pub fn draw_planes(points: &[f64], dimension: usize, planes: &[CurvePlaneRecord]) -> Drawing {
    let size = points.len() / dimension;
    let rows: Vec<Vec<f64>> =
        (0..size).map(|k| (0..dimension).map(|c| points[c * size + k]).collect()).collect();
    let rows: Vec<&[f64]> = rows.iter().map(Vec::as_slice).collect();
    let mut layers = vec![Layer::from_polyline(&rows, true, colour::MAIN)];
    let mean = |c: usize| points[c * size..(c + 1) * size].iter().sum::<f64>() / size as f64;
    let mut legend = Vec::new();
    for (found, colour) in planes.iter().zip(GROUP_COLOURS.iter().cycle()) {
        let plane = &found.plane;
        let told = match plane.axis_degrees {
            Some(degrees) => format!("axis at {}°, asymmetry {}", short(degrees), short(plane.asymmetry)),
            None => format!("asymmetry {}", short(plane.asymmetry)),
        };
        match dimension {
            2 => layers.push(axis(points, &[mean(0), mean(1)], &plane.normal, *colour).named(told)),
            _ => legend.push(Entry::Text(told)),
        }
    }
    legend.splice(0..0, Entry::of(&layers));
    layout::overlay("planes of symmetry", layers, &legend)
}
