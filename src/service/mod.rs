//! Use cases of the product: one function each, with values as arguments and values or a [`ServiceError`] as result.
//!
//! Each folder uses only those listed before it:
//!
//! * [`app`] — shared by all use cases: context, limits, threads, cache, errors;
//! * [`audit`], [`jobs`] — the audit trail; work that outlives its request;
//! * [`shapes`] — shapes of a request: read, evaluate, measure, fit, deform, morph;
//! * [`statistics`] — projections, means, alignments and components of posted shapes; [`incomplete`] — of those that miss points;
//! * [`segmentation`] — images to shapes;
//! * [`cost`] — predicted cost of requests;
//! * [`cohorts`] — stored shapes; [`access`] — authentication of callers; [`events`] — changes, as a stream;
//! * [`files`] — files of other programs: read, described, translated;
//! * [`sliding`] — semilandmarks of posted and stored shapes that slide;
//! * [`correspondence`] — surfaces of a cohort in correspondence, as a new cohort;
//! * [`hooks`] — deliveries of changes to addresses of clients;
//! * [`search`] — distances and neighbours;
//! * [`dictionaries`] — dictionaries and classifiers; [`inference`] — hypothesis tests;
//! * [`tables`] — cohorts as tables;
//! * [`dispatch`] — the use case of each kind of job.

pub mod access;
pub mod app;
pub mod audit;
pub mod cohorts;
pub mod correspondence;
pub mod cost;
pub mod dictionaries;
pub mod dispatch;
pub mod events;
pub mod files;
pub mod hooks;
pub mod incomplete;
pub mod inference;
pub mod jobs;
pub mod search;
pub mod segmentation;
pub mod shapes;
pub mod sliding;
pub mod statistics;
pub mod tables;

pub use app::{App, Limits, ServiceError};
