//! The header of NIfTI-1: size, type, scale and affine map.

use super::super::grid::{check_spacing, cross};
use super::NAME;
use crate::image::error::ImageError;
use crate::image::limits::Limits;
use crate::image::value::{Numbers, ValueType};
use crate::image::{Grid, LengthUnit};

/// Number of bytes of a header.
pub(super) const HEADER_BYTES: usize = 348;

/// Position of the voxels where the header has none: header and four bytes that announce extensions.
const FIRST_VOXEL: u64 = 352;

/// Largest excess of `b² + c² + d²` over 1 that counts as rounding. Three 32-bit squares are rounded by 2e-7; the rest is for
/// programs that normalise in single precision.
const QUATERNION_ROUNDING: f64 = 1e-5;

/// Below this, `1 − b² − c² − d²` is rounding: the rotation is by 180°, `a = 0`, and `b, c, d` are normalised. The value is that of
/// the reference implementation, `nifti_quatern_to_mat44` in nifti1_io.c.
const HALF_TURN: f64 = 1e-7;

/// Types of values that are not read.
const OTHER_TYPES: [(i16, &str); 6] = [
    (32, "Complex64"),
    (128, "Rgb24"),
    (1536, "Float128"),
    (1792, "Complex128"),
    (2048, "Complex256"),
    (2304, "Rgba32"),
];

/// Used part of a header, checked.
pub(super) struct Header {
    pub(super) grid: Grid,
    pub(super) numbers: Numbers,
    /// Position of the first voxel.
    pub(super) offset: u64,
}

impl Header {
    /// Checks a header, and that its image is within the limits.
    pub(super) fn new(bytes: &[u8; HEADER_BYTES], limits: &Limits) -> Result<Self, ImageError> {
        check_variant(bytes)?;
        let raw = Fields::of(bytes);
        if raw.sizeof_hdr != HEADER_BYTES as i32 {
            return Err(unsupported("a header of 348 bytes (sizeof_hdr)", raw.sizeof_hdr));
        }
        let stored = value_type(&raw)?;
        let size = limits.size(size(&raw)?)?;
        let offset = offset(&raw)?;
        let voxels = size.iter().map(|size| *size as u128).product::<u128>() * stored.bytes() as u128;
        limits.bytes("NIfTI-1 header and voxels", u128::from(offset) + voxels)?;
        let unit = unit(&raw)?;
        let affine = affine(&raw)?.map(|row| row.map(|entry| unit.millimetres(entry)));
        let grid = Grid::new(size, affine, [unit; 3])?;
        let big_endian = raw.big_endian;
        Ok(Self { grid, numbers: Numbers { stored, big_endian, scale: scale(&raw)? }, offset })
    }
}

/// The fields that are used, by their names and at their positions in nifti1.h.
struct Fields {
    big_endian: bool,
    sizeof_hdr: i32,
    dim: [i16; 8],
    datatype: i16,
    bitpix: i16,
    pixdim: [f32; 8],
    vox_offset: f32,
    scl_slope: f32,
    scl_inter: f32,
    xyzt_units: u8,
    qform_code: i16,
    sform_code: i16,
    /// `b, c, d`.
    quatern: [f32; 3],
    /// `x, y, z`.
    qoffset: [f32; 3],
    srow: [[f32; 4]; 3],
}

impl Fields {
    fn of(bytes: &[u8; HEADER_BYTES]) -> Self {
        // A number of axes above 7 tells the other order of bytes.
        let big_endian = u16::from_le_bytes([bytes[40], bytes[41]]) > 7;
        let part = |at: usize| [bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]];
        let short = |at: usize| {
            let part = [bytes[at], bytes[at + 1]];
            if big_endian { i16::from_be_bytes(part) } else { i16::from_le_bytes(part) }
        };
        let float =
            |at: usize| if big_endian { f32::from_be_bytes(part(at)) } else { f32::from_le_bytes(part(at)) };
        Self {
            big_endian,
            sizeof_hdr: if big_endian { i32::from_be_bytes(part(0)) } else { i32::from_le_bytes(part(0)) },
            dim: std::array::from_fn(|i| short(40 + 2 * i)),
            datatype: short(70),
            bitpix: short(72),
            pixdim: std::array::from_fn(|i| float(76 + 4 * i)),
            vox_offset: float(108),
            scl_slope: float(112),
            scl_inter: float(116),
            xyzt_units: bytes[123],
            qform_code: short(252),
            sform_code: short(254),
            quatern: std::array::from_fn(|i| float(256 + 4 * i)),
            qoffset: std::array::from_fn(|i| float(268 + 4 * i)),
            srow: std::array::from_fn(|row| std::array::from_fn(|i| float(280 + 16 * row + 4 * i))),
        }
    }
}

/// Refuses files that share the name but not the layout: NIfTI-2, and headers whose voxels are in another file.
fn check_variant(bytes: &[u8; HEADER_BYTES]) -> Result<(), ImageError> {
    let whole = "a NIfTI-1 header with its voxels in the same file (magic n+1)";
    match (&bytes[4..8], &bytes[344..348]) {
        (b"n+2\0" | b"ni2\0", _) => Err(unsupported(whole, "a NIfTI-2 header")),
        (_, b"n+1\0") => Ok(()),
        (_, b"ni1\0") => Err(unsupported(whole, "a header alone (magic ni1)")),
        _ => Err(unsupported(whole, "a file without its magic bytes")),
    }
}

fn unsupported(expected: &'static str, found: impl ToString) -> ImageError {
    ImageError::Unsupported { format: NAME, expected, found: found.to_string() }
}

fn value_type(raw: &Fields) -> Result<ValueType, ImageError> {
    let expected = "integers or floating-point numbers of 8 to 64 bits (datatype)";
    let stored = match raw.datatype {
        2 => ValueType::U8,
        4 => ValueType::I16,
        8 => ValueType::I32,
        16 => ValueType::F32,
        64 => ValueType::F64,
        256 => ValueType::I8,
        512 => ValueType::U16,
        768 => ValueType::U32,
        1024 => ValueType::I64,
        1280 => ValueType::U64,
        other => {
            let name = OTHER_TYPES.iter().find(|(code, _)| *code == other);
            let found = name.map_or_else(|| other.to_string(), |(_, name)| format!("{other} ({name})"));
            return Err(unsupported(expected, found));
        }
    };
    let bits = 8 * stored.bytes();
    if usize::try_from(raw.bitpix) == Ok(bits) {
        Ok(stored)
    } else {
        let fault = format!("expected bitpix {bits} for datatype {}, got {}", raw.datatype, raw.bitpix);
        Err(ImageError::corrupt(NAME, fault))
    }
}

/// Size along x, y, z, of 2 or 3 axes and any further ones of length 1.
fn size(raw: &Fields) -> Result<[u64; 3], ImageError> {
    let count = raw.dim[0];
    if !(2..=7).contains(&count) {
        return Err(unsupported("2 or 3 axes (dim[0])", count));
    }
    let lengths = &raw.dim[1..=count as usize];
    if let Some(axis) = lengths.iter().position(|length| *length < 0) {
        let fault = format!("expected 1 to 32767 cells (dim[{}]), got {}", axis + 1, lengths[axis]);
        return Err(ImageError::corrupt(NAME, fault));
    }
    if let Some(axis) = (3..lengths.len()).find(|axis| lengths[*axis] > 1) {
        let found = format!("{} along axis {}", lengths[axis], axis + 1);
        return Err(unsupported("one value along each axis after the third", found));
    }
    Ok(std::array::from_fn(|axis| lengths.get(axis).map_or(1, |length| length.unsigned_abs().into())))
}

fn offset(raw: &Fields) -> Result<u64, ImageError> {
    let offset = f64::from(raw.vox_offset);
    if offset == 0.0 {
        Ok(FIRST_VOXEL)
    } else if offset >= FIRST_VOXEL as f64 && offset.fract() == 0.0 && offset.is_finite() {
        Ok(offset as u64)
    } else {
        let fault =
            format!("expected voxels from a whole position of at least 352 on (vox_offset), got {offset}");
        Err(ImageError::corrupt(NAME, fault))
    }
}

/// Unit of lengths: the lowest three bits of the field.
fn unit(raw: &Fields) -> Result<LengthUnit, ImageError> {
    match raw.xyzt_units & 7 {
        0 => Ok(LengthUnit::Unknown),
        1 => Ok(LengthUnit::Metre),
        2 => Ok(LengthUnit::Millimetre),
        3 => Ok(LengthUnit::Micrometre),
        other => Err(unsupported(
            "lengths in metres, millimetres, micrometres or no unit (xyzt_units 0 to 3)",
            other,
        )),
    }
}

/// A slope of 0 means none. Some programs write no number where they have no slope.
fn scale(raw: &Fields) -> Result<Option<[f64; 2]>, ImageError> {
    let [slope, intercept] = [raw.scl_slope, raw.scl_inter].map(f64::from);
    if slope == 0.0 || slope.is_nan() || (slope, intercept) == (1.0, 0.0) {
        return Ok(None);
    }
    if slope.is_finite() && intercept.is_finite() {
        return Ok(Some([slope, intercept]));
    }
    let fault =
        format!("expected a finite slope and intercept (scl_slope, scl_inter), got {slope} and {intercept}");
    Err(ImageError::corrupt(NAME, fault))
}

/// Rows `[A | b]` in the unit of the file, by the methods of the standard in their order of precedence: sform (3), qform (2),
/// spacing alone (1).
fn affine(raw: &Fields) -> Result<[[f64; 4]; 3], ImageError> {
    let mut rows = if raw.sform_code > 0 {
        raw.srow.map(|row| row.map(f64::from))
    } else if raw.qform_code > 0 {
        qform(raw)?
    } else {
        let spacing = spacing(raw)?;
        std::array::from_fn(|r| std::array::from_fn(|c| if r == c { spacing[r] } else { 0.0 }))
    };
    if raw.dim[0] == 2 && rows.iter().all(|row| row[2] == 0.0) {
        set_normal(&mut rows);
    }
    Ok(rows)
}

/// A plane has no third column: the unit normal of the other two completes the map without changing the orientation.
fn set_normal(rows: &mut [[f64; 4]; 3]) {
    let normal = cross(rows.map(|row| row[0]), rows.map(|row| row[1]));
    let length = normal.iter().map(|x| x * x).sum::<f64>().sqrt();
    if length > 0.0 {
        for (row, entry) in rows.iter_mut().zip(normal) {
            row[2] = entry / length;
        }
    }
}

/// `pixdim[1..4]`, positive; 1 along the missing axis of a plane.
fn spacing(raw: &Fields) -> Result<[f64; 3], ImageError> {
    let mut spacing = [1, 2, 3].map(|axis| f64::from(raw.pixdim[axis]));
    if raw.dim[0] == 2 && spacing[2] == 0.0 {
        spacing[2] = 1.0;
    }
    for (axis, value) in ['x', 'y', 'z'].into_iter().zip(spacing) {
        check_spacing(axis, value)?;
    }
    Ok(spacing)
}

/// Method 2: `A = R diag(Δx, Δy, q Δz)`, `b` the position of the first voxel, `R` the rotation of the unit quaternion
/// `a + bi + cj + dk` with `a = √(1 − b² − c² − d²)`, `q = −1` if `pixdim[0]` is negative, else 1.
fn qform(raw: &Fields) -> Result<[[f64; 4]; 3], ImageError> {
    let [b, c, d] = raw.quatern.map(f64::from);
    let square = b * b + c * c + d * d;
    if !(square <= 1.0 + QUATERNION_ROUNDING) {
        let fault = format!("expected a quaternion with b² + c² + d² of at most 1, got {square}");
        return Err(ImageError::corrupt(NAME, fault));
    }
    let rest = 1.0 - square;
    let (scale, a) = if rest < HALF_TURN { (square.sqrt(), 0.0) } else { (1.0, rest.sqrt()) };
    let [b, c, d] = [b / scale, c / scale, d / scale];
    let rotation = [
        [a * a + b * b - c * c - d * d, 2.0 * (b * c - a * d), 2.0 * (b * d + a * c)],
        [2.0 * (b * c + a * d), a * a + c * c - b * b - d * d, 2.0 * (c * d - a * b)],
        [2.0 * (b * d - a * c), 2.0 * (c * d + a * b), a * a + d * d - b * b - c * c],
    ];
    let mut spacing = spacing(raw)?;
    if raw.pixdim[0] < 0.0 {
        spacing[2] = -spacing[2];
    }
    let first = raw.qoffset.map(f64::from);
    Ok(std::array::from_fn(|r| {
        std::array::from_fn(|c| if c < 3 { rotation[r][c] * spacing[c] } else { first[r] })
    }))
}
