//! Tensor-product surfaces of every topology, collapsed, far off, tiny and huge: measured, evaluated, refined and fitted.

#![no_main]

use libfuzzer_sys::fuzz_target;
use serde_json::{Value, json};
use shapelex_fuzz::{Draws, post};

/// Places along each direction of the grid of a topology.
fn grid(topology: &str, [u, v]: [usize; 2]) -> [usize; 2] {
    match topology {
        "torus" => [u, v],
        "plane" => [u + 1, v + 1],
        _ => [u, v + 1],
    }
}

fuzz_target!(|data: &[u8]| {
    let mut draws = Draws(data);
    let topology = *draws.one(&["sphere", "cylinder", "torus", "plane"]);
    let count = [draws.between(3, 6), draws.between(2, 6)];
    let mut representation = json!({"kind": "surface", "topology": topology, "control_points": count});
    if draws.byte() % 4 == 0 {
        let generators =
            [json!({"name": "cubic"}), json!({"name": "bspline", "degree": draws.between(1, 3)})];
        representation["generators"] = json!(generators);
    }
    if topology == "torus" && draws.byte() % 4 == 0 {
        representation["seam"] = json!(draws.one(&["half_turn", "reflected"]));
    }
    let [rows, columns] = grid(topology, count);
    let mut points: Vec<[f64; 3]> = (0..rows * columns).map(|_| [0; 3].map(|_| draws.coordinate())).collect();
    draws.disturb(&mut points);
    if topology == "sphere" {
        // All meridians start and end in the same points.
        for row in 1..rows {
            points[row * columns] = points[0];
            points[row * columns + columns - 1] = points[columns - 1];
        }
    }
    let shape = json!({"points": points.chunks(columns).collect::<Vec<_>>()});
    let mut body = json!({"representation": representation, "shapes": [shape]});
    let extra: (&str, &str, Value) = match draws.byte() % 4 {
        0 => ("/v1/measure", "reference", shape),
        1 => ("/v1/evaluate", "grid", json!([draws.between(1, 9), draws.between(1, 9)])),
        2 => ("/v1/refine", "control_points", json!([draws.between(2, 9), draws.between(2, 9)])),
        _ => ("/v1/fit", "shapes", json!([shape])),
    };
    body[extra.1] = extra.2;
    post(extra.0, &body);
});
