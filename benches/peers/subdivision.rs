//! Loop subdivision of an octahedron.
//!
//! ```text
//! refine   LEVEL OUT                  from nothing to a level; vertices to OUT
//! operator SPLIT LEVEL SHAPES OUT     the operator of a level on control points of shapes, the last result to OUT
//! ```

use std::hint::black_box;

use rayon::prelude::*;
use serde_json::{Value, json};
use shapelex_server::geometry::representation::{Representation, ShapeSpace};
use shapelex_server::geometry::subdivision::control::{ControlMesh, StartMesh};
use shapelex_server::geometry::subdivision::refinement::{Depth, refine_mesh};
use shapelex_server::geometry::subdivision::{LoopWeights, Scheme, Subdivision};

use super::{number, read, timed, write};

const LOOP: Scheme = Scheme::Loop(LoopWeights::Original);
/// Numbers at every vertex that go through the operator at once: the coordinates of 16 shapes.
const WIDTH: usize = 48;

pub(super) fn refine(words: &[&str], repeats: usize) -> Value {
    let [level, out] = words else { panic!("arguments") };
    let depth = Depth::Level(number(level));
    let octahedron = "octahedron".parse::<StartMesh>().unwrap();
    let (seconds, mesh) =
        timed(repeats, || refine_mesh(LOOP, octahedron.mesh(), depth, 2_000_000, false).unwrap().0.shape);
    let (vertices, faces) = (mesh.vertices.len(), mesh.faces.len());
    write(out, mesh.vertices.into_iter().flatten());
    json!({"seconds": seconds, "vertices": vertices, "faces": faces})
}

/// The shapes are given as rows of 48 numbers, one row for every control point.
pub(super) fn operator(words: &[&str], repeats: usize) -> Value {
    let [split, level, shapes, out] = words else { panic!("arguments") };
    let start = format!("octahedron/{split}").parse().unwrap();
    let subdivision =
        Subdivision { scheme: LOOP, level: number(level), connectivity: ControlMesh::Named(start) };
    let space = ShapeSpace::new(&Representation::Subdivision(subdivision)).unwrap();
    let operator = space.subdivision().unwrap().operator();
    let numbers = read(shapes);
    let blocks: Vec<&[[f64; WIDTH]]> = numbers.as_chunks().0.chunks_exact(operator.columns()).collect();
    let (seconds, ()) = timed(repeats, || {
        blocks.par_iter().for_each_init(Vec::new, |points: &mut Vec<[f64; WIDTH]>, block| {
            operator.apply_into(block, points);
            black_box(&points);
        });
    });
    let mut points = Vec::new();
    operator.apply_into(blocks[blocks.len() - 1], &mut points);
    write(out, points.into_iter().flatten());
    json!({"seconds": seconds, "rows": operator.rows(), "columns": operator.columns(), "entries": operator.len()})
}
