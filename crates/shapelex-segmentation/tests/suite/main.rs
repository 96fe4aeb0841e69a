//! Tests of the segmentation crate.

mod fields;
mod vectors;
