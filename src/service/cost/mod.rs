//! Predicted cost of requests, in seconds ([`requests`]). That of jobs is
//! [`analysis::estimate`](crate::analysis::estimate).

pub mod requests;
