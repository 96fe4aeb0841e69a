//! Distances between shapes.
//!
//! * [`distances`] — all pairs of a set; [`neighbours`] — nearest shapes of a cohort; [`picture`] — their drawing;
//!   `prepared` — cached cohorts, prepared for searches.

pub mod distances;
pub mod neighbours;
pub mod picture;
mod prepared;
