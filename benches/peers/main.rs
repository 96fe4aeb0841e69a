//! Our side of `benches/peers/run.py`: learns a dictionary or encodes, and says in JSON how long it took.
//!
//! ```text
//! learn  SHAPES n J seed epochs tolerance schedule ATOMS [lambda=… | nonzeros=…]     writes the atoms to ATOMS
//! encode SHAPES ATOMS n J repeats [lambda=… | nonzeros=…]
//! moved  SHAPES n class J seed epochs tolerance [lambda=… | nonzeros=…]             moved atoms, shapes as they are
//! ```
//!
//! Files hold little-endian `f64`, one column of `n` numbers after the other. Times are those of the call alone, without
//! reading and writing.

use std::io::Write;
use std::time::Instant;

use rayon::ThreadPoolBuilder;
use shapelex::analysis::accumulate::{ShapeSource, ShapesInMemory};
use shapelex::analysis::dictionary::algebra::Algebra;
use shapelex::analysis::dictionary::learning::{Learning, Schedule};
use shapelex::analysis::dictionary::model::Certificate;
use shapelex::analysis::sparse::{Atoms, Coder, Encode, GroupLasso, Lasso, Pursuit};
use shapelex::analysis::transformation::{ClassName, TransformationClass};
use shapelex::analysis::watch::Unwatched;
use shapelex::numeric::dense::Matrix;

/// Threads of a measurement, as many as the peers get.
const THREADS: usize = 2;

fn main() {
    // `cargo bench` hands its own flag on.
    let arguments: Vec<String> = std::env::args().skip(1).filter(|word| word != "--bench").collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let pool = ThreadPoolBuilder::new().num_threads(THREADS).build().expect("threads start");
    let answer = pool.install(|| match words.as_slice() {
        ["learn", rest @ ..] => learn(rest),
        ["encode", rest @ ..] => encode(rest),
        ["moved", rest @ ..] => moved(rest),
        _ => serde_json::json!({"usage": "see benches/peers/README.md: run benches/peers/run.py"}),
    });
    std::io::stdout().write_all(answer.to_string().as_bytes()).expect("somebody reads the answer");
}

fn read(path: &str) -> Vec<f64> {
    let bytes = std::fs::read(path).expect("the file of numbers is there");
    bytes.as_chunks::<8>().0.iter().map(|chunk| f64::from_le_bytes(*chunk)).collect()
}

fn number<T: std::str::FromStr>(word: &str) -> T {
    word.parse().ok().expect("a number")
}

/// `lambda=…` or `nonzeros=…`, as it is coded with blocks of `block` columns.
fn coder(word: &str, block: usize) -> Coder {
    match word.split_once('=') {
        Some(("lambda", value)) if block == 1 => Coder::Lasso(Lasso::new(number(value), false)),
        Some(("lambda", value)) => Coder::GroupLasso(GroupLasso::new(number(value))),
        Some(("nonzeros", value)) => Coder::Pursuit(Pursuit { nonzeros: number(value) }),
        _ => panic!("lambda=… or nonzeros=…"),
    }
}

fn learn(words: &[&str]) -> serde_json::Value {
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
    serde_json::json!({"seconds": seconds, "history": learnt.history, "reseeded": learnt.reseeded})
}

fn encode(words: &[&str]) -> serde_json::Value {
    let [shapes, atoms, n, count, repeats, code] = words else { panic!("arguments") };
    let (shapes, n) = (read(shapes), number::<usize>(n));
    let matrix = Matrix::from_vec(n, number(count), read(atoms));
    let coder = coder(code, 1);
    let mut seconds = Vec::new();
    let mut objective = 0.0;
    for _ in 0..number::<usize>(repeats) {
        let start = Instant::now();
        let codes = coder.codes(&Atoms::new(matrix.clone()), &shapes).expect("the shapes are coded");
        seconds.push(start.elapsed().as_secs_f64());
        objective = codes.iter().map(|code| code.objective).sum::<f64>() / codes.len() as f64;
    }
    serde_json::json!({"seconds": seconds, "objective": objective})
}

fn moved(words: &[&str]) -> serde_json::Value {
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
    serde_json::json!({
        "seconds": seconds, "history": learnt.history, "residuals": certificate.residuals,
        "parameters": certificate.parameters, "shapes": source.count()
    })
}
