//! Control meshes under every scheme, with vertices that coincide, cross, lie far off or nowhere: refined, measured, fitted.

#![no_main]

use libfuzzer_sys::fuzz_target;
use serde_json::{Value, json};
use shapelex_fuzz::{Draws, post};

const OCTAHEDRON: [[f64; 3]; 6] =
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0]];
const FACES: [[u32; 3]; 8] =
    [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4], [1, 0, 5], [2, 1, 5], [3, 2, 5], [0, 3, 5]];

fn scheme(draws: &mut Draws<'_>) -> Value {
    match draws.byte() % 4 {
        0 => json!({"scheme": "blob", "lambda": draws.coordinate() / 4.0}),
        1 => json!({"scheme": "loop"}),
        2 => json!({"scheme": "butterfly"}),
        _ => json!({"scheme": "normal_based"}),
    }
}

fn joined(a: Value, b: Value) -> Value {
    let mut all = a;
    if let (Some(all), Value::Object(more)) = (all.as_object_mut(), b) {
        all.extend(more);
    }
    all
}

fuzz_target!(|data: &[u8]| {
    let mut draws = Draws(data);
    let (scheme, level) = (scheme(&mut draws), draws.between(0, 4));
    let mut vertices = OCTAHEDRON;
    for _ in 0..draws.between(0, 6) {
        let vertex = draws.between(0, 5);
        vertices[vertex] = [0; 3].map(|_| draws.coordinate());
    }
    draws.disturb(&mut vertices);
    let mut faces = FACES;
    if draws.byte() == 1 {
        let (face, corner) = (draws.between(0, 7), draws.between(0, 2));
        faces[face][corner] = u32::from(draws.byte()) % 7;
    }
    let representation = joined(
        scheme.clone(),
        json!({"kind": "subdivision", "level": level, "connectivity": {"vertices": 6, "faces": faces}}),
    );
    match draws.byte() % 4 {
        0 => {
            let depth = if draws.byte() % 2 == 0 {
                json!({"level": level})
            } else {
                json!({"tolerance": draws.length()})
            };
            let limit =
                json!({"limit": draws.byte() % 2 == 0, "mesh": {"vertices": vertices, "faces": faces}});
            post("/v1/subdivide", &joined(joined(scheme, depth), limit));
        }
        1 => {
            let shape = json!({"control_points": vertices});
            post(
                "/v1/measure",
                &json!({"representation": representation, "shapes": [shape], "reference": shape}),
            );
        }
        2 => {
            let mesh = json!({"vertices": vertices, "faces": faces});
            let representation =
                joined(scheme, json!({"kind": "subdivision", "level": level, "connectivity": "octahedron"}));
            post(
                "/v1/fit",
                &json!({"representation": representation, "turns": draws.between(0, 3), "meshes": [mesh]}),
            );
        }
        _ => {
            let polyline =
                json!({"points": vertices.map(|[x, y, _]| [x, y]), "closed": draws.byte() % 2 == 0});
            post("/v1/subdivide", &joined(scheme, json!({"level": level, "polyline": polyline})));
        }
    }
});
