//! Overlap of two masks, and distances of their surfaces.

use shapelex_numeric::bounded::{Stop, never};

use super::distance::Window;
use super::fill::between;
use super::grid::Mask;

/// Overlap of two masks, and distances between their surfaces.
///
/// The surface of a mask consists of its cells with a neighbour across a face (in the plane, across an edge) that is outside
/// of the mask or beyond the grid. Distances are between centres, in the unit of the spacing; `None` if a mask is empty.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Overlap {
    /// Number of cells in each mask.
    pub cells: [usize; 2],
    /// Number of cells in both masks.
    pub intersection: usize,
    /// Number of cells in at least one mask.
    pub union: usize,
    /// `|A ∩ B| / |A ∪ B|`; 1 if both are empty.
    pub jaccard: f64,
    /// `2 |A ∩ B| / (|A| + |B|)`; 1 if both are empty.
    pub dice: f64,
    /// Largest distance from one surface to the other, over both directions.
    pub hausdorff: Option<f64>,
    /// The larger one of the 95th percentiles of the distances in both directions, with linear interpolation.
    pub hausdorff_95: Option<f64>,
    /// Mean of the distances in both directions together.
    pub mean_surface_distance: Option<f64>,
}

/// Overlap of two masks of one grid.
///
/// Distances come from an exact distance transform of each surface, read at the cells of the other, within the
/// bounding box of both masks. Cost `O(cells)`, and 6 bytes per cell of that box. The result does not depend on the
/// number of threads.
pub fn overlap(a: &Mask, b: &Mask) -> Overlap {
    compared(a, b, &never)
}

/// As [`overlap`], with cancellation: `stop` is checked at every layer of cells.
pub fn overlap_unless_stopped(a: &Mask, b: &Mask, stop: Stop<'_>) -> Option<Overlap> {
    let overlap = compared(a, b, stop);
    (!stop()).then_some(overlap)
}

fn compared(a: &Mask, b: &Mask, stop: Stop<'_>) -> Overlap {
    debug_assert_eq!(a.grid, b.grid);
    let cells = [a.count(), b.count()];
    let intersection = a.inside.iter().zip(&b.inside).filter(|(a, b)| **a && **b).count();
    let union = cells[0] + cells[1] - intersection;
    let ratio = |part: usize, whole: usize| if whole == 0 { 1.0 } else { part as f64 / whole as f64 };
    let mut distances = surface_distances(a, b, stop);
    let pooled = || distances.iter().flatten().copied();
    let (hausdorff, mean_surface_distance) = (pooled().reduce(f64::max), mean(pooled()));
    let percentiles = distances.iter_mut().filter_map(|directed| percentile(directed, 0.95));
    Overlap {
        cells,
        intersection,
        union,
        jaccard: ratio(intersection, union),
        dice: ratio(2 * intersection, cells[0] + cells[1]),
        hausdorff,
        hausdorff_95: percentiles.reduce(f64::max),
        mean_surface_distance,
    }
}

fn mean(values: impl Iterator<Item = f64> + Clone) -> Option<f64> {
    let count = values.clone().count();
    (count > 0).then(|| values.sum::<f64>() / count as f64)
}

/// Value at position `part · (n − 1)` of the sorted values, with linear interpolation. Reorders them. Cost `O(n)`.
fn percentile(values: &mut [f64], part: f64) -> Option<f64> {
    let position = part * values.len().checked_sub(1)? as f64;
    let below = position as usize;
    let (_, &mut value, above) = values.select_nth_unstable_by(below, f64::total_cmp);
    let next = above.iter().copied().reduce(f64::min).unwrap_or(value);
    Some(between(value, next, position - below as f64))
}

/// Distances from the surface cells of `a` to the surface of `b`, and from `b` to `a`; empty if one surface is empty.
fn surface_distances(a: &Mask, b: &Mask, stop: Stop<'_>) -> [Vec<f64>; 2] {
    let Some(window) = Window::around(a, b) else { return [Vec::new(), Vec::new()] };
    let [of_a, of_b] = [a, b].map(|mask| window.surface(mask));
    if [&of_a, &of_b].into_iter().any(|surface| !surface.contains(&true)) {
        return [Vec::new(), Vec::new()];
    }
    [window.distances(&of_a, &of_b, stop), window.distances(&of_b, &of_a, stop)]
}
