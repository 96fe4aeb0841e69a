//! Reads the facts that a structure set needs of the images that it refers to.

use dicom_dictionary_std::tags;

use super::content::Content;
use super::values::Node;
use crate::error::FileError;
use crate::series::{Patient, SeriesImage, Study};

/// Deepest nesting of sequences in the header of an image.
const DEPTH: usize = 64;

/// Reads the header of an image of a series. The pixels are not looked at, and may be missing.
///
/// # Errors
/// Bytes that are not DICOM, and an image without its identifiers, its frame of reference, its position or its orientation.
pub fn series(bytes: &[u8]) -> Result<SeriesImage, FileError> {
    let content = Content::new(bytes, bytes.len() as u64, |_| Ok(()))?;
    let file = content.parse_header(DEPTH)?;
    let root = file.root();
    let optional = |tag| root.text(tag).map(Option::unwrap_or_default);
    Ok(SeriesImage {
        class: root.required_text(tags::SOP_CLASS_UID, "the class of an image")?,
        instance: root.required_text(tags::SOP_INSTANCE_UID, "the identifier of an image")?,
        series: root.required_text(tags::SERIES_INSTANCE_UID, "the identifier of a series")?,
        frame_of_reference: root.required_text(tags::FRAME_OF_REFERENCE_UID, "a frame of reference")?,
        position: vector(&root, tags::IMAGE_POSITION_PATIENT, "the position of an image")?,
        orientation: orientation(&root)?,
        study: Study {
            instance: root.required_text(tags::STUDY_INSTANCE_UID, "the identifier of a study")?,
            id: optional(tags::STUDY_ID)?,
            date: optional(tags::STUDY_DATE)?,
            time: optional(tags::STUDY_TIME)?,
            accession_number: optional(tags::ACCESSION_NUMBER)?,
            referring_physician: optional(tags::REFERRING_PHYSICIAN_NAME)?,
        },
        patient: Patient {
            name: optional(tags::PATIENT_NAME)?,
            id: optional(tags::PATIENT_ID)?,
            birth_date: optional(tags::PATIENT_BIRTH_DATE)?,
            sex: optional(tags::PATIENT_SEX)?,
        },
    })
}

fn vector<const N: usize>(root: &Node<'_>, tag: dicom_core::Tag, what: &str) -> Result<[f64; N], FileError> {
    root.array(tag)?.ok_or_else(|| root.malformed(tag, format!("expected {what}, got none")))
}

fn orientation(root: &Node<'_>) -> Result<[f64; 6], FileError> {
    let tag = tags::IMAGE_ORIENTATION_PATIENT;
    let directions = vector(root, tag, "the orientation of an image")?;
    check_orientation(&directions).map_err(|detail| root.malformed(tag, detail))?;
    Ok(directions)
}

/// Largest deviation of the directions of an image from unit length and from a right angle. Headers have six digits or more.
const ORTHONORMAL: f64 = 1e-3;

/// Two directions of length 1 at a right angle.
pub(crate) fn check_orientation(directions: &[f64; 6]) -> Result<(), String> {
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
    let (row, column) = directions.split_at(3);
    let products = [dot(row, row) - 1.0, dot(column, column) - 1.0, dot(row, column)];
    if products.iter().all(|x| x.abs() <= ORTHONORMAL) {
        Ok(())
    } else {
        Err(format!("expected two directions of length 1 at a right angle, got {directions:?}"))
    }
}
