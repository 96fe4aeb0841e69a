//! Cohorts, shapes, dictionaries, jobs and keys, and their storage in SQLite or PostgreSQL.
//!
//! * [`domain`] — records with an identity, and their invariants; no input or output;
//! * [`store`] — these records in a database; uses [`domain`], which does not use it (checked by a test of the program).
//!
//! The crate knows nothing of HTTP, callers' tokens, threads or jobs' work: a change there does not rebuild it. The feature `schema`
//! describes the records in OpenAPI documents.

pub mod domain;
pub mod store;
