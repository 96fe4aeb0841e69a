//! Numbers of files as values of images and as labels.

use super::error::ImageError;

/// Weights of red, green and blue in the luma of ITU-R BT.709. They sum to 1, so a grey pixel keeps its value.
pub(super) const LUMA: [f64; 3] = [0.2126, 0.7152, 0.0722];

/// The type of the numbers in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ValueType {
    /// 8 bits, unsigned.
    U8,
    /// 16 bits, unsigned.
    U16,
    /// 32 bits, unsigned.
    U32,
    /// 64 bits, unsigned.
    U64,
    /// 8 bits, signed.
    I8,
    /// 16 bits, signed.
    I16,
    /// 32 bits, signed.
    I32,
    /// 64 bits, signed.
    I64,
    /// Floating point of single precision.
    F32,
    /// Floating point of double precision.
    F64,
}

impl ValueType {
    /// Number of bytes of a number.
    pub fn bytes(self) -> usize {
        match self {
            Self::U8 | Self::I8 => 1,
            Self::U16 | Self::I16 => 2,
            Self::U32 | Self::I32 | Self::F32 => 4,
            Self::U64 | Self::I64 | Self::F64 => 8,
        }
    }
}

/// Target of the number of a cell: a value of an image, or a label.
pub(super) trait Target: Copy {
    /// From a whole number.
    fn integer(value: i64, cell: usize) -> Result<Self, ImageError>;
    /// From any number.
    fn real(value: f64, cell: usize) -> Result<Self, ImageError>;
    /// From red, green and blue.
    fn colour(rgb: [f64; 3], cell: usize) -> Result<Self, ImageError>;
}

/// The nearest number of single precision. Integers up to 2²⁴ are exact, and so is all that a 16-bit or 32-bit float file holds;
/// other sources are rounded by 6e-8 of the value, far below the noise of any image, which halves memory.
impl Target for f32 {
    fn integer(value: i64, _cell: usize) -> Result<Self, ImageError> {
        Ok(value as Self)
    }

    fn real(value: f64, index: usize) -> Result<Self, ImageError> {
        let nearest = value as Self;
        if nearest.is_finite() { Ok(nearest) } else { Err(ImageError::NotFinite { index, value }) }
    }

    fn colour(rgb: [f64; 3], cell: usize) -> Result<Self, ImageError> {
        Self::real((0..3).map(|c| LUMA[c] * rgb[c]).sum(), cell)
    }
}

/// The number itself: nothing is rounded.
impl Target for u32 {
    fn integer(value: i64, index: usize) -> Result<Self, ImageError> {
        Self::try_from(value).map_err(|_| ImageError::Label { index, value: value as f64 })
    }

    fn real(value: f64, index: usize) -> Result<Self, ImageError> {
        let label = value as Self;
        if f64::from(label) == value { Ok(label) } else { Err(ImageError::Label { index, value }) }
    }

    fn colour(rgb: [f64; 3], index: usize) -> Result<Self, ImageError> {
        if rgb[0] == rgb[1] && rgb[1] == rgb[2] {
            Self::real(rgb[0], index)
        } else {
            Err(ImageError::Colour { index, colour: rgb })
        }
    }
}

/// A number as it is in a file.
pub(super) trait Source: Copy {
    /// In double precision.
    fn to_f64(self) -> f64;
    /// As a value or label.
    fn to<T: Target>(self, cell: usize) -> Result<T, ImageError>;
}

macro_rules! integer_source {
    ($($type:ty)*) => {$(
        impl Source for $type {
            fn to_f64(self) -> f64 {
                self as f64
            }

            fn to<T: Target>(self, cell: usize) -> Result<T, ImageError> {
                T::integer(i64::from(self), cell)
            }
        }
    )*};
}

integer_source!(u8 u16 u32 i8 i16 i32 i64);

impl Source for u64 {
    fn to_f64(self) -> f64 {
        self as f64
    }

    fn to<T: Target>(self, cell: usize) -> Result<T, ImageError> {
        // Beyond the range of i64 there are no labels, and for images the nearest double will do.
        i64::try_from(self).map_or_else(|_| T::real(self as f64, cell), |value| T::integer(value, cell))
    }
}

impl Source for f32 {
    fn to_f64(self) -> f64 {
        f64::from(self)
    }

    fn to<T: Target>(self, cell: usize) -> Result<T, ImageError> {
        T::real(f64::from(self), cell)
    }
}

impl Source for f64 {
    fn to_f64(self) -> f64 {
        self
    }

    fn to<T: Target>(self, cell: usize) -> Result<T, ImageError> {
        T::real(self, cell)
    }
}

/// How the numbers of a file are stored one after the other.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Numbers {
    pub(super) stored: ValueType,
    pub(super) big_endian: bool,
    /// Slope and intercept, unless values are as stored.
    pub(super) scale: Option<[f64; 2]>,
}

impl Numbers {
    /// Appends the values of whole numbers.
    pub(super) fn decode<T: Target>(&self, block: &[u8], values: &mut Vec<T>) -> Result<(), ImageError> {
        macro_rules! decode {
            ($type:ty) => {
                self.append(block, values, <$type>::from_le_bytes, <$type>::from_be_bytes)
            };
        }
        match self.stored {
            ValueType::U8 => decode!(u8),
            ValueType::U16 => decode!(u16),
            ValueType::U32 => decode!(u32),
            ValueType::U64 => decode!(u64),
            ValueType::I8 => decode!(i8),
            ValueType::I16 => decode!(i16),
            ValueType::I32 => decode!(i32),
            ValueType::I64 => decode!(i64),
            ValueType::F32 => decode!(f32),
            ValueType::F64 => decode!(f64),
        }
    }

    /// `value = slope · stored + intercept`, where the file has a slope.
    fn append<S: Source, T: Target, const N: usize>(
        &self,
        block: &[u8],
        values: &mut Vec<T>,
        little: fn([u8; N]) -> S,
        big: fn([u8; N]) -> S,
    ) -> Result<(), ImageError> {
        let from_bytes = if self.big_endian { big } else { little };
        for bytes in block.as_chunks::<N>().0 {
            let (stored, cell) = (from_bytes(*bytes), values.len());
            values.push(match self.scale {
                None => stored.to(cell)?,
                Some([slope, intercept]) => T::real(slope * stored.to_f64() + intercept, cell)?,
            });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grey_pixels_keep_their_value() {
        assert_eq!(LUMA.iter().sum::<f64>(), 1.0);
        for grey in 0..=65535_u32 {
            assert_eq!(f32::colour([f64::from(grey); 3], 0), Ok(grey as f32), "{grey}");
        }
        // 0.2126 · 100 + 0.7152 · 50 + 0.0722 · 200 = 71.46, rounded to single precision
        assert_eq!(f32::colour([100.0, 50.0, 200.0], 0), Ok(71.46));
    }

    #[test]
    fn labels_are_exact() {
        for label in [0, 16_777_217, u32::MAX] {
            assert_eq!(u64::from(label).to::<u32>(0), Ok(label));
            assert_eq!(f64::from(label).to::<u32>(0), Ok(label));
        }
        for bad in [-1.0, 0.5, f64::NAN, f64::INFINITY, 4_294_967_296.0] {
            assert!(matches!(bad.to::<u32>(7), Err(ImageError::Label { index: 7, .. })), "{bad}");
        }
        assert_eq!((-3_i8).to::<u32>(5), Err(ImageError::Label { index: 5, value: -3.0 }));
        assert!(u64::MAX.to::<u32>(0).is_err());
        let coloured = u32::colour([255.0, 0.0, 0.0], 3).unwrap_err().to_string();
        assert_eq!(coloured, "expected a label, a grey pixel, got red 255, green 0, blue 0 at cell 3");
    }

    #[test]
    fn values_are_finite() {
        for bad in [f64::NAN, f64::INFINITY, 1e300] {
            assert!(matches!(bad.to::<f32>(9), Err(ImageError::NotFinite { index: 9, .. })), "{bad}");
        }
        assert_eq!(u64::MAX.to::<f32>(0), Ok(18_446_744_073_709_551_615.0));
        assert_eq!(0.1_f64.to::<f32>(0), Ok(0.1));
    }
}
