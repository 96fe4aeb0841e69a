//! All integration tests, one binary.
#![allow(clippy::unwrap_used, clippy::print_stdout, missing_docs)]

mod commands;
mod document;
mod endless;
mod guards;
mod health;
mod http_access;
mod http_bad_input;
mod http_browsers;
mod http_classes;
mod http_comparisons;
mod http_contract;
mod http_curves;
mod http_dictionaries;
mod http_drawings;
mod http_input;
mod http_jobs;
mod http_language;
mod http_limits;
mod http_novelty;
mod http_operations;
mod http_retries;
mod http_retrieval;
mod http_same_bits;
mod http_spreading;
mod http_subdivision;
mod http_surfaces;
mod http_tokens;
mod kill;
mod kill_dictionaries;
mod memory;
mod misleading;
mod server;
mod structure;
mod worker;
