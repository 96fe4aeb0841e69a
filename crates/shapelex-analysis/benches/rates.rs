//! Rates of the main computations on one thread, beside bounds of this machine.
//!
//! `cargo bench -p shapelex-analysis --bench rates`. `tests/rates` fails where a fraction is less than half of the usual one of its profile.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout)]

#[path = "../tests/rates/rows.rs"]
mod rows;

fn main() {
    println!("| computation | a second | bound | a second | fraction | in tests |");
    println!("|---|---|---|---|---|---|");
    for row in rows::rows() {
        let (work, limit) = row.rates();
        println!(
            "| {} | {work:.3e} {} | {} | {limit:.3e} | {:.2} | {} |",
            row.name,
            row.unit,
            row.bound,
            work / limit,
            row.usual,
        );
    }
}
