//! Tests of the segmentation crate.

mod boundaries;
mod fields;
mod vectors;
