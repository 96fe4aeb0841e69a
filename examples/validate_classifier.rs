//! Trains a classifier of two kinds of outlines, validated on outlines that neither it nor its dictionary has seen.
#![allow(clippy::print_stdout, reason = "an example prints its result")]

use std::error::Error;
use std::f64::consts::TAU;

use shapelex_analysis::assessment::Assessor;
use shapelex_analysis::classification::labels::ClassLabels;
use shapelex_analysis::classification::study::train_classifier;
use shapelex_analysis::classifier_record::{ClassifierKind, ClassifierSettings};
use shapelex_analysis::dictionary::learn::learn;
use shapelex_analysis::dictionary::method::Method;
use shapelex_analysis::dictionary::recipe::Recipe;
use shapelex_analysis::transformation::{ClassName, Transformation};
use shapelex_analysis::watch::Unwatched;
use shapelex_geometry::generator::GeneratorKind;
use shapelex_geometry::representation::Representation;

/// Control points of outline `k`: every second one has three corners, the others are round; all vary.
fn outline(k: usize) -> impl Iterator<Item = f64> {
    let corners = 0.1 * (k % 2) as f64 + 0.08 * (7.0 * k as f64).sin();
    let radius = move |angle: f64| {
        1.0 + corners * (3.0 * angle).cos() + 0.1 * (5.0 * k as f64).cos() * (2.0 * angle).sin()
    };
    let coordinate = move |i: usize, turn: f64| {
        let angle = TAU * i as f64 / 24.0;
        radius(angle) * (angle - turn).cos()
    };
    (0..48).map(move |i| coordinate(i % 24, if i < 24 { 0.0 } else { TAU / 4.0 }))
}

fn main() -> Result<(), Box<dyn Error>> {
    let generator = GeneratorKind::Bspline { degree: 3 };
    let representation = Representation::ClosedCurve { dimension: 2, control_points: 24, generator };
    let similarity = Transformation::Named(ClassName::Similarity);
    let recipe = Recipe::new(representation, similarity, Method::components(4, true));
    let shapes = recipe.setting()?.shapes((0..60).flat_map(outline).collect(), vec![1.0; 60])?;
    let dictionary = learn(&shapes, &recipe, &Unwatched)?.dictionary;

    let names: Vec<String> = (0..60).map(|k| ["round", "cornered"][k % 2].into()).collect();
    let settings = ClassifierSettings::new(ClassifierKind::Discriminant);
    let labels = ClassLabels::from_names(&names);
    let record = train_classifier(&dictionary, &shapes, &labels, &settings, &Unwatched)?;
    let accuracy = record.validation.accuracy;
    println!(
        "held-out outlines classified correctly: {:.0} % (95 % interval {:.0} to {:.0} %)",
        100.0 * accuracy.value,
        100.0 * accuracy.low,
        100.0 * accuracy.high
    );

    let assessor = Assessor::trained(dictionary, record);
    let new: Vec<f64> = outline(61).collect();
    for class in assessor.classify(&assessor.dictionary.encode(&new, &Unwatched)?, 0.99)?.unwrap_or_default()
    {
        let best = &class.ranking[0];
        println!("a new outline is {} with confidence {:.2}", labels.labels[best.class], best.confidence);
    }
    Ok(())
}
