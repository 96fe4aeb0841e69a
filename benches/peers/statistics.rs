//! Means, components, tests.
//!
//! ```text
//! mean         SHAPES N (landmarks | cyclic) OUT  plane curves: mean, alignment, 20 modes and scores, under similarities
//! components   SHAPES n                           20 components and scores of vectors of n numbers
//! procrustes   SHAPES N OUT                       generalised Procrustes mean of N points in space, written to OUT
//! permutations SHAPES n count draws (F | pair)    tests of two groups, the first and the second half
//! model        SHAPES n count draws (factor | curve)  a model of one term: three levels, or a polynomial of degree 3
//! transforms   n count                            inverse complex transforms of n numbers: a bound
//! ```

use std::hint::black_box;

use nalgebra::Complex;
use serde_json::{Value, json};
use shapelex_server::analysis::accumulate::{ShapesInMemory, map_shapes};
use shapelex_server::analysis::alignment::{Alignment, Method, align, mean_shape};
use shapelex_server::analysis::correspondence::{Correspondence, Direction, Mirror};
use shapelex_server::analysis::frame::Frame;
use shapelex_server::analysis::inference::comparison::Sample;
use shapelex_server::analysis::inference::permutation::Relabellings;
use shapelex_server::analysis::matching::Matching;
use shapelex_server::analysis::metric::Metric;
use shapelex_server::analysis::models::anova::{Model, Testing};
use shapelex_server::analysis::models::design::{Contrasts, Table};
use shapelex_server::analysis::models::formula::{Formula, TermOrder};
use shapelex_server::analysis::pca::FunctionalPca;
use shapelex_server::analysis::transformation::{ClassName, Transformation};
use shapelex_server::analysis::watch::Unwatched;
use shapelex_server::geometry::generator::GeneratorKind;
use shapelex_server::geometry::representation::{Representation, ShapeSpace};
use shapelex_server::numeric::dense::Matrix;
use shapelex_server::numeric::fft::ComplexFft;

use super::{number, read, timed, write};

const MODES: usize = 20;

/// Closed curves of `n` control points in the plane.
pub(super) fn curves(n: usize) -> ShapeSpace {
    let generator = GeneratorKind::Trigonometric {};
    ShapeSpace::new(&Representation::ClosedCurve { dimension: 2, control_points: n, generator }).unwrap()
}

/// Similarities of the plane.
pub(super) fn similarity() -> Method {
    Method::new(&Transformation::Named(ClassName::Similarity), Alignment::Projection, 2).unwrap()
}

pub(super) fn correspondence(word: &str) -> Correspondence {
    if word == "cyclic" { Correspondence::Cyclic } else { Correspondence::Landmarks }
}

fn source(shapes: Vec<f64>, length: usize) -> ShapesInMemory {
    let count = shapes.len() / length;
    ShapesInMemory::prepared(shapes, vec![1.0; count])
}

pub(super) fn mean(words: &[&str], repeats: usize) -> Value {
    let [shapes, n, search, out] = words else { panic!("arguments") };
    let (space, method) = (curves(number(n)), similarity());
    let metric = Metric::of(&space);
    let matching = Matching::new(&space, correspondence(search), Direction::Given, Mirror::Forbid);
    let source = source(read(shapes), metric.len());
    let (seconds, (mean, pca)) = timed(repeats, || {
        let mean = mean_shape(&source, &metric, &method, Frame::Training, &matching).unwrap();
        let aligned = map_shapes(&source, |k, x, _| {
            align(&method, &matching, &mean.whitened, x, &[0.0; 2], mean.placements[k])
        });
        let aligned = aligned.unwrap().into_iter().flat_map(|shape| shape.whitened).collect();
        let aligned = ShapesInMemory::prepared(aligned, vec![1.0; mean.shapes]);
        let pca = FunctionalPca::new(&aligned, &metric, &mean.whitened, true, MODES).unwrap();
        black_box(pca.all_scores(&aligned).unwrap());
        (mean, pca)
    });
    write(out, mean.whitened);
    json!({"seconds": seconds, "objective": mean.objective, "rounds": mean.rounds, "converged": mean.converged,
        "eigenvalues": pca.eigenvalues})
}

pub(super) fn components(words: &[&str], repeats: usize) -> Value {
    let [shapes, length] = words else { panic!("arguments") };
    let length: usize = number(length);
    let space = ShapeSpace::new(&Representation::Landmarks { dimension: 2, points: length / 2 }).unwrap();
    let (metric, origin) = (Metric::of(&space), vec![0.0; length]);
    let source = source(read(shapes), length);
    let (seconds, pca) = timed(repeats, || {
        let pca = FunctionalPca::new(&source, &metric, &origin, true, MODES).unwrap();
        black_box(pca.all_scores(&source).unwrap());
        pca
    });
    json!({"seconds": seconds, "eigenvalues": pca.eigenvalues})
}

pub(super) fn procrustes(words: &[&str], repeats: usize) -> Value {
    let [shapes, points, out] = words else { panic!("arguments") };
    let space = ShapeSpace::new(&Representation::Landmarks { dimension: 3, points: number(points) }).unwrap();
    let metric = Metric::of(&space);
    let similarity = Transformation::Named(ClassName::Similarity);
    let method = Method::new(&similarity, Alignment::Procrustes, 3).unwrap();
    let matching = Matching::new(&space, Correspondence::Landmarks, Direction::Given, Mirror::Forbid);
    let source = source(read(shapes), metric.len());
    let (seconds, mean) =
        timed(repeats, || mean_shape(&source, &metric, &method, Frame::Training, &matching).unwrap());
    write(out, mean.whitened);
    json!({"seconds": seconds, "rounds": mean.rounds, "converged": mean.converged})
}

pub(super) fn permutations(words: &[&str], repeats: usize) -> Value {
    let [shapes, length, count, draws, what] = words else { panic!("arguments") };
    let (length, count): (usize, usize) = (number(length), number(count));
    let coordinates = Matrix::from_vec(length, count, read(shapes));
    let (points, sizes) = (coordinates.clone(), Matrix::from_element(1, count, 1.0));
    let sample = Sample { coordinates, points, dimension: 2, sizes, weights: vec![1.0; count] };
    let labels = (0..count).map(|k| 2 * k / count).collect();
    let draws = Relabellings::new(labels, 2, &vec![0; count], 1, number(draws));
    let (seconds, statistics) = timed(repeats, || match *what {
        "F" => vec![sample.compare_all(&draws, &Unwatched).unwrap().pseudo_f.value],
        _ => {
            let tests = sample.compare_pair(&draws, &Unwatched).unwrap();
            let largest = tests.effect.t_squared.iter().flatten().copied().fold(0.0, f64::max);
            vec![tests.pseudo_f.value, tests.hotelling.value, Some(largest), Some(tests.components as f64)]
        }
    });
    json!({"seconds": seconds, "statistics": statistics})
}

pub(super) fn model(words: &[&str], repeats: usize) -> Value {
    let [shapes, length, count, draws, what] = words else { panic!("arguments") };
    let (length, count): (usize, usize) = (number(length), number(count));
    let vectors = Matrix::from_vec(length, count, read(shapes));
    let (text, table) = match *what {
        "factor" => (
            "~ level",
            Table::default().with_factor("level", (0..count).map(|k| (3 * k / count).to_string())),
        ),
        _ => ("~ poly(x,3)", Table::default().with_numbers("x", (0..count).map(|k| k as f64 / count as f64))),
    };
    let formula = Formula::parse(text, TermOrder::ByDegree).unwrap();
    let testing = Testing { permutations: number(draws), seed: 1, ..Testing::default() };
    let (seconds, table) = timed(repeats, || {
        let (vectors, weights) = (vectors.clone(), vec![1.0; count]);
        let model = Model::new(&formula, &table, Contrasts::Treatment, vectors, weights).unwrap();
        model.anova(&testing, &Unwatched).unwrap()
    });
    json!({"seconds": seconds, "statistics": table.terms.iter().map(|term| term.f).collect::<Vec<_>>()})
}

pub(super) fn transforms(words: &[&str], repeats: usize) -> Value {
    let [n, count] = words else { panic!("arguments") };
    let (fft, count) = (ComplexFft::new(number(n)), number::<usize>(count));
    let mut signal = vec![Complex::new(1.0, 0.5); fft.len()];
    let mut scratch = fft.scratch();
    let (seconds, ()) = timed(repeats, || {
        for _ in 0..count {
            signal.fill(Complex::new(1.0, 0.5));
            fft.inverse(black_box(&mut signal), &mut scratch);
        }
    });
    json!({ "seconds": seconds })
}
