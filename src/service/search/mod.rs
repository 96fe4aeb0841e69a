//! Distances between shapes.
//!
//! * [`distances`] — all pairs of a set; [`neighbours`] — the nearest shapes of a cohort; `prepared` — cohorts prepared for that.

pub mod distances;
pub mod neighbours;
mod prepared;
