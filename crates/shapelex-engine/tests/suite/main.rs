//! All integration tests of the engine, one binary.
#![allow(clippy::unwrap_used, missing_docs)]

#[cfg(feature = "s3")]
mod buckets;
#[cfg(feature = "cluster")]
mod cluster;
mod cohorts;
mod damage;
mod dictionaries;
mod lines;
mod passes;
mod program;
mod readers;
mod regressions;
mod source;
mod stores;
mod support;
