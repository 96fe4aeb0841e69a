//! Drawings of comparisons and regressions.

use super::View;
use crate::alignment::{Method, norms};
use crate::inference::compare::{scatter_text, unequal_spreads};
use crate::inference::records::{GroupComparison, PairRecord, Prediction, RegressionRecord, TestRecord};
use crate::metric::Metric;
use crate::rows::columns_of;
use shapelex_geometry::drawing::colour::{self, Colour};
use shapelex_geometry::drawing::effect::{Connection, Effect, EffectPoint as DrawnPoint};
use shapelex_geometry::drawing::layer::Layer;
use shapelex_geometry::drawing::layout;
use shapelex_geometry::drawing::legend::Entry;
use shapelex_geometry::drawing::scene::{Drawing, short};
use shapelex_geometry::representation::ShapeSpace;

/// Maximum p value of points drawn as wide.
const SIGNIFICANT: f64 = 0.05;

/// Colours of the groups, used cyclically (colour-blind safe).
pub(super) const GROUP_COLOURS: [Colour; 6] = [
    colour::MINUS,
    colour::PLUS,
    Colour::new(0x22_88_33, 0x63_c6_7c),
    Colour::new(0xaa_33_77, 0xe5_83_bd),
    Colour::new(0x99_77_00, 0xdd_c8_55),
    Colour::new(0x00_8c_a8, 0x66_d4_ee),
];

/// Drawing of the averages of all groups on top of one another, with the effect along the first group of the pair with
/// the largest distance; the averages at equal size where sizes are removed. `cohort`: its name.
pub fn draw_comparison(
    (space, metric, method): (&ShapeSpace, &Metric, &Method),
    cohort: &str,
    comparison: &GroupComparison,
) -> Drawing {
    let d = space.representation().dimension();
    let pooled = columns_of(&comparison.pooled.control_points, d);
    let view = View::upright(space, method, &pooled);
    let at_size = |average: &[Vec<f64>]| at_size_of(&pooled, columns_of(average, d), (metric, method));
    let layers: Vec<Layer> = comparison
        .groups
        .iter()
        .zip(GROUP_COLOURS.iter().cycle())
        .map(|(group, colour)| {
            let (average, _) = at_size(&group.average);
            let name = format!("{} (n = {})", group.name, group.shapes);
            view.layer([average.as_slice()], *colour, 1.5, 0.9).named(name)
        })
        .collect();
    let distance = |pair: &PairRecord| pair.distance.value.unwrap_or_default();
    let farthest = comparison.pairs.iter().max_by(|a, b| distance(a).total_cmp(&distance(b)));
    let Some(pair) = farthest else { return layout::draw("", layers) };
    let first = comparison.groups.iter().find(|group| group.name == pair.first);
    let first = first.unwrap_or(&comparison.groups[0]);
    let effect = effect_along(&view, pair, at_size(&first.average));
    let mut legend = Entry::of(&layers);
    legend.push(Entry::Text(difference(pair)));
    legend
        .extend(unequal_spreads(comparison.groups.iter()).map(|unequal| Entry::Text(scatter_text(unequal))));
    legend.push(effect.scale(scale_text(pair, &effect)));
    if let Some(overall) = &comparison.overall {
        legend.push(Entry::Text(format!("all groups together{}", in_brackets(&overall.pseudo_f.test))));
    }
    let mut drawn = effect.layers(effect.largest(), 1.0);
    // Surfaces would hide the effect, so that the sheet that carries it replaces them.
    if !space.domain().is_surface() {
        drawn.extend(layers);
    }
    layout::overlay(&format!("{} groups of {cohort}", comparison.groups.len()), drawn, &legend)
}

/// A shape at the size of another one where the class removes sizes, and the factor by which it was scaled.
fn at_size_of(other: &[f64], mut shape: Vec<f64>, (metric, method): (&Metric, &Method)) -> (Vec<f64>, f64) {
    let size = |shape: &[f64]| norms(metric, method, shape)[0];
    let factor = if method.keeps_sizes() { 1.0 } else { size(other) / size(&shape) };
    if !factor.is_finite() {
        return (shape, 1.0);
    }
    shape.iter_mut().for_each(|value| *value *= factor);
    (shape, factor)
}

/// The effect of a pair along the average of its first group, which is drawn scaled by a factor.
fn effect_along(view: &View<'_>, pair: &PairRecord, (average, factor): (Vec<f64>, f64)) -> Effect {
    let scaled = |point: &[f64]| point.iter().map(|value| factor * value).collect::<Vec<_>>();
    let points = pair.effect.iter().map(|point| DrawnPoint {
        point: view.orientation.turn(&scaled(&point.point)),
        length: point.length,
        significant: point.p.is_some_and(|p| p <= SIGNIFICANT),
    });
    Effect {
        points: points.collect(),
        connection: Connection::of(view.space, &view.orientation.turn(&average)),
        colours: (colour::EFFECT_NONE, colour::EFFECT_MOST),
    }
}

/// Meaning of the colours and widths of an effect.
fn scale_text(pair: &PairRecord, effect: &Effect) -> String {
    format!(
        "distance from {} to {}: 0 to {}; {} where they differ even at this place (p ≤ 0.05 over all places)",
        pair.first,
        pair.second,
        short(effect.largest()),
        effect.emphasis()
    )
}

/// Result for a pair, and meaning of the colours.
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
pub(super) fn probability(p: f64) -> String {
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

/// Drawing of the predicted shapes from the 5 % to the 95 % quantile of the attribute. `cohort`: its name; `unit`: its unit of
/// length.
pub fn draw_regression(
    (space, method): (&ShapeSpace, &Method),
    (cohort, unit): (&str, Option<&str>),
    shapes: usize,
    regression: &RegressionRecord,
) -> Drawing {
    let d = space.representation().dimension();
    let [Some(low), Some(high)] = [regression.predictions.first(), regression.predictions.last()] else {
        return layout::draw("", Vec::new());
    };
    let view = View::upright(space, method, &columns_of(&regression.average, d));
    let (from, to) = (columns_of(&low.control_points, d), columns_of(&high.control_points, d));
    let quantity = Quantity::of(&regression.attribute.name, unit);
    let layer = |(i, colour): (usize, &Colour)| {
        let part = i as f64 / (SHADES.len() - 1) as f64;
        let between = |a: f64, b: f64| (1.0 - part) * a + part * b;
        let shape: Vec<f64> = from.iter().zip(&to).map(|(a, b)| between(*a, *b)).collect();
        let value = quantity.value(between(low.attribute, high.attribute));
        view.layer([shape.as_slice()], *colour, 2.0, 1.0).named(value)
    };
    let layers: Vec<Layer> = SHADES.iter().enumerate().map(layer).collect();
    let mut legend = Entry::of(&layers);
    legend.push(Entry::Text(format!(
        "shapes as predicted by {}, from its {} to its {}",
        quantity.name,
        quantile(low),
        quantile(high)
    )));
    legend.push(Entry::Text(explained(&quantity.name, regression)));
    let title = format!("{} of {shapes} shapes of {cohort}", quantity.name);
    match space.domain().is_surface() {
        true => layout::draw(&title, layers).with_legend(&legend[SHADES.len()..]),
        false => layout::overlay(&title, layers, &legend),
    }
}

fn quantile(prediction: &Prediction) -> String {
    format!("{:.0} % quantile", 100.0 * prediction.quantile)
}

/// Result of a regression, in words.
fn explained(name: &str, regression: &RegressionRecord) -> String {
    let p = regression.test.p.map_or_else(String::new, |p| format!(" (p = {})", probability(p)));
    format!("{name} explains {:.1} % of the variation of the shapes{p}", 100.0 * regression.r_squared)
}

/// An attribute as readers know it.
struct Quantity {
    name: String,
    unit: String,
    is_logarithm: bool,
}

impl Quantity {
    /// The centroid size is regressed on as its logarithm, and has the unit of length of the cohort.
    fn of(attribute: &str, unit: Option<&str>) -> Self {
        match attribute {
            "log_centroid_size" => Self {
                name: "centroid size".into(),
                unit: unit.map_or_else(String::new, |unit| format!(" {unit}")),
                is_logarithm: true,
            },
            other => {
                let name = other.strip_prefix("labels.").unwrap_or(other).to_owned();
                Self { name, unit: String::new(), is_logarithm: false }
            }
        }
    }

    /// A value of the attribute as text.
    fn value(&self, value: f64) -> String {
        let value = if self.is_logarithm { value.exp() } else { value };
        format!("{}{}", short(value), self.unit)
    }
}
