//! Dictionaries: atoms learnt from shapes, and the codes of shapes in these atoms.
//!
//! ```text
//! X_k ≈ Σ_j D_j B_jkᵀ,   B_jk ∈ 𝓑,   few B_jk ≠ 0
//! ```
//!
//! With *aligned* codes, the shapes are aligned to their mean and `B_jk = α_jk` is a number. With *invariant* codes, every
//! atom is transformed by its own member of the transformation class and no alignment is needed (for similarities of
//! the plane these are the complex weights of Song, Uhlmann, Fageot and Unser).
//!
//! Learn:
//!
//! * [`recipe`] — all parameters of learning; [`method`] — the learning method among them;
//! * [`learn`] — mean, preparation, atoms, certificate and statistics of held-out shapes ([`held_out`]);
//! * [`content`] — the learnt model, as a record, whose parts `consistency` checks.
//!
//! Use:
//!
//! * [`in_use`] — a dictionary prepared for use; [`coding`] — codes and reconstructions, [`posted_code`] — of
//!   given codes; [`score`] — outliers;
//! * [`report`] — how well modes describe shapes: generalisation, specificity, stability, named measurements;
//! * [`posterior`] — shapes of which a part is known: completion, calibrated bands, conditions;
//! * [`modes`] — modes, random shapes; [`prior`] — the energy of a shape outside of a span.
//!
//! Parts:
//!
//! * [`procedure`] — the trait of methods, with its implementations `components` and `sparse_atoms`;
//! * [`learning`] — online and batch learning of sparse atoms; [`statistics`] — sufficient statistics of codes;
//! * [`model`] — learnt atoms in use; [`work`] — predicted work;
//! * [`downdate`] — leave-one-out statistics of principal components;
//! * [`novelty`] — the limit beyond which a shape is an outlier; `gross_errors` — held-out shapes without which it is computed.
//!
//! Source: Schmitter 2017, (4.27); Mairal, Bach, Ponce, Sapiro 2009 for the statistics.

pub mod coding;
mod components;
mod consistency;
pub mod content;
pub mod downdate;
mod gross_errors;
pub mod held_out;
pub mod in_use;
pub mod learn;
pub mod learning;
pub mod method;
pub mod model;
pub mod modes;
pub mod novelty;
pub mod posted_code;
pub mod posterior;
pub mod prior;
pub mod procedure;
pub mod recipe;
pub mod report;
pub mod score;
mod sparse_atoms;
pub mod statistics;
pub mod work;
