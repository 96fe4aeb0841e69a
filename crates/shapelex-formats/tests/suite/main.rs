//! All integration tests of the crate, one binary.
#![allow(clippy::unwrap_used, missing_docs)]
#![cfg_attr(
    not(all(feature = "dicom", feature = "microscopy")),
    allow(dead_code, reason = "what tests of families share")
)]

#[cfg(feature = "default")]
mod broken;
mod cost;
mod data;
#[cfg(feature = "dicom")]
mod dicom;
mod files;
// The table is of all families.
#[cfg(feature = "default")]
mod kept;
#[cfg(feature = "morphometrics")]
mod landmarks;
#[cfg(feature = "meshes")]
mod meshes;
#[cfg(feature = "microscopy")]
mod microscopy;
mod nifti;
mod nrrd;
mod png;
// The pages are of all families.
#[cfg(feature = "default")]
mod registry;
#[cfg(feature = "dicom")]
mod rtstruct;
#[cfg(feature = "dicom")]
mod segmentation;
#[cfg(feature = "microscopy")]
mod tiff;
// As `registry`.
#[cfg(feature = "default")]
mod whole;
mod written;
