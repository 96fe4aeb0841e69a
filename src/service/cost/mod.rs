//! Predicted cost of requests, in seconds ([`requests`]), and of jobs, in multiply-adds and bytes ([`jobs`]).

pub mod jobs;
pub mod requests;
