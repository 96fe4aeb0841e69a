//! Linear models of aligned shapes: formulas, designs, sums of squares of three types, permutation tests.
//!
//! * [`formula`] — the notation of Wilkinson and Rogers; [`design`] — columns of a formula;
//! * [`subspaces`] — an orthonormal basis of the columns, and the pair of models that tests each term;
//! * [`permuted`] — sums of squares, as observed and for exchanged residuals; [`exchange`] — which residuals change places;
//! * [`effect_size`] — p values and Z of permuted statistics;
//! * [`anova`] — the table of all terms; `error_terms` — tests against groups; `slopes` — of effects that vary between them;
//! * [`groups`] — groups of shapes and rows of their averages; [`resample`] — vectors for exchanged and redrawn residuals;
//! * [`pairs`], [`disparity`], [`trajectories`] — groups beside each other; [`compare`] — two nested models; [`bands`] — of predictions;
//! * [`manova`] — multivariate statistics of the terms; [`covariance`] — known covariances of shapes, as of a tree;
//! * [`mixed`] — random effects of groups; [`repeatability`] — repeated shapes of subjects, and the error of measurement;
//! * [`predictor`] — predictions at values of attributes; [`kept`] — models that are kept for them, without the shapes;
//! * [`study`] — a model of aligned shapes with coefficients and predictions; `tested` — rows of its table, `testing` — how they are tested;
//! * [`streamed`] — the same of sums over a stream of shapes; [`chi_squared`] — their asymptotic p values;
//! * [`records`] — results, [`outcome`] — all of them; `printed` — tables as text; [`error`] — reasons why there is none.
//!
//! All shapes are aligned to one mean, which knows nothing of the model, so that the response is the same for every hypothesis. A
//! response of one number for each shape is one of vectors of length 1.
//!
//! Sources: Anderson and ter Braak 2003; Collyer, Sekora and Adams 2015; Collyer and Adams 2018.

pub mod anova;
pub mod bands;
pub mod chi_squared;
mod coefficients;
pub mod compare;
pub mod covariance;
pub mod design;
pub mod disparity;
pub mod effect_size;
pub mod error;
mod error_terms;
pub mod exchange;
pub mod formula;
pub mod groups;
pub mod kept;
pub mod manova;
pub mod mixed;
pub mod outcome;
pub mod pairs;
pub mod permuted;
pub mod predictor;
mod printed;
pub mod records;
pub mod repeatability;
pub mod resample;
mod slopes;
pub mod streamed;
pub mod study;
pub mod subspaces;
mod tested;
mod testing;
pub mod trajectories;
mod variables;

pub use super::inference::limits::MAX_VALUE;
