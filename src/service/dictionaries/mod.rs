//! Dictionaries: learning, storage and use.
//!
//! * [`planning`] — checks a request to learn and makes a [`plan`] of it; list, find and delete;
//! * [`learning`] — the job that learns; [`validation`] — validation of its classifier; [`distributed`] — its passes,
//!   distributed to idle workers;
//! * [`class_labels`] — classes and subjects of the shapes of a cohort;
//! * [`ready`] — stored dictionaries prepared for use, cached; [`file`](mod@file) — export and import;
//! * [`coding`] — codes, reconstructions, scores; [`classify`] — classes; [`modes`] — drawings of components; [`drift`]
//!   — new shapes compared with the training shapes.

pub mod class_labels;
mod classifier_record;
pub mod classify;
pub mod coding;
pub mod distributed;
pub mod drift;
pub mod file;
pub mod learning;
pub mod modes;
pub mod plan;
pub mod planning;
pub mod ready;
pub mod validation;
