//! All integration tests of the crate, one binary.
#![allow(clippy::unwrap_used, clippy::print_stdout, missing_docs)]

mod curves;
mod endless;
mod fits;
mod generators;
mod interpolators;
mod masks;
mod measures;
mod open_meshes;
mod refinement;
mod resolution;
mod sheet_sizes;
mod sizes;
mod spaces;
mod subdivision;
mod surfaces;
mod vectors;
