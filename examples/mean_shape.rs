//! Mean of twelve noisy ellipses, whatever their position, size and direction.
#![allow(clippy::print_stdout, reason = "an example prints its result")]

use std::error::Error;
use std::f64::consts::TAU;

use shapelex_analysis::accumulate::ShapesInMemory;
use shapelex_analysis::alignment::{Alignment, Method, mean_shape};
use shapelex_analysis::correspondence::{Correspondence, Direction, Mirror};
use shapelex_analysis::frame::Frame;
use shapelex_analysis::matching::Matching;
use shapelex_analysis::metric::Metric;
use shapelex_analysis::transformation::{ClassName, Transformation};
use shapelex_geometry::generator::GeneratorKind;
use shapelex_geometry::representation::{Representation, ShapeSpace};

const POINTS: usize = 16;
const SHAPES: usize = 12;

/// Control points of an ellipse, turned, scaled and moved differently for every `k`: first all x, then all y.
fn ellipse(k: usize) -> Vec<f64> {
    let (turn, scale, shift) = (0.5 * k as f64, 1.0 + k as f64, 10.0 * k as f64);
    let noise = |i: usize| 0.05 * ((7 * k * k + 13 * i) as f64).sin();
    let point = |i: usize| {
        let t = TAU * i as f64 / POINTS as f64;
        ((2.0 + noise(i)) * t.cos(), (1.0 + noise(i + POINTS)) * t.sin())
    };
    let x = (0..POINTS).map(|i| turn.cos() * point(i).0 - turn.sin() * point(i).1);
    let y = (0..POINTS).map(|i| turn.sin() * point(i).0 + turn.cos() * point(i).1);
    x.chain(y).map(|value| scale * value + shift).collect()
}

fn main() -> Result<(), Box<dyn Error>> {
    let generator = GeneratorKind::Bspline { degree: 3 };
    let contours = Representation::ClosedCurve { dimension: 2, control_points: POINTS, generator };
    let space = ShapeSpace::new(&contours)?;
    let metric = Metric::of(&space);
    let method = Method::new(&Transformation::Named(ClassName::Similarity), Alignment::Projection, 2)?;
    let matching = Matching::new(&space, Correspondence::Landmarks, Direction::Given, Mirror::Forbid);
    let control_points = (0..SHAPES).flat_map(ellipse).collect();
    let shapes = ShapesInMemory::new(&metric, method.translates(), control_points, vec![1.0; SHAPES])?;
    let mean = mean_shape(&shapes, &metric, &method, Frame::Canonical, &matching)?;

    let (x, y) = mean.control_points.split_at(POINTS);
    let squares = |values: &[f64]| values.iter().map(|value| value * value).sum::<f64>();
    let (a, b) = (squares(x).max(squares(y)).sqrt(), squares(x).min(squares(y)).sqrt());
    println!("mean of {} shapes: an ellipse with axes of ratio {:.2}", mean.shapes, a / b);
    println!("it is {}", if mean.unique == Some(true) { "unique" } else { "not unique" });
    Ok(())
}
