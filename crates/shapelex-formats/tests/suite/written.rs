//! What is written is read back.

use shapelex_formats::image::{Grid, ImageError, ImageFile, LengthUnit, Limits, read, read_labels, write};

const LIMITS: Limits = Limits { bytes: 1 << 20, cells: 1 << 16 };

fn plane() -> Grid {
    Grid::along_axes([5, 3, 1], [1.0; 3], [LengthUnit::Cell; 3]).unwrap()
}

/// A grid whose map has a negative determinant and entries of single precision.
fn volume() -> Grid {
    let affine = [[-0.75, 0.0, 0.25, 90.5], [0.0, 1.5, 0.0, -126.0], [0.25, 0.0, 2.0, -72.0]];
    Grid::new([2, 3, 4], affine, [LengthUnit::Millimetre; 3]).unwrap()
}

#[test]
fn png_files_come_back() {
    let bytes: Vec<u8> = (0..15).map(|cell| cell * 17).collect();
    let file = write::png_u8(&plane(), &bytes).unwrap();
    let labels = read_labels(&file, &LIMITS).unwrap();
    assert_eq!(
        (labels.grid, labels.values),
        (plane(), bytes.iter().map(|value| u32::from(*value)).collect())
    );
    let words: Vec<u16> = (0..15).map(|cell| 65_535 - 4000 * cell).collect();
    let file = write::png_u16(&plane(), &words).unwrap();
    assert_eq!(
        read(&file, &LIMITS).unwrap().values,
        words.iter().map(|value| f32::from(*value)).collect::<Vec<_>>()
    );
}

#[test]
fn nifti_files_come_back() {
    let bytes: Vec<u8> = (0..24).map(|cell| cell % 3).collect();
    let many: Vec<u16> = bytes.iter().map(|byte| 300 * u16::from(*byte)).collect();
    let file = write::nifti_u16(&volume(), &many).unwrap();
    let labels: Vec<u32> = many.iter().map(|label| u32::from(*label)).collect();
    assert_eq!(read_labels(&file, &LIMITS).unwrap().values, labels);
    let file = write::nifti_u8(&volume(), &bytes).unwrap();
    let expected =
        ImageFile { grid: volume(), values: bytes.iter().map(|value| u32::from(*value)).collect() };
    assert_eq!(read_labels(&file, &LIMITS), Ok(expected));
    assert!(volume().determinant() < 0.0);
    let values: Vec<f32> = (0..24).map(|cell| (cell as f32).sin() * 1e-20).collect();
    let file = write::nifti_f32(&volume(), &values).unwrap();
    assert_eq!(read(&file, &LIMITS), Ok(ImageFile { grid: volume(), values }));
}

#[test]
fn what_a_format_cannot_hold_is_refused() {
    let text = |result: Result<Vec<u8>, ImageError>| result.unwrap_err().to_string();
    assert_eq!(
        text(write::png_u8(&volume(), &[0; 24])),
        "expected one layer of at most 2147483647 × 2147483647 cells for a PNG file, got 2 × 3 × 4"
    );
    assert_eq!(text(write::png_u16(&plane(), &[0; 14])), "expected 15 values for the grid, got 14");
    assert_eq!(text(write::nifti_u8(&volume(), &[0; 25])), "expected 24 values for the grid, got 25");
    let mut values = [0.0; 24];
    values[7] = f32::NAN;
    assert_eq!(
        text(write::nifti_f32(&volume(), &values)),
        "expected a finite value in single precision, got NaN at cell 7"
    );
    let long = Grid::along_axes([40_000, 1, 1], [1.0; 3], [LengthUnit::Unknown; 3]).unwrap();
    assert_eq!(
        text(write::nifti_u8(&long, &[0; 40_000])),
        "expected at most 32767 cells along every axis for a NIfTI-1 file, got 40000 × 1 × 1"
    );
    let far = Grid::along_axes([1; 3], [1e-60; 3], [LengthUnit::Unknown; 3]).unwrap();
    assert_eq!(text(write::nifti_u8(&far, &[0])), "expected a positive, finite spacing along x, got 0");
}
