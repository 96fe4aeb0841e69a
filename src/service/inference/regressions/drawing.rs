//! Drawing of a regression.

use super::RegressedShapes;
use crate::analysis::inference::records::Prediction;
use crate::analysis::rows::columns_of;
use crate::domain::study::ShapeRegression;
use crate::geometry::drawing::svg::{self, Layer};
use crate::service::inference::study::Study;

/// Colours from low to high values of the attribute (colour-blind safe).
const SHADES: [&str; 7] = ["#2166ac", "#5a8fc4", "#92b7d8", "#8c8c8c", "#e2a184", "#cf6a53", "#b2182b"];

/// Drawing of the predicted shapes from the 5 % to the 95 % quantile of the attribute.
pub(super) fn draw(study: &Study<RegressedShapes>, regression: &ShapeRegression) -> String {
    let (space, d) = (&study.setup.space, study.setup.metric.dimension());
    let [Some(low), Some(high)] = [regression.found.predictions.first(), regression.found.predictions.last()]
    else {
        return svg::draw("", &[]);
    };
    let (from, to) = (columns_of(&low.control_points, d), columns_of(&high.control_points, d));
    let last = SHADES.len() - 1;
    let layers: Vec<Layer> = SHADES
        .iter()
        .enumerate()
        .map(|(i, colour)| {
            let part = i as f64 / last as f64;
            let shape: Vec<f64> = from.iter().zip(&to).map(|(a, b)| (1.0 - part) * a + part * b).collect();
            let layer = Layer::of(space, [shape.as_slice()], colour, 2.0, 1.0);
            let name = |prediction: &Prediction| {
                format!("{:.0} %: {:.4}", 100.0 * prediction.quantile, prediction.attribute)
            };
            match i {
                0 => layer.named(name(low)),
                i if i == last => layer.named(name(high)),
                _ => layer,
            }
        })
        .collect();
    let (header, found) = (&regression.header, &regression.found);
    let p = found.test.p.map_or_else(String::new, |p| format!(", p = {p:.4}"));
    let title = format!(
        "{} of {} shapes of {}: R² = {:.3}{p}",
        found.attribute.name, header.shapes, study.cohort.spec.name, found.r_squared
    );
    svg::draw(&title, &layers)
}
