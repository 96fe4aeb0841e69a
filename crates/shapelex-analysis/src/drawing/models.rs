//! Drawings of linear models: predicted shapes side by side, over the table of the terms.

use super::View;
use super::studies::probability;
use crate::alignment::Method;
use crate::models::records::{AnovaRecord, ModelRecord, PredictionRecord, TermRecord};
use crate::models::study::At;
use crate::rows::columns_of;
use shapelex_geometry::drawing::legend::Entry;
use shapelex_geometry::drawing::scene::{Drawing, short};
use shapelex_geometry::drawing::{colour, layout};
use shapelex_geometry::representation::ShapeSpace;

/// Predictions that are drawn.
const MOST: usize = 12;

/// Predicted shapes of a model, with the table of its terms.
pub fn draw_model(
    (space, method): (&ShapeSpace, &Method),
    cohort: &str,
    shapes: usize,
    model: &ModelRecord,
) -> Drawing {
    let d = space.representation().dimension();
    let title = format!("{} of {shapes} shapes of {cohort}", model.anova.formula);
    let drawn: Vec<(String, Vec<f64>)> = model
        .predictions
        .iter()
        .filter_map(|prediction| Some((caption(prediction), columns_of(prediction.shape.as_ref()?, d))))
        .take(MOST)
        .collect();
    let legend = table(&model.anova);
    let Some((_, first)) = drawn.first() else {
        return layout::draw(&title, Vec::new()).with_legend(&legend);
    };
    let view = View::upright(space, method, first);
    let cells = drawn
        .iter()
        .map(|(name, shape)| (name.clone(), vec![view.layer([shape.as_slice()], colour::MAIN, 2.0, 1.0)]));
    layout::row(&title, cells.collect()).with_legend(&legend)
}

/// Values at which a shape is predicted.
fn caption(prediction: &PredictionRecord) -> String {
    let of = |(name, at): (&String, &At)| match at {
        At::Number(number) => format!("{name} {}", short(*number)),
        At::Level(level) => level.clone(),
    };
    prediction.at.iter().map(of).collect::<Vec<_>>().join(", ")
}

/// The table, a line for each term.
fn table(anova: &AnovaRecord) -> Vec<Entry> {
    let of = |term: &TermRecord| {
        let mut line = format!("{}: df {}, R² {:.3}", term.term, term.degrees, term.r_squared);
        if let Some(f) = term.f {
            line += &format!(", F {}", short(f));
        }
        if let (Some(z), Some(p)) = (term.z, term.p) {
            line += &format!(", Z {z:.2}, p {}", probability(p));
        }
        Entry::Text(line)
    };
    let residual = format!("residuals: df {}, R² {:.3}", anova.residual.degrees, anova.residual.r_squared);
    anova.terms.iter().map(of).chain([Entry::Text(residual)]).collect()
}
