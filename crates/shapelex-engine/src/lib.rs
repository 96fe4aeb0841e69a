//! Cohorts beyond one machine's memory: revisions as Parquet on an object store, and passes over them on Apache DataFusion.
//!
//! ```text
//! parts of 8192 shapes ──► a sum for each ──► sums of 64 parts ──► sums of 64 groups ──► … ──► one sum
//! ```
//!
//! Every result has the bits that `shapelex-analysis` computes directly from the same shapes, on any number of threads and with
//! any division of the work: see [`pass`].
//!
//! * [`objects`] — reading and writing objects, with checks of length and content;
//! * [`cohort`] — a revision as content-addressed parts and a manifest; its checks and the collection of garbage;
//! * [`ingest`] — shapes as lines of JSON, as the service lists them;
//! * [`pass`] — a revision as a source of shapes, whose sums run on DataFusion;
//! * [`dictionary`] — dictionaries learnt from a revision, and used in passes over it;
//! * [`named`] — dictionaries in use, by the digests of their contents;
//! * [`regression`] — regression of a revision on an attribute;
//! * [`statistics`] — mean and principal components of a revision;
//! * [`estimate`] — predicted cost;
//! * [`location`] — where objects are;
//! * `nearest` — approximate search by an index, with the feature `approximate`;
//! * `cluster` — passes on many machines, with the feature of this name.

#[cfg(feature = "cluster")]
pub mod cluster;
pub mod cohort;
pub mod dictionary;
pub mod error;
pub mod estimate;
pub mod ingest;
pub mod location;
pub mod named;
#[cfg(feature = "approximate")]
pub mod nearest;
pub mod objects;
pub mod pass;
pub mod regression;
pub mod statistics;

pub use error::EngineError;
