//! All integration tests of the crate, one binary.
#![allow(clippy::unwrap_used, clippy::print_stdout, missing_docs)]

mod degenerate;
mod dictionaries;
mod elastic;
mod elastic_mean;
mod groupwise;
mod laws;
mod mixed;
mod models;
mod motions;
#[path = "../nulls/mod.rs"]
mod null_cases;
mod nulls;
mod outliers;
mod pairs;
mod parts;
mod pipeline;
mod repeatability;
mod retrieval;
mod robust;
mod sliding;
mod sliding_along;
mod sparse;
mod sparse_blocks;
mod streamed_models;
mod studies;
mod subdivision;
mod symmetry;
mod thin_plate;
mod two_blocks;
mod vectors;
