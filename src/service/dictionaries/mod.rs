//! Dictionaries: learnt, stored, and used.
//!
//! * [`planning`] — what learning was asked for is checked and becomes a [`plan`]; list, find and delete;
//! * [`learning`] — the job that learns; [`validation`] — its classifier, validated; [`distributed`] — its passes, shared with idle workers;
//! * [`class_labels`] — classes and subjects of the shapes of a cohort;
//! * [`ready`] — a stored dictionary prepared for use, cached; [`file`](mod@file) — export and import;
//! * [`coding`] — codes, reconstructions, scores; [`classify`] — classes; [`modes`] — drawn components; [`drift`] — new shapes beside the
//!   learnt ones.

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
