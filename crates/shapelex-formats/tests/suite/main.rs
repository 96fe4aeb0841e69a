//! All integration tests of the crate, one binary.
#![allow(clippy::unwrap_used, missing_docs)]

mod data;
mod files;
mod nifti;
mod png;
mod registry;
mod tiff;
mod written;
