//! Tests of the segmentation crate.

mod boundaries;
mod contours_planar;
mod contours_solid;
mod contours_stored;
mod detector;
mod energies;
mod fields;
mod floors;
mod methods;
mod phantoms;
mod runs;
mod tasks;
mod vectors;
