//! Dictionaries: statistics learnt from a cohort and stored.
//!
//! A dictionary is immutable; learning again under the same name creates the next version. Its [`Content`] depends on the
//! shapes and the parameters alone, so that equal inputs give equal digests. Time, name and cohort are recorded outside the
//! content, the cohort in its [`Provenance`].

use serde::{Deserialize, Serialize};

use super::classifier::{ClassifierKind, ClassifierRecord};
use super::shape::ShapeFilter;
use crate::analysis::alignment::{Alignment, MeanShape};
use crate::analysis::correspondence::{Correspondence, Direction, Mirror};
use crate::analysis::dictionary::learning::Schedule;
use crate::analysis::frame::Frame;
use crate::analysis::transformation::Transformation;
use crate::geometry::representation::Representation;

/// A stored version of a dictionary.
#[derive(Debug, Clone, PartialEq)]
pub struct Dictionary {
    /// Identifier, `dic_…`.
    pub id: String,
    /// Name shared by all versions.
    pub name: String,
    /// Version number, from 1.
    pub version: u64,
    /// Learnt content and its parameters.
    pub content: Content,
    /// Training data of the dictionary.
    pub provenance: Provenance,
    /// BLAKE3 digest of the content.
    pub digest: String,
    /// Time of creation, milliseconds since 1970 UTC.
    pub created_at_ms: i64,
}

/// A row of control points.
pub type Row = Vec<f64>;

/// Learnt statistics and the parameters of learning.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
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
    pub centre: Option<Vec<Row>>,
    /// Eigenshapes, orthonormal in `L₂`, or atoms of unit norm.
    pub atoms: Vec<Atom>,
    /// Convergence of the learning, and quality of the description of the shapes.
    pub statistics: Statistics,
    /// Classifier; null if none was requested.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub classifier: Option<ClassifierRecord>,
}

/// Mean shape with its certificate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct MeanRecord {
    /// Control points, of unit `L₂` norm except under `rigid` and `translation`.
    pub control_points: Vec<Row>,
    /// Leading eigenvalues of the sum of projectors; empty for Procrustes alignment.
    pub eigenvalues: Vec<f64>,
    /// Gap between the eigenvalues of the mean space and the next one; null for Procrustes alignment.
    pub gap: Option<f64>,
    /// Whether the mean is unique; null for Procrustes alignment.
    pub unique: Option<bool>,
    /// Whether the search for start points, or the Procrustes alignment, converged.
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
    /// Control points in the representation.
    pub control_points: Vec<Row>,
    /// Fraction of the shapes whose code uses the atom; 1 for components.
    pub usage: f64,
    /// Eigenvalue `λ_i`, the sum of squared scores over the shapes; null for sparse atoms.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub eigenvalue: Option<f64>,
    /// Explained fraction `λ_i/Σλ`; null for sparse atoms.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub explained: Option<f64>,
}

/// How codes handle the transformation class.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Codes {
    /// Shapes are aligned to the mean, then coded with one number per atom.
    #[default]
    Aligned,
    /// Every atom is transformed by its own member of the class; no alignment.
    Invariant,
}

/// Learning method.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Method {
    /// Functional principal components of the aligned shapes.
    FunctionalPca {
        /// Number of components. Default: 10.
        #[serde(default = "default_components")]
        #[schema(default = 10)]
        components: usize,
        /// Whether components are centred on the arithmetic mean of the aligned shapes. Default: false.
        #[serde(default)]
        centre: bool,
    },
    /// Sparse dictionary: every shape is coded with few atoms.
    Sparse {
        /// Number of atoms.
        atoms: usize,
        /// Penalty `λ` on the magnitudes of a code (lasso); null with `nonzeros`.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        lambda: Option<f64>,
        /// Number of atoms in a code (optimised orthogonal matching pursuit); null with `lambda`.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        nonzeros: Option<usize>,
        /// Aligned or invariant codes. Default: `aligned`.
        #[serde(default)]
        codes: Codes,
        /// Whether coefficients must be non-negative. Default: false.
        #[serde(default)]
        nonnegative: bool,
        /// Whether aligned shapes are divided by their norm, as invariant codes always are. Default: true.
        #[serde(default = "default_normalise")]
        #[schema(default = true)]
        normalise: bool,
        /// Seed of the random initial atoms. Default: 0.
        #[serde(default)]
        seed: u64,
        /// Maximum number of passes over the shapes, up to 10 000. Default: 200.
        #[serde(default = "default_max_epochs")]
        #[schema(default = 200)]
        max_epochs: usize,
        /// Relative decrease of the objective in one pass (with `nonzeros`: ten passes) below which learning stops. Default:
        /// 1e-4.
        #[serde(default = "default_tolerance")]
        #[schema(default = 1e-4)]
        tolerance: f64,
        /// Update schedule of the atoms. Default: `online` (after every group of shapes).
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
    /// Name of the method: `functional_pca` or `sparse`.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::FunctionalPca { .. } => "functional_pca",
            Self::Sparse { .. } => "sparse",
        }
    }

    /// Whether coefficients must be non-negative.
    pub fn is_nonnegative(&self) -> bool {
        matches!(self, Self::Sparse { nonnegative: true, .. })
    }

    /// Number of atoms or components requested.
    pub fn atoms(&self) -> usize {
        match self {
            Self::FunctionalPca { components, .. } => *components,
            Self::Sparse { atoms, .. } => *atoms,
        }
    }
}

/// Convergence of the learning, and quality of the description of the shapes.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
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
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub total: Option<f64>,
    /// Distribution of the scores; null for sparse atoms.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scores: Option<ScoreStatistics>,
    /// Statistics of held-out shapes, which set the limit of outliers. Null in dictionaries learnt before this was recorded,
    /// and where nothing could be held out. Outliers are then judged against the training shapes, which are described better
    /// than new ones.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub held_out: Option<HeldOutStatistics>,
}

/// Method of holding out shapes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum HoldOut {
    /// Each shape in turn, by an exact downdate of the components; aligned to the mean of all.
    LeaveOneOut,
    /// Groups of shapes; mean, alignment and atoms were learnt anew from the other groups.
    Parts,
}

/// Measures of held-out shapes, which predict those of new shapes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct HeldOutStatistics {
    /// Method of holding out shapes.
    pub method: HoldOut,
    /// Squared Mahalanobis distances; null for sparse atoms.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub t_squared: Option<HeldOutMeasure>,
    /// Squared prediction errors `‖y − ŷ‖²`.
    pub residuals: HeldOutMeasure,
    /// Larger of the two standardised logarithms for every shape, ascending; the outlier limit is derived from it.
    pub novelty: Vec<f64>,
}

/// A measure of the held-out shapes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct HeldOutMeasure {
    /// Values, ascending, one per shape.
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
    /// Weighted mean score of every component; zero for centred components.
    pub mean: Vec<f64>,
    /// Covariance of the scores, divided by the total weight minus its mean.
    pub covariance: Vec<Row>,
    /// Squared Mahalanobis distances of the shapes, ascending; for more than 1001 shapes, 1001 quantiles.
    pub t_squared: Vec<f64>,
}

/// Training data of a dictionary.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Provenance {
    /// Id of the cohort.
    pub cohort: String,
    /// Name of the cohort at that time.
    pub cohort_name: String,
    /// Revision of the cohort at that time.
    pub cohort_revision: u64,
    /// Filter that selected its shapes.
    pub filter: ShapeFilter,
    /// BLAKE3 digest of their control points and weights.
    pub shapes_digest: String,
    /// Id of the version that learning continued from.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub continued_from: Option<String>,
    /// Program and its version.
    pub program: String,
}

/// List entry of a version.
#[derive(Debug, Clone, PartialEq)]
pub struct Listed {
    /// Identifier, `dic_…`.
    pub id: String,
    /// Name shared by all versions.
    pub name: String,
    /// Version number, from 1.
    pub version: u64,
    /// Parts of the content shown in lists.
    pub summary: Summary,
    /// Training data of the dictionary.
    pub provenance: Provenance,
    /// BLAKE3 digest of the content.
    pub digest: String,
    /// Time of creation, milliseconds since 1970 UTC.
    pub created_at_ms: i64,
}

/// Parts of a [`Content`] shown in lists.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Summary {
    /// Representation of the shapes.
    pub representation: Representation,
    /// Transformation class removed before comparison.
    pub transformation: Transformation,
    /// Learning method with all its parameters.
    pub method: Method,
    /// Number of atoms; fewer components than requested if the rank is smaller.
    pub atoms: usize,
    /// Number of training shapes.
    pub shapes: usize,
    /// Mean objective over the training shapes.
    pub objective: f64,
    /// Mean reconstruction error over the training shapes.
    pub reconstruction_error: f64,
    /// Kind of classifier, if there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub classifier: Option<ClassifierKind>,
    /// Fraction of the shapes classified correctly in cross-validation.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub accuracy: Option<f64>,
}

/// A version about to be stored; the store assigns its number.
#[derive(Debug, Clone, PartialEq)]
pub struct NewDictionary {
    /// Identifier, `dic_…`.
    pub id: String,
    /// Name shared by all versions.
    pub name: String,
    /// Parts of the content shown in lists.
    pub summary: Summary,
    /// The content as JSON.
    pub content: Vec<u8>,
    /// Accumulated sums from which learning can continue.
    pub state: Option<Vec<u8>>,
    /// Training data of the dictionary.
    pub provenance: Provenance,
    /// BLAKE3 digest of the content.
    pub digest: String,
    /// Time of creation, milliseconds since 1970 UTC.
    pub created_at_ms: i64,
}

impl Content {
    /// Parts shown in lists.
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
