//! The audit trail: every request, one entry each, chained by digests.
//!
//! * [`trail`] — entries in order, written in groups;
//! * [`refusals`] — requests without a valid credential, counted by address and minute.

pub mod refusals;
pub mod trail;
