//! The content of a dictionary: learnt statistics with the parameters of learning, as a serialisable record.
//!
//! A content depends on the shapes and the parameters alone: equal inputs give equal numbers, and an equal serialised
//! form. Names, times and the origin of the shapes are not part of it.

use super::method::Method;
use crate::alignment::Alignment;
use crate::classifier_record::ClassifierRecord;
use crate::correspondence::{Correspondence, Direction, Mirror};
use crate::factors::RobustSummary;
use crate::frame::Frame;
use crate::mean_record::MeanRecord;
use crate::transformation::Transformation;
use shapelex_geometry::representation::Representation;

/// Learnt statistics and the parameters of learning.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields))]
pub struct Content {
    /// Representation of the shapes.
    pub representation: Representation,
    /// Point correspondence between shapes.
    pub correspondence: Correspondence,
    /// Treatment of contour direction.
    pub direction: Direction,
    /// Whether shapes may be matched to mirror images.
    pub mirror: Mirror,
    /// Unit of the coordinates of the cohort; the dictionary itself has no unit if shapes are normalised.
    pub length_unit: Option<String>,
    /// Transformation class removed before comparison.
    pub transformation: Transformation,
    /// Alignment method: projection onto the class, or Procrustes.
    pub alignment: Alignment,
    /// Representative of the mean space used as the mean shape.
    pub frame: Frame,
    /// Learning method with all its parameters.
    pub method: Method,
    /// Mean shape to which shapes are aligned, or start points are matched.
    pub mean: MeanRecord,
    /// Arithmetic mean of the aligned shapes; null for sparse atoms.
    pub centre: Option<Vec<Vec<f64>>>,
    /// Eigenshapes, orthonormal in `L₂`, or atoms of unit norm.
    pub atoms: Vec<Atom>,
    /// Convergence of the learning, and quality of the description of the shapes.
    pub statistics: Statistics,
    /// Shapes that were left out, or count less, because they are unlike the majority; null if every shape counts by its weight.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub robust: Option<RobustSummary>,
    /// Classifier; null if none was requested.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub classifier: Option<ClassifierRecord>,
}

impl Content {
    /// Lowest version of the file format that has all fields of the content: the second adds measures of held-out shapes, the third the
    /// shapes that a robust dictionary leaves out, the fourth the seed and the gross
    /// errors of the held-out shapes, and a minority that a robust one keeps.
    pub fn format_version(&self) -> u32 {
        match &self.statistics.held_out {
            Some(held_out) if held_out.seed.is_some() || held_out.gross_errors.is_some() => 4,
            _ if self.robust.is_some_and(|robust| robust.minority.is_some()) => 4,
            _ if self.robust.is_some() => 3,
            Some(_) => 2,
            None => 1,
        }
    }
}

/// One atom.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields))]
pub struct Atom {
    /// Control points in the representation.
    pub control_points: Vec<Vec<f64>>,
    /// Fraction of the shapes whose code uses the atom; 1 for components.
    pub usage: f64,
    /// Eigenvalue `λ_i`, the sum of squared scores over the shapes; null for sparse atoms.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub eigenvalue: Option<f64>,
    /// Explained fraction `λ_i/Σλ`; null for sparse atoms.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub explained: Option<f64>,
}

/// Convergence of the learning, and quality of the description of the shapes.
#[derive(Debug, Clone, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields))]
pub struct Statistics {
    /// Number of shapes.
    pub shapes: usize,
    /// Sum of their weights.
    pub weight: f64,
    /// Weighted mean of `½‖y − ŷ‖²` plus the penalty over the shapes, with their codes in the final atoms.
    pub objective: f64,
    /// Objective after every pass, each shape with its latest code then; it never rises under a penalty.
    pub history: Vec<f64>,
    /// Whether learning stopped because it reached the tolerance.
    pub converged: bool,
    /// Number of atoms replaced because no shape used them.
    pub reseeded: usize,
    /// Weighted mean of `‖y − ŷ‖²/(‖y‖‖ŷ‖)` over the shapes.
    pub reconstruction_error: f64,
    /// Mean number of real numbers in a code.
    pub parameters: f64,
    /// `‖y − ŷ‖²` of the shapes, ascending; for more than 1001 shapes, 1001 quantiles.
    pub residuals: Vec<f64>,
    /// Total variance `Σλ`, over all components; null for sparse atoms.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub total: Option<f64>,
    /// Distribution of the scores; null for sparse atoms.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub scores: Option<ScoreStatistics>,
    /// Statistics of held-out shapes, which set the limit of outliers. Null in dictionaries learnt before this was recorded,
    /// and where nothing could be held out. Outliers are then judged against the training shapes, which are described better
    /// than new ones.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub held_out: Option<HeldOutStatistics>,
}

/// Method of holding out shapes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
pub enum HoldOut {
    /// Each shape in turn, by an exact downdate of the components; aligned to the mean of all.
    LeaveOneOut,
    /// Groups of shapes; mean, alignment and atoms were learnt anew from the other groups.
    Parts,
}

/// Measures of held-out shapes, which predict those of new shapes.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields))]
pub struct HeldOutStatistics {
    /// Method of holding out shapes.
    pub method: HoldOut,
    /// Seed of the choice of the held-out shapes, which does not depend on the order of the shapes. Null in dictionaries learnt by
    /// earlier versions, which took every so-manyth shape, and where every shape was held out by its place.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub seed: Option<u64>,
    /// Squared Mahalanobis distances; null for sparse atoms.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub t_squared: Option<HeldOutMeasure>,
    /// Squared prediction errors `‖y − ŷ‖²`.
    pub residuals: HeldOutMeasure,
    /// Larger of the two standardised logarithms for every shape without gross errors, ascending; the outlier limit is derived from
    /// it.
    pub novelty: Vec<f64>,
    /// Gross errors among the held-out shapes; null if there are none.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub gross_errors: Option<GrossErrors>,
}

/// Gross errors among the held-out shapes, without which the outlier limit and the logarithms are computed.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields))]
pub struct GrossErrors {
    /// Number of gross errors.
    pub shapes: usize,
    /// Scores without them, in which the distance of a shape is measured; null for sparse atoms and for few shapes.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub scores: Option<TypicalScores>,
}

/// Scores of the held-out shapes without gross errors.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields))]
pub struct TypicalScores {
    /// Mean score of every component.
    pub mean: Vec<f64>,
    /// Covariance of the scores, divided by the number of shapes minus one.
    pub covariance: Vec<Vec<f64>>,
    /// Mean of the logarithms of the squared distances, each without the shape itself.
    pub log_mean: f64,
    /// Standard deviation of these logarithms.
    pub log_deviation: f64,
}

/// A measure of the held-out shapes.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields))]
pub struct HeldOutMeasure {
    /// Values, ascending, one per shape.
    pub values: Vec<f64>,
    /// Mean of the logarithms, without gross errors.
    pub log_mean: f64,
    /// Standard deviation of the logarithms, without gross errors.
    pub log_deviation: f64,
}

/// Distribution of the scores of the shapes.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields))]
pub struct ScoreStatistics {
    /// Weighted mean score of every component; zero for centred components.
    pub mean: Vec<f64>,
    /// Covariance of the scores, divided by the total weight minus its mean.
    pub covariance: Vec<Vec<f64>>,
    /// Squared Mahalanobis distances of the shapes, ascending; for more than 1001 shapes, 1001 quantiles.
    pub t_squared: Vec<f64>,
}
