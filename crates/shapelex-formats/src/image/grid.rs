//! The grid of an image: its size, and the positions of its cells.

use super::error::ImageError;
use crate::unit::Unit;

/// Determinants below this, relative to the product of the lengths of the columns, are taken for zero: the inverse would have
/// lost all digits that matter for positions.
const SINGULAR: f64 = 1e-9;

/// The unit in which a file gives lengths.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LengthUnit {
    /// 1000 mm.
    Metre,
    /// 10 mm.
    Centimetre,
    /// 1 mm.
    Millimetre,
    /// 0.001 mm.
    Micrometre,
    /// 10⁻⁶ mm.
    Nanometre,
    /// 25.4 mm.
    Inch,
    /// A cell: the file gives no lengths, and cells have the size 1.
    Cell,
    /// Not given: lengths are taken for millimetres.
    Unknown,
}

impl LengthUnit {
    /// The unit of a length; `None` without one.
    pub fn length(self) -> Option<Unit> {
        match self {
            Self::Metre => Some(Unit::Metre),
            Self::Centimetre => Some(Unit::Centimetre),
            Self::Millimetre => Some(Unit::Millimetre),
            Self::Micrometre => Some(Unit::Micrometre),
            Self::Nanometre => Some(Unit::Nanometre),
            Self::Inch => Some(Unit::Inch),
            Self::Cell | Self::Unknown => None,
        }
    }

    /// A number of this unit in millimetres.
    pub fn millimetres(self, x: f64) -> f64 {
        self.length().and_then(|unit| unit.to(Unit::Millimetre)).map_or(x, |ratio| ratio.times(x))
    }
}

impl From<Unit> for LengthUnit {
    fn from(unit: Unit) -> Self {
        match unit {
            Unit::Metre => Self::Metre,
            Unit::Centimetre => Self::Centimetre,
            Unit::Millimetre => Self::Millimetre,
            Unit::Micrometre => Self::Micrometre,
            Unit::Nanometre => Self::Nanometre,
            Unit::Inch => Self::Inch,
            Unit::Pixel | Unit::Voxel => Self::Cell,
            Unit::None => Self::Unknown,
        }
    }
}

/// Size of an image and the affine map from the index of a cell to the position of its centre.
///
/// ```text
/// w = A i + b,   affine = [A | b],   i = (i, j, k),   w in mm
/// ```
///
/// Centres have whole indices from 0. The value of cell `(i, j, k)` is at `(k · size[1] + j) · size[0] + i`: x is fastest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Grid {
    size: [usize; 3],
    affine: [[f64; 4]; 3],
    units: [LengthUnit; 3],
    open_ends: bool,
}

impl Grid {
    /// A grid of `size` cells with the rows `[A | b]` in millimetres, from a file with lengths in `units` along x, y, z.
    ///
    /// # Errors
    /// [`ImageError::Empty`], [`ImageError::Spacing`] of a column that is zero or not finite, [`ImageError::Affine`].
    pub fn new(size: [usize; 3], affine: [[f64; 4]; 3], units: [LengthUnit; 3]) -> Result<Self, ImageError> {
        if size
            .iter()
            .try_fold(1_usize, |count, size| count.checked_mul(*size))
            .is_none_or(|count| count == 0)
        {
            return Err(ImageError::Empty { size: size.map(|size| size as u64) });
        }
        let grid = Self { size, affine, units, open_ends: false };
        let spacing = grid.spacing();
        for (axis, value) in ['x', 'y', 'z'].into_iter().zip(spacing) {
            check_spacing(axis, value)?;
        }
        let determinant = grid.determinant();
        let finite = affine.iter().flatten().all(|entry| entry.is_finite());
        if finite && determinant.is_finite() && determinant.abs() > SINGULAR * spacing.iter().product::<f64>()
        {
            Ok(grid)
        } else {
            Err(ImageError::Affine { determinant })
        }
    }

    /// A grid along the axes of the world, whose first centre is the origin: `A = diag(spacing)`, `b = 0`.
    ///
    /// # Errors
    /// [`ImageError::Empty`], [`ImageError::Spacing`].
    pub fn along_axes(
        size: [usize; 3],
        spacing: [f64; 3],
        units: [LengthUnit; 3],
    ) -> Result<Self, ImageError> {
        for (axis, value) in ['x', 'y', 'z'].into_iter().zip(spacing) {
            check_spacing(axis, value)?;
        }
        let row = |r: usize| std::array::from_fn(|c| if r == c { spacing[r] } else { 0.0 });
        Self::new(size, std::array::from_fn(row), units)
    }

    /// Number of cells along x, y, z; 1 along z for an image in the plane.
    pub fn size(&self) -> [usize; 3] {
        self.size
    }

    /// Number of cells.
    pub fn cells(&self) -> usize {
        self.size.iter().product()
    }

    /// Whether the image has one layer.
    pub fn is_planar(&self) -> bool {
        self.size[2] == 1
    }

    /// The grid of the cells with the index `k` along z: an image in the plane, at the same positions. `None` beyond the last one.
    #[must_use]
    pub fn layer(&self, k: usize) -> Option<Self> {
        let [width, height, depth] = self.size;
        let affine = self.affine.map(|[x, y, z, offset]| [x, y, z, offset + z * k as f64]);
        (k < depth).then_some(Self { size: [width, height, 1], affine, ..*self })
    }

    /// The grid of `count` layers from the index `first` along z on. `None` if it does not have them.
    #[must_use]
    pub(super) fn layers(&self, first: usize, count: usize) -> Option<Self> {
        let [width, height, depth] = self.size;
        let begin = self.layer(first)?;
        (count > 0 && first + count <= depth).then_some(Self { size: [width, height, count], ..begin })
    }

    /// The same grid, of a volume that may go on beyond its first and its last layer.
    #[must_use]
    pub(super) fn with_open_ends(self, open_ends: bool) -> Self {
        Self { open_ends, ..self }
    }

    /// Whether the volume may go on beyond its first and its last layer: the file holds a part of it and does not say which.
    pub fn has_open_ends(&self) -> bool {
        self.open_ends && !self.is_planar()
    }

    /// The rows `[A | b]`, in millimetres.
    pub fn affine(&self) -> [[f64; 4]; 3] {
        self.affine
    }

    /// Units of lengths along x, y, z in the file.
    pub fn units(&self) -> [LengthUnit; 3] {
        self.units
    }

    /// Whether the file gives lengths along all axes that it has.
    pub fn has_lengths(&self) -> bool {
        self.axes().iter().all(|unit| unit.length().is_some())
    }

    /// Unit of positions: millimetres where the file gives lengths, cells where it gives none; `None` where it does not say the
    /// unit of its lengths.
    pub fn unit(&self) -> Option<Unit> {
        match self.axes() {
            _ if self.has_lengths() => Some(Unit::Millimetre),
            axes if axes.iter().any(|unit| *unit != LengthUnit::Cell) => None,
            _ if self.is_planar() => Some(Unit::Pixel),
            _ => Some(Unit::Voxel),
        }
    }

    /// The unit in which shapes of the image are told: that of the file where it is a small one, else that of positions.
    pub fn unit_of_shapes(&self) -> Option<Unit> {
        let [first, others @ ..] = self.axes() else { return None };
        let is_small = matches!(first, LengthUnit::Micrometre | LengthUnit::Nanometre);
        if is_small && others.iter().all(|unit| unit == first) { first.length() } else { self.unit() }
    }

    /// Units along the axes that the image has.
    fn axes(&self) -> &[LengthUnit] {
        if self.is_planar() { &self.units[..2] } else { &self.units }
    }

    /// Distances between neighbouring centres along x, y, z in millimetres: the lengths of the columns of `A`.
    pub fn spacing(&self) -> [f64; 3] {
        std::array::from_fn(|c| self.column(c).iter().map(|x| x * x).sum::<f64>().sqrt())
    }

    /// `det A`: negative if the map changes the orientation.
    pub fn determinant(&self) -> f64 {
        let [x, y, z] = [0, 1, 2].map(|c| self.column(c));
        let normal = cross(x, y);
        (0..3).map(|r| normal[r] * z[r]).sum()
    }

    fn column(&self, c: usize) -> [f64; 3] {
        self.affine.map(|row| row[c])
    }
}

/// `a × b`.
pub(super) fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// Refuses a spacing that is zero, negative, infinite or no number.
pub(super) fn check_spacing(axis: char, value: f64) -> Result<(), ImageError> {
    if value > 0.0 && value.is_finite() { Ok(()) } else { Err(ImageError::Spacing { axis, value }) }
}

#[cfg(test)]
mod tests {
    use super::*;

    const UNITS: [LengthUnit; 3] = [LengthUnit::Millimetre; 3];

    #[test]
    fn spacing_and_determinant_follow_from_the_columns() {
        let affine = [[0.0, -2.0, 0.0, 7.0], [3.0, 0.0, 0.0, 8.0], [0.0, 0.0, -0.5, 9.0]];
        let grid = Grid::new([4, 2, 1], affine, UNITS).unwrap();
        assert_eq!((grid.spacing(), grid.determinant(), grid.cells()), ([3.0, 2.0, 0.5], -3.0, 8));
        assert!(grid.is_planar());
    }

    #[test]
    fn a_layer_keeps_its_place() {
        let affine = [[0.0, -2.0, 0.5, 7.0], [3.0, 0.0, 0.0, 8.0], [0.0, 0.0, -0.5, 9.0]];
        let grid = Grid::new([4, 2, 3], affine, UNITS).unwrap();
        let layer = grid.layer(2).unwrap();
        assert_eq!((layer.size(), layer.is_planar()), ([4, 2, 1], true));
        assert_eq!(layer.affine().map(|row| row[3]), [8.0, 8.0, 8.0]);
        assert_eq!(layer.spacing(), grid.spacing());
        assert_eq!(grid.layer(3), None);
    }

    #[test]
    fn bad_grids_are_refused() {
        let make = |spacing| Grid::along_axes([2, 2, 2], spacing, UNITS);
        for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let message = make([1.0, bad, 1.0]).unwrap_err().to_string();
            assert_eq!(message, format!("expected a positive, finite spacing along y, got {bad}"));
        }
        let empty = Grid::along_axes([2, 0, 2], [1.0; 3], UNITS);
        assert_eq!(empty, Err(ImageError::Empty { size: [2, 0, 2] }));
        let singular = [[1.0, 2.0, 0.0, 0.0], [1.0, 2.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]];
        assert_eq!(Grid::new([1; 3], singular, UNITS), Err(ImageError::Affine { determinant: 0.0 }));
        let mut lost = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]];
        lost[1][3] = f64::NAN;
        assert!(matches!(Grid::new([1; 3], lost, UNITS), Err(ImageError::Affine { .. })));
    }
}
