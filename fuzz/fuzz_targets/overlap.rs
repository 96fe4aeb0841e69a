//! Two bodies, contours, meshes or masks, tiny beside huge, far from one another, crossing themselves: how they overlap.

#![no_main]

use libfuzzer_sys::fuzz_target;
use serde_json::{Value, json};
use shapelex_fuzz::{Draws, post};

const FACES: [[u32; 3]; 4] = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];

/// Largest number of cells along an axis of a mask.
const CELLS: usize = 6;

fn body(draws: &mut Draws<'_>, dimension: usize) -> Value {
    match draws.byte() % 3 {
        0 => mask(draws, dimension),
        _ if dimension == 2 => {
            let count = draws.between(0, 9);
            let mut points: Vec<[f64; 3]> = (0..count).map(|_| [0; 3].map(|_| draws.coordinate())).collect();
            draws.disturb(&mut points);
            json!({"contour": points.iter().map(|[x, y, _]| [x, y]).collect::<Vec<_>>()})
        }
        _ => {
            let mut vertices = [[0; 3]; 4].map(|vertex| vertex.map(|_| draws.coordinate()));
            draws.disturb(&mut vertices);
            json!({"vertices": vertices, "faces": FACES})
        }
    }
}

fn mask(draws: &mut Draws<'_>, dimension: usize) -> Value {
    let size: Vec<usize> = (0..dimension).map(|_| draws.between(1, CELLS)).collect();
    let (mut left, mut runs) = (size.iter().product::<usize>(), Vec::new());
    for _ in 0..draws.between(0, 12) {
        let run = draws.between(0, 40).min(left);
        left -= run;
        runs.push(run);
    }
    runs.push(left);
    let axis = |draws: &mut Draws<'_>| (0..dimension).map(|_| draws.length()).collect::<Vec<_>>();
    json!({"mask": {"size": size, "spacing": axis(draws), "first": axis(draws), "runs": runs}})
}

fuzz_target!(|data: &[u8]| {
    let mut draws = Draws(data);
    let dimension = draws.between(2, 3);
    let first = body(&mut draws, dimension);
    let second = if draws.byte() % 4 == 0 { first.clone() } else { body(&mut draws, dimension) };
    let mut request = json!({"first": first, "second": second});
    if draws.byte() % 2 == 0 {
        request["spacing"] = json!(draws.length());
    }
    post("/v1/overlap", &request);
});
