//! Statistics of shapes. Every shape is an `N × d` matrix of control points, coordinate-major when
//! flattened, and the metric is one Gram operator: nothing here knows what kind of shape it is.
//!
//! * [`metric`] — inner product, whitening, centring;
//! * [`transformation`] — the linear classes that are removed before shapes are compared;
//! * [`subspace`] — the subspace of a shape under a class, and its projector (Theorem 1);
//! * [`accumulate`] — sums over many shapes that stream, split and merge; [`pass`] — the same, written down;
//! * [`correspondence`], [`matching`] — start points, directions and mirror images;
//! * [`mean`], [`frame`] — the mean space (mean of the subspaces) and its representative;
//! * [`procrustes`] — the classical comparator;
//! * [`alignment`] — the mean of a set of shapes, and the shapes aligned to it;
//! * [`mean_angle`] — the angle between two mean shapes, and what it is by chance;
//! * [`pca`] — functional principal components;
//! * [`sparse`] — sparse codes: lasso and group lasso with a certificate, matching pursuit;
//! * [`dictionary`] — dictionaries learnt from shapes, and how shapes are prepared for them;
//! * [`classification`] — classifiers of labelled shapes, and their validation;
//! * [`distance`] — distances modulo a class, of one pair, one against many, or all pairs;
//! * [`neighbours`] — the nearest of many shapes that stream by;
//! * [`inference`] — tests of differences between groups and of dependencies, by permutation;
//! * [`path`] — paths between shapes.
//!
//! Source: Schmitter, *Spline Shape Processing*, chapters 2–5, with its misprints corrected.
//!
//! What ends each loop stands in one table for all layers of arithmetic, `docs/limits.md`.

pub mod accumulate;
pub mod alignment;
pub mod classification;
pub mod correspondence;
pub mod dictionary;
pub mod distance;
pub mod fit;
pub mod frame;
pub mod inference;
pub mod matching;
pub mod mean;
pub mod mean_angle;
pub mod metric;
pub mod neighbours;
pub mod partial_sums;
pub mod pass;
pub mod path;
pub mod pca;
pub mod procrustes;
pub mod sparse;
pub mod subspace;
pub mod transformation;

use shapelex_numeric::NumericError;

/// What the analysis can refuse.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum AnalysisError {
    /// The subspace of a shape under the class loses rank.
    #[error(
        "shape {index} is degenerate under {class}: relative singular value {sigma:.1e}, at least {DEGENERATE:.0e} is needed"
    )]
    Degenerate {
        /// Position of the shape.
        index: usize,
        /// Name of the class.
        class: String,
        /// Smallest over largest singular value of the basis.
        sigma: f64,
    },
    /// The shape is a point as far as the metric can tell.
    #[error("shape {index} has no extent: norm {norm:.1e} after centring, {size:.1e} before")]
    NoExtent {
        /// Position of the shape.
        index: usize,
        /// Norm of the centred shape.
        norm: f64,
        /// Norm of the shape as given.
        size: f64,
    },
    /// Too few shapes for the statistics asked for.
    #[error("{found} shapes, at least {needed} are needed")]
    TooFewShapes {
        /// Shapes given.
        found: usize,
        /// Shapes needed.
        needed: usize,
    },
    /// The class cannot be projected on.
    #[error("{0}")]
    NotAProperClass(String),
    /// The frame is not defined for the class.
    #[error("the canonical frame is not defined for {class}: ask for the training frame")]
    NoCanonicalFrame {
        /// Name of the class.
        class: String,
    },
    /// Bytes that are not an accumulator of this kind.
    #[error("these bytes are not a stored sum of this kind and size")]
    NotAnAccumulator,
    /// The covariance of a class cannot be inverted.
    #[error("the covariance of class {class} has not full rank")]
    SingularCovariance {
        /// Which class.
        class: usize,
    },
    /// The caller asked to stop.
    #[error("interrupted")]
    Interrupted,
    /// Two shapes are opposite on the sphere.
    #[error("the shapes are opposite ({angle:.6} rad apart): the path between them is not determined")]
    Antipodal {
        /// Angle between them.
        angle: f64,
    },
    /// An iteration did not reach its certificate.
    #[error(
        "shape {index}: no convergence after {iterations} iterations: duality gap {gap:.1e}, wanted {tolerance:.1e}"
    )]
    NoConvergence {
        /// Position of the shape.
        index: usize,
        /// Iterations done.
        iterations: usize,
        /// Gap reached.
        gap: f64,
        /// Gap wanted.
        tolerance: f64,
    },
    /// A numerical failure.
    #[error(transparent)]
    Numeric(#[from] NumericError),
}

/// Relative singular value below which the subspace of a shape has lost rank: the square root of the
/// rounding of a projection, so that what passes is accurate to half of the digits at least.
pub const DEGENERATE: f64 = 1e-10;
