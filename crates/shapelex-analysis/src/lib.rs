//! Shape statistics: alignment, means, principal components, sparse codes, classification and tests.
//!
//! A shape is an `N × d` matrix of control points (coordinate-major when flattened), and the metric is one Gram
//! operator. The crate is therefore independent of the kind of shape: curve, surface or landmarks.
//!
//! * [`metric`] — inner product, whitening, centring;
//! * [`transformation`] — linear transformation classes that are factored out before shapes are compared;
//! * [`subspace`] — the subspace of a shape under a class, and its projector (Theorem 1);
//! * [`accumulate`] — sums over many shapes that stream, split and merge; [`pass`] — the same sums as serialisable values;
//! * [`correspondence`], [`matching`] — start points, directions and mirror images; [`conversion`] — control points of
//!   points;
//! * [`groupwise`] — correspondence of shapes on a sphere by entropy over reparametrisations;
//! * [`mean`], [`frame`] — the mean space (mean of the subspaces) and its representative;
//! * [`robust`] — weights that take wrong shapes out of a mean, its components and its atoms;
//! * [`factors`] — which shapes a robust estimate leaves out;
//! * [`procrustes`] — generalised Procrustes analysis, for comparison;
//! * [`alignment`] — the mean of a set of shapes, and the shapes aligned to it; [`mean_record`] — means as records;
//! * [`mean_angle`] — the angle between two mean shapes, and the angle expected by chance;
//! * [`pca`] — functional principal components; [`region`] — alignment on a part of the shapes;
//! * [`sparse`] — sparse codes: lasso and group lasso with a certificate, matching pursuit;
//! * [`preparation`] — the form of shapes for coding; [`algebra`] — the transformations that may act on atoms;
//! * [`dictionary`] — dictionaries: learning, codes, scores;
//! * [`classification`] — classifiers of labelled shapes, and their validation; [`classifier_record`] — as records;
//! * [`assessment`] — shapes assessed by a dictionary and its classifier, and drift;
//! * [`distance`] — distances modulo a class: one pair, one against many, or all pairs;
//! * [`elastic`] — elastic distances of curves, and what corresponds;
//! * [`neighbours`] — nearest neighbours in a stream of shapes;
//! * [`inference`] — permutation tests for group differences and for regression; [`strata`] — sets within which they draw;
//! * [`models`] — linear models of shapes: formulas, sums of squares, permutation tests of their terms;
//! * [`blocks`] — how two sets of numbers of the same subjects vary together, and whether parts of a shape are modules;
//! * [`symmetry`] — symmetry and asymmetry of shapes: axes, tables, indices;
//! * [`thin_plate`] — thin-plate splines: maps that take landmarks to landmarks; [`sliding`] — semilandmarks that slide;
//! * [`size`] — sizes of many shapes;
//! * [`path`] — paths between shapes; [`drawing`] — drawings of results;
//! * [`estimate`] — predicted cost of learning and tests;
//! * [`rows`] — control points as rows, in records; [`watch`] — progress and cancellation.
//!
//! Source: Schmitter, *Spline Shape Processing*, chapters 2–5, with its misprints corrected.
//!
//! The termination bound of every loop is listed in `docs/limits.md`, in one table for all numerical layers.
//!
//! # Example
//!
//! The mean of four ellipses, whatever their position, size and direction:
//!
//! ```
//! use std::f64::consts::TAU;
//!
//! use shapelex_analysis::accumulate::ShapesInMemory;
//! use shapelex_analysis::alignment::{Alignment, Method, mean_shape};
//! use shapelex_analysis::correspondence::{Correspondence, Direction, Mirror};
//! use shapelex_analysis::frame::Frame;
//! use shapelex_analysis::matching::Matching;
//! use shapelex_analysis::metric::Metric;
//! use shapelex_analysis::transformation::{ClassName, Transformation};
//! use shapelex_geometry::generator::GeneratorKind;
//! use shapelex_geometry::representation::{Representation, ShapeSpace};
//!
//! let generator = GeneratorKind::Bspline { degree: 3 };
//! let space = ShapeSpace::new(&Representation::ClosedCurve { dimension: 2, control_points: 16, generator })?;
//! let ellipse = |k: usize| {
//!     let point = move |i: usize, c: usize| (TAU * (i as f64 / 16.0 - c as f64 / 4.0)).cos();
//!     let axes = [1.0, 0.5 + 0.05 * k as f64];
//!     (0..2).flat_map(move |c| (0..16).map(move |i| 10.0 * k as f64 + axes[c] * point(i, c)))
//! };
//! let metric = Metric::of(&space);
//! let method = Method::new(&Transformation::Named(ClassName::Similarity), Alignment::Projection, 2)?;
//! let matching = Matching::new(&space, Correspondence::Landmarks, Direction::Given, Mirror::Forbid);
//! let shapes = ShapesInMemory::new(&metric, true, (0..4).flat_map(ellipse).collect(), vec![1.0; 4])?;
//! let mean = mean_shape(&shapes, &metric, &method, Frame::Canonical, &matching)?;
//! assert_eq!(mean.unique, Some(true));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod accumulate;
pub mod algebra;
pub mod alignment;
mod anderson;
pub mod assessment;
pub mod blocks;
pub mod classification;
pub mod classifier_record;
pub mod conversion;
pub mod correspondence;
pub mod defaults;
pub mod dictionary;
pub mod distance;
pub mod drawing;
pub mod elastic;
pub mod estimate;
pub mod factors;
pub mod fit;
pub mod frame;
pub mod groupwise;
pub mod incomplete;
pub mod inference;
mod magnitudes;
pub mod matching;
pub mod mean;
pub mod mean_angle;
pub mod mean_record;
pub mod metric;
pub mod models;
pub mod neighbours;
pub mod partial_sums;
pub mod pass;
pub mod path;
pub mod pca;
mod placement;
mod placement_search;
pub mod preparation;
pub mod procrustes;
mod quantile;
mod random;
pub mod region;
pub mod robust;
pub mod rows;
pub mod size;
pub mod sliding;
pub mod sparse;
mod start_points;
pub mod strata;
pub mod subspace;
pub mod symmetry;
pub mod tangent;
pub mod thin_plate;
pub mod transformation;
mod unit_size;
pub mod watch;

use shapelex_numeric::NumericError;

/// Errors of the analysis layer.
#[derive(Debug, PartialEq, thiserror::Error)]
pub enum AnalysisError {
    /// The subspace of a shape under the class is rank-deficient.
    #[error(
        "shape {index} is degenerate under {class}: expected a relative singular value of at least \
         {DEGENERATE:.0e}, got {sigma:.1e}"
    )]
    Degenerate {
        /// Position of the shape.
        index: usize,
        /// Name of the class.
        class: String,
        /// Smallest over largest singular value of the basis.
        sigma: f64,
    },
    /// The shape is a single point to within the precision of the metric.
    #[error("shape {index} has no extent: norm {norm:.1e} after centring, {size:.1e} before")]
    NoExtent {
        /// Position of the shape.
        index: usize,
        /// Norm of the centred shape.
        norm: f64,
        /// Norm of the shape as given.
        size: f64,
    },
    /// A shape that does not suit the others, or the parameters.
    #[error("shape {index}: {detail}")]
    Unsuitable {
        /// Position of the shape.
        index: usize,
        /// The expected and the actual value.
        detail: String,
    },
    /// Too few shapes for the requested statistic.
    #[error("too few shapes: expected at least {needed}, got {found}")]
    TooFewShapes {
        /// Number of shapes given.
        found: usize,
        /// Number of shapes needed.
        needed: usize,
    },
    /// There is no projection onto the class.
    #[error("{0}")]
    NotAProperClass(String),
    /// The frame is not defined for the class.
    #[error("the canonical frame is not defined for {class}: use the training frame")]
    NoCanonicalFrame {
        /// Name of the class.
        class: String,
    },
    /// A parameter that does not suit the others, or the shapes.
    #[error("{field}: {detail}")]
    Parameter {
        /// Path of the parameter in its record, with dots: `method.codes`; empty for the whole record.
        field: &'static str,
        /// The expected and the actual value.
        detail: String,
    },
    /// The bytes are not a serialised accumulator of this kind.
    #[error("these bytes are not a stored sum of this kind and size")]
    NotAnAccumulator,
    /// The covariance of a class is singular.
    #[error("the covariance of class {class} does not have full rank")]
    SingularCovariance {
        /// Position of the class.
        class: usize,
    },
    /// The caller asked the computation to stop.
    #[error("interrupted")]
    Interrupted,
    /// Two shapes are antipodal on the sphere.
    #[error("the shapes are opposite ({angle:.6} rad apart): the path between them is not unique")]
    Antipodal {
        /// Angle between them in radians.
        angle: f64,
    },
    /// An iteration ended without its certificate.
    #[error(
        "shape {index}: no convergence after {iterations} iterations: duality gap {gap:.1e}, expected at most \
         {tolerance:.1e}"
    )]
    NoConvergence {
        /// Position of the shape.
        index: usize,
        /// Number of iterations.
        iterations: usize,
        /// Duality gap reached.
        gap: f64,
        /// Duality gap required.
        tolerance: f64,
    },
    /// An error of the numerical layer.
    #[error(transparent)]
    Numeric(#[from] NumericError),
    /// The source of the shapes failed.
    #[error(transparent)]
    Source(#[from] SourceError),
}

/// A failure of the origin of shapes, such as a database, on its way through a statistic. Whoever passed the source takes it out again.
#[derive(Debug, thiserror::Error)]
#[error(transparent)]
pub struct SourceError(Box<dyn std::error::Error + Send + Sync>);

impl SourceError {
    /// Wraps the error of a source.
    pub fn new(error: impl std::error::Error + Send + Sync + 'static) -> Self {
        Self(Box::new(error))
    }

    /// The error of the source, if it is of this type.
    ///
    /// # Errors
    /// This error, if it is not.
    pub fn take<E: std::error::Error + 'static>(self) -> Result<E, Self> {
        self.0.downcast().map(|error| *error).map_err(Self)
    }
}

/// No two failures are equal.
impl PartialEq for SourceError {
    fn eq(&self, _: &Self) -> bool {
        false
    }
}

impl AnalysisError {
    /// The same error for the shape at `position`.
    pub fn at(self, position: usize) -> Self {
        match self {
            Self::Degenerate { class, sigma, .. } => Self::Degenerate { index: position, class, sigma },
            Self::NoExtent { norm, size, .. } => Self::NoExtent { index: position, norm, size },
            Self::Unsuitable { detail, .. } => Self::Unsuitable { index: position, detail },
            Self::NoConvergence { iterations, gap, tolerance, .. } => {
                Self::NoConvergence { index: position, iterations, gap, tolerance }
            }
            other => other,
        }
    }

    /// The same error with its position increased by `first`.
    pub fn after(self, first: usize) -> Self {
        match self.position() {
            Some(position) => self.at(first + position),
            None => self,
        }
    }

    /// Position of the shape that caused the error.
    pub fn position(&self) -> Option<usize> {
        match self {
            Self::Degenerate { index, .. }
            | Self::NoExtent { index, .. }
            | Self::Unsuitable { index, .. }
            | Self::NoConvergence { index, .. } => Some(*index),
            _ => None,
        }
    }
}

/// Relative singular value below which the subspace of a shape is rank-deficient. The error of a subspace is the rounding
/// over its relative singular value: at least six digits of an accepted one are right.
pub const DEGENERATE: f64 = 1e-10;

/// The examples of the README are tests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
