//! Masks and fields of values as PNG and NIfTI-1. Written cells are read back exactly.

use png::{BitDepth, ColorType, Encoder};

use super::error::ImageError;
use super::grid::Grid;
use super::limits::reserve;
use super::{nifti, png as format};

/// Largest number of cells along an axis of NIfTI-1, whose sizes are signed 16-bit integers.
const MOST_NIFTI: usize = i16::MAX as usize;

/// Largest width and height of PNG.
const MOST_PNG: usize = i32::MAX as usize;

/// Position of the voxels: a header of 348 bytes and four that announce no extensions.
const FIRST_VOXEL: usize = 352;

/// A picture with 8-bit grey values, x fastest. Positions are not kept: PNG has none.
///
/// # Errors
/// [`ImageError::Write`] of a volume, [`ImageError::Values`].
pub fn png_u8(grid: &Grid, values: &[u8]) -> Result<Vec<u8>, ImageError> {
    check_count(grid, values.len())?;
    png(grid, BitDepth::Eight, values)
}

/// A picture with 16-bit grey values, x fastest. Positions are not kept: PNG has none.
///
/// # Errors
/// [`ImageError::Write`] of a volume, [`ImageError::Values`].
pub fn png_u16(grid: &Grid, values: &[u16]) -> Result<Vec<u8>, ImageError> {
    check_count(grid, values.len())?;
    let mut bytes = reserve(2 * values.len())?;
    bytes.extend(values.iter().flat_map(|value| value.to_be_bytes()));
    png(grid, BitDepth::Sixteen, &bytes)
}

/// A volume of 8-bit integers, x fastest, with the affine map of the grid rounded to single precision.
///
/// # Errors
/// [`ImageError::Write`] of more than 32 767 cells along an axis, [`ImageError::Values`], and [`ImageError::Spacing`] or
/// [`ImageError::Affine`] of a map beyond single precision.
pub fn nifti_u8(grid: &Grid, values: &[u8]) -> Result<Vec<u8>, ImageError> {
    let mut file = nifti_file(grid, 2, values.len(), 1)?;
    file.extend_from_slice(values);
    Ok(file)
}

/// A volume of 16-bit integers, x fastest, with the affine map of the grid rounded to single precision.
///
/// # Errors
/// As [`nifti_u8`].
pub fn nifti_u16(grid: &Grid, values: &[u16]) -> Result<Vec<u8>, ImageError> {
    let mut file = nifti_file(grid, 512, values.len(), size_of::<u16>())?;
    file.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    Ok(file)
}

/// A volume of numbers of single precision, x fastest, with the affine map of the grid rounded to single precision.
///
/// # Errors
/// As [`nifti_u8`], and [`ImageError::NotFinite`].
pub fn nifti_f32(grid: &Grid, values: &[f32]) -> Result<Vec<u8>, ImageError> {
    if let Some(index) = values.iter().position(|value| !value.is_finite()) {
        return Err(ImageError::NotFinite { index, value: f64::from(values[index]) });
    }
    let mut file = nifti_file(grid, 16, values.len(), size_of::<f32>())?;
    file.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    Ok(file)
}

fn check_count(grid: &Grid, found: usize) -> Result<(), ImageError> {
    let expected = grid.cells();
    if found == expected {
        Ok(())
    } else {
        Err(ImageError::Values { what: "values for the grid", expected, found })
    }
}

fn png(grid: &Grid, depth: BitDepth, bytes: &[u8]) -> Result<Vec<u8>, ImageError> {
    let size = grid.size();
    if !grid.is_planar() || size.iter().any(|size| *size > MOST_PNG) {
        let expected = "one layer of at most 2147483647 × 2147483647 cells";
        return Err(ImageError::Write { format: format::NAME, expected, size });
    }
    let mut file = Vec::new();
    let mut encoder = Encoder::new(&mut file, size[0] as u32, size[1] as u32);
    encoder.set_color(ColorType::Grayscale);
    encoder.set_depth(depth);
    let fail = |error| ImageError::corrupt(format::NAME, error);
    let mut writer = encoder.write_header().map_err(fail)?;
    writer.write_image_data(bytes).map_err(fail)?;
    writer.finish().map_err(fail)?;
    Ok(file)
}

/// The bytes before the voxels, little-endian, with room for these.
fn nifti_file(grid: &Grid, datatype: i16, count: usize, width: usize) -> Result<Vec<u8>, ImageError> {
    check_count(grid, count)?;
    let size = grid.size();
    if size.iter().any(|size| *size > MOST_NIFTI) {
        let expected = "at most 32767 cells along every axis";
        return Err(ImageError::Write { format: nifti::NAME, expected, size });
    }
    let affine = grid.affine().map(|row| row.map(|entry| entry as f32));
    Grid::new(size, affine.map(|row| row.map(f64::from)), grid.units())?;
    let mut file = reserve(FIRST_VOXEL + count * width)?;
    file.resize(FIRST_VOXEL, 0);
    let mut put = |at: usize, bytes: &[u8]| file[at..at + bytes.len()].copy_from_slice(bytes);
    put(0, &348_i32.to_le_bytes());
    put(40, &3_i16.to_le_bytes());
    for (axis, size) in size.iter().enumerate() {
        put(42 + 2 * axis, &(*size as i16).to_le_bytes());
    }
    // Further axes have one value each.
    for axis in 3..7 {
        put(42 + 2 * axis, &1_i16.to_le_bytes());
    }
    put(70, &datatype.to_le_bytes());
    put(72, &(8 * width as i16).to_le_bytes());
    for (axis, spacing) in [1.0].into_iter().chain(grid.spacing()).enumerate() {
        put(76 + 4 * axis, &(spacing as f32).to_le_bytes());
    }
    put(108, &(FIRST_VOXEL as f32).to_le_bytes());
    put(112, &1_f32.to_le_bytes());
    // Millimetres.
    put(123, &[2]);
    // Method 3, positions aligned with another image.
    put(254, &2_i16.to_le_bytes());
    for (place, entry) in affine.iter().flatten().enumerate() {
        put(280 + 4 * place, &entry.to_le_bytes());
    }
    put(344, b"n+1\0");
    Ok(file)
}
