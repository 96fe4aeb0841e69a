//! Our side of the comparisons in this folder: one computation on files of numbers; says in JSON how long it took and
//! what came out.
//!
//! ```text
//! peers THREADS REPEATS COMMAND …
//! ```
//!
//! Each module lists its commands. Files hold little-endian `f64`, one shape after the other, coordinate by coordinate.
//! Times are those of the call alone, without reading and writing.
#![allow(clippy::unwrap_used)]

use std::io::Write;
use std::time::Instant;

use rayon::ThreadPoolBuilder;

mod retrieval;
mod service;
mod sparse;
mod statistics;
mod subdivision;

fn main() {
    // `cargo bench` hands its own flag on.
    let arguments: Vec<String> = std::env::args().skip(1).filter(|word| word != "--bench").collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let answer = match words.as_slice() {
        [threads, repeats, command, words @ ..] => {
            let pool = ThreadPoolBuilder::new().num_threads(number(threads)).build().expect("threads start");
            pool.install(|| run(command, words, number(repeats)))
        }
        _ => serde_json::json!({"usage": "see benches/peers/README.md: run benches/peers/run.py"}),
    };
    std::io::stdout().write_all(answer.to_string().as_bytes()).expect("somebody reads the answer");
}

fn run(command: &str, words: &[&str], repeats: usize) -> serde_json::Value {
    match command {
        "learn" => sparse::learn(words),
        "encode" => sparse::encode(words, repeats),
        "moved" => sparse::moved(words),
        "mean" => statistics::mean(words, repeats),
        "components" => statistics::components(words, repeats),
        "procrustes" => statistics::procrustes(words, repeats),
        "permutations" => statistics::permutations(words, repeats),
        "model" => statistics::model(words, repeats),
        "distances" => retrieval::distances(words, repeats),
        "neighbours" => retrieval::neighbours(words, repeats),
        "refine" => subdivision::refine(words, repeats),
        "operator" => subdivision::operator(words, repeats),
        "transforms" => statistics::transforms(words, repeats),
        "lines" => service::lines(words),
        "parse" => service::parse(words, repeats),
        "store" => service::store(words, repeats),
        "echo" => service::echo(),
        "load" => service::load(words),
        other => panic!("no command {other}"),
    }
}

/// The numbers of a file.
fn read(path: &str) -> Vec<f64> {
    let bytes = std::fs::read(path).expect("the file of numbers is there");
    bytes.as_chunks::<8>().0.iter().map(|chunk| f64::from_le_bytes(*chunk)).collect()
}

fn write(path: &str, numbers: impl IntoIterator<Item = f64>) {
    let bytes: Vec<u8> = numbers.into_iter().flat_map(f64::to_le_bytes).collect();
    std::fs::write(path, bytes).expect("the numbers are written");
}

fn number<T: std::str::FromStr>(word: &str) -> T {
    word.parse().ok().expect("a number")
}

/// Seconds of every run, and the result of the last.
fn timed<T>(repeats: usize, mut work: impl FnMut() -> T) -> (Vec<f64>, T) {
    let mut seconds = Vec::new();
    loop {
        let start = Instant::now();
        let result = work();
        seconds.push(start.elapsed().as_secs_f64());
        if seconds.len() >= repeats {
            return (seconds, result);
        }
    }
}
