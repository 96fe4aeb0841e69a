//! Cohorts, shapes and jobs as things with an identity: names, invariants, no input or output.
//!
//! * [`access`] — who asks, and what they may; [`key`] — how programs show it;
//! * [`audit`] — what was asked of the service, and what came of it;
//! * [`cohort`] — a named set of shapes in one representation, with its revision;
//! * [`comparison`], [`regression`] — what tests of a cohort's shapes have found;
//! * [`dictionary`] — what is learnt from a cohort;
//! * [`shape`] — one member: control points and what is known about it;
//! * [`job`] — long work, its progress and its outcome;
//! * [`change`] — the feed of what has changed; [`retry`] — requests that may be sent again; [`trash`] — what can come back;
//! * [`id`] — prefixed, sortable, opaque identifiers.

pub mod access;
pub mod audit;
pub mod change;
pub mod classifier;
pub mod cohort;
pub mod comparison;
pub mod dictionary;
pub mod id;
pub mod job;
pub mod key;
pub mod regression;
pub mod retry;
pub mod shape;
pub mod trash;
