//! The classifier of a dictionary: what is asked for, what was trained, and how well it does.

use serde::{Deserialize, Serialize};

use super::dictionary::Row;

/// Kinds of classifiers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum ClassifierKind {
    /// Distance to the mean space of every class.
    MeanSpace,
    /// Class of the atom that correlates best.
    NearestAtom,
    /// Class whose atoms leave least of the shape; for sparse dictionaries.
    SparseResidual,
    /// Regularised discriminant of the code, from linear to quadratic.
    Discriminant,
    /// Votes of the nearest training shapes, by their codes.
    NearestNeighbours,
    /// Those of all these, one or several together, that do best in cross-validation within the training shapes.
    Best,
    /// Several of these together: what `best` may train; not to be asked for.
    Ensemble,
}

/// What a classifier looks at.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Feature {
    /// The shape, as the dictionary describes it.
    Shape,
    /// Its size `ln ‖r − r̄‖`, which the class of transformations may have removed.
    Size,
}

/// A classifier that is asked for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ClassifierSettings {
    /// How classes are told apart.
    pub kind: ClassifierKind,
    /// What names the class of a shape: `label` unless given, or `labels.` and the name of an attribute.
    #[serde(default = "default_attribute")]
    #[schema(default = "label")]
    pub attribute: String,
    /// What is looked at; `["shape"]` unless given.
    #[serde(default = "default_features")]
    #[schema(default = json!(["shape"]))]
    pub features: Vec<Feature>,
    /// For `discriminant`: leading components of the code that are used; all unless given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub components: Option<usize>,
    /// For `discriminant`: 1 (one covariance for all classes: linear) unless given, down to 0 (one a class: quadratic).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pooling: Option<f64>,
    /// For `discriminant`: how far covariances are drawn to a multiple of the identity, 0 to 1; estimated unless given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shrinkage: Option<f64>,
    /// For `nearest_neighbours`: how many vote; 5 unless given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub neighbours: Option<usize>,
    /// Parts of the cross-validation; 5 unless given.
    #[serde(default = "default_folds")]
    #[schema(default = 5)]
    pub folds: usize,
    /// How often it is repeated with other parts; 3 unless given.
    #[serde(default = "default_repeats")]
    #[schema(default = 3)]
    pub repeats: usize,
    /// Draws the parts; 0 unless given.
    #[serde(default)]
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
    /// Whether the size is looked at.
    pub fn sees_size(&self) -> bool {
        self.features.contains(&Feature::Size)
    }

    /// Trainings of the whole validation, each with all that is learnt; `within` for the choice of `best`, whose result is
    /// validated once more.
    pub fn trainings(&self, within: usize) -> usize {
        let parts = self.folds * self.repeats;
        match self.kind {
            ClassifierKind::Best => parts * (1 + within) + 1 + within + parts,
            _ => parts + 1,
        }
    }
}

/// A trained classifier with its validation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ClassifierRecord {
    /// What was asked for.
    pub settings: ClassifierSettings,
    /// The classes, in alphabetical order.
    pub classes: Vec<ClassRecord>,
    /// What was trained on all shapes.
    pub trained: Trained,
    /// `β` of the confidences `∝ exp(β score)`.
    pub sharpness: f64,
    /// How it does on shapes that it has not seen.
    pub validation: Validation,
}

/// A class.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ClassRecord {
    /// Its name: the value of the attribute.
    pub label: String,
    /// Training shapes.
    pub shapes: usize,
    /// Distances of its shapes to it when they were held out, ascending; of more than 1001 that many quantiles.
    pub distances: Vec<f64>,
}

/// The numbers of a trained classifier.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Trained {
    /// Distance to the mean space of every class.
    MeanSpace {
        /// Control points of the mean shape of every class.
        means: Vec<Vec<Row>>,
    },
    /// Class of the atom that correlates best.
    NearestAtom {
        /// The atoms of every class, from 0; those that no shape votes for are of none.
        atoms: Vec<Vec<usize>>,
    },
    /// Class whose atoms leave least of the shape.
    SparseResidual {
        /// The atoms of every class, from 0; those that no shape uses are of none.
        atoms: Vec<Vec<usize>>,
    },
    /// Regularised discriminant.
    Discriminant {
        /// Features that are used, from 0: entries of the code, then the size.
        features: Vec<usize>,
        /// What they are divided by: pooled standard deviations within classes.
        scales: Vec<f64>,
        /// Mean features of every class.
        means: Vec<Vec<f64>>,
        /// Lower triangles, row by row, of the Cholesky factors of the covariances: one for all, or one a class.
        factors: Vec<Vec<f64>>,
        /// `ln(n_c/n)`.
        log_priors: Vec<f64>,
        /// Pooling that was asked for or chosen.
        pooling: f64,
        /// Shrinkage that was given, chosen or estimated.
        shrinkage: f64,
    },
    /// Votes of the nearest training shapes.
    NearestNeighbours {
        /// How many vote.
        neighbours: usize,
        /// Features of the training shapes.
        features: Vec<Vec<f64>>,
        /// Their classes, from 0.
        classes: Vec<usize>,
        /// What the size is multiplied by, when it is a feature.
        size_factor: Option<f64>,
    },
    /// The mean of what several hold likely.
    Ensemble {
        /// At most twelve, the heaviest first; its distances are those of the whole.
        members: Vec<TrainedMember>,
    },
}

/// One classifier of several.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct TrainedMember {
    /// Its numbers.
    #[schema(no_recursion)]
    pub trained: Trained,
    /// `β` of its probabilities `∝ exp(β score)`.
    pub sharpness: f64,
    /// Its part of the mean; those of all sum to 1.
    pub weight: f64,
}

impl Trained {
    /// What was trained.
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

/// A part with its 95 % interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PartRecord {
    /// The estimate.
    pub value: f64,
    /// Lower end of the interval.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

/// Shapes by their confidence in the likeliest class.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ReliabilityBin {
    /// Confidences from here; of the width of a tenth.
    pub from: f64,
    /// Shapes, over all repeats.
    pub count: usize,
    /// Their mean confidence.
    pub confidence: f64,
    /// Part of them that is right.
    pub accuracy: f64,
}

/// How a class is found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ClassQuality {
    /// Name of the class.
    pub label: String,
    /// Part of its shapes that is found.
    pub recall: PartRecord,
    /// Part of the shapes said to be of it that are; null when none is.
    pub precision: Option<f64>,
}

/// A classifier that `best` has tried.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Candidate {
    /// Its kind.
    pub kind: ClassifierKind,
    /// Components of a discriminant.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub components: Option<usize>,
    /// Pooling of a discriminant.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pooling: Option<f64>,
    /// Shrinkage of a discriminant; none when it is estimated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shrinkage: Option<f64>,
    /// Votes of nearest neighbours.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub neighbours: Option<usize>,
    /// Part of the shapes that it got right in the cross-validation that chose. Too high for the one that was chosen:
    /// the figures of the validation are those to be trusted.
    pub accuracy: f64,
    /// Its part in what was chosen; absent when it has none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub weight: Option<f64>,
}

/// What `best` has chosen for all shapes, on the shapes of the same parts when they were held out. Confidences and limits
/// come from these. A little too good, because all shapes had a say in the choice: the figures of the validation, whose
/// choices were made without the shapes they are judged by, are those to be trusted.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ChosenQuality {
    /// Part of the shapes that is right.
    pub accuracy: f64,
    /// Mean of `Σ_c (p_c − [c is the class])²`.
    pub brier: f64,
    /// Mean of `−ln p` of the class.
    pub log_loss: f64,
}

/// Cross-validation: mean shape, alignment, dictionary and classifier are learnt anew without the shapes that are
/// classified.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Validation {
    /// Parts.
    pub folds: usize,
    /// Repeats with other parts.
    pub repeats: usize,
    /// Draws the parts.
    pub seed: u64,
    /// Shapes that were classified in every repeat.
    pub shapes: usize,
    /// Subjects, whose shapes stay in one part; null when no shape has one.
    pub subjects: Option<usize>,
    /// Part of the shapes that is right.
    pub accuracy: PartRecord,
    /// The same of every repeat.
    pub accuracies: Vec<f64>,
    /// Part of the shapes that is in the largest class: what is right without looking.
    pub majority: f64,
    /// Mean recall of the classes.
    pub balanced_accuracy: PartRecord,
    /// Class by class.
    pub classes: Vec<ClassQuality>,
    /// Row: the class; column: what was said. Over all repeats.
    pub confusion: Vec<Vec<usize>>,
    /// Mean of `Σ_c (p_c − [c is the class])²`; 0 is perfect.
    pub brier: f64,
    /// Mean of `−ln p` of the class.
    pub log_loss: f64,
    /// Confidences against what is right.
    pub reliability: Vec<ReliabilityBin>,
    /// What `best` chose from for all shapes, the best first; null without a choice.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub candidates: Option<Vec<Candidate>>,
    /// The choice itself; null without one, and in dictionaries that were learnt before it was validated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub chosen: Option<ChosenQuality>,
}
