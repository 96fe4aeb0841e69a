//! Dictionaries: atoms learnt from shapes, and the codes of shapes in these atoms.
//!
//! ```text
//! X_k ≈ Σ_j D_j B_jkᵀ,   B_jk ∈ 𝓑,   few B_jk ≠ 0
//! ```
//!
//! With *aligned* codes, the shapes are aligned to their mean and `B_jk = α_jk` is a number. With *invariant* codes, every
//! atom is transformed by a member of the transformation class of its own and no alignment is needed (for similarities of
//! the plane these are the complex weights of Song, Uhlmann, Fageot and Unser).
//!
//! * [`algebra`] — the transformations that may act on atoms;
//! * [`preparation`] — the form of shapes for coding;
//! * [`statistics`] — sufficient statistics of codes;
//! * [`learning`] — online and batch learning;
//! * [`model`] — a learnt dictionary in use;
//! * [`held_out`] — leave-one-out statistics of principal components;
//! * [`novelty`] — the limit beyond which a shape is an outlier;
//! * [`prior`] — the shape prior: the energy of a shape outside of a span.
//!
//! Source: Schmitter 2017, (4.27); Mairal, Bach, Ponce, Sapiro 2009 for the statistics.

pub mod algebra;
pub mod content;
pub mod held_out;
pub mod learning;
pub mod method;
pub mod model;
pub mod novelty;
pub mod preparation;
pub mod prior;
pub mod statistics;
