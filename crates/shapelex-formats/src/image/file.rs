//! An image as it is read, and what its header says.

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

/// What the header of a file says.
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
