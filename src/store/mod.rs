//! Cohorts, shapes, jobs and dictionaries in SQLite or PostgreSQL.
//!
//! ```text
//! cohort ─< chunk ── chunk_data     up to 4096 shapes: points (little-endian f64), weights, checksum
//!              └──< shape           what is known about each, and when it was deleted
//! job ── job_output                   the queue, the history of what is finished, and what came out
//!  └── pass ─< task                  what a job has cut into parts, and the parts
//! dictionary ── dictionary_data     versions that are written once
//! ```
//!
//! A chunk carries the revision of its cohort that brought it, a shape the revision that removed it;
//! the set at revision `r` is therefore fixed for ever:
//! `chunk.revision ≤ r and not (deleted_revision ≤ r)`.
//!
//! A [`Store`] shows what one [`Principal`](crate::domain::access::Principal) may see: the things of its tenant, and of these the cohorts that are open to it.
//!
//! SQLite: one connection writes, in short transactions; four read; the folder belongs to one process. PostgreSQL: any
//! number of processes; writers of one cohort wait for each other, all others do not. The SQL is the same (`engine`).
//! Parts: [`cohorts`], [`upload`] (storing shapes), [`shapes`] (finding, listing, deleting), [`scan`] (reading control points
//! in bulk), [`changes`] (the feed), [`receipts`] (what was done once), `trash`, [`jobs`] (the queue), [`outputs`] (what jobs bring about),
//! [`passes`] (parts of jobs), [`dictionaries`], [`audit`] (who asked for what), [`metrics`] (what is counted), [`maintenance`] (checks, backups, exports of all of it); `blob` turns numbers into bytes and back; `sqlite`, `postgres` (connections, checks, schema), `replica` (which processes live), `clock` (what was believed of it).

pub mod audit;
mod blob;
pub mod changes;
mod clock;
pub mod cohorts;
pub mod dictionaries;
mod engine;
mod error;
mod filter;
mod folder;
mod handle;
pub mod jobs;
pub mod keys;
pub mod maintenance;
mod mark;
mod measure;
pub mod metrics;
pub mod outputs;
pub mod passes;
mod postgres;
pub mod receipts;
mod replica;
pub mod scan;
pub mod shapes;
mod sqlite;
mod text;
mod trash;
pub mod upload;

pub use audit::AuditCheck;
pub use clock::ClockNotes;
pub use dictionaries::DictionaryFilter;
pub use error::StoreError;
pub use filter::Revisions;
pub use handle::Store;
pub use jobs::{Claim, Claimed, Release};
pub use measure::Measures;
pub use passes::{PartClaim, PartEnd, PassOf, Start};
pub use scan::{Ids, ScanBatch};
pub use shapes::{Cursor, CursorError, ShapePage};
pub use upload::{Added, Upload};

#[cfg(test)]
mod tests;
