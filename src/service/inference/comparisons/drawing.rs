//! Drawing of a comparison.

use super::ComparedShapes;
use crate::analysis::inference::records::{PairRecord, TestRecord};
use crate::analysis::rows::columns_of;
use crate::domain::study::Comparison;
use crate::geometry::drawing::effect::{self, Connection, Effect, EffectPoint as DrawnPoint};
use crate::geometry::drawing::svg::{Layer, colour};
use crate::service::inference::study::Study;

/// Colours of the groups, used cyclically (colour-blind safe).
const GROUP_COLOURS: [&str; 6] = ["#4477aa", "#cc3311", "#228833", "#aa3377", "#ccbb44", "#66ccee"];

/// Drawing of the averages of all groups on top of one another, with the effect along the first group of the pair with
/// the largest distance.
pub(super) fn draw(study: &Study<ComparedShapes>, comparison: &Comparison) -> String {
    let (space, d) = (&study.setup.space, study.setup.metric.dimension());
    let comparison = &comparison.found;
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
    let title = format!("{} groups of {}", comparison.groups.len(), study.cohort.spec.name);
    effect::draw(&title, &layers, Some(&effect), &captions)
}

/// Maximum p value of points drawn as wide.
const SIGNIFICANT: f64 = 0.05;
