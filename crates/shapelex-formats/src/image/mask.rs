//! Images to and from the masks of requests, whose last axis is fastest.

use super::error::ImageError;
use super::file::ImageFile;
use super::grid::{Grid, LengthUnit};
use super::limits::{Limits, reserve};

/// A mask as requests contain it: run lengths of cells on a grid along the axes.
///
/// The cell `(i, j, k)` comes `(i · size[1] + j) · size[2] + k` cells after the first one, in the plane `i · size[1] + j`: z is
/// fastest, or y in the plane, whereas x is fastest in files.
#[derive(Debug, Clone, PartialEq)]
pub struct MaskRuns {
    /// Number of cells along the 2 or 3 axes.
    pub size: Vec<usize>,
    /// Distances between neighbouring centres.
    pub spacing: Vec<f64>,
    /// Position of the first centre.
    pub first: Vec<f64>,
    /// Run lengths of cells outside, inside, outside, and so on; the first may be 0.
    pub runs: Vec<usize>,
}

impl MaskRuns {
    /// The cells for which `inside` holds, by their position with x fastest.
    ///
    /// A mask has no rotation: it is that of the indices, with the spacing of the grid and its first centre at the origin.
    pub fn from_cells(grid: &Grid, inside: impl Fn(usize) -> bool) -> Self {
        let [width, height, depth] = grid.size();
        let axes = if grid.is_planar() { 2 } else { 3 };
        let (mut runs, mut current) = (vec![0], false);
        for i in 0..width {
            for j in 0..height {
                for k in 0..depth {
                    let cell = inside((k * height + j) * width + i);
                    if cell != current {
                        runs.push(0);
                        current = cell;
                    }
                    if let Some(run) = runs.last_mut() {
                        *run += 1;
                    }
                }
            }
        }
        let (size, spacing) = (grid.size()[..axes].to_vec(), grid.spacing()[..axes].to_vec());
        Self { size, spacing, first: vec![0.0; axes], runs }
    }

    /// The cells of one label, or of all labels but 0.
    pub fn from_labels(image: &ImageFile<u32>, label: Option<u32>) -> Self {
        Self::from_cells(&image.grid, |cell| {
            label.map_or(image.values[cell] != 0, |label| image.values[cell] == label)
        })
    }

    /// The mask as an image: 1 inside, 0 outside, x fastest.
    ///
    /// # Errors
    /// [`ImageError::Cells`], [`ImageError::Empty`], [`ImageError::Spacing`], [`ImageError::Affine`], and
    /// [`ImageError::Values`] if lists are not of one length or the runs do not cover the grid.
    pub fn to_image(&self, limits: &Limits) -> Result<ImageFile<u8>, ImageError> {
        let grid = self.grid(limits)?;
        let (expected, [width, height, depth]) = (grid.cells(), grid.size());
        let found = self.runs.iter().fold(0_usize, |sum, run| sum.saturating_add(*run));
        if found != expected {
            return Err(ImageError::Values { what: "cells in runs", expected, found });
        }
        let mut values = reserve(expected)?;
        values.resize(expected, 0);
        let mut start = 0;
        for (index, run) in self.runs.iter().enumerate() {
            for cell in (start..start + run).filter(|_| index % 2 == 1) {
                let (i, j, k) = (cell / depth / height, cell / depth % height, cell % depth);
                values[(k * height + j) * width + i] = 1;
            }
            start += run;
        }
        Ok(ImageFile { grid, values })
    }

    fn grid(&self, limits: &Limits) -> Result<Grid, ImageError> {
        let axes = self.size.len().clamp(2, 3);
        let lists = [
            ("axes of size", self.size.len()),
            ("entries of spacing", self.spacing.len()),
            ("entries of first", self.first.len()),
        ];
        if let Some((what, found)) = lists.into_iter().find(|(_, found)| *found != axes) {
            return Err(ImageError::Values { what, expected: axes, found });
        }
        let of = |values: &[f64], rest| {
            std::array::from_fn::<f64, 3, _>(|axis| *values.get(axis).unwrap_or(&rest))
        };
        let size = limits.size(std::array::from_fn(|axis| *self.size.get(axis).unwrap_or(&1) as u64))?;
        let grid = Grid::along_axes(size, of(&self.spacing, 1.0), [LengthUnit::Unknown; 3])?;
        let (mut affine, first) = (grid.affine(), of(&self.first, 0.0));
        for (row, first) in affine.iter_mut().zip(first) {
            row[3] = first;
        }
        Grid::new(size, affine, grid.units())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: Limits = Limits { bytes: 1 << 20, cells: 1 << 10 };

    fn grid(size: [usize; 3]) -> Grid {
        Grid::along_axes(size, [2.0, 3.0, 5.0], [LengthUnit::Unknown; 3]).unwrap()
    }

    #[test]
    fn a_picture_that_is_not_square_is_transposed() {
        // Three columns, two rows: the cells (1, 0) and (2, 1) are inside.
        let picture = [0, 1, 0, 0, 0, 1];
        let mask = MaskRuns::from_cells(&grid([3, 2, 1]), |cell| picture[cell] != 0);
        assert_eq!(
            (&mask.size[..], &mask.spacing[..], &mask.first[..]),
            (&[3, 2][..], &[2.0, 3.0][..], &[0.0; 2][..])
        );
        // Columns one after the other: (0, 0) (0, 1) | (1, 0) | (1, 1) (2, 0) | (2, 1).
        assert_eq!(mask.runs, [2, 1, 2, 1]);
        let image = mask.to_image(&LIMITS).unwrap();
        assert_eq!((image.values, image.grid.size()), (picture.to_vec(), [3, 2, 1]));
    }

    #[test]
    fn volumes_come_back() {
        let grid = grid([2, 3, 4]);
        let values: Vec<u32> = (0..24).map(|cell| cell * 7 % 5).collect();
        for label in [None, Some(3)] {
            let inside = |value: u32| label.map_or(value != 0, |label| value == label);
            let mut mask = MaskRuns::from_labels(&ImageFile { grid, values: values.clone() }, label);
            mask.first = vec![10.0, 20.0, 30.0];
            let image = mask.to_image(&LIMITS).unwrap();
            assert_eq!(image.values, values.iter().map(|value| u8::from(inside(*value))).collect::<Vec<_>>());
            assert_eq!(image.grid.affine().map(|row| row[3]), [10.0, 20.0, 30.0]);
            assert_eq!(image.grid.spacing(), [2.0, 3.0, 5.0]);
        }
    }

    #[test]
    fn bad_masks_are_refused() {
        let mask =
            MaskRuns { size: vec![2, 2], spacing: vec![1.0; 2], first: vec![0.0; 2], runs: vec![0, 4] };
        assert_eq!(mask.to_image(&LIMITS).unwrap().values, [1; 4]);
        let with = |change: fn(&mut MaskRuns)| {
            let mut bad = mask.clone();
            change(&mut bad);
            bad.to_image(&LIMITS).unwrap_err().to_string()
        };
        assert_eq!(with(|mask| mask.runs = vec![1, 2]), "expected 4 cells in runs, got 3");
        assert_eq!(
            with(|mask| mask.runs = vec![usize::MAX; 2]),
            format!("expected 4 cells in runs, got {}", usize::MAX)
        );
        assert_eq!(
            with(|mask| mask.size = vec![1 << 40, 1 << 40]),
            format!("expected at most 1024 cells, got {0} × {0} × 1", 1_u64 << 40)
        );
        assert_eq!(
            with(|mask| mask.spacing = vec![1.0, -1.0]),
            "expected a positive, finite spacing along y, got -1"
        );
        assert_eq!(with(|mask| mask.first = vec![0.0]), "expected 2 entries of first, got 1");
        assert_eq!(with(|mask| mask.size = vec![4]), "expected 2 axes of size, got 1");
        assert!(with(|mask| mask.first[0] = f64::NAN).starts_with("expected an invertible affine map"));
    }
}
