//! What the product does: one function per use case, values in, values or a [`ServiceError`] out.
//!
//! A folder uses only those before it:
//!
//! * [`app`] — what all use cases share: context, limits, threads, cache, errors;
//! * [`audit`], [`jobs`] — the audit trail; work that outlives its request;
//! * [`shapes`] — shapes of a request: read, evaluate, measure, fit, deform, morph;
//! * [`statistics`] — projections, means, alignments and components of posted shapes;
//! * [`cost`] — predictions of what requests and jobs take;
//! * [`cohorts`] — stored shapes; [`access`] — who asks;
//! * [`search`] — distances and neighbours;
//! * [`dictionaries`] — dictionaries and classifiers; [`inference`] — hypothesis tests;
//! * [`dispatch`] — what each kind of job does.

pub mod access;
pub mod app;
pub mod audit;
pub mod cohorts;
pub mod cost;
pub mod dictionaries;
pub mod dispatch;
pub mod inference;
pub mod jobs;
pub mod search;
pub mod shapes;
pub mod statistics;

pub use app::{App, Limits, ServiceError};
