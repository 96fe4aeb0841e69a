//! Dictionaries: atoms that are learnt from shapes, and codes of shapes in them.
//!
//! ```text
//! X_k ≈ Σ_j D_j B_jkᵀ,   B_jk ∈ 𝓑,   few B_jk ≠ 0
//! ```
//!
//! With *aligned* codes the shapes are aligned to their mean and `B_jk = α_jk` is a number; with *invariant* codes every
//! atom is moved by its own member of the transformation class, and no alignment is needed (for similarities of the
//! plane these are the complex weights of Song, Uhlmann, Fageot and Unser).
//!
//! * [`algebra`] — what atoms may be moved by;
//! * [`preparation`] — how a shape is brought into the form that is coded;
//! * [`statistics`] — sufficient statistics of codes;
//! * [`learning`] — learning, online and in batches;
//! * [`model`] — the dictionary in use;
//! * [`held_out`] — what components say about shapes that are left out;
//! * [`novelty`] — from where on a shape is an outlier;
//! * [`prior`] — the energy of a shape outside of it.
//!
//! Source: Schmitter 2017, (4.27); Mairal, Bach, Ponce, Sapiro 2009 for the statistics.

pub mod algebra;
pub mod held_out;
pub mod learning;
pub mod model;
pub mod novelty;
pub mod preparation;
pub mod prior;
pub mod statistics;
