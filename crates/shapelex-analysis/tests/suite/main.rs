//! All integration tests of the crate, one binary.
#![allow(clippy::unwrap_used, clippy::print_stdout, missing_docs)]

mod degenerate;
mod dictionaries;
mod groupwise;
mod laws;
mod models;
mod motions;
#[path = "../nulls/mod.rs"]
mod null_cases;
mod nulls;
mod outliers;
mod parts;
mod pipeline;
mod retrieval;
mod robust;
mod sparse;
mod sparse_blocks;
mod studies;
mod subdivision;
mod vectors;
