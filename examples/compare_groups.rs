//! Comparison of two groups of contours: whether they differ in shape, and where most.
#![allow(clippy::print_stdout, reason = "an example prints its result")]

use std::error::Error;
use std::f64::consts::TAU;

use shapelex_analysis::alignment::{Alignment, Method};
use shapelex_analysis::correspondence::{Correspondence, Direction, Mirror};
use shapelex_analysis::inference::aligned::{AlignedShapes, StudySpace, frame_for};
use shapelex_analysis::inference::compare::compare;
use shapelex_analysis::inference::groups::Groups;
use shapelex_analysis::inference::permutation::Draws;
use shapelex_analysis::matching::Matching;
use shapelex_analysis::metric::Metric;
use shapelex_analysis::transformation::{ClassName, Transformation};
use shapelex_analysis::watch::Unwatched;
use shapelex_geometry::generator::GeneratorKind;
use shapelex_geometry::representation::{Representation, ShapeSpace};

const POINTS: usize = 16;
const SHAPES: usize = 24;

/// Control points of an ellipse, first all x, then all y; the second half of the shapes has a bump at the right end.
fn contour(k: usize) -> Vec<f64> {
    let bump = if k < SHAPES / 2 { 0.0 } else { 0.3 };
    let noise = |i: usize| 0.1 * ((7 * k * k + 13 * i) as f64).sin();
    let angle = |i: usize| TAU * i as f64 / POINTS as f64;
    let x = (0..POINTS).map(|i| 2.0 * angle(i).cos() + bump * f64::from(u8::from(i == 0)) + noise(i));
    let y = (0..POINTS).map(|i| angle(i).sin() + noise(i + POINTS));
    x.chain(y).collect()
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
    let labels = (0..SHAPES).map(|k| 2 * k / SHAPES).collect();
    let groups = Groups { names: vec!["smooth".into(), "with a bump".into()], labels };
    let draws = Draws { strata: &[0; SHAPES], seed: 1, permutations: 999 };
    let found = compare(&shapes, &groups, draws, POINTS, &Unwatched)?;

    let pair = &found.pairs[0];
    println!(
        "'{}' against '{}': chordal distance {:.3}",
        pair.first,
        pair.second,
        pair.chordal_distance.unwrap_or(0.0)
    );
    println!(
        "R² = {:.2}, p = {:.3} of {} relabellings",
        pair.r_squared,
        pair.pseudo_f.test.p.unwrap_or(1.0),
        pair.pseudo_f.test.permutations
    );
    let most = pair.effect.iter().max_by(|a, b| a.length.total_cmp(&b.length));
    if let Some(place) = most {
        println!(
            "they differ most at u = {:.2}, by {:.3}, p = {:.3}",
            place.parameter,
            place.length,
            place.p.unwrap_or(1.0)
        );
    }
    Ok(())
}
