//! Where results are: beside their starts, and beside each other.

use std::collections::BTreeMap;
use std::ops::Range;

use serde::Serialize;

use crate::geometry::raster::Grid;
use crate::segmentation::run::moved::{Extent, Moved};
use crate::segmentation::snake::Outline;

/// Part of the cells of the smaller one of two results from which on their overlap is a warning: touching contours share cells on
/// their border.
const MUCH: f64 = 0.1;

/// Largest number of warnings about overlaps of one result.
const MOST_WARNINGS: usize = 8;

/// Size and centre of a shape.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct PlaceOutput {
    /// Enclosed area or volume, in the unit of the coordinates.
    size: f64,
    /// Centroid of the enclosed region.
    centre: Vec<f64>,
}

/// A result beside its initial shape.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct MovedOutput {
    /// The initial shape.
    start: PlaceOutput,
    /// The result.
    result: PlaceOutput,
    /// Size of the result over that of the initial shape.
    size_ratio: f64,
    /// Whether the result contains the centre of the initial shape.
    contains_centre: bool,
    /// Part of the cells of the initial shape that the result contains.
    shared: f64,
}

/// A result that covers some of the same cells.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, utoipa::ToSchema)]
pub struct SharedOutput {
    /// Index of the other result.
    index: usize,
    /// Number of cells of the image that both cover.
    cells: usize,
    /// The same as a part of the cells of this result.
    part: f64,
    /// The same as a part of the cells of the other result.
    part_of_other: f64,
}

impl<const D: usize> From<Extent<D>> for PlaceOutput {
    fn from(Extent { size, centre }: Extent<D>) -> Self {
        Self { size, centre: centre.to_vec() }
    }
}

impl<const D: usize> From<Moved<D>> for MovedOutput {
    fn from(moved: Moved<D>) -> Self {
        Self {
            start: moved.start.into(),
            result: moved.result.into(),
            size_ratio: moved.ratio(),
            contains_centre: moved.contains_centre,
            shared: moved.shared,
        }
    }
}

/// Reason why a result counts as one that has left its object.
pub(super) fn left<const D: usize>(moved: &Moved<D>, factor: f64) -> String {
    let ratio = moved.ratio();
    let size = if ratio > factor || ratio * factor < 1.0 {
        format!("it has {ratio:.3} times the size of its initial shape")
    } else if moved.start_contains_centre {
        "it does not contain the centre of its initial shape".to_owned()
    } else {
        "it has no cell of its initial shape".to_owned()
    };
    format!("the shape left its object: {size}")
}

/// The cells of an image inside an outline, as runs of positions with the last axis fastest.
pub(super) fn runs(outline: &Outline, size: [usize; 3]) -> Vec<Range<usize>> {
    let Some(Grid { first, spacing, size: around }) = outline.grid() else { return Vec::new() };
    let lower: [usize; 3] = std::array::from_fn(|c| first[c].max(0.0) as usize);
    let upper: [usize; 3] =
        std::array::from_fn(|c| ((first[c] + around[c] as f64).max(0.0) as usize).min(size[c]));
    if (0..3).any(|c| lower[c] >= upper[c]) {
        return Vec::new();
    }
    let count: [usize; 3] = std::array::from_fn(|c| upper[c] - lower[c]);
    let mask = outline.cells(&Grid { first: lower.map(|x| x as f64), spacing, size: count });
    let mut runs: Vec<Range<usize>> = Vec::new();
    for (at, _) in mask.inside.iter().enumerate().filter(|(_, inside)| **inside) {
        let [i, j, k] = [at / (count[1] * count[2]), at / count[2] % count[1], at % count[2]];
        let cell = ((i + lower[0]) * size[1] + j + lower[1]) * size[2] + k + lower[2];
        match runs.last_mut() {
            Some(run) if run.end == cell => run.end += 1,
            _ => runs.push(cell..cell + 1),
        }
    }
    runs
}

/// For each result, the results that cover some of the same cells. A cell that several cover counts for the first of them with each
/// other one, so that the work is linear in the covered cells, however many results are at one place.
///
/// Memory: 4 bytes for each of the `cells` of the image.
pub(super) fn overlaps(results: &[Vec<Range<usize>>], cells: usize) -> Vec<Vec<SharedOutput>> {
    let mut found = vec![Vec::new(); results.len()];
    if results.len() < 2 {
        return found;
    }
    // Position of the first result that covers a cell, counted from 1; 0 for none.
    let mut first = vec![0_u32; cells];
    let mut pairs: BTreeMap<(usize, usize), usize> = BTreeMap::new();
    for (index, runs) in results.iter().enumerate() {
        for cell in runs.iter().flat_map(Range::clone) {
            match first[cell] {
                0 => first[cell] = u32::try_from(index + 1).unwrap_or(u32::MAX),
                earlier => *pairs.entry((earlier as usize - 1, index)).or_default() += 1,
            }
        }
    }
    let covered = |index: usize| results[index].iter().map(ExactSizeIterator::len).sum::<usize>();
    for ((a, b), shared) in pairs {
        let part = |index: usize| shared as f64 / covered(index) as f64;
        let of = |index, a, b| SharedOutput { index, cells: shared, part: part(a), part_of_other: part(b) };
        found[a].push(of(b, a, b));
        found[b].push(of(a, b, a));
    }
    found
}

/// Warnings about the first results that cover much of this one, or of which this one covers much.
pub(super) fn warnings(shared: &[SharedOutput]) -> Vec<String> {
    let much = |other: &&SharedOutput| other.part.max(other.part_of_other) >= MUCH;
    let text = |other: &SharedOutput| {
        format!(
            "{} of its cells, {:.0} %, are those of result {} too",
            other.cells,
            100.0 * other.part,
            other.index
        )
    };
    shared.iter().filter(much).take(MOST_WARNINGS).map(text).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two rectangles of 10 × 6 and 4 × 6 cells that share 2 × 6, and one elsewhere, partly outside of the image.
    #[test]
    fn shared_cells_are_counted_for_both() {
        let rectangle = |[x0, y0]: [f64; 2], [x1, y1]: [f64; 2]| {
            Outline::Polygon(vec![[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
        };
        let size = [30, 20, 1];
        let results = [
            rectangle([1.5, 2.5], [11.5, 8.5]),
            rectangle([9.5, 2.5], [13.5, 8.5]),
            rectangle([25.5, 12.5], [35.5, 30.5]),
        ];
        let runs: Vec<_> = results.iter().map(|outline| runs(outline, size)).collect();
        let counts: Vec<usize> =
            runs.iter().map(|runs| runs.iter().map(ExactSizeIterator::len).sum()).collect();
        assert_eq!(counts, [60, 24, 4 * 7]);
        let found = overlaps(&runs, 600);
        assert_eq!(found[0], [SharedOutput { index: 1, cells: 12, part: 0.2, part_of_other: 0.5 }]);
        assert_eq!(found[1], [SharedOutput { index: 0, cells: 12, part: 0.5, part_of_other: 0.2 }]);
        assert!(found[2].is_empty());
        assert_eq!(warnings(&found[0]), ["12 of its cells, 20 %, are those of result 1 too"]);
        assert_eq!(warnings(&found[1]), ["12 of its cells, 50 %, are those of result 0 too"]);
        let little = SharedOutput { index: 1, cells: 1, part: 0.05, part_of_other: 0.02 };
        assert!(warnings(&[little]).is_empty());
    }

    /// Many results at one place are told with the first of them: linear work.
    #[test]
    fn results_at_one_place_are_told_with_the_first() {
        let runs = vec![vec![3..7, 13..17]; 5];
        let found = overlaps(&runs, 20);
        assert_eq!(
            found[0].iter().map(|other| (other.index, other.cells)).collect::<Vec<_>>(),
            [(1, 8), (2, 8), (3, 8), (4, 8)]
        );
        let with_first = SharedOutput { index: 0, cells: 8, part: 1.0, part_of_other: 1.0 };
        assert!(found[1..].iter().all(|one| one == &[with_first]));
    }
}
