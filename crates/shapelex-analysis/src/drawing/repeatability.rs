//! Drawing of repeatability: the part of the variance within subjects along the mean shape.

use super::View;
use crate::alignment::Method;
use crate::models::repeatability::records::{Bounded, RepeatabilityRecord};
use crate::rows::columns_of;
use shapelex_geometry::drawing::effect::{Connection, Effect, EffectPoint};
use shapelex_geometry::drawing::legend::Entry;
use shapelex_geometry::drawing::scene::Drawing;
use shapelex_geometry::drawing::{colour, layout};
use shapelex_geometry::representation::ShapeSpace;

/// The mean with the part of the variance within subjects as colour, over the intraclass correlations.
pub fn draw_repeatability(
    (space, method): (&ShapeSpace, &Method),
    cohort: &str,
    found: &RepeatabilityRecord,
) -> Drawing {
    let title = format!("Repeatability of {} subjects of {cohort}", found.subjects);
    let Some(pooled) = &found.pooled else { return layout::draw(&title, Vec::new()) };
    let mean = columns_of(&pooled.control_points, space.representation().dimension());
    let view = View::upright(space, method, &mean);
    let points = found.map.iter().map(|point| EffectPoint {
        point: view.orientation.turn(&point.point),
        length: point.icc.map_or(0.0, |icc| (1.0 - icc).clamp(0.0, 1.0)),
        significant: false,
    });
    let effect = Effect {
        points: points.collect(),
        connection: Connection::of(space, &view.orientation.turn(&mean)),
        colours: (colour::EFFECT_NONE, colour::EFFECT_MOST),
    };
    let values = [("ICC", found.icc), ("agreement", found.agreement), ("consistency", found.consistency)];
    let mut legend: Vec<Entry> =
        values.iter().filter_map(|(name, value)| Some(Entry::Text(text(name, value.as_ref()?)))).collect();
    legend.push(effect.scale("part of the variance within subjects: 0 to 1".into()));
    layout::overlay(&title, effect.layers(1.0, 1.0), &legend)
}

fn text(name: &str, Bounded { value, low, high }: &Bounded) -> String {
    match (low, high) {
        (Some(low), Some(high)) => format!("{name} {value:.3} ({low:.3} to {high:.3})"),
        _ => format!("{name} {value:.3}"),
    }
}
