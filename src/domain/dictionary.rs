//! A dictionary: what is learnt from a cohort and kept.
//!
//! Immutable. Learning again under the same name makes the next version. Its [`Content`] depends on the shapes and the
//! parameters alone, so that equal inputs have equal digests; when, under which name and from which cohort it was
//! learnt stands in its [`Provenance`].

use serde::{Deserialize, Serialize};

use super::classifier::{ClassifierKind, ClassifierRecord};
use super::shape::ShapeFilter;
use crate::analysis::alignment::{Alignment, MeanShape};
use crate::analysis::correspondence::{Correspondence, Direction, Mirror};
use crate::analysis::dictionary::learning::Schedule;
use crate::analysis::frame::Frame;
use crate::analysis::transformation::Transformation;
use crate::geometry::representation::Representation;

/// A stored version.
#[derive(Debug, Clone, PartialEq)]
pub struct Dictionary {
    /// `dic_…`.
    pub id: String,
    /// Name, shared by all versions.
    pub name: String,
    /// From 1.
    pub version: u64,
    /// What was learnt.
    pub content: Content,
    /// From what.
    pub provenance: Provenance,
    /// blake3 of the content.
    pub digest: String,
    /// Milliseconds since 1970 UTC.
    pub created_at_ms: i64,
}

/// A row of control points.
pub type Row = Vec<f64>;

/// What was learnt, and the parameters of learning.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Content {
    /// What shapes are made of.
    pub representation: Representation,
    /// How points correspond.
    pub correspondence: Correspondence,
    /// Whether the direction of contours means something.
    pub direction: Direction,
    /// Whether mirror images may be matched.
    pub mirror: Mirror,
    /// Unit of the coordinates of the cohort; the dictionary itself has no unit where shapes are normalised.
    pub length_unit: Option<String>,
    /// The class that is removed.
    pub transformation: Transformation,
    /// Projection on the class, or Procrustes fits.
    pub alignment: Alignment,
    /// Which member of the mean space is the mean shape.
    pub frame: Frame,
    /// What was learnt, with all parameters.
    pub method: Method,
    /// The mean shape that shapes are aligned to, or that start points are matched to.
    pub mean: MeanRecord,
    /// Arithmetic mean of the aligned shapes; null for sparse atoms.
    pub centre: Option<Vec<Row>>,
    /// Eigenshapes, or atoms; orthonormal in `L₂`, or of unit norm.
    pub atoms: Vec<Atom>,
    /// How learning went and how well the shapes are described.
    pub statistics: Statistics,
    /// Tells classes apart; null when none was asked for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub classifier: Option<ClassifierRecord>,
}

/// The mean shape with its certificate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct MeanRecord {
    /// Of unit `L₂` norm except under `rigid` and `translation`.
    pub control_points: Vec<Row>,
    /// Leading eigenvalues of the sum of projectors; empty for Procrustes fits.
    pub eigenvalues: Vec<f64>,
    /// Gap behind the mean space; null for Procrustes fits.
    pub gap: Option<f64>,
    /// Whether the mean is unique; null for Procrustes fits.
    pub unique: Option<bool>,
    /// Whether the search of start points, or the fit, ended.
    pub converged: bool,
}

impl MeanRecord {
    /// The record of a mean shape in `dimension` coordinates.
    pub fn of(mean: &MeanShape, dimension: usize) -> Self {
        Self {
            control_points: rows_of(&mean.control_points, dimension),
            eigenvalues: mean.eigenvalues.clone(),
            gap: mean.gap,
            unique: mean.unique,
            converged: mean.converged,
        }
    }
}

/// One atom.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Atom {
    /// Coefficients in the representation.
    pub control_points: Vec<Row>,
    /// Part of the shapes whose code uses the atom; 1 for components.
    pub usage: f64,
    /// `λ_i`, sums of squared scores over the shapes; null for sparse atoms.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub eigenvalue: Option<f64>,
    /// `λ_i/Σλ`; null for sparse atoms.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub explained: Option<f64>,
}

/// How codes treat the class.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Codes {
    /// Shapes are aligned to the mean, then coded with numbers.
    #[default]
    Aligned,
    /// Every atom is moved by its own member of the class; no alignment.
    Invariant,
}

/// What is learnt.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Method {
    /// Functional principal components of the aligned shapes.
    FunctionalPca {
        /// Number of components; 10 unless given.
        #[serde(default = "default_components")]
        #[schema(default = 10)]
        components: usize,
        /// Whether they are about the arithmetic mean of the aligned shapes; false unless given.
        #[serde(default)]
        centre: bool,
    },
    /// Atoms in which every shape has a code with few of them.
    Sparse {
        /// Number of atoms.
        atoms: usize,
        /// Penalty `λ` on the magnitudes of a code (lasso); null with `nonzeros`.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        lambda: Option<f64>,
        /// Atoms in a code (optimised orthogonal matching pursuit); null with `lambda`.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        nonzeros: Option<usize>,
        /// Aligned or invariant codes; `aligned` unless given.
        #[serde(default)]
        codes: Codes,
        /// Whether coefficients must not be negative; false unless given.
        #[serde(default)]
        nonnegative: bool,
        /// Whether aligned shapes are divided by their norm, as invariant codes always are; true unless given.
        #[serde(default = "default_normalise")]
        #[schema(default = true)]
        normalise: bool,
        /// Draws the first atoms; 0 unless given.
        #[serde(default)]
        seed: u64,
        /// Passes over the shapes at the most, up to 10 000; 200 unless given.
        #[serde(default = "default_max_epochs")]
        #[schema(default = 200)]
        max_epochs: usize,
        /// Learning ends when a pass (with `nonzeros`: ten passes) lowers the objective by less than this part of it; 1e-4
        /// unless given.
        #[serde(default = "default_tolerance")]
        #[schema(default = 1e-4)]
        tolerance: f64,
        /// How often atoms move; `online` (after every group of shapes) unless given.
        #[serde(default)]
        schedule: Schedule,
    },
}

fn default_components() -> usize {
    10
}

fn default_normalise() -> bool {
    true
}

fn default_max_epochs() -> usize {
    200
}

fn default_tolerance() -> f64 {
    1e-4
}

impl Method {
    /// `functional_pca` or `sparse`.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::FunctionalPca { .. } => "functional_pca",
            Self::Sparse { .. } => "sparse",
        }
    }

    /// Whether coefficients must not be negative.
    pub fn is_nonnegative(&self) -> bool {
        matches!(self, Self::Sparse { nonnegative: true, .. })
    }

    /// Atoms or components asked for.
    pub fn atoms(&self) -> usize {
        match self {
            Self::FunctionalPca { components, .. } => *components,
            Self::Sparse { atoms, .. } => *atoms,
        }
    }
}

/// How learning went, and how well the shapes are described.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Statistics {
    /// Number of shapes.
    pub shapes: usize,
    /// Sum of their weights.
    pub weight: f64,
    /// Weighted mean of `½‖y − ŷ‖²` plus the penalty over the shapes, with their codes in the final atoms.
    pub objective: f64,
    /// The objective after every pass: each shape with its latest code then; never rises under a penalty.
    pub history: Vec<f64>,
    /// Whether the tolerance ended learning.
    pub converged: bool,
    /// Atoms that no shape used and that were replaced.
    pub reseeded: usize,
    /// Weighted mean of `‖y − ŷ‖²/(‖y‖‖ŷ‖)` over the shapes.
    pub reconstruction_error: f64,
    /// Real numbers in a code, mean over the shapes.
    pub parameters: f64,
    /// `‖y − ŷ‖²` of the shapes, ascending; of more than 1001 shapes that many quantiles.
    pub residuals: Vec<f64>,
    /// `Σλ`, all of it; null for sparse atoms.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub total: Option<f64>,
    /// Distribution of the scores; null for sparse atoms.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scores: Option<ScoreStatistics>,
    /// What shapes look like that were not learnt from: outliers are told by it. Null in dictionaries that were learnt
    /// before there was such a record, and where nothing could be held out: their outliers are told by the shapes that
    /// were learnt from, which are described better than new ones.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub held_out: Option<HeldOutStatistics>,
}

/// How shapes were held out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum HoldOut {
    /// Each by the components of all others, by an exact downdate; aligned to the mean of all.
    LeaveOneOut,
    /// In parts; mean, alignment and atoms were learnt anew from the others.
    Parts,
}

/// Measures of shapes that were held out, and what they say about new ones.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct HeldOutStatistics {
    /// How they were held out.
    pub method: HoldOut,
    /// Squared Mahalanobis distances; null for sparse atoms.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub t_squared: Option<HeldOutMeasure>,
    /// `‖y − ŷ‖²`.
    pub residuals: HeldOutMeasure,
    /// The larger of the two standardised logarithms of every shape, ascending: what the limit of outliers is made from.
    pub novelty: Vec<f64>,
}

/// A measure of shapes that were held out.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct HeldOutMeasure {
    /// Ascending, one a shape.
    pub values: Vec<f64>,
    /// Mean of the logarithms.
    pub log_mean: f64,
    /// Standard deviation of the logarithms.
    pub log_deviation: f64,
}

/// Distribution of the scores of the shapes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ScoreStatistics {
    /// Weighted mean score of every component; zero when they are about the mean.
    pub mean: Vec<f64>,
    /// Covariance of the scores, divided by the weight minus its mean.
    pub covariance: Vec<Row>,
    /// Squared Mahalanobis distances of the shapes, ascending; of more than 1001 shapes that many quantiles.
    pub t_squared: Vec<f64>,
}

/// From what a dictionary was learnt.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Provenance {
    /// Id of the cohort.
    pub cohort: String,
    /// Its name then.
    pub cohort_name: String,
    /// Its revision then.
    pub cohort_revision: u64,
    /// Which of its shapes.
    pub filter: ShapeFilter,
    /// blake3 of their control points and weights.
    pub shapes_digest: String,
    /// Id of the version that learning went on from.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub continued_from: Option<String>,
    /// The program and its version.
    pub program: String,
}

/// What a list says about a version.
#[derive(Debug, Clone, PartialEq)]
pub struct Listed {
    /// `dic_…`.
    pub id: String,
    /// Name, shared by all versions.
    pub name: String,
    /// From 1.
    pub version: u64,
    /// The parts of the content that a list shows.
    pub summary: Summary,
    /// From what.
    pub provenance: Provenance,
    /// blake3 of the content.
    pub digest: String,
    /// Milliseconds since 1970 UTC.
    pub created_at_ms: i64,
}

/// The parts of a [`Content`] that a list shows.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Summary {
    /// What shapes are made of.
    pub representation: Representation,
    /// The class that is removed.
    pub transformation: Transformation,
    /// What was learnt, with all parameters.
    pub method: Method,
    /// Atoms there are; fewer components than asked for when the rank is smaller.
    pub atoms: usize,
    /// Shapes it was learnt from.
    pub shapes: usize,
    /// Mean objective over them.
    pub objective: f64,
    /// Mean reconstruction error over them.
    pub reconstruction_error: f64,
    /// Kind of the classifier, when there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub classifier: Option<ClassifierKind>,
    /// Part of the shapes that it got right in cross-validation.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub accuracy: Option<f64>,
}

/// A version that is about to be stored; its number is given by the store.
#[derive(Debug, Clone, PartialEq)]
pub struct NewDictionary {
    /// `dic_…`.
    pub id: String,
    /// Name.
    pub name: String,
    /// For lists.
    pub summary: Summary,
    /// The content as JSON.
    pub content: Vec<u8>,
    /// Sums that learning can go on from.
    pub state: Option<Vec<u8>>,
    /// From what.
    pub provenance: Provenance,
    /// blake3 of the content.
    pub digest: String,
    /// Milliseconds since 1970 UTC.
    pub created_at_ms: i64,
}

impl Content {
    /// What a list shows.
    pub fn summary(&self) -> Summary {
        Summary {
            representation: self.representation.clone(),
            transformation: self.transformation.clone(),
            method: self.method.clone(),
            atoms: self.atoms.len(),
            shapes: self.statistics.shapes,
            objective: self.statistics.objective,
            reconstruction_error: self.statistics.reconstruction_error,
            classifier: self.classifier.as_ref().map(|record| record.settings.kind),
            accuracy: self.classifier.as_ref().map(|record| record.validation.accuracy.value),
        }
    }
}

/// Rows of control points from `d·N` coordinate-major numbers.
pub fn rows_of(columns: &[f64], dimension: usize) -> Vec<Row> {
    let n = columns.len() / dimension;
    (0..n).map(|k| (0..dimension).map(|c| columns[c * n + k]).collect()).collect()
}

/// `d·N` coordinate-major numbers from rows of control points.
pub fn columns_of(rows: &[Row], dimension: usize) -> Vec<f64> {
    (0..dimension).flat_map(|c| rows.iter().map(move |row| row[c])).collect()
}
