//! Drawings of linear models: predicted shapes side by side, in the plane with their bands, over the table of the terms and the pairs of
//! groups.

use super::View;
use super::completed::{ellipse, lines};
use super::studies::probability;
use crate::alignment::Method;
use crate::models::bands::BandRecord;
use crate::models::outcome::{ModelRecord, PredictionRecord};
use crate::models::records::{AnovaRecord, At};
use crate::models::resample::ExchangedStatistic;
use crate::rows::columns_of;
use shapelex_geometry::drawing::layer::Layer;
use shapelex_geometry::drawing::legend::Entry;
use shapelex_geometry::drawing::scene::{Drawing, short};
use shapelex_geometry::drawing::{colour, layout};
use shapelex_geometry::representation::ShapeSpace;
use shapelex_numeric::dense::Matrix;

/// Predictions that are drawn.
const MOST: usize = 12;
/// Pairs of groups that are written below.
const MOST_PAIRS: usize = 15;

/// Predicted shapes of a model, with the table of its terms.
pub fn draw_model(
    (space, method): (&ShapeSpace, &Method),
    cohort: &str,
    shapes: usize,
    model: &ModelRecord,
) -> Drawing {
    let title = format!("{} of {shapes} shapes of {cohort}", model.anova.formula);
    let mut legend = table(&model.anova);
    legend.extend(pairs(model));
    draw_predictions((space, method), &title, &model.predictions, legend)
}

/// Predicted shapes side by side, over a legend.
pub fn draw_predictions(
    (space, method): (&ShapeSpace, &Method),
    title: &str,
    predictions: &[PredictionRecord],
    mut legend: Vec<Entry>,
) -> Drawing {
    let d = space.representation().dimension();
    let drawn: Vec<(&PredictionRecord, Vec<f64>)> = predictions
        .iter()
        .filter_map(|prediction| Some((prediction, columns_of(prediction.shape.as_ref()?, d))))
        .take(MOST)
        .collect();
    let Some((_, first)) = drawn.first() else {
        return layout::draw(title, Vec::new()).with_legend(&legend);
    };
    let view = View::upright(space, method, first);
    let band = |prediction: &PredictionRecord| prediction.band.clone().filter(|_| d == 2);
    if let Some(level) = drawn.first().and_then(|(prediction, _)| band(prediction)).map(|band| band.level) {
        let level = short(100.0 * level);
        legend.push(Entry::Text(format!(
            "small regions: {level} % of each place alone; circles: of all places together"
        )));
    }
    let cells = drawn.iter().map(|(prediction, shape)| {
        let mut layers = band(prediction).map_or_else(Vec::new, |band| regions(&view, &band));
        layers.push(view.layer([shape.as_slice()], colour::MAIN, 2.0, 1.0));
        (caption(prediction), layers)
    });
    layout::row(title, cells.collect()).with_legend(&legend)
}

/// Regions of a band in the plane: ellipses whose extents are the pointwise half widths, and circles of the simultaneous band.
fn regions(view: &View<'_>, band: &BandRecord) -> Vec<Layer> {
    let at = |point: &[f64]| {
        let turned = view.orientation.turn(point);
        [turned[0], turned[1]]
    };
    // The rows of the turn are the turned axes.
    let axes = [view.orientation.turn(&[1.0, 0.0]), view.orientation.turn(&[0.0, 1.0])];
    let turn = Matrix::from_fn(2, 2, |i, j| axes[j][i]);
    let pointwise =
        band.points.iter().zip(&band.covariance).zip(&band.half_width).map(|((point, c), half)| {
            let covariance = Matrix::from_row_slice(2, 2, &[c[0], c[1], c[1], c[2]]);
            let factor = if c[0] > 0.0 { half[0] / c[0].sqrt() } else { 0.0 };
            ellipse(at(point), &(&turn * covariance * turn.transpose()), factor)
        });
    let mut layers: Vec<Layer> = Vec::new();
    if let Some(factor) = band.simultaneous {
        let circle = |(point, deviation): (&Vec<f64>, &f64)| {
            ellipse(at(point), &Matrix::identity(2, 2), factor * deviation)
        };
        layers.extend(lines(
            band.points.iter().zip(&band.deviation).map(circle).collect(),
            colour::BACK,
            1.0,
            0.55,
        ));
    }
    layers.extend(lines(pointwise.collect(), colour::PLUS, 1.0, 0.65));
    layers
}

/// Pairs of groups, a line for each.
fn pairs(model: &ModelRecord) -> Vec<Entry> {
    let test = |name: &str, test: Option<&ExchangedStatistic>| {
        let test = test?;
        let p = test.p_holm.or(test.p).map_or_else(String::new, |p| format!(", p {}", probability(p)));
        Some(format!("{name} {}{p}", short(test.value)))
    };
    let line = |first: &str, second: &str, tests: [Option<String>; 3]| {
        format!("{first} – {second}: {}", tests.into_iter().flatten().collect::<Vec<_>>().join("; "))
    };
    let mut found: Vec<String> = Vec::new();
    found.extend(model.pairs.iter().flat_map(|pairs| &pairs.pairs).map(|pair| {
        let length = test("lengths differ by", pair.length_difference.as_ref());
        let tests = [test("distance", pair.distance.as_ref()), test("angle", pair.angle.as_ref()), length];
        line(&pair.first, &pair.second, tests)
    }));
    found.extend(model.disparity.iter().flat_map(|disparity| &disparity.pairs).map(|pair| {
        line(&pair.first, &pair.second, [test("variances differ by", Some(&pair.difference)), None, None])
    }));
    found.extend(model.trajectories.iter().flat_map(|trajectories| &trajectories.pairs).map(|pair| {
        let length = test("lengths differ by", Some(&pair.length_difference));
        line(
            &pair.first,
            &pair.second,
            [length, test("angle", Some(&pair.angle)), test("shapes", pair.shape.as_ref())],
        )
    }));
    let more = found.len().saturating_sub(MOST_PAIRS);
    found.truncate(MOST_PAIRS);
    found.extend((more > 0).then(|| format!("and {more} pairs more")));
    found.into_iter().map(Entry::Text).collect()
}

/// Values at which a shape is predicted.
fn caption(prediction: &PredictionRecord) -> String {
    let of = |(name, at): (&String, &At)| match at {
        At::Number(number) => format!("{name} {}", short(*number)),
        At::Level(level) => level.clone(),
    };
    prediction.at.iter().map(of).collect::<Vec<_>>().join(", ")
}

/// Letters of a name in the table.
const NAME: usize = 22;

/// The table, a line for each term.
fn table(anova: &AnovaRecord) -> Vec<Entry> {
    let shortened = |mut row: [String; 8]| {
        if row[0].chars().count() > NAME {
            row[0] = row[0].chars().take(NAME - 1).chain(['…']).collect();
        }
        // Mean squares are in the table as text.
        let [name, degrees, squares, _, explained, f, z, p] = row;
        Entry::Row(vec![name, degrees, squares, explained, f, z, p])
    };
    anova.rows().into_iter().map(shortened).collect()
}
