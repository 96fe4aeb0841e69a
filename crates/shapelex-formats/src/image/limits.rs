//! Bounds on the claims of a file, checked before memory is taken.

use super::error::ImageError;

/// Most that is read of one file.
///
/// Memory for values is at most `4 · cells` bytes. Beside it a decoder holds at most `3 · bytes` and 1 MiB: pixels as they are
/// in the file, and the rows of PNG or the lists of strips of TIFF that it works on. A DICOM file has at most 2²⁰ elements and items,
/// some 200 bytes each.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Number of bytes after decompression, headers and padding included.
    pub bytes: u64,
    /// Number of cells.
    pub cells: u64,
}

impl Limits {
    /// A size as numbers of this machine, if it is neither empty nor too large.
    pub(super) fn size(&self, size: [u64; 3]) -> Result<[usize; 3], ImageError> {
        if size.contains(&0) {
            return Err(ImageError::Empty { size });
        }
        let cells = size.iter().try_fold(1_u64, |count, size| count.checked_mul(*size));
        let fits = cells.is_some_and(|cells| cells <= self.cells && usize::try_from(cells).is_ok());
        // Every size is at most their product, which fits.
        if fits {
            Ok(size.map(|size| size as usize))
        } else {
            Err(ImageError::Cells { limit: self.cells, size })
        }
    }

    /// A number of bytes, if it is not too large.
    pub(super) fn bytes(&self, place: &'static str, found: u128) -> Result<u64, ImageError> {
        match u64::try_from(found) {
            Ok(bytes) if bytes <= self.bytes => Ok(bytes),
            _ => Err(ImageError::Bytes { place, limit: self.bytes, found }),
        }
    }
}

/// A vector with room for `count` values.
///
/// # Errors
/// [`ImageError::Memory`] where the system has none: the process goes on.
pub(super) fn reserve<T>(count: usize) -> Result<Vec<T>, ImageError> {
    let mut values = Vec::new();
    match values.try_reserve_exact(count) {
        Ok(()) => Ok(values),
        Err(_) => Err(ImageError::Memory { bytes: count as u64 * size_of::<T>() as u64 }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_bounded() {
        let limits = Limits { bytes: 100, cells: 24 };
        assert_eq!(limits.size([2, 3, 4]), Ok([2, 3, 4]));
        assert_eq!(limits.size([2, 0, 4]), Err(ImageError::Empty { size: [2, 0, 4] }));
        for size in [[5, 5, 1], [u64::MAX, u64::MAX, u64::MAX]] {
            assert_eq!(limits.size(size), Err(ImageError::Cells { limit: 24, size }));
        }
        assert_eq!(limits.bytes("voxels", 100), Ok(100));
        let message = limits.bytes("voxels", 1 << 70).unwrap_err().to_string();
        assert_eq!(message, "expected at most 100 bytes of voxels, got 1180591620717411303424");
        assert_eq!(reserve::<u64>(usize::MAX / 16), Err(ImageError::Memory { bytes: u64::MAX / 2 - 7 }));
    }
}
