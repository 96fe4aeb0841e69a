//! Cohorts and shapes as things with an identity: names, invariants, no input or output.
//!
//! * [`cohort`] — a named set of shapes in one representation, with its revision;
//! * [`shape`] — one member: control points and what is known about it;
//! * [`id`] — prefixed, sortable, opaque identifiers.

pub mod cohort;
pub mod id;
pub mod shape;
