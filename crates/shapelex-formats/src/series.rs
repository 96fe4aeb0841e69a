//! Headers of the images that a structure set refers to: options of writing, which are there without the family `dicom` too.

use serde::{Deserialize, Serialize};

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
