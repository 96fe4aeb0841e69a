//! Audit trail: one entry per request, chained by digests.
//!
//! * [`trail`] — entries in order, written in groups;
//! * [`refusals`] — requests without a valid credential, counted by address and minute.

pub mod refusals;
pub mod trail;
