//! All integration tests of the crate, one binary.
#![allow(clippy::unwrap_used, missing_docs)]

mod cost;
mod data;
mod dicom;
mod files;
mod landmarks;
mod meshes;
mod microscopy;
mod nifti;
mod nrrd;
mod png;
mod registry;
mod rtstruct;
mod segmentation;
mod tiff;
mod written;
