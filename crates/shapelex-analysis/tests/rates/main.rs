//! No computation falls far behind what this machine can do.
//!
//! `make test-all` runs this file alone, because other work on the machine disturbs it.
#![allow(clippy::unwrap_used, clippy::print_stdout)]

mod rows;

/// Part of the usual fraction of the bound below which a rate is a defect.
const LEAST: f64 = 0.5;

#[test]
fn rates_are_at_least_half_of_the_usual() {
    let mut slow = Vec::new();
    for row in rows::rows() {
        let (work, limit) = row.rates();
        let (fraction, least) = (work / limit, LEAST * row.usual);
        let text = format!(
            "{}: {work:.2e} {} a second, {fraction:.3} of the bound ({}); expected at least {least:.3}",
            row.name, row.unit, row.bound
        );
        println!("{text}");
        if fraction < least {
            slow.push(text);
        }
    }
    assert!(slow.is_empty(), "{}", slow.join("\n"));
}
