//! Cells inside closed spline curves, by crossings of the curves themselves.

use shapelex_numeric::bounded::Stop;

use super::fill::{accumulate, reached};
use super::grid::{Grid, Mask};
use crate::curve::Curve;

/// Number of samples per segment between which crossings are looked for. Two crossings of one line between two samples are
/// missed together: the curve passes over the centres by less than the sagitta of a chord.
const SAMPLES: usize = 64;

/// Number of bisections of a crossing: an interval of 1/64 of a segment becomes as short as a rounding of its parameter.
const BISECTIONS: usize = 46;

/// Cells in the plane about whose centres closed curves wind: the sum of their winding numbers is not zero, as in
/// [`super::from_contours`]. `None` once `stop` returns true.
///
/// ```text
/// x(u) = x_i,   bracketed by samples with x₀ ≤ x_i < x₁ (+1) or x₁ ≤ x_i < x₀ (−1), for the cells with y_j ≥ y(u)
/// ```
///
/// The crossing is that of the curve, not of its chords, found by bisection. The curves are closed and have dimension 2, else
/// their cells are left out; `grid` has one layer. Cost `O(samples + 46 crossings + cells)`. Memory: besides the mask four bytes
/// per cell.
pub fn from_curves(curves: &[Curve], grid: &Grid, stop: Stop<'_>) -> Option<Mask> {
    debug_assert!(grid.is_planar(), "{grid:?}");
    let [xs, ys] = [0, 1].map(|axis| grid.centres(axis));
    let mut turns = vec![0; xs.len() * ys.len()];
    for curve in curves.iter().filter(|curve| curve.is_closed() && curve.dimension() == 2) {
        let count = SAMPLES * curve.segments();
        let abscissae = curve.evaluate_all(&curve.parameters(count), 0);
        for i in 0..count {
            if i.is_multiple_of(SAMPLES) && stop() {
                return None;
            }
            let ends = [abscissae[i], abscissae[(i + 1) % count]];
            let rows = reached(&xs, ends[0].min(ends[1]))..reached(&xs, ends[0].max(ends[1]));
            for row in rows {
                let j =
                    reached(&ys, crossing(curve, [i, i + 1].map(|i| i as f64 / count as f64), ends, xs[row]));
                if j < ys.len() {
                    turns[row * ys.len() + j] += if ends[0] < ends[1] { 1 } else { -1 };
                }
            }
        }
    }
    let mut inside = vec![false; grid.count()];
    accumulate(&turns, &mut inside, ys.len());
    Some(Mask { grid: *grid, inside })
}

/// `y(u)` at the crossing of `x(u) = x` between two parameters, at which `x(u)` is on different sides.
fn crossing(curve: &Curve, [mut low, mut high]: [f64; 2], ends: [f64; 2], x: f64) -> f64 {
    let (rises, mut point) = (ends[0] < ends[1], [0.0; 2]);
    for _ in 0..BISECTIONS {
        let middle = 0.5 * (low + high);
        curve.evaluate_into(middle, 0, &mut point);
        if (point[0] <= x) == rises {
            low = middle;
        } else {
            high = middle;
        }
    }
    curve.evaluate_into(0.5 * (low + high), 0, &mut point);
    point[1]
}
