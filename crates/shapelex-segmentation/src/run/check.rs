//! Checks of a shape after a stage.
//!
//! Integrals over the boundary count a region as often as it is enclosed, with a sign. For a shape that is folded they differ
//! from the number of cells inside:
//!
//! ```text
//! |Vol − cells inside| ≤ 2 % Vol + border cells/4
//! ```
//!
//! Folds of planar curves are also found by an exact test ([`Model::crosses_itself`](crate::snake::Model::crosses_itself)): a loop may
//! be too narrow for cells.

use shapelex_geometry::raster::{Grid, Mask};

use crate::snake::Outline;

/// Relative difference of the volume and the number of cells that is left by sampling.
const SAMPLING: f64 = 0.02;
/// Part of the cells on the border by which the number of cells may be wrong.
const BORDER: f64 = 0.25;
/// Volume in cells below which nothing is left of a shape.
const NOTHING: f64 = 1.0;
/// Part of the cells of a shape that must be in the image.
const INSIDE: f64 = 0.5;

/// Fault of a shape.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fault {
    /// The shape encloses regions twice or negatively, or crosses itself.
    Folded,
    /// Less than half of the shape is in the image.
    LeftImage,
    /// The shape has no volume.
    Collapsed,
}

/// Checks a shape with a volume, in cells, in an image of a size.
pub fn check(outline: &Outline, volume: f64, size: [usize; 3]) -> Option<Fault> {
    let Some([lower, upper]) = outline.bounds() else { return Some(Fault::Collapsed) };
    if !volume.is_finite() || lower.iter().chain(&upper).any(|x| !x.is_finite()) {
        return Some(Fault::Folded);
    }
    // One image size around the image bounds the grid to 27 times its cells.
    let axes = if size[2] == 1 { 2 } else { 3 };
    let far = |axis: usize| lower[axis] < -(size[axis] as f64) || upper[axis] > 2.0 * size[axis] as f64;
    if (0..axes).any(far) {
        return Some(Fault::LeftImage);
    }
    let first: [f64; 3] = std::array::from_fn(|axis| if axis < axes { lower[axis].floor() } else { 0.0 });
    let count = |axis: usize| if axis < axes { (upper[axis] - first[axis]).ceil() as usize + 1 } else { 1 };
    let grid = Grid { first, spacing: [1.0; 3], size: std::array::from_fn(count) };
    let mask = outline.cells(&grid);
    let [cells, border, inside] = counts(&mask, size);
    let difference = (volume - cells as f64).abs();
    if volume < NOTHING && cells == 0 {
        Some(Fault::Collapsed)
    } else if !(difference <= SAMPLING * volume + BORDER * border as f64) {
        Some(Fault::Folded)
    } else if (inside as f64) < INSIDE * cells as f64 {
        Some(Fault::LeftImage)
    } else {
        None
    }
}

/// Numbers of the cells of a mask, of those on its border, and of those in the image.
fn counts(mask: &Mask, size: [usize; 3]) -> [usize; 3] {
    let [nx, ny, nz] = mask.grid.size;
    let strides = [ny * nz, nz, 1];
    let axes = if size[2] == 1 { 2 } else { 3 };
    let mut counts = [0; 3];
    for (at, _) in mask.inside.iter().enumerate().filter(|(_, inside)| **inside) {
        let cell = [at / strides[0], at / nz % ny, at % nz];
        let outside = |axis: usize| {
            let last = [nx, ny, nz][axis] - 1;
            cell[axis] == 0
                || cell[axis] == last
                || !mask.inside[at - strides[axis]]
                || !mask.inside[at + strides[axis]]
        };
        let in_image = |axis: usize| {
            let position = mask.grid.first[axis] + cell[axis] as f64;
            position >= 0.0 && position < size[axis] as f64
        };
        counts[0] += 1;
        counts[1] += usize::from((0..axes).any(outside));
        counts[2] += usize::from((0..axes).all(in_image));
    }
    counts
}

#[cfg(test)]
mod tests {
    use super::*;

    fn polygon(points: &[[f64; 2]]) -> Outline {
        Outline::Polygon(points.to_vec())
    }

    #[test]
    fn faults_are_told_apart() {
        let size = [40, 30, 1];
        let square =
            |[x, y]: [f64; 2], side: f64| [[x, y], [x + side, y], [x + side, y + side], [x, y + side]];
        let at = |corner: [f64; 2]| check(&polygon(&square(corner, 12.0)), 144.0, size);
        assert_eq!(at([5.5, 6.5]), None);
        assert_eq!(at([-5.5, 6.5]), None);
        assert_eq!(at([-8.5, 6.5]), Some(Fault::LeftImage));
        assert_eq!(at([200.0, 6.5]), Some(Fault::LeftImage));
        let once = square([5.5, 6.5], 12.0);
        let twice = polygon(&[once, once].concat());
        assert_eq!(check(&twice, 288.0, size), Some(Fault::Folded));
        assert_eq!(check(&polygon(&once), -144.0, size), Some(Fault::Folded));
        assert_eq!(check(&polygon(&once), f64::NAN, size), Some(Fault::Folded));
        assert_eq!(check(&polygon(&square([5.6, 6.6], 0.1)), 0.01, size), Some(Fault::Collapsed));
    }
}
