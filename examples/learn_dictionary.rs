//! Learns principal components of outlines, and finds the one new outline that is unlike them.
#![allow(clippy::print_stdout, reason = "an example prints its result")]

use std::error::Error;
use std::f64::consts::TAU;

use shapelex_analysis::dictionary::learn::learn;
use shapelex_analysis::dictionary::method::Method;
use shapelex_analysis::dictionary::recipe::Recipe;
use shapelex_analysis::transformation::{ClassName, Transformation};
use shapelex_analysis::watch::Unwatched;
use shapelex_geometry::generator::GeneratorKind;
use shapelex_geometry::representation::Representation;

/// Control points of outline `k`: an ellipse of its own width, somewhere in the plane, with `bumps`.
fn outline(k: usize, bumps: f64) -> impl Iterator<Item = f64> {
    let width = 0.5 + 0.2 * (7.0 * k as f64).sin();
    let radius = move |angle: f64| {
        1.0 + 0.1 * (3.0 * k as f64).cos() * (2.0 * angle).sin() + bumps * (5.0 * angle).cos()
    };
    let point = move |i: usize| [radius(TAU * i as f64 / 24.0), TAU * i as f64 / 24.0];
    let x = (0..24).map(point).map(move |[r, angle]| 10.0 * k as f64 + r * angle.cos());
    x.chain((0..24).map(point).map(move |[r, angle]| width * r * angle.sin()))
}

fn main() -> Result<(), Box<dyn Error>> {
    let generator = GeneratorKind::Bspline { degree: 3 };
    let representation = Representation::ClosedCurve { dimension: 2, control_points: 24, generator };
    let similarity = Transformation::Named(ClassName::Similarity);
    let recipe = Recipe::new(representation, similarity, Method::components(2, true));

    let control_points = (0..50).flat_map(|k| outline(k, 0.0)).collect();
    let shapes = recipe.setting()?.shapes(control_points, vec![1.0; 50])?;
    let dictionary = learn(&shapes, &recipe, &Unwatched)?.dictionary;
    let explained: f64 = dictionary.content.atoms.iter().filter_map(|atom| atom.explained).sum();
    println!("two components explain {:.1} % of the variance of 50 outlines", 100.0 * explained);

    let new: Vec<f64> = outline(50, 0.0).chain(outline(51, 0.2)).collect();
    for (name, coded) in ["alike", "with bumps"].iter().zip(dictionary.encode(&new, &Unwatched)?) {
        let score = dictionary.score(&coded, 0.99);
        println!("new outline, {name}: scores {:.3?}, outlier: {}", coded.code.values, score.outlier);
    }
    Ok(())
}
