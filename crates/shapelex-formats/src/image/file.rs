//! An image as it is read, and the facts of its header.

use super::grid::Grid;
use super::value::ValueType;

/// A grid with a value for every cell, x fastest.
#[derive(Debug, Clone, PartialEq)]
pub struct ImageFile<T = f32> {
    /// Size and positions.
    pub grid: Grid,
    /// The values of the cells; one for each.
    pub values: Vec<T>,
}

impl<T: Copy> ImageFile<T> {
    /// The cells with the index `k` along z. `None` beyond the last one.
    #[must_use]
    pub fn layer(&self, k: usize) -> Option<Self> {
        let grid = self.grid.layer(k)?;
        let values = self.values.get(k * grid.cells()..(k + 1) * grid.cells())?.to_vec();
        Some(Self { grid, values })
    }
}

/// Description of a file from its header.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Description {
    /// Size and positions.
    pub grid: Grid,
    /// Type of the numbers in the file.
    pub stored: ValueType,
    /// Numbers for each cell in the file: 1 grey, 2 grey and alpha, 3 and 4 colour.
    pub channels: usize,
    /// Most bytes of memory that reading takes: values, and the buffers of the decoder.
    pub memory_bytes: u64,
}

#[cfg(test)]
mod tests {
    use super::super::grid::LengthUnit;
    use super::*;

    #[test]
    fn a_layer_has_its_own_values() {
        let grid = Grid::along_axes([2, 3, 2], [1.0; 3], [LengthUnit::Unknown; 3]).unwrap();
        let file = ImageFile { grid, values: (0..12_u32).collect() };
        assert_eq!(file.layer(1).unwrap().values, [6, 7, 8, 9, 10, 11]);
        assert_eq!(file.layer(2), None);
    }
}
