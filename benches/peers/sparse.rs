//! Dictionaries and sparse codes.
//!
//! ```text
//! learn  SHAPES n J seed epochs tolerance schedule ATOMS (lambda=… | nonzeros=…)    writes the atoms to ATOMS
//! encode SHAPES ATOMS n J (lambda=… | nonzeros=…)
//! moved  SHAPES n class J seed epochs tolerance (lambda=… | nonzeros=…)             moved atoms, shapes as they are
//! ```

use std::time::Instant;

use serde_json::{Value, json};
use shapelex_server::analysis::accumulate::{ShapeSource, ShapesInMemory};
use shapelex_server::analysis::algebra::Algebra;
use shapelex_server::analysis::dictionary::learning::{Learning, Schedule};
use shapelex_server::analysis::dictionary::model::Certificate;
use shapelex_server::analysis::sparse::{Atoms, Coder, Encode, GroupLasso, Lasso, Pursuit, SparseCode};
use shapelex_server::analysis::transformation::{ClassName, TransformationClass};
use shapelex_server::analysis::watch::Unwatched;
use shapelex_server::numeric::dense::Matrix;

use super::{number, read, timed};

/// `lambda=…` or `nonzeros=…`, as it is coded with blocks of `block` columns.
fn coder(word: &str, block: usize) -> Coder {
    match word.split_once('=') {
        Some(("lambda", value)) if block == 1 => Coder::Lasso(Lasso::new(number(value), false)),
        Some(("lambda", value)) => Coder::GroupLasso(GroupLasso::new(number(value))),
        Some(("nonzeros", value)) => Coder::Pursuit(Pursuit { nonzeros: number(value) }),
        _ => panic!("lambda=… or nonzeros=…"),
    }
}

pub(super) fn learn(words: &[&str]) -> Value {
    let [shapes, n, atoms, seed, epochs, tolerance, schedule, out, code] = words else { panic!("arguments") };
    let (shapes, n) = (read(shapes), number::<usize>(n));
    let schedule = if *schedule == "batch" { Schedule::Batch } else { Schedule::Online };
    let learning = Learning {
        atoms: number(atoms),
        coder: coder(code, 1),
        algebra: Algebra::numbers(),
        schedule,
        seed: number(seed),
        max_epochs: number(epochs),
        tolerance: number(tolerance),
    };
    let count = shapes.len() / n;
    let source = ShapesInMemory::prepared(shapes, vec![1.0; count]);
    let start = Instant::now();
    let learnt = learning.learn(&source, None, &Unwatched).expect("the dictionary is learnt");
    let seconds = start.elapsed().as_secs_f64();
    let bytes: Vec<u8> = learnt.atoms.iter().flat_map(|value| value.to_le_bytes()).collect();
    std::fs::write(out, bytes).expect("the atoms are written");
    json!({"seconds": seconds, "history": learnt.history, "reseeded": learnt.reseeded})
}

pub(super) fn encode(words: &[&str], repeats: usize) -> Value {
    let [shapes, atoms, n, count, code] = words else { panic!("arguments") };
    let (shapes, n) = (read(shapes), number::<usize>(n));
    let matrix = Matrix::from_vec(n, number(count), read(atoms));
    let coder = coder(code, 1);
    let (seconds, codes) =
        timed(repeats, || coder.codes(&Atoms::new(matrix.clone()), &shapes).expect("the shapes are coded"));
    let squared =
        |(x, code): (&[f64], &SparseCode)| code.relative_error.powi(2) * x.iter().map(|x| x * x).sum::<f64>();
    let count = codes.len() as f64;
    let squares = shapes.chunks_exact(n).zip(&codes).map(squared).sum::<f64>() / count;
    let objective = codes.iter().map(|code| code.objective).sum::<f64>() / count;
    json!({"seconds": seconds, "objective": objective, "squared residual": squares})
}

pub(super) fn moved(words: &[&str]) -> Value {
    let [shapes, n, class, atoms, seed, epochs, tolerance, code] = words else { panic!("arguments") };
    let (mut shapes, n) = (read(shapes), number::<usize>(n));
    let name: ClassName = serde_json::from_value((*class).into()).expect("the name of a class");
    let class = TransformationClass::named(name, 2).expect("a class of the plane");
    let algebra = Algebra::of(&class).expect("a closed class");
    let count = shapes.len() / n;
    let start = Instant::now();
    for shape in shapes.chunks_exact_mut(n) {
        algebra.normalise(shape).expect("a shape with an extent");
    }
    let learning = Learning {
        atoms: number(atoms),
        coder: coder(code, algebra.parameters()),
        algebra,
        schedule: Schedule::Online,
        seed: number(seed),
        max_epochs: number(epochs),
        tolerance: number(tolerance),
    };
    let source = ShapesInMemory::prepared(shapes, vec![1.0; count]);
    let learnt = learning.learn(&source, None, &Unwatched).expect("the dictionary is learnt");
    let seconds = start.elapsed().as_secs_f64();
    let certificate =
        Certificate::new(&learning.model(&learnt.atoms), &source, &Unwatched).expect("the shapes are coded");
    json!({
        "seconds": seconds, "history": learnt.history, "residuals": certificate.residuals,
        "parameters": certificate.parameters, "shapes": source.count()
    })
}
