//! Distances between shapes.
//!
//! * [`distances`] — all pairs of a set; [`pairs`] — how they are compared; [`matched`] — one pair, elastically;
//!   [`neighbours`] — nearest shapes of a cohort; [`picture`] — their drawing;
//!   `prepared` — cached cohorts, prepared for searches.

pub mod distances;
pub mod matched;
pub mod neighbours;
pub mod pairs;
pub mod picture;
mod prepared;
mod reranked;
