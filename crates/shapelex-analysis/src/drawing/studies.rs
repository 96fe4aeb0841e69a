//! Drawings of comparisons and regressions.

use crate::inference::records::{GroupComparison, PairRecord, Prediction, RegressionRecord, TestRecord};
use crate::rows::columns_of;
use shapelex_geometry::drawing::effect::{self, Connection, Effect, EffectPoint as DrawnPoint};
use shapelex_geometry::drawing::svg::{self, Layer, colour};
use shapelex_geometry::representation::ShapeSpace;

/// Maximum p value of points drawn as wide.
const SIGNIFICANT: f64 = 0.05;

/// Colours of the groups, used cyclically (colour-blind safe).
const GROUP_COLOURS: [&str; 6] = ["#4477aa", "#cc3311", "#228833", "#aa3377", "#ccbb44", "#66ccee"];

/// Drawing of the averages of all groups on top of one another, with the effect along the first group of the pair with
/// the largest distance. `cohort`: its name.
pub fn draw_comparison(space: &ShapeSpace, cohort: &str, comparison: &GroupComparison) -> String {
    let d = space.representation().dimension();
    let layers: Vec<Layer> = comparison
        .groups
        .iter()
        .enumerate()
        .map(|(g, group)| {
            let control_points = columns_of(&group.average, d);
            let colour = GROUP_COLOURS[g % GROUP_COLOURS.len()];
            Layer::of(space, [control_points.as_slice()], colour, 1.5, 0.9)
                .named(format!("{} (n = {})", group.name, group.shapes))
        })
        .collect();
    let distance = |pair: &PairRecord| pair.distance.value.unwrap_or_default();
    let farthest = comparison.pairs.iter().max_by(|a, b| distance(a).total_cmp(&distance(b)));
    let Some(pair) = farthest else { return effect::draw("", &layers, None, &[]) };
    let points = pair.effect.iter().map(|point| DrawnPoint {
        point: point.point.clone(),
        length: point.length,
        significant: point.p.is_some_and(|p| p <= SIGNIFICANT),
    });
    let first = comparison.groups.iter().find(|group| group.name == pair.first);
    let first = first.unwrap_or(&comparison.groups[0]);
    let effect = Effect {
        points: points.collect(),
        connection: Connection::of(space, &columns_of(&first.average, d)),
        colours: (colour::EFFECT_NONE, colour::EFFECT_MOST),
    };
    let of = |name: &str, test: &TestRecord| match test.p_holm.or(test.p) {
        Some(p) => format!("{name}, p = {p:.2}").replace("p = 0.00", &format!("p = {p:.1e}")),
        None => name.to_owned(),
    };
    let mut captions = vec![
        format!("effect on {}: {} less {}", pair.first, pair.second, pair.first),
        of(&format!("distance {:.3}", distance(pair)), &pair.distance.test),
    ];
    if let Some(chordal) = pair.chordal_distance {
        captions.push(format!("chordal distance {chordal:.3}"));
    }
    captions.push(of("Hotelling", &pair.hotelling.test));
    if let Some(overall) = &comparison.overall {
        captions.push(of("all groups, pseudo-F", &overall.pseudo_f.test));
    }
    let title = format!("{} groups of {cohort}", comparison.groups.len());
    effect::draw(&title, &layers, Some(&effect), &captions)
}

/// Colours from low to high values of the attribute (colour-blind safe).
const SHADES: [&str; 7] = ["#2166ac", "#5a8fc4", "#92b7d8", "#8c8c8c", "#e2a184", "#cf6a53", "#b2182b"];

/// Drawing of the predicted shapes from the 5 % to the 95 % quantile of the attribute. `cohort`: its name.
pub fn draw_regression(
    space: &ShapeSpace,
    cohort: &str,
    shapes: usize,
    regression: &RegressionRecord,
) -> String {
    let d = space.representation().dimension();
    let [Some(low), Some(high)] = [regression.predictions.first(), regression.predictions.last()] else {
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
    let p = regression.test.p.map_or_else(String::new, |p| format!(", p = {p:.4}"));
    let title = format!(
        "{} of {shapes} shapes of {cohort}: R² = {:.3}{p}",
        regression.attribute.name, regression.r_squared
    );
    svg::draw(&title, &layers)
}
