//! All integration tests of the crate, one binary.
#![allow(clippy::unwrap_used, missing_docs)]

mod data;
mod files;
mod landmarks;
mod meshes;
mod microscopy;
mod nifti;
mod png;
mod tiff;
mod written;
