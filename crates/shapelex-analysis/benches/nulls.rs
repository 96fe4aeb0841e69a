//! Tables of null cases of `docs/comparisons.md`, `docs/models.md` (`Models`, of some layouts by their names) and `docs/evaluation.md`
//! (`Sides`): `cargo bench -p shapelex-analysis --bench nulls [-- SETS KIND …]`.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout)]

#[path = "../tests/nulls/mod.rs"]
mod null_cases;

use null_cases::sides::{Sided, sided_alarms};
use null_cases::{Case, Kind, Layout, alarms, model_alarms, regression_alarms};
use shapelex_analysis::alignment::Alignment;
use shapelex_analysis::models::subspaces::SumType;

fn main() {
    // Cargo hands on `--bench`.
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| argument != "--bench").collect();
    let sets = arguments.iter().find_map(|argument| argument.parse().ok()).unwrap_or(2000);
    let names: Vec<&String> =
        arguments.iter().filter(|argument| argument.parse::<usize>().is_err()).collect();
    let chosen = |kind: Kind| names.is_empty() || names.iter().any(|name| **name == format!("{kind:?}"));
    if arguments.iter().any(|argument| argument == "Models") {
        return models(sets, &names);
    }
    if arguments.iter().any(|argument| argument == "Sides") {
        return sides(sets);
    }
    println!("| shapes | groups | ratio | alignment | distance | Hotelling | studentised | warned |");
    println!("|---|---|---|---|---|---|---|---|");
    for kind in Kind::ALL.into_iter().filter(|kind| chosen(*kind)) {
        for sizes in [[20, 20], [10, 30], [30, 10]] {
            for ratio in [1.0, 1.5, 2.0, 3.0, 4.5] {
                row(&Case { kind, sizes, ratio, alignment: None }, sets);
            }
        }
        let by_name = if kind == Kind::LandmarksInSpace || kind == Kind::Surfaces {
            Alignment::Procrustes
        } else {
            Alignment::Projection
        };
        row(&Case { kind, sizes: [20, 20], ratio: 3.0, alignment: Some(by_name) }, sets);
    }
    println!("\n| shapes | ratio | default | warned | by name |\n|---|---|---|---|---|");
    for (kind, by_name) in
        [(Kind::Landmarks, Alignment::Projection), (Kind::LandmarksInSpace, Alignment::Procrustes)]
    {
        let [default, warned] = regression_alarms(kind, 4.5, None, sets);
        let [by_name, _] = regression_alarms(kind, 4.5, Some(by_name), sets);
        println!("| {kind:?} | 4.5 | {default:.3} | {warned:.3} | {by_name:.3} |");
    }
}

/// Levels of the terms of models without effects; of all layouts unless some are named.
fn models(sets: usize, names: &[&String]) {
    println!("| design | type | terms |\n|---|---|---|");
    let is_chosen =
        |layout: &Layout| names.len() == 1 || names.iter().any(|name| **name == format!("{layout:?}"));
    for layout in Layout::ALL.into_iter().filter(is_chosen) {
        for kind in [SumType::I, SumType::II, SumType::III] {
            let found = model_alarms(layout, kind, sets);
            let terms: Vec<String> =
                found.iter().map(|(term, part)| format!("{term} {:.2} %", 100.0 * part)).collect();
            println!("| {layout:?} | {kind:?} | {} |", terms.join(", "));
        }
    }
}

/// Levels of tests of individuals and sides without effects.
fn sides(sets: usize) {
    println!("| case | terms |\n|---|---|");
    for case in Sided::ALL {
        let found = sided_alarms(case, sets);
        let terms: Vec<String> =
            found.iter().map(|(term, part)| format!("{term} {:.2} %", 100.0 * part)).collect();
        println!("| {case:?} | {} |", terms.join(", "));
    }
}

fn row(case: &Case, sets: usize) {
    let Case { kind, sizes: [wide, narrow], ratio, alignment } = case;
    let found = alarms(case, sets);
    let alignment = alignment.map_or("default".into(), |alignment| format!("{alignment:?}"));
    println!(
        "| {kind:?} | {wide}, {narrow} | {ratio} | {alignment} | {:.3} | {:.3} | {:.3} | {:.3} |",
        found.distance, found.hotelling, found.studentised, found.warned
    );
}
