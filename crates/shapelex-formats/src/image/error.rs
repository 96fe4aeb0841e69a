//! Errors of image files.

/// Why a file is not an image, or an image cannot be written.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ImageError {
    /// The first bytes belong to no format of the registry.
    #[error("expected a file of one of the formats {known}, got one that begins with {found}")]
    Format {
        /// Names of the formats.
        known: String,
        /// The first bytes, hexadecimal.
        found: String,
    },
    /// The content of a gzip file is another gzip file.
    #[error("expected a NIfTI-1 file inside of the gzip file, got another gzip file")]
    NestedGzip,
    /// Fewer bytes than announced.
    #[error("expected {expected} bytes of {place}, got {found}")]
    Truncated {
        /// The part of the file.
        place: &'static str,
        /// Number of bytes announced.
        expected: u64,
        /// Number of bytes present; for compressed data the most that they can hold.
        found: u64,
    },
    /// The file ends before its image does.
    #[error("expected a whole {format} file, got one that ends too early")]
    Short {
        /// Name of the format.
        format: &'static str,
    },
    /// More bytes than announced.
    #[error("expected the file to end after {expected} bytes of {place}, got more")]
    Excess {
        /// The part of the file.
        place: &'static str,
        /// Number of bytes announced.
        expected: u64,
    },
    /// The bytes contradict the format.
    #[error("expected a valid {format} file, got one with a fault: {fault}")]
    Corrupt {
        /// Name of the format.
        format: &'static str,
        /// The fault.
        fault: String,
    },
    /// A valid file with a feature that is not read.
    #[error("expected {expected} in a {format} file, got {found}")]
    Unsupported {
        /// Name of the format.
        format: &'static str,
        /// Features that are read.
        expected: &'static str,
        /// Feature of the file.
        found: String,
    },
    /// More cells than allowed.
    #[error("expected at most {limit} cells, got {} × {} × {}", size[0], size[1], size[2])]
    Cells {
        /// The limit.
        limit: u64,
        /// Number of cells along x, y, z.
        size: [u64; 3],
    },
    /// More bytes than allowed.
    #[error("expected at most {limit} bytes of {place}, got {found}")]
    Bytes {
        /// The part of the file.
        place: &'static str,
        /// The limit.
        limit: u64,
        /// Number of bytes announced.
        found: u128,
    },
    /// The system has no memory for an image within the limits.
    #[error("expected {bytes} bytes of free memory, got fewer")]
    Memory {
        /// Number of bytes needed.
        bytes: u64,
    },
    /// An image has no cells.
    #[error("expected at least one cell along every axis, got {} × {} × {}", size[0], size[1], size[2])]
    Empty {
        /// Number of cells along x, y, z.
        size: [u64; 3],
    },
    /// A distance between cells is not positive.
    #[error("expected a positive, finite spacing along {axis}, got {value}")]
    Spacing {
        /// The axis.
        axis: char,
        /// The spacing in the unit of the file.
        value: f64,
    },
    /// The map from indices to positions has no inverse.
    #[error("expected an invertible affine map, got one with determinant {determinant:.1e}")]
    Affine {
        /// The determinant of its linear part.
        determinant: f64,
    },
    /// A value is not finite, or not within single precision.
    #[error("expected a finite value in single precision, got {value} at cell {index}")]
    NotFinite {
        /// Position of the first such value, x fastest, from 0.
        index: usize,
        /// The value.
        value: f64,
    },
    /// A value is not a label.
    #[error("expected a label, a whole number from 0 to 4294967295, got {value} at cell {index}")]
    Label {
        /// Position of the first such value, x fastest, from 0.
        index: usize,
        /// The value.
        value: f64,
    },
    /// A pixel of a label image is coloured.
    #[error("expected a label, a grey pixel, got red {}, green {}, blue {} at cell {index}", colour[0], colour[1], colour[2])]
    Colour {
        /// Position of the first such pixel, x fastest, from 0.
        index: usize,
        /// Its colour.
        colour: [f64; 3],
    },
    /// A cell belongs to several segments.
    #[error("expected segments that do not overlap, got segments {} and {} at cell {index}", segments[0], segments[1])]
    Overlap {
        /// Position of the first such cell, x fastest, from 0.
        index: usize,
        /// Numbers of two segments.
        segments: [u32; 2],
    },
    /// The pages of a file are not of one kind.
    #[error("expected pages of one size and type, {first} as on page 1, got {found} on page {page}")]
    Pages {
        /// Size and type of the first page.
        first: String,
        /// Number of the page that differs, from 1.
        page: usize,
        /// Its size and type.
        found: String,
    },
    /// A list is not as long as its grid asks for.
    #[error("expected {expected} {what}, got {found}")]
    Values {
        /// Name of the values.
        what: &'static str,
        /// Number that fits the grid.
        expected: usize,
        /// Number given.
        found: usize,
    },
    /// A grid does not fit the format to be written.
    #[error("expected {expected} for a {format} file, got {} × {} × {}", size[0], size[1], size[2])]
    Write {
        /// Name of the format.
        format: &'static str,
        /// Sizes that can be written.
        expected: &'static str,
        /// Number of cells along x, y, z.
        size: [usize; 3],
    },
}

impl ImageError {
    /// A fault in the bytes of a format.
    pub(super) fn corrupt(format: &'static str, fault: impl ToString) -> Self {
        Self::Corrupt { format, fault: fault.to_string() }
    }
}
