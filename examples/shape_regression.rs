//! Regression of contours on age, adjusted for size: how much of the variation age explains, and what it changes.
#![allow(clippy::print_stdout, reason = "an example prints its result")]

use std::error::Error;
use std::f64::consts::TAU;

use shapelex_analysis::alignment::{Alignment, Method};
use shapelex_analysis::correspondence::{Correspondence, Direction, Mirror};
use shapelex_analysis::inference::aligned::{AlignedShapes, StudySpace, frame_for};
use shapelex_analysis::inference::permutation::Draws;
use shapelex_analysis::inference::regress::regress;
use shapelex_analysis::inference::variables::{Values, Variable, Variables};
use shapelex_analysis::matching::Matching;
use shapelex_analysis::metric::Metric;
use shapelex_analysis::transformation::{ClassName, Transformation};
use shapelex_analysis::watch::Unwatched;
use shapelex_geometry::generator::GeneratorKind;
use shapelex_geometry::representation::{Representation, ShapeSpace};

const POINTS: usize = 16;
const SHAPES: usize = 30;

/// Age of shape `k` in years.
fn age(k: usize) -> f64 {
    20.0 + 2.0 * k as f64
}

/// Control points of an ellipse that grows longer with age, first all x, then all y. Its size does not depend on age.
fn contour(k: usize) -> Vec<f64> {
    let (length, size) = (1.5 + 0.01 * age(k), 1.0 + 0.2 * ((5 * k * k) as f64).sin());
    let noise = |i: usize| 0.05 * ((7 * k * k + 13 * i) as f64).sin();
    let angle = |i: usize| TAU * i as f64 / POINTS as f64;
    let x = (0..POINTS).map(|i| length * angle(i).cos() + noise(i));
    let y = (0..POINTS).map(|i| angle(i).sin() + noise(i + POINTS));
    x.chain(y).map(|value| size * value).collect()
}

fn main() -> Result<(), Box<dyn Error>> {
    let generator = GeneratorKind::Bspline { degree: 3 };
    let contours = Representation::ClosedCurve { dimension: 2, control_points: POINTS, generator };
    let (space, class) = (ShapeSpace::new(&contours)?, Transformation::Named(ClassName::Similarity));
    let (metric, method) = (Metric::of(&space), Method::new(&class, Alignment::Projection, 2)?);
    let matching = Matching::new(&space, Correspondence::Landmarks, Direction::Given, Mirror::Forbid);
    let frame = frame_for(&class);
    let study = StudySpace {
        space: &space,
        metric: &metric,
        method: &method,
        tangent: true,
        frame,
        matching: &matching,
    };
    let control_points = (0..SHAPES).flat_map(contour).collect();
    let shapes = AlignedShapes::new(study, control_points, vec![1.0; SHAPES], &Unwatched)?;
    let variables = Variables {
        covariates: vec![Variable { name: "size".into(), values: Values::LogCentroidSize }],
        attribute: Variable { name: "age".into(), values: Values::Numbers((0..SHAPES).map(age).collect()) },
    };
    let draws = Draws { strata: &[0; SHAPES], seed: 1, permutations: 999 };
    let found = regress(&shapes, &variables, draws, &Unwatched)?.record;

    let p = found.test.p.unwrap_or(1.0);
    println!(
        "{} explains R² = {:.2} of the variation of shape, p = {p:.3}",
        found.attribute.name, found.r_squared
    );
    for prediction in &found.predictions {
        let extent = |c: usize| prediction.control_points.iter().map(|row| row[c].abs()).fold(0.0, f64::max);
        let ratio = extent(0).max(extent(1)) / extent(0).min(extent(1));
        println!("at {:.0} years: {ratio:.2} times as long as wide", prediction.attribute);
    }
    Ok(())
}
