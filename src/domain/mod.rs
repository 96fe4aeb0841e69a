//! Cohorts, shapes and jobs as things with an identity: names, invariants, no input or output.
//!
//! * [`cohort`] — a named set of shapes in one representation, with its revision;
//! * [`comparison`], [`regression`] — what tests of a cohort's shapes have found;
//! * [`dictionary`] — what is learnt from a cohort;
//! * [`shape`] — one member: control points and what is known about it;
//! * [`job`] — long work, its progress and its outcome;
//! * [`id`] — prefixed, sortable, opaque identifiers.

pub mod classifier;
pub mod cohort;
pub mod comparison;
pub mod dictionary;
pub mod id;
pub mod job;
pub mod regression;
pub mod shape;
