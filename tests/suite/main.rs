//! All integration tests, one binary.
#![allow(clippy::unwrap_used, clippy::print_stdout, missing_docs)]

mod analysis_laws;
mod analysis_vectors;
mod curves;
mod fits;
mod generators;
mod guards;
mod http_bad_input;
mod http_contract;
mod http_curves;
mod interpolators;
mod kill;
mod measures;
mod refinement;
mod server;
mod spaces;
mod sparse;
mod vectors;
