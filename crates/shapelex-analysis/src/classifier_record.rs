//! Classifiers as serialisable records: requested settings, trained numbers, and validation.

/// Kind of classifier.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
pub enum ClassifierKind {
    /// Distance to the mean space of each class.
    MeanSpace,
    /// Class of the atom with the largest correlation.
    NearestAtom,
    /// Class whose atoms leave the smallest residual; for sparse dictionaries.
    SparseResidual,
    /// Regularised discriminant of the code, from linear to quadratic.
    Discriminant,
    /// Vote of the nearest training shapes, compared by their codes.
    NearestNeighbours,
    /// The best of the other kinds, alone or combined, in cross-validation within the training shapes.
    Best,
    /// Combination of several kinds, which `best` may train; cannot be requested.
    Ensemble,
}

/// Feature that a classifier uses.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
pub enum Feature {
    /// Shape, as described by the dictionary.
    Shape,
    /// Size `ln ‖r − r̄‖`, which the transformation class may have removed.
    Size,
}

/// Settings of a classifier.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields))]
pub struct ClassifierSettings {
    /// Kind of classifier to train.
    pub kind: ClassifierKind,
    /// Attribute that names the class of a shape: `label`, or `labels.` and the name of an attribute. Default: `label`.
    #[cfg_attr(feature = "serde", serde(default = "default_attribute"))]
    #[cfg_attr(feature = "schema", schema(default = "label"))]
    pub attribute: String,
    /// Features to use. Default: `["shape"]`.
    #[cfg_attr(feature = "serde", serde(default = "default_features"))]
    #[cfg_attr(feature = "schema", schema(default = json!(["shape"])))]
    pub features: Vec<Feature>,
    /// For `discriminant`: number of leading components of the code to use. Default: all.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    #[cfg_attr(feature = "schema", schema(minimum = 1))]
    pub components: Option<usize>,
    /// For `discriminant`: pooling of covariances, from 0 (one per class: quadratic) to 1 (one for all classes: linear).
    /// Default: 1.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    #[cfg_attr(feature = "schema", schema(minimum = 0, maximum = 1))]
    pub pooling: Option<f64>,
    /// For `discriminant`: shrinkage of covariances towards a multiple of the identity, 0 to 1. Default: estimated.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    #[cfg_attr(feature = "schema", schema(minimum = 0, maximum = 1))]
    pub shrinkage: Option<f64>,
    /// For `nearest_neighbours`: number of neighbours that vote. Default: 5.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    #[cfg_attr(feature = "schema", schema(minimum = 1))]
    pub neighbours: Option<usize>,
    /// Number of parts (folds) of the cross-validation. Default: 5.
    #[cfg_attr(feature = "serde", serde(default = "default_folds"))]
    #[cfg_attr(feature = "schema", schema(default = 5, minimum = 2, maximum = 100))]
    pub folds: usize,
    /// Number of repeats of the cross-validation with different parts. Default: 3.
    #[cfg_attr(feature = "serde", serde(default = "default_repeats"))]
    #[cfg_attr(feature = "schema", schema(default = 3, minimum = 1, maximum = 100))]
    pub repeats: usize,
    /// Seed of the random parts. Default: 0.
    #[cfg_attr(feature = "serde", serde(default))]
    pub seed: u64,
}

fn default_attribute() -> String {
    "label".into()
}

fn default_features() -> Vec<Feature> {
    vec![Feature::Shape]
}

fn default_folds() -> usize {
    5
}

fn default_repeats() -> usize {
    3
}

impl ClassifierSettings {
    /// Settings of a kind of classifier, with defaults otherwise.
    pub fn new(kind: ClassifierKind) -> Self {
        Self {
            kind,
            attribute: default_attribute(),
            features: default_features(),
            components: None,
            pooling: None,
            shrinkage: None,
            neighbours: None,
            folds: default_folds(),
            repeats: default_repeats(),
            seed: 0,
        }
    }

    /// Whether the size is one of the features.
    pub fn sees_size(&self) -> bool {
        self.features.contains(&Feature::Size)
    }

    /// Number of trainings of the whole validation, each of which learns everything anew; `within` are those for the choice of
    /// `best`, whose result is validated once more.
    pub fn trainings(&self, within: usize) -> usize {
        let parts = self.folds * self.repeats;
        match self.kind {
            ClassifierKind::Best => parts * (1 + within) + 1 + within + parts,
            _ => parts + 1,
        }
    }
}

/// Trained classifier with its validation.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields))]
pub struct ClassifierRecord {
    /// Requested settings.
    pub settings: ClassifierSettings,
    /// Classes, in alphabetical order.
    pub classes: Vec<ClassRecord>,
    /// Classifier trained on all shapes.
    pub trained: Trained,
    /// `β` of the confidences, which are proportional to `exp(β score)`.
    pub sharpness: f64,
    /// Performance on shapes that it has not seen.
    pub validation: Validation,
}

/// A class of the training shapes.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields))]
pub struct ClassRecord {
    /// Name of the class: the value of the attribute.
    pub label: String,
    /// Number of training shapes.
    pub shapes: usize,
    /// Distances of the class's own shapes to it when held out, ascending; for more than 1001 shapes, 1001 quantiles.
    pub distances: Vec<f64>,
}

/// Numbers of a trained classifier.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields))]
pub enum Trained {
    /// Distance to the mean space of each class.
    MeanSpace {
        /// Control points of the mean shape of each class.
        means: Vec<Vec<Vec<f64>>>,
    },
    /// Class of the atom with the largest correlation.
    NearestAtom {
        /// Atoms of each class, from 0; atoms that no shape votes for belong to none.
        atoms: Vec<Vec<usize>>,
    },
    /// Class whose atoms leave the smallest residual.
    SparseResidual {
        /// Atoms of each class, from 0; atoms that no shape uses belong to none.
        atoms: Vec<Vec<usize>>,
    },
    /// Regularised discriminant.
    Discriminant {
        /// Features used, from 0: entries of the code, then the size.
        features: Vec<usize>,
        /// Divisors of the features: pooled standard deviations within classes.
        scales: Vec<f64>,
        /// Mean features of each class.
        means: Vec<Vec<f64>>,
        /// Lower triangles, row by row, of the Cholesky factors of the covariances: one for all classes, or one per class.
        factors: Vec<Vec<f64>>,
        /// Log priors `ln(n_c/n)`.
        log_priors: Vec<f64>,
        /// Pooling, requested or chosen.
        pooling: f64,
        /// Shrinkage, requested, chosen or estimated.
        shrinkage: f64,
    },
    /// Vote of the nearest training shapes.
    NearestNeighbours {
        /// Number of neighbours that vote.
        neighbours: usize,
        /// Features of the training shapes.
        features: Vec<Vec<f64>>,
        /// Classes of the training shapes, from 0.
        classes: Vec<usize>,
        /// Factor applied to the size, if it is a feature.
        size_factor: Option<f64>,
    },
    /// Mean of the probabilities of several classifiers.
    Ensemble {
        /// Members, at most twelve, largest weight first; distances are those of the whole ensemble.
        members: Vec<TrainedMember>,
    },
}

/// Member of an ensemble.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields))]
pub struct TrainedMember {
    /// Numbers of the trained classifier.
    #[cfg_attr(feature = "schema", schema(no_recursion))]
    pub trained: Trained,
    /// `β` of its probabilities, which are proportional to `exp(β score)`.
    pub sharpness: f64,
    /// Weight in the mean; the weights of all members sum to 1.
    pub weight: f64,
}

impl Trained {
    /// Kind of the trained classifier.
    pub fn kind(&self) -> ClassifierKind {
        match self {
            Self::MeanSpace { .. } => ClassifierKind::MeanSpace,
            Self::NearestAtom { .. } => ClassifierKind::NearestAtom,
            Self::SparseResidual { .. } => ClassifierKind::SparseResidual,
            Self::Discriminant { .. } => ClassifierKind::Discriminant,
            Self::NearestNeighbours { .. } => ClassifierKind::NearestNeighbours,
            Self::Ensemble { .. } => ClassifierKind::Ensemble,
        }
    }
}

/// A proportion with its 95 % confidence interval.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields))]
pub struct PartRecord {
    /// Estimated proportion.
    pub value: f64,
    /// Lower end of the interval.
    pub low: f64,
    /// Upper end of the interval.
    pub high: f64,
}

/// Calibration bin: shapes grouped by their confidence in the most likely class.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields))]
pub struct ReliabilityBin {
    /// Lower end of the bin, which is a tenth wide.
    pub from: f64,
    /// Number of shapes, over all repeats.
    pub count: usize,
    /// Mean confidence of these shapes.
    pub confidence: f64,
    /// Fraction of them classified correctly.
    pub accuracy: f64,
}

/// Recall and precision of a class.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields))]
pub struct ClassQuality {
    /// Name of the class.
    pub label: String,
    /// Fraction of the class's shapes that are assigned to it.
    pub recall: PartRecord,
    /// Fraction of the shapes assigned to the class that belong to it; null if none is assigned.
    pub precision: Option<f64>,
}

/// A classifier tried by `best`.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields))]
pub struct Candidate {
    /// Kind of classifier.
    pub kind: ClassifierKind,
    /// Number of components of a discriminant.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub components: Option<usize>,
    /// Pooling of a discriminant.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub pooling: Option<f64>,
    /// Shrinkage of a discriminant; absent if it is estimated.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub shrinkage: Option<f64>,
    /// Number of neighbours that vote.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub neighbours: Option<usize>,
    /// Fraction classified correctly in the cross-validation used for the choice. It is too high for the candidate that was
    /// chosen: rely on the figures of the validation instead.
    pub accuracy: f64,
    /// Weight in the chosen classifier; absent if it has none.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub weight: Option<f64>,
}

/// Quality of the choice made by `best` for all shapes, measured on held-out shapes of the same parts. Confidences and
/// limits are derived from it. It is slightly optimistic, because all shapes influenced the choice. Rely on the figures of
/// the validation, in which choices are made without the shapes they are tested on.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields))]
pub struct ChosenQuality {
    /// Fraction of the shapes classified correctly.
    pub accuracy: f64,
    /// Brier score, the mean of `Σ_c (p_c − [c is the class])²`.
    pub brier: f64,
    /// Log loss, the mean of `−ln p` of the true class.
    pub log_loss: f64,
}

/// Cross-validation: mean shape, alignment, dictionary and classifier are learnt anew without the shapes that are
/// classified.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields))]
pub struct Validation {
    /// Number of parts (folds).
    pub folds: usize,
    /// Number of repeats with different parts.
    pub repeats: usize,
    /// Seed of the random parts.
    pub seed: u64,
    /// Number of shapes classified in every repeat.
    pub shapes: usize,
    /// Number of subjects, each of whose shapes stay in one part; null if no shape has a subject.
    pub subjects: Option<usize>,
    /// Fraction of the shapes classified correctly.
    pub accuracy: PartRecord,
    /// The same fraction for each repeat.
    pub accuracies: Vec<f64>,
    /// Fraction of the shapes in the largest class: the accuracy of always guessing that class.
    pub majority: f64,
    /// Mean recall over the classes.
    pub balanced_accuracy: PartRecord,
    /// Recall and precision, class by class.
    pub classes: Vec<ClassQuality>,
    /// Confusion matrix over all repeats: rows are true classes, columns predicted ones.
    pub confusion: Vec<Vec<usize>>,
    /// Brier score, the mean of `Σ_c (p_c − [c is the class])²`; 0 is perfect.
    pub brier: f64,
    /// Log loss, the mean of `−ln p` of the true class.
    pub log_loss: f64,
    /// Calibration: confidence compared with accuracy.
    pub reliability: Vec<ReliabilityBin>,
    /// Candidates of `best` for all shapes, best first; null without a choice.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub candidates: Option<Vec<Candidate>>,
    /// Quality of the choice; null without a choice, and in dictionaries learnt before it was validated.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub chosen: Option<ChosenQuality>,
}
