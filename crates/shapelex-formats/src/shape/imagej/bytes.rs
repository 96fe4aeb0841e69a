//! Big-endian numbers of a file at their offsets.

use crate::error::{FileError, Place};

/// Bytes of a whole file.
#[derive(Clone, Copy)]
pub(super) struct Bytes<'a>(pub(super) &'a [u8]);

impl<'a> Bytes<'a> {
    /// `count` bytes at an offset.
    pub(super) fn slice(self, at: usize, count: usize) -> Result<&'a [u8], FileError> {
        at.checked_add(count).and_then(|end| self.0.get(at..end)).ok_or_else(|| {
            let left = self.0.len().saturating_sub(at);
            let detail = format!("expected {count} bytes, got {left} up to the end of the file");
            FileError::truncated(Place::byte(at as u64), detail)
        })
    }

    fn array<const N: usize>(self, at: usize) -> Result<[u8; N], FileError> {
        let mut array = [0; N];
        array.copy_from_slice(self.slice(at, N)?);
        Ok(array)
    }

    pub(super) fn u8(self, at: usize) -> Result<u8, FileError> {
        self.array(at).map(|[byte]: [u8; 1]| byte)
    }

    pub(super) fn u16(self, at: usize) -> Result<u16, FileError> {
        self.array(at).map(u16::from_be_bytes)
    }

    /// A coordinate of the bounds: ImageJ takes numbers below −5000 for unsigned ones that wrapped around.
    pub(super) fn bound(self, at: usize) -> Result<f64, FileError> {
        let number = f64::from(self.array(at).map(i16::from_be_bytes)?);
        Ok(if number < -5000.0 { number + 65536.0 } else { number })
    }

    pub(super) fn i32(self, at: usize) -> Result<i32, FileError> {
        self.array(at).map(i32::from_be_bytes)
    }

    pub(super) fn u32(self, at: usize) -> Result<u32, FileError> {
        self.array(at).map(u32::from_be_bytes)
    }

    /// An offset or a count, which is not negative.
    pub(super) fn size(self, at: usize, what: &str) -> Result<usize, FileError> {
        let number = self.i32(at)?;
        usize::try_from(number).map_err(|_| {
            FileError::malformed(Place::byte(at as u64), format!("expected {what}, got {number}"))
        })
    }

    /// A finite number.
    pub(super) fn f32(self, at: usize) -> Result<f64, FileError> {
        let number = f64::from(self.array(at).map(f32::from_be_bytes)?);
        if number.is_finite() {
            return Ok(number);
        }
        let detail = format!("expected a finite coordinate, got {number}");
        Err(FileError::malformed(Place::byte(at as u64), detail))
    }

    /// Text of 16-bit units.
    pub(super) fn text(self, at: usize, count: usize) -> Result<String, FileError> {
        let bytes = self.slice(at, count.saturating_mul(2))?;
        let units: Vec<u16> =
            bytes.chunks_exact(2).map(|pair| u16::from_be_bytes([pair[0], pair[1]])).collect();
        String::from_utf16(&units).map_err(|_| {
            FileError::malformed(Place::byte(at as u64), "expected UTF-16 text, got other units")
        })
    }
}
