//! Segmentation of images and volumes by parametric snakes: shapes that minimise an energy of the image inside them.
//!
//! * [`field`] — images, Gaussian derivatives, and fields integrated in advance along x.
//!
//! # Coordinates
//! Centres of pixels and voxels are whole numbers, `x` is the fastest axis. Outside of an image every field is zero.

pub mod field;

/// Errors of the segmentation layer.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SegmentationError {
    /// The number of values is not that of the size.
    #[error("expected {} values for {} × {} × {} cells, got {count}", size.iter().product::<usize>(), size[0], size[1], size[2])]
    Values {
        /// Number of cells along x, y, z.
        size: [usize; 3],
        /// Number of values given.
        count: usize,
    },
    /// An image has no cells.
    #[error("expected at least one cell along every axis, got {} × {} × {}", size[0], size[1], size[2])]
    Empty {
        /// Number of cells along x, y, z.
        size: [usize; 3],
    },
    /// A value of an image is not a finite number.
    #[error("expected finite values, got {value} at cell {index}")]
    NotFinite {
        /// Position of the value, x fastest.
        index: usize,
        /// The value.
        value: f64,
    },
}
