//! Drawings of drift: the scores of new shapes against those of the training, and other changes, in sentences.

use crate::assessment::drift::{ClassDrift, Drift, ScoreDrift};
use shapelex_geometry::drawing::legend::Entry;
use shapelex_geometry::drawing::scene::{Drawing, short};
use shapelex_geometry::drawing::strips::{Strip, strips};

/// Maximum number of components in a drawing.
const MAX_COMPONENTS: usize = 20;
/// Maximum number of classes that are named.
const MAX_CLASSES: usize = 5;

/// Drawing of the drift since a revision; `quantile` defines the outliers.
pub fn draw_drift(title: &str, drift: &Drift, since: u64, quantile: f64) -> Drawing {
    let strip = |score: &ScoreDrift| Strip {
        name: score.component.to_string(),
        middle: score.shift,
        reach: score.spread,
    };
    let scores = drift.scores.iter().flatten().take(MAX_COMPONENTS);
    let scores: Vec<Strip> = scores.map(strip).collect();
    let mut sentences = Vec::new();
    if !scores.is_empty() {
        sentences.push(
            "a line for each component: new shapes, mean (dot) ± one standard deviation, in standard deviations of the training; \
             grey: the training shapes, drawn in the same way"
                .to_owned(),
        );
    }
    sentences.extend(told(drift, since, quantile));
    let legend: Vec<Entry> = sentences.into_iter().map(Entry::Text).collect();
    strips(title, &scores).with_legend(&legend)
}

/// Changes in sentences.
fn told(drift: &Drift, since: u64, quantile: f64) -> Vec<String> {
    if drift.shapes == 0 {
        return vec![format!("no shapes were added since revision {since}")];
    }
    let percent = |part: f64| format!("{} %", short((1e3 * part).round() / 10.0));
    let outliers = drift.outliers as f64 / drift.shapes as f64;
    let mut told = vec![format!(
        "{} of the {} shapes added since revision {since} are unusual: {}, where {} are expected",
        drift.outliers,
        drift.shapes,
        percent(outliers),
        percent(1.0 - quantile)
    )];
    if let Some(mean) = &drift.mean {
        let expected = mean
            .expected_deg
            .map_or_else(String::new, |x| format!(", where {}° are expected by chance", short(x)));
        told.push(format!(
            "their mean is {}° away from that of the training{expected}",
            short(mean.angle_deg)
        ));
    }
    told.extend(drift.classes.as_deref().and_then(|classes| shifted(classes, percent)));
    told
}

/// The classes whose parts changed most, in a sentence.
fn shifted(classes: &[ClassDrift], percent: impl Fn(f64) -> String) -> Option<String> {
    let mut classes: Vec<&ClassDrift> = classes.iter().collect();
    let change = |class: &ClassDrift| (class.new - class.training).abs();
    classes.sort_by(|a, b| change(b).total_cmp(&change(a)));
    let part = |class: &&ClassDrift| {
        format!("{} {} ({} in the training)", class.label, percent(class.new), percent(class.training))
    };
    let parts: Vec<String> = classes.iter().take(MAX_CLASSES).map(part).collect();
    (!parts.is_empty()).then(|| format!("predicted classes: {}", parts.join(", ")))
}
