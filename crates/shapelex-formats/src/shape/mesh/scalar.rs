//! Numbers in binary and as text.

/// A type of numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    I64,
    U64,
    F32,
    F64,
}

impl Scalar {
    /// Number of bytes.
    pub(super) fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::I64 | Self::U64 | Self::F64 => 8,
        }
    }

    /// A number of [`size`](Self::size) bytes. Whole numbers beyond 2⁵³ are rounded.
    pub(super) fn decode(self, bytes: &[u8], big_endian: bool) -> f64 {
        macro_rules! value {
            ($type:ty) => {{
                let mut raw = [0; size_of::<$type>()];
                raw.copy_from_slice(bytes);
                if big_endian { <$type>::from_be_bytes(raw) } else { <$type>::from_le_bytes(raw) }
            }};
        }
        match self {
            Self::I8 => value!(i8).into(),
            Self::U8 => value!(u8).into(),
            Self::I16 => value!(i16).into(),
            Self::U16 => value!(u16).into(),
            Self::I32 => value!(i32).into(),
            Self::U32 => value!(u32).into(),
            Self::I64 => value!(i64) as f64,
            Self::U64 => value!(u64) as f64,
            Self::F32 => value!(f32).into(),
            Self::F64 => value!(f64),
        }
    }

    /// All whole numbers of this type in `bytes`.
    pub(super) fn decode_all(self, bytes: &[u8], big_endian: bool) -> Vec<f64> {
        bytes.chunks_exact(self.size()).map(|bytes| self.decode(bytes, big_endian)).collect()
    }
}

/// A number as an index, if it is one.
pub(super) fn index(value: f64) -> Option<u32> {
    // Checked to be a whole number in the range: the conversion is exact.
    (value >= 0.0 && value <= f64::from(u32::MAX) && value.fract() == 0.0).then_some(value as u32)
}

/// A number in single precision, unless it is too large for it.
pub(super) fn single(value: f64) -> Option<f32> {
    let rounded = value as f32;
    (rounded.is_finite() || !value.is_finite()).then_some(rounded)
}
