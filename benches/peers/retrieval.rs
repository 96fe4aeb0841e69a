//! Distances and nearest neighbours of plane curves under similarities.
//!
//! ```text
//! distances  SHAPES N (landmarks | cyclic) OUT    writes the matrix to OUT; preparation included
//! neighbours SHAPES N most                        of the first shape, start points searched; preparation not included
//! ```

use serde_json::{Value, json};
use shapelex_server::analysis::correspondence::{Correspondence, Direction, Mirror};
use shapelex_server::analysis::distance::DistanceSpace;
use shapelex_server::analysis::matching::Matching;
use shapelex_server::analysis::neighbours::NeighbourSearch;

use super::statistics::{correspondence, curves, similarity};
use super::{number, read, timed, write};

fn space(n: usize, correspondence: Correspondence) -> DistanceSpace {
    let matching = Matching::new(&curves(n), correspondence, Direction::Given, Mirror::Forbid);
    DistanceSpace::new(&similarity(), &matching).unwrap()
}

pub(super) fn distances(words: &[&str], repeats: usize) -> Value {
    let [shapes, n, search, out] = words else { panic!("arguments") };
    let (shapes, space) = (read(shapes), space(number(n), correspondence(search)));
    let (seconds, matrix) = timed(repeats, || {
        let prepared = space.prepare(&shapes).unwrap();
        space.matrix(&prepared, &|_| true).unwrap()
    });
    write(out, matrix);
    json!({ "seconds": seconds })
}

pub(super) fn neighbours(words: &[&str], repeats: usize) -> Value {
    let [shapes, n, most] = words else { panic!("arguments") };
    let (shapes, n) = (read(shapes), number::<usize>(n));
    let space = space(n, Correspondence::Cyclic);
    let query = space.prepare(&shapes[..2 * n]).unwrap();
    let shapes = space.prepare(&shapes).unwrap();
    let (seconds, nearest) = timed(repeats, || {
        let mut search = NeighbourSearch::new(&space, query.clone(), number(most));
        search.offer(&shapes, &|| false).unwrap();
        search.into_sorted().remove(0)
    });
    let distances: Vec<f64> = nearest.iter().map(|found| found.found.distance).collect();
    let positions: Vec<usize> = nearest.iter().map(|found| found.position).collect();
    json!({"seconds": seconds, "positions": positions, "distances": distances})
}
