//! Where a search begins: starts and rotations with large correlations of tangents at equal fractions of the length.

use super::pairing::{Found, Way};
use super::strips::Strips;
use super::{IDENTITY, Rotation};

/// Least distance of two starts, in segments.
const APART: usize = 3;

/// Shifts whose rotations are computed in space, for each start that is wanted: those with the largest correlations.
const RATED: usize = 3;

/// Angle by which the first rotations of open curves are tilted, in radians.
const TILT: f64 = 0.7;

/// Starts of the search for one way to lay the first curve, the best ones first: at most `most` of closed curves, which may begin
/// anywhere; of open ones, the best rotation and tilted ones.
pub(super) fn candidates(strips: &Strips<'_>, way: Way, most: usize) -> Vec<Found> {
    let count = strips.count();
    let found = |shift: f64, (rotation, value): (Rotation, f64)| {
        let path = (0..=count).map(|i| (i as f64 + shift) / count as f64).collect();
        Found { way, rotation, path, value }
    };
    let correlations = correlations(strips);
    let half = (count / 2) as f64;
    if !strips.closed {
        let (rotation, value) = strips.best_rotation(&at(&correlations, count / 2));
        let tilted = |tilt: Rotation| found(0.0, (product(&tilt, &rotation), value));
        let tilts = if strips.turns { tilts(strips.second.dimension()) } else { vec![IDENTITY] };
        return tilts.into_iter().map(tilted).collect();
    }
    let mut rated = rated(strips, &correlations, RATED * most);
    rated.sort_by(|a, b| b.1.1.total_cmp(&a.1.1));
    let mut kept: Vec<(usize, (Rotation, f64))> = Vec::new();
    for (shift, score) in rated {
        let near = |&(other, _): &(usize, _)| {
            let apart = shift.abs_diff(other);
            apart.min(count - apart) < APART
        };
        if kept.len() < most && !kept.iter().any(near) {
            kept.push((shift, score));
        }
    }
    kept.into_iter()
        .map(|(shift, score)| found((shift as f64 - half).rem_euclid(count as f64), score))
        .collect()
}

/// `Σ_i u_a[i, r] u_b[i + s, c]` for all shifts `s` from `−⌊M/2⌋`: a list for each `r` and `c`.
fn correlations(strips: &Strips<'_>) -> Vec<Vec<f32>> {
    let (count, d) = (strips.count(), strips.second.dimension());
    let from = strips.second.pad - count / 2;
    let sum = |r: usize, c: usize| {
        let mut sums = vec![0.0; count];
        let column = strips.second.column(c);
        for (i, own) in strips.first.iter().enumerate() {
            let shifted = &column[from + i..][..count];
            sums.iter_mut().zip(shifted).for_each(|(sum, y)| *sum += own[r] * y);
        }
        sums
    };
    (0..d * d).map(|k| sum(k / d, k % d)).collect()
}

/// The matrix of correlations at one shift.
fn at(correlations: &[Vec<f32>], shift: usize) -> Rotation {
    let d = if correlations.len() == 4 { 2 } else { 3 };
    let mut matrix = [[0.0; 3]; 3];
    for r in 0..d {
        for c in 0..d {
            matrix[r][c] = f64::from(correlations[r * d + c][shift]);
        }
    }
    matrix
}

/// Shifts with their best rotations and scores: all in the plane, in space the `most` with the largest matrices.
fn rated(strips: &Strips<'_>, correlations: &[Vec<f32>], most: usize) -> Vec<(usize, (Rotation, f64))> {
    let mut shifts: Vec<usize> = (0..strips.count()).collect();
    if strips.second.dimension() == 3 && strips.turns {
        let norm = |shift: usize| correlations.iter().map(|list| list[shift] * list[shift]).sum::<f32>();
        shifts.sort_by(|a, b| norm(*b).total_cmp(&norm(*a)));
        shifts.truncate(most);
    }
    let score = |shift: usize| strips.best_rotation(&at(correlations, shift));
    shifts.into_iter().map(|shift| (shift, score(shift))).collect()
}

/// No rotation, and one about each axis in both directions.
fn tilts(dimension: usize) -> Vec<Rotation> {
    let mut tilts = vec![IDENTITY];
    for axis in if dimension == 2 { 2..3 } else { 0..3 } {
        for angle in [TILT, -TILT] {
            let (a, b) = ((axis + 1) % 3, (axis + 2) % 3);
            let mut tilt = IDENTITY;
            (tilt[a][a], tilt[a][b]) = (angle.cos(), -angle.sin());
            (tilt[b][a], tilt[b][b]) = (angle.sin(), angle.cos());
            tilts.push(tilt);
        }
    }
    tilts
}

/// The product of two matrices.
pub(super) fn product(a: &Rotation, b: &Rotation) -> Rotation {
    let mut product = [[0.0; 3]; 3];
    for r in 0..3 {
        for c in 0..3 {
            product[r][c] = (0..3).map(|k| a[r][k] * b[k][c]).sum();
        }
    }
    product
}
