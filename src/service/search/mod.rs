//! Distances between shapes.
//!
//! * [`distances`] — all pairs of a set; [`neighbours`] — nearest shapes of a cohort; `prepared` — cached cohorts,
//!   prepared for searches.

pub mod distances;
pub mod neighbours;
mod prepared;
