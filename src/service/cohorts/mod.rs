//! Cohorts and their stored shapes.
//!
//! * [`catalogue`] — create, list, find and delete cohorts and shapes; [`trash`] — what can be restored; [`changes`] — the feed;
//! * [`upload`] — streams of shapes into a cohort; [`example`] — the example cohort of an empty store;
//! * [`source`] — the shapes of a cohort at one revision, as a source of statistics;
//! * [`attributes`] — labels of shapes by their names in requests;
//! * [`live_mean`] — the mean of a cohort at its present revision.

pub mod attributes;
pub mod catalogue;
pub mod changes;
pub mod example;
pub mod live_mean;
pub mod source;
pub mod trash;
pub mod upload;
