//! Candidates among which the kind `best` chooses, and the choice.

use super::classifier::Kind;
use super::discriminant::Regularisation;
use super::ensemble::{self, ROUNDS};
use super::labels::ClassLabels;
use super::observations::Evidence;
use super::quality::Held;
use super::sharpness::{confidences, sharpness};
use crate::classifier_record::{Candidate, ClassifierKind, ClassifierSettings};
use crate::dictionary::model::Model;

/// Maximum count of numbers recorded of a trained classifier: some tens of megabytes in a file.
pub(super) const MAX_STORED: usize = 1 << 22;

/// Numbers of components that `best` tries, as far as available.
const COMPONENTS: [usize; 8] = [5, 8, 10, 15, 20, 30, 40, 60];
/// Poolings that `best` tries.
const POOLINGS: [f64; 4] = [1.0, 0.5, 0.25, 0.0];
/// Shrinkages that `best` tries.
const SHRINKAGES: [Option<f64>; 4] = [None, Some(0.01), Some(0.1), Some(0.3)];
/// Numbers of neighbours that `best` tries.
const NEIGHBOURS: [usize; 4] = [1, 3, 5, 9];
/// Number of reported candidates.
pub(super) const REPORTED: usize = 10;

/// Maximum count of probabilities kept for the candidates of one choice, 32 MB; beyond it, only every second candidate
/// is tried, or fewer.
const MAX_TRIED: usize = 1 << 22;

/// A kind of classifier to train, or several with the sharpness and weight of their probabilities, the heaviest first.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Choice {
    pub(super) ballots: Vec<Ballot>,
}

/// A kind with the sharpness and the weight of its probabilities.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Ballot {
    pub(super) kind: Kind,
    pub(super) sharpness: f64,
    pub(super) weight: f64,
}

impl Choice {
    /// A single kind with its own scores.
    pub(super) fn of(kind: Kind) -> Self {
        Self { ballots: vec![Ballot { kind, sharpness: 1.0, weight: 1.0 }] }
    }

    pub(super) fn first(&self) -> Kind {
        self.ballots[0].kind
    }

    /// Converts scores of a single kind to log probabilities; those of several kinds are log probabilities already.
    pub(super) fn standardise(&self, evidence: &mut [Evidence]) {
        let [only] = self.ballots.as_slice() else { return };
        for evidence in evidence {
            evidence.scores =
                confidences(evidence, only.sharpness).into_iter().map(ensemble::logarithm).collect();
        }
    }
}

/// Results of a candidate on shapes on which it was not trained.
pub(super) struct Trial {
    pub(super) kind: Kind,
    /// Number of correctly classified shapes.
    pub(super) right: usize,
    /// Sharpness `β` of its probabilities.
    pub(super) sharpness: f64,
    /// Probability of the true class of each shape.
    pub(super) likelihoods: Vec<f64>,
}

impl Trial {
    pub(super) fn new(kind: Kind, held: &[Held]) -> Self {
        let sharpness = sharpness(held.iter());
        Self {
            kind,
            right: held.iter().filter(|held| held.evidence.best() == held.class).count(),
            sharpness,
            likelihoods: held.iter().map(|held| confidences(&held.evidence, sharpness)[held.class]).collect(),
        }
    }

    /// Log loss.
    pub(super) fn loss(&self) -> f64 {
        -self.likelihoods.iter().map(|p| ensemble::logarithm(*p)).sum::<f64>()
    }
}

impl ClassifierSettings {
    /// The requested kind with its parameters; `None` if it is to be chosen.
    pub(super) fn requested(&self) -> Option<Kind> {
        Some(match self.kind {
            ClassifierKind::MeanSpace => Kind::MeanSpace,
            ClassifierKind::NearestAtom => Kind::NearestAtom,
            ClassifierKind::SparseResidual => Kind::SparseResidual,
            ClassifierKind::Discriminant => Kind::Discriminant(Regularisation {
                components: self.components,
                pooling: self.pooling.unwrap_or(1.0),
                shrinkage: self.shrinkage,
            }),
            ClassifierKind::NearestNeighbours => {
                Kind::NearestNeighbours { neighbours: self.neighbours.unwrap_or(5) }
            }
            ClassifierKind::Best | ClassifierKind::Ensemble => return None,
        })
    }
}

/// Maximum count of numbers in each classifier that `best` keeps.
const MAX_OF_MEMBER: usize = MAX_STORED / ROUNDS;

/// Candidates for `best` that are small enough to be kept.
pub(super) fn candidates(model: &Model, labels: &ClassLabels) -> Vec<Kind> {
    let (shapes, classes) = (labels.classes.len(), labels.labels.len());
    let mut kinds = Vec::new();
    if classes * model_length(model) <= MAX_OF_MEMBER {
        kinds.push(Kind::MeanSpace);
    }
    match model {
        Model::Sparse { .. } => kinds.extend([Kind::NearestAtom, Kind::SparseResidual]),
        Model::Components { pca, .. } if !pca.centred => kinds.push(Kind::NearestAtom),
        // Differences from a centre are not shapes, so distances to them are meaningless.
        Model::Components { .. } => {}
    }
    if shapes * (model.len() + 1) <= MAX_OF_MEMBER {
        kinds.extend(NEIGHBOURS.map(|neighbours| Kind::NearestNeighbours { neighbours }));
    }
    let mut sizes: Vec<usize> = COMPONENTS.iter().copied().filter(|&count| count < model.len()).collect();
    sizes.push(model.len());
    for count in sizes {
        for pooling in POOLINGS {
            if pooling < 1.0 && classes * (count + 1) * (count + 1) > MAX_OF_MEMBER {
                continue;
            }
            for shrinkage in SHRINKAGES {
                let components = Some(count);
                kinds.push(Kind::Discriminant(Regularisation { components, pooling, shrinkage }));
            }
        }
    }
    let most = (MAX_TRIED / (shapes * classes).max(1)).max(REPORTED);
    let step = kinds.len().div_ceil(most);
    kinds.into_iter().step_by(step.max(1)).collect()
}

/// Number of coordinates of a shape.
fn model_length(model: &Model) -> usize {
    match model {
        Model::Components { pca, .. } => pca.mean.len(),
        Model::Sparse { algebra, atoms, .. } => atoms.matrix().nrows() * algebra.size(),
    }
}

pub(super) fn candidate(kind: Kind, accuracy: f64) -> Candidate {
    let plain = |kind| Candidate {
        kind,
        components: None,
        pooling: None,
        shrinkage: None,
        neighbours: None,
        accuracy,
        weight: None,
    };
    match kind {
        Kind::MeanSpace => plain(ClassifierKind::MeanSpace),
        Kind::NearestAtom => plain(ClassifierKind::NearestAtom),
        Kind::SparseResidual => plain(ClassifierKind::SparseResidual),
        Kind::NearestNeighbours { neighbours } => {
            Candidate { neighbours: Some(neighbours), ..plain(ClassifierKind::NearestNeighbours) }
        }
        Kind::Discriminant(Regularisation { components, pooling, shrinkage }) => {
            Candidate { components, pooling: Some(pooling), shrinkage, ..plain(ClassifierKind::Discriminant) }
        }
    }
}
