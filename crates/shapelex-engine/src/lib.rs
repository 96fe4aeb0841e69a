//! Cohorts beyond one machine's memory: revisions as Parquet on an object store, and passes over them on Apache DataFusion.
//!
//! ```text
//! parts of 8192 shapes ──► a sum for each ──► sums of 64 parts ──► sums of 64 groups ──► … ──► one sum
//! ```
//!
//! Every result has the bits that `shapelex-analysis` computes directly from the same shapes, on any number of threads and with
//! any division of the work: see [`pass`]. The caller chooses the passes for a mean or a dictionary.
//!
//! * [`objects`] — reading and writing objects, with checks of length and content;
//! * [`cohort`] — a revision as content-addressed parts and a manifest; its checks and the collection of garbage;
//! * [`ingest`] — shapes as lines of JSON, as the service lists them;
//! * [`pass`] — sums, codes and certificates of a revision, which run on DataFusion;
//! * [`dictionary`] — dictionaries that passes use;
//! * [`location`] — where objects are;
//! * `cluster` — passes on many machines, with the feature of this name.

#[cfg(feature = "cluster")]
pub mod cluster;
pub mod cohort;
pub mod dictionary;
pub mod error;
pub mod ingest;
pub mod location;
pub mod objects;
pub mod pass;

pub use error::EngineError;
