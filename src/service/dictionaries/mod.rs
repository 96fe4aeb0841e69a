//! Dictionaries: learning, storage and use.
//!
//! * [`planning`] — checks a request to learn and makes a [`plan`] of it; list, find and delete;
//! * [`aliases`] — names for versions, which can be moved;
//! * [`learning`] — the job that learns;
//! * [`class_labels`] — classes and subjects of the shapes of a cohort;
//! * [`ready`] — stored dictionaries prepared for use, cached; [`file`](mod@file) — export and import;
//! * [`coding`] — codes, reconstructions, scores; `part` — shapes of which a part is missing, [`posterior`] — their completion; [`classify`] — classes; [`answers`] — both as they are written;
//! * [`assessments`] — both for all shapes of a cohort; [`stored_assessments`] — those kept beside the shapes; [`modes`], [`pictures`] — drawings; [`drift`]
//!   — new shapes of the cohort compared with the training shapes.
//!
//! The arithmetic is in [`analysis::dictionary`](crate::analysis::dictionary) and
//! [`analysis::classification`](crate::analysis::classification): this folder loads, limits, schedules and stores.

pub mod aliases;
pub mod answers;
pub mod assessments;
pub mod class_labels;
pub mod classify;
pub mod coding;
pub mod correspond;
pub mod drift;
pub mod file;
pub mod learning;
pub mod modes;
mod part;
pub mod pictures;
pub mod plan;
pub mod planning;
pub mod posterior;
pub mod ready;
pub mod report;
pub mod stored_assessments;
