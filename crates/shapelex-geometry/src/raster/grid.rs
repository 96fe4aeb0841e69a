//! Grids of cells, and masks on them.

/// Fraction of a cell by which a box may exceed a whole number of cells without getting another cell: the quotient of a
/// length and a fraction of itself is rounded twice.
const WHOLE: f64 = 1e-9;

/// A regular grid of pixel or voxel centres `first + spacing · (i, j, k)`.
///
/// A grid of one layer, `size[2] == 1`, lies in the plane. Its third coordinate is ignored, and its third spacing is
/// 1, so that the product of the spacings is an area.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Grid {
    /// The first centre.
    pub first: [f64; 3],
    /// Distances between neighbouring centres along the axes; positive.
    pub spacing: [f64; 3],
    /// Number of centres along each axis.
    pub size: [usize; 3],
}

/// The grid cells that belong to a shape.
#[derive(Debug, Clone, PartialEq)]
pub struct Mask {
    /// The grid.
    pub grid: Grid,
    /// For every cell, whether it belongs to the shape; the last axis is the fastest.
    pub inside: Vec<bool>,
}

impl Grid {
    /// The grid of a given spacing that covers a box and one more cell on every side. Its centre is that of the box, so it
    /// depends on the box and the spacing alone. `D` is 2 or 3.
    ///
    /// Sizes saturate; check [`Grid::count`] before making a mask.
    pub fn around<const D: usize>([lower, upper]: [[f64; D]; 2], spacing: [f64; D]) -> Self {
        const { assert!(D == 2 || D == 3) };
        let mut grid = Self { first: [0.0; 3], spacing: [1.0; 3], size: [1; 3] };
        for axis in 0..D {
            let cells = (upper[axis] - lower[axis]) / spacing[axis];
            let cells = (cells - WHOLE).ceil().max(1.0);
            let middle = 0.5 * lower[axis] + 0.5 * upper[axis];
            grid.first[axis] = middle - 0.5 * spacing[axis] * (cells + 1.0);
            grid.spacing[axis] = spacing[axis];
            grid.size[axis] = (cells as usize).saturating_add(2);
        }
        grid
    }

    /// The grid of square or cubic cells around a box, as in [`Grid::around`], with `cells` along the longest side of the
    /// box. For a box of one point, cells have size 1.
    pub fn with_cells<const D: usize>([lower, upper]: [[f64; D]; 2], cells: usize) -> Self {
        let longest = (0..D).map(|axis| upper[axis] - lower[axis]).fold(0.0, f64::max);
        let spacing = if longest > 0.0 { longest / cells.max(1) as f64 } else { 1.0 };
        Self::around([lower, upper], [spacing; D])
    }

    /// Number of cells; saturates at `usize::MAX`.
    pub fn count(&self) -> usize {
        self.size.iter().fold(1, |count, size| count.saturating_mul(*size))
    }

    /// Volume of a cell; area in the plane.
    pub fn cell_measure(&self) -> f64 {
        self.spacing.iter().product()
    }

    /// Whether the grid has one layer.
    pub fn is_planar(&self) -> bool {
        self.size[2] == 1
    }

    /// Coordinates of the centres along an axis, increasing.
    pub fn centres(&self, axis: usize) -> Vec<f64> {
        (0..self.size[axis]).map(|i| self.first[axis] + self.spacing[axis] * i as f64).collect()
    }

    pub(super) fn index(&self, [i, j, k]: [usize; 3]) -> usize {
        (i * self.size[1] + j) * self.size[2] + k
    }
}

impl Mask {
    /// The mask of cells with x fastest, as files of pictures and volumes have them: `(k · size[1] + j) · size[0] + i`. `None`
    /// unless there is one for every cell of the grid.
    pub fn from_x_fastest(grid: Grid, cells: &[bool]) -> Option<Self> {
        let [columns, rows, slices] = grid.size;
        if grid.count() != cells.len() {
            return None;
        }
        let mut inside = Vec::with_capacity(cells.len());
        for (i, j) in (0..columns).flat_map(|i| (0..rows).map(move |j| (i, j))) {
            inside.extend((0..slices).map(|k| cells[(k * rows + j) * columns + i]));
        }
        Some(Self { grid, inside })
    }

    /// The cells with x fastest: the inverse of [`Self::from_x_fastest`].
    pub fn x_fastest(&self) -> impl Iterator<Item = bool> {
        let [columns, rows, slices] = self.grid.size;
        let rows = (0..slices).flat_map(move |k| (0..rows).map(move |j| [j, k]));
        rows.flat_map(move |[j, k]| (0..columns).map(move |i| self.inside[self.grid.index([i, j, k])]))
    }

    /// Number of cells in the mask.
    pub fn count(&self) -> usize {
        self.inside.iter().filter(|inside| **inside).count()
    }

    /// Volume of the mask; area in the plane.
    pub fn measure(&self) -> f64 {
        self.count() as f64 * self.grid.cell_measure()
    }

    /// Whether a cell of the mask has a neighbour outside of the mask.
    pub(super) fn is_surface(&self, cell: [usize; 3]) -> bool {
        let size = self.grid.size;
        let strides = [size[1] * size[2], size[2], 1];
        let axes = if self.grid.is_planar() { 2 } else { 3 };
        let at = self.grid.index(cell);
        self.inside[at]
            && (0..axes).any(|axis| {
                let border = cell[axis] == 0 || cell[axis] + 1 == size[axis];
                border || !self.inside[at - strides[axis]] || !self.inside[at + strides[axis]]
            })
    }
}
