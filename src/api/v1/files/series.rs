//! The images of a series that a structure set refers to, as the document of a form.

use utoipa::ToSchema;

use crate::api::respond::Binary;
use crate::service::app::ServiceError;
use crate::wire::checked::{Many, document, take_many};
use crate::wire::dicom::SeriesImage;

document! {
    /// Images that a file which is written refers to.
    #[schema(example = json!({"series": [{
        "class": "1.2.840.10008.5.1.4.1.1.2", "instance": "1.2.3.1", "series": "1.2.3", "frame_of_reference": "1.2.4",
        "position": [-250.0, -250.0, 12.5], "orientation": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0], "study": {"instance": "1.2"}
    }]}))]
    pub(in crate::api::v1) struct SeriesRequest {
        /// Images of one DICOM series.
        #[schema(value_type = Vec<SeriesImageDocument>)]
        series: Many<SeriesImage>, required;
    }
}

impl SeriesRequest {
    /// The images.
    ///
    /// # Errors
    /// All faults of the document.
    pub(in crate::api::v1) fn images(self) -> Result<Vec<SeriesImage>, ServiceError> {
        let mut errors = self.faults;
        let images = take_many(self.series, "/series", &mut errors);
        ServiceError::unless_empty(errors)?;
        Ok(images.unwrap_or_default())
    }
}

/// Form with a file of shapes and the series that its translation refers to.
#[derive(Debug, ToSchema)]
#[allow(dead_code, reason = "only for the document")]
pub(in crate::api::v1) struct ConvertForm {
    /// Images that the translation refers to; the first part.
    parameters: SeriesRequest,
    /// File of shapes.
    file: Binary,
}

/// An image of a series, as far as a structure set that refers to it must know it.
#[derive(Debug, ToSchema)]
#[allow(dead_code, reason = "only for the document")]
pub(in crate::api::v1) struct SeriesImageDocument {
    /// SOP Class UID (0008,0016).
    class: String,
    /// SOP Instance UID (0008,0018).
    instance: String,
    /// Series Instance UID (0020,000E): the same of all images.
    series: String,
    /// Frame of Reference UID (0020,0052): the same of all images.
    frame_of_reference: String,
    /// Image Position (Patient) (0020,0032): centre of the first pixel, in mm.
    position: [f64; 3],
    /// Image Orientation (Patient) (0020,0037): directions of a row and of a column.
    orientation: [f64; 6],
    /// The study, of which only `instance` is needed.
    study: SeriesStudyDocument,
    /// The patient. Default: elements without values. Nothing of it is kept or logged.
    #[schema(required = false)]
    patient: SeriesPatientDocument,
}

/// The study of a series.
#[derive(Debug, ToSchema)]
#[allow(dead_code, reason = "only for the document")]
pub(in crate::api::v1) struct SeriesStudyDocument {
    /// Study Instance UID (0020,000D).
    instance: String,
    /// Study ID (0020,0010).
    #[schema(required = false)]
    id: String,
    /// Study Date (0008,0020).
    #[schema(required = false)]
    date: String,
    /// Study Time (0008,0030).
    #[schema(required = false)]
    time: String,
    /// Accession Number (0008,0050).
    #[schema(required = false)]
    accession_number: String,
    /// Referring Physician's Name (0008,0090).
    #[schema(required = false)]
    referring_physician: String,
}

/// The patient of a series.
#[derive(Debug, ToSchema)]
#[allow(dead_code, reason = "only for the document")]
pub(in crate::api::v1) struct SeriesPatientDocument {
    /// Patient's Name (0010,0010).
    #[schema(required = false)]
    name: String,
    /// Patient ID (0010,0020).
    #[schema(required = false)]
    id: String,
    /// Patient's Birth Date (0010,0030).
    #[schema(required = false)]
    birth_date: String,
    /// Patient's Sex (0010,0040).
    #[schema(required = false)]
    sex: String,
}
