//! Recorded form of trained classifiers, and back.

use super::atom_classes::AtomClasses;
use super::class_means::ClassMeans;
use super::classifier::{Classifier, Kind};
use super::discriminant::{Discriminant, Regularisation};
use super::ensemble::{Ensemble, Member};
use super::neighbours::NearestNeighbours;
use crate::classifier_record::{ClassifierRecord, Trained, TrainedMember};
use crate::metric::Metric;
use shapelex_numeric::dense::Matrix;

/// Stored form of a trained classifier.
pub(super) fn trained_of(classifier: &Classifier, kind: Kind, metric: &Metric) -> Trained {
    match classifier {
        Classifier::MeanSpace(ClassMeans { means }) => {
            Trained::MeanSpace { means: means.iter().map(|mean| metric.rows(mean)).collect() }
        }
        Classifier::NearestAtom(AtomClasses { atoms }) => Trained::NearestAtom { atoms: atoms.clone() },
        Classifier::SparseResidual(AtomClasses { atoms }) => Trained::SparseResidual { atoms: atoms.clone() },
        Classifier::Discriminant(discriminant) => {
            let Discriminant { features, scales, means, factors, log_priors, shrinkage } =
                discriminant.clone();
            let pooling = match kind {
                Kind::Discriminant(regularisation) => regularisation.pooling,
                _ => 1.0,
            };
            let triangle = |factor: &Matrix| {
                let row = |i: usize| (0..=i).map(move |j| factor[(i, j)]);
                (0..factor.nrows()).flat_map(row).collect()
            };
            let factors = factors.iter().map(triangle).collect();
            Trained::Discriminant { features, scales, means, factors, log_priors, pooling, shrinkage }
        }
        Classifier::NearestNeighbours(nearest) => {
            let NearestNeighbours { neighbours, features, classes, size_factor, .. } = nearest;
            Trained::NearestNeighbours {
                neighbours: *neighbours,
                features: features.column_iter().map(|column| column.iter().copied().collect()).collect(),
                classes: classes.clone(),
                size_factor: *size_factor,
            }
        }
        Classifier::Ensemble(Ensemble { members }) => {
            let member = |member: &Member| TrainedMember {
                trained: trained_of(&member.classifier, member.kind, metric),
                sharpness: member.sharpness,
                weight: member.weight,
            };
            Trained::Ensemble { members: members.iter().map(member).collect() }
        }
    }
}

/// Kind of a stored classifier.
fn kind_of(trained: &Trained) -> Kind {
    match trained {
        Trained::MeanSpace { .. } | Trained::Ensemble { .. } => Kind::MeanSpace,
        Trained::NearestAtom { .. } => Kind::NearestAtom,
        Trained::SparseResidual { .. } => Kind::SparseResidual,
        Trained::Discriminant { pooling, shrinkage, .. } => Kind::Discriminant(Regularisation {
            components: None,
            pooling: *pooling,
            shrinkage: Some(*shrinkage),
        }),
        Trained::NearestNeighbours { neighbours, .. } => Kind::NearestNeighbours { neighbours: *neighbours },
    }
}

impl Classifier {
    /// Prepares a recorded classifier for use. Its parts must be consistent, as training leaves them.
    pub fn from_record(record: &ClassifierRecord, metric: &Metric) -> Self {
        ready(record.trained.clone(), record.classes.len(), metric)
    }
}

fn ready(trained: Trained, count: usize, metric: &Metric) -> Classifier {
    match trained {
        Trained::MeanSpace { means } => Classifier::MeanSpace(ClassMeans {
            means: means.iter().map(|mean| metric.whitened(mean)).collect(),
        }),
        Trained::NearestAtom { atoms } => Classifier::NearestAtom(AtomClasses { atoms }),
        Trained::SparseResidual { atoms } => Classifier::SparseResidual(AtomClasses { atoms }),
        Trained::Discriminant { features, scales, means, factors, log_priors, shrinkage, .. } => {
            let size = features.len();
            let entry = |triangle: &[f64], i: usize, j: usize| {
                if j <= i { triangle[i * (i + 1) / 2 + j] } else { 0.0 }
            };
            let square = |triangle: &Vec<f64>| Matrix::from_fn(size, size, |i, j| entry(triangle, i, j));
            let factors = factors.iter().map(square).collect();
            Classifier::Discriminant(Discriminant { features, scales, means, factors, log_priors, shrinkage })
        }
        Trained::NearestNeighbours { neighbours, features, classes, size_factor } => {
            let rows = features.first().map_or(0, Vec::len);
            let features = Matrix::from_vec(rows, features.len(), features.concat());
            let nearest = NearestNeighbours { neighbours, features, classes, count, size_factor };
            Classifier::NearestNeighbours(nearest)
        }
        Trained::Ensemble { members } => {
            let member = |TrainedMember { trained, sharpness, weight }| Member {
                kind: kind_of(&trained),
                classifier: ready(trained, count, metric),
                sharpness,
                weight,
            };
            Classifier::Ensemble(Ensemble { members: members.into_iter().map(member).collect() })
        }
    }
}
