//! What a structure set says of the images that it refers to.

use dicom_dictionary_std::tags;
use serde::{Deserialize, Serialize};

use super::content::Content;
use super::values::Node;
use crate::shape::FileError;

/// Deepest nesting of sequences in the header of an image.
const DEPTH: usize = 64;

/// An image of a series, as far as a structure set that refers to it must know it. It holds identifying data of the patient.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SeriesImage {
    /// SOP Class UID (0008,0016).
    pub class: String,
    /// SOP Instance UID (0008,0018).
    pub instance: String,
    /// Series Instance UID (0020,000E).
    pub series: String,
    /// Frame of Reference UID (0020,0052).
    pub frame_of_reference: String,
    /// Image Position (Patient) (0020,0032): centre of the first pixel, in mm.
    pub position: [f64; 3],
    /// Image Orientation (Patient) (0020,0037): directions of a row and of a column.
    pub orientation: [f64; 6],
    /// The study.
    pub study: Study,
    /// The patient.
    pub patient: Patient,
}

/// The study of a series, which its structure sets belong to.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Study {
    /// Study Instance UID (0020,000D).
    pub instance: String,
    /// Study ID (0020,0010).
    pub id: String,
    /// Study Date (0008,0020).
    pub date: String,
    /// Study Time (0008,0030).
    pub time: String,
    /// Accession Number (0008,0050).
    pub accession_number: String,
    /// Referring Physician's Name (0008,0090).
    pub referring_physician: String,
}

/// The patient of a series.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Patient {
    /// Patient's Name (0010,0010).
    pub name: String,
    /// Patient ID (0010,0020).
    pub id: String,
    /// Patient's Birth Date (0010,0030).
    pub birth_date: String,
    /// Patient's Sex (0010,0040).
    pub sex: String,
}

impl SeriesImage {
    /// Unit normal of the image.
    pub(crate) fn normal(&self) -> [f64; 3] {
        let [a, b, c, d, e, f] = self.orientation;
        [b * f - c * e, c * d - a * f, a * e - b * d]
    }
}

/// Reads the header of an image of a series. The pixels are not looked at, and may be missing.
///
/// # Errors
/// What is no DICOM, and an image without its identifiers, its frame of reference, its position or its orientation.
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
