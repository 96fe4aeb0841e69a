//! Drawings of comparisons and regressions.

use crate::inference::records::{GroupComparison, PairRecord, Prediction, RegressionRecord, TestRecord};
use crate::rows::columns_of;
use shapelex_geometry::drawing::colour::{self, Colour};
use shapelex_geometry::drawing::effect::{self, Connection, Effect, EffectPoint as DrawnPoint};
use shapelex_geometry::drawing::layer::Layer;
use shapelex_geometry::drawing::layout;
use shapelex_geometry::drawing::scene::Drawing;
use shapelex_geometry::representation::ShapeSpace;

/// Maximum p value of points drawn as wide.
const SIGNIFICANT: f64 = 0.05;

/// Colours of the groups, used cyclically (colour-blind safe).
const GROUP_COLOURS: [Colour; 6] = [
    colour::MINUS,
    colour::PLUS,
    Colour::new(0x22_88_33, 0x63_c6_7c),
    Colour::new(0xaa_33_77, 0xe5_83_bd),
    Colour::new(0x99_77_00, 0xdd_c8_55),
    Colour::new(0x00_8c_a8, 0x66_d4_ee),
];

/// Drawing of the averages of all groups on top of one another, with the effect along the first group of the pair with
/// the largest distance. `cohort`: its name.
pub fn draw_comparison(space: &ShapeSpace, cohort: &str, comparison: &GroupComparison) -> Drawing {
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
    let Some(pair) = farthest else { return effect::draw("", layers, None, &[]) };
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
    let mut captions = vec![difference(pair)];
    if let Some(overall) = &comparison.overall {
        captions.push(format!("all groups together{}", in_brackets(&overall.pseudo_f.test)));
    }
    let title = format!("{} groups of {cohort}", comparison.groups.len());
    effect::draw(&title, layers, Some(&effect), &captions)
}

/// What was found about a pair, and what the colours mean.
fn difference(pair: &PairRecord) -> String {
    let PairRecord { first, second, distance, .. } = pair;
    let p = in_brackets(&distance.test);
    match distance.test.p_holm.or(distance.test.p) {
        Some(p_value) if p_value > SIGNIFICANT => {
            format!("no difference of {first} and {second} is shown{p}; strongest colour: where most")
        }
        _ => format!("{first} and {second} differ{p}; strongest colour: where most"),
    }
}

/// The p value of a test, in brackets.
fn in_brackets(test: &TestRecord) -> String {
    match (test.p_holm, test.p) {
        (Some(p), _) => format!(" (p = {} after Holm)", probability(p)),
        (None, Some(p)) => format!(" (p = {})", probability(p)),
        _ => String::new(),
    }
}

/// A probability with one digit that counts, or two from a tenth on.
fn probability(p: f64) -> String {
    if p >= 0.1 {
        return format!("{p:.2}");
    }
    let digits = if p > 0.0 { (-p.log10().floor()).clamp(1.0, 6.0) as usize } else { 1 };
    format!("{p:.digits$}")
}

/// Colours from low to high values of the attribute (colour-blind safe).
const SHADES: [Colour; 7] = [
    Colour::new(0x21_66_ac, 0x5a_a9_f5),
    Colour::new(0x5a_8f_c4, 0x86_bc_ee),
    Colour::new(0x92_b7_d8, 0xae_cc_e6),
    Colour::new(0x8c_8c_8c, 0xb8_b8_b8),
    Colour::new(0xe2_a1_84, 0xea_b4_9c),
    Colour::new(0xcf_6a_53, 0xee_8f_78),
    Colour::new(0xb2_18_2b, 0xff_65_5c),
];

/// Drawing of the predicted shapes from the 5 % to the 95 % quantile of the attribute. `cohort`: its name.
pub fn draw_regression(
    space: &ShapeSpace,
    cohort: &str,
    shapes: usize,
    regression: &RegressionRecord,
) -> Drawing {
    let d = space.representation().dimension();
    let [Some(low), Some(high)] = [regression.predictions.first(), regression.predictions.last()] else {
        return layout::draw("", Vec::new());
    };
    let (from, to) = (columns_of(&low.control_points, d), columns_of(&high.control_points, d));
    let last = SHADES.len() - 1;
    let layers: Vec<Layer> = SHADES
        .iter()
        .enumerate()
        .map(|(i, colour)| {
            let part = i as f64 / last as f64;
            let shape: Vec<f64> = from.iter().zip(&to).map(|(a, b)| (1.0 - part) * a + part * b).collect();
            let layer = Layer::of(space, [shape.as_slice()], *colour, 2.0, 1.0);
            let name = |prediction: &Prediction| {
                let of = 100.0 * prediction.quantile;
                format!("{} {:.4} ({of:.0} % quantile)", regression.attribute.name, prediction.attribute)
            };
            match i {
                0 => layer.named(name(low)),
                i if i == last => layer.named(name(high)),
                _ => layer,
            }
        })
        .collect();
    let p = regression.test.p.map_or_else(String::new, |p| format!(", p = {}", probability(p)));
    let title = format!(
        "{} of {shapes} shapes of {cohort}: R² = {:.3}{p}",
        regression.attribute.name, regression.r_squared
    );
    layout::draw(&title, layers)
}
