//! Tests of the segmentation crate.

mod boundaries;
mod detector;
mod energies;
mod fields;
mod floors;
mod phantoms;
mod runs;
mod vectors;
