//! Images, volumes, label images and masks.
//!
//! * [`read`], [`read_labels`] and [`describe`] take a file of any format in [`FORMATS`];
//! * [`write`](mod@write) makes PNG and NIfTI-1 files;
//! * [`mask`] converts between images and runs of masks.
//!
//! Values are whole numbers as stored (0 to 255 for 8 bits, not 0 to 1), after slope and intercept of NIfTI. Colours become
//! luma, `0.2126 R + 0.7152 G + 0.0722 B` (ITU-R BT.709) of the stored numbers; alpha is left out.
//!
//! Positions are in the axes of the file: those of NIfTI point to the right, the front and the head of the patient, those of DICOM to
//! the left, the back and the head, those of NRRD as its field `space` says.
//!
//! # Values
//! Images have values of single precision, the type that segmentation computes with: integers of 8 and 16 bits and
//! floating-point numbers of 32 bits are exact, others are rounded once, after slope and intercept in double precision. Labels
//! are 32-bit integers that never pass through a floating-point type unless the file itself stores one.

use std::collections::BTreeMap;

mod error;
mod file;
mod format;
mod grid;
mod limits;
pub mod mask;
mod nifti;
mod nrrd;
mod png;
#[cfg(feature = "dicom")]
mod segmentation;
mod stream;
#[cfg(feature = "microscopy")]
mod tiff;
mod value;
pub mod write;

pub use error::ImageError;
pub use file::{Description, ImageFile};
pub use format::{FORMATS, Format, GiveLabels, LABEL_OPTIONS, LabelNames, LabelPart, detect};
pub use grid::{Grid, LengthUnit};
pub use limits::Limits;
pub use value::ValueType;

/// The image in a file.
///
/// # Errors
/// All of [`ImageError`] that concern reading. Limits are checked before memory is taken.
pub fn read(bytes: &[u8], limits: &Limits) -> Result<ImageFile, ImageError> {
    (detect(bytes)?.image)(bytes, limits)
}

/// The labels in a file: whole numbers from 0 to 2³² − 1, exactly as stored.
///
/// # Errors
/// As [`read`]; [`ImageError::Label`] and [`ImageError::Colour`] with the first cell that holds no label.
pub fn read_labels(bytes: &[u8], limits: &Limits) -> Result<ImageFile<u32>, ImageError> {
    (detect(bytes)?.labels)(bytes, limits)
}

/// Names of the labels in a file, where it has some.
///
/// # Errors
/// As [`read`].
pub fn label_names(bytes: &[u8], limits: &Limits) -> Result<BTreeMap<u32, String>, ImageError> {
    Ok(detect(bytes)?.label_names(bytes, limits)?.of)
}

/// Size, type and memory of a file, from its header; nothing is decoded.
///
/// `bytes` may be the start of a file: 4 KiB are enough for PNG, NIfTI and most of NRRD. TIFF and DICOM need all bytes, because their
/// directories and elements may be anywhere.
///
/// # Errors
/// Those of the header, and sizes beyond the limits.
pub fn describe(bytes: &[u8], limits: &Limits) -> Result<Description, ImageError> {
    (detect(bytes)?.describe)(bytes, limits)
}
