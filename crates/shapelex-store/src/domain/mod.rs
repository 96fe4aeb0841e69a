//! Domain values with an identity (cohorts, shapes, dictionaries, jobs): names and invariants, no input or output.
//!
//! * [`access`] — callers and their permissions; [`key`] — API keys of programs;
//! * [`audit`] — requests to the service and their outcomes;
//! * [`cohort`] — a named set of shapes in one representation, with its revision;
//! * [`dictionary`] — statistics learnt from a cohort;
//! * [`shape`] — one member: control points and attributes; [`attribute`] — its attributes by name;
//!   [`filter`] — conditions on them;
//! * [`study`] — results of comparisons and regressions of a cohort's shapes;
//! * [`job`] — long work, its progress and its outcome;
//! * [`change`] — the change feed; [`hook`] — where it is delivered; [`retry`] — requests that may be repeated; [`trash`] — deleted objects that can be restored;
//!   [`erasure`] — which subjects were erased;
//! * [`id`] — prefixed, sortable, opaque identifiers.

pub mod access;
pub mod attribute;
pub mod audit;
pub mod change;
pub mod cohort;
pub mod dictionary;
pub mod erasure;
pub mod filter;
pub mod hook;
pub mod id;
pub mod job;
pub mod key;
pub mod retry;
pub mod shape;
pub mod study;
pub mod trash;
