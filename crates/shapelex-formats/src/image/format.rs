//! The formats that are read.

use std::collections::BTreeMap;

use super::error::ImageError;
use super::file::{Description, ImageFile};
use super::limits::Limits;
#[cfg(feature = "dicom")]
use super::segmentation;
#[cfg(feature = "microscopy")]
use super::tiff;
use super::{nifti, nrrd, png};

/// Number of bytes that an error shows of an unknown file.
const SHOWN: usize = 8;

/// Fields of [`ReadOptions`](crate::shape::ReadOptions) that are obeyed where the boundaries of labels become records.
pub const LABEL_OPTIONS: [&str; 7] =
    ["holes", "select", "least_cells", "largest", "fill", "blur", "photograph"];

/// A format of image files.
#[derive(Debug, Clone, Copy)]
pub struct Format {
    /// Word in options and queries.
    pub id: &'static str,
    /// Name in messages.
    pub name: &'static str,
    /// Media types of requests and responses; the first one is written.
    pub media_types: &'static [&'static str],
    /// Endings of file names, lower case, without the first dot.
    pub extensions: &'static [&'static str],
    /// Positions and bytes, one of which is in every file of the format.
    pub magic: &'static [(usize, &'static [u8])],
    pub(super) describe: fn(&[u8], &Limits) -> Result<Description, ImageError>,
    pub(super) image: fn(&[u8], &Limits) -> Result<ImageFile, ImageError>,
    pub(super) labels: fn(&[u8], &Limits) -> Result<ImageFile<u32>, ImageError>,
    pub(super) names: Option<ReadNames>,
    pub(super) parts: Option<ReadParts>,
}

/// Reads the names of labels.
type ReadNames = fn(&[u8], &Limits) -> Result<LabelNames, ImageError>;
/// Reads the label images of a file whose labels may overlap.
type ReadParts = fn(&[u8], &Limits, &dyn Fn(u32) -> bool, GiveLabels<'_>) -> Result<(), ImageError>;

/// Takes a label image. Whether another one is wanted.
pub type GiveLabels<'a> = &'a mut dyn FnMut(LabelPart) -> bool;

/// A label image of a file that may have several.
#[derive(Debug, Clone, PartialEq)]
pub struct LabelPart {
    /// The image.
    pub image: ImageFile<u32>,
    /// Its only label; of all labels if absent.
    pub label: Option<u32>,
    /// Its first slice, among those of the file.
    pub first: usize,
}

impl LabelPart {
    /// The image of all labels.
    pub(super) fn whole(image: ImageFile<u32>) -> Self {
        Self { image, label: None, first: 0 }
    }
}

/// The names that a file gives to labels.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct LabelNames {
    /// Names by label.
    pub of: BTreeMap<u32, String>,
    /// Warnings about them.
    pub warnings: Vec<String>,
}

impl Format {
    /// The labels in a file of this format: [`read_labels`](super::read_labels).
    ///
    /// # Errors
    /// Those of [`read_labels`](super::read_labels).
    pub fn read_labels(&self, bytes: &[u8], limits: &Limits) -> Result<ImageFile<u32>, ImageError> {
        (self.labels)(bytes, limits)
    }

    /// The names of labels in a file of this format: [`label_names`](super::label_names).
    ///
    /// # Errors
    /// Those of [`label_names`](super::label_names).
    pub fn label_names(&self, bytes: &[u8], limits: &Limits) -> Result<LabelNames, ImageError> {
        self.names.map_or_else(|| Ok(LabelNames::default()), |names| names(bytes, limits))
    }

    /// Gives on the label images of a file of this format: one, or where labels overlap, one for each label that is `wanted`.
    ///
    /// # Errors
    /// Those of [`read_labels`](super::read_labels) but for the overlap.
    pub fn each_label_image(
        &self,
        bytes: &[u8],
        limits: &Limits,
        wanted: &dyn Fn(u32) -> bool,
        give: GiveLabels<'_>,
    ) -> Result<(), ImageError> {
        match self.parts {
            Some(parts) => parts(bytes, limits, wanted, give),
            None => {
                give(LabelPart::whole(self.read_labels(bytes, limits)?));
                Ok(())
            }
        }
    }
}

/// All formats. The magic bytes of NIfTI include those of its other variants, which its reader refuses by name.
pub static FORMATS: &[Format] = &[
    Format {
        id: "png",
        name: png::NAME,
        media_types: &["image/png"],
        extensions: &["png"],
        magic: &[(0, b"\x89PNG\r\n\x1a\n")],
        describe: png::describe,
        image: png::read,
        labels: png::read_labels,
        names: None,
        parts: None,
    },
    #[cfg(feature = "microscopy")]
    Format {
        id: "tiff",
        name: tiff::NAME,
        media_types: &["image/tiff"],
        extensions: &["tif", "tiff"],
        magic: &[(0, b"II*\0"), (0, b"MM\0*"), (0, b"II+\0"), (0, b"MM\0+")],
        describe: tiff::describe,
        image: tiff::read,
        labels: tiff::read,
        names: None,
        parts: None,
    },
    Format {
        id: "nii",
        name: nifti::NAME,
        media_types: &["application/x-nifti"],
        extensions: &["nii"],
        magic: &[(344, b"n+1\0"), (344, b"ni1\0"), (4, b"n+2\0"), (4, b"ni2\0")],
        describe: nifti::describe,
        image: nifti::read,
        labels: nifti::read,
        names: None,
        parts: None,
    },
    Format {
        id: "nii.gz",
        name: nifti::COMPRESSED,
        media_types: &["application/gzip", "application/x-nifti+gzip"],
        extensions: &["nii.gz"],
        magic: &[(0, b"\x1f\x8b")],
        describe: nifti::describe_compressed,
        image: nifti::read_compressed,
        labels: nifti::read_compressed,
        names: None,
        parts: None,
    },
    Format {
        id: "nrrd",
        name: nrrd::NAME,
        media_types: &["application/x-nrrd"],
        extensions: &["nrrd"],
        magic: &[(0, b"NRRD000")],
        describe: nrrd::describe,
        image: nrrd::read,
        labels: nrrd::read,
        names: Some(nrrd::names),
        parts: None,
    },
    #[cfg(feature = "dicom")]
    Format {
        id: "segmentation",
        name: segmentation::NAME,
        media_types: &["application/dicom"],
        extensions: &["dcm"],
        magic: &[(128, b"DICM")],
        describe: segmentation::describe,
        image: segmentation::read,
        labels: segmentation::read_labels,
        names: Some(segmentation::names),
        parts: Some(segmentation::read_parts),
    },
];

/// The format of a file by its first 348 bytes.
///
/// # Errors
/// [`ImageError::Format`], which lists the formats.
pub fn detect(bytes: &[u8]) -> Result<&'static Format, ImageError> {
    let has = |(at, magic): &(usize, &[u8])| bytes.get(*at..).is_some_and(|rest| rest.starts_with(magic));
    let unknown = || ImageError::Format { known: names(), found: first_bytes(bytes) };
    FORMATS.iter().find(|format| format.magic.iter().any(has)).ok_or_else(unknown)
}

/// The names of all formats.
fn names() -> String {
    FORMATS.iter().map(|format| format.name).collect::<Vec<_>>().join(", ")
}

fn first_bytes(bytes: &[u8]) -> String {
    if bytes.is_empty() {
        return "no bytes".into();
    }
    bytes.iter().take(SHOWN).map(|byte| format!("{byte:02x}")).collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[cfg(all(feature = "dicom", feature = "microscopy"))]
    #[test]
    fn formats_are_recognised() {
        let mut nifti = vec![0; 348];
        nifti[344..].copy_from_slice(b"n+1\0");
        let mut dicom = vec![0; 132];
        dicom[128..].copy_from_slice(b"DICM");
        let files: [(&[u8], &str); 6] = [
            (b"\x89PNG\r\n\x1a\n...", "PNG"),
            (b"MM\0*....", "TIFF"),
            (&nifti, "NIfTI-1"),
            (b"\x1f\x8b", "NIfTI-1 (gzip)"),
            (b"NRRD0004\n", "NRRD"),
            (&dicom, "DICOM Segmentation"),
        ];
        for (bytes, name) in files {
            assert_eq!(detect(bytes).map(|format| format.name), Ok(name));
        }
    }

    #[cfg(all(feature = "dicom", feature = "microscopy"))]
    #[test]
    fn an_unknown_file_gets_the_list_of_formats() {
        let expected = "expected a file of one of the formats PNG, TIFF, NIfTI-1, NIfTI-1 (gzip), NRRD, DICOM Segmentation, got one that begins with";
        assert_eq!(detect(b"GIF89a").unwrap_err().to_string(), format!("{expected} 47 49 46 38 39 61"));
        assert_eq!(detect(b"").unwrap_err().to_string(), format!("{expected} no bytes"));
    }
}
