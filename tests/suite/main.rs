//! All integration tests, one binary.
#![allow(clippy::unwrap_used, clippy::print_stdout, missing_docs)]

mod analysis_laws;
mod analysis_vectors;
mod curves;
mod generators;
mod vectors;
