//! Influence of control points: their weights at a place, and the region in which one moves a shape.

use super::knot_line::Line;
use super::representation::ShapeSpace;

/// The control points with an influence at the parameter of a curve, the two parameters of a surface, or the vertex of a
/// subdivision surface at its level, with their weights there; empty for landmarks.
pub fn weights(space: &ShapeSpace, parameters: &[f64]) -> Vec<(usize, f64)> {
    match (space.line(), space.surface(), space.subdivision(), parameters) {
        (Some(line), _, _, [u]) => line_weights(line, *u),
        (_, Some(basis), _, [u, v]) => basis.weights(*u, *v),
        (_, _, Some(basis), [vertex]) => basis.weights(*vertex as u32),
        _ => Vec::new(),
    }
}

fn line_weights(line: &Line, u: f64) -> Vec<(usize, f64)> {
    let (half, s) = line.locate(u);
    let (first, weights) = line.weights(half, s, 0);
    let beyond = line.generator().beyond()[0];
    let row = |k: usize| {
        if line.is_closed() {
            (k as isize - beyond as isize).rem_euclid(line.intervals() as isize) as usize
        } else {
            k
        }
    };
    weights.enumerate().map(|(k, weight)| (row(first + k), weight)).collect()
}

/// Region in which a control point moves a shape: an interval of parameters `[from, to]` per direction, with `to > 1` if it
/// crosses the end of a closed direction. Empty for shapes without parameters. Cost: the weights at every pair of half-intervals.
pub fn support(space: &ShapeSpace, control_point: usize) -> Vec<[f64; 2]> {
    let lines: Vec<&Line> = match (space.line(), space.surface()) {
        (Some(line), _) => vec![line],
        (_, Some(basis)) => basis.lines().iter().collect(),
        _ => Vec::new(),
    };
    // Basis functions do not vanish on half-intervals inside their support.
    let places: Vec<Vec<f64>> = lines
        .iter()
        .map(|line| {
            let halves = 2 * line.intervals();
            (0..halves).map(|i| (i as f64 + 0.37) / halves as f64).collect()
        })
        .collect();
    let mut touched: Vec<Vec<bool>> = places.iter().map(|places| vec![false; places.len()]).collect();
    let moves = |parameters: &[f64]| {
        weights(space, parameters).iter().filter(|(i, _)| *i == control_point).map(|(_, w)| w).sum::<f64>()
            != 0.0
    };
    match &places[..] {
        [along] => along.iter().enumerate().for_each(|(i, &u)| touched[0][i] = moves(&[u])),
        [along_u, along_v] => {
            for (i, &u) in along_u.iter().enumerate() {
                for (j, &v) in along_v.iter().enumerate() {
                    if moves(&[u, v]) {
                        (touched[0][i], touched[1][j]) = (true, true);
                    }
                }
            }
        }
        _ => {}
    }
    touched.iter().zip(lines).map(|(touched, line)| interval(touched, line.is_closed())).collect()
}

/// The shortest interval that contains everything touched, for `[0, 1]` in equal parts.
fn interval(touched: &[bool], closed: bool) -> [f64; 2] {
    let count = touched.len();
    let at = |i: usize| i as f64 / count as f64;
    let first = touched.iter().position(|touched| *touched).unwrap_or(0);
    let last = touched.iter().rposition(|touched| *touched).unwrap_or(0);
    let whole = touched.iter().all(|touched| *touched);
    if closed && !whole && touched[0] && touched[count - 1] {
        // Across the end: from behind the last gap to the start of the first.
        let gap_ends = touched.iter().rposition(|touched| !touched).map_or(0, |i| i + 1);
        let gap_starts = touched.iter().position(|touched| !touched).unwrap_or(0);
        return [at(gap_ends), 1.0 + at(gap_starts)];
    }
    [at(first), at(last + 1)]
}
