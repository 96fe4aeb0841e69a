//! All integration tests of the engine, one binary.
#![allow(clippy::unwrap_used, missing_docs)]

mod cohorts;
mod damage;
mod lines;
mod passes;
mod program;
mod readers;
mod stores;
mod support;
