//! All integration tests, one binary.
#![allow(clippy::unwrap_used, clippy::print_stdout, missing_docs)]

mod analysis_laws;
mod analysis_vectors;
mod curves;
mod dictionaries;
mod fits;
mod generators;
mod guards;
mod http_bad_input;
mod http_classes;
mod http_comparisons;
mod http_contract;
mod http_curves;
mod http_dictionaries;
mod http_jobs;
mod http_retrieval;
mod interpolators;
mod kill;
mod kill_dictionaries;
mod measures;
mod refinement;
mod retrieval_laws;
mod server;
mod spaces;
mod sparse;
mod sparse_blocks;
mod vectors;
mod worker;
