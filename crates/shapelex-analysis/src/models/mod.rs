//! Linear models of aligned shapes: formulas, designs, sums of squares of three types, permutation tests.
//!
//! * [`formula`] — the notation of Wilkinson and Rogers; [`design`] — columns of a formula;
//! * [`subspaces`] — an orthonormal basis of the columns, and the pair of models that tests each term;
//! * [`permuted`] — sums of squares, as observed and for exchanged residuals; [`exchange`] — which residuals change places;
//! * [`effect_size`] — p values and Z of permuted statistics;
//! * [`anova`] — the table of all terms; `error_terms` — tests against groups;
//! * [`study`] — a model of aligned shapes with coefficients and predictions;
//! * [`records`] — results; [`error`] — reasons why there is none.
//!
//! All shapes are aligned to one mean, which knows nothing of the model, so that the response is the same for every hypothesis. A
//! response of one number for each shape is one of vectors of length 1.
//!
//! Sources: Anderson and ter Braak 2003; Collyer, Sekora and Adams 2015; Collyer and Adams 2018.

pub mod anova;
pub mod design;
pub mod effect_size;
pub mod error;
mod error_terms;
pub mod exchange;
pub mod formula;
pub mod permuted;
pub mod records;
pub mod study;
pub mod subspaces;

pub use super::inference::limits::MAX_VALUE;
